"""damping: the surroundings resist in proportion to mass and velocity. Every node's velocity decays by exp(-rate dt) a step.

A motion of frequency w falls off by exp(-rate t / 2); rate = 2 w is critical, and settles soonest: about 60 /s for a silicone catheter
of 40 x 4 mm. The decay is exact for any step, so it needs no smaller one, and takes energy out, never in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.effects.hooks import NO_DATA, register
from magmpm.jit import compiled
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


@compiled
def node(effect, data, X, u, v, dt):  # type: ignore[no-untyped-def]
    """v *= exp(-rate dt)."""
    left = math.exp(-effect.damping_rate * dt)
    for i in range(3):
        v[i] *= left


register(DTYPE, node=node)
