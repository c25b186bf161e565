"""Kernels of dynamics.drift_correction: from a model's particles to splines on the grid of the undeformed body and back, cell by cell.

The order of every sum does not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, kernel, prange
from magmpm.compiled.simd import determinant_of
from magmpm.materials import determinant


class Cells(NamedTuple):
    """Cells of the undeformed body. The particles of a cell are consecutive.

    slab_first (slabs + 1,): first cell of each slab, every second slab shares no node; first (cells + 1,): first particle of each cell;
    node (cells, 27): nodes, z fastest; low (cells, 3) m: lower corners; per (3,) 1/m: 1 / h.
    """

    slab_first: Index
    first: Index
    node: NDArray[np.int32]
    low: Array
    per: Array


class Particles(NamedTuple):
    """Particles (n): rest (n, 3) m: positions in the undeformed body; volume m^3, density kg/m^3 (n,); modes (n, 0) or (n, 4):
    bodies.volume_modes."""

    rest: Array
    volume: Array
    density: Array
    modes: Array


@compiled
def _splines(t, N, S):
    """The three splines N (3,) at t in a cell, 0 to 1, and their derivatives S (3,) by t."""
    N[0], N[1], N[2] = 0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t
    S[0], S[1], S[2] = t - 1.0, 1.0 - 2.0 * t, t


@compiled
def _weights(a, b, c, out):
    """out (27,): all products a_i b_j c_k of three numbers each."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[9 * i + 3 * j + k] = a[i] * b[j] * c[k]


@compiled
def _sum(a, b):
    total = 0.0
    for k in range(27):
        total += a[k] * b[k]
    return total


@kernel
def interpolate(cells, rest, field, out):
    """out (n, 3): values of a nodal field (nodes, 3) at the particles."""
    cell_first, node, low, per = cells.first, cells.node, cells.low, cells.per
    for cell in prange(len(cell_first) - 1):
        N, S, W, near = np.empty((3, 3)), np.empty(3), np.empty(27), np.empty((3, 27))
        for a in range(27):
            for i in range(3):
                near[i, a] = field[node[cell, a], i]
        for p in range(cell_first[cell], cell_first[cell + 1]):
            for axis in range(3):
                _splines((rest[p, axis] - low[cell, axis]) * per[axis], N[axis], S)
            _weights(N[0], N[1], N[2], W)
            for i in range(3):
                out[p, i] = _sum(W, near[i])


@kernel
def moments(cells, particles, values, out):
    """out (nodes, 3) += sum over particles of m N values (n, 3)."""
    slab_first, cell_first, node, low, per = cells
    rest, volume, density, _ = particles
    slabs = len(slab_first) - 1
    for color in range(2):
        for half in prange((slabs + 1 - color) // 2):
            slab = 2 * half + color
            N, S, W, near = np.empty((3, 3)), np.empty(3), np.empty(27), np.empty((3, 27))
            for cell in range(slab_first[slab], slab_first[slab + 1]):
                near[:] = 0.0
                for p in range(cell_first[cell], cell_first[cell + 1]):
                    for axis in range(3):
                        _splines((rest[p, axis] - low[cell, axis]) * per[axis], N[axis], S)
                    _weights(N[0], N[1], N[2], W)
                    for i in range(3):
                        share = volume[p] * density[p] * values[p, i]
                        for a in range(27):
                            near[i, a] += share * W[a]
                for a in range(27):
                    for i in range(3):
                        out[node[cell, a], i] += near[i, a]


@compiled
def _lane_determinant(F, at):
    """det F of one particle of a block: one lane, its first entry at `at`."""
    return determinant_of(F[at], F[at + 8], F[at + 16], F[at + 24], F[at + 32], F[at + 40], F[at + 48], F[at + 56], F[at + 64])


@kernel
def relax(cells, particles, field, moved, alone, pressed, torn, part, row, x, F):
    """x <- x + part (fit - x) and F <- F + part (A - F), A = I + sum field (x) grad N with its det projected on the cell's modes (F-bar).

    moved (n, 3) m: present displacements. Some particles stay as they are: those marked in alone (n,), those farther than torn (m) from
    the fit, and those whose A has det A <= 0. pressed (n,): for these only F changes, and only where det F is above the projected det.
    row (n,): row of each particle in x and F, which are flat in blocks of eight (dynamics.apic).
    """
    cell_first, node, low, per = cells.first, cells.node, cells.low, cells.per
    rest, volume, modes = particles.rest, particles.volume, particles.modes
    count = modes.shape[1]
    for cell in prange(len(cell_first) - 1):
        first, last = cell_first[cell], cell_first[cell + 1]
        N, S, W, near = np.empty((3, 3)), np.empty((3, 3)), np.empty(27), np.empty((3, 27))
        A, off, J, c = np.empty((last - first, 3, 3)), np.empty((last - first, 3)), np.empty(last - first), np.zeros(count)
        for a in range(27):
            for i in range(3):
                near[i, a] = field[node[cell, a], i]
        for p in range(first, last):
            B = A[p - first]
            for axis in range(3):
                _splines((rest[p, axis] - low[cell, axis]) * per[axis], N[axis], S[axis])
            _weights(N[0], N[1], N[2], W)
            for i in range(3):
                off[p - first, i] = _sum(W, near[i]) - moved[p, i]
            for axis in range(3):
                _weights(S[0] if axis == 0 else N[0], S[1] if axis == 1 else N[1], S[2] if axis == 2 else N[2], W)
                for i in range(3):
                    B[i, axis] = _sum(W, near[i]) * per[axis] + (1.0 if i == axis else 0.0)
            J[p - first] = determinant(B)
            for k in range(count):
                c[k] += volume[p] * modes[p, k] * (J[p - first] - 1.0)
        for p in range(first, last):
            projected, misfit = 1.0 if count else J[p - first], 0.0
            for k in range(count):
                projected += modes[p, k] * c[k]
            for i in range(3):
                misfit += off[p - first, i] * off[p - first, i]
            if alone[p] or not misfit < torn * torn or not (projected > 0.0 and J[p - first] > 0.0):
                continue
            scale = (projected / J[p - first]) ** (1.0 / 3.0)
            block, lane = row[p] // 8, row[p] % 8
            if pressed[p]:
                if not _lane_determinant(F, 72 * block + lane) > projected:
                    continue
            else:
                for i in range(3):
                    x[24 * block + 8 * i + lane] += part * off[p - first, i]
            for i in range(3):
                for j in range(3):
                    k = 72 * block + 8 * (3 * i + j) + lane
                    F[k] += part * (scale * A[p - first, i, j] - F[k])
