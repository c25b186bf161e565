"""Steps of Gauss and Newton on products of spheres, balls and intervals: coordinates of parameters, tangents, trust region.

The part of the Gauss-Newton sampler (gauss_newton.py) that knows geometry. Like it, this file needs Optuna, NumPy and SciPy alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

Array = NDArray[np.float64]

DAMPINGS = 24  # tried along the path of steps


@dataclass(frozen=True)
class Direction:
    """A unit vector by two angles in degrees: (sin along, cos along cos around, cos along sin around).

    Attributes
    ----------
    around : str
        Name of the first angle.
    along : str
        Name of the second.
    """

    around: str
    along: str
    size = 3

    def distributions(self) -> dict[str, BaseDistribution]:
        """Describe the parameters for Optuna.

        Returns
        -------
        dict[str, BaseDistribution]
            Distributions by name.
        """
        from optuna.distributions import FloatDistribution

        return {
            self.around: FloatDistribution(-180.0, 180.0),
            self.along: FloatDistribution(-90.0, 90.0),
        }

    def read(self, params: Mapping[str, float]) -> Array:
        """Find the coordinates of parameters.

        Parameters
        ----------
        params : Mapping[str, float]
            Values by name.

        Returns
        -------
        array (3,)
            The unit vector.
        """
        a = math.radians(params[self.around])
        b = math.radians(params[self.along])
        return np.array([math.sin(b), math.cos(b) * math.cos(a), math.cos(b) * math.sin(a)])

    def write(self, x: Array) -> dict[str, float]:
        """Find the parameters of coordinates.

        Parameters
        ----------
        x : array (3,)
            A unit vector.

        Returns
        -------
        dict[str, float]
            Values by name.
        """
        along = math.atan2(x[0], math.hypot(x[1], x[2]))
        return {self.around: math.degrees(math.atan2(x[2], x[1])), self.along: math.degrees(along)}

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        """Find the steps that are possible.

        Parameters
        ----------
        x : array (size,)
            Coordinates.

        Returns
        -------
        basis : array (size, q)
            Of the steps.
        low : array (q,)
            Their lower bounds.
        high : array (q,)
            Their upper bounds.
        """
        return _across(x), np.full(2, -math.pi), np.full(2, math.pi)

    def within(self, x: Array, p: Array) -> Array:
        """Shorten a step to what the block allows.

        Parameters
        ----------
        x : array (size,)
            Coordinates.
        p : array (q,)
            The step.

        Returns
        -------
        array (q,)
            The allowed step.
        """
        return p

    def moved(self, x: Array, p: Array) -> Array:
        """Find the point to which a step leads, along a great circle.

        Parameters
        ----------
        x : array (size,)
            Coordinates.
        p : array (q,)
            The step.

        Returns
        -------
        array (size,)
            Coordinates there.
        """
        angle = float(np.linalg.norm(p))
        if angle == 0.0:
            return x
        there = math.cos(angle) * x + math.sin(angle) / angle * (_across(x) @ p)
        return np.asarray(there / np.linalg.norm(there))

    def anywhere(self, u: Array) -> Array:
        """Find the point of uniform density for numbers from 0 to 1.

        Parameters
        ----------
        u : array (size,)
            The numbers.

        Returns
        -------
        array (size,)
            Coordinates.
        """
        x = 2 * u[0] - 1
        turn = 2 * math.pi * u[1]
        return np.array(
            [x, math.sqrt(1 - x * x) * math.cos(turn), math.sqrt(1 - x * x) * math.sin(turn)]
        )


@dataclass(frozen=True)
class Ball:
    """Vector of a strength: strength (cos elevation cos azimuth, cos elevation sin azimuth, sin elevation), angles in degrees.

    Attributes
    ----------
    strength : str
        Name of its length.
    azimuth : str
        Name of the first angle.
    elevation : str
        Name of the second.
    most : float
        Greatest strength.
    unit : float
        Coordinates are in a unit of their own: this many for each of the strength's.
    """

    strength: str
    azimuth: str
    elevation: str
    most: float
    unit: float = 1.0
    size = 3

    @property
    def radius(self) -> float:
        """Greatest length, in coordinates."""
        return self.most * self.unit

    def distributions(self) -> dict[str, BaseDistribution]:
        """Describe the parameters for Optuna.

        Returns
        -------
        dict[str, BaseDistribution]
            Distributions by name.
        """
        from optuna.distributions import FloatDistribution

        angles = {
            self.azimuth: FloatDistribution(-180.0, 180.0),
            self.elevation: FloatDistribution(-90.0, 90.0),
        }
        return {self.strength: FloatDistribution(0.0, self.most), **angles}

    def read(self, params: Mapping[str, float]) -> Array:
        """Find the coordinates of parameters.

        Parameters
        ----------
        params : Mapping[str, float]
            Values by name.

        Returns
        -------
        array (3,)
            The vector.
        """
        a = math.radians(params[self.azimuth])
        b = math.radians(params[self.elevation])
        return (
            params[self.strength]
            * self.unit
            * np.array([math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b)])
        )

    def write(self, x: Array) -> dict[str, float]:
        """Find the parameters of coordinates.

        Parameters
        ----------
        x : array (3,)
            A vector.

        Returns
        -------
        dict[str, float]
            Values by name.
        """
        strength = min(float(np.linalg.norm(x)) / self.unit, self.most)
        elevation = math.atan2(x[2], math.hypot(x[0], x[1]))
        return {
            self.strength: strength,
            self.azimuth: math.degrees(math.atan2(x[1], x[0])),
            self.elevation: math.degrees(elevation),
        }

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        """Find the steps that are possible, in shares of the radius.

        Parameters
        ----------
        x : array (3,)
            Coordinates.

        Returns
        -------
        basis : array (3, 3)
            Outward, and two directions across.
        low : array (3,)
            Lower bounds of the steps.
        high : array (3,)
            Their upper bounds.
        """
        size = float(np.linalg.norm(x))
        outward = np.asarray(x / size) if size > 0.0 else np.array([1.0, 0.0, 0.0])
        basis = self.radius * np.column_stack([outward, _across(outward)])
        inside = size / self.radius
        return (
            basis,
            np.array([-1.0 - inside, -2.0, -2.0]),
            np.array([max(1.0 - inside, 0.0), 2.0, 2.0]),
        )

    def within(self, x: Array, p: Array) -> Array:
        """Shorten a step to what the ball allows.

        Parameters
        ----------
        x : array (3,)
            Coordinates.
        p : array (3,)
            The step.

        Returns
        -------
        array (3,)
            The allowed step.
        """
        basis = self.tangent(x)[0] / self.radius
        there = x / self.radius + basis @ p
        size = float(np.linalg.norm(there))
        return p if size <= 1.0 else np.asarray(basis.T @ (there / size - x / self.radius))

    def moved(self, x: Array, p: Array) -> Array:
        """Find the point to which a step leads.

        Parameters
        ----------
        x : array (3,)
            Coordinates.
        p : array (3,)
            The step.

        Returns
        -------
        array (3,)
            Coordinates there.
        """
        return np.asarray(x + self.tangent(x)[0] @ p)

    def anywhere(self, u: Array) -> Array:
        """Find the point of uniform density for numbers from 0 to 1.

        Parameters
        ----------
        u : array (3,)
            The numbers.

        Returns
        -------
        array (3,)
            Coordinates.
        """
        return self.radius * u[2] ** (1 / 3) * Direction("", "").anywhere(u)


@dataclass(frozen=True)
class Number:
    """A number from low to high; its coordinate is its place between them, 0 to 1.

    Attributes
    ----------
    name : str
        Of the parameter.
    low : float
        Least value.
    high : float
        Greatest value.
    log : bool
        Whether the coordinate is the place of the number's logarithm.
    """

    name: str
    low: float
    high: float
    log: bool = False
    size = 1

    def distributions(self) -> dict[str, BaseDistribution]:
        """Describe the parameter for Optuna.

        Returns
        -------
        dict[str, BaseDistribution]
            Its distribution by name.
        """
        from optuna.distributions import FloatDistribution

        return {self.name: FloatDistribution(self.low, self.high, log=self.log)}

    def read(self, params: Mapping[str, float]) -> Array:
        """Find the coordinate of the parameter.

        Parameters
        ----------
        params : Mapping[str, float]
            Values by name.

        Returns
        -------
        array (1,)
            The place between the bounds.
        """
        value = params[self.name]
        if self.log:
            return np.array([math.log(value / self.low) / math.log(self.high / self.low)])
        return np.array([(value - self.low) / (self.high - self.low)])

    def write(self, x: Array) -> dict[str, float]:
        """Find the parameter of the coordinate.

        Parameters
        ----------
        x : array (1,)
            The place between the bounds.

        Returns
        -------
        dict[str, float]
            The value by name.
        """
        place = float(x[0])
        value = self.low + place * (self.high - self.low)
        if self.log:
            value = self.low * (self.high / self.low) ** place
        return {self.name: min(max(value, self.low), self.high)}

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        """Find the steps that are possible.

        Parameters
        ----------
        x : array (1,)
            The coordinate.

        Returns
        -------
        basis : array (1, 1)
            One.
        low : array (1,)
            Lower bound of the step.
        high : array (1,)
            Its upper bound.
        """
        return np.eye(1), np.minimum(-x, 0.0), np.maximum(1.0 - x, 0.0)

    def within(self, x: Array, p: Array) -> Array:
        """Return a step as it is: its bounds are those of `tangent`.

        Parameters
        ----------
        x : array (1,)
            The coordinate.
        p : array (1,)
            The step.

        Returns
        -------
        array (1,)
            The step.
        """
        return p

    def moved(self, x: Array, p: Array) -> Array:
        """Find the coordinate to which a step leads.

        Parameters
        ----------
        x : array (1,)
            The coordinate.
        p : array (1,)
            The step.

        Returns
        -------
        array (1,)
            The coordinate there.
        """
        return np.asarray(x + p)

    def anywhere(self, u: Array) -> Array:
        """Return a number from 0 to 1, which is a coordinate of uniform density.

        Parameters
        ----------
        u : array (1,)
            The number.

        Returns
        -------
        array (1,)
            The coordinate.
        """
        return u


Block = Direction | Ball | Number


def _across(unit: Array) -> Array:
    """Two unit vectors across a unit vector, (3, 2)."""
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(unit)))] = 1.0
    first = np.cross(unit, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(unit, first)])


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
        ends = np.cumsum([block.size for block in self.blocks])
        self.places = [
            slice(int(end) - block.size, int(end))
            for block, end in zip(self.blocks, ends, strict=True)
        ]
        self.size = int(ends[-1])

    def read(self, params: Mapping[str, float]) -> Array:
        """Find the coordinates of parameters.

        Parameters
        ----------
        params : Mapping[str, float]
            Values by name.

        Returns
        -------
        array (k,)
            The coordinates.
        """
        return np.concatenate([block.read(params) for block in self.blocks])

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
        ends = np.cumsum(
            [2 if isinstance(block, Direction) else block.size for block in self.blocks]
        )
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
            `_trusted`).

        Returns
        -------
        Step
            The step.
        """
        basis, low, high = self.tangent(x)
        J = jacobian @ basis
        p = _trusted(J, residuals, (low, high), radius, curvature)
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


def _trusted(
    J: Array, r: Array, bounds: tuple[Array, Array], radius: float, curvature: float
) -> Array:
    """The best of the steps (J^T J + damping) p = -J^T r on the free variables, within bounds and |p| <= radius, over all dampings.

    The best has the least |r + J p|^2 + (curvature |p|^2)^2: what the linear model leaves, and what it does not know. Without the second
    term the last hundredth of a decrease is often sought far away, in directions that hardly matter.
    """
    largest = float(np.linalg.norm(J, 2))
    if largest == 0.0:
        return np.zeros(J.shape[1])
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    along, (low, high) = U.T @ r, bounds

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

    less = 1e-6 * largest  # directions that hardly matter stay as they are
    more = largest + float(np.linalg.norm(J.T @ r)) / (radius * largest)
    while np.linalg.norm(damped(more)) > radius:
        more *= 4.0
    roots = np.geomspace(less, more, DAMPINGS)
    best = int(np.argmin([expected(damped(root)) for root in roots]))
    around = np.geomspace(roots[max(best - 1, 0)], roots[min(best + 1, DAMPINGS - 1)], DAMPINGS)
    return min((damped(root) for root in around), key=expected)
