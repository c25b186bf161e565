"""A motion that is interrupted late and resumed equals an uninterrupted one bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene

from magmpm.dynamics.checkpoint import Checkpoint
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.model import build
from magmpm.scene import Scene

BODY = {"catheter": {"length": 8e-3, "diameter": 4e-3, "material": "m", "clamp": "base", "segments": [{"magnetization": [0.0, 0.0, 0.0]}]}}
# All kinds of effects: viscous stress, which needs the velocity gradient; contact with the ground; a guide that pushes.
EFFECTS: dict[str, Any] = {
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "viscosity": {"viscosity": 5.0},
    "damping": {"rate": 5.0},
    "ground": {"point": [0.0, 0.0, -2.0e-3], "friction": 0.2},
    "walls": {"tube": {"radius": 3e-3, "path": [[-5e-3, 0, 0], [20e-3, 0, 0]]}},
    "feed": {"speed": 20e-3, "exit": 6e-3},
}
FRAMES, STEPS, LATE = 8, 230, 1024  # number of frames, the least number of steps in each, and steps until it ends


class Interrupted(Exception):
    """Represents a kill: the files on disk are those after a kill just after the last checkpoint."""


def scene() -> Scene:
    """A catheter pushed through a guide over the ground, for FRAMES times STEPS steps."""
    data = moving_scene(BODY, EFFECTS, duration=1e-3).to_si()
    step = begin(build(Scene.from_si(data))).control.step
    data["solver"]["dynamic"] |= {"duration": FRAMES * STEPS * step, "output_every": STEPS * step}
    return Scene.from_si(data)


def test_ended_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magmpm.dynamics.time_loop.SAVE_EVERY", 0.0)
    given = scene()
    whole = integrate(begin(build(given)))

    def interrupt(at: float, steps: int) -> None:
        if steps > LATE + STEPS:
            raise Interrupted

    ended = begin(build(given))
    with pytest.raises(Interrupted):
        integrate(ended, folder=tmp_path, on_progress=interrupt)
    assert whole.steps > LATE + 512 > ended.steps > LATE
    saved = Checkpoint.load(tmp_path, given)
    assert saved is not None
    assert saved.steps > LATE
    again = integrate(begin(build(given)), folder=tmp_path, resume=True)
    assert again.steps == whole.steps
    assert again.energies == whole.energies
    kept, found = whole.motion.state(), again.motion.state()
    assert kept.keys() == found.keys()
    for name, values in kept.items():
        assert found[name].tobytes() == values.tobytes(), name
    assert np.abs(whole.x - whole.motion.model.particles.position).max() > 1e-6
