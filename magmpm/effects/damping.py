"""damping: the surroundings resist in proportion to mass and velocity. Every node's velocity decays by exp(-rate dt) a step.

A motion of frequency w falls off by exp(-rate t / 2); rate = 2 w is critical, and settles soonest: about 60 /s for a silicone catheter
of 40 x 4 mm. The decay is exact for any step, so it needs no smaller one, and takes energy out, never in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.jit import compiled
from magmpm.effects.estimates import Advice, Body
from magmpm.effects.hooks import NO_DATA, register
from magmpm.scene import Scene

PHASE = "damping"
DTYPE = np.dtype([("damping_rate", np.float64)])


def parameters(rate: float) -> tuple[NDArray[Any], ...]:
    """What kernels take. rate 1/s."""
    record = np.zeros(1, DTYPE)
    record["damping_rate"] = rate
    return record, NO_DATA


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take, or () where the rate is zero."""
    settings = scene.effects.damping
    return parameters(settings.rate) if settings is not None and settings.rate > 0 else ()


def advice(scene: Scene, body: Body) -> Advice:
    """What rate would settle the body soonest."""
    if body.frequency is None:
        return Advice(0.0, "moves no equilibrium; settles motion")
    best = 2 * body.frequency
    named = scene.effects.damping
    says = f"moves no equilibrium; {best:.3g} 1/s settles its first bending soonest"
    if named is not None:
        says += f", {named.rate:.3g} 1/s is {named.rate / best:.2g} of that"
    return Advice(0.0, says)


@compiled
def node(effect, data, X, u, v, dt):  # type: ignore[no-untyped-def]
    """v *= exp(-rate dt)."""
    left = math.exp(-effect.damping_rate * dt)
    for i in range(3):
        v[i] *= left


register(DTYPE, node=node)
