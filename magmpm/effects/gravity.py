"""gravity: weight. W = -rho g . x, so the force per undeformed volume is rho g, constant, with no tangent."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.jit import compiled
from magmpm.effects.estimates import Advice, Body, in_lengths, shift
from magmpm.effects.hooks import NO_DATA, register
from magmpm.scene import Scene

PHASE = "force"
DTYPE = np.dtype([("gravity", np.float64, (3,))])


def parameters(acceleration: NDArray[np.float64]) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """What kernels take. acceleration (3,) m/s^2."""
    record = np.zeros(1, DTYPE)
    record["gravity"] = np.asarray(acceleration)
    return record, NO_DATA


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take, or () where there is no weight."""
    settings = scene.effects.gravity
    acceleration = strength * np.array(settings.acceleration if settings else (0.0, 0.0, 0.0))
    return parameters(acceleration) if acceleration.any() else ()


def advice(scene: Scene, body: Body) -> Advice:
    """How far weight bends the body."""
    if any(scene.materials[region.material_name].density is None for region in scene.regions()):
        return Advice(None, "not known: a material has no density")
    moved = shift(scene, body, "gravity")
    return Advice(moved, f"weight moves it by {in_lengths(moved, scene)}")


@compiled
def energy(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    """-rho g . x, J/m^3: zero at the origin."""
    g = effect.gravity
    return -rho * (g[0] * x[0] + g[1] * x[1] + g[2] * x[2])


@compiled
def force(effect, data, magnet, rho, x, F, f):  # type: ignore[no-untyped-def]
    """f += rho g, N/m^3."""
    for i in range(3):
        f[i] += rho * effect.gravity[i]


register(DTYPE, wide=("force",), energy=energy, force=force)
