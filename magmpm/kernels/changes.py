"""Changes of stress and force with numbers of the scene or with the shape, and their way to the grid: many columns in one pass.

Slots are kinds of change that a particle can see: its remanence, the field, its moduli, its density. Which column of the answer a slot
of a cell adds to depends on the cell's region, so a hundred directions of magnetization take two slots.
Cells, colors and the order of sums are those of kernels.equilibrium. In each cell, the way from its nodes to its particles and back is a
matrix product, done by BLAS: rows are the gradients and values of the splines, columns those of the answer.
Loops around loops over columns run to `len` of an array, which is 3: known to the compiler, they would be unrolled, and take it seconds.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import compiled, inner, task_body
from magmpm.compiled.parallel import TOGETHER, over_parts, over_slabs, parts_of, task
from magmpm.effects.calls import (
    add_curvatures,
    add_energies,
    add_loads,
    given_for,
    particles_from,
)
from magmpm.kernels.equilibrium import (
    STENCIL,
    _particle_gradients,
    _volume_change,
    _volume_moments,
    multiply,
    particle_splines,
)
from magmpm.materials import cofactor, determinant, stress, tangent, volume_pressure

ROWS_PER_PARTICLE = 4  # of each particle: three of gradients, one of values


@task_body
def _block_of_load_changes(block, given):
    """`load_changes` of some particles."""
    calls, magnet, rho, x, F, dmagnet, drho, P, f = given
    first = TOGETHER * block
    count = min(TOGETHER, len(x) - first)
    given = given_for()
    for slot in range(len(drho)):
        particles_from(given, first, magnet, rho, x, F)
        _changed(given, first, dmagnet[slot], drho[slot])
        add_loads(calls, count, given, P[slot, first:], f[slot, first:])


@compiled
def load_changes(calls, magnet, rho, x, F, dmagnet, drho, P, f):
    """Add to P (slots, n, 3, 3) Pa and f (slots, n, 3) N/m^3 how the effects' stress and force change with the particles' constants.

    calls: rows of the hooks (effects.calls); dmagnet (slots, n, 3 or 4): change of the remanence (T; with a mark, which stays, where the
    particles have one); drho (slots, n): of the density (kg/m^3).
    """
    over_parts(
        parts_of(len(x)),
        task(_block_of_load_changes, (calls, magnet, rho, x, F, dmagnet, drho, P, f)),
    )


@inner
def _changed(given, p, dmagnet, drho):
    """Give hooks the changes of the particles from number p on: dmagnet (n, columns) and drho (n,)."""
    at = given[0]
    at.dmagnet = address(dmagnet, dmagnet.shape[1] * p)
    at.drho = address(drho, p)


@task_body
def _block_of_loads(block, given):
    """`loads` of some particles."""
    calls, magnet, rho, x, F, P, f = given
    first = TOGETHER * block
    given = given_for()
    particles_from(given, first, magnet, rho, x, F)
    add_loads(calls, min(TOGETHER, len(x) - first), given, P[first:], f[first:])


@compiled
def loads(calls, magnet, rho, x, F, P, f):
    """Add the effects' stress and force of each particle to P (n, 3, 3) Pa and f (n, 3) N/m^3; calls: rows of these hooks."""
    over_parts(parts_of(len(x)), task(_block_of_loads, (calls, magnet, rho, x, F, P, f)))


@task_body
def _block_of_potentials(block, given):
    """`potentials` of some particles."""
    calls, magnet, rho, x, F, W = given
    first = TOGETHER * block
    given = given_for()
    particles_from(given, first, magnet, rho, x, F)
    add_energies(calls, min(TOGETHER, len(x) - first), given, W[first:])


@compiled
def potentials(calls, magnet, rho, x, F, W):
    """Add the effects' energy of each particle to W (n,), J/m^3; calls: rows of this hook."""
    over_parts(parts_of(len(x)), task(_block_of_potentials, (calls, magnet, rho, x, F, W)))


@task_body
def _stress_per_shear_of_cell(cell, given):
    """`stress_per_shear` of one cell."""
    cells, particles, F, P = given
    volume = particles.volume
    shear = particles.shear
    bulk = particles.bulk
    modes = particles.modes
    first = cells.first[cell]
    last = cells.first[cell + 1]
    cof = np.empty((3, 3))
    c = np.empty(modes.shape[1])
    _volume_moments(first, last, volume, modes, F, c)
    for p in range(first, last):
        J = determinant(F[p])
        pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p] / shear[p])
        cofactor(F[p], cof)
        stress(F[p], cof, J, 1.0, pressure, P[p])


@compiled
def stress_per_shear(cells, particles, F, P):
    """Write the elastic stress over the shear modulus to P (n, 3, 3), no unit: it is linear in the moduli at a fixed K/G."""
    over_parts(len(cells.plane), task(_stress_per_shear_of_cell, (cells, particles, F, P)))


