"""The search for a goal: trials that Optuna asks for, each a run with its measures, kept in a database and resumed from it."""

from __future__ import annotations

import math
import shutil
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState

from magmpm.compiled.arrays import NamedNumbers
from magmpm.compiled.process import Died
from magmpm.errors import InputError, MagmpmError, in_one_line, in_words
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.results.whole_file import write_json
from magmpm.scene import Scene
from magmpm.studies.engine.storage_url import shown_url, storage_url
from magmpm.studies.goals import Plain, evaluate
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.descend import Enough, Slopes, descend
from magmpm.studies.goals.evaluate import WHY
from magmpm.studies.goals.goal_file import GAUSS_NEWTON, SLSQP
from magmpm.studies.goals.goal_study import GoalStudy
from magmpm.studies.goals.report import REPORT, GoalReport
from magmpm.studies.goals.slopes import Derived, Near, shares, stencil, values_and_slopes
from magmpm.studies.problem.study import check_trials
from magmpm.studies.search.knobs import distributions, made
from magmpm.studies.search.objectives import told_factors
from magmpm.studies.search.samplers.choice import check_workers
from magmpm.studies.search.samplers.gauss_newton import GaussNewtonSampler
from magmpm.studies.search.samplers.gauss_newton_steps import Coordinates
from magmpm.studies.search.samplers.optuna_ids import set_constraints

if TYPE_CHECKING:
    from optuna import Study
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial, Trial

DEFINITION = "definition"
CONSTRAINTS = "constraints"  # at most 0 each where they hold
INTERRUPTED = "interrupted"
CONVERGED = "converged"
# of a trial along derivatives: the goal and what is left to each bound, and their derivatives
SLOPES = "slopes"
SKIPPED = "skipped"  # whether a pruned trial was not run, as it breaks a bound anyway
CONTACTS = ("ground", "walls", "self_contact")  # effects in which things touch


def sampler(study: GoalStudy, workers: int, designs: int) -> BaseSampler:
    """Optuna's sampler of a study, for the design after so many: each has a seed of its own, so a search that is resumed goes on alike."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    seed = (study.file.seed + 7919 * designs) % 2**32
    blocks = [block for knob in study.knobs for block in knob.blocks()]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return {
            "tpe": lambda: samplers.TPESampler(
                seed=seed, multivariate=True, constant_liar=workers > 1
            ),
            "gp": lambda: samplers.GPSampler(seed=seed),
            "cmaes": lambda: samplers.CmaEsSampler(seed=seed),
            "nsga2": lambda: samplers.NSGAIISampler(seed=seed),
            "random": lambda: samplers.RandomSampler(seed=seed),
            GAUSS_NEWTON: lambda: GaussNewtonSampler(blocks, seed=study.file.seed),
            SLSQP: lambda: samplers.RandomSampler(seed=seed),  # every trial is enqueued
        }[study.sampler]()


def search(
    study: GoalStudy,
    out: Path,
    *,
    trials: int | None = None,
    workers: int | None = None,
    storage: str | None = None,
    on_trial: Callable[[str], None] | None = None,
) -> GoalReport:
    """Run or resume a search, with results in the folder `out`. Raises InputError where another study is there, and for numbers of trials
    and workers that can't be."""
    import optuna

    check_trials(trials)
    check_workers(workers)
    workers = workers or 1

    from magmpm.results.folder_lock import folder_lock

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    out.mkdir(parents=True, exist_ok=True)
    url = storage_url(out, storage)
    with folder_lock(out):
        known = optuna.create_study(
            study_name=study.name,
            storage=url,
            sampler=sampler(study, workers, 0),
            pruner=optuna.pruners.MedianPruner(n_startup_trials=5),
            directions=study.directions,
            load_if_exists=True,
        )
        _same(known, study, out)
        at_once = 1 if study.sampler in (SLSQP, GAUSS_NEWTON) else workers  # steps are one by one
        seeking = _Seeking(study, out, known, at_once, on_trial, shown_url(url))
        return seeking.run(trials or study.file.trials)


