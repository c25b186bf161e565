"""Storage of trials: an SQLite file in the results folder unless another database is named.

SQLite runs in WAL mode, so that the dashboard can read while trials are written, and waits TIMEOUT seconds for
other writers.
"""

from __future__ import annotations

import json
import re
import sqlite3
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import InputError, MagmpmError, install, report, require
from magmpm.results.run_folder import holds_run
from magmpm.results.whole_file import naming
from magmpm.studies.engine.storage_url import (
    GRPC,
    grpc_address,
    is_server,
    refuse_memory,
    shown_url,
    without_passwords,
)
from magmpm.studies.problem import OWNER, REPORT
from magmpm.studies.search.definition import Study, differences
from magmpm.studies.search.objectives import SHOWN

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

Kept = TypeVar("Kept")
TIMEOUT = 60.0  # s to wait for a locked database
OUTAGE = 600.0  # s to wait for a server that was there and does not answer any more
CONNECTING = 10.0  # s to wait for a server's first answer
# a connection that is cut without a word is noticed within half a minute (libpq's settings; the last in milliseconds)
_SHORT_WAITS = {
    "connect_timeout": int(CONNECTING),
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 30000,
}
_CORRUPT = ("malformed", "corrupt", "disk image")
# ends the name of a database with the trials of one that was lost while its study ran
RESCUED = "-rescued"


class StorageError(MagmpmError):
    """The database of trials can't be used at the moment: locked, gone, full."""


class StorageAway(StorageError):
    """The server of the database does not answer: it may be back in a while."""


class DatabaseLost(StorageError):
    """The SQLite file is not any more what it was when the study began: deleted, replaced, cut off, not to be written."""


class DatabaseDamaged(InputError):
    """An SQLite file whose content can't be read."""


@contextmanager
def storage_faults(url: str, timeout: float = TIMEOUT) -> Iterator[None]:
    """Turn what the database driver raises into a StorageError that says what to do.

    Parameters
    ----------
    url : str
        Of the storage.
    timeout : float, s, optional
        How long a locked SQLite file is waited for.

    Yields
    ------
    None
        Nothing: it is a context.

    Raises
    ------
    StorageError
        Where the storage can't be used.
    StorageAway
        Where a server does not answer.
    """
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except Exception as error:
        if isinstance(error, (StorageInternalError, SQLAlchemyError, sqlite3.Error, *_of_grpc())):
            raise _explained(error, url, timeout) from None
        unread = isinstance(
            error, (ValueError, TypeError, KeyError, AssertionError)
        ) and "Record does not exist" not in str(error)
        if unread and _in_optuna(error) and not is_server(url):
            raise _corrupt(
                url, f"Optuna can't read it: {type(error).__name__} {error}".splitlines()[0]
            ) from None
        raise


