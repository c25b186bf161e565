"""Processes that judge designs, and are replaced when one dies.

They are fresh interpreters at the other end of a pipe, never forks: a fork hangs once OpenMP has started. They know no storage: what they
find comes back through the pipe, and the session that started them keeps it. A process that dies takes nothing with it: its design is given
to a new one, once; a design that ends two processes counts as failed. One that hangs, in a solve or while it starts, is ended and has died.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import magmpm
from magmpm.errors import MagmpmError, report
from magmpm.studies.judge import Judge, Judged

TRIES = 2  # processes that a design may end before it counts as failed
STARTS = 3  # processes in a row that may end before they are ready
STARTING = 600.0  # s that a process may take until it is ready
SECRETS = ("MAGMPM_STORAGE", "PGPASSWORD", "PGPASSFILE")  # of the storage, which workers do not see


class WorkersError(MagmpmError):
    """Worker processes do not start."""


def threads_each(workers: int) -> int:
    """Threads of each of so many processes: together the cores that this process may use, or NUMBA_NUM_THREADS if fewer."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, int(os.environ.get("NUMBA_NUM_THREADS") or cores)) // workers)


class Pool:
    """Worker processes; a context manager that ends them."""

    def __init__(self, judge: Judge, workers: int) -> None:
        """Starts them, and does not wait for them."""
        self._payload = pickle.dumps((judge.study, judge.solve, judge.differentiate, judge.picture, judge.out))
        self._threads = threads_each(workers)
        self._failed_starts = 0
        self.deaths = self.hangs = 0
        self.limit: float | None = None  # s that a design may take
        self._workers = [_Worker(self._payload, self._threads) for _ in range(workers)]

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()

    @property
    def idle(self) -> int:
        """How many processes have nothing to do."""
        return sum(worker.job is None for worker in self._workers)

    @property
    def busy(self) -> set[int]:
        """Numbers of the trials that are being solved."""
        return {worker.job[0] for worker in self._workers if worker.job is not None}

    def begin(self, number: int, params: Mapping[str, Any]) -> None:
        """Give a design to a process that is idle."""
        worker = next(worker for worker in self._workers if worker.job is None)
        worker.give((number, dict(params)))

    def answers(self, patience: float) -> Iterator[tuple[int, Judged | str]]:
        """Number and judgment of designs that are done, after at most `patience`, s; or why the design ended its processes.

        Raises WorkersError where processes do not start.
        """
        if not self.busy:
            time.sleep(patience)
            return
        yield from self._of_those_that_hang()
        ready = set(wait([worker.pipe for worker in self._workers if worker.job is not None], timeout=patience))
        for place, worker in enumerate(self._workers):
            if worker.pipe not in ready or worker.job is None:
                continue
            number = worker.job[0]
            try:
                kind, answer = worker.pipe.recv()
            except (EOFError, OSError):
                found = self._replaced(place, worker)
                if found is not None:
                    yield number, found
                continue
            if kind == "ready":
                worker.ready, self._failed_starts, worker.since = True, 0, time.monotonic()
            elif kind == "raised":  # what ends a study in one process ends it here as well
                raise answer
            else:
                worker.job, worker.tries = None, 0
                yield number, answer

    def _of_those_that_hang(self) -> Iterator[tuple[int, str]]:
        """Ends processes that take too long. Number of each design that is given up, and why."""
        for place, worker in enumerate(self._workers):
            limit = self.limit if worker.ready else STARTING
            if worker.job is None or limit is None or time.monotonic() - worker.since < limit or worker.pipe.poll():
                continue
            self.hangs += 1
            found = self._replaced(place, worker, f"after {limit:.0f} s without an answer")
            if found is not None:
                yield worker.job[0], found

    def _replaced(self, place: int, worker: _Worker, why: str = "") -> str | None:
        """Another process in place of one that died, or has to, with the same design; or why the design is given up."""
        ended = worker.end()
        how = why or ended
        self.deaths += 1
        self._failed_starts += not worker.ready
        if self._failed_starts >= STARTS:
            rule = f"worker processes must start; {STARTS} in a row ended ({how})"
            remedy = "see that there is memory for them, or use --workers 1"
            raise WorkersError(report("--workers", rule=rule, remedy=remedy))
        job, tries = worker.job, worker.tries + worker.ready
        self._workers[place] = fresh = _Worker(self._payload, self._threads)
        if tries >= TRIES:
            return f"the process that solved it ended ({how}), {TRIES} times"
        assert job is not None
        fresh.tries = tries
        fresh.give(job)
        return None


class _Worker:
    """One process and its pipe."""

    def __init__(self, payload: bytes, threads: int) -> None:
        self.pipe, theirs = Pipe()
        self.job: tuple[int, dict[str, Any]] | None = None
        self.ready, self.tries, self.since = False, 0, time.monotonic()  # since: when its design, or its start, began
        root = str(Path(magmpm.__file__).resolve().parents[1])
        code = f"import sys; sys.path.insert(0, {root!r}); from magmpm.studies.workers.process import main; main(sys.argv)"
        env = {name: value for name, value in os.environ.items() if name not in SECRETS}
        env |= dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), str(threads))
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code, str(theirs.fileno())], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, pass_fds=[theirs.fileno()], env=env,
            )  # fmt: skip
        with suppress(OSError):  # it has died; whoever waits for its answer learns of it
            self.pipe.send(sys.path)
            self.pipe.send_bytes(payload)

    def give(self, job: tuple[int, dict[str, Any]]) -> None:
        """Give it a design."""
        self.job, self.since = job, time.monotonic()
        with suppress(OSError):  # as above
            self.pipe.send(job)

    def end(self) -> str:
        """End the process. Returns how it had ended, or ended now."""
        self.process.kill()
        status = self.process.wait()
        self.pipe.close()
        assert self.process.stdin is not None
        self.process.stdin.close()
        if status < 0:
            return signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
        return f"status {status}"
