"""Points of a body's surface and the solids of its components that they may touch: which are near each other.

In motion (dynamics.body_contact) and at rest (statics.own_contact) the pairs, their places and their law are the same.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.contact_solid import solid_distance
from magmpm.bodies.grid import each_node
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inner
from magmpm.effects.base import Contact
from magmpm.effects.contact_law import own_friction, stiffness_of
from magmpm.errors import PAIR
from magmpm.kernels.body_contact import PLACE_TOLERANCE, SolidCells
from magmpm.model import Model

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

# cells that any point may be away from its place when pairs were listed: they may then be twice as
# much nearer
MOVE = 0.5
# cells from a place on a face to the nearest of its points, at most, if stretched by sqrt(3): the
# edges' EDGE
BETWEEN = 0.5
SHARE_OF_EACH_BODY = 0.25  # of the stiffness, where both bodies have points, and both give
REACH = float(
    np.hypot(2 * MOVE, BETWEEN)
)  # cells from the nearest point of a surface up to which a point is listed


class SurfacePairs:
    """Points (n,) of a model's surface, first those that can move, and its solids.

    place (n, 3) m, in the undeformed body; at (n,): cell of each; solid (n,): its component; part (n,): the part or segment of each;
    splines: a matrix (n, nodes in motion); mass (free,) kg; names: of the parts; law (2,): stiffness 1/s^2 and friction where no material
    names one; cell: m.
    """

    def __init__(self, model: Model, on: Index, *, still: bool = False) -> None:
        """on: the order of the surface's points; still: held parts see no node, and stay where they are."""
        surface = model.surface
        effect = model.scene.effects.self_contact
        assert surface is not None  # of a scene that names self_contact
        assert effect is not None
        self.law = np.array([stiffness_of(model.scene, effect.stiffness), effect.friction])
        self.mass = surface.mass[on]
        self.cell = float(model.grid.spacing.min())
        self.solids = model.scene.body.shape.solids(self.cell, model.particles)
        self.cells, number, cells = _solid_cells(model, still)
        place, particle = surface.still
        self.place = np.concatenate([surface.place[on], place])
        particle = np.concatenate([surface.particle[on], particle])
        self.at = number[particle]
        self.solid = model.component[particle]
        self.part = model.particles.segment[particle]
        self._free = len(on)
        weights, _ = model.splines_at(
            self.place, model.particles.cell[particle], model.held[particle]
        )
        if still:
            weights[model.held[particle]] = 0.0
        self.nodes = model.nodes_in_motion
        self.splines = spline_matrix(model.first_in_motion(particle), weights, self.nodes)
        self.names = [region.name for region in model.scene.regions()]
        self._patches = _patches(self.at, cells)

    def near(self, x: Array) -> tuple[Index, Index, Array]:
        """Free points (n,) near another solid, or a place of their own that shares no node; the nearest point (n,), its distance (n,) m."""
        from scipy.spatial import cKDTree  # 0.2 s to import, and few bodies touch themselves

        first, order, cell = self._patches
        center, radius = self._balls(x)
        pairs = cKDTree(center).query_pairs(
            REACH * self.cell + 2 * radius.max(), output_type="ndarray"
        )
        found = _nearest(
            pairs, cell, center, radius, first, order, x, self._free, REACH * self.cell
        )
        p = found[:, 0].astype(np.int64)
        q = found[:, 1].astype(np.int64)
        distance = found[:, 2]
        best = np.lexsort((q, distance, self.solid[q], p))
        one = best[
            np.flatnonzero(np.diff((p * len(self.solids.size) + self.solid[q])[best], prepend=-1))
        ]
        return p[one], q[one], distance[one]

    def _balls(self, x: Array) -> tuple[Array, Array]:
        """Center (patches, 3) and radius (patches,) m of balls around patches whose points are at x (n, 3), m."""
        first, order, _ = self._patches
        count = np.diff(first)
        sorted_x = x[order]
        center = np.add.reduceat(sorted_x, first[:-1], axis=0) / count[:, None]
        squares = ((sorted_x - np.repeat(center, count, axis=0)) ** 2).sum(axis=1)
        return center, np.sqrt(np.maximum.reduceat(squares, first[:-1]))

    def contacts(
        self,
        point: Index,
        there: tuple[Index, Array],
        acting: tuple[Array, Array, Array],
        depth: Array,
        energy: Array,
    ) -> dict[str, tuple[Contact, Index | None, Array]]:
        """Contact of the body with itself, and of each two parts that touch, with which of the touching pairs it is of and the share that
        each has of its push; a force acts on the first of two, and that on the whole is zero.

        Of touching pairs (t,): point; there: solid, and place (t, 3) m in it, undeformed; acting: place m, force N and unit normal, (t, 3)
        each, on the point; depth m and energy J.
        """
        x, force, normal = acting
        deepest = float(depth.max(initial=0.0))
        whole = Contact(
            force=np.zeros(3), count=len(point), depth=deepest, energy=float(energy.sum())
        )
        found: dict[str, tuple[Contact, Index | None, Array]] = {
            "self_contact": (whole, None, np.zeros(0))
        }
        own = self.part[point]
        other = self.parts_at(*there)
        a = np.minimum(own, other)
        b = np.maximum(own, other)
        sign = np.where(own <= other, 1.0, -1.0)[:, None]
        for i, j in np.unique(np.column_stack([a, b]), axis=0):
            here = np.flatnonzero((a == i) & (b == j))
            outward = (sign * normal)[here]
            weight = np.einsum("ni,ni->n", (sign * force)[here], outward)
            weight += 1e-300  # a point that leaves may be in, and not be pushed
            weight /= weight.sum()
            mean = weight @ outward
            one = Contact(
                force=np.zeros(3) if i == j else (sign * force)[here].sum(axis=0),
                count=len(here),
                depth=float(depth[here].max()),
                energy=float(energy[here].sum()),
                point=weight @ x[here],
                normal=mean / np.linalg.norm(mean),
            )
            name = pair_name(self.names[i], "itself" if i == j else self.names[j])
            found[name] = (one, here, weight)
        return found

    def begun(self, point: Index, nearest: Index) -> Array:
        """Distance (n,) m, 0 or less, at which points begin to touch the solids of the nearest ones. As bodies begin clear of each other,
        that is the error of a table, up to 0.005 cells, and rounding: taken off, what touches at the start is not pushed.
        """
        found = np.zeros(len(point))
        other = self.solid[point] != self.solid[nearest]
        there = self.solid[nearest][other]
        found[other] = _inside(self.solids, there, self.place[point[other]])
        found[other] -= PLACE_TOLERANCE * self.cell
        return found

    def rigidity(self, cell: Index, point: Index) -> Array:
        """Stiffness (n,) N/m of what pushes points in cells of solids."""
        return self.cells.share[cell] * self.mass[point] * self.law[0]

    def parts_at(self, solid: Index, X: Array) -> Index:
        """Part or segment (t,) of places X (t, 3) m in undeformed solids (t,): that of the nearest point of each solid's surface."""
        return np.asarray(self.part[self._nearby.query(self._apart(solid, X))[1]])

    def _apart(self, solid: Index, X: Array) -> Array:
        """Places (t, 4) m among which those of different solids (t,) are farther from each other than any of the same one."""
        return np.column_stack([X, 2.0 * np.ptp(self.place) * solid])

    @cached_property
    def _nearby(self) -> cKDTree:
        from scipy.spatial import cKDTree  # as in `near`

        return cKDTree(self._apart(self.solid, self.place))

    def share(self, x: Array, way: Array) -> float:
        """Share, at most 1, of a way (n, 3) m from places x (n, 3) m on which no point can come past another surface unseen.

        In its course no two patches that share no node approach each other by more than what is between them, and MOVE cells.
        """
        center, radius = self._balls(x)
        mean, spread = self._balls(way)
        return float(_clear(self._patches[2], center, radius, mean, spread, MOVE * self.cell))


