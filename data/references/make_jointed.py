"""Reference solutions of jointed catheters and of tubes that bend in a plane, by 3D finite elements: jointed_catheters.json.

    pip install -e .[fem]
    python data/references/make_jointed.py [NAME ...] [--out FILE]    # minutes per case; without a name: every case

Problem, energy and Newton's method are those of make_fem.py; the mesh is another. Field, magnetization and gravity lie in the x-z
plane, so half of the body (y >= 0) is solved, with u_y = 0 on the plane y = 0. Elements are hexahedra, and prisms along a solid
body's axis, in slabs across x and in rings that follow the section, curved to order 5. They shrink geometrically (five times a layer)
in x toward the clamp and from both sides toward every joint, and in the radius toward the outer surface and the bore: toward every
rim where the stress is singular.

Newton's method begins at the shape of an inextensible rod that bends as Euler's; the lowest modes at order 3 (those symmetric about the
plane) must be stable. The order rises to 4, and then the mesh becomes finer, with shorter slabs and one more layer at every rim: this is
the result. Its stated error is the largest distance of its centerline from that of order 4 on the coarse mesh.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import netgen.meshing as nm
import ngsolve as ngs
import numpy as np
from make_fem import HERE, MU0, X_AXIS, Case, Equilibrium, Segment, say

ABOUT = "3D finite elements by make_jointed.py; SOURCES.md explains the keys. SI units but for keys in _mm and _hz, and centreline (mm)."
STATIONS = 41
COARSE, FINE = (1.0, 2), (0.75, 3)  # length of the slabs over the diameter, layers at each rim
SHRINK = 0.2  # of elements toward a rim, from layer to layer
SECTORS = 4  # of the half section
CORE = 0.5  # of a solid section's radius: straight-sided within
GEOMETRY = 5  # order of the elements' shape


def along_x(*parts: tuple[float, float, float]) -> tuple[Segment, ...]:
    """Segments from (length in mm, shear modulus in kPa, remanence in T), magnetized along x."""
    return tuple(Segment(X_AXIS, 1e-3 * part[0], 1e3 * part[1], part[2]) for part in parts)


def soft_stiff_soft(ratio: float, inner_diameter: float = 0.0) -> Case:
    """Three segments of 40 mm in all, the middle one `ratio` times as stiff."""
    parts = along_x((12.6, 60, 0.05), (13.7, 60 * ratio, 0.12), (13.7, 60, 0.05))
    return Case(parts, 4e-3, (1e-3, 0.0, 5e-3), inner_diameter=inner_diameter)


def tube(wall: float, ratio: float, length: float, field: float) -> Case:
    """A tube of 4 mm of one stiffness; wall over the outer radius, K/G, length in mm, transverse field in mT."""
    inner = 4e-3 * (1 - wall)
    return Case(
        along_x((length, 120, 0.1)),
        4e-3,
        (0.0, 0.0, 1e-3 * field),
        inner_diameter=inner,
        bulk_to_shear=ratio,
    )


SIX = along_x(*[(29 / 6, 60, 0.05), (29 / 6, 600, 0.12)] * 3)
WIRE = along_x((25.8, 200, 0.0), (4.2, 16000, 0.4))
CASES = {
    "rod_10": soft_stiff_soft(10),
    "rod_100": soft_stiff_soft(100),
    "six_segments": Case(SIX, 3e-3, (0.0, 0.0, 8e-3), gravity=(0.0, 0.0, -9.81)),
    "stiff_tip": Case(along_x((18.3, 100, 0.0), (5.7, 3000, 0.3)), 2e-3, (-1e-3, 0.0, 3e-3)),
    "guidewire": Case(
        WIRE, 2e-3, (0.0, 0.0, 4e-3), gravity=(0.0, 0.0, 9.81), inner_diameter=1.4e-3
    ),
    "hollow_10": soft_stiff_soft(10, 2.4e-3),
    **{
        f"tube_{round(100 * wall):02d}_{ratio}": tube(wall, ratio, length, field)
        for wall, length, field in ((0.1, 60.0, 3.0), (0.2, 48.0, 4.5), (0.4, 40.0, 8.0))
        for ratio in (20, 200)
    },
}


def graded(
    start: float, end: float, layers: int, at_start: bool, at_end: bool, size: float
) -> list[float]:
    """Ends of elements of about `size` from start to end, with `layers` more that shrink toward the ends asked for."""
    points = np.linspace(start, end, math.ceil((end - start) / size - 1e-9) + 1)
    near = (points[1] - points[0]) * SHRINK ** np.arange(layers, 0, -1)
    first, last = start + near if at_start else [], (end - near)[::-1] if at_end else []
    return [start, *first, *points[1:-1], *last, end]


class HalfBody:
    """Half of a case's body, meshed: the points of a section are kept as polygons, which `shape` bends to circles."""

    def __init__(self, case: Case, slab: float, layers: int) -> None:
        self.slab, self.layers, self.radius, self.bore = (
            slab,
            layers,
            case.diameter * 500,
            case.inner_diameter * 500,
        )
        wall = self.bore / self.radius
        rings = graded(wall or CORE, 1.0, layers - (wall > 0), wall > 0, True, 1.0)
        slabs, start = [], 0.0  # number of the segment, ends
        for number, segment in enumerate(case.segments):
            end, joint = start + 1e3 * segment.length, number < len(case.segments) - 1
            ends = graded(start, end, layers, True, joint, slab * 2 * self.radius)
            slabs += [(number, a, b) for a, b in pairwise(ends)]
            start = end
        section = [(c, k) for c in rings for k in range(SECTORS + 1)] + ([] if wall else [(0.0, 0)])
        cells = [
            [(a, k), (b, k), (b, k + 1), (a, k + 1)]
            for a, b in pairwise(rings)
            for k in range(SECTORS)
        ]
        if not wall:
            cells += [[(0.0, 0), (CORE, k), (CORE, k + 1)] for k in range(SECTORS)]
        spokes = [
            [(c, k if c else 0), (d, k)]
            for c, d in pairwise(rings if wall else [0.0, *rings])
            for k in (0, SECTORS)
        ]
        rims = [
            [(c, k), (c, k + 1)] for c in ([wall, 1.0] if wall else [1.0]) for k in range(SECTORS)
        ]

        mesh, at = nm.Mesh(), {}
        mesh.dim = 3
        for number, name in enumerate(("clamp", "tip", "plane", "free"), 1):
            mesh.Add(nm.FaceDescriptor(surfnr=number, domin=1, bc=number))
            mesh.SetBCName(number - 1, name)
        for x in (0.0, *(b for _, _, b in slabs)):
            for c, k in section:
                angle = -math.pi / 2 + k * math.pi / SECTORS
                place = c * self.radius * math.cos(angle), c * self.radius * math.sin(angle)
                at[x, c, k] = mesh.Add(nm.MeshPoint(nm.Pnt(x, *place)))
        for number, a, b in slabs:
            for cell in cells:
                mesh.Add(nm.Element3D(number + 1, [at[x, *p] for x in (a, b) for p in cell]))
            for kind, lines in ((3, spokes), (4, rims)):
                for p, q in lines:
                    mesh.Add(nm.Element2D(kind, [at[a, *p], at[b, *p], at[b, *q], at[a, *q]]))
        for kind, x in ((1, 0.0), (2, slabs[-1][2])):
            for cell in cells:
                mesh.Add(nm.Element2D(kind, [at[x, *p] for p in cell]))
        for number in range(len(case.segments)):
            mesh.SetMaterial(number + 1, f"segment{number}")
        self.mesh = ngs.Mesh(mesh)
        self.shape = ngs.GridFunction(ngs.VectorH1(self.mesh, order=GEOMETRY))
        for component, values in zip(self.shape.components[1:], self.bent(bool(wall)), strict=True):
            component.Set(values)
        self.mesh.SetDeformation(self.shape)

    def bent(self, hollow: bool) -> list[ngs.CoefficientFunction]:
        """y and z displacement that bends polygons to circles, equal angles from equal parts of an edge: in a solid body from none at the
        core to all at the surface.
        """
        half, turn, away = (
            math.pi / (2 * SECTORS),
            ngs.atan2(ngs.z, ngs.y),
            ngs.sqrt(ngs.y**2 + ngs.z**2),
        )
        steps = [
            ngs.IfPos(turn + math.pi / 2 - 2 * half * k, 2 * half, 0) for k in range(1, SECTORS)
        ]
        middle = sum(steps, ngs.CF(half - math.pi / 2))
        radius = away * ngs.cos(turn - middle) / math.cos(half)
        angle = middle + half * ngs.tan(turn - middle) / math.tan(half)
        beyond = (radius / self.radius - CORE) / (1 - CORE)
        share = ngs.CF(1) if hollow else ngs.IfPos(beyond, beyond, 0)
        return [
            share * (radius * ngs.cos(angle) - ngs.y),
            share * (radius * ngs.sin(angle) - ngs.z),
        ]

    def unbent(self, radius: float, angle: float) -> tuple[float, float]:
        """Point of the polygons that becomes this point of a tube's section."""
        half = math.pi / (2 * SECTORS)
        within = (angle + math.pi / 2) % (2 * half) - half
        straight = complex(radius * math.cos(half), radius * math.sin(half) * within / half)
        place = straight * np.exp(1j * (angle - within))
        return place.real, place.imag


