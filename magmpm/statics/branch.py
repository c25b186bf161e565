"""Equilibria along a path of loads: each found from the one before, on its branch, until the branch ends.

A step is accepted where undamped Newton iterations from the prediction contract (each step at most CONTRACTION times the one before)
to a state whose tangent is positive definite: then the state is the neighbor of the one before, and stable. Otherwise the step is halved,
down to FINEST of what the caller asked for. A step that fails even then has passed the end of the branch, where the smallest eigenvalue of
the tangent reaches zero:

* a limit point: the branch turns back, and the body snaps to another. Near it the eigenvalue falls as the root of the distance;
* a bifurcation: the branch goes on but is unstable, as a straight column is beyond its buckling load. The eigenvalue falls linearly.

The body then falls: from the last stable state, pushed slightly along the mode whose eigenvalue vanishes, down in energy by implicit Euler
steps of the overdamped motion M du/dt = -dE/du (M: mass matrix), each of limited length, to the minimum that they end in.

Sources: contraction of Newton's method: Deuflhard, Newton Methods for Nonlinear Problems, section 2.1; critical points: Riks, Int. J.
Solids Struct. 15 (1979) 529-551; Wriggers and Simo, IJNME 30 (1990) 155-176.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.errors import SolveError
from magmpm.statics.block_cholesky import factor, solve
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import NEAR, _chord_steps, _step, factored, minimize

CONTRACTION = 0.5  # of Newton's steps, below which they are sure to stay with the branch
ALIKE = 1e-5  # of the length: steps shorter than this may shrink more slowly, down to rounding
MOST_NEWTON = 12  # steps of one attempt
FINEST = 2.0**-10  # of the step asked for: attempts are halved down to this, and critical loads known within it
GROWTH = 2.0  # of the step after one that was accepted
PUSH = 1e-3  # of the length: how far along its mode an unstable body is pushed off
LONGEST_FALL = 0.03  # of the length: a step of a fall
MOST_FALLING = 400  # steps of a fall
SOFT = 100.0  # of Energy.least_scale, a strain of 1e-8: near a critical load rounding alone moves the soft mode by an energy like this
Kind = Literal["limit point", "bifurcation"]
Tell = Callable[[int, float], None]


class Loads(Protocol):
    """A path of loads: the model at any time, with its axes as the solve needs them (statics.axis_order)."""

    def at(self, time: float) -> StaticModel: ...

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """Coefficients (planes, m) m of the same displacement on the grid of a later (or earlier) time, s."""


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
    """An equilibrium on the path: time s, its point, the lowest eigenvalue of its tangent (1/s^2 in a mass of unit density; None: unknown),
    Newton steps and factorizations since the one before; step: s, the longest step to try next."""

    time: float
    point: Point
    lowest: float | None
    iterations: int
    step: float


class Branch:
    """Follows equilibria along a path of loads. `now` is the last one."""

    def __init__(self, loads: Loads, now: Reached, *, tolerance: float, max_steps: int, on_step: Tell | None = None) -> None:
        self.loads, self.now = loads, now
        self.before: Reached | None = None  # the one before, on the same branch
        self._tolerance, self._max_steps, self._tell = tolerance, max_steps, on_step
        self._energy: Energy | None = None
        self._spent = 0

    def settle_in(self, grid: Array) -> None:
        """Take an equilibrium that was found otherwise as the first: its energy, and its lowest eigenvalue."""
        energy = self.energy_at(self.now.time)
        point = energy.at(grid)
        lowest = None
        if not acting.feels_itself(energy.model.scene):
            factored(energy, point)
            lowest = lowest_mode(energy)[0]
        self.now = replace(self.now, point=point, lowest=lowest)

    def state(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and numbers from which `restored` makes the same branch."""
        kept = {"now": self.now, "before": self.before}
        known = {name: one for name, one in kept.items() if one is not None}
        arrays = {name: one.point.grid for name, one in known.items()}
        numbers = {name: [one.time, one.lowest, one.iterations, one.step] for name, one in known.items()}
        return arrays, numbers

    @classmethod
    def restored(cls, loads: Loads, arrays: dict[str, Array], numbers: dict[str, Any], **options: Any) -> Branch:
        """The branch of a `state`."""
        found = {}
        for name, (time, lowest, iterations, step) in numbers.items():
            found[name] = Reached(time, Energy(loads.at(time)).at(arrays[name]), lowest, iterations, step)
        branch = cls(loads, found["now"], **options)
        branch.before = found.get("before")
        return branch

    def advance(self, until: float) -> list[Jump]:
        """Go on to a time (s). Returns the jumps on the way. Raises SolveError where the body falls to no rest, or leaves the field."""
        jumps: list[Jump] = []
        asked, failed = until - self.now.time, np.inf
        finest, self._spent = FINEST * asked, 0
        while self.now.time < until:
            way = min(until - self.now.time, self.now.step)
            if failed < np.inf:
                way = min(way, failed - self.now.time)
            target = until if self.now.time + way > until - 0.5 * finest else self.now.time + way
            found = self._attempt(target)
            if found is not None:
                self.before = self.now
                self.now = replace(found, step=max(GROWTH * way, found.step))
                failed = np.inf if target >= failed else failed
            elif way > 1.01 * finest:
                failed = target
                self.now = replace(self.now, step=way / 2)
            else:
                jumps.append(self._jump(target))
                failed = np.inf
        self.now = replace(self.now, iterations=self._spent)
        return jumps

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
        begin = self.loads.carried(self.now.point.grid, self.now.time, target)
        if acting.feels_itself(model.scene):
            point = self._together(model, begin)
            lowest = None
        else:
            point = self._contracted(energy, begin)
            lowest = None if point is None else lowest_mode(energy)[0]
        if point is None:
            return None
        if (lost := outside_domain(model, point)) is not None:
            raise SolveError(f"t = {target:.6g} s: {lost}")
        return Reached(target, point, lowest, self._spent, self.now.step)

    def _contracted(self, energy: Energy, begin: Array) -> Point | None:
        """The minimum to which Newton's steps contract, with its factored tangent in the energy's panels; None where they do not."""
        point, rest, last = energy.at(begin), energy.rest_energy(), np.inf
        alike = ALIKE * float(np.ptp(energy.model.plane_coordinates()))
        for step in range(MOST_NEWTON):
            if not point.min_det_F > 0:
                return None
            residual, direction, shift = _step(energy, point, 0.0)
            self._spent += 1
            if shift > 0.0 and step > 0:  # the prediction alone may hold a spurious pressure
                return None
            decrement = -float(np.sum(residual * direction)) / 2
            scale = max(abs(point.energy - rest), energy.least_scale())
            if self._tell is not None:
                self._tell(step + 1, decrement / scale)
            size = float(np.abs(direction).max())
            if size > max(CONTRACTION * last, alike):
                return None
            if decrement < NEAR * scale and shift == 0.0:
                enough = max(self._tolerance * scale, SOFT * energy.least_scale())
                point, reached = _chord_steps(energy, point, direction, decrement, enough)
                if reached < enough:
                    return point
                if reached < decrement:
                    continue
            last = size if shift == 0.0 else np.inf
            point = energy.at(point.grid + direction)
        return None

    def _together(self, model: StaticModel, begin: Array) -> Point | None:
        """The minimum near a state of a body whose segments act on each other, if the steps to it are few."""
        energy = InteractingEnergy(model)
        try:
            found = minimize_with_interaction(energy, begin, tolerance=self._tolerance, max_steps=3)
        except SolveError:
            return None
        self._spent += found.steps
        return found.point

    def _jump(self, past: float) -> Jump:
        """The end of the branch, between now and a time (s) just past it; the body falls to where it is then."""
        last, before = self.now, self.before
        energy = self.energy_at(last.time)
        factored(energy, last.point)
        lowest, mode = lowest_mode(energy)
        kind = self._kind(energy, last, past, mode)
        critical = _zero_of(kind, before, last, lowest, past)
        energy = self.energy_at(past)
        carry = self.loads.carried
        begin = energy.at(carry(last.point.grid, last.time, past))
        found = self._fall(energy, begin, carry(mode, last.time, past), kind)
        if (lost := outside_domain(energy.model, found)) is not None:
            raise SolveError(f"t = {past:.6g} s: after the branch ended, {lost}")
        moved = float(np.linalg.norm(found.position - begin.position, axis=1).max())
        factored(energy, found)
        self.now = Reached(past, found, lowest_mode(energy)[0], self._spent, 4 * (past - last.time))
        self.before = None
        return Jump(critical, kind, past - last.time, moved, begin.energy - found.energy, past)

    def _kind(self, energy: Energy, last: Reached, past: float, mode: Array) -> Kind:
        """Whether the branch turns back there (its direction is the mode) or goes on unstable (its direction has nothing of the mode).

        energy: at the last state, with its factored tangent.
        """
        mass = lumped_mass(energy.model)
        split, layout = energy.model.layout.split, energy.model.layout
        if self.loads.at(past).layout is layout:
            direction = -solve(energy.panels, split, self.energy_at(past).residual(last.point))
        elif self.before is not None:
            direction = last.point.grid - self.loads.carried(self.before.point.grid, self.before.time, last.time)
        else:
            return "limit point"
        along = float(np.sum(mass * direction * mode)) ** 2
        whole = float(np.sum(mass * direction**2) * np.sum(mass * mode**2))
        return "limit point" if along > 0.5 * whole else "bifurcation"

    def _fall(self, energy: Energy, begin: Point, mode: Array, kind: Kind) -> Point:
        """The minimum that the body falls to from just past the end of a branch."""
        length = float(np.ptp(energy.model.plane_coordinates()))
        push = PUSH * length / float(np.abs(mode).max()) * mode
        if float(push[-1].sum()) < 0.0:  # where nothing else decides: toward +z, as statics.newton does
            push = -push
        one, other = energy.at(begin.grid + push), energy.at(begin.grid - push)
        if other.energy < one.energy - 1e-3 * abs(one.energy + other.energy - 2 * begin.energy):
            one = other
        if acting.feels_itself(energy.model.scene):
            whole = InteractingEnergy(energy.model)
            return minimize_with_interaction(whole, one.grid, tolerance=self._tolerance, max_steps=self._max_steps).point
        point, count = fall(energy, one, LONGEST_FALL * length)
        self._spent += count
        scale = max(abs(point.energy - energy.rest_energy()), energy.least_scale())
        tolerance = max(self._tolerance, SOFT * energy.least_scale() / scale)
        found = minimize(energy, point.grid, tolerance=tolerance, max_steps=self._max_steps, on_step=self._tell)
        self._spent += found.steps
        return found.point


