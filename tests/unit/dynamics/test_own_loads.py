"""Loads by which a body acts on itself, which are held for some steps (test_motion_loads.py has their values)."""

from __future__ import annotations

import numpy as np
import pytest
from reference.moving import moving_scene

from magmpm.scene import Scene
from magmpm.simulate import run


@pytest.mark.slow
def test_a_motion_with_interaction_does_not_depend_on_the_time_step() -> None:
    """Two segments that turn in a field, without frames in between: half the step changes the tip by 0.2 % of what it moves.

    Loads that are held for 256 steps, as computed, change it by 21 %.
    """

    def scene(safety: float) -> Scene:
        segments = [{"magnetization": [0.0, 0.3, 1.0], "length": 6e-3}, {"magnetization": [0.0, -1.0, 0.3]}]
        body = {"catheter": {"length": 12e-3, "diameter": 2e-3, "material": "m", "segments": segments}}
        effects = {"magnetic_interaction": {"blocks_across": 2}, "magnetic_torque": {}}
        data = moving_scene(body, effects, shear=1e4, duration=0.02, field={"uniform": [0.02, 0.02, 0.0]}).to_si()
        data["solver"]["dynamic"].update(safety=safety, output_every=0.02)
        return Scene.from_si(data)

    one, other = run(scene(0.8)), run(scene(0.4))
    moved = np.linalg.norm(one.tip - [12e-3, 0.0, 0.0])
    assert moved > 0.01
    assert np.linalg.norm(one.tip - other.tip) < 5e-3 * moved
