"""Error of a solution, estimated from the same scene on a finer grid.

The error of grid n is u - u_n = (u - u_m) + (u_m - u_n). Where errors fall at least as h^p, the part that the finer grid m leaves is at
most (n/m)^p of the whole, so |u - u_n| <= |u_m - u_n| / (1 - (n/m)^p). For p we take the slowest order there is, that of the singular
stress at a clamp's rim; smooth parts of the error fall faster, and the bound is then up to 1 / (1 - (n/m)^p) too large: 1.5 for n/m = 1/2.

The grids must differ enough (`proof`). Between neighbors (2 and 3 cells, 4 and 5) the error depends on how the grid happens to cut a
round section or a thin wall, and their difference says little: docs/accuracy.md has the measurements.

Source of the idea: Richardson, Phil. Trans. A 210 (1911) 307; Roache, J. Fluids Eng. 116 (1994) 405 (grid convergence index).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from magmpm.compiled.arrays import Array

WARY = 0.7
SOUGHT = (
    0.05,
    16.0,
    0.01,
)  # orders of differences: from, to, and how finely; one decimal is told, and above 4 there is none
ALGEBRAIC = (
    0.3  # of the root of the solve's tolerance: error of the solve, over the largest displacement
)


# 1.5: the singular stress at the rim of a clamp, docs/design.md; 1: less what the cut of the grid does; 4: bending far from the clamp, in
# cells that are fine enough. On 95 scenes drawn at random (seeds 0 to 99 of tests/benchmarks/drawn_scenes.py) the bound was too small by up
# to 1.31 at 2 cells and 1.99 at 3, against the finest grid solved; never at 4. With these factors of safety the worst are 1.05 and 1.47.
# the slowest order; that of errors that fall steadily; the fastest
ORDER = 1.5
LEAST_ORDER = 1.0
FASTEST = 4.0
PROOF = {
    2: 4,
    3: 5,
    4: 6,
    5: 7,
    6: 8,
    7: 10,
    8: 11,
    9: 12,
    10: 14,
    11: 15,
    12: 16,
}  # cells across: of the grid that tells another's error
INTERMEDIATE = {
    2: 3
}  # grids between that tell whether errors fall steadily: neighbors' differences say little and count for less
SAFETY = {2: 1.25, 3: 1.35}


def bound(
    coarse: int, fine: int, difference: float, others: Mapping[int, float], around: float = 0.0
) -> float:
    """Bound (m) of the error of a grid that has this `difference` (m) from a finer one; grids by their cells across.

    others: distances (m) of grids in between from the finer one. Where one of these is farther from the finer grid than the coarse one is
    (bodies of large K/G), the two are close by chance, and the finer grid's own error, as the one in between tells it, counts.
    around: as of `factor`.
    """
    own = [distance / (1.0 / left(n, fine) - 1.0) for n, distance in others.items() if n > coarse]
    return max(factor(coarse, fine, around) * difference, difference + WARY * max(own, default=0.0))


def factor(coarse: int, fine: int, around: float = 0.0) -> float:
    """The factor between the difference of two grids and the bound of the coarser one's error.

    around: the part of a tube's error that more cells around its axis leave; 0 without such cells.
    """
    return SAFETY.get(coarse, 1.0) / (1.0 - max(left(coarse, fine), around))


def left(coarse: int, fine: int, order: float = ORDER) -> float:
    """The part of a grid's error that a finer one leaves, at most: of errors that fall at this order, or faster."""
    return (coarse / fine) ** order


def foretold(errors: Mapping[int, float], cells: int) -> float:
    """The error (m) of a finer grid, from those of one or more grids: at the order that the last two show, or the usual one."""
    order = observed_order(errors)
    last = max(errors)
    return errors[last] * (last / cells) ** min(
        max(2.0 if order is None else order, ORDER), FASTEST
    )


def steady(order: float | None) -> bool | None:
    """Return whether errors that fall at this order are in the asymptotic range; None where no order is known.

    An order is told to the nearest whole one: orders of single scenes scatter by some tenths. Beyond FASTEST no error of the method falls:
    then the coarser grids are too coarse, and their errors are of another kind.
    """
    return None if order is None else order >= LEAST_ORDER and round(order) <= FASTEST


def why_undetermined(order: float | None, errors: Sequence[float]) -> str | None:
    """Reason why errors of grids, coarse to fine, show no order; None where they show this one, or are too few to show any."""
    if order is None or len(errors) < 2:
        return None
    if list(errors) != sorted(errors, reverse=True):
        return "the errors do not fall steadily with the cells"
    if order < LEAST_ORDER:
        return "the errors fall too slowly for an order: the grids are too coarse"
    if not steady(order):
        return (
            f"the errors fall faster than the method's can, by order {FASTEST:g} at most: the grids"
            " are too coarse"
        )
    return None


def order_to_finest(differences: Mapping[int, float], finest: int) -> float | None:
    """Order p at which grids (by their cells across) differ from the finest one, as C (n^-p - m^-p), m being that one's cells.

    The finest has an error itself. Taken for the truth, it would let the others seem to converge at a higher order, the more so the nearer
    they are to it: 3.3 in place of 2 for the grids of 2, 3 and 4 cells. None of fewer than two differences.
    """
    known = {n: difference for n, difference in differences.items() if difference > 0.0}
    if len(known) < 2:
        return None
    cells = np.array(list(known), dtype=float)
    logs = np.log(list(known.values()))
    orders = np.arange(*SOUGHT)
    shape = np.log(cells[:, None] ** -orders - float(finest) ** -orders)
    return float(orders[np.argmin(np.var(logs[:, None] - shape, axis=0))])


def farthest(one: Array, other: Array) -> float:
    """Largest distance (m) between points (k, 3) m and their partners."""
    return float(np.linalg.norm(one - other, axis=1).max())


def caution(slenderness: float, wall: float) -> float:
    """Factor of the bounds for bodies unlike those by which they were measured: walls below a fifth of a cell, and bodies of L/D below 3.
    Three tubes with a wall of a tenth of a cell, and a body of L/D 2, had errors of up to 1.74 and 1.51 of their bounds.

    slenderness: length over thickness; wall: cells across a tube's wall (inf without a bore).
    """
    return (2.0 if wall < 0.2 else 1.0) * (1.6 if slenderness < 3.0 else 1.0)


def observed_order(errors: Mapping[int, float]) -> float | None:
    """The order at which the errors of the last two grids fall; None where there is one alone."""
    if len(errors) < 2:
        return None
    before, last = sorted(errors)[-2:]
    if not min(errors[before], errors[last]) > 0.0:
        return None
    return float(np.log(errors[before] / errors[last]) / np.log(last / before))
