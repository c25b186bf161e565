"""The plain reference of dynamics is itself correct: it agrees with the static reference and conserves what motion must conserve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.dynamics import Total, Updated
from reference.mpm_numpy import Reference
from reference.scenes import rod_scene

from magmpm.bodies.grid import spline_weights
from magmpm.model import build
from magmpm.statics.layout import StaticModel, static_model


@pytest.fixture(scope="module")
def model() -> StaticModel:
    return static_model(build(rod_scene(length=6e-3)))


def test_total_force_is_the_energys_slope(model: StaticModel, rng: np.random.Generator) -> None:
    """At rest and without effects: minus the residual of the static reference, whose splines are SciPy's."""
    total, statics = Total.of(model), Reference.of(model)
    c = np.zeros((len(total.X), 3))
    free = np.flatnonzero(total.mass > 0)
    c[free] = 2e-5 * rng.standard_normal((len(free), 3))
    planes = c.reshape(*model.grid.nodes, 3)[1:]  # node 0 along x belongs to the clamp
    y, z = model.layout.node_yz.T
    ours = total.force(c, 0 * c, 1e-6).reshape(*model.grid.nodes, 3)[1:][:, y, z]
    theirs = -statics.residual(planes[:, y, z].reshape(model.layout.planes, -1)).reshape(ours.shape)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())
    assert np.abs(theirs).max() > 1e-3


def test_updated_carries_affine_motion(model: StaticModel) -> None:
    """A body far from its clamp with an affine velocity field keeps it, and F follows: one step with negligible forces."""
    state = Updated.of(replace(model, shear=0 * model.shear, bulk=0 * model.bulk))
    state.x += np.array([4 * model.grid.spacing[0], 0.0, 0.0])
    L = np.array([[0.3, -2.0, 1.0], [2.5, -0.1, 0.4], [0.2, 0.7, -0.2]])  # 1/s
    before = state.x.copy()
    state.v, state.C = before @ L.T + 0.2, np.tile(L, (len(before), 1, 1))
    v = state.v.copy()
    state.step(1e-4)
    np.testing.assert_allclose(state.v, v, rtol=0, atol=1e-13 * np.abs(v).max())
    np.testing.assert_allclose(state.C, np.tile(L, (len(v), 1, 1)), rtol=0, atol=1e-11 * np.abs(L).max())
    np.testing.assert_allclose(state.x, before + 1e-4 * v, rtol=1e-14)
    np.testing.assert_allclose(state.F, np.tile(np.eye(3) + 1e-4 * L, (len(v), 1, 1)), rtol=0, atol=1e-14)


def test_updated_keeps_momentum(model: StaticModel, rng: np.random.Generator) -> None:
    """Away from the clamp, internal forces conserve momentum and, for a symmetric stress, angular momentum."""
    state = Updated.of(model)
    state.x += np.array([4 * model.grid.spacing[0], 0.0, 0.0])
    state.v = rng.standard_normal(state.v.shape)
    state.F = state.F + 0.05 * rng.standard_normal(state.F.shape)
    mass, h = model.density * model.particles.volume, model.grid.spacing

    def moments() -> tuple[np.ndarray, np.ndarray]:
        inner = np.einsum("nij,j->nij", state.C, h**2 / 4)  # sum N_a v_a (x) d
        spin = np.stack([inner[:, 2, 1] - inner[:, 1, 2], inner[:, 0, 2] - inner[:, 2, 0], inner[:, 1, 0] - inner[:, 0, 1]], -1)
        return mass @ state.v, mass @ (np.cross(state.x, state.v) + spin)

    p0, l0 = moments()
    state.step(1e-6)
    p1, l1 = moments()
    assert np.linalg.norm(p1 - p0) <= 1e-12 * mass.sum()
    assert np.linalg.norm(l1 - l0) <= 1e-10 * np.linalg.norm(l0)


def test_the_clamp_is_a_mirror(model: StaticModel) -> None:
    """In a uniform motion the nodes next to the face move by r and -r, and the face does not move: v = V (N_2 + r (N_1 - N_0)), where
    r = (m_1 - m_0) / (m_1 + m_0) from the momentum that node 0 gives to its mirror: for a uniform body, of node masses 5/6 and 1/6
    of a cell, 2/3.
    """
    state = Updated.of(model)
    V = np.array([1.0, 2.0, -3.0])
    state.v[:] = V
    first = model.particles.cell[:, 0] == 0
    N = spline_weights(model.particles.position[first, 0] / model.grid.spacing[0])
    state.step(1e-12)  # too short for the stress that follows
    expected = (N[:, 2] + 2 / 3 * (N[:, 1] - N[:, 0]))[:, None] * V
    np.testing.assert_allclose(
        state.v[first], expected, rtol=0, atol=1e-2
    )  # N at two points a cell: masses to 1 %
    beyond = model.particles.cell[:, 0] > 1
    np.testing.assert_allclose(state.v[beyond], np.tile(V, (beyond.sum(), 1)), rtol=1e-9)
