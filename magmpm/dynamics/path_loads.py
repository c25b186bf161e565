"""The loads along a path of equilibria: a body that is held in a field that changes, or one that is fed out of a guide.

Of a fed catheter only the part outside the guide bends: a shorter catheter, clamped exactly at the guide's exit, with a grid of its own for
each length. Its displacement is carried from one length to the next at the points of the material, so that nothing jumps with the cells.
"""

from __future__ import annotations

from collections import OrderedDict
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.body_shape import Line
from magmpm.compiled.arrays import Array, Mask
from magmpm.effects import acting
from magmpm.effects.base import Records
from magmpm.effects.contact_law import Obstacle, most_friction
from magmpm.model import Model, build, reshaped
from magmpm.results import measures
from magmpm.scene import Scene
from magmpm.scene.coarsest import knots_of
from magmpm.statics import axis
from magmpm.statics.axis import along
from magmpm.statics.branch import Lift
from magmpm.statics.contact import CONTACT_SETTLED, Held, Touched, change, followed, held_at
from magmpm.statics.energy import Point
from magmpm.statics.equilibrium import Equilibrium, solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.own_contact import HeldPairs, OwnContacts, changed, holding, released


@dataclass(frozen=True)
class EquilibriumShape:
    """The whole body at one equilibrium: position (n, 3) m and F (n, 3, 3) of the model's particles, axis rows [s, x, y, z] (m, 4) m and
    tip (3,) m, None for parts that name none; min_det_F and max_det_F; dof: unknowns of the solve; touched: the points that touch
    obstacles; own: the pairs in which the body touches itself.
    """

    model: Model
    position: Array
    F: Array
    centreline: Array
    tip: Array | None
    min_det_F: float
    max_det_F: float
    dof: int
    touched: Touched | None = None
    own: OwnContacts | None = None


class FieldLoads:
    """The load of a body that stays where it is: the field changes, and what holds the body moves. statics.branch.Loads."""

    def __init__(self, scene: Scene, time: float) -> None:
        self.whole = build(scene, time=time)
        self.model = static_model(self.whole)
        self._lift = Lift(self.model)
        self.held: Held | None = None  # by friction
        self._begun: tuple[Array, Held] | None = (
            None  # places (n, 3) m of the surface as the increment began, and how it was held then
        )
        named = [
            effect
            for effect in self.model.scene.effects.named().values()
            if isinstance(effect, Obstacle)
        ]
        self._rough = any(most_friction(self.model.scene, effect.friction) > 0 for effect in named)
        self.held_pairs: HeldPairs | None = None  # of the body with itself
        self._pairs_begun: tuple[HeldPairs, Array] | None = None
        own = self.model.scene.effects.self_contact
        self._rubs = own is not None and most_friction(self.model.scene, own.friction) > 0

    def bends(self, time: float) -> bool:
        """True if any part of the body can bend at a time, s."""
        return True

    def inserted(self, time: float) -> float | None:
        """Length (m) outside of the guide; None where there is none."""
        return None

    def first(self, time: float) -> Equilibrium:
        """The equilibrium at a time, s, found as statics finds one."""
        return solve_static(replace(self.model, effects=self._named(time), time=time))

    def at(self, time: float) -> StaticModel:
        """The model, with its axes as the solve needs them, under the load of a time, s."""
        surface = self.model.touching
        touching = None if surface is None else replace(surface, held=self.held)
        pairs = self.model.pairs
        return replace(
            self.model,
            effects=self._named(time),
            time=time,
            touching=touching,
            pairs=None if pairs is None else pairs.held_by(self.held_pairs),
        )

    def hold(self, time: float, point: Point) -> bool:
        """Let friction hold points as this equilibrium presses them. Returns True if that changes what holds them."""
        pairs_differ = self._hold_pairs(point)
        return self._hold_points(time, point) or pairs_differ

    def _hold_pairs(self, point: Point) -> bool:
        own = point.own
        if own is None or not self._rubs:
            return False
        nodes = point.grid.reshape(-1, 3)
        start = self._pairs_begun or (released(own, nodes, None), nodes)
        now = holding(own, nodes, start)
        if self.held_pairs is not None and changed(self.held_pairs, now) < CONTACT_SETTLED:
            return False
        self.held_pairs = now
        return True

    def _hold_points(self, time: float, point: Point) -> bool:
        surface = self.model.touching
        if surface is None or not self._rough:
            return False
        now = held_at(
            self._named(time),
            surface.positions(point.grid),
            surface.mass,
            surface.friction,
            self._begun,
        )
        if self.held is not None and change(self.held, now) < CONTACT_SETTLED:
            return False
        self.held = now
        return True

    def let_slide(self, point: Point) -> None:
        """Begin an increment at an equilibrium: anchors follow the points that slid."""
        surface = self.model.touching
        if self.held is not None and surface is not None:
            was = surface.positions(point.grid)
            self.held = followed(self.held, was)
            self._begun = was, self.held
        if point.own is not None and self._rubs:
            nodes = point.grid.reshape(-1, 3)
            self.held_pairs = released(point.own, nodes, self.held_pairs)
            self._pairs_begun = self.held_pairs, nodes

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """Return the same coefficients: the grid does not move."""
        return grid

    def moved(self, grid: Array, before: float, after: float) -> Array:
        """The coefficients after what holds the body has moved to its place at the later time."""
        return self._lift.on(grid, before, after)

    def shape(self, time: float, point: Point | None) -> EquilibriumShape:
        """The body at an equilibrium of a time, s."""
        assert point is not None  # it always bends
        model = self.model
        tip = (
            measures.named_tip(model, point.position)
            if model.line is None
            else axis.tip(model, point.grid)
        )
        rows = axis.centreline(model, point.grid)
        return EquilibriumShape(
            replace(self.whole, time=time),
            point.position,
            point.F @ np.swapaxes(model.axes, -1, -2),  # along x, y, z, as in motions
            rows,
            tip,
            point.min_det_F,
            point.max_det_F,
            model.dof,
            point.touched,
            point.own,
        )

    def _named(self, time: float) -> Records:
        return acting.collect(self.model.scene, times=np.array([time]))


