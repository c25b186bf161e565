"""Meshes to a grid and particles: quadrature points with the exact volume, centroid and second moments of every cut cell.

The points of a cell are tensor Gauss points, moved and stretched to the moments of what the mesh fills of the cell; in a full cell they are
the Gauss points themselves. Where a piece is so skew that its points would leave the cell they are pulled toward its centroid:
volume and centroid stay exact, `part_errors` says what the second moments of the whole part lose.

The moments of what the mesh fills of each cell are exact to rounding. The surface is cut at the grid's planes into pieces that each lie in
one cell. By the divergence theorem along x, the integral of f over the part of the mesh within a cell is the sum over the surface of n_x
times the integral of f along x from the cell's left face: up to the surface for pieces in the cell, up to the cell's right face for pieces
farther right in the same column. No test whether a point is inside is needed. Source: Mirtich, Fast and accurate computation of polyhedral
mass properties, J. Graphics Tools 1 (1996), applied to each cell.
"""

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.curves import face_normals
from magmpm.bodies.grid import ClampPlane, Grid
from magmpm.bodies.section_quadrature import Particles, gauss
from magmpm.compiled.arrays import Array, Index, Mask, NamedNumbers
from magmpm.errors import SceneError

_A = (6 - 15**0.5) / 21
_B = (6 + 15**0.5) / 21
# Radon's rule, exact for polynomials of degree 5 on a triangle: barycentric points (7, 3) and weights (7,).
_POINTS = np.array(
    [[1 / 3] * 3, *(np.roll([1 - 2 * p, p, p], k) for p in (_A, _B) for k in range(3))]
)
_WEIGHTS = np.array([9 / 40, *[(155 - 15**0.5) / 1200] * 3, *[(155 + 15**0.5) / 1200] * 3])


def cell_moments(triangles: Array, grid: Grid) -> tuple[Index, Array]:
    """The cells that a closed mesh fills in part or whole, and the moments of the filled part.

    triangles (f, 3, 3) m, inside the grid. Returns cell (k, 3), in the order of x, y, z, and moments (k, 10) in the cell's own
    coordinates, 0 to 1 each way: integrals of 1, x, y, z, x^2, xy, xz, y^2, yz, z^2.
    """
    scaled = (triangles - grid.origin) / grid.spacing
    nearest = np.round(scaled)
    # STL files hold single precision, and axes told from their faces lose up to 7 times that (300 turned robots drawn at random).
    reach = max(np.abs(triangles).max(), np.max(grid.spacing * grid.cells))
    noise = 8 * 2.0**-24 * reach / grid.spacing
    scaled = np.where(np.abs(scaled - nearest) < noise, nearest, scaled)
    low = np.floor(scaled.reshape(-1, 3).min(0)).astype(int)
    shape = np.maximum(np.ceil(scaled.reshape(-1, 3).max(0)).astype(int) - low, 1)
    if np.any(low < 0) or np.any(low + shape > grid.cells):
        raise ValueError("the mesh leaves the grid")
    if np.prod(shape) > 30_000_000:
        raise ValueError(f"the box around the mesh has {np.prod(shape)} cells, more than 30000000")
    pieces = scaled - low
    for axis in range(3):
        pieces = _cut(pieces, axis)
    cell = np.clip(np.floor(pieces.mean(axis=1)).astype(int), 0, shape - 1)
    local = pieces - cell[:, None, :]
    edge = local[:, 1] - local[:, 0]
    other = local[:, 2] - local[:, 0]
    area = (edge[:, 1] * other[:, 2] - edge[:, 2] * other[:, 1]) / 2  # n_x dA
    flat = np.ravel_multi_index(cell.T, shape)
    count = int(np.prod(shape))
    own = np.zeros((10, count))
    column = np.zeros((6, count))
    for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
        x, y, z = np.einsum("k,fki->if", point, local)
        w = weight * area
        terms = (
            x,
            x * x / 2,
            x * y,
            x * z,
            x**3 / 3,
            x * x * y / 2,
            x * x * z / 2,
            x * y * y,
            x * y * z,
            x * z * z,
        )
        for k, term in enumerate(terms):
            own[k] += np.bincount(flat, w * term, count)
        for k, term in enumerate((np.ones_like(x), y, z, y * y, y * z, z * z)):
            column[k] += np.bincount(flat, w * term, count)
    grid_of = column.reshape(6, *shape)
    beyond = (
        np.cumsum(grid_of[:, ::-1], axis=1)[:, ::-1] - grid_of
    )  # of the pieces farther right in the column
    one, y, z, yy, yz, zz = beyond.reshape(6, -1)
    own += np.stack([one, one / 2, y, z, one / 3, y / 2, z / 2, yy, yz, zz])
    filled = np.flatnonzero(own[0] > 1e-9)  # less is rounding error
    return np.stack(np.unravel_index(filled, shape), axis=1) + low, own[:, filled].T


