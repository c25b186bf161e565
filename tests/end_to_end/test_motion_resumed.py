"""`magmpm run` of motions that are killed, resumed or lengthened, and of damaged checkpoints."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from swing import environment, scene

from magmpm.cli import main
from magmpm.cli.render import motion_of
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.results.file_names import ABOUT, CHECKPOINT, ENERGIES, MOTION, NUMBERS
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import load_scene


def test_killed_and_resumed_is_the_same_motion(tmp_path: Path) -> None:
    """SIGKILL at some frame, then --resume: result and checkpoint equal those of an uninterrupted run bit for bit, and no frame is missing.
    """
    path = scene(tmp_path, "duration: 40 ms, output_every: 1 ms")
    command = [sys.executable, "-m", "magmpm.cli", "run", str(path), "--json", "--out"]
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main(["run", str(path), "--json", "--out", str(whole)]) == 0

    process = subprocess.Popen([*command, str(broken)], env=environment(), stdout=subprocess.DEVNULL)
    patience = time.monotonic() + 120
    while not (broken / CHECKPOINT).exists() and process.poll() is None and time.monotonic() < patience:
        time.sleep(0.005)
    time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the run was over before it could be killed"
    with np.load(broken / CHECKPOINT) as saved:
        frame = json.loads(str(saved["about"]))["frame"]
    assert 1 <= frame < 40

    assert main(["run", str(path), "--json", "--out", str(broken), "--resume"]) == 0
    one, two = Result.load(whole), Result.load(broken)
    assert one.iterations == two.iterations
    assert one.particle_position.tobytes() == two.particle_position.tobytes()
    assert one.particle_det_F.tobytes() == two.particle_det_F.tobytes()
    with np.load(whole / CHECKPOINT) as a, np.load(broken / CHECKPOINT) as b:
        assert all(a[name].tobytes() == b[name].tobytes() for name in a.files)
    first, second = Motion.load(whole), Motion.load(broken)
    assert len(first) == len(second) == 41
    for k in (0, frame, 40):
        assert first[k].position.tobytes() == second[k].position.tobytes()


class Interrupted(Exception):
    """Represents an interruption between two frames."""


def test_a_motion_resumed_at_its_first_frames_goes_on(tmp_path: Path) -> None:
    """At the start of an oscillation, half a step changes the kinetic energy by a fifth: this is not energy from nothing."""
    loaded = load_scene(scene(tmp_path, "duration: 2 ms, output_every: 0.2 ms"))

    def interrupt(at: float, steps: int) -> None:
        if at > 0.3e-3:
            raise Interrupted

    with pytest.raises(Interrupted):
        integrate(begin(build(loaded)), folder=tmp_path, on_progress=interrupt)
    again = integrate(begin(build(loaded)), folder=tmp_path, resume=True)
    assert again.x.tobytes() == integrate(begin(build(loaded))).x.tobytes()


def test_a_checkpoint_that_the_disk_does_not_take_is_warned_of(tmp_path: Path) -> None:
    """The motion itself is complete."""
    begun = begin(build(load_scene(scene(tmp_path, "duration: 1 ms, output_every: 0.5 ms"))))
    moved = integrate(begun, folder=tmp_path, on_state=lambda _: (tmp_path / CHECKPOINT).mkdir(exist_ok=True))
    assert len(moved.warnings) == 1
    assert moved.warnings[0].startswith(f"{tmp_path / CHECKPOINT}: Is a directory: --resume can only go on")
    assert len(Motion.load(tmp_path)) == 3


def test_resuming_another_scene_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path, "duration: 1 ms, output_every: 1 ms")), "--out", str(out)]) == 0
    path = scene(tmp_path, "duration: 1 ms, output_every: 1 ms")
    path.write_text(path.read_text(encoding="utf-8").replace("20 mT", "19 mT"), encoding="utf-8")
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 2
    said = capsys.readouterr().err
    assert f"{out / CHECKPOINT}: received the checkpoint of another scene" in said
    assert "\n  rule: " in said
    assert "\n  remedy: " in said


@pytest.mark.parametrize(("short", "long"), [("2 ms, output_every: 1 ms", "4 ms, output_every: 1 ms"), ("0.5 ms", "0.6 ms")])
def test_a_motion_is_lengthened(short: str, long: str, tmp_path: Path) -> None:
    """It continues from its end, with the same frame interval, and equals a motion of that length."""
    out, whole = tmp_path / "out", tmp_path / "whole"
    frames = long if "every" in long else f"{long}, output_every: 5 us"  # a hundredth of the short one
    assert main(["run", str(scene(tmp_path, f"duration: {short}")), "--out", str(out), "--json"]) == 0
    assert main(["run", str(scene(tmp_path, f"duration: {long}")), "--out", str(out), "--json", "--resume"]) == 0
    assert main(["run", str(scene(tmp_path, f"duration: {frames}")), "--out", str(whole), "--json"]) == 0
    one, two = Motion.load(out), Motion.load(whole)
    np.testing.assert_array_equal(one.times, two.times)
    np.testing.assert_array_equal(one.energies["total"], two.energies["total"])
    for k in range(len(one)):
        np.testing.assert_array_equal(one[k].quantities["cauchy_stress"], two[k].quantities["cauchy_stress"])
    assert Result.load(out).particle_position.tobytes() == Result.load(whole).particle_position.tobytes()
    assert one.scene["solver"]["dynamic"]["duration"] == Result.load(out).scene["solver"]["dynamic"]["duration"] > 5e-4


@pytest.mark.parametrize(
    ("short", "long", "rule"),
    [
        ("2 ms, output_every: 1 ms", "1 ms, output_every: 1 ms", "must be no shorter than what the motion has done, 0.002 s"),
        ("2.5 ms, output_every: 1 ms", "4 ms, output_every: 1 ms", "it ended between two"),
        ("2 ms, output_every: 1 ms", "4 ms, output_every: 2 ms", "its duration alone may be longer, and its budgets"),
    ],
)
def test_what_can_t_be_lengthened_is_refused(short: str, long: str, rule: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path, f"duration: {short}")), "--out", str(out)]) == 0
    before = Result.load(out)
    assert main(["run", str(scene(tmp_path, f"duration: {long}")), "--out", str(out), "--resume"]) == 2
    assert rule in capsys.readouterr().err
    assert Result.load(out).time == before.time


def test_a_motion_goes_on_with_a_larger_budget(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, length = tmp_path / "out", "duration: 4 ms, output_every: 0.1 ms"
    assert main(["run", str(scene(tmp_path, f"{length}, max_disk: 600 kB")), "--out", str(out)]) == 3
    assert "raise max_disk" in capsys.readouterr().err
    kept, frames = Result.load(out), Motion.load(out)
    assert 2 < len(frames) < 41, "whole frames before the limit"
    assert kept.time == pytest.approx(frames.times[-1], abs=1e-12)
    assert sum(file.stat().st_size for file in out.glob("motion.*")) < 600e3
    assert main(["run", str(scene(tmp_path, length)), "--out", str(out), "--resume"]) == 0
    assert len(Motion.load(out)) == 41


def _frames_of_before(out: Path, earlier: Path) -> None:
    shutil.copy(earlier / MOTION, out / MOTION)


def _rows_cut(out: Path, earlier: Path) -> None:
    (out / ENERGIES).write_bytes((out / ENERGIES).read_bytes()[:150])


def _no_rows(out: Path, earlier: Path) -> None:
    (out / ENERGIES).unlink()


def _garbage(out: Path, earlier: Path) -> None:
    (out / ENERGIES).write_text("null\nnull\n")


@pytest.mark.parametrize(
    ("damage", "name"), [(_frames_of_before, MOTION), (_rows_cut, ENERGIES), (_no_rows, ENERGIES), (_garbage, ENERGIES)]
)
def test_a_motion_with_holes_is_not_resumed(
    damage: Callable[[Path, Path], None], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames or rows before the checkpoint are missing, so the continuation would not fit. Tables with missing rows are not drawn either.
    """
    out, earlier = tmp_path / "out", tmp_path / "earlier"
    assert main(["run", str(scene(tmp_path, "duration: 2 ms, output_every: 1 ms")), "--out", str(out)]) == 0
    shutil.copytree(out, earlier)
    assert main(["run", str(scene(tmp_path, "duration: 4 ms, output_every: 1 ms")), "--out", str(out), "--resume"]) == 0
    damage(out, earlier)
    left = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    capsys.readouterr()
    assert main(["run", str(scene(tmp_path, "duration: 5 ms, output_every: 1 ms")), "--out", str(out), "--resume"]) == 2
    assert f"{out / name}: received " in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == left
    if name == ENERGIES:
        with pytest.raises(InputError, match=ENERGIES):
            Motion.load(out)


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def _of_another_version(path: Path) -> None:
    with np.load(path) as stored:
        arrays = dict(stored)
    about = json.loads(str(arrays.pop("about")))
    np.savez(path, about=np.array(json.dumps({**about, "unknown": 1})), **arrays)


