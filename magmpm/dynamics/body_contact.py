"""Pairs of surface points and solids of a body that touches itself, listed again whenever it has moved by a share of a cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from magmpm.bodies.contact_solid import solid_distance
from magmpm.bodies.grid import each_node
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled
from magmpm.dynamics.particle_groups import Packed
from magmpm.effects.base import Contact
from magmpm.effects.contact_force import NORMAL
from magmpm.effects.contact_law import own_friction, stiffness_of
from magmpm.kernels import body_contact as kernel
from magmpm.kernels.body_contact import (
    CELL,
    DEPTH,
    FORCE,
    FRICTION,
    MEMORY,
    PLACE,
    ROOM,
    Meeting,
    SolidCells,
)
from magmpm.model import Model

# cells that any point may be away from its place when pairs were listed: they may then be twice as
# much nearer
MOVE = 0.5
# cells from a place on a face to the nearest of its points, at most, if stretched by sqrt(3): the
# edges' EDGE
BETWEEN = 0.5
SHARE = 0.25  # of the stiffness, where both bodies have points, and both give
REACH = float(
    np.hypot(2 * MOVE, BETWEEN)
)  # cells from the nearest point of a surface up to which a point is listed


def body_contact(model: Model, packed: Packed) -> BodyContact | None:
    """The contact of a model's body with itself, if its scene names self_contact."""
    effect = model.scene.effects.self_contact
    if effect is None:
        return None
    stiffness = stiffness_of(model.scene, effect.stiffness)
    return BodyContact(model, packed, np.array([stiffness, effect.friction]))


