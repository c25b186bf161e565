"""Where trials are kept: an SQLite file in the results folder unless another database is named.

SQLite runs in WAL mode, so that the dashboard can read while trials are written, and waits TIMEOUT seconds for
other writers.
"""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmpm.errors import InputError, MagmpmError, report
from magmpm.results.run_folder import holds_run
from magmpm.results.whole_file import naming
from studies.definition import Study, definition_hash, differences
from studies.file_names import DATABASE, OWNER, REPORT
from studies.objectives import NAMES

if TYPE_CHECKING:
    import optuna
    from sqlalchemy.engine import URL

TIMEOUT = 60.0  # s to wait for a locked database
_CORRUPT = ("malformed", "corrupt", "disk image")
STALE = 600.0  # s after which a trial begun on another machine counts as left behind


class StorageError(MagmpmError):
    """The database of trials can't be used at the moment: locked, gone, full."""


def storage_url(out: Path, url: str | None) -> str:
    """The database's URL: as given, or OUT/study.db. Raises InputError if it is not a URL."""
    if url is None:
        return f"sqlite:///{(out / DATABASE).resolve()}"
    if "://" not in url:
        from sqlalchemy.engine import make_url

        rule, file = "must be the URL of a database", f"sqlite:///{url}"
        remedy = f"write, say, {f'sqlite:///{DATABASE}' if _in_memory(make_url(file)) else file}"
        raise InputError(report("--storage", received=url or "nothing", rule=rule, remedy=remedy))
    return url


def _in_memory(parts: URL) -> bool:
    """Whether SQLite keeps this database in memory, by any of its names (sqlite.org/inmemorydb.html), or in a file that goes with it."""
    name = parts.database or ""
    options = (parts.query.get("mode") == "memory", parts.query.get("vfs") == "memdb")
    return name in ("", ":memory:", "file:") or name.startswith("file::memory:") or any(options)


def _refuse_memory(parts: URL, url: str) -> None:
    """Raises InputError for a database that would not outlive its process."""
    if parts.get_backend_name() == "sqlite" and _in_memory(parts):
        rule = "a database in memory is gone with its process, and with it all trials"
        raise InputError(report("--storage", received=url, rule=rule, remedy=f"name a file, say, --storage sqlite:///{DATABASE}"))


def shown_url(url: str) -> str:
    """The URL without its password, for messages and reports."""
    from sqlalchemy.engine import make_url

    return make_url(url).render_as_string(hide_password=True)


@contextmanager
def storage_faults(url: str, timeout: float = TIMEOUT) -> Iterator[None]:
    """Turns what the database driver raises into a StorageError that says what to do."""
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (StorageInternalError, SQLAlchemyError, sqlite3.Error) as error:
        cause: BaseException = error
        while cause.__cause__ is not None and not isinstance(cause, sqlite3.Error):
            cause = cause.__cause__
        reason = str(getattr(cause, "orig", cause)).strip().splitlines()[0]
        if any(word in reason for word in _CORRUPT):
            raise _corrupt(url, reason) from None
        if "full" in reason:
            rule = f"the database needs room on its disk ({reason})"
            remedy = "free room, then run this command again: the finished trials are kept, and it resumes"
        elif "locked" in reason or "busy" in reason:
            rule = f"another process has kept it locked for {timeout:g} s"
            remedy = "end that process, then run this command again: it resumes"
        else:
            rule = reason
            remedy = (
                "see that the database can be reached and written to, then run this command again: it resumes"
            )
        raise StorageError(report(shown_url(url), rule=rule, remedy=remedy)) from None


def _corrupt(url: str, reason: str) -> InputError:
    """The message about an SQLite file whose content is damaged."""
    from sqlalchemy.engine import make_url

    path = Path(str(make_url(url).database))
    saved = f"save what can be read of its trials: sqlite3 {path} .recover | sqlite3 {path}.saved, and name that with --storage sqlite:///{path}.saved"
    return InputError(
        report(
            f"{path}: the database of trials is damaged ({reason})",
            rule="must be an SQLite database that is whole; running again will not mend it",
            remedy=f"put back a copy; or {saved}; or move the file away and begin anew with another --out",
        )
    )


