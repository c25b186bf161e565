"""Nodes that follow what holds a body, where that is moved: their coefficient is its displacement.

Splines sum to one, so a face, or a held part, whose nodes all have the same coefficient moves by it, exactly.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.body_shape import BodyShape, Discretization
from magmpm.bodies.grid import ClampPlane, Grid
from magmpm.errors import SceneError

Driven = tuple[tuple[str, NDArray[np.bool_]], ...]  # by what moves them: which of the grid's nodes follow, in the grid's shape


def driven_nodes(shape: BodyShape, made: Discretization, moves: Collection[str]) -> tuple[tuple[ClampPlane, ...], Driven]:
    """The planes on which a body is held, those that move marked, and the nodes that follow what is moved: base, tip or parts by name.

    Raises SceneError where parts that move apart hold at one face, or at the same nodes.
    """
    grid, cell = made.grid, made.particles.cell
    on = {name: np.zeros(grid.nodes, bool) for name in moves}
    if shape.line is not None:
        ends = [(replace(plane, moved="tip" in on), "tip") for plane in made.planes]
        ends += [(ClampPlane(0, True, 0, moved=True), "base")] if "base" in on else []
        for plane, name in ends:
            if name in on:
                on[name][_layer(grid, plane)] = True
        return tuple(plane for plane, _ in ends), tuple(on.items())
    regions = shape.regions()
    names = np.array([region.name if region.held else "" for region in regions])[made.particles.segment]
    planes = []
    for plane in made.planes:
        behind = cell[:, plane.axis] == plane.cell + (-1 if plane.lower else 1)
        holding = set(names[behind]) - {""}
        if holding & set(on):
            _one(holding)
            on[holding.pop()][_layer(grid, plane)] = True
            plane = replace(plane, moved=True)
        planes.append(plane)
    seen = np.array([[1, 1, 1]]) if planes else np.array(list(np.ndindex(3, 3, 3)))  # by a held particle: see model.Model.splines_at
    held = {name: np.zeros(grid.nodes, bool) for name in set(names) - {""}}
    for name, mask in held.items():
        for shift in seen:
            mask[tuple((cell[names == name] + shift).T)] = True
        if name in on:
            on[name] |= mask
    for name, mask in on.items():
        for other in held:
            if other != name and (mask & held[other]).any():
                _one({name, other})
    return tuple(planes), tuple(on.items())


def _layer(grid: Grid, plane: ClampPlane) -> tuple[slice | int, ...]:
    """Index of the nodes that have the displacement of a plane that moves."""
    first = int(grid.along.node[plane.cell]) if plane.axis == 0 else plane.cell
    return tuple(first + (0 if plane.lower else 2) if axis == plane.axis else slice(None) for axis in range(3))


def _one(holding: set[str]) -> None:
    """Raise SceneError where not all that holds at one place is one."""
    if len(holding) > 1:
        raise SceneError(
            "move",
            found=f"{' and '.join(sorted(holding))} hold the body at the same face or within a cell of each other",
            rule="what is moved holds its cells alone",
            remedy="give these parts one name, so that they move together, or use smaller cells",
        )
