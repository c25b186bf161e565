"""walls: the body lies in a lumen, a tube around a path or the inside of a closed surface, and touches its wall, with friction.

The distance from the wall comes from a table (bodies.signed_distance), so a particle costs the same whatever the wall's shape; force,
friction, stiffness and what a body sinks in: see effects.contact_law. What lies beyond the table, as past the open ends of a tube,
touches nothing.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve
from magmpm.bodies.signed_distance import Table, value
from magmpm.compiled.jit import compiled
from magmpm.effects import contact_law as law
from magmpm.effects.body_reach import body_reach, unreached
from magmpm.effects.contact_law import Contact, push
from magmpm.effects.estimates import Advice, Body, obstacle
from magmpm.effects.hooks import register
from magmpm.errors import SceneError
from magmpm.scene import Scene
from magmpm.scene.surroundings import Surface, Tube, Walls

PHASE = "contact"
POINTS = 6  # of the table in a tube's radius
DTYPE = np.dtype(
    [
        ("walls_origin", np.float64, (3,)),
        ("walls_spacing", np.float64),
        ("walls_shape", np.int64, (3,)),
        ("walls_friction", np.float64),
        ("walls_stiffness", np.float64),
        ("walls_reach", np.float64),
    ]
)


def parameters(
    table: Table, *, friction: float, stiffness: float, reach: float = 0.0
) -> tuple[NDArray[Any], ...]:
    """What kernels take. stiffness w^2 1/s^2; reach m."""
    record = np.zeros(1, DTYPE)
    record["walls_origin"], record["walls_spacing"] = table.origin, table.spacing
    record["walls_shape"] = table.coefficients.shape
    record["walls_friction"], record["walls_stiffness"] = friction, stiffness
    record["walls_reach"] = reach
    return record, np.ascontiguousarray(table.coefficients).ravel()


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take."""
    settings = scene.effects.walls
    if settings is None:
        return ()
    return parameters(
        table_of(scene),
        friction=settings.friction,
        stiffness=law.penalty(scene, settings.stiffness),
        reach=law.reach(scene),
    )


def table_of(scene: Scene) -> Table:
    """Distances from the wall: of a tube true to 0.0006 of its radius, of a surface as fine as two points a cell of the body can tell."""
    settings = scene.effects.walls
    assert settings is not None  # asked for where it is named
    if settings.tube is not None:
        return _tube_table(settings.tube)
    assert settings.surface is not None  # validated
    return _surface_table(settings.surface, scene.cell / 2)


@lru_cache(maxsize=4)
def _tube_table(tube: Tube) -> Table:
    return distance.tube(_path(tube), tube.radius, tube.radius / POINTS)


def _path(tube: Tube) -> NDArray[np.float64]:
    return curve(np.array(tube.path), tube.radius / POINTS / 4)


@lru_cache(maxsize=4)
def _surface_table(surface: Surface, spacing: float) -> Table:
    return distance.surface(surface.vertices, surface.faces, spacing)