def _same(known: Study, study: GoalStudy, out: Path) -> None:
    """Raises InputError where the database holds trials of another definition; ends trials that nobody runs."""
    from optuna.exceptions import ExperimentalWarning

    before = known.user_attrs.get(DEFINITION)
    if before is not None and before != study.definition:
        raise InputError(
            str(out),
            received="trials of another definition of this study",
            rule="a search continues with the same scene, variables, goals, constraints and files of"
            " `python:` functions",
            remedy="give another folder, `--out DIR`, or remove this one",
        )
    if before is None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            known.set_metric_names([label for label, _ in study.shown])
        if study.sampler != SLSQP:  # which begins there by itself
            known.enqueue_trial(study.begun, skip_if_exists=True)  # the scene as it is
        # last: a kill before it leaves a study that the next run begins again
        known.set_user_attr(DEFINITION, study.definition)
    for trial in known.get_trials(states=(TrialState.RUNNING,), deepcopy=False):
        known.tell(trial.number, state=TrialState.FAIL)
        if study.sampler != SLSQP:
            known.enqueue_trial(trial.params)  # its design is tried again
        evaluate.forget(out / f"trial_{trial.number}")


class _Hopeless(Exception):
    """A trial that does worse than others at the same time."""


@dataclass
class _Seeking:
    """A search that runs."""

    study: GoalStudy
    out: Path
    known: Study
    workers: int
    on_trial: Callable[[str], None] | None
    shown: str  # the storage, without a password
    written: float = -math.inf  # when the report was, s
    wanted: int = 0  # trials in all

    def run(self, count: int) -> GoalReport:
        """Trials until there are `count`, then the best on more cells."""
        self.wanted = count
        self._keep()
        ended = "done"
        running: dict[Future[Plain], tuple[Trial, evaluate.Job]] = {}
        with ExitStack() as stack:
            pool = (
                stack.enter_context(evaluate.Processes(self.workers)) if self.workers > 1 else None
            )
            try:
                if self.study.sampler == SLSQP:
                    self._descend(count)
                    count = 0
                if self.known.user_attrs.get(CONVERGED):
                    count = 0
                while (left := count - self._finished() - len(running)) > 0 or running:
                    while left > 0 and len(running) < self.workers:
                        left -= 1
                        begun = self._begun()
                        if begun is None:
                            continue
                        trial, job = begun
                        if pool is None:
                            self._tell(trial, job, self._here(trial, job))
                            if self.known.user_attrs.get(CONVERGED):
                                return self._ended(ended, pool)
                        else:
                            running[pool.submit(evaluate.tried, job)] = (trial, job)
                    for done in wait(running, return_when=FIRST_COMPLETED)[0] if running else ():
                        trial, job = running.pop(done)
                        try:
                            outcome = done.result()
                        except Died as death:  # killed, by the system for its memory perhaps
                            outcome = {WHY: f"the process that ran it {death}"}
                        self._tell(trial, job, outcome)
            except KeyboardInterrupt:
                ended = INTERRUPTED
                for future in running:
                    future.cancel()
            return self._ended(ended, pool)

    def _ended(self, ended: str, pool: evaluate.Processes | None) -> GoalReport:
        """The report of a search that has ended, with the checks of its best."""
        report = self._report(ended)
        if ended == "done" and report.best is not None:
            report.finer = self._finer(report.best)
            report.scatter = self._scatter(report.best, pool)
        write_json(self.out / REPORT, report.summary(), indent=1)
        return report

    def _descend(self, count: int) -> None:
        """Steps along derivatives, from the scene; each is a trial. Those that are stored are not run again, so a search goes on with the
        next step, and with all that its steps had learned."""
        ranges: Any = distributions(self.study.knobs)  # all of them are smooth
        stored = {
            tuple(trial.params[name] for name in ranges): trial.user_attrs.get(SLOPES)
            for trial in self.known.get_trials(deepcopy=False)
            if SLOPES in trial.user_attrs or WHY in trial.user_attrs
        }

        def tried(params: NamedNumbers) -> Slopes | None:
            at = tuple(params.values())
            if at not in stored:
                if self._finished() >= count:
                    raise Enough
                stored[at] = self._with_slopes(params, ranges)
            rows = stored[at]
            return None if rows is None else (np.array(rows[0]), np.array(rows[1]))

        if self.known.user_attrs.get(CONVERGED):
            return
        with suppress(Enough):
            descend(ranges, self.study.begun, tried, steps=count)
            self.known.set_user_attr(CONVERGED, True)

    def _missed(self, found: dict[str, Derived]) -> Slopes:
        """Gaps to the targets, with their slopes: to a point that must be reached three components."""
        values = []
        slopes = []
        for at, target in zip(self.study.measures, self.study.targets, strict=False):
            assert target is not None  # of targets alone
            one = found[at]
            if target == 0.0 and one.parts is not None:
                values.append(one.parts[0])
                slopes.append(one.parts[1])
            else:
                values.append(np.array([one.value - target]))
                slopes.append(one.slope[None])
        return np.concatenate(values), np.concatenate(slopes)

    def _rows(self, found: dict[str, Derived]) -> Slopes:
        """The goal, to be small, and what is left to each bound, with their slopes."""
        if self.study.file.targets_alone:
            missed, slope = self._missed(found)
            values = [float(missed @ missed)]
            slopes = [2.0 * missed @ slope]
        else:
            goal = self.study.file.goals[0]
            one = found[f"goal[0].{goal.key}"]
            sign = -1.0 if goal.key == "maximize" else 1.0
            values = [sign * one.value]
            slopes = [sign * one.slope]
        for at, (least, most) in self.study.bounded.items():
            if least is not None:
                values.append(found[at].value - least)
                slopes.append(found[at].slope)
            if most is not None:
                values.append(most - found[at].value)
                slopes.append(-found[at].slope)
        return np.array(values), np.array(slopes)

    def _with_slopes(
        self, params: NamedNumbers, ranges: dict[str, FloatDistribution]
    ) -> list[Any] | None:
        """The rows of a trial with these parameters, whose measures get derivatives; None where it fails."""
        self.known.enqueue_trial(params)
        begun = self._begun()
        while begun is not None and begun[0].params != params:  # one that a killed session left
            self.known.tell(begun[0], state=TrialState.FAIL)
            begun = self._begun()
        if begun is None:
            return None
        trial, job = begun
        near = [stencil(params, name, space) for name, space in ranges.items()]
        try:
            found = self._derived(trial, job, near)
        except MagmpmError as error:
            self._tell(trial, job, {WHY: in_one_line(error)})
            return None
        rows = [part.tolist() for part in self._rows(found)]
        trial.set_user_attr(SLOPES, rows)
        self._tell(trial, job, {"values": {at: one.value for at, one in found.items()}})
        return rows

    def _derived(self, trial: Trial, job: evaluate.Job, near: Near) -> dict[str, Derived]:
        """The measures of a trial, with derivatives along ways near it. Raises MagmpmError."""
        return values_and_slopes(
            lambda some: made(self.study.scene, self.study.knobs, some),
            [place for knob in self.study.knobs for place in knob.places],
            trial.params,
            near,
            job.measures,
            job.folder,
        )

    def _with_residuals(self, trial: Trial, job: evaluate.Job, enough: float = 1e-7) -> Plain:
        """The outcome of a trial of Gauss-Newton's sampler, which reads what its targets miss by, and the derivatives, from the trial.

        enough: of what a unit of all its numbers moves, where the targets are met.
        """
        space = Coordinates([block for knob in self.study.knobs for block in knob.blocks()])
        x = space.read(trial.params)
        basis, low, high = space.tangent(x)
        near = [
            [
                (share, space.write(space.moved(x, way * step)))
                for way, share in shares(0.0, low[k], high[k])
            ]
            for k, step in enumerate(np.eye(len(low)))
        ]
        found = self._derived(trial, job, near)
        missed, slopes = self._missed(found)
        trial.set_user_attr("residuals", missed.tolist())
        trial.set_user_attr("jacobian", (slopes @ np.linalg.pinv(basis)).tolist())
        if np.linalg.norm(missed) <= enough * np.linalg.norm(slopes):
            self.known.set_user_attr(CONVERGED, True)
        return {at: one.value for at, one in found.items()}

    def _begun(self) -> tuple[Trial, evaluate.Job] | None:
        """A new trial and its run; None where its values together break a rule of the scene."""
        designs = sum(
            t.state.name != "FAIL" or WHY in t.user_attrs
            for t in self.known.get_trials(deepcopy=False)
            if t.state.name != "WAITING"
        )
        self.known.sampler = sampler(self.study, self.workers, designs)
        trial = self.known.ask(distributions(self.study.knobs))
        folder = self.out / f"trial_{trial.number}"
        try:
            scene = made(self.study.scene, self.study.knobs, trial.params)
        except InputError as error:
            self._ended_early(trial, {WHY: in_one_line(error)})
            return None
        return trial, self._job(scene, folder, bounds=self.study.bounded)

    def _here(self, trial: Trial, job: evaluate.Job) -> Plain:
        """The outcome of a run in this process, which may be pruned on its way."""
        try:
            if self.study.sampler == GAUSS_NEWTON:
                return {"values": self._with_residuals(trial, job)}
            return evaluate.tried(job, self._pruner(trial, job) if self.study.file.prune else None)
        except _Hopeless:
            return {"pruned": True}
        except MagmpmError as error:
            return {WHY: in_one_line(error)}

    def _pruner(self, trial: Trial, job: evaluate.Job) -> evaluate.Progress:
        """Return what a motion calls as it goes on: it raises _Hopeless where the goal so far is worse than that of half the trials."""
        parts_of_motion = 10  # of a motion's time, after each of which a trial may be pruned
        seen = 0
        key = next(iter(job.measures))
        target = self.study.targets[0]

        def look(step: int, now: float) -> None:
            nonlocal seen
            part = int(parts_of_motion * now / job.scene.duration)
            if part <= seen or part >= parts_of_motion:
                return
            seen = part
            with suppress(MagmpmError):  # no frame yet, none that is whole, or too few to measure
                motion = Motion.load(job.folder)
                if len(motion) < 2:
                    return
                answer = Answer(job.scene, None, motion)
                value = job.measures[key].of_answer(answer, key, job.functions)
                trial.report(
                    self._told([value if target is None else abs(value - target)])[0], part
                )
                if trial.should_prune():
                    raise _Hopeless

        return look

    def _tell(self, trial: Trial, job: evaluate.Job, outcome: Plain) -> None:
        """Store a trial's outcome, and keep its run if it is the best."""
        if "values" in outcome:
            values, beyond = self.study.values(outcome["values"])
            trial.set_user_attr("measures", outcome["values"])
            trial.set_user_attr(CONSTRAINTS, beyond)
            set_constraints(trial, beyond)
            self.known.tell(trial, self._told(values))
            self._keep()
        else:
            self._ended_early(trial, outcome)
        evaluate.forget(job.folder)
        if time.perf_counter() - self.written > 5.0:  # for the dashboard
            write_json(self.out / REPORT, self._report("running").summary(), indent=1)
            self.written = time.perf_counter()
        self._note(self._line(trial.number, outcome))

    def _keep(self) -> None:
        """Keep the run of the best trial, if that is new; or was, when a session was killed."""
        best = self._best()
        if best is None:
            return
        run = self.out / f"trial_{best.number}"
        if not run.exists():
            return
        scene = made(self.study.scene, self.study.knobs, best.params)
        with suppress(InputError):  # a scene with a table that a file names stays in best/
            name = f"{scene.name}, {self.study.name}"[:100]
            Scene.from_si({**scene.to_si(), "name": name}).save(self.out / "best.yaml")
        evaluate.forget(self.out / "best")
        shutil.move(run, self.out / "best")  # last: until then the next session finds it

    def _told(self, values: Sequence[float]) -> list[float]:
        """Values as trials of this study are told."""
        factors = told_factors(self.known, self.study.shown) or [1.0] * len(values)
        return [value * factor for value, factor in zip(values, factors, strict=True)]

    def _values(self, trial: FrozenTrial) -> list[float]:
        """Values of a complete trial in SI."""
        return self.study.values(trial.user_attrs["measures"])[0]

    def _ended_early(self, trial: Trial, outcome: Plain) -> None:
        """Store that a trial failed, and why, or was pruned."""
        numbers = outcome.get("beyond", {})
        beyond = self.study.beyond(numbers)
        set_constraints(trial, beyond)
        trial.set_user_attr(CONSTRAINTS, beyond)
        trial.set_user_attr("measures", numbers or outcome.get("known", {}))
        if WHY not in outcome:
            trial.set_user_attr(SKIPPED, "beyond" in outcome)
            self.known.tell(trial, state=TrialState.PRUNED)
            return
        trial.set_user_attr(WHY, outcome[WHY])
        self.known.tell(trial, state=TrialState.FAIL)

    def _note(self, text: str) -> None:
        if self.on_trial is not None:
            self.on_trial(text)

    def _line(self, number: int, outcome: Plain) -> str:
        head = f"trial {number}, {self._finished()} of {self.wanted}: "
        if "values" not in outcome:
            return head + (
                f"failed: {outcome[WHY]}"
                if WHY in outcome
                else "not run: violates a bound anyway"
                if "beyond" in outcome
                else "pruned"
            )
        said = ", ".join(
            in_words(label, value)
            for label, value in zip(
                self.study.names, self.study.values(outcome["values"])[0], strict=True
            )
        )
        best = self._best()
        return f"{head}{said}" + (
            ", the best" if best is not None and best.number == number else ""
        )

    def _ran(self) -> list[FrozenTrial]:
        return [
            trial
            for trial in self.known.get_trials(deepcopy=False)
            if trial.state.is_finished() and (trial.state.name != "FAIL" or WHY in trial.user_attrs)
        ]

    def _finished(self) -> int:
        return len(self._ran())

    def _best(self) -> FrozenTrial | None:
        """The best trial that was run: one that keeps all bounds, else the one that is least beyond them; of several goals by the first."""
        return self._least(self.known.get_trials(states=(TrialState.COMPLETE,), deepcopy=False))

    def _least(self, trials: Sequence[FrozenTrial]) -> FrozenTrial | None:
        """The best of trials, as above."""
        sign = -1.0 if self.study.file.goals[0].key == "maximize" else 1.0

        def rank(trial: FrozenTrial) -> tuple[float, float, int]:
            beyond = trial.user_attrs.get(CONSTRAINTS) or [0.0]
            value = sign * (trial.values or [0.0])[0]
            return sum(max(one, 0.0) for one in beyond), value, trial.number

        return min(trials, key=rank, default=None)

    def _shown(self, trial: FrozenTrial) -> Plain:
        return {
            "number": trial.number,
            "measures": trial.user_attrs["measures"],
            "values": self._values(trial),
            "params": dict(trial.params),
            "feasible": _keeps(trial),
        }

    def _report(self, ended: str) -> GoalReport:
        finished = self._ran()
        ends = [_end(t) for t in finished]
        took = [t.duration.total_seconds() for t in finished if t.duration and t.values]
        best = self._best()
        near = best or self._least([t for t in finished if t.user_attrs.get(SKIPPED)])
        return GoalReport(
            name=self.study.name,
            goals=self.study.names,
            trials=len(finished),
            values=[self._values(t) if t.state.name == "COMPLETE" else None for t in finished],
            feasible=[t.state.name == "COMPLETE" and _keeps(t) for t in finished],
            ends=ends,
            best=None if best is None else self._shown(best),
            nearest=None if near is None else near.number,
            pareto=[self._shown(t) for t in self.known.best_trials]
            if self.study.file.several
            else [],
            failed=[
                {
                    "number": t.number,
                    "why": t.user_attrs[WHY],
                    "params": dict(t.params),
                    "measures": t.user_attrs["measures"],
                }
                for t in finished
                if WHY in t.user_attrs
            ],
            pruned=ends.count("pruned"),
            skipped=ends.count("not run"),
            limits=self.study.limits({} if near is None else near.user_attrs["measures"]),
            begun={
                name: value
                for knob in self.study.knobs
                for name, value in knob.own(self.study.scene).items()
            },
            tied={
                name: knob.tied
                for knob in self.study.knobs
                if knob.tied > 1
                for name in knob.distributions()
            },
            study_file=str(self.study.path.resolve()),
            sampler=self.study.sampler,
            why_sampler=self.study.why_sampler,
            storage=self.shown,
            seconds_per_trial=float(np.median(took)) if took else 0.0,
            ended=ended,
            warnings=[] if best is None else Result.load(self.out / "best").warnings,
            out=self.out,
        )

    def _known_of(self, key: str, best: Plain) -> Plain | None:
        """Findings about the best trial that are stored under a key; None where they are of another one."""
        stored: Plain = self.known.user_attrs.get(key, {})
        return stored if stored.get("number") == best["number"] else None

    def _finer(self, best: Plain) -> Plain:
        """The best design's measures on one more cell across, once for each best."""
        stored = self._known_of("finer", best)
        if stored is not None:
            return stored
        scene = Scene.from_si(Result.load(self.out / "best").scene)
        cells = round(scene.thickness / scene.cell) + 1
        found: Plain = {"number": best["number"], "cells_across": cells}
        self._note(f"the best on {cells} cells across")
        try:
            outcome = evaluate.tried(self._job(scene.with_cells(cells), self.out / "finer"))
        except InputError as error:  # cells that do not fit the body
            outcome = {WHY: in_one_line(error)}
        if WHY in outcome:
            found[WHY] = outcome[WHY]
        else:
            found["measures"] = outcome["values"]
            found["values"] = self.study.values(found["measures"])[0]
        self.known.set_user_attr("finer", found)
        return found

    def _scatter(
        self,
        best: Plain,
        pool: evaluate.Processes | None,
        runs: int = 4,
        nearness: float = 1e-4,
    ) -> Plain | None:
        """Values of some designs so near to the best that they should be the same: what differs is noise; None where nothing touches.

        nearness: way of each number at random up or down, of its range.
        """
        named = self.study.scene.effects.named()
        if self.study.scene.solver.dynamic is None or not {*CONTACTS} & {*named}:
            return None
        stored = self._known_of("scatter", best)
        if stored is not None:
            return stored
        self._note("designs near the best, for their noise")
        spaces = self.known.get_trials(deepcopy=False)[best["number"]].distributions
        random = np.random.default_rng(self.study.file.seed)
        jobs = []
        for k in range(runs):
            params = {
                name: _moved(value, spaces[name], nearness * random.choice([-1.0, 1.0]))
                for name, value in best["params"].items()
            }
            scene = made(self.study.scene, self.study.knobs, params)
            jobs.append(self._job(scene, self.out / f"near_{k}"))
        each = map(evaluate.tried, jobs) if pool is None else pool.map(evaluate.tried, jobs)
        values = [self.study.values(of["values"])[0] if "values" in of else None for of in each]
        found = {"number": best["number"], "nearness": nearness, "values": values}
        for job in jobs:
            evaluate.forget(job.folder)
        self.known.set_user_attr("scatter", found)
        return found

    def _job(self, scene: Scene, folder: Path, **more: Any) -> evaluate.Job:
        """The run of a scene in a folder, with the measures of the study."""
        return evaluate.Job(scene, folder, self.study.measures, self.study.path.parent, **more)


def _end(trial: FrozenTrial) -> str:
    """End of a trial: done, failed, pruned, or not run, as it breaks a bound anyway."""
    if trial.state.name == "COMPLETE":
        return "done"
    if trial.state.name == "FAIL":
        return "failed"
    return "not run" if trial.user_attrs.get(SKIPPED) else "pruned"


def _keeps(trial: FrozenTrial) -> bool:
    """True if a trial keeps all constraints."""
    return all(one <= 0.0 for one in trial.user_attrs.get(CONSTRAINTS) or ())


def _moved(value: Any, space: Any, share: float) -> Any:
    """A parameter moved by a share of its range; what is no real number stays."""
    if not isinstance(space, FloatDistribution):
        return value
    return float(min(max(value + share * (space.high - space.low), space.low), space.high))
