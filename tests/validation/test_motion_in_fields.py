"""Motion in fields that vary in space and time: balances of momentum, settling at the static equilibrium, and stops."""

from typing import Any

import numpy as np
import pytest
from reference.in_motion import advance, free_rod, moving, quantities, set_off
from reference.scenes import rod_scene

from magmpm.dynamics.time_loop import begin
from magmpm.effects import acting as effects
from magmpm.errors import SolveError
from magmpm.fields.dipole import MU0
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run

BODY = {"length": 8e-3, "directions": [(0.3, 0.2, 1.0), (-1.0, 0.4, 0.0)]}
BOTH: dict[str, Any] = {"magnetic_torque": {}, "magnetic_force": {}}
SPHERE = {"position": (20e-3, 4e-3, 10e-3), "moment": (1.0, 0.4, -2.0), "diameter": 6e-3}


def in_field(scene: Scene, field: dict[str, Any], named: dict[str, Any]) -> Scene:
    data = scene.to_si()
    return Scene.from_si({**data, "field": field, "effects": {**data["effects"], **named}})


def test_a_gradient_pulls_and_turns_a_free_body() -> None:
    """Momentum grows by the integral of f = (1/mu0) (grad B)^T F Br, angular momentum by that of x cross f plus (1/mu0) F Br cross B,
    summed by steps: to 1e-6 of their size. The first step gives the center the acceleration (1/mu0) mean of (grad B)^T Br over rho.
    """
    scene = in_field(free_rod(**BODY), {"uniform": (0, 2e-3, 0), "dipole": SPHERE}, BOTH)
    motion, dt = set_off(scene, np.zeros_like)
    model = motion.model
    source = scene.external_field()
    V = model.particles.volume
    mass = float(model.density @ model.particles.volume)
    pushed = np.zeros(3)
    turned = np.zeros(3)
    size = np.zeros(2)
    for step in range(200):
        x, _, F = motion.particles()
        m = np.einsum("nij,nj->ni", F, model.remanence) / MU0
        f = np.einsum("nji,nj->ni", source.gradient(x), m)
        force = V @ f
        torque = V @ (np.cross(x, f) + np.cross(m, source.at(x)))
        pushed = pushed + dt * force
        turned = turned + dt * torque
        size += dt * np.array([np.linalg.norm(force), np.linalg.norm(torque)])
        advance(motion, 1, dt)
        if step == 0:
            np.testing.assert_allclose(
                quantities(motion).momentum / mass, dt * force / mass, rtol=1e-9
            )
            assert np.linalg.norm(force) / mass > 1.0, "m/s^2"
    now = quantities(motion)
    assert np.linalg.norm(now.momentum - pushed) < 1e-6 * size[0]
    assert np.linalg.norm(now.spin - turned) < 1e-6 * size[1]


def test_segments_that_pull_each_other_move_no_centre() -> None:
    """Loads computed every 64 steps: momentum stays 0 to rounding; the angular one, by their lag, below a thousandth of exchanges."""
    scene = free_rod({"magnetic_interaction": {}}, **BODY)
    motion, dt = set_off(scene, np.zeros_like)
    model = motion.model
    exchanged = 0.0
    turned = 0.0
    for _ in range(8):
        x, _, F = motion.particles()
        effects.refresh(model.effects, model, x, F)
        load = model.effects[1].reshape(-1, 6)[model.remanence[:, 3].astype(int)]
        force = model.particles.volume[:, None] * load[:, 3:]
        torque = model.particles.volume[:, None] * np.cross(
            np.einsum("nij,nj->ni", F, model.remanence[:, :3]), load[:, :3]
        )
        exchanged += 64 * dt * float(np.abs(force).sum())
        turned += 64 * dt * float(np.abs(torque).sum())
        advance(motion, 64, dt)
    now = quantities(motion)
    assert np.abs(motion.particles()[0] - model.particles.position).max() > 1e-6, "they move"
    assert np.linalg.norm(now.momentum) < 1e-11 * exchanged
    assert np.linalg.norm(now.spin) < 1e-3 * turned


