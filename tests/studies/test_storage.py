"""The database of trials: its settings, and the messages if it cannot be used."""

import errno
import json
import math
import os
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import optuna
import pytest
import rod_solve
from interruptible import draw
from optuna.trial import FrozenTrial
from reference.folders import holding
from rod_solve import STUDY, RodResult, differentiate, solve, write_study
from test_resume import trials_of

from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.studies.engine import storage
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.records import artifact_store
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.engine.storage import StorageError
from magmpm.studies.engine.storage_url import known_url
from magmpm.studies.engine.workers.sessions import (
    BEAT,
    LEASE,
    RECORD,
    SESSION,
    STALE,
    Session,
    _started,
    alive,
    this_process,
)
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.search.definition import Study, load_study

Begun = Callable[[Path, int], Study]
SHORT = STUDY.replace("trials: 8", "trials: 6")
LOCKER = """\
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("BEGIN EXCLUSIVE")
print("held", flush=True)
sys.stdin.read()
"""


def run(folder: Path, how: Any = solve, text: str = STUDY, **options: Any) -> StudyReport:
    return run_study(
        load_study(write_study(folder, text)), solve=how, **{"out": folder / "out", **options}
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[FrozenTrial]]:
    """whole(sampler): the trials of a short study that nothing happens to."""

    @cache
    def trials(sampler: str) -> list[FrozenTrial]:
        folder = tmp_path_factory.mktemp("whole")
        text = SHORT.replace("sampler: random", f"sampler: {sampler}")
        run(folder, text=text, picture=draw, differentiate=differentiate)
        return trials_of(folder / "out")

    return trials


@pytest.mark.parametrize("sampler", ["random", "tpe", "cmaes", "gauss-newton"])
def test_a_study_that_was_begun_in_meters_goes_on_so(
    sampler: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    whole: Callable[[str], list[FrozenTrial]],
) -> None:
    """As before 0.1.0, of which its names tell: the same designs and numbers as of one in millimeters."""
    text = SHORT.replace("sampler: random", f"sampler: {sampler}")
    with monkeypatch.context() as earlier:
        earlier.setattr(storage, "SHOWN", {"rms": ("rms_m", 1.0)})
        run(tmp_path, text=text, differentiate=differentiate, trials=3)
    report = run(tmp_path, text=text, differentiate=differentiate)
    begun = trials_of(tmp_path / "out")
    there = whole(sampler)
    assert [t.params for t in begun] == [t.params for t in there]
    assert [t.values for t in begun] == [t.user_attrs["values_si"] for t in there]
    assert [t.value for t in there] == [1e3 * rms for rms in report.rms_m]
    assert not any("values_si" in t.user_attrs or t.constraints for t in begun)


def test_sqlite_is_in_wal_mode_and_lets_others_read_and_write(tmp_path: Path) -> None:
    def look(scene: Scene) -> RodResult:
        # like the dashboard during a study: it reads trials and writes notes
        other = sqlite3.connect(tmp_path / "out/study.db", timeout=5)
        assert other.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert other.execute("SELECT COUNT(*) FROM trials").fetchone()[0] >= 1
        other.execute("UPDATE studies SET study_name = study_name")
        other.commit()
        other.close()
        return solve(scene)

    assert run(tmp_path, look).failed == 0


def test_a_locked_database_is_waited_for_then_said(tmp_path: Path, begun: Begun) -> None:
    begun(tmp_path, 3)
    with holding(tmp_path / "out/study.db", LOCKER):
        begun = time.monotonic()
        with pytest.raises(StorageError) as caught:
            run(tmp_path, storage_timeout=0.5)
        assert time.monotonic() - begun > 0.5, "it waits"
    message = str(caught.value)
    assert "study.db" in message
    assert "another process has kept it locked for 0.5 s" in message
    assert "run this command again: it resumes" in message
    assert caught.value.exit_status == 1
    assert run(tmp_path, trials=4).trials == 4, "and it does"


