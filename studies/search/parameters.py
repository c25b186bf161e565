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
    """Unit vector (3,) in the undeformed body, axis +x; angles in degrees."""
    y, z, x = from_angles(math.radians(around), math.radians(along))
    return np.array([x, y, z])


def angles(vector: Array) -> tuple[float, float]:
    """(around, along) in degrees of a direction (3,): the inverse of `direction`."""
    return azimuth_of(np.roll(vector / np.linalg.norm(vector), -1))


def azimuth_of(vector: Array) -> tuple[float, float]:
    """Azimuth and elevation, degrees, of a vector (3,)."""
    x, y, z = vector
    return float(np.rad2deg(np.arctan2(y, x))), float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def across(units: Array) -> Array:
    """Two unit vectors across each of the unit vectors (..., 3), as columns (..., 3, 2)."""
    first = unit(np.cross(units, np.eye(3)[np.argmin(np.abs(units), axis=-1)]))
    return np.stack([first, np.cross(units, first)], axis=-1)


def corner_of(seed: int, corner: int) -> Array:
    """The direction (3,) of all segments in one of a study's first trials: a corner of a regular tetrahedron in a random orientation."""
    turn, _ = np.linalg.qr(np.random.default_rng([seed]).normal(size=(3, 3)))
    return np.asarray(TETRAHEDRON[corner] @ turn)


@dataclass(frozen=True)
class SegmentDirection:
    """The direction of a segment's magnetization: a unit vector (3,). segment: its number in the scene, from 0."""

    name: str
    segment: int
    size = 3

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {f"{self.name}_around_deg": (-180.0, 180.0), f"{self.name}_along_deg": (-90.0, 90.0)}

    def read(self, parameters: Parameters) -> Array:
        return direction(
            parameters[f"{self.name}_around_deg"], parameters[f"{self.name}_along_deg"]
        )

    def written(self, x: Array) -> dict[str, float]:
        around, along = angles(x)
        return {f"{self.name}_around_deg": around, f"{self.name}_along_deg": along}

    def nearest(self, x: Array) -> Array:
        """The unit vector nearest to x (3,); +x for zeros."""
        length = float(np.linalg.norm(x))
        return np.array(x) / length if length > 0 else np.array([1.0, 0.0, 0.0])

    def drawn(self, rng: np.random.Generator) -> Array:
        """Uniform on the sphere."""
        return self.nearest(rng.normal(size=3))


@dataclass(frozen=True)
class FieldVector:
    """A uniform field, (3,) T, in a ball of radius max T. names: of its parameters; number: which of the study's fields, from 0."""

    names: tuple[str, ...]
    max: float
    number: int = 0
    size = 3

    def bounds(self) -> dict[str, tuple[float, float]]:
        return dict(
            zip(self.names, ((0.0, 1e3 * self.max), (-180.0, 180.0), (-90.0, 90.0)), strict=True)
        )

    def read(self, parameters: Parameters) -> Array:
        return np.asarray(1e-3 * parameters[self.names[0]] * self.direction(parameters))

    def direction(self, parameters: Parameters) -> Array:
        """Its unit vector (3,)."""
        return np.array(from_angles(*(math.radians(parameters[name]) for name in self.names[1:])))

    def written(self, x: Array) -> dict[str, float]:
        strength = min(1e3 * float(np.linalg.norm(x)), 1e3 * self.max)
        return dict(zip(self.names, (strength, *azimuth_of(x)), strict=True))

    def nearest(self, x: Array) -> Array:
        """The vector of the ball that is nearest to x (3,) T."""
        return np.array(x) * min(1.0, self.max / max(float(np.linalg.norm(x)), 1e-300))

    def drawn(self, rng: np.random.Generator) -> Array:
        """Any direction, any strength: uniform in both."""
        vector = rng.normal(size=3)
        return np.asarray(self.max * rng.random() / np.linalg.norm(vector) * vector)


@dataclass(frozen=True)
class VariedNumber:
    """A quantity from low to high (SI); embedded as its place between them, 0 to 1.

    name: of its parameter, which is in the unit that the name ends with, `unit` of which are an SI unit. what: length, diameter,
    remanence or shear_modulus, or "number" of one that has an address; place: in the scene; segment: whose number it is, from 0, or None;
    shared: further places that have the same value.
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
        return {self.name: (self.unit * self.low, self.unit * self.high)}

    def read(self, parameters: Parameters) -> Array:
        return np.array([(parameters[self.name] / self.unit - self.low) / (self.high - self.low)])

    def written(self, x: Array) -> dict[str, float]:
        low, high = self.bounds()[self.name]
        return {self.name: min(max(self.unit * self.value(x), low), high)}

    def value(self, x: Array) -> float:
        """The quantity, SI, of an embedded coordinate (1,)."""
        return self.low + float(x[0]) * (self.high - self.low)

    def nearest(self, x: Array) -> Array:
        return np.clip(x, 0.0, 1.0)

    def drawn(self, rng: np.random.Generator) -> Array:
        return rng.random(1)


@dataclass(frozen=True)
class SegmentOrder:
    """One of several orders of magnetized (M) and plain (P) segments, base to tip. It has no embedded coordinates."""

    name: str
    choices: tuple[str, ...]
    size = 0

    def bounds(self) -> dict[str, tuple[float, float]]:
        return {}

    def read(self, parameters: Parameters) -> Array:
        return np.zeros(0)

    def written(self, x: Array) -> dict[str, float]:
        return {}

    def nearest(self, x: Array) -> Array:
        return x

    def drawn(self, rng: np.random.Generator) -> Array:
        return np.zeros(0)


Block = SegmentDirection | FieldVector | VariedNumber | SegmentOrder


@dataclass(frozen=True)
class Makeable:
    """Limits of manufacture: directions from a set, at most k different ones. Every design is brought within them before it is solved.

    A design's requested directions stay its parameters. Those that are made are the nearest that the limits allow, by the sum of cosines
    sum_i d_i . m_i:

    * a set: each segment gets the direction of the set that is nearest to its own;
    * at most k: segments are put into k groups that share a direction, that of the sum of theirs (spherical k-means, begun from the
      groups that merging two by two leaves, which loses least of the sum); Dhillon and Modha, Machine Learning 42 (2001) 143;
    * both: the k of the set that together have the largest sum.

    allowed (s, 3) unit vectors or None: any; at_most: different ones, or None.
    """

    allowed: Array | None
    at_most: int | None

    def made(self, requested: Array) -> Array:
        """The directions (n, 3) that are made where these unit vectors (n, 3) are requested."""
        if len(requested) == 0:
            return requested
        if self.allowed is not None:
            return np.asarray(
                self._subset(requested)[np.argmax(requested @ self._subset(requested).T, axis=1)]
            )
        return self._shared(requested)[0]

    def derivative(self, requested: Array) -> Array:
        """The derivatives (n, 3, n, 3) of the directions made by those requested: zero of a set, and within each group of shared ones."""
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
