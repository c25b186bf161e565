"""The kernels of motion against the plain reference of one step, to rounding."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from reference.dynamics import Total
from reference.scenes import rod_scene

from magmpm.dynamics.particle_groups import slab_edges
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import damping, magnetic_torque
from magmpm.effects.base import one_record
from magmpm.model import Model, build
from magmpm.statics.layout import static_model

B = np.array([2e-3, -3e-3, 5e-3])
ROUNDING = 1e-13  # of the largest value: sums over some hundred particles
DT, STEPS = 1e-6, 3
# Weight, viscosity, contact and a guide: test_motion_effects.py, with one set of kernels.
LOADS = {"bare": (), "field and damping": magnetic_torque.parameters(B) + one_record(damping.DTYPE, damping_rate=300.0)}


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
    motion.u[:] = np.random.default_rng(0).standard_normal(len(motion.u)) * (motion.packed.nodes.inverse_mass > 0) * 5e-3
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
