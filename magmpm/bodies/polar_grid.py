"""The grid of a tube: cells around its axis, in layers through its wall.

Its axes are x, the angle and the radius. The angle goes from y toward -z, so that they are right-handed. Along x and the radius the splines
are those of bodies.grid. Around, they are trigonometric: on each cell 1, the cosine and the sine of the angle stand for the three
polynomials, with the same values and as smooth. Times a radius they hold y and z: rigid motion and uniform strain of a section are exact.
A thin wall that flattens is bent, not stretched. Splines across the section can't follow that in cells thicker than the wall, and lock.
Source: Schoenberg, J. Math. Mech. 13 (1964) 795; Lyche and Winther, J. Approx. Theory 25 (1979) 266 (trigonometric B-splines).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.grid import Grid, Knots, Run, runs_along, spline_weights
from magmpm.bodies.section_quadrature import Particles, extruded, gauss
from magmpm.compiled.arrays import Array, Index


@dataclass(frozen=True)
class PolarGrid(Grid):
    """Cells along x, around and through the wall. origin, spacing: x and radius m, angle rad; even: uncut at the base."""

    even: Grid | None = None

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Number of spline nodes along its axes; around there are no ends."""
        along, _, through = super().nodes
        return along, self.cells[1], through

    def section_nodes(self, node: Index) -> Array:
        """The coefficients of the places themselves, y and z, (k, 2) m: outside of the circle that they stand for."""
        angle = self.origin[1] + self.spacing[1] * (node[:, 0] - 0.5)
        radius = self.node_coordinates(2)[node[:, 1]] / np.cos(self.spacing[1] / 2)
        return np.column_stack([radius * np.cos(angle), -radius * np.sin(angle)])

    def axes_at(self, points: Array) -> Array:
        """The directions of its axes at points (n, 3) m, in columns, (n, 3, 3)."""
        axes = np.zeros((len(points), 3, 3))
        outward = points[:, 1:] / np.hypot(points[:, 1], points[:, 2])[:, None]
        axes[:, 0, 0] = 1.0
        axes[:, 1, 1], axes[:, 2, 1] = outward[:, 1], -outward[:, 0]
        axes[:, 1:, 2] = outward
        return axes

    def section_splines(self, points: Array) -> tuple[Index, Array]:
        """First nodes (q, 2) and values (q, 2, 3) of the splines across a section at points (q, 2) m of it."""
        turn = np.arctan2(-points[:, 1], points[:, 0]) - self.origin[1]
        scaled = (
            np.column_stack([turn % (2 * np.pi), np.hypot(*points.T) - self.origin[2]])
            / self.spacing[1:]
        )
        cell = np.clip(np.floor(scaled + 1e-12).astype(int), 0, np.array(self.cells[1:]) - 1)
        xi = scaled - cell
        return cell, np.stack([self._around(xi[:, 0])[0], spline_weights(xi[:, 1])], axis=1)

    def splines(self, points: Array, cell: Index) -> tuple[Array, Array]:
        """Values and slopes (1/m) of the three splines that points (n, 3) m in these cells (n, 3) see along each axis, (n, 3, 3)."""
        weights, slopes = super().splines(points, cell)
        weights[:, 1], turned = self._around(self.locate(points, cell)[:, 1])
        slopes[:, 1] = turned / np.hypot(points[:, 1], points[:, 2])[:, None]
        return weights, slopes

    def own(self, points: Array, cell: Index) -> Array:
        """x, angle and radius (n, 3) of points (n, 3) m. Of the angles that differ by full turns, the one nearest to the cell (n, 3)."""
        middle = self.origin[1] + self.spacing[1] * (cell[:, 1] + 0.5)
        turn = np.arctan2(-points[:, 2], points[:, 1]) - middle
        return np.column_stack(
            [
                points[:, 0],
                middle + (turn + np.pi) % (2 * np.pi) - np.pi,
                np.hypot(points[:, 1], points[:, 2]),
            ]
        )

    def _around(self, xi: Array) -> tuple[Array, Array]:
        """Values and slopes (1/rad) of the three splines around at positions (q,) in a cell, 0 to 1; both (q, 3)."""
        width = self.spacing[1]
        scale = 0.5 / np.sin(self.spacing[1] / 2) ** 2
        before = width * (1.0 - xi)
        after = width * xi
        low = scale * np.sin(before / 2) ** 2
        high = scale * np.sin(after / 2) ** 2
        down = -scale / 2 * np.sin(before)
        up = scale / 2 * np.sin(after)
        return np.stack([low, 1.0 - low - high, high], axis=-1), np.stack(
            [down, -down - up, up], axis=-1
        )


