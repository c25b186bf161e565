"""The steps of a static solve: energy, forces and tangent of the particles on a grid in the undeformed body.

Each Newton step takes the three steps of the method once. P2G: `particles_to_grid` scatters forces, `particles_to_grid_with_tangent` forces
and tangent. Grid update: the linear solve and the line search (statics.newton, with the factors of statics.block_cholesky).
G2P: `grid_to_particles` gathers displacement and deformation gradient.

The grid is cut into slabs of cells along its first axis. Slabs of one color share no node, so each thread owns what it writes. The
two colors run one after the other. The order of every sum does not depend on the number of threads: results are the same bit for bit.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.by_address import call
from magmpm.compiled.jit import chosen_by_types, compiled, inner, task_body
from magmpm.compiled.parallel import over_parts, over_slabs, task
from magmpm.effects.calls import (
    add_curvatures,
    add_energies,
    add_loads,
    given_for,
    particles_from,
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


class StaticCells(NamedTuple):
    """Cells with particles of one material, as statics.layout.UnknownsLayout numbers them.

    slab_first (slabs + 1,) first cell of each slab of two base planes; first (cells + 1,) first particle of each cell; plane (cells,) and
    row (cells, 3): the first plane of nodes, and the rows in a plane, that a cell touches; most: largest number of particles in a cell.
    """

    slab_first: Index
    first: Index
    plane: Index
    row: Index
    most: int


class StaticParticles(NamedTuple):
    """Particles (n) sorted by cell.

    weights, slopes (n, 3, 3): values and slopes (1/m) of the splines, axis by node; volume m^3, shear, bulk Pa, density kg/m^3 (n,); modes
    (n, 0), (n, 1) or (n, 4): the modes of the volume part (model.volume_modes); remanence (n, 3) T, or (n, 4) if marked (acting.marked).
    """

    weights: Array
    slopes: Array
    volume: Array
    shear: Array
    bulk: Array
    modes: Array
    remanence: Array
    density: Array


@inner
def _volume_moments(first, last, volume, modes, F, c):
    """c (modes,): moments of det F - 1 over a cell's particles, sum of volume mode (J - 1), in m^(3/2)."""
    c[:] = 0.0
    for p in range(first, last):
        change = volume[p] * (determinant(F[p]) - 1.0)
        for k in range(len(c)):
            c[k] += modes[p, k] * change


@inner
def _volume_change(J, p, modes, c):
    """J at particle p as it enters the volume part of the energy: det F itself, or its projection on the cell's modes."""
    if len(c) == 0:
        return J
    projected = 1.0
    for k in range(len(c)):
        projected += modes[p, k] * c[k]
    return projected


@task_body
def _energy_of_cell(cell, given):
    """`cell_energy` of one cell."""
    cells, particles, calls, x, F, energy, low, high = given
    volume = particles.volume
    shear = particles.shear
    bulk = particles.bulk
    modes = particles.modes
    remanence = particles.remanence
    density = particles.density
    first = cells.first[cell]
    last = cells.first[cell + 1]
    c = np.empty(modes.shape[1])
    _volume_moments(first, last, volume, modes, F, c)
    total = 0.0
    lowest = np.inf
    highest = -np.inf
    loaded = np.zeros(last - first)
    given = given_for()
    particles_from(given, first, remanence, density, x, F)
    add_energies(calls.energy, last - first, given, loaded)
    for p in range(first, last):
        J = determinant(F[p])
        lowest = min(lowest, J)
        highest = max(highest, J)
        W = shape_energy(F[p], J, shear[p]) if J > 0.0 else np.inf
        if len(c) == 0:
            W += volume_energy(J, bulk[p])
        total += volume[p] * (W + loaded[p - first])
    for k in range(len(c)):  # K/2 (J - 1)^2 of the projection: the modes are orthogonal
        total += 0.5 * bulk[first] * c[k] ** 2
    energy[cell], low[cell], high[cell] = total, lowest, highest


@compiled
def cell_energy(cells, particles, calls, x, F, energy, low, high):
    """Write each cell's potential energy to energy (cells,) J, and the smallest and largest det F of its particles to low, high (cells,).

    x (n, 3) m, F (n, 3, 3) of the particles; calls: effects.calls.RestCalls. A cell with det F <= 0 has energy inf.
    """
    over_parts(
        len(energy), task(_energy_of_cell, (cells, particles, calls, x, F, energy, low, high))
    )


