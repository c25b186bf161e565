"""What stands around a body: walls, guides, magnets and coils as coloured solids, and the ground as a plane. Read from a scene's JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from viz import style
from viz.shapes import Surface, bar, lofted, refined, tube

AROUND = 48
POLES = "(N, S)"  # ends the names of what is red in the north and blue in the south


# How far from the body, in its lengths, a source may be to be in the picture.
REACH = 2.5
END = 1e12  # s: when every schedule that ends has ended


@dataclass(frozen=True)
class Prop:
    """A solid: points (n, 3) m, triangles (m, 3) counter-clockwise from outside.

    name: what the legend calls it; empty if it says nothing of it. hollow: only its far side is drawn, so that what
    is inside is seen. framed: it must be in the picture.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    colour: str
    hollow: bool = False
    framed: bool = True


@dataclass(frozen=True)
class Plane:
    """The ground: a point (3,) m and the unit normal (3,) into the free side."""

    point: np.ndarray
    normal: np.ndarray

    def dropped(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) m projected onto the plane."""
        return points - ((points - self.point) @ self.normal)[:, None] * self.normal

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m above the plane."""
        return np.asarray((points - self.point) @ self.normal)


def ground(scene: Mapping[str, Any]) -> Plane | None:
    """The plane the body may rest on, or None."""
    settings = (scene.get("effects") or {}).get("ground")
    if settings is None:
        return None
    normal = np.asarray(settings.get("normal") or (0.0, 0.0, 1.0), dtype=float)
    point = np.asarray(settings.get("point") or (0.0, 0.0, 0.0), dtype=float)
    return Plane(point, normal / np.linalg.norm(normal))


def standing(scene: Mapping[str, Any], length: float) -> list[Prop]:
    """What does not move: walls and guides. length: m, of the body."""
    effects = scene.get("effects") or {}
    props = [*_clamps(scene), *_walls(effects.get("walls") or {})]
    feed = effects.get("feed")
    if feed is not None:
        props.append(_guide(-0.05 * length, float(feed.get("exit") or 0.0), 0.75 * _diameter(scene, length)))
    return props


def sources(scene: Mapping[str, Any], time: float) -> list[Prop]:
    """The field's magnets, dipoles and coils where they are at a time (s): north red, south blue."""
    field = scene.get("field") or {}
    turn, centre, move = _pose(field.get("over_time") or {}, time)
    props: list[Prop] = []
    for magnet in _many(field.get("magnet")):
        props += _magnet(magnet)
    for dipole in _many(field.get("dipole")):
        props += _dipole(dipole)
    for coil in _many(field.get("coils")):
        props.append(_coil(coil))
    return [
        Prop(p.name, (p.points + move - centre) @ turn.T + centre, p.triangles, p.colour, p.hollow, p.framed)
        for p in props
    ]


def sources_at_rest(scene: Mapping[str, Any], points: np.ndarray, length: float) -> list[Prop]:
    """The sources at the end of their schedule, where an equilibrium meets them; those farther than REACH lengths (m) from the body's
    points (n, 3) m are not framed."""
    return in_reach(sources(scene, END), points, REACH * length)


def in_reach(props: list[Prop], points: np.ndarray, reach: float) -> list[Prop]:
    """Props, with those farther than reach (m) from the points (n, 3) m not framed: a far magnet would make the body a speck."""
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    return [
        p
        if not p.framed or ((p.points > low) & (p.points < high)).all(axis=1).any()
        else Prop(p.name, p.points, p.triangles, p.colour, p.hollow, framed=False)
        for p in props
    ]


def _many(value: Any) -> list[Mapping[str, Any]]:
    return [] if value is None else [value] if isinstance(value, Mapping) else list(value)


def _diameter(scene: Mapping[str, Any], length: float) -> float:
    body: Mapping[str, Any] = next(
        (shape for shape in scene.get("body", {}).values() if shape is not None), {}
    )
    return float(body.get("diameter") or body.get("thickness") or 0.1 * length)


