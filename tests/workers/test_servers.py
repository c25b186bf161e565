"""Four workers on PostgreSQL, and on Optuna's gRPC proxy, while workers and sessions are killed: nothing lost, nothing doubled."""

import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import optuna
import psutil
import pytest
from rod_solve import STUDY, write_study
from servers import PASSWORD, Postgres, grpc_proxy, postgres, program, session

from magmpm.studies.engine.storage import open_storage
from magmpm.studies.engine.storage_url import storage_url
from magmpm.studies.engine.workers.sessions import RERUN_OF
from magmpm.studies.search.samplers.optuna_ids import value_of

WANTED = 40
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        program("initdb") is None, reason="needs PostgreSQL: apt-get install postgresql"
    ),
]
pytest.importorskip("psycopg", reason="an extra: pip install -e '.[postgresql]'")


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    with postgres() as running:
        yield running


def trials_of(url: str, name: str) -> list[optuna.trial.FrozenTrial]:
    return optuna.load_study(
        study_name=name, storage=open_storage(storage_url(None, url))
    ).get_trials(deepcopy=False)


def nothing_lost_or_doubled(
    trials: list[optuna.trial.FrozenTrial], seen: dict[int, tuple[float, ...]], wanted: int
) -> None:
    """As many trials as were asked for, each design once, and every trial that was complete when it was looked at still as it was."""
    done = [t for t in trials if t.state == optuna.trial.TrialState.COMPLETE]
    assert len(done) == wanted
    assert len({tuple(sorted(t.params.items())) for t in done}) == wanted, "no design twice"
    assert {t.number: tuple(t.values) for t in trials if t.number in seen} == seen, "nothing lost"
    states = {t.state for t in trials}
    assert states <= {
        optuna.trial.TrialState.COMPLETE,
        optuna.trial.TrialState.FAIL,
    }, "nothing is left running or waiting"
    rerun = [t.user_attrs[RERUN_OF] for t in trials if RERUN_OF in t.user_attrs]
    assert len(rerun) == len(set(rerun)), "no design is queued again twice"
    for trial in done:
        assert trial.user_attrs["feasible"]
        assert value_of(trial) == trial.user_attrs["rms_m"]


def seen_now(url: str, name: str) -> dict[int, tuple[float, ...]]:
    try:
        return {
            t.number: tuple(t.values)
            for t in trials_of(url, name)
            if t.state == optuna.trial.TrialState.COMPLETE
        }
    except KeyError:
        return {}  # the study has not begun


def killed_now_and_then(
    study: Path, folder: Path, url: str, look: str, kills: int, sampler_seed: int
) -> list[str]:
    """Two sessions of two workers each on one storage; workers and sessions are killed at random moments, sessions begun again.

    look: a URL by which the test itself sees the database. Returns what sessions said."""
    drawn = random.Random(sampler_seed)
    said = []
    sessions = {k: session(study, folder / f"out{k}", 2, url) for k in range(2)}
    seen: dict[int, tuple[float, ...]] = {}
    done = 0
    try:
        until = time.monotonic() + 300
        while any(child.poll() is None for child in sessions.values()):
            assert time.monotonic() < until, "no trial in 300 s: the study does not go on"
            time.sleep(drawn.uniform(0.2, 1.2))
            before = len(seen)
            seen |= seen_now(look, study.stem)
            if len(seen) > before:
                until = time.monotonic() + 300
            if done >= kills or len(seen) > WANTED - 8:
                continue
            k = drawn.randrange(2)
            try:
                family = psutil.Process(sessions[k].pid)
                workers = [
                    child
                    for child in family.children()
                    if "magmpm.studies.engine.workers.pool" in " ".join(child.cmdline())
                ]
                victim = family if drawn.random() < 0.5 or not workers else drawn.choice(workers)
                victim.send_signal(signal.SIGKILL)
                done += 1
                if victim is family:
                    said += sessions[k].communicate()
                    sessions[k] = session(study, folder / f"out{k}", 2, url)
            except psutil.NoSuchProcess:
                continue
        for child in sessions.values():
            out, err = child.communicate()
            said += [out, err]
            assert child.returncode == 0, err
    finally:
        for child in sessions.values():
            child.kill()  # of no effect on one that has ended
    assert done >= min(kills, 3)
    nothing_lost_or_doubled(trials_of(look, study.stem), seen, WANTED)
    return said