@inner
def _particle_gradients(weights, slopes, G):
    """Write the gradients of a particle's 27 splines to G (3, 27), 1/m. Nodes are ordered x slowest."""
    for a in range(3):
        for b in range(3):
            nn = weights[0, a] * weights[1, b]
            dn = slopes[0, a] * weights[1, b]
            nd = weights[0, a] * slopes[1, b]
            for c in range(3):
                node = 9 * a + 3 * b + c
                G[0, node] = dn * weights[2, c]
                G[1, node] = nd * weights[2, c]
                G[2, node] = nn * slopes[2, c]


@inner
def particle_splines(weights, N):
    """Write a particle's 27 splines to N (27,)."""
    for a in range(3):
        for b in range(3):
            for c in range(3):
                N[9 * a + 3 * b + c] = weights[0, a] * weights[1, b] * weights[2, c]


@inner
def _add_residual(weights, G, P, f, volume, r):
    """r (27, 3) += volume (P grad N_a - f N_a), N: the share of one particle in the cell's residual."""
    for a in range(3):
        for b in range(3):
            nn = weights[0, a] * weights[1, b]
            for c in range(3):
                node = 9 * a + 3 * b + c
                n = nn * weights[2, c]
                for k in range(3):
                    r[node, k] += volume * (
                        P[k, 0] * G[0, node]
                        + P[k, 1] * G[1, node]
                        + P[k, 2] * G[2, node]
                        - f[k] * n
                    )


@inner
def _scatter_vector(plane, rows, r, residual):
    """Add a cell's (27, 3) residual to residual (planes, 3 nodes)."""
    for a in range(3):
        for b in range(3):
            first = 3 * rows[b]
            for c in range(3):
                for k in range(3):
                    residual[plane + a, first + 3 * c + k] += r[9 * a + 3 * b + c, k]


@inner
def _elastic(first, last, particles, F, cof, c, P):
    """Write the elastic stress (Pa) of a cell's particles to P (last - first, 3, 3), and its moments to c (modes,); cof: work space."""
    _volume_moments(first, last, particles.volume, particles.modes, F, c)
    for p in range(first, last):
        J = determinant(F[p])
        change = _volume_change(J, p, particles.modes, c)
        cofactor(F[p], cof)
        pressure = volume_pressure(change, particles.bulk[p])
        stress(F[p], cof, J, particles.shear[p], pressure, P[p - first])


@task_body
def _slab_to_grid(slab, given):
    """`particles_to_grid` of one slab."""
    cells, particles, calls, x, F, residual = given
    weights = particles.weights
    slopes = particles.slopes
    volume = particles.volume
    modes = particles.modes
    remanence = particles.remanence
    density = particles.density
    G = np.empty((3, STENCIL))
    P = np.empty((cells.most, 3, 3))
    cof = np.empty((3, 3))
    f = np.empty((cells.most, 3))
    r = np.empty((STENCIL, 3))
    c = np.empty(modes.shape[1])
    given = given_for()
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        first = cells.first[cell]
        last = cells.first[cell + 1]
        _elastic(first, last, particles, F, cof, c, P)
        r[:] = 0.0
        f[:] = 0.0
        particles_from(given, first, remanence, density, x, F)
        add_loads(calls.load, last - first, given, P, f)
        for p in range(first, last):
            _particle_gradients(weights[p], slopes[p], G)
            _add_residual(weights[p], G, P[p - first], f[p - first], volume[p], r)
        _scatter_vector(cells.plane[cell], cells.row[cell], r, residual)


@compiled
def particles_to_grid(cells, particles, calls, x, F, residual):
    """P2G: gradient of the potential energy with respect to the grid's coefficients, added to residual (planes, 3 nodes), N."""
    over_slabs(
        len(cells.slab_first) - 1, task(_slab_to_grid, (cells, particles, calls, x, F, residual))
    )


@inner
def _particle_products(q, volume, A, G, T):
    """Rows q .. q + 2 of T [q, i, k, node]: volume A_iJkL dN/dX_L for J = 0, 1, 2."""
    for j in range(3):
        for i in range(3):
            for k in range(3):
                a0 = volume * A[3 * i + j, 3 * k]
                a1 = volume * A[3 * i + j, 3 * k + 1]
                a2 = volume * A[3 * i + j, 3 * k + 2]
                for node in range(STENCIL):
                    T[q + j, i, k, node] = (
                        a0 * G[q, node] + a1 * G[q + 1, node] + a2 * G[q + 2, node]
                    )


