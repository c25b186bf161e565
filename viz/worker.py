"""Pictures are drawn in a process of their own, used for every frame, so that a crash there cannot harm the simulation.

A missing OpenGL library is a segmentation fault inside VTK, and a driver may hang. So all drawing happens in
a worker process. When it dies or hangs it is started once more; when that does not help,
matplotlib draws that picture.
"""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from magmpm.compiled.process import Died, Process, with_threads
from magmpm.errors import InputError, RenderError, install, installed, report, require
from magmpm.viz.camera import Framing
from magmpm.viz.layout import Layout, page_of
from magmpm.viz.snapshot import Snapshot
from magmpm.viz.worker_main import begin, draw

Size = tuple[int, int]
BACKENDS = ("pyvista", "matplotlib")

# Set to one of BACKENDS to have pictures drawn by it, whatever is installed.
BACKEND_VARIABLE = "MAGMPM_RENDER"

# Which of VTK's windows to use; its classes that need no display are EGL's and OSMesa's.
WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
# VTK's windows that need no display: EGL (libegl1, libgl1-mesa-dri), then OSMesa (libosmesa6).
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")

NO_OPENGL = (
    "No OpenGL library was found, so matplotlib draws the pictures; "
    "for PyVista's: apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)."
)
DOES_NOT_START = (
    "PyVista does not start here ({reason}), so matplotlib draws the pictures; to draw without "
    "a display: apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)."
)
NO_PYVISTA = (
    "PyVista is not installed, so matplotlib draws the pictures; for PyVista's:"
    f" {install('render')}."
)
GAVE_UP = (
    "PyVista's drawing process kept failing ({reason}), so matplotlib draws the pictures from"
    " here on."
)

# s that the drawing process gets to start, and to end by itself
STARTING = 60.0
SECONDS_TO_END = 1.0

# After so many pictures in a row that PyVista could not draw even after a restart, it is not tried again.
MOST_FAILURES = 3


class UnknownBackend(InputError, RenderError):
    """A backend that was requested and is none."""


def forced_backend() -> str | None:
    """The backend that the environment requests, or None. Raises UnknownBackend."""
    forced = os.environ.get(BACKEND_VARIABLE) or None
    if forced is not None and forced not in BACKENDS:
        raise UnknownBackend(
            report(
                BACKEND_VARIABLE,
                received=forced,
                rule=f"must be one of {', '.join(BACKENDS)}",
                remedy=f"write, say, {BACKEND_VARIABLE}=matplotlib, or unset it",
            )
        )
    return forced


