"""Both renderers draw a motion; moments of it side by side, and what their legend holds; movies play, and fall back to GIF."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reference import bent_bodies, drawn, motions
from reference.drawn import MAGNET, SIZE

from magmpm.errors import RenderError
from magmpm.results.trajectory import Motion, MotionWriter
from magmpm.viz import annotations, layout, movies, style
from magmpm.viz.camera import Framing
from magmpm.viz.figure_panels import figure, moments
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.meshes import swept
from magmpm.viz.movies import chosen
from magmpm.viz.snapshot import DrawnSolid, Snapshot
from magmpm.viz.worker import Renderer


def pictures(renderer: Renderer, motion: MotionRenderer) -> tuple[np.ndarray, np.ndarray]:
    return tuple(
        renderer.image(motion.snapshot(k), framing=motion.framing, size=(800, 450)) for k in (2, 6)
    )  # type: ignore[return-value]


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_both_backends_show_body_magnet_ground_and_contact(
    backend: str, motion: MotionRenderer, request: pytest.FixtureRequest
) -> None:
    up, down = pictures(request.getfixturevalue(backend), motion)
    for color in (style.NORTH, style.SOUTH, style.SEGMENTS[0], style.SEGMENTS[1], style.GROUND):
        assert drawn.count(up, color) > 150, color
    # Blue stands for contact: in the legend always, in the view when there is some.
    assert drawn.count(down, style.CONTACT) > drawn.count(up, style.CONTACT) + 60
    assert up.shape == (450, 800, 3)


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_the_fields_arrow_of_a_moment_stands_on_the_picture(
    backend: str, motion: MotionRenderer, request: pytest.FixtureRequest
) -> None:
    """No white box around it: the panel's corner is as it is without a field."""
    renderer = request.getfixturevalue(backend)
    snapshot = motion.snapshot(2)
    tube = swept(np.array([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]]), 0.1)
    wall = DrawnSolid("wall", tube.points, tube.triangles, style.WALL, hollow=True)
    images = [
        renderer.image(
            replace(snapshot, obstacles=(wall,), field=field),
            framing=motion.framing,
            layout=layout.bare((400, 300)),
        )
        for field in (snapshot.field, None)
    ]
    changed = np.flatnonzero((np.abs(images[0].astype(int) - images[1]) > 8).any(axis=2))
    assert 10 < len(changed) < 0.5 * 300 * 400 * 0.17**2


@pytest.mark.parametrize(
    ("times", "middle"),
    [
        ([0.0, 0.1, 0.35, 0.4, 0.2, 0.05, 0.0, 0.0, 0.0], 1),
        ([0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024, 0.04, 0.1], 7),
    ],
    ids=["closes and opens", "goes one way"],
)
def test_moments_are_the_ends_and_what_is_most_unlike_both(
    times: list[float], middle: int, tmp_path: Path
) -> None:
    """Bent the most at 0.1 s; on the way there, 0.04 s is nearest to halfway."""
    model = motions.body()
    writer = MotionWriter(tmp_path, model)
    for k, frame in enumerate(motions.bending(model, times)):
        writer.frame(replace(frame, time=0.01 * k, contacts={}, field=None))
    assert moments(MotionRenderer(Motion.load(tmp_path))) == [0, middle, 8]


def test_the_legend_of_moments_holds_what_is_in_them_and_only_that(tmp_path: Path) -> None:
    """A coil that is out of the picture and contact at other moments are not; poles of a point dipole are."""
    coil = {"position": [0.02, 0.0, 0.5], "axis": [0, 0, 1], "diameter": 0.05, "current": 1.0}
    dipole = {"position": [0.05, 0.0, 0.02], "moment": [0.0, 0.0, 1.0]}
    other = drawn.moving(tmp_path, drawn.surrounded(field={"coils": [coil], "dipole": dipole}))
    seen = [(other.framing.view(1.5), 1.5)]
    above = other.snapshot(2)
    touching = other.snapshot(6)
    assert not len(above.forces)
    assert len(touching.forces)
    texts = {sign.text for sign in annotations.signs([above], seen)}
    assert texts >= {"ground", "clamp", "dipole (N, S)"}
    assert not texts & {"coil", "contact force", "magnet (N, S)"}
    assert "contact force" in {sign.text for sign in annotations.signs([above, touching], seen)}
    assert "coil" in {sign.text for sign in annotations.signs([above])}
    # A movie's legend does not change with the frame.
    assert "contact force" in {sign.text for sign in annotations.legend(above, seen)}