@inner
def _particle_softening(q, volume, weights, H, M, G, T):
    """Add the terms of an energy W that also depends on position, x = X + sum N c. The splines N of the particle are a fourth row of G.

    d2W/dc_a dc_b = N_a H N_b + N_a M grad N_b + (N_b M grad N_a)^T: row q + 3 of T, and additions to rows q .. q + 2.
    """
    particle_splines(weights, G[q + 3])
    for i in range(3):
        for k in range(3):
            h = volume * H[i, k]
            m0 = volume * M[i, 3 * k]
            m1 = volume * M[i, 3 * k + 1]
            m2 = volume * M[i, 3 * k + 2]
            for node in range(STENCIL):
                T[q + 3, i, k, node] = (
                    h * G[q + 3, node] + m0 * G[q, node] + m1 * G[q + 1, node] + m2 * G[q + 2, node]
                )
            for j in range(3):
                m = volume * M[k, 3 * i + j]
                for node in range(STENCIL):
                    T[q + j, i, k, node] += m * G[q + 3, node]


class Room(NamedTuple):
    """Work space for a cell's tangent: rows of gradients G and products T; P, f of its particles; A, H, M, cof of one of them; moments c
    of the volume part and their gradients b; addresses for effects; arguments of the matrix product."""

    G: Array
    T: Array
    A: Array
    P: Array
    H: Array
    M: Array
    cof: Array
    f: Array
    b: Array
    c: Array
    given: NDArray[Any]
    letters: NDArray[np.uint8]
    sizes: NDArray[np.int32]
    factors: Array


@inner
def _room(most, each, modes):
    """Work space for this many particles, rows of each, and modes."""
    rows = most * each
    # N T
    letters = np.array([78, 84], np.uint8)
    sizes = np.array([9 * STENCIL, STENCIL, 0], np.int32)
    return Room(
        np.empty((rows, STENCIL)),
        np.empty((rows, 3, 3, STENCIL)),
        np.empty((9, 9)),
        np.empty((most, 3, 3)),
        np.empty((3, 3)),
        np.empty((3, 9)),
        np.empty((3, 3)),
        np.empty((most, 3)),
        np.empty((modes, 3, STENCIL)),
        np.empty(modes),
        given_for(),
        letters,
        sizes,
        np.array([1.0, 0.0]),
    )


@inner
def _cell_tangent(cell, cells, particles, calls, x, F, fortran, room, K, r):
    """Tangent K [node, i, k, other] (27, 3, 3, 27) and residual r (27, 3): sum over particles and J of dN/dX_J(node) T(J, i, k, other)."""
    weights, slopes, volume, shear, bulk, modes, remanence, density = particles
    G, T, A, P, H, M, cof, f, b, c, given, _, _, _ = room
    first = cells.first[cell]
    last = cells.first[cell + 1]
    softens = calls.softens > 0
    rows_each = 4 if softens else 3
    _elastic(first, last, particles, F, cof, c, P)
    r[:] = 0.0
    b[:] = 0.0
    f[:] = 0.0
    particles_from(given, first, remanence, density, x, F)
    add_loads(calls.load, last - first, given, P, f)
    for p in range(first, last):
        q = rows_each * (p - first)
        J = determinant(F[p])
        pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p])
        cofactor(F[p], cof)
        tangent(F[p], cof, J, shear[p], pressure, bulk[p] if len(c) == 0 else 0.0, A)
        particles_from(given, p, remanence, density, x, F)
        H[:] = 0.0
        M[:] = 0.0
        add_curvatures(calls.curvature, 1, given, A, H, M)
        _particle_gradients(weights[p], slopes[p], G[q : q + 3])
        _add_residual(weights[p], G[q : q + 3], P[p - first], f[p - first], volume[p], r)
        _particle_products(q, volume[p], A, G, T)
        if softens:
            _particle_softening(q, volume[p], weights[p], H, M, G, T)
        for k in range(3 if len(c) > 0 else 0):
            for node in range(STENCIL):
                change = volume[p] * (
                    cof[k, 0] * G[q, node] + cof[k, 1] * G[q + 1, node] + cof[k, 2] * G[q + 2, node]
                )
                for mode in range(len(c)):
                    b[mode, k, node] += modes[p, mode] * change
    multiply(rows_each * (last - first), fortran, room, 1, 1, 2, T, 0, G, 1, K)
    for mode in range(
        len(c)
    ):  # second derivative of the projected volume part: one outer product for each mode
        for node in range(STENCIL):
            for i in range(3):
                scale = bulk[first] * b[mode, i, node]
                for k in range(3):
                    for other in range(STENCIL):
                        K[node, i, k, other] += scale * b[mode, k, other]


