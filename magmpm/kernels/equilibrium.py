"""P2G: particles scatter energy, residual and tangent to the grid.

The grid is cut into slabs of cells along its first axis. Slabs of one colour share no node, so each thread owns what it writes; the
two colours run one after the other. Sums are made in the same order whatever the number of threads: results are the same bit for bit.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.jit import compiled, kernel, prange
from magmpm.compiled.lapack import call
from magmpm.effects.hooks import (
    add_energy,
    add_force,
    add_softening,
    add_stress,
    add_tangent,
    any_softening,
)
from magmpm.materials import (
    cofactor,
    determinant,
    shape_energy,
    stress,
    tangent,
    volume_energy,
    volume_pressure,
)

STENCIL = 27  # nodes of a cell


@compiled
def _volume_moments(first, last, volume, modes, F, c):
    """c (modes,): moments of det F - 1 over a cell's particles, sum of volume mode (J - 1), in m^(3/2)."""
    c[:] = 0.0
    for p in range(first, last):
        change = volume[p] * (determinant(F[p]) - 1.0)
        for k in range(len(c)):
            c[k] += modes[p, k] * change


@compiled
def _volume_change(J, p, modes, c):
    """What the volume part of the energy sees at particle p: J, or its projection on the cell's modes."""
    if len(c) == 0:
        return J
    projected = 1.0
    for k in range(len(c)):
        projected += modes[p, k] * c[k]
    return projected


@kernel
def cell_energy(cell_first, volume, shear, bulk, modes, effects, remanence, density, x, F, energy, low, high):
    """Potential energy of each cell into energy (cells,) J; smallest and largest det F of its particles into low, high (cells,).

    modes (n, 0), (n, 1) or (n, 4): what the volume part is projected on, see bodies.volume_modes.
    A cell with det F <= 0 has energy inf.
    """
    for cell in prange(len(energy)):
        first, last = cell_first[cell], cell_first[cell + 1]
        c = np.empty(modes.shape[1])
        _volume_moments(first, last, volume, modes, F, c)
        total, lowest, highest = 0.0, np.inf, -np.inf
        for p in range(first, last):
            J = determinant(F[p])
            lowest, highest = min(lowest, J), max(highest, J)
            W = shape_energy(F[p], J, shear[p]) if J > 0.0 else np.inf
            if len(c) == 0:
                W += volume_energy(J, bulk[p])
            total += volume[p] * (W + add_energy(effects, 0, remanence[p], density[p], x[p], F[p]))
        for k in range(len(c)):  # K/2 (J - 1)^2 of the projection: the modes are orthogonal
            total += 0.5 * bulk[first] * c[k] ** 2
        energy[cell], low[cell], high[cell] = total, lowest, highest


@compiled
def _particle_gradients(weights, slopes, G):
    """Gradients of a particle's 27 splines into G (3, 27), 1/m; nodes in the order x slowest."""
    for a in range(3):
        for b in range(3):
            nn, dn, nd = (
                weights[0, a] * weights[1, b],
                slopes[0, a] * weights[1, b],
                weights[0, a] * slopes[1, b],
            )
            for c in range(3):
                node = 9 * a + 3 * b + c
                G[0, node] = dn * weights[2, c]
                G[1, node] = nd * weights[2, c]
                G[2, node] = nn * slopes[2, c]


@compiled
def _add_residual(weights, G, P, f, volume, r):
    """r (27, 3) += volume (P grad N_a - f N_a), N: one particle's share of the cell's residual."""
    for a in range(3):
        for b in range(3):
            nn = weights[0, a] * weights[1, b]
            for c in range(3):
                node = 9 * a + 3 * b + c
                n = nn * weights[2, c]
                for k in range(3):
                    r[node, k] += volume * (
                        P[k, 0] * G[0, node] + P[k, 1] * G[1, node] + P[k, 2] * G[2, node] - f[k] * n
                    )


@compiled
def _scatter_vector(plane, rows, r, residual):
    """A cell's (27, 3) residual into residual (planes, 3 nodes)."""
    for a in range(3):
        for b in range(3):
            first = 3 * rows[b]
            for c in range(3):
                for k in range(3):
                    residual[plane + a, first + 3 * c + k] += r[9 * a + 3 * b + c, k]


