"""Steps of Gauss and Newton on products of spheres, balls and intervals: coordinates of parameters, tangents, trust region.

The part of the Gauss-Newton sampler (gauss_newton.py) that knows geometry. Like it, this file needs Optuna, NumPy and SciPy alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from magmpm.studies.search.samplers.blocks import Array, Block

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


class Coordinates:
    """All blocks together: parameters, their k coordinates, and steps in them.

    Parameters
    ----------
    blocks : sequence of Block
        Directions, balls and numbers, in the order of their coordinates.
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.size = sum(block.size for block in self.blocks)
        ends = np.cumsum([block.size for block in self.blocks]).tolist()
        self.places = [
            slice(end - block.size, end) for block, end in zip(self.blocks, ends, strict=True)
        ]

    def read(self, params: Mapping[str, Any]) -> Array:
        """Find the coordinates of parameters.

        Parameters
        ----------
        params : Mapping[str, Any]
            Values by name.

        Returns
        -------
        array (k,)
            The coordinates.
        """
        return np.concatenate([np.zeros(0), *(block.read(params) for block in self.blocks)])

    def write(self, x: Array) -> dict[str, float]:
        """Find the parameters of coordinates.

        Parameters
        ----------
        x : array (k,)
            The coordinates.

        Returns
        -------
        dict[str, float]
            Values by name.
        """
        found: dict[str, float] = {}
        for block, place in zip(self.blocks, self.places, strict=True):
            found.update(block.write(x[place]))
        return found

    def anywhere(self, u: Array) -> Array:
        """Find a point for numbers from 0 to 1; uniform in them is uniform on spheres, in balls and between bounds.

        Parameters
        ----------
        u : array (k,)
            The numbers.

        Returns
        -------
        array (k,)
            Coordinates.
        """
        return np.concatenate(
            [
                block.anywhere(u[place])
                for block, place in zip(self.blocks, self.places, strict=True)
            ]
        )

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        """Find the steps that are possible.

        Parameters
        ----------
        x : array (k,)
            Coordinates.

        Returns
        -------
        basis : array (k, q)
            Of the steps.
        low : array (q,)
            Their lower bounds.
        high : array (q,)
            Their upper bounds.
        """
        parts = [
            block.tangent(x[place]) for block, place in zip(self.blocks, self.places, strict=True)
        ]
        basis = np.zeros((self.size, sum(part[0].shape[1] for part in parts)))
        column = 0
        for place, (part, _, _) in zip(self.places, parts, strict=True):
            basis[place, column : column + part.shape[1]] = part
            column += part.shape[1]
        return (
            basis,
            np.concatenate([part[1] for part in parts]),
            np.concatenate([part[2] for part in parts]),
        )

    def _split(self, p: Array) -> list[Array]:
        ends = np.cumsum([block.freedom for block in self.blocks])
        return np.split(p, ends[:-1])

    def moved(self, x: Array, p: Array) -> Array:
        """Find the point to which a step leads.

        Parameters
        ----------
        x : array (k,)
            Coordinates.
        p : array (q,)
            The step.

        Returns
        -------
        array (k,)
            Coordinates there.
        """
        parts = zip(self.blocks, self.places, self._split(p), strict=True)
        return np.concatenate([block.moved(x[place], part) for block, place, part in parts])

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
        parts = zip(self.blocks, self.places, self._split(p), strict=True)
        p = np.concatenate([block.within(x[place], part) for block, place, part in parts])
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
        size = float(p @ p)
        left = r + J @ p
        return float(left @ left) + (curvature * size) ** 2 if size <= radius * radius else math.inf

    more = largest + float(np.linalg.norm(J.T @ r)) / (radius * largest)
    while np.linalg.norm(damped(more)) > radius:
        more *= 4.0
    roots = np.geomspace(less, more, DAMPINGS)
    best = int(np.argmin([expected(damped(root)) for root in roots]))
    around = np.geomspace(roots[max(best - 1, 0)], roots[min(best + 1, DAMPINGS - 1)], DAMPINGS)
    return min((damped(root) for root in around), key=expected)
