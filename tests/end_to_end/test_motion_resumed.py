"""`magmpm run` of motions that are killed, resumed or lengthened, and of damaged checkpoints."""

import json
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from reference.commands import started, wait_for
from reference.damage import byte_changed, cut_short, emptied
from reference.stopped import interrupted
from swing import scene, text

from magmpm.cli.draw import motion_of
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.errors import InputError, SceneError
from magmpm.model import build
from magmpm.results.file_names import ABOUT, CHECKPOINT, ENERGIES, MOTION, NUMBERS
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import load_scene
from magmpm.scene.memory import within


def test_killed_and_resumed_is_the_same_motion(tmp_path: Path, told) -> None:
    """SIGKILL at some frame, then --resume: result and checkpoint equal those of an uninterrupted run bit for bit; no frame is missing."""
    path = scene(tmp_path, "duration: 40 ms, output_every: 1 ms")
    whole = tmp_path / "whole"
    broken = tmp_path / "broken"
    told("run", path, "--out", whole)
    process = started("run", path, "--out", broken)
    wait_for((broken / CHECKPOINT).exists, process)
    time.sleep(0.01)
    process.kill()
    assert process.wait() == -signal.SIGKILL, "the run was over before it could be killed"
    with np.load(broken / CHECKPOINT) as saved:
        frame = json.loads(str(saved["about"]))["frame"]
    assert 1 <= frame < 40

    told("run", path, "--out", broken, "--resume")
    one = Result.load(whole)
    two = Result.load(broken)
    assert one.iterations == two.iterations
    assert one.particle_position.tobytes() == two.particle_position.tobytes()
    assert one.particle_det_F.tobytes() == two.particle_det_F.tobytes()
    with np.load(whole / CHECKPOINT) as a, np.load(broken / CHECKPOINT) as b:
        assert all(a[name].tobytes() == b[name].tobytes() for name in a.files)
    first = Motion.load(whole)
    second = Motion.load(broken)
    assert len(first) == len(second) == 41
    for k in (0, frame, 40):
        assert first[k].position.tobytes() == second[k].position.tobytes()


def test_a_motion_resumed_at_its_first_frames_goes_on(tmp_path: Path) -> None:
    """At the start of an oscillation, half a step changes the kinetic energy by a fifth: this is not energy from nothing."""
    loaded = load_scene(scene(tmp_path, "duration: 2 ms, output_every: 0.2 ms"))
    interrupted(loaded, tmp_path, 0.3e-3)
    again = integrate(begin(build(loaded)), folder=tmp_path, resume=True)
    assert again.x.tobytes() == integrate(begin(build(loaded))).x.tobytes()


def test_a_checkpoint_that_the_disk_does_not_take_is_warned_of(tmp_path: Path) -> None:
    """The motion itself is complete."""
    begun = begin(build(load_scene(scene(tmp_path, "duration: 1 ms, output_every: 0.5 ms"))))
    moved = integrate(
        begun, folder=tmp_path, on_state=lambda _: (tmp_path / CHECKPOINT).mkdir(exist_ok=True)
    )
    assert len(moved.warnings) == 1
    assert moved.warnings[0].startswith(
        f"{tmp_path / CHECKPOINT}: Is a directory: --resume can only continue"
    )
    assert len(Motion.load(tmp_path)) == 3


def test_resuming_another_scene_is_refused(tmp_path: Path, told) -> None:
    out = tmp_path / "out"
    path = scene(tmp_path, "duration: 1 ms, output_every: 1 ms")
    told("run", path, "--out", out)
    path.write_text(path.read_text(encoding="utf-8").replace("20 mT", "19 mT"), encoding="utf-8")
    says = (
        f"{out / CHECKPOINT}: received the checkpoint of another scene",
        "\n  rule: ",
        "\n  remedy: ",
    )
    told("run", path, "--out", out, "--resume", status=2, says=says)


