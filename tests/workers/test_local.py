"""Several workers on one machine: the same study with one, reproducible trials with more, and what happens when one dies."""

import json
import signal
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import optuna
import pytest
import rod_solve
import session
from interruptible import draw
from rod_solve import STUDY, write_study

from magmpm.cli import main
from magmpm.errors import InputError
from magmpm.studies.engine.loop import allowed_time, run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.engine.storage_url import given_url, passwords, shown_url, without_passwords
from magmpm.studies.engine.workers import pool, sessions
from magmpm.studies.evaluate.evaluator import Evaluator
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.problem.sampler_names import SAMPLERS
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.optuna_ids import value_of

TRIALS = 16


def run(
    folder: Path, sampler: str = "tpe", solve: Any = rod_solve.solve, **options: Any
) -> StudyReport:
    path = write_study(folder, STUDY.replace("trials: 8", f"trials: {TRIALS}"))
    how: dict[str, Any] = {
        "differentiate": rod_solve.differentiate,
        "picture": draw,
        "sampler": sampler,
        "out": folder / "out",
        **options,
    }
    return run_study(load_study(path), solve=solve, **how)


def trials_of(folder: Path) -> list[optuna.trial.FrozenTrial]:
    return optuna.load_study(study_name="probe", storage=f"sqlite:///{folder}/out/study.db").trials


@pytest.mark.slow
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_every_sampler_with_three_workers(sampler: str, tmp_path: Path) -> None:
    """As many trials as were asked for, all different, each with its picture; each gives the same bits when it is solved by itself."""
    if sampler == "cmaes":
        pytest.importorskip("cmaes")
    report = run(tmp_path, sampler, workers=3)
    assert (report.trials, report.failed, report.ended) == (TRIALS, 0, "trials")
    trials = trials_of(tmp_path)
    assert [t.number for t in trials] == list(range(TRIALS))
    assert len({tuple(sorted(t.params.items())) for t in trials}) == TRIALS
    study = load_study(tmp_path / "probe.yaml").changed(sampler=sampler)
    evaluator = Evaluator(study, rod_solve.solve, rod_solve.differentiate, None, tmp_path)
    for trial in trials:
        assert evaluator.outcome(trial.number, trial.params).value == value_of(trial)
        assert (tmp_path / f"out/pictures/trial_{trial.number:03d}.png").exists()


def test_two_that_wait_for_the_same_dead_session_choose_one_after_the_other() -> None:
    """Trial 0 never gets a design; trial 1 has waited for it and then gets its own, for which trial 2 waits."""
    begun = time.monotonic()
    silent = set[int]()

    def get_trials(**_: Any) -> list[SimpleNamespace]:
        known = {sessions.READY: True} if time.monotonic() > begun + 0.3 else {}
        return [
            SimpleNamespace(number=0, user_attrs={}),
            SimpleNamespace(number=1, user_attrs=known),
        ]

    study = SimpleNamespace(get_trials=get_trials)
    trial = SimpleNamespace(number=2)
    sessions._wait_for_smaller(study, trial, silent, patience=0.2)  # type: ignore[arg-type]
    assert (time.monotonic() > begun + 0.3, silent) == (True, {0}), "which is not waited for again"


@pytest.mark.slow
def test_one_worker_process_gives_the_study_that_none_gives(tmp_path: Path) -> None:
    """By the process that solves itself, and by one worker process on a shared storage."""
    run(tmp_path / "a")
    run(tmp_path / "b", workers=1)
    run(tmp_path / "c", workers=1, storage=f"sqlite:///{tmp_path}/c/out/study.db")
    one, two, three = (trials_of(tmp_path / name) for name in "abc")
    for other in (two, three):
        assert [t.params for t in one] == [t.params for t in other]
        assert [t.value for t in one] == [t.value for t in other]


