"""From meshes to a grid and particles: quadrature points with the exact volume, centroid and second moments of every cut cell.

The points of a cell are tensor Gauss points, moved and stretched to the moments of what the mesh fills of the cell; in a full cell they are
the Gauss points themselves. Where a piece is so skew that its points would leave the cell they are pulled toward its centroid:
volume and centroid stay exact, `part_errors` says what the second moments of the whole part lose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.cut_cells import cell_moments
from magmpm.bodies.grid import ClampPlane, Grid
from magmpm.bodies.section_quadrature import Particles, gauss
from magmpm.compiled.arrays import Array, Index
from magmpm.errors import SceneError

ON_PLANE = 1e-9  # of a cell
MOST_CELLS = 20_000_000  # of the box around all parts
TOUCHING = 1e-4  # of the body's length: parts this near touch, and faces of held and free ones lie in one plane


def grid_of_parts(parts: list[Array], held: list[bool], spacing: float) -> tuple[Grid, list[ClampPlane]]:
    """Grid around parts (each (f, 3, 3) m) with cells of about `spacing` m, and the planes on which free parts are clamped.

    Knots lie on the faces of the box around the free parts, and the held parts stand in as many more cells as they need.
    Raises SceneError where the box has too many cells.
    """
    boxes = np.array([[p.reshape(-1, 3).min(0), p.reshape(-1, 3).max(0)] for p in parts])
    still = np.array(held)
    moving = boxes[~still] if not still.all() else boxes
    low, high = moving[:, 0].min(0), moving[:, 1].max(0)
    cells = np.maximum(np.round((high - low) / spacing), 1).astype(int)
    size = (high - low) / cells
    below = np.maximum(np.ceil((low - boxes[:, 0].min(0)) / size - ON_PLANE), 0).astype(int)
    above = np.maximum(np.ceil((boxes[:, 1].max(0) - high) / size - ON_PLANE), 0).astype(int)
    count = below + cells + above
    if np.prod(count.astype(float)) > MOST_CELLS:
        extent = " x ".join(f"{1e3 * x:.4g}" for x in boxes[:, 1].max(0) - boxes[:, 0].min(0))
        raise SceneError(
            "body.parts",
            found=f"the box around all parts, {extent} mm, has {np.prod(count.astype(float)):.3g} cells of {1e3 * spacing:.3g} mm",
            rule=f"at most {MOST_CELLS:.0e} cells can be had",
            remedy="check units and places of the parts, or raise spacing",
        )
    grid = Grid(low - below * size, size, (int(count[0]), int(count[1]), int(count[2])))
    return grid, _clamp_planes(parts, boxes, still, grid, below, below + cells)


def _stands(free: Array, held: Array, step: Array) -> bool:
    """True if the shadow of free triangles (f, 3, 2) m lies on held ones (h, 3, 2) m, except for gaps and rims of a step (2,) m: a part
    that spans a gap between two feet, or the hole of a ring, is not held there.
    """
    from scipy.ndimage import binary_dilation  # only where parts hold others

    low = free.reshape(-1, 2).min(0)
    shape = np.ceil((free.reshape(-1, 2).max(0) - low) / step).astype(int) + 1
    on = binary_dilation(_shadow(held, low, step, shape), np.ones((3, 3)))
    return not (_shadow(free, low, step, shape) & ~on).any()


def _shadow(triangles: Array, low: Array, step: Array, shape: Index) -> NDArray[np.bool_]:
    """Which points low + step (i, j) of a lattice of this shape lie in triangles (f, 3, 2) m."""
    out = np.zeros(tuple(shape), bool)
    scaled = (triangles - low) / step
    first = np.maximum(np.ceil(scaled.min(1) - ON_PLANE), 0).astype(int)
    last = np.minimum(np.floor(scaled.max(1) + ON_PLANE), shape - 1).astype(int)
    for k in np.flatnonzero((first <= last).all(1)):  # few: most triangles of a fine mesh hold no point
        i, j = (np.arange(first[k, axis], last[k, axis] + 1) for axis in range(2))
        place = np.stack(np.meshgrid(i, j, indexing="ij"), -1).astype(float)
        sides = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            along, to = scaled[k, b] - scaled[k, a], place - scaled[k, a]
            sides.append(along[0] * to[..., 1] - along[1] * to[..., 0])
        inside = (np.stack(sides) >= -ON_PLANE).all(0) | (np.stack(sides) <= ON_PLANE).all(0)
        out[first[k, 0] : last[k, 0] + 1, first[k, 1] : last[k, 1] + 1] |= inside
    return out


def _clamp_planes(parts: list[Array], boxes: Array, still: NDArray[np.bool_], grid: Grid, first: Array, last: Array) -> list[ClampPlane]:
    """Planes on which the held parts do all of their holding; none where some hold in another way.

    boxes (k, 2, 3): lower and upper corners; still (k,): held; first, last (3,): cells of the free parts' box, last excluded.
    """
    planes: list[ClampPlane] = []
    covered = np.zeros(len(parts), bool)
    slack = TOUCHING * float(np.ptp(boxes.reshape(-1, 3), axis=0).max())
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for lower in (True, False):
            at = grid.origin[axis] + grid.spacing[axis] * (first if lower else last)[axis]
            face = boxes[:, 1, axis] if lower else boxes[:, 0, axis]
            mine = still & (np.abs(face - at) < slack)
            if not mine.any():
                continue
            # All of the free parts within a cell of the plane must stand on the held ones.
            inner = at + grid.spacing[axis] * (1 if lower else -1)
            free = np.concatenate([p for p, s in zip(parts, still, strict=True) if not s])
            within = (free[:, :, axis].min(1) < max(at, inner)) & (free[:, :, axis].max(1) > min(at, inner))
            near = free[within | (np.abs(free[:, :, axis] - at) < slack).all(1)][:, :, others]
            bases = np.concatenate([p for p, s in zip(parts, mine, strict=True) if s])
            bases = bases[(np.abs(bases[:, :, axis] - at) < slack).all(1)][:, :, others]
            if len(near) and _stands(near, bases, 0.5 * grid.spacing[others]):
                planes.append(ClampPlane(axis, lower, int(first[axis] if lower else last[axis] - 1)))
                covered |= mine
    return planes if np.array_equal(covered, still) else []


def part_particles(grid: Grid, parts: list[Array], count: int) -> Particles:
    """Particles of parts (each (f, 3, 3) m), `count` a direction and cell. Sorted by cell, then by part."""
    unit, share = gauss(count)
    cube = np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), -1).reshape(-1, 3)
    weight = np.einsum("i,j,k->ijk", share, share, share).ravel()
    cells, points, volumes, owners = [], [], [], []
    for k, triangles in enumerate(parts):
        cell, moments = cell_moments(triangles, grid)
        points.append(_points(moments, cube))
        volumes.append(moments[:, 0])
        cells.append(cell)
        owners.append(np.full(len(cell), k))
    cell, owner = np.concatenate(cells), np.concatenate(owners)
    order = np.lexsort((owner, np.ravel_multi_index(cell.T, grid.cells)))
    cell, local = cell[order], np.concatenate(points)[order]
    volume = np.concatenate(volumes)[order] * float(np.prod(grid.spacing))
    position = grid.origin + grid.spacing * (cell[:, None, :] + local)
    each = len(cube)
    return Particles(
        position.reshape(-1, 3),
        (volume[:, None] * weight).ravel(),
        np.repeat(owner[order], each).astype(np.int32),
        np.repeat(cell, each, axis=0).astype(np.int64),
    )


def _points(moments: Array, cube: Array) -> Array:
    """Points (k, q, 3), in cell coordinates, that have the moments (k, 10) of each cell's piece, but for those pulled into the cell."""
    volume = moments[:, :1]
    centroid = np.clip(moments[:, 1:4] / volume, 0.0, 1.0)
    xx, xy, xz, yy, yz, zz = (moments[:, 4:] / volume).T
    second = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    covariance = second - centroid[:, :, None] * centroid[:, None, :]
    values, vectors = np.linalg.eigh(covariance)
    root = np.einsum("kij,kj,klj->kil", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)
    away = np.einsum("kij,qj->kqi", root, cube)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(away > 0, (1 - centroid)[:, None] / away, np.where(away < 0, -centroid[:, None] / away, np.inf))
    pull = np.minimum(room.min(axis=(1, 2)), 1.0)
    return centroid[:, None, :] + pull[:, None, None] * away


