"""A session that is killed while it requests a design: the study ends all the same, and no wait is longer than a lease."""

from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import optuna
import pytest
from rod_solve import STUDY, write_study
from servers import postgres, program, session

from magmpm.studies.engine.storage import open_storage
from magmpm.studies.engine.storage_url import storage_url

STATE = optuna.trial.TrialState
LEASE = 4.0  # s, as session.py has it
FEW = STUDY.replace("magnetization: {}", "field: {max: 10 mT}").replace(
    "trials: 8", "trials: 4"
)  # each parameter is a commit
pytestmark = pytest.mark.slow


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/shared.db"
        return
    if program("initdb") is None:
        pytest.skip("needs PostgreSQL: apt-get install postgresql")
    pytest.importorskip("psycopg", reason="an extra: pip install -e '.[postgresql]'")
    with postgres() as server:
        yield server.url()


def trials_of(url: str, name: str) -> list[optuna.trial.FrozenTrial]:
    return optuna.load_study(study_name=name, storage=open_storage(storage_url(None, url))).trials


def test_a_kill_at_any_commit_of_a_request_costs_a_lease_at_most(url: str, tmp_path: Path) -> None:
    """A database is after a kill as its last commit has left it, so a kill before each of them meets all states there are."""
    at = 0
    commits = None
    owners = set()
    while commits is None:
        study = write_study(tmp_path, FEW)
        study = study.rename(tmp_path / f"killed_{at}.yaml")
        killed = session(study, tmp_path / f"out_{at}", 1, url, 0.0, TEST_KILLED=f"ask {at}")
        _, said = killed.communicate(timeout=120)
        assert killed.returncode == -9, said
        if "commits" in said:
            commits = int(said.split(" commits")[0].split()[-1])
        left = [t for t in trials_of(url, study.stem) if t.state == STATE.RUNNING]
        owners |= {t.user_attrs.get("session") is not None for t in left}
        rerun = session(study, tmp_path / f"out_{at}", 1, url, 0.0)
        _, said = rerun.communicate(timeout=120)
        assert rerun.returncode == 0, said
        trials = trials_of(url, study.stem)
        done = sorted(
            (t for t in trials if t.state == STATE.COMPLETE), key=lambda t: t.datetime_complete
        )
        assert len(done) == 4
        assert len({tuple(sorted(t.params.items())) for t in done}) == 4, "no design twice"
        assert all(set(t.params) == set(done[0].params) for t in done), "no design in part"
        assert {t.state for t in trials} <= {
            STATE.COMPLETE,
            STATE.FAIL,
        }, "nothing is left running or waiting"
        # a session looks once a second: it first sees the trial up to a second late, and the end of the lease as well
        assert done[-1].datetime_start - done[-2].datetime_complete < timedelta(seconds=LEASE + 3.0)
        at += 1
    assert at == commits + 1
    assert owners == {
        False,
        True,
    }, "trials that a session had named as its own, and some that it had not yet"


def test_a_kill_while_a_study_is_opened_costs_nothing(url: str, tmp_path: Path) -> None:
    """It was refused as "another definition" by the next session, for ever, where the kill fell between two of its attributes."""
    at = 0
    commits = None
    while commits is None:
        study = write_study(tmp_path, FEW)
        study = study.rename(tmp_path / f"opened_{at}.yaml")
        killed = session(study, tmp_path / f"out_{at}", 1, url, 0.0, TEST_KILLED=f"open {at}")
        _, said = killed.communicate(timeout=120)
        assert killed.returncode == -9, said
        if "commits" in said:
            commits = int(said.split(" commits")[0].split()[-1])
        rerun = session(study, tmp_path / f"out_{at}", 1, url, 0.0)
        _, said = rerun.communicate(timeout=120)
        assert rerun.returncode == 0, said
        kept = optuna.load_study(
            study_name=study.stem, storage=open_storage(storage_url(None, url))
        )
        assert [t.state for t in kept.trials] == [STATE.COMPLETE] * 4
        assert kept.metric_names == ["rms (mm)"]
        at += 1
    assert at == commits + 1 > 3
