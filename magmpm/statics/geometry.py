"""Derivatives with respect to a body's lengths and diameter, at fixed coefficients: differences between models of nearly the same shape.

The models have the same grid cells, so the same unknowns, and the same loads. Where a segment ends on a face of the cells, which is usual,
to make it longer cuts the cells beyond the face, to make it shorter those before it: the residual has a kink there. Central differences D
then have all powers of the step, D(h) = D + a h + b h^2 + ..., and D is extrapolated from three steps h, 2 h and 3 h, by
3 D(h) - 3 D(2 h) + D(3 h). At a kink D is the mean of both one-sided derivatives, as central differences of solutions have it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.effects.hooks import each_record
from magmpm.model import Model, build, reshaped
from magmpm.scene.variables import Variable
from magmpm.statics import axis
from magmpm.statics.axis_order import arranged
from magmpm.statics.energy import Energy
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.layout import StaticModel, static_model

STEP = 1e-3  # of a cell's width
TOUCHING = 1e-2  # of that step, with obstacles: in a longer one points begin or cease to touch
WEIGHTS = (3.0, -3.0, 1.0)
ON_A_FACE = 1e-9  # of a cell: a segment's end nearer than this to a face is on it (bodies.section_quadrature)
Residual = Callable[[StaticModel, Array], Array]


@dataclass(frozen=True)
class GeometryChange:
    """Changes at fixed coefficients: of the residual (planes, m) N, of the axis's rows [s, x, y, z] (rows, 4) m and of the tip (3,) m, per
    unit."""

    residual: Array
    rows: Array
    tip: Array


def geometry_changes(model: StaticModel, grid: Array, variables: Sequence[Variable], residual: Residual) -> dict[int, GeometryChange]:
    """Change with each variable that is a length or diameter, by its number.

    residual(model, grid): of a model that differs from the given one in shape alone, at coefficients (planes, m) m.
    """
    return {k: _change(model, grid, one, residual) for k, one in enumerate(variables) if one.kind in ("length", "diameter")}


def contact_changes(model: StaticModel, grid: Array, variables: Sequence[Variable]) -> dict[int, Array]:
    """Change (planes, m) N per unit of the force of contact, whose stiffness goes with the body's own, with each modulus and density, by
    its number: central differences of a force that is nearly linear in them."""
    found: dict[int, Array] = {}
    for k, one in enumerate(variables if model.touching is not None else ()):
        if one.kind in ("shear_modulus", "density"):
            step, total = STEP * getattr(model.scene.materials[str(one.material)], one.kind), np.zeros((grid.size // 3, 3))
            for side in (1.0, -1.0):
                near = arranged(static_model(build(one.changed(model.scene, side * step), time=model.time)))[0]
                assert near.touching is not None  # as the model's
                total -= side * near.touching.force(near.touching.touched(near.effects, grid))
            found[k] = total.reshape(grid.shape) / (2 * step)
    return found


def residual_alone(model: StaticModel, grid: Array) -> Array:
    """Residual (planes, m) N of a model without magnetic interaction."""
    energy = Energy(model)
    return energy.residual(energy.at(grid))


def residual_with_interaction(model: StaticModel, grid: Array) -> Array:
    """Residual (planes, m) N of a model whose segments act on each other."""
    energy = InteractingEnergy(model)
    return energy.residual(energy.at(grid))


def _change(model: StaticModel, grid: Array, variable: Variable, residual: Residual) -> GeometryChange:
    step = _step(model)
    total: list[Array] = []
    for k, weight in enumerate(WEIGHTS, start=1):
        sides = []
        for sign in (1.0, -1.0):
            near = _near(model, variable, sign * k * step)
            sides.append((residual(near, grid), axis.centreline(near, grid), axis.tip(near, grid)))
        slope = [weight * (ahead - behind) / (2 * k * step) for ahead, behind in zip(*sides, strict=True)]
        total = [a + b for a, b in zip(total, slope, strict=True)] if total else slope
    return GeometryChange(*total)


def _step(model: StaticModel) -> float:
    """Step (m) of a length or diameter: so short that no segment's end crosses a face that it is not on."""
    shape = model.scene.body.shape
    assert isinstance(shape, StraightBody)
    ends, spans = np.cumsum(shape.segment_lengths())[:-1], model.grid.along
    cell = model.grid.cell_along(ends)
    within = (ends - spans.start[cell]) / spans.width[cell] - spans.index[cell]
    off = np.abs(within - np.round(within))
    least = float(np.min(off[off > ON_A_FACE], initial=1.0))
    return min(STEP, least / 8) * float(model.grid.spacing.min()) * (1.0 if model.touching is None else TOUCHING)


def _near(model: StaticModel, variable: Variable, amount: float) -> StaticModel:
    """The model with a shape in which the variable is larger by an amount (m), on as many cells, under the same loads."""
    scene = variable.changed(model.scene, amount)
    base = Model(**{name: value for name, value in vars(model).items() if name in Model.__dataclass_fields__})
    touched = [effect.records(scene)[0] for effect in scene.effects.named().values() if effect.PHASE == "contact"]  # as stiff as its cells
    stiff = {record.dtype: record for record in touched}
    base = replace(base, scene=scene, effects=each_record(lambda record: stiff.get(record.dtype, record), base.effects))
    near = static_model(reshaped(base, scene.body.shape))
    same = near.layout.planes == model.layout.planes and np.array_equal(near.layout.node_yz, model.layout.node_yz)
    if not (same and np.array_equal(near.layout.fixed, model.layout.fixed)):
        raise ValueError(f"{variable.name}: the unknowns are others {amount:g} m away, so there is no derivative by differences")
    return near
