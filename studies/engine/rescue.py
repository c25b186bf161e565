"""Trials that a session keeps in memory of a study, for the case that its SQLite file goes while the study runs.

SQLite writes on into a file that was deleted, as the system allows: everything seems well, and all is lost with the process. So
the file is looked at before each call of the storage: is it the same one, whole, and may it be written? If not, the study ends, and
what is known of its trials goes into a new database: in place of one that was deleted, else beside it.

The file itself is never opened here but through SQLite: to close it would drop the locks that SQLite holds in this process (POSIX).
"""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import optuna
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import Plain
from magmpm.errors import MagmpmError, report
from magmpm.studies.engine.storage import RESCUED, DatabaseLost, StorageError, Store, storage_faults
from magmpm.studies.engine.workers.sessions import SESSION

LOG = ("-wal", "-shm")  # files beside an SQLite file, which belong to it
GAP = "not known to the session that saved these trials"
FIXED = "fixed_params"  # attribute by which Optuna gives a trial its design


class DatabaseFile:
    """An SQLite file that is in use, as it was found last.

    Parameters
    ----------
    path : Path
        The file.
    study : str
        Name of the study in it.
    timeout : float, s
        How long a lock is waited for.
    """

    def __init__(self, path: Path, study: str, timeout: float) -> None:
        """study: its name in the file; timeout: s to wait for a lock."""
        self.path = path
        self.deleted = False
        self._study = study
        self._timeout = timeout
        self._first = self._last = path.stat()
        self._could_be_written = _writable(path, self._first)
        self._logs: dict[Path, int] = {}

    def check(self, finished: int) -> None:
        """Check that the file is there, whole, may be written, and has so many finished trials of the study.

        Parameters
        ----------
        finished : int
            Number of trials.

        Raises
        ------
        DatabaseLost
            If it is not.
        """
        fault = self._fault(finished)
        if fault is not None:
            raise DatabaseLost(
                report(
                    f"{self.path}: {fault} while the study ran",
                    rule="must stay as it is",
                    remedy="put it back",
                )
            )

    def _fault(self, finished: int) -> str | None:
        try:
            now = self.path.stat()
        except OSError as error:
            self.deleted = isinstance(error, (FileNotFoundError, NotADirectoryError))
            return "deleted" if self.deleted else f"out of reach ({error.strerror})"
        if not os.path.samestat(now, self._first):
            return "replaced by another file"
        if self._could_be_written and not _writable(self.path, now):
            return "made read-only"
        if not self._has_its_log():
            return f"separated from its {self.path.name}{LOG[0]}, which has the last trials,"
        if (now.st_size, now.st_mtime_ns) != (
            self._last.st_size,
            self._last.st_mtime_ns,
        ):  # SQLite moves what is in the log now and then
            if not self._is_whole(finished):
                return "truncated" if now.st_size < self._last.st_size else "overwritten"
            self._last = now
        return None

    def _has_its_log(self) -> bool:
        """True unless the log of the last changes is gone or another one: it stays as long as this process has the database open."""
        for path in (Path(f"{self.path}{end}") for end in LOG):
            try:
                found = path.stat().st_ino
            except OSError:
                found = None
            if found is not None:
                self._logs.setdefault(path, found)
            if self._logs.get(path) != found:
                return False
        return True

    def _is_whole(self, finished: int) -> bool:
        query = (
            "SELECT COUNT(*) FROM trials JOIN studies USING (study_id) WHERE study_name = ? AND"
            " state = 'COMPLETE'"
        )
        try:
            connection = sqlite3.connect(
                f"file:{quote(str(self.path))}?mode=rw", uri=True, timeout=self._timeout
            )
            try:
                (sound,) = connection.execute("PRAGMA quick_check(1)").fetchone()
                (found,) = connection.execute(query, [self._study]).fetchone()
            finally:
                connection.close()
        except sqlite3.DatabaseError as error:
            if "locked" in str(error) or "busy" in str(error):
                raise
            return False
        return sound == "ok" and found >= finished

    def remove_log(self) -> None:
        """Remove the log of a database that is gone: SQLite would take it for that of the file that comes in its place."""
        for path, number in self._logs.items():
            with suppress(OSError):
                if path.stat().st_ino == number:
                    path.unlink()


def _writable(path: Path, found: os.stat_result) -> bool:
    """True if a file may be written: by its mode too, which does not bind the system's administrator."""
    return os.access(path, os.W_OK) and bool(found.st_mode & 0o222)


