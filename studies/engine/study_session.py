"""A study that is open in this process: its definition, its storage, its folder, and what they hold."""

from __future__ import annotations

import dataclasses
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import optuna
from optuna.storages import BaseStorage
from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import NamedNumbers, Plain
from magmpm.errors import InputError, MagmpmError, SolveError
from magmpm.studies.engine import records, report
from magmpm.studies.engine.explain_miss import findings
from magmpm.studies.engine.report import StudyReport, verified
from magmpm.studies.engine.rescue import Memory
from magmpm.studies.engine.storage import (
    Store,
    must_exist,
    must_hold,
    open_study,
    storage_faults,
)
from magmpm.studies.engine.storage_url import shown_url, sqlite_file
from magmpm.studies.engine.workers.sessions import EXCHANGED
from magmpm.studies.evaluate.evaluator import Evaluator
from magmpm.studies.evaluate.trajectory import MOVIE, InsertionTrajectory
from magmpm.studies.evaluate.trial import Note, silent
from magmpm.studies.problem.study import Study
from magmpm.studies.search.best_scene import write_best_scene
from magmpm.studies.search.objectives import NAMES, SHOWN, pareto_report, told_factors
from magmpm.studies.search.samplers.choice import whole_definition
from magmpm.studies.search.samplers.optuna_ids import value_of

VERIFIED = "verified"  # attribute of a study: its best designs on finer grids
STARTS = "starts"  # attribute of a study: the rod's designs


def as_begun(study: Study, storage: BaseStorage) -> Study:
    """Give a study whose file names no sampler the one by which it was begun, if it was.

    Parameters
    ----------
    study : Study
        The study.
    storage : BaseStorage
        Where it may stand.

    Returns
    -------
    Study
        The study.
    """
    if study.why_sampler is None or study.name not in optuna.get_all_study_names(storage):
        return study
    kept = optuna.load_study(study_name=study.name, storage=storage).user_attrs.get(
        "definition", {}
    )
    begun = kept.get("sampler", study.sampler)
    if begun == study.sampler:
        return study
    return dataclasses.replace(study, sampler=begun, why_sampler="the study was begun with it")


