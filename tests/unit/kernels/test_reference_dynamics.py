"""The plain reference of dynamics is itself correct: it agrees with the static reference."""

from __future__ import annotations

import numpy as np
import pytest
from reference.dynamics import Total
from reference.mpm_numpy import Reference
from reference.scenes import rod_scene

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