class FeedLoads:
    """The load of a catheter that is pushed through a guide: its free part grows, in a field that may change. statics.branch.Loads."""

    def __init__(self, scene: Scene, time: float) -> None:
        feed = scene.effects.feed
        assert feed is not None  # dynamics.quasi_static.loads_of
        self._speed = feed.speed
        self._exit = feed.exit
        self.scene = scene
        self.whole = build(scene, time=time)
        self._free = scene.with_effects(feed=None)
        self._bare = self._free.with_effects(
            ground=None, walls=None
        )  # obstacles stay where they are, whatever is fed
        self.held: Held | None = None  # friction doesn't hold what is fed
        self.held_pairs: HeldPairs | None = None
        self._models: OrderedDict[float, StaticModel] = OrderedDict()

    def inserted(self, time: float) -> float:
        """Length (m) outside of the guide, at most the whole."""
        return min(max(self.scene.length - self._exit + self._speed * time, 0.0), self.scene.length)

    def bends(self, time: float) -> bool:
        """True if enough of the body is outside the guide at a time, s."""
        return (
            self.inserted(time) >= self.scene.thickness
        )  # a shorter piece outside of the guide is taken as straight

    def at(self, time: float) -> StaticModel:
        """The model of the part outside the guide, clamped at its exit."""
        if time not in self._models:
            part = self._bare.inserted(self.inserted(time))
            base = np.array([self._exit, 0.0, 0.0])
            shape = part.body.shape
            resolution = part.resolution
            made = shape.discretize(
                resolution.cells_across, resolution.particles_per_cell, knots_of(part)
            )
            grid = made.grid
            particles = made.particles
            made = replace(
                made,
                grid=replace(grid, origin=grid.origin + base),
                particles=replace(particles, position=particles.position + base),
            )
            named = acting.collect(self._free, times=np.array([time]))
            line = Line((self._exit, 0.0, 0.0), shape.length)
            model = reshaped(replace(self.whole, scene=self._free), shape, made)
            made_static = static_model(replace(model, effects=named, time=time, line=line))
            self._models[time] = replace(made_static, again=lambda near: self._with(near).at(time))
            while len(self._models) > 4:  # lengths
                self._models.popitem(last=False)
        return self._models[time]

    def _with(self, free: Scene) -> FeedLoads:
        """The loads of a scene without its guide, whose body is the same."""
        other = copy(self)
        other._free = free
        other._bare = free.with_effects(ground=None, walls=None)
        other.whole = replace(self.whole, scene=free)
        other._models = OrderedDict()
        return other

    def first(self, time: float) -> Equilibrium:
        """The equilibrium at a time, s, found as statics finds one: from the rod, or in a field that varies by a ramp of the load."""
        model = self.at(time)
        if (
            self.scene.field.varies or model.touching is not None
        ):  # the rod would need what is around a body that begins at the exit
            slow = self._free.solver.static.model_copy(update={"field_steps": 8})
            scene = self._free.model_copy(
                update={"solver": self._free.solver.model_copy(update={"static": slow})}
            )
        else:
            scene = self._bare.inserted(self.inserted(time)).model_copy(
                update={"field": self.scene.field}
            )
        return solve_static(replace(model, scene=scene))

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """The same displacement of the material on the grid of another length; what was in the guide has none."""
        old = self.at(before)
        new = self.at(after)
        if old is new:
            return grid
        return np.ascontiguousarray(
            along(old, new, grid, moved=self.inserted(before) - self.inserted(after))
        )

    moved = carried

    def hold(self, time: float, point: Point) -> bool:
        """Return False: nothing is held by friction."""
        return False

    def let_slide(self, point: Point) -> None:
        """Begin an increment: nothing slides."""

    def shape(self, time: float, point: Point | None) -> EquilibriumShape:
        """The whole catheter: what is in the guide is straight, and moved by the push."""
        whole = self.whole
        fed = self._speed * time
        X = whole.particles.position
        clamp = self._exit - fed  # m along the catheter
        position = X + np.array([fed, 0.0, 0.0])
        F = np.tile(np.eye(3), (len(X), 1, 1))
        s = whole.grid.stations
        rows = np.column_stack([s, s + fed, np.zeros((len(s), 2))])
        tip = np.array([self.scene.length + fed, 0.0, 0.0])
        dof = 0
        if point is not None:
            part = self.at(time)
            free = X[:, 0] > clamp
            u, slope = _displacement(part, point.grid, whole, free, clamp)
            position[free] += u
            F[free] += slope
            out = s > clamp
            rows[out, 1:] = axis.along_axis(
                part, point.grid, axis.section_weights(part), s[out] - clamp
            )
            tip = axis.tip(part, point.grid)
            dof = part.dof
        low, high = (1.0, 1.0) if point is None else (point.min_det_F, point.max_det_F)
        touched = None if point is None else point.touched
        return EquilibriumShape(
            replace(whole, time=time), position, F, rows, tip, low, high, dof, touched
        )


