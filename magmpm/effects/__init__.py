"""Effects: one file each. What a scene does not name is not simulated and costs nothing.

To add an effect: one file with its dtype, its `parameters` and its hooks (effects.hooks says which there are), one key in the scene's
schema, and one line in `collect`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.effects import gravity, magnetic_torque
from magmpm.scene import Scene


def collect(scene: Scene, strength: float = 1.0) -> tuple[NDArray[Any], ...]:
    """Parameter records and data, in turn, of the effects the scene names, by phase, never by their order in the file.

    strength scales every load, 0 to 1: a solve that ramps the load from zero asks for the steps between. An effect at zero strength
    is left out: the kernels without it give the same numbers bit for bit, those that add its zeros need not (sums are reassociated).
    """
    named: list[NDArray[Any]] = []
    field = strength * np.array(scene.field.uniform)
    if scene.effects.magnetic_torque is not None and field.any():
        named += magnetic_torque.parameters(field)
    if scene.effects.gravity is not None:
        acceleration = strength * np.array(scene.effects.gravity.acceleration)
        if acceleration.any():
            named += gravity.parameters(acceleration)
    return tuple(named)