def _room(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (n,) m of points (n, 3) m from the wall, negative beyond it."""
    settings = scene.effects.walls
    assert settings is not None  # asked for where it is named
    if settings.tube is not None:  # exact, and past the table as well
        return settings.tube.radius - distance.to_path(points, _path(settings.tube))
    found, _ = table_of(scene).at(points)
    return np.where(np.isfinite(found), found, -np.inf)


def stable_step(record: NDArray[Any], data: NDArray[np.float64], model: Any) -> float:
    """Largest stable step, s."""
    return law.stable_step(float(record["walls_stiffness"].max()))


def advice(scene: Scene, body: Body) -> Advice:
    """Whether the body's rest, were the wall not there, would be through it."""
    named = scene.effects.walls
    if named is None:
        return Advice(None, "no lumen is given")
    return obstacle(scene, body, lambda points: _room(scene, points), "from it")


def warnings(scene: Scene) -> list[str]:
    """Where the wall is too far away to be touched."""
    named = scene.effects.walls
    found = None if named is None else _unreached(scene, named)
    return [] if found is None else [found]


def _unreached(scene: Scene, named: Walls) -> str | None:
    reach = body_reach(scene)
    if named.tube is not None:
        path = _path(named.tube)
        distances = distance.to_tube(reach.base, path, named.tube.radius, distance.past_ends(named.tube.radius, named.tube.radius / POINTS))
    else:
        assert named.surface is not None  # validated
        distances = distance.to_triangles(reach.base, np.ascontiguousarray(named.surface.vertices[named.surface.faces]))
    return unreached("walls", "the lumen's wall", reach, distances)


@compiled
def depth(effect, data, x):  # type: ignore[no-untyped-def]
    """How far (m) the body's surface at a particle at x is beyond the wall, negative inside; slope of the distance, inwards."""
    s = effect.walls_spacing
    p, q, r = (
        (x[0] - effect.walls_origin[0]) / s,
        (x[1] - effect.walls_origin[1]) / s,
        (x[2] - effect.walls_origin[2]) / s,
    )
    planes, rows, columns = effect.walls_shape[0], effect.walls_shape[1], effect.walls_shape[2]
    if not (0.5 <= p < planes - 1.5 and 0.5 <= q < rows - 1.5 and 0.5 <= r < columns - 1.5):
        return -np.inf, 0.0, 0.0, 0.0
    # The nearest point's coefficient is within 2 s of the distance: most particles are done with it.
    near = data[(int(p + 0.5) * rows + int(q + 0.5)) * columns + int(r + 0.5)]
    if near > effect.walls_reach + 2.0 * s:
        return effect.walls_reach - near, 0.0, 0.0, 0.0
    distance, sx, sy, sz = value(p, q, r, s, rows, columns, data)
    return effect.walls_reach - distance, sx, sy, sz


@compiled
def near(effect, data, x):  # type: ignore[no-untyped-def]
    """How far a particle at x is beyond it, m."""
    return depth(effect, data, x)[0]


@compiled
def contact(effect, data, x, v, mass, dt, f):  # type: ignore[no-untyped-def]
    """f += the wall's push and friction, N."""
    beyond, sx, sy, sz = depth(effect, data, x)
    if beyond > 0.0:
        size = math.sqrt(sx * sx + sy * sy + sz * sz)
        if size > 0.0:  # times the slope's size: the exact slope of the energy
            push(
                beyond, sx / size, sy / size, sz / size, v, mass, dt,
                effect.walls_stiffness * size, effect.walls_friction, f,
            )  # fmt: skip


@compiled
def _touching(effect, data, x, v, mass, dt, force):  # type: ignore[no-untyped-def]
    """Number in contact, the deepest one (-1: none) and how deep it is (m), energy (J); adds to force (3,) N."""
    count, worst, deepest, squares = 0, -1, 0.0, 0.0
    for p in range(len(mass)):
        beyond = depth(effect, data, x[p])[0]
        if beyond > 0.0:
            contact(effect, data, x[p], v[p], mass[p], dt, force)
            count += 1
            if beyond > deepest:
                worst, deepest = p, beyond
            squares += mass[p] * beyond**2
    return count, worst, deepest, 0.5 * effect.walls_stiffness * squares


def report(
    record: NDArray[Any],
    data: NDArray[np.float64],
    x: NDArray[np.float64],
    v: NDArray[np.float64],
    mass: NDArray[np.float64],
    dt: float,
) -> Contact:
    """Contact of particles at x (n, 3) m with velocities v (n, 3) m/s and mass (n,) kg, in steps of dt (s)."""
    force = np.zeros(3)
    count, _, deepest, _ = _touching(record[0], data, x, v, mass, dt, force)
    return Contact(force=force, count=count, depth=deepest)


def check(record: NDArray[Any], data: NDArray[np.float64], model: Any) -> None:
    """Raises SceneError where the body begins beyond the wall, or before the open end of a tube that it can't reach."""
    out = -_room(model.scene, model.particles.position)
    if out.max() > model.scene.cell:  # less is an overlap, below
        far = f"{1e3 * out.max():.3g} mm " if np.isfinite(out.max()) else "far "
        raise SceneError(
            "effects.walls",
            found=f"the body begins {far}outside the lumen, farthest with {law.place(model, int(out.argmax()))}",
            rule="the body must begin within the lumen",
            remedy="make the lumen wider, or move it to the body",
        )
    named = model.scene.effects.walls
    if named.tube is not None and not np.isfinite(table_of(model.scene).at(model.particles.position)[0]).any():
        found = _unreached(model.scene, named)
        if found is not None:
            raise SceneError(
                "effects.walls",
                found=f"the body begins outside the lumen, before an open end of its tube; {found.removeprefix('effects.walls: ')}",
                rule="the body must begin within the lumen, or be able to reach it",
                remedy="move the tube to the body, or feed the body into it",
            )
    x, mass = model.particles.position, model.density * model.particles.volume
    _, worst, deepest, energy = _touching(record[0], data, x, 0 * x, mass, 1.0, np.zeros(3))
    law.refuse_overlap("walls", "the wall", model, worst, deepest, energy, "make the lumen wider, or move it")


register(DTYPE, contact=contact, near=near)
