"""Equilibrium in a steady stream: the drag of a fluid (effects.fluid) on the shape that it bends.

Drag follows the shape and has no potential, so it is held while the energy is minimized, and computed again for the shape that was found,
until neither changes. Where that overshoots, steps of the load are shortened or lengthened by what the last two have shown (Aitken's method
for vectors). Source: Irons, Tuck, Int. J. Numer. Meth. Eng. 1 (1969) 275; Kuettler, Wall, Comput. Mech. 43 (2008) 61.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.fluid import forces
from magmpm.errors import SolveError
from magmpm.model import Model
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.newton import Minimum, OnStep, minimize


def in_stream(
    model: Model,
    energy: Energy | InteractingEnergy,
    point: Point,
    on_step: OnStep | None,
) -> Minimum:
    """The equilibrium near a point, which is one without drag, in the stream of a model's fluid, with the steps that it took.

    The energy keeps the load of the drag. Raises SolveError, with the last point as its state, where drag and shape don't settle.
    """
    options = model.scene.solver.static
    near = 1e-7 * model.scene.length  # m: by so little may a whole step still move the body
    steps = 0
    at = _at_pieces(model)
    load = np.zeros(energy.alone.shape)
    left = _drag(model, at, energy.alone, point)
    share = 1.0
    for _ in range(50):
        load = load + share * left
        energy.held_load(load)
        last = _minimum(energy, point.grid, options.tolerance, options.max_steps, on_step)
        steps += last.steps
        moved = float(np.abs(last.point.position - point.position).max())
        point = last.point
        before = left
        left = _drag(model, at, energy.alone, point) - load
        change = left - before
        size = float(np.sum(change * change))
        if moved <= near * min(1.0, abs(share)):  # a short step moves it by less
            return replace(last, point=point, steps=steps)
        share *= -float(np.sum(before * change)) / size if size > 0.0 else 1.0
    raise SolveError(
        f"drag and bent shape do not converge (the last change was {1e3 * moved:.2g} mm): the "
        "body may flutter in this stream; simulate its motion, `solver: {dynamic: {duration: "
        "0.5 s}}`, or make the stream slower",
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


def _at_pieces(model: Model) -> Any:
    """Sparse matrix (k, n) that gives what a linear field is at the wetted pieces from what it is at the particles of their cells."""
    from scipy.sparse import csr_matrix  # imported only where it is used

    wetted = model.wetted
    begins = model.particles.cell_first
    cell = np.searchsorted(begins, wetted.particle, side="right") - 1
    shares = []
    columns = []
    for piece, at in enumerate(cell):
        near = np.arange(begins[at], begins[at + 1])
        ways = model.particles.position[near] - wetted.surface.place[piece]
        linear = np.column_stack([np.full(len(near), model.scene.cell), ways])
        # of the least squares through these: the value at the piece
        shares.append(np.linalg.pinv(linear, rcond=1e-6)[0] * model.scene.cell)
        columns.append(near)
    count = [len(near) for near in columns]
    ends = np.concatenate([[0], np.cumsum(count)])
    shape = (len(cell), len(model.density))
    return csr_matrix((np.concatenate(shares), np.concatenate(columns), ends), shape)


def _drag(model: Model, at: Any, energy: Energy, point: Point) -> Array:
    """Drag on a shape as a load (planes, m) N on the solver's unknowns; at: of `_at_pieces`."""
    surface = model.wetted.surface
    F = point.F @ np.swapaxes(model.grid.axes_at(model.particles.position), -1, -2)
    stretched = (at @ F.reshape(-1, 9)).reshape(-1, 3, 3)
    tangents = np.einsum("nij,nkj->nki", stretched, surface.tangents)
    force = at.T @ forces(model.scene, surface, at @ point.position, tangents)
    density = force / model.particles.volume[:, None]
    stress = np.zeros((1, len(density), 3, 3))
    return -energy.each_scattered(stress, density[None])[:, 0]
