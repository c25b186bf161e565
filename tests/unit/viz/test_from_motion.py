"""Snapshots of a motion: their contents, their view, and the text beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference import drawn, motions
from reference.drawn import MAGNET, SIZE

from magmpm.errors import RenderError
from magmpm.results.trajectory import Motion, MotionWriter
from magmpm.scene import Scene
from magmpm.viz import annotations, layout, movies, style
from magmpm.viz.body import DrawnBody
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.meshes import TriangleSurface
from magmpm.viz.worker import Renderer


def test_the_body_is_a_closed_tube_with_its_segments_and_follows_the_motion(
    motion: MotionRenderer,
) -> None:
    straight = motion.snapshot(0).body
    up = motion.snapshot(2).body
    assert isinstance(straight, TriangleSurface)
    assert straight.points[:, 0].max() == pytest.approx(motions.LENGTH, abs=1e-4)
    ends = [straight.points[straight.triangles[straight.part == k], 0].max() for k in range(3)]
    np.testing.assert_allclose(ends, [0.01, 0.025, 0.04], atol=1e-4)
    # Bent to a circle of curvature 60/m at a quarter of the period.
    tip = motions.bent(np.array([[motions.LENGTH, 0.0, 0.0]]), 60.0)[0][0]
    assert np.linalg.norm(up.points - tip, axis=1).min() < 0.1 * motions.DIAMETER


def test_one_arrow_for_each_magnetized_part_along_its_magnetization(motion: MotionRenderer) -> None:
    arrows = motion.snapshot(0).arrows
    assert len(arrows) == 3
    directions = arrows[:, 1] / np.linalg.norm(arrows[:, 1], axis=1, keepdims=True)
    np.testing.assert_allclose(directions, np.eye(3)[[0, 1, 0]], atol=1e-6)
    middles = arrows[:, 0] + 0.5 * arrows[:, 1]
    np.testing.assert_allclose(middles[:, 0], motions.LENGTH * np.array([1, 3, 5]) / 6, atol=1e-3)


def test_a_magnetization_that_turns_gets_several_arrows(tmp_path: Path) -> None:
    model = motions.body(segments=1)
    angle = 2 * np.pi * model.particles.position[:, 0] / motions.LENGTH
    model.remanence = 0.1 * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    motions.write(MotionWriter(tmp_path, model), motions.bending(model, [0.0]))
    arrows = MotionRenderer(Motion.load(tmp_path)).snapshot(0).arrows
    assert len(arrows) == 8
    turned = np.unwrap(np.arctan2(arrows[:, 1, 2], arrows[:, 1, 0]))
    np.testing.assert_allclose(np.diff(turned), 2 * np.pi / 8, rtol=0.05)


def test_contact_is_shown_when_there_is_some(motion: MotionRenderer) -> None:
    above = motion.snapshot(2)
    below = motion.snapshot(6)
    assert len(above.contact) == 0
    assert len(above.forces) == 0
    assert len(below.contact) > 3
    np.testing.assert_allclose(below.contact[:, 2], -0.006)
    ((start, vector),) = below.forces
    assert vector[2] > 0
    assert vector[:2] == pytest.approx(0.0)
    assert start[2] == pytest.approx(-0.006)


def test_everything_stays_in_view_for_the_whole_motion(motion: MotionRenderer) -> None:
    aspect = layout.PAGE.mains[0].aspect(SIZE[0] / SIZE[1])
    (view,) = layout.Views.of(motion.framing, layout.PAGE, SIZE[0] / SIZE[1]).mains
    for k in range(len(motion)):
        snapshot = motion.snapshot(k)
        for points in (snapshot.body.points, *(o.points for o in snapshot.obstacles if o.framed)):
            flat = view.project(points)
            assert np.abs(flat[:, 0]).max() <= aspect
            assert np.abs(flat[:, 1]).max() <= 1.0


def test_down_is_where_gravity_points(tmp_path: Path) -> None:
    """A catheter along +x with gravity along +x hangs: its tip is below its base in the picture, and the floor below both."""
    hanging = drawn.scene(effects={"gravity": {"acceleration": [9.81, 0.0, 0.0]}})
    framing = drawn.moving(tmp_path, hanging, frames=3).framing
    view = framing.view(1.6)
    base, tip, floor = view.project(
        np.array([[0, 0, 0], [motions.LENGTH, 0, 0], framing.floor().mean(axis=0)])
    )
    assert base[1] > tip[1] + 0.5 > floor[1] + 0.5
    assert abs(base[0] - tip[0]) < 0.1
    np.testing.assert_allclose(framing.plane.normal, [-1, 0, 0], atol=1e-12)


def test_what_is_tall_is_seen_from_two_sides_at_one_scale(
    motion: MotionRenderer, tmp_path: Path, flat: Renderer
) -> None:
    """A quarter of a turn about the vertical apart, whatever is vertical; all of the body in both panels."""
    assert layout.page_of(motion.framing) == layout.PAGE
    hanging = drawn.scene(effects={"gravity": {"acceleration": [9.81, 0.0, 0.0]}})
    tall = drawn.written(tmp_path, motions.body(), [0.0, 0.01], hanging)
    assert layout.page_of(tall.framing) == layout.TWO_VIEWS
    one, other = layout.Views.of(tall.framing, layout.TWO_VIEWS, SIZE[0] / SIZE[1]).mains
    assert one.half_height == other.half_height
    up = tall.framing.up
    np.testing.assert_allclose(other.toward @ up, one.toward @ up, atol=1e-12)
    level = [view.toward - (view.toward @ up) * up for view in (one, other)]
    assert level[0] @ level[1] == pytest.approx(0.0, abs=1e-12)
    snapshot = tall.snapshot(1)
    for view, panel in zip((one, other), layout.TWO_VIEWS.mains):
        places = view.project(snapshot.body.points)
        assert np.abs(places[:, 0]).max() <= panel.aspect(SIZE[0] / SIZE[1])
        assert np.abs(places[:, 1]).max() <= 1.0
    image = flat.image(snapshot, framing=tall.framing, size=(800, 450))
    for half in (image[80:370, :400], image[80:370, 400:]):
        assert drawn.count(half, style.SEGMENTS[1]) > 100


def test_the_caption_tells_time_and_pace(motion: MotionRenderer) -> None:
    assert motion.snapshot(2, 10.0).caption() == "t = 0.100 s   10× slower"
    assert motion.snapshot(2, 1.0).caption() == "t = 0.100 s   real time"
    times = np.linspace(0.0, 0.4, 41)
    # 40 intervals in 40/10 s of film show 0.4 s.
    assert movies.pace(times, 10.0) == pytest.approx(10.0)


def test_legend_and_curve_only_of_what_is_there(motion: MotionRenderer, tmp_path: Path) -> None:
    signs = {sign.text for sign in annotations.legend(motion.snapshot(0))}
    assert signs >= {"ground", "contact force", "magnet (N, S)"}
    assert annotations.varies(motion.snapshot(0))
    bare = drawn.moving(tmp_path, drawn.scene(), frames=2)
    assert {sign.text for sign in annotations.legend(bare.snapshot(0))} == {
        "magnetic",
        "magnetization",
        "path so far",
        "clamp",
    }


def test_a_far_magnet_does_not_make_the_body_a_speck(tmp_path: Path) -> None:
    far = {**MAGNET, "position": [0.5, 0.0, 0.0]}
    near = drawn.moving(tmp_path / "near")
    away = drawn.moving(tmp_path / "far", drawn.surrounded(field={"magnet": [far]}))
    assert away.framing.view(1.5).half_height <= near.framing.view(1.5).half_height


def test_a_run_that_blew_up_is_drawn_as_far_as_it_is_finite(tmp_path: Path, flat: Renderer) -> None:
    model = motions.body()
    writer = MotionWriter(tmp_path, model)
    good, bad = motions.bending(model, [0.0, 0.1])
    writer.frame(replace(good, contacts={}, field=None))
    bad.x[:50] = np.nan
    writer.frame(replace(bad, contacts={}, field=None))
    motion = MotionRenderer(Motion.load(tmp_path))
    snapshot = motion.snapshot(1)
    assert 0 < len(snapshot.body.triangles) < len(motion.snapshot(0).body.triangles)
    assert (
        drawn.count(flat.image(snapshot, framing=motion.framing, size=SIZE), style.SEGMENTS[0]) > 20
    )


def test_a_motion_without_frames_is_refused(tmp_path: Path) -> None:
    MotionWriter(tmp_path, motions.body())
    with pytest.raises(RenderError, match="no frames"):
        MotionRenderer(Motion.load(tmp_path))


def test_a_body_in_plane_strain_keeps_its_width() -> None:
    """One layer of particles stands for all of it."""
    X = np.stack(np.meshgrid(np.arange(40), [0], np.arange(4), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    X = (X + np.array([0.5, 0.0, -1.5])) * 0.5e-3
    strip = {
        "length": 0.02,
        "width": 0.005,
        "thickness": 0.002,
        "plane_strain": True,
        "material": "silicone",
        "segments": [{}],
    }
    remanence = np.tile([0.1, 0.0, 0.0], (len(X), 1))
    said = Scene.from_si(drawn.scene(body={"strip": strip}))
    body = DrawnBody(said, X, np.full(len(X), 0.125e-9), np.zeros(len(X), dtype=int), remanence)
    moved = body.points(motions.bent(X, 40.0)[0])
    np.testing.assert_allclose(
        [moved[:, 1].min(), moved[:, 1].max()], [-0.0025, 0.0025], rtol=1e-12
    )
    wanted = motions.bent(body.surface.points, 40.0)[0]
    assert np.abs(moved - wanted).max() < 0.5 * 40.0 * (3 * 0.5e-3) ** 2  # as in test_binding