def _pose(over_time: Mapping[str, Any], time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation (3, 3) about a centre (3,) m, and the shift before it (3,) m, of the field's sources (fields.outside_field has the rule)."""
    turn, centre, move = np.eye(3), np.zeros(3), np.zeros(3)
    frames = [
        f for f in over_time.get("keyframes") or over_time.get("table") or () if f.get("move") is not None
    ]
    if frames:
        times = [float(f["time"]) for f in frames]
        move = np.array([np.interp(time, times, [float(f["move"][i]) for f in frames]) for i in range(3)])
    rotation = over_time.get("rotation")
    if rotation is not None:
        turns = float(rotation["frequency"]) * max(time - float(rotation.get("start") or 0.0), 0.0)
        if rotation.get("turns") is not None:
            turns = float(np.clip(turns, -rotation["turns"], rotation["turns"]))
        axis = np.asarray(rotation.get("axis") or (0.0, 0.0, 1.0), dtype=float)
        turn = rotation_matrix(axis / np.linalg.norm(axis) * 2 * np.pi * turns)
        centre = np.asarray(rotation.get("center") or (0.0, 0.0, 0.0), dtype=float)
    return turn, centre, move


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) by a rotation vector (3,) rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle > 0 else vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _frame(axis: Any) -> np.ndarray:
    """Rotation (3, 3) that takes +x to the axis."""
    x = np.asarray(axis, dtype=float)
    x = x / np.linalg.norm(x)
    y = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def least_turn(axis: np.ndarray) -> np.ndarray:
    """The least rotation (3, 3) that carries z onto an axis, as magmpm.fields.magnets lays blocks; half a turn about x for -z."""
    x, y, z = axis / np.linalg.norm(axis)
    across = np.array([-y, x, 0.0])
    away = float(np.linalg.norm(across))
    if away < 1e-12:
        return np.eye(3) if z > 0 else np.diag([1.0, -1.0, -1.0])
    return rotation_matrix(across / away * float(np.arctan2(away, z)))


def _halves(name: str, shape: Surface, frame: np.ndarray, position: Any) -> Iterator[Prop]:
    """A solid along +x, its part 0 south and its part 1 north, turned and put in place."""
    points = shape.points @ frame.T + np.asarray(position, dtype=float)
    for part, colour in ((0, style.SOUTH), (1, style.NORTH)):
        yield Prop(name, points, shape.triangles[shape.part == part], colour)


def _magnet(magnet: Mapping[str, Any]) -> Iterator[Prop]:
    axis = np.asarray(magnet.get("axis") or (0.0, 0.0, 1.0), dtype=float)
    along = np.asarray(magnet.get("magnetization") or axis, dtype=float)
    if magnet.get("cylinder"):
        length, radius = float(magnet["cylinder"]["length"]), 0.5 * float(magnet["cylinder"]["diameter"])
        shape = tube([length / 2, length], radius, 0.0, length, AROUND)
        shape = Surface(shape.points - [length / 2, 0, 0], shape.triangles, shape.part)
        frame = _frame(axis)
    else:
        sizes = np.asarray(magnet["cuboid"]["size"], dtype=float)
        frame = least_turn(axis)[:, [2, 0, 1]]
        shape = _block(sizes[[2, 0, 1]])
    if abs(float(along @ axis)) < 0.7 * np.linalg.norm(along) * np.linalg.norm(axis):
        # Magnetised across its axis: the halves are told apart by the side they lie on.
        side = (shape.points[shape.triangles].mean(axis=1) @ frame.T) @ along > 0
        shape = Surface(shape.points, shape.triangles, side.astype(int))
    elif float(along @ axis) < 0:
        shape = Surface(shape.points, shape.triangles, 1 - shape.part)
    yield from _halves(f"magnet {POLES}", shape, frame, magnet["position"])


def _block(sizes: np.ndarray) -> Surface:
    """A block with edges `sizes` (3,) m along x, y, z about the origin, its halves along x parts 0 and 1."""
    a, b, c = (float(s) for s in sizes)
    return bar([a / 2, a], b, c, min(b, c) / 2, (-a / 2, 0.0, 0.0))


def _dipole(dipole: Mapping[str, Any]) -> Iterator[Prop]:
    moment = np.asarray(dipole["moment"], dtype=float)
    # A point is drawn as the neodymium sphere (1.3 T) it would take to make its moment, and called what it is.
    strength = float(np.linalg.norm(moment))
    size = 0.5 * float(dipole.get("diameter") or 0.0)
    name = f"magnet {POLES}" if size else f"point dipole {POLES}"
    shape, frame = (
        _ball(size or (3e-7 * strength / 1.3) ** (1 / 3)),
        _frame(moment if strength else (0, 0, 1)),
    )
    yield from _halves(name, shape, frame, dipole["position"])


def _ball(radius: float) -> Surface:
    """A sphere about the origin, its halves along x parts 0 and 1."""
    angle = np.linspace(0.0, np.pi, 25)
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    rings = [
        radius
        * np.stack(
            [
                np.full(AROUND, -np.cos(a)),
                max(np.sin(a), 1e-6) * np.cos(turn),
                max(np.sin(a), 1e-6) * np.sin(turn),
            ],
            axis=1,
        )
        for a in angle
    ]
    whole = lofted(rings, 0, closed=True, flip=True)
    return Surface(
        whole.points, whole.triangles, (whole.points[whole.triangles].mean(axis=1)[:, 0] > 0).astype(int)
    )