class _Room(NamedTuple):
    """Work space of one cell, k columns: rows G (rows, 27) of its splines; coefficients and forces C (9, 9 k) of its nodes, three nodes
    and their three axes in a row; D, T (rows, 3, k) of its particles; A, H, M, cof of one particle; moments c of the volume part, and their
    changes s (modes, k); arguments of BLAS."""

    G: Array
    C: Array
    D: Array
    T: Array
    A: Array
    H: Array
    M: Array
    cof: Array
    c: Array
    s: Array
    letters: NDArray[np.uint8]
    sizes: NDArray[np.int32]
    factors: Array


@inner
def _room(most, k, modes):
    """Work space for cells of at most this many particles."""
    rows = ROWS_PER_PARTICLE * most
    sizes = np.array(
        [3 * k, STENCIL, 0, 3 * k * ROWS_PER_PARTICLE, STENCIL * ROWS_PER_PARTICLE], np.int32
    )
    return _Room(
        np.empty((rows, STENCIL)),
        np.empty((STENCIL // 3, 9 * k)),
        np.empty((rows, 3, k)),
        np.empty((rows, 3, k)),
        np.empty((9, 9)),
        np.empty((3, 3)),
        np.empty((3, 9)),
        np.empty((3, 3)),
        np.empty(modes),
        np.empty((modes, k)),
        np.array([78, 84], np.uint8),
        sizes,
        np.array([1.0, 0.0]),
    )


@inner
def _rows(first, last, particles, room):
    """Write the rows of a cell's particles."""
    for p in range(first, last):
        q = ROWS_PER_PARTICLE * (p - first)
        _particle_gradients(particles.weights[p], particles.slopes[p], room.G[q : q + 3])
        particle_splines(particles.weights[p], room.G[q + 3])


@inner
def _to_nodes(count, fortran, room):
    """C = G^T T: forces at a cell's nodes."""
    multiply(ROWS_PER_PARTICLE * count, fortran, room, 1, 1, 2, room.T, 0, room.G, 1, room.C)


@task_body
def _slots_of_slab(slab, given):
    """`scatter` of one slab."""
    cells, particles, column, P, f, fortran, out = given
    room = _room(cells.most, len(column), 0)
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        first = cells.first[cell]
        last = cells.first[cell + 1]
        _rows(first, last, particles, room)
        _slots_of_cell(first, last, particles.volume, P, f, room.T)
        _to_nodes(last - first, fortran, room)
        for slot in range(len(column)):
            if column[slot, cell] >= 0:
                _scatter_column(
                    cells.plane[cell],
                    cells.row[cell],
                    room.C,
                    slot,
                    column[slot, cell],
                    out,
                )


@compiled
def scatter(cells, particles, column, P, f, fortran, out):
    """P2G of many slots: sum over particles of volume (P grad N_a - f N_a), added to out (planes, columns, 3 nodes), N.

    column (slots, cells): which column a slot of a cell adds to, -1 for none; P (slots, n, 3, 3) Pa, f (slots, n, 3) N/m^3.
    """
    over_slabs(
        len(cells.slab_first) - 1,
        task(_slots_of_slab, (cells, particles, column, P, f, fortran, out)),
    )


@inner
def _slots_of_cell(first, last, volume, P, f, T):
    """Write volume P and -volume f of a cell's particles to T (rows, 3, slots)."""
    for p in range(first, last):
        q = ROWS_PER_PARTICLE * (p - first)
        for slot in range(len(P)):
            for i in range(3):
                for j in range(3):
                    T[q + j, i, slot] = volume[p] * P[slot, p, i, j]
                T[q + 3, i, slot] = -volume[p] * f[slot, p, i]


@inner
def _scatter_column(plane, rows, r, slot, column, out):
    """Add a slot of a cell's forces r (9, 9 slots) to one column of out (planes, columns, 3 nodes)."""
    slots = r.shape[1] // 9
    for a in range(3):
        for b in range(3):
            first = 3 * rows[b]
            for c in range(3):
                for k in range(3):
                    out[plane + a, column, first + 3 * c + k] += r[
                        3 * a + b, (3 * c + k) * slots + slot
                    ]


@task_body
def _products_of_slab(slab, given):
    """`tangent_products` of one slab."""
    cells, particles, calls, x, F, fortran, count, columns, stiff, heavy = given
    room = _room(cells.most, count, particles.modes.shape[1])
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        first = cells.first[cell]
        last = cells.first[cell + 1]
        _rows(first, last, particles, room)
        _gather(cells.plane[cell], cells.row[cell], columns, room.C)
        multiply(
            ROWS_PER_PARTICLE * (last - first), fortran, room, 0, 2, 1, room.C, 0, room.G, 1, room.D
        )  # gradients, values at particles
        _stress_changes(first, last, particles, calls, x, F, room)
        _to_nodes(last - first, fortran, room)
        _scatter_all(cells.plane[cell], cells.row[cell], room.C, stiff)
        _weigh(first, last, particles.volume, room.D)
        multiply(
            last - first,
            fortran,
            room,
            1,
            1,
            2,
            room.D[ROWS_PER_PARTICLE - 1 :],
            3,
            room.G[ROWS_PER_PARTICLE - 1 :],
            4,
            room.C,
        )  # of values alone
        _scatter_all(cells.plane[cell], cells.row[cell], room.C, heavy)


@compiled
def tangent_products(cells, particles, calls, x, F, fortran, count, columns, stiff, heavy):
    """Add the tangent times `count` columns to stiff, N, and the mass matrix of unit density times them to heavy.

    All three (planes, 3 nodes count): the columns' values at a node, axis by axis, are neighbors.
    The tangent is that of kernels.equilibrium.particles_to_grid_with_tangent at x (n, 3) m, F (n, 3, 3), without its matrix.
    """
    over_slabs(
        len(cells.slab_first) - 1,
        task(
            _products_of_slab,
            (cells, particles, calls, x, F, fortran, count, columns, stiff, heavy),
        ),
    )


@inner
def _gather(plane, rows, columns, C):
    """Write a cell's coefficients to C (9, 9 k)."""
    wide = C.shape[1]
    for a in range(len(rows)):
        for b in range(len(rows)):
            source = columns[plane + a]
            target = C[3 * a + b]
            for k in range(wide):
                target[k] = source[rows[b] * (wide // 3) + k]


@inner
def _scatter_all(plane, rows, C, out):
    """Add a cell's C (9, 9 k) to out (planes, 3 nodes k)."""
    wide = C.shape[1]
    for a in range(len(rows)):
        for b in range(len(rows)):
            target = out[plane + a]
            source = C[3 * a + b]
            for k in range(wide):
                target[rows[b] * (wide // 3) + k] += source[k]


@inner
def _weigh(first, last, volume, D):
    """Multiply the rows of values by the particles' volumes."""
    for p in range(first, last):
        q = ROWS_PER_PARTICLE * (p - first) + 3
        for i in range(3):
            for k in range(D.shape[2]):
                D[q, i, k] *= volume[p]


@inner
def _stress_changes(first, last, particles, calls, x, F, room):
    """Write volume times the change of stress and of force with the changes D of gradients and positions of a cell's particles to T."""
    _, _, volume, shear, bulk, modes, remanence, density = particles
    _, _, D, T, A, H, M, cof, c, s, _, _, _ = room
    given = given_for()
    _volume_moments(first, last, volume, modes, F, c)
    s[:] = 0.0
    for p in range(first, last):
        q = ROWS_PER_PARTICLE * (p - first)
        J = determinant(F[p])
        pressure = volume_pressure(_volume_change(J, p, modes, c), bulk[p])
        cofactor(F[p], cof)
        tangent(F[p], cof, J, shear[p], pressure, bulk[p] if len(c) == 0 else 0.0, A)
        particles_from(given, p, remanence, density, x, F)
        H[:] = 0.0
        M[:] = 0.0
        add_curvatures(calls.curvature, 1, given, A, H, M)
        _multiply_rows(q, volume[p], A, D, T)
        T[q + 3] = 0.0
        if calls.softens > 0:
            _soften_rows(q, volume[p], H, M, D, T)
        for mode in range(len(c)):
            _add_product(volume[p] * modes[p, mode], cof, D, q, s[mode])
    for p in range(
        first, last if len(c) > 0 else first
    ):  # the projected volume part: a change of pressure
        q = ROWS_PER_PARTICLE * (p - first)
        cofactor(F[p], cof)
        for mode in range(len(c)):
            scale = volume[p] * bulk[first] * modes[p, mode]
            for i in range(len(cof)):
                for j in range(len(cof)):
                    for k in range(s.shape[1]):
                        T[q + j, i, k] += scale * cof[i, j] * s[mode, k]


@inner
def _multiply_rows(q, volume, A, D, T):
    """Rows q .. q + 2 of T: volume A_iJkL D_kL."""
    for i in range(len(A) // 3):
        for j in range(len(A) // 3):
            out = T[q + j, i]
            row = A[3 * i + j]
            out[:] = 0.0
            for k in range(3):
                a0 = volume * row[3 * k]
                a1 = volume * row[3 * k + 1]
                a2 = volume * row[3 * k + 2]
                for n in range(len(out)):
                    out[n] += a0 * D[q, k, n] + a1 * D[q + 1, k, n] + a2 * D[q + 2, k, n]


@inner
def _soften_rows(q, volume, H, M, D, T):
    """The terms of an energy that also depends on position (kernels.equilibrium): row q + 3 of T, and additions to rows q .. q + 2."""
    for i in range(len(H)):
        for k in range(len(H)):
            for n in range(T.shape[2]):
                T[q + 3, i, n] += volume * H[i, k] * D[q + 3, k, n]
                for j in range(3):
                    T[q + 3, i, n] += volume * M[i, 3 * k + j] * D[q + j, k, n]
                    T[q + j, i, n] += volume * M[k, 3 * i + j] * D[q + 3, k, n]


@inner
def _add_product(scale, cof, D, q, s):
    """s (k,) += scale cof : D, the change of det F."""
    for i in range(len(cof)):
        for j in range(len(cof)):
            for n in range(len(s)):
                s[n] += scale * cof[i, j] * D[q + j, i, n]