@kernel
def scatter_residual(
    slab_first, cell_first, cell_plane, cell_row, weights, slopes, volume, shear, bulk, modes, effects, remanence, density, x, F,
    residual,
):  # fmt: skip
    """Gradient of the potential energy with respect to the grid's coefficients, added to residual (planes, 3 nodes), N."""
    slabs = len(slab_first) - 1
    for colour in range(2):
        for half in prange((slabs + 1 - colour) // 2):
            slab = 2 * half + colour
            G, P, cof = np.empty((3, STENCIL)), np.empty((3, 3)), np.empty((3, 3))
            f, r, c = np.empty(3), np.empty((STENCIL, 3)), np.empty(modes.shape[1])
            for cell in range(slab_first[slab], slab_first[slab + 1]):
                first, last = cell_first[cell], cell_first[cell + 1]
                _volume_moments(first, last, volume, modes, F, c)
                r[:] = 0.0
                for p in range(first, last):
                    J = determinant(F[p])
                    pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p])
                    cofactor(F[p], cof)
                    stress(F[p], cof, J, shear[p], pressure, P)
                    f[:] = 0.0
                    add_stress(effects, 0, remanence[p], density[p], x[p], F[p], P)
                    add_force(effects, 0, remanence[p], density[p], x[p], F[p], f)
                    _particle_gradients(weights[p], slopes[p], G)
                    _add_residual(weights[p], G, P, f, volume[p], r)
                _scatter_vector(cell_plane[cell], cell_row[cell], r, residual)


@compiled
def _particle_products(q, volume, A, G, T):
    """Rows q .. q + 2 of T [q, i, k, node]: volume A_iJkL dN/dX_L for J = 0, 1, 2."""
    for j in range(3):
        for i in range(3):
            for k in range(3):
                a0, a1, a2 = (
                    volume * A[3 * i + j, 3 * k],
                    volume * A[3 * i + j, 3 * k + 1],
                    volume * A[3 * i + j, 3 * k + 2],
                )
                for node in range(STENCIL):
                    T[q + j, i, k, node] = a0 * G[q, node] + a1 * G[q + 1, node] + a2 * G[q + 2, node]


@compiled
def _particle_softening(q, volume, weights, H, M, G, T):
    """What place adds to a particle's products: its splines N are a fourth row of G, and W depends on x = X + sum N c as well.

    d2W/dc_a dc_b = N_a H N_b + N_a M grad N_b + (N_b M grad N_a)^T: row q + 3 of T, and more for rows q .. q + 2.
    """
    for a in range(3):
        for b in range(3):
            for c in range(3):
                G[q + 3, 9 * a + 3 * b + c] = weights[0, a] * weights[1, b] * weights[2, c]
    for i in range(3):
        for k in range(3):
            h, m0, m1, m2 = (
                volume * H[i, k],
                volume * M[i, 3 * k],
                volume * M[i, 3 * k + 1],
                volume * M[i, 3 * k + 2],
            )
            for node in range(STENCIL):
                T[q + 3, i, k, node] = (
                    h * G[q + 3, node] + m0 * G[q, node] + m1 * G[q + 1, node] + m2 * G[q + 2, node]
                )
            for j in range(3):
                m = volume * M[k, 3 * i + j]
                for node in range(STENCIL):
                    T[q + j, i, k, node] += m * G[q + 3, node]


