"""Changes of the residual of an equilibrium with the numbers of its scene, at fixed unknowns: one column for each variable.

The residual is linear in the shear modulus (at a fixed K/G), and through the effects' loads linear in the density and in the uniform
field; an effect says how its loads change with the remanence (effects.hooks) and with the field (Effect.field_changes). So all these
columns are exact. All of them come of one pass over the particles (kernels.changes).

Changes with a body's lengths and diameter are differences between models of nearly the same shape, at fixed coefficients. The models have
the same grid cells, so the same unknowns, and the same loads. Where a segment ends on a face of the cells, which is usual, to make it
longer cuts the cells beyond the face, to make it shorter those before it: the residual has a kink there. Central differences D then have
all powers of the step, D(h) = D + a h + b h^2 + ..., and D is extrapolated from three steps h, 2 h and 3 h, by 3 D(h) - 3 D(2 h) + D(3 h).
At a kink D is the mean of both one-sided derivatives, as central differences of solutions have it.

Numbers that are named by their addresses (a magnet's place, a coil's current, a bulk modulus) are differences of the residual, too, between
models of the same grid: of smooth functions, so that what is left is of the order of the step's fourth power, and rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, Index
from magmpm.effects import acting
from magmpm.effects.calls import rows
from magmpm.effects.hooks import each_record
from magmpm.errors import PAIR, SolveError
from magmpm.kernels.changes import load_changes, loads, stress_per_shear
from magmpm.model import Model, build, reshaped
from magmpm.scene import Scene
from magmpm.scene.addresses import value_at
from magmpm.scene.variables import ADDRESS, Variable
from magmpm.statics import axis
from magmpm.statics.contact import Touched
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import energy_of
from magmpm.statics.layout import StaticModel, static_model


class _Slots:
    """Changes of stress P (n, 3, 3) and force f (n, 3) of the particles, and the answer's column of each, by region (regions,)."""

    def __init__(self, energy: Energy, point: Point) -> None:
        self.energy = energy
        self.point = point
        self.n = len(point.F)
        self.P: list[Array] = []
        self.f: list[Array] = []
        self.column: list[Index] = []

    def add(self, column: Index, count: int) -> tuple[Array, Array]:
        """Room (count, n, 3, 3) and (count, n, 3) for `count` slots with columns (count, regions)."""
        P = np.zeros((count, self.n, 3, 3))
        f = np.zeros((count, self.n, 3))
        self.P.append(P)
        self.f.append(f)
        self.column.append(np.asarray(column).reshape(count, -1))
        return P, f

    def scattered(self, columns: int) -> Array:
        """All of them on the grid, (planes, columns, m) N."""
        model = self.energy.model
        region = model.particles.segment[model.layout.cell_first[:-1]]
        column = np.ascontiguousarray(np.concatenate(self.column)[:, region])
        return self.energy.scattered(
            column, np.concatenate(self.P), np.concatenate(self.f), columns
        )


def right_sides(energy: Energy, point: Point, variables: Sequence[Variable]) -> Array:
    """dr/dp (planes, k, m), N per unit, of each variable, at an equilibrium as energy.at gave it; of lengths and diameters zero."""
    slots = _Slots(energy, point)
    _of_loads(slots, variables)
    _of_field(slots, variables)
    stiffened = _columns(energy.model, variables, "shear_modulus")
    if len(stiffened):
        P, _ = slots.add(stiffened, 1)
        stress_per_shear(energy.cells, energy.particles, point.F, P[0])
    if not slots.P:
        return np.zeros((energy.model.layout.planes, len(variables), energy.model.layout.m))
    return slots.scattered(len(variables)) + _of_bonds(energy, point, stiffened, len(variables))


def _of_bonds(energy: Energy, point: Point, stiffened: Index, count: int) -> Array:
    """Change (planes, count, m) N/Pa of the forces of bonds, by the variable (1, regions) of each region's shear modulus, -1 for none."""
    layout = energy.model.layout
    out = np.zeros((layout.planes, count, layout.m))
    if layout.springs is not None:
        for k in np.unique(stiffened[stiffened >= 0]):
            out[:, k] = energy.free(
                layout.springs.gradient_per_shear(point.grid, stiffened[0] == k)
            )
    return out


