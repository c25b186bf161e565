"""Many rods that descend to a target at once: directions and a field, by Levenberg's and Marquardt's method.

A body that bends strongly has several equilibria, and is found on the branch that grows from zero load. So each shape of a descent is
relaxed from the straight rod: from the shape of the step before, descents went down branches on which no body is.

A field that varies in space, and its gradient, are taken at the places of the target, where the body is if the design is right.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import rod_model
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.studies.search.samplers.blocks import across, unit

# in each segment: the rod is a thousandth of its length from its limit, less than from the body
ELEMENTS_PER_SEGMENT = 8
DESIGNS_SOUGHT = 6  # that are looked for
# of the length: descents end where DESIGNS_SOUGHT of them are nearer, since the body is not that near to
# the rod
AT_TARGET = 3e-4
DAMPING = 0.1  # of the first step of a descent
# in which the load of the last descents grows, each then less than about two radians of bending
LOAD_STEPS = 4
# times that rods relax in a pull: with one, that on the shape before, steps that are better look
# worse and are refused
PULLS = 3


@dataclass
class RodDescents:
    """Several designs, s of them, on their way down, and what the rod says of each.

    Attributes
    ----------
    directions : array (s, k, 3), no unit
        Unit vectors of the k varied regions.
    field : array (s, 3), no unit
        The uniform field in shares of the greatest.
    quaternions : array (s, n + 1, 4), no unit
        Frames of the rods.
    residuals : array (s, m), m
        Weighted gaps.
    slopes : array (s, m, q)
        Their derivatives in the tangent space.
    basis : array (s, k, 3, 2), no unit
        Two unit vectors across each direction.
    cost : array (s,), m^2
        Sums of squares; infinite where there is no stable shape.
    damping : array (s,)
        Of the next step.
    """

    directions: Array
    field: Array
    quaternions: Array
    residuals: Array  # (s, m)
    slopes: Array  # (s, m, q) in the tangent space
    basis: Array  # (s, k, 3, 2)
    cost: Array  # (s,)
    damping: Array  # (s,)

    def best(self, count: int) -> RodDescents:
        """Keep the descents of least cost.

        Parameters
        ----------
        count : int
            How many.

        Returns
        -------
        RodDescents
            These, best first.
        """
        order = np.argsort(self.cost, kind="stable")[:count]
        return RodDescents(**{name: value[order] for name, value in vars(self).items()})

    def and_those(self, others: RodDescents) -> RodDescents:
        """Join these descents and others.

        Parameters
        ----------
        others : RodDescents
            The others.

        Returns
        -------
        RodDescents
            All of them.
        """
        theirs = vars(others)
        return RodDescents(
            **{name: np.concatenate([value, theirs[name]]) for name, value in vars(self).items()}
        )


class DescendingRods:
    """Rods of a scene against a target.

    Parameters
    ----------
    scene : Scene
        The scene.
    target : array (m, 4), m
        Rows [s, x, y, z].
    regions : sequence of int
        Indices of the k regions whose directions vary.
    field_max : float, T, or None
        Greatest strength of a varied field; None: the scene's field stays.

    Raises
    ------
    SolveError
        Where the scene has no rod.
    """

    def __init__(
        self, scene: Scene, target: Array, regions: Sequence[int], field_max: float | None
    ) -> None:
        rod = rod_model(
            scene, max(5 * ELEMENTS_PER_SEGMENT, ELEMENTS_PER_SEGMENT * len(scene.regions()))
        )
        s = rod.places
        if field_max is not None:
            rod = replace(rod, field=np.zeros_like(rod.field))
        self.gradient: Array | None = None  # (n + 1, 3, 3) T/m
        if scene.field.varies and scene.effects.in_a_field:
            source = scene.external_field()
            places = _along_target(scene, target, s)
            without = np.zeros(3) if field_max is None else np.array(scene.field.uniform)
            rod = replace(rod, field=source.at(places) - without)
            self.gradient = (
                source.gradient(places) if scene.effects.magnetic_force is not None else None
            )
        self.family = RodFamily.of(rod, scene.body.shape.segment_lengths(), regions)  # type: ignore[attr-defined]
        self.field_max = field_max
        self.count = len(regions)
        self.target = target
        self.length = scene.length
        self.load_steps = 1  # in which the load of a rod grows
        self.before = np.clip(
            np.searchsorted(s, target[:, 0], side="right") - 1, 0, len(s) - 2
        )  # the frames beside each station
        share = (target[:, 0] - s[self.before]) / np.diff(s)[self.before]
        self.shares = np.stack([1 - share, share]) / np.sqrt(len(target))

    def within(self, field_max: float) -> DescendingRods:
        """Make the problem with another bound of the field.

        Parameters
        ----------
        field_max : float, T
            The bound.

        Returns
        -------
        DescendingRods
            The other problem.
        """
        other = copy.copy(self)
        other.field_max = field_max
        return other

    def carefully(self, at: RodDescents, phases: Sequence[tuple[int, int]]) -> RodDescents:
        """Descend as `descended` does, but let each shape relax under a load that grows in LOAD_STEPS.

        Parameters
        ----------
        at : RodDescents
            Where they are.
        phases : sequence of tuple[int, int]
            As of `descended`.

        Returns
        -------
        RodDescents
            Where they have come to.
        """
        other = copy.copy(self)
        other.load_steps = LOAD_STEPS
        return other.descended(
            other.state(at.directions, at.field, at.quaternions, at.damping), phases
        )

    @property
    def unit_field(self) -> float:
        """The field, T, that bends the rod by about a radian: M B L^2 = E I. Infinite for a rod without moments."""
        rod = self.family.rod
        moment = float(np.linalg.norm(rod.moment, axis=1).max())
        return (
            float(rod.twist_bend[:, 1:].min()) / (moment * self.length**2)
            if moment > 0.0
            else np.inf
        )

    def shapes(
        self, directions: Array, field: Array, before: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Find the rods' shapes of several designs.

        Parameters
        ----------
        directions : array (s, k, 3), no unit
            Unit vectors.
        field : array (s, 3), no unit
            In shares of the greatest.
        before : array (s, n + 1, 4), no unit
            Quaternions of the shapes in which a field that varies pulls.

        Returns
        -------
        residuals : array (s, m), m
            Weighted gaps.
        slopes : array (s, m, c), m
            Their derivatives by directions and by shares of the greatest field.
        found : array (s,) of bool
            Whether there is a stable shape.
        quaternions : array (s, n + 1, 4), no unit
            Frames of the rods.
        """
        fields = None if self.field_max is None else self.field_max * field
        quaternions = self.family.straight(len(directions))
        position, slopes, found = self._relaxed(quaternions, directions, fields, before)
        goal = self.target[:, 1:] / np.sqrt(len(self.target))
        rows = (self._at_stations(position) - goal).reshape(len(position), -1)
        columns = self._at_stations(slopes).reshape(*rows.shape, -1)
        if self.field_max is not None:
            columns[:, :, -3:] *= self.field_max
        return rows, columns, found, quaternions

    def _relaxed(
        self, quaternions: Array, directions: Array, fields: Array | None, before: Array
    ) -> tuple[Array, Array, Array]:
        """RodFamily.relaxed, under a load that grows in steps, from quaternions that are changed in place.

        A pull turns with the moments, so rods relax again in the pull on the shapes that they came to. before: as of `shapes`.
        """
        gradient = self.gradient
        pull: Array | float = (
            0.0 if gradient is None else self.family.pull(before, directions, gradient)
        )
        for step in range(1, self.load_steps):
            self.family.relaxed(
                quaternions,
                directions,
                fields,
                pull=pull,
                share=step / self.load_steps,
                sloped=False,
            )
        if gradient is not None:
            for _ in range(PULLS - 1):
                self.family.relaxed(quaternions, directions, fields, pull=pull, sloped=False)
                pull = self.family.pull(quaternions, directions, gradient)
        return self.family.relaxed(quaternions, directions, fields, pull=pull)

    def _at_stations(self, values: Array) -> Array:
        """Values (s, n + 1, ...) at the frames as values (s, m, ...) at the target's m stations, over the root of m."""
        shares = self.shares.reshape(2, -1, *(1,) * (values.ndim - 2))
        return np.asarray(
            shares[0] * values[:, self.before] + shares[1] * values[:, self.before + 1]
        )

    def state(self, directions: Array, field: Array, before: Array, damping: Array) -> RodDescents:
        """Begin descents at several designs.

        Parameters
        ----------
        directions : array (s, k, 3), no unit
            Unit vectors.
        field : array (s, 3), no unit
            In shares of the greatest.
        before : array (s, n + 1, 4), no unit
            As of `shapes`.
        damping : array (s,)
            Of their first steps.

        Returns
        -------
        RodDescents
            The descents; one without a stable shape has an infinite cost.
        """
        rows, columns, found, quaternions = self.shapes(directions, field, before)
        basis = across(directions)
        count = 3 * self.count
        turned = np.einsum(
            "smka,skab->smkb", columns[:, :, :count].reshape(*rows.shape, -1, 3), basis
        )
        slopes = np.concatenate(
            [turned.reshape(*rows.shape, 2 * self.count), columns[:, :, count:]], axis=2
        )
        cost = np.where(found, np.einsum("sm,sm->s", rows, rows), np.inf)
        return RodDescents(directions, field, quaternions, rows, slopes, basis, cost, damping)

    def step(self, at: RodDescents) -> RodDescents:
        """Take one step of all descents; those that did not get better stay, with more damping.

        Parameters
        ----------
        at : RodDescents
            Where they are.

        Returns
        -------
        RodDescents
            Where they have come to.
        """
        A = np.einsum("smi,smj->sij", at.slopes, at.slopes, optimize=True)
        g = np.einsum("smi,sm->si", at.slopes, at.residuals)
        if self.field_max is not None:
            _hold_at_the_bound(A, g, at.field)
        scale = np.maximum(np.einsum("sii->s", A) / max(A.shape[1], 1), 1e-300)
        A += (at.damping * scale)[:, None, None] * np.eye(A.shape[1])
        p = -np.linalg.solve(A, g[:, :, None])[:, :, 0]
        turns = p[:, : 2 * self.count].reshape(len(p), self.count, 2)
        directions = _turned(at.directions, np.einsum("skab,skb->ska", at.basis, turns))
        field = at.field
        if self.field_max is not None:
            field = in_ball(field + p[:, -3:])
        new = self.state(directions, field, at.quaternions, np.maximum(at.damping / 5, 1e-9))
        better = new.cost < at.cost
        kept = {
            name: np.where(better.reshape(-1, *(1,) * (value.ndim - 1)), getattr(new, name), value)
            for name, value in vars(at).items()
        }
        kept["damping"] = np.where(better, new.damping, np.minimum(6 * at.damping, 1e6))
        return RodDescents(**kept)

    def descended(self, at: RodDescents, phases: Sequence[tuple[int, int]]) -> RodDescents:
        """Descend in phases; less where enough of the descents are at their target.

        Parameters
        ----------
        at : RodDescents
            Where they are.
        phases : sequence of tuple[int, int]
            Of each the steps, and how many of the best go on.

        Returns
        -------
        RodDescents
            Where they have come to.
        """
        for steps, left in phases:
            for _ in range(steps):
                if (
                    np.sort(at.cost)[min(DESIGNS_SOUGHT, len(at.cost)) - 1]
                    < (AT_TARGET * self.length) ** 2
                ):
                    break
                at = self.step(at)
            at = at.best(left)
        return at

    def begun(self, uniform: Array) -> RodDescents:
        """Begin descents at points that are spread over the spheres of directions and the ball of fields.

        Parameters
        ----------
        uniform : array (s, 3 k + 3), no unit
            Numbers from 0 to 1.

        Returns
        -------
        RodDescents
            The descents.
        """
        starts = len(uniform)
        directions = _on_sphere(uniform[:, : 3 * self.count].reshape(starts, -1, 3))
        field = _on_sphere(uniform[:, None, -3:])[:, 0] * (0.4 + 0.6 * uniform[:, -1:])
        return self.begun_with(directions, field)

    def begun_with(self, directions: Array, field: Array) -> RodDescents:
        """Begin descents at given designs, from the straight rod.

        Parameters
        ----------
        directions : array (s, k, 3), no unit
            Unit vectors.
        field : array (s, 3), no unit
            In shares of the greatest.

        Returns
        -------
        RodDescents
            The descents.
        """
        starts = len(field)
        return self.state(directions, field, self.family.straight(starts), np.full(starts, DAMPING))

    def beside(self, at: RodDescents, draw: np.random.Generator, turn: float) -> RodDescents:
        """Begin descents at designs that are drawn beside others.

        Parameters
        ----------
        at : RodDescents
            The others.
        draw : numpy.random.Generator
            Of random numbers.
        turn : float, rad
            Root mean square of each direction's turns about the axes, and of what each component of the field, in shares of the
            greatest, is changed by.

        Returns
        -------
        RodDescents
            The descents.
        """
        turns = np.cross(draw.normal(0.0, turn, at.directions.shape), at.directions)
        field = at.field
        if self.field_max is not None:
            field = in_ball(field + draw.normal(0.0, turn, field.shape))
        damping = np.full(len(field), DAMPING)
        return self.state(_turned(at.directions, turns), field, at.quaternions, damping)


