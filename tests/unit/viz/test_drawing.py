"""Both renderers draw a motion, at the same places; moments of it side by side, and what their legend holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reference import drawn, motions
from reference.drawn import MAGNET

from magmpm.results.trajectory import Motion, MotionWriter
from magmpm.viz import annotations, layout, style
from magmpm.viz.camera import Framing
from magmpm.viz.figure_panels import figure, moments
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.meshes import swept
from magmpm.viz.snapshot import Obstacle
from magmpm.viz.worker import Renderer


def pictures(renderer: Renderer, motion: MotionRenderer) -> tuple[np.ndarray, np.ndarray]:
    return tuple(renderer.image(motion.snapshot(k), framing=motion.framing, size=(800, 450)) for k in (2, 6))  # type: ignore[return-value]


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_both_backends_show_body_magnet_ground_and_contact(backend: str, motion: MotionRenderer, request: pytest.FixtureRequest) -> None:
    up, down = pictures(request.getfixturevalue(backend), motion)
    for color in (style.NORTH, style.SOUTH, style.SEGMENTS[0], style.SEGMENTS[1], style.GROUND):
        assert drawn.count(up, color) > 150, color
    # Blue stands for contact: in the legend always, in the view when there is some.
    assert drawn.count(down, style.CONTACT) > drawn.count(up, style.CONTACT) + 60
    assert up.shape == (450, 800, 3)


def test_both_backends_show_things_at_the_same_place(motion: MotionRenderer, flat: Renderer, solid: Renderer) -> None:
    for one, other in zip(pictures(flat, motion), pictures(solid, motion)):
        for color in (style.SOUTH, style.SEGMENTS[1]):
            places = [
                np.argwhere(np.abs(i.astype(int) - np.round(255 * np.array(style.rgb(color)))).max(axis=2) < 50)[:, :2].mean(axis=0)
                for i in (one[:350], other[:350])
            ]
            # Shading decides which pixels come near the color: a few of 450.
            assert np.abs(places[0] - places[1]).max() < 12


@pytest.mark.parametrize("backend", ["flat", "solid"])
def test_the_fields_arrow_of_a_moment_stands_on_the_picture(backend: str, motion: MotionRenderer, request: pytest.FixtureRequest) -> None:
    """No white box around it: the panel's corner is as it is without a field."""
    renderer, snapshot = request.getfixturevalue(backend), motion.snapshot(2)
    tube = swept(np.array([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]]), 0.1)
    wall = Obstacle("wall", tube.points, tube.triangles, style.WALL, hollow=True)
    images = [
        renderer.image(replace(snapshot, obstacles=(wall,), field=field), framing=motion.framing, layout=layout.bare((400, 300)))
        for field in (snapshot.field, None)
    ]
    changed = np.flatnonzero((np.abs(images[0].astype(int) - images[1]) > 8).any(axis=2))
    assert 10 < len(changed) < 0.5 * 300 * 400 * 0.17**2


def test_moments_show_what_closes_and_opens_again_closed(tmp_path: Path) -> None:
    model = motions.body()
    bends = [0.0, 0.1, 0.35, 0.4, 0.2, 0.05, 0.0, 0.0, 0.0]
    frames = list(motions.bending(model, bends))
    writer = MotionWriter(tmp_path, model)
    for k, frame in enumerate(frames):
        writer.frame(0.01 * k, frame.x, frame.v, frame.F, frame.P, frame.energies)
    motion = MotionRenderer(Motion.load(tmp_path))
    apart = [float(np.abs(motion.motion.position(k) - motion.motion.position(0)).max()) for k in range(len(motion))]
    assert moments(motion) == [0, int(np.argmax(apart)), 8]


def test_the_legend_of_moments_holds_what_is_in_them_and_only_that(tmp_path: Path) -> None:
    """A coil that is out of the picture and contact at other moments are not; poles of a point dipole are."""
    coil = {"position": [0.02, 0.0, 0.5], "axis": [0, 0, 1], "diameter": 0.05, "current": 1.0}
    dipole = {"position": [0.05, 0.0, 0.02], "moment": [0.0, 0.0, 1.0]}
    other = drawn.moving(tmp_path, drawn.surrounded(field={"coils": [coil], "dipole": dipole}))
    seen = [(other.framing.view(1.5), 1.5)]
    above, touching = other.snapshot(2), other.snapshot(6)
    assert not len(above.forces)
    assert len(touching.forces)
    texts = {sign.text for sign in annotations.signs([above], seen)}
    assert texts >= {"ground", "clamp", "point dipole (N, S)"}
    assert not texts & {"coil", "contact force", "magnet (N, S)"}
    assert "contact force" in {sign.text for sign in annotations.signs([above, touching], seen)}
    assert "coil" in {sign.text for sign in annotations.signs([above])}
    # A movie's legend does not change with the frame.
    assert "contact force" in {sign.text for sign in annotations.legend(above, seen)}


def test_moments_hold_a_magnet_before_it_has_come_near(tmp_path: Path) -> None:
    frames = [{"time": 0.0, "move": [0, 0, 0.12]}, {"time": 0.4, "move": [0, 0, 0.05]}]
    near = drawn.moving(tmp_path, drawn.surrounded(field={"magnet": [MAGNET], "over_time": {"keyframes": frames}}))
    magnet = np.vstack([o.points for o in near.snapshot(0).obstacles if o.name.startswith("magnet")])

    def reach(framing: Framing) -> float:
        return float(np.abs(framing.view(1.0).project(magnet)[:, :2]).max())

    assert reach(near.framing_of([0, 8])) < 1.0 < reach(near.framing_of([8]))
    assert reach(near.framing) == reach(near.framing_of([8]))  # the movie stays with the body


def test_the_moments_stand_side_by_side_at_one_scale(motion: MotionRenderer, flat: Renderer, tmp_path: Path) -> None:
    with Image.open(figure(motion, tmp_path / "moments.png", flat, width=900)) as image:
        assert abs(image.width - 900) < 4
        assert image.height < image.width
        pixels = np.asarray(image.convert("RGB"))
    thirds = np.array_split(pixels, 3, axis=1)
    # The magnet does not move: it fills as many pixels in each panel.
    shown = [drawn.count(third[: image.height * 3 // 4], style.SOUTH) for third in thirds]
    assert min(shown) > 50
    assert max(shown) - min(shown) < 0.1 * max(shown)