def _cut(triangles: Array, axis: int) -> Array:
    """Triangles cut at the integer planes of an axis, so that none crosses one."""
    done: list[Array] = []
    while len(triangles):
        low = np.floor(triangles[:, :, axis].min(1))
        high = np.ceil(triangles[:, :, axis].max(1))
        whole = high - low <= 1
        done.append(triangles[whole])
        triangles = triangles[~whole]
        low = low[~whole]
        high = high[~whole]
        if len(triangles):
            triangles = _split(triangles, axis, np.floor((low + high) / 2))
    return np.concatenate(done) if done else triangles


def _split(triangles: Array, axis: int, plane: Array) -> Array:
    """Each triangle (f, 3, 3), which has corners on both sides of its plane, as three: one on one side, two on the other."""
    side = triangles[:, :, axis] - plane[:, None]
    above = side > 0
    alone = np.where(
        above.sum(1) == 1, above.argmax(1), (side < 0).argmax(1)
    )  # the corner that is alone on its side
    order = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    side = np.take_along_axis(side, order, axis=1)
    a = corners[:, 0]
    b = corners[:, 1]
    c = corners[:, 2]
    ab = a + (side[:, 0] / (side[:, 0] - side[:, 1]))[:, None] * (b - a)
    ac = a + (side[:, 0] / (side[:, 0] - side[:, 2]))[:, None] * (c - a)
    ab[:, axis] = ac[:, axis] = plane
    made = [np.stack(t, axis=1) for t in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    pieces = np.concatenate(made)
    flat = np.all(pieces == pieces[:, :1], axis=(1, 2))
    return pieces[~flat]


ON_PLANE = 1e-9  # of a cell
# of the body's length: parts this near touch, and faces of held and free ones lie in one plane
TOUCHING_DISTANCE = 1e-4


def axes_of_parts(free: list[Array], held: list[Array], spacing: float) -> Array:
    """Axes (3, 3), in columns, of a grid with few cells of about `spacing` m in parts (each (f, 3, 3) m) that can move.

    They turn with the parts, but are x, y, z where hardly a face is flat. The first is that of the longest side: planes of unknowns lie
    across it.

    Of V/h^3 + sum A (|n_x| + |n_y| + |n_z|)/(2 h^2) cells that parts of volume V are expected to meet, whose faces have areas A and normals
    n along the grid; but faces that lie along it are taken to lie on knots, and cut no cell. Axes are sought along the largest faces; of
    those with about the fewest cells, those along the most of all faces are taken, what holds the parts among them.
    Source: Schneider and Weil, Stochastic and Integral Geometry, section 5.1 (the volume of the sum of body and cell; edges left out).
    """
    directions = 6  # of the largest faces that are not parallel
    flat = 1e-8  # one less the cosine: faces of files in single precision differ by 1e-5 rad
    about = 0.05  # of the cells, or of the area of all faces: less does not decide
    triangles = np.concatenate(free)
    faces = face_normals(np.concatenate([triangles, *held])) / 2
    area = np.linalg.norm(faces, axis=1)
    normals = faces / np.maximum(area, 1e-300)[:, None]
    inner = float(np.sum(triangles[:, 0] * faces[: len(triangles)])) / 3 / spacing**3

    def cells_and_area(axes: Array) -> tuple[float, float]:
        along = np.abs(normals @ axes)
        lies = along.max(axis=1) > 1 - flat
        cut = np.where(lies, 0.0, area * along.sum(axis=1))[: len(triangles)]
        return inner + float(cut.sum()) / 2 / spacing**2, float(area @ lies)

    # Faces may be of many triangles: the areas of those whose normals are about the same are summed.
    sign_free = np.round(np.einsum("ni,nj->nij", normals, normals).reshape(-1, 9), 3)
    _, first, alike = np.unique(sign_free, axis=0, return_index=True, return_inverse=True)
    share = np.bincount(alike.ravel(), area) / area.sum()
    main: list[Array] = []
    for k in first[np.lexsort((first, -np.round(share, 4)))]:  # however the parts are turned
        side = normals @ normals[k]
        mean = np.where(np.abs(side) > 1 - flat, np.sign(side) * area, 0.0) @ normals
        mean = mean / np.linalg.norm(mean)
        if all(abs(mean @ other) < 1 - flat for other in main):
            main.append(mean)
        if len(main) == directions:
            break
    found = []
    for one, other in permutations(main, 2):
        frame = np.linalg.qr(np.stack([one, other], axis=1), mode="complete")[0]
        found.append(frame * np.linalg.det(frame))  # right-handed
    cells, flush = np.array([cells_and_area(frame) for frame in found]).T
    flush[cells > (1 + about) * cells.min()] = 0.0
    axes = np.eye(3)
    if flush.max() > about * area.sum():
        from scipy.spatial.transform import Rotation  # 0.1 s to import, and few bodies are turned

        # Of frames that differ by rounding the first; of its axes in other orders and senses, those that are turned least.
        best = found[int(np.argmax(flush > flush.max() * (1 - 1e-4)))]
        least = Rotation.from_matrix(best).reduce(right=Rotation.create_group("O"))
        axes = np.round(least.as_matrix(), 14)  # x, y, z to the last bit
    extent = np.ptp(triangles.reshape(-1, 3) @ axes, axis=0)
    return np.roll(axes, -int(np.argmax(np.round(extent / spacing))), axis=1)


def grid_of_parts(
    parts: list[Array], held: list[bool], spacing: float
) -> tuple[Grid, list[ClampPlane]]:
    """Grid around parts (each (f, 3, 3) m) with cells of about `spacing` m, and the planes on which free parts are clamped.

    Knots lie on the faces of the box around the free parts; held ones take more cells. Raises SceneError where it has too many cells.
    """
    most_cells = 20_000_000  # of the box around all parts
    boxes = np.array([[p.reshape(-1, 3).min(0), p.reshape(-1, 3).max(0)] for p in parts])
    still = np.array(held)
    moving = boxes[~still] if not still.all() else boxes
    low = moving[:, 0].min(0)
    high = moving[:, 1].max(0)
    cells = np.maximum(np.round((high - low) / spacing), 1).astype(int)
    size = (high - low) / cells
    below = np.maximum(np.ceil((low - boxes[:, 0].min(0)) / size - ON_PLANE), 0).astype(int)
    above = np.maximum(np.ceil((boxes[:, 1].max(0) - high) / size - ON_PLANE), 0).astype(int)
    count = below + cells + above
    if np.prod(count.astype(float)) > most_cells:
        extent = " x ".join(f"{1e3 * x:.4g}" for x in boxes[:, 1].max(0) - boxes[:, 0].min(0))
        raise SceneError(
            "body.parts",
            found=(
                f"the box around all parts, {extent} mm, has {np.prod(count.astype(float)):.3g}"
                f" cells of {1e3 * spacing:.3g} mm"
            ),
            rule=f"at most {most_cells:.0e} cells are allowed",
            remedy="check the units and positions of the parts, or increase spacing",
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


def _shadow(triangles: Array, low: Array, step: Array, shape: Index) -> Mask:
    """True for points low + step (i, j) of a lattice of this shape that lie in triangles (f, 3, 2) m."""
    out = np.zeros(tuple(shape), bool)
    scaled = (triangles - low) / step
    first = np.maximum(np.ceil(scaled.min(1) - ON_PLANE), 0).astype(int)
    last = np.minimum(np.floor(scaled.max(1) + ON_PLANE), shape - 1).astype(int)
    for k in np.flatnonzero(
        (first <= last).all(1)
    ):  # few: most triangles of a fine mesh hold no point
        i, j = (np.arange(first[k, axis], last[k, axis] + 1) for axis in range(2))
        place = np.stack(np.meshgrid(i, j, indexing="ij"), -1).astype(float)
        sides = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            along = scaled[k, b] - scaled[k, a]
            to = place - scaled[k, a]
            sides.append(along[0] * to[..., 1] - along[1] * to[..., 0])
        inside = (np.stack(sides) >= -ON_PLANE).all(0) | (np.stack(sides) <= ON_PLANE).all(0)
        out[first[k, 0] : last[k, 0] + 1, first[k, 1] : last[k, 1] + 1] |= inside
    return out


def _clamp_planes(
    parts: list[Array],
    boxes: Array,
    still: Mask,
    grid: Grid,
    first: Array,
    last: Array,
) -> list[ClampPlane]:
    """Planes on which the held parts do all of their holding; none where some hold in another way.

    boxes (k, 2, 3): lower and upper corners; still (k,): held; first, last (3,): cells of the free parts' box, last excluded.
    """
    planes: list[ClampPlane] = []
    covered = np.zeros(len(parts), bool)
    slack = TOUCHING_DISTANCE * float(np.ptp(boxes.reshape(-1, 3), axis=0).max())
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
            within = (free[:, :, axis].min(1) < max(at, inner)) & (
                free[:, :, axis].max(1) > min(at, inner)
            )
            near = free[within | (np.abs(free[:, :, axis] - at) < slack).all(1)][:, :, others]
            bases = np.concatenate([p for p, s in zip(parts, mine, strict=True) if s])
            bases = bases[(np.abs(bases[:, :, axis] - at) < slack).all(1)][:, :, others]
            if len(near) and _stands(near, bases, 0.5 * grid.spacing[others]):
                planes.append(
                    ClampPlane(axis, lower, int(first[axis] if lower else last[axis] - 1))
                )
                covered |= mine
    return planes if np.array_equal(covered, still) else []


def part_particles(grid: Grid, parts: list[Array], count: int) -> Particles:
    """Particles of parts (each (f, 3, 3) m), `count` a direction and cell. Sorted by cell, then by part."""
    unit, share = gauss(count)
    cube = np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), -1).reshape(-1, 3)
    weight = np.einsum("i,j,k->ijk", share, share, share).ravel()
    cells = []
    points = []
    volumes = []
    owners = []
    for k, triangles in enumerate(parts):
        cell, moments = cell_moments(triangles, grid)
        points.append(_points(moments, cube))
        volumes.append(moments[:, 0])
        cells.append(cell)
        owners.append(np.full(len(cell), k))
    cell = np.concatenate(cells)
    owner = np.concatenate(owners)
    order = np.lexsort((owner, np.ravel_multi_index(cell.T, grid.cells)))
    cell = cell[order]
    local = np.concatenate(points)[order]
    volume = np.concatenate(volumes)[order] * float(np.prod(grid.spacing))
    position = grid.origin + grid.spacing * (cell[:, None, :] + local)
    each = len(cube)
    return Particles(
        position.reshape(-1, 3),
        (volume[:, None] * weight).ravel(),
        np.repeat(owner[order], each).astype(np.int32),
        np.repeat(cell, each, axis=0).astype(np.int64),
    )


