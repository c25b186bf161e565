"""One run of a scene and its measures, here or in another process."""

from __future__ import annotations

import operator
import shutil
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from magmpm.compiled.process import Died, Process, threads_each, with_threads
from magmpm.errors import InputError, MagmpmError, in_one_line
from magmpm.inputs import quantities
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.studies.goals import Bounds, Plain
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.measures import Measure

WHY = "failed"  # key of a reason
Progress = Callable[[int, float], None]  # called with the number of a step, and the time (s)


@dataclass(frozen=True)
class Job:
    """A scene, the folder of its run, measures by name, the folder of users' functions, and the least and the
    greatest value (SI) of measures that are bounded."""

    scene: Scene
    folder: Path
    measures: dict[str, Measure]
    functions: Path
    bounds: dict[str, Bounds] = field(default_factory=dict)


def beyond(value: float, bounds: Bounds, scale: float | None = None) -> list[float]:
    """Return how far a value is beyond each of its bounds, in `scale`, SI: unless given as a share of the larger one; at most 0 where it
    keeps it. Beside a bound of 0 alone, in SI."""
    least, greatest = bounds
    scale = scale or max(abs(one) for one in bounds if one is not None) or 1.0
    found = [] if least is None else [(least - value) / scale]
    return found if greatest is None else [*found, (value - greatest) / scale]


def all_measured(job: Job, answer: Answer, names: Iterable[str]) -> Plain:
    """Measures of an answer, as `known`."""
    return known(
        {at: partial(job.measures[at].of_answer, answer, at, job.functions) for at in names}
    )


def known(measures: Mapping[str, Callable[[], float]]) -> Plain:
    """Collect what measures give, by name, and in `failed` why the others give nothing."""
    found: Plain = {}
    missing = []
    for name, measure in measures.items():
        try:
            found[name] = measure()
        except MagmpmError as error:
            missing.append(in_one_line(error))
    return {**found, WHY: "; ".join(missing)} if missing else found


def answered(scene: Scene, folder: Path | None, on_progress: Progress | None = None) -> Answer:
    """Run a scene in a folder, which equilibria do without. Raises MagmpmError."""
    from magmpm.simulate import run

    result = run(scene, folder=folder, on_progress=on_progress, progress=False)
    return Answer(scene, result, Motion.load(folder) if folder and scene.in_time else None)


def tried(job: Job, on_progress: Progress | None = None) -> Plain:
    """The measures of a run, in SI, as {"values": ...}; {"beyond": ...} of one that breaks a bound whatever its answer is, with those that
    are known; or {"failed": reason, "known": ...}."""
    scene = job.scene
    early = [at for at in job.bounds if job.measures[at].before(scene)]
    found = all_measured(job, Answer(scene, None), early)
    if any(max(beyond(found[at], job.bounds[at])) > 0.0 for at in early if at in found):
        return {"beyond": found}
    try:
        found = all_measured(job, answered(scene, job.folder, on_progress), job.measures)
    except MagmpmError as error:
        found = {WHY: in_one_line(error)}
    return {WHY: found.pop(WHY), "known": found} if WHY in found else {"values": found}


class Processes(ThreadPoolExecutor):
    """Processes that each run one scene at a time, on their share of the threads, as an executor of concurrent.futures.

    One that ends takes its own job alone with it (the job's future raises Died), and another takes its place.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        env = with_threads(threads_each(workers))
        self._processes = [Process(_ready, env=env) for _ in range(workers)]
        self._closing = False
        self._idle: SimpleQueue[Process] = SimpleQueue()
        for process in self._processes:
            self._idle.put(process)

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Any:
        """Run a function of a module: it is found by its name."""
        return super().submit(self._asked, partial(function, *given, **named))

    def _asked(self, job: Callable[[], Any]) -> Any:
        process = self._idle.get()
        try:
            return process.ask(job)
        except Died:
            if not self._closing:
                process.start()
            raise
        finally:
            self._idle.put(process)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes, whatever they do."""
        self._closing = True
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        for process in self._processes:
            process.process.kill()
        super().shutdown(wait=wait)
        for process in self._processes:
            process.end()


def _ready(_: object) -> Callable[[Callable[[], Any]], Any]:
    """Return what answers a job in a process: a call."""
    return operator.call


def in_si(value: Any, measure: Measure, at: str) -> float | None:
    """A bound or target of a measure in SI; None of None. Raises InputError."""
    if value is None:
        return None
    if measure.kind is None:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(
                at,
                received=repr(value),
                rule=f"{measure.name} is a plain number (SI)",
                remedy="write a number",
            )
        return float(value)
    return quantities.in_si(str(value), measure.kind, at)


def forget(folder: Path) -> None:
    """Remove a run's folder."""
    shutil.rmtree(folder, ignore_errors=True)
