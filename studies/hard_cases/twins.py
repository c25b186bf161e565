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

MIRROR = np.diag([1.0, -1.0, 1.0])  # y to -y: the side to which a body buckles if nothing else decides, +z, stays
QUARTER = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y to z, z to -y
Data = dict[str, Any]


def can_turn(scene: Scene) -> bool:
    """True if the quarter turn maps the scene's body and grid onto themselves: a round body, in no field that is put on a table."""
    return scene.body.catheter is not None and not scene.field.magnet and not scene.field.coils


def twin(scene: Scene, R: np.ndarray) -> Scene:
    """The scene as R maps it: MIRROR, or QUARTER of a scene that `can_turn`."""
    data = copy.deepcopy(scene.to_si())
    _body(data["body"], R)
    _field(data["field"], R)
    effects = data["effects"]
    if effects.get("gravity"):
        _vector(effects["gravity"], "acceleration", R)
    if effects.get("ground"):
        _vector(effects["ground"], "point", R)
        _vector(effects["ground"], "normal", R)
    if effects.get("walls"):
        effects["walls"]["tube"]["path"] = [(R @ point).tolist() for point in effects["walls"]["tube"]["path"]]
    return Scene.from_si(data)


def _vector(data: Data, key: str, R: np.ndarray) -> None:
    if data.get(key) is not None:
        data[key] = (R @ data[key]).tolist()


def _axial(data: Data, key: str, R: np.ndarray) -> None:
    if data.get(key) is not None:
        data[key] = (np.linalg.det(R) * R @ data[key]).tolist()


def _body(body: Data, R: np.ndarray) -> None:
    for shape in (body.get("catheter"), body.get("strip")):
        for segment in (shape or {}).get("segments") or ():
            _axial(segment, "magnetization", R)
        if shape and shape.get("magnetization_profile"):
            _mirrored_profile(shape["magnetization_profile"]["harmonic"], R)
    if body.get("strip"):
        _vector(body["strip"], "position", R)
    for part in (body.get("parts") or {}).get("meshes", ()):
        _axial(part, "magnetization", R)
        mesh = unpack_mesh(part["mesh"])
        faces = mesh.faces if np.linalg.det(R) > 0 else mesh.faces[:, ::-1]
        part["mesh"] = pack_mesh(Mesh(mesh.vertices @ R.T, np.ascontiguousarray(faces)))


def _mirrored_profile(harmonic: Data, R: np.ndarray) -> None:
    """(cos a, sin a) in the plane xz becomes -(cos a, sin a); in xy it becomes (-cos a, sin a), an angle that turns the other way."""
    assert np.array_equal(R, MIRROR)  # only strips have profiles, and they do not turn
    if harmonic["plane"] == "xz":
        phase = harmonic["phase"] + math.pi
    else:
        phase = math.pi - harmonic["phase"]
        harmonic["turn"] = {"ccw": "cw", "cw": "ccw"}[harmonic["turn"]]
    harmonic["phase"] = math.remainder(phase, 2 * math.pi)


def _field(field: Data, R: np.ndarray) -> None:
    _axial(field, "uniform", R)
    for dipole in field.get("dipole") or ():
        _vector(dipole, "position", R)
        _axial(dipole, "moment", R)
    for magnet in field.get("magnet") or ():
        magnet["magnetization"] = magnet["magnetization"] or magnet["axis"]
        _vector(magnet, "position", R)
        _vector(magnet, "axis", R)
        _axial(magnet, "magnetization", R)
    for coil in field.get("coils") or ():
        _vector(coil, "position", R)
        _axial(coil, "axis", R)
    over = field.get("over_time") or {}
    if over.get("rotation"):
        _axial(over["rotation"], "axis", R)
        _vector(over["rotation"], "center", R)
    for frame in over.get("keyframes") or ():
        _axial(frame, "uniform", R)
        _vector(frame, "move", R)
