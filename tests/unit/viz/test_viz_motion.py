"""What stands on the stage of a motion, where it is seen from, and that both backends draw it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from reference import motions

from magmpm.results.trajectory import Motion, MotionWriter
from viz import motion_movie, motion_plots, scenery, stage_layout, style
from viz.play import Body, Play, Still
from viz.process import RenderError
from viz.sheet import chosen, moments, sheet
from viz.stage import Shot, Stage
from viz.worker import Renderer

SIZE = (320, 180)
CATHETER = {"length": 0.04, "diameter": 0.004, "clamp": "base", "segments": [{"length": 0.01}, {}, {}]}
MAGNET = {"cylinder": {"diameter": 0.01, "length": 0.02}, "position": [0.05, 0.0, 0.02], "axis": [0, 0, 1]}


def scene(**more: Any) -> dict[str, Any]:
    return {
        "name": "bending",
        "body": {"catheter": CATHETER},
        "effects": {"ground": {"point": [0, 0, -0.006], "normal": [0, 0, 1]}, "gravity": {}},
        "field": {"magnet": [MAGNET]},
        **more,
    }


def played(folder: Path, said: dict[str, Any] | None = None, frames: int = 9) -> Play:
    """A catheter that bends up, and down into the ground."""
    model = motions.body()
    model.scene = SimpleNamespace(to_si=lambda: scene() if said is None else said, name="bending")
    motions.write(MotionWriter(folder, model), motions.bending(model, np.linspace(0.0, 0.4, frames)))
    return Play(Motion.load(folder))


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Play:
    return played(tmp_path_factory.mktemp("motion"))


@pytest.fixture(scope="module")
def flat() -> Iterator[Renderer]:
    with Renderer("matplotlib") as opened:
        yield opened


@pytest.fixture(scope="module")
def solid() -> Iterator[Renderer]:
    with Renderer() as opened:
        opened.wait_ready()
        if opened.backend != "pyvista":
            pytest.skip("no OpenGL library here")
        yield opened


def count(image: np.ndarray, colour: str, within: int = 40) -> int:
    """Pixels near a colour."""
    return int(
        np.count_nonzero(
            np.abs(image.astype(int) - np.round(255 * np.array(style.rgb(colour)))).max(axis=2) < within
        )
    )


def test_the_body_is_a_closed_tube_with_its_segments_and_follows_the_motion(play: Play) -> None:
    straight, up = play.stage(0), play.stage(2)
    assert straight.points[:, 0].max() == pytest.approx(motions.LENGTH, abs=1e-4)
    ends = [straight.points[straight.triangles[straight.part == k], 0].max() for k in range(3)]
    np.testing.assert_allclose(ends, [0.01, 0.025, 0.04], atol=1e-4)
    # Bent to a circle of curvature 60/m at a quarter of the period.
    tip = motions.bent(np.array([[motions.LENGTH, 0.0, 0.0]]), 60.0)[0][0]
    assert np.linalg.norm(up.points - tip, axis=1).min() < 0.1 * motions.DIAMETER


def test_one_arrow_for_each_magnetised_part_along_its_magnetisation(play: Play) -> None:
    arrows = play.stage(0).arrows
    assert len(arrows) == 3
    directions = arrows[:, 1] / np.linalg.norm(arrows[:, 1], axis=1, keepdims=True)
    np.testing.assert_allclose(directions, np.eye(3)[[0, 1, 0]], atol=1e-6)
    middles = arrows[:, 0] + 0.5 * arrows[:, 1]
    np.testing.assert_allclose(middles[:, 0], motions.LENGTH * np.array([1, 3, 5]) / 6, atol=1e-3)


def test_a_magnetisation_that_turns_gets_several_arrows(tmp_path: Path) -> None:
    model = motions.body(segments=1)
    angle = 2 * np.pi * model.particles.position[:, 0] / motions.LENGTH
    model.magnet = 0.1 * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    motions.write(MotionWriter(tmp_path, model), motions.bending(model, [0.0]))
    arrows = Play(Motion.load(tmp_path)).stage(0).arrows
    assert len(arrows) == 8
    turned = np.unwrap(np.arctan2(arrows[:, 1, 2], arrows[:, 1, 0]))
    np.testing.assert_allclose(np.diff(turned), 2 * np.pi / 8, rtol=0.05)


def test_contact_is_shown_when_there_is_some(play: Play) -> None:
    above, below = play.stage(2), play.stage(6)
    assert len(above.contact) == 0
    assert len(above.forces) == 0
    assert len(below.contact) > 3
    np.testing.assert_allclose(below.contact[:, 2], -0.006)
    ((start, vector),) = below.forces
    assert vector[2] > 0
    assert vector[:2] == pytest.approx(0.0)
    assert start[2] == pytest.approx(-0.006)


def test_everything_stays_in_view_for_the_whole_motion(play: Play) -> None:
    (view,) = stage_layout.views(play.shot, SIZE, stage_layout.PAGE)
    aspect = stage_layout.MAIN.aspect(SIZE[0] / SIZE[1])
    for k in range(len(play)):
        stage = play.stage(k)
        for points in (stage.points, *(p.points for p in stage.props if p.framed)):
            flat = view.project(points)
            assert np.abs(flat[:, 0]).max() <= aspect
            assert np.abs(flat[:, 1]).max() <= 1.0


def test_down_is_where_gravity_points(tmp_path: Path) -> None:
    """A catheter along +x with gravity along +x hangs: its tip is below its base in the picture, and the floor below both."""
    hanging = scene(effects={"gravity": {"acceleration": [9.81, 0.0, 0.0]}}, field={})
    shot = played(tmp_path, hanging, frames=3).shot
    view = shot.view(1.6)
    base, tip, floor = view.project(np.array([[0, 0, 0], [motions.LENGTH, 0, 0], shot.floor().mean(axis=0)]))
    assert base[1] > tip[1] + 0.5 > floor[1] + 0.5
    assert abs(base[0] - tip[0]) < 0.1
    np.testing.assert_allclose(shot.plane.normal, [-1, 0, 0], atol=1e-12)


def test_what_is_tall_is_seen_from_two_sides_at_one_scale(play: Play, tmp_path: Path, flat: Renderer) -> None:
    """A quarter of a turn about the vertical apart, whatever is vertical; all of the body in both panels."""
    assert stage_layout.page_of(play.shot) == stage_layout.PAGE
    model = motions.body()
    stretched = {"effects": {"gravity": {"acceleration": [9.81, 0.0, 0.0]}}, "body": {"catheter": CATHETER}}
    model.scene = SimpleNamespace(to_si=lambda: stretched, name="hanging")
    motions.write(MotionWriter(tmp_path, model), motions.bending(model, [0.0, 0.01]))
    tall = Play(Motion.load(tmp_path))
    layout = stage_layout.page_of(tall.shot)
    assert layout == stage_layout.TWO_VIEWS
    one, other = stage_layout.views(tall.shot, SIZE, layout)
    assert one.half_height == other.half_height
    np.testing.assert_allclose(other.toward @ tall.shot.up, one.toward @ tall.shot.up, atol=1e-12)
    level = [view.toward - (view.toward @ tall.shot.up) * tall.shot.up for view in (one, other)]
    assert level[0] @ level[1] == pytest.approx(0.0, abs=1e-12)
    stage = tall.stage(1)
    for view, panel in zip((one, other), layout.mains):
        places = view.project(stage.points)
        assert np.abs(places[:, 0]).max() <= panel.aspect(SIZE[0] / SIZE[1])
        assert np.abs(places[:, 1]).max() <= 1.0
    image = flat.stage_image(stage, tall.shot, size=(800, 450))
    for half in (image[80:370, :400], image[80:370, 400:]):
        assert count(half, style.SEGMENTS[1]) > 100


def test_the_caption_tells_time_and_pace(play: Play) -> None:
    assert play.stage(2, 10.0).caption() == "t = 0.100 s   10× slower"
    assert play.stage(2, 1.0).caption() == "t = 0.100 s   real time"
    times = np.linspace(0.0, 0.4, 41)
    # 40 intervals in 40/10 s of film show 0.4 s.
    assert motion_movie.pace(times, 10.0) == pytest.approx(10.0)


def test_legend_and_curve_only_of_what_is_there(play: Play, tmp_path: Path) -> None:
    assert {item.text for item in stage_layout.legend(play.stage(0))} >= {
        "ground",
        "contact force",
        "magnet (N, S)",
    }
    assert stage_layout.varies(play.stage(0))
    bare = played(tmp_path, {"body": {"catheter": CATHETER}}, frames=2)
    assert {item.text for item in stage_layout.legend(bare.stage(0))} == {
        "magnetic",
        "magnetisation",
        "clamp",
    }


def test_moving_and_turning_magnets_are_drawn_where_they_are() -> None:
    field = {
        "magnet": [MAGNET],
        "over_time": {
            "keyframes": [{"time": 0.0, "move": [0, 0, 0]}, {"time": 1.0, "move": [-0.02, 0, 0]}],
            "rotation": {"axis": [0, 0, 1], "frequency": 0.5, "center": [0, 0, 0], "turns": 0.25},
        },
    }
    for time, centre in ((0.0, [0.05, 0.0, 0.02]), (0.5, [0.0, 0.04, 0.02]), (1.0, [0.0, 0.03, 0.02])):
        props = scenery.sources({"field": field}, time)
        middle = 0.5 * (
            np.max([p.points.max(axis=0) for p in props], axis=0)
            + np.min([p.points.min(axis=0) for p in props], axis=0)
        )
        np.testing.assert_allclose(middle, centre, atol=1e-9)


@pytest.mark.parametrize(
    ("magnet", "north"),
    [
        (MAGNET, [0, 0, 1]),
        ({**MAGNET, "magnetization": [0, 0, -1]}, [0, 0, -1]),
        ({**MAGNET, "magnetization": [1, 0, 0]}, [1, 0, 0]),
        (
            {"cuboid": {"size": [0.03, 0.02, 0.01]}, "position": [0.05, 0.0, 0.02], "axis": [0, 0, 1]},
            [0, 0, 1],
        ),
    ],
)
def test_red_is_north(magnet: dict[str, Any], north: list[float]) -> None:
    middle = {
        p.colour: p.points[p.triangles].mean(axis=(0, 1))
        for p in scenery.sources({"field": {"magnet": magnet}}, 0.0)
    }
    away = middle[style.NORTH] - middle[style.SOUTH]
    # A facet that lies across the border is on one side of it.
    np.testing.assert_allclose(away / np.linalg.norm(away), north, atol=0.01)


def test_a_block_has_its_edges_where_the_scene_says() -> None:
    magnet = {"cuboid": {"size": [0.03, 0.02, 0.01]}, "position": [0.0, 0.0, 0.0], "axis": [0, 0, 1]}
    props = scenery.sources({"field": {"magnet": magnet}}, 0.0)
    np.testing.assert_allclose(
        np.ptp(np.vstack([p.points for p in props]), axis=0), [0.03, 0.02, 0.01], atol=1e-12
    )


def test_a_lumen_is_drawn_and_its_distance_known() -> None:
    """The same tube as a path and as a mesh: heights agree with the distance to the wall, within the facets' size."""
    from magmpm.bodies.surface_mesh import Mesh, pack_mesh
    from viz.shapes import tube

    shape = tube([0.06], 0.005, 0.0, 0.06)
    mesh = pack_mesh(Mesh(1e3 * shape.points, shape.triangles))
    lumens = [
        {"tube": {"radius": 0.005, "path": [[0, 0, 0], [0.06, 0, 0]]}},
        {"surface": {"mesh": mesh, "unit": "mm"}},
    ]
    points = np.array([[0.03, 0.0, 0.0035], [0.02, -0.0045, 0.0], [0.03, 0.0, 0.0]])
    for walls in lumens:
        (wall,) = scenery.standing({"effects": {"walls": walls}}, 0.04)
        assert wall.hollow
        np.testing.assert_allclose(np.ptp(wall.points, axis=0), [0.06, 0.01, 0.01], rtol=0.01)
        height = scenery.surfaces({"effects": {"walls": walls}})["walls"].height(points)
        np.testing.assert_allclose(height, [0.0015, 0.0005, 0.005], atol=1e-4)


