"""Files that a run replaces, keeps and reports: a folder belongs to one scene and contains one result of it."""

import json
import os
import signal
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import swing
from reference.commands import started, wait_for
from test_commands import SCENE, STUDY
from test_import import robot_file
from test_motion_resumed import WILD

from magmpm.errors import SolveError
from magmpm.results.file_names import CHECKPOINT, EARLIER, FAILED, MOMENTS, MOTION, NUMBERS, PICTURE
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene.time_limit import limited
from magmpm.studies.problem import OWNER, REPORT
from magmpm.viz.from_result import Still, trial_snapshot

MOVING = swing.text("duration: 0.4 ms, output_every: 0.2 ms")
RESTING = swing.text(solver="{static: {field_steps: 4}}")
# Its ramp ends at 29 % of the load: three of Newton's steps are too few.
FAILING = RESTING.replace("[0 mT, 2 mT, 20 mT]", "[-150 mT, 2 mT, 6 mT]").replace(
    "field_steps: 4", "field_steps: 4, max_steps: 3"
)
OUT = Path("runs/swing")


@pytest.fixture(autouse=True)
def _inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look at the clock of --time-limit counts as a second."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "magmpm.cli.run.limited", lambda seconds: limited(seconds, clock=count().__next__)
    )
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")


@pytest.fixture
def run(told) -> Callable[..., Any]:
    """run(text, *options, file="scene.yaml", **expected): `magmpm run` of this scene."""

    def command(text: str, *options: str, file: str = "scene.yaml", **expected: Any) -> Any:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_text(text, encoding="utf-8")
        return told("run", file, *options, **expected)

    return command