def poisoned(
    variable: str, says: str, folder: Path, monkeypatch: pytest.MonkeyPatch, **options: Any
) -> list[str]:
    """Let one design of a study be bad once, which it says; then again, as often as one may be. Returns why that one failed."""
    poison = folder / "poison"
    monkeypatch.setenv(variable, str(poison))
    for where, tries, failed in (("once", pool.PROCESSES_PER_DESIGN, 0), ("often", 1, 1)):
        monkeypatch.setattr(pool, "PROCESSES_PER_DESIGN", tries)
        poison.touch()
        report = run(folder / where, "random", session.slow, **options)
        assert (report.trials, report.failed, poison.exists()) == (TRIALS, failed, False)
        assert failed or any(says in line for line in report.warnings)
    return report.reasons


@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing_and_a_deadly_design_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (reason,) = poisoned(
        session.DEADLY,
        "worker processes that ended and were replaced: 1",
        tmp_path,
        monkeypatch,
        workers=2,
    )
    assert "ended by SIGSEGV" in reason


def test_a_design_that_ended_two_processes_is_given_up_and_the_next_one_begins_anew() -> None:
    worker: Any = SimpleNamespace(ready=True, tries=0, given=[], start=lambda: None)
    worker.give = worker.given.append
    many: Any = pool.Pool.__new__(pool.Pool)
    many._failed_starts = many.deaths = 0
    for number in (5, 6):
        worker.job = (number, {})
        assert many._replaced(worker, "ended by SIGKILL") is None
        assert (
            many._replaced(worker, "ended by SIGKILL")
            == "the process that solved it ended by SIGKILL, 2 times"
        )
        assert worker.job is None
    assert (worker.given, many.deaths) == ([(5, {}), (6, {})], 4)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_worker_that_hangs_is_ended_and_its_design_taken_up(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a design that hangs as often as it may counts as failed, with the reason.

    The limit is a hundred times a solve, which a machine that others keep busy may take thirty times as long for.
    """
    says = "took too long for a design and were ended (--time-limit): 1"
    (reason,) = poisoned(
        session.HANGING, says, tmp_path, monkeypatch, workers=workers, time_limit=10.0
    )
    assert reason == "the process that solved it ended after 10 s without an answer, 1 times"


@pytest.mark.slow
@pytest.mark.parametrize("workers", [None, 2])
def test_ctrl_c_that_a_library_swallows_ends_the_study(workers: int | None, tmp_path: Path) -> None:
    def swallowed(trial: Trial) -> None:
        if trial.number == 4:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    report = run(tmp_path, workers=workers, on_trial=swallowed)
    assert report.ended == "interrupted"
    assert report.trials < TRIALS
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert run(tmp_path, workers=workers).trials == TRIALS


def test_a_design_may_take_long_unless_it_is_told() -> None:
    assert allowed_time([]) is None
    assert allowed_time([2.0, 1.0, 3.0]) == 600.0
    assert allowed_time([60.0, 10.0, 20.0]) == 2000.0


LIMITS = [(None, 60.0), (2, 0.0), (2, -1.0), (2, float("nan")), (2, float("inf"))]


@pytest.mark.parametrize(("workers", "limit"), [*LIMITS, (0, None), (-1, None), (257, None)])
def test_a_time_limit_or_a_number_of_workers_that_cant_be_is_refused(
    workers: int | None, limit: float | None, tmp_path: Path
) -> None:
    option, rule = (
        ("--workers", "must be from 1 to 256") if limit is None else ("--time-limit", ".*")
    )
    with pytest.raises(InputError, match=rf"{option}: received .*\n  rule: {rule}\n  remedy: "):
        run(tmp_path, workers=workers, time_limit=limit)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_solves_with_workers_and_a_trial_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The real solver: a trial that a worker with one thread has solved gives the same bits in this process."""
    path = write_study(
        tmp_path, STUDY, rod_solve.SCENE.replace("cells_across: 4", "cells_across: 2")
    )
    common = [str(path), "--out", str(tmp_path / "out"), "--json"]
    assert main(["design", *common, "--trials", "5", "--workers", "2", "--no-pictures"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trials"] == 5
    for number in (0, 4):
        assert main(["design", *common, "--trial", str(number)]) == 0
        again = json.loads(capsys.readouterr().out)
        assert again["same"] is True
        assert again["rms_m"] == found["rms_m"][number]
    assert main(["design", *common, "--trial", "5"]) == 2
    assert (
        "--trial: received 5\n  rule: trial 5 is not there; the study has 5, numbered from 0"
        in capsys.readouterr().err
    )


URLS = [
    ("postgresql://me:secret@host/db", "postgresql://me:***@host/db", ["secret"]),
    ("postgresql://me:se@c/r:t@host:5/db", "postgresql://me:***@host:5/db", ["se@c/r:t"]),
    (
        "postgresql://me@host/db?password=secret&sslmode=require",
        "postgresql://me@host/db?password=***&sslmode=require",
        ["secret"],
    ),
    (
        "postgresql://host/db?sslpassword=a&passfile=/x",
        "postgresql://host/db?sslpassword=***&passfile=***",
        ["a", "/x"],
    ),
    ("postgresql://me@host/db", "postgresql://me@host/db", []),
    ("sqlite:////a/b:c@d.db", "sqlite:////a/b:c@d.db", []),
    ("grpc://host:13000", "grpc://host:13000", []),
]


@pytest.mark.parametrize(("url", "shown", "secret"), URLS)
def test_passwords_are_hidden_and_refused_on_the_command_line(
    url: str, shown: str, secret: list[str]
) -> None:
    assert shown_url(url) == shown
    assert passwords(url) == secret
    assert given_url(None, {"MAGMPM_STORAGE": url}) == url
    if not secret:
        assert given_url(url, {}) == url
        return
    with pytest.raises(
        InputError, match="everybody on this machine can read a command line"
    ) as caught:
        given_url(url, {})
    for word in secret:
        assert len(word) < 3 or word not in str(caught.value)


def test_a_password_with_a_percent_sign_is_hidden_in_either_form() -> None:
    assert without_passwords("no: p%40ss, p@ss", "postgresql://me:p%40ss@host/db") == "no: ***, ***"


@pytest.mark.slow
def test_artifacts_in_an_s3_compatible_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boto3 = pytest.importorskip("boto3")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "key-of-a-test",
        "AWS_SECRET_ACCESS_KEY": "secret-of-a-test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    try:
        client = boto3.client("s3")
        client.create_bucket(Bucket="my-study")
        run(tmp_path, "random", artifacts="s3://my-study")
        stored = client.list_objects_v2(Bucket="my-study")["Contents"]
        assert len(stored) == TRIALS
        first = client.get_object(Bucket="my-study", Key=stored[0]["Key"])["Body"].read()
        assert first.startswith(b"trial ")
    finally:
        server.stop()
    for path in (tmp_path / "out").rglob("*"):
        assert not path.is_file() or b"secret-of-a-test" not in path.read_bytes()


@pytest.mark.parametrize("place", ["s3://", "s3://My_Bucket", "s3://bucket/with/a/path"])
def test_a_place_that_is_no_bucket_is_refused(place: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must name a bucket alone"):
        run(tmp_path, artifacts=place)


@pytest.mark.slow
def test_pictures_are_put_back(tmp_path: Path) -> None:
    run(tmp_path, "random")
    files = sorted((tmp_path / "out/artifacts").iterdir())
    before = [path.read_bytes() for path in files]
    files[0].write_bytes(b"")
    files[1].unlink()
    report = run(tmp_path, "random")
    assert [path.read_bytes() for path in files] == before
    assert report.warnings == [
        "artifacts that were damaged or gone, and are put back from pictures: 2"
    ]
    (number,) = np.flatnonzero([t.number == 3 for t in trials_of(tmp_path)])
    (tmp_path / "out/pictures/trial_003.png").unlink()
    for path in files:
        path.unlink()
    report = run(tmp_path, "random")
    assert f"trial {number}: its artifact trial_003.png is gone" in report.warnings[-1]