def test_a_lock_that_goes_in_time_is_not_noticed(tmp_path: Path, begun: Begun) -> None:
    begun(tmp_path, 3)
    holder = sqlite3.connect(
        tmp_path / "out/study.db", isolation_level=None, check_same_thread=False
    )
    holder.execute("BEGIN EXCLUSIVE")
    threading.Timer(0.7, lambda: holder.execute("COMMIT")).start()
    assert run(tmp_path, storage_timeout=20, trials=4).trials == 4
    holder.close()


def test_locked_in_mid_study_keeps_what_is_finished(
    tmp_path: Path, whole: Callable[[str], list[FrozenTrial]]
) -> None:
    holders = []

    def then_locked(scene: Scene) -> RodResult:
        if len(trials_of(tmp_path / "out")) == 4 and not holders:
            holders.append(sqlite3.connect(tmp_path / "out/study.db", isolation_level=None))
            holders[0].execute("BEGIN EXCLUSIVE")
        return solve(scene)

    with pytest.raises(StorageError, match=r"locked for 0\.3 s"):
        run(tmp_path, then_locked, storage_timeout=0.3)
    holders[0].execute("COMMIT")
    holders[0].close()
    states = [t.state for t in trials_of(tmp_path / "out")]
    assert states == [optuna.trial.TrialState.COMPLETE] * 3 + [optuna.trial.TrialState.RUNNING]
    run(tmp_path, trials=6)
    assert [t.params for t in trials_of(tmp_path / "out")] == [t.params for t in whole("random")]


@pytest.mark.parametrize(
    ("url", "kind", "says"),
    [
        ("study.db", InputError, ("--storage", "must be the URL", "sqlite:///study.db")),
        ("nodatabase://x", InputError, ("usable URL", "nodatabase")),
        ("postgresql+nodriver://x/y", InputError, ("usable URL", "nodriver")),
        ("sqlite:////proc/no/study.db", InputError, ("/proc/no", "writable")),
        (
            "sqlite:///:memory:",
            InputError,
            (
                "--storage: received sqlite:///:memory:",
                "lost with its process",
                "sqlite:///study.db",
            ),
        ),
        ("sqlite://", InputError, ("--storage: received sqlite://", "lost with its process")),
        (
            "sqlite:///file:x?mode=memory&uri=true",
            InputError,
            ("--storage: received sqlite:///file:x?", "lost with its process"),
        ),
        (
            "sqlite:///file::memory:?cache=shared&uri=true",
            InputError,
            ("--storage: received sqlite:///file:", "lost with its process"),
        ),
        (
            "sqlite:///file:/x?vfs=memdb&uri=true",
            InputError,
            ("--storage: received sqlite:///file:", "lost with its process"),
        ),
        ("", InputError, ("--storage: received nothing", "must be the URL", "sqlite:///study.db")),
        (
            ":memory:",
            InputError,
            ("--storage: received :memory:", "must be the URL", "sqlite:///study.db"),
        ),
        (
            "postgresql://me:se@cret@host/db",
            InputError,
            ("--storage: received postgresql://me:***@host/db", "write %40 for @"),
        ),
        (
            "postgresql://me:se/c@host/db?x=1",
            InputError,
            ("received postgresql://me:***@host/db", "%2F for /"),
        ),
        (
            "host=here user=me password=cret",
            InputError,
            ("a text without ://", "postgresql://USER@HOST/DATABASE"),
        ),
        ("sqlite:////tmp", InputError, ("/tmp: a folder", "must be a file", "remedy: ")),
        (
            "mysql://me:secret@host/db",
            InputError,
            (
                "--storage: received mysql://me:***@host/db",
                "driver must be",
                "pip install mysqlclient",
            ),
        ),
    ],
)
def test_unusable_storage_is_said_before_any_trial(
    url: str, kind: type[Exception], says: tuple[str, ...], tmp_path: Path
) -> None:
    opened: list[Study] = []
    with pytest.raises(kind) as caught:
        run(tmp_path, storage=url, on_open=opened.append)
    assert all(phrase in str(caught.value) for phrase in says), str(caught.value)
    assert "cret" not in str(caught.value)
    assert opened == []


