"""Hard cases in processes side by side, the long ones first; each process has its share of the cores."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from magmpm.compiled.process import DIED, RAISED, answers, started, threads_each, with_threads
from magmpm.studies.hard_cases.case import Case, Outcome

Done = Callable[[int, int, str], None]


def outcomes(cases: Sequence[Case], *, processes: int = 2, on_done: Done = lambda done, count, name: None) -> list[Outcome]:
    """The outcomes of cases, in their order. on_done(done, number of cases, name): called after each."""
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
    """What a process does: cases hold functions without a name, so they go by theirs."""
    from magmpm.studies.hard_cases import CASES  # which imports this module

    return lambda name: next(case for case in CASES if case.name == name).run()
