"""Shapes to particles: quadrature points of the undeformed body whose volume and section moments are exact.

What a grid cell holds of the body gets its own quadrature rule: tensor-product Gauss points, shifted and scaled so that volume, centroid
and second moments are exact. In a cell that the body fills, this is the Gauss rule itself. So the section's area and second moments
are exact to rounding for any cell size. A regular lattice of particles gives a disk of 4 mm, spacing 0.5 mm, moments 2 to 5 % wrong.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import EVEN, Grid, Knots, runs_along
from magmpm.compiled.arrays import Array, Index, NamedNumbers


@dataclass(frozen=True)
class Particles:
    """Quadrature points of the undeformed body, sorted by cell (x slowest).

    position (n, 3) m, volume (n,) m^3, segment (n,) index of the segment, cell (n, 3) index of the grid cell; box (n, 3): where cells are
    no boxes, the index of the cubic cell that each would be in.
    """

    position: Array
    volume: Array
    segment: NDArray[np.int32]
    cell: Index
    box: Index | None = None

    @cached_property
    def cell_first(self) -> Index:
        """First particle of each cell, and the end (cells + 1,). A cell that two regions share counts as two: each has one material."""
        new = np.any(np.diff(self.cell, axis=0) != 0, axis=1) | (np.diff(self.segment) != 0)
        return np.concatenate([[0], np.flatnonzero(new) + 1, [len(self.cell)]]).astype(np.int64)


@cache
def _legendre(count: int) -> tuple[Array, Array]:
    """Points and weights of Gauss and Legendre: nobody changes them."""
    return np.polynomial.legendre.leggauss(count)


def gauss(count: int) -> tuple[Array, Array]:
    """Gauss-Legendre points scaled to mean 0 and variance 1, and weights that sum to 1. A variance of 1 needs count >= 2."""
    points, weights = _legendre(count)
    return points * np.sqrt(3.0), weights / 2


def disk_moments(low: Array, high: Array, radius: float) -> Array:
    """Moments of a disk cut by rectangles: integrals of 1, y, z, y^2, y z, z^2 over each piece.

    low, high (n, 2) m: corners of the rectangles; radius m, disk centered at 0. Returns (n, 6).
    The integral over z is analytical. With y = radius sin t, the integrand over t is a trigonometric polynomial between the points
    where the circle crosses an edge; 12 Gauss points integrate it to rounding.
    """
    if radius == 0.0:
        return np.zeros((len(low), 6))
    lo = np.clip(low, -radius, radius)
    hi = np.clip(high, -radius, radius)
    # A power of a float and one of an array may differ in the last bit: at the circle's edge their difference may be below zero.
    cross = [np.sqrt(np.maximum(radius**2 - edge[:, 1] ** 2, 0.0)) for edge in (lo, hi)]
    ends = np.stack([lo[:, 0], hi[:, 0], cross[0], -cross[0], cross[1], -cross[1]], axis=1)
    ends = np.sort(np.clip(ends, lo[:, :1], hi[:, :1]), axis=1)
    angle = np.arcsin(np.clip(ends / radius, -1, 1))
    point, weight = _legendre(12)
    half = np.diff(angle, axis=1)[..., None] / 2
    t = (angle[:, 1:] + angle[:, :-1])[..., None] / 2 + half * point
    y = radius * np.sin(t)
    c = radius * np.cos(t)
    z1 = np.minimum(hi[:, 1, None, None], c)
    z0 = np.minimum(np.maximum(lo[:, 1, None, None], -c), z1)
    dy = half * weight * c
    powers = [(z1 ** (k + 1) - z0 ** (k + 1)) / (k + 1) for k in range(3)]
    terms = (powers[0], y * powers[0], powers[1], y * y * powers[0], y * powers[1], powers[2])
    return np.stack([np.sum(term * dy, axis=(1, 2)) for term in terms], axis=1)


def section_points(
    low: Array, high: Array, outer: float, inner: float, count: int
) -> tuple[Array, Array, Index]:
    """Quadrature of a ring cut by rectangles, exact for polynomials up to degree 2.

    low, high (n, 2) m: the rectangles; outer, inner: radii in m; count: points per direction and cell.
    Returns points (k, 2) m, areas (k,) m^2 and the rectangle (k,) that each point belongs to; empty rectangles get no points.
    """
    owner = np.arange(len(low))
    depth = 0
    found: list[tuple[Array, Array, Index]] = []
    # less is rounding error
    cells = (low, high)
    least = 1e-9 * float(np.prod(high - low, axis=1).max())
    while len(low):
        piece, points, areas = _piece_rules(low, high, outer, inner, count, least)
        a = cells[0][owner[piece]]
        b = cells[1][owner[piece]]
        if depth == 6:  # halvings of a cell's side
            points = np.clip(points, a[:, None, :], b[:, None, :])
        slack = 1e-9 * (b - a)[:, None, :]
        inside = np.all(
            (points >= a[:, None] - slack) & (points <= b[:, None] + slack), axis=(1, 2)
        )
        home = np.repeat(owner[piece[inside]], areas.shape[1])
        found.append((points[inside].reshape(-1, 2), areas[inside].ravel(), home))
        # Points of a very skew piece (a thin wall) may leave the cell: try the 2-point rule first, then cut the piece in quarters.
        bad = piece[~inside]
        if count > 2:
            low = low[bad]
            high = high[bad]
            owner = owner[bad]
            count = 2
        else:
            low, high, owner = _quarters(low[bad], high[bad], owner[bad])
            depth += 1
    points, areas, home = (np.concatenate([f[k] for f in found]) for k in range(3))
    order = np.argsort(home, kind="stable")
    return points[order], areas[order], home[order]


def _piece_rules(
    low: Array, high: Array, outer: float, inner: float, count: int, least: float
) -> tuple[Index, Array, Array]:
    """Indices (k,) of the rectangles that hold at least `least` m^2 of material; their points (k, count^2, 2), areas (k, count^2)."""
    moments = disk_moments(low, high, outer) - disk_moments(low, high, inner)
    keep = np.flatnonzero(moments[:, 0] > least)
    area = moments[keep, 0]
    centroid = moments[keep, 1:3] / area[:, None]
    yy, yz, zz = (moments[keep, 3:] / area[:, None]).T
    a = yy - centroid[:, 0] ** 2
    b = yz - centroid[:, 0] * centroid[:, 1]
    d = zz - centroid[:, 1] ** 2
    det = np.sqrt(np.maximum(a * d - b * b, 0.0))
    root = np.stack(
        [np.stack([a + det, b], -1), np.stack([b, d + det], -1)], -2
    )  # root of the covariance matrix
    root /= np.sqrt(np.maximum(a + d + 2 * det, np.finfo(float).tiny))[:, None, None]
    unit, weight = gauss(count)
    grid = np.stack(np.meshgrid(unit, unit, indexing="ij"), -1).reshape(-1, 2)
    points = centroid[:, None, :] + np.einsum("cij,qj->cqi", root, grid)
    return keep, points, area[:, None] * np.outer(weight, weight).ravel()


def _quarters(low: Array, high: Array, owner: Index) -> tuple[Array, Array, Index]:
    """Each rectangle cut into four, with the owner repeated."""
    half = (high - low) / 2
    corners = [low + half * np.array(c) for c in ((0, 0), (0, 1), (1, 0), (1, 1))]
    starts = np.concatenate(corners)
    return starts, starts + np.tile(half, (4, 1)), np.tile(owner, 4)


def rod_grid(
    ends: Array,
    diameter: float,
    cells_across: int,
    shift: tuple[float, float] = (0.0, 0.0),
    knots: Knots = EVEN,
) -> Grid:
    """Grid of a straight rod along +x, base at the origin: knots on both end faces, on joints, and on the box around the section.

    ends (k,) m: where each segment ends, the last one at the tip; shift: parts of a cell, 0 to 1, by which the grid lies lower along y and
    z, with one more cell there: to see what the grid's place does.
    """
    h = diameter / cells_across
    origin = np.array([0.0, -diameter / 2 - shift[0] * h, -diameter / 2 - shift[1] * h])
    across, high = (cells_across + int(part > 0.0) for part in shift)
    along, width, runs = runs_along(ends, h, cells_across, knots)
    return Grid(origin, np.array([width, h, h]), (along, across, high), runs)


def rod_particles(
    grid: Grid, *, outer: float, inner: float, segment_ends: Array, particles_per_cell: int
) -> Particles:
    """Particles of a straight round rod or tube along +x.

    outer, inner: radii in m; segment_ends (k,) m: where each segment ends, the last one at the tip;
    particles_per_cell: points a direction and cell (at least 2). A cell that two segments share is cut between them.
    """
    index, (points, areas, rectangle) = rod_section(
        grid, outer=outer, inner=inner, particles_per_cell=particles_per_cell
    )
    return extruded(grid, index, points, areas, rectangle, segment_ends, particles_per_cell)


def _cells_across(grid: Grid) -> Index:
    """Numbers (r, 2) along y and z of a section's cells."""
    _, ny, nz = grid.cells
    return np.stack(np.meshgrid(np.arange(ny), np.arange(nz), indexing="ij"), -1).reshape(-1, 2)