def test_what_a_study_needs_is_prepared_before_it_is_written(tmp_path: Path) -> None:
    """Whoever ends the command while kernels are compiled may change the file, and begin it anew."""
    url = f"sqlite:///{tmp_path}/out/study.db"
    seen = []
    run(
        tmp_path,
        trials=1,
        on_open=lambda study: seen.append((study.name, optuna.get_all_study_names(url))),
    )
    assert seen == [("probe", [])]


@pytest.mark.parametrize(
    "url", ["sqlite://", "sqlite:///:memory:", "sqlite:///file:x?mode=memory&uri=true"]
)
def test_a_database_in_memory_is_refused_in_a_folder_that_has_designs_too(
    url: str, tmp_path: Path, begun: Begun
) -> None:
    """No file can be missing, because such a database has none."""
    begun(tmp_path, 1)
    with pytest.raises(InputError, match="lost with its process"):
        run(tmp_path, storage=url)


def test_a_database_server_that_does_not_answer_is_said(tmp_path: Path) -> None:
    """A driver that fails to connect, as for a server: SQLite on a broken link."""
    (tmp_path / "link.db").symlink_to(tmp_path / "nowhere" / "study.db")
    with pytest.raises(StorageError, match="unable to open database file") as caught:
        run(tmp_path, storage=f"sqlite:///{tmp_path}/link.db")
    assert "can be reached" in str(caught.value)


def test_a_file_that_is_no_database_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/study.db").write_text("minutes of the last meeting" * 100)
    with pytest.raises(InputError, match="must be an SQLite database"):
        run(tmp_path)
    assert (tmp_path / "out/study.db").read_text().startswith("minutes")


@pytest.mark.parametrize(
    "code",
    [
        "CREATE TRIGGER t AFTER INSERT ON trials BEGIN DELETE FROM trials; END",
        (
            "ALTER TABLE trial_values RENAME TO v; CREATE VIEW trial_values AS WITH RECURSIVE c(x)"
            " AS (SELECT 1 UNION ALL SELECT x FROM c) SELECT * FROM c"
        ),
    ],
)
def test_code_in_a_database_is_refused(code: str, tmp_path: Path, begun: Begun) -> None:
    """It would delete trials, or keep a reader busy without end."""
    begun(tmp_path, 1)
    connection = sqlite3.connect(tmp_path / "out/study.db")
    connection.executescript(code)
    connection.close()
    with pytest.raises(InputError, match=r"holds the (trigger|view) t"):
        run(tmp_path)


