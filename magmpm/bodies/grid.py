"""The grid in the undeformed body and its quadratic B-splines.

A grid is a box of cells. Along each axis, cell i carries the three uniform quadratic B-splines of nodes i, i+1 and i+2
(node i is centered on cell i - 1), so that n cells have n + 2 nodes. Knots lie on the cell faces, where a body's flat faces are put.
Along x the cells may form several runs of equal width (Run). Each repeated knot between two runs brings one more node, on it.
Source: de Boor, A Practical Guide to Splines; for the role in MPM, Steffen, Kirby, Berzins, IJNME 76 (2008).

A straight body has equal cells along it, in runs between the places where its stiffness jumps. Where two materials meet, the strain jumps.
Splines follow it if a cell face lies there and the knot is repeated: then the displacement stays continuous and its slope may jump. Errors
of jointed bodies fall with the square of the cell size in this way, and only with the cell size without it (docs/accuracy.md).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from magmpm.compiled.arrays import Array, Index


def spline_weights(xi: Array, ends: Array | float = 0.5) -> Array:
    """Values of the three quadratic B-splines of a cell.

    xi: (...) position within the cell, 0 to 1; ends (..., 2): values of the first spline on the lower face and of the last one on the
    upper face: the cell's share of the two cells that meet there, and 1 on a repeated knot. Returns (..., 3), a partition of unity.
    """
    lower, upper = _both(ends)
    return np.stack(
        [
            lower * (1.0 - xi) ** 2,
            (1.0 - lower) + xi * (2.0 * lower - (lower + upper) * xi),
            upper * xi**2,
        ],
        axis=-1,
    )


def spline_slopes(xi: Array, ends: Array | float = 0.5) -> Array:
    """Derivatives of ``spline_weights`` with respect to xi. Returns (..., 3); divide by the cell size for 1/m."""
    lower, upper = _both(ends)
    return np.stack(
        [2.0 * lower * (xi - 1.0), 2.0 * lower - 2.0 * (lower + upper) * xi, 2.0 * upper * xi],
        axis=-1,
    )


def _both(ends: Array | float) -> tuple[Array, Array]:
    given = np.asarray(ends)
    return (given, given) if given.ndim == 0 else (given[..., 0], given[..., 1])


def clamp_first_node(weights: Array, slopes: Array) -> tuple[Array, Array]:
    """Splines of the first cell of an axis when the displacement is zero on that cell's lower face.

    On the face the two splines of nodes 0 and 1 are both 1/2, and node 2's is 0: the face is at rest, all of it and nothing more,
    exactly when node 0's coefficient is minus node 1's. Node 0 is eliminated by that rule, and the stencil moves up by one:
    the returned (..., 3) values and slopes belong to nodes 1, 2 and 3 (node 3's are 0).
    """
    zero = np.zeros_like(weights[..., 0])
    moved = [np.stack([v[..., 1] - v[..., 0], v[..., 2], zero], axis=-1) for v in (weights, slopes)]
    return moved[0], moved[1]


def clamp_last_node(weights: Array, slopes: Array, *, moved: bool = False) -> tuple[Array, Array]:
    """Splines of the last cell of an axis when the displacement is given on that cell's upper face: 0, or, where moved, the last node's.

    As ``clamp_first_node`` mirrored. What is left of the last node is the face's displacement, with twice the spline; the stencil stays.
    """
    own = [2.0 * v[..., 2] if moved else np.zeros_like(v[..., 0]) for v in (weights, slopes)]
    clamped = [
        np.stack([v[..., 0], v[..., 1] - v[..., 2], one], axis=-1)
        for v, one in zip((weights, slopes), own, strict=True)
    ]
    return clamped[0], clamped[1]


def clamp_low_node(weights: Array, slopes: Array, *, moved: bool = False) -> tuple[Array, Array]:
    """Splines of a cell when the displacement is given on its lower face: the mirror image of ``clamp_last_node``."""
    flipped = clamp_last_node(weights[..., ::-1], slopes[..., ::-1], moved=moved)
    return flipped[0][..., ::-1], flipped[1][..., ::-1]


def each_node(
    first: Index, nodes: tuple[int, int, int], weights: Array
) -> Iterator[tuple[Index, Array]]:
    """The number (n,) in the whole grid, x slowest, of each of the 27 nodes that points see, and its weight (n,) there.

    first (n, 3): of the first ones; nodes: of the grid along x, y, z; weights (n, 3, 3): of the splines along each axis.
    """
    for a, b, c in product(range(3), repeat=3):
        node = np.ravel_multi_index(
            (first + np.array([a, b, c])).T, nodes, mode=("clip", "wrap", "clip")
        )  # wrap: around a tube
        yield node, weights[:, 0, a] * weights[:, 1, b] * weights[:, 2, c]


def spread(values: Array, first: Index, nodes: tuple[int, int, int], weights: Array) -> Array:
    """Sums (nodes,) over points of their values (n,) times their weights at each node of the whole grid; others as in `each_node`."""
    count = int(np.prod(nodes))
    return np.asarray(
        sum(
            np.bincount(node, values * share, count)
            for node, share in each_node(first, nodes, weights)
        )
    )


@dataclass(frozen=True)
class Run:
    """Equal cells along x: start m from the grid's lower face, width m, and their number. after: the segment that ends where the run
    begins, with a repeated knot; None: the run goes on smoothly from the one before, or is the first.
    """

    start: float
    width: float
    cells: int
    after: int | None = None


@dataclass(frozen=True)
class Spans:
    """The cells along x, each (cells,): start and width m of its run, index in it, first node, and ends (cells, 2) of its splines."""

    start: Array
    width: Array
    index: Index
    node: Index
    ends: Array

    def at(self, share: Array, cell: Index) -> Array:
        """Distances (m) from the grid's lower face of places within cells, 0 to 1."""
        return np.asarray(self.start[cell] + self.width[cell] * (self.index[cell] + share))


@dataclass(frozen=True)
class Grid:
    """A box of cells.

    origin (3,) m: lower corner; spacing (3,) m: of cells, along x the smallest; cells: number along x, y, z; runs: of equal ones, or none.
    """

    origin: Array
    spacing: Array
    cells: tuple[int, int, int]
    runs: tuple[Run, ...] = ()

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Number of spline nodes along x, y, z: two more than cells, and one for each repeated knot."""
        return (
            self.cells[0] + 2 + sum(run.after is not None for run in self.runs),
            self.cells[1] + 2,
            self.cells[2] + 2,
        )

    @cached_property
    def along(self) -> Spans:
        """The cells along x."""
        runs = self.runs or (Run(0.0, float(self.spacing[0]), self.cells[0]),)
        count = [run.cells for run in runs]
        width = np.repeat([run.width for run in runs], count)
        repeated = np.array([run.after is not None for run in runs])
        ends = np.full((self.cells[0], 2), 0.5)
        for first, jumps in zip(np.cumsum(count)[:-1], repeated[1:], strict=True):
            both = width[first - 1] + width[first]
            ends[first, 0], ends[first - 1, 1] = (
                (1.0, 1.0) if jumps else (width[first] / both, width[first - 1] / both)
            )
        return Spans(
            start=np.repeat([run.start for run in runs], count),
            width=width,
            index=np.concatenate([np.arange(run.cells) for run in runs]),
            node=np.arange(self.cells[0]) + np.repeat(np.cumsum(repeated), count),
            ends=ends,
        )

    @property
    def faces(self) -> Array:
        """x (cells + 1,) m of the cells' faces, from the grid's lower face."""
        spans = self.along
        return np.append(
            spans.start + spans.width * spans.index,
            spans.start[-1] + spans.width[-1] * (spans.index[-1] + 1),
        )

    @property
    def stations(self) -> Array:
        """x (2 cells + 1,) m of the cells' faces and middles, from the grid's lower face."""
        runs = self.runs or (Run(0.0, float(self.spacing[0]), self.cells[0]),)
        parts = [
            np.linspace(run.start, run.start + run.width * run.cells, 2 * run.cells + 1)
            for run in runs
        ]
        return np.concatenate([*(part[:-1] for part in parts[:-1]), parts[-1]])

    def node_coordinates(self, axis: int) -> Array:
        """Centers (m) of the splines along one axis, (nodes,): where a coefficient acts most (Greville points)."""
        if axis > 0 or not self.runs:
            return self.origin[axis] + self.spacing[axis] * (np.arange(self.nodes[axis]) - 0.5)
        middles = [run.start + run.width * (np.arange(run.cells) + 0.5) for run in self.runs]
        joints = [[] if run.after is None else [run.start] for run in self.runs]
        inside = [place for pair in zip(joints, middles, strict=True) for place in pair]
        first = self.runs[0]
        last = self.runs[-1]
        return self.origin[0] + np.concatenate(
            [[-first.width / 2], *inside, [last.start + last.width * (last.cells + 0.5)]]
        )

    def section_nodes(self, node: Index) -> Array:
        """Coefficients (k, 2) m of the second and third coordinates themselves: of the nodes of a plane with these indices (k, 2)."""
        return np.column_stack(
            [self.node_coordinates(1)[node[:, 0]], self.node_coordinates(2)[node[:, 1]]]
        )

    def axes_at(self, points: Array) -> Array:
        """The directions of its axes, in columns: (3, 3), or (n, 3, 3) where they differ between points (n, 3) m."""
        return np.eye(3)

    @property
    def node_widths(self) -> Array:
        """Width (nodes,) m of the cell each spline along x is centered on, 0 on a repeated knot. Neighbors are half their sum apart."""
        widths = np.zeros(self.nodes[0])
        widths[self.along.node + 1] = self.along.width
        widths[[0, -1]] = self.along.width[[0, -1]]
        return widths

    def splines_along(self, x: Array) -> tuple[Index, Array, Array]:
        """First node (m,), values (m, 3) and slopes (m, 3) 1/m of the splines along x at distances x (m,) m from the lower face."""
        cell = self.cell_along(x)
        spans = self.along
        xi = (x - spans.start[cell]) / spans.width[cell] - spans.index[cell]
        ends = spans.ends[cell]
        return (
            spans.node[cell],
            spline_weights(xi, ends),
            spline_slopes(xi, ends) / spans.width[cell, None],
        )

    def matrix_along(self, x: Array) -> Array:
        """Values (m, nodes) of all splines along x at distances x (m,) m from the lower face."""
        node, values, _ = self.splines_along(x)
        out = np.zeros((len(x), self.nodes[0]))
        for a in range(3):
            out[np.arange(len(x)), node + a] += values[:, a]
        return out

    def cell_along(self, x: Array) -> Index:
        """The cell (m,) along x of each distance x (m,) m from the lower face; the outermost cells go on beyond the grid."""
        if self.runs:
            return np.clip(
                np.searchsorted(self.faces, x + 1e-12 * self.spacing[0], side="right") - 1,
                0,
                self.cells[0] - 1,
            )
        return np.clip(np.floor(x / self.spacing[0] + 1e-12).astype(int), 0, self.cells[0] - 1)

    def section_splines(self, points: Array) -> tuple[Index, Array]:
        """First nodes (q, 2) and values (q, 2, 3) of the splines across a section at points (q, 2) m of it."""
        scaled = (points - self.origin[1:]) / self.spacing[1:]
        cell = np.clip(np.floor(scaled + 1e-12).astype(int), 0, np.array(self.cells[1:]) - 1)
        return cell, spline_weights(scaled - cell)

    def splines(self, points: Array, cell: Index) -> tuple[Array, Array]:
        """Values and slopes (1/m) of the three splines that points (n, 3) m in these cells (n, 3) see along each axis, (n, 3, 3)."""
        xi = self.within(points, cell)
        first = cell[:, 0]
        weights = np.empty((*xi.shape, 3))
        slopes = np.empty((*xi.shape, 3))
        for axis in range(
            3
        ):  # one at a time: all at once take the most memory of all that a model is built with
            ends, width = (
                (0.5, self.spacing[axis])
                if axis
                else (self.along.ends[first], self.along.width[first, None])
            )
            weights[:, axis], slopes[:, axis] = (
                spline_weights(xi[:, axis], ends),
                spline_slopes(xi[:, axis], ends) / width,
            )
        return weights, slopes

    def own(self, points: Array, cell: Index) -> Array:
        """Coordinates (n, 3) along its axes of points (n, 3) m in these cells (n, 3)."""
        return points

    def locate(self, points: Array, cell: Index) -> Array:
        """Position within the given cells, 0 to 1. points (n, 3) m, cell (n, 3) -> (n, 3).

        Raises ValueError if a point lies outside its cell: an index outside the grid would corrupt memory in a kernel.
        """
        if np.any(cell < 0) or np.any(cell >= self.cells):
            raise ValueError("a particle lies outside the cell it was given: there is no such cell")
        xi = self.within(points, cell)
        slack = 1e-9  # rounding of a point on a face
        if np.any(xi < -slack) or np.any(xi > 1 + slack):
            raise ValueError("a particle lies outside the cell it was given")
        return np.clip(xi, 0.0, 1.0)

    def within(self, points: Array, cell: Index) -> Array:
        """Position (n, 3) in units of given cells (n, 3): 0 to 1 within them, where their splines are meant; points (n, 3) m."""
        spans = self.along
        first = cell[:, 0]
        start = np.zeros(cell.shape)
        width = np.tile(self.spacing, (len(cell), 1))
        index = cell.copy()
        start[:, 0], width[:, 0], index[:, 0] = (
            spans.start[first],
            spans.width[first],
            spans.index[first],
        )
        return np.asarray((self.own(points, cell) - self.origin - start) / width - index)


@dataclass(frozen=True)
class TurnedGrid(Grid):
    """A grid along axes (3, 3) of its own, in columns: a rotation. Its origin is meant along these; points stay in x, y, z."""

    axes: Array = field(kw_only=True)

    def axes_at(self, points: Array) -> Array:
        """The directions of its axes, in columns (3, 3)."""
        return self.axes

    def own(self, points: Array, cell: Index) -> Array:
        """Coordinates (n, 3) m along its axes of points (n, 3) m."""
        return points @ self.axes


@dataclass(frozen=True)
class ClampPlane:
    """A face of the grid's cells on which all that is held holds the rest: the grid has its knots there.

    axis: its normal; lower: whether what is free lies above it; cell: index along the axis of the first cell that is free (the last, if
    not lower); moved: whether what holds there moves: the first node of that cell (the last) has the face's displacement.
    """

    axis: int
    lower: bool
    cell: int
    moved: bool = False


# cells: a joint nearer to the next one, or to an end, gets no knot at rest; also the least width of
# the cell that takes what is left
LEAST_JOINT_DISTANCE_AT_REST = 0.02


@dataclass(frozen=True)
class Knots:
    """Layout of the cells in a straight body. joints: the segments at whose far end the stiffness jumps; from_tip: cells of the requested
    size are counted from the tip, or from the next joint, and the one nearest to the base takes the remainder; like: the grid of nearly the
    same body, for as many cells everywhere; at_rest: in an equilibrium joints may be near each other, the cells of a tube lie around
    its axis (bodies.polar_grid), and those of parts along their faces."""

    joints: tuple[int, ...] = ()
    from_tip: bool = False
    like: Grid | None = None
    at_rest: bool = False


EVEN = Knots()
AT_REST = Knots(at_rest=True)


def runs_along(
    ends: Array, h: float, across: int, knots: Knots
) -> tuple[int, float, tuple[Run, ...]]:
    """Cells of about h m along a body whose segments end at `ends` (k,) m, `across` of which make its thickness: their number, the least
    width (m), and their runs (none if all are equal)."""
    least_cells_along = 3  # cells along a body
    # cells: the same in motion, where thin cells would need short steps
    least_joint_distance = 0.5
    like = knots.like
    length = float(ends[-1])
    if like is None:
        joints = _kept(
            ends,
            (
                LEAST_JOINT_DISTANCE_AT_REST
                if knots.from_tip or knots.at_rest
                else least_joint_distance
            )
            * h,
            knots.joints,
        )
    else:
        joints = [run.after for run in like.runs if run.after is not None]
    from_tip = knots.from_tip and (
        length >= (least_cells_along - 0.5) * h if like is None else bool(like.runs)
    )
    if not joints and not from_tip:
        along = max(least_cells_along, round(length / h)) if like is None else like.cells[0]
        return along, length / along, ()
    faces = [0.0, *ends[joints].tolist(), length]
    widths = np.diff(faces)
    counts = (
        [_count(width / h, across, from_tip) for width in widths]
        if like is None
        else _counts(like.runs)
    )
    runs: list[Run] = []
    for start, width, count, after in zip(
        faces, widths.tolist(), counts, [None, *joints], strict=False
    ):
        rest = width - (count - 1) * h
        if from_tip and count > 1:
            runs += [Run(start, rest, 1, after), Run(start + rest, h, count - 1)]
        else:
            runs.append(Run(start, width / count, count, after))
    return sum(counts), min(run.width for run in runs), tuple(runs)


def _count(width: float, across: int, from_tip: bool) -> int:
    """Cells in a run that is `width` cells wide, where `across` make the body's thickness: none is wider than requested by more than
    LEAST_JOINT_DISTANCE_AT_REST.
    From the tip, the first one takes LEAST_JOINT_DISTANCE_AT_REST to 1 + LEAST_JOINT_DISTANCE_AT_REST: a new cell begins with almost no
    width, and changes the answer by as little. Else twice as many cells across are twice as many in each run: nested grids tell each
    other's error, and do not agree by chance.
    """
    if across > 2 and across % 2 == 0 and not from_tip:
        return 2 * _count(width / 2, across // 2, from_tip)
    return max(1, math.ceil(width - LEAST_JOINT_DISTANCE_AT_REST))


def _kept(ends: Array, least: float, joints: tuple[int, ...]) -> list[int]:
    """The joints that get a knot, chosen from the tip on."""
    kept = []
    last = float(ends[-1])
    for joint in reversed(joints):
        if min(last - ends[joint], ends[joint]) >= least:
            kept.append(joint)
            last = ends[joint]
    return kept[::-1]


def _counts(runs: tuple[Run, ...]) -> list[int]:
    """Cells between repeated knots."""
    counts = [0]
    for run in runs:
        if run.after is not None:
            counts.append(0)
        counts[-1] += run.cells
    return counts