def _centroid_and_covariance(moments: Array) -> tuple[Array, Array]:
    """Centroids (k, 3) and covariances (k, 3, 3) of pieces, from their moments (k, 10)."""
    mean = moments / moments[:, :1]
    centroid = mean[:, 1:4]
    second = mean[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    return centroid, second - centroid[:, :, None] * centroid[:, None, :]


def _points(moments: Array, cube: Array) -> Array:
    """Points (k, q, 3), in cell coordinates, that have the moments (k, 10) of each cell's piece, but for those pulled into the cell."""
    middle, covariance = _centroid_and_covariance(moments)
    centroid = np.clip(middle, 0.0, 1.0)
    values, vectors = np.linalg.eigh(covariance)
    root = np.einsum("kij,kj,klj->kil", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)
    away = np.einsum("kij,qj->kqi", root, cube)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(
            away > 0,
            (1 - centroid)[:, None] / away,
            np.where(away < 0, -centroid[:, None] / away, np.inf),
        )
    pull = np.minimum(room.min(axis=(1, 2)), 1.0)
    return centroid[:, None, :] + pull[:, None, None] * away


def part_errors(particles: Particles, parts: list[Array]) -> NamedNumbers:
    """Largest errors over the parts (each (f, 3, 3) m): of volume, relative; centroid, over the size; second moments, over their trace."""
    errors = np.zeros(3)
    for k, triangles in enumerate(parts):
        mine = particles.segment == k
        p = particles.position[mine]
        v = particles.volume[mine]
        low = triangles.reshape(-1, 3).min(0)
        high = triangles.reshape(-1, 3).max(0)
        _, moments = cell_moments(
            triangles, Grid(low, high - low, (1, 1, 1))
        )  # one cell: the whole mesh
        size = high - low
        volume = moments[0, 0] * size.prod()
        middle, spread = _centroid_and_covariance(moments)
        centroid = low + size * middle[0]
        exact = spread[0] * np.outer(size, size)
        away = p - centroid
        found = np.einsum("p,pi,pj->ij", v, away, away) / v.sum()
        mine_errors = (
            abs(v.sum() / volume - 1),
            np.abs(v @ away / v.sum()).max() / size.max(),
            np.abs(found - exact).max() / np.trace(exact),
        )
        errors = np.maximum(errors, mine_errors)
    return dict(
        zip(("volume_error", "centroid_error", "second_moment_error"), errors.tolist(), strict=True)
    )


def point_weights(grid: Grid, particles: Particles, mine: Mask, point: Array) -> Array:
    """Weights that give a material point's deformed position from those of the particles.

    A displacement that the grid's splines hold is met exactly, wherever the particles determine the splines that the
    point sees, as two a direction and cell do in two cells or more; elsewhere one that is linear in space is, and of
    the others the nearest.

    Parameters
    ----------
    grid : Grid
        Of the undeformed body.
    particles : Particles
        n of them, at their undeformed positions.
    mine : (n,) array of bool
        Those that move with the same nodes as the point.
    point : (3,) array
        The point in the undeformed body, m.

    Returns
    -------
    (n,) array
        Without unit; their sum is 1.
    """
    cells = np.unique(particles.cell[mine], axis=0)
    own = grid.own(point[None], cells[:1])
    place = (own[0] - grid.origin) / grid.spacing
    outside = np.maximum(np.maximum(cells - place, place - cells - 1), 0.0)
    home = cells[np.argmin(np.linalg.norm(outside * grid.spacing, axis=1))]
    near = np.flatnonzero(mine & (np.abs(particles.cell - home) <= 1).all(axis=1))
    seen = _on_nodes(grid, particles.position[near], particles.cell[near], home)
    wanted = _on_nodes(grid, point[None], home[None], home)[0]
    away = (grid.own(particles.position[near], particles.cell[near]) - own) / grid.spacing
    linear = np.column_stack([np.ones(len(near)), away])
    # Exact for what is linear in space, and with what is left free of the weights as near as can be for the splines.
    first = np.linalg.lstsq(linear.T, np.array([1.0, 0.0, 0.0, 0.0]), rcond=None)[0]
    free = np.linalg.qr(linear, mode="complete")[0][:, 4:]
    more = np.linalg.lstsq(seen.T @ free, wanted - seen.T @ first, rcond=None)[0]
    weights = np.zeros(len(mine))
    weights[near] = first + free @ more
    return weights


def _on_nodes(grid: Grid, points: Array, cell: Index, home: Index) -> Array:
    """Values (m, 5^3) of the splines around a cell at points (m, 3) m in cells (m, 3) that are next to it or are it."""
    nodes_seen = 5  # nodes along an axis that the particles of a cell and its neighbors see
    values = grid.splines(points, cell)[0]
    along = np.zeros((len(points), 3, nodes_seen))
    rows = np.arange(len(points))
    for axis in range(3):
        for k in range(3):
            along[rows, axis, cell[:, axis] - home[axis] + 1 + k] = values[:, axis, k]
    return np.einsum("ma,mb,mc->mabc", along[:, 0], along[:, 1], along[:, 2]).reshape(
        len(points), -1
    )


def connected_components(
    touching: Mask, cell: NDArray[np.integer], part: NDArray[np.integer]
) -> Index:
    """Connected component that each particle (n,) is in, from 0.

    touching (parts, parts): which do; cell (n, 3), part (n,): of each particle. Two are connected where they touch and their cells do.
    """
    from scipy.sparse import csgraph  # only for bodies of parts
    from scipy.spatial import cKDTree

    count = len(touching)
    box = (*(np.ptp(cell, axis=0) + 1).tolist(), count)
    full = np.unique(np.ravel_multi_index((*(cell - cell.min(axis=0)).T, part), box))
    *places, of = np.unravel_index(full, box)
    near = np.zeros((count, count), bool)
    pairs = of[
        cKDTree(np.column_stack(places)).query_pairs(1.01, output_type="ndarray")
    ]  # the same cell, or neighbors by a face
    near[pairs[:, 0], pairs[:, 1]] = True
    number = csgraph.connected_components(near & touching, directed=False)[1]
    return np.asarray(np.asarray(number, np.int64)[part])