class Worker(Process):
    """One drawing process with one backend. The constructor only begins its start; `wait_ready` does."""

    def __init__(self, backend: str, window: str | None = None) -> None:
        """window: the class of VTK's window, for backend "pyvista"."""
        # One thread for OpenGL and BLAS, and memory given back at once.
        env = {**with_threads(1), "LP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
        env["MALLOC_TRIM_THRESHOLD_"] = env["MALLOC_MMAP_THRESHOLD_"] = str(256 * 1024)
        env.pop("PYTHONFAULTHANDLER", None)
        if window is not None:
            env[WINDOW_VARIABLE] = window
        # VTK and OpenGL print when they fail, which is not shown: what matters is said in one line by the caller.
        super().__init__(begin, backend, env=env)

    def wait_ready(self, timeout: float) -> None:
        """Wait (timeout: s) for its first picture. Raises Died, or RenderError if it cannot draw."""
        self.ask(timeout=timeout)

    def request(self, function: Callable[..., Any], *args: Any, timeout: float) -> Any:
        """Call function(*args) there and return its result; function must be of a module's top level, to be sent.

        Raises Died, also when it takes longer than timeout (s), and RenderError for its exceptions.
        """
        try:
            return self.ask((function, args), timeout)
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise RenderError(
                f"this request cannot be sent to the drawing process: {error}"
            ) from None


class Renderer:
    """Draws pictures in a worker process; a context manager.

    Entering starts the process and returns at once: its start overlaps with the first solve. backend is
    "pyvista" or "matplotlib"; it is "pyvista" until found wanting. note is empty, or one line that says why
    pictures are not drawn by PyVista and what to install.
    """

    def __init__(self, backend: str | None = None, *, frame_timeout: float = 30.0) -> None:
        """backend: forces one; else the variable MAGMPM_RENDER does. frame_timeout: s."""
        forced = backend or forced_backend()
        if forced is not None and forced not in BACKENDS:
            raise UnknownBackend(
                f"backend {forced!r} is not known; it must be one of {', '.join(BACKENDS)}"
            )
        self.backend = forced or "pyvista"
        self.note = ""
        self._frame_timeout = frame_timeout
        self._failures = 0
        self._worker: Worker | None = None
        self._lock = threading.RLock()
        self._queue: ThreadPoolExecutor | None = None
        chosen = os.environ.get(WINDOW_VARIABLE)
        self._windows = [chosen] if chosen else list(WINDOWS)

    def __enter__(self) -> Renderer:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start the drawing process, without waiting for it."""
        with self._lock:
            self._started()

    def wait_ready(self) -> None:
        """Wait until a backend has drawn its first picture; then `backend` and `note` are settled.

        Raises RenderError if not even matplotlib starts.
        """
        with self._lock:
            self._ready_worker()

    def render(
        self,
        snapshot: Snapshot,
        path: str | Path,
        *,
        size: Size | None = None,
        framing: Framing | None = None,
    ) -> Path:
        """Draw a snapshot into a PNG file, or as the image of an SVG or PDF page; its folder is made. Returns the path.

        size: width and height in pixels, the layout's own unless given. framing: what is in view, by default the body and its target
        (share one to compare pictures). Raises RenderError.
        """
        path = Path(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RenderError(f"the folder of {path} cannot be made: {error}") from None
        self._draw(snapshot, size, framing, None, str(path.resolve()))
        return path

    def image(
        self,
        snapshot: Snapshot,
        *,
        size: Size | None = None,
        framing: Framing | None = None,
        layout: Layout | None = None,
    ) -> np.ndarray:
        """The snapshot as an array (height, width, 3) uint8; size and framing: as of `render`; layout: as these call for, unless given.

        Raises RenderError.
        """
        image: np.ndarray = self._draw(snapshot, size, framing, layout, None)
        return image

    def submit(self, snapshot: Snapshot, path: str | Path, **kind: Any) -> Future[Path]:
        """`render` in the background and in order, so that the next solve need not wait for it."""
        if self._queue is None:
            self._queue = ThreadPoolExecutor(max_workers=1, thread_name_prefix="magmpm-render")
        return self._queue.submit(self.render, snapshot, path, **kind)

    def run(self, function: Callable[..., Any], *args: Any) -> Any:
        """function(*args) in the drawing process, for plots: so matplotlib stays out of this one.

        function must be of a module's top level, as viz.plots' are. Raises RenderError.
        """
        with self._lock:
            for _ in range(2):
                try:
                    return self._ready_worker().request(
                        function, *args, timeout=self._frame_timeout
                    )
                except Died as death:
                    self._drop_worker()
                    problem = f"the drawing process {death} twice on the same picture"
            raise RenderError(problem)

    def rest(self) -> None:
        """End the process to free its memory; the next picture starts it again, in about a second."""
        with self._lock:
            self._drop_worker()

    def close(self) -> None:
        """Finish what was submitted, and end the process."""
        if self._queue is not None:
            self._queue.shutdown()
            self._queue = None
        with self._lock:
            self._drop_worker()

    def _draw(
        self,
        snapshot: Snapshot,
        size: Size | None,
        framing: Framing | None,
        layout: Layout | None,
        path: str | None,
    ) -> Any:
        """One picture, with whatever it takes: a restart, then matplotlib."""
        framing = framing or Framing.of(snapshot)
        layout = layout or page_of(framing, insets=snapshot.insets)
        args = (snapshot, framing, size or layout.size, layout, path)
        with self._lock:
            try:
                answer = self.run(draw, *args)
            except RenderError as error:
                if self.backend == "matplotlib":
                    raise
                return self._drawn_by_matplotlib(error, *args)
            self._failures = 0
            return answer

    def _drawn_by_matplotlib(self, error: RenderError, *args: Any) -> Any:
        """The picture by a matplotlib worker, after PyVista's failed with that error."""
        self._failures += 1
        if self._failures >= MOST_FAILURES:
            self._fall_back(GAVE_UP.format(reason=error))
            return self.run(draw, *args)
        spare = Worker("matplotlib")
        try:
            spare.wait_ready(STARTING)
            return spare.request(draw, *args, timeout=self._frame_timeout)
        except Died as death:
            raise RenderError(
                f"PyVista: {error}; matplotlib: the drawing process {death}"
            ) from None
        finally:
            spare.end(SECONDS_TO_END)

    def _ready_worker(self) -> Worker:
        """The worker, started if it is not; goes down the list of windows, then to matplotlib."""
        while True:
            worker = self._started()
            try:
                worker.wait_ready(STARTING)
                return worker
            except (Died, RenderError) as problem:
                self._drop_worker()
                if self.backend == "matplotlib":
                    raise RenderError(f"the drawing process does not start: {problem}") from None
                self._windows.pop(0)
                if not self._windows:
                    crashed = isinstance(problem, Died) and any(
                        name in str(problem) for name in ("SIGSEGV", "SIGABRT")
                    )
                    reason = " ".join(str(problem).split())
                    self._fall_back(NO_OPENGL if crashed else DOES_NOT_START.format(reason=reason))

    def _started(self) -> Worker:
        """The worker, whether ready or still starting."""
        if self._worker is None:
            if self.backend == "pyvista" and not installed("pyvista"):
                self._fall_back(NO_PYVISTA)
            if self.backend == "matplotlib":
                require("matplotlib", "render", key="pictures", use="pictures without PyVista")
            self._worker = Worker(
                self.backend, self._windows[0] if self.backend == "pyvista" else None
            )
        return self._worker

    def _fall_back(self, note: str) -> None:
        self._drop_worker()
        self.backend = "matplotlib"
        self.note = note

    def _drop_worker(self) -> None:
        if self._worker is not None:
            self._worker.end(SECONDS_TO_END)
            self._worker = None
