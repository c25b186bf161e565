"""Speed to which loads can drive a body."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.fields.dipole import MU0

WHIP = 4.0  # the square of a tip's speed over the mean of the body's: 3 for a body that turns about its base, and a free end whips
LOOKS = 9  # moments at which a field that changes in time is looked at


def driven_speed(model: Any, x: Array, time: float, way: float) -> float:
    """The speed (m/s) to which loads can drive a particle of a Model until a time (s): what feed gives, and sqrt(2 WHIP w).

    w: the largest work on a mass (J/kg): of weight along the farthest way (m); of a field that turns and pulls, 4 M B; of neighbors.
    x (n, 3) m: present positions.
    """
    scene, named = model.scene, model.scene.effects
    work = 0.0
    if named.gravity is not None:
        work += float(np.linalg.norm(named.gravity.acceleration)) * way
    remanence = np.linalg.norm(model.remanence[:, :3], axis=1)
    magnetic = float((remanence / model.density).max()) / MU0
    if named.in_a_field and magnetic > 0.0:
        field = scene.outside_field()
        most = max(float(np.linalg.norm(field.at(x, moment), axis=1).max()) for moment in np.linspace(0.0, time, LOOKS))
        work += 4.0 * magnetic * most
    if named.magnetic_interaction is not None:
        work += magnetic * float(remanence.max())
    return float(np.sqrt(2.0 * WHIP * work)) + (0.0 if named.feed is None else abs(named.feed.speed))
