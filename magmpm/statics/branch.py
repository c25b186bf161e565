"""Equilibria along a path of loads: each found from the one before, on its branch, until the branch ends.

A step is accepted where undamped Newton iterations from the state before contract (step k is at most CONTRACTION^k times the first) to a
state whose tangent is positive definite: then it is the neighbor of the one before, and stable. Otherwise the step is halved, down to
SHORTEST_ARC of what the caller requested; where nothing tells that the branch ends, neither an unstable neighbor nor the trend of the
smallest eigenvalue, to SHORTEST_ARC of that once more. A step that fails even then has passed the end of the branch, where the smallest
eigenvalue of the tangent reaches zero:

* a limit point: the branch turns back, and the body snaps to another. Near it the eigenvalue falls as the root of the distance;
* a bifurcation: the branch goes on but is unstable, as a straight column is beyond its buckling load. The eigenvalue falls linearly.

Where the smallest eigenvalue counts as zero (a buckled round rod turns about its axis freely), what is left of it is rounding, and what the
grid prefers. Its trend tells nothing: there the next eigenvalue is followed in its place.

The body then falls: from the last stable state, pushed slightly along the mode whose eigenvalue vanishes, down in energy by implicit Euler
steps of the overdamped motion M du/dt = -dE/du (M: mass matrix), each of limited length, to the minimum that they end in.

Sources: contraction of Newton's method: Deuflhard, Newton Methods for Nonlinear Problems, section 2.1; critical points: Riks, Int. J.
Solids Struct. 15 (1979) 529-551; Wriggers and Simo, IJNME 30 (1990) 155-176.

Unknowns that follow what is moved are given (layout.UnknownsLayout.fixed), so Newton's steps leave them alone: what a solve begins from
decides where they are. It begins from the shape of the unloaded body, moved to first order (Lift).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.effects import acting
from magmpm.errors import LeftField, SolveError
from magmpm.statics.definite import lowest_mode
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, energy_of, minimize_with_interaction
from magmpm.statics.layout import StaticModel
from magmpm.statics.nearby_minima import NearbyMinima
from magmpm.statics.newton import OnStep
from magmpm.statics.stability import NO_LOAD, stability, unloaded

SHORTEST_ARC = (
    2.0**-10
)  # of the step requested: attempts are halved down to this, and critical loads known within it
Kind = Literal["limit point", "bifurcation"]


class Loads(Protocol):
    """A path of loads: the model at any time, with its axes as the solve needs them (statics.layout)."""

    def at(self, time: float) -> StaticModel: ...

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """Coefficients (planes, m) m of the same displacement on the grid of a later (or earlier) time, s."""

    def moved(self, grid: Array, before: float, after: float) -> Array:
        """The same, with what holds the body where it is then."""


@dataclass(frozen=True)
class Jump:
    """The end of a branch, and where the body went from there.

    time: s, when the smallest eigenvalue reaches zero; kind; within: s, uncertainty of the time; moved: m, the farthest that a particle
    moved; released: J, energy lost in the fall; landed: s, when the body was found on its new branch.
    """

    time: float
    kind: Kind
    within: float
    moved: float
    released: float
    landed: float


@dataclass(frozen=True)
class Reached:
    """An equilibrium on the path: time s, its point.

    lowest: lowest eigenvalue of its tangent (1/s^2 in a mass of unit density; None: unknown), or the next one where that counts as zero
    (NearbyMinima.lowest); iterations: Newton steps and factorizations since the one before; step: s, the longest step to try next.
    """

    time: float
    point: Point
    lowest: float | None
    iterations: int
    step: float


class EquilibriumPath:
    """Follows equilibria along a path of loads. `now` is the last one."""

    def __init__(
        self,
        loads: Loads,
        now: Reached,
        *,
        tolerance: float,
        max_steps: int,
        on_step: OnStep | None = None,
    ) -> None:
        self.loads = loads
        self.now = now
        self.before: Reached | None = None  # the one before, on the same branch
        self._tolerance = tolerance
        self._max_steps = max_steps
        self._energy: Energy | None = None
        self._near = NearbyMinima(tolerance=tolerance, on_step=on_step)

    def settle_in(self, grid: Array) -> None:
        """Take an equilibrium that was found otherwise as the first: its energy, and its lowest eigenvalue."""
        energy = self.energy_at(self.now.time)
        point = point_of(energy.model, grid)
        self.now = replace(self.now, point=point, lowest=self._eigenvalue(energy, point))

    def state(self) -> tuple[dict[str, Array], Plain]:
        """Arrays and numbers from which `restored` makes the same branch."""
        kept = {"now": self.now, "before": self.before}
        known = {name: one for name, one in kept.items() if one is not None}
        arrays = {name: one.point.grid for name, one in known.items()}
        numbers = {
            name: [one.time, one.lowest, one.iterations, one.step] for name, one in known.items()
        }
        return arrays, numbers

    @classmethod
    def restored(
        cls, loads: Loads, arrays: dict[str, Array], numbers: Plain, **options: Any
    ) -> EquilibriumPath:
        """The branch of a `state`."""
        found = {}
        for name, (time, lowest, iterations, step) in numbers.items():
            found[name] = Reached(
                time, point_of(loads.at(time), arrays[name]), lowest, iterations, step
            )
        branch = cls(loads, found["now"], **options)
        branch.before = found.get("before")
        return branch

    def advance(self, until: float) -> list[Jump]:
        """Go on to a time (s). Returns the jumps on the way. Raises SolveError where the body falls to no rest, or leaves the field."""
        step_growth = 2.0  # of the step after one that was accepted
        jumps: list[Jump] = []
        self._near.begin()
        finest = SHORTEST_ARC * (until - self.now.time)
        growth = step_growth
        beyond = np.inf  # the earliest time at which an attempt failed
        while self.now.time < until:
            # Where nothing tells that the branch ends, a step may only have been too long: loads may grow a thousandfold within it.
            ends = beyond < np.inf and (
                self._near.unstable
                or _zero_of("limit point", self.before, self.now, beyond) < beyond
            )
            least = finest if ends else SHORTEST_ARC * finest
            gap = min(until, beyond) - self.now.time
            way = min(gap / 2 if ends else gap, self.now.step)
            if beyond < np.inf and gap <= 1.5 * least:
                jumps.append(
                    self._jump(beyond, min(until, beyond + 15 * finest))
                )  # nearer, a new branch is too steep
                beyond = np.inf
                continue
            end = min(until, beyond)
            target = end if self.now.time + way > end - 0.5 * least else self.now.time + way
            found = self._attempt(target)
            if found is None:
                # the next step is no longer than the one that was too long
                beyond = target
                growth = 1.0
                self.now = replace(self.now, step=max(way / 2, 0.5 * least))
                continue
            self.before = self.now
            self.now = replace(found, step=growth * way)
            growth = step_growth
            beyond = np.inf if target >= beyond else beyond
        self.now = replace(self.now, iterations=self._near.spent)
        return jumps

    def settle(self) -> bool:
        """Find the equilibrium of the present time again, under loads that have changed a little. Returns False if there is none nearby."""
        found = self._attempt(self.now.time)
        if found is not None:
            self.now = replace(found, step=self.now.step)
        return found is not None

    def stability(self) -> float:
        """Stability of the last equilibrium: its smallest eigenvalue over that of the unloaded body (statics.stability)."""
        energy = self.energy_at(self.now.time)
        if acting.feels_itself(energy.model.scene):
            return self._together_stable(energy.model, self.now.point)
        self._near.definite.made(energy, self.now.point)
        return stability(energy, self.now.point)

    def _together_stable(self, model: StaticModel, point: Point) -> float:
        """`stability` of a body whose segments act on each other."""
        return stability(InteractingEnergy(model), point)

    def energy_at(self, time: float) -> Energy:
        """The energy under the load of a time, s. Its work arrays are used again as long as the grid stays."""
        model = self.loads.at(time)
        if self._energy is None or self._energy.model.layout is not model.layout:
            self._energy = Energy(model)
        self._energy.load(model)
        return self._energy

    def _attempt(self, target: float) -> Reached | None:
        """The equilibrium at a time, if Newton's method contracts to it from the present one."""
        energy = self.energy_at(target)
        model = energy.model
        begin = self._expected(model, target)
        self._near.unstable = False
        if acting.feels_itself(model.scene):
            point = self._near.together(model, begin)
            lowest = None
            if point is not None:
                lowest = self._together_stable(model, point)
                self._near.unstable = lowest < -2e-3  # of the unloaded body's lowest eigenvalue
                point = None if self._near.unstable else point
        else:
            point = self._near.contracted(energy, begin)
            mode = None
            if point is not None:
                mode = self._near.lowest(energy, point)
                self._near.unstable = mode is None
            point, lowest = (None, None) if mode is None else (point, mode[0])
        if point is None:
            return None
        if model.pairs is not None:  # and is not fed: its grid stays
            way = point.grid - self.now.point.grid
            if energy.clear_share(self.now.point.grid, way) < 1.0:
                return None
        if (lost := outside_domain(model, point)) is not None:
            raise LeftField(lost.reason)
        return Reached(target, point, lowest, self._near.spent, self.now.step)

    def _expected(self, model: StaticModel, target: float) -> Array:
        """Coefficients (planes, m) m from which the equilibrium at a time is sought: the last ones, or beside obstacles as they went on.

        Points that are pressed against an obstacle, and do not go on along it, begin in it or away from it: other points touch then, and
        Newton's steps contract only from close by. Without obstacles they contract from the last equilibrium.
        """
        # times the last step: how far the way between the last two equilibria is taken to go on
        goes_on = 2.5
        now = self.now
        begin = self.loads.moved(now.point.grid, now.time, target)
        before = self.before
        if model.touching is None or before is None or target == now.time:
            return begin
        share = (target - now.time) / (now.time - before.time)
        if share > goes_on:
            return begin
        return begin + share * (begin - self.loads.moved(before.point.grid, before.time, target))

    def _eigenvalue(self, energy: Energy, point: Point) -> float | None:
        """Lowest eigenvalue (Pa/m^2) at a minimum; None where it is not known."""
        if acting.feels_itself(energy.model.scene):
            return self._together_stable(energy.model, point)
        mode = self._near.lowest(energy, point)
        return None if mode is None else mode[0]

    def _jump(self, past: float, landing: float) -> Jump:
        """The end of the branch, between now and a time (s) just past it; the body falls to where it is at `landing`, s."""
        last = self.now
        energy = self.energy_at(last.time)
        alone = (
            InteractingEnergy(energy.model).alone
            if acting.feels_itself(energy.model.scene)
            else energy
        )
        self._near.definite.made(
            alone, last.point
        )  # `last` is a minimum, or of the whole energy one
        lowest, mode = lowest_mode(alone, self._near.definite.mass(alone))
        if (
            alone is energy
        ):  # here the one that vanishes counts, though it may be as good as zero already
            last = replace(last, lowest=lowest - self._near.definite.shift)
        energy = alone
        kind = self._kind(energy, last, past, mode, lowest)
        critical = 0.5 * (last.time + past)
        if self.before is not None:
            critical = _zero_of(kind, self.before, last, past)
        energy = self.energy_at(landing)
        carry = self.loads.carried
        begin = energy.at(self.loads.moved(last.point.grid, last.time, landing))
        found = self._fall(energy, begin, carry(mode, last.time, landing))
        if (lost := outside_domain(energy.model, found)) is not None:
            raise LeftField(f"after a branch ended: {lost.reason}")
        moved = float(np.linalg.norm(found.position - begin.position, axis=1).max())
        self.now = Reached(
            landing, found, self._eigenvalue(energy, found), self._near.spent, landing - critical
        )
        self.before = None
        released = point_of(energy.model, begin.grid).energy - found.energy
        return Jump(critical, kind, past - last.time, moved, released, landing)

    def _kind(self, energy: Energy, last: Reached, past: float, mode: Array, lowest: float) -> Kind:
        """Decide whether the branch turns back there (its direction is the mode) or goes on unstable (its direction is free of the mode).

        energy: at the last state, with its factored tangent; lowest: that tangent's eigenvalue, of the mode. A load that does work on the
        mode moves the body along it by as much more as its eigenvalue is smaller; so does what is left of a solve, there. So where a load
        would, at the stiffness of the undeformed body, move it less than a hundredth as far along the mode as in other ways, the branch
        goes on.
        """
        mass = self._near.definite.mass(energy)
        layout = energy.model.layout
        least = 1.0
        if self.loads.at(past).layout is layout:
            moved = self.loads.moved(last.point.grid, last.time, past)
            after = self.energy_at(past)
            direction = (
                moved - last.point.grid - energy.matrix.solve(after.residual(after.at(moved)))
            )
            least = max(0.01 * self._near.definite.free(energy) / lowest, 1.0)
        elif self.before is not None:
            direction = last.point.grid - self.loads.carried(
                self.before.point.grid, self.before.time, last.time
            )
        else:
            return "limit point"
        along = float(np.sum(mass * direction * mode)) ** 2
        whole = float(np.sum(mass * direction**2) * np.sum(mass * mode**2))
        return "limit point" if along > least**2 * (whole - along) else "bifurcation"

    def _fall(self, energy: Energy, begin: Point, mode: Array) -> Point:
        """The minimum that the body falls to from just past the end of a branch."""
        length = float(np.ptp(energy.model.plane_coordinates()))
        push = 1e-3 * length / float(np.abs(mode).max()) * mode
        if (
            float(push[-1].sum()) < 0.0
        ):  # where nothing else decides: toward +z, as statics.newton does
            push = -push
        one = energy.at(begin.grid + push)
        other = energy.at(begin.grid - push)
        if other.energy < one.energy - 1e-3 * abs(one.energy + other.energy - 2 * begin.energy):
            one = other
        if acting.feels_itself(energy.model.scene):
            whole = InteractingEnergy(energy.model)
            return minimize_with_interaction(
                whole, one.grid, tolerance=self._tolerance, max_steps=self._max_steps
            ).point

        def stays_in_the_field(point: Point) -> None:
            if (lost := outside_domain(energy.model, point)) is not None:
                raise LeftField(f"as the body fell from a branch that ended: {lost.reason}")

        return self._near.settled(energy, one, 0.03 * length, stays_in_the_field)