@pytest.mark.slow
@pytest.mark.parametrize("named", ["pulled", "together"])
def test_motion_comes_to_rest_where_statics_is(named: str) -> None:
    """With damping near twice the first bending frequency: within 0.2 % of the length."""
    length = 24e-3
    if named == "pulled":
        sphere = {"position": (45e-3, 0, 12e-3), "moment": (4.0, 0, 0), "diameter": 16e-3}
        still = in_field(rod_scene(length=length), {"dipole": sphere}, BOTH)
    else:
        directions = [(1, 0, 0), (0, 0, 1), (-1, 0, 0)]
        still = rod_scene(
            length=length, directions=directions, field=(0, 1e-3, 10e-3)
        ).with_effects(magnetic_interaction={})
    rest = run(still)
    settled = run(moving(still, {"damping": {"rate": 160.0}}, duration=0.12, output_every=0.03))
    assert np.linalg.norm(rest.tip - [length, 0, 0]) > 0.02 * length
    assert np.linalg.norm(settled.tip - rest.tip) < 2e-3 * length
    assert settled.kinetic_energy < 1e-4 * abs(settled.energy)


def test_a_magnet_that_is_brought_too_close_stops_the_motion() -> None:
    """The magnet moves through the catheter: the run ends with a message (time, magnet, place) and the last good state."""
    frames = [{"time": 0.0, "move": (0, 0, 0)}, {"time": 4e-3, "move": (-25e-3, 0, 0)}]
    field = {"dipole": {**SPHERE, "position": (30e-3, 0, 0)}, "over_time": {"keyframes": frames}}
    with pytest.raises(
        SolveError,
        match=(
            r"t = 0.00\d+ s: the body's point at .* is inside field.dipole, center \(.*, 0, 0\) mm"
        ),
    ) as caught:
        run(moving(in_field(rod_scene(length=8e-3), field, BOTH), duration=4e-3, output_every=1e-3))
    assert caught.value.state.time < 4e-3


# A body that nothing holds: momentum, angular momentum and acceleration follow from the external forces


SPIN = np.array([30.0, -80.0, 50.0])  # 1/s


def thrown(x: np.ndarray) -> np.ndarray:
    """The body flies, rotates and vibrates: strain rates of 200 1/s, about 0.4 % in the transit time of a wave."""
    return np.array([0.3, -0.2, 0.1]) + np.cross(SPIN, x) + 0.5 * np.sin(400.0 * x)


def test_momentum_and_spin_stay() -> None:
    """Without force and torque, 2000 steps of violent motion conserve both to 1e-10 (accumulated rounding)."""
    motion, dt = set_off(free_rod(**BODY), thrown)
    before = quantities(motion)
    advance(motion, 4, dt)
    assert np.abs(np.linalg.det(motion.particles()[2]) - 1).max() > 1e-3, (
        "the body does not stay rigid"
    )
    advance(motion, 1996, dt)
    after = quantities(motion)
    for a, b in zip(after, before, strict=True):
        assert np.linalg.norm(a - b) < 1e-10 * np.linalg.norm(b)


def test_inertia_is_the_body_s() -> None:
    """Momentum and angular momentum of a rigid motion are those of the particles, to rounding, and no warning is given."""
    for cells in (2, 4):
        motion, _ = set_off(
            free_rod(cells=cells, **BODY), lambda x: np.array([0.3, -0.2, 0.1]) + np.cross(SPIN, x)
        )
        model = motion.model
        mass, (x, v, _) = model.density * model.particles.volume, motion.particles()
        now = quantities(motion)
        np.testing.assert_allclose(
            now.momentum, mass @ v, rtol=0, atol=1e-12 * np.linalg.norm(mass @ v)
        )
        spin = mass @ np.cross(x, v)
        np.testing.assert_allclose(now.spin, spin, rtol=0, atol=1e-12 * np.linalg.norm(spin))
        assert motion.kinetic_energy() == pytest.approx(
            0.5 * float(mass @ (v**2).sum(axis=1)), rel=1e-12
        )
    assert begin(build(free_rod(cells=2, **BODY))).warnings == []


def test_weight_alone_accelerates_by_g() -> None:
    """To 1e-10, and without stress: all particles fall equally."""
    g = np.array([1.0, -2.0, -9.81])
    motion, dt = set_off(
        free_rod({"damping": {"rate": 1e-9}}, gravity=g, **BODY), np.zeros_like
    )  # of nothing: kernels of other tests
    steps = 500
    advance(motion, steps, dt)
    x, _, F = motion.particles()
    fallen = g * dt**2 * steps * (steps + 1) / 2  # g t^2/2 as symplectic Euler integrates it
    np.testing.assert_allclose(
        x - motion.model.particles.position, np.tile(fallen, (len(x), 1)), rtol=1e-10
    )
    np.testing.assert_allclose(F, np.tile(np.eye(3), (len(x), 1, 1)), atol=1e-11)
