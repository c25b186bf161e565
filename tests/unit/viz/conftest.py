"""Renderers and a motion that several files draw."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from reference import drawn

from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.worker import Renderer


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> MotionRenderer:
    """A catheter that bends up, and down into the ground."""
    return drawn.moving(tmp_path_factory.mktemp("motion"))


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
