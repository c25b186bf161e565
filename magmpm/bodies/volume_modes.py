"""The functions over which the volume part of the energy is averaged (F-bar), in equilibrium and in motion: four in each cell."""

from __future__ import annotations

import numpy as np

from magmpm.bodies.grid import Grid
from magmpm.bodies.polar_grid import PolarGrid
from magmpm.bodies.section_quadrature import Particles
from magmpm.compiled.arrays import Array

LINEAR_STIFFNESS = 5.0  # of G: the most that the linear modes of the volume part carry, see volume_modes


def volume_modes(grid: Grid, particles: Particles, ratio: Array) -> Array:
    """Anti-locking (F-bar): functions on each cell's particles onto which det F is projected in the volume part of the energy.

    ratio (n,): K/G. Returns (n, 4) m^(-3/2): a constant and three linear modes, orthogonal under the particles' volumes. The volume
    energy of a cell is K/2 sum_k c_k^2 with c_k = sum V mode_k (J - 1). The linear modes carry at most LINEAR_STIFFNESS G in place
    of K: a cell's mean of J is held by K, its variation within the cell, which vanishes with the cell's size, more softly.
    Through a tube's wall it does not vanish, for one cell is all of the wall: there the linear mode has all of K.
    Source: F-bar, de Souza Neto et al., IJSS 33 (1996); as a projection for splines, Elguedj et al., CMAME 197 (2008).
    The measurements behind both choices are in docs/design.md.
    """
    modes, cell_first = np.zeros((len(particles.volume), 4)), particles.cell_first
    cell = np.repeat(np.arange(len(cell_first) - 1), np.diff(cell_first))
    root = np.sqrt(particles.volume)
    for k, raw in enumerate([np.ones(len(cell)), *grid.own(particles.position, particles.cell).T]):
        mode = raw * root
        size = np.sqrt(np.bincount(cell, mode**2))
        for _ in range(2):  # twice: once leaves rounding of the size of the offset from the origin
            for j in range(k):
                mode = mode - modes[:, j] * np.bincount(cell, modes[:, j] * mode)[cell]
        left = np.sqrt(np.bincount(cell, mode**2))
        fine = left > 1e-9 * size  # particles in a line or a plane: the mode adds nothing
        modes[:, k] = np.where(fine[cell], mode / np.where(fine, left, 1.0)[cell], 0.0)
    soft = slice(1, 3 if isinstance(grid, PolarGrid) else 4)
    modes[:, soft] *= np.sqrt(np.minimum(1.0, LINEAR_STIFFNESS / ratio))[:, None]
    return modes / root[:, None]