class BodyContact:
    """The pairs of a model, which `listed` brings up to date with displacements u (3 nodes,) m."""

    def __init__(self, model: Model, packed: Packed, law: Array) -> None:
        surface = model.surface
        assert surface is not None  # of a scene that names self_contact
        self.law = law
        self._mass = packed.surface.mass
        self._cell = float(model.grid.spacing.min())
        self.solids = model.scene.body.shape.solids(self._cell, model.particles)
        self.cells, number, cells = _solid_cells(model)
        still, still_particle = surface.still
        on = packed.point
        self._place = np.concatenate([surface.place[on], still])
        particle = np.concatenate([surface.particle[on], still_particle])
        self._at = number[particle]
        self._solid = model.component[particle]
        self._free = len(on)
        self._node = np.repeat(packed.surface.first_node, np.diff(packed.surface.first_point))
        weights, _ = model.splines_at(
            self._place, model.particles.cell[particle], model.held[particle]
        )
        self._splines = _matrix(model.first_in_motion(particle), weights, model.nodes_in_motion)
        splines = abs(self._splines)[:, packed.nodes.active]
        pace = (
            splines.max(axis=0).toarray().ravel() ** 0.75
        )  # light nodes are fast: from 0.7 to 1 the bound is tightest
        self._pace = (
            pace * (splines @ np.divide(1.0, pace, out=np.zeros_like(pace), where=pace > 0)).max()
        )
        segment = model.particles.segment
        self.names = [
            model.scene.regions()[segment[model.component == one].min()].name
            for one in range(int(model.component.max()) + 1)
        ]
        self._nodes = model.nodes_in_motion
        self._patches = _patches(self._at, cells)
        none = np.zeros(0, np.int64)
        self._then = np.full_like(
            self._place, np.inf
        )  # places of the points when pairs were listed
        self.meeting = self._of(none, none, np.zeros(1), np.full(1, -1.0))

    def _of(self, point: Index, solid: Index, memory: Array, most: Array) -> Meeting:
        parts: tuple[Any, ...] = (self._pace, *self.cells, *self.solids)
        return Meeting(point, self._node[point], solid, memory, most, self.law, *parts)

    def copy(self) -> Meeting:
        """The pairs, with a memory that steps may change."""
        return self.meeting._replace(memory=self.meeting.memory.copy())

    @property
    def outdated(self) -> bool:
        """True if pairs must be listed before the next step."""
        return bool(self.meeting.memory[-1] > self.meeting.most[0])

    def list(self, u: Array) -> None:
        """List the pairs at displacements u (3 nodes,) m, if points have moved by half of MOVE since. What touches stays listed with its
        memory, and nothing else acts: forces do not depend on when pairs were listed.
        """
        x = self._place + self._splines @ u.reshape(-1, 3)
        old = self.meeting
        way = old.memory[-1]
        most = MOVE * self._cell
        moved = float(np.sqrt(((x - self._then) ** 2).sum(axis=1).max()))
        if moved < 0.5 * most:
            old.most[0] = way + most - moved
            return
        p, q, distance = self._near(x)
        held = old.memory[:-1].reshape(-1, MEMORY)
        solids = len(self.solids.size)
        key = p * solids + self._solid[q]
        known = old.point * solids + old.solid
        kept = np.flatnonzero(held[:, DEPTH] > 0)
        new = np.flatnonzero(~np.isin(key, known[kept]))
        memory = np.zeros((len(new), MEMORY))
        memory[:, PLACE : PLACE + 3], memory[:, CELL] = self._place[q[new]], self._at[q[new]]
        other = self._solid[p[new]] != self._solid[q[new]]
        error = _begun(self.solids, self._solid[q[new]][other], self._place[p[new]][other])
        memory[other, kernel.BEGUN] = error - kernel.CLOSE * self._cell  # and rounding
        memory[:, ROOM] = way + 0.5 * np.sqrt(
            np.maximum(distance[new] ** 2 - (BETWEEN * self._cell) ** 2, 0.0)
        )
        order = np.argsort(np.concatenate([known[kept], key[new]]))
        memory = np.concatenate([held[kept], memory])[order]
        point = np.concatenate([old.point[kept], p[new]])[order]
        solid = np.concatenate([old.solid[kept], self._solid[q[new]]])[order]
        self._then, self.meeting = (
            x,
            self._of(point, solid, np.append(memory.ravel(), way), np.array([way + most])),
        )

    def _near(self, x: Array) -> tuple[Index, Index, Array]:
        """Free points (n,) near another solid, or a place of their own that shares no node; the nearest point (n,), its distance (n,) m."""
        first, order, cell = self._patches
        sorted_x = x[order]
        count = np.diff(first)
        center = (
            np.add.reduceat(sorted_x, first[:-1], axis=0) / count[:, None]
        )  # of balls around patches
        radius = np.sqrt(
            np.maximum.reduceat(
                ((sorted_x - np.repeat(center, count, axis=0)) ** 2).sum(axis=1), first[:-1]
            )
        )
        pairs = cKDTree(center).query_pairs(
            REACH * self._cell + 2 * radius.max(), output_type="ndarray"
        )
        found = _nearest(
            pairs, cell, center, radius, first, order, x, self._free, REACH * self._cell
        )
        p = found[:, 0].astype(np.int64)
        q = found[:, 1].astype(np.int64)
        distance = found[:, 2]
        best = np.lexsort((q, distance, self._solid[q], p))
        one = best[
            np.flatnonzero(np.diff((p * len(self.solids.size) + self._solid[q])[best], prepend=-1))
        ]
        return p[one], q[one], distance[one]

    def report(self, memory: Array, u: Array, v: Array) -> dict[str, Contact]:
        """Contact of the body with itself, and of each two components that touch, at displacements u m and velocities v m/s (3 nodes,);
        memory: of the pairs, at that time. A force acts on the first of two; the force on the whole is zero.
        """
        pair = memory[:-1].reshape(-1, MEMORY)
        on = np.flatnonzero(pair[:, DEPTH] > 0)
        pair = pair[on]
        point = self.meeting.point[on]
        a = self._solid[point]
        b = self.meeting.solid[on]
        x = self._place[point] + self._splines[point] @ u.reshape(-1, 3)
        sign = np.where(a <= b, 1.0, -1.0)[:, None]
        force = sign * pair[:, FORCE : FORCE + 3]
        normal = sign * pair[:, FRICTION + NORMAL : FRICTION + NORMAL + 3]
        cell = pair[:, CELL].astype(np.int64)
        rigidity = self.cells.share[cell] * self._mass[point] * self.law[0]
        energy = 0.5 * rigidity * pair[:, DEPTH] ** 2
        slip = self._splines[point] @ v.reshape(-1, 3) - self._there(v, pair)
        slip -= np.einsum("ni,ni->n", slip, normal)[:, None] * normal
        deepest = float(pair[:, DEPTH].max(initial=0.0))
        found = {
            "self_contact": Contact(
                force=np.zeros(3), count=len(on), depth=deepest, energy=float(energy.sum())
            )
        }
        for i, j in np.unique(np.column_stack([np.minimum(a, b), np.maximum(a, b)]), axis=0):
            here = (np.minimum(a, b) == i) & (np.maximum(a, b) == j)
            weight = (
                np.einsum("ni,ni->n", force[here], normal[here]) + 1e-300
            )  # a point that leaves may be in, and not be pushed
            weight /= weight.sum()
            mean = weight @ normal[here]
            found[f"self_contact: {self.names[i]}, {'itself' if i == j else self.names[j]}"] = (
                Contact(
                    force=np.zeros(3) if i == j else force[here].sum(axis=0),
                    count=int(here.sum()),
                    depth=float(pair[here, DEPTH].max()),
                    energy=float(energy[here].sum()),
                    point=weight @ x[here],
                    normal=mean / np.linalg.norm(mean),
                    slip=float(weight @ np.linalg.norm(slip[here], axis=1)),
                )
            )
        return found

    def _there(self, v: Array, pair: Array) -> Array:
        """Velocity (n, 3) m/s of the solids at the places of pairs (n, MEMORY)."""
        cell = pair[:, CELL].astype(np.int64)
        cells = self.cells
        xi = (pair[:, PLACE : PLACE + 3] - cells.low.reshape(-1, 3)[cell]) / cells.width.reshape(
            -1, 3
        )[cell]
        powers = np.stack([np.ones_like(xi), xi, xi**2], axis=-1)
        weights = np.einsum("niak,nik->nia", cells.splines.reshape(-1, 3, 3, 3)[cell], powers)
        first = np.stack(np.unravel_index(cells.node[cell], self._nodes), axis=1)
        return (
            np.asarray(_matrix(first, weights, self._nodes) @ v.reshape(-1, 3))
            if len(pair)
            else np.zeros((0, 3))
        )

    def state(self) -> dict[str, Any]:
        """State that `restore` needs."""
        now = self.meeting
        changed = {
            "pair_state": now.memory.copy(),
            "pair_most": now.most.copy(),
            "pair_then": self._then,
        }
        return {"pair_point": now.point, "pair_solid": now.solid, **changed}

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a `state`."""
        self._then = state["pair_then"]
        self.meeting = self._of(
            state["pair_point"],
            state["pair_solid"],
            np.array(state["pair_state"]),
            np.array(state["pair_most"]),
        )


def _solid_cells(model: Model) -> tuple[SolidCells, Index, Index]:
    """The well filled cells of a model's solids; that of each particle (n,), -1 for others; component and index (cells, 4) of each."""
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
    steps = np.array(
        [sign * int(np.prod(shape[axis + 2 :])) for axis in range(3) for sign in (-1, 1)]
    )
    beside = cells[:, None] + steps
    at = np.minimum(np.searchsorted(cells, beside), len(cells) - 1)
    first = model.first_in_motion(one) @ np.array(
        [np.prod(model.nodes_in_motion[1:]), model.nodes_in_motion[2], 1]
    )
    after = np.where(cells[at] == beside, at, -1)
    share = np.where(model.held[one], 1.0, SHARE)
    friction = own_friction(model.scene)[model.particles.segment[one]]
    found = SolidCells(
        first, low.ravel(), width.ravel(), splines.ravel(), after.ravel(), share, friction
    )
    return found, number, np.column_stack([model.component[one], place])