def outside_domain(model: StaticModel, point: Point) -> str | None:
    """Why a body is where its field is not known, or None."""
    if not model.scene.effects.in_a_field:
        return None
    found = model.scene.outside_field().outside_domain(point.position, model.time)
    return None if found is None else f"{found[0]}; {found[2]}"


def _zero_of(kind: Kind, before: Reached | None, last: Reached, lowest: float, past: float) -> float:
    """When the lowest eigenvalue reaches zero, s: by its trend between the last two equilibria, within the bracket."""
    if before is None or before.lowest is None or not before.lowest > lowest:
        return 0.5 * (last.time + past)
    power = 2 if kind == "limit point" else 1
    far, near = before.lowest**power, lowest**power
    return float(np.clip(last.time + near * (last.time - before.time) / (far - near), last.time, past))


def fall(energy: Energy, point: Point, longest: float) -> tuple[Point, int]:
    """Overdamped motion from a state, by implicit Euler steps of at most `longest` (m), until Newton's method can take over.

    Each step solves (K + mu M) d = -R. mu (1/s^2: one over the time step) grows where K + mu M is not positive definite, the step too long,
    or the energy does not fall, and shrinks otherwise. Returns the state and the number of steps. Raises SolveError.
    """
    layout, mass = energy.model.layout, lumped_mass(energy.model)
    mu, count = 0.0, 0
    least = 1e-9 * float(energy.model.shear.max()) / (float(np.ptp(energy.model.plane_coordinates())) ** 2)
    while count < MOST_FALLING:
        count += 1
        residual, panels = energy.tangent(point)
        diagonal = np.einsum("jaa->ja", panels[: layout.planes, :, : layout.m])
        diagonal += mu * mass
        if factor(panels, layout.split) >= 0:
            mu = max(4.0 * mu, least)
            continue
        direction = -solve(panels, layout.split, residual)
        size = float(np.abs(direction).max())
        trial = energy.at(point.grid + direction) if size <= longest else None
        if trial is None or not (trial.min_det_F > 0 and trial.energy <= point.energy):
            if mu == 0.0 and size < 1e-3 * longest:
                return point, count
            mu = max(3.0 * mu, least)
            continue
        point = trial
        if mu == 0.0 and size < 0.1 * longest:
            return point, count
        mu = mu / 3.0 if mu > least else 0.0
    raise SolveError(f"the body fell for {MOST_FALLING} steps and came to no rest", point)


