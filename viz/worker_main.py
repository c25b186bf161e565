"""What runs inside the drawing process: open a backend, draw a first picture, then answer requests.

The first picture is the probe: where OpenGL is missing the process dies on it and the parent knows.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.results.whole_file import FULL, REFUSED, explained, whole_file

Draw = Callable[..., np.ndarray]
_backend: Draw | None = None
_stage_backend: Draw | None = None


def main(argv: list[str]) -> None:
    """argv: ignored, file descriptor of the pipe, backend. Ends when the pipe does."""
    # Ctrl-C is for the parent to act on; this process ends when the parent closes the pipe, or is gone.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _no_core_dump()
    pipe = Connection(int(argv[1]))
    try:
        global _backend, _stage_backend
        _backend, _stage_backend = _opened(argv[2])
        _probe(_backend)
    except Exception as error:
        pipe.send(("error", _told(error)))
        return
    pipe.send(("ready", None))
    while True:
        try:
            function, args = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer: tuple[str, Any] = ("done", function(*args))
        except Exception as error:
            answer = ("error", _told(error))
        try:
            pipe.send(answer)
        except OSError:
            return


def _told(error: Exception) -> str:
    """What to say of an exception: of a file that can't be written, its name and the remedy."""
    if isinstance(error, OSError) and error.filename is not None and error.errno in (*FULL, *REFUSED):
        return explained(error)
    return f"{type(error).__name__}: {error}"


def draw(picture: Any, frame: Any, size: tuple[int, int], path: str | None) -> np.ndarray | None:
    """Draw in this process: into the PNG file `path`, or return the image (h, w, 3) uint8 if that is None."""
    if _backend is None:
        raise RuntimeError("no backend is open in this process; use viz.worker.Renderer")
    return _saved(_backend(picture, frame, size), path)


def draw_stage(
    stage: Any, shot: Any, size: tuple[int, int], layout: Any, path: str | None
) -> np.ndarray | None:
    """As `draw`, a moment of a motion."""
    if _stage_backend is None:
        raise RuntimeError("no backend is open in this process; use viz.worker.Renderer")
    return _saved(_stage_backend(stage, shot, size, layout), path)


def _saved(image: np.ndarray, path: str | None) -> np.ndarray | None:
    if path is None:
        return image
    save_png(image, path)
    return None


def save_png(image: np.ndarray, path: str) -> None:
    """Write an image (h, w, 3) uint8; the file is whole or not there."""
    from PIL import Image

    with whole_file(Path(path)) as unfinished:
        Image.fromarray(image).save(unfinished, format="PNG", compress_level=4)


def _opened(backend: str) -> tuple[Draw, Draw]:
    """The functions of a backend that draw pictures and stages; imports it."""
    if backend == "matplotlib":
        from viz import matplotlib_scene, stage_flat

        return matplotlib_scene.draw, stage_flat.draw
    # PyVista imports mypy where it finds it, for a plugin nobody uses here: 20 MB.
    sys.modules["mypy"] = None  # type: ignore[assignment]
    from viz.scene3d import Scene3D

    window = Scene3D()
    return window.draw, window.stage


def _probe(backend: Draw) -> None:
    """Draw a small body and look for it. Raises RuntimeError if the picture is blank."""
    from viz import samples, style

    body = samples.catheter(spacing=1e-3)
    image = backend(body, None, style.TRIAL_SIZE)
    # The palette's mint is in no text and no arrow: it must be the body's second segment.
    red, green, blue = (image[..., k].astype(int) for k in range(3))
    if np.count_nonzero((green > red + 60) & (green > blue)) < 100:
        raise RuntimeError("the first picture came out blank")


def _no_core_dump() -> None:
    """A crash in OpenGL is expected where it is missing: it must not leave a file behind."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, ValueError, OSError):
        pass
