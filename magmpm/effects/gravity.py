"""gravity: weight. W = -rho g . u, so the force per undeformed volume is rho g, constant, with no tangent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magmpm.effects.hooks import register
from magmpm.jit import compiled

DTYPE = np.dtype([("gravity", np.float64, (3,))])


def parameters(acceleration: NDArray[np.float64]) -> NDArray[np.void]:
    """The record kernels take. acceleration (3,) m/s^2."""
    record = np.zeros(1, DTYPE)
    record["gravity"] = np.asarray(acceleration)
    return record


@compiled
def energy(effect, magnet, rho, u, F):  # type: ignore[no-untyped-def]
    """-rho g . u, J/m^3, zero in the undeformed body."""
    g = effect.gravity
    return -rho * (g[0] * u[0] + g[1] * u[1] + g[2] * u[2])


@compiled
def force(effect, magnet, rho, u, F, f):  # type: ignore[no-untyped-def]
    """f += rho g, N/m^3."""
    for i in range(3):
        f[i] += rho * effect.gravity[i]


register(DTYPE, energy=energy, force=force)
