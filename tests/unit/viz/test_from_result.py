"""A result's snapshot is small and holds what is seen; what cannot be drawn is refused."""

import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from reference import bent_bodies, drawn, motions

from magmpm.viz import annotations, style
from magmpm.viz.from_result import Still, segment_arrows, trial_snapshot
from magmpm.viz.snapshot import Balls
from magmpm.viz.worker import Renderer


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
        scene=drawn.scene(
            body={"catheter": {**drawn.CATHETER, "segments": [{}] * 5}}, effects=effects
        ),
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
    snapshot = trial_snapshot(result, target=target, trial=7, rms=1.234e-3)
    assert snapshot.title == "straight"
    assert snapshot.caption() == "trial 7   rms 1.23 mm"
    assert snapshot.length == 0.04
    assert snapshot.thickness == 0.004
    assert snapshot.target.shape == (9, 3)
    assert snapshot.gravity[2] == -9.81
    assert snapshot.magnetized.tolist() == [True, False, True, True, True]
    assert isinstance(snapshot.body, Balls)
    assert snapshot.body.size == pytest.approx(0.00025)
    assert trial_snapshot(fake_result()).gravity is None


def test_only_particles_that_cannot_be_seen_are_left_out() -> None:
    result = fake_result()
    particles = trial_snapshot(result).body.points
    assert 0.3 < len(particles) / len(result.particle_position) < 0.8
    kept = {tuple(p) for p in particles.round(7).tolist()}
    radius = np.hypot(result.particle_reference[:, 1], result.particle_reference[:, 2])
    outer = result.particle_position[radius > 0.002 - 0.0004].astype(np.float32)
    assert {tuple(p) for p in outer.round(7).tolist()} <= kept
    # Both end faces are whole: as many particles as one layer has.
    layer = int((result.particle_reference[:, 0] < 0.00025).sum())
    assert int((particles[:, 0] < 0.00025).sum()) == layer
    assert int((particles[:, 0] > 0.04 - 0.00025).sum()) == layer


def test_a_picture_stays_small_and_keeps_its_shape() -> None:
    result = fake_result(per_diameter=24)
    snapshot = trial_snapshot(result, max_particles=4000)
    assert len(snapshot.body.points) == 4000
    assert np.ptp(snapshot.body.points, axis=0) == pytest.approx(
        np.ptp(result.particle_position, axis=0), rel=0.03
    )
    # 20 bytes a particle, and the rest.
    assert len(pickle.dumps(snapshot)) < 20 * 4000 + 5000


def test_slivers_do_not_make_the_balls_small_or_the_picture_large() -> None:
    result = fake_result()
    result.particle_volume[::2] *= 1e-6
    body = trial_snapshot(result).body
    assert isinstance(body, Balls)
    assert body.size == pytest.approx(0.00025)
    assert len(body.points) <= len(result.particle_position) / 2


def test_arrows_go_through_the_axis_of_a_segment_bent_far() -> None:
    bent = bent_bodies.catheter(bent_bodies.c_shape, segments=1, spacing=1e-3)
    beside = bent.body.points.astype(float).mean(axis=0)[None]
    ((start, vector),) = segment_arrows(
        bent.axis, beside, np.array([[0.138, 0.0, 0.0]]), bent.length, bent.thickness
    )
    away = np.linalg.norm(bent.axis - (start + 0.5 * vector), axis=1)
    assert away.min() < 1e-9
    assert np.argmin(away) == pytest.approx(40, abs=1), "and through the middle of its arc"


def test_particles_that_are_not_finite_are_left_out() -> None:
    result = fake_result()
    result.particle_position[5:50] = np.nan
    assert np.isfinite(trial_snapshot(result).body.points).all()
    result.particle_position[:] = np.inf
    with pytest.raises(ValueError, match="nothing to draw"):
        trial_snapshot(result)