@inner
def multiply(count, fortran, room, turned, rows, inner, A, a, B, b, C):
    """C = B A, or B^T A where `turned` is 1, row by row, by dgemm. The third of room.sizes is set to `count`, the first is the length of
    C's rows; rows, inner, a, b: places there of C's number of rows, of the sum's length, and of how far rows of A and of B are apart.
    """
    letters = room.letters
    sizes = room.sizes
    factors = room.factors
    sizes[2] = count
    plain = letters[0:].ctypes.data
    way = letters[turned:].ctypes.data
    wide = sizes[0:].ctypes.data
    one = factors[0:].ctypes.data
    zero = factors[1:].ctypes.data
    outs = sizes[rows:].ctypes.data
    sums = sizes[inner:].ctypes.data
    first = (A.ctypes.data, sizes[a:].ctypes.data)
    second = (B.ctypes.data, sizes[b:].ctypes.data)
    call(
        fortran[3],
        (
            plain,
            way,
            wide,
            outs,
            sums,
            one,
            first[0],
            first[1],
            second[0],
            second[1],
            zero,
            C.ctypes.data,
            wide,
        ),
    )


@inner
def _kept_rows(column, a, split):
    """Planes of a cell, of its three, that are rows of its a-th plane, column `column` of the panels: the first, and one past the last."""
    if column >= split + 2:
        return 0, a + 1
    if (
        column >= split
    ):  # where the halves meet, each of the two planes keeps only rows of these two
        return a, min(3, a + split + 2 - column)
    return a, 3


class Panels(NamedTuple):
    """A matrix of bands (statics.block_cholesky): panels (planes + 2, m, 3 m), and the plane where their two halves meet."""

    values: Array
    split: int


class Blocks(NamedTuple):
    """A sparse matrix (statics.sparse_cholesky): block (cells, 27, 27) of each two nodes of a cell, -1 for none; values (blocks, 3, 3)."""

    block: NDArray[np.int32]
    values: Array


@compiled
def _scatter_to_blocks(cell, K, matrix):
    """Add a cell's tangent to the blocks of a sparse matrix."""
    for node in range(STENCIL):
        for other in range(STENCIL):
            block = matrix.block[cell, node, other]
            if block >= 0:
                for i in range(3):
                    for k in range(3):
                        matrix.values[block, i, k] += K[node, i, k, other]


@compiled
def _scatter_to_panels(plane, rows, K, matrix):
    """Add a cell's tangent to the panels of a matrix of bands: only the rows that each column's panel keeps."""
    panels = matrix.values
    split = matrix.split
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


def _scatter_matrix_of(cell, plane, rows, K, matrix):
    """The code of `scatter_matrix` for a kind of matrix."""
    if matrix.instance_class is Blocks:
        return lambda cell, plane, rows, K, matrix: _scatter_to_blocks(cell, K, matrix)
    return lambda cell, plane, rows, K, matrix: _scatter_to_panels(plane, rows, K, matrix)


scatter_matrix = chosen_by_types(
    _scatter_matrix_of
)  # adds the tangent of a cell to a matrix of either kind


@task_body
def _slab_to_grid_with_tangent(slab, given):
    """`particles_to_grid_with_tangent` of one slab."""
    cells, particles, calls, x, F, matrix, fortran, residual = given
    each = 4 if calls.softens > 0 else 3
    room = _room(cells.most, each, particles.modes.shape[1])
    K = np.empty((STENCIL, 3, 3, STENCIL))
    r = np.empty((STENCIL, 3))
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        _cell_tangent(cell, cells, particles, calls, x, F, fortran, room, K, r)
        _scatter_vector(cells.plane[cell], cells.row[cell], r, residual)
        scatter_matrix(cell, cells.plane[cell], cells.row[cell], K, matrix)


@compiled
def particles_to_grid_with_tangent(cells, particles, calls, x, F, matrix, fortran, residual):
    """P2G: residual as in `particles_to_grid`, and second derivative of the potential energy, N/m, added to a matrix, Panels or Blocks."""
    over_slabs(
        len(cells.slab_first) - 1,
        task(
            _slab_to_grid_with_tangent, (cells, particles, calls, x, F, matrix, fortran, residual)
        ),
    )


