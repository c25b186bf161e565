"""The external field: B(x, t), its derivatives, and where it is known.

`external_field(...)` makes a Field of its sources: dipoles in closed form; magnets and coils on a table, or as clouds of dipoles where
one turns or the body surrounds it; a measured map as the spline through it. Kernels evaluate the same data (fields.kernels).
In the sources' frame nothing changes in time: a schedule changes strength and place of that frame (fields.schedule).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import LeftField, SceneError, in_mm
from magmpm.fields import table
from magmpm.fields.kernels import fields_at, gradients_at
from magmpm.fields.magnets import (
    Box,
    Solid,
    bare_dipoles,
    cut_for,
    dipole_rows,
    exact,
    frame_of,
    parting,
    polarization,
    reach,
    reach_along,
    seen_from_sources,
    taken,
    wires,
)
from magmpm.fields.schedule import end_time, places, sample_times
from magmpm.fields.sources import FieldSource, Tabulation
from magmpm.inputs.vectors import Vector

Nodes = tuple[Box, tuple[int, ...]]


@dataclass(frozen=True)
class Limit:
    """A box, seen from the sources, outside of which a source is not known.

    Attributes
    ----------
    box : Box
        The box.
    name : str
        Of the source.
    remedy : str
        For the message.
    """

    box: Box
    name: str
    remedy: str


@dataclass(frozen=True)
class Field:
    """A field of any sources over time.

    Attributes
    ----------
    source : FieldSource
        The sources, as the scene says them.
    data : array (m,)
        The sources as the kernels take them (fields.kernels).
    solids : tuple of tuple[Solid, float]
        Magnets, which the body can't enter, each with the distance (m) from which on the field
        is accurate.
    limits : tuple of Limit
        Boxes outside of which it is not known.
    errors : table.Errors or None
        Of the table of magnets and coils, if there is one.
    warnings : list of str
        What a user should know, a sentence each.
    cell : float, m
        Width of a grid cell of the body: nearer to a point dipole its field has no meaning.
    nodes : Nodes or None
        Box and numbers of nodes of that table.
    """

    source: FieldSource
    data: Array
    solids: tuple[tuple[Solid, float], ...] = ()
    limits: tuple[Limit, ...] = ()
    errors: table.Errors | None = None
    warnings: list[str] = field(default_factory=list)
    cell: float = 0.0
    nodes: Nodes | None = None

    def at(self, points: Array, time: float | None = None) -> Array:
        """Find the flux density.

        Parameters
        ----------
        points : array (n, 3), m
            Where.
        time : float, s, optional
            When; the end of the schedule unless given.

        Returns
        -------
        array (n, 3), T
            B at each point.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_field([0, 0, 0.004])
        >>> scene.external_field().at([[0.01, 0.0, 0.0]]).tolist()  # T
        [[0.0, 0.0, 0.004]]
        """
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=float)
        place = places(self.source, _times(time))[0]
        if not self.source.varies:
            return np.tile(place["uniform"], (len(points), 1))
        out = np.empty((len(points), 3))
        fields_at(place, self.data, points, out)
        return out

    def gradient(self, points: Array, time: float | None = None) -> Array:
        """Find the gradient of the flux density.

        Parameters
        ----------
        points : array (n, 3), m
            Where.
        time : float, s, optional
            When; the end of the schedule unless given.

        Returns
        -------
        array (n, 3, 3), T/m
            dB_i/dx_j at each point.
        """
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=float)
        out = np.empty((len(points), 3, 3))
        gradients_at(places(self.source, _times(time))[0], self.data, points, out)
        return out

    def outside_domain(
        self, points: Array, time: float | None = None
    ) -> tuple[str, str, str] | None:
        """Find whether a body is where the field is not known.

        Parameters
        ----------
        points : array (n, 3), m
            Of the body.
        time : float, s, optional
            When; the end of the schedule unless given.

        Returns
        -------
        tuple[str, str, str] or None
            What happened, the source, the remedy; None where all is well.
        """
        bare = bare_dipoles(self.source)
        if not (self.solids or self.limits or bare) or len(points) == 0:
            return None
        place = places(self.source, _times(time))[0]
        local = (np.asarray(points) - place["origin"]) @ place["frame"].reshape(3, 3)
        for solid, distance in self.solids:
            depth = solid.depth(local)
            worst = int(np.argmax(depth))
            if depth[worst] > 0:
                return (
                    (
                        f"the body's point at {in_mm(points[worst])} is inside {solid.name}, center"
                        f" {in_mm(_outward(place, solid.position))}"
                    ),
                    solid.name,
                    (
                        "move the magnet away, or weaken its pull: only contact with `walls` "
                        "stops a body at a magnet's surface"
                    ),
                )
            if depth[worst] > -distance:
                return (
                    (
                        f"the body's point at {in_mm(points[worst])} is within {1e3 * distance:.3g}"
                        f" mm of {solid.name}, where its field is not known"
                    ),
                    solid.name,
                    (
                        "start with the body closer to the magnet, or raise "
                        "field.tabulation.tolerance"
                    ),
                )
        for name, position in bare:
            distance = np.linalg.norm(local - position, axis=1)
            worst = int(np.argmin(distance))
            if distance[worst] < self.cell:
                return (
                    (
                        f"the body's point at {in_mm(points[worst])} is {1e3 * distance[worst]:.3g}"
                        f" mm from the point dipole {name} at {in_mm(_outward(place, position))},"
                        f" nearer than a cell of the grid, {1e3 * self.cell:.3g} mm"
                    ),
                    name,
                    (
                        "move the dipole away, or give it its size: its `diameter`, or a `magnet`"
                        " in its place"
                    ),
                )
        for limit in self.limits:
            out = ~limit.box.holds(local)
            if out.any():
                point = points[int(np.argmax(out))]
                return (
                    (
                        f"the body's point at {in_mm(point)} is outside the box where "
                        f"{limit.name} is known, {limit.box.text()}"
                    ),
                    limit.name,
                    limit.remedy,
                )
        return None

    def check(self, points: Array, time: float | None = None) -> None:
        """Refuse a body that is in a magnet, or where the field is not known.

        Parameters
        ----------
        points : array (n, 3), m
            Of the body.
        time : float, s, optional
            When; the end of the schedule unless given.

        Raises
        ------
        LeftField
            Where it is.
        """
        found = self.outside_domain(points, time)
        if found is not None:
            raise LeftField(f"{found[0]}; {found[2]}")

    def check_at_rest(self, points: Array, moving: bool, time: float | None = None) -> None:
        """Refuse a scene whose body is in a magnet, or where the field is not known.

        Parameters
        ----------
        points : array (n, 3), m
            Of the body.
        moving : bool
            Whether the scene is a motion.
        time : float, s, optional
            When. Unless given: 0 if moving, the schedule's end at rest.

        Raises
        ------
        SceneError
            Where it is.
        """
        if time is None:
            time = 0.0 if moving else end_time(self.source)
        found = self.outside_domain(points, time)
        if found is not None:
            when = "" if self.source.over_time is None else f" at {time:g} s"
            rule = (
                "the undeformed body is where the field is known, outside of every magnet, and a"
                " cell away from every point dipole"
            )
            raise SceneError(found[1], found=found[0] + when, rule=rule, remedy=found[2])


def external_field(
    source: FieldSource,
    box: tuple[Vector, Vector],
    *,
    anchored: bool,
    cell: float,
    nodes: Nodes | None = None,
) -> Field:
    """Make the field of sources around a body. Tables are made once for each source and box; that takes seconds for magnets and coils.

    Parameters
    ----------
    source : FieldSource
        The sources.
    box : tuple of (float, float, float), m
        Lower and upper corner of the undeformed body.
    anchored : bool
        Whether it is held at its base.
    cell : float, m
        Width of a grid cell.
    nodes : Nodes, optional
        Of the table, as another field has them: between tables of other nodes a field jumps by
        their errors as its sources move.

    Returns
    -------
    Field
        The field.

    Raises
    ------
    SceneError
        For a magnet in or too near to the body, a map that does not cover it, or where magpylib
        is missing.
    """
    if not source.varies:
        return Field(source, np.zeros(2))
    found = (
        _kept(source, *box, anchored) if nodes is None else _around(source, *box, anchored, nodes)
    )
    return replace(found, cell=cell)  # tables do not depend on the cell


@lru_cache(maxsize=64)  # the places of a magnet in a table of measurements, each a megabyte
def _kept(source: FieldSource, lower: Vector, upper: Vector, anchored: bool) -> Field:
    return _around(source, lower, upper, anchored, None)


def _around(
    source: FieldSource, lower: Vector, upper: Vector, anchored: bool, nodes: Nodes | None
) -> Field:
    body = Box(np.array(lower), np.array(upper))
    seen = seen_from_sources(source, body)
    found = [(solid, 0.0) for solid in taken(source) if solid.ball]
    dipoles = [dipole_rows(source.dipole or ())]
    tables = []
    limits = []
    warnings: list[str] = []
    errors = None
    if source.magnet or source.coils:
        options = source.tabulation or Tabulation()
        function = exact(source)
        named = [*taken(source), *wires(source)]
        named = [solid for solid in named if not solid.ball]
        boxes = [] if nodes else _table_boxes(source, options, body, seen, anchored, named)
        if source.tabulation is None and not source.coils:
            # magnets may move so far that a table would be many times as large as the body's reach
            boxes = [box for box in boxes if box.volume <= 3.0 * reach(body, anchored).volume]
        clouds = None if boxes or nodes else _clouds(source, options, body)
        if clouds is None:
            if nodes is None:
                box, packed, errors = _tabulated(function, boxes, seen, named, options)
                nodes = (box, tuple(int(n) for n in packed[6:9]))
            else:
                box = nodes[0]
                packed = table.on_nodes(function, *nodes)
            tables.append(packed)
            reason = f" (which ends before {', '.join(box.cut)})" if box.cut else ""
            remedy = (
                f"give a larger box, field.tabulation.lower and upper, that no magnet is in{reason}"
            )
            limits.append(Limit(box, _names(named), remedy))
            found += [(solid, 0.0) for solid in named if not solid.name.startswith("field.coils")]
        else:
            dipoles += clouds[0]
            found += clouds[1]
    if source.map is not None:
        packed, limit, odd = _map(source, body, seen)
        tables.append(packed)
        limits.append(limit)
        warnings += odd
    rows = np.concatenate(dipoles)
    data = np.concatenate([[len(rows), len(tables)], rows.ravel(), *tables])
    return Field(source, data, tuple(found), tuple(limits), errors, warnings, nodes=nodes)


def _tabulated(
    function: Callable[[Array], Array],
    boxes: list[Box],
    seen: Box,
    named: list[Solid],
    options: Tabulation,
) -> tuple[Box, Array, table.Errors]:
    """The box of the table, the table and its errors: of the first box over which a table is exact.

    Next to the edge of a magnet none is: then the box keeps off it, and if that is not enough, farther, though it loses more.
    Raises SceneError where no box is left, or the box is given.
    """
    failed: SceneError | None = None
    for box in boxes:
        tried: list[Box] = []
        far = 0.05 * float((box.upper - box.lower).max())  # some seven nodes of the finest table
        for off in (None, 0.0, far) if options.lower is None else (None,):
            cut = box if off is None else _cut(box, seen, named, keeps_off=off)
            if cut is None or any(cut is one for one in tried):
                continue
            tried.append(cut)
            try:
                return cut, *table.tabulate(function, cut, options.tolerance, _names(named))
            except SceneError as error:
                failed = error
    assert failed is not None
    raise failed


def _table_boxes(
    source: FieldSource,
    options: Tabulation,
    body: Box,
    seen: Box,
    anchored: bool,
    named: list[Solid],
) -> list[Box]:
    """Boxes for the table, the best first; none where a magnet can't be kept out of one and must become a cloud of dipoles.

    Where a magnet is in the way of a box along the axes of space, boxes along the shortest way from the body to a magnet are tried too: a
    plane perpendicular to it parts them wherever they are apart, however the magnet is tilted. What a box loses least by its cuts is best.
    """
    if options.lower is not None and options.upper is not None:
        box = seen_from_sources(source, Box(np.array(options.lower), np.array(options.upper)))
        for solid in named:
            if _cut(box, seen, [solid]) is not box:
                rule = (
                    f"no magnet or wire may be in the table's box ({box.text()} as the sources"
                    " see it)"
                )
                raise SceneError(
                    "field.tabulation",
                    found=f"{solid.name} is in the box",
                    rule=rule,
                    remedy="give a smaller box",
                )
        return [box]
    whole = seen_from_sources(source, reach(body, anchored))
    plain = _cut(whole, seen, named)
    if plain is whole:
        return [whole]
    found = [] if plain is None else [plain]
    for solid in named:
        way = None if solid.name.startswith("field.coils") else parting(seen, solid)
        if way is not None:
            cut = _cut(reach_along(frame_of(way.tolist()), source, body, anchored), seen, named)
            found += [] if cut is None else [cut]
    return sorted(
        found, key=lambda box: -box.volume
    )  # of equal ones the first, along the axes of space


def _cut(box: Box, seen: Box, named: list[Solid], *, keeps_off: float | None = None) -> Box | None:
    """The box, cut for magnets and wires (fields.magnets.cut_for). seen: the undeformed body in the sources' frame."""
    return cut_for(
        box,
        seen.turned(box.frame),
        _arcs([solid.turned(box.frame) for solid in named]),
        keeps_off=keeps_off,
    )


