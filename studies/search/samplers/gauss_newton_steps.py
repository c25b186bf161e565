"""Steps of Gauss and Newton on products of spheres, balls and intervals: coordinates of parameters, tangents, trust region.

The part of the Gauss-Newton sampler (gauss_newton.py) that knows geometry. Like it, this file needs Optuna, NumPy and SciPy alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.studies.search.samplers.blocks import Array, Block

if TYPE_CHECKING:
    from magmpm.studies.search.samplers.blocks import Distributions

DAMPINGS = 24  # tried along the path of steps


@dataclass(frozen=True)
class Step:
    """A step in the tangent space.

    Attributes
    ----------
    p : array (q,)
        The step.
    length : float
        Its length.
    promised : float
        The decrease of the sum of squares that the linear model promises.
    """

    p: Array
    length: float
    promised: float


def _slices(sizes: Sequence[int]) -> list[slice]:
    """Places of pieces of these sizes, one after the other."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]


def _joined(parts: Iterable[Array]) -> Array:
    """One array of the parts, of none an empty one."""
    return np.concatenate([np.zeros(0), *parts])


class Coordinates(Block):
    """All blocks together: parameters, their k coordinates, and steps in them.

    Parameters
    ----------
    blocks : sequence of Block
        Directions, balls and numbers, in the order of their coordinates.
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.size = sum(block.size for block in self.blocks)
        self.freedom = sum(block.freedom for block in self.blocks)
        self.places = _slices([block.size for block in self.blocks])
        self._columns = _slices([block.freedom for block in self.blocks])

    def _each(self, x: Array) -> Iterator[tuple[Block, Array]]:
        """The blocks, each with its coordinates."""
        return ((block, x[place]) for block, place in zip(self.blocks, self.places, strict=True))

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {name: pair for block in self.blocks for name, pair in block.bounds().items()}

    def distributions(self) -> Distributions:
        return {name: kind for block in self.blocks for name, kind in block.distributions().items()}

    def read(self, params: Mapping[str, Any]) -> Array:
        return _joined(block.read(params) for block in self.blocks)

    def write(self, x: Array) -> dict[str, float]:
        found: dict[str, float] = {}
        for block, at in self._each(x):
            found |= block.write(at)
        return found

    def nearest(self, x: Array) -> Array:
        return _joined(block.nearest(at) for block, at in self._each(x))

    def drawn(self, rng: np.random.Generator) -> Array:
        return _joined(block.drawn(rng) for block in self.blocks)

    def anywhere(self, u: Array) -> Array:
        return _joined(block.anywhere(at) for block, at in self._each(u))

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        parts = [block.tangent(at) for block, at in self._each(x)]
        basis = np.zeros((self.size, self.freedom))
        for place, columns, (part, _, _) in zip(self.places, self._columns, parts, strict=True):
            basis[place, columns] = part
        return basis, _joined(low for _, low, _ in parts), _joined(high for _, _, high in parts)

    def within(self, x: Array, p: Array) -> Array:
        each = zip(self._each(x), self._columns, strict=True)
        return _joined(block.within(at, p[columns]) for (block, at), columns in each)

    def moved(self, x: Array, p: Array) -> Array:
        each = zip(self._each(x), self._columns, strict=True)
        return _joined(block.moved(at, p[columns]) for (block, at), columns in each)

    def step(
        self, x: Array, residuals: Array, jacobian: Array, radius: float, curvature: float = 0.0
    ) -> Step:
        """Find the step that promises most within the bounds and the radius.

        Parameters
        ----------
        x : array (k,)
            Coordinates.
        residuals : array (m,)
            Residuals there.
        jacobian : array (m, k)
            Their derivatives.
        radius : float
            Greatest length of the step.
        curvature : float, default 0.0
            A guess of half the second derivative of the residuals along a step (see
            `trusted_step`).

        Returns
        -------
        Step
            The step.
        """
        basis, low, high = self.tangent(x)
        J = jacobian @ basis
        p = trusted_step(J, residuals, (low, high), radius, curvature)
        p = self.within(x, p)
        left = residuals + J @ p
        return Step(p, float(np.linalg.norm(p)), float(residuals @ residuals - left @ left))

    def curvature(self, x: Array, jacobian: Array) -> float:
        """Guess half the second derivative of the residuals along a step: for angles it is of the order of the first.

        Parameters
        ----------
        x : array (k,)
            Coordinates.
        jacobian : array (m, k)
            Derivatives of the residuals.

        Returns
        -------
        float
            The guess.
        """
        return float(np.mean(np.linalg.norm(jacobian @ self.tangent(x)[0], axis=0))) / 2


def trusted_step(
    J: Array, r: Array, bounds: tuple[Array, Array], radius: float, curvature: float = 0.0
) -> Array:
    """Find the best of the steps (J^T J + damping) p = -J^T r on the free variables, within bounds and |p| <= radius, over all dampings.

    The best has the least |r + J p|^2 + (curvature |p|^2)^2: what the linear model leaves, and what it does not know. Without the second
    term the last hundredth of a decrease is often sought far away, in directions that hardly matter.

    Parameters
    ----------
    J : array (m, q)
        Derivatives of the residuals.
    r : array (m,)
        Residuals.
    bounds : tuple of array (q,)
        Lower and upper ones of the step.
    radius : float
        Greatest length of the step.
    curvature : float, default 0.0
        Half the second derivative of the residuals along a step.

    Returns
    -------
    array (q,)
        The step.
    """
    largest = float(np.linalg.norm(J, 2))
    if largest == 0.0:
        return np.zeros(J.shape[1])
    less = 1e-6 * largest  # directions that hardly matter stay as they are
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    s = np.where(s > less, s, 0.0)
    along = U.T @ r
    low, high = bounds

    def damped(root: float) -> Array:
        p = np.asarray(-(Vt.T * (s / (s * s + root * root))) @ along)
        if (p >= low).all() and (p <= high).all():
            return p
        matrix = np.vstack([J, root * np.eye(J.shape[1])])
        from scipy.optimize import lsq_linear  # 0.3 s to import, and only this sampler steps

        return np.asarray(
            lsq_linear(matrix, np.concatenate([-r, np.zeros(J.shape[1])]), bounds, method="bvls").x
        )

    def expected(p: Array) -> float:
        left = r + J @ p
        return float(left @ left) + (curvature * float(p @ p)) ** 2

    def within(p: Array) -> bool:
        return bool(p @ p <= radius * radius)

    def allowed(roots: Array) -> list[Array]:
        """Steps of the last roots, which are the largest, as many as are within the radius: they grow as roots fall."""
        steps = (damped(root) for root in roots[::-1])
        return [*itertools.takewhile(within, steps)][::-1]

    more = largest + float(np.linalg.norm(J.T @ r)) / (radius * largest)
    while not within(damped(more)):
        more *= 4.0
    roots = np.geomspace(less, more, DAMPINGS)
    costs = [expected(p) for p in allowed(roots)]
    best = DAMPINGS - len(costs) + int(np.argmin(costs))
    around = np.geomspace(roots[max(best - 1, 0)], roots[min(best + 1, DAMPINGS - 1)], DAMPINGS)
    return min(allowed(around), key=expected)
