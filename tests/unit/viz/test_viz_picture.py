"""A picture is small, holds what is seen, and refuses what cannot be drawn."""

from __future__ import annotations

import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from viz import samples, style
from viz.picture import Picture


def fake_result(per_diameter: int = 16, gravity: dict[str, Any] | None = None) -> SimpleNamespace:
    """A straight 40 x 4 mm catheter as magmpm.results.result.Result would hold it; plain second segment."""
    spacing = 0.004 / per_diameter
    across = (np.arange(per_diameter) + 0.5) * spacing - 0.002
    along = (np.arange(10 * per_diameter) + 0.5) * spacing
    x, y, z = (grid.ravel() for grid in np.meshgrid(along, across, across, indexing="ij"))
    inside = np.hypot(y, z) < 0.002
    reference = np.stack([x, y, z], axis=1)[inside]
    effects = {"magnetic_torque": {}, "gravity": gravity}
    s = np.linspace(0.0, 0.04, 21)
    return SimpleNamespace(
        scene={"body": {"catheter": {"length": 0.04, "diameter": 0.004}}, "effects": effects},
        name="straight",
        particle_reference=reference,
        particle_position=reference + np.array([0.0, 0.0, 1e-3]),
        particle_segment=(reference[:, 0] / 0.008).astype(np.int32),
        particle_volume=np.full(len(reference), spacing**3),
        segment_center=np.stack([(np.arange(5) + 0.5) * 0.008, np.zeros(5), np.zeros(5)], axis=1),
        segment_remanence=np.array([[0.1, 0, 0], [0, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.1, 0, 0]]),
        centreline=np.stack([s, s, 0 * s, 0 * s], axis=1),
        field=np.array([0.0, 6e-3, 8e-3]),
    )


def test_from_result_takes_what_the_result_says() -> None:
    result = fake_result(gravity={"acceleration": [0.0, 0.0, -9.81]})
    target = np.stack([np.linspace(0, 0.04, 9)] * 4, axis=1)
    picture = Picture.from_result(result, target=target, trial=7, rms=1.234e-3)
    assert picture.title == "straight"
    assert picture.caption() == "trial 7   rms 1.23 mm"
    assert picture.length == 0.04
    assert picture.diameter == 0.004
    assert picture.target is not None
    assert picture.target.shape == (9, 3)
    assert picture.gravity is not None
    assert picture.gravity[2] == -9.81
    assert picture.magnetised.tolist() == [True, False, True, True, True]
    assert picture.particle_size == pytest.approx(0.00025)
    assert Picture.from_result(fake_result()).gravity is None


def test_only_particles_that_cannot_be_seen_are_left_out() -> None:
    result = fake_result()
    picture = Picture.from_result(result)
    assert 0.3 < len(picture.particles) / len(result.particle_position) < 0.8
    kept = {tuple(p) for p in picture.particles.round(7).tolist()}
    radius = np.hypot(result.particle_reference[:, 1], result.particle_reference[:, 2])
    outer = result.particle_position[radius > 0.002 - 0.0004].astype(np.float32)
    assert {tuple(p) for p in outer.round(7).tolist()} <= kept
    # Both end faces are whole: as many particles as one layer has.
    layer = int((result.particle_reference[:, 0] < 0.00025).sum())
    assert int((picture.particles[:, 0] < 0.00025).sum()) == layer
    assert int((picture.particles[:, 0] > 0.04 - 0.00025).sum()) == layer


def test_a_picture_stays_small_and_keeps_its_shape() -> None:
    result = fake_result(per_diameter=24)
    picture = Picture.from_result(result, max_particles=4000)
    assert len(picture.particles) == 4000
    assert np.ptp(picture.particles, axis=0) == pytest.approx(
        np.ptp(result.particle_position, axis=0), rel=0.03
    )
    # 20 bytes a particle, and the rest.
    assert len(pickle.dumps(picture)) < 20 * 4000 + 5000


def test_slivers_do_not_make_the_balls_small_or_the_picture_large() -> None:
    result = fake_result()
    result.particle_volume[::2] *= 1e-6
    picture = Picture.from_result(result)
    assert picture.particle_size == pytest.approx(0.00025)
    assert len(picture.particles) <= len(result.particle_position) / 2


def test_arrows_go_through_the_axis_of_a_segment_bent_far() -> None:
    bent = samples.catheter(samples.c_shape, segments=1, spacing=1e-3)
    beside = replace(bent, segment_center=np.asarray(bent.particles, dtype=float).mean(axis=0)[None])
    ((start, vector),) = style.magnetisation_arrows(beside)
    away = np.linalg.norm(bent.centreline - (start + 0.5 * vector), axis=1)
    assert away.min() < 1e-9
    assert np.argmin(away) == pytest.approx(40, abs=1), "and through the middle of its arc"


def test_particles_that_are_not_finite_are_left_out() -> None:
    result = fake_result()
    result.particle_position[5:50] = np.nan
    assert np.isfinite(Picture.from_result(result).particles).all()
    result.particle_position[:] = np.inf
    with pytest.raises(ValueError, match="nothing to draw"):
        Picture.from_result(result)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"particles": np.zeros((4, 2))}, "Picture.particles has shape"),
        ({"particles": np.zeros((0, 3))}, "nothing to draw"),
        ({"target": np.zeros(3)}, "Picture.target has shape"),
        ({"particle_segment": np.zeros(3, dtype=int)}, "one segment a particle"),
    ],
)
def test_wrong_shapes_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(samples.catheter(spacing=1e-3), **change)


def test_segments_get_different_colours_and_plain_ones_grey() -> None:
    colours = style.segment_colours(np.array([True, False, True, True, False]))
    assert np.array_equal(colours[1], style.rgb(style.UNMAGNETISED))
    assert np.array_equal(colours[4], style.rgb(style.UNMAGNETISED))
    assert len({tuple(c) for c in colours[[0, 2, 3]]}) == 3


@pytest.mark.parametrize(
    ("length", "nice"), [(0.012, 0.01), (0.02, 0.02), (0.0199, 0.01), (0.0168, 0.01), (5.0, 5.0)]
)
def test_scale_bars_have_round_lengths(length: float, nice: float) -> None:
    assert style.nice_length(length) == pytest.approx(nice)
