"""Pairs of surface points and solids of a body that touches itself, listed again whenever it has moved by a share of a cell."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Index, Plain
from magmpm.dynamics.particle_groups import Packed
from magmpm.effects.base import Contact
from magmpm.effects.contact_force import NORMAL
from magmpm.kernels.body_contact import (
    BEGUN,
    CELL,
    DEPTH,
    FORCE,
    FRICTION,
    MEMORY,
    PLACE,
    ROOM,
    Meeting,
)
from magmpm.model import Model
from magmpm.statics.surface_pairs import (
    BETWEEN,
    MOVE,
    SurfacePairs,
    spline_matrix,
)


def body_contact(model: Model, packed: Packed) -> BodyContact | None:
    """The contact of a model's body with itself, if its scene names self_contact."""
    if model.scene.effects.self_contact is None:
        return None
    return BodyContact(model, packed)


class BodyContact(SurfacePairs):
    """The pairs of a model, which `listed` brings up to date with displacements u (3 nodes,) m."""

    def __init__(self, model: Model, packed: Packed) -> None:
        super().__init__(model, packed.point)
        self._node = np.repeat(packed.surface.first_node, np.diff(packed.surface.first_point))
        splines = abs(self.splines)[:, packed.nodes.active]
        pace = (
            splines.max(axis=0).toarray().ravel() ** 0.75
        )  # light nodes are fast: from 0.7 to 1 the bound is tightest
        self._pace = (
            pace * (splines @ np.divide(1.0, pace, out=np.zeros_like(pace), where=pace > 0)).max()
        )
        self._then = np.full_like(self.place, np.inf)  # places of the points when pairs were listed
        self.meeting = self._without_pairs(-1.0)

    def _of(self, point: Index, solid: Index, memory: Array, most: Array) -> Meeting:
        parts: tuple[Any, ...] = (self._pace, *self.cells, *self.solids)
        return Meeting(point, self._node[point], solid, memory, most, self.law, *parts)

    def _without_pairs(self, most: float) -> Meeting:
        """No pairs, until points have moved by more than `most`, m."""
        none = np.zeros(0, np.int64)
        return self._of(none, none, np.zeros(1), np.full(1, most))

    def apart(self) -> Meeting:
        """No pairs at all: nothing touches. Kernels take it as they take pairs."""
        return self._without_pairs(np.inf)

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
        x = self.place + self.splines @ u.reshape(-1, 3)
        old = self.meeting
        way = old.memory[-1]
        most = MOVE * self.cell
        moved = float(np.sqrt(((x - self._then) ** 2).sum(axis=1).max()))
        if moved < 0.5 * most:
            old.most[0] = way + most - moved
            return
        p, q, distance = self.near(x)
        held = old.memory[:-1].reshape(-1, MEMORY)
        solids = len(self.solids.size)
        key = p * solids + self.solid[q]
        known = old.point * solids + old.solid
        kept = np.flatnonzero(held[:, DEPTH] > 0)
        new = np.flatnonzero(~np.isin(key, known[kept]))
        memory = np.zeros((len(new), MEMORY))
        memory[:, PLACE : PLACE + 3], memory[:, CELL] = self.place[q[new]], self.at[q[new]]
        memory[:, BEGUN] = self.begun(p[new], q[new])
        memory[:, ROOM] = way + 0.5 * np.sqrt(
            np.maximum(distance[new] ** 2 - (BETWEEN * self.cell) ** 2, 0.0)
        )
        order = np.argsort(np.concatenate([known[kept], key[new]]))
        memory = np.concatenate([held[kept], memory])[order]
        point = np.concatenate([old.point[kept], p[new]])[order]
        solid = np.concatenate([old.solid[kept], self.solid[q[new]]])[order]
        self._then, self.meeting = (
            x,
            self._of(point, solid, np.append(memory.ravel(), way), np.array([way + most])),
        )

    def report(self, memory: Array, u: Array, v: Array) -> dict[str, Contact]:
        """Contact of the body with itself, and of each two parts that touch, at displacements u m and velocities v m/s (3 nodes,);
        memory: of the pairs, at that time. A force acts on the first of two; the force on the whole is zero.
        """
        pair = memory[:-1].reshape(-1, MEMORY)
        on = np.flatnonzero(pair[:, DEPTH] > 0)
        pair = pair[on]
        point = self.meeting.point[on]
        x = self.place[point] + self.splines[point] @ u.reshape(-1, 3)
        force = pair[:, FORCE : FORCE + 3]
        normal = pair[:, FRICTION + NORMAL : FRICTION + NORMAL + 3]
        cell = pair[:, CELL].astype(np.int64)
        rigidity = self.rigidity(cell, point)
        slip = self.splines[point] @ v.reshape(-1, 3) - self._there(v, pair)
        slip -= np.einsum("ni,ni->n", slip, normal)[:, None] * normal
        depth = pair[:, DEPTH]
        energy = 0.5 * rigidity * depth**2
        there = (self.meeting.solid[on], pair[:, PLACE : PLACE + 3])
        found = self.contacts(point, there, (x, force, normal), depth, energy)
        speed = np.linalg.norm(slip, axis=1)
        for each, here, weight in found.values():
            if here is not None:
                each["slip"] = float(weight @ speed[here])
        return {name: each for name, (each, _, _) in found.items()}

    def _there(self, v: Array, pair: Array) -> Array:
        """Velocity (n, 3) m/s of the solids at the places of pairs (n, MEMORY)."""
        cell = pair[:, CELL].astype(np.int64)
        cells = self.cells
        xi = (pair[:, PLACE : PLACE + 3] - cells.low.reshape(-1, 3)[cell]) / cells.width.reshape(
            -1, 3
        )[cell]
        powers = np.stack([np.ones_like(xi), xi, xi**2], axis=-1)
        weights = np.einsum("niak,nik->nia", cells.splines.reshape(-1, 3, 3, 3)[cell], powers)
        first = np.stack(np.unravel_index(cells.node[cell], self.nodes), axis=1)
        return (
            np.asarray(spline_matrix(first, weights, self.nodes) @ v.reshape(-1, 3))
            if len(pair)
            else np.zeros((0, 3))
        )

    def state(self) -> Plain:
        """State that `restore` needs."""
        now = self.meeting
        changed = {
            "pair_state": now.memory.copy(),
            "pair_most": now.most.copy(),
            "pair_then": self._then,
        }
        return {"pair_point": now.point, "pair_solid": now.solid, **changed}

    def restore(self, state: Plain) -> None:
        """Go back to a `state`."""
        self._then = state["pair_then"]
        self.meeting = self._of(
            state["pair_point"],
            state["pair_solid"],
            np.array(state["pair_state"]),
            np.array(state["pair_most"]),
        )