def test_a_damaged_database_is_told_as_such(tmp_path: Path, begun: Begun) -> None:
    """The message says what may save it, and does not claim that the study resumes."""
    begun(tmp_path, 3)
    path = tmp_path / "out/study.db"
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    for beside in path.parent.glob("study.db-*"):
        beside.unlink()
    whole = Path(shutil.copytree(path.parent, tmp_path / "whole"))
    content = path.read_bytes()
    middle = bytearray(content)
    middle[len(content) // 2 : len(content) // 2 + 8192] = b"\x5a" * 8192
    for damaged in (content[: len(content) // 2], bytes(middle)):
        path.write_bytes(damaged)
        with pytest.raises(InputError) as caught:
            run(tmp_path)
        said = str(caught.value)
        for part in (
            f"{path}: the database of trials is damaged (",
            "rule: ",
            f"sqlite3 {path} .recover",
            "another --out",
        ):
            assert part in said
        assert "it resumes" not in said
        assert path.read_bytes() == damaged, "left as it is"
    cells = (
        "trial_user_attributes SET value_json = '{'",
        "trial_params SET distribution_json = '{}'",
        "trial_values SET value = 'abc'",
    )
    for cell in cells:
        shutil.rmtree(tmp_path / "out")
        shutil.copytree(whole, tmp_path / "out")
        connection = sqlite3.connect(path)
        connection.execute(f"UPDATE {cell}")
        connection.commit()
        connection.close()
        with pytest.raises(InputError, match="the database of trials is damaged"):
            run(tmp_path)
    shutil.rmtree(tmp_path / "out")
    whole.rename(tmp_path / "out")
    assert run(tmp_path, trials=4).trials == 4


@pytest.mark.parametrize("file", ["design.json", "study.json"])
def test_a_full_disk_keeps_the_trials(
    file: str,
    tmp_path: Path,
    begun: Begun,
    whole: Callable[[str], list[FrozenTrial]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The message gives file and remedy and says that trials are kept; with free space the study continues unchanged."""
    begun(tmp_path, 3)
    shutil.rmtree(tmp_path / "out/best")
    shutil.rmtree(tmp_path / "out/improvements")
    write_text = Path.write_text

    def no_room(self: Path, *arguments: Any, **options: Any) -> int:
        if self.name.endswith(file):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # the system names no file here
        return write_text(self, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", no_room)
        with pytest.raises(StorageError) as caught:
            run(tmp_path, text=SHORT)
    said = str(caught.value)
    for part in (
        f"{file}: No space left on device\n  rule: ",
        "remedy: free disk space",
        f"the finished trials are kept in sqlite:///{tmp_path}",
    ):
        assert part in said
    assert said.startswith(str(tmp_path / "out"))
    assert run(tmp_path, text=SHORT).trials == 6
    assert [t.params for t in trials_of(tmp_path / "out")] == [t.params for t in whole("random")]


def test_a_database_without_room_keeps_the_trials(
    tmp_path: Path, begun: Begun, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun(tmp_path, 3)

    def full(*_: Any, **__: Any) -> Any:
        raise sqlite3.OperationalError("database or disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(optuna.Study, "tell", full)
        with pytest.raises(StorageError) as caught:
            run(tmp_path)
    said = str(caught.value)
    for part in (
        "study.db",
        "database or disk is full",
        "free disk space",
        "the finished trials are kept",
        "it resumes",
    ):
        assert part in said
    assert run(tmp_path, trials=4).trials == 4


def test_the_storage_of_a_saved_study() -> None:
    """As saved; with its password hidden, the variable's; never a password from the command line."""
    hidden = "postgresql://me:***@host/db"
    whole = "postgresql+psycopg://me:secret@host/db"
    assert (
        known_url("sqlite:////a/study.db", None, {"MAGMPM_STORAGE": whole})
        == "sqlite:////a/study.db"
    )
    assert known_url(hidden, None, {"MAGMPM_STORAGE": whole}) == whole
    assert known_url(hidden, None, {}) is None
    assert known_url(hidden, "sqlite:////b.db", {"MAGMPM_STORAGE": whole}) == "sqlite:////b.db"
    with pytest.raises(InputError, match="everybody on this machine can read a command line"):
        known_url(hidden, whole, {})


def test_a_place_for_pictures_that_is_no_folder_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for place in ("ftp://x", "gs://bucket", "S3://bucket"):
        with pytest.raises(InputError, match="must be a folder, or s3://BUCKET"):
            artifact_store(place, tmp_path)
        with pytest.raises(InputError, match="must be a folder, or s3://BUCKET"):
            run_study(
                load_study(write_study(tmp_path / "study")),
                solve=solve,
                out=tmp_path / "study/out",
                artifacts=place,
            )
        shutil.rmtree(tmp_path / "study")
    assert list(tmp_path.iterdir()) == []


def test_another_database_holds_the_trials_and_the_folder_the_rest(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/shared.db"
    report = run(tmp_path, storage=url, trials=3)
    assert report.storage == url
    assert not (tmp_path / "out/study.db").exists()
    elsewhere = run(tmp_path, storage=url, out=tmp_path / "elsewhere")
    assert elsewhere.trials == 8, "another folder resumes the study of that database"
    assert (tmp_path / "elsewhere/best/design.json").exists()


def test_a_study_someone_else_made_is_left_alone(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/shared.db"
    other = optuna.create_study(storage=url, study_name="probe")
    other.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=1)
    with pytest.raises(InputError, match="that magmpm did not make"):
        run(tmp_path, storage=url)
    assert len(optuna.load_study(study_name="probe", storage=url).trials) == 1


def test_a_study_that_was_opened_in_part_is_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session that ends while it writes what the study is leaves a database that the next one goes on with."""
    real = optuna.Study.set_user_attr
    written: list[str] = []

    def ended(kept: optuna.Study, key: str, value: Any) -> None:
        if written:
            raise KeyboardInterrupt
        written.append(key)
        real(kept, key, value)

    with monkeypatch.context() as patched:
        patched.setattr(optuna.Study, "set_user_attr", ended)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, trials=2)
    assert run(tmp_path, trials=2).trials == 2


# the user who runs a study


def test_a_folder_that_cant_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="must be writable"):
        run(tmp_path)


def left_running(folder: Path, **owner: Any) -> str:
    """A shared database with a finished trial and one that `owner` left running. Returns its URL."""
    url = f"sqlite:///{folder}/shared.db"
    run(folder, storage=url, trials=1)
    study = optuna.load_study(study_name="probe", storage=url)
    study.ask()
    study.set_user_attr("process", {**study.user_attrs["process"], **owner})
    return url


def test_a_trial_that_runs_elsewhere_is_not_taken(tmp_path: Path) -> None:
    began = int(Path(f"/proc/{os.getppid()}/stat").read_text().rpartition(")")[2].split()[19])
    url = left_running(
        tmp_path, pid=os.getppid(), started=began, out="/elsewhere"
    )  # on this machine, running
    with pytest.raises(StorageError, match=r"trial 1 is being run by process \d+ on "):
        run(tmp_path, storage=url)
    url = left_running(
        tmp_path / "b", host="another", out="/elsewhere"
    )  # on another machine, just started
    with pytest.raises(StorageError, match=r"trial 1 is being run by process \d+ on another"):
        run(tmp_path / "b", storage=url)


def test_a_trial_left_behind_elsewhere_is_taken_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    url = left_running(tmp_path, pid=ended.pid, out="/elsewhere")  # on this machine, ended
    assert run(tmp_path, storage=url, trials=2).trials == 2
    url = left_running(
        tmp_path / "c", pid=os.getppid(), started=1, out="/elsewhere"
    )  # ended, and its number given to another
    assert run(tmp_path / "c", storage=url, trials=2).trials == 2
    url = left_running(
        tmp_path / "b", host="another", out="/elsewhere"
    )  # on another machine, started long ago

    class Later(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) + timedelta(seconds=STALE + 1)

    monkeypatch.setattr("magmpm.studies.engine.workers.sessions.datetime", Later)
    report = run(tmp_path / "b", storage=url, trials=2)
    assert report.trials == 2
    assert json.loads((tmp_path / "b/out/study.json").read_text())["trials"] == 2


def test_a_process_that_has_ended_and_that_nobody_has_waited_for_is_not_alive(
    tmp_path: Path,
) -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    owner = {**this_process(tmp_path), "pid": child.pid, "started": _started(child.pid)}
    assert alive(owner, tmp_path / "elsewhere", 1.0)
    child.kill()
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
    assert not alive(owner, tmp_path / "elsewhere", 1.0)
    child.communicate()


# Which sessions of workers count as dead, without processes


def session(looked: float = 0.0) -> Session:
    """One that looked so many seconds ago, and has seen the beat 7 of another, and a trial of nobody, just before their lease ended."""
    found: Any = Session.__new__(Session)
    found.name = "mine"
    found.out = Path("out")
    found.store = lambda call: call()
    found._looked = time.monotonic() - looked
    found._silence = {"other": (7, LEASE - 1.0), "trial 4": (None, LEASE - 1.0)}
    return found


def taken_up(one: Session, beat: int) -> list[int]:
    """Numbers of the trials that it takes up: 3 is of a session elsewhere, which has this beat, and 4 of none."""
    other = SimpleNamespace(number=3, datetime_start=None, user_attrs={SESSION: "other"})
    nobodys = SimpleNamespace(number=4, datetime_start=None, user_attrs={})
    records = {RECORD + "other": {"host": "elsewhere", "beat": beat}}
    found: list[int] = []
    one.kept = SimpleNamespace(user_attrs=records, get_trials=lambda **_: [other, nobodys])  # type: ignore[assignment]
    one._take_up = lambda trial: found.append(trial.number)  # type: ignore[method-assign]
    one.sweep(set())
    return found


def test_a_session_elsewhere_is_dead_once_its_lease_is_over_and_so_is_a_trial_that_is_nobodys() -> (
    None
):
    assert taken_up(session(looked=0.5), 7) == []
    assert taken_up(session(looked=1.5), 7) == [3, 4]
    assert taken_up(session(looked=1.5), 8) == [4]


def test_of_a_time_when_no_beat_could_be_seen_two_beats_count() -> None:
    one = session()
    one._silence = {who: (beat, 0.0) for who, (beat, _) in one._silence.items()}
    one._looked -= 10 * LEASE
    assert taken_up(one, 7) == []
    assert one._silence == {"other": (7, 2 * BEAT), "trial 4": (None, 2 * BEAT)}


def test_a_session_that_waits_says_for_what() -> None:
    """Once it has waited for PATIENCE, and again after each LEASE, but not while it has something to do."""
    one = session()
    said: list[str] = []
    one.store.tell = said.append
    records = {RECORD + "other": {"host": "elsewhere pid:[1]", "pid": 4711, "beat": 7}}
    other = SimpleNamespace(number=3, user_attrs={SESSION: "other"})
    nobodys = SimpleNamespace(number=4, user_attrs={})
    one.kept = SimpleNamespace(user_attrs=records, get_trials=lambda **_: [other, nobodys])  # type: ignore[assignment]
    one.works()
    one.tell_wait()
    assert said == []
    for _ in range(2):
        one._said -= LEASE
        one.tell_wait()
        one.tell_wait()
    assert len(said) == 2
    assert (
        "trial 3, by process 4711 on elsewhere; trial 4, which no session has named as its own"
        in said[0]
    )
    assert "queued again in 1 s" in said[0]


@pytest.mark.parametrize("pause", [0.5 * BEAT, 5 * BEAT])
def test_however_rarely_a_session_looks_it_finds_the_dead(pause: float) -> None:
    """Also where its pauses are longer than two beats: as often as it takes for them to make up a lease."""
    one = session()
    one._silence = {}
    found = taken_up(one, 7)
    looks = 0
    while not found and looks < 100:
        one._looked -= pause
        found = taken_up(one, 7)
        looks += 1
    assert (found, looks) == ([3, 4], math.ceil(LEASE / min(pause, 2 * BEAT)))


# A database that goes while its study runs


def struck(database: Path, how: str) -> None:
    """Do to a database what a user, a script or a disk may do."""
    if how == "deleted":
        for path in database.parent.glob(f"{database.name}*"):
            path.unlink()
    elif how == "deleted alone":
        database.unlink()
    elif how == "log deleted":
        database.with_name(f"{database.name}-wal").unlink()
    elif how == "replaced":
        other = database.with_name("other.db")
        sqlite3.connect(other).executescript(
            "CREATE TABLE notes (line TEXT); INSERT INTO notes VALUES ('mine');"
        )
        other.replace(database)
    elif how == "truncated":
        os.truncate(database, 0)
    elif how == "cut in half":
        os.truncate(database, database.stat().st_size // 2)
    elif how == "overwritten":
        size = database.stat().st_size
        database.write_bytes(b"\x5a" * size)
    else:
        database.chmod(0o444)


STRIKES = {
    "deleted": "deleted while",
    "deleted alone": "deleted while",
    "log deleted": "separated from its study.db-wal",
    "replaced": "replaced by another file",
    "truncated": "truncated while",
    "cut in half": "truncated while",
    "overwritten": "overwritten while",
    "read-only": "made read-only",
}


@pytest.mark.parametrize(
    ("how", "sampler"), [*((how, "random") for how in STRIKES), ("deleted", "gauss-newton")]
)
def test_a_database_that_is_lost_during_a_study_is_told_and_its_trials_are_saved(
    how: str, sampler: str, tmp_path: Path, whole: Callable[[str], list[FrozenTrial]]
) -> None:
    """At the next trial, and with the one that was being solved; the study goes on as if nothing had happened."""
    database = tmp_path / "out/study.db"
    solved = []
    text = SHORT.replace("sampler: random", f"sampler: {sampler}")

    def striking(result: RodResult, path: Path, trial: Trial) -> Path:
        solved.append(trial.number)
        if len(solved) == 4:
            struck(database, how)
        return draw(result, path, trial)

    options = {"picture": striking, "differentiate": differentiate}
    with pytest.raises(StorageError) as caught:
        run(tmp_path, text=text, **options)
    said = str(caught.value)
    assert caught.value.exit_status == 1
    assert said.startswith(f"{database}: {STRIKES[how]}"), said
    assert "its finished trials (4) are saved in" in said
    assert len(solved) == 4, "noticed at the next trial"
    (place,) = (
        (tmp_path / "out").glob("*rescued*.db") if not how.startswith("deleted") else [database]
    )
    assert f"--storage sqlite:///{place}" in said or (
        place == database and "a new file of that name; run this command again" in said
    )
    if how == "replaced":
        assert sqlite3.connect(database).execute("SELECT line FROM notes").fetchall() == [
            ("mine",)
        ], "left alone"
        with pytest.raises(InputError, match=f"--storage sqlite:///{place}"):
            run(tmp_path, text=text, **options)
    url = None if place == database else f"sqlite:///{place}"
    report = run(tmp_path, text=text, storage=url, **options)
    assert (report.trials, report.failed) == (6, 0)
    assert solved == list(range(6)), "no trial is solved again"
    here = optuna.load_study(study_name="probe", storage=f"sqlite:///{place}").trials
    there = whole(sampler)
    assert [(t.number, t.params, t.values) for t in here] == [
        (t.number, t.params, t.values) for t in there
    ]
    assert [t.constraints for t in here] == [t.constraints for t in there]


@pytest.mark.slow
def test_a_database_that_is_deleted_while_workers_solve_keeps_their_designs(tmp_path: Path) -> None:
    database = tmp_path / "out/study.db"
    kept = []

    def strike(trial: Trial) -> None:
        kept.append(trial.number)
        if len(kept) == 3:
            struck(database, "deleted")

    with pytest.raises(StorageError, match="deleted while the study ran"):
        run(tmp_path, rod_solve.solve, workers=2, on_trial=strike)
    states = [t.state.name for t in trials_of(tmp_path / "out")]
    assert states.count("COMPLETE") >= 3
    assert set(states) <= {"COMPLETE", "WAITING"}
    assert run(tmp_path, rod_solve.solve, workers=2).trials == 8


def test_a_database_that_others_tidy_up_is_not_lost(tmp_path: Path) -> None:
    """VACUUM and a checkpoint change size and time of the file, and are nobody's loss."""

    def tidy(scene: Scene) -> RodResult:
        other = sqlite3.connect(tmp_path / "out/study.db", timeout=5, isolation_level=None)
        other.execute("VACUUM")
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        other.close()
        return solve(scene)

    assert run(tmp_path, tidy, SHORT).trials == 6