def _arcs(named: list[Solid]) -> list[Solid]:
    """Magnets unchanged, coils as the boxes of arcs of their wire: a body may be inside a coil."""
    arcs = 48  # pieces of a coil's wire, each in a box
    out = []
    for solid in named:
        if not solid.name.startswith("field.coils"):
            out.append(solid)
            continue
        radius = solid.half[0]
        thin = solid.half[2]
        for angle in 2 * np.pi * (np.arange(arcs) + 0.5) / arcs:
            center = solid.position + radius * (
                solid.frame @ np.array([np.cos(angle), np.sin(angle), 0.0])
            )
            half = np.array([thin + radius * np.sin(np.pi / arcs)] * 3)
            out.append(Solid(solid.name, center, np.eye(3), half, False))
    return out


def _clouds(
    source: FieldSource, options: Tabulation, body: Box
) -> tuple[list[Array], list[tuple[Solid, float]]]:
    """All magnets as clouds of dipoles, and the distance (m) from which on each is accurate."""
    if source.coils:
        remedy = (
            "move the coil away from the body, or put the body's reach in a box of your own,"
            " field.tabulation.lower and upper"
        )
        raise SceneError(
            "field.coils",
            found="no plane parts their wires from the body",
            rule="a coil that turns, or whose wire the body goes round, can't be put on a table",
            remedy=remedy,
        )
    corners = np.stack(
        np.meshgrid(*np.linspace(body.lower, body.upper, 9).T, indexing="ij"), axis=-1
    ).reshape(-1, 3)
    clouds = []
    near = []
    blocks = [solid for solid in taken(source) if not solid.ball]
    for solid, magnet in zip(blocks, source.magnet or (), strict=True):
        depth = -np.inf
        for time, place in zip(
            sample_times(source), places(source, sample_times(source)), strict=True
        ):
            local = (corners - place["origin"]) @ place["frame"].reshape(3, 3)
            depth = max(depth, float(solid.depth(local).max()))
            if depth >= 0:
                when = "" if source.over_time is None else f" at {time:.4g} s"
                raise SceneError(
                    solid.name,
                    found=(
                        f"the magnet, center {in_mm(_outward(place, solid.position))}{when}, is in"
                        f" the box around the body, {body.text()}"
                    ),
                    rule="the undeformed body must be outside of every magnet, at all times",
                    remedy="move the magnet away",
                )
        distance = -0.5 * depth  # down to which the cloud is accurate
        alone = FieldSource(magnet=(magnet,))
        clouds.append(
            table.cloud(solid, polarization(magnet), exact(alone), distance, options.tolerance)
        )
        near.append((solid, distance))
    return clouds, near