def test_moments_hold_a_magnet_before_it_has_come_near(tmp_path: Path) -> None:
    frames = [{"time": 0.0, "move": [0, 0, 0.12]}, {"time": 0.4, "move": [0, 0, 0.05]}]
    near = drawn.moving(
        tmp_path, drawn.surrounded(field={"magnet": [MAGNET], "over_time": {"keyframes": frames}})
    )
    magnet = np.vstack(
        [o.points for o in near.snapshot(0).obstacles if o.name.startswith("magnet")]
    )

    def reach(framing: Framing) -> float:
        return float(np.abs(framing.view(1.0).project(magnet)[:, :2]).max())

    assert reach(near.framing_of([0, 8])) < 1.0 < reach(near.framing_of([8]))
    assert reach(near.framing) == reach(near.framing_of([8]))  # the movie stays with the body


def test_the_moments_stand_side_by_side_at_one_scale(
    motion: MotionRenderer, flat: Renderer, tmp_path: Path
) -> None:
    with Image.open(figure(motion, tmp_path / "moments.png", flat, width=900)) as image:
        assert abs(image.width - 900) < 4
        assert image.height < image.width
        pixels = np.asarray(image.convert("RGB"))
    thirds = np.array_split(pixels, 3, axis=1)
    # The magnet does not move: it fills as many pixels in each panel.
    shown = [drawn.count(third[: image.height * 3 // 4], style.SOUTH) for third in thirds]
    assert min(shown) > 50
    assert max(shown) - min(shown) < 0.1 * max(shown)


SMALL = (160, 120)


def shapes() -> list[Snapshot]:
    target = bent_bodies.c_shape
    return [
        bent_bodies.catheter(lambda s, k=k: (-20.0 * k, 0.0), target, spacing=1e-3, trial=k)  # type: ignore[misc]
        for k in range(3)
    ]


def test_mp4_lasts_as_long_as_its_shapes_are_shown_and_ends_with_the_last(
    flat: Renderer, tmp_path: Path
) -> None:
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
    last = (
        np.frombuffer(list(reader)[-1], dtype=np.uint8).reshape(SMALL[1], SMALL[0], 3).astype(float)
    )
    framing = Framing.of(shapes())
    away = [
        np.abs(last - flat.image(shape, size=SMALL, framing=framing)).mean() for shape in shapes()
    ]
    # H.264 with halved color changes thin lines a little; another shape changes much more.
    assert away[2] < 4.0
    assert away[2] < 0.6 * min(away[:2])


def test_without_ffmpeg_a_gif_is_written_and_said(
    motion: MotionRenderer, flat: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    best = movies.best_shapes_movie(shapes(), tmp_path / "best.mp4", flat, size=SMALL)
    moved = movies.movie(motion, tmp_path / "movie.mp4", flat, size=SIZE)
    for made, name, frames, size in (
        (best, "best.gif", 3, SMALL),
        (moved, "movie.gif", len(motion), SIZE),
    ):
        assert made.path.name == name
        assert "[render]'" in made.note
        with Image.open(made.path) as gif:
            assert (gif.n_frames, gif.size) == (frames, (size[0] // 2, size[1] // 2))  # type: ignore[attr-defined]


def test_what_cannot_be_a_movie_is_refused(flat: Renderer, tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="at least one"):
        movies.best_shapes_movie([], tmp_path / "best.mp4", flat)
    with pytest.raises(RenderError, match="even"):
        movies.best_shapes_movie(shapes(), tmp_path / "best.mp4", flat, size=(161, 120))


def test_the_movie_shows_every_frame_and_holds_the_last(
    motion: MotionRenderer, flat: Renderer, tmp_path: Path
) -> None:
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
def test_a_movie_has_the_colors_of_its_pictures_and_says_how_they_are_coded(
    size: tuple[int, int], tmp_path: Path
) -> None:
    """Players take an untagged movie of 720 lines for BT.709 and a smaller one for BT.601: greens and pinks then differ."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for code in style.SEGMENTS:
        color = np.round(255 * np.array(style.rgb(code)))
        image = np.full((size[1], size[0], 3), color, dtype=np.uint8)
        made = movies.frames_movie(
            tmp_path / "one.mp4", lambda k, image=image: image, np.array([0])
        )  # type: ignore[misc]
        told = subprocess.run(
            [ffmpeg.get_ffmpeg_exe(), "-i", str(made.path)],
            capture_output=True,
            text=True,
            check=False,
        ).stderr
        assert "yuv420p(tv, bt709, progressive)" in told
        reader = ffmpeg.read_frames(str(made.path), input_params=["-colorspace", "bt709"])
        next(reader)
        shown = (
            np.frombuffer(next(reader), dtype=np.uint8).reshape(image.shape)[10, 10].astype(float)
        )
        assert (
            np.abs(shown - color).max() <= 4
        )  # three roundings to whole numbers, in steps of up to 1.2


def test_shapes_without_insets_have_room_for_their_legend(flat: Renderer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for insets, size in ((True, style.TRIAL_SIZE), (False, style.MOVIE_SIZE)):
        made = movies.best_shapes_movie(
            [replace(shapes()[0], insets=insets)], tmp_path / "best.mp4", flat, fps=1
        )
        assert next(ffmpeg.read_frames(str(made.path)))["size"] == size
