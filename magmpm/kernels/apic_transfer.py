"""Splines, scatter and gather between eight particles and the nodes around them, for kernels.apic_step.

A node holds four floats: mass and momentum, or 0 and velocity. Two nodes in a row along z fill one register. So a particle scatters to its
27 nodes in 36 multiplications and additions, with no sum over lanes. Neighboring particles in one cell share the registers.
The splines are found for eight particles at a time, one lane each; a scatter or gather takes one particle after the other. So lanes are
transposed into one row of 64 floats for each particle, and back, in registers.

Source: Steffen, Kirby, Berzins, IJNME 76 (2008) 922 (MPM with B-splines).
"""

from __future__ import annotations

from magmpm.compiled.jit import compiled
from magmpm.compiled.simd import floor, four, halves, load, splat, store, store_folded, store_rows

ROW = 64  # floats a particle has in a block's rows: 28 of motion, 4 unused, 28 of place, 4 unused


@compiled
def _splines(x, block, axis, origin, cells, h):
    """First node, splines N, products N d and slopes (1/m), three each, of eight particles along one axis.

    d: position of the node minus position of the particle (m); cells: 1 / h.
    """
    s = (load(x, 24 * block + 8 * axis) - origin[axis]) * cells
    first = floor(s)
    t = s - first
    u = 1.0 - t
    a, b, c, d = 0.5 * (u * u), 0.5 + t * u, 0.5 * (t * t), (-0.5 - t) * h
    return first, a, b, c, a * d, b * (d + h), c * (d + 2.0 * h), u * (-cells), (u - t) * cells, t * cells


@compiled
def locate(block, grid, particles, state, rows):
    """Write a block's splines to rows (8 ROW,): at 32 the first node; at 33, 42, 51 N, N d and slopes along x, y, z."""
    x, origin, h, lift = state.x, grid.origin, grid.spacing, particles.lift[block]
    i, a0, a1, a2, a3, a4, a5, a6, a7, a8 = _splines(x, block, 0, origin, 1.0 / h[0], h[0])
    j, b0, b1, b2, b3, b4, b5, b6, b7, b8 = _splines(x, block, 1, origin, 1.0 / h[1], h[1])
    k, c0, c1, c2, c3, c4, c5, c6, c7, c8 = _splines(x, block, 2, origin, 1.0 / h[2], h[2])
    first = i * float(grid.along_x) + j * float(grid.along_y) + k + lift
    store_rows(rows, 32, ROW, first, a0, a1, a2, a3, a4, a5, a6)
    store_rows(rows, 40, ROW, a7, a8, b0, b1, b2, b3, b4, b5)
    store_rows(rows, 48, ROW, b6, b7, b8, c0, c1, c2, c3, c4)
    store_rows(rows, 56, ROW, c5, c6, c7, c8, c8, c8, c8, c8)


@compiled
def _add(grid, k, low, high):
    """Add two registers, which hold three nodes, to a row of nodes."""
    store(grid, k, load(grid, k) + low)
    store(grid, k + 8, load(grid, k + 8) + high)


@compiled
def scatter(grid, along_x, along_y, rows):
    """Add mass and momentum of a block's particles, rows (8 ROW,), to their 27 nodes.

    Node (i, j, k) gets N_i N_j N_k (base + sum over axes q d) - t . grad(N_i N_j N_k), written as A_i N_j + B_j N_i with rows of k in
    A and B. Consecutive particles mostly share a cell: their sums stay in 18 registers until the next cell.
    """
    p, zero = 0, splat(0.0)
    while p < 8:
        first = rows[ROW * p + 32]
        a0, a1, a2, a3, a4, a5, a6, a7, a8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        b0, b1, b2, b3, b4, b5, b6, b7, b8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        while p < 8 and rows[ROW * p + 32] == first:
            at = ROW * p
            ny0, ny1, ny2 = rows[at + 42], rows[at + 43], rows[at + 44]
            na, nb = halves(rows[at + 51], rows[at + 52]), halves(rows[at + 53], 0.0)
            q, t = four(rows, at + 12), four(rows, at + 24)
            za = q * halves(rows[at + 54], rows[at + 55]) - t * halves(rows[at + 57], rows[at + 58])
            zb = q * halves(rows[at + 56], 0.0) - t * halves(rows[at + 59], 0.0)
            q, t = four(rows, at + 8), four(rows, at + 20)
            y0, y1, y2 = q * rows[at + 45] - t * rows[at + 48], q * rows[at + 46] - t * rows[at + 49], q * rows[at + 47] - t * rows[at + 50]
            ya0, ya1, ya2, yb0, yb1, yb2 = y0 * na, y1 * na, y2 * na, y0 * nb, y1 * nb, y2 * nb
            base, q, t = four(rows, at), four(rows, at + 4), four(rows, at + 16)
            n, row = rows[at + 33], base * rows[at + 33] + q * rows[at + 36] - t * rows[at + 39]
            low, high = row * na + za * n, row * nb + zb * n
            a0, a1, a2 = a0 + low * ny0 + ya0 * n, a1 + low * ny1 + ya1 * n, a2 + low * ny2 + ya2 * n
            b0, b1, b2 = b0 + high * ny0 + yb0 * n, b1 + high * ny1 + yb1 * n, b2 + high * ny2 + yb2 * n
            n, row = rows[at + 34], base * rows[at + 34] + q * rows[at + 37] - t * rows[at + 40]
            low, high = row * na + za * n, row * nb + zb * n
            a3, a4, a5 = a3 + low * ny0 + ya0 * n, a4 + low * ny1 + ya1 * n, a5 + low * ny2 + ya2 * n
            b3, b4, b5 = b3 + high * ny0 + yb0 * n, b4 + high * ny1 + yb1 * n, b5 + high * ny2 + yb2 * n
            n, row = rows[at + 35], base * rows[at + 35] + q * rows[at + 38] - t * rows[at + 41]
            low, high = row * na + za * n, row * nb + zb * n
            a6, a7, a8 = a6 + low * ny0 + ya0 * n, a7 + low * ny1 + ya1 * n, a8 + low * ny2 + ya2 * n
            b6, b7, b8 = b6 + high * ny0 + yb0 * n, b7 + high * ny1 + yb1 * n, b8 + high * ny2 + yb2 * n
            p += 1
        k, x, y = 4 * int(first), 4 * along_x, 4 * along_y
        _add(grid, k, a0, b0), _add(grid, k + y, a1, b1), _add(grid, k + 2 * y, a2, b2)
        k += x
        _add(grid, k, a3, b3), _add(grid, k + y, a4, b4), _add(grid, k + 2 * y, a5, b5)
        k += x
        _add(grid, k, a6, b6), _add(grid, k + y, a7, b7), _add(grid, k + 2 * y, a8, b8)


