"""magnetic_torque: a uniform outside field turns hard-magnetic material.

W = -(1/mu0) B . (F Br), so P = -(1/mu0) B (x) Br: constant, with no tangent and, in a uniform field, no net force.
The Cauchy stress it makes is not symmetric; its skew part is the torque density (1/mu0) (F Br) x B.
Source: Zhao, Kim, Cheng, Liu, Zhao, JMPS 124 (2019) 244-263, equations 8 to 12.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.advice import Advice, Body, shift
from magmpm.effects.hooks import NO_DATA, register
from magmpm.jit import compiled
from magmpm.scene import Scene

PHASE = "force"

MU0 = 4e-7 * np.pi  # T m/A
DTYPE = np.dtype([("field_over_mu0", np.float64, (3,))])


def parameters(field: NDArray[np.float64]) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """What kernels take. field (3,) T."""
    record = np.zeros(1, DTYPE)
    record["field_over_mu0"] = np.asarray(field) / MU0
    return record, NO_DATA


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take, or () where there is no field."""
    field = strength * np.array(scene.field.uniform)
    return parameters(field) if field.any() else ()


def advice(scene: Scene, body: Body) -> Advice:
    """How far the field bends the body."""
    if not any(scene.field.uniform) or not scene.magnetised_segments():
        return Advice(0.0, "nothing to turn, or no field to turn it")
    moved = shift(scene, body, "magnetic_torque")
    return Advice(moved, f"the field moves it by {100 * moved / scene.length:.2g} % of its length")


@compiled
def energy(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    """-(1/mu0) B . (F Br), J/m^3."""
    h = effect.field_over_mu0
    total = 0.0
    for i in range(3):
        total -= h[i] * (F[i, 0] * magnet[0] + F[i, 1] * magnet[1] + F[i, 2] * magnet[2])
    return total


@compiled
def stress(effect, data, magnet, rho, x, F, P):  # type: ignore[no-untyped-def]
    """P -= (1/mu0) B (x) Br, Pa."""
    h = effect.field_over_mu0
    for i in range(3):
        for j in range(3):
            P[i, j] -= h[i] * magnet[j]


register(DTYPE, wide=("stress",), energy=energy, stress=stress)