def point_of(model: StaticModel, grid: Array) -> Point:
    """The state at coefficients (planes, m) m, with its whole energy."""
    return energy_of(model).at(grid)


def outside_domain(model: StaticModel, point: Point) -> SolveError | None:
    """The error if a solve has led into a magnet, to where the field is not known, or through an obstacle; else None."""
    if (
        model.touching is not None
        and (through := acting.passed(model.scene, model.touching.positions(point.grid)))
        is not None
    ):
        return SolveError(through)
    depth = 0.0 if point.own is None else float(point.own.depth.max(initial=0.0))
    if depth > model.scene.cell / 2:
        return SolveError(
            f"the body is {1e3 * depth:.3g} mm inside itself, more than half a cell: it was "
            "pressed in or passed through"
        )
    if not model.scene.effects.in_a_field:
        return None
    found = model.scene.external_field().outside_domain(point.position, model.time)
    return None if found is None else LeftField(f"{found[0]}; {found[2]}")


def _zero_of(kind: Kind, before: Reached | None, last: Reached, past: float) -> float:
    """Time when the lowest eigenvalue reaches zero, s, at most `past`: by its trend between two equilibria."""
    if (
        before is None
        or before.lowest is None
        or last.lowest is None
        or not before.lowest > last.lowest
    ):
        return past
    power = 2 if kind == "limit point" else 1
    far = before.lowest**power
    near = max(last.lowest, 0.0) ** power
    return float(
        np.clip(last.time + near * (last.time - before.time) / (far - near), last.time, past)
    )


