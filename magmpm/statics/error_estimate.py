"""How far a solution is from the exact one, told from the same scene on a finer grid.

The error of grid n is u - u_n = (u - u_m) + (u_m - u_n). Where errors fall at least as h^p, the part that the finer grid m leaves is at
most (n/m)^p of the whole, so |u - u_n| <= |u_m - u_n| / (1 - (n/m)^p). For p we take the slowest order there is, that of the singular
stress at a clamp's rim; smooth parts of the error fall faster, and the bound is then up to 1 / (1 - (n/m)^p) too large: 1.5 for n/m = 1/2.

The grids must differ enough (`proof`). Between neighbors (2 and 3 cells, 4 and 5) the error depends on how the grid happens to cut a
round section or a thin wall, and their difference says little: docs/accuracy.md has the measurements.

Where soft and stiff segments meet, the strain jumps within a cell, whose splines have no jump: the stiff segment reaches into the soft one
by a part of a cell, which depends on where in the cell they meet. Such errors fall as h, and jump from grid to grid. So these bodies have
bounds of their own (JOINTED).
Source of the idea: Richardson, Phil. Trans. A 210 (1911) 307; Roache, J. Fluids Eng. 116 (1994) 405 (grid convergence index).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene
from magmpm.scene.joints import stiffness_jump

# What drawn scenes (SMOOTH, below) had not: walls below a fifth of a cell, and bodies of L/D below 3. Three tubes with a wall of a tenth of
# a cell, and a body of L/D 2, had errors of up to 1.74 and 1.51 of their bounds, which are therefore twice and 1.6 times as large.
THIN, THIN_WALL = 2.0, 0.2
BLUNT, BLUNT_BODY = 1.6, 3.0
WARY = 0.7
ALGEBRAIC = 0.3  # of the root of the solve's tolerance: error of the solve, over the largest displacement
JUMP = 1.5  # ratio of the moduli of neighboring segments above which a body is jointed


@dataclass(frozen=True)
class Convergence:
    """How the errors of a kind of body fall with its cells, and by which grids they are told. Numbers are cells across.

    order: the slowest there is; least, most: orders between which errors fall as they must for an order to mean anything; fastest, usual:
    orders at which errors can fall, and at which they are taken to fall before a scene has shown its own; sharpest: at which they fall at
    most from the coarsest grids on, inf where that is not known.
    proof: of the grid that tells the error of another; witness: of those between the two which tell whether errors fall steadily
    (neighbors' differences say little, so they count for less); safety: what bounds are multiplied by, 1 unless named.
    """

    order: float
    least: float
    most: float
    fastest: float
    usual: float
    sharpest: float
    proof: Mapping[int, int]
    witness: Mapping[int, tuple[int, ...]]
    safety: Mapping[int, float]

    def factor(self, coarse: int, fine: int) -> float:
        """What the difference of two grids is multiplied by to bound the coarser one's error; no unit."""
        return self.safety.get(coarse, 1.0) / (1.0 - (coarse / fine) ** self.order)

    def bound(self, coarse: int, fine: int, apart: float, others: Mapping[int, float]) -> float:
        """Bound (m) of the error of a grid that is `apart` (m) from a finer one.

        others: distances (m) of other, coarser grids from the finer one. Where the errors fall steadily, they change nothing. Where a grid
        in between is farther from the finer one than the coarse grid is (bodies of large K/G, joints), the two are close by chance, and the
        finer grid's own error, as the one in between tells it, counts. Grids coarser than both tell the least error that there can be, for
        errors fall no faster than at the order `sharpest` from them.
        """
        own = [distance * self.left(n, fine) / (1.0 - self.left(n, fine)) for n, distance in others.items() if n > coarse]
        least = [distance * (n / coarse) ** self.sharpest for n, distance in others.items() if n < coarse]
        return max(self.factor(coarse, fine) * apart, apart + WARY * max(own, default=0.0), max(least, default=0.0))

    def left(self, coarse: int, fine: int) -> float:
        """The part of a grid's error that a finer one leaves, at most."""
        return (coarse / fine) ** self.order

    def foretold(self, errors: Mapping[int, float], cells: int) -> float:
        """The error (m) of a finer grid, from those of one or more grids: at the order that the last two show, or the usual one."""
        order = observed_order(errors)
        last = max(errors)
        return errors[last] * (last / cells) ** min(max(self.usual if order is None else order, self.order), self.fastest)

    def steady(self, order: float | None) -> bool | None:
        """Whether errors that fall at this order are in the asymptotic range; None where no order is known."""
        return None if order is None else self.least <= order <= self.most


# Bodies of one stiffness. 1.5: the singular stress at the rim of a clamp, docs/design.md; 1: less what the cut of the grid does; 4: bending
# far from the clamp, in cells that are fine enough. On 95 scenes drawn at random (seeds 0 to 99 of tests/benchmarks/drawn_scenes.py) the
# bound was too small by up to 1.31 at 2 cells and 1.99 at 3, against the finest grid solved; never at 4. With these factors of safety the
# worst are 1.05 and 1.47.
SMOOTH = Convergence(
    order=1.5, least=1.0, most=np.inf, fastest=4.0, usual=2.0, sharpest=np.inf,
    proof={2: 4, 3: 5, 4: 6, 5: 7, 6: 8, 7: 10, 8: 11, 9: 12, 10: 14, 11: 15, 12: 16}, witness={2: (3,)}, safety={2: 1.25, 3: 1.35},
)  # fmt: skip
# Bodies of soft and stiff segments. On 80 of them (tests/benchmarks/drawn_scenes.jointed, seeds 0 to 79) bounds by SMOOTH were up to ten
# times too small; these by 1.22 at most, docs/accuracy.md.
_WIDE = {2: 4, 3: 6, 4: 7, 5: 8, 6: 9, 7: 11, 8: 12, 9: 14, 10: 15, 11: 16}
JOINTED = Convergence(
    order=1.0, least=0.5, most=2.5, fastest=2.5, usual=1.0, sharpest=2.0,
    proof=_WIDE, witness={n: (n + 1, _WIDE[n] - 1) for n in _WIDE}, safety=dict.fromkeys(_WIDE, 1.25) | {2: 1.4},
)  # fmt: skip


def convergence(scene: Scene) -> Convergence:
    """How the errors of a scene's body fall: neighboring segments whose moduli differ by more than JUMP make it jointed."""
    return JOINTED if stiffness_jump(scene) > JUMP else SMOOTH


def distance(one: Array, other: Array) -> float:
    """Largest distance (m) between points (k, 3) m and their partners."""
    return float(np.linalg.norm(one - other, axis=1).max())


def caution(slenderness: float, wall: float) -> float:
    """What bounds are multiplied by for bodies unlike those by which they were measured. slenderness: length over thickness; wall: cells
    across a tube's wall (inf without a bore)."""
    return (THIN if wall < THIN_WALL else 1.0) * (BLUNT if slenderness < BLUNT_BODY else 1.0)


def observed_order(errors: Mapping[int, float]) -> float | None:
    """The order at which the errors of the last two grids fall; None where there is one alone."""
    if len(errors) < 2:
        return None
    before, last = sorted(errors)[-2:]
    if not min(errors[before], errors[last]) > 0.0:
        return None
    return float(np.log(errors[before] / errors[last]) / np.log(last / before))
