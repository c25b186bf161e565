"""Minima of the energy near a state: the one that Newton's steps contract to, and the one that the body falls to.

All that is done with the tangent is done with K + nu M: M is the mass matrix (lumped, density 1), and nu is NEUTRAL of the smallest
eigenvalue of the undeformed body, so that a neutral direction, such as a turn of a buckled round rod about its axis, does no harm.

A fall is overdamped motion, M du/dt = -dE/du, by implicit Euler steps of limited length.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError, TimeOver
from magmpm.scene import time_limit
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import NEAR, ROUNDING_AT_REST, OnStep, _chord_steps, factored

CONTRACTION = 0.5  # of Newton's steps, below which they are sure to stay with the branch
MOST_FALLING = 400  # steps of a fall
STIFFER = 10.0  # times as much of the mass matrix, where a tangent has no factors yet
NEUTRAL = 1e-4  # of the lowest eigenvalue of the undeformed body: what counts as zero. A buckled round rod turns about its axis freely
SOFT = 100.0  # of Energy.least_scale, a strain of 1e-8: near a critical load rounding alone costs the soft mode such an energy


class NearbyMinima:
    """Finds minima near states of a model. spent: Newton steps so far; unstable: the last search found a stationary point, no minimum."""

    def __init__(self, *, tolerance: float, on_step: OnStep | None = None) -> None:
        self._tolerance, self._tell = tolerance, on_step
        self.spent, self.unstable = 0, False
        self._shift, self._free, self._decrement = 0.0, 0.0, 0.0
        self._enough = 0.0  # the shift that a tangent last needed to have factors: where the next one looks for its own
        self._mass_of: object = None
        self._masses = np.zeros((0, 0))

    def begin(self) -> None:
        """Count from now on, and forget what earlier tangents needed: a path goes on from a checkpoint bit for bit as without one."""
        self.spent, self._enough = 0, 0.0

    def contracted(self, energy: Energy, begin: Array) -> Point | None:
        """The minimum to which Newton's steps contract; None where they do not, or lead to where the tangent is not positive definite."""
        self.unstable = False
        point, rest, allowed, on = energy.at(begin), energy.rest_energy(), np.inf, np.zeros(0, np.int64)
        length = float(np.ptp(energy.model.plane_coordinates()))
        for step in range(12):
            if not point.min_det_F > 0:
                return None
            residual, definite = self.made_definite(energy, point)
            if residual is None:
                return None
            direction = -energy.matrix.solve(residual)
            self.spent += 1
            if point.touched is not None and not np.array_equal(on, point.touched.pattern):  # others touch: another tangent
                on, allowed = point.touched.pattern, np.inf
            decrement = -float(np.sum(residual * direction)) / 2
            scale = max(abs(point.energy - rest), energy.least_scale())
            if self._tell is not None:
                self._tell(step + 1, decrement / scale)
            size = float(np.abs(direction).max())
            if size > max(allowed, 1e-5 * length):  # steps that are shorter may shrink more slowly, down to rounding
                return None
            allowed = CONTRACTION * (size if allowed == np.inf else allowed)
            if decrement < NEAR * scale:
                if not definite:
                    self.unstable = True
                    return None
                enough = max(self._tolerance * scale, SOFT * energy.least_scale())
                point, reached = _chord_steps(energy, point, residual, direction, decrement, enough)
                if reached < enough:
                    return point
                if reached < decrement:
                    continue
            point = energy.at(point.grid + direction)
        return None

    def _factored(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array, bool]:
        """Residual, and whether all eigenvalues of the tangent are positive or count as zero (NEUTRAL).

        If so, the energy's matrix holds the factors of the tangent plus that much, or `more` (Pa/m^2), of the mass matrix. So steps along
        a neutral direction, where rounding decides, stay short; others are Newton's to within NEUTRAL.
        """
        time_limit.check()
        self._shift = max(more, self._neutral(energy))
        residual, matrix = energy.tangent(point)
        matrix.add_diagonal(self._shift * self.mass(energy))
        return residual, matrix.factor()

    def made_definite(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array | None, bool]:
        """Factor as `_factored`, with as much more of the mass matrix as it takes to have factors. A slender body on its way is compressed
        for a step or two, as it moves along tangents of its arcs: it is not unstable. No residual where values are not finite."""
        residual, definite = self._factored(energy, point, more)
        done, enough = definite, self._enough / STIFFER
        while not done:
            residual, done = self._factored(energy, point, max(STIFFER * self._shift, enough))
            if not self._shift < 1e15 * self._neutral(energy):  # it is not the tangent that matters
                return None, False
            self._enough = self._shift
        return residual, definite

    def mass(self, energy: Energy) -> Array:
        """The lumped mass of the energy's model."""
        if self._mass_of is not energy.model.layout:
            self._mass_of, self._masses = energy.model.layout, lumped_mass(energy.model)
            self._free = 0.0
        return self._masses

    def free(self, energy: Energy) -> float:
        """Lowest eigenvalue (Pa/m^2) of the undeformed body, which nothing touches or holds."""
        mass, model = self.mass(energy), energy.model
        if self._free == 0.0:
            energy.load(replace(model, touching=None))
            factored(energy, energy.at(np.zeros(energy.shape)))
            self._free = lowest_mode(energy, mass)[0]
            energy.load(model)
        return self._free

    def _neutral(self, energy: Energy) -> float:
        """Eigenvalue (Pa/m^2) that counts as zero."""
        return NEUTRAL * self.free(energy)

    def lowest(self, energy: Energy, point: Point) -> tuple[float, Array] | None:
        """Lowest eigenvalue (Pa/m^2) and mode of the tangent at a minimum; None where it is none."""
        if not self._factored(energy, point)[1]:
            return None
        lowest, mode = lowest_mode(energy, self.mass(energy))
        return lowest - self._shift, mode

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

    def settled(self, energy: Energy, point: Point, longest: float, check: Callable[[Point], None]) -> Point:
        """End of the overdamped motion from a state, by implicit Euler steps of at most `longest` (m). Raises SolveError.

        check: called with each state on the way; may raise SolveError.
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
            check(trial)
            point, mu = trial, max(mu / 4.0, neutral)
        raise SolveError(f"the body fell for {MOST_FALLING} steps and came to no rest", point)

    def _euler(self, energy: Energy, before: Point, mu: float, longest: float) -> Point | None:
        """The minimum of E + mu/2 |c - c0|^2 near a state c0; None where there is none within `longest` (m)."""
        mass, point = self.mass(energy), before
        for turn in range(6):  # Newton steps
            residual, definite = self.made_definite(energy, point, mu)
            if residual is None or (not definite and turn == 0):
                return None
            self.spent += 1
            residual = residual + mu * mass * (point.grid - before.grid)
            direction = -energy.matrix.solve(residual)
            decrement = -float(np.sum(residual * direction)) / 2
            if turn == 0:
                self._decrement = decrement
            point = energy.at(point.grid + direction)
            if not point.min_det_F > 0 or float(np.abs(point.grid - before.grid).max()) > longest:
                return None
            if decrement < max(1e-4 * self._decrement, SOFT * energy.least_scale()):
                break
        return point


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
        new = energy.matrix.solve(energy.free(loaded))
        size, before = float(np.sum(mass * new * new)), lowest
        lowest = float(np.sum(new * loaded)) / size
        d = new / np.sqrt(size)
        if abs(lowest - before) < 1e-6 * abs(lowest):
            break
    return lowest, d