class Lift:
    """Coefficients (planes, m) m by which what is moved moves all of an unloaded body; those of a body of which nothing is moved are 0."""

    def __init__(self, model: StaticModel) -> None:
        self._moves = model.scene.move or {}
        self._whole = {}
        if not model.driven:
            return
        bare, at = unloaded(model)
        for name, move in self._moves.items():
            given = model.displaced(**{name: move.whole})
            pulled = bare.products(at, given[:, None])[0][:, 0]
            self._whole[name] = given - bare.matrix.solve(np.ascontiguousarray(pulled))

    def at(self, time: float | None) -> Array:
        """Displacement of the moved parts at a time, s; None: at the end of its schedules."""
        return np.asarray(
            sum(move.share(time)[0] * self._whole[name] for name, move in self._moves.items())
        )

    def on(self, grid: Array, before: float, after: float) -> Array:
        """Coefficients `grid` (planes, m) m of a time, s, as those of another one begin; the same array where nothing is moved."""
        return grid if not self._moves else grid + (self.at(after) - self.at(before))


class GrowingLoads:
    """The path on which all loads of a model, and the way of what is moved, grow from nothing, at 0, to all, at 1. statics.branch.Loads."""

    def __init__(self, model: StaticModel) -> None:
        self._model = model
        self._way = Lift(model).at(model.time)

    def at(self, time: float) -> StaticModel:
        """The model under a share of its loads; at 0 under next to none, by the same kernels."""
        return replace(
            self._model,
            effects=acting.collect(self._model.scene, max(time, NO_LOAD), self._model.times),
        )

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """The same coefficients: the grid stays."""
        return grid

    def moved(self, grid: Array, before: float, after: float) -> Array:
        """The same, with what holds the body where it is at the later share."""
        return grid + (after - before) * self._way
