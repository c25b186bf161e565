"""Effects of motion in the fast kernels, against the plain reference of one step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.dynamics import Total
from reference.scenes import X, rod_scene

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import damping, feed, gravity, ground, magnetic_torque, viscosity, walls
from magmpm.effects.base import one_record
from magmpm.effects.contact_law import at_rest, contact_of
from magmpm.model import Model, build

ROUNDING = (
    1e-12  # of the largest value; stiff contact and viscosity amplify rounding errors of positions and rates
)
DT, STEPS = 1e-6, 3
TABLE = distance.tube(curve(np.array([[-5e-3, 0, 0], [15e-3, 0, 1e-3]]), 1e-4), 2.2e-3, 0.5e-3)
# One set, that of test_interrupted_results.py, so that one kernel is compiled: all kinds of hooks, and contact with many particles.
EFFECTS = (
    magnetic_torque.parameters(np.array([0.2, 0.3, -0.5]), turns=True)
    + one_record(gravity.DTYPE, gravity=np.array([0.3, 0.2, -9.81]))
    + one_record(viscosity.DTYPE, viscosity=3.0)
    + one_record(damping.DTYPE, damping_rate=300.0)
    + ground.parameters(point=[0, 0, -1.2e-3], normal=[0.1, 0.2, 1], friction=0.3, stiffness=1e9, damping=3e4)
    + walls.parameters(TABLE, friction=0.2, stiffness=2e9, damping=5e4)
    + one_record(feed.DTYPE, feed_speed=0.02, feed_exit=2e-3, feed_radius=3e-3)
)


@pytest.fixture(scope="module")
def model() -> Model:
    """Magnetization stretches in the first half and rotates in the second."""
    return replace(build(rod_scene(length=8e-3, directions=[X, X], law=["stretches", "rotates"])), effects=EFFECTS, clamped_face=True)


def touching(model: Model, x: np.ndarray) -> None:
    """The comparison is meaningful: some points touch each obstacle, and some do not."""
    for at in (8, 10):  # ground, walls
        told = contact_of(EFFECTS[at : at + 2], at_rest(x), DT)
        assert 0.02 * len(x) < told["count"] < 0.9 * len(x)


def test_total(model: Model, rng: np.random.Generator) -> None:
    reference, motion = Total.of(model), TotalMotion(model)
    c, v = np.zeros((2, *reference.X.shape))
    on = motion.packed.nodes.inverse_mass.reshape(-1, 3).all(axis=1)
    c[on], v[on] = 3e-5 * rng.standard_normal((on.sum(), 3)), rng.standard_normal((on.sum(), 3))
    x = model.surface.place + reference.on @ c
    reference.anchor[:, :3] = x + 3e-6 * rng.standard_normal(x.shape)  # some are held and some slide
    reference.anchor[:, 3] = rng.integers(0, 3, len(x))
    mine = np.lexsort((*model.surface.place.T, model.surface.mass))
    theirs = np.lexsort((*motion.packed.surface.place.reshape(-1, 3).T, motion.packed.surface.mass))
    begun = np.ones_like(motion.anchor)  # the last numbers, of patches: some may be held
    begun[: 4 * len(x)].reshape(-1, 4)[theirs] = reference.anchor[mine]
    motion.restore({"u": c.ravel(), "v": v.ravel(), "anchor": begun})
    touching(model, motion.touching_points().x)
    for _ in range(STEPS):
        c, v = reference.step(c, v, DT)
    assert motion.advance(STEPS, DT, model.effects) == (STEPS, False)
    np.testing.assert_allclose(motion.u.reshape(-1, 3), c, rtol=0, atol=ROUNDING * np.abs(c).max())
    np.testing.assert_allclose(motion.v.reshape(-1, 3), v, rtol=0, atol=ROUNDING * np.abs(v).max())
    found, held = motion.anchor[: 4 * len(x)].reshape(-1, 4)[theirs], reference.anchor[mine]
    np.testing.assert_array_equal(found[:, 3], held[:, 3])
    on = held[:, 3] > 0
    assert 20 < on.sum() < 0.9 * len(on)
    np.testing.assert_allclose(found[on], held[on], rtol=0, atol=ROUNDING)
