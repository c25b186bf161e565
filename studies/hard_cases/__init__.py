"""Hard cases: scenes at the edge of what the solvers can do.

Each is an object with its scene, what a weak code does there, a measure and its bound.
What they find is repaired in the solver, not in the case.

    for case in CASES:
        print(case.run().summary())
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from magmpm.compiled.process import (
    DIED,
    RAISED,
    answers,
    started,
    threads_each,
    with_threads,
)
from magmpm.studies.hard_cases import equilibria, shapes, stepping
from magmpm.studies.hard_cases.case import Case, CaseOutcome, table

__all__ = ["CASES", "Case", "CaseOutcome", "run_cases", "table"]

CASES: tuple[Case, ...] = (*equilibria.CASES, *stepping.CASES, *shapes.CASES, *stepping.LONG)
Done = Callable[[int, int, str], None]


def run_cases(
    cases: Sequence[Case], *, processes: int = 2, on_done: Done = lambda done, count, name: None
) -> list[CaseOutcome]:
    """Run cases in processes, each of which has its share of the cores; the long ones begin first.

    Parameters
    ----------
    cases : sequence of Case
        The cases.
    processes : int, default 2
        How many run at the same time.
    on_done : Done, optional
        `on_done(done, number of cases, name)` is called after each.

    Returns
    -------
    list of CaseOutcome
        Their outcomes, in the cases' order.
    """
    processes = min(processes, len(cases), threads_each(1))
    if processes < 2:
        found = []
        for k, case in enumerate(cases):
            on_done(k, len(cases), case.name)
            found.append(CaseOutcome(case, *case.run()))
        return found
    by_name = dict[str, CaseOutcome]()
    known = {case.name: case for case in sorted(cases, key=lambda case: not case.slow)}
    with started(processes, _begin_cases, env=with_threads(threads_each(processes))) as pool:
        for name, kind, found in answers(iter(known), pool):
            if kind == RAISED:
                raise found
            by_name[name] = CaseOutcome(
                known[name],
                *((math.inf, found.seconds, f"the process {found}") if kind == DIED else found),
            )
            on_done(len(by_name), len(cases), name)
    return [by_name[case.name] for case in cases]


def _begin_cases(_: object) -> Callable[[str], tuple[float, float, str]]:
    """Begin a process: cases hold functions without a name, so they go by theirs."""
    return lambda name: next(case for case in CASES if case.name == name).run()