def magnet_changes(model: StaticModel, variables: Sequence[Variable]) -> dict[int, Array]:
    """Change (n, 3) T per unit of the particles' remanence, in the grid's axes, with each variable that it depends on, by number."""
    found = {}
    segment = model.particles.segment
    directions = None
    for k, variable in enumerate(variables):
        if variable.kind == "magnetization":
            assert variable.region is not None
            change = np.zeros((len(segment), 3))
            change[segment == variable.region] = model.scene.region_material(
                variable.region
            ).remanence * np.array(variable.direction)
            found[k] = model.along_axes(change)
        elif variable.kind == "remanence":
            directions = (
                model.along_axes(model.scene.body.shape.magnetization(model.particles))
                if directions is None
                else directions
            )
            made_of_it = np.array(
                [region.material_name == variable.material for region in model.scene.regions()]
            )
            found[k] = np.where(made_of_it[segment][:, None], directions, 0.0)
    return found


def _columns(model: StaticModel, variables: Sequence[Variable], kind: str) -> Index:
    """Number of the variable of this kind that each region's material has (1, regions), -1 for none; (0, regions) if there are none."""
    named = {variable.material: k for k, variable in enumerate(variables) if variable.kind == kind}
    regions = [named.get(region.material_name, -1) for region in model.scene.regions()]
    return np.array([regions] if named else np.zeros((0, len(regions))), np.int64)


def _of_loads(slots: _Slots, variables: Sequence[Variable]) -> None:
    """Slots of remanence and density: as many as there are variables that one particle sees."""
    model = slots.energy.model
    regions = len(model.scene.regions())
    width = model.remanence.shape[1]
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
        load_changes(
            rows(model.effects, "load_change"),
            model.remanence,
            model.density,
            slots.point.position,
            slots.point.F,
            np.array([one[:, :-1] for one in change]),
            np.array([one[:, -1] for one in change]),
            P,
            f,
        )


def _of_field(slots: _Slots, variables: Sequence[Variable]) -> None:
    """Slots of the field's uniform part."""
    model = slots.energy.model
    energy = slots.energy
    wanted = [
        (k, variable.component) for k, variable in enumerate(variables) if variable.kind == "field"
    ]
    if not wanted:
        return
    changes = acting.field_changes(model.scene, model.times)
    column = np.repeat([[k] for k, _ in wanted], len(model.scene.regions()), axis=1)
    P, f = slots.add(column, len(wanted))
    for slot, (_, component) in enumerate(wanted):
        assert component is not None
        if changes[component]:
            loads(
                rows(changes[component], "load"),
                energy.particles.remanence,
                energy.particles.density,
                slots.point.position,
                slots.point.F,
                P[slot],
                f[slot],
            )


NODE_STEP = 1e-3  # of a cell's width


@dataclass(frozen=True)
class GeometryChange:
    """Changes, per unit, at fixed coefficients: of the residual (planes, m) N, axis rows [s, x, y, z] (rows, 4) m and the tip (3,) m."""

    residual: Array
    rows: Array
    tip: Array


def geometry_changes(
    model: StaticModel, grid: Array, variables: Sequence[Variable]
) -> dict[int, GeometryChange]:
    """Change with each variable that is a length or diameter, or has an address, by its number, at coefficients (planes, m) m."""
    return {
        k: _change(model, grid, one)
        for k, one in enumerate(variables)
        if one.kind in ("length", "diameter", ADDRESS)
    }


