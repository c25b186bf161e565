"""Movies play, show every frame or shape, and fall back to GIF."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reference import bent_bodies
from reference.drawn import SIZE

from magmpm.errors import RenderError
from magmpm.viz import movies, style
from magmpm.viz.camera import Framing
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.movies import chosen
from magmpm.viz.snapshot import Snapshot
from magmpm.viz.worker import Renderer

SMALL = (160, 120)


def shapes() -> list[Snapshot]:
    target = bent_bodies.c_shape
    return [
        bent_bodies.catheter(lambda s, k=k: (-20.0 * k, 0.0), target, spacing=1e-3, trial=k)  # type: ignore[misc]
        for k in range(3)
    ]


def test_mp4_lasts_as_long_as_its_shapes_are_shown_and_ends_with_the_last(flat: Renderer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    made = movies.best_shapes_movie(shapes(), tmp_path / "best.mp4", flat, fps=10, size=SMALL)
    assert made.note == ""
    frames, seconds = ffmpeg.count_frames_and_secs(str(made.path))
    # Two shapes for 0.7 s, two fadings of one frame between their ends, the last shape for 2 s.
    assert frames == 2 * 7 + 2 * 1 + 20
    assert seconds == pytest.approx(frames / 10, abs=0.11)
    assert [path.name for path in tmp_path.iterdir()] == ["best.mp4"]

    reader = ffmpeg.read_frames(str(made.path))
    next(reader)
    last = np.frombuffer(list(reader)[-1], dtype=np.uint8).reshape(SMALL[1], SMALL[0], 3).astype(float)
    framing = Framing.of(shapes())
    away = [np.abs(last - flat.image(shape, size=SMALL, framing=framing)).mean() for shape in shapes()]
    # H.264 with halved color changes thin lines a little; another shape changes much more.
    assert away[2] < 4.0
    assert away[2] < 0.6 * min(away[:2])


def test_without_ffmpeg_a_gif_is_written_and_said(
    motion: MotionRenderer, flat: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    best = movies.best_shapes_movie(shapes(), tmp_path / "best.mp4", flat, size=SMALL)
    moved = movies.movie(motion, tmp_path / "movie.mp4", flat, size=SIZE)
    for made, name, frames, size in ((best, "best.gif", 3, SMALL), (moved, "movie.gif", len(motion), SIZE)):
        assert made.path.name == name
        assert "pip install 'magmpm[render]'" in made.note
        with Image.open(made.path) as gif:
            assert (gif.n_frames, gif.size) == (frames, (size[0] // 2, size[1] // 2))  # type: ignore[attr-defined]


def test_what_cannot_be_a_movie_is_refused(flat: Renderer, tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="at least one"):
        movies.best_shapes_movie([], tmp_path / "best.mp4", flat)
    with pytest.raises(RenderError, match="even"):
        movies.best_shapes_movie(shapes(), tmp_path / "best.mp4", flat, size=(161, 120))


def test_the_movie_shows_every_frame_and_holds_the_last(motion: MotionRenderer, flat: Renderer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    made = movies.movie(motion, tmp_path / "movie.mp4", flat, fps=10, size=SIZE)
    assert made.note == ""
    frames, seconds = ffmpeg.count_frames_and_secs(str(made.path))
    assert frames == len(motion) + 10
    assert seconds == pytest.approx(frames / 10, abs=0.11)


def test_long_motions_are_thinned_and_keep_their_ends() -> None:
    numbers = chosen(10_001, 500)
    assert len(numbers) == 500
    assert (numbers[0], numbers[-1]) == (0, 10_000)
    np.testing.assert_array_equal(chosen(7, 500), np.arange(7))


@pytest.mark.parametrize("size", [(160, 120), (1280, 720)])
def test_a_movie_has_the_colors_of_its_pictures_and_says_how_they_are_coded(size: tuple[int, int], tmp_path: Path) -> None:
    """Players take an untagged movie of 720 lines for BT.709 and a smaller one for BT.601: greens and pinks then differ."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for code in style.SEGMENTS:
        color = np.round(255 * np.array(style.rgb(code)))
        image = np.full((size[1], size[0], 3), color, dtype=np.uint8)
        made = movies.frames_movie(tmp_path / "one.mp4", lambda k, image=image: image, np.array([0]))  # type: ignore[misc]
        told = subprocess.run([ffmpeg.get_ffmpeg_exe(), "-i", str(made.path)], capture_output=True, text=True, check=False).stderr
        assert "yuv420p(tv, bt709, progressive)" in told
        reader = ffmpeg.read_frames(str(made.path), input_params=["-colorspace", "bt709"])
        next(reader)
        shown = np.frombuffer(next(reader), dtype=np.uint8).reshape(image.shape)[10, 10].astype(float)
        assert np.abs(shown - color).max() <= 4  # three roundings to whole numbers, in steps of up to 1.2


def test_shapes_without_insets_have_room_for_their_legend(flat: Renderer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for insets, size in ((True, style.TRIAL_SIZE), (False, style.MOVIE_SIZE)):
        made = movies.best_shapes_movie([replace(shapes()[0], insets=insets)], tmp_path / "best.mp4", flat, fps=1)
        assert next(ffmpeg.read_frames(str(made.path)))["size"] == size