@compiled
def gather(grid, along_x, along_y, h, rows):
    """Write velocities and velocity gradients of a block's particles to rows (8 ROW,): seven rows of four, the first of each unused.

    v; C by column: sum of N v d 4/h^2; L by column: sum of v grad N.
    """
    scale_x, scale_y, scale_z = 4.0 / (h[0] * h[0]), 4.0 / (h[1] * h[1]), 4.0 / (h[2] * h[2])
    zero = splat(0.0)
    for p in range(8):
        at = ROW * p
        ny0, ny1, ny2 = rows[at + 42], rows[at + 43], rows[at + 44]
        my0, my1, my2 = rows[at + 45], rows[at + 46], rows[at + 47]
        sy0, sy1, sy2 = rows[at + 48], rows[at + 49], rows[at + 50]
        # sums over the nodes along x and y, low: nodes 0 and 1 along z, high: node 2. Letters: factors along x, y: n N, m N d, s slope
        nn_low, nn_high, mn_low, mn_high, sn_low, sn_high = zero, zero, zero, zero, zero, zero
        nm_low, nm_high, ns_low, ns_high = zero, zero, zero, zero
        for i in range(3):
            k, step = 4 * (int(rows[at + 32]) + i * along_x), 4 * along_y
            a0, a1, a2 = load(grid, k), load(grid, k + step), load(grid, k + 2 * step)
            b0, b1, b2 = load(grid, k + 8), load(grid, k + step + 8), load(grid, k + 2 * step + 8)
            n, m, s = rows[at + 33 + i], rows[at + 36 + i], rows[at + 39 + i]
            a, b = a0 * ny0 + a1 * ny1 + a2 * ny2, b0 * ny0 + b1 * ny1 + b2 * ny2
            nn_low, nn_high, mn_low, mn_high = nn_low + a * n, nn_high + b * n, mn_low + a * m, mn_high + b * m
            sn_low, sn_high = sn_low + a * s, sn_high + b * s
            nm_low, nm_high = nm_low + (a0 * my0 + a1 * my1 + a2 * my2) * n, nm_high + (b0 * my0 + b1 * my1 + b2 * my2) * n
            ns_low, ns_high = ns_low + (a0 * sy0 + a1 * sy1 + a2 * sy2) * n, ns_high + (b0 * sy0 + b1 * sy1 + b2 * sy2) * n
        na, nb = halves(rows[at + 51], rows[at + 52]), halves(rows[at + 53], 0.0)
        ma, mb = halves(rows[at + 54], rows[at + 55]), halves(rows[at + 56], 0.0)
        sa, sb = halves(rows[at + 57], rows[at + 58]), halves(rows[at + 59], 0.0)
        store_folded(rows, at, nn_low * na + nn_high * nb)
        store_folded(rows, at + 4, (mn_low * na + mn_high * nb) * scale_x)
        store_folded(rows, at + 8, (nm_low * na + nm_high * nb) * scale_y)
        store_folded(rows, at + 12, (nn_low * ma + nn_high * mb) * scale_z)
        store_folded(rows, at + 16, sn_low * na + sn_high * nb)
        store_folded(rows, at + 20, ns_low * na + ns_high * nb)
        store_folded(rows, at + 24, nn_low * sa + nn_high * sb)
