"""Equilibrium in a steady stream: the drag of a fluid (effects.fluid) on the shape that it bends.

Drag follows the shape and has no potential, so it is held while the energy is minimized, and computed again for the shape that was found,
until neither changes. Where that overshoots, steps of the load are shortened or lengthened by what the last two have shown (Aitken's method
for vectors). Source: Irons, Tuck, Int. J. Numer. Meth. Eng. 1 (1969) 275; Kuettler, Wall, Comput. Mech. 43 (2008) 61.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.effects.fluid import forces
from magmpm.errors import SolveError
from magmpm.model import Model
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.newton import Minimum, OnStep, minimize


def in_stream(
    model: Model,
    of: Index,
    energy: Energy | InteractingEnergy,
    point: Point,
    restore: Callable[[Point], Point],
    on_step: OnStep | None,
) -> Minimum:
    """The equilibrium near a point, which is one without drag, in the stream of a model's fluid, with the steps that it took.

    of: the number in the model of each of the solver's particles; restore: the solver's point in the model's order. The energy keeps the
    load of the drag. Raises SolveError, with the last point as its state, where drag and shape don't settle.
    """
    options = model.scene.solver.static
    near = 1e-7 * model.scene.length  # m: a hundredth of the rounding of a shape in files
    steps = 0
    load = np.zeros(energy.alone.shape)
    left = _drag(model, of, energy.alone, restore(point))
    share = 1.0
    for _ in range(50):
        load = load + share * left
        energy.held_load(load)
        last = _minimum(energy, point.grid, options.tolerance, options.max_steps, on_step)
        steps += last.steps
        moved = float(np.abs(last.point.position - point.position).max())
        point = last.point
        before = left
        left = _drag(model, of, energy.alone, restore(point)) - load
        change = left - before
        size = float(np.sum(change * change))
        if moved <= near:
            return replace(last, point=point, steps=steps)
        share *= -float(np.sum(before * change)) / size if size > 0.0 else 1.0
    raise SolveError(
        f"the stream's drag and the shape that it bends do not settle (the last change was {1e3 * moved:.2g}"
        " mm): a body may flutter in this stream; simulate its motion, `solver: {dynamic: {duration: 0.5"
        " s}}`, or make the stream slower",
        point,
    )


def _minimum(
    energy: Energy | InteractingEnergy,
    begin: Array,
    tolerance: float,
    most: int,
    on_step: OnStep | None,
) -> Minimum:
    """The minimum of an energy near coefficients (planes, m) m."""
    if isinstance(energy, InteractingEnergy):
        return minimize_with_interaction(
            energy, begin, tolerance=tolerance, max_steps=most, on_step=on_step
        )
    return minimize(energy, begin, tolerance=tolerance, max_steps=most, on_step=on_step)


def _drag(model: Model, of: Index, energy: Energy, point: Point) -> Array:
    """Drag on a shape as a load (planes, m) N on the solver's unknowns; point: in the model's order."""
    wetted = model.wetted
    fluid = model.scene.effects.fluid
    axes = model.grid.axes_at(model.particles.position)
    F = point.F @ np.swapaxes(axes, -1, -2)
    on = wetted.particle
    arm = wetted.surface.place - model.particles.position[on]
    place = point.position[on] + np.einsum("nij,nj->ni", F[on], arm)
    tangents = np.einsum("nij,nkj->nki", F[on], wetted.surface.tangents)
    force = forces(fluid, model.scene, wetted.surface, place, tangents)
    per_volume = force / model.particles.volume[on][:, None]
    density = np.zeros((len(model.density), 3))
    stress = np.zeros((len(density), 3, 3))
    np.add.at(density, on, per_volume)
    # a piece moves with its particle, and with the particle's F times its way from it
    np.add.at(stress, on, -per_volume[:, :, None] * arm[:, None, :])
    along = (stress @ axes)[of][:, :, list(energy.model.order)]
    return -energy.each_scattered(along[None], density[of][None])[:, 0]