def rod_section(
    grid: Grid, *, outer: float, inner: float, particles_per_cell: int
) -> tuple[Index, tuple[Array, Array, Index]]:
    """Cells (r, 2) of a round section's grid, and the `section_points` of the section in them."""
    index = _cells_across(grid)
    low = grid.origin[1:] + index * grid.spacing[1:]
    return index, section_points(low, low + grid.spacing[1:], outer, inner, particles_per_cell)


def extruded(
    grid: Grid,
    index: Index,
    points: Array,
    areas: Array,
    rectangle: Index,
    segment_ends: Array,
    count: int,
) -> Particles:
    """Particles of a body with the same section all along +x: section points times Gauss points of each piece of the length.

    index (r, 2): cell of each rectangle of the section; points (k, 2) m, areas (k,) m^2, rectangle (k,): the section's rule;
    segment_ends (s,) m: x of each segment's end; count: points along x and cell.
    """
    faces = grid.origin[0] + grid.faces
    near = (
        np.abs(faces[:, None] - segment_ends[None, :]) < 1e-9 * grid.spacing[0]
    )  # a segment end on a face is that face
    ends = np.where(near.any(0), faces[near.argmax(0)], segment_ends)
    cuts = np.unique(np.concatenate([faces, ends]))
    unit, weight = gauss(count)
    width = np.diff(cuts)
    middle = (cuts[1:] + cuts[:-1]) / 2
    x = (middle[:, None] + width[:, None] * unit / np.sqrt(12.0)).ravel()
    dx = (width[:, None] * weight).ravel()
    cell_x = np.repeat(np.searchsorted(faces, middle) - 1, count)
    segment = np.repeat(np.searchsorted(ends, middle), count)

    # One row for each (section rectangle, axial point, section point), in that order within an axial cell.
    ix, iq = (i.ravel() for i in np.indices((len(x), len(points))))
    order = np.lexsort((iq, ix, rectangle[iq], cell_x[ix]))
    ix = ix[order]
    iq = iq[order]
    position = np.column_stack([x[ix], points[iq]])
    cell = np.column_stack([cell_x[ix], index[rectangle[iq]]])
    return Particles(
        position, dx[ix] * areas[iq], segment[ix].astype(np.int32), cell.astype(np.int64)
    )


