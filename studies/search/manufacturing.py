"""Limits of manufacture: directions from a set, at most k different ones. Every design is brought within them before it is solved.

A design's requested directions stay its parameters. Those that are made are the nearest that the limits allow, by the sum of cosines
sum_i d_i . m_i:

* a set: each segment gets the direction of the set that is nearest to its own;
* at most k: segments are put into k groups that share a direction, that of the sum of theirs (spherical k-means, begun from the groups that
  merging two by two leaves, which loses least of the sum); Dhillon and Modha, Machine Learning 42 (2001) 143;
* both: the k of the set that together have the largest sum.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array


@dataclass(frozen=True)
class Makeable:
    """Limits of directions. allowed (s, 3) unit vectors or None: any; at_most: different ones, or None."""

    allowed: Array | None
    at_most: int | None

    def made(self, asked: Array) -> Array:
        """The directions (n, 3) that are made where these unit vectors (n, 3) are requested."""
        if len(asked) == 0:
            return asked
        if self.allowed is not None:
            return np.asarray(self._subset(asked)[np.argmax(asked @ self._subset(asked).T, axis=1)])
        return self._shared(asked)[0]

    def derivative(self, asked: Array) -> Array:
        """The derivatives (n, 3, n, 3) of the directions made by those requested: zero of a set, and within each group of shared ones."""
        n = len(asked)
        found = np.zeros((n, 3, n, 3))
        if self.allowed is not None or n == 0:
            return found
        made, group = self._shared(asked)
        for g in np.unique(group):
            members = np.flatnonzero(group == g)
            size = float(np.linalg.norm(asked[members].sum(axis=0)))
            across = (np.eye(3) - np.outer(made[members[0]], made[members[0]])) / size
            for i, j in itertools.product(members, members):
                found[i, :, j] = across
        return found

    def _subset(self, asked: Array) -> Array:
        """The directions of the set that are used, (k, 3)."""
        allowed = self.allowed
        assert allowed is not None
        k = self.at_most
        if k is None or k >= len(allowed):
            return allowed
        cosines = asked @ allowed.T
        if math.comb(len(allowed), k) <= 20_000:  # all are tried
            subsets = np.array(list(itertools.combinations(range(len(allowed)), k)))
            return np.asarray(allowed[subsets[int(np.argmax(cosines[:, subsets].max(axis=2).sum(axis=0)))]])
        chosen: list[int] = []
        for _ in range(k):
            reached = cosines[:, chosen].max(axis=1) if chosen else np.full(len(asked), -1.0)
            gains = np.maximum(cosines, reached[:, None]).sum(axis=0)
            gains[chosen] = -np.inf
            chosen.append(int(np.argmax(gains)))
        return np.asarray(allowed[sorted(chosen)])

    def _shared(self, asked: Array) -> tuple[Array, NDArray[np.int64]]:
        """Shared directions (n, 3) and the group (n,) that each segment is in."""
        group = _merged(asked, self.at_most or len(asked))
        for _ in range(50):
            sums = np.array([asked[group == g].sum(axis=0) for g in range(group.max() + 1)])
            centers = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
            new = np.argmax(asked @ centers.T, axis=1)
            if (new == group).all() or len(np.unique(new)) < len(centers):
                break
            group = new
        if group.max() + 1 == len(asked):
            return asked, group
        return centers[group], group


def _merged(asked: Array, k: int) -> NDArray[np.int64]:
    """Groups (n,) of unit vectors (n, 3), at most k, by merging the two whose sum loses least of their lengths."""
    group = np.arange(len(asked))
    sums, alive = asked.astype(float).copy(), np.ones(len(asked), bool)
    while alive.sum() > k:
        lengths = np.linalg.norm(sums, axis=1)
        loss = lengths[:, None] + lengths - np.linalg.norm(sums[:, None] + sums, axis=2)
        loss[~alive] = np.inf
        loss[:, ~alive] = np.inf
        np.fill_diagonal(loss, np.inf)
        a, b = divmod(int(np.argmin(loss)), len(asked))
        group[group == b] = a
        sums[a] += sums[b]
        alive[b] = False
    return np.unique(group, return_inverse=True)[1].astype(np.int64)