@task_body
def _gradients_of_slab(slab, given):
    """Scatter the products of one slab's gradients to the matrix: a thread's share of `gradient_products`."""
    cells, particles, weight, matrix = given
    K = np.zeros((STENCIL, 3, 3, STENCIL))
    G = np.empty((3, STENCIL))
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        for i in range(3):
            K[:, i, i] = 0.0
        for p in range(cells.first[cell], cells.first[cell + 1]):
            _particle_gradients(particles.weights[p], particles.slopes[p], G)
            for node in range(STENCIL):
                for other in range(STENCIL):
                    product = (
                        G[0, node] * G[0, other]
                        + G[1, node] * G[1, other]
                        + G[2, node] * G[2, other]
                    )
                    for i in range(3):
                        K[node, i, i, other] += weight[p] * product
        scatter_matrix(cell, cells.plane[cell], cells.row[cell], K, matrix)


@compiled
def gradient_products(cells, particles, weight, matrix):
    """P2G: add the sum over particles of weight grad N_a . grad N_b, for each axis alike, to a matrix, Panels or Blocks; weight (n,)."""
    over_slabs(
        len(cells.slab_first) - 1, task(_gradients_of_slab, (cells, particles, weight, matrix))
    )


@task_body
def _stresses_of_slab(slab, given):
    """Scatter the stresses of one slab's particles to the residual: a thread's share of `add_stresses`."""
    cells, particles, P, residual = given
    G = np.empty((3, STENCIL))
    r = np.empty((STENCIL, 3))
    f = np.zeros(3)
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        r[:] = 0.0
        for p in range(cells.first[cell], cells.first[cell + 1]):
            _particle_gradients(particles.weights[p], particles.slopes[p], G)
            _add_residual(particles.weights[p], G, P[p], f, particles.volume[p], r)
        _scatter_vector(cells.plane[cell], cells.row[cell], r, residual)


@compiled
def add_stresses(cells, particles, P, residual):
    """P2G: add the sum over particles of volume P grad N_a to residual (planes, 3 nodes); P (n, 3, 3)."""
    over_slabs(len(cells.slab_first) - 1, task(_stresses_of_slab, (cells, particles, P, residual)))


@inner
def _at_rest(rest, p, k, j):
    """Entry of F at rest: of all particles alike, rest (3, 3), or of each, (n, 3, 3)."""
    return rest[k, j] if rest.ndim == 2 else rest[p, k, j]


@task_body
def _cell_to_particles(cell, given):
    """`grid_to_particles` of one cell."""
    cells, particles, grid, rest, displacement, F = given
    weights = particles.weights
    slopes = particles.slopes
    for p in range(cells.first[cell], cells.first[cell + 1]):
        for k in range(3):
            displacement[p, k] = 0.0
            for j in range(3):
                F[p, k, j] = _at_rest(rest, p, k, j)
        for a in range(3):
            plane = grid[cells.plane[cell] + a]
            nx = weights[p, 0, a]
            dx = slopes[p, 0, a]
            for b in range(3):
                first = 3 * cells.row[cell, b]
                nn = nx * weights[p, 1, b]
                dn = dx * weights[p, 1, b]
                nd = nx * slopes[p, 1, b]
                for c in range(3):
                    nz = weights[p, 2, c]
                    g0 = dn * nz
                    g1 = nd * nz
                    g2 = nn * slopes[p, 2, c]
                    for k in range(3):
                        value = plane[first + 3 * c + k]
                        displacement[p, k] += nn * nz * value
                        F[p, k, 0] += g0 * value
                        F[p, k, 1] += g1 * value
                        F[p, k, 2] += g2 * value


@compiled
def grid_to_particles(cells, particles, grid, rest, displacement, F):
    """G2P: displacement and deformation gradient of every particle: u = sum N_a c_a, F = I + sum c_a (x) grad N_a.

    grid (planes, 3 nodes): coefficients in m; rest (3, 3), or (n, 3, 3) of each particle: F at rest, the
    directions of the grid's axes (statics.layout). Writes displacement (n, 3) m and F (n, 3, 3).
    """
    over_parts(
        len(cells.plane), task(_cell_to_particles, (cells, particles, grid, rest, displacement, F))
    )