def open_storage(url: str, timeout: float = TIMEOUT) -> optuna.storages.BaseStorage:
    """The database as Optuna uses it, made if missing.

    Raises InputError when the URL or its driver is wrong or the file is something else, StorageError when it is locked or
    can't be reached.
    """
    import optuna
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError, NoSuchModuleError

    remedy = "write, say, --storage sqlite:///study.db or --storage postgresql+psycopg://user@host/name"
    try:
        parts = make_url(url)
        parts.get_dialect().import_dbapi()
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            report("--storage", received=url, rule=f"must be a usable URL: {reason}", remedy=remedy)
        ) from None
    sqlite = parts.get_backend_name() == "sqlite"
    _refuse_memory(parts, url)
    options: dict[str, Any] = {"connect_args": {"timeout": timeout}} if sqlite else {"pool_pre_ping": True}
    if sqlite:
        _prepare_sqlite(Path(str(parts.database)), timeout, url)
    with storage_faults(url, timeout):
        try:
            backend = optuna.storages.RDBStorage(url, engine_kwargs=options)
        except RuntimeError as error:  # made by another version of Optuna
            raise InputError(report(shown_url(url), rule=str(error), remedy="use another --out")) from None
        if sqlite:
            _commit_without_waiting(backend)
        return optuna.storages.get_storage(backend)


