"""A result is the same, bit for bit, however often its run was interrupted: three times, and once more when it was finished."""

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene

from magmpm import Scene, run
from magmpm.dynamics.time_loop import begin
from magmpm.model import build
from magmpm.results.file_names import ARRAYS, CHECKPOINT, ENERGIES, JUMPS, MOTION, NUMBERS, STEPS
from magmpm.simulate import simulated
from magmpm.solving.solve import RunOptions

BODY = {
    "catheter": {
        "length": 8e-3,
        "diameter": 4e-3,
        "material": "m",
        "clamp": "base",
        "segments": [{"magnetization": [0.0, 0.0, 1.0]}],
    }
}
# All kinds of effects: a field that turns; viscous stress, which needs the velocity gradient; contact with the ground; a guide that pushes.
EFFECTS: dict[str, Any] = {
    "magnetic_torque": {},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "viscosity": {"viscosity": 5.0},
    "damping": {"rate": 5.0},
    "ground": {"point": [0.0, 0.0, -2.0e-3], "friction": 0.2},
    "walls": {"tube": {"radius": 3e-3, "path": [[-5e-3, 0, 0], [20e-3, 0, 0]]}},
    "feed": {"speed": 20e-3, "exit": 6e-3},
}
TURNING = {
    "uniform": [0.0, 2e-3, 20e-3],
    "over_time": {"rotation": {"axis": [0.0, 1.0, 0.0], "frequency": 200.0}},
}
# checkpoints late in a motion too, after more than a thousand steps
FRAMES = 6
STEPS_EACH = 230


class Interrupted(Exception):
    """A kill between two chunks of work: on disk is what was there."""


def motion() -> Scene:
    """A catheter pushed through a guide over the ground, in a field that turns."""
    data = moving_scene(BODY, EFFECTS, duration=1e-3).to_si()
    data["field"] = TURNING
    data["materials"]["m"] |= {"remanence": 0.1, "magnetization_law": "rotates"}
    step = begin(build(Scene.from_si(data))).control.step
    data["solver"]["dynamic"] |= {
        "duration": (FRAMES - 0.5) * STEPS_EACH * step,
        "output_every": STEPS_EACH * step,
    }
    return Scene.from_si(data)


def column(length: float = 20e-3, **more: Any) -> Scene:
    """A column that its field, along its axis, pushes together: it buckles where the field grows."""
    more = {"resolution": {"cells_across": 2}} | more
    silicone = {
        "shear_modulus": 120e3,
        "bulk_to_shear": 20.0,
        "density": 1100.0,
        "remanence": 138e-3,
    }
    catheter = {
        "length": length,
        "diameter": 2e-3,
        "material": "m",
        "segments": [{"magnetization": [1.0, 0.0, 0.0]}],
    }
    return Scene.from_si(
        {
            "name": "column",
            "materials": {"m": silicone},
            "body": {"catheter": catheter},
            "effects": {"magnetic_torque": {}},
            **more,
        }
    )


def timeless(value: Any) -> Any:
    """Plain data without the seconds that something took."""
    if isinstance(value, dict):
        return {key: timeless(one) for key, one in value.items() if not key.startswith("seconds")}
    return [timeless(one) for one in value] if isinstance(value, list) else value


def finished(scene: Scene, folder: Path) -> dict[str, Any]:
    """Everything that a run leaves when it is resumed to its end."""
    run(scene, folder=folder, resume=True).save(folder)
    with np.load(folder / ARRAYS) as stored:
        arrays = {name: stored[name].tobytes() for name in stored.files}
    tables = {
        name: (folder / name).read_text()
        for name in (ENERGIES, STEPS, JUMPS)
        if (folder / name).exists()
    }
    saved = [folder / name for name in (CHECKPOINT, MOTION) if (folder / name).exists()]
    frames = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in saved}
    return {**timeless(json.loads((folder / NUMBERS).read_text())), **arrays, **tables, **frames}


def interrupt(scene: Scene, folder: Path, moment: float) -> None:
    """Begin a run, or go on with it, and end it at a moment: a share of its time, or of a solve's first steps."""

    def after(step: int, at: float) -> None:
        if (at > moment * scene.duration) if scene.in_time else (step > 4 * moment):
            raise Interrupted

    with suppress(Interrupted):
        simulated(scene, RunOptions(folder=folder, resume=True, on_progress=after))


RAMP = {"over_time": {"ramp": {"duration": 1.0}}, "uniform": [-8e-3, 0.0, 0.0]}
STEADY = {"uniform": [0.0, 0.0, 3e-3]}
PATH = {"solver": {"quasi_static": {"steps": 4}}}
ASKED = {"resolution": {"error": 2e-4}}
SCENES: dict[str, Callable[[], Scene]] = {
    "motion": motion,
    "quasi-static": partial(column, **PATH, field=RAMP),
    "quasi-static, error": partial(
        column, 8e-3, **PATH, field=RAMP | {"uniform": STEADY["uniform"]}, **ASKED
    ),
    "static": partial(column, field=STEADY),
    "static, error": partial(column, field=STEADY, **ASKED),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name == "quasi-static, error" else [])
        for name in SCENES
    ],
)
def test_a_result_is_that_of_a_run_without_interruptions(name: str, tmp_path: Path) -> None:
    scene = SCENES[name]()
    drawn = np.random.default_rng(26)
    whole = finished(scene, tmp_path / "whole")
    assert finished(scene, tmp_path / "whole") == whole, "a finished run, resumed"
    for moment in np.sort(drawn.uniform(0.0, 1.0, 3)):
        interrupt(scene, tmp_path / "killed", moment)
    found = finished(scene, tmp_path / "killed")
    assert [key for key in whole.keys() | found.keys() if whole.get(key) != found.get(key)] == []
