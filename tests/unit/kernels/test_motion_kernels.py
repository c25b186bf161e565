"""The kernels of motion against the plain reference of one step, to rounding, and that against the static reference."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from reference.dynamics import Total
from reference.mpm_numpy import Reference
from reference.scenes import X, rod_scene

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import damping, feed, gravity, ground, magnetic_torque, viscosity, walls
from magmpm.effects.base import one_record
from magmpm.effects.contact_force import MOST_PUSH, NORMAL
from magmpm.effects.contact_law import at_rest, contact_of
from magmpm.kernels.surface_contact import PATCH
from magmpm.model import Model, build
from magmpm.statics.layout import static_model

B = np.array([2e-3, -3e-3, 5e-3])
DT = 1e-6
STEPS = 3
LOADS = {
    "bare": (),
    "field and damping": (
        magnetic_torque.parameters(B) + one_record(damping.DTYPE, damping_rate=300.0)
    ),
}
TABLE = distance.tube(curve(np.array([[-5e-3, 0, 0], [15e-3, 0, 1e-3]]), 1e-4), 2.2e-3, 0.5e-3)
# One set, that of test_interrupted_results.py, so that one kernel is compiled: all kinds of hooks, and contact with many particles.
EFFECTS = (
    magnetic_torque.parameters(np.array([0.2, 0.3, -0.5]), turns=True)
    + one_record(gravity.DTYPE, gravity=np.array([0.3, 0.2, -9.81]))
    + one_record(viscosity.DTYPE, viscosity=3.0)
    + one_record(damping.DTYPE, damping_rate=300.0)
    + ground.parameters(
        point=[0, 0, -1.2e-3],
        normal=[0.1, 0.2, 1],
        friction=30.0,
        stiffness=1e9,
    )
    + walls.parameters(TABLE, friction=0.2, stiffness=2e9)
    + one_record(feed.DTYPE, feed_speed=0.02, feed_exit=2e-3, feed_radius=3e-3)
)


def model_of(effects: tuple[np.ndarray, ...] = (), **scene: object) -> Model:
    return replace(static_model(build(rod_scene(length=8e-3, **scene))), effects=effects)  # type: ignore[arg-type]


def shaken(
    reference: Total, motion: TotalMotion, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random displacements and velocities of all free nodes."""
    c, v = np.zeros((2, *reference.X.shape))
    on = motion.packed.nodes.inverse_mass.reshape(-1, 3).all(axis=1)
    c[on], v[on] = 3e-5 * rng.standard_normal((on.sum(), 3)), rng.standard_normal((on.sum(), 3))
    return c, v


def compare(
    reference: Total, motion: TotalMotion, c: np.ndarray, v: np.ndarray, rounding: float
) -> np.ndarray:
    """Take steps by both; rounding: of the largest value. Returns c of the reference."""
    for _ in range(STEPS):
        c, v = reference.step(c, v, DT)
    assert motion.advance(STEPS, DT, motion.model.effects) == (STEPS, False)
    np.testing.assert_allclose(motion.u.reshape(-1, 3), c, rtol=0, atol=rounding * np.abs(c).max())
    np.testing.assert_allclose(motion.v.reshape(-1, 3), v, rtol=0, atol=rounding * np.abs(v).max())
    return c


@pytest.mark.parametrize("loads", LOADS)
@pytest.mark.parametrize("averaged", [True, False], ids=["f-bar", "plain"])
def test_total(loads: str, averaged: bool, rng: np.random.Generator) -> None:
    """To rounding of sums over some hundred particles."""
    model = model_of(LOADS[loads])
    if not averaged:
        model = replace(model, modes=np.zeros((len(model.density), 0)))
    reference = Total.of(model)
    motion = TotalMotion(model)
    c, v = shaken(reference, motion, rng)
    motion.restore({"u": c.ravel(), "v": v.ravel()})
    c = compare(reference, motion, c, v, 1e-13)
    x, _, F = motion.particles()
    np.testing.assert_allclose(x, model.particles.position + reference.N @ c, rtol=0, atol=1e-13)
    np.testing.assert_allclose(F, np.eye(3) + reference.gradient(c), rtol=0, atol=1e-13)