class StudySession:
    """A study and what is known of it.

    Parameters
    ----------
    evaluator : Evaluator
        Evaluates its designs.
    out : Path
        The study's folder.
    store : Store
        Its storage.
    on_open : callable or None
        As of run_study.
    note : Note, default silent
        Told in words what is being done between trials.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        out: Path,
        store: Store,
        on_open: Callable[[Study], object] | None,
        note: Note = silent,
    ) -> None:
        """on_open: as of run_study; note: is told what is being done between trials."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.evaluator = evaluator
        self.study = evaluator.study
        self.space = evaluator.space
        self.out = out
        self.store = store
        self.note = note
        self.distributions = self.space.distributions()
        self.starts: list[NamedNumbers] = []
        held = records.designs(out)
        if held:
            must_exist(store.url, out)
        self.storage = store.open()
        with storage_faults(store.url, store.timeout):
            self.study = evaluator.study = as_begun(self.study, self.storage)
        must_hold(self.storage, self.study.name, held, out, store.url, store.timeout)
        if on_open is not None:
            on_open(self.study)
        self.kept = self._opened(self.storage, store.url)
        shown = [SHOWN[name] for name in self.study.minimize]
        self.factors = store(lambda: told_factors(self.kept, shown))
        file = sqlite_file(store.url)
        self.memory = None if file is None else Memory(self.kept, store, file, self.distributions)

    def _opened(self, storage: BaseStorage, url: str) -> optuna.Study:
        """The study in a storage, new or as it was left there."""
        definition = whole_definition(self.study, self.distributions)
        return open_study(storage, self.study, definition, self.out, url, self.store.timeout)

    def finished(self) -> list[FrozenTrial]:
        """Read the finished trials.

        Returns
        -------
        list of FrozenTrial
            In order.
        """
        found = self.store(
            lambda: list(self.kept.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))
        )
        if self.memory is not None:
            self.memory.note(found)
        return found

    def saved_elsewhere(self, error: MagmpmError) -> MagmpmError:
        """Save the trials that this session knows in another database, where theirs is lost.

        Parameters
        ----------
        error : MagmpmError
            What was raised.

        Returns
        -------
        MagmpmError
            What is to be said.
        """
        attributes: Plain = {STARTS: self.starts} if self.starts else {}

        def make(store: Store) -> optuna.Study:
            kept = self._opened(store.open(), store.url)
            if self.factors is None:  # as the trials were told
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # experimental
                    kept.set_metric_names([NAMES[name] for name in self.study.minimize])
            for key, value in attributes.items():
                kept.set_user_attr(key, value)
            return kept

        return error if self.memory is None else self.memory.told(error, make)

    def rod_starts(self) -> list[NamedNumbers]:
        """Find the rod's best designs, if this study begins with them. They are found once and kept with the study.

        Returns
        -------
        list of dict[str, float]
            Parameters, best first.
        """
        if self.study.sampler != "gauss-newton" and self.study.start is None:
            return []
        known = self.store(lambda: self.kept.user_attrs)
        if STARTS not in known:
            starts = self.evaluator.evaluation.rod_starts(self.note)
            self.store(lambda: self.kept.set_user_attr(STARTS, starts))
        return list(self.store(lambda: self.kept.user_attrs)[STARTS])

    def keep_best(self) -> None:
        """Makes sure that OUT/best holds the best trial and its scene; solves it again if its result is not in this folder."""
        best = report.best_trial(self.finished())
        if best is None:
            return
        self.note("keeping the best design")
        self.mend_improvements()
        source = self.out / records.IMPROVEMENTS / f"{best.number:03d}"
        if not records.holds(self.out / records.BEST, best) and self.saved(best, source):
            records.replace_folder(source, self.out / records.BEST)
        self.verify_best()
        if records.holds(self.out / records.BEST, best):
            if (
                isinstance(self.evaluator.evaluation, InsertionTrajectory)
                and not (self.out / records.BEST / MOVIE).exists()
            ):
                self.evaluator.evaluation.write_moments(
                    self.out / records.BEST, self.evaluator.solve, best.params, self.note
                )
            write_best_scene(self.out / records.BEST, self.study, self.space, report.describe(best))

    def _verified(self) -> list[Plain]:
        """Best designs on finer grids, as far as they are known; studies of before 0.1.0 called it judged."""
        notes = self.store(lambda: self.kept.user_attrs)
        if VERIFIED in notes:
            return list(notes[VERIFIED])
        return [
            {key.replace("judged", "verified"): value for key, value in one.items()}
            for one in notes.get("judged", [])
        ]

    def verify_best(self) -> None:
        """Runs the best designs with the error that the study's scene requests, if it does. What is found is kept with the study."""
        if self.study.requested is None:
            return
        self.note("the best designs on finer grids")
        known = self._verified()
        best = report.nearest_first(self.finished())
        found = verified(
            self.study,
            best,
            lambda trial: self.evaluator.scene_of(trial.params),
            self.evaluator.solve,
            known,
        )
        self.store(lambda: self.kept.set_user_attr(VERIFIED, found))

    def mend_improvements(self) -> None:
        """Solves again those designs among the best so far that can't be read."""
        trials = {trial.number: trial for trial in self.finished()}
        for folder in sorted((self.out / records.IMPROVEMENTS).glob("[0-9]*")):
            trial = trials.get(int(folder.name)) if folder.name.isdigit() else None
            if trial is not None and not self.saved(trial, folder):
                shutil.rmtree(folder)  # a picture less, where it would stop all of them

    def saved(self, trial: FrozenTrial, folder: Path) -> bool:
        """Save the result of a trial in a folder, unless it is there; the trial is solved again for that.

        Parameters
        ----------
        trial : FrozenTrial
            The trial.
        folder : Path
            The folder.

        Returns
        -------
        bool
            True if the folder holds it.
        """
        if not records.holds(folder, trial):
            try:
                result = self.evaluator.evaluation.last_result(self.evaluator.solve, trial.params)
            except SolveError:
                return (
                    False  # it has been solved elsewhere; parameters and numbers stay in the report
                )
            drawn = {
                key: trial.user_attrs[key]
                for key in ("shapes", "catheter")
                if key in trial.user_attrs
            }
            records.save_design(folder, result, report.describe(trial) | drawn)
        return True

    def report(self, ended: report.Ended) -> StudyReport:
        """Report the study as it stands.

        Parameters
        ----------
        ended : report.Ended
            Why it is not running any more.

        Returns
        -------
        StudyReport
            The report.
        """
        trials = self.finished()
        chosen = report.best_trial(trials)
        stop = self.study.stop_rms
        first = next(
            (t for t in trials if stop is not None and report.feasible(t) and value_of(t) <= stop),
            None,
        )
        best = None if chosen is None else report.describe(chosen)
        return StudyReport(
            name=self.study.name,
            out=self.out,
            storage=shown_url(self.store.url),
            sampler=self.study.sampler,
            why_sampler=self.study.why_sampler,
            seed=self.study.seed,
            wanted=self.study.trials,
            stop_rms_m=self.study.stop_rms,
            trials=len(trials),
            failed=sum(not report.feasible(t) and not report.refused(t) for t in trials),
            refused=sum(report.refused(t) for t in trials),
            best=best,
            exchanged=sum(EXCHANGED in t.user_attrs for t in trials),
            warnings=report.on_the_brink(best),
            first_trial_below_stop=None if first is None else first.number,
            seconds_per_trial=report.seconds_per_trial(trials),
            ended=ended,
            rms_m=[t.user_attrs.get("rms_m", value_of(t)) for t in trials],
            measure_m=[value_of(t) for t in trials] if self.study.robust is not None else None,
            failed_trials=[k for k, t in enumerate(trials) if not report.feasible(t)],
            reasons=[
                t.user_attrs.get("reason") or "not told" for t in trials if not report.feasible(t)
            ],
            verified=self._verified(),
            study_file=str(self.study.path.resolve()),
            limits=(
                findings(self.study, self.space, trials)
                if self.study.sampler == "gauss-newton"
                else []
            ),
            front=(
                pareto_report(self.study.minimize, trials, report.feasible)
                if len(self.study.minimize) > 1
                else None
            ),
        )


