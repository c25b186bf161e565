"""The movie plays, holds every shape still, and falls back to GIF."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from viz import movie, samples
from viz.picture import Picture
from viz.process import RenderError
from viz.worker import Renderer

SIZE = (160, 120)


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with Renderer("matplotlib") as opened:
        yield opened


def shapes() -> list[Picture]:
    target = samples.c_shape
    return [
        samples.catheter(lambda s, k=k: (-20.0 * k, 0.0), target, spacing=1e-3, trial=k)  # type: ignore[misc]
        for k in range(3)
    ]


def test_mp4_lasts_as_long_as_its_shapes_are_shown_and_ends_with_the_last(
    renderer: Renderer, tmp_path: Path
) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    made = movie.best_shapes_movie(shapes(), tmp_path / "best.mp4", renderer, fps=10, size=SIZE)
    assert made.note == ""
    frames, seconds = ffmpeg.count_frames_and_secs(str(made.path))
    # Two shapes for 0.7 s, two fadings of one frame between their ends, the last shape for 2 s.
    assert frames == 2 * 7 + 2 * 1 + 20
    assert seconds == pytest.approx(frames / 10, abs=0.11)
    assert [path.name for path in tmp_path.iterdir()] == ["best.mp4"]

    reader = ffmpeg.read_frames(str(made.path))
    next(reader)
    last = np.frombuffer(list(reader)[-1], dtype=np.uint8).reshape(SIZE[1], SIZE[0], 3).astype(float)
    frame = movie.Frame.of(shapes())
    away = [np.abs(last - renderer.image(shape, size=SIZE, frame=frame)).mean() for shape in shapes()]
    # H.264 with halved colour changes thin lines a little; another shape changes much more.
    assert away[2] < 4.0
    assert away[2] < 0.6 * min(away[:2])


def test_without_ffmpeg_a_gif_is_written_and_said(
    renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find, missing = importlib.util.find_spec, "imageio_ffmpeg"
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else find(name))
    made = movie.best_shapes_movie(shapes(), tmp_path / "best.mp4", renderer, size=SIZE)
    assert made.path.name == "best.gif"
    assert "pip install -e '.[render]'" in made.note
    with Image.open(made.path) as gif:
        assert gif.n_frames == 3  # type: ignore[attr-defined]
        assert gif.size == (SIZE[0] // 2, SIZE[1] // 2)


def test_what_cannot_be_a_movie_is_refused(renderer: Renderer, tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="at least one"):
        movie.best_shapes_movie([], tmp_path / "best.mp4", renderer)
    with pytest.raises(RenderError, match="even"):
        movie.best_shapes_movie(shapes(), tmp_path / "best.mp4", renderer, size=(161, 120))