def _coil(coil: Mapping[str, Any]) -> Prop:
    radius = 0.5 * float(coil["diameter"])
    turn = 2 * np.pi * np.arange(73) / 72
    ring = np.stack([np.zeros(73), radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    frame = _frame(coil.get("axis") or (0.0, 0.0, 1.0))
    points, triangles = swept(ring @ frame.T + np.asarray(coil["position"], dtype=float), 0.05 * radius)
    return Prop("coil", points, triangles, style.COIL)


def _clamps(scene: Mapping[str, Any]) -> Iterator[Prop]:
    """Plates at the ends that a catheter or strip is held by."""
    body = scene.get("body") or {}
    shape = body.get("catheter") or body.get("strip")
    if (
        not shape
        or shape.get("clamp", "base") == "none"
        or (scene.get("effects") or {}).get("feed") is not None
    ):
        return
    base = np.asarray(shape.get("position") or (0.0, 0.0, 0.0), dtype=float)
    thick = float(shape.get("diameter") or shape.get("thickness"))
    depth = style.CLAMP_THICKNESS * max(thick, 0.1 * float(shape["length"]))
    for at in (-depth, float(shape["length"]))[: 2 if shape["clamp"] == "both" else 1]:
        if "diameter" in shape:
            plate = tube([depth], style.CLAMP_RADIUS * thick, 0.0, depth, AROUND)
        else:
            grown = 2 * style.CLAMP_RADIUS * thick
            plate = bar([depth], float(shape["width"]) + grown - thick, 1.8 * grown, depth)
        yield Prop("clamp", plate.points + base + [at, 0.0, 0.0], plate.triangles, style.CLAMP)


def _guide(low: float, high: float, radius: float) -> Prop:
    points, triangles = swept(np.array([[low, 0.0, 0.0], [high, 0.0, 0.0]]), radius, AROUND)
    return Prop("guide", points, triangles, style.CLAMP, hollow=True, framed=False)


def swept(path: np.ndarray, radius: float | np.ndarray, around: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """A tube around a path (n, 3) m with that radius (m), one or (n,): points, triangles."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    first = _frame(tangent[0])[:, 1]
    turn = 2 * np.pi * np.arange(around) / around
    rings = []
    for point, along, r in zip(path, tangent, np.broadcast_to(radius, len(path))):
        first = first - along * (first @ along)
        first = first / np.linalg.norm(first)
        second = np.cross(along, first)
        rings.append(point + r * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second))
    shape = lofted(rings, 0, closed=True, flip=True)
    return shape.points, shape.triangles


def _walls(walls: Mapping[str, Any]) -> Iterator[Prop]:
    """A lumen: a tube around a path, or a closed surface."""
    wall = wall_of(walls)
    if isinstance(wall, TubeWall):
        points, triangles = swept(wall.path, wall.radius)
        yield Prop("wall", points, triangles, style.WALL, hollow=True)
    elif wall is not None:
        yield Prop("wall", wall.points, wall.triangles, style.WALL, hollow=True)


@dataclass(frozen=True)
class TubeWall:
    """The inside of a tube of that radius (m) around a path (n, 3) m."""

    path: np.ndarray
    radius: float

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m from points (n, 3) m to the wall, within it."""
        return np.asarray(self.radius - _distance(points, self.path))

    def dropped(self, points: np.ndarray) -> np.ndarray:
        """The points themselves: marks of contact stand on the body."""
        return points


@dataclass(frozen=True)
class SurfaceWall:
    """The inside of a closed surface: points (n, 3) m, near enough to each other to measure distances by, and triangles (m, 3)."""

    points: np.ndarray
    triangles: np.ndarray

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m from points (n, 3) m to the wall's nearest point."""
        return _distance(points, self.points)

    def dropped(self, points: np.ndarray) -> np.ndarray:
        """The points themselves: marks of contact stand on the body."""
        return points


def _distance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree  # not in the drawing process, which imports this file as well

    good = np.isfinite(points).all(axis=1)
    away = np.full(len(points), np.inf)
    away[good] = cKDTree(others).query(points[good])[0]
    return away


def wall_of(walls: Mapping[str, Any]) -> TubeWall | SurfaceWall | None:
    """The lumen of a scene's walls (their JSON), or None."""
    if walls.get("tube"):
        from magmpm.bodies.curves import curve

        points, radius = np.asarray(walls["tube"]["path"], dtype=float), float(walls["tube"]["radius"])
        return TubeWall(curve(points, 0.1 * radius), radius)
    if walls.get("surface"):
        from magmpm.bodies.assembly import UNITS
        from magmpm.bodies.surface_mesh import unpack_mesh
        from viz.surface import creased

        mesh, scale = unpack_mesh(walls["surface"]["mesh"]), UNITS[walls["surface"]["unit"]]
        shape = creased(mesh.vertices * scale, mesh.faces, 0)
        fine = refined(shape, 0.01 * float(np.ptp(shape.points, axis=0).max()), 60_000)
        return SurfaceWall(fine.points, fine.triangles)
    return None


def surfaces(scene: Mapping[str, Any]) -> dict[str, Plane | TubeWall | SurfaceWall]:
    """What the body may touch, by effect."""
    plane, wall = ground(scene), wall_of((scene.get("effects") or {}).get("walls") or {})
    return {name: s for name, s in (("ground", plane), ("walls", wall)) if s is not None}
