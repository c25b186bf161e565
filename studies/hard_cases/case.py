"""Hard cases: their definition, the outcome of a run, and several runs in processes side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

from magmpm.compiled.process import DIED, RAISED, answers, started, threads_each, with_threads
from magmpm.errors import SolveError
from magmpm.scene import Scene


@dataclass(frozen=True)
class Case:
    """A scene at the edge of what the solvers can do, and one number that tells whether it went well.

    weak: what a weak code does there; quantity: what `measure(scene)` returns, with its unit; it must be at most `bound`;
    source: of the bound or of the exact answer; slow: takes longer than a few seconds.
    """

    name: str
    scene: Callable[[], Scene]
    weak: str
    quantity: str
    measure: Callable[[Scene], float]
    bound: float
    source: str
    slow: bool = False

    def run(self) -> Outcome:
        """Measure it. A failed run counts as infinite, with its reason."""
        begun, reason = perf_counter(), ""
        try:
            value = float(self.measure(self.scene()))
        except SolveError as error:
            value, reason = math.inf, error.reason
        return self.outcome(value, reason, perf_counter() - begun)

    def outcome(self, value: float, reason: str, seconds: float) -> Outcome:
        """Outcome of a measure, or of the reason why there is none."""
        passed = value <= self.bound
        return Outcome(self.name, self.weak, self.quantity, value, self.bound, passed, seconds, self.source, reason)


@dataclass(frozen=True)
class Outcome:
    """A case that was run. measure and bound in the unit of `quantity`; reason: why the run failed, if it did."""

    name: str
    weak: str
    quantity: str
    measure: float
    bound: float
    passed: bool
    seconds: float
    source: str
    reason: str

    def summary(self) -> dict[str, Any]:
        """Plain data; a measure that is not finite is None."""
        return {**asdict(self), "measure": self.measure if math.isfinite(self.measure) else None}


def table(outcomes: list[Outcome]) -> str:
    """The outcomes as text."""
    lines = [f"{'case':<36} {'measure':>9} {'bound':>9}  {'':<6} {'seconds':>7}  what is measured"]
    for o in outcomes:
        word = "ok" if o.passed else "FAILED"
        lines.append(f"{o.name:<36} {o.measure:9.2e} {o.bound:9.2e}  {word:<6} {o.seconds:7.1f}  {o.quantity}")
        if not o.passed:
            lines.append(f"    a weak code: {o.weak}" + (f"; here: {o.reason}" if o.reason else ""))
    return "\n".join(lines)


Done = Callable[[int, int, str], None]


def run_cases(cases: Sequence[Case], *, processes: int = 2, on_done: Done = lambda done, count, name: None) -> list[Outcome]:
    """The outcomes of cases, in their order. The long ones begin first; each process has its share of the cores.

    on_done(done, number of cases, name): called after each.
    """
    processes = min(processes, len(cases), threads_each(1))
    if processes < 2:
        found = []
        for k, case in enumerate(cases):
            on_done(k, len(cases), case.name)
            found.append(case.run())
        return found
    by_name = dict[str, Outcome]()
    known = {case.name: case for case in sorted(cases, key=lambda case: not case.slow)}
    with started(processes, _begin, env=with_threads(threads_each(processes))) as pool:
        for name, kind, found in answers(iter(known), pool):
            if kind == RAISED:
                raise found
            by_name[name] = known[name].outcome(math.inf, f"the process {found}", found.seconds) if kind == DIED else found
            on_done(len(by_name), len(cases), name)
    return [by_name[case.name] for case in cases]


def _begin(_: object) -> Callable[[str], Outcome]:
    """Begin a process: cases hold functions without a name, so they go by theirs."""
    from magmpm.studies.hard_cases import CASES  # which imports this module

    return lambda name: next(case for case in CASES if case.name == name).run()
