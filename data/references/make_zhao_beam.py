"""Writes zhao_beam.json: the beam of Zhao et al. in a field opposite to its magnetization: finite elements, published values, elastica.

    pip install -e .[fem]
    python data/references/make_zhao_beam.py [--plane-strain] [--refined] [--out FILE]    # minutes; --plane-strain: 2D only, seconds

NGSolve minimizes, over displacements that are zero on the face x = 0, the integral of

    W = G/2 (J^(-2/3) tr(F^T F) - 3) + K/2 (J - 1)^2 - (1/mu0) B . (F Br),  F = I + grad u, J = det F, K = 20 G,

in the plane x-z, where nothing varies along y and u_y = 0, and in 3D for a width of 5 mm (half of it, with u_y = 0 on the middle plane).
The straight beam is an equilibrium in any field. So the buckled branch is reached at the largest field with an additional transverse field,
which is then removed, and the branch is followed to lower fields. Elements are of order 3. The stress is singular at the rim of the clamp;
with --refined the elements shrink toward it (SOURCES.md says what that changes).

`published`: values read from figures, to about 0.005 (SOURCES.md). `elastica`: theta'' + load sin(theta) = 0, theta(0) = theta'(1) = 0,
load = 12 Br B L^2 / (mu0 E' h^2): sqrt(load) = K(k^2), the complete elliptic integral, and the tip deflection is 2 k / sqrt(load).

The code uses N, mm, MPa.
"""

from __future__ import annotations

import argparse
import json
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import netgen.occ as occ
import ngsolve as ngs
import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipk

say = partial(print, flush=True)
HERE = Path(__file__).resolve().parent
MU0 = 4e-7 * math.pi  # T m / A
LENGTH, THICKNESS, WIDTH = 17.2, 0.84, 5.0  # mm
G, RATIO, REMANENCE = 0.303, 20.0, 0.143  # MPa, K/G, T
FIELDS = [
    5,
    7,
    10,
    15,
    25,
    40,
]  # mT; at 5, the buckling threshold, there is no finite-element solution
SIDE = 0.2  # of the field: transverse field used to reach the buckled branch
MESH = {"plane_strain": 0.28, "width_5mm": 0.42}  # mm
PUBLISHED = {
    "experiment": [0.55, 0.758, 0.78, 0.68, 0.53, 0.42],
    "zhao_finite_elements": [0.48, 0.78, 0.801, 0.71, 0.559, 0.441],
    "magneticMPM": [0.534, 0.787, 0.746, 0.623, 0.482, 0.377],
}
ABOUT = (
    "Tip of the beam of Zhao, Kim, Cheng, Liu, Zhao, J. Mech. Phys. Solids 124 (2019) 244-263: length 17.2 mm, thickness 0.84 mm, "
    "G 303 kPa, remanence 143 mT along the beam, field against it. Everything over the length. SOURCES.md says where each row is from."
)
SOLVED = (
    f"NGSolve {ngs.__version__}, order 3, K = 20 G, the clamped face held, mean of the end face; converged. "
    "5 mT is left out: the threshold of buckling."
)


def make_mesh(kind: str, refined: bool) -> ngs.Mesh:
    """Mesh of the plane x-z, or of half the width, with the faces `clamp`, `tip` and `middle`."""
    if kind == "plane_strain":
        shape = occ.MoveTo(0, -THICKNESS / 2).Rectangle(LENGTH, THICKNESS).Face()
        shape.edges.Min(occ.X).name, shape.edges.Max(occ.X).name = "clamp", "tip"
        shape.edges.Min(occ.X).vertices.hpref = 1
        mesh = ngs.Mesh(occ.OCCGeometry(shape, dim=2).GenerateMesh(maxh=MESH[kind]))
    else:
        shape = occ.Box(occ.Pnt(0, 0, -THICKNESS / 2), occ.Pnt(LENGTH, WIDTH / 2, THICKNESS / 2))
        shape.faces.Min(occ.X).name, shape.faces.Max(occ.X).name, shape.faces.Min(occ.Y).name = (
            "clamp",
            "tip",
            "middle",
        )
        shape.faces.Min(occ.X).edges.hpref = 1
        mesh = ngs.Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=MESH[kind]))
    if refined:
        mesh.RefineHP(2, 0.2)
    return mesh


