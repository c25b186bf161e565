"""One run of a scene and its measures, here or in another process."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from magmpm.errors import MagmpmError
from magmpm.inputs.quantities import KINDS, BadQuantity, parse_quantity
from magmpm.inputs.settings import validate
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.measures import Measure


@dataclass(frozen=True)
class Job:
    """A scene (SI data), the folder of its run, measures by name as plain data, the folder of users' functions, and the least and the
    greatest value (SI) of measures that are bounded."""

    scene: dict[str, Any]
    folder: Path
    measures: dict[str, dict[str, Any]]
    functions: Path
    bounds: dict[str, tuple[float | None, float | None]] = field(default_factory=dict)


class BeyondBounds(MagmpmError):
    """A scene that breaks a bound whatever its answer is; numbers: the measures that are known."""

    def __init__(self, numbers: dict[str, float]) -> None:
        super().__init__("a bound is broken, whatever the answer is")
        self.numbers = numbers


def beyond(value: float, bounds: tuple[float | None, float | None]) -> list[float]:
    """Return how far a value is beyond each of its bounds: at most 0 where it keeps it."""
    least, greatest = bounds
    found = [] if least is None else [least - value]
    return found if greatest is None else [*found, value - greatest]


def numbers(job: Job, on_progress: Callable[[int, float], None] | None = None) -> dict[str, float]:
    """The measures of a run, in SI. Raises MagmpmError where it fails, with the reason; BeyondBounds where it need not be run."""
    scene = Scene.from_si(job.scene)
    if not scene.external_field().source.varies:
        early = Answer(scene, None)
        known = {
            name: measured(job.measures[name], early, name, job.functions)
            for name in job.bounds
            if validate(Measure, job.measures[name]).before
        }
        if any(max(beyond(value, job.bounds[name])) > 0.0 for name, value in known.items()):
            raise BeyondBounds(known)
    answer = answered(scene, job.folder, on_progress)
    return {
        name: measured(data, answer, name, job.functions) for name, data in job.measures.items()
    }


def measured(data: Mapping[str, Any], answer: Answer, at: str, functions: Path) -> float:
    """A measure, as plain data, of an answer. Raises MagmpmError."""
    return validate(Measure, data).of_answer(answer, at, functions)


def answered(
    scene: Scene, folder: Path, on_progress: Callable[[int, float], None] | None = None
) -> Answer:
    """Run a scene in a folder. Raises MagmpmError."""
    from magmpm.simulate import run

    result = run(scene, folder=folder, on_progress=on_progress, progress=False)
    return Answer(scene, result, Motion.load(folder) if scene.in_time else None)


def tried(job: Job) -> dict[str, Any]:
    """`numbers` as {"values": ...}, {"beyond": ...} or {"failed": reason}."""
    try:
        return {"values": numbers(job)}
    except BeyondBounds as found:
        return {"beyond": found.numbers}
    except MagmpmError as error:
        return {"failed": reason(error)}


def reason(error: BaseException) -> str:
    """The first line of what went wrong."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


class Processes(ProcessPoolExecutor):
    """Processes that each run one scene at a time, on their share of the threads.

    They do not import the user's script, as those of multiprocessing do: a script needs no guard, `if __name__ == "__main__"`.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers, get_context("spawn"), _share_threads, (workers,))

    def submit(self, function: Any, /, *given: Any, **more: Any) -> Any:
        """Run a function of a module, not of the script."""
        main = vars(sys.modules["__main__"])
        hidden: dict[str, Any] = {
            name: main.pop(name) for name in ("__file__", "__spec__") if name in main
        }
        main["__spec__"] = None
        try:
            return super().submit(function, *given, **more)
        finally:
            main.update(hidden)


def _share_threads(workers: int) -> None:
    import numba

    settings: Any = numba.config
    numba.set_num_threads(max(1, min(settings.NUMBA_NUM_THREADS, (os.cpu_count() or 1) // workers)))


def in_si(value: Any, measure: Measure, at: str) -> float:
    """A bound or target of a measure in SI. Raises InputError."""
    from magmpm.errors import InputError

    kind = None if measure.kind is None else KINDS[measure.kind]
    if kind is None:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(
                at,
                received=repr(value),
                rule=f"{measure.name} is a plain number (SI)",
                remedy="write a number",
            )
        return float(value)
    try:
        return parse_quantity(str(value), kind)
    except BadQuantity as error:
        raise InputError(at, received=repr(value), rule=error.rule, remedy=error.remedy) from None


def forget(folder: Path) -> None:
    """Remove a run's folder."""
    shutil.rmtree(folder, ignore_errors=True)
