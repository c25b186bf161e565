"""A motion is read while a process writes it, or after that process was killed: frames are whole, and no reader harms the file."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from reference import motions
from reference.folders import holding

from magmpm.errors import InputError
from magmpm.results import trajectory as motion
from magmpm.results import vtkhdf
from magmpm.results.trajectory import Motion, MotionWriter

ROOT = Path(__file__).parents[3]
TIMES = np.linspace(0.0, 0.4, 9)  # of motions.written

WATCH_THE_MARK = """
import sys
seen = set()
with open(sys.argv[1], "rb", buffering=0) as file:
    print("watching", flush=True)
    while True:
        file.seek(11)
        seen.add(file.read(1)[0])
        try:
            open(sys.argv[2]).close()
            break
        except FileNotFoundError:
            pass
print(*sorted(seen))
"""


def test_a_file_is_at_no_moment_marked_as_written_in_no_order(tmp_path: Path) -> None:
    """Byte 11 of HDF5's superblock says how a file is open: 0 not, 5 for frames that can be read at any moment, 1 otherwise.

    A run that is killed while the byte is 1 leaves a file that cannot be opened. The test checks it a hundred times per frame.
    """
    model = motions.body(0.5e-3)
    writer = MotionWriter(tmp_path, model)
    command = [
        sys.executable,
        "-c",
        WATCH_THE_MARK,
        str(tmp_path / motion.MOTION),
        str(tmp_path / "over"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as watch:
        assert watch.stdout.readline() == "watching\n"
        try:
            motions.write(writer, motions.bending(model, np.arange(1, 120) * 1e-3))
            left = MotionWriter(tmp_path, model, resume_at=0.1).frames
        finally:
            (tmp_path / "over").touch()
        assert watch.stdout.read().split() == ["0", "5"]
    assert left == 100


def test_a_motion_marked_as_being_written_in_no_order_is_said_to_be(tmp_path: Path) -> None:
    motions.written(tmp_path)
    left = tmp_path / "left.vtkhdf"
    with h5py.File(tmp_path / motion.MOTION, "r+", locking=False):
        shutil.copy(tmp_path / motion.MOTION, left)  # as after a kill at this moment
    with pytest.raises(InputError, match="can't be opened as HDF5"):
        vtkhdf.mend(left)
    assert sorted(path.name for path in tmp_path.glob("*left*")) == ["left.vtkhdf"]


WRITE_FOR_EVER = """
import sys, numpy as np
from dataclasses import replace
sys.path[:0] = [{root!r}, {tests!r}]
from reference import motions
from magmpm.results.trajectory import MotionWriter
model = motions.body(0.5e-3)
writer = MotionWriter({folder!r}, model)
moment = next(motions.bending(model, [0.1]))
for k in range(100000):
    writer.frame(replace(moment, time=0.001 * k))
"""


@pytest.mark.parametrize(
    "delay",
    [0.0, 0.0291, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.0137, 0.0403))],
)
def test_a_killed_run_leaves_whole_frames(delay: float, tmp_path: Path) -> None:
    """Killed at any moment while it only writes: all counted frames are whole, and it can be resumed."""
    code = WRITE_FOR_EVER.format(root=str(ROOT), tests=str(ROOT / "tests"), folder=str(tmp_path))
    process = subprocess.Popen([sys.executable, "-c", code])
    give_up = time.monotonic() + 60
    while (
        not (tmp_path / motion.ENERGIES).exists()
        or (tmp_path / motion.ENERGIES).stat().st_size < 300
    ):
        assert process.poll() is None
        assert time.monotonic() < give_up
        time.sleep(0.005)
    time.sleep(delay)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    read = Motion.load(tmp_path)
    model = motions.body(0.5e-3)
    moment = next(motions.bending(model, np.array([0.1])))
    assert len(read) > 2
    for k in (0, len(read) - 1):
        np.testing.assert_array_equal(read[k].position, moment.x.astype(np.float32))
        assert all(np.isfinite(array).all() for array in read[k].quantities.values())
    # The row of a frame is written after the frame: at most the last row is missing.
    assert len(read) - len(read.energies["t"]) in (0, 1)
    with h5py.File(tmp_path / motion.MOTION, "r"):
        pass  # opens without special flags, as ParaView does
    assert MotionWriter(tmp_path, model, resume_at=read.times[1]).frames == 2


def test_a_folder_that_is_held_is_not_mended(tmp_path: Path) -> None:
    """A run suspended in the middle of a frame: its file stays as it is, and the message names the run."""
    motions.written(tmp_path)
    path = tmp_path / motion.MOTION
    path.write_bytes(motions.as_left_by_a_kill(path.read_bytes()))
    before = path.read_bytes()
    with holding(tmp_path) as pid:
        with pytest.raises(InputError, match=f"in use by process {pid}"):
            Motion.load(tmp_path)
        assert path.read_bytes() == before
    assert len(Motion.load(tmp_path)) == len(TIMES)


def test_reading_never_harms_a_motion_that_is_written(tmp_path: Path) -> None:
    """A motion loaded over and over while a process writes it: every load succeeds, and at the end each frame is whole."""
    code = WRITE_FOR_EVER.format(
        root=str(ROOT), tests=str(ROOT / "tests"), folder=str(tmp_path)
    ).replace("100000", "200")
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        give_up = time.monotonic() + 60
        while not (tmp_path / motion.ENERGIES).exists() and time.monotonic() < give_up:
            time.sleep(0.005)
        counts = [0]
        while process.poll() is None:
            counts.append(len(Motion.load(tmp_path)))
    assert counts == sorted(counts)
    assert len(Motion.load(tmp_path)) == 200
