"""Blocks of parameters that belong together: a direction, a vector in a ball, a number between bounds.

Each has coordinates in which steps are taken: a direction's are its unit vector, a vector's its components, a number's its place between
its bounds. This file needs NumPy alone, and Optuna where parameters are described for it; `make optunahub` takes it into a package.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

    Distributions = dict[str, BaseDistribution]

Array = NDArray[np.float64]


def unit(vectors: Array) -> Array:
    """Scale vectors to length 1.

    Parameters
    ----------
    vectors : array (..., 3)
        Of any lengths; zeros stay zeros.

    Returns
    -------
    array (..., 3), no unit
        The unit vectors.
    """
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def across(units: Array) -> Array:
    """Find two unit vectors across each of the given ones.

    Parameters
    ----------
    units : array (..., 3), no unit
        Unit vectors.

    Returns
    -------
    array (..., 3, 2), no unit
        The two as columns.
    """
    first = unit(np.cross(units, np.eye(3)[np.argmin(np.abs(units), axis=-1)]))
    return np.stack([first, np.cross(units, first)], axis=-1)


class Block(ABC):
    """Parameters that belong together.

    It has `size` coordinates, k, of which as many as its `freedom`, q, can change independently.
    """

    size: int
    freedom: int

    @abstractmethod
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Find the bounds of the parameters that are numbers.

        Returns
        -------
        dict[str, tuple of float]
            Least and greatest value by name.
        """

    def distributions(self) -> Distributions:
        """Describe the parameters for Optuna.

        Returns
        -------
        dict[str, BaseDistribution]
            Their distributions by name.
        """
        from optuna.distributions import FloatDistribution

        return {name: FloatDistribution(*pair) for name, pair in self.bounds().items()}

    @abstractmethod
    def read(self, params: Mapping[str, Any]) -> Array:
        """Find the coordinates of parameters.

        Parameters
        ----------
        params : Mapping[str, Any]
            Values by name, others among them.

        Returns
        -------
        array (k,)
            Coordinates.
        """

    @abstractmethod
    def write(self, x: Array) -> dict[str, float]:
        """Find the parameters of coordinates.

        Parameters
        ----------
        x : array (k,)
            Coordinates.

        Returns
        -------
        dict[str, float]
            Values by name.
        """

    @abstractmethod
    def nearest(self, x: Array) -> Array:
        """Find the nearest coordinates that a design can have.

        Parameters
        ----------
        x : array (k,)
            Any numbers.

        Returns
        -------
        array (k,)
            Coordinates.
        """

    @abstractmethod
    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw coordinates: directions, strengths and numbers are each uniform.

        Parameters
        ----------
        rng : numpy.random.Generator
            Draws them.

        Returns
        -------
        array (k,)
            Coordinates.
        """

    def anywhere(self, u: Array) -> Array:
        """Find the coordinates of uniform density for numbers from 0 to 1.

        Parameters
        ----------
        u : array (k,)
            The numbers.

        Returns
        -------
        array (k,)
            Coordinates.
        """
        return u

    @abstractmethod
    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        """Find the steps that are possible.

        Parameters
        ----------
        x : array (k,)
            Coordinates.

        Returns
        -------
        basis : array (k, q)
            Changes of the coordinates by each component of a step: 1 is a radian, a ball's radius,
            or an interval's length.
        low : array (q,)
            Lower bounds of a step.
        high : array (q,)
            Its upper bounds.
        """

    def within(self, x: Array, p: Array) -> Array:
        """Shorten a step that is within the bounds of `tangent` to what the block allows.

        Parameters
        ----------
        x : array (k,)
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
        return np.asarray(x + self.tangent(x)[0] @ p)


@dataclass(frozen=True)
class Direction(Block):
    """A unit vector by two angles in degrees: (sin along, cos along cos around, cos along sin around).

    Attributes
    ----------
    around : str
        Name of the angle about the axis.
    along : str
        Name of the angle toward the axis.
    """

    around: str
    along: str
    size = 3
    freedom = 2

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {self.around: (-180.0, 180.0), self.along: (-90.0, 90.0)}

    def read(self, params: Mapping[str, Any]) -> Array:
        a = math.radians(params[self.around])
        b = math.radians(params[self.along])
        return np.array([math.sin(b), math.cos(b) * math.cos(a), math.cos(b) * math.sin(a)])

    def write(self, x: Array) -> dict[str, float]:
        along = math.atan2(x[0], math.hypot(x[1], x[2]))
        return {self.around: math.degrees(math.atan2(x[2], x[1])), self.along: math.degrees(along)}

    def nearest(self, x: Array) -> Array:
        length = float(np.linalg.norm(x))
        return np.array(x) / length if length > 0 else np.array([1.0, 0.0, 0.0])

    def drawn(self, rng: np.random.Generator) -> Array:
        return self.nearest(rng.normal(size=3))

    def anywhere(self, u: Array) -> Array:
        x = 2 * u[0] - 1
        turn = 2 * math.pi * u[1]
        across = math.sqrt(1 - x * x)
        return np.array([x, across * math.cos(turn), across * math.sin(turn)])

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        return across(x), np.full(2, -math.pi), np.full(2, math.pi)

    def moved(self, x: Array, p: Array) -> Array:
        # along a great circle
        angle = float(np.linalg.norm(p))
        if angle == 0.0:
            return x
        there = math.cos(angle) * x + math.sin(angle) / angle * (across(x) @ p)
        return np.asarray(there / np.linalg.norm(there))