class Beam:
    """The beam and its field (T): `against` the magnetization and `across` the beam."""

    def __init__(self, kind: str, refined: bool) -> None:
        self.mesh, self.plane = make_mesh(kind, refined), kind == "plane_strain"
        if self.plane:
            self.space = ngs.VectorH1(self.mesh, order=3, dirichlet="clamp")
        else:
            self.space = ngs.VectorH1(
                self.mesh,
                order=3,
                dirichletx="clamp",
                dirichlety="clamp|middle",
                dirichletz="clamp",
            )
        self.u = ngs.GridFunction(self.space)
        self.against, self.across = ngs.Parameter(0.0), ngs.Parameter(0.0)
        size = 2 if self.plane else 3
        H = ngs.Grad(self.space.TrialFunction())
        F, J = H + ngs.Id(size), ngs.Det(H + ngs.Id(size))
        first = ngs.InnerProduct(F, F) + (1 if self.plane else 0)
        elastic = G / 2 * (J ** (-2 / 3) * first - 3) + RATIO * G / 2 * (J - 1) ** 2
        magnetic = 1e-6 / MU0 * REMANENCE * (self.against * H[0, 0] - self.across * H[size - 1, 0])
        self.form = ngs.BilinearForm(self.space, symmetric=True)
        self.form += ngs.Variation((elastic + magnetic).Compile() * ngs.dx(bonus_intorder=2))

    def minimize(self) -> None:
        """Newton's method with backtracking, until a step would lower the energy by less than 1e-13 of it."""
        state = self.u.vec
        residual, step, start = (state.CreateVector() for _ in range(3))
        for _ in range(100):
            self.form.Apply(state, residual)
            self.form.AssembleLinearization(state)
            step.data = (
                self.form.mat.Inverse(self.space.FreeDofs(), inverse="sparsecholesky") * residual
            )
            decrement, energy, fraction = (
                ngs.InnerProduct(step, residual),
                self.form.Energy(state),
                1.0,
            )
            start.data = state
            state.data -= step
            if abs(decrement) < 1e-13 * abs(energy):
                return
            while (
                not self.form.Energy(state) < energy - 1e-4 * fraction * decrement
            ):  # "not <" is also true for NaN
                fraction /= 2
                if fraction < 1e-6:
                    raise RuntimeError(f"no way down at {self.against.Get():g} T")
                state.data = start - fraction * step
        raise RuntimeError(f"Newton's method does not converge at {self.against.Get():g} T")

    def tip(self) -> tuple[float, float]:
        """Mean displacement of the end face across and along the beam, over the length."""
        end = self.mesh.Boundaries("tip")
        area, moved = (
            ngs.Integrate(f, self.mesh, definedon=end, order=8) for f in (ngs.CF(1), self.u)
        )
        return abs(moved[-1]) / area / LENGTH, moved[0] / area / LENGTH


def buckled(kind: str, refined: bool) -> dict[str, list[float | None]]:
    """Tip displacements on the buckled branch at FIELDS; None at the threshold field."""
    beam = Beam(kind, refined)
    say(f"{kind}: {beam.space.ndof} unknowns")
    most = 1e-3 * FIELDS[-1]
    for share in np.linspace(0, 1, 9)[1:]:
        beam.against.Set(share * most)
        beam.across.Set(SIDE * share * most)
        beam.minimize()
    tips: dict[int, tuple[float, float]] = {}
    beam.across.Set(0.0)
    for field in FIELDS[:0:-1]:
        beam.against.Set(1e-3 * field)
        beam.minimize()
        tips[field] = beam.tip()
        say(
            f"  {field} mT: deflection {tips[field][0]:.5f}, axial {tips[field][1]:.5f} of the length"
        )
    rows = [tips.get(field) for field in FIELDS]
    names = ("deflection", "axial")
    return {
        name: [None if row is None else round(row[k], 4) for row in rows]
        for k, name in enumerate(names)
    }


def elastica(modulus: float) -> list[float]:
    """Tip deflections at FIELDS, over the length, of an inextensible beam with this bending modulus (MPa); 0: straight."""
    found = []
    for field in FIELDS:
        load = 12 * REMANENCE * 1e-3 * field / MU0 * 1e-6 * (LENGTH / THICKNESS) ** 2 / modulus
        if load <= math.pi**2 / 4:
            found.append(0.0)
            continue
        m = brentq(_above, 0.0, 1 - 1e-15, args=(load,), xtol=1e-16)
        found.append(round(2 * math.sqrt(m / load), 3))
    return found


def _above(m: float, load: float) -> float:
    """Zero where m = k^2 belongs to the load."""
    return float(ellipk(m)) - math.sqrt(load)


def text(book: dict[str, Any]) -> str:
    """JSON text with each list on one line."""
    plain = json.dumps(book, indent=2)
    return (
        re.sub(
            r"\[[^\]]*\]",
            lambda found: re.sub(r"\s*\n\s*", " ", found[0]).replace("[ ", "[").replace(" ]", "]"),
            plain,
        )
        + "\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--plane-strain",
        action="store_true",
        help="solve only plane strain; keep the existing values for 5 mm",
    )
    parser.add_argument(
        "--refined", action="store_true", help="elements that shrink toward the rim of the clamp"
    )
    parser.add_argument("--out", type=Path, default=HERE / "zhao_beam.json", help="file to write")
    options = parser.parse_args()
    ngs.SetNumThreads(1)
    solved: dict[str, Any] = {
        "about": SOLVED,
        "plane_strain": buckled("plane_strain", options.refined),
    }
    if options.plane_strain:
        solved["width_5mm"] = json.loads((HERE / "zhao_beam.json").read_text())["finite_elements"][
            "width_5mm"
        ]
    else:
        solved["width_5mm"] = buckled("width_5mm", options.refined)
    thin = "Inextensible beam with bending modulus 3 G (narrow, K infinite) and 4 G (plane strain, K infinite)."
    book = {
        "about": ABOUT, "length": 17.2e-3, "field_mT": FIELDS, "finite_elements": solved, "published": PUBLISHED,
        "elastica": {"about": thin, "3G": elastica(3 * G), "4G": elastica(4 * G)},
    }  # fmt: skip
    options.out.write_text(text(book))


if __name__ == "__main__":
    main()