def _no_archive(path: Path) -> None:
    np.save(path.with_suffix(".npy"), np.zeros(3))
    path.with_suffix(".npy").replace(path)


def _a_byte_changed(path: Path) -> None:
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    path.write_bytes(whole)


def _without_state(path: Path) -> None:
    with np.load(path) as stored:
        about = stored["about"]
    np.savez(path, about=about)


@pytest.mark.parametrize("damage", [cut_short, emptied, _of_another_version, _no_archive, _a_byte_changed, _without_state])
def test_a_damaged_checkpoint_is_refused(damage: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With file and remedy; never a traceback."""
    path, out = scene(tmp_path, "duration: 0.4 ms, output_every: 0.4 ms"), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0
    damage(out / CHECKPOINT)
    capsys.readouterr()
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 2
    said = capsys.readouterr().err
    assert str(out / CHECKPOINT) in said
    assert "remedy: remove it" in said


def test_a_motion_begun_afresh_leaves_no_older_checkpoint(tmp_path: Path) -> None:
    """If it is killed before its first frame, it must not be resumed from the last checkpoint of another run."""
    path, out = scene(tmp_path, "duration: 0.8 ms, output_every: 0.4 ms"), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0

    def interrupt(at: float, steps: int) -> None:
        raise Interrupted

    with pytest.raises(Interrupted):
        integrate(begin(build(load_scene(path))), folder=out, on_progress=interrupt)
    assert not (out / CHECKPOINT).exists()


def test_resuming_from_nothing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The motion starts from the beginning; a second --resume, from its checkpoint, gives no message."""
    path, out = scene(tmp_path, "duration: 0.4 ms, output_every: 0.4 ms"), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 0
    assert f"{out} holds no checkpoint.npz; the motion begins at the start" in capsys.readouterr().err
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 0
    assert "--resume" not in capsys.readouterr().err
    path.write_text(path.read_text(encoding="utf-8").replace("dynamic: {duration: 0.4 ms, output_every: 0.4 ms}", "static: {}"))
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 0
    assert "a static scene has no checkpoints" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["null", "{", "", '{"name": null, "scene": 3}'])
def test_damaged_files_beside_a_motion(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """motion.json is refused by name, and written again by --resume; a damaged result does not affect the motion."""
    path, out = scene(tmp_path, "duration: 0.8 ms, output_every: 0.4 ms"), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0
    (out / NUMBERS).write_text(content)
    motion = motion_of(out)
    assert motion is not None
    assert len(motion) == 3
    (out / ABOUT).write_text(content)
    capsys.readouterr()
    assert main(["render", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"{out / ABOUT}: can't be read (" in said
    assert "\n  remedy: " in said
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 0
    assert len(Motion.load(out)) == 3
    (out / ENERGIES).write_text("t,kinetic\nnever,0\n")
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 2
    assert f"{out / ENERGIES}: received what can't be read as one (" in capsys.readouterr().err