def strip_result(across: int, thick: int, strip: dict[str, Any], **scene: Any) -> SimpleNamespace:
    """A strip of 20 mm with so many particles across and through it, 0.5 mm apart, of two parts unless it has one segment."""
    X = np.stack(
        np.meshgrid(np.arange(40), np.arange(across), np.arange(thick), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    X = (X + np.array([0.5, (1 - across) / 2, (1 - thick) / 2])) * 0.5e-3
    shape = {
        "length": 0.02,
        "width": across * 0.5e-3,
        "thickness": thick * 0.5e-3,
        "material": "silicone",
        **strip,
    }
    return SimpleNamespace(
        name="strip",
        scene=drawn.scene(body={"strip": shape}, solver={"static": {}}, **scene),
        particle_reference=X,
        particle_position=X,
        particle_volume=np.full(len(X), 0.125e-9),
        particle_segment=((X[:, 0] > 0.01) & (len(strip["segments"]) > 1)).astype(np.int32),
        segment_remanence=np.array([[0.1, 0, 0]]),
        field=np.array([0, 0, 8e-3]),
        contacts={},
    )


def test_forces_at_rest_are_arrows_part_by_part() -> None:
    """The ground's on the segment that lies on it, at that segment; between two parts at the mean point of their push."""
    effects = {"magnetic_torque": {}, "ground": {"point": [0.0, 0.0, -1e-3]}}
    result = strip_result(10, 4, {"clamp": "base", "segments": [{}, {}]}, effects=effects)
    usual = {"count": 3, "depth": 1e-6}
    up = {**usual, "force": [0.0, 0.0, 3e-3]}
    apart = {**usual, "force": [0.0, 0.0, 0.0]}
    between = {**usual, "force": [3e-3, 0.0, 0.0], "point": [5e-3, 0.0, 1e-3]}
    result.contacts = {"ground": up, "ground: segment 2": up, "self_contact": apart}
    result.contacts["self_contact: segment 1, segment 2"] = between
    snapshot = Still(result).snapshot()
    on, across = snapshot.forces
    np.testing.assert_allclose(on[0], [15e-3, 0.0, -1e-3], rtol=0, atol=0.5e-3)  # a particle's size
    np.testing.assert_allclose(across[0], between["point"])
    assert on[1][2] > 0 == on[1][0]
    assert across[1][0] > 0 == across[1][2]


def test_a_result_of_a_strip_is_drawn(flat: Renderer) -> None:
    """Without a catheter's centerline: sharp edges from the scene, colors by segment, magnetization arrows."""
    result = strip_result(10, 4, {"clamp": "base", "segments": [{}, {}]})
    result.particle_position = motions.bent(result.particle_reference, 40.0)[0]
    result.segment_remanence = 0.1 * np.array(
        [[np.sin(0.4) / 0.4, 0, (1 - np.cos(0.4)) / 0.4], [0, 0, 0]]
    )
    still = Still(result)
    snapshot = still.snapshot()
    assert snapshot.caption() == ""
    assert len(snapshot.arrows) == 1
    # Bent by 40/m: the magnetization at 5 mm has turned by 0.2 rad with the strip.
    vector = snapshot.arrows[0, 1] / np.linalg.norm(snapshot.arrows[0, 1])
    np.testing.assert_allclose(vector, [np.cos(0.2), 0.0, np.sin(0.2)], atol=0.02)
    assert np.ptp(snapshot.body.points[:, 1]) == pytest.approx(0.005, rel=1e-2)
    image = flat.image(snapshot, framing=still.framing, size=(800, 450))
    assert drawn.count(image, style.SEGMENTS[0]) > 300
    assert drawn.count(image, style.UNMAGNETIZED) > 300


def test_a_magnet_stands_where_the_equilibrium_met_it() -> None:
    """At the end of its schedule. Where there is no field at all, none is spoken of."""
    moves = [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 2.0, "move": [0.0, 0.01, 0.0]}]
    dipole = {"moment": [0.0, 0.0, 1.0], "position": [0.03, 0.0, 0.0]}
    result = strip_result(
        4, 4, {"segments": [{}]}, field={"dipole": [dipole], "over_time": {"keyframes": moves}}
    )
    snapshot = Still(result).snapshot()
    poles = np.vstack([o.points for o in snapshot.obstacles if o.name.startswith("dipole")])
    np.testing.assert_allclose(poles.mean(axis=0), [0.03, 0.01, 0.0], atol=1e-6)
    assert annotations.field_text(snapshot) == "|B| = 8.0 mT"
    none = strip_result(4, 4, {"segments": [{}]})
    none.field = np.zeros(3)
    assert annotations.field_text(Still(none).snapshot()) == ""


SHOWN = bent_bodies.catheter(spacing=1e-3).body


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"body": replace(SHOWN, points=np.zeros((4, 2)))}, "Snapshot.body.points has shape"),
        ({"body": replace(SHOWN, points=np.zeros((0, 3)))}, "nothing to draw"),
        ({"target": np.zeros(3)}, "Snapshot.target has shape"),
        ({"body": replace(SHOWN, part=np.zeros(3, dtype=int))}, "one a particle"),
    ],
)
def test_wrong_shapes_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(bent_bodies.catheter(spacing=1e-3), **change)


def test_segments_get_different_colors_and_plain_ones_grey() -> None:
    colors = style.segment_colors(np.array([True, False, True, True, False]))
    assert np.array_equal(colors[1], style.rgb(style.UNMAGNETIZED))
    assert np.array_equal(colors[4], style.rgb(style.UNMAGNETIZED))
    assert len({tuple(c) for c in colors[[0, 2, 3]]}) == 3


@pytest.mark.parametrize(
    ("length", "nice"), [(0.012, 0.01), (0.02, 0.02), (0.0199, 0.01), (0.0168, 0.01), (5.0, 5.0)]
)
def test_scale_bars_have_round_lengths(length: float, nice: float) -> None:
    assert style.nice_length(length) == pytest.approx(nice)