def files(folder: Path) -> dict[str, bytes]:
    """All files of a folder except hidden ones, by name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


# pictures


def test_a_run_without_pictures_leaves_no_older_ones(run) -> None:
    """It says that it replaced them; with --render there are new ones."""
    run(RESTING, "--render")
    drawn = (OUT / PICTURE).stat().st_mtime_ns
    said = run(RESTING.replace("20 mT", "5 mT")).out
    assert not (OUT / PICTURE).exists()
    assert "replaced        the equilibrium of 20" in said
    assert ", with its pictures" in said
    assert json.loads(run(RESTING, "--render", "--json").out)["replaced"].startswith(
        "the equilibrium of 20"
    )
    assert (OUT / PICTURE).stat().st_mtime_ns > drawn


def test_an_equilibrium_after_a_motion_leaves_no_movie_of_it(run) -> None:
    run(MOVING)
    for name in (PICTURE, MOMENTS, "energies.png", "movie.mp4", "movie.gif", "contacts.csv"):
        (OUT / name).write_text("an older picture")
    (OUT / "frames").mkdir()
    (OUT / "frames/frame_0000.png").write_text("an older picture")
    (OUT / "notes.txt").write_text("mine")
    assert "replaced        the motion over 0.0004 s of 20" in run(RESTING).out
    assert sorted(files(OUT)) == ["notes.txt", "result.json", "scene-file.json", "state.npz"]
    run(MOVING)
    assert sorted(files(OUT)) == sorted(
        [
            "checkpoint.npz",
            "energies.csv",
            "motion.json",
            "motion.vtkhdf",
            "notes.txt",
            "result.json",
            "scene-file.json",
            "state.npz",
        ]
    )


def test_what_the_accuracy_was_goes_when_the_scene_has_changed(run, told) -> None:
    Path("scene.yaml").write_text(SCENE)
    told("accuracy", "scene.yaml", "--cells", "2,3")
    run(SCENE)
    assert Path("runs/small/accuracy.png").exists(), "of this definition"
    run(SCENE.replace("5 mT", "4 mT"))
    assert not Path("runs/small/accuracy.png").exists()


# ownership of a folder


def test_another_scene_of_the_same_name_is_refused(run, told) -> None:
    """Unless --overwrite is given; the same file edited, or the same definition elsewhere, is the same scene."""
    run(RESTING, file="one/a.yaml")
    run(RESTING.replace("20 mT", "5 mT"), file="one/a.yaml")  # edited
    run(RESTING.replace("20 mT", "5 mT"), file="two/b.yaml")  # copied
    before = files(OUT)
    says = (
        f"{OUT}: holds the results of another scene, swing (",
        "two/b.yaml)",
        "\n  rule: ",
        "--out runs/c;",
        "--overwrite",
    )
    for text in (RESTING, MOVING):
        run(text, file="one/c.yaml", status=2, says=says)
    Path("one/d.yaml").write_text(RESTING)
    told("accuracy", "one/d.yaml", "--cells", "2,3", status=2)
    assert files(OUT) == before
    assert "(of swing (" in run(MOVING, "--overwrite", file="one/c.yaml").out
    assert Result.load(OUT).formulation == "total"


def test_a_result_saved_by_python_code_is_somebody_s_as_well(run) -> None:
    run(RESTING)
    (OUT / "scene-file.json").unlink()
    run(RESTING)  # the same definition
    (OUT / "scene-file.json").unlink()
    run(RESTING.replace("20 mT", "5 mT"), status=2, says="another scene, swing")


def test_two_robots_of_one_name_do_not_replace_one_another(tmp_path: Path, told) -> None:
    """Both are imported as "Tiny"."""
    for folder, strength in (("A", 0.1), ("F", 0.138)):
        told(
            "import",
            str(robot_file(tmp_path / folder, remenance=strength)),
            "-o",
            f"robot{folder}.yaml",
        )
    told("run", "robotA.yaml")
    says = "runs/Tiny: holds the results of another scene, Tiny (", "--out runs/robotF;"
    told("run", "robotF.yaml", status=2, says=says)


def test_studies_and_runs_do_not_share_a_folder(run, told) -> None:
    Path("target.csv").write_text("s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n10,10,0,0\n20,20,0,0\n")
    Path("study.yaml").write_text(STUDY.replace("trials: 3", "trials: 1"))
    Path("runs/small").mkdir(parents=True)
    for kept in (REPORT, OWNER):  # before it computes: its mark would make it the folder of a run
        mark = Path("runs/small") / kept
        mark.write_text("{}")
        Path("scene.yaml").write_text(SCENE)
        for out in ([], ["--out", "runs/small"]):
            told(
                "accuracy",
                "scene.yaml",
                "--cells",
                "2,3",
                *out,
                status=2,
                says="runs/small: holds a study",
            )
        assert list(files(Path("runs/small"))) == [kept]
        mark.unlink()
    run(SCENE)
    told(
        "design",
        "study.yaml",
        "--no-pictures",
        "--out",
        "runs/small",
        status=2,
        says="runs/small: holds the results of a run",
    )
    told("design", "study.yaml", "--no-pictures")
    for overwrite in ([], ["--overwrite"]):
        told(
            "run",
            "scene.yaml",
            "--out",
            "runs/study",
            *overwrite,
            status=2,
            says="runs/study: holds a study",
        )


# runs that fail


def test_a_failed_equilibrium_is_marked(run) -> None:
    """In the result and in its picture: the share of the load, and that it is no equilibrium; the field is the one at that load."""
    remedy = "; to try: solver.static: {field_steps: 40, max_steps: 150}"
    says = (
        "of the load: no equilibrium within 3 Newton steps",
        remedy,
        f"; the last good state is in {OUT}",
    )
    summary = json.loads(run(FAILING, "--render", "--json", status=3, says=says).out)
    assert Path(summary["folder"]) == OUT
    share = summary["load_share"]
    assert not summary["converged"]
    assert 0.2 < share < 0.5
    assert "no equilibrium within" in summary["failure"]
    assert (OUT / PICTURE).stat().st_size > 5_000
    assert json.loads((OUT / NUMBERS).read_text())["load_share"] == share
    found = Result.load(OUT)
    assert not found.converged
    assert found.tip[2] > 0.5e-3  # bent along the field
    assert trial_snapshot(found).caption() == f"NOT THE ANSWER: at {100 * share:.3g} % of the load"
    assert trial_snapshot(found).field == pytest.approx(
        [-150e-3 * share, 2e-3 * share, 6e-3 * share]
    )
    assert Still(found).snapshot().caption() == trial_snapshot(found).caption()


def test_a_failed_equilibrium_keeps_what_was_there(run, told) -> None:
    """A good motion with its pictures, byte for byte; the failed state is beside it, and is removed by the next success."""
    run(MOVING)
    (OUT / "movie.mp4").write_text("its movie")
    before = files(OUT)
    failed = OUT / FAILED
    run(
        FAILING,
        status=3,
        says=f"the last good state is in {failed}; the earlier results in {OUT} are unchanged",
    )
    after = files(OUT)
    assert {name: after.get(name) for name in before} == before
    assert not Result.load(failed).converged
    told("render", str(failed))
    assert (failed / PICTURE).exists()
    run(MOVING)
    assert not failed.exists()


def test_a_motion_that_fails_keeps_what_was_there(run) -> None:
    """A good equilibrium; the frames up to the failure are beside it."""
    run(RESTING, "--render")
    before = files(OUT)
    run(
        WILD,
        status=3,
        says=f"the last good state is in {OUT / FAILED}; the earlier results in {OUT} are unchanged",
    )
    after = files(OUT)
    assert {name: after.get(name) for name in before} == before
    assert not (OUT / MOTION).exists()
    assert not (OUT / EARLIER).exists()
    assert len(Motion.load(OUT / FAILED)) >= 1
    assert not Result.load(OUT / FAILED).converged
    run(WILD.replace("time_step: 1 us", "time_step: 90 us"), status=2)  # refused before it begins
    assert {name: files(OUT).get(name) for name in before} == before


def test_a_motion_that_is_killed_keeps_what_was_there_aside(run, told) -> None:
    """In FOLDER/earlier until it is resumed and finished, or until it fails."""
    run(RESTING)
    before = files(OUT)
    swing.scene(Path(), "duration: 30 ms, output_every: 1 ms")
    process = started("run", "scene.yaml")
    wait_for((OUT / CHECKPOINT).exists, process)
    process.kill()
    assert process.wait() == -signal.SIGKILL, "the run was over before it could be killed"
    assert files(OUT / EARLIER) == before
    told("run", "scene.yaml", "--resume")
    assert not (OUT / EARLIER).exists()
    assert Result.load(OUT).time == pytest.approx(0.03)


def test_a_motion_that_is_interrupted_before_its_first_frames_leaves_all_as_it_was(
    run, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(RESTING)
    before = files(OUT)

    def interrupted(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("magmpm.dynamics.time_loop.integrate", interrupted)
    run(MOVING, status=1)
    assert files(OUT) == before


def test_pictures_are_not_put_beside_other_results(tmp_path: Path, told) -> None:
    """Neither those of a run nor of a study, because they would be mistaken for its own. A pipe instead of a result does not hang."""
    one = tmp_path / "one"
    other = tmp_path / "other"
    study = tmp_path / "study"
    for folder in (one, other, study):
        folder.mkdir()
    for folder in (one, other):
        (folder / "result.json").write_text("{}")
        (folder / "scene-file.json").write_text("{}")
    (study / "study.db").write_text("")
    for out in (other, study):
        told(
            "render",
            str(one),
            "--out",
            str(out),
            status=2,
            says=f"{out}: received a folder that holds other results",
        )
    told("render", str(study), status=2, says="run `magmpm design` again")
    (one / "result.json").unlink()
    os.mkfifo(one / "result.json")
    told("render", str(one), status=2, says="result.json")


def ramped(steps: int, resolution: str) -> str:
    """Equilibria along a field that grows for a second."""
    grown = "{over_time: {ramp: {duration: 1 s}}, uniform: [0 mT, 2 mT, 20 mT]}"
    return swing.text(
        field=grown, solver=f"{{quasi_static: {{steps: {steps}}}}}", resolution=f"{{{resolution}}}"
    )


HURRIED = ramped(50, "seconds: 0.02 s")
TIMED = ramped(400, "seconds: 500 s")
WAITING = swing.text("duration: 5 s, output_every: 0.1 ms")


def waiting(run) -> dict[str, bytes]:
    """Leave a motion that its time limit has ended; what is in its folder then."""
    run(WAITING, "--time-limit", "200", status=3)
    assert (OUT / CHECKPOINT).exists()
    return files(OUT)


def test_a_time_that_is_refused_on_the_way_leaves_what_was_there(run) -> None:
    """Its path can't be gone on with, so nothing of it stays: it looked like a motion that waits to be resumed."""
    run(RESTING)
    before = files(OUT)
    run(HURRIED, status=2, says="must be enough for the coarsest grid")
    assert files(OUT) == before
    assert not (OUT / EARLIER).exists()
    run(HURRIED, "--out", "runs/new", status=2)
    assert not any((Path("runs/new") / name).exists() for name in (CHECKPOINT, MOTION, NUMBERS))