def contact_changes(
    model: StaticModel, grid: Array, variables: Sequence[Variable]
) -> dict[int, Array]:
    """Change (planes, m) N per unit of the force of contact, whose stiffness goes with the body's own, with each modulus and density, by
    its number: central differences of a force that is nearly linear in them."""
    found: dict[int, Array] = {}
    for k, one in enumerate(variables if model.touching is not None else ()):
        if one.kind in ("shear_modulus", "density"):
            step = NODE_STEP * getattr(model.scene.materials[str(one.material)], one.kind)
            total = np.zeros((grid.size // 3, 3))
            for side in (1.0, -1.0):
                near = _rebuilt(model, one.changed(model.scene, side * step))
                assert near.touching is not None  # as the model's
                total -= side * near.touching.force(near.touching.touched(near.effects, grid))
                if near.pairs is not None:
                    total -= side * near.pairs.touched(grid).force(len(total))
            found[k] = total.reshape(grid.shape) / (2 * step)
    return found


def push_changes(
    model: StaticModel, grid: Array, variables: Sequence[Variable], obstacle: str
) -> Array:
    """Change (3, k), N per unit, at fixed coefficients, of the sum of an obstacle's forces, or of two parts': central differences."""
    out = np.zeros((3, len(variables)))
    for k, one in enumerate(variables):
        if one.kind in ("magnetization", "field", "remanence"):
            continue
        for side in (1.0, -1.0):
            if one.kind in ("shear_modulus", "density"):
                step = NODE_STEP * getattr(model.scene.materials[str(one.material)], one.kind)
                near = _rebuilt(model, one.changed(model.scene, side * step))
            else:
                step = _step(model) if one.kind != ADDRESS else _step_at(model, one)
                near = _near(model, one, side * step)
            out[:, k] += side * _push(near, grid, obstacle) / (2.0 * step)
    return out


def _push(model: StaticModel, grid: Array, obstacle: str) -> Array:
    """Force (3,) N of an obstacle on the body or a part, or of the second of two parts on the first, at coefficients (planes, m) m."""
    if not obstacle.startswith("self_contact"):
        return np.asarray(touched_by(model, grid, obstacle).f.sum(axis=0))
    assert model.pairs is not None  # of a scene that names self_contact
    found = model.pairs.touched(grid).report().get(obstacle)
    return np.zeros(3) if found is None else found["force"]


def touched_by(model: StaticModel, grid: Array, obstacle: str) -> Touched:
    """The points that touch one obstacle, or of a part that touches it ("walls: tip"), at coefficients (planes, m) m."""
    assert model.touching is not None  # it has the obstacle
    key, _, part = obstacle.partition(PAIR)
    records = model.scene.effects.named()[key].records(model.scene)
    touched = model.touching.touched(records, grid)
    if not part:
        return touched
    names = [region.name for region in model.scene.regions()]
    return touched.chosen(model.particles.segment[touched.particle] == names.index(part))


def _rebuilt(model: StaticModel, scene: Scene) -> StaticModel:
    """The model of a changed scene, at the same step of a path: where its schedule tells when it ends, a step's time changes with it.

    Raises SolveError where more of a fed catheter would be out of its guide then.
    """
    time = model.time
    before = model.scene.path_times()
    if time is not None and time in before:
        time = scene.path_times()[before.index(time)]
    if model.again is None:
        return static_model(build(scene, time=time))
    if time != model.time:
        raise SolveError(
            "the number changes the times of the path's steps, and so the length outside the guide;"
            " remedy: `duration` in `solver.quasi_static`, or differences of runs"
        )
    return model.again(scene)


def _change(model: StaticModel, grid: Array, variable: Variable) -> GeometryChange:
    step = _step(model) if variable.kind != ADDRESS else _step_at(model, variable)
    total: list[Array] = []
    slopes: list[Array] = []
    for k, weight in enumerate((3.0, -3.0, 1.0), start=1):
        sides = []
        for sign in (1.0, -1.0):
            near = _near(model, variable, sign * k * step)
            energy = energy_of(near)
            residual = energy.residual(energy.at(grid))
            if variable.kind == ADDRESS:  # the body's shape, and so its axis, stay as they are
                sides.append((residual, np.zeros((len(near.grid.stations), 4)), np.zeros(3)))
            else:
                sides.append((residual, axis.centreline(near, grid), axis.tip(near, grid)))
        slope = [
            weight * (ahead - behind) / (2 * k * step) for ahead, behind in zip(*sides, strict=True)
        ]
        total = [a + b for a, b in zip(total, slope, strict=True)] if total else slope
        slopes.append(slope[0] / weight)
    if variable.kind == ADDRESS:
        _check_smooth(variable, slopes[0], slopes[1])
    return GeometryChange(*total)


def _check_smooth(variable: Variable, near: Array, far: Array, most: float = 1e-3) -> None:
    """Raises SolveError where differences of the residual over one step and over two are farther apart than `most` of them."""
    if np.linalg.norm(near - far) > most * np.linalg.norm(near):
        raise SolveError(
            f"{variable.name}: the forces do not change smoothly with it, so there is no"
            " derivative; remedy: another variable, or differences of runs"
        )


def _step(model: StaticModel) -> float:
    """Step (m) of a length or diameter: so short that no segment's end crosses a face that it is not on."""
    shape = model.scene.body.shape
    assert isinstance(shape, StraightBody)
    ends = np.cumsum(shape.segment_lengths())[:-1]
    spans = model.grid.along
    cell = model.grid.cell_along(ends)
    within = (ends - spans.start[cell]) / spans.width[cell] - spans.index[cell]
    off = np.abs(within - np.round(within))
    least = float(np.min(off[off > 1e-9], initial=1.0))
    touching = (
        1.0 if model.touching is None else 1e-2
    )  # in a longer step points begin or cease to touch
    return min(NODE_STEP, least / 8) * float(model.grid.spacing.min()) * touching


def _step_at(model: StaticModel, variable: Variable) -> float:
    """Step of a number that has an address: NODE_STEP of it, or of the vector that it is a part of; of zeros, of the body's length or 1
    SI."""
    value = value_at(model.scene, variable.place)
    if isinstance(variable.place[-1], int):
        value = np.linalg.norm(value_at(model.scene, variable.place[:-1]))
    usual = {"m": model.scene.length, "T": 1e-3}.get(variable.unit, 1.0)
    return NODE_STEP * (abs(float(value)) or usual)


def _near(model: StaticModel, variable: Variable, amount: float) -> StaticModel:
    """The model in which the variable is larger by an amount (SI), on as many cells."""
    scene = variable.changed(model.scene, amount)
    if variable.kind == ADDRESS:
        scene = scene.on_field_nodes_of(model.scene)
        return _same_unknowns(_rebuilt(model, scene), model, variable, amount)
    base = Model(
        **{name: value for name, value in vars(model).items() if name in Model.__dataclass_fields__}
    )
    touched = [
        effect.records(scene)[0]
        for effect in scene.effects.named().values()
        if effect.PHASE == "contact" and effect.records(scene)
    ]  # as stiff as its cells
    stiff = {record.dtype: record for record in touched}
    base = replace(
        base,
        scene=scene,
        effects=each_record(lambda record: stiff.get(record.dtype, record), base.effects),
    )
    near = _same_unknowns(static_model(reshaped(base, scene.body.shape)), model, variable, amount)
    if acting.feels_itself(scene) and not _same_dipoles(near, model):
        raise SolveError(
            f"{variable.name}: {amount:g} m away the segments are divided into other dipoles"
            " (magnetic_interaction), where a segment's first or last cell is half full, so the"
            " shape jumps and has no derivative; remedy: lengths of whole cells, or other variables"
        )
    return near


def _same_unknowns(
    near: StaticModel, model: StaticModel, variable: Variable, amount: float
) -> StaticModel:
    """A model near another, with the same unknowns. Raises ValueError where they are others."""
    same = near.layout.planes == model.layout.planes and np.array_equal(
        near.layout.node_yz, model.layout.node_yz
    )
    if not (same and np.array_equal(near.layout.fixed, model.layout.fixed)):
        raise ValueError(
            f"{variable.name}: the unknowns are others {amount:g} {variable.unit} away, so there is"
            " no derivative by differences"
        )
    return near


def _same_dipoles(one: StaticModel, other: StaticModel) -> bool:
    """True if the cells that both models have are divided into the same dipoles, and slivers of further cells belong to these."""
    (first, block), (second, same) = (_dipole_of_cells(model) for model in (one, other))
    _, at, there = np.intersect1d(first, second, return_indices=True)
    return bool(block.max() == same.max() and np.array_equal(block[at], same[there]))


def _dipole_of_cells(model: StaticModel) -> tuple[Index, Array]:
    """Number (k,) of each part of a cell that is of one segment, and of the dipole (k,) that it belongs to."""
    particles = model.particles
    cell = np.ravel_multi_index(particles.cell.T, model.grid.cells)
    number, first = np.unique(
        cell * (int(particles.segment.max()) + 1) + particles.segment, return_index=True
    )
    return number, model.remanence[first, 3]