def tube_grid(
    ends: Array, outer: float, inner: float, cells_across: int, knots: Knots, turn: float = 0.0
) -> PolarGrid:
    """Grid of a tube along +x. ends (k,) m: where each segment ends, the last one at the tip; outer, inner: radii, m; turn: part of a cell,
    0 to 1, by which the grid is turned: to see what its place does."""
    # The thickest cell through a wall is 0.8 of a cell's width along: one alone, where half a radius bends sharply, is 0.1 to 0.3 % off.
    h = 2 * outer / cells_across
    wall = outer - inner
    like = knots.like
    if isinstance(like, PolarGrid):
        _, around, through = like.cells
        knots = replace(knots, like=like.even)
    else:
        around = 2 * max(4, round(3.0 * (cells_across * (outer + inner) / (2 * wall)) ** (1 / 3)))
        through = math.ceil(wall / (0.8 * h) - 1e-9)
    along, width, runs = runs_along(ends, h, cells_across, knots)
    spacing = np.array([width, 2 * np.pi / around, wall / through])
    even = Grid(np.array([0.0, turn * spacing[1], inner]), spacing, (along, around, through), runs)
    fine = _finer_at_base(runs or (Run(0.0, width, along),))
    spacing = np.array([min(run.width for run in fine), *spacing[1:]])
    return PolarGrid(
        even.origin, spacing, (sum(run.cells for run in fine), around, through), fine, even
    )


def _finer_at_base(runs: tuple[Run, ...]) -> tuple[Run, ...]:
    """The first cell cut in two quarters and a half: there a clamp keeps the section round and its stress is singular at two rims."""
    first, *others = runs
    width = first.width
    rest = first.cells - 1
    cut = [Run(0.0, width / 4, 2), Run(width / 2, width / 2, 1), Run(width, width, rest)]
    return (*(cut if rest else cut[:2]), *others)


def tube_particles(
    grid: PolarGrid,
    *,
    outer: float,
    segment_ends: Array,
    cells_across: int,
    particles_per_cell: int,
) -> Particles:
    """Particles of a tube: Gauss points of every cell. Area and second moments are exact: over equal cells harmonics sum to zero.

    outer: radius, m; segment_ends (k,) m: where each segment ends; particles_per_cell: points a direction and cell (at least 2).
    """
    _, around, through = grid.cells
    index = np.stack(np.meshgrid(np.arange(around), np.arange(through), indexing="ij"), -1).reshape(
        -1, 2
    )
    unit, weight = gauss(particles_per_cell)
    within = np.stack(np.meshgrid(unit, unit, indexing="ij"), -1).reshape(-1, 2) / np.sqrt(12.0)
    place = (grid.origin[1:] + grid.spacing[1:] * (index[:, None] + 0.5 + within)).reshape(-1, 2)
    angle, radius = place.T
    areas = (
        np.tile(np.outer(weight, weight).ravel() * np.prod(grid.spacing[1:]), len(index)) * radius
    )
    points = np.column_stack([radius * np.cos(angle), -radius * np.sin(angle)])
    owner = np.repeat(np.arange(len(index)), len(weight) ** 2)
    made = extruded(grid, index, points, areas, owner, segment_ends, particles_per_cell)
    boxes = np.floor((made.position[:, 1:] / outer + 1.0) * cells_across / 2).astype(np.int64)
    return Particles(
        made.position,
        made.volume,
        made.segment,
        made.cell,
        np.column_stack([made.cell[:, 0], boxes]),
    )
