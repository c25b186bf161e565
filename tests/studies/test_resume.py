"""A study that is killed and continued is the same study: numbers, parameters, values, pictures."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import optuna
import pytest
from interruptible import draw
from rod_solve import STUDY, RodResult, differentiate, solve, write_study

from magmpm.errors import InputError
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.problem.sampler_names import NAMES, PREFIX, SAMPLERS
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.choice import check_available

HERE = Path(__file__).parent


def of(names: Iterable[str], quick: Iterable[str] | None = None) -> pytest.MarkDecorator:
    """A test for each sampler, skipped where the package that it needs is missing; quick: those whose test is not of the long run (all)."""
    needs = {"optuna:GPSampler": "torch", "cmaes": "cmaes", "optuna:CmaEsSampler": "cmaes"}

    def mark(name: str) -> pytest.MarkDecorator:
        missing = name in needs and importlib.util.find_spec(needs[name]) is None
        return pytest.mark.skipif(
            missing, reason=f"the sampler {name} needs {needs.get(name)}, an extra of magmpm"
        )

    def marks(name: str) -> list[pytest.MarkDecorator]:
        return [mark(name), *[pytest.mark.slow] * (quick is not None and name not in quick)]

    return pytest.mark.parametrize(
        "sampler", [pytest.param(name, marks=marks(name)) for name in names]
    )


def trials_of(out: Path) -> list[optuna.trial.FrozenTrial]:
    """The trials in a results folder, read back from the database."""
    storage = optuna.storages.RDBStorage(f"sqlite:///{out}/study.db")
    (name,) = optuna.get_all_study_names(storage)
    return optuna.load_study(study_name=name, storage=storage).trials


def same(one: list[optuna.trial.FrozenTrial], other: list[optuna.trial.FrozenTrial]) -> None:
    """Asserts that two studies are identical bit for bit: rod and search are deterministic."""
    assert [t.number for t in one] == [t.number for t in other]
    assert {t.state for t in [*one, *other]} == {optuna.trial.TrialState.COMPLETE}
    assert [t.params for t in one] == [t.params for t in other]
    assert [t.value for t in one] == [t.value for t in other]


def kill_in_trial(study: Path, out: Path, sampler: str, at: int, where: str) -> None:
    """Runs the study in a process and kills that process where it waits."""
    command = [
        sys.executable,
        str(HERE / "interruptible.py"),
        str(study),
        str(out),
        sampler,
        str(at),
        where,
    ]
    child = subprocess.Popen(command)
    try:
        until = time.monotonic() + 120
        while not (out / "waiting").exists():
            assert child.poll() is None, "the study ended before the trial it was to be killed in"
            assert time.monotonic() < until, (
                "the study never came to the trial it was to be killed in"
            )
            time.sleep(0.02)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
    (out / "waiting").unlink()


@of(NAMES, quick=("tpe", "gauss-newton"))
def test_same_seed_same_trials_and_another_seed_others(sampler: str, tmp_path: Path) -> None:
    path = write_study(tmp_path)
    for out in ("a", "b"):
        report = run_study(
            load_study(path),
            solve=solve,
            differentiate=differentiate,
            out=tmp_path / out,
            sampler=sampler,
        )
        assert report.trials == 8
    same(trials_of(tmp_path / "a"), trials_of(tmp_path / "b"))
    path.write_text(STUDY.replace("seed: 3", "seed: 4"))
    run_study(
        load_study(path),
        solve=solve,
        differentiate=differentiate,
        out=tmp_path / "c",
        sampler=sampler,
    )
    assert [t.params for t in trials_of(tmp_path / "a")] != [
        t.params for t in trials_of(tmp_path / "c")
    ]
    assert len({t.value for t in trials_of(tmp_path / "a")}) == 8, "no design is tried twice"


@of(
    (name for name in SAMPLERS if name != "nsga2"), quick=("tpe",)
)  # nsga2: below, as Optuna's NSGAIISampler
@pytest.mark.parametrize("where", ["solve", pytest.param("tell", marks=pytest.mark.slow)])
def test_killed_in_mid_trial_and_resumed_is_the_same_study(
    sampler: str, where: str, tmp_path: Path
) -> None:
    # CMA-ES (population 10) has finished its second generation after 23 trials, TPE its random ones after 13
    trials = 23 if "cma" in sampler.lower() else 13
    path = write_study(tmp_path, STUDY.replace("trials: 8", f"trials: {trials}"))
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    run_study(
        load_study(path),
        solve=solve,
        differentiate=differentiate,
        picture=draw,
        out=whole,
        sampler=sampler,
    )
    for at in (1, 12):
        kill_in_trial(path, parts, sampler, at, where)
    report = run_study(
        load_study(path),
        solve=solve,
        differentiate=differentiate,
        picture=draw,
        out=parts,
        sampler=sampler,
    )
    assert report.trials == trials
    same(trials_of(whole), trials_of(parts))
    for one, other in zip(trials_of(whole), trials_of(parts), strict=True):
        (first,), (second,) = pictures(whole, one), pictures(parts, other)
        assert first == second
    assert (whole / "best" / "result.json").read_text() == (
        parts / "best" / "result.json"
    ).read_text()


@of((name for name in NAMES if name.startswith(PREFIX)), quick=("optuna:NSGAIISampler",))
def test_a_study_by_a_sampler_of_optuna_is_continued_as_it_was(
    sampler: str, tmp_path: Path
) -> None:
    """Stopped in the solves of trials 1, 4 and 22 of 24, which are two generations of the genetic ones, it has the same trials."""
    study = load_study(write_study(tmp_path, STUDY.replace("trials: 8", "trials: 24")))
    run_study(study, solve=solve, out=tmp_path / "whole", sampler=sampler)
    stops = [1, 5, 24]
    calls = []

    def interrupted(scene: Scene) -> RodResult:
        calls.append(scene)
        if len(calls) in stops:
            raise KeyboardInterrupt
        return solve(scene)

    while (
        run_study(study, solve=interrupted, out=tmp_path / "parts", sampler=sampler).ended
        == "interrupted"
    ):
        assert len(calls) <= 24
    assert len(calls) == 27
    same(trials_of(tmp_path / "whole"), trials_of(tmp_path / "parts"))


def pictures(out: Path, trial: optuna.trial.FrozenTrial) -> list[bytes]:
    """The contents of the artifacts of a trial."""
    storage = optuna.storages.RDBStorage(f"sqlite:///{out}/study.db")
    known = optuna.artifacts.get_all_artifact_meta(trial, storage=storage)
    return [(out / "artifacts" / meta.artifact_id).read_bytes() for meta in known]


def test_a_surface_is_stored_once_and_a_picture_twice(tmp_path: Path) -> None:
    """A surface's artifact is another name of its file; drawn again, gone or on a store of its own, it is what it has to be."""
    study = load_study(write_study(tmp_path))
    out = tmp_path / "out"
    calls = []

    def files(result: RodResult, path: Path, trial: Trial) -> list[Path]:
        surface = path.with_suffix(".stl")
        with whole_file(surface) as part:
            part.write_bytes(f"solid {trial.number}".encode() * 100)
        return [draw(result, path, trial), surface]

    def killed(trial: Trial) -> None:
        calls.append(trial)
        if len(calls) == 2:
            raise KeyboardInterrupt

    def names(folder: Path) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = {}
        for path in sorted((out / "pictures").iterdir()):
            found[path.name] = [
                kept for kept in folder.iterdir() if kept.read_bytes() == path.read_bytes()
            ]
        return found

    run_study(study, solve=solve, out=out, picture=files, trials=3, on_trial=killed)
    run_study(study, solve=solve, out=out, picture=files, trials=3)
    for name, (kept,) in names(out / "artifacts").items():
        assert kept.samefile(out / "pictures" / name) == name.endswith(".stl")
    (gone,) = names(out / "artifacts")["trial_001.stl"]
    gone.unlink()
    report = run_study(study, solve=solve, out=out, picture=files, trials=3)
    assert report.warnings == [
        "artifacts that were damaged or gone, and are put back from pictures: 1"
    ]
    assert gone.samefile(out / "pictures/trial_001.stl")
    assert not list((out / "artifacts").glob(".*"))
    run_study(
        study, solve=solve, out=out, picture=files, trials=4, artifacts=str(tmp_path / "elsewhere")
    )
    (kept,) = names(tmp_path / "elsewhere")["trial_003.stl"]
    assert not kept.samefile(out / "pictures/trial_003.stl"), (
        "a store that others share has files of its own"
    )


