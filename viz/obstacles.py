"""Surroundings of a body: clamps, walls, guides, magnets and coils as colored solids, and the surfaces that it may touch.

Magnets and coils stand where magmpm.fields places them, at any time of their schedule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from magmpm.bodies.curves import curve
from magmpm.fields.magnets import Solid, frame_of, polarization, taken, wires
from magmpm.fields.schedule import places
from magmpm.fields.sources import FieldSource
from magmpm.scene import Scene
from magmpm.viz import style
from magmpm.viz.meshes import TriangleSurface, ball, bar, circle, creased, refined, swept, tube
from magmpm.viz.snapshot import DrawnSolid, Plane

POINTS_AROUND_TUBE = 48
REACH_OF_VIEW = 2.5  # how far from the body, in its lengths, a source may be to be in view


def ground(scene: Scene | None) -> Plane | None:
    """The plane the body may rest on, or None."""
    settings = None if scene is None else scene.effects.ground
    if settings is None:
        return None
    normal = np.array(settings.normal, dtype=float)
    return Plane(np.array(settings.point, dtype=float), normal / np.linalg.norm(normal))


def standing(scene: Scene | None) -> list[DrawnSolid]:
    """Obstacles that do not move: clamps, walls and guides."""
    if scene is None:
        return []
    found = list(_clamps(scene))
    wall = wall_of(scene)
    feed = scene.effects.feed
    if wall is not None:
        found.append(
            DrawnSolid("wall", wall.surface.points, wall.surface.triangles, style.WALL, hollow=True)
        )
    if feed is not None:
        path = np.array([[-0.05 * scene.length, 0.0, 0.0], [feed.exit, 0.0, 0.0]])
        guide = swept(path, 0.75 * scene.thickness, POINTS_AROUND_TUBE)
        found.append(
            DrawnSolid(
                "guide", guide.points, guide.triangles, style.CLAMP, hollow=True, framed=False
            )
        )
    return found


def _clamps(scene: Scene) -> Iterator[DrawnSolid]:
    """Plates at the ends by which a catheter or strip is held."""
    shape = scene.body.shape
    if shape.line is None or shape.clamp == "none" or scene.effects.feed is not None:
        return
    thick = scene.thickness
    depth = style.CLAMP_THICKNESS * max(thick, 0.1 * shape.length)
    for name, at in (("base", -depth), ("tip", shape.length))[: 2 if shape.clamp == "both" else 1]:
        if scene.body.strip is None:
            plate = tube([depth], style.CLAMP_RADIUS * thick, 0.0, 0.25 * thick, POINTS_AROUND_TUBE)
        else:
            grown = 2 * style.CLAMP_RADIUS * thick
            plate = bar([depth], scene.body.strip.width + grown - thick, 1.8 * grown, depth)
        moved = scene.move[name].displacement(None)[0] if scene.move and name in scene.move else 0.0
        points = plate.points + shape.line.base + [at, 0.0, 0.0] + moved
        yield DrawnSolid("clamp", points.astype(np.float32), plate.triangles, style.CLAMP)


def sources(scene: Scene | None, time: float | None = None) -> list[DrawnSolid]:
    """The field's magnets, dipoles and coils where they are at a time (s), or at the end of their schedule: north red, south blue."""
    if scene is None:
        return []
    field = scene.field
    (place,) = places(field, None if time is None else np.array([time]))
    turn = place["frame"].reshape(3, 3)
    origin = place["origin"]
    return [replace(o, points=o.points @ turn.T + origin) for o in _sources(field)]


def _sources(field: FieldSource) -> Iterator[DrawnSolid]:
    """The sources in their own frame."""
    solids = [solid for solid in taken(field) if not solid.ball]
    for solid, magnet in zip(solids, field.magnet or ()):
        yield from _halves(
            f"magnet {style.POLES}",
            _magnet(solid, polarization(magnet)),
            solid.frame,
            magnet.position,
        )
    for dipole in field.dipole or ():
        moment = np.array(dipole.moment)
        strength = float(np.linalg.norm(moment))
        kind = "magnet" if dipole.diameter else "dipole"
        # 1.3 T: a point dipole is drawn as the sphere of this remanence that makes its moment
        shape = ball(
            dipole.diameter / 2 if dipole.diameter else (3e-7 * strength / 1.3) ** (1 / 3),
            POINTS_AROUND_TUBE,
        )
        frame = frame_of((moment / strength).tolist() if strength else (0.0, 0.0, 1.0))
        yield from _halves(f"{kind} {style.POLES}", _upright(shape), frame, dipole.position)
    for coil in wires(field):
        ring = np.vstack([circle(coil.half[0], 72), circle(coil.half[0], 72)[:1]])
        wire = _upright(swept(ring, 0.05 * coil.half[0]))
        yield DrawnSolid(
            "coil", wire.points @ coil.frame.T + coil.position, wire.triangles, style.COIL
        )