def _displacement(
    part: StaticModel, grid: Array, whole: Model, free: Mask, clamp: float
) -> tuple[Array, Array]:
    """Displacement (k, 3) m and its gradient (k, 3, 3) at the whole's free particles; clamp: m, where the part begins on its axis."""
    layout = part.layout
    weights, slopes = (values[free] for values in whole.splines())
    node, weights[:, 0], slopes[:, 0] = part.grid.splines_along(
        whole.particles.position[free, 0] - clamp
    )
    planes = np.concatenate([-grid[:1], grid]).reshape(
        layout.planes + 1, layout.nodes_per_plane, 3
    )  # node 0: the clamp eliminated it
    nodes = np.zeros((layout.planes + 1, *part.grid.nodes[1:], 3))
    nodes[:, layout.node_yz[:, 0], layout.node_yz[:, 1]] = planes
    at = whole.particles.cell[free]
    u = np.zeros((len(node), 3))
    gradient = np.zeros((len(node), 3, 3))
    for a, b, c in np.ndindex(3, 3, 3):
        value = nodes[node + a, (at[:, 1] + b) % nodes.shape[1], at[:, 2] + c]
        w = (weights[:, 0, a], weights[:, 1, b], weights[:, 2, c])
        d = (slopes[:, 0, a], slopes[:, 1, b], slopes[:, 2, c])
        u += (w[0] * w[1] * w[2])[:, None] * value
        for k, rate in enumerate((d[0] * w[1] * w[2], w[0] * d[1] * w[2], w[0] * w[1] * d[2])):
            gradient[:, :, k] += rate[:, None] * value
    return u, gradient @ np.swapaxes(whole.grid.axes_at(whole.particles.position[free]), -1, -2)
