"""Processes that solve scenes one after the other, and are replaced when one ends or hangs.

Each compiles a kernel once, for all its scenes. A scene's limit is in seconds of processor time, which a busy machine does not shorten; a
process that waits for nothing is ended after PATIENCE times as long.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import magmpm
from magmpm.studies.hard_cases.attempt import HUNG, TRACEBACK, Outcome, attempt

PATIENCE = 20.0
COMPILING = 1200.0  # s more that a process may take: it compiles before its limit of processor time begins
Job = tuple[int, Path, Path]  # number, scene file, folder for what is saved


def solved(jobs: Iterable[Job], processes: int, limit: float) -> Iterator[tuple[int, Outcome]]:
    """Number and outcome of each job, in the order in which they end. limit: s of processor time for each."""
    waiting, pool = iter(jobs), [_Process(limit) for _ in range(processes)]
    try:
        busy = {process for process in pool if process.begin(next(waiting, None))}
        while busy:
            ready = set(wait([process.pipe for process in busy], timeout=1.0))
            for process in list(busy):
                outcome = process.outcome(process.pipe in ready)
                if outcome is None:
                    continue
                yield process.number, outcome
                if not process.begin(next(waiting, None)):
                    busy.discard(process)
    finally:
        for process in pool:
            process.end()


class _Process:
    """One process and its pipe."""

    def __init__(self, limit: float) -> None:
        self.limit, self.number, self.file, self.begun = limit, -1, "", 0.0
        self.known: Outcome | None = None  # of the scene at work, before remedies are tried
        self._start()

    def _start(self) -> None:
        self.pipe, theirs = Pipe()
        root = str(Path(magmpm.__file__).resolve().parents[1])
        given = f"{theirs.fileno()}, {self.limit}"
        code = f"import sys; sys.path.insert(0, {root!r}); from magmpm.studies.hard_cases.pool import serve; serve({given})"
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()], env={**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")},
            )  # fmt: skip

    def begin(self, job: Job | None) -> bool:
        """Begin a job. Returns whether there was one."""
        if job is None:
            return False
        self.number, path, _ = job
        self.file, self.begun, self.known = path.name, time.monotonic(), None
        self.pipe.send(job)
        return True

    def outcome(self, ready: bool) -> Outcome | None:
        """Of the job, once it has one. A process that ended or hung is replaced."""
        if ready:
            try:
                done, found = self.pipe.recv()
                if done:
                    return found  # type: ignore[no-any-return]
                self.known = found
                return None
            except (EOFError, OSError):
                found = self._died(self.process.wait())
        elif time.monotonic() - self.begun > PATIENCE * self.limit + COMPILING:
            found = {"ended": HUNG, "reason": f"no answer within {PATIENCE * self.limit + COMPILING:.0f} s"}
        else:
            return None
        self.end()
        self._start()
        return {"file": self.file, "seconds": time.monotonic() - self.begun, **found}

    def _died(self, status: int) -> Outcome:
        """The outcome where the process ended on its own: out of time (in a remedy, which then brought no answer), or otherwise."""
        late = status == -signal.SIGPROF
        if late and self.known is not None:
            return self.known
        reason = f"no answer within {self.limit:g} s of processor time" if late else f"the process ended with status {status}"
        return {"ended": HUNG if late else TRACEBACK, "reason": reason}

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        self.pipe.close()


def serve(descriptor: int, limit: float) -> None:
    """A process: solves what comes through the pipe until it closes."""
    pipe: Any = Connection(descriptor)
    while True:
        try:
            _, path, folder = pipe.recv()
        except EOFError:
            return
        pipe.send((True, attempt(path, folder, limit, lambda known: pipe.send((False, known)))))
