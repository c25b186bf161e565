"""Bodies set in motion by hand, for cases that look closer than frames allow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics import energies
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.step_control import LIMIT
from magmpm.dynamics.steps import take
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting as effects
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.scene import Scene

Motion = TotalMotion | UpdatedMotion
Affine = Callable[[Array], Array]
FACTOR = 1.0  # of the chosen step and of the stable one: controls raise it


def at_rest(scene: Scene) -> tuple[Motion, float, float]:
    """The undeformed body, its chosen time step and the largest stable one, s. No step ends early because the body has grown stiffer than
    the step was chosen for: a run would find a new one, a case keeps its own.
    """
    moved = begin(build(scene))
    moved.motion.watch[LIMIT] = np.inf
    return moved.motion, FACTOR * moved.control.step, FACTOR * moved.stable.largest


def throw(motion: Motion, velocity: Affine) -> None:
    """Give the undeformed body velocity(x) (m, 3) m/s at points x (m, 3) m."""
    if isinstance(motion, TotalMotion):
        free = motion.packed.nodes.inverse_mass > 0
        motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)
        return
    x = motion.model.particles.position
    step = 1e-6 * np.eye(3)
    slope = np.stack([(velocity(x + d) - velocity(x - d)) / 2e-6 for d in step], axis=2)
    motion.place(x, velocity(x), np.tile(np.eye(3), (len(x), 1, 1)), slope)


def stretch(motion: Motion, by: float) -> None:
    """Put the body, at rest, `by` times as large as it is."""
    if isinstance(motion, TotalMotion):
        free = motion.packed.nodes.inverse_mass > 0
        motion.u[:] = np.where(free, (by - 1.0) * motion.packed.node_place.ravel(), 0.0)
        return
    n = len(motion.model.density)
    eye = np.tile(by * np.eye(3), (n, 1, 1))
    motion.place(by * motion.model.particles.position, np.zeros((n, 3)), eye, np.zeros((n, 3, 3)))


def advance(motion: Motion, steps: int, dt: float, start: float = 0.0) -> None:
    """Take so many steps of dt (s) from time `start` (s). Raises SolveError where the motion breaks."""
    named = effects.collect(motion.model.scene, times=start + dt * np.arange(steps, dtype=float))
    taken, broken = take(motion, named, steps, dt)
    if broken or taken < steps:  # a step in which the body moves too far is the last one
        raise SolveError(f"the motion {'broke' if broken else 'was stopped'} at step {taken} of {steps}")


def energy(motion: Motion, time: float = 0.0) -> float:
    """Kinetic, elastic and the effects' potential energies together, J, of one moment. Raises SolveError where they are not finite."""
    now, model = motion.kinematics(), motion.model
    elastic = energies.elastic_energy(model, now.F, isinstance(motion, TotalMotion))
    found = now.kinetic + elastic + sum(energies.effect_energies(model, now.x, now.F, time).values())
    if not np.isfinite(found):
        raise SolveError("the energy of the motion is not finite")
    return found


def spin(motion: Motion) -> Array:
    """Angular momentum (3,) about the origin, N m s, of the particles and of what turns within them.

    Mass sits on nodes: a particle's turns with it at a distance whose square is h^2/4 along each axis (dynamics.mass).
    """
    now, model = motion.kinematics(), motion.model
    mass = model.density * model.particles.volume
    if isinstance(motion, TotalMotion):
        p = motion.packed
        place = p.node_place + motion.u.reshape(-1, 3)
        return np.asarray(np.cross(place, p.mass.momentum(motion.velocity().reshape(-1, 3))).sum(axis=0))
    within = model.grid.spacing**2 / 4 * motion.affine()  # sum of m d (x) dv over a particle's nodes: m C h^2/4
    turning = np.stack([within[:, 2, 1] - within[:, 1, 2], within[:, 0, 2] - within[:, 2, 0], within[:, 1, 0] - within[:, 0, 1]], axis=1)
    return np.asarray(mass @ (np.cross(now.x, now.v) + turning))


def last_cells(model: Model) -> Array:
    """Weights (n,), of sum 1, of the particles of the last cells along x: what they average to stands for the tip."""
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    return np.asarray(share / share.sum())
