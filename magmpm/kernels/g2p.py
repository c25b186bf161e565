"""G2P: particles gather displacement and deformation gradient from the grid."""

from __future__ import annotations

from magmpm.compiled.jit import kernel, prange


@kernel
def gather(cell_first, cell_plane, cell_row, weights, slopes, grid, rest, displacement, F):
    """Displacement and deformation gradient of every particle: u = sum N_a c_a, F = I + sum c_a (x) grad N_a.

    cell_first (cells + 1,), cell_plane (cells,), cell_row (cells, 3): see model.Layout; weights, slopes (n, 3, 3): axis, node;
    slopes in 1/m; grid (planes, 3 nodes) coefficients in m; rest (3, 3): F at rest, I but for renumbered axes (statics.axis_order); out:
    displacement (n, 3) m, F (n, 3, 3).
    """
    for cell in prange(len(cell_plane)):
        for p in range(cell_first[cell], cell_first[cell + 1]):
            for k in range(3):
                displacement[p, k] = 0.0
                for j in range(3):
                    F[p, k, j] = rest[k, j]
            for a in range(3):
                plane = grid[cell_plane[cell] + a]
                nx, dx = weights[p, 0, a], slopes[p, 0, a]
                for b in range(3):
                    first = 3 * cell_row[cell, b]
                    nn, dn, nd = nx * weights[p, 1, b], dx * weights[p, 1, b], nx * slopes[p, 1, b]
                    for c in range(3):
                        nz = weights[p, 2, c]
                        g0, g1, g2 = dn * nz, nd * nz, nn * slopes[p, 2, c]
                        for k in range(3):
                            value = plane[first + 3 * c + k]
                            displacement[p, k] += nn * nz * value
                            F[p, k, 0] += g0 * value
                            F[p, k, 1] += g1 * value
                            F[p, k, 2] += g2 * value
