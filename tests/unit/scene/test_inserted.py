"""Scene.inserted: the part of a catheter that has left a guide."""

import numpy as np
import pytest
from reference.moving import resting_scene

from magmpm import InputError
from magmpm.rod.cosserat import solve_rod


def scene(**changes):
    """A catheter of 3 mm with three segments of 10, 12 and 8 mm; the middle one is plain."""
    magnetic = {"shear_modulus": 120e3, "bulk_to_shear": 20, "density": 1882.0, "remanence": 0.138}
    segments = [
        {"magnetization": [1, 0, 0], "length": 10e-3},
        {"material": "plain", "length": 12e-3},
        {"magnetization": [0, 0, 1]},
    ]
    given = {
        "materials": {
            "m": magnetic,
            "plain": {"shear_modulus": 80e3, "bulk_to_shear": 20, "density": 1100.0},
        },
        "body": {
            "catheter": {"length": 30e-3, "diameter": 3e-3, "material": "m", "segments": segments}
        },
        "field": {"uniform": [0, 2e-3, 8e-3]},
        "effects": {"magnetic_torque": {}, "gravity": {}},
    }
    return resting_scene(**given | changes)


def pieces(found):
    return [
        (round(1e3 * s.length, 9), s.material, s.magnetization)
        for s in found.body.catheter.segments
    ]


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (30e-3, [(10.0, None, (1, 0, 0)), (12.0, "plain", (0, 0, 0)), (8.0, None, (0, 0, 1))]),
        (25e-3, [(5.0, None, (1, 0, 0)), (12.0, "plain", (0, 0, 0)), (8.0, None, (0, 0, 1))]),
        (20e-3, [(12.0, "plain", (0, 0, 0)), (8.0, None, (0, 0, 1))]),
        (8e-3, [(8.0, None, (0, 0, 1))]),
        (3e-3, [(3.0, None, (0, 0, 1))]),
    ],
)
def test_it_is_the_last_part_of_the_catheter(length, expected):
    """Segments are cut from the base; the tip's stay."""
    found = scene().inserted(length)
    assert found.length == pytest.approx(length, rel=1e-12)
    assert pieces(found) == expected
    assert found.static
    assert found.anchored


def test_a_rest_too_short_for_the_grid_counts_to_the_next_segment():
    """8.02 mm: 0.02 mm of the plain segment, below a hundredth of the diameter, 0.03 mm. 8.04 mm keep it."""
    assert pieces(scene().inserted(8.02e-3)) == [(8.02, None, (0, 0, 1))]
    assert pieces(scene().inserted(8.04e-3)) == [(0.04, "plain", (0, 0, 0)), (8.0, None, (0, 0, 1))]


def test_the_whole_length_is_the_whole_catheter():
    """The rod's shape does not change when nothing is left in the guide."""
    whole = scene()
    np.testing.assert_allclose(
        solve_rod(whole.inserted(30e-3)).position, solve_rod(whole).position, atol=1e-12
    )


@pytest.mark.parametrize("cells", [2, 3, 4])
def test_cells_stay_near_cubes(cells):
    """Down to one and a half diameters a cell is at most a seventh longer or shorter than wide; at one diameter a third, with 2 across."""
    for length in np.linspace(3e-3, 30e-3, 61):
        spacing = scene().inserted(length).body.shape.grid(cells).spacing
        assert abs(np.log(spacing[0] / spacing[1])) <= np.log(
            7 / 6 if length >= 4.5e-3 else 1.5
        ) * (1 + 1e-9)


def test_what_acts_in_motion_only_stays_out():
    """A scene of a push through a guide gives equilibria without feed, damping and walls."""
    effects = {
        "magnetic_torque": {},
        "feed": {"speed": 0.01, "exit": 20e-3},
        "damping": {"rate": 50.0},
    }
    found = scene(effects=effects, solver={"dynamic": {"duration": 0.1}}).inserted(15e-3)
    assert set(found.effects.named()) == {"magnetic_torque"}
    assert found.static


@pytest.mark.parametrize("length", [0.0, -1e-3, 2.9e-3, 30.1e-3, float("nan"), float("inf")])
def test_lengths_out_of_reach_are_refused(length):
    with pytest.raises(InputError, match="between one diameter and the whole length"):
        scene().inserted(length)


def test_strips_and_moving_magnets_are_refused():
    with pytest.raises(InputError, match="the exit of the guide becomes the origin"):
        scene(
            effects={
                "magnetic_torque": {},
                "magnetic_force": {},
                "feed": {"speed": 0.01, "exit": 20e-3},
            },
            solver={"dynamic": {"duration": 0.1}},
            field={"dipole": {"position": [0.2, 0, 0], "moment": [0, 0, 1]}},
        ).inserted(15e-3)
    strip = {"length": 20e-3, "width": 4e-3, "thickness": 1e-3, "material": "m", "segments": [{}]}
    with pytest.raises(InputError, match="only a catheter"):
        scene(body={"strip": strip}).inserted(15e-3)
