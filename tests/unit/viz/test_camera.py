"""Projections: lengths and places in a picture are what they are on the body."""

import numpy as np
import pytest
from reference.bent_bodies import c_shape, catheter, s_shape

from magmpm.viz import annotations
from magmpm.viz.camera import Framing, best_direction
from magmpm.viz.layout import TRIAL, Views
from magmpm.viz.snapshot import Snapshot

ASPECT = 4 / 3


def bodies() -> list[Snapshot]:
    shapes = (
        (c_shape, c_shape),
        (s_shape, s_shape),
        (lambda s: (0.0, 80.0),),
        (lambda s: (0.0, 0.0),),
    )
    return [catheter(*shape, spacing=1e-3) for shape in shapes]


@pytest.mark.parametrize("body", bodies())
def test_views_are_orthonormal_and_hold_body_and_target(body: Snapshot) -> None:
    views = Views.of(Framing.of(body), TRIAL, ASPECT)
    assert views.insets[0].half_height == views.insets[1].half_height
    panels = (*TRIAL.mains, *(inset.panel for inset in TRIAL.insets))
    for view, panel in zip((*views.mains, *views.insets), panels):
        axes = np.stack([view.right, view.up, view.toward])
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.cross(view.right, view.up) == pytest.approx(view.toward, abs=1e-12)
        flat = view.project(body.body.points)
        assert np.abs(flat[:, 0]).max() < panel.aspect(ASPECT)
        assert np.abs(flat[:, 1]).max() < 1.0
    # The body fills the frame: it is not lost in the middle of the panel.
    flat = views.mains[0].project(body.body.points) / [TRIAL.mains[0].aspect(ASPECT), 1.0, 1.0]
    assert np.ptp(flat[:, :2], axis=0).max() > 1.0


def test_moving_towards_the_camera_does_not_move_a_point_in_the_picture() -> None:
    body = bodies()[1]
    view = Views.of(Framing.of(body), TRIAL, ASPECT).mains[0]
    there = view.project(body.axis)
    here = view.project(view.lift(body.axis, 0.3))
    assert here[:, :2] == pytest.approx(there[:, :2], abs=1e-9)
    assert here[:, 2] - there[:, 2] == pytest.approx(0.3)


def test_the_view_of_a_study_does_not_turn_with_the_trial() -> None:
    target = s_shape
    trials = [
        catheter(lambda s, k=k: (k * 20.0, -k * 10.0), target, spacing=1e-3) for k in range(5)
    ]
    directions = [Framing.of(trial).toward for trial in trials]
    assert all(np.array_equal(direction, directions[0]) for direction in directions)


def test_a_shared_frame_holds_every_body() -> None:
    many = bodies()
    view = Framing.of(many).view(TRIAL.mains[0].aspect(ASPECT))
    for body in many:
        assert np.abs(view.project(body.body.points)[:, 1]).max() < 1.0


def test_the_view_shows_the_plane_a_body_bends_in() -> None:
    s = np.linspace(0, np.pi, 30)
    in_xz = np.stack([np.sin(s), 0 * s, 1 - np.cos(s)], axis=1)
    in_xy = np.stack([np.sin(s), 1 - np.cos(s), 0 * s], axis=1)
    # Seen from the front at 20 degrees aside and 20 above at least 0.85 of the plane's area remain; the x-y
    # plane is seen from above as steeply as is allowed, 40 degrees.
    assert abs(best_direction(in_xz)[1]) > 0.8
    assert best_direction(in_xy)[2] == pytest.approx(np.sin(np.radians(40.0)))


def test_scale_bar_is_as_long_as_it_says() -> None:
    body = bodies()[0]
    view = Views.of(Framing.of(body), TRIAL, ASPECT).mains[0]
    width = annotations.bar_width(view, TRIAL.mains[0], TRIAL.mains[0].aspect(ASPECT), 0.01)
    ends = np.stack([view.center, view.center + 0.01 * view.right])
    placed = TRIAL.mains[0].place(view.project(ends), TRIAL.mains[0].aspect(ASPECT))
    assert width == pytest.approx(placed[1, 0] - placed[0, 0])
