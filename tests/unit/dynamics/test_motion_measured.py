"""The measures of a motion at a moment other than the first: stress, field, energies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.dynamics import elastic_stress
from reference.in_motion import moving
from reference.scenes import rod_scene

from magmpm.dynamics.time_loop import SimulationState, begin, integrate
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run

FIELD, RISE = np.array([0.0, 5e-3, 20e-3]), 2e-3  # T, s: twice as long as the motion


def scene() -> Scene:
    """A short clamped catheter in a field that rises throughout the motion."""
    data = moving(rod_scene(length=8e-3, field=FIELD), duration=1e-3, output_every=5e-4).to_si()
    return Scene.from_si({**data, "field": {"uniform": FIELD.tolist(), "over_time": {"ramp": {"duration": RISE}}}})


def energies(model: Model, moved: SimulationState) -> dict[str, float]:
    """Elastic and magnetic energy, J, from the formulas: sum V (G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2), with (J - 1)^2 projected by F-bar,
    and -sum V B . F Br / mu0."""
    F, V = moved.F, model.particles.volume
    J, I1 = np.linalg.det(F), np.einsum("nij,nij->n", F, F)
    first = model.particles.cell_first
    moments = np.add.reduceat(model.modes * (V * (J - 1))[:, None], first[:-1], axis=0)
    volume = float(np.sum(model.bulk[first[:-1]] * (moments**2).sum(axis=1))) / 2
    shape = float(V @ (model.shear * (J ** (-2 / 3) * I1 - 3))) / 2
    B = FIELD * moved.time / RISE
    magnetic = -float(V @ np.einsum("i,nij,nj->n", B, F, model.remanence)) / MU0
    return {"elastic": shape + volume, "magnetic_torque": magnetic}


def test_stress_field_and_energies_are_those_of_the_moment(tmp_path: Path) -> None:
    """The stress of a frame includes the elastic law and the field at that moment, not that of the start, which is zero."""
    model = build(scene())
    moved = integrate(begin(model), folder=tmp_path)
    assert moved.time == 1e-3
    B = FIELD * moved.time / RISE
    magnetic = -np.einsum("i,nj->nij", B, model.remanence) / MU0
    elastic = elastic_stress(model, moved.F)
    np.testing.assert_allclose(moved.P, elastic + magnetic, rtol=0, atol=1e-10 * np.abs(elastic).max())  # sums of about ten products
    assert np.abs(magnetic).max() > 0.05 * np.abs(elastic).max(), "to leave it out would be seen"
    wanted = energies(model, moved)
    for name, value in wanted.items():
        assert moved.energies[name] == pytest.approx(value, rel=1e-6)  # of J^(-2/3) I1 - 3, a difference of 1e-4 of its parts
    np.testing.assert_allclose(Motion.load(tmp_path).fields, np.outer([0.0, 0.25, 0.5], FIELD), rtol=0, atol=1e-9)


def test_a_result_s_energy_is_potential_and_the_kinetic_one_apart() -> None:
    model = build(scene())
    moved, result = integrate(begin(model)), run(scene())
    potential = energies(model, moved)
    assert result.energy == pytest.approx(sum(potential.values()), rel=1e-6)
    assert result.kinetic_energy == moved.energies["kinetic"]
    assert result.kinetic_energy > 1e-3 * abs(result.energy), "to add it would be seen"
