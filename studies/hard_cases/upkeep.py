"""Hard cases of long and broken runs: a million steps, restarts, lost frames, fields reversed at once."""

from __future__ import annotations

import contextlib
import csv
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.errors import InputError
from magmpm.results.file_names import CHECKPOINT, ENERGIES
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import advance, at_rest, bending_field, changed, rod
from magmpm.studies.hard_cases.stepping import energy_kept, stays

SHORT = 8e-3  # m
FRAMES = 6
REVERSED = 0.02  # s


class _Interrupted(Exception):
    """A run that is ended from outside."""


def _reversed(scene: Scene) -> float:
    """Change of all energies after the reversal, over the largest kinetic energy."""
    motion, dt, _ = at_rest(scene)
    steps = int(np.ceil(REVERSED / dt))
    advance(motion, steps, dt)
    return energy_kept(motion, dt, 2 * steps, 40, steps * dt)


def _moving() -> Scene:
    moving = {"duration": 0.012, "output_every": 0.012 / FRAMES}
    return rod(length=SHORT, field=bending_field(1.0, length=SHORT), effects={"damping": {"rate": 100.0}}, dynamic=moving)


def _table(folder: Path) -> list[dict[str, Any]]:
    with (folder / ENERGIES).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _pieces(scene: Scene, folder: Path, broken: bool = False) -> Any:
    """The motion, ended after every frame and begun again from its checkpoint; broken: half a row was written after it."""
    every = scene.duration / FRAMES
    for k in range(1, FRAMES + 1):

        def stop(_: int, time: float, until: float = k * every) -> None:
            if time > until * (1 + 1e-9) and until < scene.duration:
                raise _Interrupted

        with contextlib.suppress(_Interrupted):
            result = run(scene, folder=folder, resume=(folder / CHECKPOINT).exists(), on_progress=stop)
        if broken and k < FRAMES:
            with (folder / ENERGIES).open("a", encoding="utf-8") as stream:
                stream.write(f"{(k + 0.5) * every!r},1.0")  # a row that the end of the process cut off
    return result


def _restarted(scene: Scene) -> float:
    """Largest difference of positions, over L, of a motion that is begun again at every checkpoint, from one that is not interrupted."""
    with tempfile.TemporaryDirectory() as folder:
        whole, parts = run(scene), _pieces(scene, Path(folder))
    return float(np.abs(whole.particle_position - parts.particle_position).max()) / scene.length


def _frames_lost(scene: Scene) -> float:
    """Frames of energies.csv that are missing, too many, or other than those of a run that nothing has broken."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        run(scene, folder=one)
        try:
            _pieces(scene, Path(other), broken=True)
        except InputError:  # the run can't go on
            return np.inf
        whole, parts = _table(Path(one)), _table(Path(other))
    return float(abs(len(whole) - len(parts)) + sum(a != b for a, b in zip(whole, parts, strict=False)))


def _field_reversed() -> Scene:
    scene = rod(field=bending_field(2.0), dynamic={})
    frames = [{"time": t, "strength": s} for t, s in ((0.0, 1.0), (REVERSED - 1e-9, 1.0), (REVERSED, -1.0))]
    return changed(scene, field={"uniform": list(scene.field.uniform), "over_time": {"keyframes": frames}})


CASES = (
    Case(
        "field reversed at once", _field_reversed, "blows up, or gains energy as the load changes its sign within a step",
        "change of all energies after it, over the largest kinetic", _reversed, 0.01,
        "nothing does work after the reversal: a constant field has a potential",
    ),
    Case(
        "drift in 10^6 steps", lambda: rod(length=SHORT, clamp="none", dynamic={}), "gains or loses energy or spin, a little in each step",
        "change of energy or spin, over those at first", stays(0.8, 1_000_000, 20), 0.1,
        "symplectic Euler: the energy of a mode swings within dt w / 2, and does not grow", slow=True,
    ),
    Case(
        "restart at every checkpoint", _moving, "goes on from another state than it saved",
        "difference from a run that is not interrupted, over L", _restarted, 0.0, "checkpoints hold all bits",
    ),
    Case(
        "frames lost", _moving, "writes frames twice, or goes on after half a row", "frames missing, too many or other", _frames_lost, 0.0,
        "tables are cut back to the checkpoint",
    ),
)