class HalfEquilibrium(Equilibrium):
    """Equilibrium of half a body; `condense`: the elements' inner unknowns are eliminated first."""

    def __init__(self, case: Case, body: HalfBody, order: int, condense: bool = True) -> None:
        self.condense = condense
        self.case, self.body, self.mesh, self.order = case, body, body.mesh, order
        self.space = ngs.VectorH1(
            self.mesh, order=order, dirichlet="clamp", dirichlety="clamp|plane"
        )
        self.free, self.u, self.load = (
            self.space.FreeDofs(),
            ngs.GridFunction(self.space),
            ngs.Parameter(1.0),
        )
        self.newton_steps = 0
        self.form = ngs.BilinearForm(self.space, symmetric=True, condense=condense)
        for density in self.densities(self.space.TrialFunction()).values():
            self.form += ngs.Variation(density.Compile() * ngs.dx)

    def tangent_inverse(self) -> ngs.BaseMatrix:
        if not self.condense:
            return super().tangent_inverse()
        self.form.AssembleLinearization(self.u.vec)
        outer = self.form.mat.Inverse(self.space.FreeDofs(True), inverse="sparsecholesky")
        one = ngs.IdentityMatrix(self.space.ndof)
        inward, outward = (
            one + self.form.harmonic_extension,
            one + self.form.harmonic_extension_trans,
        )
        return inward @ outer @ outward + self.form.inner_solve

    def bend_as_rod(self) -> None:
        """Displacement of the rod: its sections turn by the angle that minimizes bending energy less work of couples and weight."""
        case, count = self.case, 400
        h = case.length / count
        place = np.searchsorted(
            np.cumsum([p.length for p in case.segments]), (np.arange(count) + 0.5) * h
        )
        shear = np.array([p.shear_modulus for p in case.segments])[place]
        remanence = np.array([p.remanence for p in case.segments])[place]
        area, K = math.pi / 4 * (case.diameter**2 - case.inner_diameter**2), case.bulk_to_shear
        second = math.pi / 64 * (case.diameter**4 - case.inner_diameter**4)
        beyond = case.length - (np.arange(count) + 0.5) * h
        push = np.outer(remanence * area / MU0, case.field) + np.outer(
            case.density * area * beyond, case.gravity
        )
        stiff = 9 * K / (3 * K + 1) * shear * second / h
        stiff = 1 / (0.5 / stiff + 0.5 / np.roll(stiff, 1))  # between middles of the parts
        stiff[0] *= 2  # from the clamp
        bending = (
            np.diag(stiff + np.append(stiff[1:], 0))
            - np.diag(stiff[1:], 1)
            - np.diag(stiff[1:], -1)
        )
        angle = np.zeros(count)
        for step in np.linspace(0.05, 1.0, 20).repeat(5):
            work = step * h * (push[:, 0] * np.sin(angle) - push[:, 2] * np.cos(angle))
            change = step * h * (push[:, 0] * np.cos(angle) + push[:, 2] * np.sin(angle))
            angle -= np.linalg.solve(bending + np.diag(change), bending @ angle + work)
        s = 1e3 * np.linspace(0.0, case.length, count + 1)
        along, across = (np.append(0.0, np.cumsum(f(angle))) * 1e3 * h for f in (np.cos, np.sin))
        turned = np.interp(s, s[:-1] + 500 * h, angle)
        turned[0] = 0.0
        rows = (along - s, across, np.sin(turned), np.cos(turned) - 1)
        u, w, sine, cosine = (ngs.BSpline(2, [s[0], *s, s[-1]], list(row))(ngs.x) for row in rows)
        self.u.Set(ngs.CF((u - ngs.z * sine, 0, w + ngs.z * cosine)))
        self.u.vec.FV().NumPy()[~np.array(self.free)] = 0.0

    def begin(self, before: HalfEquilibrium) -> None:
        """Take over the displacement of another order or mesh, at the same places of the polygons."""
        for body in (self.body, before.body):
            body.mesh.UnsetDeformation()
        self.u.Set(before.u)
        self.u.vec.FV().NumPy()[~np.array(self.free)] = 0.0
        for body in (self.body, before.body):
            body.mesh.SetDeformation(body.shape)

    def centreline(self, s: np.ndarray) -> np.ndarray:
        """Deformed positions (m, 3) at s (m): of the points (s, 0, 0), or for a tube the mean over its section."""
        outer, inner = self.body.radius, self.body.bore
        points, weights = [(0.0, 0.0)], np.ones(1)
        if (
            inner > 0
        ):  # area mean: Gauss rules in the squared radius, and in the angle of each sector
            node, weight = np.polynomial.legendre.leggauss(6)
            radii = np.sqrt((outer**2 + inner**2 + (outer**2 - inner**2) * node) / 2)
            angles = (
                (np.arange(SECTORS)[:, None] + 0.5 + node / 2) / SECTORS - 0.5
            ).ravel() * math.pi
            points = [self.body.unbent(r, a) for r in radii for a in angles]
            weights = np.outer(weight / 2, np.tile(weight / 2, SECTORS) / SECTORS).ravel()
        self.mesh.UnsetDeformation()
        inside = np.minimum(1e3 * s, 1e3 * self.case.length * (1 - 1e-9))
        moved = np.array([[self.u(self.mesh(x, y, z)) for y, z in points] for x in inside])
        self.mesh.SetDeformation(self.body.shape)
        moved[:, :, 1] = 0.0  # the other half moves the other way
        return np.einsum("p,mpc->mc", weights, moved) * 1e-3 + np.outer(s, X_AXIS)


