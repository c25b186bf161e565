"""The study itself: ask for a design, solve, compare, keep, until it is good enough or the trials are used up.

By Optuna's ask and tell. With one worker, a trial depends only on the study's definition, its seed and the earlier trials; with several,
also on which trials were running when it was requested. A process may end at any moment; the next one continues as if nothing had happened.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.samplers import BaseSampler
from optuna.trial import TrialState

from magmpm.errors import InputError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.results.folder_lock import folder_lock
from magmpm.results.whole_file import REFUSED, explained
from magmpm.studies.engine import records, report
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.engine.storage import (
    OUTAGE,
    TIMEOUT,
    DatabaseDamaged,
    DatabaseLost,
    StorageError,
    Store,
    claim_folder,
)
from magmpm.studies.engine.storage_url import shown_url, storage_url
from magmpm.studies.engine.study_session import StudySession
from magmpm.studies.engine.workers.pool import Pool
from magmpm.studies.engine.workers.sessions import (
    EXCHANGED,
    READY,
    PerTrial,
    Session,
    remembered,
    uninterrupted,
)
from magmpm.studies.evaluate.evaluator import Evaluator, Picture, trial_of
from magmpm.studies.evaluate.trajectory import InsertionTrajectory
from magmpm.studies.evaluate.trial import (
    Differentiate,
    Note,
    Outcome,
    Solve,
    Trial,
    beyond,
    needs_derivatives,
    silent,
)
from magmpm.studies.problem import TARGET
from magmpm.studies.rods.exchanges import next_exchange
from magmpm.studies.rods.rod_designs import RodForetells
from magmpm.studies.search.definition import Study
from magmpm.studies.search.objectives import trial_values
from magmpm.studies.search.samplers import choice
from magmpm.studies.search.samplers.gauss_newton import GaussNewtonSampler
from magmpm.studies.search.samplers.optuna_ids import SI, set_constraints, trial_id, value_of
from magmpm.studies.search.search_space import SearchSpace
from magmpm.studies.search.well_posed import check_search

LOOK = 1.0  # s between two looks at what other sessions do


def check_study(
    study: Study, workers: int | None = None, time_limit: float | None = None
) -> list[str]:
    """Find what a user should know of a study's search.

    Parameters
    ----------
    study : Study
        The study.
    workers : int, optional
        Number of processes that solve.
    time_limit : float, s, optional
        Of a design.

    Returns
    -------
    list of str
        One sentence each.

    Raises
    ------
    InputError
        Where its sampler can't search it, or nothing can.
    """
    choice.check_available(study.sampler)
    choice.check_suits(study)
    choice.check_workers(workers, time_limit)
    return check_search(study, SearchSpace.of(study))


def run_study(
    study: Study,
    *,
    solve: Solve,
    differentiate: Differentiate | None = None,
    out: Path | str,
    picture: Picture | None = None,
    on_trial: Callable[[Trial], None] | None = None,
    on_advice: Callable[[list[str]], None] | None = None,
    trials: int | None = None,
    sampler: str | None = None,
    storage: str | None = None,
    storage_timeout: float = TIMEOUT,
    workers: int | None = None,
    outage: float = OUTAGE,
    artifacts: str | None = None,
    time_limit: float | None = None,
    on_open: Callable[[Study], object] | None = None,
    on_note: Note = silent,
) -> StudyReport:
    """Run a study to its end, or resume it; return at once when it is done.

    After an interrupt (Ctrl-C) everything finished is kept.

    Parameters
    ----------
    study : Study
        The study.
    solve : callable
        From a scene to its Result; what it raises costs the trial the penalty.
    differentiate : callable, optional
        From a scene to its Sensitivities (magmpm.sensitivities), for the samplers that use
        derivatives.
    out : Path or str
        The study's folder.
    picture : Picture, optional
        Draws a trial; there are no pictures unless given.
    on_trial : callable, optional
        Called with each trial that ends.
    on_advice : callable, optional
        Called before the first trial with what a user should know of the search, and when the
        storage's server goes away and comes back.
    trials : int, optional
        Number of all trials, with those of earlier runs, in place of the study's. If it is
        given, the study runs that many, past its `stop` too.
    sampler : str, optional
        In place of the study's.
    storage : str, optional
        URL of the database; OUT/study.db unless given.
    storage_timeout : float, s, optional
        How long a locked SQLite file is waited for.
    workers : int, optional
        Number of processes that solve. Then solve, differentiate and picture must be importable
        or picklable, and other sessions may share the storage, if it is not the folder's own.
        None: this process solves, and works on the study alone.
    outage : float, s, optional
        How long a server that does not answer is waited for.
    artifacts : str, optional
        A folder or s3://BUCKET for the trials' pictures, in place of OUT/artifacts.
    time_limit : float, s, optional
        After which a worker that still solves a design is ended; the design is solved again,
        once. Unless given, allowed_time.
    on_open : callable, optional
        Called with the study when folder and storage are found usable, before the study is
        written there or anything needs kernels.
    on_note : Note, default silent
        Told in words what is being done where no trial ends for a while: designs of rods, the
        best design, its movie.

    Returns
    -------
    StudyReport
        The study as it stands.

    Raises
    ------
    InputError
        For a changed definition, an unusable sampler or storage, and if another process writes
        to the folder.
    StorageError
        When the database is locked or gone.
    ValueError
        Where the sampler needs `differentiate`, and it is missing.
    """
    study = study.changed(trials=trials, sampler=sampler)
    if differentiate is None and study.why_sampler is not None:
        study = dataclasses.replace(
            study,
            sampler="tpe",
            why_sampler="the study names none, and its solves have no derivatives",
        )
    advice = check_study(study, workers, time_limit)
    if needs_derivatives(study) and differentiate is None:
        raise ValueError(
            "differentiate: gauss-newton and robust need derivatives; pass magmpm.sensitivities"
        )
    if on_advice is not None:
        on_advice(advice)
    folder = Path(out)
    url = storage_url(folder, storage)
    shared = workers is not None and storage is not None
    artifacts = None if artifacts is None else records.whole_place(artifacts)
    store = Store(
        url, storage_timeout, outage, lambda line: None if on_advice is None else on_advice([line])
    )
    with folder_lock(folder), _trials_kept(url):
        claim_folder(folder, study.name)
        run = _Run(
            Evaluator(study, solve, differentiate, picture, folder),
            folder,
            store,
            shared,
            artifacts,
            on_open,
            on_note,
        )
        run.time_limit = time_limit
        stop = study.stop_rms if trials is None else None
        try:
            if workers is None or (workers == 1 and not shared and time_limit is None):
                ended = run.to_the_end(on_trial, stop)
            else:
                ended = run.with_workers(workers, on_trial, stop)
            ended = (
                run.to_the_end(on_trial, stop) if ended == "trials" else ended
            )  # workers leave exchanges, which need one another
            if ended != "interrupted":
                run.keep_best()
                if (
                    not shared
                ):  # where other sessions share the study, each sees to its own pictures
                    run.mended = store(lambda: run.gallery.mend(run.finished()))
            found = run.report(ended)
        except (DatabaseLost, DatabaseDamaged) as error:
            raise run.saved_elsewhere(error) from None
        summary = dataclasses.replace(
            found, artifacts=artifacts, warnings=[*advice, *run.notes, *found.warnings]
        )
        summary.save()
        write_centreline(folder / TARGET, study.target)  # for pictures that are drawn later
    return summary


def allowed_time(durations: list[float]) -> float | None:
    """Find the time that a worker has for a design: a hundred times the usual, ten minutes at least.

    Parameters
    ----------
    durations : list of float, s
        Of designs that are finished.

    Returns
    -------
    float, s, or None
        The limit; None before any is finished.
    """
    return max(600.0, 100.0 * statistics.median(durations)) if durations else None


def kernel_uses(study: Study) -> list[str]:
    """Find the uses of a study's kernels (magmpm.solving.precompile): derivatives and families of rods only where it uses them.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    list of str
        The uses.
    """
    rods = (
        study.sampler == "gauss-newton"
        or study.start == "rod"
        or bool(study.depths or study.keyframes)
    )
    return ["solve", *["sensitivities"] * needs_derivatives(study), *["rods"] * rods]


@contextmanager
def _trials_kept(url: str) -> Iterator[None]:
    """A file that can't be written ends a study, with its trials kept. Raises StorageError, or InputError where the place is wrong."""
    try:
        yield
    except OSError as error:
        kind = InputError if error.errno in REFUSED else StorageError
        kept = (
            f", then run this command again: the finished trials are kept in {shown_url(url)}, and"
            " it resumes"
        )
        raise kind(explained(error, kept)) from None


