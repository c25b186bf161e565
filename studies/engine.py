"""The study itself: ask for a design, solve, compare, keep, until it is good enough or the trials are used up.

One trial at a time, by Optuna's ask and tell. A trial depends only on the study's definition, its seed and the earlier trials. A process
may end at any moment; the next one continues as if nothing had happened.
"""

from __future__ import annotations

import dataclasses
import shutil
import statistics
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from magmpm.errors import InputError, SolveError
from magmpm.results.folder_lock import folder_lock
from magmpm.results.whole_file import REFUSED, explained
from studies import records, report
from studies.best_scene import write_best_scene
from studies.definition import Study
from studies.insertion import Insertion, shapes_of
from studies.judged import judged
from studies.limited_designs import improved
from studies.linear_model import Differentiate, needs_derivatives, solve_with_derivatives
from studies.objectives import pareto_report, trial_values
from studies.reach import findings
from studies.report import StudyReport
from studies.rod_designs import rod_starts
from studies.samplers import check_available, check_suits, make_sampler, settings
from studies.schedule import Schedule
from studies.search_space import SearchSpace
from studies.storage import (
    TIMEOUT,
    StorageError,
    claim_folder,
    must_exist,
    must_hold,
    open_storage,
    open_study,
    shown_url,
    storage_faults,
    storage_url,
)
from studies.trial import Outcome, Solve, Trial, attributes, constraints, evaluate
from studies.well_posed import check_search

if TYPE_CHECKING:
    import optuna
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial

    from magmpm.results.result import Result
    from magmpm.scene import Scene

FAILURES = "failures.log"
JUDGED = "judged"  # attribute of a study: its best designs on finer grids
STARTS = "starts"  # attribute of a study: the rod's designs
REMEMBERED = 50  # durations of trials by which the time left is guessed


class Picture(Protocol):
    """Draws a trial's result to a file; returns the file (another ending is fine). What it raises never harms the trial."""

    def __call__(self, result: Result, path: Path, trial: Trial) -> Path: ...


def check_study(study: Study) -> list[str]:
    """What the search of a study should know, one sentence each. Raises InputError where its sampler can't search it, or nothing can."""
    check_available(study.sampler)
    check_suits(study)
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
) -> StudyReport:
    """Runs a study to its end, or resumes it; returns at once when it is done.

    solve: from scene to Result; what it raises costs the trial the penalty. differentiate: solves with derivatives, for the samplers that
    use them (magmpm.sensitivities); ValueError where it is missing. trials, sampler: in place of the study's; trials
    counts all trials, including those of earlier runs; if it is given, the study runs that many, past its `stop` too. After an interrupt
    (Ctrl-C) everything finished is kept. on_advice: called before the first trial with what a user should know of the search.
    Raises InputError for a changed definition, an unusable sampler or storage, and if another process writes to the folder;
    StorageError when the database is locked or gone.
    """
    study = study.changed(trials=trials, sampler=sampler)
    advice = check_study(study)
    if needs_derivatives(study) and differentiate is None:
        raise ValueError("differentiate: gauss-newton and robust need derivatives; pass magmpm.sensitivities")
    if on_advice is not None:
        on_advice(advice)
    folder = Path(out)
    url = storage_url(folder, storage)
    with folder_lock(folder), _trials_kept(url):
        claim_folder(folder, study.name)
        run = _Run(study, folder, url, storage_timeout, differentiate)
        ended = run.to_the_end(solve, picture, on_trial, study.stop_rms if trials is None else None)
        if ended != "interrupted":
            run.keep_best(solve)
        summary = dataclasses.replace(run.report(ended), warnings=advice)
        summary.save()
    return summary


def kernel_uses(study: Study) -> list[str]:
    """What a study's kernels are for (magmpm.precompile): derivatives and families of rods only where it uses them."""
    rods = study.sampler == "gauss-newton" or study.start == "rod" or bool(study.depths or study.keyframes)
    return ["solve", *["sensitivities"] * needs_derivatives(study), *["rods"] * rods]


