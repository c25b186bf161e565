"""A magnet as a cloud of dipoles: for sources that turn or that the body surrounds, where no box excludes the magnet.

Each dipole stands for a piece of the magnet, at Gauss points of a block, or of a cylinder's height, radius squared and angle.
Their error falls exponentially with the number along an edge (a cube, at one edge from its face: 0.11 % with 3 per edge, 0.008 % with 4).
That number grows until the field at the given distance agrees with magpylib within the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.errors import SceneError
from magmpm.fields.dipole import MU0, POINT, K
from magmpm.fields.magnets import Solid

MAX_DIPOLES = 1000  # per magnet: some 40 microseconds per particle


def cloud(solid: Solid, polarization: Array, exact: Callable[[Array], Array], distance: float, tolerance: float) -> Array:
    """Dipoles (k, 7) (fields.dipole) that stand for a magnet at points `distance` m or farther from its surface.

    polarization (3,) T in space; exact: the magnet's field. Raises SceneError where MAX_DIPOLES do not reach the tolerance.
    """
    points = _around(solid, distance)
    B = exact(points)
    size = np.linalg.norm(B, axis=1)
    count, error = np.ones(3), np.inf
    while True:
        positions, weights = (_cylinder if solid.round else _block)(solid, np.rint(count).astype(int))
        if len(weights) > MAX_DIPOLES:
            raise SceneError(
                solid.name,
                found=f"within {1e3 * distance:.3g} mm of it the field can't be as exact as {1e2 * tolerance:g} % with "
                f"{MAX_DIPOLES} dipoles ({1e2 * error:.2g} % was reached)",
                rule="a magnet that turns, or that the body goes round, is computed as a cloud of dipoles, and needs some distance",
                remedy="keep the body farther from it, or raise field.tabulation.tolerance",
            )
        volume = (2 * np.pi if solid.round else 8.0) * solid.half.prod()
        moments = weights[:, None] * volume * polarization / MU0
        error = float((np.linalg.norm(_field(positions, moments, points) - B, axis=1) / size).max())
        if error <= tolerance:
            radius = np.full((len(positions), 1), POINT)
            return np.concatenate([positions, moments, radius], axis=1)
        # refine first where the pieces are longest
        pieces = solid.half / count
        count = np.where(pieces > 0.7 * pieces.max(), count + 1, count)


def _block(solid: Solid, count: NDArray[np.int64]) -> tuple[Array, Array]:
    rules = [np.polynomial.legendre.leggauss(int(n)) for n in count]
    points = np.stack(np.meshgrid(*[rule[0] for rule in rules], indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.einsum("i,j,k->ijk", *[rule[1] / 2 for rule in rules]).ravel()
    return solid.position + (points * solid.half) @ solid.frame.T, weights


def _cylinder(solid: Solid, count: NDArray[np.int64]) -> tuple[Array, Array]:
    radial, height = int(max(count[0], count[1])), int(count[2])
    s, ws = np.polynomial.legendre.leggauss(radial)
    z, wz = np.polynomial.legendre.leggauss(height)
    around = 1 if radial == 1 and height == 1 else 4 * radial
    angle = 2 * np.pi * (np.arange(around) + 0.5) / around
    r = np.zeros(1) if around == 1 else np.sqrt((1 + s) / 2)
    grid_r, grid_a, grid_z = np.meshgrid(r, angle, z, indexing="ij")
    local = np.stack([grid_r * np.cos(grid_a), grid_r * np.sin(grid_a), grid_z], axis=-1).reshape(-1, 3)
    weights = np.einsum("i,j,k->ijk", ws / 2, np.full(around, 1 / around), wz / 2).ravel()
    return solid.position + (local * solid.half) @ solid.frame.T, weights


def _around(solid: Solid, distance: float) -> Array:
    """Points at a distance from the box or cylinder of a magnet, (n, 3) m in the sources' frame."""
    rng = np.random.default_rng(21)
    far = rng.standard_normal((600, 3)) * 3 * solid.half.max()
    near = np.clip(far, -solid.half, solid.half)
    if solid.round:
        near[:, :2] = far[:, :2] * np.minimum(1.0, solid.half[0] / np.hypot(far[:, 0], far[:, 1]))[:, None]
    outward = far - near
    outside = np.linalg.norm(outward, axis=1) > 1e-6 * solid.half.max()
    near, outward = near[outside], outward[outside]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return solid.position + (near + distance * outward) @ solid.frame.T


def _field(positions: Array, moments: Array, points: Array) -> Array:
    """B (n, 3) T of dipoles (k, 3), the plain formula."""
    d = points[:, None, :] - positions
    r = np.linalg.norm(d, axis=2)
    along = np.einsum("nkj,kj->nk", d, moments)
    return K * np.sum(3 * (along / r**5)[..., None] * d - moments / (r**3)[..., None], axis=1)