def test_a_time_that_is_refused_or_stopped_keeps_a_motion_that_waits_beside_earlier_results(
    run,
) -> None:
    """Both: the motion, which --resume goes on with, and what it will replace. If time stops it, the state goes to FOLDER/failed."""
    run(RESTING)
    before = waiting(run)
    assert (OUT / EARLIER / NUMBERS).exists()
    for options in ((), ("--resume",)):
        run(HURRIED, *options, status=2, says="must be enough for the coarsest grid")
        assert files(OUT) == before
    run(
        TIMED,
        "--resume",
        "--time-limit",
        "200",
        status=3,
        says="with resolution.seconds starts over",
    )
    assert not Result.load(OUT / FAILED).converged
    assert not (OUT / FAILED / MOTION).exists()
    assert {
        name: content for name, content in files(OUT).items() if not name.startswith(FAILED)
    } == before


@pytest.mark.parametrize("first", [None, RESTING], ids=["empty", "with a result"])
def test_a_time_that_is_stopped_leaves_the_last_grid_as_failed_and_nothing_to_resume(
    first: str | None, run
) -> None:
    """Its first attempt is no earlier result, and leaves no checkpoint from which a run could go on."""
    if first is not None:
        run(first)
    before = files(OUT)
    said = run(TIMED, "--time-limit", "200", status=3).err
    assert "--resume" not in said
    assert "earlier results are kept in" not in said
    saved = OUT / FAILED if first else OUT
    assert not Result.load(saved).converged
    assert not (saved / CHECKPOINT).exists()
    assert not (OUT / EARLIER).exists()
    assert {name: files(OUT).get(name) for name in before} == before