@pytest.mark.parametrize(
    ("short", "long"),
    [("2 ms, output_every: 1 ms", "4 ms, output_every: 1 ms"), ("0.5 ms", "0.6 ms")],
)
def test_a_motion_is_lengthened(short: str, long: str, tmp_path: Path, told) -> None:
    """It continues from its end, with the same frame interval, and equals a motion of that length."""
    out = tmp_path / "out"
    whole = tmp_path / "whole"
    frames = (
        long if "every" in long else f"{long}, output_every: 5 us"
    )  # a hundredth of the short one
    told("run", scene(tmp_path, f"duration: {short}"), "--out", out)
    told("run", scene(tmp_path, f"duration: {long}"), "--out", out, "--resume")
    told("run", scene(tmp_path, f"duration: {frames}"), "--out", whole)
    one = Motion.load(out)
    two = Motion.load(whole)
    np.testing.assert_array_equal(one.times, two.times)
    np.testing.assert_array_equal(one.energies["total"], two.energies["total"])
    for k in range(len(one)):
        np.testing.assert_array_equal(
            one[k].quantities["cauchy_stress"], two[k].quantities["cauchy_stress"]
        )
    assert (
        Result.load(out).particle_position.tobytes()
        == Result.load(whole).particle_position.tobytes()
    )
    assert (
        one.scene["solver"]["dynamic"]["duration"]
        == Result.load(out).scene["solver"]["dynamic"]["duration"]
        > 5e-4
    )


@pytest.mark.parametrize(
    ("short", "long", "rule"),
    [
        (
            "2 ms, output_every: 1 ms",
            "1 ms, output_every: 1 ms",
            "must be at least the time already simulated, 0.002 s",
        ),
        ("2.5 ms, output_every: 1 ms", "4 ms, output_every: 1 ms", "it ended between two"),
        (
            "2 ms, output_every: 1 ms",
            "4 ms, output_every: 2 ms",
            "only its duration may be longer, and its budgets",
        ),
    ],
)
def test_what_can_t_be_lengthened_is_refused(
    short: str, long: str, rule: str, tmp_path: Path, told
) -> None:
    out = tmp_path / "out"
    told("run", scene(tmp_path, f"duration: {short}"), "--out", out)
    before = Result.load(out)
    told("run", scene(tmp_path, f"duration: {long}"), "--out", out, "--resume", status=2, says=rule)
    assert Result.load(out).time == before.time


def test_a_motion_goes_on_with_a_larger_budget(tmp_path: Path, told) -> None:
    out = tmp_path / "out"
    length = "duration: 4 ms, output_every: 0.1 ms"
    told(
        "run",
        scene(tmp_path, f"{length}, max_disk: 600 kB"),
        "--out",
        out,
        status=3,
        says="raise max_disk",
    )
    kept = Result.load(out)
    frames = Motion.load(out)
    assert 2 < len(frames) < 41, "whole frames before the limit"
    assert kept.time == pytest.approx(frames.times[-1], abs=1e-12)
    assert sum(file.stat().st_size for file in out.glob("motion.*")) < 600e3
    told("run", scene(tmp_path, length), "--out", out, "--resume")
    assert len(Motion.load(out)) == 41


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (lambda out, earlier: shutil.copy(earlier / MOTION, out / MOTION), MOTION),
        (
            lambda out, _: (out / ENERGIES).write_bytes((out / ENERGIES).read_bytes()[:150]),
            ENERGIES,
        ),
        (lambda out, _: (out / ENERGIES).unlink(), ENERGIES),
        (lambda out, _: (out / ENERGIES).write_text("null\nnull\n"), ENERGIES),
    ],
    ids=["frames", "rows cut", "no rows", "garbage"],
)
def test_a_motion_with_holes_is_not_resumed(
    damage: Callable[[Path, Path], None], name: str, tmp_path: Path, told
) -> None:
    """Frames or rows before the checkpoint are missing: the continuation would not fit. Tables with missing rows are not drawn either."""
    out = tmp_path / "out"
    earlier = tmp_path / "earlier"
    told("run", scene(tmp_path, "duration: 2 ms, output_every: 1 ms"), "--out", out)
    shutil.copytree(out, earlier)
    told("run", scene(tmp_path, "duration: 4 ms, output_every: 1 ms"), "--out", out, "--resume")
    damage(out, earlier)
    left = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    longer = scene(tmp_path, "duration: 5 ms, output_every: 1 ms")
    told("run", longer, "--out", out, "--resume", status=2, says=f"{out / name}: received ")
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == left
    if name == ENERGIES:
        with pytest.raises(InputError, match=ENERGIES):
            Motion.load(out)