@compiled
def _cell_tangent(
    first,
    last,
    weights,
    slopes,
    volume,
    shear,
    bulk,
    modes,
    effects,
    remanence,
    density,
    x,
    F,
    fortran,
    work,
    K,
    r,
):
    """Tangent K [node, i, k, other node] (27, 3, 3, 27) and residual r (27, 3) of one cell.

    K = sum over particles and J of dN/dX_J(node) T(J, i, k, other): one matrix product, left to BLAS.
    """
    G, T, A, P, H, M, cof, f, b, c, letters, sizes, factors = work
    rows_each = 4 if any_softening(effects) else 3
    _volume_moments(first, last, volume, modes, F, c)
    r[:] = 0.0
    b[:] = 0.0
    for p in range(first, last):
        q = rows_each * (p - first)
        J = determinant(F[p])
        pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p])
        cofactor(F[p], cof)
        stress(F[p], cof, J, shear[p], pressure, P)
        tangent(F[p], cof, J, shear[p], pressure, bulk[p] if len(c) == 0 else 0.0, A)
        f[:] = 0.0
        add_stress(effects, 0, remanence[p], density[p], x[p], F[p], P)
        add_tangent(effects, 0, remanence[p], density[p], x[p], F[p], A)
        add_force(effects, 0, remanence[p], density[p], x[p], F[p], f)
        _particle_gradients(weights[p], slopes[p], G[q : q + 3])
        _add_residual(weights[p], G[q : q + 3], P, f, volume[p], r)
        _particle_products(q, volume[p], A, G, T)
        if any_softening(effects):
            H[:], M[:] = 0.0, 0.0
            add_softening(effects, 0, remanence[p], density[p], x[p], F[p], H, M)
            _particle_softening(q, volume[p], weights[p], H, M, G, T)
        for k in range(3 if len(c) > 0 else 0):
            for node in range(STENCIL):
                change = volume[p] * (
                    cof[k, 0] * G[q, node] + cof[k, 1] * G[q + 1, node] + cof[k, 2] * G[q + 2, node]
                )
                for mode in range(len(c)):
                    b[mode, k, node] += modes[p, mode] * change
    sizes[2] = rows_each * (last - first)
    plain, trans = letters[0:].ctypes.data, letters[1:].ctypes.data
    rows, nodes, count = sizes[0:].ctypes.data, sizes[1:].ctypes.data, sizes[2:].ctypes.data
    one, zero = factors[0:].ctypes.data, factors[1:].ctypes.data
    call(
        fortran[3],
        (
            plain,
            trans,
            rows,
            nodes,
            count,
            one,
            T.ctypes.data,
            rows,
            G.ctypes.data,
            nodes,
            zero,
            K.ctypes.data,
            rows,
        ),
    )
    for mode in range(len(c)):  # the projected volume part's second derivative: one outer product a mode
        for node in range(STENCIL):
            for i in range(3):
                scale = bulk[first] * b[mode, i, node]
                for k in range(3):
                    for other in range(STENCIL):
                        K[node, i, k, other] += scale * b[mode, k, other]


@compiled
def _kept_rows(column, a, split):
    """Which of a cell's three planes are rows of its column plane `column` (its a-th) in the panels: first and one past last."""
    if column >= split + 2:
        return 0, a + 1
    if column >= split:  # the two planes where the halves meet keep only each other
        return a, min(3, a + split + 2 - column)
    return a, 3


@compiled
def _scatter_matrix(plane, rows, split, K, panels):
    """A cell's tangent into the panels (see statics.block_cholesky): only the rows each column's panel keeps."""
    m = panels.shape[1]
    for a in range(3):
        column = plane + a
        low, high = _kept_rows(column, a, split)
        for b in range(3):
            for c in range(3):
                for i in range(3):
                    target = panels[column, 3 * (rows[b] + c) + i]
                    block = K[9 * a + 3 * b + c, i]
                    for other in range(low, high):
                        for d in range(3):
                            first = abs(other - a) * m + 3 * rows[d]
                            node = 9 * other + 3 * d
                            for k in range(3):
                                target[first + k] += block[k, node]
                                target[first + 3 + k] += block[k, node + 1]
                                target[first + 6 + k] += block[k, node + 2]


@kernel
def scatter_tangent(
    slab_first, cell_first, cell_plane, cell_row, split, most, weights, slopes, volume, shear, bulk, modes, effects, remanence,
    density, x, F, fortran, residual, panels,
):  # fmt: skip
    """Residual (as scatter_residual) and tangent: second derivative of the potential energy, added to panels (planes, m, 3 m), N/m.

    most: largest number of particles in a cell; split: where the panels' two halves meet (statics.block_cholesky).
    """
    slabs = len(slab_first) - 1
    for colour in range(2):
        for half in prange((slabs + 1 - colour) // 2):
            slab = 2 * half + colour
            most_rows = most * (4 if any_softening(effects) else 3)
            G, T = np.empty((most_rows, STENCIL)), np.empty((most_rows, 3, 3, STENCIL))
            H, M = np.empty((3, 3)), np.empty((3, 9))
            A, P, cof, f = np.empty((9, 9)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
            letters, sizes = np.array([78, 84], np.uint8), np.array([9 * STENCIL, STENCIL, 0], np.int32)
            c, b = np.empty(modes.shape[1]), np.empty((modes.shape[1], 3, STENCIL))
            work = (G, T, A, P, H, M, cof, f, b, c, letters, sizes, np.array([1.0, 0.0]))
            K, r = np.empty((STENCIL, 3, 3, STENCIL)), np.empty((STENCIL, 3))
            for cell in range(slab_first[slab], slab_first[slab + 1]):
                _cell_tangent(
                    cell_first[cell], cell_first[cell + 1], weights, slopes, volume, shear, bulk, modes, effects, remanence,
                    density, x, F, fortran, work, K, r,
                )  # fmt: skip
                _scatter_vector(cell_plane[cell], cell_row[cell], r, residual)
                _scatter_matrix(cell_plane[cell], cell_row[cell], split, K, panels)
