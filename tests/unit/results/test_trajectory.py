"""A motion on disk: it is read back by magmpm and by VTK; kills, resuming and budgets leave whole frames."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from reference import motions

from magmpm.errors import BudgetError, InputError, SolveError
from magmpm.results import trajectory as motion
from magmpm.results.frame_arrays import QUANTITIES, von_mises
from magmpm.results.trajectory import Motion, MotionWriter

ROOT = Path(__file__).parents[3]
TIMES = np.linspace(0.0, 0.4, 9)
SINGLE = 1.2e-7  # relative rounding of single precision, 2^-23


def contents(folder: Path) -> dict[str, Any]:
    """The whole content of the files of a motion."""
    found: dict[str, Any] = {}
    with h5py.File(folder / motion.MOTION, "r") as file:
        file.visititems(
            lambda name, item: (
                found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
            )
        )
        count = file["VTKHDF/Steps"].attrs["NSteps"]
        n = file["VTKHDF/NumberOfPoints"][0]
        for name, array in found.items():  # growing arrays are longer than the counted frames
            if array.ndim and file[name].maxshape[0] is None:
                found[name] = array[
                    : count * n if "Points" in name or "PointData/" in name else count
                ]
        found["NSteps"] = count
    for name in (motion.ENERGIES, motion.CONTACTS):
        found[name] = (folder / name).read_bytes()
    return found


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(
        np.array_equal(one[name], other[name]) for name in one
    )


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    model = motions.body()
    motions.write(MotionWriter(tmp_path, model), motions.bending(model, TIMES))
    read = Motion.load(tmp_path)
    np.testing.assert_array_equal(read.times, TIMES)
    np.testing.assert_array_equal(read.part, model.particles.segment)
    for k, moment in enumerate(motions.bending(model, TIMES)):
        frame = read[k]
        J = np.linalg.det(moment.F)
        cauchy = moment.P @ moment.F.transpose(0, 2, 1) / J[:, None, None]
        wanted = {
            "displacement": moment.x - model.particles.position,
            "velocity": moment.v,
            "cauchy_stress": cauchy.reshape(-1, 9),
            "von_mises": motions.von_mises(cauchy),
            "magnetisation": np.einsum("nij,nj->ni", moment.F, model.remanence),
            "det_F": J,
        }
        assert frame.quantities.keys() == wanted.keys()
        np.testing.assert_allclose(frame.position, moment.x, rtol=SINGLE, atol=1e-12)
        for name, array in wanted.items():
            # Rounded once to single precision; absolute where an entry is a difference of large numbers.
            np.testing.assert_allclose(
                frame.quantities[name],
                array,
                rtol=SINGLE,
                atol=1e-13 * (1 + np.abs(array).max()),
                err_msg=name,
            )
        np.testing.assert_array_equal(frame.field, moment.field)
        assert read.energies["kinetic"][k] == moment.energies["kinetic"]
        assert read.energies["total"][k] == sum(moment.energies.values())
        assert read.contacts["ground"]["Fz"][k] == moment.contacts["ground"]["force"][2]
    assert read[-1].number == len(read) - 1
    with pytest.raises(IndexError):
        read[len(read)]
    for wrong in (lambda: read[99], lambda: read.position(99)):
        with pytest.raises(
            IndexError, match=f"frame: received 99; motion has frames 0 to {len(TIMES) - 1}$"
        ):
            wrong()
    assert [frame.number for frame in read[0:2]] == [0, 1]
    assert [frame.number for frame in read[-1::-4]] == [8, 4, 0]
    assert repr(read[2]).startswith(f"Frame(2 at 100 ms: {len(read.reference)} particles; ")
    assert "\n" not in repr(read[2])


def test_von_mises_of_known_stresses() -> None:
    """Tension: its stress; pure shear: sqrt(3) times its stress; pressure and torque (a skew stress): zero."""
    pull = np.zeros((3, 3))
    shear = np.zeros((3, 3))
    pressure = np.eye(3)
    torque = np.zeros((3, 3))
    pull[0, 0] = 7.0
    shear[0, 1] = shear[1, 0] = 2.0
    torque[0, 1], torque[1, 0] = 5.0, -5.0
    stresses = [pull, shear, pressure, torque]
    known = [7, 2 * np.sqrt(3), 0, 0]
    np.testing.assert_allclose([von_mises(stress) for stress in stresses], known, atol=1e-14)
    np.testing.assert_allclose(motions.von_mises(np.stack(stresses)), known, atol=1e-14)


def test_vtk_reads_every_step_as_paraview_does(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    motions.written(tmp_path)
    ours = Motion.load(tmp_path)
    reader = pyvista.get_reader(tmp_path / motion.MOTION).reader
    reader.UpdateInformation()
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

    steps = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    np.testing.assert_array_equal(steps, ours.times)
    for k in (0, 5, len(ours) - 1):
        reader.UpdateTimeStep(ours.times[k])
        read = pyvista.wrap(reader.GetOutput())
        frame = ours[k]
        assert read.n_cells == read.n_points == len(ours.part)
        np.testing.assert_array_equal(read.points, frame.position)
        for name, array in {**frame.quantities, "part": ours.part, "volume": ours.volume}.items():
            np.testing.assert_array_equal(read.point_data[name], array, err_msg=name)
        np.testing.assert_array_equal(np.ravel(read.field_data["field"]), frame.field)


def test_resumed_files_equal_unbroken_ones(tmp_path: Path) -> None:
    """Frames after the checkpoint are dropped, also half a row of a table; the continuation is the same bit for bit."""
    model = motions.body()
    motions.written(tmp_path / "unbroken")
    motions.write(MotionWriter(tmp_path / "resumed", model), motions.bending(model, TIMES[:7]))
    with (tmp_path / "resumed" / motion.ENERGIES).open("a") as stream:
        stream.write("0.3499")
    writer = MotionWriter(tmp_path / "resumed", model, resume_at=TIMES[4] + 0.01)
    assert writer.frames == 5
    assert len(Motion.load(tmp_path / "resumed")) == 5
    assert len(Motion.load(tmp_path / "resumed").energies["t"]) == 5
    motions.write(writer, motions.bending(model, TIMES[5:]))
    assert same(contents(tmp_path / "resumed"), contents(tmp_path / "unbroken"))


def test_resuming_before_the_first_frame_or_with_another_body(tmp_path: Path) -> None:
    model = motions.body()
    motions.written(tmp_path / "unbroken")
    motions.written(tmp_path / "again")
    writer = MotionWriter(tmp_path / "again", model, resume_at=-1.0)
    assert writer.frames == len(Motion.load(tmp_path / "again")) == 0
    motions.write(writer, motions.bending(model, TIMES))
    assert same(contents(tmp_path / "again"), contents(tmp_path / "unbroken"))
    MotionWriter(tmp_path / "again", model, resume_at=TIMES[2])
    with h5py.File(
        tmp_path / "again" / motion.MOTION, "r"
    ) as file:  # VTK's reader writes beyond its buffer if there are more
        assert len(file["VTKHDF/Steps/Values"]) == file["VTKHDF/Steps"].attrs["NSteps"] == 3
    with pytest.raises(InputError, match="holds another motion"):
        MotionWriter(tmp_path / "again", motions.body(0.5e-3), resume_at=0.1)


def test_a_new_motion_takes_the_place_of_an_old_one(tmp_path: Path) -> None:
    motions.written(tmp_path, frames=9)
    motions.written(tmp_path, frames=3)
    read = Motion.load(tmp_path)
    assert len(read) == len(read.energies["t"]) == len(read.contacts["ground"]["t"]) == 3


def test_the_budget_is_kept_and_what_was_written_stays(tmp_path: Path) -> None:
    """Never a byte above max_disk; stops before a frame that would exceed it, and names the key to change."""
    model = motions.body(0.25e-3)
    free = MotionWriter(tmp_path / "free", model)
    motions.write(free, motions.bending(model, TIMES))
    budget = 0.6 * free.size
    writer = MotionWriter(tmp_path / "kept", model, max_disk=budget)
    with pytest.raises(BudgetError) as caught:
        motions.write(writer, motions.bending(model, TIMES))
    for phrase in (
        "solver.dynamic.max_disk",
        "MB",
        f"after {writer.frames} frames",
        "output_every",
        "raise max_disk",
    ):
        assert phrase in str(caught.value)
    assert isinstance(caught.value, SolveError)
    assert caught.value.exit_status == 3
    assert writer.size <= budget < writer.size + writer.frame_size
    assert len(Motion.load(tmp_path / "kept")) == writer.frames > 2
    # later frames reuse the space of dropped frames: a resumed run keeps the budget of its start
    resumed = MotionWriter(tmp_path / "kept", model, max_disk=free.size + 1e5, resume_at=TIMES[0])
    motions.write(resumed, motions.bending(model, TIMES[1:]))
    assert abs(resumed.size - free.size) < 1e5
    # and the estimate is never below the actual size of a frame
    assert free.size - writer.size <= (free.frames - writer.frames) * writer.frame_size


def test_a_full_disk_is_found_before_the_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = motions.body()
    writer = MotionWriter(tmp_path, model)
    motions.write(writer, motions.bending(model, TIMES[:2]))
    usage = motion.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(motion.shutil, "disk_usage", lambda _: usage._replace(free=16_000_100))
    with pytest.raises(BudgetError, match="the disk is full"):
        motions.write(writer, motions.bending(model, TIMES[2:]))
    assert len(Motion.load(tmp_path)) == 2


def test_frames_go_forward_in_time(tmp_path: Path) -> None:
    model = motions.body()
    writer = MotionWriter(tmp_path, model)
    motions.write(writer, motions.bending(model, TIMES[:2]))
    with pytest.raises(ValueError, match="the last one is at"):
        motions.write(writer, motions.bending(model, TIMES[1:2]))


def test_folders_without_a_motion_are_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no motion"):
        Motion.load(tmp_path)
    motions.written(tmp_path)
    (tmp_path / motion.MOTION).write_bytes(b"not HDF5")
    with pytest.raises(InputError, match="can't be opened as HDF5"):
        Motion.load(tmp_path)


@pytest.mark.parametrize("share", [0.99, 0.6, 0.1, 0.0])
def test_a_file_cut_off_behind_is_refused_and_not_resumed(share: float, tmp_path: Path) -> None:
    """Like after `truncate -s` or an incomplete copy: closed and marked files are refused at once, without a frame of zeros."""
    model = motions.body()
    motions.written(tmp_path)
    path = tmp_path / motion.MOTION
    whole = path.read_bytes()
    for marked in (False, True):
        path.write_bytes(motions.as_left_by_a_kill(whole) if marked else whole)
        with path.open("r+b") as file:
            file.truncate(int(share * len(whole)))
        begun = time.monotonic()
        with pytest.raises(InputError, match=motion.MOTION):
            Motion.load(tmp_path)
        with pytest.raises(InputError, match=motion.MOTION):
            MotionWriter(tmp_path, model, resume_at=TIMES[-1])
        assert time.monotonic() - begun < 30  # it must end: it waits 4 s for a possible writer


def test_a_killed_runs_mark_is_taken_away(tmp_path: Path) -> None:
    """The file opens normally, with all its frames."""
    motions.written(tmp_path)
    path = tmp_path / motion.MOTION
    before = contents(tmp_path)
    path.write_bytes(motions.as_left_by_a_kill(path.read_bytes()))
    with pytest.raises(OSError, match="open for write"):
        h5py.File(path, "r")
    Motion.load(tmp_path)
    assert same(contents(tmp_path), before)


def test_every_array_of_a_frame_tells_whether_it_is_whole(tmp_path: Path) -> None:
    """One changed number is detected, when the folder is loaded and when the frame is read; earlier frames can be resumed."""
    motions.written(tmp_path)
    path = tmp_path / motion.MOTION
    model = motions.body()
    loaded = Motion.load(tmp_path)
    whole = path.read_bytes()
    n = len(model.particles.volume)
    for name in (
        "Points",
        *(f"PointData/{name}" for name in QUANTITIES),
        "Steps/Values",
        "FieldData/field",
    ):
        path.write_bytes(whole)
        with h5py.File(path, "r+", locking=False) as file:
            row = 4 * n + 7 if name.startswith("Point") else 4
            array = file["VTKHDF"][name]
            array[row] = np.nextafter(array[row], 2 * np.abs(array[row]) + 1, dtype=array.dtype)
        with pytest.raises(InputError, match="frame 4 of 9 with"):
            Motion.load(tmp_path)
        if name.startswith("Point"):
            with pytest.raises(InputError, match="frame 4 of 9 with"):
                loaded[4]
        with pytest.raises(InputError, match="frame 4 of 9 with"):
            MotionWriter(tmp_path, model, resume_at=TIMES[6])
        assert MotionWriter(tmp_path, model, resume_at=TIMES[3]).frames == 4


def test_particles_that_are_not_as_they_were_written(tmp_path: Path) -> None:
    motions.written(tmp_path)
    with h5py.File(tmp_path / motion.MOTION, "r+", locking=False) as file:
        file["VTKHDF/PointData/volume"][3] = 0.0
    with pytest.raises(InputError, match="particles"):
        Motion.load(tmp_path)


WRITE_WITHIN_A_LIMIT = """
import resource, sys, numpy as np
sys.path[:0] = [{root!r}, {tests!r}]
from reference import motions
from magmpm.errors import BudgetError
from magmpm.results.trajectory import MotionWriter
model = motions.body(0.5e-3)
writer = MotionWriter({folder!r}, model)
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
try:
    motions.write(writer, motions.bending(model, np.arange(1, 100) * 1e-3))
except BudgetError as error:
    print(error, writer.frames)
"""


def test_a_write_the_system_refuses_ends_as_a_full_disk_does(tmp_path: Path) -> None:
    """A limit on the file size represents quotas and full disks: no traceback, and the written frames are whole."""
    code = WRITE_WITHIN_A_LIMIT.format(
        root=str(ROOT), tests=str(ROOT / "tests"), folder=str(tmp_path)
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "File too large after" in ended.stdout
    assert len(Motion.load(tmp_path)) == int(ended.stdout.split()[-1]) > 2
    assert (tmp_path / motion.MOTION).stat().st_size <= 3_000_000
