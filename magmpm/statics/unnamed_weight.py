"""Whether the weight of a body would matter that a scene does not name, where the body is no rod: by the factors that its solve leaves.

One load vector and one substitution, so it costs next to nothing. To first order: a large shift may be less, so no number is told.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.gravity import Gravity
from magmpm.kernels.equilibrium import grid_to_particles
from magmpm.rod.advice import allowed_error
from magmpm.rod.shifts import is_cantilever
from magmpm.scene import Scene
from magmpm.statics.block_cholesky import solve_columns
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.interacting import InteractingEnergy

SURE = 1.25  # times the error: what a shift to first order must be, to be told


def missed_weight(scene: Scene, found: Equilibrium) -> list[str]:
    """A warning where a scene's equilibrium lacks a weight that would move it by more than the error it asks for."""
    if scene.advice == "off" or scene.effects.gravity is not None or is_cantilever(scene) or found.energy is None:
        return []
    if any(scene.materials[region.material_name].density is None for region in scene.regions()):
        return []
    energy, error = found.energy, allowed_error(scene)
    alone = energy.alone if isinstance(energy, InteractingEnergy) else energy
    if float(np.linalg.norm(weight_shift(alone, Gravity().acceleration), axis=1).max()) < SURE * error:
        return []
    return [
        f"effects: gravity is not named, and the body's weight may move the answer by more than {100 * error / scene.length:.2g} % of its "
        "length; name it, or write `advice: off` to hear no more of it (`magmpm effects` says how much)"
    ]


def weight_shift(energy: Energy, acceleration: tuple[float, float, float]) -> Array:
    """How far (particles, 3) m the body's weight moves an equilibrium, to first order. energy: of its solve, with its last factors."""
    model, n = energy.model, len(energy.model.shear)
    load = model.density[:, None] * np.array(acceleration)
    column = np.zeros((1, len(model.layout.cell_plane)), np.int64)
    force = energy.scattered(column, np.zeros((1, n, 3, 3)), -load[None], 1)
    moved = solve_columns(energy.panels, model.layout.split, energy.free_columns(force))
    shift, F = np.empty((n, 3)), np.empty((n, 3, 3))
    grid_to_particles(energy.cells, energy.particles, np.ascontiguousarray(moved[:, 0]), energy.rest_gradient, shift, F)
    return shift