def test_edges_of_a_drawing_stay_sharp_and_round_sides_smooth() -> None:
    """Of a welded rod: points of the two end circles are split into side and end, those of the side are not."""
    from viz.surface import creased

    turn = 2 * np.pi * np.arange(24) / 24
    circle = np.stack([0 * turn, np.cos(turn), np.sin(turn)], axis=1)
    points = np.vstack([circle, circle + np.eye(3)[0], [[0, 0, 0], [1, 0, 0]]])
    k, after = np.arange(24), (np.arange(24) + 1) % 24
    sides = np.vstack([np.stack([k, 24 + after, 24 + k], axis=1), np.stack([k, after, 24 + after], axis=1)])
    ends = np.vstack(
        [
            np.stack([np.full(24, 48), after, k], axis=1),
            np.stack([np.full(24, 49), 24 + k, 24 + after], axis=1),
        ]
    )
    surface = creased(points, np.vstack([sides[:, ::-1], ends]), 3)
    assert len(surface.points) == 2 * 24 + 2 * 24 + 2
    assert set(surface.part) == {3}


def test_sources_are_drawn_where_the_solver_has_them() -> None:
    """A keyframed move and a rotation about a centre: as fields.outside_field places the field itself; blocks lie as it lays them."""
    from magmpm.fields.magnets import frame_of
    from magmpm.fields.schedule import places
    from magmpm.fields.sources import FieldSource

    axis = [0.6, 0.0, -0.8]
    block = {
        "cuboid": {"size": [0.03, 0.02, 0.01]},
        "position": [0.05, 0.01, 0.02],
        "axis": axis,
        "remanence": 1.2,
    }
    over = {
        "keyframes": [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 1.0, "move": [-0.02, 0.01, 0.0]}],
        "rotation": {
            "axis": [0.0, 0.6, 0.8],
            "frequency": -0.4,
            "center": [0.01, 0.0, 0.02],
            "start": 0.2,
            "turns": 0.25,
        },
    }
    source = FieldSource.model_validate({"magnet": block, "over_time": over})
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * [0.015, 0.01, 0.005]
    for time in (0.0, 0.3, 0.7, 2.0):
        (place,) = places(source, np.array([time]))
        wanted = (corners @ frame_of(axis).T + block["position"]) @ place["frame"].reshape(3, 3).T + place[
            "origin"
        ]
        props = scenery.sources({"field": source.model_dump(mode="json")}, time)
        points = np.vstack([p.points for p in props])
        away = np.linalg.norm(wanted[:, None] - points, axis=2).min(axis=1)
        assert away.max() < 1e-9


