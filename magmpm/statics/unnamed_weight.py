"""Effect of a weight that a scene does not name, where the body is no rod: by the factors that its solve leaves.

One load vector and one substitution, so it costs next to nothing. To first order: a large shift may be less, so no number is reported.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.gravity import Gravity
from magmpm.kernels.equilibrium import grid_to_particles
from magmpm.rod.advice import allowed_error, meets
from magmpm.rod.shifts import is_cantilever
from magmpm.scene import Scene
from magmpm.statics.block_cholesky import solve_columns
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.interacting import InteractingEnergy

SURE = 1.25  # times the error: what a shift to first order must be, to be reported


def missed_weight(scene: Scene, found: Equilibrium) -> list[str]:
    """A warning where a scene's equilibrium lacks a weight that would move it by more than the error it requests."""
    if scene.advice == "off" or scene.effects.gravity is not None or found.energy is None or (is_cantilever(scene) and not meets(scene)):
        return []
    if any(scene.materials[region.material_name].density is None for region in scene.regions()):
        return []
    energy, error = found.energy, allowed_error(scene)
    alone = energy.alone if isinstance(energy, InteractingEnergy) else energy
    shift = float(np.linalg.norm(weight_shift(alone, Gravity().acceleration), axis=1).max())
    if scene.body.strip is not None and scene.body.shape.clamp == "both":
        shift = _stretched(shift, scene.body.strip.thickness)
    if shift < SURE * error:
        return []
    return [
        f"effects: gravity is not named, and the body's weight may move the answer by more than {100 * error / scene.length:.2g} % of its "
        "length; name it, or write `advice: off` to hear no more of it (`magmpm effects` says how much)"
    ]


def _stretched(shift: float, thickness: float) -> float:
    """The way (m) w that a strip held at both ends goes where it would go `shift` (m) if it did not stretch: w + 3/4 w^3/t^2 is the shift.

    By its first shape, w (1 - cos(2 pi x/L))/2, and the force that its longer axis needs (Timoshenko and Woinowsky-Krieger, Theory of
    Plates and Shells, 2nd ed., section 1.4); 1 and 2 % from whole runs at w = 1.5 and 8 t.
    """
    cubic = np.roots([0.75 / thickness**2, 0.0, 1.0, -shift])
    return float(cubic[np.argmin(np.abs(cubic.imag))].real)


def weight_shift(energy: Energy, acceleration: tuple[float, float, float]) -> Array:
    """Shift (particles, 3) m of an equilibrium by the body's weight, to first order. energy: of its solve, with its last factors."""
    model, n = energy.model, len(energy.model.shear)
    load = model.density[:, None] * np.array(acceleration)
    column = np.zeros((1, len(model.layout.cell_plane)), np.int64)
    force = energy.scattered(column, np.zeros((1, n, 3, 3)), -load[None], 1)
    moved = solve_columns(energy.panels, model.layout.split, energy.free_columns(force))
    shift, F = np.empty((n, 3)), np.empty((n, 3, 3))
    grid_to_particles(energy.cells, energy.particles, np.ascontiguousarray(moved[:, 0]), model.axes, shift, F)
    return shift