def test_what_is_done_does_nothing(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    first = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out")

    def never(scene: Scene) -> Any:
        raise AssertionError("a finished study solved something")

    again = run_study(study, solve=never, out=tmp_path / "out")
    assert again == first
    assert again.ended == "trials"
    fewer = run_study(study, solve=never, out=tmp_path / "out", trials=3)
    assert fewer.trials == 8, "trials that are there stay"


def test_stop_reached_is_done_and_says_why(tmp_path: Path) -> None:
    """The reason names trial and remedy; a requested number of trials is run, even past `stop`."""
    path = write_study(tmp_path, STUDY + "stop: {rms: 30 mm}\n")  # any catheter is within 30 mm
    first = run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=tmp_path / "out"
    )
    assert (first.trials, first.ended, first.first_trial_below_stop) == (1, "stop", 0)
    assert first.why.startswith("stopped after trial 0, because its rms is within `stop`, 30 mm")
    assert "--trials 2" in first.why
    again = run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=tmp_path / "out"
    )
    assert (again.trials, again.ended) == (1, "stop")
    past = run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=tmp_path / "out", trials=5
    )
    assert (past.trials, past.ended, past.first_trial_below_stop) == (5, "trials", 0)
    assert past.rms_m[0] == first.rms_m[0]
    enough = run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=tmp_path / "out", trials=3
    )
    assert (enough.trials, enough.ended) == (5, "trials")
    assert enough.why.startswith("5 trials are done, and 3 were asked for")
    path.write_text(
        STUDY + "stop: {rms: 0.001 mm}\n"
    )  # stop may change: it is not part of the definition
    more = run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=tmp_path / "out"
    )
    assert (more.trials, more.ended, more.first_trial_below_stop) == (8, "trials", None)


@pytest.mark.parametrize(
    ("sampler", "module", "extra"),
    [
        ("cmaes", "cmaes", "design"),
        ("optuna:GPSampler", "torch", "gp"),
        ("optuna:CmaEsSampler", "cmaes", "design"),
    ],
)
def test_missing_extra_is_said_before_any_trial(
    sampler, module, extra, tmp_path, monkeypatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"pip install .*\[{extra}\]'"):
        check_available(sampler)
    study = load_study(write_study(tmp_path))
    with pytest.raises(InputError, match=module):
        run_study(
            study, solve=solve, differentiate=differentiate, out=tmp_path / "out", sampler=sampler
        )
    assert not (tmp_path / "out").exists()
