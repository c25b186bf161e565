"""Steps along arcs: to first order the straight step, and exact where a body turns as a whole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmpm.model import build
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.newton import along_arc, minimize, rest_nodes
from magmpm.statics.rod_start import from_rod

SILICONE = {"shear_modulus": 120e3, "bulk_to_shear": 20.0, "density": 1882.0, "remanence": 0.138}


def scene(**changes: object) -> Scene:
    content = {
        "name": "arc",
        "materials": {"silicone": SILICONE},
        "body": {"catheter": {"length": 0.03, "diameter": 3e-3, "material": "silicone", "segments": [{"magnetization": [1, 0, 0]}]}},
        "resolution": {"cells_across": 2},
    }
    return Scene.from_si({**content, **changes})


@pytest.fixture(scope="module")
def model() -> StaticModel:
    return static_model(build(scene()))


def turning(model: StaticModel, axis: np.ndarray) -> np.ndarray:
    """The direction (planes, m) in which the whole body turns about the origin."""
    return np.cross(axis, rest_nodes(model)).reshape(model.layout.planes, -1)


def test_a_body_that_turns_as_a_whole_is_not_strained(model: StaticModel) -> None:
    axis = np.array([0.3, -1.1, 0.7])
    reached = along_arc(model, np.zeros((model.layout.planes, model.layout.m)), turning(model, axis), 1.0)
    turned = rest_nodes(model) @ Rotation.from_rotvec(axis).as_matrix().T
    # The center of the first plane goes straight; seen from it the body is turned exactly, to rounding.
    found = rest_nodes(model) + reached.reshape(turned.shape)
    assert np.abs((found - found[0].mean(axis=0)) - (turned - turned[0].mean(axis=0))).max() < 1e-14


def test_to_first_order_it_is_the_straight_step(model: StaticModel) -> None:
    rng = np.random.default_rng(1)
    shape = (model.layout.planes, model.layout.m)
    grid, direction = 1e-4 * rng.normal(size=shape), 1e-3 * rng.normal(size=shape) + turning(model, np.array([1.0, 2.0, -1.0]))

    def off(fraction: float) -> float:
        return float(np.abs(along_arc(model, grid, direction, fraction) - grid - fraction * direction).max())

    assert np.log2(off(2e-3) / off(1e-3)) == pytest.approx(2.0, abs=0.02)


def test_bending_along_an_arc_keeps_the_length(model: StaticModel) -> None:
    """Every plane turned by its own angle about y, a straight step of half a turn at the tip."""
    X = rest_nodes(model)
    angle = X[..., 0] / X[..., 0].max() * np.pi / 2
    d = np.zeros_like(X)
    d[..., 0] = angle * X[..., 2]
    gap = np.diff(X[:, 0, 0], prepend=0.0)
    d[..., 2] = -np.cumsum(gap * angle.mean(axis=1))[:, None]
    direction = d.reshape(model.layout.planes, -1)
    arc = along_arc(model, np.zeros_like(direction), direction, 1.0).reshape(X.shape)
    centers = (X + arc).mean(axis=1)
    assert np.linalg.norm(np.diff(centers, axis=0), axis=1) == pytest.approx(np.diff(X[:, 0, 0]), rel=1e-3)
    straight = (X + d).mean(axis=1)
    assert np.linalg.norm(np.diff(straight, axis=0), axis=1).max() > 1.3 * np.diff(X[:, 0, 0]).max()


def test_a_soft_curved_valley_takes_few_steps() -> None:
    """A slender catheter about to turn round, from a search for insertions: straight steps with the usual shift found no end in 300."""
    directions = [
        [-0.0697, -0.4462, -0.8922], [0.711, 0.4182, -0.5654], [0.7258, -0.2357, -0.6462],
        [0.9261, 0.0052, -0.3772], [0.9139, 0.0393, 0.404], [-0.4517, 0.0057, 0.8921],
    ]  # fmt: skip
    segments = [{"magnetization": d} for d in directions]
    found = scene(
        body={"catheter": {"length": 0.056, "diameter": 3e-3, "material": "silicone", "segments": segments}},
        field={"uniform": [2.131697e-3, -1.814e-6, 9.669181e-3]},
        effects={"magnetic_torque": {}, "gravity": {}},
    )
    made = static_model(build(found))
    steps = minimize(Energy(made), from_rod(made, solve_rod(found)), tolerance=1e-11, max_steps=300).steps
    assert steps <= 40  # 23 when this was written
