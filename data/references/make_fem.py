"""Reference solutions of catheters by 3D finite elements, independent of the solvers of this package.

    pip install -e .[fem]
    python data/references/make_fem.py [NAME ...] [--out DIR]    # some minutes per case; without a name: every case

NGSolve finds the displacement u, zero on the face x = 0, that minimizes the integral over the body of

    W = G/2 (J^(-2/3) tr(F^T F) - 3) + K/2 (J - 1)^2 - (1/mu0) B . (F Br) - rho g . u,
    F = I + grad u, J = det F.

- Branch: field and gravity grow together from zero in equal steps, with elements of low order, so that the solution is on
  the branch of the straight rod. The lowest vibration modes at each step and at the end must be stable.
- Accuracy: at full load the order rises to 4. Elements are tetrahedra curved to order 5, with prisms and hexahedra that shrink
  geometrically toward the rim of the clamp, where the stress is singular. Without them the tip of a 40 mm rod stays 0.02 to
  0.03 mm short, and finer meshes hardly help. Each case is solved on two meshes: the finer one is the result, and the
  distance between the two is its stated error.

The code uses N, mm, MPa, tonne, s; the written files are in SI, except keys and columns that end in _mm.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import netgen.occ as occ
import ngsolve as ngs
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, eigsh

say = partial(print, flush=True)
MU0 = 4e-7 * math.pi  # T m / A
HERE = Path(__file__).resolve().parent
ABOUT = "3D finite elements by make_fem.py; SOURCES.md explains the keys. SI units but for keys in _mm and _hz."
Vector = tuple[float, float, float]
X_AXIS, NONE = (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Segment:
    """Unit direction of the remanence, length (m), shear modulus (Pa), remanence (T)."""

    direction: Vector
    length: float
    shear_modulus: float
    remanence: float


@dataclass(frozen=True)
class Case:
    """One problem, in SI; `steps` load steps with elements of order `ramp_order` from zero to full load."""

    segments: tuple[Segment, ...]  # base to tip
    diameter: float
    field: Vector
    gravity: Vector = NONE
    inner_diameter: float = 0.0
    bulk_to_shear: float = 20.0
    density: float = 1882.0
    steps: int = 6
    ramp_order: int = 2

    @property
    def length(self) -> float:
        return sum(segment.length for segment in self.segments)


def pointing(azimuth: float, elevation: float) -> Vector:
    """Unit vector from degrees: azimuth from +x toward +y, elevation from that plane toward +z."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))


def equal_segments(length: float, remanence: float, *directions: Vector) -> tuple[Segment, ...]:
    """Segments of equal length, with G = 120 kPa."""
    return tuple(
        Segment(direction, length / len(directions), 120e3, remanence) for direction in directions
    )


DOWN = (0.0, 0.0, -9.81)
AXIAL = equal_segments(40e-3, 0.1, X_AXIS)
THREE = equal_segments(30e-3, 0.12, X_AXIS, pointing(60, 20), pointing(240, 30))
FOUR = equal_segments(56e-3, 0.1, *map(pointing, (80, -40, 40, -140), (30, -30, -50, -30)))
FIVE = equal_segments(40e-3, 0.138, *map(pointing, (0, 45, 120, 200, -60), (0, 20, 30, -20, 30)))
MIXED = (
    *(Segment(NONE, 8e-3, 60e3, 0.0), Segment(pointing(30, -10), 4e-3, 120e3, 0.12)),
    *(Segment(NONE, 10e-3, 60e3, 0.0), Segment(pointing(-75, -20), 8e-3, 120e3, 0.12)),
)
MESH_SIZES = (0.32, 0.25)  # relative to the diameter: coarse, fine
CASES = {
    "axial_transverse_5mT": Case(AXIAL, 4e-3, field=(0.0, 0.0, 5e-3)),
    "three_segments_3d": Case(THREE, 3e-3, field=(0.0, 5e-3, 7e-3)),
    "slender_3d": Case(FOUR, 3e-3, field=(1e-3, 3e-3, 3e-3), steps=8, ramp_order=3),
    "gravity_3d": Case(FIVE, 4e-3, field=(0.0, 6e-3, 8e-3), gravity=DOWN),
    "hollow_mixed": Case(MIXED, 4e-3, (3e-3, 8e-3, 8e-3), inner_diameter=2e-3, ramp_order=3),
    "near_incompressible": Case(AXIAL, 4e-3, field=(0.0, 0.0, 5e-3), bulk_to_shear=500.0),
    "gravity_only": Case(equal_segments(40e-3, 0.0, NONE), 4e-3, field=NONE, gravity=DOWN),
}


