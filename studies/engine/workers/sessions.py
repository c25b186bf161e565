"""Sessions that work on a study: one alone, or several that share its storage; and what is done with the trials of one that died.

A session is one `magmpm design`, with all its workers. Each trial of a shared study says which session runs it, and each session writes
a beat into the storage every BEAT seconds. A session is dead if its process is gone, as far as this machine can see it; of another machine
if its beat has not changed for LEASE seconds by our own clock, so that clocks that differ or are set back do no harm.

A storage gives out a trial first and takes the name of its session afterwards. A session that is killed between the two leaves a trial that
nobody has named as theirs: it counts as a dead session's after LEASE seconds without a name.

A trial of a dead session ends as FAIL, which a storage lets only one session do, and that one queues the same design again under a new
number. So nothing is lost, and nothing done twice: a session that only seemed dead finds its trial ended, and drops what it has.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import optuna
from filelock import lock_descriptor
from optuna.exceptions import UpdateFinishedTrialError
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import report
from magmpm.studies.engine.storage import StorageError, Store
from magmpm.studies.engine.storage_url import is_server
from magmpm.studies.search.samplers.optuna_ids import storage_of, study_id, trial_id

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution

    from magmpm.studies.search.samplers.blocks import Distributions

SESSION = "session"  # user attribute of a trial: the session that runs it
# ... and the number of the trial, left behind by a session that died, whose design it has
RERUN_OF = "again"
EXCHANGED = (  # ... and the number of the trial whose design it has, but for one direction
    "exchanged"
)
READY = "asked"  # ... and whether its parameters are all there
SECONDS_TO_LEAVE = (
    5.0  # s to wait for the parameters of a trial with a smaller number: its session may have died
)
# s after which a trial begun on another machine counts as left behind, if its session writes no
# beat
STALE = 600.0
BEAT = 10.0  # s between two beats of a session
LEASE = 60.0  # s without a beat after which a session counts as dead
RECORD = "session:"  # attribute of a study: who a session is
SURPLUS = "one more than were asked for: another session had the last one already"


class PerTrial(BaseSampler):
    """A study's sampler, made anew for each trial from the study's seed and the trial's number.

    So a choice depends on seed, number and the trials that are there, and not on which process
    makes it. Where several sessions share a study, each trial first waits until all with smaller
    numbers have their parameters: storages give out numbers one by one, so this orders the choices,
    and each of them knows all designs that are being solved. Without that, two that ask at the same
    moment would choose alike.

    Parameters
    ----------
    make : callable
        Makes the sampler of the trial with a number.
    starts : sequence of Mapping[str, Any], default ()
        Designs of the first trials, whatever the sampler would choose.
    session : str, optional
        Name of this session, which is stored with its trials.
    wait : bool, default False
        Whether other sessions share the study.
    """

    def __init__(
        self,
        make: Callable[[int], BaseSampler],
        *,
        starts: Sequence[Named] = (),
        session: str | None = None,
        wait: bool = False,
    ) -> None:
        self._make = make
        self._starts = starts
        self._session = session
        self._wait = wait
        self._inner: BaseSampler | None = None
        self._given = False
        self._silent: set[int] = set()  # numbers of the trials that were waited for in vain

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        """Once a trial has its number."""
        self._inner = self._make(trial.number)
        self._given = RERUN_OF in trial.user_attrs or EXCHANGED in trial.user_attrs
        if self._session is not None:
            storage_of(study).set_trial_user_attr(trial_id(trial), SESSION, self._session)
        if self._wait and not self._given:
            _wait_for_smaller(study, trial, self._silent)
        self._inner.before_trial(study, trial)

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> Distributions:
        """Search space that the sampler chooses from together; nothing where the design is given."""
        assert self._inner is not None
        return {} if self._given else self._inner.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: Distributions
    ) -> Plain:
        """The design of a trial."""
        assert self._inner is not None
        if self._given:
            return {}
        found = self._inner.sample_relative(study, trial, search_space)
        if trial.number < len(self._starts):
            storage_of(study).set_trial_user_attr(trial_id(trial), "start", "rod")
            return {
                name: value
                for name, value in self._starts[trial.number].items()
                if name in search_space
            }
        return found

    def sample_independent(
        self,
        study: Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Value that the sampler chooses by itself."""
        assert self._inner is not None
        if (
            not self._given
            and trial.number < len(self._starts)
            and param_name in self._starts[trial.number]
        ):
            return self._starts[trial.number][param_name]
        return self._inner.sample_independent(study, trial, param_name, param_distribution)

    def after_trial(
        self, study: Study, trial: FrozenTrial, state: TrialState, values: Sequence[float] | None
    ) -> None:
        """Pass a trial that has ended to the sampler, which takes notes of it."""
        self._make(trial.number).after_trial(study, trial, state, values)


