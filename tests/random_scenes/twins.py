"""Twins of a scene: the same body seen in a mirror, or turned about its axis. Their answers must be mirrored or turned as well.

Positions, weight and velocities are vectors: v -> R v. Flux density, magnetization, magnetic moment, a coil's axis and the axis of a
rotation are axial vectors, which come of a cross product: a -> det(R) R a. Source: Jackson, Classical Electrodynamics, 3rd ed., section
6.10. A solver that treats an axis, a sign or an index wrongly gives twins that differ.
"""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from magmpm.bodies.surface_mesh import Mesh, pack_mesh, unpack_mesh
from magmpm.scene import Scene

MIRROR = np.diag(
    [1.0, -1.0, 1.0]
)  # y to -y: the side to which a body buckles if nothing else decides, +z, stays
QUARTER = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y to z, z to -y
VECTORS = ("position", "axis", "acceleration", "point", "normal", "center", "move")
# the axes of these are axial, too
AXIAL = ("magnetization", "uniform", "moment")
TURNING = ("coils", "rotation")


def can_turn(scene: Scene) -> bool:
    """True if the quarter turn maps the scene's body and grid onto themselves: a round body, in no field that is put on a table."""
    return scene.body.catheter is not None and not scene.field.magnet and not scene.field.coils


def twin(scene: Scene, R: np.ndarray) -> Scene:
    """The scene as R maps it: MIRROR, or QUARTER of a scene that `can_turn`."""
    data = copy.deepcopy(scene.to_si())
    for magnet in data["field"].get("magnet") or ():
        magnet["magnetization"] = magnet["magnetization"] or magnet["axis"]
    for part in ("body", "field", "effects"):
        _map(data[part], R)
    return Scene.from_si(data)


def _map(data: Any, R: np.ndarray, whose: str = "") -> None:
    """Map all that has a direction in a scene's data, which stand under the key `whose`."""
    for each in data if isinstance(data, list) else ():
        _map(each, R, whose)
    for key, value in data.items() if isinstance(data, dict) else ():
        if key == "harmonic":
            _mirror_profile(value, R)
        elif key == "mesh":
            mesh = unpack_mesh(value)
            faces = mesh.faces if np.linalg.det(R) > 0 else mesh.faces[:, ::-1]
            data[key] = pack_mesh(Mesh(mesh.vertices @ R.T, np.ascontiguousarray(faces)))
        elif key == "path":
            data[key] = [(R @ point).tolist() for point in value]
        elif isinstance(value, list) and (key in AXIAL or (key == "axis" and whose in TURNING)):
            data[key] = (np.linalg.det(R) * R @ value).tolist()
        elif isinstance(value, list) and key in VECTORS:
            data[key] = (R @ value).tolist()
        else:
            _map(value, R, key)


def _mirror_profile(harmonic: dict[str, Any], R: np.ndarray) -> None:
    """(cos a, sin a) in the plane xz becomes -(cos a, sin a); in xy it becomes (-cos a, sin a), an angle that turns the other way."""
    assert np.array_equal(R, MIRROR)  # only strips have profiles, and they do not turn
    if harmonic["plane"] == "xz":
        phase = harmonic["phase"] + math.pi
    else:
        phase = math.pi - harmonic["phase"]
        harmonic["turn"] = {"ccw": "cw", "cw": "ccw"}[harmonic["turn"]]
    harmonic["phase"] = math.remainder(phase, 2 * math.pi)