def _prepare_sqlite(path: Path, timeout: float, url: str) -> None:
    """Checks that the file is a writable database, and puts it into WAL mode."""
    if path.exists() and not path.is_file():
        rule, remedy = "must be a file: an SQLite database, or one that is to become one", "name a file in it, with --storage or --out"
        raise InputError(report(f"{path}: {'a folder' if path.is_dir() else 'no regular file'}", rule=rule, remedy=remedy))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with storage_faults(url, timeout):
            connection = sqlite3.connect(path, timeout=timeout)
            try:
                connection.execute("PRAGMA journal_mode=WAL")
                (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
                if found != "ok":
                    raise _corrupt(url, " ".join(str(found).split()))
            finally:
                connection.close()
    except OSError as error:
        rule, remedy = f"the folder must be writable ({error.strerror})", "use another --out"
        raise InputError(report(str(path.parent), rule=rule, remedy=remedy)) from None
    except StorageError as error:
        if "not a database" in str(error):
            rule, remedy = (
                "must be an SQLite database",
                "use another --out or --storage, or move the file away",
            )
            raise InputError(report(str(path), rule=rule, remedy=remedy)) from None
        raise


def _commit_without_waiting(backend: optuna.storages.RDBStorage) -> None:
    """synchronous=NORMAL: in WAL mode a power cut can cost the last trials, but never the database."""
    from sqlalchemy import event

    @event.listens_for(backend.engine, "connect")
    def _on_connect(connection: sqlite3.Connection, _: object) -> None:
        connection.execute("PRAGMA synchronous=NORMAL")

    backend.scoped_session.remove()
    backend.engine.dispose()


def open_study(
    storage: optuna.storages.BaseStorage,
    study: Study,
    definition: Mapping[str, Any],
    out: Path,
    url: str,
    timeout: float = TIMEOUT,
) -> optuna.Study:
    """The study in its storage, new or resumed, with interrupted trials queued to run again.

    Raises InputError, showing the difference, when the storage holds a study of this name with another definition.
    """
    import optuna

    with storage_faults(url, timeout):
        kept = optuna.create_study(
            storage=storage, study_name=study.name, directions=["minimize"] * len(study.minimize), load_if_exists=True
        )
        known = kept.user_attrs.get("definition")
        if known is None and kept.get_trials(deepcopy=False):
            rule = f"holds a study named {study.name} that magmpm did not make"
            raise InputError(report(shown_url(url), rule=rule, remedy="use another --out or --storage"))
        if known is None:
            kept.set_user_attr("definition", dict(definition))
            kept.set_user_attr("definition_hash", definition_hash(definition))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "experimental": the name of the axis in the dashboard
                kept.set_metric_names([NAMES[name] for name in study.minimize])
        elif kept.user_attrs.get("definition_hash") != definition_hash(definition):
            changes = "\n".join(f"    {line}" for line in differences(known, definition))
            raise InputError(
                f"{study.path}: {shown_url(url)} holds a study named {study.name} with another definition\n{changes}\n"
                "  rule: a study is continued only as it was begun (trials and stop may change)\n"
                f"  remedy: begin a new study with --out, say, --out {out}-2; or put the old values back to resume"
            )
        _requeue(kept, storage, out)
        kept.set_user_attr("process", _this_process(out))
    return kept


def must_exist(url: str, out: Path) -> None:
    """Raises InputError where the designs of a folder have lost their SQLite file, or `url` names none."""
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        parts = make_url(url)
    except ArgumentError:
        return  # open_storage says what is wrong with it
    _refuse_memory(parts, url)
    path = Path(str(parts.database))
    if parts.get_backend_name() == "sqlite" and (not path.exists() or path.stat().st_size == 0):
        raise _without_trials(out, f"{path} is {'empty' if path.exists() else 'missing'}")


def must_hold(
    storage: optuna.storages.BaseStorage, name: str, held: Mapping[int, Any], out: Path, url: str, timeout: float = TIMEOUT
) -> None:
    """Raises InputError unless the designs that a folder holds (their parameters by number of the trial) are of trials of this storage."""
    import optuna

    with storage_faults(url, timeout):
        known = name in optuna.get_all_study_names(storage)
        trials = optuna.load_study(study_name=name, storage=storage).get_trials(deepcopy=False) if known else []
    params = {trial.number: trial.params for trial in trials if trial.number in held}
    if held and (not params or any(params[number] != held[number] for number in params)):
        has = f"{len(trials)} trials, which are others" if trials else "no trial of this study"
        raise _without_trials(out, f"{shown_url(url)} has {has}")


def _without_trials(out: Path, found: str) -> InputError:
    written = ""
    with suppress(OSError, ValueError, KeyError, TypeError):  # it was never written, or is damaged
        written = str(json.loads((out / REPORT).read_text(encoding="utf-8"))["storage"])
    which = f"name their database with --storage ({written} when they ended)" if written else "name their database with --storage"
    return InputError(
        report(
            f"{out}: holds designs of trials that are not there: {found}",
            rule="the designs in a folder and the trials in its database must belong together",
            remedy=f"put the trials back, or {which}; or begin anew in another folder, say, --out {out}-2",
        )
    )


def _this_process(out: Path) -> dict[str, Any]:
    return {"host": socket.gethostname(), "pid": os.getpid(), "out": str(out.resolve())}


def _requeue(kept: optuna.Study, storage: optuna.storages.BaseStorage, out: Path) -> None:
    """Queues trials that a killed process left running: `ask` takes them up with the same number and parameters.

    Raises StorageError when the process that runs them is alive.
    """
    from optuna.trial import TrialState

    for trial in kept.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        owner = kept.user_attrs.get("process", {})
        age = (datetime.now() - trial.datetime_start).total_seconds() if trial.datetime_start else STALE
        if _alive(owner, out, age):
            rule = f"trial {trial.number} is being run by process {owner['pid']} on {owner['host']}"
            remedy = "wait for it or end it, then run this command again: it resumes"
            raise StorageError(report(f"study {kept.study_name}", rule=rule, remedy=remedy))
        storage.set_trial_state_values(trial._trial_id, state=TrialState.WAITING)


def _alive(owner: Mapping[str, Any], out: Path, age: float) -> bool:
    """Whether the process that last took up a study may still be running its trial, begun `age` seconds ago."""
    here = _this_process(out)
    if owner.get("host") != here["host"]:
        return bool(owner) and age < STALE
    if owner.get("out") == here["out"] or owner.get("pid") == here["pid"]:
        return False  # we hold that folder's lock, so nobody else runs
    try:
        os.kill(int(owner["pid"]), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def claim_folder(out: Path, name: str) -> None:
    """Makes the results folder this study's, whatever database its trials are in: two studies in one would mix their pictures.

    Raises InputError when it is another study's, or a run's.
    """
    if holds_run(out):
        rule = "a study has a folder of its own: its designs would mix with the run's result"
        raise InputError(report(f"{out}: holds the results of a run", rule=rule, remedy=f"use another --out, say, {out}-study"))
    path = out / OWNER
    holder = path.read_text(encoding="utf-8", errors="replace").strip() if path.exists() else name
    if holder and holder != name:
        rule = f"the folder holds the results of another study, {holder} ({OWNER}); a study has a folder of its own"
        raise InputError(report(str(out), received=name, rule=rule, remedy=f"use another --out, say, {out}-{name}"))
    with naming(path):
        path.write_text(name + "\n", encoding="utf-8")