def _matrix(first: Index, weights: Array, nodes: tuple[int, int, int]) -> csr_matrix:
    """The splines (points, nodes) of points; arguments as of bodies.grid.each_node."""
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
def _begun(solids, solid, place):  # type: ignore[no-untyped-def]
    """Distance (n,) m of places (n, 3) m of undeformed points in undeformed solids (n,), 0 outside. As bodies begin clear of each other,
    that is the error of a table, up to 0.005 cells: taken off, what touches at the start is not pushed.
    """
    found = np.empty(len(solid))
    normal = np.empty(3)
    for k in range(len(solid)):
        found[k] = min(solid_distance(solids, solid[k], place[k], normal), 0.0)
    return found


@compiled
def _nearest(pairs, cell, center, radius, first, order, x, free, reach):  # type: ignore[no-untyped-def]
    """Rows (p, q, distance m): of each free point p of a patch the nearest point q of the other, for each of the pairs (k, 2) both ways.

    Patches of one component that share a node are left out, and those whose balls are too far from each other.
    """
    found = np.empty((1024, 3))
    count = 0
    for k in range(2 * len(pairs)):
        a = pairs[k // 2, k % 2]
        b = pairs[k // 2, 1 - k % 2]
        beside = cell[a, 0] == cell[b, 0]
        apart = 0.0
        for i in range(3):
            beside = beside and abs(cell[a, 1 + i] - cell[b, 1 + i]) <= 2
            apart += (center[a, i] - center[b, i]) ** 2
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