def _in_optuna(error: Exception) -> bool:
    """True if Optuna raised an error, or what it calls to decode what is stored."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return frame.f_globals["__name__"].split(".")[0] in ("optuna", "json")


def _of_grpc() -> tuple[type[Exception], ...]:
    """Errors that gRPC raises, if it is in use: it is an extra."""
    grpc = sys.modules.get("grpc")
    return () if grpc is None else (grpc.RpcError,)


def _explained(error: BaseException, url: str, timeout: float) -> MagmpmError:
    """The error of a driver in words, without passwords."""
    from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, PendingRollbackError

    cause = error
    away = isinstance(error, _of_grpc())
    while not isinstance(cause, sqlite3.Error):
        cut = isinstance(cause, DBAPIError) and cause.connection_invalidated
        away = (
            away
            or cut
            or isinstance(cause, (OperationalError, InterfaceError, PendingRollbackError))
        )
        if cause.__cause__ is None:
            break
        cause = cause.__cause__
    message = (
        cause.details()
        if isinstance(cause, _of_grpc()) and hasattr(cause, "details")
        else getattr(cause, "orig", cause)
    )
    reason = without_passwords((str(message).strip() or type(cause).__name__).splitlines()[0], url)
    if any(word in reason for word in _CORRUPT) and not is_server(url):
        return _corrupt(url, reason)
    if re.search(r"\b(full|No space left)\b", reason):
        rule = f"the database needs room on its disk ({reason})"
        remedy = (
            "free disk space, then run this command again: the finished trials are kept, and "
            "it resumes"
        )
    elif not is_server(url) and "disk I/O" in reason:
        rule = f"the disk, or a quota on it, does not take what the database writes ({reason})"
        remedy = (
            "free disk space or check the disk, then run this command again: the finished trials "
            "are kept, and it resumes"
        )
    elif not is_server(url) and ("locked" in reason or "busy" in reason):
        rule = f"another process has kept it locked for {timeout:g} s"
        remedy = "end that process, then run this command again: it resumes"
    elif not is_server(url) and "readonly" in reason:
        rule = "must be a file that may be written"
        remedy = "make it writable, then run this command again: it resumes"
        return DatabaseLost(
            report(f"{shown_url(url)}: can't be written ({reason})", rule=rule, remedy=remedy)
        )
    else:
        rule = reason
        remedy = (
            "see that the database can be reached and written to, then run this command again: it"
            " resumes"
        )
    kind = StorageAway if away and is_server(url) else StorageError
    return kind(report(shown_url(url), rule=rule, remedy=remedy))


class Store:
    """Calls of a storage. A server that does not answer is waited for: it may be restarted while a study runs for hours.

    Parameters
    ----------
    url : str
        Of the storage.
    timeout : float, s
        How long a locked SQLite file is waited for.
    outage : float, s
        How long a server is waited for.
    tell : callable
        Gets a line when the wait begins, and when it ends.
    """

    def __init__(
        self, url: str, timeout: float, outage: float, tell: Callable[[str], None]
    ) -> None:
        """timeout: s to wait for a locked SQLite file; outage: s to wait for a server."""
        self.url = url
        self.timeout = timeout
        self.outage = outage
        self.tell = tell
        self.storage: optuna.storages.BaseStorage | None = None
        self.guard: Callable[[], None] | None = None  # is called before each call

    def open(self) -> optuna.storages.BaseStorage:
        """Open the storage.

        Returns
        -------
        optuna.storages.BaseStorage
            The storage.

        Raises
        ------
        InputError
            As of open_storage.
        StorageError
            As of open_storage.
        """
        self.storage = open_storage(self.url, self.timeout)
        return self.storage

    def forget(self) -> None:
        """Give up connections and what was begun on them: a transaction that was cut off refuses all that follows."""
        import optuna

        backend = getattr(self.storage, "_backend", self.storage)
        if isinstance(backend, optuna.storages.RDBStorage):
            with suppress(Exception):  # the server is away
                backend.scoped_session.remove()
            backend.engine.dispose()

    def __call__(self, work: Callable[[], Kept]) -> Kept:
        """Return what `work` returns, which may be called again: a call that failed may have been carried out. Raises StorageError."""
        begun: float | None = None
        pause = 0.1
        while True:
            if self.guard is not None:
                self.guard()
            try:
                with storage_faults(self.url, self.timeout):
                    found = work()
            except StorageAway as error:
                if begun is None:
                    begun = time.monotonic()
                    reason = str(error).splitlines()[1].strip().removeprefix("rule: ")
                    self.tell(
                        f"{shown_url(self.url)} does not answer ({reason}); waiting for it up to"
                        f" {self.outage / 60:.0f} min"
                    )
                if time.monotonic() - begun > self.outage:
                    raise
                self.forget()
                time.sleep(pause)
                pause = min(2 * pause, 5.0)
            else:
                if begun is not None:
                    self.tell(f"{shown_url(self.url)} answers again")
                return found


def _corrupt(url: str, reason: str) -> DatabaseDamaged:
    """The message about an SQLite file whose content is damaged."""
    from sqlalchemy.engine import make_url

    path = Path(str(make_url(url).database))
    saved = (
        f"save what can be read of its trials: sqlite3 {path} .recover | sqlite3 {path}.saved, and"
        f" name that with --storage sqlite:///{path}.saved"
    )
    return DatabaseDamaged(
        f"{path}: the database of trials is damaged ({reason})",
        rule="must be an SQLite database that is whole; running again will not mend it",
        remedy=(
            f"{_rescued(path.parent)}put back a copy; or {saved}; or move the file away and start"
            " again with another --out"
        ),
    )


def _rescued(folder: Path) -> str:
    """The beginning of a remedy, where a folder has trials that were saved as their database was lost."""
    found = sorted(folder.glob(f"*{RESCUED}*.db"))
    return "".join(
        "go on with the trials that were saved as it was lost: --storage"
        f" sqlite:///{path.absolute()}; or "
        for path in found
    )


def open_storage(
    url: str, timeout: float = TIMEOUT, kind: type[optuna.storages.RDBStorage] | None = None
) -> optuna.storages.BaseStorage:
    """Open the database as Optuna uses it; it is made if missing.

    Parameters
    ----------
    url : str
        Of the storage.
    timeout : float, s, optional
        How long a locked SQLite file is waited for.
    kind : type, optional
        Class of a database's storage, in place of Optuna's own.

    Returns
    -------
    optuna.storages.BaseStorage
        The storage.

    Raises
    ------
    InputError
        When the URL or its driver is wrong or the file is something else.
    StorageError
        When it is locked or can't be reached.
    """
    import optuna
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError, NoSuchModuleError

    if url.startswith(GRPC):
        return _open_grpc(url)
    remedy = "write, say, --storage sqlite:///study.db or --storage postgresql://user@host/name"
    try:
        parts = make_url(url)
        parts.get_dialect().import_dbapi()
    except (ArgumentError, NoSuchModuleError, ImportError, ValueError) as error:
        reason = without_passwords(str(error).splitlines()[0], url)
        rule = f"must be a usable URL: {reason}"
        if isinstance(error, ImportError):
            driver = parts.get_driver_name()
            rule = f"the database's driver must be installed: {reason}"
            named = {"psycopg": install("postgresql"), "mysqldb": "pip install mysqlclient"}
            remedy = named.get(driver, f"pip install {driver}")
        raise InputError("--storage", received=shown_url(url), rule=rule, remedy=remedy) from None
    sqlite = parts.get_backend_name() == "sqlite"
    refuse_memory(parts, url)
    options: Plain = {"connect_args": {"timeout": timeout}} if sqlite else {"pool_pre_ping": True}
    if parts.get_backend_name() == "postgresql":
        options["connect_args"] = dict(_SHORT_WAITS)
    if sqlite:
        _prepare_sqlite(Path(str(parts.database)), timeout, url)
    with storage_faults(url, timeout):
        try:
            backend = _made(kind or optuna.storages.RDBStorage, url, options)
        except RuntimeError as error:  # made by another version of Optuna
            raise InputError(shown_url(url), rule=str(error), remedy="use another --out") from None
        if sqlite:
            _commit_without_waiting(backend)
        return optuna.storages.get_storage(backend)


def _made(
    kind: type[optuna.storages.RDBStorage], url: str, options: Named
) -> optuna.storages.RDBStorage:
    """The database with its tables. Sessions that begin together may make them at the same moment: all but one of them try again."""
    from sqlalchemy.exc import IntegrityError, ProgrammingError

    for _ in range(5):
        try:
            return kind(url, engine_kwargs=dict(options))
        except (IntegrityError, ProgrammingError):
            if not is_server(url):
                raise
            time.sleep(0.5)
    return kind(url, engine_kwargs=dict(options))


def _open_grpc(url: str) -> optuna.storages.BaseStorage:
    """Optuna's gRPC proxy, which serves a database that its own machine can reach."""
    host, port = grpc_address(url)
    for package in ("grpc", "google.protobuf"):
        require(package, "grpc", key="--storage", use="storages behind Optuna's gRPC proxy")
    from optuna.storages import GrpcStorageProxy

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "experimental"
        proxy = GrpcStorageProxy(host=host, port=port)
    try:
        proxy.wait_server_ready(timeout=CONNECTING)
    except ConnectionError:
        remedy = (
            "start one where the database is: python -m magmpm.studies.engine.workers.grpc_proxy"
            f" --port {port}"
        )
        raise StorageError(
            report(url, rule=f"no gRPC proxy answers there within {CONNECTING:g} s", remedy=remedy)
        ) from None
    return proxy


