"""Minima of the energy near a state: the one that Newton's steps contract to, and the one that the body falls to.

All that is done with the tangent is done with its factors as statics.definite makes them, so that a neutral direction, such as a turn of a
buckled round rod about its axis, does no harm.

A fall is overdamped motion, M du/dt = -dE/du, by implicit Euler steps of limited length.
"""

from collections.abc import Callable

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError, TimeOver
from magmpm.statics.definite import Definite, lowest_mode
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import NEAR_MINIMUM, ROUNDING_AT_REST, OnStep, _chord_steps, fall

CONTRACTION = 0.5  # of Newton's steps, below which they are sure to stay with the branch
MOST_FALLING = 400  # steps of a fall
# of Energy.least_scale, a strain of 1e-8: near a critical load rounding alone costs the soft mode
# such an energy
SOFT = 100.0


class NearbyMinima:
    """Finds minima near states of a model. spent: Newton steps so far; unstable: the last search found a stationary point, no minimum."""

    def __init__(self, *, tolerance: float, on_step: OnStep | None = None) -> None:
        self._tolerance = tolerance
        self._tell = on_step
        self.spent = 0
        self.unstable = False
        self._decrement = 0.0
        self.definite = Definite()

    def begin(self) -> None:
        """Count from now on, and forget what earlier tangents needed: a path goes on from a checkpoint bit for bit as without one."""
        self.spent = 0
        self.definite.forget()

    def contracted(self, energy: Energy, begin: Array) -> Point | None:
        """The minimum to which Newton's steps contract; None where they do not, or lead to where the tangent is not positive definite."""
        self.unstable = False
        point = energy.at(begin)
        rest = energy.rest_energy()
        allowed = np.inf
        on = np.zeros(0, np.int64)
        length = float(np.ptp(energy.model.plane_coordinates()))
        for step in range(12):
            if not point.min_det_F > 0:
                return None
            residual, definite = self.definite.made(energy, point)
            if residual is None:
                return None
            direction = -energy.matrix.solve(residual)
            self.spent += 1
            pattern = point.pattern
            if pattern is not None and not np.array_equal(on, pattern):  # another tangent
                on = pattern
                allowed = np.inf
            decrement = fall(residual, direction)
            scale = max(abs(point.energy - rest), energy.least_scale())
            if self._tell is not None:
                self._tell(step + 1, decrement / scale)
            size = float(np.abs(direction).max())
            if size > max(
                allowed, 1e-5 * length
            ):  # steps that are shorter may shrink more slowly, down to rounding
                return None
            allowed = CONTRACTION * (size if allowed == np.inf else allowed)
            if decrement < NEAR_MINIMUM * scale:
                if not definite:
                    self.unstable = True
                    return None
                enough = max(self._tolerance * scale, SOFT * energy.least_scale())
                point, reached = _chord_steps(energy, point, residual, direction, decrement, enough)
                if reached < enough:
                    return point
                if reached < decrement:
                    continue
            point = _stepped(energy, point, direction)
        return None

    def lowest(self, energy: Energy, point: Point) -> tuple[float, Array] | None:
        """Lowest eigenvalue (Pa/m^2) and mode of the tangent at a minimum; None where it is none.

        Of a body that is free to move along a mode, whose eigenvalue counts as zero, it is the next eigenvalue.
        """
        if not self.definite.factored(energy, point)[1]:
            return None
        mass = self.definite.mass(energy)
        lowest, mode = lowest_mode(energy, mass)
        if lowest - self.definite.shift < self.definite.neutral(energy):
            lowest, mode = lowest_mode(energy, mass, but=mode)
        return lowest - self.definite.shift, mode

    def together(self, model: StaticModel, begin: Array) -> Point | None:
        """The minimum near a state of a body whose segments act on each other, if the steps to it are few."""
        energy = InteractingEnergy(model)
        try:
            found = minimize_with_interaction(energy, begin, tolerance=self._tolerance, max_steps=3)
        except TimeOver:
            raise
        except SolveError:
            return None
        self.spent += found.steps
        return found.point

    def settled(
        self, energy: Energy, point: Point, longest: float, check: Callable[[Point], None]
    ) -> Point:
        """End of the overdamped motion from a state, by implicit Euler steps of at most `longest` (m). Raises SolveError.

        check: called with each state on the way; may raise SolveError.
        A step of the time 1 / mu is the minimum of E + mu/2 |c - c0|^2, found by Newton's method. mu grows where that fails, the step is
        too long or the energy does not fall, and shrinks otherwise, to next to nothing: the last steps are Newton's.
        """
        neutral = self.definite.neutral(energy)
        rest = energy.rest_energy()
        noise = ROUNDING_AT_REST * energy.least_scale()
        mu = neutral
        for _ in range(MOST_FALLING):
            trial = self._euler(energy, point, mu, longest)
            if trial is None or trial.energy > point.energy + noise:
                mu *= 4.0
                continue
            scale = max(abs(trial.energy - rest), energy.least_scale())
            if mu <= neutral and self._decrement < max(
                self._tolerance * scale, SOFT * energy.least_scale()
            ):
                return trial
            check(trial)
            point = trial
            mu = max(mu / 4.0, neutral)
        raise SolveError(
            f"the body did not come to rest within {MOST_FALLING} steps of its fall", point
        )

    def _euler(self, energy: Energy, before: Point, mu: float, longest: float) -> Point | None:
        """The minimum of E + mu/2 |c - c0|^2 near a state c0; None where there is none within `longest` (m)."""
        mass = self.definite.mass(energy)
        point = before
        for turn in range(6):  # Newton steps
            residual, definite = self.definite.made(energy, point, mu)
            if residual is None or (not definite and turn == 0):
                return None
            self.spent += 1
            residual = residual + mu * mass * (point.grid - before.grid)
            direction = -energy.matrix.solve(residual)
            decrement = fall(residual, direction)
            if turn == 0:
                self._decrement = decrement
            point = energy.at(point.grid + direction)
            way = point.grid - before.grid
            if not point.min_det_F > 0 or float(np.abs(way).max()) > longest:
                return None
            if energy.clear_share(before.grid, way) < 1.0:
                return None
            if decrement < max(1e-4 * self._decrement, SOFT * energy.least_scale()):
                break
        return point


def _stepped(energy: Energy, point: Point, direction: Array) -> Point:
    """The state after a step; after a part of it where points begin to touch and the whole step would raise the energy.

    A point that was clear has no stiffness in the tangent, so a whole step may press it far into an obstacle, and the next one far out.
    """
    trial = energy.at(point.grid + direction)
    if point.touched is None:
        return trial
    part = 1.0
    shortest = 1 / 8
    while part > shortest and not (trial.min_det_F > 0 and trial.energy <= point.energy):
        part = part / 2
        trial = energy.at(point.grid + part * direction)
    return trial
