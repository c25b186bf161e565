"""Hard cases in processes side by side, the long ones first; each process has its share of the cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from magmpm.studies.hard_cases.case import Case, Outcome

THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
Done = Callable[[int, int, str], None]


def outcomes(
    cases: Sequence[Case], *, processes: int = 2, on_done: Done = lambda done, count, name: None
) -> list[Outcome]:
    """The outcomes of cases, in their order. on_done(done, number of cases, name): called after each."""
    processes = min(processes, len(cases), os.cpu_count() or 1)
    if processes < 2:
        found = []
        for k, case in enumerate(cases):
            on_done(k, len(cases), case.name)
            found.append(case.run())
        return found
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    by_name: dict[str, Outcome] = {}
    with _threads(processes), ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        order = sorted(cases, key=lambda case: not case.slow)
        futures = {pool.submit(_run, case.name): case.name for case in order}
        for k, future in enumerate(as_completed(futures)):
            by_name[futures[future]] = future.result()
            on_done(k + 1, len(cases), futures[future])
    return [by_name[case.name] for case in cases]


def _run(name: str) -> Outcome:
    """What a process does: cases hold functions without a name, so they go by theirs."""
    from magmpm.studies.hard_cases import CASES  # which imports this module

    return next(case for case in CASES if case.name == name).run()


@contextmanager
def _threads(processes: int) -> Iterator[None]:
    """Processes that are started in this context take their share of the cores. Threads are counted once, when a process loads them."""
    each, before = str(max(1, (os.cpu_count() or 1) // processes)), {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, each))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