def _prepare_sqlite(path: Path, timeout: float, url: str) -> None:
    """Checks that the file is a writable database, and puts it into WAL mode."""
    if path.exists() and not path.is_file():
        raise InputError(
            f"{path}: {'a folder' if path.is_dir() else 'no regular file'}",
            rule="must be a file: an SQLite database, or one that is to become one",
            remedy="name a file in it, with --storage or --out",
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with storage_faults(url, timeout):
            connection = sqlite3.connect(path, timeout=timeout)
            try:
                code = connection.execute(
                    "SELECT type, name FROM sqlite_master WHERE type IN ('trigger', 'view')"
                ).fetchone()
                if code is not None:
                    rule = (
                        "a database of trials has tables alone: triggers and views are code, which"
                        " would run here"
                    )
                    raise InputError(
                        f"{path}: holds the {code[0]} {code[1]}",
                        rule=rule,
                        remedy="use another --out or --storage",
                    )
                connection.execute("PRAGMA journal_mode=WAL")
                (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
                if found != "ok":
                    raise _corrupt(url, " ".join(str(found).split()))
            finally:
                connection.close()
    except OSError as error:
        raise InputError(
            str(path.parent),
            rule=f"the folder must be writable ({error.strerror})",
            remedy="use another --out",
        ) from None
    except StorageError as error:
        if "not a database" in str(error):
            raise InputError(
                str(path),
                rule="must be an SQLite database",
                remedy="use another --out or --storage, or move the file away",
            ) from None
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
    definition: Named,
    out: Path,
    url: str,
    timeout: float = TIMEOUT,
) -> optuna.Study:
    """Open the study in its storage, new or resumed, with interrupted trials queued to run again.

    Parameters
    ----------
    storage : optuna.storages.BaseStorage
        The storage.
    study : Study
        The study.
    definition : Mapping[str, Any]
        All that decides its trials.
    out : Path
        The study's folder.
    url : str
        Of the storage.
    timeout : float, s, optional
        How long a locked SQLite file is waited for.

    Returns
    -------
    optuna.Study
        Optuna's study.

    Raises
    ------
    InputError
        When the storage holds a study of this name with another definition; shows the
        difference.
    """
    import optuna

    with storage_faults(url, timeout):
        objectives = len(study.minimize)
        kept = optuna.create_study(
            storage=storage,
            study_name=study.name,
            directions=["minimize"] * objectives,
            load_if_exists=True,
        )
        known = kept.user_attrs.get("definition")
        if trials_of(kept, url) and known is None:
            raise InputError(
                shown_url(url),
                rule=f"holds a study named {study.name} that magmpm did not make",
                remedy="use another --out or --storage",
            )
        if known is None:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore"
                )  # "experimental": the name of the axis in the dashboard
                kept.set_metric_names([SHOWN[name][0] for name in study.minimize])
            # last: a kill before it leaves a study that the next session begins again
            kept.set_user_attr("definition", dict(definition))
        elif changed := differences(known, definition):
            changes = "\n".join(f"    {line}" for line in changed)
            raise InputError(
                f"{study.path}: {shown_url(url)} holds a study named {study.name} with another"
                f" definition\n{changes}\n  rule: a study is continued only as it was begun (trials"
                " and stop may change)\n  remedy: begin a new study with --out, say, --out"
                f" {out}-2; or put the old values back to resume"
            )
    return kept


