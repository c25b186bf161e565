"""Magnets and coils of finite size: their exact fields through magpylib, and the space that they occupy.

magpylib evaluates closed forms in double precision (Ortner and Coliado Bandeira, SoftwareX 11 (2020) 100466).
The extra `magnets` installs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SceneError
from magmpm.fields.sources import Dipole, FieldSource, Magnet

CHUNK = 200_000  # points per call: magpylib's work arrays are some twenty times as large
SLACK = 1e-3  # of a coil's diameter: nearer to its wire counts as in it


@dataclass(frozen=True)
class Solid:
    """A solid that a body can't enter. name: in messages; frame (3, 3): columns its axes; half (3,) m: of its box."""

    name: str
    position: Array
    frame: Array
    half: Array
    round: bool  # a cylinder or sphere about its third axis, not a block
    ball: bool = False

    def depth(self, points: Array) -> Array:
        """Depth of points (n, 3) m inside (> 0), or about how far outside (< 0), in the sources' frame, (n,) m."""
        local = (points - self.position) @ self.frame
        if self.ball:
            return np.asarray(self.half[0] - np.linalg.norm(local, axis=1))
        if self.round:
            radial = self.half[0] - np.hypot(local[:, 0], local[:, 1])
            return np.minimum(radial, self.half[2] - np.abs(local[:, 2]))
        return np.asarray((self.half - np.abs(local)).min(axis=1))

    def box(self) -> tuple[Array, Array]:
        """Its box along the axes of the sources' frame, lower and upper corner (3,) m."""
        reach = np.abs(self.frame) @ self.half if not self.ball else self.half
        return self.position - reach, self.position + reach


def frame_of(axis: Sequence[float]) -> Array:
    """The least rotation that carries z onto a unit vector, (3, 3); half a turn about x for -z."""
    x, y, z = axis
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([-y, x, 0.0])  # z cross axis
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + K + K @ K / (1 + z)


def taken(field: FieldSource) -> list[Solid]:
    """The solids among the sources of a field. Coils are thin and are left out; their wire has no cross-section."""
    found = []
    for k, dipole in enumerate(field.dipole or ()):
        if dipole.diameter is not None:
            half = np.full(3, dipole.diameter / 2)
            found.append(Solid(_name("dipole", k, field.dipole), np.array(dipole.position), np.eye(3), half, True, True))
    for k, magnet in enumerate(field.magnet or ()):
        found.append(
            Solid(
                _name("magnet", k, field.magnet),
                np.array(magnet.position),
                frame_of(magnet.axis),
                _half(magnet),
                magnet.cylinder is not None,
            )
        )
    return found


def bare_dipoles(field: FieldSource) -> list[tuple[str, Array]]:
    """Point dipoles, by name, with their position (3,) m in the sources' frame."""
    return [
        (_name("dipole", k, field.dipole), np.array(dipole.position))
        for k, dipole in enumerate(field.dipole or ())
        if dipole.diameter is None
    ]


def wires(field: FieldSource) -> list[Solid]:
    """Coils as flat boxes: a table must not contain their wire, where the field has no bound."""
    return [
        Solid(
            _name("coils", k, field.coils),
            np.array(coil.position),
            frame_of(coil.axis),
            np.array([coil.diameter / 2, coil.diameter / 2, SLACK * coil.diameter]),
            True,
        )
        for k, coil in enumerate(field.coils or ())
    ]


def _name(key: str, k: int, many: tuple[Any, ...] | None) -> str:
    return f"field.{key}" if len(many or ()) == 1 else f"field.{key}[{k}]"


def _half(magnet: Magnet) -> Array:
    if magnet.cuboid is not None:
        return np.array(magnet.cuboid.size) / 2
    assert magnet.cylinder is not None
    return np.array([magnet.cylinder.diameter, magnet.cylinder.diameter, magnet.cylinder.length]) / 2


def polarization(magnet: Magnet) -> Array:
    """Remanent flux density in space, (3,) T."""
    return magnet.remanence * np.array(magnet.axis if magnet.magnetization is None else magnet.magnetization)


def exact(field: FieldSource) -> Any:
    """The field of all magnets and coils as a function: points (n, 3) m in the sources' frame -> B (n, 3) T.

    Raises SceneError where magpylib is not installed.
    """
    magpylib = _library()
    from scipy.spatial.transform import Rotation

    sources = []
    for magnet in field.magnet or ():
        frame = frame_of(magnet.axis)
        common: dict[str, Any] = {
            "polarization": frame.T @ polarization(magnet),
            "position": magnet.position,
            "orientation": Rotation.from_matrix(frame),
        }
        if magnet.cuboid is not None:
            sources.append(magpylib.magnet.Cuboid(dimension=magnet.cuboid.size, **common))
        elif magnet.cylinder is not None:
            size = (magnet.cylinder.diameter, magnet.cylinder.length)
            sources.append(magpylib.magnet.Cylinder(dimension=size, **common))
    for coil in field.coils or ():
        sources.append(
            magpylib.current.Circle(
                current=coil.current * coil.turns,
                diameter=coil.diameter,
                position=coil.position,
                orientation=Rotation.from_matrix(frame_of(coil.axis)),
            )
        )

    def evaluate(points: Array) -> Array:
        out = np.zeros((len(points), 3))
        for first in range(0, len(points), CHUNK):
            part = slice(first, first + CHUNK)
            for source in sources:
                out[part] += np.asarray(source.getB(points[part])).reshape(-1, 3)
        return out

    return evaluate


def _library() -> Any:
    try:
        import magpylib
    except ImportError:
        raise SceneError(
            "field",
            found="magnets and coils of finite size need the library magpylib, which is not installed",
            rule="field.magnet and field.coils are computed by magpylib",
            remedy="pip install 'magmpm[magnets]' (or pip install magpylib), or use "
            "field.dipole, which needs nothing",
        ) from None
    return magpylib


def dipole_rows(dipoles: Sequence[Dipole]) -> Array:
    """Dipoles as fields.dipole takes them, (k, 7)."""
    from magmpm.fields.dipole import POINT

    return np.array([[*one.position, *one.moment, POINT if one.diameter is None else one.diameter / 2] for one in dipoles]).reshape(-1, 7)