def _map(source: FieldSource, body: Box, seen: Box) -> tuple[Array, Limit, list[str]]:
    """Table, limit and warnings of a measured map. Raises SceneError where it does not cover the undeformed body with a margin."""
    assert source.map is not None
    grid = source.map.table
    spacing = np.array(grid.spacing)
    lower = np.array(grid.lower) + source.map.position
    box = Box(lower, lower + spacing * (np.array(grid.shape) - 1))
    short = np.maximum(
        box.lower - (seen.lower - spacing), seen.upper + spacing - box.upper
    )  # m, along x, y, z
    if np.any(short > 1e-3 * spacing):  # the tolerance of its planes (measured_map)
        worst = int(np.argmax(short))
        rule = (
            f"a map must cover the undeformed body, {seen.text()} as the map sees it, with a margin"
            f" of one of its spacings ({', '.join(f'{1e3 * h:.3g}' for h in spacing)} mm)"
        )
        remedy = "measure or compute a larger map, or place it with field.map.position"
        found = (
            f"the map reaches over {box.text()}, and lacks {1e3 * short[worst]:.3g} mm along"
            f" {'xyz'[worst]}"
        )
        raise SceneError("field.map", found=found, rule=rule, remedy=remedy)
    packed, errors = table.of_values(lower, spacing, grid.array())
    warnings = [
        f"field.map: the map's {name} is {100 * size:.0f} % of its gradient, and should be zero "
        "in a magnetic field; the force has an error of that size"
        for name, size in (("curl", errors.curl), ("divergence", errors.divergence))
        if size > 0.05
    ]
    return packed, Limit(box, "field.map", "give a map that covers where the body goes"), warnings


def _names(named: list[Solid]) -> str:
    return ", ".join(dict.fromkeys(solid.name for solid in named))


def _times(time: float | None) -> Array | None:
    return None if time is None else np.array([time])


def _outward(place: np.void, point: Array) -> Array:
    """A point of the sources' frame in space."""
    return np.asarray(place["frame"].reshape(3, 3) @ point + place["origin"])