class _Run(StudySession):
    """A study that this process works on."""

    def __init__(
        self,
        evaluator: Evaluator,
        out: Path,
        store: Store,
        shared: bool,
        artifacts: str | None,
        on_open: Any,
        note: Note,
    ) -> None:
        super().__init__(evaluator, out, store, on_open, note)
        self.shared = shared
        self.session = Session(self.kept, store, out, shared)
        self.session.begin()
        self.starts = self.rod_starts()
        self.kept.sampler = self.sampler()
        self.gallery = records.Gallery(out, self.storage, store.url, artifacts)
        self.deaths = 0
        self.hangs = 0
        self.looked = 0.0
        self.time_limit: float | None = None
        self.mended: list[str] = []
        self.look()
        self.durations = [
            t.user_attrs["seconds"]["total"] for t in self.finished() if "seconds" in t.user_attrs
        ]

    @property
    def notes(self) -> list[str]:
        """Notes on trials and workers that were lost on the way, a sentence each."""
        died = (
            f"worker processes that ended and were replaced: {self.deaths}; their designs were"
            " solved again"
        )
        hung = (
            "of these, processes that took too long for a design and were ended (--time-limit):"
            f" {self.hangs}"
        )
        return [
            *self.session.lost,
            *self.mended,
            *[died] * (self.deaths > 0),
            *[hung] * (self.hangs > 0),
        ]

    def look(self) -> None:
        """See what is finished."""
        finished = self.finished()
        best = report.nearest_first(finished)
        self.count = len(finished)
        self.best = value_of(best[0]) if best else None

    def sampler(self) -> BaseSampler:
        """Sampler that chooses the trials."""
        study = self.study
        insertion = self.evaluator.evaluation
        front = choice.within_bounds(study)
        goal = study.stop_rms or 0.0
        model = (
            RodForetells.of(self.space, study.target)
            if front and not (study.depths or study.keyframes)
            else None
        )

        def of(number: int) -> BaseSampler:
            if (
                isinstance(insertion, InsertionTrajectory)
                and insertion.projects
                and study.sampler != "gauss-newton"
            ):
                from magmpm.studies.search.samplers.optuna_own import FieldsByRod

                return FieldsByRod(
                    choice.make_sampler(
                        study.sampler, insertion.directions_alone(), study.seed, number
                    ),
                    insertion,
                )
            return choice.make_sampler(
                study.sampler,
                self.space,
                study.seed,
                number,
                starts=self.starts,
                goal=goal,
                front=front,
                model=model,
            )

        inner = of(0)
        self.newton = inner if isinstance(inner, GaussNewtonSampler) and self.starts else None
        first = self.starts if study.sampler != "gauss-newton" else []
        return PerTrial(
            of, starts=first, session=self.session.name if self.shared else None, wait=self.shared
        )

    def ended(self, stop: float | None) -> report.Ended | None:
        """Reason why no more trials are wanted, if so; stop: m."""
        if stop is not None and self.best is not None and self.best <= stop:
            return "stop"
        if self.count >= self.study.trials:
            return "trials"
        return "exhausted" if self.exhausted() else None

    def exhausted(self) -> bool:
        """True if only starts elsewhere are left to an insertion whose best design is good: they are on other branches, and win nothing."""
        sampler = self.newton
        found = isinstance(self.evaluator.evaluation, InsertionTrajectory) and self.best is not None
        if sampler is None or not found or self.best > choice.POOR * self.space.scene.length:  # type: ignore[operator]
            return False
        trials = self.store(lambda: self.kept.get_trials(deepcopy=False))
        running = [
            t
            for t in trials
            if t.state == TrialState.RUNNING and set(self.distributions) <= set(t.params)
        ]
        ended = [
            t for t in trials if t.state.is_finished() and set(self.distributions) <= set(t.params)
        ]
        return all(t.state != TrialState.WAITING for t in trials) and sampler.used_up(
            ended, running
        )

    def exchange(self) -> bool:
        """Queues the best design of a set of directions with the rest a step on, or one direction exchanged. Returns whether one waits."""
        several = bool(self.study.depths or self.study.keyframes) or len(self.study.minimize) > 1
        if self.shared or several or self.space.limits is None or self.space.limits.allowed is None:
            return False
        trials = self.store(lambda: self.kept.get_trials(deepcopy=False))
        best = report.best_trial([t for t in trials if t.state == TrialState.COMPLETE])
        if best is None or any(
            t.state == TrialState.WAITING and EXCHANGED in t.user_attrs for t in trials
        ):
            return best is not None
        ended = [t for t in trials if t.state.is_finished()]
        params = self.newton.refined(best, ended) if self.newton is not None else None
        params = params or next_exchange(
            self.space, self.study.target, best.params, [t.params for t in ended]
        )
        if params is not None:
            self.store(lambda: self.kept.enqueue_trial(params, user_attrs={EXCHANGED: best.number}))
        return params is not None

    def to_the_end(
        self, on_trial: Callable[[Trial], None] | None, stop: float | None
    ) -> report.Ended:
        """Runs the remaining trials in this process, or until one comes within `stop`, m. Returns why it ended."""
        with remembered() as check_for_ctrl_c:
            while (ended := self.ended(stop)) is None or (ended == "trials" and self.exchange()):
                try:
                    check_for_ctrl_c()
                    trial = self.one_trial()
                    if trial is not None and on_trial is not None:
                        on_trial(trial)
                except KeyboardInterrupt:
                    return "interrupted"
        return ended

    def one_trial(self) -> Trial | None:
        """Requests a design, solves it and reports its distance. An interrupt puts the trial back into the queue."""
        begun = time.perf_counter()
        pending = self.ask()
        try:
            return self.keep(pending, self.evaluator.outcome(pending.number, pending.params), begun)
        except KeyboardInterrupt:
            self.session.put_back(trial_id(pending))
            raise

    def with_workers(
        self, workers: int, on_trial: Callable[[Trial], None] | None, stop: float | None
    ) -> report.Ended:
        """Run as `to_the_end` does, with processes that solve. Trials being solved when one comes within `stop` are finished and saved."""
        at_work: dict[int, tuple[optuna.Trial, float]] = {}
        with (
            remembered() as check_for_ctrl_c,
            Pool(self.evaluator, workers) if self.ended(stop) is None else nullcontext() as pool,
        ):
            try:
                while True:
                    check_for_ctrl_c()
                    self.look_around(set(at_work))
                    ended = self.ended(stop)
                    if pool is None or (ended is not None and not at_work):
                        return ended or "trials"
                    if at_work:
                        self.session.works()
                    elif self.shared:
                        self.session.tell_wait()
                    while self.ended(stop) is None and pool.idle and self.wanted(len(at_work)):
                        begun = time.perf_counter()
                        pending = self.ask()
                        if not self.shared or self.in_time(pending):
                            at_work[pending.number] = pending, begun
                            pool.begin(pending.number, pending.params)
                    pool.limit = self.time_limit or allowed_time(self.durations)
                    for number, answer in pool.answers(LOOK):
                        pending, begun = at_work[number]
                        outcome = (
                            self.evaluator.failed(pending.params, answer)
                            if isinstance(answer, str)
                            else answer
                        )
                        trial = self.keep(pending, outcome, begun)
                        del at_work[number]
                        if trial is not None and on_trial is not None:
                            on_trial(trial)
                    self.deaths = pool.deaths
                    self.hangs = pool.hangs
            except BaseException as error:  # also while a trial is requested or kept
                self.session.put_all_back()
                if isinstance(error, KeyboardInterrupt):
                    return "interrupted"
                raise

    def look_around(self, mine: set[int]) -> None:
        """Read what other sessions have done meanwhile, and take over what they have left behind."""
        if self.shared and time.monotonic() - self.looked > LOOK:
            self.session.beat()
            self.session.sweep(mine)
            self.look()
            self.looked = time.monotonic()

    def wanted(self, at_work: int) -> bool:
        """True if another trial is wanted in addition to those being solved, at_work of them here."""
        if not self.shared:
            return self.count + at_work < self.study.trials
        known = [
            t.state
            for t in self.store(lambda: self.kept.get_trials(deepcopy=False))
            if t.state != TrialState.FAIL
        ]
        return len(known) < self.study.trials or TrialState.WAITING in known

    def ask(self) -> optuna.Trial:
        """The next trial, with its design."""
        while True:
            try:
                return self._asked()
            except UpdateFinishedTrialError:
                if not self.shared:
                    raise
                late = (
                    "this session gave no sign of life for too long, and another one took over "
                    "its trial before it had a design"
                )
                self.session.lost.append(late)

    def _asked(self) -> optuna.Trial:
        # uninterrupted: a trial that is begun must say whose it is
        pending = self.store(uninterrupted()(lambda: self.kept.ask(self.distributions)))
        if self.shared:
            self.store(lambda: self.storage.set_trial_user_attr(trial_id(pending), READY, True))
        self.remember(pending)
        return pending

    def remember(self, pending: optuna.Trial) -> None:
        """Note a trial as it stands in the database, where that is a file."""
        if self.memory is not None:
            self.memory.note([self.store(lambda: self.storage.get_trial(trial_id(pending)))])

    def in_time(self, pending: optuna.Trial) -> bool:
        """True if a trial is one of those that are wanted; one with which another session was faster is withdrawn."""
        known = self.store(lambda: self.kept.get_trials(deepcopy=False))
        before = sum(t.number < pending.number and t.state != TrialState.FAIL for t in known)
        if before < self.study.trials:
            return True
        self.session.withdraw(trial_id(pending))
        return False

    def keep(self, pending: optuna.Trial, outcome: Outcome, begun: float) -> Trial | None:
        """Keeps a trial's result, picture and attributes, and tells its value last: only then does it count.

        None where another session has taken up the trial meanwhile, because this one could not reach the storage for long.
        """
        try:
            found = self._kept(pending, outcome, begun)
            self.remember(pending)
        except (DatabaseLost, DatabaseDamaged):
            if self.memory is not None:
                self.memory.finish(
                    pending.number, lambda study, trial: self.record(study, trial, outcome, begun)
                )
            raise
        return found

    def _kept(self, pending: optuna.Trial, outcome: Outcome, begun: float) -> Trial | None:
        known = outcome.known
        trial = trial_of(self.study, pending.number, outcome, self.best)
        if outcome.files:
            note = self.store(lambda: self.gallery.attach(pending, outcome.files))
            known |= {} if note is None else {"picture_note": note}
        if outcome.result is not None and trial.improved:
            design = {
                "number": pending.number,
                "rms_m": outcome.rms,
                "params": pending.params,
                **known,
            }
            records.save_design(
                self.out / records.IMPROVEMENTS / f"{pending.number:03d}", outcome.result, design
            )
        if not self.store(lambda: self.record(self.kept, pending, outcome, begun)):
            self.session.lost.append(
                f"trial {pending.number}: taken up by another session while this one could not"
                " reach the storage"
            )
            return None
        self.count = self.count + 1
        self.best = trial.best_rms_m
        self.durations.append(time.perf_counter() - begun)
        del self.durations[:-50]
        left = statistics.median(self.durations) * max(self.study.trials - self.count, 0)
        return dataclasses.replace(
            trial,
            finished=self.count,
            wanted=max(self.study.trials, self.count),
            seconds=self.durations[-1],
            seconds_left=left,
        )

    def record(
        self, kept: optuna.Study, pending: optuna.Trial, outcome: Outcome, begun: float
    ) -> bool:
        """Writes a trial's attributes and value. Returns whether it counts. May be called again where it is not known what was written."""
        try:
            for key, value in outcome.known.items():
                pending.set_user_attr(key, value)
            if self.factors or self.study.margin is not None:
                set_constraints(pending, [beyond(outcome, self.study.margin)])
            # `total` lacks itself and the value; report.seconds_per_trial has all of a trial
            total = time.perf_counter() - begun
            pending.set_user_attr(
                "seconds", {"solve": outcome.seconds, "render": outcome.drawing, "total": total}
            )
            values = trial_values(
                self.study.minimize, self.space, pending.params, outcome.value, not outcome.accepted
            )
            if self.factors:
                pending.set_user_attr(SI, values)
                values = [value * one for value, one in zip(values, self.factors, strict=True)]
            kept.tell(pending, values)
        except (UpdateFinishedTrialError, ValueError):
            state = self.storage.get_trial(trial_id(pending)).state
            if not state.is_finished():
                raise
            return state == TrialState.COMPLETE
        return True