def pair_name(one: str, other: str) -> str:
    """Name of the contact of two parts, as contacts.csv has it."""
    return f"self_contact{PAIR}{one}, {other}"


def _solid_cells(model: Model, still: bool) -> tuple[SolidCells, Index, Index]:
    """The well filled cells of a model's solids; that of each particle (n,), -1 for others; component and index (cells, 4) of each.
    still: as of SurfacePairs."""
    grid = model.grid
    on = model.particles.cell.astype(np.int64)
    shape = (int(model.component.max()) + 1, *(n + 2 for n in grid.cells))
    key = np.ravel_multi_index((model.component, *(on.T + 1)), shape)
    full = np.flatnonzero(model.well_filled)
    number = np.full(len(on), -1)
    cells, one, number[full] = np.unique(key[full], return_index=True, return_inverse=True)
    one = full[one]
    place = on[one]
    spans = grid.along
    width = np.tile(grid.spacing, (len(one), 1))
    width[:, 0] = spans.width[place[:, 0]]
    low = grid.origin + grid.spacing * place
    low[:, 0] = (
        grid.origin[0]
        + spans.start[place[:, 0]]
        + spans.width[place[:, 0]] * spans.index[place[:, 0]]
    )
    zero, half, whole = (
        model.splines_at(low + share * width, place, model.held[one])[0]
        for share in (0.0, 0.5, 1.0)
    )
    splines = np.stack([zero, 4 * half - 3 * zero - whole, 2 * (zero + whole) - 4 * half], axis=-1)
    if still:
        splines[model.held[one]] = 0.0
    steps = np.array(
        [sign * int(np.prod(shape[axis + 2 :])) for axis in range(3) for sign in (-1, 1)]
    )
    beside = cells[:, None] + steps
    at = np.minimum(np.searchsorted(cells, beside), len(cells) - 1)
    first = model.first_in_motion(one) @ np.array(
        [np.prod(model.nodes_in_motion[1:]), model.nodes_in_motion[2], 1]
    )
    after = np.where(cells[at] == beside, at, -1)
    share = np.where(model.held[one], 1.0, SHARE_OF_EACH_BODY)
    friction = own_friction(model.scene)[model.particles.segment[one]]
    found = SolidCells(
        first, low.ravel(), width.ravel(), splines.ravel(), after.ravel(), share, friction
    )
    return found, number, np.column_stack([model.component[one], place])