def test_a_time_that_is_refused_before_it_begins_removes_nothing(run) -> None:
    """A motion that waits to be resumed stays where it is: nothing was written over it."""
    before = waiting(run)
    for options in ((), ("--resume",)):
        run(
            WAITING.replace("{cells_across: 2}", "{seconds: 0.1 s}"),
            *options,
            status=2,
            says="must be enough for the coarsest grid",
        )
        assert files(OUT) == before


def test_a_path_that_fails_with_an_asked_error_keeps_its_coarse_run_beside_what_was_there(
    monkeypatch, run
) -> None:
    """Nothing of it was written: earlier results stay, be they a result or a motion that waits, and the state goes to FOLDER/failed."""

    def fails(*_: Any, **__: Any) -> Any:
        raise SolveError("no proof", None)

    monkeypatch.setattr("magmpm.solving.several_grids.Runs.prove", fails)
    run(ramped(3, "error: 1 %"), "--out", "runs/new", status=3)
    assert not Result.load("runs/new").converged
    before = waiting(run)
    run(ramped(3, "error: 1 %"), status=3)
    assert not Result.load(OUT / FAILED).converged
    assert {
        name: content for name, content in files(OUT).items() if not name.startswith(FAILED)
    } == before
    assert not (OUT / FAILED / CHECKPOINT).exists()