def make_mesh(case: Case, size: float) -> ngs.Mesh:
    """Mesh with elements of about `size` (mm) and one region per segment; faces `clamp` and `tip`."""
    parts, start = [], 0.0
    for number, segment in enumerate(case.segments):
        base, length = occ.Pnt(start, 0, 0), segment.length * 1e3
        part = occ.Cylinder(base, occ.X, r=case.diameter * 500, h=length)
        if case.inner_diameter > 0:
            part = part - occ.Cylinder(base, occ.X, r=case.inner_diameter * 500, h=length)
        part.solids.name = f"segment{number}"
        parts.append(part)
        start += length
    clamp = parts[0].faces.Min(occ.X)
    clamp.name = "clamp"
    clamp.edges.hpref = 1
    parts[-1].faces.Max(occ.X).name = "tip"
    shape = parts[0] if len(parts) == 1 else occ.Glue(parts)
    mesh = ngs.Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=size, curvaturesafety=1))
    mesh.RefineHP(3, 0.2)
    return mesh.Curve(5)


class Equilibrium:
    """One case on one mesh at one order: its energy, and Newton's method to minimize it."""

    def __init__(self, case: Case, mesh: ngs.Mesh, order: int) -> None:
        self.case, self.mesh, self.order = case, mesh, order
        self.space = ngs.VectorH1(mesh, order=order, dirichlet="clamp")
        self.free = self.space.FreeDofs()
        self.u = ngs.GridFunction(self.space)
        self.load = ngs.Parameter(1.0)
        self.newton_steps = 0
        self.form = ngs.BilinearForm(self.space, symmetric=True)
        for density in self.densities(self.space.TrialFunction()).values():
            self.form += ngs.Variation(density.Compile() * ngs.dx(bonus_intorder=2))

    def densities(self, u: ngs.CoefficientFunction) -> dict[str, ngs.CoefficientFunction]:
        """Terms of W (MPa), each less its value in the undeformed body."""
        case = self.case
        shear, remanence = {}, {}
        for number, segment in enumerate(case.segments):
            shear[f"segment{number}"] = segment.shear_modulus * 1e-6
            remanence[f"segment{number}"] = tuple(segment.remanence * c for c in segment.direction)
        G, Br = self.mesh.MaterialCF(shear), self.mesh.MaterialCF(remanence)
        weight = ngs.CF(tuple(case.density * 1e-9 * g for g in case.gravity))
        H = ngs.Grad(u)
        F = H + ngs.Id(3)
        J = ngs.Det(F)
        isochoric = G / 2 * (J ** (-2 / 3) * ngs.InnerProduct(F, F) - 3)
        return {
            "elastic": isochoric + case.bulk_to_shear * G / 2 * (J - 1) ** 2,
            "magnetic": -self.load * 1e-6 / MU0 * ngs.InnerProduct(ngs.CF(case.field), H * Br),
            "gravity": -self.load * ngs.InnerProduct(weight, u),
        }

    def tangent_inverse(self) -> ngs.BaseMatrix:
        self.form.AssembleLinearization(self.u.vec)
        return self.form.mat.Inverse(self.free, inverse="sparsecholesky")

    def minimize(self, tolerance: float = 1e-13, max_steps: int = 200) -> None:
        """Newton's method with backtracking, until a step would lower the energy by less than `tolerance` of it.

        A factorization is kept while each step makes the decrement ten times smaller.
        """
        state, inverse, decrement = self.u.vec, None, math.inf
        residual, step, start = (state.CreateVector() for _ in range(3))
        for _ in range(max_steps):
            self.newton_steps += 1
            self.form.Apply(state, residual)
            if inverse is not None:
                step.data = inverse * residual
                if not 0 < ngs.InnerProduct(step, residual) < 0.1 * decrement:
                    inverse = None
            if inverse is None:
                inverse = self.tangent_inverse()
                step.data = inverse * residual
            decrement, energy, fraction = (
                ngs.InnerProduct(step, residual),
                self.form.Energy(state),
                1.0,
            )
            start.data = state
            state.data -= step
            if abs(decrement) < tolerance * abs(
                energy
            ):  # below the rounding error of the energy: no line search
                return
            if decrement < 0:  # a start that is rough at a rim: turned round, the step goes down
                decrement, inverse = -decrement, None
                state.data = start + step
                step *= -1.0
            # "not <": the energy is NaN where det F < 0
            while not self.form.Energy(state) < energy - 1e-4 * fraction * decrement:
                fraction, inverse = fraction / 2, None
                if fraction < 1e-6:
                    raise RuntimeError(
                        f"no way down at load {self.load.Get():g}, decrement {decrement:g} mJ"
                    )
                state.data = start - fraction * step
        raise RuntimeError(f"{max_steps} Newton steps do not converge at load {self.load.Get():g}")

    def frequencies(self, count: int = 4) -> list[float]:
        """Lowest natural frequencies (Hz) about the current state; RuntimeError if it is unstable."""
        inverse = self.tangent_inverse()
        v, w = self.space.TnT()
        mass = ngs.BilinearForm(
            self.case.density * 1e-12 * v * w * ngs.dx, symmetric=True
        ).Assemble()
        inside = np.flatnonzero(np.array(self.free))
        force, motion = self.u.vec.CreateVector(), self.u.vec.CreateVector()

        def solve(values: np.ndarray) -> np.ndarray:
            force[:] = 0.0
            force.FV().NumPy()[inside] = values.ravel()
            motion.data = inverse * force
            return motion.FV().NumPy()[inside].copy()

        def on_free(matrix: ngs.BaseMatrix) -> csr_matrix:
            return csr_matrix(matrix.CSR(), shape=(matrix.height, matrix.width))[inside][:, inside]

        stiffness = on_free(self.form.mat)
        squares = eigsh(
            stiffness, count, on_free(mass.mat), sigma=0.0, return_eigenvectors=False, tol=1e-6,
            OPinv=LinearOperator(stiffness.shape, matvec=solve, dtype=float),
        )  # fmt: skip
        if squares.min() <= 0:
            raise RuntimeError(
                f"unstable at load {self.load.Get():g}: omega^2 = {squares.min():g} 1/s^2"
            )
        return sorted(float(f) for f in np.sqrt(squares) / (2 * math.pi))

    def tip(self) -> np.ndarray:
        """Mean position of the end face (m), shape (3,)."""
        end = self.mesh.Boundaries("tip")
        area, moved = (
            ngs.Integrate(f, self.mesh, definedon=end, order=12) for f in (ngs.CF(1), self.u)
        )
        return np.array(moved) / area * 1e-3 + [self.case.length, 0, 0]

    def centreline(self, s: np.ndarray) -> np.ndarray:
        """Deformed positions (m, 3) at s (m): of the points (s, 0, 0), or for a tube the mean over its section."""
        outer, inner = self.case.diameter * 500, self.case.inner_diameter * 500
        points, weights = np.zeros((1, 2)), np.ones(1)
        if inner > 0:  # area mean: Gauss rule in the squared radius, equal steps in the angle
            node, weight = np.polynomial.legendre.leggauss(4)
            radius = np.sqrt((outer**2 + inner**2 + (outer**2 - inner**2) * node) / 2)
            turn = np.exp(1j * np.arange(24) * math.tau / 24)
            points = np.outer(radius, turn).ravel().view(float).reshape(-1, 2)
            weights = np.repeat(weight / 48, 24)
        moved = [[self.u(self.mesh(1e3 * x, y, z)) for y, z in points] for x in s]
        return np.einsum("p,mpc->mc", weights, np.array(moved)) * 1e-3 + np.outer(s, X_AXIS)

    def energy(self) -> dict[str, float]:
        """Integrals (J) of the terms of W, and their sum."""
        case = self.case
        parts = {
            k: 1e-3 * ngs.Integrate(d, self.mesh, order=12)
            for k, d in self.densities(self.u).items()
        }
        section = math.pi / 4 * (case.diameter**2 - case.inner_diameter**2)
        for segment in case.segments:
            along = float(np.dot(case.field, segment.direction))
            parts["magnetic"] -= along * segment.remanence * segment.length * section / MU0
        return parts | {"total": sum(parts.values())}