def spline_matrix(first: Index, weights: Array, nodes: tuple[int, int, int]) -> csr_matrix:
    """The splines (points, nodes) of points; arguments as of bodies.grid.each_node."""
    from scipy.sparse import csr_matrix  # 0.1 s to import, and few bodies touch themselves

    columns, values = zip(*each_node(first, nodes, weights), strict=True)
    rows = np.tile(np.arange(len(first)), 27)
    return csr_matrix(
        (np.concatenate(values), (rows, np.concatenate(columns))),
        shape=(len(first), int(np.prod(nodes))),
    )


def _patches(at: Index, cells: Index) -> tuple[Index, Index, Index]:
    """Points in patches, those of one cell each: first (patches + 1,) in the order (n,) of points; component and cell (patches, 4)."""
    order = np.argsort(at, kind="stable")
    first = np.flatnonzero(np.diff(at[order], prepend=-1))
    return np.append(first, len(at)), order, cells[at[order[first]]]


@compiled
def _inside(solids, solid, place):  # type: ignore[no-untyped-def]
    """Distance (n,) m of places (n, 3) m of undeformed points in undeformed solids (n,), 0 outside."""
    found = np.empty(len(solid))
    normal = np.empty(3)
    for k in range(len(solid)):
        found[k] = min(solid_distance(solids, solid[k], place[k], normal), 0.0)
    return found


@inner
def _apart(cell, center, a, b):  # type: ignore[no-untyped-def]
    """Square (m^2) of the distance of two patches' centers, and whether they are of one component and share a node."""
    beside = cell[a, 0] == cell[b, 0]
    apart = 0.0
    for i in range(3):
        beside = beside and abs(cell[a, 1 + i] - cell[b, 1 + i]) <= 2
        apart += (center[a, i] - center[b, i]) ** 2
    return apart, beside


@compiled
def _nearest(  # type: ignore[no-untyped-def]
    pairs, cell, center, radius, first, order, x, free, reach
):
    """Rows (p, q, distance m): of each free point p of a patch the nearest point q of the other, for each of the pairs (k, 2) both ways.

    Patches of one component that share a node are left out, and those whose balls are too far from each other.
    """
    found = np.empty((1024, 3))
    count = 0
    for k in range(2 * len(pairs)):
        a = pairs[k // 2, k % 2]
        b = pairs[k // 2, 1 - k % 2]
        apart, beside = _apart(cell, center, a, b)
        if beside or apart > (reach + radius[a] + radius[b]) ** 2:
            continue
        for i in range(first[a], first[a + 1]):
            p = order[i]
            best = reach**2
            nearest = -1
            if p >= free:
                continue
            for j in range(first[b], first[b + 1]):
                q = order[j]
                now = (x[p, 0] - x[q, 0]) ** 2 + (x[p, 1] - x[q, 1]) ** 2 + (x[p, 2] - x[q, 2]) ** 2
                if now < best:
                    best = now
                    nearest = q
            if nearest >= 0:
                if count == len(found):
                    more = np.empty((2 * count, 3))
                    more[:count] = found
                    found = more
                found[count, 0], found[count, 1], found[count, 2] = p, nearest, np.sqrt(best)
                count += 1
    return found[:count]


@compiled
def _clear(cell, center, radius, mean, spread, passed):  # type: ignore[no-untyped-def]
    """The share of a way of SurfacePairs.share; mean (patches, 3), spread (patches,) m: of the ways of each patch's points."""
    least = 1.0
    for a in range(len(cell)):
        for b in range(a):
            apart, beside = _apart(cell, center, a, b)
            way, _ = _apart(cell, mean, a, b)
            way = np.sqrt(way) + spread[a] + spread[b]
            if beside or way <= passed:
                continue
            room = max(np.sqrt(apart) - radius[a] - radius[b], 0.0) + passed
            least = min(least, room / way)
    return least
