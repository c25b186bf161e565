"""walls: the body lies in a lumen, a tube around a path or the inside of a closed surface, and touches its wall, with friction.

The distance from the wall comes from a table (bodies.signed_distance), so the cost does not depend on the wall's shape. For force,
friction and stiffness see effects.contact_law. Outside of the table, as beyond the open ends of a tube, there is no contact.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.assembly import UNITS
from magmpm.bodies.curves import curve, tightest_radius
from magmpm.bodies.signed_distance import DistanceTable, curvature, value
from magmpm.bodies.surface_mesh import outline, read_mesh, size_fault, unpack_mesh
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined
from magmpm.effects.base import Point, Records, SceneLike
from magmpm.effects.body_reach import body_reach, unreached
from magmpm.effects.contact_force import push, spring
from magmpm.effects.contact_law import (
    Friction,
    Obstacle,
    Stiffness,
    obstacle_dtype,
    obstacle_record,
    place,
)
from magmpm.effects.hooks import register
from magmpm.errors import SceneError
from magmpm.inputs.csv_tables import named_table, read_centreline
from magmpm.inputs.settings import Quantity, Settings, fault

POINTS = 6  # of the table in a tube's radius
DTYPE = obstacle_dtype(
    "walls", ("origin", np.float64, (3,)), ("spacing", np.float64), ("shape", np.int64, (3,))
)
_PATH = WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "minItems": 2}]})


def parameters(table: DistanceTable, **pushing: float) -> Records:
    """Parameters for the kernels: see contact_force.push."""
    return obstacle_record(
        DTYPE,
        table.flat,
        origin=table.origin,
        spacing=table.spacing,
        shape=table.coefficients.shape,
        **pushing,
    )


class TubularLumen(Settings):
    """A tube around a path."""

    radius: Annotated[float, Quantity("length", above="0 mm", at_most="1 m")] = Field(
        description="Inner radius.", examples=["5 mm"]
    )
    path: Annotated[
        tuple[Point, ...],
        named_table(lambda path: read_centreline(path)[:, 1:].tolist(), None),
        _PATH,
    ] = Field(
        description=(
            "Points of its axis, joined by a smooth curve: a list of [x, y, z], or the path,"
            " relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm. Both ends are"
            " open and go on straight."
        ),
        examples=[[["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]],
    )

    @model_validator(mode="after")
    def _can_be_made(self) -> TubularLumen:
        points = np.array(self.path)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 2 or not np.all(steps > 0):
            raise fault(
                "a tube's path must have 2 or more points, each apart from the next",
                "correct the points",
                ("path",),
            )
        bend = tightest_radius(curve(points, min(float(steps.min()), self.radius) / 20))
        if not bend > self.radius:
            raise fault(
                "a tube's path must not bend more tightly than its radius, and bends to"
                f" {1e3 * bend:.3g} mm",
                "make the radius smaller, or the path smoother",
                ("path",),
            )
        return self


class Surface(Settings):
    """The inside of a closed surface."""

    mesh: Annotated[
        str,
        BeforeValidator(partial(read_mesh, key="effects.walls.surface.mesh")),
        WithJsonSchema({"type": "string"}),
    ] = Field(
        description=(
            "Path, relative to this file, of an STL file: a closed surface around the lumen."
        ),
        examples=["vessel.stl"],
    )
    unit: Literal["um", "mm", "cm", "m", "inch"] = Field(
        description="Unit of the numbers in the STL file, which does not say it.", examples=["mm"]
    )

    @model_validator(mode="after")
    def _of_usable_size(self) -> Surface:
        found = size_fault(unpack_mesh(self.mesh), self.unit, UNITS[self.unit])
        if found is not None:
            raise fault(*found, ("mesh",))
        return self

    @property
    def vertices(self) -> Array:
        """(v, 3) m."""
        return unpack_mesh(self.mesh).vertices * UNITS[self.unit]

    @property
    def faces(self) -> Index:
        """(f, 3)."""
        return unpack_mesh(self.mesh).faces


class Walls(Obstacle):
    """A lumen the body lies in: a tube, or the inside of a surface.

    Parameters
    ----------
    tube : dict, optional
        The inside of a tube around a path; give this or `surface`.
    surface : dict, optional
        The inside of an STL mesh; give this or `tube`.
    friction : float, no unit, optional
        Coulomb's coefficient of friction; 0, slippery, unless given.
    stiffness : float, no unit, optional
        Factor on the usual contact stiffness, at which the body sinks in by
        micrometers; 1 unless given. Above 1 the contact may require a smaller time step
        than the body.

    Examples
    --------
    >>> from magmpm import Walls
    >>> path = [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]
    >>> Walls(tube={"radius": "5 mm", "path": path}).tube.radius  # m
    0.005
    """

    WORDS = "the wall"
    CLEAR = "make the lumen wider, or move it"
    tube: TubularLumen | None = Field(
        default=None,
        description="The inside of a tube around a path; give this or `surface`.",
        examples=[
            {"radius": "5 mm", "path": [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]}
        ],
    )
    surface: Surface | None = Field(
        default=None,
        description="The inside of an STL mesh; give this or `tube`.",
        examples=[{"mesh": "vessel.stl", "unit": "mm"}],
    )
    friction: Friction = 0.0
    stiffness: Stiffness = 1.0

    one_of = ("tube", "surface")
    written = "tube: {radius: 5 mm, path: vessel.csv}"

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels."""
        return parameters(
            self._table(scene), friction=self.friction, stiffness=self.stiffness_in(scene)
        )

    @property
    def axis(self) -> Array:
        """Points (k, 3) m of the axis of a tube."""
        assert self.tube is not None  # asked for by those who know
        return curve(np.array(self.tube.path), self.tube.radius / 2)

    def _table(self, scene: SceneLike) -> DistanceTable:
        """Distances from the wall: of a tube within 0.0006 of its radius; of a surface with two points in a cell of the body."""
        if self.tube is not None:
            return _tube_table(self.tube)
        assert self.surface is not None  # validated
        return _surface_table(self.surface, scene.cell / 2)

    def _room(self, scene: SceneLike, points: Array) -> Array:
        """Distance (n,) m of points (n, 3) m from the wall, negative beyond it."""
        if self.tube is not None:  # exact, and past the table as well
            return self.tube.radius - distance.to_path(points, _path(self.tube))
        found, _ = self._table(scene).at(points)
        return np.where(np.isfinite(found), found, -np.inf)

    def passed(self, scene: SceneLike, x: Array) -> str | None:
        """Reason why points can't rest at x (n, 3) m: as of any obstacle; or they are outside, past the table, but beside the lumen."""
        out = x[~np.isfinite(self._table(scene).at(x)[0])]
        if self.tube is not None and len(out):
            place = distance.along_path(out, path := _path(self.tube))
            out = out[(place > 0.0) & (place < len(path) - 1.0)]
        return f"the body passed through {self.WORDS}" if len(out) else super().passed(scene, x)

    def warnings(self, scene: SceneLike) -> list[str]:
        """Warn of a wall that is too far away to be touched."""
        limits = body_reach(scene)
        if self.tube is not None:
            radius = self.tube.radius
            distances = distance.to_tube(
                limits.base, _path(self.tube), radius, distance.past_ends(radius, radius / POINTS)
            )
        else:
            assert self.surface is not None  # validated
            triangles = self.surface.vertices[self.surface.faces]
            distances = distance.to_triangles(limits.base, np.ascontiguousarray(triangles))
        return unreached("walls", "the lumen's wall", limits, distances)

    def check(self, model: Any) -> None:
        """Raises SceneError where the body begins beyond the wall, or before the open end of a tube that it can't reach."""
        out = -self._room(model.scene, model.particles.position)
        if out.max() > model.scene.cell:  # less is an overlap, below
            far = f"{1e3 * out.max():.3g} mm " if np.isfinite(out.max()) else "far "
            raise SceneError(
                "effects.walls",
                found=(
                    f"the body starts {far}outside the lumen, farthest in "
                    f"{place(model, model.particles.position[out.argmax()])}"
                ),
                rule="the body must start inside the lumen",
                remedy="make the lumen wider, or move it to the body",
            )
        if (
            self.tube is not None
            and not np.isfinite(self._table(model.scene).at(model.particles.position)[0]).any()
        ):
            for found in self.warnings(model.scene):
                raise SceneError(
                    "effects.walls",
                    found=(
                        "the body starts outside the lumen, before an open end of its tube; "
                        f"{found.removeprefix('effects.walls: ')}"
                    ),
                    rule="the body must start inside the lumen, or be able to reach it",
                    remedy="move the tube to the body, or feed the body into it",
                )
        super().check(model)


