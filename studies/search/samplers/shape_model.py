"""A Gaussian process of a shape: what each design's residuals are, from few designs.

Residuals (m) are reduced to their principal components over the designs that are known, and each component is a Gaussian process of its own
amplitude. All share one kernel of the embedded coordinates x, brought to z = A x:

    k(x, x') = (1 + z.z') / (1 + n) + w (1 + r + r^2 / 3) exp(-r),    r = sqrt(5) |z - z'| / l,    n the directions and other coordinates.

The first part is linear: a shape is nearly linear in small moments. The second is Matern's kernel with smoothness 5/2. A says how much
which coordinate matters. Of the directions it is a Kronecker product: axes of a direction count differently (a magnet along the field feels
no torque), segments that are neighbors act alike (their correlation falls as exp(-distance / c)), and segments matter by a power of their
place along the body. Of a field or a number it is a factor. From 15 random designs of five segments, the root mean square error of the
points of 100 others was 5.3 mm with A = 1 and 3.4 mm with this A (docs/design.md, "Choosing trials").

The parameters are those of greatest posterior density: their likelihood, with the amplitudes at their best, and normal priors. Sources:
Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2, 4.2 and 5.4.1; the composite of a model and a known
function: Astudillo and Frazier, ICML 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from magmpm.compiled.arrays import Array

AXES, CORRELATION, PLACE, OTHERS, WEIGHT, RANGE = slice(0, 5), 5, 6, 7, 8, 9  # places of the parameters
PRIOR = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0, 1.0])  # their means: logarithms, but for shears and the power
SPREAD = np.array([1.0, 1.0, 0.5, 0.5, 0.5, 1.0, 0.7, 1.0, 1.5, 1.0])  # and standard deviations
FARTHEST = 4.0  # of a parameter from zero
NOISE = 1e-7  # of the variance of 1: solves are exact but for rounding and their tolerance
KEPT = 1e-6  # of the variance: components below it are left out
OWN = 0.5  # weight of the sample's variance in an amplitude, in designs
STEPS = 30  # of the search for parameters


@dataclass(frozen=True)
class Layout:
    """Which embedded coordinates are directions (k, 3 each, base to tip) and which are not; scale: of the others, to be of size 1."""

    directions: tuple[int, ...]  # first coordinate of each
    others: tuple[int, ...]
    scale: tuple[float, ...]

    @property
    def count(self) -> int:
        """Directions and other coordinates."""
        return max(1, len(self.directions) + len(self.others))

    def matrix(self, p: Array, size: int) -> Array:
        """A transposed (size, size): z = x @ A.T."""
        found = np.zeros((size, size))
        k = len(self.directions)
        if k:
            axes = np.array([[np.exp(p[0]), 0, 0], [p[2], np.exp(p[1]), 0], [p[3], p[4], np.exp(-p[0] - p[1])]])
            place = (np.arange(k) + 0.5) / k
            apart = np.abs(np.subtract.outer(place, place))
            along = np.linalg.cholesky(np.exp(-apart * np.exp(-p[CORRELATION]))) * (place ** p[PLACE])[:, None]
            both = np.kron(along, axes)
            both *= np.sqrt(3 * k / np.sum(both**2))
            rows = np.concatenate([np.arange(first, first + 3) for first in self.directions])
            found[np.ix_(rows, rows)] = both
        found[list(self.others), list(self.others)] = np.exp(p[OTHERS]) / np.array(self.scale)
        return found


class ShapeModel:
    """The model of n >= 2 designs x (n, size) with residuals (n, m)."""

    def __init__(self, layout: Layout, x: Array, residuals: Array) -> None:
        self._layout, self._x = layout, x
        self._mean = residuals.mean(axis=0)
        _, sizes, basis = np.linalg.svd(residuals - self._mean, full_matrices=False)
        share = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
        kept = max(1, min(int(np.sum(share < 1 - KEPT)) + 1, len(x) - 1))
        self._basis = basis[:kept]
        self._scores = (residuals - self._mean) @ self._basis.T
        self._variance = self._scores.var(axis=0) + 1e-300
        found = minimize(self._cost, PRIOR, method="L-BFGS-B", bounds=[(-FARTHEST, FARTHEST)] * len(PRIOR), options={"maxiter": STEPS})
        self._p = np.asarray(found.x, dtype=float)
        self._a = layout.matrix(self._p, x.shape[1])
        self._z = x @ self._a
        self._factor, white = self._whitened(self._z, self._p)
        self._amplitude = self._amplitudes(white)
        self._weights: Array = np.asarray(cho_solve((self._factor, True), self._scores))
        self._left = -self._basis @ self._mean  # scores at which the residuals within the basis vanish
        self._beyond = float(self._mean @ self._mean - self._left @ self._left)

    def _whitened(self, z: Array, p: Array) -> tuple[Array, Array]:
        factor = np.asarray(np.linalg.cholesky(self._kernel(z, z, p) + NOISE * np.eye(len(z))))
        return factor, np.asarray(solve_triangular(factor, self._scores, lower=True))

    def _amplitudes(self, white: Array) -> Array:
        """Variance of each component: the best, drawn a little toward that of its scores."""
        return np.asarray((np.sum(white**2, axis=0) + OWN * self._variance) / (len(white) + OWN))

    def _cost(self, p: Array) -> float:
        """Negative logarithm of the posterior density of the parameters, to a constant."""
        factor, white = self._whitened(self._x @ self._layout.matrix(p, self._x.shape[1]), p)
        n, count = self._scores.shape
        likelihood = count * np.sum(np.log(np.diag(factor))) + 0.5 * (n + OWN) * np.sum(np.log(self._amplitudes(white)))
        return float(likelihood + 0.5 * np.sum(((p - PRIOR) / SPREAD) ** 2))

    def _kernel(self, a: Array, b: Array, p: Array) -> Array:
        product = a @ b.T
        apart = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * product
        r = np.sqrt(5 * np.maximum(apart, 0.0)) / np.exp(p[RANGE])
        return np.asarray((1 + product) / (1 + self._layout.count) + np.exp(p[WEIGHT]) * (1 + r + r * r / 3) * np.exp(-r))

    def predicted(self, x: Array) -> tuple[Array, Array]:
        """Mean (m,) of the residuals of a design (size,), and the variance of their whole."""
        scores, variance, _, _ = self._at(x)
        return scores @ self._basis + self._mean, np.array(variance * self._amplitude.sum())

    def _at(self, x: Array) -> tuple[Array, float, Array, Array]:
        z = x @ self._a
        k = self._kernel(z[None], self._z, self._p)[0]
        white = np.asarray(solve_triangular(self._factor, k, lower=True))
        own = (1 + z @ z) / (1 + self._layout.count) + np.exp(self._p[WEIGHT])
        return k @ self._weights, max(float(own - white @ white), 1e-12), z, white

    def expected(self, x: Array, caution: float = 1.0) -> tuple[float, Array]:
        """The expected sum of squares of the residuals of a design (size,), and its gradient (size,).

        Of independent normal components with means m_j and variances v_j, that of the sum of m_j^2 is the sum of m_j^2 + v_j.
        caution: how much the variances count; 0 gives the square of the means alone.
        """
        scores, variance, z, white = self._at(x)
        off, total = scores - self._left, caution * float(self._amplitude.sum())
        range_ = float(np.exp(self._p[RANGE]))
        apart = z - self._z
        r = np.sqrt(5 * np.sum(apart**2, axis=1)) / range_
        slopes = self._z / (1 + self._layout.count)
        slopes = slopes - (np.exp(self._p[WEIGHT]) * 5 / (3 * range_**2) * (1 + r) * np.exp(-r))[:, None] * apart
        back = np.asarray(solve_triangular(self._factor, white, lower=True, trans=1))
        of_variance = 2 * z / (1 + self._layout.count) - 2 * back @ slopes
        gradient = 2 * off @ (self._weights.T @ slopes) + total * of_variance
        return float(off @ off + total * variance + self._beyond), gradient @ self._a.T


def layout_of(sizes: Sequence[tuple[str, int, float]]) -> Layout:
    """The layout of blocks in order: (kind, size, scale), the kind of directions being "direction"."""
    directions: list[int] = []
    others: list[int] = []
    scale: list[float] = []
    first = 0
    for kind, size, unit in sizes:
        if kind == "direction":
            directions.append(first)
        else:
            others += range(first, first + size)
            scale += [unit] * size
        first += size
    return Layout(tuple(directions), tuple(others), tuple(scale))
