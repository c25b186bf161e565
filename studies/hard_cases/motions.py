"""Bodies set in motion by hand, for cases that look closer than frames allow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics import energies
from magmpm.dynamics.step_control import LIMIT
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion, take
from magmpm.effects import acting as effects
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.scene import Scene

Affine = Callable[[Array], Array]
FACTOR = 1.0  # of the chosen step and of the stable one: controls raise it


def at_rest(scene: Scene) -> tuple[TotalMotion, float, float]:
    """The undeformed body, its chosen time step and the largest stable one, s. No step ends early because the body has grown stiffer than
    the step was chosen for: a run would find a new one, a case keeps its own.
    """
    moved = begin(build(scene))
    moved.motion.watch[LIMIT] = np.inf
    return moved.motion, FACTOR * moved.control.step, FACTOR * moved.stable.largest


def throw(motion: TotalMotion, velocity: Affine) -> None:
    """Give the undeformed body velocity(x) (m, 3) m/s at points x (m, 3) m."""
    free = motion.packed.nodes.inverse_mass > 0
    motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)


def stretch(motion: TotalMotion, by: float) -> None:
    """Put the body, at rest, `by` times as large as it is."""
    free = motion.packed.nodes.inverse_mass > 0
    motion.u[:] = np.where(free, (by - 1.0) * motion.packed.node_place.ravel(), 0.0)


def advance(motion: TotalMotion, steps: int, dt: float, start: float = 0.0) -> None:
    """Take so many steps of dt (s) from time `start` (s). Raises SolveError where the motion breaks."""
    named = effects.collect(motion.model.scene, times=start + dt * np.arange(steps, dtype=float))
    taken, broken = take(motion, named, steps, dt)
    if broken or taken < steps:  # a step in which the body moves too far is the last one
        raise SolveError(f"the motion {'broke' if broken else 'was stopped'} at step {taken} of {steps}")


def energy(motion: TotalMotion, time: float = 0.0) -> float:
    """Kinetic, elastic and the effects' potential energies together, J, of one moment. Raises SolveError where they are not finite."""
    now, model = motion.kinematics(), motion.model
    elastic = energies.elastic_energy(model, now.F)
    found = now.kinetic + elastic + sum(energies.effect_energies(model, now.x, now.F, time).values())
    if not np.isfinite(found):
        raise SolveError("the energy of the motion is not finite")
    return found


def spin(motion: TotalMotion) -> Array:
    """Angular momentum (3,) about the origin, N m s."""
    place = motion.packed.node_place + motion.u.reshape(-1, 3)
    return np.asarray(np.cross(place, motion.packed.mass.momentum(motion.velocity().reshape(-1, 3))).sum(axis=0))


def last_cells(model: Model) -> Array:
    """Weights (n,), of sum 1, of the particles of the last cells along x: what they average to stands for the tip."""
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    return np.asarray(share / share.sum())
