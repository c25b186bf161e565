"""Bodies in motion for tests: started by the test, moved by the kernels of the solver, measured independently."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from reference.scenes import rod_scene
from scipy.optimize import brentq

from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.kernels.watch import GOING, WHY
from magmpm.model import Model, build
from magmpm.scene import Scene

Velocity = Callable[[np.ndarray], np.ndarray]


def moving(scene: Scene, effects: Mapping[str, Any] | None = None, **dynamic: Any) -> Scene:
    """The scene with solver.dynamic (duration 1 s unless given), and more effects."""
    data = scene.to_si()
    data["solver"] = {**data["solver"], "dynamic": {"duration": 1.0, **dynamic}}
    data["effects"] = {**data["effects"], **(effects or {})}
    return Scene.from_si(data)


def free_rod(effects: Mapping[str, Any] | None = None, **rod: Any) -> Scene:
    """A free catheter for motion."""
    data = rod_scene(**rod).to_si()
    data["body"]["catheter"]["clamp"] = "none"
    return moving(Scene.from_si(data), effects)


def set_off(scene: Scene, velocity: Velocity) -> tuple[TotalMotion, float]:
    """The undeformed body with velocity(x) (m, 3) m/s at points x (m, 3) m; and the chosen time step, s."""
    moved = begin(build(scene))
    motion = moved.motion
    free = motion.packed.nodes.inverse_mass > 0
    motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)
    return motion, moved.dt


def advance(motion: TotalMotion, steps: int, dt: float) -> None:
    """Take a number of steps with the effects of the model."""
    taken = 0
    while taken < steps:
        gone, broken = motion.advance(steps - taken, dt, motion.model.effects)
        taken += gone
        if broken or motion.watch[WHY] != GOING:
            raise AssertionError(f"the motion broke, or asks for another step, after {taken} steps")


class Quantities(NamedTuple):
    """Momentum (3,) kg m/s and angular momentum about the origin (3,) kg m^2/s."""

    momentum: np.ndarray
    spin: np.ndarray


def quantities(motion: TotalMotion) -> Quantities:
    """Momentum and angular momentum of the nodes."""
    p = motion.packed
    v = motion.v.reshape(-1, 3)
    momentum = p.mass.momentum(v)
    return Quantities(
        momentum.sum(axis=0), np.cross(p.node_place + motion.u.reshape(-1, 3), momentum).sum(axis=0)
    )


def tip_height(model: Model) -> Callable[[np.ndarray], float]:
    """A function that measures the mean z of the particles in the last cell along x."""
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    share /= share.sum()
    return lambda x: float(share @ x[:, 2])


FIRST = 1.8751040687119611  # first root of cos(z) cosh(z) = -1


def cantilever_mode(x: np.ndarray, length: float) -> np.ndarray:
    """First mode of an Euler-Bernoulli cantilever, with the value 2 at its tip; x (m,) m from the clamp, 0 for negative x."""
    z = FIRST * np.clip(x, 0.0, None) / length
    s = (np.sinh(FIRST) - np.sin(FIRST)) / (np.cosh(FIRST) + np.cos(FIRST))
    return np.cosh(z) - np.cos(z) - s * (np.sinh(z) - np.sin(z))


def timoshenko(length: float, radius: float, young: float, shear: float, density: float) -> float:
    """First angular frequency of a round cantilever with rotary inertia and shear, 1/s: 6 (1 + nu) / (7 + 6 nu) (Cowper, JAM 33).

    Frequency equation of Huang, J. Appl. Mech. 28 (1961) 579, clamped-free: with b^2 = rho A L^4 w^2/(E I), r^2 = I/(A L^2),
    s^2 = E I/(k A G L^2), 2 + (b^2 (r^2 - s^2)^2 + 2) cosh(b p) cos(b q) - b (r^2 + s^2)/sqrt(1 - b^2 r^2 s^2) sinh(b p) sin(b q) = 0.
    """
    nu = young / (2 * shear) - 1
    k = 6 * (1 + nu) / (7 + 6 * nu)
    r2 = radius**2 / 4 / length**2
    s2 = r2 * young / (k * shear)

    def residual(b: float) -> float:
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        p = np.sqrt((root - r2 - s2) / 2)
        q = np.sqrt((root + r2 + s2) / 2)
        last = b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2) * np.sinh(b * p) * np.sin(b * q)
        return float(2 + (b**2 * (r2 - s2) ** 2 + 2) * np.cosh(b * p) * np.cos(b * q) - last)

    b = brentq(residual, 0.3 * FIRST**2, 1.1 * FIRST**2, xtol=1e-12)
    return float(b * np.sqrt(young / density) * (radius / 2) / length**2)


def angular_frequency(times: np.ndarray, height: np.ndarray) -> float:
    """Angular frequency (1/s) of an oscillation about zero, from its first zero to its last."""
    i = np.flatnonzero(height[:-1] * height[1:] < 0)
    zero = times[i] - height[i] * (times[i + 1] - times[i]) / (height[i + 1] - height[i])
    return float(np.pi * (len(zero) - 1) / (zero[-1] - zero[0]))