def make(name: str, path: Path) -> None:
    """Solve from the rod's shape, raise the order, change to the finer mesh; write the entry."""
    case, rows, lines = CASES[name], [], []
    s = np.linspace(0.0, case.length, STATIONS)
    coarse, fine = HalfBody(case, *COARSE), HalfBody(case, *FINE)
    now = None
    for body, order in ((coarse, 3), (coarse, 4), (fine, 4)):
        started, before = time.perf_counter(), now
        now = HalfEquilibrium(case, body, order)
        if before is None:
            now.bend_as_rod()
        else:
            now.begin(before)
        now.minimize()
        lines.append(now.centreline(s))
        tip, seconds = 1e3 * lines[-1][-1], time.perf_counter() - started
        mesh = {"slab": body.slab, "layers": body.layers, "order": order, "ndof": now.space.ndof}
        rows.append(mesh | {"tip_mm": tip.tolist()})
        say(
            f"{name}, order {order}, {now.space.ndof} unknowns: {now.newton_steps} steps, {seconds:.0f} s, tip {tip} mm"
        )
        if before is None:
            whole = HalfEquilibrium(case, body, order, condense=False)
            whole.u.vec.data = now.u.vec
            modes = whole.frequencies()
            say(f"  modes {np.round(modes, 2)} Hz")
    apart = [1e3 * float(np.linalg.norm(line - lines[-1], axis=1).max()) for line in lines[:-1]]
    given = {
        key: value for key, value in asdict(case).items() if key not in ("steps", "ramp_order")
    }
    entry = {"length": case.length} | given | {
        "centreline": np.round(1e3 * np.column_stack([s, lines[-1]]), 6).tolist(),
        "centreline_error_mm": apart[-1],
        "apart_from_result_mm": apart,
        "lowest_symmetric_frequencies_hz": modes,
        "convergence": rows,
        "ngsolve": ngs.__version__,
    }  # fmt: skip
    cases = json.loads(path.read_text())["cases"] if path.exists() else {}
    cases[name] = entry
    blocks = [f'  "{key}": {json.dumps(cases[key])}' for key in CASES if key in cases]
    path.write_text(f'{{\n "about": "{ABOUT}",\n "cases": {{\n' + ",\n".join(blocks) + "\n }\n}\n")
    say(
        f"{name}: stated error {apart[-1] / 10 / case.length:.5f} % of the length; order 3: {apart[0] / 10 / case.length:.5f} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}")
    parser.add_argument("--out", type=Path, default=HERE / "jointed_catheters.json")
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    ngs.SetNumThreads(1)
    ngs.SetHeapSize(10**9)
    for name in options.names or CASES:
        make(name, options.out)


if __name__ == "__main__":
    main()
