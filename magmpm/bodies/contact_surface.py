"""The surface of the undeformed body as points with areas: where it touches obstacles.

Points lie on the edges and corners as well, so that a body rests on these as on its faces. On flat faces they are those of Lobatto's rule
of four points in every cell, exact for quadratic splines (Abramowitz and Stegun, 25.4.32); on rods and meshes a share of a cell apart.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.curves import face_normals
from magmpm.bodies.grid import Grid, each_node, spread
from magmpm.bodies.section_quadrature import Particles
from magmpm.compiled.arrays import Array, Index, Mask


@dataclass(frozen=True)
class SurfacePoints:
    """Points of a surface: position (n, 3) m, area (n,) m^2, and the region (n,) each is of: a part of an assembly, else 0."""

    position: Array
    area: Array
    region: Index


@dataclass(frozen=True)
class ContactSurface:
    """Points on a model's grid: place (n, 3) m in the undeformed body, first (n, 3): node indices, weights (n, 3, 3) of their splines,
    mass (n,) kg of the layers they stand for (`layer_mass`), and a particle (n,) in the cell of each. still: points of held regions, and a
    particle in the cell of each; friction (n,): of their own material (effects.contact_law.own_friction)."""

    place: Array
    first: Index
    weights: Array
    mass: Array
    particle: Index
    still: tuple[Array, Index]
    friction: Array


def layer_mass(
    area: Array, first: Index, weights: Array, mass: Array, nodes: tuple[int, int, int]
) -> Array:
    """Mass (n,) kg of the points' layers, which springs of frequency w push: as thick as can be so that no oscillation is faster than w.

    Springs m_s w^2 at points s on nodes of mass m_i have omega^2 <= w^2 max over s of (A x)_s / x_s for any x > 0, with
    (A x)_s = sum_i N_i(s) (sum_t m_t N_i(t) x_t) / m_i (Collatz and Wielandt: Horn and Johnson, Matrix Analysis, 8.1.26). x = 1 is the
    largest row sum, which edges and corners raise by as much as 1.75; six products come within 6 % of the true frequency. So the layer
    is a quarter to half a cell thick. area (n,) m^2; first, weights: as in ContactSurface; mass: of all nodes, kg.
    """
    products = 6  # further ones thicken the layer by at most 6 %
    share = np.abs(weights)
    x = np.ones(len(area))
    most = 0.0
    for _ in range(products if len(area) else 0):
        covered = spread(area * x, first, nodes, share)
        ratio = np.divide(covered, mass, out=np.zeros_like(mass), where=mass > 0)
        sums = np.zeros(len(area))
        for node, part in each_node(first, nodes, share):
            sums += part * ratio[node]
        most = float(np.divide(sums, x, out=np.zeros_like(x), where=x > 0).max())
        x = sums / sums.max()
    return area / most if len(area) else area


def lobatto(edges: Array) -> tuple[Array, Array]:
    """Points and weights of Lobatto's rule of four points between each two edges (k,), with the edges shared: (3 k - 2,) each."""
    width = np.diff(edges)
    weight = np.array([1.0, 5.0, 5.0, 1.0]) / 12
    share = np.array([0.0, (1 - 1 / math.sqrt(5)) / 2, (1 + 1 / math.sqrt(5)) / 2])
    points = np.append((edges[:-1, None] + width[:, None] * share).ravel(), edges[-1])
    weights = np.zeros(len(points))
    for k in range(4):
        weights[k : len(weights) - 3 + k : 3] += width * weight[k]
    return points, weights


def box_surface(edges: tuple[Array, Array, Array], *, one_wide: bool, base: bool) -> SurfacePoints:
    """Points on a box with cell faces at edges (m) along x, y, z. one_wide: nothing varies along y; base: its lower x face counts, too."""
    rules = [lobatto(each) for each in edges]
    if one_wide:
        rules[1] = (edges[1].mean(keepdims=True), np.ptp(edges[1], keepdims=True))
    faces = []
    for axis in (0, 2) if one_wide else (0, 1, 2):
        others = [rules[k] for k in range(3) if k != axis]
        area = np.outer(others[0][1], others[1][1]).ravel()
        flat = np.stack(np.meshgrid(others[0][0], others[1][0], indexing="ij"), -1).reshape(-1, 2)
        ends = edges[axis][[0, -1]] if base or axis else edges[axis][-1:]
        faces += [(np.insert(flat, axis, end, axis=1), area) for end in ends]
    return _joined(faces)


