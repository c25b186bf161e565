"""Magnets and coils of finite size: their exact fields through magpylib, and the space that they occupy.

magpylib evaluates closed forms in double precision (Ortner and Coliado Bandeira, SoftwareX 11 (2020) 100466).
The extra `magnets` installs it. A body needs the field in a box: what it can reach, without the space of magnets and wires.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Mask, Plain
from magmpm.errors import require
from magmpm.fields.dipole import POINT
from magmpm.fields.schedule import places, sample_times
from magmpm.fields.sources import Dipole, FieldSource, Magnet

POINTS_PER_CALL = 200_000  # points per call: magpylib's work arrays are some twenty times as large


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

    def nearest(self, points: Array) -> Array:
        """The points of it nearest to points (n, 3) m, in the sources' frame, (n, 3) m."""
        local = (points - self.position) @ self.frame
        if self.ball:
            size = np.linalg.norm(local, axis=1)
            near = local * np.minimum(1.0, self.half[0] / np.maximum(size, 1e-300))[:, None]
        else:
            near = np.clip(local, -self.half, self.half)
            if self.round:
                radius = np.hypot(local[:, 0], local[:, 1])
                near[:, :2] = (
                    local[:, :2]
                    * np.minimum(1.0, self.half[0] / np.maximum(radius, 1e-300))[:, None]
                )
        return self.position + near @ self.frame.T

    def turned(self, frame: Array) -> "Solid":
        """The same solid as a frame (3, 3) sees it whose columns are its axes in the sources' frame."""
        return replace(self, position=frame.T @ self.position, frame=frame.T @ self.frame)

    def box(self) -> tuple[Array, Array]:
        """Its smallest box along the axes of the sources' frame, lower and upper corner (3,) m."""
        if self.ball:
            reach = self.half
        elif self.round:
            reach = self.half[0] * np.hypot(self.frame[:, 0], self.frame[:, 1]) + self.half[
                2
            ] * np.abs(self.frame[:, 2])
        else:
            reach = np.abs(self.frame) @ self.half
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
            found.append(
                Solid(
                    _name("dipole", k, field.dipole),
                    np.array(dipole.position),
                    np.eye(3),
                    half,
                    True,
                    True,
                )
            )
    for k, magnet in enumerate(field.magnet or ()):
        place = np.array(magnet.position)
        frame = frame_of(magnet.axis)
        round_ = magnet.cylinder
        if magnet.cuboid is not None:
            size = magnet.cuboid.size
        else:
            assert round_ is not None  # a magnet is one of the two
            size = (round_.diameter, round_.diameter, round_.length)
        found.append(
            Solid(
                _name("magnet", k, field.magnet),
                place,
                frame,
                np.array(size) / 2,
                round_ is not None,
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
            np.array(
                [coil.diameter / 2, coil.diameter / 2, 1e-3 * coil.diameter]
            ),  # nearer to the wire counts as in it
            True,
        )
        for k, coil in enumerate(field.coils or ())
    ]


def _name(key: str, k: int, many: tuple[Any, ...] | None) -> str:
    return f"field.{key}" if len(many or ()) == 1 else f"field.{key}[{k}]"


def polarization(magnet: Magnet) -> Array:
    """Remanent flux density in space, (3,) T."""
    return magnet.remanence * np.array(
        magnet.axis if magnet.magnetization is None else magnet.magnetization
    )