@dataclass(frozen=True)
class Ball(Block):
    """Vector of a strength: strength (cos elevation cos azimuth, cos elevation sin azimuth, sin elevation), angles in degrees.

    Attributes
    ----------
    strength : str
        Name of the strength.
    azimuth : str
        Name of the azimuth.
    elevation : str
        Name of the elevation.
    most : float
        Greatest strength.
    unit : float
        Length of the vector, in coordinates, for each unit of strength.
    """

    strength: str
    azimuth: str
    elevation: str
    most: float
    unit: float = 1.0
    size = 3
    freedom = 3

    @property
    def radius(self) -> float:
        """Greatest length, in coordinates."""
        return self.most * self.unit

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {
            self.strength: (0.0, self.most),
            self.azimuth: (-180.0, 180.0),
            self.elevation: (-90.0, 90.0),
        }

    def direction(self, params: Mapping[str, Any]) -> Array:
        """Find the direction of the vector.

        Parameters
        ----------
        params : Mapping[str, Any]
            Values by name.

        Returns
        -------
        array (3,), no unit
            The unit vector, also where the strength is 0.
        """
        a = math.radians(params[self.azimuth])
        b = math.radians(params[self.elevation])
        return np.array([math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b)])

    def read(self, params: Mapping[str, Any]) -> Array:
        return np.asarray(params[self.strength] * self.unit * self.direction(params))

    def write(self, x: Array) -> dict[str, float]:
        strength = min(float(np.linalg.norm(x)) / self.unit, self.most)
        elevation = math.atan2(x[2], math.hypot(x[0], x[1]))
        return {
            self.strength: strength,
            self.azimuth: math.degrees(math.atan2(x[1], x[0])),
            self.elevation: math.degrees(elevation),
        }

    def nearest(self, x: Array) -> Array:
        return np.array(x) * min(1.0, self.radius / max(float(np.linalg.norm(x)), 1e-300))

    def drawn(self, rng: np.random.Generator) -> Array:
        vector = rng.normal(size=3)
        return np.asarray(self.radius * rng.random() / np.linalg.norm(vector) * vector)

    def anywhere(self, u: Array) -> Array:
        return self.radius * u[2] ** (1 / 3) * Direction("", "").anywhere(u)

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        size = float(np.linalg.norm(x))
        outward = np.asarray(x / size) if size > 0.0 else np.array([1.0, 0.0, 0.0])
        basis = self.radius * np.column_stack([outward, across(outward)])
        inside = size / self.radius
        return (
            basis,
            np.array([-1.0 - inside, -2.0, -2.0]),
            np.array([max(1.0 - inside, 0.0), 2.0, 2.0]),
        )

    def within(self, x: Array, p: Array) -> Array:
        basis = self.tangent(x)[0] / self.radius
        there = x / self.radius + basis @ p
        size = float(np.linalg.norm(there))
        return p if size <= 1.0 else np.asarray(basis.T @ (there / size - x / self.radius))


@dataclass(frozen=True)
class Number(Block):
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
    whole : bool
        Whether it is an integer, the nearest to what its coordinate says.
    """

    name: str
    low: float
    high: float
    log: bool = False
    whole: bool = False
    size = 1
    freedom = 1

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {self.name: (self.low, self.high)}

    def distributions(self) -> Distributions:
        from optuna.distributions import FloatDistribution, IntDistribution

        if self.whole:
            return {self.name: IntDistribution(int(self.low), int(self.high), log=self.log)}
        return {self.name: FloatDistribution(self.low, self.high, log=self.log)}

    def read(self, params: Mapping[str, Any]) -> Array:
        value = params[self.name]
        if self.log:
            return np.array([math.log(value / self.low) / math.log(self.high / self.low)])
        return np.array([(value - self.low) / (self.high - self.low)])

    def write(self, x: Array) -> dict[str, float]:
        place = float(x[0])
        value = self.low + place * (self.high - self.low)
        if self.log:
            value = self.low * (self.high / self.low) ** place
        value = min(max(value, self.low), self.high)
        return {self.name: round(value) if self.whole else value}

    def nearest(self, x: Array) -> Array:
        return np.clip(x, 0.0, 1.0)

    def drawn(self, rng: np.random.Generator) -> Array:
        return rng.random(1)

    def tangent(self, x: Array) -> tuple[Array, Array, Array]:
        return np.eye(1), np.minimum(-x, 0.0), np.maximum(1.0 - x, 0.0)