@contextmanager
def _trials_kept(url: str) -> Iterator[None]:
    """A file that can't be written ends a study, with its trials kept. Raises StorageError, or InputError where the place is wrong."""
    try:
        yield
    except OSError as error:
        kind = InputError if error.errno in REFUSED else StorageError
        kept = f", then run this command again: the finished trials are kept in {shown_url(url)}, and it resumes"
        raise kind(explained(error, kept)) from None


class _Run:
    """A study that is open in this process."""

    def __init__(self, study: Study, out: Path, url: str, timeout: float, differentiate: Differentiate | None) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.study, self.out, self.url, self.timeout, self.differentiate = study, out, url, timeout, differentiate
        self.space = SearchSpace.of(study)
        self.trajectory = Insertion.of(study, self.space) or Schedule.of(study, self.space)
        self.distributions = self.space.distributions()
        search = {"parameters": list(self.distributions), **settings(study.sampler)}
        held = records.designs(out)
        if held:
            must_exist(url, out)
        self.storage = open_storage(url, timeout)
        must_hold(self.storage, study.name, held, out, url, timeout)
        definition = {**study.definition(), "search": search}
        self.kept = open_study(self.storage, study, definition, out, url, timeout)
        self.starts = self.rod_starts()
        self.gallery = records.Gallery(out, self.storage)
        finished = self.finished()
        best = report.best_trial(finished)
        self.count, self.best = len(finished), None if best is None else best.values[0]
        self.durations = [t.user_attrs["seconds"]["total"] for t in finished if "seconds" in t.user_attrs]

    def finished(self) -> list[FrozenTrial]:
        """Finished trials in order."""
        from optuna.trial import TrialState

        with storage_faults(self.url, self.timeout):
            return list(self.kept.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))

    def rod_starts(self) -> list[dict[str, float]]:
        """The rod's best designs, if this study begins with them. They are found once and kept with the study."""
        if self.study.sampler != "gauss-newton" and self.study.start is None:
            return []
        with storage_faults(self.url, self.timeout):
            if STARTS not in self.kept.user_attrs:
                if self.trajectory is not None:
                    starts = self.trajectory.rod_starts()
                else:
                    starts = rod_starts(self.space, self.study.target, self.study.seed)
                    starts = improved(self.space, self.study.target, starts)
                self.kept.set_user_attr(STARTS, starts)
            return list(self.kept.user_attrs[STARTS])

    def queue_start(self) -> None:
        """Makes the rod's next design the next trial, for samplers that do not begin from the rod's designs by themselves.

        Only as it is due, so that a trial's number says which design it has: `ask` takes what waits before it asks the sampler.
        """
        from optuna.trial import TrialState

        due = self.study.start == "rod" and self.study.sampler != "gauss-newton" and self.count < len(self.starts)
        if due and not self.kept.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            self.kept.enqueue_trial(self.starts[self.count], user_attrs={"start": "rod"})

    def to_the_end(
        self,
        solve: Solve,
        picture: Picture | None,
        on_trial: Callable[[Trial], None] | None,
        stop: float | None,
    ) -> report.Ended:
        """Runs the remaining trials, or until one comes within `stop`, m. Returns why it ended."""
        while True:
            if stop is not None and self.best is not None and self.best <= stop:
                return "stop"
            if self.count >= self.study.trials:
                return "trials"
            try:
                trial = self.one_trial(solve, picture)
                if on_trial is not None:
                    on_trial(trial)
            except KeyboardInterrupt:
                return "interrupted"

    def one_trial(self, solve: Solve, picture: Picture | None) -> Trial:
        """Asks for a design, solves it and reports its distance. An interrupt puts the trial back into the queue."""
        begun = time.perf_counter()
        with storage_faults(self.url, self.timeout):
            self.kept.sampler = self.sampler()
            self.queue_start()
            asked = self.kept.ask(self.distributions)
        try:
            scene = self.scene_of(asked.params)
            outcome = self.outcome(solve, asked.params, scene)
            known = attributes(
                outcome, scene, self.space.directions(asked.params), self.space.field(asked.params)
            )
            known |= self.space.quantities(asked.params)
            return self.keep(asked, outcome, known, picture, begun)
        except KeyboardInterrupt:
            self.put_back(asked)
            raise

    def scene_of(self, params: Mapping[str, Any]) -> Scene:
        """The scene of a trial; of an insertion that of its last depth, of a schedule that of its last time."""
        return self.space.scene_of(params) if self.trajectory is None else self.trajectory.scenes(params)[-1]

    def outcome(self, solve: Solve, params: Mapping[str, Any], scene: Scene) -> Outcome:
        """A trial's outcome, with what its sampler reads."""
        if self.trajectory is not None:
            differentiate = self.differentiate if self.study.sampler == "gauss-newton" else None
            return self.trajectory.evaluate(solve, differentiate, params, self.out / FAILURES)
        return evaluate(self.solved(solve, params), scene, self.study.target, self.out / FAILURES, self.study.margin)

    def sampler(self) -> BaseSampler:
        """What chooses the next trial."""
        study, insertion = self.study, self.trajectory
        if isinstance(insertion, Insertion) and insertion.projects and study.sampler != "gauss-newton":
            from studies.projected import FieldsByRod

            return FieldsByRod(make_sampler(study.sampler, insertion.directions_alone(), study.seed, self.count), insertion)
        return make_sampler(study.sampler, self.space, study.seed, self.count, starts=self.starts, goal=study.stop_rms or 0.0)

    def solved(self, solve: Solve, params: Mapping[str, Any]) -> Callable[[Scene], Any]:
        """How the trial with these parameters is solved: with derivatives where they are read."""
        differentiate = self.differentiate
        if differentiate is None or not needs_derivatives(self.study):
            return solve
        return lambda scene: solve_with_derivatives(differentiate, scene, self.study, self.space, params)

    def put_back(self, asked: optuna.Trial) -> None:
        """Lets `ask` take up this trial again, with the same number and parameters, unless it has ended."""
        from optuna.trial import TrialState

        with storage_faults(self.url, self.timeout):
            if not self.storage.get_trial(asked._trial_id).state.is_finished():
                self.storage.set_trial_state_values(asked._trial_id, state=TrialState.WAITING)

    def keep(
        self,
        asked: optuna.Trial,
        outcome: Outcome,
        known: dict[str, Any],
        picture: Picture | None,
        begun: float,
    ) -> Trial:
        """Keeps a trial's result, picture and attributes, and tells its value last: only then does it count."""
        result = outcome.result
        improved = outcome.accepted and (self.best is None or outcome.value < self.best)
        best = outcome.value if improved else self.best
        trial = Trial(
            asked.number,
            outcome.value,
            outcome.tip_error,
            best,
            improved,
            outcome.reason,
            self.study.target,
            shapes=shapes_of(outcome.model),
        )
        solved = time.perf_counter()
        if result is not None and picture is not None:
            note = self.gallery.add(asked, lambda path: picture(result, path, trial))
            known |= {} if note is None else {"picture_note": note}
        drawn = time.perf_counter()
        if result is not None and improved:
            design = {"number": asked.number, "rms_m": outcome.rms, "params": asked.params, **known}
            records.save_design(self.out / records.IMPROVEMENTS / f"{asked.number:03d}", result, design)
        with storage_faults(self.url, self.timeout):
            for key, value in known.items():
                asked.set_user_attr(key, value)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "already set": by the process that was killed in this trial
                for key, value in constraints(outcome, self.study.margin).items():
                    asked.set_constraint(key, value)
            # `total` lacks itself and the value; report.seconds_per_trial has all of a trial
            seconds = {"solve": outcome.seconds, "render": drawn - solved, "total": time.perf_counter() - begun}
            asked.set_user_attr("seconds", seconds)
            self.kept.tell(asked, trial_values(self.study.minimize, self.space, asked.params, outcome.value, not outcome.accepted))
        self.count, self.best = self.count + 1, best
        self.durations.append(time.perf_counter() - begun)
        del self.durations[:-REMEMBERED]
        left = statistics.median(self.durations) * max(self.study.trials - self.count, 0)
        return dataclasses.replace(
            trial,
            finished=self.count,
            wanted=self.study.trials,
            seconds=self.durations[-1],
            seconds_left=left,
        )

    def keep_best(self, solve: Solve) -> None:
        """Makes sure that OUT/best holds the best trial and its scene; solves it again if its result is not in this folder."""
        best = report.best_trial(self.finished())
        if best is None:
            return
        self.mend_improvements(solve)
        if not records.holds(self.out / records.BEST, best):
            self.replace_best(best, solve)
        self.judge(solve)
        if records.holds(self.out / records.BEST, best):
            if isinstance(self.trajectory, Insertion):
                self.trajectory.keep_best(self.out / records.BEST, solve, best.params)
                return
            write_best_scene(self.out / records.BEST, self.study, self.space, report.describe(best))

    def judge(self, solve: Solve) -> None:
        """Runs the best designs with the error that the study's scene asks for, if it does. What is found is kept with the study."""
        if self.study.asked is None:
            return
        with storage_faults(self.url, self.timeout):
            known = self.kept.user_attrs.get(JUDGED, [])
            found = judged(self.study, report.nearest_first(self.finished()), lambda trial: self.scene_of(trial.params), solve, known)
            self.kept.set_user_attr(JUDGED, found)

    def mend_improvements(self, solve: Solve) -> None:
        """Solves again those designs among the best so far that can't be read."""
        trials = {trial.number: trial for trial in self.finished()}
        for folder in sorted((self.out / records.IMPROVEMENTS).glob("[0-9]*")):
            trial = trials.get(int(folder.name)) if folder.name.isdigit() else None
            if trial is None or records.holds(folder, trial):
                continue
            try:
                records.save_design(folder, self.solved_again(solve, trial), report.whole_design(trial))
            except SolveError:
                shutil.rmtree(folder)  # a picture less, where it would stop all of them

    def replace_best(self, best: FrozenTrial, solve: Solve) -> None:
        """Puts the best trial's result into OUT/best."""
        source = self.out / records.IMPROVEMENTS / f"{best.number:03d}"
        if not records.holds(source, best):
            try:
                result = self.solved_again(solve, best)
            except SolveError:
                return  # it has been solved elsewhere; parameters and numbers stay in the report
            records.save_design(source, result, report.whole_design(best))
        records.replace_folder(source, self.out / records.BEST)

    def solved_again(self, solve: Solve, trial: FrozenTrial) -> Result:
        """The result of a trial; of an insertion or a schedule that of its end. Raises SolveError."""
        return solve(self.scene_of(trial.params)) if self.trajectory is None else self.trajectory.last_result(solve, trial.params)

    def report(self, ended: report.Ended) -> StudyReport:
        """The study as it stands."""
        trials = self.finished()
        best, first = report.best_trial(trials), report.first_below(trials, self.study.stop_rms)
        return StudyReport(
            name=self.study.name,
            out=self.out,
            storage=shown_url(self.url),
            sampler=self.study.sampler,
            seed=self.study.seed,
            wanted=self.study.trials,
            stop_rms_m=self.study.stop_rms,
            trials=len(trials),
            failed=sum(not report.feasible(t) and not report.refused(t) for t in trials),
            refused=sum(report.refused(t) for t in trials),
            best=None if best is None else report.describe(best),
            first_trial_below_stop=None if first is None else first.number,
            seconds_per_trial=report.seconds_per_trial(trials),
            ended=ended,
            rms_m=[t.user_attrs.get("rms_m", t.values[0]) for t in trials],
            measure_m=[t.values[0] for t in trials] if self.study.robust is not None else None,
            failed_trials=[k for k, t in enumerate(trials) if not report.feasible(t)],
            reasons=[t.user_attrs.get("reason") or "not told" for t in trials if not report.feasible(t)],
            judged=self.kept.user_attrs.get(JUDGED, []),
            study_file=str(self.study.path.resolve()),
            limits=findings(self.study, self.space, trials) if self.study.sampler == "gauss-newton" else [],
            front=pareto_report(self.study.minimize, trials, report.feasible) if len(self.study.minimize) > 1 else None,
        )