def _wait_for_smaller(
    study: Study, trial: FrozenTrial, silent: set[int], patience: float = SECONDS_TO_LEAVE
) -> None:
    """Wait until running trials with smaller numbers have all their parameters, `patience` s for each, which is silent if it has not."""

    def missing() -> set[int]:
        trials = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        return {
            t.number for t in trials if t.number < trial.number and READY not in t.user_attrs
        } - silent

    begun = time.monotonic()
    while time.monotonic() - begun < patience * len(
        left := missing()
    ):  # two that wait for the same dead session must not choose at once
        time.sleep(0.02)
    silent |= left


class Session:
    """This session of a study.

    Parameters
    ----------
    kept : optuna.Study
        The study.
    store : Store
        Its storage.
    out : Path
        The study's folder.
    shared : bool
        Whether other sessions may work on the study at the same time.
    """

    def __init__(self, kept: optuna.Study, store: Store, out: Path, shared: bool) -> None:
        """shared: other sessions may work on the study at the same time."""
        self.kept = kept
        self.store = store
        self.out = out
        self.shared = shared
        self.storage = storage_of(kept)
        self.name = uuid.uuid4().hex[:12]
        self.lost: list[str] = []  # what became of trials, a sentence each
        self._beats = 0
        self._beaten = -BEAT
        self._silence: dict[
            str, tuple[Any, float]
        ] = {}  # by who runs a trial: the last beat, and for how long it has not changed, s
        self._looked = time.monotonic()
        self._said = self._looked

    def begin(self) -> None:
        """Takes up what sessions before this one have left behind. Raises StorageError where another one is at work on the study."""
        if self.shared:
            self.beat()
            return
        self.store(self._requeue)
        self.store(lambda: self.kept.set_user_attr("process", this_process(self.out)))

    def beat(self) -> None:
        """Say that this session is alive."""
        if time.monotonic() - self._beaten >= BEAT:
            self._beats += 1
            record = {**this_process(self.out), "beat": self._beats}
            self.store(lambda: self.kept.set_user_attr(RECORD + self.name, record))
            self._beaten = time.monotonic()

    def sweep(self, mine: set[int]) -> None:
        """End the trials of dead sessions and queue their designs again.

        Parameters
        ----------
        mine : set[int]
            Numbers of the trials that are being solved here.
        """
        records, running = self._now()
        self._listen(running, records)
        for trial in running:
            if trial.number in mine:
                continue
            if trial.user_attrs.get(SESSION) == self.name:  # requested, but the answer was lost
                self.put_back(trial_id(trial))
            elif self._is_dead(trial, records):
                self._take_up(trial)

    def _now(self) -> tuple[Named, list[FrozenTrial]]:
        """Records of the sessions, and the trials that run."""
        records = self.store(lambda: self.kept.user_attrs)
        running = (TrialState.RUNNING,)
        return records, self.store(lambda: self.kept.get_trials(deepcopy=False, states=running))

    def tell_wait(self) -> None:
        """Say what this session waits for, if it has nothing else to do: after SECONDS_TO_LEAVE seconds, and again after each LEASE."""
        now = time.monotonic()
        if now - self._said < SECONDS_TO_LEAVE:
            return
        self._said = now + LEASE - SECONDS_TO_LEAVE
        records, running = self._now()
        if running:
            what = "; ".join(self._described(trial, records) for trial in running)
            self.store.tell(
                f"waiting for other sessions, which have begun all trials that are left: {what}"
            )

    def works(self) -> None:
        """Note that this session has something to do."""
        self._said = time.monotonic()

    def _described(self, trial: FrozenTrial, records: Named) -> str:
        """Say who runs a trial, in words."""
        by = trial.user_attrs.get(SESSION)
        owner = records.get(RECORD + by) if by is not None else None
        if owner is None:
            _, silent = self._silence.get(_runner(trial), (None, 0.0))
            left = max(LEASE - silent, 0.0)
            return (
                f"trial {trial.number}, which no session has named as its own (if none does, it is"
                f" queued again in {left:.0f} s)"
            )
        return f"trial {trial.number}, by process {owner['pid']} on {str(owner['host']).split()[0]}"

    def _listen(self, running: Sequence[FrozenTrial], records: Named) -> None:
        """Note for how long each session with a running trial, and each trial without a session, has been silent.

        Of a long time between two looks only two beats count: the server, or this machine, may have been away, and nobody could be heard.
        """
        now = time.monotonic()
        passed = min(now - self._looked, 2 * BEAT)
        self._looked = now
        before = self._silence
        self._silence = {}
        for trial in running:
            who = _runner(trial)
            beat = records.get(RECORD + who, {}).get("beat")
            last, silent = before.get(who, (beat, -passed))
            self._silence[who] = (beat, silent + passed if beat == last else 0.0)

    def put_back(self, trial_id: int) -> None:
        """Let `ask` take up a trial again, with the same number and parameters, unless it has ended. It is no session's until then.

        Parameters
        ----------
        trial_id : int
            Number of the trial in the storage.
        """

        def back() -> None:
            with suppress(UpdateFinishedTrialError):
                if self.storage.get_trial(trial_id).user_attrs.get(SESSION) is not None:
                    self.storage.set_trial_user_attr(trial_id, SESSION, None)
                self.storage.set_trial_state_values(trial_id, state=TrialState.WAITING)

        self.store(back)

    def put_all_back(self) -> None:
        """Puts back every trial that this session has requested and not finished."""
        for trial in self.store(
            lambda: self.kept.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        ):
            if not self.shared or trial.user_attrs.get(SESSION) == self.name:
                self.put_back(trial_id(trial))

    def withdraw(self, trial_id: int) -> None:
        """End a trial that nobody needs.

        Parameters
        ----------
        trial_id : int
            Number of the trial in the storage.
        """

        def end() -> None:
            with suppress(UpdateFinishedTrialError):
                self.storage.set_trial_user_attr(trial_id, "reason", SURPLUS)
                self.storage.set_trial_state_values(trial_id, state=TrialState.FAIL)

        self.store(end)

    def _is_dead(self, trial: FrozenTrial, records: Named) -> bool:
        """True if the session that runs a trial is gone."""
        by = trial.user_attrs.get(SESSION)
        owner = records.get("process" if by is None else RECORD + by, {})
        if by is not None and (owner.get("host") == here() or (owner and "beat" not in owner)):
            return not alive(owner, self.out, _age(trial))
        if by is None and alive(
            owner, self.out, _age(trial)
        ):  # a process that works on the study alone
            return False
        return self._silence[_runner(trial)][1] >= LEASE

    def _take_up(self, trial: FrozenTrial) -> None:
        """End a trial of a dead session, and queue its design, unless another session has."""

        def end() -> bool:
            try:
                with _one_at_a_time(self.store.url):
                    if self.storage.get_trial(trial_id(trial)).state != TrialState.RUNNING:
                        return False
                    return bool(
                        self.storage.set_trial_state_values(trial_id(trial), state=TrialState.FAIL)
                    )
            except UpdateFinishedTrialError:
                return False

        if not self.store(end):
            return
        design = {**trial.system_attrs.get("fixed_params", {}), **trial.params}
        whole = (
            READY in trial.user_attrs or "fixed_params" in trial.system_attrs
        )  # some parameters alone are no design
        self.lost.append(
            f"trial {trial.number}: its session died;"
            f" {'its design is queued again' if whole else 'it had no design yet'}"
        )
        if not whole:
            return
        known = {
            key: value
            for key, value in trial.system_attrs.items()
            if not key.startswith("artifacts:")
        }
        rerun = optuna.trial.create_trial(
            state=TrialState.WAITING,
            system_attrs={**known, "fixed_params": design},
            user_attrs={
                RERUN_OF: trial.number,
                **{key: trial.user_attrs[key] for key in ("start",) if key in trial.user_attrs},
            },
        )
        self.store(lambda: self.storage.create_new_trial(study_id(self.kept), template_trial=rerun))

    def _requeue(self) -> None:
        """Queues trials that a killed process left running: `ask` takes them up with the same number and parameters.

        Raises StorageError when the process that runs them is alive.
        """
        records = self.kept.user_attrs
        for trial in self.kept.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            by = trial.user_attrs.get(SESSION)
            owner = records.get("process" if by is None else RECORD + by, {})
            if alive(owner, self.out, _age(trial)):
                remedy = (
                    "wait for it or end it, then run this command again: it resumes; or share the"
                    " work with it: --workers 1"
                )
                raise StorageError(
                    report(
                        f"study {self.kept.study_name}",
                        rule=f"trial {trial.number} is being run by process {owner['pid']} on"
                        f" {owner['host']}",
                        remedy=remedy,
                    )
                )
            self.put_back(trial_id(trial))


