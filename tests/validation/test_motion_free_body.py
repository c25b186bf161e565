"""A body that nothing holds: momentum, angular momentum and acceleration follow from the external forces."""

from __future__ import annotations

import numpy as np
import pytest
from reference.in_motion import advance, free_rod, quantities, set_off

from magmpm.dynamics.time_loop import begin
from magmpm.fields.dipole import MU0
from magmpm.model import build

BODY = {"length": 8e-3, "directions": [(0.3, 0.2, 1.0), (-1.0, 0.4, 0.0)]}
SPIN = np.array([30.0, -80.0, 50.0])  # 1/s


def thrown(x: np.ndarray) -> np.ndarray:
    """The body flies, rotates and vibrates: strain rates of 200 1/s, about 0.4 % in the transit time of a wave."""
    return np.array([0.3, -0.2, 0.1]) + np.cross(SPIN, x) + 0.5 * np.sin(400.0 * x)


def test_momentum_and_spin_stay() -> None:
    """Without force and torque, 2000 steps of violent motion conserve both to 1e-10 (accumulated rounding)."""
    motion, dt = set_off(free_rod(**BODY), thrown)
    before = quantities(motion)
    advance(motion, 4, dt)
    assert np.abs(np.linalg.det(motion.particles()[2]) - 1).max() > 1e-3, "the body does not stay rigid"
    advance(motion, 1996, dt)
    after = quantities(motion)
    for a, b in zip(after, before, strict=True):
        assert np.linalg.norm(a - b) < 1e-10 * np.linalg.norm(b)


def test_a_field_turns_a_free_body() -> None:
    """dL/dt = integral of (1/mu0) F Br x B dV, summed step by step, to 1e-6 of its magnitude; momentum stays 0."""
    B = np.array([2e-3, -5e-3, 10e-3])
    motion, dt = set_off(free_rod(field=B, **BODY), np.zeros_like)
    model = motion.model
    impulse, size = np.zeros(3), 0.0
    for _ in range(400):
        _, _, F = motion.particles()
        torque = model.particles.volume @ np.cross(np.einsum("nij,nj->ni", F, model.remanence), B) / MU0
        impulse, size = impulse + dt * torque, size + dt * np.linalg.norm(torque)
        advance(motion, 1, dt)
    now = quantities(motion)
    assert size > 0
    assert np.linalg.norm(now.spin - impulse) < 1e-6 * size
    assert np.linalg.norm(now.momentum) < 1e-10 * size / 8e-3
    turned = motion.particles()[2]
    assert np.linalg.norm(turned.mean(axis=0) - np.eye(3)) > 1e-3, "the body has begun to turn"


def test_inertia_is_the_body_s() -> None:
    """Momentum and angular momentum of a rigid motion are those of the particles, to rounding, and no warning is given."""
    for cells in (2, 4):
        motion, _ = set_off(free_rod(cells=cells, **BODY), lambda x: np.array([0.3, -0.2, 0.1]) + np.cross(SPIN, x))
        model = motion.model
        mass, (x, v, _) = model.density * model.particles.volume, motion.particles()
        now = quantities(motion)
        np.testing.assert_allclose(now.momentum, mass @ v, rtol=0, atol=1e-12 * np.linalg.norm(mass @ v))
        spin = mass @ np.cross(x, v)
        np.testing.assert_allclose(now.spin, spin, rtol=0, atol=1e-12 * np.linalg.norm(spin))
        assert motion.kinetic_energy() == pytest.approx(0.5 * float(mass @ (v**2).sum(axis=1)), rel=1e-12)
    assert begin(build(free_rod(cells=2, **BODY))).warnings == []


def test_weight_alone_accelerates_by_g() -> None:
    """To 1e-10, and without stress: all particles fall equally."""
    g = np.array([1.0, -2.0, -9.81])
    motion, dt = set_off(free_rod({"damping": {"rate": 1e-9}}, gravity=g, **BODY), np.zeros_like)  # of nothing: kernels of other tests
    steps = 500
    advance(motion, steps, dt)
    x, _, F = motion.particles()
    fallen = g * dt**2 * steps * (steps + 1) / 2  # g t^2/2 as symplectic Euler integrates it
    np.testing.assert_allclose(x - motion.model.particles.position, np.tile(fallen, (len(x), 1)), rtol=1e-10)
    np.testing.assert_allclose(F, np.tile(np.eye(3), (len(x), 1, 1)), atol=1e-11)