def part_errors(particles: Particles, parts: list[Array]) -> dict[str, float]:
    """Largest errors over the parts (each (f, 3, 3) m) against the meshes: of volume, relative; of centroid, over the part's size;
    of second moments about the centroid, over their trace."""
    errors = np.zeros(3)
    for k, triangles in enumerate(parts):
        mine = particles.segment == k
        p, v = particles.position[mine], particles.volume[mine]
        low, high = triangles.reshape(-1, 3).min(0), triangles.reshape(-1, 3).max(0)
        _, moments = cell_moments(triangles, Grid(low, high - low, (1, 1, 1)))  # one cell: the whole mesh
        size = high - low
        volume, centroid = moments[0, 0] * size.prod(), low + size * moments[0, 1:4] / moments[0, 0]
        xx, xy, xz, yy, yz, zz = moments[0, 4:] / moments[0, 0]
        mean = moments[0, 1:4] / moments[0, 0]
        exact = (np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - np.outer(mean, mean)) * np.outer(size, size)
        away = p - centroid
        found = np.einsum("p,pi,pj->ij", v, away, away) / v.sum()
        mine_errors = (
            abs(v.sum() / volume - 1), np.abs(v @ away / v.sum()).max() / size.max(),
            np.abs(found - exact).max() / np.trace(exact),
        )  # fmt: skip
        errors = np.maximum(errors, mine_errors)
    return dict(zip(("volume_error", "centroid_error", "second_moment_error"), errors.tolist(), strict=True))
