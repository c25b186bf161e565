"""Drawing process: open a renderer, draw a first picture, then answer requests.

The first picture is the probe: where OpenGL is missing the process dies of it, and the parent knows.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.errors import RenderError
from magmpm.results.whole_file import FULL, REFUSED, explained
from magmpm.viz import style
from magmpm.viz.camera import Framing
from magmpm.viz.layout import PAGE, Layout
from magmpm.viz.meshes import tube
from magmpm.viz.picture_file import save_image
from magmpm.viz.snapshot import Snapshot

if TYPE_CHECKING:
    from magmpm.viz.drawing import Canvas

_canvas: Canvas | None = None


def begin(
    pipe: object, backend: str
) -> Callable[[tuple[Callable[..., Any], tuple[Any, ...]]], Any]:
    """Open the renderer; return what draws. Raises RenderError, also for all that goes wrong in drawing."""
    _no_core_dump()
    global _canvas
    try:
        _canvas = _opened(backend)
        _probe()
    except Exception as error:
        raise RenderError(_text_of(error)) from None
    return _drawn


def _drawn(request: tuple[Callable[..., Any], tuple[Any, ...]]) -> Any:
    function, args = request
    try:
        return function(*args)
    except Exception as error:
        raise RenderError(_text_of(error)) from None


def _text_of(error: Exception) -> str:
    """Describe an exception: of a file that can't be written, its name and the remedy."""
    if (
        isinstance(error, OSError)
        and error.filename is not None
        and error.errno in (*FULL, *REFUSED)
    ):
        return explained(error)
    return f"{type(error).__name__}: {error}"


def draw(
    snapshot: Snapshot, framing: Framing, size: tuple[int, int], layout: Layout, path: str | None
) -> np.ndarray | None:
    """Draw in this process: into the file `path` (PNG, SVG or PDF), whole or not there, or return the image (h, w, 3) uint8."""
    if _canvas is None:
        raise RuntimeError("no renderer is open in this process; use viz.worker.Renderer")
    from magmpm.viz import (
        drawing,
    )  # Pillow stays out of the caller, which imports this file as well

    image = drawing.draw(_canvas, snapshot, framing, size, layout)
    if path is None:
        return image
    save_image(image, path, compress_level=4)
    return None


def _opened(backend: str) -> Canvas:
    """A canvas of a backend; imports it."""
    if backend == "matplotlib":
        from magmpm.viz.matplotlib_renderer import MatplotlibCanvas

        return MatplotlibCanvas()
    # PyVista imports mypy where it finds it, for a plugin nobody uses here: 20 MB.
    sys.modules["mypy"] = None  # type: ignore[assignment]
    from magmpm.viz.vtk_renderer import VtkCanvas

    return VtkCanvas()


def _probe() -> None:
    """Draw a small rod and look for it. Raises RuntimeError if the picture is blank."""
    rod = Snapshot(
        body=tube([0.02, 0.04], 2e-3, 0.0, 1e-3),
        magnetized=np.ones(2, dtype=bool),
        length=0.04,
        thickness=4e-3,
    )
    image = draw(rod, Framing.of(rod), style.TRIAL_SIZE, PAGE, None)
    assert image is not None  # since no path was given
    # The palette's mint is in no text and no arrow: it must be the rod's second part.
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
