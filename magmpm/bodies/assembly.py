"""Bodies made of STL parts: one mesh a part, each with its material, magnetization and clamp."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from magmpm.bodies.body_shape import BodyShape, Discretization, Region
from magmpm.bodies.contact_solid import NEEDLE, Solids, meets, mesh_solids
from magmpm.bodies.contact_surface import SurfacePoints, cut, parts_surface
from magmpm.bodies.curves import face_normals
from magmpm.bodies.grid import AT_REST, EVEN, ClampPlane, Grid, Knots, TurnedGrid
from magmpm.bodies.mesh_quadrature import (
    TOUCHING_DISTANCE,
    axes_of_parts,
    connected_components,
    grid_of_parts,
    part_errors,
    part_particles,
    point_weights,
)
from magmpm.bodies.section_quadrature import Particles
from magmpm.bodies.signed_distance import to_triangles
from magmpm.bodies.surface_mesh import (
    PREFIX,
    distance_to,
    gap,
    hollow,
    nearest_solids,
    outline,
    overlaps,
    read_mesh,
    size_fault,
    thickness_of,
    unpack_mesh,
    volume_of,
)
from magmpm.bodies.wetted_surface import WettedSurface, wetted_parts
from magmpm.compiled.arrays import Array, Index, Mask
from magmpm.errors import length
from magmpm.inputs.settings import Settings, Width, fault
from magmpm.inputs.vectors import Direction, Point, Vector

if TYPE_CHECKING:
    Tip = str | Vector
else:
    Tip = Annotated[
        Annotated[str, Tag("part")] | Annotated[Point, Tag("point")],
        Discriminator(lambda value: "part" if isinstance(value, str) else "point"),
    ]

MAX_PARTS = 1000
UNITS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 25.4e-3}
MAY_OVERLAP = 1e-3  # of the smaller part: touching faces of a drawing never fit exactly
LEAST_CELLS = 2  # through the thinnest part
INSIDE = (
    np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6
)  # three points in a triangle, exact for quadratic functions


class MeshPart(Settings):
    """One mesh with one material.

    Parameters
    ----------
    mesh : str
        Path, relative to this file, of an STL file: a closed surface.
    name : str, optional
        Name used in messages and results; the file's name unless given.
    material : str
        A name from `materials`.
    magnetization : Angles, dict or sequence (3,), no unit, optional
        Direction in the undeformed part: [x, y, z], normalized, or {azimuth: ..., elevation:
        ...}; [0, 0, 0], unmagnetized, unless given.
    clamp : bool, optional
        Whether the part is held; false unless given.

    Examples
    --------
    >>> from magmpm import MeshPart
    >>> hub = MeshPart(
    ...     mesh="data/scenes/gallery/meshes/gripper_hub.stl", material="silicone", clamp=True
    ... )
    >>> hub.name
    'gripper_hub'
    """

    mesh: Annotated[
        str,
        BeforeValidator(partial(read_mesh, key="body.parts.meshes")),
        WithJsonSchema({"type": "string"}),
    ] = Field(
        description="Path, relative to this file, of an STL file: a closed surface.",
        examples=["meshes/base.stl"],
    )
    name: str = Field(
        default="",
        max_length=100,
        description="Name used in messages and results; the file's name unless given.",
        examples=["base"],
    )
    material: str = Field(description="A name from `materials`.", examples=["silicone"])
    magnetization: Direction = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "Direction in the undeformed part: [x, y, z], normalized, or {azimuth: ..., elevation:"
            " ...}; [0, 0, 0], unmagnetized, unless given."
        ),
        examples=[[0, 0, 1]],
    )
    clamp: bool = Field(
        default=False,
        strict=True,
        description="Whether the part is held; false unless given.",
        examples=[True],
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, data: Any) -> Any:
        """A part without a name has its file's."""
        if isinstance(data, Mapping) and not data.get("name"):
            mesh = data.get("mesh")
            if isinstance(mesh, (str, Path)) and not str(mesh).startswith(PREFIX):
                return {**data, "name": Path(mesh).stem[:100]}
        return data

    @property
    def volume(self) -> float:
        """Volume in the mesh's unit cubed."""
        return volume_of(unpack_mesh(self.mesh).triangles)


