"""One drawing process: a fresh interpreter at the other end of a pipe.

It is not a fork, since a fork hangs once OpenMP has started; nor multiprocessing's spawn, which would import the caller's script once
more; nor loky's, which outlives a caller that is killed.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import magmpm
from magmpm.errors import MagmpmError

# Which of VTK's windows to use; its classes that need no display are EGL's and OSMesa's.
WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"


class RenderError(MagmpmError):
    """A picture that could not be drawn; the message says why. A trial goes on without its picture."""


class WorkerDied(Exception):
    """The drawing process ended, or was ended because it took too long; the message says which."""


class Worker:
    """One drawing process with one backend. The constructor only begins its start; `wait_ready` does."""

    def __init__(self, backend: str, window: str | None = None) -> None:
        """window: the class of VTK's window, for backend "pyvista"."""
        self._ready = False
        self._pipe, theirs = Pipe()
        root = str(Path(magmpm.__file__).resolve().parents[1])
        start = f"import sys; sys.path.insert(0, {root!r}); from magmpm.viz.worker_main import main; main(sys.argv)"
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", start, str(theirs.fileno()), backend],
                stdin=subprocess.DEVNULL,
                # VTK and OpenGL print when they fail; what matters is said in one line by the parent.
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=_environment(window),
            )

    def wait_ready(self, timeout: float) -> None:
        """Wait (timeout: s) for its first picture. Raises WorkerDied, or RenderError if it cannot draw."""
        if not self._ready:
            self._exchange(None, timeout)
            self._ready = True

    def request(self, function: Callable[..., Any], *args: Any, timeout: float) -> Any:
        """What function(*args) returns there; function must be of a module's top level, to be sent.

        Raises WorkerDied, also when it takes longer than timeout (s), and RenderError for its exceptions.
        """
        return self._exchange((function, args), timeout)

    def _exchange(self, message: Any, timeout: float) -> Any:
        late = threading.Event()

        def end() -> None:
            late.set()
            self.process.kill()

        # Killing it is what wakes a send or a receive that would wait for ever.
        timer = threading.Timer(timeout, end)
        timer.daemon = True
        timer.start()
        try:
            if message is not None:
                self._pipe.send(message)
            kind, answer = self._pipe.recv()
        except (EOFError, OSError):
            self.process.wait()
            raise WorkerDied(f"no answer in {timeout:.0f} s" if late.is_set() else self._last_words()) from None
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise RenderError(f"this request cannot be sent to the drawing process: {error}") from None
        except BaseException:
            # Ctrl-C: the answer to this request must not become the next one's.
            self.process.kill()
            raise
        finally:
            timer.cancel()
        if kind == "error":
            raise RenderError(str(answer))
        return answer

    def _last_words(self) -> str:
        code = self.process.returncode
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"ended by {signal.Signals(-code).name}"
        return f"ended with status {code}"

    def close(self) -> None:
        """End the process: politely by closing its pipe, firmly after a second."""
        self._pipe.close()
        try:
            self.process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def _environment(window: str | None) -> dict[str, str]:
    """Settings of the drawing process: one thread for OpenGL and BLAS, and memory given back at once."""
    env = dict(os.environ)
    env.update(LP_NUM_THREADS="1", OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MALLOC_ARENA_MAX="1")
    env["MALLOC_TRIM_THRESHOLD_"] = env["MALLOC_MMAP_THRESHOLD_"] = str(256 * 1024)
    env.pop("PYTHONFAULTHANDLER", None)
    if window is not None:
        env[WINDOW_VARIABLE] = window
    return env