def solve(case: Case, size: float) -> tuple[Equilibrium, list[dict[str, object]], list[float]]:
    """Raise the load, then the order, on a mesh of `size` (m). Also return one row per order, and the final frequencies."""
    now = Equilibrium(case, make_mesh(case, size * 1e3), case.ramp_order)
    rows: list[dict[str, object]] = []
    for number in range(1, case.steps + 1):
        now.load.Set(number / case.steps)
        now.minimize()
        modes = now.frequencies()
        say(
            f"  load {number}/{case.steps}: {now.newton_steps} Newton steps, modes {np.round(modes, 2)} Hz"
        )
    for order in range(case.ramp_order, 5):
        started, before = time.perf_counter(), now
        if order > case.ramp_order:
            now = Equilibrium(case, before.mesh, order)
            now.u.Set(before.u)
            now.minimize()
        tip, seconds = now.tip(), time.perf_counter() - started
        rows.append(
            {"mesh_size": size, "order": order, "ndof": now.space.ndof, "tip": tip.tolist()}
        )
        say(
            f"  order {order}, {now.space.ndof} unknowns: {now.newton_steps} Newton steps, {seconds:.0f} s"
        )
        say(f"  tip {tip * 1e3} mm")
    return now, rows, now.frequencies()


def make(name: str, folder: Path) -> None:
    """Solve a case on both meshes; write NAME.csv and the entry in fem.json."""
    case = CASES[name]
    s = np.linspace(0.2e-3, case.length - 0.2e-3, 21)
    lines, convergence = [], []
    for fraction in MESH_SIZES:
        say(f"{name}, mesh size {fraction:g} of the diameter")
        fine, rows, modes = solve(case, fraction * case.diameter)
        lines.append(fine.centreline(s))
        convergence += rows
    other, last = (np.array(row["tip"]) for row in convergence if row["order"] == 4)
    entry = {"length": case.length} | asdict(case) | {
        "centreline": f"{name}.csv",
        "tip": convergence[-1]["tip"],
        "tip_error_mm": float(np.linalg.norm(last - other)) * 1e3,
        "centreline_error_mm": float(np.linalg.norm(lines[1] - lines[0], axis=1).max()) * 1e3,
        "energy": fine.energy(),
        "lowest_frequencies_hz": modes,
        "convergence": convergence,
        "ngsolve": ngs.__version__,
    }  # fmt: skip
    what = "the mean of the section at s" if case.inner_diameter > 0 else "the points (s, 0, 0)"
    text = [
        f"# 3D finite elements (make_fem.py): deformed positions of {what}",
        "s_mm,x_mm,y_mm,z_mm",
    ]
    text += [
        ",".join(f"{1e3 * value:.6f}" for value in row) for row in np.column_stack([s, lines[1]])
    ]
    (folder / f"{name}.csv").write_text("\n".join(text) + "\n")
    path = folder / "fem.json"
    cases = json.loads(path.read_text())["cases"] if path.exists() else {}
    cases[name] = entry
    book = {"about": ABOUT, "cases": {key: cases[key] for key in CASES if key in cases}}
    path.write_text(json.dumps(book, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}")
    parser.add_argument("--out", type=Path, default=HERE, help="folder for NAME.csv and fem.json")
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    options.out.mkdir(parents=True, exist_ok=True)
    ngs.SetNumThreads(1)
    for name in options.names or CASES:
        make(name, options.out)


if __name__ == "__main__":
    main()
