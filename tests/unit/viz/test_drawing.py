"""Both renderers draw a motion, at the same places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference import drawn

from magmpm.viz import layout, style
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
