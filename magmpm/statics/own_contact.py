"""A body that touches itself at equilibrium: points of its surface on the solids of its components, on the unknowns of a static solve.

A point at x touches a solid where the place X with X + u(X) = x lies below the solid's undeformed surface, at the distance phi(X) < 0
(kernels.body_contact). The energy is that of motion, k phi^2 / 2 with the same stiffness k, so a damped motion without friction settles
where the energy has its minimum. With dr = dx - du(X), g = F^-T grad phi, m_a = F^-T grad N_a of the solid's nodes a, and dX = F^-1 dr,

    d phi = g . dr,    d2 phi = dX . (grad grad phi - g . grad grad u) dX - 2 sum_a (g . du_a) (m_a . dr),

so that the force k phi g acts at one place on both, and momentum and angular momentum are kept. The tangent is k (d phi)^2 + k phi d2 phi.
Source: the implicit function theorem; Wriggers, Computational Contact Mechanics, 2nd ed., section 4.1 (projection and its variation).

Along a path friction acts by the springs of statics.contact, between a point and the place X of the solid where it was as the increment
began, or where it began to touch: their stretch D is linear in the coefficients, and the force equal and opposite.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.effects.base import Contact
from magmpm.kernels.body_contact import RestingPlaces, add_pairs_tangent, places_at_rest
from magmpm.model import Model
from magmpm.statics.contact import Held, add_springs, followed
from magmpm.statics.surface_pairs import SurfacePairs

CORNERS = np.stack(np.meshgrid(*3 * (np.arange(3),), indexing="ij"), -1).reshape(27, 3)


class Numbering(Protocol):
    """Numbers of nodes as statics.layout gives them: `planes`, and the grid index (nodes_per_plane, 2) of each in a plane."""

    @property
    def planes(self) -> int: ...

    @property
    def node_yz(self) -> Index: ...


@dataclass(frozen=True)
class HeldPairs:
    """Pairs (t,) that friction holds: key, a number of each; node, share (t, 54) of the stretch D, as in OwnContacts; how they are held,
    with anchors as stretches (t, 3) m."""

    key: Index
    node: Index
    share: Array
    held: Held

    def stretch(self, nodes: Array) -> Array:
        """D (t, 3) m for displacements (count, 3) m of the nodes."""
        return relative(self.node, self.share, nodes)

    def state(self) -> dict[str, Array]:
        """Arrays from which `restored` makes the same."""
        held = {f"pairs_{name}": value for name, value in self.held._asdict().items()}
        return {"pairs_key": self.key, "pairs_node": self.node, "pairs_share": self.share, **held}

    @classmethod
    def restored(cls, state: dict[str, Array]) -> HeldPairs:
        """The pairs of a `state`."""
        held = Held(*(state[f"pairs_{name}"] for name in Held._fields))
        key: Index = state["pairs_key"].astype(np.int64)
        node: Index = state["pairs_node"].astype(np.int64)
        return cls(key, node, state["pairs_share"], held)


def relative(node: Index, share: Array, nodes: Array) -> Array:
    """Displacements (t, 3) m of points against solids, for displacements (count, 3) m of the nodes; node, share: as in OwnContacts."""
    own = np.where((node >= 0)[:, :, None], nodes[node], 0.0)
    return np.einsum("ta,tai->ti", share, own)


def holding(now: OwnContacts, nodes: Array, start: tuple[HeldPairs, Array]) -> HeldPairs:
    """Find how friction holds the pairs that touch, with nodes displaced by `nodes` (count, 3) m; start: how, and how displaced, as the
    increment began. A pair that has begun to touch is held where it met, by the share of its approach that is its depth.
    """
    was, before = start
    node = now.node.copy()
    share = now.share.copy()
    moved = relative(node, share, nodes)
    way = moved - relative(node, share, before)
    size = np.linalg.norm(now.normal, axis=1)
    closed = -np.einsum("ti,ti->t", now.normal, way)
    anchor = moved - (now.depth / np.maximum(closed, now.depth))[:, None] * way
    _, here, there = np.intersect1d(now.key, was.key, return_indices=True)
    node[here] = was.node[there]
    share[here] = was.share[there]
    anchor[here] = was.held.anchor[there]
    grip = now.friction * now.push * size
    held = Held(anchor, now.normal / size[:, None], grip, now.stiffness)
    return HeldPairs(now.key, node, share, held)


def released(now: OwnContacts, nodes: Array, held: HeldPairs | None) -> HeldPairs:
    """Begin an increment at an equilibrium: pairs that touch have springs from where they are, with grip and stretch as friction holds
    them."""
    moved = relative(now.node, now.share, nodes)
    anchor = moved.copy()
    grip = np.zeros(len(anchor))
    normal = now.normal / np.linalg.norm(now.normal, axis=1)[:, None]
    if held is not None:
        stretch = held.stretch(nodes)
        kept = stretch - followed(held.held, stretch).anchor
        _, here, there = np.intersect1d(now.key, held.key, return_indices=True)
        anchor[here] -= kept[there]
        grip[here] = held.held.grip[there]
    return HeldPairs(now.key, now.node, now.share, Held(anchor, normal, grip, now.stiffness))


def changed(one: HeldPairs, other: HeldPairs) -> float:
    """Difference of the grips of all pairs, over their sum."""
    _, group = np.unique(np.concatenate([one.key, other.key]), return_inverse=True)
    each = np.bincount(group, np.concatenate([one.held.grip, -other.held.grip]))
    return float(np.abs(each).sum()) / max(float(one.held.grip.sum()), 1e-300)


@dataclass(frozen=True)
class FrictionSprings:
    """Springs of friction (t,) in a shape: the pairs they hold, their energy J, pull f (t, 3) N, its slope H (t, 3, 3) N/m, and which
    slide."""

    pairs: HeldPairs
    energy: float
    f: Array
    H: Array
    slides: NDArray[np.bool_]


def springs_of(pairs: HeldPairs, nodes: Array) -> FrictionSprings:
    """The springs for displacements (count, 3) m of the nodes."""
    n = len(pairs.key)
    energy = np.zeros(n)
    f = np.zeros((n, 3))
    H = np.zeros((n, 3, 3))
    slides = add_springs(pairs.held, pairs.stretch(nodes), energy, f, H)
    return FrictionSprings(pairs, float(energy.sum()), f, H, slides > 0)


@dataclass(frozen=True)
class OwnContacts:
    """Pairs (t,) that touch: point and solid, and place (t, 3) m in it, undeformed; x (t, 3) m; stiffness N/m; depth m; node (t, 54): of
    the point's splines and the solid's, among all of the layout, -1 for none; share (t, 54): of dr; lean (t, 54, 3) 1/m: m_a, 0 for the
    point's nodes; normal (t, 3): g; bend (t, 3, 3) 1/m: of d2 phi, by dr; friction (t,): coefficients; rubs: how friction holds pairs, None
    where it does not.
    """

    pairs: RestingPairs
    point: Index
    solid: Index
    place: Array
    x: Array
    stiffness: Array
    depth: Array
    node: Index
    share: Array
    lean: Array
    normal: Array
    bend: Array
    friction: Array
    rubs: FrictionSprings | None

    @property
    def energy(self) -> float:
        """Energy of all pairs, J."""
        rubs = 0.0 if self.rubs is None else self.rubs.energy
        return 0.5 * float(self.stiffness @ self.depth**2) + rubs

    @property
    def key(self) -> Index:
        """A number of each pair."""
        return np.asarray(self.point * len(self.pairs.solids.size) + self.solid)

    @property
    def pattern(self) -> Index:
        """Numbers of the pairs that touch, and of those that slide."""
        if self.rubs is None:
            return self.key
        return np.concatenate([self.key, -1 - self.rubs.pairs.key[self.rubs.slides]])

    @property
    def push(self) -> Array:
        """Force (t,) N over the length of `normal`."""
        return np.asarray(self.stiffness * self.depth)

    @property
    def across(self) -> Array:
        """The tangent (t, 3, 3) N/m by dr alone."""
        outer = np.einsum("ti,tj->tij", self.normal, self.normal)
        return np.asarray(
            self.stiffness[:, None, None] * outer - self.push[:, None, None] * self.bend
        )

    def force(self, count: int) -> Array:
        """Force (count, 3) N on the nodes of the layout."""
        each = self.push[:, None] * self.normal
        force = _to_nodes(self.node, np.einsum("ta,ti->tai", self.share, each), count)
        if self.rubs is not None:
            held = self.rubs.pairs
            force += _to_nodes(held.node, np.einsum("ta,ti->tai", held.share, self.rubs.f), count)
        return force

    def product(self, nodes: Array) -> Array:
        """The second derivative of the energy times displacements (count, 3) m of the nodes, N."""
        r = relative(self.node, self.share, nodes)
        by_r = self._resisted(nodes, r)
        by_along = self.push[:, None] * np.einsum("tai,ti->ta", self.lean, r)
        out = np.einsum("ta,ti->tai", self.share, by_r)
        out += np.einsum("ta,ti->tai", by_along, self.normal)
        product = _to_nodes(self.node, out, len(nodes))
        if self.rubs is not None:
            held = self.rubs.pairs
            pull = np.einsum("tij,tj->ti", self.rubs.H, held.stretch(nodes))
            product += _to_nodes(held.node, np.einsum("ta,ti->tai", held.share, pull), len(nodes))
        return product

    def _resisted(self, nodes: Array, r: Array) -> Array:
        """Loss (t, 3) N of the force on each point, for displacements (count, 3) m of the nodes, and dr (t, 3) m by them."""
        own = np.where((self.node >= 0)[:, :, None], nodes[self.node], 0.0)
        along = np.einsum("ti,tai->ta", self.normal, own)
        q = np.einsum("ta,tai->ti", along, self.lean)
        return np.asarray(np.einsum("tij,tj->ti", self.across, r) + self.push[:, None] * q)

    def change_between(self, name: str, nodes: Array) -> Array:
        """Change (3,) N of the force that `report` has by this name, without friction, for displacements (count, 3) m of the nodes."""
        _, here, _ = self._touching().get(name, (None, None, None))
        if here is None:
            return np.zeros(3)
        lost = self._resisted(nodes, relative(self.node, self.share, nodes))[here]
        part = self.pairs.part[self.point[here]]
        on_the_first = part <= self.pairs.parts_at(self.solid[here], self.place[here])
        return np.asarray(np.where(on_the_first, -1.0, 1.0) @ lost)

    def elements(self) -> tuple[Index, Index]:
        """The different rows (groups, 54) of `node`, of these pairs and those that friction holds, and which each (t,) has."""
        held = self.node[:0] if self.rubs is None else self.rubs.pairs.node
        rows, group = np.unique(np.concatenate([self.node, held]), axis=0, return_inverse=True)
        return rows, group.ravel()

    def add_tangent(self, table: NDArray[np.int32], group: Index, blocks: Array) -> None:
        """Add the second derivative of the energy to blocks (k, 3, 3) N/m; table (groups, 54, 54): the block of each two nodes, or -1."""
        n = len(self.push)
        add_pairs_tangent(
            self.share, self.lean, self.normal, self.across, self.push, table, group[:n], blocks
        )
        if self.rubs is not None:
            held = self.rubs.pairs
            count = len(held.key)
            bare = np.zeros((count, 54, 3))
            add_pairs_tangent(
                held.share,
                bare,
                bare[:, 0],
                self.rubs.H,
                np.zeros(count),
                table,
                group[n:],
                blocks,
            )

    def report(self) -> dict[str, Contact]:
        """Contact of the body with itself, and of each two parts that touch."""
        return {name: one for name, (one, _, _) in self._touching().items()}

    def _touching(self) -> dict[str, tuple[Contact, Index | None, Array]]:
        """Contacts of these, as SurfacePairs.contacts has them."""
        force = self.push[:, None] * self.normal
        if self.rubs is not None:
            _, here, there = np.intersect1d(self.key, self.rubs.pairs.key, return_indices=True)
            force[here] += self.rubs.f[there]
        size = np.linalg.norm(self.normal, axis=1)[:, None]
        energy = 0.5 * self.stiffness * self.depth**2
        acting = (self.x, force, self.normal / size)
        inside = (self.solid, self.place)
        return self.pairs.contacts(self.point, inside, acting, self.depth, energy)


def _to_nodes(node: Index, values: Array, count: int) -> Array:
    """Sums (count, 3) of values (t, 54, 3) at nodes (t, 54), -1 for none."""
    on = node >= 0
    return np.stack([np.bincount(node[on], values[on][:, i], count) for i in range(3)], axis=1)


class RestingPairs(SurfacePairs):
    """The pairs of a model at rest: those that touch for any coefficients of its layout. held: those that friction holds, or None."""

    def __init__(self, model: Model, still: bool) -> None:
        """still: as of SurfacePairs."""
        surface = model.surface
        assert surface is not None  # layout has looked
        super().__init__(model, np.arange(len(surface.mass)), still=still)
        _, ny, nz = self.nodes
        strides = np.array([ny * nz, nz, 1])
        self._strides = strides
        self._point_node = (surface.first @ strides)[:, None] + CORNERS @ strides
        shares = np.einsum("ta,tb,tc->tabc", *surface.weights.transpose(1, 0, 2))
        self._point_share = shares.reshape(-1, 27)
        self._in_motion: Index = np.zeros(0, np.int64)
        self._number: Index = self._in_motion
        self._friction = surface.friction
        self.held: HeldPairs | None = None

    def numbered(self, layout: Numbering, first_plane: int) -> RestingPairs:
        """The same pairs on the unknowns of a layout; first_plane: of the grid, that has unknowns."""
        out = copy(self)
        _, ny, nz = self.nodes
        inside = layout.node_yz @ np.array([nz, 1])
        # nodes that cells at rest share come first in their planes: those that move count
        out._in_motion = (
            (np.arange(layout.planes)[:, None] + first_plane) * (ny * nz) + inside
        ).ravel()
        out._number = np.full(int(np.prod(self.nodes)), -1)
        out._number[out._in_motion] = np.arange(len(out._in_motion))
        return out

    def held_by(self, held: HeldPairs | None) -> RestingPairs:
        """The same pairs, of which friction holds these."""
        out = copy(self)
        out.held = held
        return out

    def displaced(self, grid: Array) -> Array:
        """Displacements (nodes in motion, 3) m for coefficients (planes, m) m."""
        u = np.zeros((len(self._number), 3))
        u[self._in_motion] = grid.reshape(-1, 3)
        return u

    def clear(self, grid: Array, change: Array) -> float:
        """Share, at most 1, of a change of coefficients `grid` (planes, m) m in which no surface comes past another unseen."""
        x = self.place + self.splines @ self.displaced(grid)
        return self.share(x, self.splines @ self.displaced(change))

    def touched(self, grid: Array) -> OwnContacts:
        """The pairs that touch for coefficients (planes, m) m."""
        u = self.displaced(grid)
        x = self.place + self.splines @ u
        point, nearest, _ = self.near(x)
        solid = self.solid[nearest]
        n = len(point)
        start = self.begun(point, nearest)
        places = RestingPlaces(
            depth=np.zeros(n),
            X=self.place[nearest],
            cell=self.at[nearest],
            value=np.zeros((n, 9)),
            slope=np.zeros((n, 9)),
            normal=np.zeros((n, 3)),
            inverse=np.zeros((n, 3, 3)),
            bend=np.zeros((n, 3, 3)),
        )
        places_at_rest(
            self.cells,
            self.solids,
            (int(self._strides[0]), int(self._strides[1])),
            u.ravel(),
            x[point],
            solid,
            start,
            places,
        )
        on = np.flatnonzero(places.depth > 0.0)
        found = self._contacts(point[on], solid[on], x, places.chosen(on))
        if self.held is None:
            return found
        return replace(found, rubs=springs_of(self.held, grid.reshape(-1, 3)))

    def _contacts(self, point: Index, solid: Index, x: Array, at: RestingPlaces) -> OwnContacts:
        value = at.value.reshape(-1, 3, 3)
        slope = at.slope.reshape(-1, 3, 3)
        factors: list[Any] = [value] * 3
        gradient = np.empty((len(point), 27, 3))
        for axis in range(3):
            along = [slope if k == axis else value for k in range(3)]
            product = [along[k][:, k] for k in range(3)]
            gradient[:, :, axis] = np.einsum("ta,tb,tc->tabc", *product).reshape(-1, 27)
        own = np.einsum("ta,tb,tc->tabc", *(factors[k][:, k] for k in range(3))).reshape(-1, 27)
        lean = np.zeros((len(point), 54, 3))
        lean[:, 27:] = np.einsum("tji,taj->tai", at.inverse, gradient)
        there = self.cells.node[at.cell][:, None] + CORNERS @ self._strides
        node = self._number[np.concatenate([self._point_node[point], there], axis=1)]
        rigidity = self.rigidity(at.cell, point)
        share = np.concatenate([self._point_share[point], -own], axis=1)
        named = np.fmin(self._friction[point], self.cells.friction[at.cell])
        return OwnContacts(
            self,
            point,
            solid,
            at.X,
            x[point],
            rigidity,
            at.depth,
            node,
            share,
            lean,
            at.normal,
            at.bend,
            np.where(np.isnan(named), self.law[1], named),
            None,
        )
