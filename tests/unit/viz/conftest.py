"""Renderers and a motion that several files draw."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from reference import drawn

from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.worker import Renderer


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> MotionRenderer:
    """A catheter that bends up, and down into the ground."""
    return drawn.moving(tmp_path_factory.mktemp("motion"))


@pytest.fixture
def no_opengl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loader is given broken libraries in place of EGL's and OSMesa's, and VTK crashes."""
    pytest.importorskip("pyvista")
    for name in (
        "libEGL.so",
        "libEGL.so.1",
        "libOSMesa.so",
        *(f"libOSMesa.so.{n}" for n in range(6, 9)),
    ):
        (tmp_path / name).write_text("not a library")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))


@pytest.fixture(scope="module")
def flat() -> Iterator[Renderer]:
    """matplotlib's."""
    with Renderer("matplotlib") as opened:
        yield opened


@pytest.fixture(scope="module")
def solid() -> Iterator[Renderer]:
    """PyVista's, where there is OpenGL."""
    with Renderer() as opened:
        opened.wait_ready()
        if opened.backend != "pyvista":
            pytest.skip("no OpenGL library here")
        yield opened
