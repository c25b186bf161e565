"""Nonlinear least squares of a few numbers: Levenberg's and Marquardt's method, and the profile of one number.

Source: Nocedal and Wright, Numerical Optimization, section 10.3; profiles: Bates and Watts, Nonlinear Regression Analysis, section 6.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError

MOST_STEPS, LONGEST = 60, 1.0  # steps; length of the first, in x: a factor of e
SMALL = 1e-3  # standard errors: a step below it ends the search
TINY = 1e-8  # in x: likewise
MOST_TRIES = 12  # of shorter steps from one point

Model = Callable[[Array, bool], tuple[Array, Array]]  # x, whether with slopes -> residuals in standard errors (n,), slopes (n, k)


@dataclass(frozen=True)
class Minimum:
    """x (k,), residuals (n,) and their slopes (n, k) there; converged: whether the last step was small."""

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
    model: Model, start: Array, *, free: Array | None = None, scale: float | None = None, small: float = SMALL,
    known: Callable[[Array], bool] = lambda x: False,
) -> Minimum:  # fmt: skip
    """The minimum of the sum of squares that a descent from `start` (k,) reaches; free (k,): which numbers may change.

    scale: standard deviation of the residuals, None: as they turn out; small: in units of it, a step below ends the search; known(x):
    whether it has come to a minimum that is known, which ends it too. A point where the model can't be solved counts as worse. Raises what
    the model raises at the start.
    """
    x = np.array(start, dtype=float)
    free = np.ones(len(x), bool) if free is None else free
    residuals, slopes = model(x, True)
    radius, steps = LONGEST, 0
    while steps < MOST_STEPS:
        step = _step(residuals, slopes[:, free], radius)
        noise = scale if scale is not None else float(np.sqrt(residuals @ residuals / max(len(residuals) - free.sum(), 1)))
        if np.linalg.norm(slopes[:, free] @ step) <= small * noise or np.linalg.norm(step) <= TINY or known(x):
            return Minimum(x, residuals, slopes, steps, True)
        for _ in range(MOST_TRIES):
            steps += 1
            there = x.copy()
            there[free] += step
            promised = float(residuals @ residuals - np.sum((residuals + slopes[:, free] @ step) ** 2))
            try:
                found = model(there, True)
                gain = float(residuals @ residuals - found[0] @ found[0])
            except MagmpmError:
                gain = -np.inf
            if gain > 0:
                if gain > 0.75 * promised:
                    radius = max(radius, 2 * float(np.linalg.norm(step)))
                elif gain < 0.25 * promised:
                    radius = float(np.linalg.norm(step)) / 2
                x, (residuals, slopes) = there, found
                break
            radius = float(np.linalg.norm(step)) / 4
            step = _step(residuals, slopes[:, free], radius)
            if np.linalg.norm(step) <= TINY or np.linalg.norm(slopes[:, free] @ step) <= small * noise:
                return Minimum(x, residuals, slopes, steps, True)
        else:
            return Minimum(x, residuals, slopes, steps, False)
    return Minimum(x, residuals, slopes, steps, False)


def _step(residuals: Array, slopes: Array, radius: float) -> Array:
    """argmin |r + J p| with |p| <= radius, by the singular values of J: what it hardly moves stays."""
    if slopes.shape[1] == 0:
        return np.zeros(0)
    left, values, right = np.linalg.svd(slopes, full_matrices=False)
    along = left.T @ residuals
    keep = values > 1e-6 * values[0] if values[0] > 0 else np.zeros(len(values), bool)

    def step(damping: float) -> Array:
        factors = np.where(keep, values / np.where(keep, values**2 + damping, 1.0), 0.0)
        return np.asarray(-right.T @ (factors * along))

    if np.linalg.norm(step(0.0)) <= radius:
        return step(0.0)
    low, high = 0.0, float(np.linalg.norm(values * along) / radius) + 1e-300
    for _ in range(60):
        middle = 0.5 * (low + high) if low == 0.0 else float(np.sqrt(low * high))
        low, high = (middle, high) if np.linalg.norm(step(middle)) > radius else (low, middle)
        if high - low <= 0.05 * high:
            break
    return step(high)
