"""The limits of the watchdog, each tested on both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.compiled.jit import compiled
from magmpm.dynamics import watchdog
from magmpm.effects.acting import WHIP
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.scene import Scene


@pytest.fixture(scope="module")
def model() -> Model:
    return build(rod_scene(length=8e-3))


def speed_of_waves(model: Model) -> float:
    """sqrt((K + 4/3 G) / rho), m/s."""
    return float(np.sqrt((model.bulk[0] + 4 / 3 * model.shear[0]) / model.density[0]))


def test_a_particle_faster_than_waves_is_told(model: Model) -> None:
    model = replace(model, scene=model.scene.with_field([0.0, 0.0, 0.0]))
    x, v = model.particles.position, np.zeros_like(model.particles.position)
    waves = speed_of_waves(model)
    v[7] = 0.99 * 2.0 * waves * np.array([0.6, 0.0, -0.8])  # twice as fast where a wave comes back from a surface
    assert watchdog.check(model, x, v) is None
    v[7] *= 1.02 / 0.99
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 7
    assert f"{1.02 * 2.0 * waves:.3g} m/s, faster than waves in its material" in trouble.cause


def test_loads_may_drive_a_body_faster_than_waves(model: Model) -> None:
    """sqrt(2 WHIP g h) more under a weight g along a way h; sqrt(2 WHIP 4 M B / rho) in a field."""
    waves, density, still = speed_of_waves(model), float(model.density[0]), model.scene.to_si()
    heavy = Scene.from_si({**still, "field": {}, "effects": {"gravity": {"acceleration": [0.0, 0.0, -1e4]}}})
    turned = Scene.from_si({**still, "field": {"uniform": [0.0, 0.0, 5e-3]}, "effects": {"magnetic_torque": {}}})
    moment = float(np.linalg.norm(model.remanence[0, :3])) / MU0
    x = model.particles.position + np.array([0.0, 0.0, -3e-3])
    for scene, work in ((heavy, 1e4 * 3e-3), (turned, 4 * moment * 5e-3 / density)):
        driven, v = np.sqrt(2 * WHIP * work), np.zeros_like(x)
        v[7, 1] = 2.0 * waves + 0.99 * driven
        assert watchdog.check(replace(model, scene=scene), x, v, 1.0) is None
        v[7, 1] = 2.0 * waves + 1.01 * driven
        assert watchdog.check(replace(model, scene=scene), x, v, 1.0) is not None


def test_a_particle_ten_sizes_away_is_told(model: Model) -> None:
    """The size is the diagonal of the box around the undeformed particles."""
    x, v = model.particles.position.copy(), np.zeros_like(model.particles.position)
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    x[3] += 9.9 * size * np.array([0.0, 0.6, 0.8])
    assert watchdog.check(model, x, v) is None
    x[3] += 0.2 * size * np.array([0.0, 0.6, 0.8])
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 3
    assert "left the box" in trouble.cause
    assert "10 times the body's size" in trouble.cause


@pytest.mark.parametrize("which", ["x", "v"])
def test_what_is_no_number_is_told(model: Model, which: str) -> None:
    x, v = model.particles.position.copy(), np.zeros_like(model.particles.position)
    (x if which == "x" else v)[5, 1] = np.nan
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 5
    assert "not finite" in trouble.cause


def test_energy_from_nothing_is_told_from_a_twentieth_of_what_moves() -> None:
    """Measured from the smallest total energy so far: a swinging body converts energy and may lose some, but gain only little."""

    def told(*sums: tuple[float, float]) -> list[bool]:
        balance = watchdog.EnergyBalance()
        return [balance.check({"kinetic": kinetic, "elastic": elastic}) is not None for kinetic, elastic in sums]

    assert told((1.0, 0.0), (0.3, 0.7), (1.0, 0.049)) == [False, False, False]
    assert told((1.0, 0.0), (0.3, 0.7), (1.0, 0.06)) == [False, False, True]
    assert told((1.0, 0.0), (0.2, 0.6), (0.849, 0.0), (0.86, 0.0)) == [False, False, False, True], "0.8 J is the least"
    assert told((1.0, 0.0), (np.nan, 0.0)) == [False, True]


def test_a_body_that_was_turned_inside_out_is_told_where(model: Model) -> None:
    x, F = model.particles.position, np.tile(np.eye(3), (len(model.density), 1, 1))
    F[11] = np.diag([1.0, 1.0, -0.1])
    trouble = watchdog.broken(model, x, 0 * x, F)
    assert trouble.particle == 11
    assert "det F fell to -0.1" in trouble.cause


def test_comparisons_in_compiled_code_know_infinity_and_no_number() -> None:
    """Compiled code may rely on this comparison (magmpm.compiled.jit): np.isfinite would not work."""

    @compiled
    def below(values):  # type: ignore[no-untyped-def]
        fine = True
        for value in values:
            fine = fine and value * value < np.inf
        return fine

    with np.errstate(all="ignore"):
        assert [below(np.array([1.0, bad])) for bad in (2.0, np.inf, -np.inf, np.nan, 1e200)] == [True, False, False, False, False]