def rod_surface(
    along: Array, *, outer: float, inner: float, cell: float, base: bool
) -> SurfacePoints:
    """Points on a round rod or tube along +x around the axis; along (k,) m: x of the cell faces; radii and cell m; base: as in box_surface.

    A bore has none: nothing but a body inside could touch it.
    """
    count = 4 * math.ceil(
        8 * 2 * math.pi * outer / cell / 4
    )  # a patch in contact on a hard plane is far narrower than a cell
    angle = 2 * math.pi / count * (np.arange(count) + 0.5)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    (x, dx), (r, dr) = (
        lobatto(along),
        lobatto(np.linspace(inner, outer, math.ceil((outer - inner) / cell) + 1)),
    )
    side = np.column_stack([np.repeat(x, count), np.tile(outer * circle, (len(x), 1))])
    faces = [(side, np.repeat(dx * outer * 2 * math.pi / count, count))]
    ring = (r[:, None, None] * circle).reshape(-1, 2)
    area = np.repeat(r * dr * 2 * math.pi / count, count)
    for end in along[[0, -1]] if base else along[-1:]:
        faces.append((np.insert(ring, 0, end, axis=1)[area > 0], area[area > 0]))
    return _joined(faces)


def cut(triangles: Array, longest: float) -> Array:
    """Triangles (f, 3, 3) m cut at the middle of their longest edge until none exceeds `longest` (m)."""
    while True:
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest * (1 + 1e-9)
        if not long.any():
            return triangles
        first = edges[long].argmax(axis=1)
        a, b, c = (triangles[long][np.arange(len(first)), (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        triangles = np.concatenate(
            [triangles[~long], np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
        )


def mesh_surface(triangles: Array, longest: float) -> tuple[Array, Array]:
    """Corners (n, 3) m of a mesh's triangles (f, 3, 3), cut until no edge exceeds `longest` (m), and a third of their areas (n,) m^2."""
    triangles = cut(triangles, longest)
    area = np.linalg.norm(face_normals(triangles), axis=1) / 2
    corners = triangles.reshape(-1, 3)
    _, one, of = np.unique(
        np.round(corners / (1e-6 * longest)).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    return corners[one], np.asarray(
        np.bincount(of.ravel(), np.repeat(area / 3, 3), len(one)), dtype=float
    )


def parts_surface(parts: list[Array], cell: float) -> SurfacePoints:
    """Points on the surfaces of parts (each (f, 3, 3) m), in cells of this width (m)."""
    longest_edge = 0.5  # of a cell: longest edge of a mesh's triangles, after they are cut
    found = [mesh_surface(triangles, longest_edge * cell) for triangles in parts]
    return _joined(found, np.repeat(np.arange(len(found)), [len(area) for _, area in found]))


def _joined(faces: list[tuple[Array, Array]], region: Index | None = None) -> SurfacePoints:
    position = np.concatenate([face[0] for face in faces])
    area = np.concatenate([face[1] for face in faces])
    return SurfacePoints(
        position, area, np.zeros(len(area), np.int64) if region is None else region
    )


def well_filled(particles: Particles, region: NDArray[np.integer]) -> Mask:
    """Select particles (n,) in cells that are no slivers beside the fullest cell of their region (n,).

    The outer nodes of a sliver are so light that they tell nothing: just beyond its face they move by more than the body does.
    The splines of the next cell go on through it (extended B-splines: Hoellig, Reif, Wipper, SIAM J. Numer. Anal. 39 (2001) 442).
    """
    # of the fullest cell: from 1e-5 to 1e-3 contact gained energy, up to 19 % of a collision at 2 m/s
    sliver = 0.01
    _, cell = np.unique(np.column_stack([region, particles.cell]), axis=0, return_inverse=True)
    filled = np.bincount(cell.ravel(), particles.volume)[cell.ravel()]
    fullest = np.zeros(region.max() + 1)
    np.maximum.at(fullest, region, filled)
    return np.asarray(filled > sliver * fullest[region])


def particle_of(
    points: SurfacePoints,
    grid: Grid,
    particles: Particles,
    region: NDArray[np.integer],
    chosen: Mask,
) -> Index:
    """A particle (n,) whose cell's splines move each point: of its region, in the cell that the point lies in or borders, or the nearest.

    region, chosen (particles,): region of each particle, and whether its cell may move points.
    """
    from scipy.spatial import cKDTree  # imported only where it is used

    found = np.empty(len(points.area), np.int64)
    for one in np.unique(points.region):
        on = points.region == one
        mine = np.flatnonzero((region == one) & chosen)
        nearest = mine[cKDTree(particles.position[mine]).query(points.position[on])[1]]
        inward = 1e-6 * (particles.position[nearest] - points.position[on])
        inside = grid.own(points.position[on] + inward, particles.cell[nearest]) - grid.origin
        own = np.column_stack(
            [
                grid.cell_along(inside[:, 0]),
                np.floor(inside[:, 1:] / grid.spacing[1:]).astype(np.int64),
            ]
        )
        if grid.nodes[1] == grid.cells[1]:  # around a tube
            own[:, 1] %= grid.cells[1]
        own = np.clip(own, 0, np.array(grid.cells) - 1)
        number, filled = (
            np.ravel_multi_index(each.T, grid.cells) for each in (own, particles.cell[mine])
        )
        cells, first = np.unique(filled, return_index=True)
        at = np.minimum(np.searchsorted(cells, number), len(cells) - 1)
        found[on] = np.where(cells[at] == number, mine[first[at]], nearest)
    return found