def rerun(evaluator: Evaluator, store: Store, number: int) -> Plain:
    """Solve a trial again and compare.

    Parameters
    ----------
    evaluator : Evaluator
        Evaluates designs of its study.
    store : Store
        The study's storage.
    number : int
        Of the trial.

    Returns
    -------
    dict[str, Any]
        number, params, rms_m stored and again, and whether the bits agree.

    Raises
    ------
    InputError
        Where the storage has no such trial, or none that is finished.
    """
    must_exist(store.url, evaluator.out)
    storage = store.open()
    with storage_faults(store.url, store.timeout):
        evaluator.study = as_begun(evaluator.study, storage)
        try:
            kept = optuna.load_study(study_name=evaluator.study.name, storage=storage)
        except KeyError:
            raise InputError(
                shown_url(store.url),
                rule=f"holds no study named {evaluator.study.name}",
                remedy="name the --out or the --storage that it was run with",
            ) from None
        trials = {t.number: t for t in kept.get_trials(deepcopy=False)}
    trial = trials.get(number)
    if trial is None or trial.values is None:
        what = (
            "is not finished"
            if trial is not None
            else f"is not there; the study has {len(trials)}, numbered from 0"
        )
        remedy = "--trial 0, say" if trials else "run the study first"
        raise InputError(
            "--trial", received=str(number), rule=f"trial {number} {what}", remedy=remedy
        )
    outcome = evaluator.outcome(number, trial.params)
    stored = trial.user_attrs.get("rms_m", value_of(trial))
    now = outcome.rms
    return {
        "number": number,
        "params": dict(trial.params),
        "rms_m": now,
        "stored_rms_m": stored,
        "same": bool(stored == now and value_of(trial) == outcome.value),
        "reason": outcome.reason,
        "versions": trial.user_attrs.get("versions", {}),
        "versions_now": outcome.known["versions"],
        "files": [str(path) for path in outcome.files],
    }