def _of_another_version(path: Path) -> None:
    with np.load(path) as stored:
        arrays = dict(stored)
    about = json.loads(str(arrays.pop("about")))
    np.savez(path, about=np.array(json.dumps({**about, "unknown": 1})), **arrays)


def _no_archive(path: Path) -> None:
    np.save(path.with_suffix(".npy"), np.zeros(3))
    path.with_suffix(".npy").replace(path)


def _without_state(path: Path) -> None:
    with np.load(path) as stored:
        about = stored["about"]
    np.savez(path, about=about)


@pytest.mark.parametrize(
    "damage", [cut_short, emptied, byte_changed, _of_another_version, _no_archive, _without_state]
)
def test_a_damaged_checkpoint_is_refused(
    damage: Callable[[Path], None], tmp_path: Path, told
) -> None:
    """With file and remedy; never a traceback."""
    path = scene(tmp_path, "duration: 0.4 ms, output_every: 0.4 ms")
    out = tmp_path / "out"
    told("run", path, "--out", out)
    damage(out / CHECKPOINT)
    told(
        "run",
        path,
        "--out",
        out,
        "--resume",
        status=2,
        says=(str(out / CHECKPOINT), "remedy: remove it"),
    )


def test_a_motion_begun_afresh_leaves_no_older_checkpoint(tmp_path: Path, told) -> None:
    """If it is killed before its first frame, it must not be resumed from the last checkpoint of another run."""
    path = scene(tmp_path, "duration: 0.8 ms, output_every: 0.4 ms")
    out = tmp_path / "out"
    told("run", path, "--out", out)
    interrupted(load_scene(path), out, 0.0)
    assert not (out / CHECKPOINT).exists()


def test_resuming_from_nothing_is_said(tmp_path: Path, told) -> None:
    """The motion starts from the beginning; a second --resume, from its checkpoint, gives no message."""
    path = scene(tmp_path, "duration: 0.4 ms, output_every: 0.4 ms")
    out = tmp_path / "out"
    resumed = ["run", path, "--out", out, "--resume"]
    told(*resumed, says=f"{out} holds no checkpoint.npz; the motion starts over")
    assert "--resume" not in told(*resumed).err
    path.write_text(
        path.read_text(encoding="utf-8").replace(
            "dynamic: {duration: 0.4 ms, output_every: 0.4 ms}", "static: {}"
        )
    )
    told(*resumed, says="a static scene has no checkpoints")


@pytest.mark.parametrize("content", ["null", "{", "", '{"name": null, "scene": 3}'])
def test_damaged_files_beside_a_motion(content: str, tmp_path: Path, told) -> None:
    """motion.json is refused by name, and written again by --resume; a damaged result does not affect the motion."""
    path = scene(tmp_path, "duration: 0.8 ms, output_every: 0.4 ms")
    out = tmp_path / "out"
    told("run", path, "--out", out)
    (out / NUMBERS).write_text(content)
    assert len(motion_of(out)) == 3
    (out / ABOUT).write_text(content)
    told("render", out, status=2, says=(f"{out / ABOUT}: can't be read (", "\n  remedy: "))
    told("run", path, "--out", out, "--resume")
    assert len(Motion.load(out)) == 3
    (out / ENERGIES).write_text("t,kinetic\nnever,0\n")
    told(
        "run",
        path,
        "--out",
        out,
        "--resume",
        status=2,
        says=f"{out / ENERGIES}: received what can't be read as one (",
    )


# `magmpm run` of motions that are refused, or fail: message, exit status, and files on disk


# A field of 20 T lets a body fly apart within a millisecond.
WILD = text("duration: 50 ms, output_every: 0.2 ms, time_step: 1 us").replace("20 mT", "20 T")