def lumped_mass(model: StaticModel) -> Array:
    """Mass (planes, m) of the unknowns for a density of 1: the volume that each node's spline carries."""
    layout = model.layout
    size = layout.planes * layout.nodes_per_plane
    out = np.zeros(size)
    of = np.repeat(np.arange(len(layout.cell_plane)), np.diff(layout.cell_first))
    for a, b, c in np.ndindex(3, 3, 3):
        share = model.particles.volume * np.abs(model.weights[:, 0, a] * model.weights[:, 1, b] * model.weights[:, 2, c])
        plane = np.minimum(layout.cell_plane[of] + a, layout.planes - 1)
        out += np.bincount(plane * layout.nodes_per_plane + layout.cell_row[of, b] + c, share, minlength=size)
    out = np.repeat(out.reshape(layout.planes, -1), 3, axis=1)
    out[layout.fixed] = float(out.max())
    return out


def lowest_mode(energy: Energy) -> tuple[float, Array]:
    """Smallest eigenvalue (Pa/m^2) and mode (planes, m) of the factored tangent against the lumped mass of density 1: inverse iteration."""
    model, layout = energy.model, energy.model.layout
    mass, x = lumped_mass(model), model.plane_coordinates()
    _, second, third = model.order
    d = 1e-6 * np.random.default_rng(0).standard_normal((layout.planes, layout.m)) * float(np.ptp(x)) ** 2
    d[:, third::3] += ((x - x[0]) ** 2)[:, None]
    d[:, second::3] += 1e-3 * ((x - x[0]) ** 2)[:, None]
    energy.free(d)
    lowest = np.inf
    for _ in range(40):
        loaded = mass * d
        new = solve(energy.panels, layout.split, energy.free(loaded))
        size, before = float(np.sum(mass * new * new)), lowest
        lowest = float(np.sum(new * loaded)) / size
        d = new / np.sqrt(size)
        if abs(lowest - before) < 1e-6 * abs(lowest):
            break
    return lowest, d
