"""The parts of a design: directions, fields, numbers within bounds, and choices.

Optuna stores a design as *parameters* (angles in degrees, mT, mm). Samplers that know geometry work on *embedded* coordinates, in which
designs that are near each other have numbers near each other: a direction is its unit vector, a field its vector (T), a number its place
between its bounds (0 to 1). A choice has none: it has no neighbors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.inputs.vectors import from_angles
from magmpm.scene.addresses import Place, written

Parameters = Mapping[str, Any]
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
FIELD = ("field_mT", "field_azimuth_deg", "field_elevation_deg")


def direction(around: float, along: float) -> Array:
    """Make a unit vector of two angles, in the undeformed body with the axis +x.

    Parameters
    ----------
    around : float, degrees
        Angle about the axis.
    along : float, degrees
        Angle toward the axis.

    Returns
    -------
    array (3,), no unit
        The vector.
    """
    y, z, x = from_angles(math.radians(around), math.radians(along))
    return np.array([x, y, z])


def angles(vector: Array) -> tuple[float, float]:
    """Find the two angles of a direction: the inverse of `direction`.

    Parameters
    ----------
    vector : array (3,)
        Of any length.

    Returns
    -------
    tuple of float, degrees
        Around and along.
    """
    return azimuth_of(np.roll(vector / np.linalg.norm(vector), -1))


def azimuth_of(vector: Array) -> tuple[float, float]:
    """Find azimuth and elevation of a vector.

    Parameters
    ----------
    vector : array (3,)
        Of any length.

    Returns
    -------
    tuple of float, degrees
        Azimuth and elevation.
    """
    x, y, z = vector
    return float(np.rad2deg(np.arctan2(y, x))), float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))


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


def corner_of(seed: int, corner: int) -> Array:
    """Find the direction of all segments in one of a study's first trials: a corner of a regular tetrahedron in a random orientation.

    Parameters
    ----------
    seed : int
        Decides the orientation.
    corner : int
        From 0 to 3.

    Returns
    -------
    array (3,), no unit
        The unit vector.
    """
    turn, _ = np.linalg.qr(np.random.default_rng([seed]).normal(size=(3, 3)))
    return np.asarray(TETRAHEDRON[corner] @ turn)


@dataclass(frozen=True)
class SegmentDirection:
    """The direction of a segment's magnetization; its embedded coordinates are a unit vector (3,).

    Attributes
    ----------
    name : str
        Names the parameters.
    segment : int
        Number of the segment in the scene, from 0.
    """

    name: str
    segment: int
    size = 3

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Find the bounds of the parameters.

        Returns
        -------
        dict[str, tuple[float, float]]
            Least and greatest value by name, in degrees.
        """
        return {f"{self.name}_around_deg": (-180.0, 180.0), f"{self.name}_along_deg": (-90.0, 90.0)}

    def read(self, parameters: Parameters) -> Array:
        """Find the embedded coordinates of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (3,), no unit
            The unit vector.
        """
        return direction(
            parameters[f"{self.name}_around_deg"], parameters[f"{self.name}_along_deg"]
        )

    def written(self, x: Array) -> dict[str, float]:
        """Find the parameters of embedded coordinates.

        Parameters
        ----------
        x : array (3,), no unit
            A unit vector.

        Returns
        -------
        dict[str, float]
            Parameters by name.
        """
        around, along = angles(x)
        return {f"{self.name}_around_deg": around, f"{self.name}_along_deg": along}

    def nearest(self, x: Array) -> Array:
        """Find the unit vector nearest to a vector; +x for zeros.

        Parameters
        ----------
        x : array (3,)
            Any vector.

        Returns
        -------
        array (3,), no unit
            The unit vector.
        """
        length = float(np.linalg.norm(x))
        return np.array(x) / length if length > 0 else np.array([1.0, 0.0, 0.0])

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw a unit vector, uniform on the sphere.

        Parameters
        ----------
        rng : np.random.Generator
            The generator.

        Returns
        -------
        array (3,), no unit
            The unit vector.
        """
        return self.nearest(rng.normal(size=3))


@dataclass(frozen=True)
class FieldVector:
    """A uniform field; its embedded coordinates are the vector (3,) T, in a ball.

    Attributes
    ----------
    names : tuple of str
        Of its parameters: strength (mT), azimuth and elevation (degrees).
    max : float, T
        Greatest strength, the radius of the ball.
    number : int
        Which of the study's fields it is, from 0.
    """

    names: tuple[str, ...]
    max: float
    number: int = 0
    size = 3

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Find the bounds of the parameters.

        Returns
        -------
        dict[str, tuple[float, float]]
            Least and greatest value by name, in mT and degrees.
        """
        return dict(
            zip(self.names, ((0.0, 1e3 * self.max), (-180.0, 180.0), (-90.0, 90.0)), strict=True)
        )

    def read(self, parameters: Parameters) -> Array:
        """Find the embedded coordinates of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (3,), T
            The field.
        """
        return np.asarray(1e-3 * parameters[self.names[0]] * self.direction(parameters))

    def direction(self, parameters: Parameters) -> Array:
        """Find the direction of the field.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (3,), no unit
            The unit vector.
        """
        return np.array(from_angles(*(math.radians(parameters[name]) for name in self.names[1:])))

    def written(self, x: Array) -> dict[str, float]:
        """Find the parameters of embedded coordinates.

        Parameters
        ----------
        x : array (3,), T
            The field.

        Returns
        -------
        dict[str, float]
            Parameters by name.
        """
        strength = min(1e3 * float(np.linalg.norm(x)), 1e3 * self.max)
        return dict(zip(self.names, (strength, *azimuth_of(x)), strict=True))

    def nearest(self, x: Array) -> Array:
        """Find the vector of the ball that is nearest to a vector.

        Parameters
        ----------
        x : array (3,), T
            Any field.

        Returns
        -------
        array (3,), T
            The allowed one.
        """
        return np.array(x) * min(1.0, self.max / max(float(np.linalg.norm(x)), 1e-300))

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw a field: direction and strength are each uniform.

        Parameters
        ----------
        rng : np.random.Generator
            The generator.

        Returns
        -------
        array (3,), T
            The field.
        """
        vector = rng.normal(size=3)
        return np.asarray(self.max * rng.random() / np.linalg.norm(vector) * vector)


@dataclass(frozen=True)
class VariedNumber:
    """A quantity between two bounds; its embedded coordinate (1,) is its place between them, 0 to 1.

    Attributes
    ----------
    name : str
        Of its parameter, which is in the unit that the name ends with.
    what : str
        length, diameter, remanence or shear_modulus; or "number", of one that has an address.
    low : float, SI
        Least value.
    high : float, SI
        Greatest value.
    unit : float
        How many of the parameter's unit are an SI unit.
    place : Place
        Where the scene has it.
    segment : int or None
        The segment whose number it is, from 0, or None.
    shared : tuple of Place
        Further places that have the same value.
    """

    name: str
    what: str
    low: float
    high: float
    unit: float
    place: Place = ()
    segment: int | None = None
    shared: tuple[Place, ...] = ()
    size = 1

    @property
    def kinds(self) -> list[str]:
        """Names by which `magmpm.sensitivities` knows it."""
        if self.what != "number":
            return [self.what]
        return [written(place) for place in (self.place, *self.shared)]

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Find the bounds of the parameter.

        Returns
        -------
        dict[str, tuple[float, float]]
            Least and greatest value by name.
        """
        return {self.name: (self.unit * self.low, self.unit * self.high)}

    def read(self, parameters: Parameters) -> Array:
        """Find the embedded coordinate of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (1,), no unit
            The place between the bounds.
        """
        return np.array([(parameters[self.name] / self.unit - self.low) / (self.high - self.low)])

    def written(self, x: Array) -> dict[str, float]:
        """Find the parameter of an embedded coordinate.

        Parameters
        ----------
        x : array (1,), no unit
            The place between the bounds.

        Returns
        -------
        dict[str, float]
            The parameter by name.
        """
        low, high = self.bounds()[self.name]
        return {self.name: min(max(self.unit * self.value(x), low), high)}

    def value(self, x: Array) -> float:
        """Find the quantity of an embedded coordinate.

        Parameters
        ----------
        x : array (1,), no unit
            The place between the bounds.

        Returns
        -------
        float, SI
            The quantity.
        """
        return self.low + float(x[0]) * (self.high - self.low)

    def nearest(self, x: Array) -> Array:
        """Bring an embedded coordinate between the bounds.

        Parameters
        ----------
        x : array (1,), no unit
            Any number.

        Returns
        -------
        array (1,), no unit
            From 0 to 1.
        """
        return np.clip(x, 0.0, 1.0)

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw an embedded coordinate, uniform between the bounds.

        Parameters
        ----------
        rng : np.random.Generator
            The generator.

        Returns
        -------
        array (1,), no unit
            From 0 to 1.
        """
        return rng.random(1)


@dataclass(frozen=True)
class SegmentOrder:
    """One of several orders of magnetized (M) and plain (P) segments, base to tip. It has no embedded coordinates.

    Attributes
    ----------
    name : str
        Of its parameter.
    choices : tuple of str
        The orders.
    """

    name: str
    choices: tuple[str, ...]
    size = 0

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Find the bounds of its numbers: it has none.

        Returns
        -------
        dict[str, tuple[float, float]]
            An empty dict.
        """
        return {}

    def read(self, parameters: Parameters) -> Array:
        """Find its embedded coordinates: it has none.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (0,)
            Nothing.
        """
        return np.zeros(0)

    def written(self, x: Array) -> dict[str, float]:
        """Find the parameters of its embedded coordinates: there are none.

        Parameters
        ----------
        x : array (0,)
            Nothing.

        Returns
        -------
        dict[str, float]
            An empty dict.
        """
        return {}

    def nearest(self, x: Array) -> Array:
        """Find the nearest embedded coordinates: there are none.

        Parameters
        ----------
        x : array (0,)
            Nothing.

        Returns
        -------
        array (0,)
            Nothing.
        """
        return x

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw embedded coordinates: there are none.

        Parameters
        ----------
        rng : np.random.Generator
            The generator.

        Returns
        -------
        array (0,)
            Nothing.
        """
        return np.zeros(0)


Block = SegmentDirection | FieldVector | VariedNumber | SegmentOrder


@dataclass(frozen=True)
class Makeable:
    """Limits of manufacture: directions from a set, at most k different ones. Designs are brought within them before they are solved.

    A design's requested directions stay its parameters. Those that are made are the nearest that
    the limits allow, by the sum of cosines sum_i d_i . m_i:

    * a set: each segment gets the direction of the set that is nearest to its own;
    * at most k: segments are put into k groups that share a direction, that of the sum of theirs
      (spherical k-means, begun from the groups that merging two by two leaves, which loses least of
      the sum);
    * both: the k of the set that together have the largest sum.

    Attributes
    ----------
    allowed : array (s, 3), no unit, or None
        Unit vectors of the set; None: any.
    at_most : int or None
        How many different ones there may be, or None.

    References
    ----------
    Dhillon and Modha, Machine Learning 42 (2001) 143.
    """

    allowed: Array | None
    at_most: int | None

    def made(self, requested: Array) -> Array:
        """Find the directions that are made.

        Parameters
        ----------
        requested : array (n, 3), no unit
            Unit vectors that are requested.

        Returns
        -------
        array (n, 3), no unit
            The unit vectors that are made.
        """
        if len(requested) == 0:
            return requested
        if self.allowed is not None:
            return np.asarray(
                self._subset(requested)[np.argmax(requested @ self._subset(requested).T, axis=1)]
            )
        return self._shared(requested)[0]

    def derivative(self, requested: Array) -> Array:
        """Find the derivatives of the directions that are made with respect to those that are requested.

        Parameters
        ----------
        requested : array (n, 3), no unit
            Unit vectors.

        Returns
        -------
        array (n, 3, n, 3), no unit
            Zero of a set; within each group of a shared direction they are not.
        """
        n = len(requested)
        found = np.zeros((n, 3, n, 3))
        if self.allowed is not None or n == 0:
            return found
        made, group = self._shared(requested)
        for g in np.unique(group):
            members = np.flatnonzero(group == g)
            size = float(np.linalg.norm(requested[members].sum(axis=0)))
            across = (np.eye(3) - np.outer(made[members[0]], made[members[0]])) / size
            for i, j in itertools.product(members, members):
                found[i, :, j] = across
        return found

    def _subset(self, requested: Array) -> Array:
        """The directions of the set that are used, (k, 3)."""
        allowed = self.allowed
        assert allowed is not None
        k = self.at_most
        if k is None or k >= len(allowed):
            return allowed
        cosines = requested @ allowed.T
        if math.comb(len(allowed), k) <= 20_000:  # all are tried
            subsets = np.array(list(itertools.combinations(range(len(allowed)), k)))
            return np.asarray(
                allowed[subsets[int(np.argmax(cosines[:, subsets].max(axis=2).sum(axis=0)))]]
            )
        chosen: list[int] = []
        for _ in range(k):
            reached = cosines[:, chosen].max(axis=1) if chosen else np.full(len(requested), -1.0)
            gains = np.maximum(cosines, reached[:, None]).sum(axis=0)
            gains[chosen] = -np.inf
            chosen.append(int(np.argmax(gains)))
        return np.asarray(allowed[sorted(chosen)])

    def _shared(self, requested: Array) -> tuple[Array, NDArray[np.int64]]:
        """Shared directions (n, 3) and the group (n,) that each segment is in."""
        group = _merged(requested, self.at_most or len(requested))
        for _ in range(50):
            sums = np.array([requested[group == g].sum(axis=0) for g in range(group.max() + 1)])
            centers = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
            new = np.argmax(requested @ centers.T, axis=1)
            if (new == group).all() or len(np.unique(new)) < len(centers):
                break
            group = new
        if group.max() + 1 == len(requested):
            return requested, group
        return centers[group], group


def _merged(requested: Array, k: int) -> NDArray[np.int64]:
    """Groups (n,) of unit vectors (n, 3), at most k, by merging the two whose sum loses least of their lengths."""
    group = np.arange(len(requested))
    sums = requested.astype(float).copy()
    alive = np.ones(len(requested), bool)
    while alive.sum() > k:
        lengths = np.linalg.norm(sums, axis=1)
        loss = lengths[:, None] + lengths - np.linalg.norm(sums[:, None] + sums, axis=2)
        loss[~alive] = np.inf
        loss[:, ~alive] = np.inf
        np.fill_diagonal(loss, np.inf)
        a, b = divmod(int(np.argmin(loss)), len(requested))
        group[group == b] = a
        sums[a] += sums[b]
        alive[b] = False
    return np.unique(group, return_inverse=True)[1].astype(np.int64)
