"""Binding of surface points to the particles around them: moving least squares."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

NEIGHBORS = (16, 32, 64)  # tried in turn


class Binding:
    """Moves points with the particles around them: an affine fit to the nearest ones, exact for affine motion."""

    def __init__(
        self,
        points: np.ndarray,
        reference: np.ndarray,
        of_point: np.ndarray | int = 0,
        of_particle: np.ndarray | int = 0,
    ) -> None:
        """points (m, 3) m and particles reference (n, 3) m in the undeformed body.

        of_point (m,), of_particle (n,): the connected component of each. Components that touch do not pull each other's surface.
        """
        of_point = np.broadcast_to(of_point, len(points))
        of_particle = np.broadcast_to(of_particle, len(reference))
        found = []
        for component in np.unique(of_point):
            at = np.flatnonzero(of_point == component)
            of = np.flatnonzero(of_particle == component)
            found += [
                (at[row], of[column], value)
                for row, column, value in _fits(points[at], reference[of])
            ]
        rows, columns, values = (np.concatenate(entries) for entries in zip(*found))
        self._matrix = sparse.csr_matrix(
            (values, (rows, columns)), shape=(len(points), len(reference))
        )

    def at(self, position: np.ndarray) -> np.ndarray:
        """Positions of the points, (m, 3) m, when the particles are at position (n, 3) m."""
        return np.asarray(self._matrix @ np.asarray(position, dtype=float))


def _fits(
    points: np.ndarray, reference: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Entries of a matrix (m, n) that carries particles to points: rows, columns and values."""
    tree = cKDTree(reference)
    left = np.arange(len(points))
    for count in NEIGHBORS:
        count = min(count, len(reference))
        distance, near = (
            np.asarray(a).reshape(len(left), count) for a in tree.query(points[left], k=count)
        )
        value, flat = _affine(points[left], reference[near], distance)
        # Where the nearest particles lie nearly in a plane, more of them are taken.
        good = ~flat | (count in (NEIGHBORS[-1], len(reference)))
        yield np.repeat(left[good], count), near[good].ravel(), value[good].ravel()
        left = left[~good]
        if not len(left):
            break


def _affine(
    points: np.ndarray, near: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, k) that give the value at points (m, 3) of an affine fit to values at near (m, k, 3), and whether (m,) near is flat.

    The fit is by least squares, with weights that fall with the distance (m, k). Flat neighbors do not determine it.
    """
    reach = 1.15 * distance[:, -1:] + 1e-300
    weight = (1 - (distance / reach) ** 2) ** 2
    offset = (near - points[:, None]) / reach[..., None]
    basis = np.concatenate([np.ones((*distance.shape, 1)), offset], axis=2)
    moment = np.einsum("mk,mki,mkj->mij", weight, basis, basis)
    mean = moment[:, 0, 1:] / moment[:, 0, :1]
    spread = moment[:, 1:, 1:] / moment[:, :1, :1] - np.einsum("mi,mj->mij", mean, mean)
    sizes = np.linalg.eigvalsh(spread)
    flat = (
        sizes[:, 0] < 0.15**2 * sizes[:, 2]
    )  # neighbors whose thickness is less than this share of their width tell little across
    # What the neighbors do not determine stays out.
    moment[:, 1:, 1:] += 1e-9 * np.trace(moment, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    first = np.zeros((len(points), 4, 1))
    first[:, 0] = 1.0
    coefficient = np.linalg.solve(moment, first)[:, :, 0]
    return weight * np.einsum("mki,mi->mk", basis, coefficient), flat


def gradients(reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Deformation gradients (n, 3, 3) of particles that moved from reference to position (n, 3) m: affine fits to the nearest ones."""
    count = min(NEIGHBORS[1], len(reference))
    near = np.asarray(cKDTree(reference).query(reference, k=count)[1]).reshape(
        len(reference), count
    )
    before, after = (x[near] - x[near].mean(axis=1, keepdims=True) for x in (reference, position))
    size = np.einsum("mki,mki->m", before, before)[:, None, None] + 1e-300
    moment = np.einsum("mki,mkj->mij", before, before) / size + 1e-9 * np.eye(3)
    return np.asarray(
        np.linalg.solve(moment, np.einsum("mki,mkj->mij", before, after) / size).transpose(0, 2, 1)
    )
