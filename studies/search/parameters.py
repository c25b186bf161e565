"""The parts of a design: directions, fields, numbers within bounds, and choices.

Optuna stores a design as *parameters* (angles in degrees, mT, mm). Samplers that know geometry work on *embedded* coordinates, in which
designs that are near each other have numbers near each other: a direction is its unit vector, a field its vector (T), a number its place
between its bounds (0 to 1). A choice has none: it has no neighbors.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array, Index, Named
from magmpm.scene.addresses import Place, written
from magmpm.studies.search.samplers.blocks import Ball, Direction, Number

Parameters = Named
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
FIELD = ("field_mT", "field_azimuth_deg", "field_elevation_deg")


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
class SegmentDirection(Direction):
    """The direction of a segment's magnetization, in the undeformed body.

    Attributes
    ----------
    segment : int
        Index of the segment, base to tip.
    """

    segment: int = 0


@dataclass(frozen=True)
class FieldVector(Ball):
    """A uniform field; its coordinates are the vector in T, its strength is in mT.

    Attributes
    ----------
    number : int
        Index of the field.
    """

    number: int = 0


@dataclass(frozen=True)
class VariedNumber(Number):
    """A quantity between two bounds.

    Attributes
    ----------
    what : str
        "length", "diameter", "remanence" or "shear_modulus"; "number" for one by its address.
    unit : float
        Units of the parameter in one of SI.
    place : Place
        Where the quantity stands in the scene's data.
    segment : int, optional
        Index of the segment that it belongs to.
    shared : tuple of Place
        Other places that have the same value.
    """

    what: str = "number"
    unit: float = 1.0
    place: Place = ()
    segment: int | None = None
    shared: tuple[Place, ...] = ()

    @property
    def kinds(self) -> list[str]:
        """Names by which `magmpm.sensitivities` knows it."""
        if self.what != "number":
            return [self.what]
        return [written(place) for place in (self.place, *self.shared)]

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest value, SI."""
        return self.low / self.unit, self.high / self.unit

    def value(self, x: Array) -> float:
        """Find the quantity of a coordinate.

        Parameters
        ----------
        x : array (1,)
            The coordinate; it may be beyond the bounds.

        Returns
        -------
        float, SI
            The quantity.
        """
        low, high = self.ends
        place = float(x[0])
        value = float(low * (high / low) ** place) if self.log else low + place * (high - low)
        return round(value) if self.whole else value

    def slope(self, x: Array) -> float:
        """Find the derivative of the quantity by its coordinate.

        Parameters
        ----------
        x : array (1,)
            The coordinate.

        Returns
        -------
        float, SI
            The derivative.
        """
        low, high = self.ends
        return self.value(x) * math.log(high / low) if self.log else high - low


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

    def _shared(self, requested: Array) -> tuple[Array, Index]:
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


def _merged(requested: Array, k: int) -> Index:
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
