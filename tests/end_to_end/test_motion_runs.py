"""`magmpm run` of motions that are refused, or fail: message, exit status, and files on disk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from swing import SCENE, scene

from magmpm.cli import main
from magmpm.dynamics.time_loop import begin
from magmpm.errors import InputError, SceneError
from magmpm.model import build
from magmpm.results.file_names import ABOUT, CHECKPOINT, CONTACTS, ENERGIES, MOTION
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import load_scene
from magmpm.scene.memory import within

# A field of 20 T lets a body fly apart within a millisecond.
WILD = SCENE.format(dynamic="duration: 50 ms, output_every: 0.2 ms, time_step: 1 us").replace("20 mT", "20 T")


def test_a_step_above_the_bound_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With both numbers; a step just below the bound is accepted."""
    path = scene(tmp_path, "duration: 0.4 ms")
    largest = begin(build(load_scene(path))).stable.largest
    too_long = scene(tmp_path, f"duration: 0.4 ms, time_step: {1.01e6 * largest:.6g} us")
    assert main(["run", str(too_long), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"{largest:.4g} s" in said
    assert f'{too_long}:12: solver.dynamic.time_step: received "{1.01e6 * largest:.6g} us"\n  rule: ' in said
    assert "\n  remedy: " in said
    short = scene(tmp_path, f"duration: 0.4 ms, time_step: {0.99e6 * largest:.6g} us")
    assert main(["run", str(short), "--out", str(tmp_path / "out")]) == 0


def test_a_motion_that_goes_wrong_ends_with_its_last_good_state(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 3, with step, time, cause, remedy; frames and result on disk."""
    path, out = tmp_path / "scene.yaml", tmp_path / "out"
    path.write_text(WILD)
    assert main(["run", str(path), "--json", "--out", str(out)]) == 3
    printed = capsys.readouterr()
    summary = json.loads(printed.out)
    assert not summary["converged"]
    for part in ("step ", "t = ", "time step is", "stable bound", "remedy", str(out)):
        assert part in printed.err, part
    kept = Result.load(out)
    assert not kept.converged
    assert np.isfinite(kept.particle_position).all()
    assert kept.min_det_F > 0
    frames = Motion.load(out)
    assert len(frames) >= 1
    assert frames.times[-1] == pytest.approx(kept.time, abs=1e-12)


def test_too_little_memory_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(scene(tmp_path, "duration: 1 ms, max_memory: 80 kB")), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f'{tmp_path / "scene.yaml"}:12: solver.dynamic.max_memory: received "80 kB"' in said
    assert "\n  remedy: raise it, or use fewer cells_across" in said


def test_far_too_little_memory_is_refused_before_anything_is_built(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By an estimate from below, in no time."""
    path = scene(tmp_path, "duration: 1 ms, max_memory: 1 MB")
    path.write_text(path.read_text().replace("length: 16 mm", "length: 0.4 m").replace("cells_across: 2", "cells_across: 16"))
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f'{path}:12: solver.dynamic.max_memory: received "1 MB"\n  rule: must be at least' in said
    assert "at least 2.29 GB for 2.87e+06 particles" in said  # 224 cells of 16^2, 1600 along the length, 2^3 particles in each


@pytest.mark.parametrize("solver", ["dynamic: {duration: 1 ms}", "static: {}"])
def test_a_body_that_memory_can_t_hold_is_refused(
    solver: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the memory of the machine: key, value, rule and remedy instead of a traceback."""
    path = scene(tmp_path, "duration: 1 ms")
    path.write_text(path.read_text().replace("dynamic: {duration: 1 ms}", solver))
    monkeypatch.setattr("magmpm.scene.memory.machine", lambda: 5e4)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"{path}:13: resolution.cells_across: received 2; particles and grid take at least 0.205 MB for 256 particles" in said
    assert "this machine has" in said
    assert "\n  rule: " in said
    assert "\n  remedy: use fewer cells_across" in said


def test_an_allocation_that_fails_is_refused_as_well(tmp_path: Path) -> None:
    refused = pytest.raises(SceneError, match=r"take at least 0\.205 MB for 256 particles, which could not be had")
    with refused, within(load_scene(scene(tmp_path, "duration: 1 ms"))):
        np.empty(2**55)  # numpy's own MemoryError


@pytest.mark.parametrize("over", ["oscillation: {frequency: 26 kHz}", "rotation: {axis: [0, 1, 0], frequency: -26 kHz}"])
def test_the_step_resolves_a_field_that_changes_fast(over: str, tmp_path: Path) -> None:
    """With steps of 1/26 ms a field of 26 kHz would look constant: the largest step is 1/20 of the period, and is named."""
    path = scene(tmp_path, "duration: 1 ms")
    slow = path.read_text(encoding="utf-8").replace("20 mT]", "20 mT], over_time: {" + over + "}")
    path.write_text(slow, encoding="utf-8")
    moved = begin(build(load_scene(path)))
    assert moved.stable.named["schedule"] == pytest.approx(1 / (20 * 26e3))
    assert moved.stable.largest == moved.stable.named["schedule"]
    assert moved.dt <= moved.stable.largest
    path.write_text(slow.replace("26 kHz", "5 Hz"), encoding="utf-8")
    assert begin(build(load_scene(path))).stable.largest > moved.stable.largest
    path.write_text(slow.replace("duration: 1 ms", "duration: 1 ms, time_step: 3 us"), encoding="utf-8")
    with pytest.raises(InputError, match=r"time_step: received 3e-06 s.*\n?.*schedule 1.923e-06 s"):
        begin(build(load_scene(path)))


def test_an_equilibrium_takes_the_place_of_a_motion(tmp_path: Path) -> None:
    """No file of an older motion remains in the folder."""
    path, out = scene(tmp_path, "duration: 0.4 ms, output_every: 0.4 ms"), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0
    (out / CONTACTS).touch()
    path.write_text(path.read_text(encoding="utf-8").replace("dynamic: {duration: 0.4 ms, output_every: 0.4 ms}", "static: {}"))
    assert main(["run", str(path), "--out", str(out)]) == 0
    assert Result.load(out).formulation == "static"
    assert not [name for name in (MOTION, ENERGIES, CONTACTS, ABOUT, CHECKPOINT) if (out / name).exists()]