class Memory:
    """The trials of a study as this session knows them.

    Parameters
    ----------
    kept : optuna.Study
        The study.
    store : Store
        Its storage.
    path : Path
        The SQLite file, in use from now on.
    distributions : Mapping[str, BaseDistribution]
        Of the parameters, by name.
    """

    def __init__(
        self,
        kept: optuna.Study,
        store: Store,
        path: Path,
        distributions: Mapping[str, BaseDistribution],
    ) -> None:
        """path: the SQLite file, in use from now on."""
        self._kept = kept
        self._store = store
        self._distributions = distributions
        self._file = DatabaseFile(path, kept.study_name, store.timeout)
        self._directions = kept.directions
        self._trials: dict[int, FrozenTrial] = {}
        self._finished: set[int] = set()
        store.guard = self._check

    def note(self, trials: Iterable[FrozenTrial]) -> None:
        """Remember trials as they stand in the database.

        Parameters
        ----------
        trials : iterable of FrozenTrial
            The trials.
        """
        for trial in trials:
            self._trials[trial.number] = trial
            if trial.state == TrialState.COMPLETE:
                self._finished.add(trial.number)

    def finish(self, number: int, record: Callable[[optuna.Study, optuna.Trial], object]) -> None:
        """Remember the outcome of a trial that the database has not taken.

        Parameters
        ----------
        number : int
            Of the trial.
        record : callable
            `record(study, trial)` writes the outcome.
        """
        begun = self._trials[number]
        scratch = optuna.create_study(directions=self._directions)
        scratch.enqueue_trial(begun.params, user_attrs=begun.user_attrs)
        record(scratch, scratch.ask(dict(self._distributions)))
        (found,) = scratch.trials
        attributes = {key: value for key, value in found.system_attrs.items() if key != FIXED}
        found.number = number
        found.system_attrs = {**begun.system_attrs, **attributes}
        self._trials[number] = found

    def told(self, error: MagmpmError, make: Callable[[Store], optuna.Study]) -> StorageError:
        """Tell what became of the database and of the trials, which are saved.

        Parameters
        ----------
        error : MagmpmError
            What was raised.
        make : callable
            `make(store)` makes the study anew in another database.

        Returns
        -------
        StorageError
            The error to raise.
        """
        what, *_ = str(error).splitlines()
        finished = sum(trial.state == TrialState.COMPLETE for trial in self._trials.values())
        rule = "an SQLite file must stay in place, whole and writable until its study ends"
        try:
            path = self._saved(make)
        except (OSError, MagmpmError) as other:
            reason = str(other).splitlines()[0]
            remedy = (
                f"its finished trials ({finished}) can't be saved elsewhere either ({reason}); "
                "mend that, and start again"
            )
            return StorageError(report(what, rule=rule, remedy=remedy))
        if path == self._file.path:
            remedy = (
                f"its finished trials ({finished}) are saved in a new file of that name; run this"
                " command again: it resumes"
            )
        else:
            remedy = (
                f"its finished trials ({finished}) are saved in {path}; go on with --storage"
                f" sqlite:///{path}, or put that file in the place of {self._file.path.name}, then"
                " run this command again: it resumes"
            )
        return StorageError(report(what, rule=rule, remedy=remedy))

    def _check(self) -> None:
        with storage_faults(self._store.url, self._store.timeout):
            self._file.check(len(self._finished))

    def _saved(self, make: Callable[[Store], optuna.Study]) -> Path:
        """The database that has the trials from now on: where the old one was if it was deleted, else beside it, or where there is room."""
        self._store.guard = None
        with suppress(Exception):
            self._store.forget()
        self._file.remove_log()
        place = self._file.path
        try:
            path = self._written(place.parent, make)
        except (OSError, MagmpmError):
            path = self._written(Path(tempfile.mkdtemp(prefix="magmpm-")), make)
        if (
            not self._file.deleted
            or path.parent != place.parent
            or Path(f"{path}{LOG[0]}").exists()
        ):
            return path
        try:
            place.hardlink_to(
                path
            )  # which another session with the same database may have done before
        except OSError:
            return path
        path.unlink()
        return place

    def _written(self, folder: Path, make: Callable[[Store], optuna.Study]) -> Path:
        """A new database in a folder, with all trials, each with its number."""
        folder.mkdir(parents=True, exist_ok=True)
        stem = f"{self._file.path.stem}{RESCUED}"
        count = 1
        path = folder / f"{stem}.db"
        while path.exists():
            count += 1
            path = folder / f"{stem}-{count}.db"
        store = Store(f"sqlite:///{path}", self._store.timeout, 0.0, self._store.tell)
        study = make(store)
        with storage_faults(store.url):
            for number in range(max(self._trials, default=-1) + 1):
                study.add_trial(_as_saved(self._trials.get(number)))
        store.forget()  # the last one to close a database brings its log into the file
        return path


def _as_saved(trial: FrozenTrial | None) -> FrozenTrial:
    """A trial as it stands in the new database: what was running is queued again; a number that is not known has failed."""
    if trial is None:
        return optuna.trial.create_trial(state=TrialState.FAIL, user_attrs={"reason": GAP})
    if trial.state.is_finished():
        return trial
    design: Plain = {FIXED: trial.params} if trial.params else {}
    known = {key: value for key, value in trial.user_attrs.items() if key != SESSION}
    attributes = {**trial.system_attrs, **design}
    return optuna.trial.create_trial(
        state=TrialState.WAITING, user_attrs=known, system_attrs=attributes
    )
