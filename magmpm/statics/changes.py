"""Changes of the residual of an equilibrium with the numbers of its scene, at fixed unknowns: one column for each variable.

The residual is linear in the shear modulus (at a fixed K/G), and through the effects' loads linear in the density and in the uniform
field; an effect says how its loads change with the remanence (effects.hooks) and with the field (Effect.field_changes). So all these
columns are exact. All of them come of one pass over the particles (kernels.changes).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.effects import acting
from magmpm.kernels.changes import load_changes, loads, stress_per_shear
from magmpm.scene.variables import Variable
from magmpm.statics.energy import Energy, Point
from magmpm.statics.layout import StaticModel


class _Slots:
    """Changes of stress P (n, 3, 3) and force f (n, 3) of the particles, and the answer's column of each, by region (regions,)."""

    def __init__(self, energy: Energy, point: Point) -> None:
        self.energy, self.point, self.n = energy, point, len(point.F)
        self.P: list[Array] = []
        self.f: list[Array] = []
        self.column: list[Index] = []

    def add(self, column: Index, count: int) -> tuple[Array, Array]:
        """Room (count, n, 3, 3) and (count, n, 3) for `count` slots with columns (count, regions)."""
        P, f = np.zeros((count, self.n, 3, 3)), np.zeros((count, self.n, 3))
        self.P.append(P)
        self.f.append(f)
        self.column.append(np.asarray(column).reshape(count, -1))
        return P, f

    def scattered(self, columns: int) -> Array:
        """All of them on the grid, (planes, columns, m) N."""
        model = self.energy.model
        region = model.particles.segment[model.layout.cell_first[:-1]]
        column = np.ascontiguousarray(np.concatenate(self.column)[:, region])
        return self.energy.scattered(column, np.concatenate(self.P), np.concatenate(self.f), columns)


def right_sides(energy: Energy, point: Point, variables: Sequence[Variable]) -> Array:
    """dr/dp (planes, k, m) of each variable but lengths and diameters, whose columns are zero; N per unit.

    point: the equilibrium, as energy.at gave it last.
    """
    slots = _Slots(energy, point)
    _of_loads(slots, variables)
    _of_field(slots, variables)
    stiffened = _columns(energy.model, variables, "shear_modulus")
    if len(stiffened):
        P, _ = slots.add(stiffened, 1)
        stress_per_shear(energy.cells, energy.particles, point.F, P[0])
    if not slots.P:
        return np.zeros((energy.model.layout.planes, len(variables), energy.model.layout.m))
    return slots.scattered(len(variables))


def magnet_changes(model: StaticModel, variables: Sequence[Variable]) -> dict[int, Array]:
    """Change (n, 3) T per unit of the particles' remanence, in the grid's axes, with each variable that it depends on, by number."""
    found, segment = {}, model.particles.segment
    directions = None
    for k, variable in enumerate(variables):
        if variable.kind == "magnetization":
            assert variable.region is not None
            change = np.zeros((len(segment), 3))
            change[segment == variable.region] = model.scene.region_material(variable.region).remanence * np.array(variable.direction)
            found[k] = model.along_axes(change)
        elif variable.kind == "remanence":
            directions = model.along_axes(model.scene.body.shape.magnetization(model.particles)) if directions is None else directions
            found[k] = np.where(_made_of(model, variable)[segment][:, None], directions, 0.0)
    return found


def _made_of(model: StaticModel, variable: Variable) -> Array:
    """Which regions (regions,) are made of the variable's material."""
    return np.array([region.material_name == variable.material for region in model.scene.regions()])


def _columns(model: StaticModel, variables: Sequence[Variable], kind: str) -> Index:
    """Number of the variable of this kind that each region's material has (1, regions), -1 for none; (0, regions) if there are none."""
    named = {variable.material: k for k, variable in enumerate(variables) if variable.kind == kind}
    regions = [named.get(region.material_name, -1) for region in model.scene.regions()]
    return np.array([regions] if named else np.zeros((0, len(regions))), np.int64)


def _of_loads(slots: _Slots, variables: Sequence[Variable]) -> None:
    """Slots of remanence and density: as many as there are variables that one particle sees."""
    model, energy = slots.energy.model, slots.energy
    regions, width = len(model.scene.regions()), model.remanence.shape[1]
    column: list[Index] = []
    change: list[Array] = []
    for k, dmagnet in magnet_changes(model, variables).items():
        seen = np.unique(model.particles.segment[dmagnet.any(axis=1)])
        slot = next((i for i, taken in enumerate(column) if (taken[seen] < 0).all()), len(column))
        if slot == len(column):
            column.append(np.full(regions, -1))
            change.append(np.zeros((slots.n, width + 1)))
        column[slot][seen] = k
        change[slot][:, :3] += dmagnet
    heavier = _columns(model, variables, "density")
    if len(heavier):
        column.append(heavier[0])
        change.append(np.concatenate([np.zeros((slots.n, width)), np.ones((slots.n, 1))], axis=1))
    if column:
        P, f = slots.add(np.array(column), len(column))
        load_changes(energy.particles, model.effects, slots.point.position, slots.point.F, np.array(change), P, f)


def _of_field(slots: _Slots, variables: Sequence[Variable]) -> None:
    """Slots of the field's uniform part."""
    model, energy = slots.energy.model, slots.energy
    wanted = [(k, variable.component) for k, variable in enumerate(variables) if variable.kind == "field"]
    if not wanted:
        return
    changes = acting.field_changes(model.scene)
    column = np.repeat([[k] for k, _ in wanted], len(model.scene.regions()), axis=1)
    P, f = slots.add(column, len(wanted))
    for slot, (_, component) in enumerate(wanted):
        assert component is not None
        if changes[component]:
            loads(energy.particles, changes[component], slots.point.position, slots.point.F, P[slot], f[slot])
