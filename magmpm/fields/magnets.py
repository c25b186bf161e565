"""Magnets and coils of finite size: their exact fields through magpylib, and the space that they occupy.

magpylib evaluates closed forms in double precision (Ortner and Coliado Bandeira, SoftwareX 11 (2020) 100466).
The extra `magnets` installs it. A body needs the field in a box: what it can reach, without the space of magnets and wires.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.errors import SceneError
from magmpm.fields.dipole import POINT
from magmpm.fields.schedule import places, sample_times
from magmpm.fields.sources import Dipole, FieldSource, Magnet

CHUNK = 200_000  # points per call: magpylib's work arrays are some twenty times as large


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
        place, frame, round_ = np.array(magnet.position), frame_of(magnet.axis), magnet.cylinder
        size = magnet.cuboid.size if magnet.cuboid is not None else (round_.diameter, round_.diameter, round_.length)  # type: ignore[union-attr]
        found.append(Solid(_name("magnet", k, field.magnet), place, frame, np.array(size) / 2, round_ is not None))
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
            np.array([coil.diameter / 2, coil.diameter / 2, 1e-3 * coil.diameter]),  # nearer to the wire counts as in it
            True,
        )
        for k, coil in enumerate(field.coils or ())
    ]


def _name(key: str, k: int, many: tuple[Any, ...] | None) -> str:
    return f"field.{key}" if len(many or ()) == 1 else f"field.{key}[{k}]"


def polarization(magnet: Magnet) -> Array:
    """Remanent flux density in space, (3,) T."""
    return magnet.remanence * np.array(magnet.axis if magnet.magnetization is None else magnet.magnetization)


def exact(field: FieldSource) -> Any:
    """The exact field: points (n, 3) m in the sources' frame -> B (n, 3) T. Raises SceneError where magpylib is not installed."""
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
    return np.array([[*one.position, *one.moment, POINT if one.diameter is None else one.diameter / 2] for one in dipoles]).reshape(-1, 7)


KEPT_OFF = 0.25  # of the gap between the undeformed body and a magnet: distance from the magnet at which the box ends


@dataclass(frozen=True)
class Box:
    """A box in the sources' frame, corners (3,) m. cut: names of the sources for which it was cut."""

    lower: Array
    upper: Array
    cut: tuple[str, ...] = ()

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """True for points (n, 3) that are in it."""
        return np.all((points >= self.lower) & (points <= self.upper), axis=1)

    def meets(self, lower: Array, upper: Array) -> bool:
        """True if another box has a point in common with this one."""
        return bool(np.all(lower <= self.upper) and np.all(upper >= self.lower))

    @property
    def volume(self) -> float:
        return float(np.prod(self.upper - self.lower))

    def text(self) -> str:
        """Text for messages: "-40 to 44, -44 to 44, -44 to 44 mm"."""
        return ", ".join(f"{1e3 * a:.3g} to {1e3 * b:.3g}" for a, b in zip(self.lower, self.upper)) + " mm"


def reach(body: Box, anchored: bool) -> Box:
    """Box that a body can reach from its undeformed box: a held body, its diagonal from the middle of its lower x face.

    A free body may go anywhere; its box gets one diagonal on each side, and users may set a larger one.
    """
    diagonal = float(np.linalg.norm(body.upper - body.lower))
    if anchored:
        base = (body.lower + body.upper) / 2
        base[0] = body.lower[0]
        return Box(base - 1.05 * diagonal, base + 1.05 * diagonal)
    return Box(body.lower - diagonal, body.upper + diagonal)


def seen_from_sources(field: FieldSource, box: Box) -> Box:
    """The box around a box of space in the frame of the sources, over all of the schedule."""
    corners = np.array([[(box.lower, box.upper)[b][i] for i, b in enumerate(c)] for c in np.ndindex(2, 2, 2)])
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for place in places(field, sample_times(field)):
        local = (corners - place["origin"]) @ place["frame"].reshape(3, 3)
        lower, upper = np.minimum(lower, local.min(axis=0)), np.maximum(upper, local.max(axis=0))
    return Box(lower, upper)


def cut_for(box: Box, body: Box, obstacles: list[Solid], *, keeps_off: float | None = None) -> Box | None:
    """The box, cut by planes so that it contains the body but no obstacle; None where no plane separates the two.

    keeps_off: it is cut for obstacles just outside of it as well, of which it then keeps as far off, and at least so many m off where a
    plane can be. Nothing cut: the box itself.
    """
    for solid in obstacles:
        low, high = solid.box()
        if keeps_off is None and not box.meets(low, high):
            continue
        found: list[tuple[float, Box]] = []
        for k in range(3):
            for sign in (1, -1):
                gap = (low[k] - body.upper[k]) if sign > 0 else (body.lower[k] - high[k])
                if gap <= 0:
                    continue
                lower, upper = box.lower.copy(), box.upper.copy()
                if sign > 0:
                    upper[k] = min(upper[k], low[k] - KEPT_OFF * gap)
                else:
                    lower[k] = max(lower[k], high[k] + KEPT_OFF * gap)
                found.append((KEPT_OFF * gap, Box(lower, upper, box.cut)))
        if not found:
            return None
        least = min(keeps_off or 0.0, max(kept for kept, _ in found))
        largest = max((one for kept, one in found if kept >= least), key=lambda one: one.volume)
        if largest.volume == box.volume:
            continue  # it keeps off already
        box = largest
        if solid.name not in box.cut:
            box = replace(box, cut=(*box.cut, solid.name))
    return box