def test_a_step_above_the_bound_is_refused(tmp_path: Path, told) -> None:
    """With both numbers; a step just below the bound is accepted."""
    path = scene(tmp_path, "duration: 0.4 ms")
    largest = begin(build(load_scene(path))).stable.largest
    too_long = scene(tmp_path, f"duration: 0.4 ms, time_step: {1.01e6 * largest:.6g} us")
    received = (
        f'{too_long}:7: solver.dynamic.time_step: received "{1.01e6 * largest:.6g} us"\n  rule: '
    )
    told(
        "run",
        too_long,
        "--out",
        tmp_path / "out",
        status=2,
        says=(f"{largest:.4g} s", received, "\n  remedy: "),
    )
    told(
        "run",
        scene(tmp_path, f"duration: 0.4 ms, time_step: {0.99e6 * largest:.6g} us"),
        "--out",
        tmp_path / "out",
    )


def test_a_motion_that_goes_wrong_ends_with_its_last_good_state(tmp_path: Path, told) -> None:
    """Exit 3, with step, time, cause, remedy; frames and result on disk."""
    path = tmp_path / "scene.yaml"
    out = tmp_path / "out"
    path.write_text(WILD)
    says = "step ", "t = ", "time step is", "stable bound", "remedy", str(out)
    assert not json.loads(told("run", path, "--json", "--out", out, status=3, says=says).out)[
        "converged"
    ]
    kept = Result.load(out)
    assert not kept.converged
    assert np.isfinite(kept.particle_position).all()
    assert kept.min_det_F > 0
    frames = Motion.load(out)
    assert len(frames) >= 1
    assert frames.times[-1] == pytest.approx(kept.time, abs=1e-12)


def test_too_little_memory_is_refused(tmp_path: Path, told) -> None:
    path = scene(tmp_path, "duration: 1 ms, max_memory: 80 kB")
    says = (
        f'{path}:7: solver.dynamic.max_memory: received "80 kB"',
        "\n  remedy: raise it, or use fewer cells_across",
    )
    told("run", path, "--out", tmp_path / "out", status=2, says=says)


def test_far_too_little_memory_is_refused_before_anything_is_built(tmp_path: Path, told) -> None:
    """By an estimate from below, in no time."""
    path = scene(tmp_path, "duration: 1 ms, max_memory: 1 MB")
    path.write_text(
        path.read_text()
        .replace("length: 16 mm", "length: 0.4 m")
        .replace("cells_across: 2", "cells_across: 16")
    )
    received = f'{path}:7: solver.dynamic.max_memory: received "1 MB"\n  rule: must be at least'
    # 224 cells of 16^2, 1600 along the length, 2^3 particles in each
    needed = "at least 2.29 GB for 2.87e+06 particles"
    told("run", path, "--out", tmp_path / "out", status=2, says=(received, needed))


@pytest.mark.parametrize("solver", ["dynamic: {duration: 1 ms}", "static: {}"])
def test_a_body_that_memory_can_t_hold_is_refused(
    solver: str, tmp_path: Path, told, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the memory of the machine: key, value, rule and remedy instead of a traceback."""
    path = scene(tmp_path, "duration: 1 ms")
    path.write_text(path.read_text().replace("dynamic: {duration: 1 ms}", solver))
    monkeypatch.setattr("magmpm.scene.memory.machine", lambda: 5e4)
    received = (
        f"{path}:6: resolution.cells_across: received 2; particles and grid take at least 0.205 MB"
        " for 256 particles"
    )
    says = received, "this machine has", "\n  rule: ", "\n  remedy: use fewer cells_across"
    told("run", path, "--out", tmp_path / "out", status=2, says=says)


def test_an_allocation_that_fails_is_refused_as_well(tmp_path: Path) -> None:
    refused = pytest.raises(
        SceneError, match=r"take at least 0\.205 MB for 256 particles, which could not be allocated"
    )
    with refused, within(load_scene(scene(tmp_path, "duration: 1 ms"))):
        np.empty(2**55)  # numpy's own MemoryError


@pytest.mark.parametrize(
    "over", ["oscillation: {frequency: 26 kHz}", "rotation: {axis: [0, 1, 0], frequency: -26 kHz}"]
)
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
    path.write_text(
        slow.replace("duration: 1 ms", "duration: 1 ms, time_step: 3 us"), encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"time_step: received 3e-06 s.*\n?.*schedule 1.923e-06 s"):
        begin(build(load_scene(path)))
