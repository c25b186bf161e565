"""Time along its path when the outside field bends a body the most: a pulse between equal parts of the path must not be missed."""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import RodModel, rod_model
from magmpm.scene import Scene

ELEMENTS = 20  # of the rod that tells the load: its torques are sums over segments
ALIKE = 1.0 - 1e-9


def strongest(scene: Scene) -> float:
    """The time (s), of those of a path of equilibria, at which the field would bend the straight body the farthest if its shape followed
    the load in proportion; the first of those that are alike. Only torques count: where the field pulls most, it mostly turns most.

    Raises SolveError for a body that is no rod, SceneError for a field that can't be had.
    """
    rod, line = rod_model(scene.with_effects(magnetic_torque={}), ELEMENTS), scene.body.shape.line
    assert line is not None  # rod_model refuses other bodies
    field, times = scene.outside_field(), scene.path_times()
    x = np.array(line.base) + np.cumsum(rod.length)[:, None] * [1.0, 0.0, 0.0]
    bends = np.array([_deflection(rod, np.cross(rod.moment, field.at(x, time))) for time in times])
    return times[int(np.argmax(bends >= ALIKE * bends.max()))]


def _deflection(rod: RodModel, torque: Array) -> float:
    """Largest deflection (m) of a straight rod along x under torques (n, 3) N, per length, to first order."""
    beyond = np.cumsum((torque * rod.length[:, None])[::-1], axis=0)[::-1, 1:]  # about y and z, in each section
    turn = np.cumsum(beyond / rod.twist_bend[:, 1:] * rod.length[:, None], axis=0)
    return float(np.linalg.norm(np.cumsum(turn * rod.length[:, None], axis=0), axis=1).max())