def trials_of(kept: optuna.Study, url: str) -> list[FrozenTrial]:
    """Read all trials of a study.

    Parameters
    ----------
    kept : optuna.Study
        The study.
    url : str
        Of its storage.

    Returns
    -------
    list of FrozenTrial
        The trials.

    Raises
    ------
    InputError
        Where a value is no number: SQLite keeps text as well, and Optuna hands it on.
    """
    trials = kept.get_trials(deepcopy=False)
    for trial in trials:
        if not all(isinstance(value, float) for value in trial.values or ()):
            raise _corrupt(url, f"trial {trial.number} has the value {trial.values[0]!r:.40}")
    return trials


def must_exist(url: str, out: Path) -> None:
    """Check that the designs of a folder have not lost their SQLite file, and that a URL names one that exists.

    Parameters
    ----------
    url : str
        Of the storage.
    out : Path
        The study's folder.

    Raises
    ------
    InputError
        Where the file is missing.
    """
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    if url.startswith(GRPC):
        return
    try:
        parts = make_url(url)
    except (ArgumentError, ValueError):
        return  # open_storage says what is wrong with it
    refuse_memory(parts, url)
    path = Path(str(parts.database))
    if parts.get_backend_name() == "sqlite" and (not path.exists() or path.stat().st_size == 0):
        raise _without_trials(out, f"{path} is {'empty' if path.exists() else 'missing'}")


