"""Equilibria along a path of loads: each found from the one before, on its branch, until the branch ends.

A step is accepted where undamped Newton iterations from the prediction contract (step k is at most CONTRACTION^k times the first) to a state whose tangent is positive definite: then the state is the neighbor of the one before, and stable. Otherwise the step is halved,
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
from magmpm.statics.newton import NEAR, ROUNDING_AT_REST, _chord_steps, factored

CONTRACTION = 0.5  # of Newton's steps, below which they are sure to stay with the branch
ALIKE = 1e-5  # of the length: steps shorter than this may shrink more slowly, down to rounding
MOST_NEWTON = 12  # steps of one attempt
FINEST = 2.0**-10  # of the step asked for: attempts are halved down to this, and critical loads known within it
LANDING = 15  # of the finest steps: how far past the end of a branch the body is sought again; nearer, a new branch is too steep
GROWTH = 2.0  # of the step after one that was accepted
PUSH = 1e-3  # of the length: how far along its mode an unstable body is pushed off
LONGEST_FALL = 0.03  # of the length: a step of a fall
MOST_FALLING = 400  # steps of a fall
MOST_TURNS = 6  # Newton steps in each
STIFFER = 10.0  # times as much of the mass matrix, where a tangent has no factors yet
NEUTRAL = 1e-4  # of the lowest eigenvalue of the undeformed body: what counts as zero. A buckled round rod turns about its axis freely
SOFT = 100.0  # of Energy.least_scale, a strain of 1e-8: near a critical load rounding alone costs the soft mode such an energy
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
        self._unstable = False  # whether the last attempt failed on a branch that goes on, unstable
        self._shift, self._free, self._decrement = 0.0, 0.0, 0.0
        self._mass_of: object = None
        self._masses = np.zeros((0, 0))

    def settle_in(self, grid: Array) -> None:
        """Take an equilibrium that was found otherwise as the first: its energy, and its lowest eigenvalue."""
        energy = self.energy_at(self.now.time)
        point = energy.at(grid)
        self.now = replace(self.now, point=point, lowest=self._eigenvalue(energy, point))

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
        finest, self._spent = FINEST * (until - self.now.time), 0
        growth = GROWTH
        beyond = np.inf  # the earliest time at which an attempt failed
        while self.now.time < until:
            gap = min(until, beyond) - self.now.time
            way = gap / 2 if beyond < np.inf and (self._unstable or self._ends_before(beyond)) else gap
            way = min(way, self.now.step)
            if beyond < np.inf and gap <= 1.5 * finest:
                jumps.append(self._jump(beyond, min(until, beyond + LANDING * finest)))
                beyond = np.inf
                continue
            end = min(until, beyond)
            target = end if self.now.time + way > end - 0.5 * finest else self.now.time + way
            found = self._attempt(target)
            if found is None:
                beyond, growth = target, 1.0  # the next step is no longer than the one that was too long
                self.now = replace(self.now, step=max(way / 2, 0.5 * finest))
                continue
            self.before, self.now = self.now, replace(found, step=growth * way)
            growth = GROWTH
            beyond = np.inf if target >= beyond else beyond
        self.now = replace(self.now, iterations=self._spent)
        return jumps

    def _ends_before(self, time: float) -> bool:
        """Whether the trend of the lowest eigenvalue reaches zero before a time, s, as at a limit point."""
        return self.before is not None and _zero_of("limit point", self.before, self.now, time) < time

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
        self._unstable = False
        if acting.feels_itself(model.scene):
            point, lowest = self._together(model, begin), None
        else:
            point, mode = self._contracted(energy, begin), None
            if point is not None:
                mode = self._lowest(energy, point)
                self._unstable = mode is None
            point, lowest = (None, None) if mode is None else (point, mode[0])
        if point is None:
            return None
        if (lost := outside_domain(model, point)) is not None:
            raise SolveError(f"t = {target:.6g} s: {lost}")
        return Reached(target, point, lowest, self._spent, self.now.step)

    def _contracted(self, energy: Energy, begin: Array) -> Point | None:
        """The minimum to which Newton's steps contract; None where they do not, or lead to where the tangent is not positive definite."""
        point, rest, allowed = energy.at(begin), energy.rest_energy(), np.inf
        length = float(np.ptp(energy.model.plane_coordinates()))
        for step in range(MOST_NEWTON):
            if not point.min_det_F > 0:
                return None
            residual, definite = self._made_definite(energy, point)
            direction = -solve(energy.panels, energy.model.layout.split, residual)
            self._spent += 1
            decrement = -float(np.sum(residual * direction)) / 2
            scale = max(abs(point.energy - rest), energy.least_scale())
            if self._tell is not None:
                self._tell(step + 1, decrement / scale)
            size = float(np.abs(direction).max())
            if size > max(allowed, ALIKE * length):
                return None
            allowed = CONTRACTION * min(allowed, size) if step == 0 else CONTRACTION * allowed
            if decrement < NEAR * scale:
                if not definite:
                    self._unstable = True
                    return None
                enough = max(self._tolerance * scale, SOFT * energy.least_scale())
                point, reached = _chord_steps(energy, point, direction, decrement, enough)
                if reached < enough:
                    return point
                if reached < decrement:
                    continue
            point = energy.at(point.grid + direction)
        return None

    def _factored(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array, bool]:
        """Residual, and whether all eigenvalues of the tangent are positive or count as zero (NEUTRAL): if so, the energy's panels hold the
        factors of the tangent plus that much, or `more` (Pa/m^2), of the mass matrix. So steps along a neutral direction, where rounding
        decides, stay short; others are Newton's to within NEUTRAL."""
        layout, self._shift = energy.model.layout, max(more, self._neutral(energy))
        residual, panels = energy.tangent(point)
        diagonal = np.einsum("jaa->ja", panels[: layout.planes, :, : layout.m])
        diagonal += self._shift * self._mass(energy)
        return residual, factor(panels, layout.split) < 0

    def _made_definite(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array, bool]:
        """As `_factored`, with as much more of the mass matrix as it takes to have factors. A slender body on its way is compressed for a
        step or two, for it moves along tangents of its arcs: it is not unstable."""
        residual, definite = self._factored(energy, point, more)
        done = definite
        while not done:
            residual, done = self._factored(energy, point, STIFFER * self._shift)
            if self._shift > 1e12 * self._neutral(energy):
                raise SolveError("the tangent can't be made positive definite: it holds values that are not finite", point)
        return residual, definite

    def _mass(self, energy: Energy) -> Array:
        """The lumped mass of the energy's model."""
        if self._mass_of is not energy.model.layout:
            self._mass_of, self._masses = energy.model.layout, lumped_mass(energy.model)
            self._free = 0.0
        return self._masses

    def _neutral(self, energy: Energy) -> float:
        """Eigenvalue (Pa/m^2) that counts as zero: NEUTRAL of the lowest of the undeformed body."""
        mass = self._mass(energy)
        if self._free == 0.0:
            factored(energy, energy.at(np.zeros(energy.shape)))
            self._free = lowest_mode(energy, mass)[0]
        return NEUTRAL * self._free

    def _lowest(self, energy: Energy, point: Point) -> tuple[float, Array] | None:
        """Lowest eigenvalue (Pa/m^2) and mode of the tangent at a minimum; None where it is none."""
        if not self._factored(energy, point)[1]:
            return None
        lowest, mode = lowest_mode(energy, self._mass(energy))
        return lowest - self._shift, mode

    def _together(self, model: StaticModel, begin: Array) -> Point | None:
        """The minimum near a state of a body whose segments act on each other, if the steps to it are few."""
        energy = InteractingEnergy(model)
        try:
            found = minimize_with_interaction(energy, begin, tolerance=self._tolerance, max_steps=3)
        except SolveError:
            return None
        self._spent += found.steps
        return found.point

    def _eigenvalue(self, energy: Energy, point: Point) -> float | None:
        """Lowest eigenvalue (Pa/m^2) at a minimum; None where it is not known."""
        mode = None if acting.feels_itself(energy.model.scene) else self._lowest(energy, point)
        return None if mode is None else mode[0]

    def _jump(self, past: float, landing: float) -> Jump:
        """The end of the branch, between now and a time (s) just past it; the body falls to where it is at `landing`, s."""
        last = self.now
        energy = self.energy_at(last.time)
        found_mode = self._lowest(energy, last.point)
        assert found_mode is not None  # `last` is a minimum
        mode = found_mode[1]
        kind = self._kind(energy, last, past, mode)
        critical = 0.5 * (last.time + past)
        if self.before is not None:
            critical = _zero_of(kind, self.before, last, past)
        energy = self.energy_at(landing)
        carry = self.loads.carried
        begin = energy.at(carry(last.point.grid, last.time, landing))
        found = self._fall(energy, begin, carry(mode, last.time, landing))
        if (lost := outside_domain(energy.model, found)) is not None:
            raise SolveError(f"t = {landing:.6g} s: after the branch ended, {lost}")
        moved = float(np.linalg.norm(found.position - begin.position, axis=1).max())
        self.now = Reached(landing, found, self._eigenvalue(energy, found), self._spent, landing - critical)
        self.before = None
        return Jump(critical, kind, past - last.time, moved, begin.energy - found.energy, landing)

    def _kind(self, energy: Energy, last: Reached, past: float, mode: Array) -> Kind:
        """Whether the branch turns back there (its direction is the mode) or goes on unstable (its direction has nothing of the mode).

        energy: at the last state, with its factored tangent.
        """
        mass, layout = self._mass(energy), energy.model.layout
        if self.loads.at(past).layout is layout:
            direction = -solve(energy.panels, layout.split, self.energy_at(past).residual(last.point))
        elif self.before is not None:
            direction = last.point.grid - self.loads.carried(self.before.point.grid, self.before.time, last.time)
        else:
            return "limit point"
        along = float(np.sum(mass * direction * mode)) ** 2
        whole = float(np.sum(mass * direction**2) * np.sum(mass * mode**2))
        return "limit point" if along > 0.5 * whole else "bifurcation"

    def _fall(self, energy: Energy, begin: Point, mode: Array) -> Point:
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
        return self._settled(energy, one, LONGEST_FALL * length)

    def _settled(self, energy: Energy, point: Point, longest: float) -> Point:
        """Where overdamped motion from a state ends, by implicit Euler steps of at most `longest` (m). Raises SolveError.

        A step of the time 1 / mu is the minimum of E + mu/2 |c - c0|^2, found by Newton's method. mu grows where that fails, the step is
        too long or the energy does not fall, and shrinks otherwise, to next to nothing: the last steps are Newton's.
        """
        neutral, rest = self._neutral(energy), energy.rest_energy()
        noise, mu = ROUNDING_AT_REST * energy.least_scale(), neutral
        for _ in range(MOST_FALLING):
            trial = self._euler(energy, point, mu, longest)
            if trial is None or trial.energy > point.energy + noise:
                mu *= 4.0
                continue
            scale = max(abs(trial.energy - rest), energy.least_scale())
            if mu <= neutral and self._decrement < max(self._tolerance * scale, SOFT * energy.least_scale()):
                return trial
            point, mu = trial, max(mu / 4.0, neutral)
        raise SolveError(f"the body fell for {MOST_FALLING} steps and came to no rest", point)

    def _euler(self, energy: Energy, before: Point, mu: float, longest: float) -> Point | None:
        """The minimum of E + mu/2 |c - c0|^2 near a state c0; None where there is none within `longest` (m)."""
        mass, split, point = self._mass(energy), energy.model.layout.split, before
        for turn in range(MOST_TURNS):
            residual, definite = self._made_definite(energy, point, mu)
            if not definite and turn == 0:
                return None
            self._spent += 1
            residual = residual + mu * mass * (point.grid - before.grid)
            direction = -solve(energy.panels, split, residual)
            decrement = -float(np.sum(residual * direction)) / 2
            if turn == 0:
                self._decrement = decrement
            point = energy.at(point.grid + direction)
            if not point.min_det_F > 0 or float(np.abs(point.grid - before.grid).max()) > longest:
                return None
            if decrement < max(1e-4 * self._decrement, SOFT * energy.least_scale()):
                break
        return point


def outside_domain(model: StaticModel, point: Point) -> str | None:
    """Why a body is where its field is not known, or None."""
    if not model.scene.effects.in_a_field:
        return None
    found = model.scene.outside_field().outside_domain(point.position, model.time)
    return None if found is None else f"{found[0]}; {found[2]}"


def _zero_of(kind: Kind, before: Reached, last: Reached, past: float) -> float:
    """When the lowest eigenvalue reaches zero, s, at most `past`: by its trend between two equilibria."""
    if before.lowest is None or last.lowest is None or not before.lowest > last.lowest:
        return past
    power = 2 if kind == "limit point" else 1
    far, near = before.lowest**power, max(last.lowest, 0.0) ** power
    return float(np.clip(last.time + near * (last.time - before.time) / (far - near), last.time, past))


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


def lowest_mode(energy: Energy, mass: Array) -> tuple[float, Array]:
    """Smallest eigenvalue (Pa/m^2) and mode (planes, m) of the factored tangent against a lumped mass of density 1: inverse iteration."""
    model, layout = energy.model, energy.model.layout
    x = model.plane_coordinates()
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
