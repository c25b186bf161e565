"""Start of a solve, predicted from its neighbors: the correction that it will add to its rod, from theirs.

A rod bends nearly as the body does. What the solve adds to it, seen from the rod's frames, is local: how sections deform at the clamp and
between segments. It follows from how the rod is curved, smoothly, and more simply than from the field: a small change of the field may
turn the body round, and what is added at a given curvature is the same for another field, direction of magnetization or magnet.
So it is interpolated over the curvature of rods: kriging, with a covariance that is smooth (Matern 5/2) and linear far away.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, equations 2.25 and 4.17.
"""

from __future__ import annotations

import math

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import RodShape


class Neighbors:
    """Solves of one body on one grid, and what they added to their rods. `expected` and `learn` take turns."""

    def __init__(self, most: int | None = None) -> None:
        """most: solves that are kept, the last ones; all unless given."""
        self._most = most
        self._rods: list[Array] = []
        self._added: list[Array] = []
        self._requested = np.zeros(0)

    def expected(self, rod: RodShape) -> Array | None:
        """Correction that a solve will add to its rod: coefficients (planes, m), m, in the rod's frames; None where nothing is known."""
        self._requested = _curvature(rod)
        if not self._rods:
            return None
        known = np.array(self._rods)
        near = np.argsort(np.linalg.norm(known - self._requested, axis=1), kind="stable")[:64]
        among = _covariance(known[near], known[near])
        share = np.linalg.solve(
            among + 1e-8 * np.diag(np.diag(among)),
            _covariance(known[near], self._requested[None])[:, 0],
        )
        return np.asarray(np.einsum("k,kpm->pm", share, np.array([self._added[k] for k in near])))

    def learn(self, added: Array) -> None:
        """Store what the last requested rod's solve has added to it: nothing where it did not begin there. Another grid begins anew."""
        if not added.any() or not len(self._requested):
            return
        if self._added and self._added[-1].shape != added.shape:
            self._rods = []
            self._added = []
        self._rods = [*self._rods, self._requested]
        self._added = [*self._added, added]
        if self._most is not None:
            self._rods = self._rods[-self._most :]
            self._added = self._added[-self._most :]


def _curvature(rod: RodShape) -> Array:
    """Twist and bending times length at 20 places from the clamp on, rad, so scaled that the norm is their mean."""
    at = np.arange(20) / 20 * rod.s[-1]
    return (
        np.concatenate([np.interp(at, rod.s, column) for column in rod.curvature.T])
        * rod.s[-1]
        / math.sqrt(len(at))
    )


def _covariance(one: Array, other: Array) -> Array:
    """(n, m) of curvatures (n, k) and (m, k)."""
    # of curvature times length, rad: rods at a larger distance have little to do with each other
    reach_of_neighbors = 2.0
    distance = (
        np.linalg.norm(one[:, None] - other[None], axis=2) * math.sqrt(5.0) / reach_of_neighbors
    )
    return (1.0 + distance + distance**2 / 3.0) * np.exp(-distance) + 0.1 * (one @ other.T)
