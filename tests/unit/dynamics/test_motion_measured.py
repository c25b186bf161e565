"""The measures of a motion at a moment other than the first: stress, field, energies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.dynamics import elastic_stress
from reference.in_motion import moving
from reference.scenes import rod_scene

from magmpm.bodies.grid import spline_weights
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.time_loop import SimulationState, begin, integrate
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run

FIELD, RISE = np.array([0.0, 5e-3, 20e-3]), 2e-3  # T, s: twice as long as the motion


def scene(formulation: str) -> Scene:
    """A short clamped catheter in a field that rises throughout the motion."""
    data = moving(rod_scene(length=8e-3, field=FIELD), formulation=formulation, duration=1e-3, output_every=5e-4).to_si()
    return Scene.from_si({**data, "field": {"uniform": FIELD.tolist(), "over_time": {"ramp": {"duration": RISE}}}})


def energies(model: Model, moved: SimulationState, averaged: bool) -> dict[str, float]:
    """Elastic and magnetic energy, J, from the formulas: sum V (G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2), with (J - 1)^2 projected by F-bar
    where volume is averaged, and -sum V B . F Br / mu0.
    """
    F, V = moved.F, model.particles.volume
    J, I1 = np.linalg.det(F), np.einsum("nij,nij->n", F, F)
    change = J - 1
    if averaged:
        first = model.particles.cell_first
        moments = np.add.reduceat(model.modes * (V * change)[:, None], first[:-1], axis=0)
        volume = float(np.sum(model.bulk[first[:-1]] * (moments**2).sum(axis=1))) / 2
    else:
        volume = float(V @ (model.bulk * change**2)) / 2
    shape = float(V @ (model.shear * (J ** (-2 / 3) * I1 - 3))) / 2
    B = FIELD * moved.time / RISE
    magnetic = -float(V @ np.einsum("i,nij,nj->n", B, F, model.remanence)) / MU0
    return {"elastic": shape + volume, "magnetic_torque": magnetic}


@pytest.mark.parametrize("formulation", ["total", "updated"])
def test_stress_field_and_energies_are_those_of_the_moment(formulation: str, tmp_path: Path) -> None:
    """The stress of a frame includes the elastic law and the field at that moment, not that of the start, which is zero."""
    model = build(scene(formulation))
    moved = integrate(begin(model), folder=tmp_path)
    assert moved.time == 1e-3
    B = FIELD * moved.time / RISE
    averaged = formulation == "total"
    of = model if averaged else replace(model, modes=np.zeros((len(model.density), 0)))
    magnetic = -np.einsum("i,nj->nij", B, model.remanence) / MU0
    elastic = elastic_stress(of, moved.F)
    np.testing.assert_allclose(moved.P, elastic + magnetic, rtol=0, atol=1e-10 * np.abs(elastic).max())  # sums of about ten products
    assert np.abs(magnetic).max() > 0.05 * np.abs(elastic).max(), "to leave it out would be seen"
    wanted = energies(model, moved, averaged)
    for name, value in wanted.items():
        assert moved.energies[name] == pytest.approx(value, rel=1e-6)  # of J^(-2/3) I1 - 3, a difference of 1e-4 of its parts
    np.testing.assert_allclose(Motion.load(tmp_path).fields, np.outer([0.0, 0.25, 0.5], FIELD), rtol=0, atol=1e-9)


@pytest.mark.parametrize("formulation", ["total", "updated"])
def test_a_result_s_energy_is_potential_and_the_kinetic_one_apart(formulation: str) -> None:
    model = build(scene(formulation))
    moved, result = integrate(begin(model)), run(scene(formulation))
    potential = energies(model, moved, formulation == "total")
    assert result.energy == pytest.approx(sum(potential.values()), rel=1e-6)
    assert result.kinetic_energy == moved.energies["kinetic"]
    assert result.kinetic_energy > 1e-3 * abs(result.energy), "to add it would be seen"


def test_kinetic_energy_of_particles_is_that_of_the_nodes_they_give_it_to() -> None:
    """For a motion that is affine in space: node a with the share N_a in particle p has the velocity v_p + L d, d from p to a, and
    sum N_a d (x) d = diag(h^2) / 4: a block that only rotates has energy.
    """
    model = build(rod_scene(length=8e-3))
    motion, n, h = UpdatedMotion(model), len(model.density), model.grid.spacing
    L = np.array([[30.0, -200.0, 100.0], [250.0, -10.0, 40.0], [20.0, 70.0, -20.0]])  # 1/s
    x = model.particles.position
    v = 0.2 + x @ L.T
    motion.place(x, v, np.tile(np.eye(3), (n, 1, 1)), np.tile(L, (n, 1, 1)))
    xi = (x - model.grid.origin) / h - model.particles.cell
    N = spline_weights(xi)
    share = np.einsum("na,nb,nc->nabc", N[:, 0], N[:, 1], N[:, 2]).reshape(n, 27)
    at = np.stack(np.meshgrid(*[np.arange(3) - 0.5] * 3, indexing="ij"), -1).reshape(27, 3)  # of the cell
    d = (at[None] - xi[:, None]) * h
    speed2 = ((v[:, None] + d @ L.T) ** 2).sum(axis=2)
    mass = model.density * model.particles.volume
    wanted = 0.5 * float(np.sum(mass[:, None] * share * speed2))
    assert motion.kinetic_energy() == pytest.approx(wanted, rel=1e-12)
    assert wanted > 1.05 * 0.5 * float(mass @ (v**2).sum(axis=1)), "the affine part counts"