def test_effects_of_motion(rng: np.random.Generator) -> None:
    """All kinds, on magnetization that stretches in the first half and rotates in the second. Stiff contact and viscosity amplify rounding
    errors of positions and rates. Some points touch each obstacle, and some do not; some stick and some slide. Points had friction
    before, of any direction and size.
    """
    made = build(rod_scene(length=8e-3, directions=[X, X], law=["stretches", "rotates"]))
    model = replace(made, effects=EFFECTS, clamped_face=True)
    reference = Total.of(model)
    motion = TotalMotion(model)
    c, v = shaken(reference, motion, rng)
    x = model.surface.place + reference.on @ c
    patches = len(reference.most)
    reference.friction[:] = rng.choice([0.0, 1e-5, 1e-2], (patches, 1)) * rng.standard_normal(
        (patches, 3)
    )
    on = motion.packed.surface
    reference.order = reference.patch[motion.packed.point[on.first_point[:-1]]]
    begun = np.zeros((patches, PATCH))
    begun[:, :3] = reference.friction[reference.order]
    motion.restore({"u": c.ravel(), "v": v.ravel(), "touching": np.append(begun, 0.0)})
    for at in (8, 10):  # ground, walls
        told = contact_of(EFFECTS[at : at + 2], at_rest(motion.touching_points().x))
        assert 0.02 * len(x) < told["count"] < 0.9 * len(x)
    compare(reference, motion, c, v, 1e-12)
    found = motion.touching[:-1].reshape(-1, PATCH)
    held = reference.friction[reference.order]
    size = np.linalg.norm(held, axis=1)
    most = reference.most[reference.order]
    touching = most > 0
    assert 5 < touching.sum() < 0.9 * patches
    assert (size[touching] > 0.999 * most[touching]).any(), "some slide"
    assert (size[touching] < 0.999 * most[touching]).any(), "some stick"
    np.testing.assert_allclose(found[:, MOST_PUSH], most, rtol=0, atol=1e-12 * most.max())
    np.testing.assert_allclose(found[:, :3], held, rtol=0, atol=1e-9 * most.max())
    normal = reference.normal[reference.order]
    np.testing.assert_allclose(found[:, NORMAL:MOST_PUSH], normal, rtol=0, atol=1e-9)


def test_same_bits_at_any_number_of_threads() -> None:
    model = model_of(LOADS["field and damping"], directions=[(0.3, 0.2, 1.0)])
    found = []
    before = numba.get_num_threads()
    try:
        for threads in range(1, before + 1):
            numba.set_num_threads(threads)
            motion = TotalMotion(model)
            motion.advance(600, 2e-6, model.effects)
            found.append([a.tobytes() for a in motion.particles()])
    finally:
        numba.set_num_threads(before)
    assert all(bits == found[0] for bits in found)


def test_a_particle_turned_inside_out_stops_the_motion() -> None:
    motion = TotalMotion(model_of())
    motion.u[:] = (
        np.random.default_rng(0).standard_normal(len(motion.u))
        * (motion.packed.nodes.inverse_mass > 0)
        * 5e-3
    )
    assert motion.advance(5, 1e-9, ()) == (0, True)


def test_no_number_stops_the_motion() -> None:
    """NaN is detected by the watchdog and never writes to memory outside the grid."""
    motion = TotalMotion(model_of())
    motion.v[3 * motion.packed.nodes.active[5]] = np.nan
    taken, broken = motion.advance(5, 1e-9, ())
    assert broken
    assert taken <= 1


@pytest.mark.parametrize("cells", [1, 3, 4, 9, 41, 82, 83])
@pytest.mark.parametrize("least", [2, 4])
def test_slabs_are_thick_enough_and_balanced(cells: int, least: int) -> None:
    edges = slab_edges(cells, least)
    assert (edges[0], edges[-1]) == (0, cells)
    assert len(edges) == 2 or np.diff(edges).min() >= least
    assert len(edges) - 1 <= 4 or (len(edges) - 1) % 4 == 0


def test_the_plain_force_is_the_energys_slope(rng: np.random.Generator) -> None:
    """At rest and without effects: minus the residual of the static reference, whose splines are SciPy's."""
    model = static_model(build(rod_scene(length=6e-3)))
    total = Total.of(model)
    statics = Reference.of(model)
    c = np.zeros((len(total.X), 3))
    free = np.flatnonzero(total.mass > 0)
    c[free] = 2e-5 * rng.standard_normal((len(free), 3))
    planes = c.reshape(*model.grid.nodes, 3)[1:]  # node 0 along x belongs to the clamp
    y, z = model.layout.node_yz.T
    ours = total.force(c, 0 * c, 1e-6).reshape(*model.grid.nodes, 3)[1:][:, y, z]
    theirs = -statics.residual(planes[:, y, z].reshape(model.layout.planes, -1)).reshape(ours.shape)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())
    assert np.abs(theirs).max() > 1e-3
