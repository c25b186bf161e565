"""Changes of the loads and stresses of particles with numbers of the scene, and their way to the grid: many columns in one pass.

Slots are kinds of change that a particle can see: its remanence, the field, its moduli, its density. Which column of the answer a slot
of a cell adds to depends on the cell's region, so a hundred directions of magnetization take two slots.
Cells, colors and the order of sums are those of kernels.equilibrium.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.jit import compiled, kernel, prange
from magmpm.effects.hooks import add_force, add_force_change, add_stress, add_stress_change
from magmpm.kernels.equilibrium import STENCIL, _particle_gradients, _volume_change, _volume_moments
from magmpm.materials import cofactor, determinant, stress, volume_pressure


@kernel
def load_changes(particles, effects, x, F, change, P, f):
    """Add to P (slots, n, 3, 3) Pa and f (slots, n, 3) N/m^3 how the effects' stress and force change with the particles' constants.

    change (slots, n, 4 or 5): of the remanence (T; with a mark, which stays, where the particles have one), then of the density (kg/m^3).
    """
    magnet, rho = particles.remanence, particles.density
    for p in prange(len(x)):
        for slot in range(len(change)):
            changed = change[slot, p]
            add_stress_change(effects, 0, magnet[p], rho[p], changed[:-1], changed[-1], x[p], F[p], P[slot, p])
            add_force_change(effects, 0, magnet[p], rho[p], changed[:-1], changed[-1], x[p], F[p], f[slot, p])


@kernel
def loads(particles, effects, x, F, P, f):
    """Add the effects' stress and force of each particle to P (n, 3, 3) Pa and f (n, 3) N/m^3."""
    magnet, rho = particles.remanence, particles.density
    for p in prange(len(x)):
        add_stress(effects, 0, magnet[p], rho[p], x[p], F[p], P[p])
        add_force(effects, 0, magnet[p], rho[p], x[p], F[p], f[p])


@kernel
def stress_per_shear(cells, particles, F, P):
    """Write the elastic stress over the shear modulus to P (n, 3, 3), no unit: it is linear in the moduli at a fixed K/G."""
    volume, shear, bulk, modes = particles.volume, particles.shear, particles.bulk, particles.modes
    for cell in prange(len(cells.plane)):
        first, last = cells.first[cell], cells.first[cell + 1]
        cof, c = np.empty((3, 3)), np.empty(modes.shape[1])
        _volume_moments(first, last, volume, modes, F, c)
        for p in range(first, last):
            J = determinant(F[p])
            pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p] / shear[p])
            cofactor(F[p], cof)
            stress(F[p], cof, J, 1.0, pressure, P[p])


@compiled
def _add_slot(volume, P, f, G, N, r):
    """r (3, 27) += volume (P grad N_a - f N_a): the share of one particle in one slot."""
    for k in range(3):
        a, b, c, d = volume * P[k, 0], volume * P[k, 1], volume * P[k, 2], volume * f[k]
        for node in range(STENCIL):
            r[k, node] += a * G[0, node] + b * G[1, node] + c * G[2, node] - d * N[node]


@kernel
def scatter(cells, particles, column, P, f, out):
    """P2G of many slots: sum over particles of volume (P grad N_a - f N_a), added to out (planes, columns, 3 nodes), N.

    column (slots, cells): which column a slot of a cell adds to, -1 for none; P (slots, n, 3, 3) Pa, f (slots, n, 3) N/m^3.
    """
    weights, slopes, volume = particles.weights, particles.slopes, particles.volume
    slabs, slots = len(cells.slab_first) - 1, len(column)
    for color in range(2):
        for half in prange((slabs + 1 - color) // 2):
            slab = 2 * half + color
            G, N, r = np.empty((3, STENCIL)), np.empty(STENCIL), np.empty((slots, 3, STENCIL))
            for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
                r[:] = 0.0
                for p in range(cells.first[cell], cells.first[cell + 1]):
                    _particle_gradients(weights[p], slopes[p], G)
                    _particle_splines(weights[p], N)
                    for slot in range(slots):
                        if column[slot, cell] >= 0:
                            _add_slot(volume[p], P[slot, p], f[slot, p], G, N, r[slot])
                for slot in range(slots):
                    if column[slot, cell] >= 0:
                        _scatter_column(cells.plane[cell], cells.row[cell], r[slot], column[slot, cell], out)


@compiled
def _particle_splines(weights, N):
    """Write a particle's 27 splines to N (27,)."""
    for a in range(3):
        for b in range(3):
            for c in range(3):
                N[9 * a + 3 * b + c] = weights[0, a] * weights[1, b] * weights[2, c]


@compiled
def _scatter_column(plane, rows, r, column, out):
    """Add a cell's (3, 27) values to one column of out (planes, columns, 3 nodes)."""
    for a in range(3):
        for b in range(3):
            first = 3 * rows[b]
            for c in range(3):
                for k in range(3):
                    out[plane + a, column, first + 3 * c + k] += r[k, 9 * a + 3 * b + c]