def in_ball(vectors: Array) -> Array:
    """Bring vectors to the nearest points of the unit ball.

    Parameters
    ----------
    vectors : array (n, 3)
        The vectors.

    Returns
    -------
    array (n, 3)
        The points.
    """
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1.0))


def _along_target(scene: Scene, target: Array, s: Array) -> Array:
    """Places (n + 1, 3) m of the rod's frames if it has the target's shape; beyond the target's end it goes on straight."""
    rows = target if target[0, 0] == 0.0 else np.vstack([np.zeros(4), target])
    places = linear(s, rows[:, 0], rows[:, 1:])
    end = unit(rows[-1:, 1:] - rows[-2:-1, 1:])
    line = scene.body.shape.line
    assert line is not None  # only straight bodies are rods
    return np.asarray(
        np.array(line.base) + places + np.maximum(s - rows[-1, 0], 0.0)[:, None] * end
    )


def _hold_at_the_bound(A: Array, g: Array, field: Array) -> None:
    """Keeps fields that are as strong as they may be, and would become stronger, at that strength: no step along them."""
    size = np.linalg.norm(field, axis=1)
    outward = field / np.maximum(size, 1e-300)[:, None]
    held = (size > 1 - 1e-9) & (np.einsum("si,si->s", g[:, -3:], outward) < 0)
    stiff = 1e6 * np.einsum("sii->s", A)
    A[held, -3:, -3:] += stiff[held, None, None] * outward[held, :, None] * outward[held, None, :]


def _turned(units: Array, turns: Array) -> Array:
    """Unit vectors (..., 3) after turns (..., 3) across them, rad, along great circles."""
    angle = np.linalg.norm(turns, axis=-1, keepdims=True)
    return unit(np.cos(angle) * units + np.sinc(angle / np.pi) * turns)


def _on_sphere(u: Array) -> Array:
    """Unit vectors of uniform density for numbers u (..., 3) in 0 to 1, of which the third is free."""
    x = 2 * u[..., 0] - 1
    turn = 2 * np.pi * u[..., 1]
    across = np.sqrt(1 - x * x)
    return np.stack([x, across * np.cos(turn), across * np.sin(turn)], axis=-1)