@lru_cache(maxsize=4)
def _tube_table(tube: TubularLumen) -> DistanceTable:
    return distance.tube(_path(tube), tube.radius, tube.radius / POINTS)


def _path(tube: TubularLumen) -> Array:
    return curve(np.array(tube.path), tube.radius / POINTS / 4)


@lru_cache(maxsize=4)
def _surface_table(surface: Surface, spacing: float) -> DistanceTable:
    corners = UNITS[surface.unit] * outline(
        surface.mesh, distance.SLIVER_THICKNESS * spacing / UNITS[surface.unit]
    )
    return distance.solid([corners], corners, spacing, 0.0)


@inlined
def _place(effect, x):
    """Place of x in points of the table from its first; the table's spacing, m, and shape."""
    o = effect.walls_origin
    s = effect.walls_spacing
    planes, rows, columns = effect.walls_shape
    return (x[0] - o[0]) / s, (x[1] - o[1]) / s, (x[2] - o[2]) / s, s, (planes, rows, columns)


@inlined
def depth(effect, data, x):
    """Distance (m) of a point x beyond the wall, negative inside, -inf past the table; slope of the distance, inwards."""
    room, sx, sy, sz = value(*_place(effect, x), data)
    return -room, sx, sy, sz


@inlined
def contact(effect, data, x, mass, f):
    """f += the wall's push and grip (contact_force). Returns the distance beyond the wall, m."""
    beyond, sx, sy, sz = depth(effect, data, x)
    push(beyond, sx, sy, sz, mass * effect.walls_stiffness, effect.walls_friction, f)
    return beyond


@compiled
def touch(effect, data, x, mass, f, H):
    """Energy (J) of a point at rest on the wall, its force and its tangent, with the wall's curvature."""
    beyond, sx, sy, sz = depth(effect, data, x)
    if not beyond > 0.0:
        return 0.0
    rigidity = mass * effect.walls_stiffness
    xx, yy, zz, xy, xz, yz = curvature(*_place(effect, x), data)
    bent = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    for i in range(3):
        for j in range(3):
            H[i, j] -= rigidity * beyond * bent[i][j]
    return spring(beyond, sx, sy, sz, rigidity, f, H)


register(DTYPE, contact=contact, touch=touch)
