"""Bodies set in motion by hand, for cases that look closer than frames allow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from magmpm import effects
from magmpm.dynamics import energies
from magmpm.dynamics.run import begin
from magmpm.dynamics.total import TotalMotion
from magmpm.dynamics.updated import UpdatedMotion
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.scene import Scene

Array = NDArray[np.float64]
Motion = TotalMotion | UpdatedMotion
Affine = Callable[[Array], Array]


def at_rest(scene: Scene) -> tuple[Motion, float, float]:
    """The undeformed body, its chosen time step and the largest stable one, s."""
    moved = begin(build(scene))
    return moved.motion, moved.dt, moved.stable.largest


def throw(motion: Motion, velocity: Affine) -> None:
    """Give the undeformed body velocity(x) (m, 3) m/s at points x (m, 3) m."""
    if isinstance(motion, TotalMotion):
        free = motion.packed.inverse_mass > 0
        motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)
        return
    x = motion.model.particles.position
    step = 1e-6 * np.eye(3)
    slope = np.stack([(velocity(x + d) - velocity(x - d)) / 2e-6 for d in step], axis=2)
    motion.place(x, velocity(x), np.tile(np.eye(3), (len(x), 1, 1)), slope)


def stretch(motion: Motion, by: float) -> None:
    """Put the body, at rest, `by` times as large as it is."""
    if isinstance(motion, TotalMotion):
        free = motion.packed.inverse_mass > 0
        motion.u[:] = np.where(free, (by - 1.0) * motion.packed.node_place.ravel(), 0.0)
        return
    n = len(motion.model.density)
    eye = np.tile(by * np.eye(3), (n, 1, 1))
    motion.place(by * motion.model.particles.position, np.zeros((n, 3)), eye, np.zeros((n, 3, 3)))


def advance(motion: Motion, steps: int, dt: float, start: float = 0.0) -> None:
    """Take so many steps of dt (s) from time `start` (s). Raises SolveError where the motion breaks."""
    named = effects.collect(motion.model.scene, times=start + dt * np.arange(steps, dtype=float))
    taken = 0
    while taken < steps:
        part = tuple(a[taken:] if k % 2 == 0 and len(a) > 1 else a for k, a in enumerate(named))
        gone, broken = motion.advance(steps - taken, dt, part)
        taken += gone
        if broken:
            raise SolveError(f"the motion broke at step {taken} of {steps}")


def energy(motion: Motion, time: float = 0.0) -> float:
    """Kinetic, elastic and the effects' potential energies together, J."""
    x, _, F = motion.particles()
    model = motion.model
    elastic = energies.elastic_energy(model, F, isinstance(motion, TotalMotion))
    return motion.kinetic_energy() + elastic + sum(energies.effect_energies(model, x, F, time).values())


def last_cells(model: Model) -> Array:
    """Weights (n,), of sum 1, of the particles of the last cells along x: what they average to stands for the tip."""
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    return np.asarray(share / share.sum())
