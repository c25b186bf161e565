"""The interval of one constant: where the sum of squares, with the others at their best, has risen by the quantile squared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError
from magmpm.studies.fitting.solve import Minimum, Model, least_squares

PARABOLIC = 0.1  # share by which the rise at the linear interval's ends may differ from the parabola's
NEAR = 0.01  # of the quantile: accuracy of an end on the profile
SMALL = 0.03  # standard errors: a step below it ends a search on the profile; it changes a sum of squares of 4 by 0.001, far below NEAR
FARTHEST = 6.0  # standard errors, or in x: an end is not sought beyond
MOST_TURNS = 12


@dataclass(frozen=True)
class Interval:
    """Ends in x; None where the sum of squares does not rise enough. method: linear | profile."""

    low: float | None
    high: float | None
    method: str


def interval_of(model: Model, best: Minimum, covariance: Array, k: int, quantile: float, say: Callable[[], None]) -> Interval:
    """The interval of the number k, by the residuals in standard errors and the covariance (k, k) of x at the minimum."""
    error = float(np.sqrt(covariance[k, k]))
    along = covariance[:, k] / error**2  # how the others go along with x_k
    ends = []
    parabolic = True
    for side in (-1.0, 1.0):
        there = best.x + along * side * quantile * error
        try:
            rise = float(np.sum(model(there, False)[0] ** 2)) - best.cost
        except MagmpmError:
            rise = np.inf
        parabolic &= abs(rise - quantile**2) <= PARABOLIC * quantile**2
        ends.append(float(there[k]))
    if parabolic:
        return Interval(ends[0], ends[1], "linear")
    low, high = (_end(model, best, along, k, side * error, quantile) for side in (-1.0, 1.0))
    return Interval(low, high, "profile")


def _end(model: Model, best: Minimum, along: Array, k: int, error: float, quantile: float) -> float | None:
    """Point where the root of the rise meets the quantile, by false position; None where it does not within reach. error: with its sign."""
    free = np.arange(len(best.x)) != k
    reach = max(FARTHEST * quantile * abs(error), FARTHEST)

    def root(distance: float, start: Array) -> tuple[float, Array]:
        there = start.copy()
        there[k] = best.x[k] + np.sign(error) * distance
        try:
            found = least_squares(model, there, free=free, scale=1.0, small=SMALL)
        except MagmpmError:
            return np.inf, start
        return float(np.sqrt(max(found.cost - best.cost, 0.0))), found.x

    inside, below, x = 0.0, 0.0, best.x
    distance = quantile * abs(error)
    outside, above = None, np.inf
    for _ in range(MOST_TURNS):
        value, at = root(distance, x + along * (best.x[k] + np.sign(error) * distance - x[k]))
        if abs(value - quantile) <= NEAR * quantile:
            return float(best.x[k] + np.sign(error) * distance)
        if value < quantile:
            inside, below, x = distance, value, at
        else:
            outside, above = distance, value
        if outside is None:
            if inside >= reach:
                return None
            distance = min(inside * max(1.2, min(quantile / max(below, 1e-9), 3.0)), reach)
        elif np.isinf(above):
            distance = 0.5 * (inside + outside)
        else:
            distance = inside + (outside - inside) * float(np.clip((quantile - below) / (above - below), 0.1, 0.9))
    return float(best.x[k] + np.sign(error) * (inside if outside is None else 0.5 * (inside + outside)))
