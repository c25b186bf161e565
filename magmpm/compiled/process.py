"""Processes of our own: each is a fresh interpreter at the other end of a pipe, and does one job after the other.

They are no forks, since a fork hangs once OpenMP has started; nor multiprocessing's spawn, which imports the caller's script once more; nor
loky's, which outlives a caller that is killed. Ctrl-C is for the caller to act on; a process ends with its caller, however that ends.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeVar

from magmpm.errors import InputError

# kinds of messages
READY = "ready"
PARTIAL = "partial"
DONE = "done"
RAISED = "raised"
DIED = "died"
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SECONDS_TO_CLOSE = 5.0  # s that a process may take to end once its pipe is closed
Job = TypeVar("Job")


class Died(Exception):
    """A process ended, or was ended because it took too long. status: of its exit, negative for a signal; seconds: since its job began."""

    def __init__(self, how: str, status: int = 0, seconds: float = 0.0) -> None:
        super().__init__(how)
        self.status = status
        self.seconds = seconds


def threads_each(processes: int) -> int:
    """Threads of each of so many processes: together the cores that this process may use, or NUMBA_NUM_THREADS if fewer."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return max(1, min(cores, int(os.environ.get("NUMBA_NUM_THREADS") or cores)) // processes)


def with_threads(threads: int) -> dict[str, str]:
    """The environment of a process with so many threads, which are counted once, when a library is loaded."""
    return {**os.environ, **dict.fromkeys(THREADS, str(threads))}


class Process:
    """One process. `begin(pipe, *given)`, of a module's top level, is called in it, and returns the function that answers a job.

    That function may send (PARTIAL, something) through the pipe before it returns its answer.
    """

    def __init__(
        self,
        begin: Callable[..., Any],
        *given: Any,
        env: Mapping[str, str] | None = None,
        quiet: bool = True,
    ) -> None:
        """Start it, and do not wait for it. quiet: what it prints on standard error is lost."""
        if sys.platform == "win32":  # whose processes inherit no pipe by its number
            raise InputError(
                "this system",
                received="Windows",
                rule="kernels are compiled, pictures drawn and studies solved in processes of"
                " their own, which need Linux or macOS",
                remedy="install magmpm in WSL 2, the Linux of Windows: docs/install.md",
            )
        self._payload = pickle.dumps((begin, given))
        self._env = env
        self._quiet = quiet
        self._what = begin.__module__
        self.start()

    def start(self) -> None:
        """Start it, or one in its place."""
        self.ready = False
        self.since = time.monotonic()
        self.pipe, theirs = Pipe()
        root = str(Path(__file__).resolve().parents[2])
        code = (
            f"import sys; sys.path.insert(0, {root!r}); from magmpm.compiled.process import serve;"
            f" serve({theirs.fileno()})"
        )
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"{code}  # {self._what}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL if self._quiet else None,
                pass_fds=[theirs.fileno()],
                env=self._env,
            )
        with suppress(OSError):  # it has died; whoever waits for its answer learns of it
            self.pipe.send(sys.path)
            self.pipe.send_bytes(self._payload)

    def give(self, job: Any) -> None:
        """Give it a job."""
        self.since = time.monotonic()
        with suppress(OSError):  # as above
            self.pipe.send(job)

    def receive(self) -> tuple[str, Any]:
        """Kind and content of its next message. Raises Died."""
        try:
            kind, found = self.pipe.recv()
        except (EOFError, OSError):
            raise Died(
                self.end(SECONDS_TO_CLOSE), self.process.returncode, time.monotonic() - self.since
            ) from None
        if kind == READY:
            self.ready = True
            self.since = time.monotonic()
        return kind, found

    def ask(self, job: Any = None, timeout: float | None = None) -> Any:
        """Its answer to a job, or None once it is ready. Raises Died, also after `timeout`, s, and what was raised there."""
        found: Any = None
        late = threading.Event()

        def stop() -> None:  # which wakes a send or a receive that would wait for ever
            late.set()
            self.process.kill()

        timer = threading.Timer(timeout or threading.TIMEOUT_MAX, stop)
        timer.daemon = True
        timer.start()
        try:
            if job is not None:
                self.give(job)
            kind = READY
            while not (self.ready if job is None else kind in (DONE, RAISED)) and kind != RAISED:
                kind, found = self.receive()
        except Died as death:
            raise Died(f"no answer in {timeout:.0f} s") if late.is_set() else death from None
        except KeyboardInterrupt:  # the answer to this job must not become the next one's
            self.process.kill()
            raise
        finally:
            timer.cancel()
        if kind == RAISED:
            raise found
        return found

    def end(self, patience: float = 0.0) -> str:
        """End it: politely, by closing its pipe, where it gets so many seconds. Returns how it ended."""
        self.pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=patience)
        self.process.kill()
        status = self.process.wait()
        assert self.process.stdin is not None
        self.process.stdin.close()
        known = -status in set(signal.Signals)
        return (
            f"ended by {signal.Signals(-status).name if known else f'signal {-status}'}"
            if status < 0
            else f"ended with status {status}"
        )


@contextmanager
def started(
    count: int, begin: Callable[..., Any], *given: Any, env: Mapping[str, str] | None = None
) -> Iterator[list[Process]]:
    """Processes that end with this context."""
    processes = [Process(begin, *given, env=env) for _ in range(count)]
    try:
        yield processes
    finally:
        for process in processes:
            process.end()


def answers(
    jobs: Iterator[Job] | deque[Job], processes: Sequence[Process], limit: float | None = None
) -> Iterator[tuple[Job, str, Any]]:
    """Job, kind and content of each message, as they come. One that dies, or takes longer than limit, s, is replaced: DIED, with Died.

    jobs: a deque may get more of them meanwhile.
    """
    busy: dict[Process, Job] = {}
    while True:
        for process in [idle for idle in processes if idle not in busy]:
            try:
                busy[process] = jobs.popleft() if isinstance(jobs, deque) else next(jobs)
            except (IndexError, StopIteration):
                break
            process.give(busy[process])
        if not busy:
            return
        ready = set(wait([process.pipe for process in busy], timeout=1.0))
        for process, job in list(busy.items()):
            try:
                if process.pipe in ready:
                    kind, found = process.receive()
                elif (
                    limit is not None and process.ready and time.monotonic() - process.since > limit
                ):
                    process.end()
                    raise Died(
                        f"no answer in {limit:.0f} s", seconds=time.monotonic() - process.since
                    )
                else:
                    continue
            except Died as death:
                kind = DIED
                found = death
                process.start()
            if kind not in (READY, PARTIAL):
                del busy[process]
            if kind != READY:
                yield job, kind, found


def serve(descriptor: int) -> None:
    """Serve jobs in a process: they come through the pipe, and their outcomes go back, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_caller, daemon=True).start()
    pipe: Any = Connection(descriptor)
    with suppress(EOFError, OSError):
        sys.path[:] = pipe.recv()
        payload = pipe.recv_bytes()  # from the process that started this one
        try:
            begin, given = pickle.loads(payload)
            work = begin(pipe, *given)
        except Exception as error:
            pipe.send((RAISED, _sendable(error)))
            return
        pipe.send((READY, None))
        while True:
            job = pipe.recv()
            try:
                message = (DONE, work(job))
            except Exception as error:
                message = (RAISED, _sendable(error))
            pipe.send(message)


def _sendable(error: Exception) -> Exception:
    """An exception, or what it says where it can't be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with_caller() -> None:
    """Standard input closes when the caller ends, however it ends: in the middle of a job, too."""
    os.read(0, 1)
    os._exit(1)