def test_a_far_magnet_does_not_make_the_body_a_speck(tmp_path: Path) -> None:
    far = {**MAGNET, "position": [0.5, 0.0, 0.0]}
    near, away = played(tmp_path / "near"), played(tmp_path / "far", scene(field={"magnet": [far]}))
    assert away.shot.view(1.5).half_height <= near.shot.view(1.5).half_height


def drawn(renderer: Renderer, play: Play) -> tuple[np.ndarray, np.ndarray]:
    return tuple(renderer.stage_image(play.stage(k), play.shot, size=(800, 450)) for k in (2, 6))  # type: ignore[return-value]


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_both_backends_show_body_magnet_ground_and_contact(
    backend: str, play: Play, request: pytest.FixtureRequest
) -> None:
    up, down = drawn(request.getfixturevalue(backend), play)
    for colour in (style.NORTH, style.SOUTH, style.SEGMENTS[0], style.SEGMENTS[1], style.GROUND):
        assert count(up, colour) > 150, colour
    # Blue stands for contact: in the legend always, in the view when there is some.
    assert count(down, style.CONTACT) > count(up, style.CONTACT) + 60
    assert up.shape == (450, 800, 3)


def test_without_an_opengl_library_matplotlib_draws_the_motion(
    play: Play, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where no OpenGL is installed: VTK's window crashes its process, and nothing else."""
    pytest.importorskip("pyvista")
    for name in ("libEGL.so", "libEGL.so.1", "libOSMesa.so", *(f"libOSMesa.so.{n}" for n in range(6, 9))):
        (tmp_path / name).write_text("not a library")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    with Renderer() as renderer:
        made = motion_movie.movie(play, tmp_path / "movie.mp4", renderer, size=SIZE)
        assert renderer.backend == "matplotlib"
        assert "apt-get install" in renderer.note
    assert made.path.stat().st_size > 1000


def test_both_backends_show_things_at_the_same_place(play: Play, flat: Renderer, solid: Renderer) -> None:
    for one, other in zip(drawn(flat, play), drawn(solid, play)):
        for colour in (style.SOUTH, style.SEGMENTS[1]):
            places = [
                np.argwhere(
                    np.abs(i.astype(int) - np.round(255 * np.array(style.rgb(colour)))).max(axis=2) < 50
                )[:, :2].mean(axis=0)
                for i in (one[:350], other[:350])
            ]
            # Shading decides which pixels come near the colour: a few of 450.
            assert np.abs(places[0] - places[1]).max() < 12


def test_the_movie_shows_every_frame_and_holds_the_last(play: Play, flat: Renderer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    made = motion_movie.movie(play, tmp_path / "movie.mp4", flat, fps=10, size=SIZE)
    assert made.note == ""
    frames, seconds = ffmpeg.count_frames_and_secs(str(made.path))
    assert frames == len(play) + 10
    assert seconds == pytest.approx(frames / 10, abs=0.11)


def test_without_ffmpeg_the_movie_is_a_gif(
    play: Play, flat: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find, missing = importlib.util.find_spec, "imageio_ffmpeg"
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else find(name))
    made = motion_movie.movie(play, tmp_path / "movie.mp4", flat, size=SIZE)
    assert made.path.name == "movie.gif"
    assert "'.[render]'" in made.note
    with Image.open(made.path) as gif:
        assert gif.n_frames == len(play)  # type: ignore[attr-defined]


def test_long_motions_are_thinned_and_keep_their_ends() -> None:
    numbers = chosen(10_001, 500)
    assert len(numbers) == 500
    assert (numbers[0], numbers[-1]) == (0, 10_000)
    np.testing.assert_array_equal(chosen(7, 500), np.arange(7))


def test_moments_show_what_closes_and_opens_again_closed(tmp_path: Path) -> None:
    model = motions.body()
    bends = [0.0, 0.1, 0.35, 0.4, 0.2, 0.05, 0.0, 0.0, 0.0]
    frames = list(motions.bending(model, bends))
    with MotionWriter(tmp_path, model) as writer:
        for k, frame in enumerate(frames):
            writer.frame(0.01 * k, frame.x, frame.v, frame.F, frame.P, frame.energies)
    play = Play(Motion.load(tmp_path))
    apart = [float(np.abs(play.motion.position(k) - play.motion.position(0)).max()) for k in range(len(play))]
    assert moments(play) == [0, int(np.argmax(apart)), 8]


def test_the_legend_of_moments_holds_what_is_in_them_and_only_that(play: Play, tmp_path: Path) -> None:
    """A coil that is out of the picture and contact at other moments are not; poles of a point dipole are."""
    coil = {"position": [0.02, 0.0, 0.5], "axis": [0, 0, 1], "diameter": 0.05}
    dipole = {"position": [0.05, 0.0, 0.02], "moment": [0.0, 0.0, 1.0]}
    other = played(tmp_path, scene(field={"coils": [coil], "dipole": dipole}))
    seen = [(other.shot.view(1.5), 1.5)]
    above, touching = other.stage(2), other.stage(6)
    assert not len(above.forces)
    assert len(touching.forces)
    texts = {text for _, _, text in stage_layout.signs([above], seen)}
    assert texts >= {"ground", "clamp", "point dipole (N, S)"}
    assert not texts & {"coil", "contact force", "magnet (N, S)"}
    assert "contact force" in {text for _, _, text in stage_layout.signs([above, touching], seen)}
    assert "coil" in {text for _, _, text in stage_layout.signs([above])}
    # A movie's legend does not change with the frame.
    assert "contact force" in {item.text for item in stage_layout.legend(above, seen)}


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_the_fields_arrow_of_a_moment_stands_on_the_picture(
    backend: str, play: Play, request: pytest.FixtureRequest
) -> None:
    """No white box around it: the panel's corner is as it is without a field."""
    renderer, stage = request.getfixturevalue(backend), play.stage(2)
    wall = scenery.Prop(
        "wall", *scenery.swept(np.array([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]]), 0.1), style.WALL, hollow=True
    )
    layout = stage_layout.bare((400, 300))
    assert layout.field is not None
    images = [
        renderer.stage_image(
            replace(stage, props=(wall,), field=field), play.shot, size=(400, 300), layout=layout
        )
        for field in (stage.field, None)
    ]
    changed = np.flatnonzero((np.abs(images[0].astype(int) - images[1]) > 8).any(axis=2))
    assert 10 < len(changed) < 0.5 * 300 * 400 * 0.17**2


def test_moments_hold_a_magnet_before_it_has_come_near(tmp_path: Path) -> None:
    frames = [{"time": 0.0, "move": [0, 0, 0.12]}, {"time": 0.4, "move": [0, 0, 0.05]}]
    near = played(tmp_path, scene(field={"magnet": [MAGNET], "over_time": {"keyframes": frames}}))
    magnet = np.vstack([p.points for p in near.stage(0).props if p.name.startswith("magnet")])

    def reach(shot: Shot) -> float:
        return float(np.abs(shot.view(1.0).project(magnet)[:, :2]).max())

    assert reach(near.shot_of([0, 8])) < 1.0 < reach(near.shot_of([8]))
    assert reach(near.shot) == reach(near.shot_of([8]))  # the movie stays with the body


def test_the_moments_stand_side_by_side_at_one_scale(play: Play, flat: Renderer, tmp_path: Path) -> None:
    with Image.open(sheet(play, tmp_path / "moments.png", flat, width=900)) as image:
        assert abs(image.width - 900) < 4
        assert image.height < image.width
        pixels = np.asarray(image.convert("RGB"))
    thirds = np.array_split(pixels, 3, axis=1)
    # The magnet does not move: it fills as many pixels in each panel.
    shown = [count(third[: image.height * 3 // 4], style.SOUTH) for third in thirds]
    assert min(shown) > 50
    assert max(shown) - min(shown) < 0.1 * max(shown)


def test_a_run_that_blew_up_is_drawn_as_far_as_it_is_finite(tmp_path: Path, flat: Renderer) -> None:
    model = motions.body()
    with MotionWriter(tmp_path, model) as writer:
        good, bad = motions.bending(model, [0.0, 0.1])
        writer.frame(good.time, good.x, good.v, good.F, good.P, good.energies)
        bad.x[:50] = np.nan
        writer.frame(bad.time, bad.x, bad.v, bad.F, bad.P, bad.energies)
    play = Play(Motion.load(tmp_path))
    stage = play.stage(1)
    assert 0 < len(stage.triangles) < len(play.stage(0).triangles)
    assert count(flat.stage_image(stage, play.shot, size=SIZE), style.SEGMENTS[0]) > 20


def test_a_motion_without_frames_is_refused(tmp_path: Path) -> None:
    MotionWriter(tmp_path, motions.body())
    with pytest.raises(RenderError, match="no frames"):
        Play(Motion.load(tmp_path))


def test_a_result_of_a_strip_is_drawn(flat: Renderer) -> None:
    """Without a catheter's centreline: sharp edges from the scene, colours by segment, magnetisation arrows."""
    X = np.stack(np.meshgrid(np.arange(40), np.arange(10), np.arange(4), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    X = (X + np.array([0.5, -4.5, -1.5])) * 0.5e-3
    segment = (X[:, 0] > 0.01).astype(np.int32)
    result = SimpleNamespace(
        name="strip",
        scene={
            "body": {
                "catheter": None,
                "strip": {
                    "length": 0.02,
                    "width": 0.005,
                    "thickness": 0.002,
                    "clamp": "base",
                    "segments": [{}, {}],
                },
            }
        },
        particle_reference=X,
        particle_position=motions.bent(X, 40.0)[0],
        particle_volume=np.full(len(X), 0.125e-9),
        particle_segment=segment,
        segment_remanence=0.1 * np.array([[np.sin(0.4) / 0.4, 0, (1 - np.cos(0.4)) / 0.4], [0, 0, 0]]),
        field=np.array([0, 0, 8e-3]),
    )
    still = Still(result)
    stage: Stage = still.picture()
    assert stage.caption() == ""
    assert len(stage.arrows) == 1
    # Bent by 40/m: the magnetisation at 5 mm has turned by 0.2 rad with the strip.
    vector = stage.arrows[0, 1] / np.linalg.norm(stage.arrows[0, 1])
    np.testing.assert_allclose(vector, [np.cos(0.2), 0.0, np.sin(0.2)], atol=0.02)
    low, high = stage.points.min(axis=0), stage.points.max(axis=0)
    assert high[1] - low[1] == pytest.approx(0.005, rel=1e-2)
    image = flat.stage_image(stage, still.shot, size=(800, 450))
    assert count(image, style.SEGMENTS[0]) > 300
    assert count(image, style.UNMAGNETISED) > 300


def test_a_magnet_stands_where_the_equilibrium_met_it() -> None:
    """At the end of its schedule. Where there is no field at all, none is spoken of."""
    X = np.stack(np.meshgrid(np.arange(40), np.arange(4), np.arange(4), indexing="ij"), axis=-1).reshape(-1, 3)
    X = (X + np.array([0.5, -1.5, -1.5])) * 0.5e-3
    dipole = {"moment": [0.0, 0.0, 1.0], "position": [0.03, 0.0, 0.0]}
    moves = [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 2.0, "move": [0.0, 0.01, 0.0]}]
    shape = {"length": 0.02, "width": 0.002, "thickness": 0.002, "clamp": "base", "segments": [{}]}
    result = SimpleNamespace(
        name="strip",
        scene={"body": {"strip": shape}, "field": {"dipole": [dipole], "over_time": {"keyframes": moves}}},
        particle_reference=X,
        particle_position=X,
        particle_volume=np.full(len(X), 0.125e-9),
        particle_segment=np.zeros(len(X), dtype=np.int32),
        segment_remanence=np.array([[0.1, 0, 0]]),
        field=np.array([0, 0, 8e-3]),
    )
    stage = Still(result).picture()
    poles = np.vstack([prop.points for prop in stage.props if prop.name.startswith("point dipole")])
    np.testing.assert_allclose(poles.mean(axis=0), [0.03, 0.01, 0.0], atol=1e-6)
    assert stage_layout.field_text(stage) == "|B| = 8.0 mT"
    none = SimpleNamespace(**{**vars(result), "field": np.zeros(3), "scene": {"body": {"strip": shape}}})
    assert stage_layout.field_text(Still(none).picture()) == ""


def test_a_body_in_plane_strain_keeps_its_width() -> None:
    """One layer of particles stands for all of it."""
    X = np.stack(np.meshgrid(np.arange(40), [0], np.arange(4), indexing="ij"), axis=-1).reshape(-1, 3)
    X = (X + np.array([0.5, 0.0, -1.5])) * 0.5e-3
    strip = {"length": 0.02, "width": 0.005, "thickness": 0.002, "plane_strain": True, "segments": [{}]}
    remanence = np.tile([0.1, 0.0, 0.0], (len(X), 1))
    body = Body(
        {"body": {"strip": strip}}, X, np.full(len(X), 0.125e-9), np.zeros(len(X), dtype=int), remanence
    )
    moved = body.points(motions.bent(X, 40.0)[0])
    np.testing.assert_allclose([moved[:, 1].min(), moved[:, 1].max()], [-0.0025, 0.0025], rtol=1e-12)
    wanted = motions.bent(body.surface.points, 40.0)[0]
    assert np.abs(moved - wanted).max() < 0.5 * 40.0 * (3 * 0.5e-3) ** 2  # as in test_viz_surface


def test_energies_and_forces_are_plotted(play: Play, tmp_path: Path) -> None:
    path = motion_plots.motion(
        play.motion.energies, play.motion.contacts, tmp_path / "energies.svg", "bending"
    )
    text = path.read_text()
    for word in ("kinetic", "elastic", "magnetic torque", "total", "ground", "time (s)"):
        assert word in text
    alone = motion_plots.motion(play.motion.energies, {}, tmp_path / "alone.svg")
    assert "contact force" not in alone.read_text()


def test_labels_of_the_plots_stand_whole(tmp_path: Path) -> None:
    """One spike among zeros: its axis gets wide ticks once the layout is made, and they pushed the label over the edge."""
    time = np.linspace(0.0, 0.02, 21)
    spike = np.where(time == time[19], 3.46e-3, 0.0)
    energies = {
        "t": time,
        "kinetic": 3e-6 * np.sin(300 * time) ** 2,
        "elastic": 6e-6 * np.sin(300 * time),
        "total": -6.9e-6 * np.sin(400 * time),
    }
    walls = {"t": time, "Fx": -0.03 * spike, "Fy": -0.1 * spike, "Fz": spike}
    with Image.open(motion_plots.motion(energies, {"walls": walls}, tmp_path / "energies.png")) as image:
        pixels = np.asarray(image.convert("L"))
    for edge in (pixels[:2], pixels[-2:], pixels[:, :2], pixels[:, -2:]):
        assert edge.min() > 250