def must_hold(
    storage: optuna.storages.BaseStorage,
    name: str,
    held: Mapping[int, Any],
    out: Path,
    url: str,
    timeout: float = TIMEOUT,
) -> None:
    """Check that the designs that a folder holds are of trials of this storage.

    Parameters
    ----------
    storage : optuna.storages.BaseStorage
        The storage.
    name : str
        Of the study.
    held : Mapping[int, Any]
        Parameters of the designs by the trials' numbers.
    out : Path
        The study's folder.
    url : str
        Of the storage.
    timeout : float, s, optional
        How long a locked SQLite file is waited for.

    Raises
    ------
    InputError
        Where they are not.
    """
    import optuna

    with storage_faults(url, timeout):
        known = name in optuna.get_all_study_names(storage)
        trials = (
            optuna.load_study(study_name=name, storage=storage).get_trials(deepcopy=False)
            if known
            else []
        )
    params = {trial.number: trial.params for trial in trials if trial.number in held}
    if held and (not params or any(params[number] != held[number] for number in params)):
        has = f"{len(trials)} trials, which are others" if trials else "no trial of this study"
        raise _without_trials(out, f"{shown_url(url)} has {has}")


def _without_trials(out: Path, found: str) -> InputError:
    written = ""
    with suppress(OSError, ValueError, KeyError, TypeError):  # it was never written, or is damaged
        written = str(json.loads((out / REPORT).read_text(encoding="utf-8"))["storage"])
    which = (
        f"name their database with --storage ({written} when they ended)"
        if written
        else "name their database with --storage"
    )
    return InputError(
        f"{out}: holds designs of trials that are not there: {found}",
        rule="the designs in a folder and the trials in its database must belong together",
        remedy=(
            f"{_rescued(out)}put the trials back, or {which}; or start again in another folder:"
            f" --out {out}-2"
        ),
    )


def claim_folder(out: Path, name: str) -> None:
    """Make the results folder this study's, whatever database its trials are in: two studies in one would mix their pictures.

    Parameters
    ----------
    out : Path
        The folder.
    name : str
        Of the study.

    Raises
    ------
    InputError
        When it is another study's, or a run's.
    """
    if holds_run(out):
        raise InputError(
            f"{out}: holds the results of a run",
            rule="a study has a folder of its own: its designs would mix with the run's result",
            remedy=f"use another --out, say, {out}-study",
        )
    path = out / OWNER
    holder = path.read_text(encoding="utf-8", errors="replace").strip() if path.exists() else name
    if holder and holder != name:
        rule = (
            f"the folder holds the results of another study, {holder} ({OWNER}); a study has a"
            " folder of its own"
        )
        raise InputError(
            str(out), received=name, rule=rule, remedy=f"use another --out, say, {out}-{name}"
        )
    with naming(path):
        path.write_text(name + "\n", encoding="utf-8")