@pytest.mark.parametrize("by", ["postgresql", "grpc"])
@pytest.mark.parametrize("sampler", ["tpe", "gauss-newton"])
def test_kills_lose_and_double_nothing(
    by: str, sampler: str, server: Postgres, tmp_path: Path
) -> None:
    study = write_study(
        tmp_path,
        STUDY.replace("trials: 8", f"trials: {WANTED}").replace(
            "sampler: random", f"sampler: {sampler}"
        ),
    )
    study = study.rename(tmp_path / f"kills_{by}_{sampler.replace('-', '_')}.yaml")
    if by == "postgresql":
        said = killed_now_and_then(study, tmp_path, server.url(), server.url(), 6, 1)
    else:
        pytest.importorskip("grpc", reason="an extra: pip install -e '.[grpc]'")
        with grpc_proxy(server.url()) as url:
            said = killed_now_and_then(study, tmp_path, url, server.url(), 6, 2)
    assert PASSWORD not in "".join(said)
    for path in tmp_path.rglob("*"):
        assert not path.is_file() or PASSWORD.encode() not in path.read_bytes(), path


def test_a_server_that_is_stopped_and_started_is_waited_for(
    server: Postgres, tmp_path: Path
) -> None:
    study = write_study(tmp_path, STUDY.replace("trials: 8", "trials: 30")).rename(
        tmp_path / "outage.yaml"
    )
    child = session(study, tmp_path / "out", 2, server.url())
    seen: dict[int, tuple[float, ...]] = {}
    while len(seen) < 5 and child.poll() is None:
        time.sleep(0.1)
        seen |= seen_now(server.url(), "outage")
    server.cut()
    time.sleep(1)
    server.stop()
    time.sleep(3)
    server.start()
    _, said = child.communicate(timeout=120)
    assert child.returncode == 0, said
    assert "does not answer" in said
    assert "answers again" in said
    assert PASSWORD not in said
    nothing_lost_or_doubled(trials_of(server.url(), "outage"), seen, 30)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_put_the_trials_at_work_back(
    how: signal.Signals, server: Postgres, tmp_path: Path
) -> None:
    study = write_study(tmp_path, STUDY.replace("trials: 8", "trials: 60")).rename(
        tmp_path / f"ended_{how.name}.yaml"
    )
    child = session(study, tmp_path / "out", 2, server.url(), seconds=0.5)
    while len(seen_now(server.url(), study.stem)) < 3 and child.poll() is None:
        time.sleep(0.05)
    family = psutil.Process(child.pid).children(recursive=True)
    child.send_signal(how)
    child.communicate(timeout=30)
    if (
        how == signal.SIGINT
    ):  # SIGTERM is the command's to handle: this session has no command, and dies of it
        assert child.returncode == 1
        states = [t.state.name for t in trials_of(server.url(), study.stem)]
        assert "RUNNING" not in states
        assert "WAITING" in states
    _, left = psutil.wait_procs(family, timeout=10)
    assert not left, "no process is left behind"
    rerun = session(study, tmp_path / "out", 2, server.url())
    assert rerun.wait(timeout=120) == 0
    nothing_lost_or_doubled(trials_of(server.url(), study.stem), {}, 60)


def test_a_wrong_password_is_said_and_not_shown(server: Postgres, tmp_path: Path) -> None:
    study = write_study(tmp_path)
    child = session(study, tmp_path / "out", 2, server.url().replace(PASSWORD, "wrong-one-of-mine"))
    _, said = child.communicate(timeout=60)
    assert child.returncode == 1
    assert "password authentication failed" in said
    assert "wrong-one-of-mine" not in said
    assert "postgresql+psycopg://magmpm:***@127.0.0.1" in said