def _upright(shape: TriangleSurface) -> TriangleSurface:
    """A shape along +x, turned to stand along +z."""
    return TriangleSurface(shape.points[:, [1, 2, 0]], shape.triangles, shape.part)


def _magnet(solid: Solid, remanence: np.ndarray) -> TriangleSurface:
    """A magnet in its own frame: part 0 is its south, part 1 its north half; remanence (3,) T, in space."""
    a, b, c = (float(half) for half in solid.half)
    shape = (
        tube([c, 2 * c], a, 0.0, 2 * c, POINTS_AROUND_TUBE)
        if solid.round
        else bar([c, 2 * c], 2 * a, 2 * b, min(a, b))
    )
    shape = _upright(TriangleSurface(shape.points - [c, 0.0, 0.0], shape.triangles, shape.part))
    along = remanence @ solid.frame
    if abs(along[2]) < 0.7 * np.linalg.norm(along):
        # Magnetized across its axis: the halves are distinguished by the side they lie on.
        side = shape.points[shape.triangles].mean(axis=1) @ along > 0
        return TriangleSurface(shape.points, shape.triangles, side.astype(int))
    return shape if along[2] > 0 else TriangleSurface(shape.points, shape.triangles, 1 - shape.part)


def _halves(
    name: str, shape: TriangleSurface, frame: np.ndarray, position: tuple[float, float, float]
) -> Iterator[DrawnSolid]:
    """A solid, its part 0 south and its part 1 north, turned and put in place."""
    points = shape.points @ frame.T + np.array(position)
    for part, color in ((0, style.SOUTH), (1, style.NORTH)):
        yield DrawnSolid(name, points, shape.triangles[shape.part == part], color)


def in_reach(obstacles: list[DrawnSolid], points: np.ndarray, reach: float) -> list[DrawnSolid]:
    """The obstacles; those farther than reach (m) from the points (n, 3) m need not be in view, where they would make the body a speck."""
    low = points.min(axis=0) - reach
    high = points.max(axis=0) + reach
    near = [((o.points > low) & (o.points < high)).all(axis=1).any() for o in obstacles]
    return [replace(o, framed=o.framed and bool(is_near)) for o, is_near in zip(obstacles, near)]


@dataclass(frozen=True)
class Wall:
    """The inside of a lumen: its surface, and the points (n, 3) m that its distance is measured by, which is `radius` (m) less."""

    surface: TriangleSurface
    measured: np.ndarray
    radius: float | None = None

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m from points (n, 3) m to the wall, within it."""
        good = np.isfinite(points).all(axis=1)
        away = np.full(len(points), np.inf)
        away[good] = cKDTree(self.measured).query(points[good])[0]
        return away if self.radius is None else self.radius - away

    def dropped(self, points: np.ndarray) -> np.ndarray:
        """The points themselves: marks of contact stand on the body."""
        return points


def wall_of(scene: Scene) -> Wall | None:
    """The lumen of a scene, or None."""
    walls = scene.effects.walls
    if walls is None:
        return None
    if walls.tube is not None:
        path = curve(np.array(walls.tube.path), 0.1 * walls.tube.radius)
        return Wall(swept(path, walls.tube.radius), path, walls.tube.radius)
    assert walls.surface is not None  # validated
    shape = creased(walls.surface.vertices, walls.surface.faces, 0)
    # Points near enough to each other to measure distances by.
    fine = refined(shape, 0.01 * float(np.ptp(shape.points, axis=0).max()), 60_000)
    return Wall(fine, fine.points)


def surfaces(scene: Scene | None) -> dict[str, Plane | Wall]:
    """Surfaces that the body may touch, by effect."""
    plane = ground(scene)
    wall = None if scene is None else wall_of(scene)
    return {name: s for name, s in (("ground", plane), ("walls", wall)) if s is not None}
