"""Near enough to an equilibrium to tell how far another grid is from it: one factorization, and steps that use it again.

The residual of each step is exact, whatever the factors. So these may be of single precision, which takes half the time, unless the body is
slender: they are right to 1e-7 of the stiffest mode, and the softest one of a body of L/D 30 is no stiffer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from magmpm.compiled.arrays import Array
from magmpm.statics.block_cholesky import factor, rounded, solve
from magmpm.statics.energy import Energy
from magmpm.statics.error_estimate import distance
from magmpm.statics.newton import PAIRS, corrected

SETTLED = 0.03  # of the difference from the coarser grid: a proof may still move by so much
MOST_CHORDS = 10  # steps with one set of factors
ASTRAY = 3.0  # times the first one: a step that is longer leads away
SLENDER = 15.0  # length over thickness: above, factors are of double precision. Steps settled as they do with those up to 20, not at 24


def approached(
    energy: Energy,
    start: Array,
    points: Callable[[Array], Array],
    compared: Array,
    slenderness: float,
    on_step: Callable[[int, float], None],
) -> Array | None:
    """The equilibrium near grid coefficients `start` (planes, m) m; None where this is not to be had so cheaply.

    points(grid): where the difference counts, (k, 3) m; compared (k, 3) m: these of the coarser grid. Steps end when one moves the
    points by less than SETTLED of their distance to `compared`. slenderness: length over thickness. on_step(number, 0.0): at each step.
    """
    point = energy.at(start)
    if not point.min_det_F > 0:
        return None
    residual, panels = energy.tangent(point)
    factors = panels if slenderness > SLENDER else rounded(panels)
    if factor(factors, energy.model.layout.split) >= 0:
        return None
    newton = partial(solve, factors, energy.model.layout.split)
    first, at, direction = 0.0, points(start), -newton(residual)
    pairs: list[tuple[Array, Array]] = []
    for step in range(MOST_CHORDS + 1):
        point = energy.at(point.grid + direction)
        if not point.min_det_F > 0:
            return None
        before, at = at, points(point.grid)
        moved = distance(at, before)
        first = first if step else moved
        on_step(step, 0.0)
        if step and moved < SETTLED * distance(at, compared):
            return point.grid
        if moved > ASTRAY * first:
            return None
        last, residual = residual, energy.residual(point)
        pairs = [*pairs[1 - PAIRS :], (direction, residual - last)]
        direction = corrected(residual, pairs, lambda right: -newton(right))
    return None