def _runner(trial: FrozenTrial) -> str:
    """The session that runs a trial, or a name for the one that has not said so."""
    return str(trial.user_attrs.get(SESSION) or f"trial {trial.number}")


def this_process(out: Path) -> Plain:
    """Identify this process: its number means something on its own host alone, and there until the number is given to another.

    Parameters
    ----------
    out : Path
        The study's folder.

    Returns
    -------
    dict[str, Any]
        Host, number, time of its start, and folder.
    """
    return {
        "host": here(),
        "pid": os.getpid(),
        "started": _started(os.getpid()),
        "out": str(out.resolve()),
    }


def here() -> str:
    """Name this machine, as far as numbers of processes go: in a container, they are its own.

    Returns
    -------
    str
        The name.
    """
    try:
        return f"{socket.gethostname()} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()


def alive(owner: Named, out: Path, age: float) -> bool:
    """Tell whether the process that last took up a study may still be running its trial.

    Parameters
    ----------
    owner : Mapping[str, Any]
        Its identity, as of this_process.
    out : Path
        The study's folder.
    age : float, s
        How long ago the trial was begun.

    Returns
    -------
    bool
        True if it may.
    """
    mine = this_process(out)
    if owner.get("host") not in (
        mine["host"],
        socket.gethostname(),
    ):  # without a number of a namespace: by an earlier version
        return bool(owner) and age < STALE
    if owner.get("out") == mine["out"] or owner.get("pid") == mine["pid"]:
        return False  # we hold that folder's lock, so nobody else runs
    try:
        os.kill(int(owner["pid"]), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return owner.get("started") in (None, _started(int(owner["pid"])))


def _started(pid: int) -> int | None:
    """Time when a process was started, in clock ticks since the machine was (proc(5), field 22).

    None where that can't be found, and for a process that has ended and that nobody has waited for.
    """
    try:
        state, *fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return None if state in ("Z", "X") else int(fields[18])
    except (OSError, ValueError, IndexError):
        return None


def _age(trial: FrozenTrial) -> float:
    """Seconds since a trial began, by the storage's clock and ours; never negative."""
    began = trial.datetime_start
    return max((datetime.now() - began).total_seconds(), 0.0) if began is not None else STALE


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let Ctrl-C wait until this is done. Only the main thread gets it.

    Yields
    ------
    None
        Nothing: it is a context.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if asked:
            raise KeyboardInterrupt


@contextmanager
def remembered() -> Iterator[Callable[[], None]]:
    """Make a function that raises a Ctrl-C again that was swallowed on its way: exceptions in destructors and weak references' callbacks
    are.

    Libraries of databases have both. Only the main thread gets Ctrl-C, and a handler of somebody
    else's is left to do as it does.

    Yields
    ------
    callable
        The function, within the context.
    """
    before = signal.getsignal(signal.SIGINT)
    if (
        threading.current_thread() is not threading.main_thread()
        or before is not signal.default_int_handler
    ):
        yield lambda: None
        return
    asked: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        signal.default_int_handler(number, frame)

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _one_at_a_time(url: str) -> Iterator[None]:
    """SQLite lets two processes read before either writes, so the sessions on its machine take turns; servers lock the row themselves."""
    if is_server(url):
        yield
        return
    from sqlalchemy.engine import make_url

    folder = os.open(Path(str(make_url(url).database)).resolve().parent, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            lock_descriptor(folder)
        yield
    finally:
        os.close(folder)
