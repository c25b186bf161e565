"""Processes that evaluate designs, and are replaced when one dies.

They (magmpm.compiled.process) know no storage: what they find comes back, and the session that started them keeps it. A process that dies
takes nothing with it: its design is given to a new one, once; a design that ends two processes counts as failed. One that hangs, in a solve
or while it starts, is ended and has died.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import wait
from typing import Any

from magmpm.compiled.arrays import Plain
from magmpm.compiled.process import RAISED, READY, Died, Process, threads_each, with_threads
from magmpm.errors import MagmpmError, report
from magmpm.studies.evaluate.evaluator import Evaluator
from magmpm.studies.evaluate.trial import Outcome
from magmpm.studies.search.parameters import Parameters

PROCESSES_PER_DESIGN = 2  # processes that a design may end before it counts as failed
SECRETS = ("MAGMPM_STORAGE", "PGPASSWORD", "PGPASSFILE")  # of the storage, which workers do not see


class WorkersError(MagmpmError):
    """Worker processes do not start."""


class Pool:
    """Worker processes; a context manager that ends them. They are started at once, and not waited for.

    Parameters
    ----------
    evaluator : Evaluator
        Evaluates designs.
    workers : int
        Number of processes.
    """

    def __init__(self, evaluator: Evaluator, workers: int) -> None:
        """Starts them, and does not wait for them."""
        self._failed_starts = 0
        self.deaths = self.hangs = 0
        self.limit: float | None = None  # s that a design may take
        self._workers = [_Worker(evaluator, threads_each(workers)) for _ in range(workers)]

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()

    @property
    def idle(self) -> int:
        """Number of processes that have nothing to do."""
        return sum(worker.job is None for worker in self._workers)

    def begin(self, number: int, params: Parameters) -> None:
        """Give a design to a process that is idle.

        Parameters
        ----------
        number : int
            Of the trial.
        params : Mapping[str, Any]
            The design.
        """
        worker = next(worker for worker in self._workers if worker.job is None)
        worker.job = (number, dict(params))
        worker.give(worker.job)

    def answers(self, patience: float) -> Iterator[tuple[int, Outcome | str]]:
        """Wait for designs that are done.

        Parameters
        ----------
        patience : float, s
            How long, at most.

        Yields
        ------
        tuple of (int, Outcome or str)
            Number of a trial and its outcome, or why the design ended its processes.

        Raises
        ------
        WorkersError
            Where processes do not start.
        """
        busy = [worker for worker in self._workers if worker.job is not None]
        if not busy:
            time.sleep(patience)
            return
        ready = set(wait([worker.pipe for worker in busy], timeout=patience))
        for worker in busy:
            assert worker.job is not None
            number = worker.job[0]
            limit = self.limit if worker.ready else 600.0
            try:
                if worker.pipe in ready:
                    kind, answer = worker.receive()
                elif limit is not None and time.monotonic() - worker.since >= limit:
                    self.hangs += 1
                    worker.end()
                    raise Died(f"ended after {limit:.0f} s without an answer")
                else:
                    continue
            except Died as death:
                found = self._replaced(worker, str(death))
                if found is not None:
                    yield number, found
                continue
            if kind == READY:
                self._failed_starts = 0
            elif kind == RAISED:  # what ends a study in one process ends it here as well
                raise answer
            else:
                worker.job = None
                worker.tries = 0
                yield number, answer

    def _replaced(self, worker: _Worker, how: str) -> str | None:
        """Start a process anew that has ended, with the same design; or say why the design is given up."""
        failed_starts = 3  # processes in a row that may end before they are ready
        self.deaths += 1
        self._failed_starts += not worker.ready
        if self._failed_starts >= failed_starts:
            raise WorkersError(
                report(
                    "--workers",
                    rule=f"worker processes must start; {failed_starts} in a row {how}",
                    remedy="see that there is memory for them, or use --workers 1",
                )
            )
        worker.tries += worker.ready
        worker.start()
        if worker.tries >= PROCESSES_PER_DESIGN:
            worker.job = None
            worker.tries = 0
            return f"the process that solved it {how}, {PROCESSES_PER_DESIGN} times"
        worker.give(worker.job)
        return None


class _Worker(Process):
    """One process with its design."""

    def __init__(self, evaluator: Evaluator, threads: int) -> None:
        self.job: tuple[int, Plain] | None = None
        self.tries = 0
        env = {name: value for name, value in with_threads(threads).items() if name not in SECRETS}
        super().__init__(
            _begin,
            evaluator.study,
            evaluator.solve,
            evaluator.differentiate,
            evaluator.picture,
            evaluator.out,
            env=env,
        )


def _begin(_: object, *given: Any) -> Callable[[tuple[int, Plain]], Outcome]:
    evaluator = Evaluator(*given)
    return lambda job: evaluator.outcome(*job)