def exact(field: FieldSource) -> Any:
    """The exact field: points (n, 3) m in the sources' frame -> B (n, 3) T. Raises MissingPackage without magpylib."""
    magpylib = _library()
    from scipy.spatial.transform import Rotation

    sources = []
    for magnet in field.magnet or ():
        frame = frame_of(magnet.axis)
        common: Plain = {
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
        for first in range(0, len(points), POINTS_PER_CALL):
            part = slice(first, first + POINTS_PER_CALL)
            for source in sources:
                out[part] += np.asarray(source.getB(points[part])).reshape(-1, 3)
        return out

    return evaluate


def _library() -> Any:
    require(
        "magpylib",
        "magnets",
        key="field",
        use="field.magnet and field.coils",
        instead="use field.dipole, which needs no package",
    )
    import magpylib

    return magpylib


def dipole_rows(dipoles: Sequence[Dipole]) -> Array:
    """Dipoles as fields.dipole takes them, (k, 7)."""
    return np.array(
        [
            [*one.position, *one.moment, POINT if one.diameter is None else one.diameter / 2]
            for one in dipoles
        ]
    ).reshape(-1, 7)


@dataclass(frozen=True)
class Box:
    """A box, corners (3,) m along its own axes: the columns of `frame` (3, 3) in the sources' frame. cut: sources for which it was cut."""

    lower: Array
    upper: Array
    cut: tuple[str, ...] = ()
    frame: Array = field(default_factory=lambda: np.eye(3))

    def holds(self, points: Array) -> Mask:
        """True for points (n, 3) m of the sources' frame that are in it."""
        local = points @ self.frame
        return np.all((local >= self.lower) & (local <= self.upper), axis=1)

    def meets(self, lower: Array, upper: Array) -> bool:
        """True if another box along the same axes has a point in common with this one."""
        return bool(np.all(lower <= self.upper) and np.all(upper >= self.lower))

    def corners(self) -> Array:
        """The corners (8, 3) along its axes."""
        ends = np.array([self.lower, self.upper])
        return np.array([ends[list(which), range(3)] for which in np.ndindex(2, 2, 2)])

    def turned(self, frame: Array) -> "Box":
        """The smallest box around this one along other axes, the columns of `frame` (3, 3)."""
        local = self.corners() @ self.frame.T @ frame
        return Box(local.min(axis=0), local.max(axis=0), self.cut, frame)

    @property
    def volume(self) -> float:
        return float(np.prod(self.upper - self.lower))

    def text(self) -> str:
        """Text for messages: "-40 to 44, -44 to 44, -44 to 44 mm"."""
        ends = (
            ", ".join(f"{1e3 * a:.3g} to {1e3 * b:.3g}" for a, b in zip(self.lower, self.upper))
            + " mm"
        )
        if np.array_equal(self.frame, np.eye(3)):
            return ends
        along = " and ".join(
            "(" + ", ".join(f"{part:.3g}" for part in axis) + ")" for axis in self.frame.T[1:]
        )
        return f"{ends} along axes of its own, whose second and third are {along}"


def parting(box: Box, solid: Solid) -> Array | None:
    """Unit vector (3,) along the shortest way from a box to a solid, to which a plane between the two is perpendicular.

    None where they meet. Box and solid are in the same frame, along whose axes the box lies. By projections onto either in turn, which
    converge for convex bodies; that a plane parts the two is then checked exactly.
    """
    # Most steps toward the shortest way between a box and a solid; two flat faces need two, a rim and an edge some fifty.
    projections = 500
    point = solid.position
    for _ in range(projections):
        inside = np.clip(point, box.lower, box.upper)
        before = point
        point = solid.nearest(inside[None])[0]
        if np.linalg.norm(point - before) <= 1e-12 * np.linalg.norm(solid.half):
            break
    way = point - np.clip(point, box.lower, box.upper)
    size = float(np.linalg.norm(way))
    if not size > 0.0:
        return None
    frame = frame_of((way / size).tolist())
    own = Box(box.lower, box.upper).turned(frame)
    return way / size if solid.turned(frame).box()[0][2] > own.upper[2] else None


def reach(body: Box, anchored: bool) -> Box:
    """Box of all places that a body can reach. A body that is held reaches as far as its diagonal from the middle of its lower x face.

    A free body may go anywhere: its box grows by one diagonal on each side, and users may set a larger one.
    """
    diagonal = float(np.linalg.norm(body.upper - body.lower))
    if anchored:
        base = (body.lower + body.upper) / 2
        base[0] = body.lower[0]
        return Box(base - 1.05 * diagonal, base + 1.05 * diagonal)
    return Box(body.lower - diagonal, body.upper + diagonal)


def seen_from_sources(field: FieldSource, box: Box) -> Box:
    """The box around a box of space in the frame of the sources, over all of the schedule."""
    corners = box.corners()
    lower = np.full(3, np.inf)
    upper = np.full(3, -np.inf)
    for place in places(field, sample_times(field)):
        local = (corners - place["origin"]) @ place["frame"].reshape(3, 3)
        lower = np.minimum(lower, local.min(axis=0))
        upper = np.maximum(upper, local.max(axis=0))
    return Box(lower, upper)


def reach_along(frame: Array, field: FieldSource, body: Box, anchored: bool) -> Box:
    """The box along axes, the columns of `frame` (3, 3), that a body can reach as the sources see it, over all of the schedule.

    body: its undeformed box in space, m. What a held body reaches is a ball, as wide along any axes.
    """
    around = reach(body, anchored)
    if not anchored:
        return seen_from_sources(field, around).turned(frame)
    center = (around.lower + around.upper) / 2
    radius = (around.upper - around.lower) / 2
    where = [
        (center - place["origin"]) @ place["frame"].reshape(3, 3) @ frame
        for place in places(field, sample_times(field))
    ]
    return Box(np.min(where, axis=0) - radius, np.max(where, axis=0) + radius, (), frame)


def cut_for(
    box: Box, body: Box, obstacles: list[Solid], *, keeps_off: float | None = None
) -> Box | None:
    """The box, cut by planes along its axes so that it contains the body but no obstacle; None where no such plane separates the two.

    body, obstacles: as the axes of the box see them. keeps_off: it is cut for obstacles just outside of it as well, of which it then
    keeps as far off, and at least so many m off where a plane can be. Nothing cut: the box itself.
    """
    # of the gap between the undeformed body and a magnet: distance from the magnet at which the box
    # ends
    kept_off = 0.25
    for solid in obstacles:
        low, high = solid.box()
        if keeps_off is None and (not box.meets(low, high) or parting(box, solid) is not None):
            continue
        found: list[tuple[float, Box]] = []
        for k in range(3):
            for sign in (1, -1):
                gap = (low[k] - body.upper[k]) if sign > 0 else (body.lower[k] - high[k])
                if gap <= 0:
                    continue
                lower = box.lower.copy()
                upper = box.upper.copy()
                if sign > 0:
                    upper[k] = min(upper[k], low[k] - kept_off * gap)
                else:
                    lower[k] = max(lower[k], high[k] + kept_off * gap)
                found.append((kept_off * gap, replace(box, lower=lower, upper=upper)))
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
