"""The rod that moves: it comes to rest where the static rod is, swings at theory's frequency, falls as g says, and lies on the ground."""

from __future__ import annotations

import numpy as np
import pytest
from reference.moving import DENSITY, block, moving_scene
from reference.scenes import G

from magmpm.materials import young_modulus
from magmpm.rod.cosserat import solve_rod
from magmpm.rod.motion import LOOKS, move_rod
from magmpm.rod.shifts import without_motion

LENGTH, DIAMETER = 30e-3, 3e-3
CATHETER = {"catheter": {"length": LENGTH, "diameter": DIAMETER, "material": "m", "segments": [{"magnetization": [1.0, 0.0, 0.0]}]}}
WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}


def test_a_damped_rod_comes_to_rest_where_the_static_rod_is() -> None:
    """In a field and under weight. 36 elements instead of 180, of second order, and a creep that has died out: a hundredth of the way."""
    effects = {"magnetic_torque": {}, "damping": {"rate": 40.0}, **WEIGHT}
    scene = moving_scene(CATHETER, effects, duration=1.0, field={"uniform": [0.0, 1e-3, 3e-3]})
    path, rest = move_rod(scene), solve_rod(without_motion(scene))
    way = np.linalg.norm(rest.position[-1] - [LENGTH, 0.0, 0.0])
    assert way > 2e-3
    np.testing.assert_allclose(path.position[-1], rest.at(path.s), atol=0.01 * way)


def test_a_rod_swings_at_the_frequency_of_a_beam() -> None:
    """Let go under a weight that bends it little, its tip is lowest after half a period of the first mode.

    Euler and Bernoulli: 3.516/(2 pi) sqrt(E I/(rho A L^4)). Shear and rotary inertia lower it by 1 % at L/D = 10, the second mode adds
    a few per cent of the deflection, and the motion is looked at in steps of a hundredth of the half period.
    """
    E = young_modulus(np.array([G]), np.array([20.0 * G]))[0]
    frequency = 3.516 / (2 * np.pi) * np.sqrt(E * DIAMETER**2 / 16 / (DENSITY * LENGTH**4))
    scene = moving_scene(CATHETER, {"gravity": {"acceleration": [0.0, 0.0, -0.2]}}, duration=1.0 / frequency)
    path = move_rod(scene)
    lowest = path.times[int(np.argmin(path.position[:, -1, 2]))]
    assert lowest == pytest.approx(0.5 / frequency, rel=0.05)
    assert path.position[-1, -1, 2] == pytest.approx(0.0, abs=0.1 * abs(path.position[:, -1, 2].min()))  # back after a period


def test_a_free_rod_falls() -> None:
    """Without anything that holds it, as g says: semi-implicit Euler is late by one step in the speed."""
    scene = moving_scene(block((20e-3, 4e-3, 2e-3), position=[0.0, 0.0, 0.1]), WEIGHT, duration=0.05)
    path = move_rod(scene)
    assert len(path.times) == LOOKS + 1
    fallen = path.position[0, :, 2] - path.position[:, :, 2]
    expected = 0.5 * 9.81 * path.times**2
    np.testing.assert_allclose(fallen, np.repeat(expected[:, None], fallen.shape[1], axis=1), atol=9.81 * path.step * path.times[-1])


def test_a_rod_lies_on_the_ground() -> None:
    """It falls by its own thickness and stays half of it above the ground, but for the give of the contact, and does not slide."""
    effects = {"ground": {"point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": 0.3}, "damping": {"rate": 30.0}, **WEIGHT}
    scene = moving_scene(block((20e-3, 4e-3, 2e-3), position=[0.0, 0.0, 3e-3]), effects, duration=0.6)
    last = move_rod(scene).position[-1]
    np.testing.assert_allclose(last[:, 2], 1e-3, atol=0.1e-3)
    np.testing.assert_allclose(last[:, 0], move_rod(scene).position[0, :, 0], atol=1e-4)


@pytest.mark.parametrize("nodes", [True, False])
def test_a_rod_hangs_freely_from_where_its_guide_ends(nodes: bool) -> None:
    """It bends like one clamped there, within a tenth of an element: it was one of 36 too long, by 20 % of the deflection here.

    The run's guide ends at the last plane of nodes before the exit and half a cell (1.5 mm cells), as the finer rod's does.
    """
    for exit in np.linspace(0.41, 0.41 + 1 / 36, 4) * LENGTH:
        effects = {"damping": {"rate": 150.0}, "feed": {"speed": 0.0, "exit": float(exit)}, **WEIGHT}
        scene = moving_scene(CATHETER, effects, duration=0.3)
        path = move_rod(scene, coarser=int(not nodes))
        end = 1.5e-3 * (exit // 1.5e-3 + 0.5) if nodes else exit
        free = np.array([-1.5e-3, 0.0, 1.5e-3]) + LENGTH - end
        clamped = without_motion(scene)
        fallen = [-solve_rod(clamped.inserted(float(length))).position[-1, 2] for length in free]
        assert abs(np.interp(-path.position[-1, -1, 2], fallen, free) - free[1]) < 0.1 * LENGTH / (path.position.shape[1] - 1)