class Parts(BodyShape):
    """Closed STL meshes, one a part. Parts that touch hold together.

    Parameters
    ----------
    unit : {'um', 'mm', 'cm', 'm', 'inch'}
        Unit of the numbers in the STL files, which do not say it.
    spacing : float or str, m, optional
        Cell size; the thinnest part's thickness over `cells_across` unless given.
    meshes : sequence of MeshPart
        The parts.
    tip : str or sequence (3,) of float or str, m, optional
        The tip in results: the name of a part (its center), or a point of a moving part
        in the undeformed body, such as the middle of an end face. Unless given, parts
        have no tip.

    Examples
    --------
    >>> from magmpm import MeshPart, Parts
    >>> hub = MeshPart(
    ...     mesh="data/scenes/gallery/meshes/gripper_hub.stl", material="silicone", clamp=True
    ... )
    >>> arm = MeshPart(
    ...     mesh="data/scenes/gallery/meshes/gripper_inner_1.stl", material="silicone", name="arm"
    ... )
    >>> [part.name for part in Parts(unit="mm", meshes=[hub, arm]).meshes]
    ['gripper_hub', 'arm']
    """

    clamp_key: ClassVar[str] = "meshes"

    unit: Literal["um", "mm", "cm", "m", "inch"] = Field(
        description="Unit of the numbers in the STL files, which do not say it.", examples=["mm"]
    )
    spacing: Width | None = Field(
        default=None,
        description="Cell size; the thinnest part's thickness over `cells_across` unless given.",
        examples=["0.5 mm"],
    )
    meshes: tuple[MeshPart, ...] = Field(
        min_length=1,
        max_length=MAX_PARTS,
        description="The parts.",
        examples=[[{"mesh": "meshes/base.stl", "material": "silicone", "clamp": True}]],
    )

    tip: Tip | None = Field(
        default=None,
        description=(
            "The tip in results: the name of a part (its center), or a point of a moving part in "
            "the undeformed body, such as the middle of an end face. Unless given, parts have no "
            "tip."
        ),
        examples=["arm", ["18 mm", "0 mm", "0 mm"]],
    )

    @field_validator("meshes")
    @classmethod
    def _separate(cls, meshes: tuple[MeshPart, ...], info: ValidationInfo) -> tuple[MeshPart, ...]:
        unit = info.data.get("unit")
        sizes = (
            []
            if unit is None
            else [size_fault(unpack_mesh(part.mesh), unit, UNITS[unit]) for part in meshes]
        )
        for k, found in enumerate(sizes):
            if found is not None:
                raise fault(*found, (k, "mesh"))
        for i, j, shared, smaller in overlaps([part.mesh for part in meshes]):
            if shared > MAY_OVERLAP * smaller:
                raise fault(
                    f"parts must not overlap: {meshes[j].name or f'part {j + 1}'} shares"
                    f" {shared:.3g} {unit or ''}^3 with {meshes[i].name or f'part {i + 1}'},"
                    f" {100 * shared / smaller:.3g} % of the smaller",
                    "move or trim one of them; faces may touch, and are then joined",
                    (j, "mesh"),
                )
        return meshes

    @model_validator(mode="after")
    def _some_move_and_none_is_too_thin(self) -> Parts:
        if all(part.clamp for part in self.meshes):
            raise fault(
                "at least one part must be free to move",
                "remove `clamp: true` from the parts that should move",
                ("meshes",),
            )
        if self.spacing is not None:
            for i, part in enumerate(self.meshes):
                thickness = self.part_thickness(i)
                if not part.clamp and thickness < LEAST_CELLS * self.spacing * (1 - 1e-6):
                    remedy = (
                        f"at most `spacing: {1e3 * thickness / LEAST_CELLS:.3g} mm`, or leave"
                        " spacing out"
                    )
                    rule = (
                        f"a part must be at least {LEAST_CELLS} cells thick:"
                        f" {part.name or f'part {i + 1}'} is {1e3 * thickness:.3g} mm,"
                        f" {thickness / self.spacing:.2g} cells of {1e3 * self.spacing:.3g} mm"
                    )
                    whole = self.part_length(i)
                    if whole >= self.spacing:
                        raise fault(rule, remedy, ("spacing",))
                    # Not even a cell long: no spacing that suits the others suits it.
                    raise fault(
                        f"{rule}; all of it is {length(whole)} long",
                        self._other_unit(i, remedy),
                        ("meshes", i, "mesh"),
                    )
        return self

    @model_validator(mode="after")
    def _tip_is_a_place_that_moves(self) -> Parts:
        most_names_listed = 8  # names that a message lists
        if isinstance(self.tip, str):
            names = self.part_names()
            moving = [name for name, part in zip(names, self.meshes, strict=True) if not part.clamp]
            if self.tip not in moving:
                held = self.tip in names
                near = difflib.get_close_matches(self.tip, moving, n=1)
                listed = ", ".join(moving[:most_names_listed]) + (
                    ", ..." if len(moving) > most_names_listed else ""
                )
                raise fault(
                    "the tip must be"
                    f" {'a part that moves' if held else 'the name of a part that moves'}:"
                    f" {listed}",
                    (
                        f'did you mean "{near[0]}"?'
                        if near and not held
                        else "name one of them, or write a point: [18 mm, 0 mm, 0 mm]"
                    ),
                    ("tip",),
                )
        elif self.tip is not None:
            far, nearest = self._nearest(np.array(self.tip))
            if far > TOUCHING_DISTANCE * self.length:
                raise fault(
                    "the tip must be a point in or on a part that moves: "
                    f"this is {length(far)} away from {self.part_names()[nearest]}, the nearest",
                    "write a point of the undeformed parts, as the STL files have them",
                    ("tip",),
                )
        return self

    def _nearest(self, point: Array) -> tuple[float, int]:
        """Distance (m) of the part nearest to a point (3,) m, of those that can move, and its number."""
        unit = UNITS[self.unit]
        small = TOUCHING_DISTANCE * self.length / unit
        free = [i for i, part in enumerate(self.meshes) if not part.clamp]
        far = [unit * (distance_to(self.meshes[i].mesh, point / unit, small) + small) for i in free]
        nearest = int(np.argmin(far))
        return (0.0 if far[nearest] <= unit * small else far[nearest]), free[nearest]

    def hollow_parts(self) -> list[str]:
        names = self.part_names()
        return [names[k] for k in hollow([part.mesh for part in self.meshes])]

    def part_names(self) -> tuple[str, ...]:
        return different_names([part.name for part in self.meshes])

    def tip_weights(self, grid: Grid, particles: Particles) -> Array | None:
        if self.tip is None:
            return None
        if isinstance(self.tip, str):
            mine = particles.segment == self.part_names().index(self.tip)
            return np.where(mine, particles.volume, 0.0) / particles.volume[mine].sum()
        point = np.array(self.tip)
        component = self.components(particles)
        part = particles.segment == self._nearest(point)[1]
        held = np.array([part.clamp for part in self.meshes])[particles.segment]
        mine = (component == component[part][0]) & ~held
        return point_weights(grid, particles, mine, point)

    def part_thickness(self, index: int) -> float:
        """Thickness of a part, m: see surface_mesh.thickness_of."""
        return thickness_of(self.meshes[index].mesh) * UNITS[self.unit]

    def part_length(self, index: int) -> float:
        """Longest side of the box around a part, m."""
        return (
            float(np.ptp(unpack_mesh(self.meshes[index].mesh).vertices, axis=0).max())
            * UNITS[self.unit]
        )

    def _other_unit(self, index: int, otherwise: str) -> str:
        """Remedy for a part that is far too small in the unit of all parts: the unit its file may be in, or else `otherwise`."""
        assert self.spacing is not None
        for unit, scale in UNITS.items():  # from the smallest on
            times = scale / UNITS[self.unit]
            if times > 1.0 and times * self.part_thickness(index) >= LEAST_CELLS * self.spacing * (
                1 - 1e-6
            ):
                return (
                    f"is its file in {unit}? It would then be "
                    f"{length(times * self.part_length(index))} long: export it in {self.unit}, "
                    f"as `unit` says, or write `unit: {unit}` if all parts are; if it really is "
                    f"this small, {otherwise}"
                )
        return otherwise

    def surfaces(self) -> list[tuple[Array, NDArray[np.integer]]]:
        """Each part's surface: vertices (v, 3) m, and faces (f, 3) by vertex, counter-clockwise from outside."""
        meshes = [unpack_mesh(part.mesh) for part in self.meshes]
        return [(mesh.vertices * UNITS[self.unit], mesh.faces) for mesh in meshes]

    def triangles(self) -> list[Array]:
        """Corners (f, 3, 3) m of each part's surface."""
        return [vertices[faces] for vertices, faces in self.surfaces()]

    @property
    def thickness(self) -> float:
        """Thickness of the thinnest part that can move, m."""
        return min(self.part_thickness(i) for i, part in enumerate(self.meshes) if not part.clamp)

    @property
    def length(self) -> float:
        """Longest side of the box around the parts, m."""
        return float(np.ptp(self._corners(), axis=0).max()) * UNITS[self.unit]

    def box(self) -> tuple[Vector, Vector]:
        (x0, y0, z0), (x1, y1, z1) = (self._corners() * UNITS[self.unit]).tolist()
        return (x0, y0, z0), (x1, y1, z1)

    def _corners(self) -> Array:
        """Lower and upper corner of the box around the parts, (2, 3) in their unit."""
        vertices = np.concatenate([unpack_mesh(part.mesh).vertices for part in self.meshes])
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    def _gaps(self, within: float) -> Array:
        """Between the parts, (parts, parts) m: where boxes come within this distance (m) that of the surfaces, else of the boxes."""
        corners = [vertices for vertices, _ in self.surfaces()]
        low = np.array([each.min(axis=0) for each in corners])
        high = np.array([each.max(axis=0) for each in corners])
        found = np.linalg.norm(
            np.maximum(np.maximum(low[:, None] - high, low - high[:, None]), 0.0), axis=2
        )
        unit = UNITS[self.unit]
        for i, j in np.argwhere(np.triu(found < within, 1)):
            found[i, j] = found[j, i] = unit * gap(
                self.meshes[i].mesh, self.meshes[j].mesh, within / unit
            )
        return np.asarray(found)

    @property
    def clamp(self) -> Literal["parts", "none"]:
        """parts where some part is held."""
        return "parts" if any(part.clamp for part in self.meshes) else "none"

    def regions(self) -> tuple[Region, ...]:
        """The parts, in the file's order."""
        return tuple(
            Region(
                part.name or f"part {i + 1}",
                ("parts", "meshes", i),
                part.material,
                part.magnetization,
                0.0 if part.clamp else self.part_thickness(i),
                part.clamp,
            )
            for i, part in enumerate(self.meshes)
        )

    def cell_size(self, cells_across: int) -> float:
        """Width of the grid's cells as requested, m: `spacing` where it is given."""
        return self.spacing or super().cell_size(cells_across)

    def cell_setting(self, cells_across: int) -> tuple[str, str, str]:
        if self.spacing is None:
            return super().cell_setting(cells_across)
        return "body.parts.spacing", f"{1e3 * self.spacing:.4g} mm", "a larger spacing"

    def grid(self, cells_across: int, knots: Knots = EVEN) -> Grid:
        """The grid in the undeformed body: knots on the box around the parts that move. Raises SceneError where it has too many cells;
        ValueError for knots that are those of a straight body."""
        return self._grid(cells_across, knots)[0]

    def _grid(self, cells_across: int, knots: Knots) -> tuple[TurnedGrid, list[ClampPlane]]:
        """The grid, at rest along axes in which it has few cells, and the planes on which held parts hold the others."""
        if knots not in (EVEN, AT_REST):
            raise ValueError("knots: the grid of parts follows from their meshes")
        size = self.cell_size(cells_across)
        triangles = self.triangles()
        held = [part.clamp for part in self.meshes]
        axes = np.eye(3)
        if knots.at_rest:
            pairs = list(zip(triangles, held, strict=True))
            free = [mesh for mesh, still in pairs if not still]
            axes = axes_of_parts(free, [mesh for mesh, still in pairs if still], size)
        grid, planes = grid_of_parts([mesh @ axes for mesh in triangles], held, size)
        return TurnedGrid(grid.origin, grid.spacing, grid.cells, axes=axes), planes

    def discretize(
        self, cells_across: int, particles_per_cell: int, knots: Knots = EVEN
    ) -> Discretization:
        grid, planes = self._grid(cells_across, knots)
        triangles = self.triangles()
        made = part_particles(grid, [mesh @ grid.axes for mesh in triangles], particles_per_cell)
        particles = replace(made, position=made.position @ grid.axes.T)
        return Discretization(grid, particles, part_errors(particles, triangles), tuple(planes))

    def fewest_particles(
        self, cells_across: int, particles_per_cell: int, *, around: bool = False
    ) -> float:
        """The number of particles of its volume in full cells; cut cells have more for theirs."""
        volume = sum(volume_of(triangles) for triangles in self.triangles())
        return float(volume / np.prod(self.grid(cells_across).spacing) * particles_per_cell**3)

    def surface(self, grid: Grid, *, base: bool) -> SurfacePoints:
        return parts_surface(self.triangles(), float(grid.spacing.min()))

    def wetted(self, grid: Grid, *, base: bool) -> WettedSurface:
        return wetted_parts(self.triangles(), self._component(), float(grid.spacing.min()))

    def held_surface(self, grid: Grid) -> SurfacePoints:
        """Points on the faces of parts that can move where they lie on parts that are held, or across a gap from them."""
        held_edge = (
            0.25  # of a cell: longest edge of triangles whose points tell where a face is held
        )
        # times that: longest edge of those that are left out where no held part is near
        longest_left_out_edge = 16
        reach = self._reach_to_held(float(grid.spacing.min()))
        longest = held_edge * float(grid.spacing.min())
        triangles = self.triangles()
        still = [mesh for part, mesh in zip(self.meshes, triangles, strict=True) if part.clamp]
        held = np.ascontiguousarray(np.concatenate(still))
        position = []
        area = []
        region = []
        for k, (part, mesh) in enumerate(zip(self.meshes, triangles, strict=True)):
            if part.clamp:
                continue
            within = reach[k]
            coarse = cut(mesh[meets(mesh, held, within)], longest_left_out_edge * longest)
            pieces = cut(_pieces_near(coarse, held, within), longest)
            places = np.ascontiguousarray((INSIDE @ pieces).reshape(-1, 3))
            on = to_triangles(places, held) <= within
            thirds = np.linalg.norm(face_normals(pieces), axis=1) / 6
            position.append(places[on])
            area.append(np.repeat(thirds, 3)[on])
            region.append(np.full(int(on.sum()), k))
        return SurfacePoints(np.concatenate(position), np.concatenate(area), np.concatenate(region))

    def _reach_to_held(self, cell: float) -> Array:
        """Distance (parts,) m within which each part's faces are held by parts that are.

        Parts that hang on nothing else and are less than two cells from a held part move as if joined to it: their faces across the gap are
        held, and half a gap beyond its narrowest place.
        """
        touching = TOUCHING_DISTANCE * self.length
        held = np.array([part.clamp for part in self.meshes])
        component = self._component()
        gap = self._gaps(3 * cell)[:, held].min(axis=1)
        across = ~np.isin(component, component[held]) & (gap < 2 * cell)
        return np.where(across, 1.5 * gap, touching)

    def solids(self, cell: float, particles: Particles) -> Solids:
        component = self.components(particles)
        scale = UNITS[self.unit]
        thin = NEEDLE * cell / UNITS[self.unit]
        parts = [
            np.unique(particles.segment[component == one])
            for one in range(int(component.max()) + 1)
        ]
        outlines = [[scale * outline(self.meshes[k].mesh, thin) for k in of] for of in parts]
        return mesh_solids(outlines, cell, TOUCHING_DISTANCE * self.length)

    def part_of(self, particles: Particles) -> NDArray[np.integer]:
        return particles.segment

    def components(self, particles: Particles) -> Index:
        """Connected component that each particle (n,) is in, from 0: parts that touch are of one."""
        return connected_components(self._touching(), particles.cell, particles.segment)

    def _touching(self) -> Mask:
        near = TOUCHING_DISTANCE * self.length
        return self._gaps(2 * near) <= near

    @property
    def in_one_piece(self) -> bool:
        """True if there are several parts, and each is connected to every other one."""
        return len(self.meshes) > 1 and not self._component().any()

    def _component(self) -> NDArray[np.int32]:
        """Connected component that each part is in, from 0."""
        from scipy.sparse.csgraph import connected_components

        return np.asarray(connected_components(self._touching(), directed=False)[1])

    def warnings(self, cells_across: int, *, one_grid: bool) -> list[str]:
        """Warnings of what is near and does not touch, which one grid moves as one; and of specks."""
        return [*self._near(self.cell_size(cells_across), one_grid), *self._specks()]

    def _specks(self) -> list[str]:
        """Warnings of free parts that are so small beside the body that their files may be in another unit."""
        # of the body's length: with two cells through such a part the body would have 200 a side; units
        # differ by ten and more
        speck = 0.01
        found = []
        for i, region in enumerate(self.regions()):
            if not region.held and self.part_length(i) < speck * self.length:
                found.append(
                    f"body.parts: {region.name} is {length(self.part_length(i))} long, all parts"
                    f" together {length(self.length)}: are all files in {self.unit}?"
                )
        return found

    def _near(self, cell: float, one_grid: bool) -> list[str]:
        """Warnings of parts, or solids of one part, that share nodes of the grid and do not touch."""
        regions = self.regions()
        gaps = self._gaps(3 * cell)
        least = TOUCHING_DISTANCE * self.length
        unit = UNITS[self.unit]
        told = []
        for part, region in zip(
            self.meshes, regions, strict=True
        ):  # they are on one grid in motion, too
            apart = unit * nearest_solids(part.mesh, 3 * cell / unit)
            if not region.held and least < apart < 2 * cell:
                told.append(
                    f"body.parts: two solids of {region.name} are {1e3 * apart:.3g} mm apart, less"
                    f" than two cells of {1e3 * cell:.3g} mm: they move as if joined"
                )
        return told + [
            f"body.parts: {regions[i].name} and {regions[j].name} are {1e3 * gaps[i, j]:.3g} mm"
            f" apart, less than two cells of {1e3 * cell:.3g} mm: they move as if joined"
            for i, j in itertools.combinations(range(len(regions)), 2)
            if one_grid
            and least < gaps[i, j] < 2 * cell
            and not (regions[i].held and regions[j].held)
        ]


def different_names(given: Sequence[str]) -> tuple[str, ...]:
    """Names of parts, each another: one without a name has its number, and so have those that share one."""
    names = [name or f"part {i + 1}" for i, name in enumerate(given)]
    return tuple(
        f"{name} (part {i + 1})" if names.count(name) > 1 else name for i, name in enumerate(names)
    )


def _pieces_near(pieces: Array, others: Array, within: float) -> Array:
    """Those of triangles (n, 3, 3) m that may come within so much (m) of others (m, 3, 3) m."""
    center = pieces.mean(axis=1)
    radius = np.linalg.norm(pieces - center[:, None], axis=2).max(axis=1, initial=0.0)
    return np.ascontiguousarray(pieces[to_triangles(center, others) <= within + radius])