def strip_grid(
    base: Array,
    size: Array,
    ends: Array,
    cells_across: int,
    *,
    one_wide: bool = False,
    knots: Knots = EVEN,
) -> Grid:
    """Grid of a strip: knots on all its faces and joints. base (3,) m: center of the base face; size (3,) m: length, width, thickness;
    ends (k,) m: where each segment ends, from the base.

    Cells are cubes within rounding of the length, but up to twice as long along a width that is many cells: what bends
    varies fast along the length and the thickness, not across. one_wide: a single cell across the width (plane strain).
    """
    # a strip's cells may be this much longer across its width than through its thickness
    widest_cell = 2.0
    h = size[2] / cells_across
    along, width, runs = runs_along(ends, h, cells_across, knots)
    wide = (
        1
        if one_wide
        else max(
            round(size[1] / h)
            if size[1] < 2 * size[2]
            else int(np.ceil(size[1] / (widest_cell * h))),
            2,
        )
    )
    cells = (along, wide, cells_across) if knots.like is None else knots.like.cells
    spacing = np.array([width, *(size[1:] / np.array(cells[1:]))])
    return Grid(base - np.array([0.0, size[1] / 2, size[2] / 2]), spacing, cells, runs)


def strip_particles(
    grid: Grid, *, segment_ends: Array, particles_per_cell: int, one_wide: bool = False
) -> Particles:
    """Particles of the strip that fills a grid: Gauss points of every cell, one across the width where nothing varies along it.

    segment_ends (k,) m: x of each segment's end. A cell that two segments share is cut between them.
    """
    index = _cells_across(grid)
    middle = grid.origin[1:] + (index + 0.5) * grid.spacing[1:]
    rules = [
        (np.zeros(1), np.ones(1)) if one_wide else gauss(particles_per_cell),
        gauss(particles_per_cell),
    ]
    unit = np.stack(np.meshgrid(rules[0][0], rules[1][0], indexing="ij"), -1).reshape(
        -1, 2
    ) / np.sqrt(12.0)
    share = np.outer(rules[0][1], rules[1][1]).ravel()
    points = (middle[:, None, :] + unit * grid.spacing[1:]).reshape(-1, 2)
    areas = np.tile(share * np.prod(grid.spacing[1:]), len(index))
    rectangle = np.repeat(np.arange(len(index)), len(share))
    return extruded(grid, index, points, areas, rectangle, segment_ends, particles_per_cell)


def strip_errors(particles: Particles, size: Array) -> NamedNumbers:
    """Relative errors of a strip's section: area, and second moment about y, against b t and b t^3/12. size (3,) m."""
    area = size[1] * size[2]
    z = particles.position[:, 2]
    v = particles.volume / size[0]
    z = z - (v * z).sum() / v.sum()
    return {
        "area_error": float(abs(v.sum() / area - 1)),
        "second_moment_error": float(abs((v * z * z).sum() / (area * size[2] ** 2 / 12) - 1)),
    }


def section_errors(
    particles: Particles, *, outer: float, inner: float, length: float
) -> NamedNumbers:
    """Relative errors of the particles' section: area and the two second moments against pi (R^2 - r^2) and pi/4 (R^4 - r^4)."""
    area = np.pi * (outer**2 - inner**2)
    moment = np.pi / 4 * (outer**4 - inner**4)
    _, y, z = particles.position.T
    areas = particles.volume / length
    return {
        "area_error": float(abs(areas.sum() / area - 1)),
        "second_moment_error": float(
            max(abs((areas * y * y).sum() / moment - 1), abs((areas * z * z).sum() / moment - 1))
        ),
    }
