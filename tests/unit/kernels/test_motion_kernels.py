"""The kernels of motion against the plain reference of one step, to rounding, in both formulations."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from reference.dynamics import Total, Updated
from reference.scenes import rod_scene

from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.drift_correction import INTERVAL
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import damping, gravity, magnetic_torque
from magmpm.model import Model, build
from magmpm.statics.layout import static_model

B, BR, G_EARTH = np.array([2e-3, -3e-3, 5e-3]), np.array([0.1, 0.05, -0.08]), np.array([0.3, 0.2, -9.81])
ROUNDING = 1e-13  # of the largest value: sums over some hundred particles
DT, STEPS = 1e-6, 3
LOADS = {"bare": (), "weight, field and damping": magnetic_torque.parameters(B) + gravity.parameters(G_EARTH) + damping.parameters(300.0)}


def model_of(effects: tuple[np.ndarray, ...] = (), **scene: object) -> Model:
    return replace(static_model(build(rod_scene(length=8e-3, **scene))), effects=effects)  # type: ignore[arg-type]


@pytest.mark.parametrize("loads", LOADS)
@pytest.mark.parametrize("averaged", [True, False], ids=["f-bar", "plain"])
def test_total(loads: str, averaged: bool, rng: np.random.Generator) -> None:
    model = model_of(LOADS[loads])
    if not averaged:
        model = replace(model, modes=np.zeros((len(model.density), 0)))
    reference, motion = Total.of(model), TotalMotion(model)
    c, v = np.zeros((2, *reference.X.shape))
    on = motion.packed.nodes.inverse_mass.reshape(-1, 3).all(axis=1)
    c[on], v[on] = 3e-5 * rng.standard_normal((on.sum(), 3)), rng.standard_normal((on.sum(), 3))
    motion.restore({"u": c.ravel(), "v": v.ravel()})
    for _ in range(STEPS):
        c, v = reference.step(c, v, DT)
    assert motion.advance(STEPS, DT, model.effects) == (STEPS, False)
    np.testing.assert_allclose(motion.u.reshape(-1, 3), c, rtol=0, atol=ROUNDING * np.abs(c).max())
    np.testing.assert_allclose(motion.v.reshape(-1, 3), v, rtol=0, atol=ROUNDING * np.abs(v).max())
    x, _, F = motion.particles()
    np.testing.assert_allclose(x, model.particles.position + reference.N @ c, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(F, np.eye(3) + reference.gradient(c), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("loads", LOADS)
def test_updated(loads: str, rng: np.random.Generator) -> None:
    model = replace(model_of(LOADS[loads]), modes=np.zeros((0, 0)))
    model = replace(model, modes=np.zeros((len(model.density), 0)))
    n = len(model.density)
    x = model.particles.position + 1e-4 * rng.standard_normal((n, 3))
    v, C = 0.5 * rng.standard_normal((n, 3)), 100.0 * rng.standard_normal((n, 3, 3))
    F = np.eye(3) + 0.05 * rng.standard_normal((n, 3, 3))
    reference, motion = Updated(model, x.copy(), v.copy(), F.copy(), C.copy(), C.copy()), UpdatedMotion(model)
    motion.place(x, v, F, C)
    for _ in range(STEPS):
        reference.step(DT)
    assert motion.advance(STEPS, DT, model.effects) == (STEPS, False)
    found = (*motion.particles(), motion.affine())
    for a, b in zip(found, (reference.x, reference.v, reference.F, reference.C), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=ROUNDING * np.abs(b).max())


def test_updated_sorts_where_it_must_and_goes_on_as_before(rng: np.random.Generator) -> None:
    """A body that flies over 3 cells: sorted repeatedly, and still equal to the reference."""
    model = model_of(clamp="none") if "clamp" in rod_scene.__kwdefaults__ else model_of()
    model = replace(model, modes=np.zeros((len(model.density), 0)), clamped_face=False)
    n = len(model.density)
    v = np.tile([0.0, 20.0, -10.0], (n, 1)) + 0.1 * rng.standard_normal((n, 3))
    eye, zero = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3))
    motion = UpdatedMotion(model)
    motion.place(model.particles.position, v, eye, zero)
    dt = 0.3 * model.grid.spacing[1] / 20.0
    taken = [motion.advance(10, dt, ()) for _ in range(4)]
    assert [count for count, _ in taken] == [4, 4, 4, 4], "a cell is 3.3 steps wide"
    reference = Updated(model, model.particles.position.copy(), v.copy(), eye.copy(), zero.copy(), zero.copy())
    reference = replace(reference, model=replace(model, layout=replace(model.layout, planes=model.grid.nodes[0])))
    for _ in range(16):
        reference.step(dt)
    x, _, F = motion.particles()
    np.testing.assert_allclose(x, reference.x, rtol=0, atol=1e-12 * np.abs(x).max())
    np.testing.assert_allclose(F, reference.F, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", [TotalMotion, UpdatedMotion])
def test_same_bits_at_any_number_of_threads(kind: type[TotalMotion] | type[UpdatedMotion]) -> None:
    model = model_of(LOADS["weight, field and damping"], directions=[(0.3, 0.2, 1.0)])
    found = []
    before = numba.get_num_threads()
    try:
        for threads in range(1, before + 1):
            numba.set_num_threads(threads)
            motion = kind(model)
            motion.advance(600, 2e-6, model.effects)  # with a fit of the updated formulation (dynamics.drift_correction)
            found.append([a.tobytes() for a in motion.particles()])
    finally:
        numba.set_num_threads(before)
    assert all(bits == found[0] for bits in found)


@pytest.mark.parametrize("kind", [TotalMotion, UpdatedMotion])
def test_a_particle_turned_inside_out_stops_the_motion(kind: type[TotalMotion] | type[UpdatedMotion]) -> None:
    model = model_of()
    motion = kind(model)
    if isinstance(motion, TotalMotion):
        motion.u[:] = np.random.default_rng(0).standard_normal(len(motion.u)) * (motion.packed.nodes.inverse_mass > 0) * 5e-3
    else:
        n = len(model.density)
        F = np.tile(np.diag([1.0, 1.0, -0.1]), (n, 1, 1))
        motion.place(model.particles.position, np.zeros((n, 3)), F, np.zeros((n, 3, 3)))
    assert motion.advance(5, 1e-9, ()) == (0, True)


@pytest.mark.parametrize("kind", [TotalMotion, UpdatedMotion])
def test_no_number_stops_the_motion(kind: type[TotalMotion] | type[UpdatedMotion]) -> None:
    """NaN is detected by the watchdog and never writes to memory outside the grid."""
    motion = kind(model_of())
    if isinstance(motion, TotalMotion):
        motion.v[3 * motion.packed.nodes.active[5]] = np.nan
    else:
        motion.v[12] = np.nan
    taken, broken = motion.advance(5, 1e-9, ())
    assert broken
    assert taken <= 1


def test_sorting_gives_the_bits_that_placing_gives(rng: np.random.Generator) -> None:
    """A resumed motion places its particles again; a running one sorts them."""
    model = model_of(LOADS["weight, field and damping"])
    n = len(model.density)
    motions = [UpdatedMotion(model), UpdatedMotion(model)]
    for motion in motions:
        motion.since = INTERVAL - 90  # so that a drift correction takes place
        motion.place(model.particles.position, np.tile([0.0, 8.0, -3.0], (n, 1)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))
        motion.advance(60, 2e-6, model.effects)
    motions[0].sort()
    motions[1].restore(motions[1].state())
    for motion in motions:
        motion.advance(60, 2e-6, model.effects)
    for name in ("x", "v", "C", "F", "remanence", "volume", "shear", "bulk", "density", "particle"):
        assert np.array_equal(getattr(motions[0], name), getattr(motions[1], name)), name


def test_sorting_keeps_what_segments_that_act_on_each_other_need() -> None:
    """Rows of `magnet` have a fourth column then: which block of the body a particle is of."""
    model = build(rod_scene(length=8e-3, directions=[(1, 0, 0), (0, 0, 1)]).with_effects(magnetic_interaction={}))
    motion = UpdatedMotion(model)
    for _ in range(2):
        np.testing.assert_array_equal(motion._in_order(motion.remanence, 4), model.remanence)
        motion.sort()


@pytest.mark.parametrize("cells", [1, 3, 4, 9, 41, 82, 83])
@pytest.mark.parametrize("least", [2, 4])
def test_slabs_are_thick_enough_and_balanced(cells: int, least: int) -> None:
    edges = slab_edges(cells, least)
    assert (edges[0], edges[-1]) == (0, cells)
    assert len(edges) == 2 or np.diff(edges).min() >= least
    assert len(edges) - 1 <= 4 or (len(edges) - 1) % 4 == 0
