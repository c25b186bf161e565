"""Nonlinear least squares of a few numbers: Levenberg's and Marquardt's method, and the profile of one number.

Source: Nocedal and Wright, Numerical Optimization, section 10.3; profiles: Bates and Watts, Nonlinear Regression Analysis, section 6.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError
from magmpm.studies.search.samplers.gauss_newton_steps import trusted_step

Model = Callable[
    [Array, bool], tuple[Array, Array]
]  # x, whether with slopes -> residuals in standard errors (n,), slopes (n, k)


def quantile_of(level: float, degrees: float) -> float:
    """Find half an interval in standard errors: Student's t, or the normal one where the noise is known.

    Parameters
    ----------
    level : float, no unit
        Of the interval.
    degrees : float
        Of freedom; inf where the noise is known.

    Returns
    -------
    float, no unit
        The quantile.
    """
    from scipy.special import ndtri, stdtrit  # what scipy.stats calls, without its half second

    tail = 0.5 + level / 2
    return float(ndtri(tail) if np.isinf(degrees) else stdtrit(degrees, tail))


@dataclass(frozen=True)
class LeastSquares:
    """A minimum of a sum of squares.

    Attributes
    ----------
    x : array (k,)
        Where it is.
    residuals : array (n,)
        There.
    slopes : array (n, k)
        Their derivatives.
    steps : int
        How many led there.
    converged : bool
        Whether the last step was small.
    """

    x: Array
    residuals: Array
    slopes: Array
    steps: int
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residuals @ self.residuals)


def least_squares(
    model: Model,
    start: Array,
    *,
    free: Array | None = None,
    scale: float | None = None,
    small: float = 1e-3,
    known: Callable[[Array], bool] = lambda x: False,
    secant: bool = False,
) -> LeastSquares:
    """Find the minimum of a sum of squares that a descent reaches. A point where the model can't be solved counts as worse.

    What the model raises at the start is passed on.

    Parameters
    ----------
    model : Model
        From x, and whether slopes are needed, to residuals (n,) and slopes (n, k).
    start : array (k,)
        Where it begins.
    free : array (k,) of bool, optional
        Which numbers may change; all unless given.
    scale : float, optional
        Standard deviation of the residuals; as they turn out unless given.
    small : float, default 0.001
        In units of the scale, a step below ends the search.
    known : callable, default lambda x: False
        Tells whether it has come to a minimum that is known, which ends it too.
    secant : bool, default False
        Where slopes cost more than residuals: on the way they follow from the residuals
        (Broyden's method), and are computed at the start, where a step fails, and at the end.

    Returns
    -------
    LeastSquares
        The minimum.
    """
    x = np.array(start, dtype=float)
    free = np.ones(len(x), bool) if free is None else free
    residuals, slopes = model(x, True)
    # x changes by a factor of e at most at first
    radius = 1.0
    steps = 0
    failures = 0
    exact = True
    while steps < 60:
        step = _step(residuals, slopes[:, free], radius)
        size = float(np.linalg.norm(step))
        change = slopes[:, free] @ step
        squares = float(residuals @ residuals)
        spread = float(np.sqrt(squares / max(len(residuals) - free.sum(), 1)))
        noise = spread if scale is None else scale
        ended = np.linalg.norm(change) <= small * noise or size <= 1e-8 or known(x)
        if (ended or failures) and not exact:
            slopes = model(x, True)[1]
            exact = True
            continue
        if ended:
            return LeastSquares(x, residuals, slopes, steps, True)
        if failures == 12:
            break
        steps += 1
        there = x.copy()
        there[free] += step
        promised = squares - float(np.sum((residuals + change) ** 2))
        try:
            found = model(there, not secant)
            gain = squares - float(found[0] @ found[0])
        except MagmpmError:
            gain = -np.inf
        if gain > 0:
            if gain > 0.75 * promised:
                radius = max(radius, 2 * size)
            elif gain < 0.25 * promised:
                radius = size / 2
            if secant:
                moved = there - x
                unforeseen = found[0] - residuals - slopes @ moved
                slopes = slopes + np.outer(unforeseen, moved) / (moved @ moved)
            else:
                slopes = found[1]
            exact = not secant
            x = there
            residuals = found[0]
            failures = 0
        else:
            radius = size / 4
            failures += 1
    return LeastSquares(x, residuals, slopes if exact else model(x, True)[1], steps, False)


def _step(residuals: Array, slopes: Array, radius: float) -> Array:
    """Step that leaves the least of the residuals, no longer than the radius."""
    if slopes.shape[1] == 0:
        return np.zeros(0)
    anywhere = np.full(slopes.shape[1], np.inf)
    return trusted_step(slopes, residuals, (-anywhere, anywhere), radius)


@dataclass(frozen=True)
class Interval:
    """Interval of a number x.

    Attributes
    ----------
    low : float or None
        Lower end; None where the sum of squares does not rise enough.
    high : float or None
        Upper end; None where it does not.
    method : str
        How it was found: linear or profile.
    """

    low: float | None
    high: float | None
    method: str


def interval_of(
    model: Model,
    best: LeastSquares,
    covariance: Array,
    k: int,
    quantile: float,
    say: Callable[[], None],
) -> Interval:
    """Find the interval of a number.

    Parameters
    ----------
    model : Model
        Of the residuals in standard errors.
    best : LeastSquares
        The minimum.
    covariance : array (k, k)
        Of x at the minimum.
    k : int
        Which number.
    quantile : float
        Half an interval, in standard errors.
    say : callable
        Called where there is progress.

    Returns
    -------
    Interval
        The interval.
    """
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
        parabolic &= abs(rise - quantile**2) <= 0.1 * quantile**2
        ends.append(float(there[k]))
    if parabolic:
        return Interval(ends[0], ends[1], "linear")
    low, high = (_end(model, best, along, k, side * error, quantile) for side in (-1.0, 1.0))
    return Interval(low, high, "profile")


def _end(
    model: Model, best: LeastSquares, along: Array, k: int, error: float, quantile: float
) -> float | None:
    """Point where the root of the rise meets the quantile, by false position; None where it does not within reach. error: with its sign."""
    free = np.arange(len(best.x)) != k
    reach = max(6.0 * quantile * abs(error), 6.0)

    def root(distance: float, start: Array) -> tuple[float, Array]:
        there = start.copy()
        there[k] = best.x[k] + np.sign(error) * distance
        try:
            # such a small step changes a sum of squares of 4 by 0.001, far less than the accuracy of an end
            found = least_squares(model, there, free=free, scale=1.0, small=0.03)
        except MagmpmError:
            return np.inf, start
        return float(np.sqrt(max(found.cost - best.cost, 0.0))), found.x

    inside = 0.0
    below = 0.0
    x = best.x
    distance = quantile * abs(error)
    outside = None
    above = np.inf
    for _ in range(12):
        value, at = root(distance, x + along * (best.x[k] + np.sign(error) * distance - x[k]))
        if abs(value - quantile) <= 0.01 * quantile:
            return float(best.x[k] + np.sign(error) * distance)
        if value < quantile:
            inside = distance
            below = value
            x = at
        else:
            outside = distance
            above = value
        if outside is None:
            if inside >= reach:
                return None
            distance = min(inside * max(1.2, min(quantile / max(below, 1e-9), 3.0)), reach)
        elif np.isinf(above):
            distance = 0.5 * (inside + outside)
        else:
            distance = inside + (outside - inside) * float(
                np.clip((quantile - below) / (above - below), 0.1, 0.9)
            )
    return float(
        best.x[k] + np.sign(error) * (inside if outside is None else 0.5 * (inside + outside))
    )
