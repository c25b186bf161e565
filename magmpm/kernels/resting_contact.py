"""Contact of the body's surface with obstacles at equilibrium: the points that touch, and their part of the tangent (statics.contact)."""

from __future__ import annotations

import numpy as np

from magmpm.compiled.jit import kernel, prange
from magmpm.effects.hooks import add_touch, deepest
from magmpm.kernels.changes import _particle_splines
from magmpm.kernels.equilibrium import STENCIL, _scatter_matrix


@kernel
def touch(effects, x, mass, energy, f, H):
    """Write the energy (n,) J, force f (n, 3) N and tangent H (n, 3, 3) N/m of those points at x (n, 3) m that touch; mass (n,) kg."""
    for p in prange(len(x)):
        if deepest(effects, 0, x[p]) > 0.0:
            energy[p] = add_touch(effects, x[p], mass[p], f[p], H[p])


@kernel
def contact_to_panels(cells, weights, H, split, panels):
    """P2G: add the sum of N_a H N_b over points to panels (planes, m, 3 m), N/m. weights (n, 3, 3): of splines N; H (n, 3, 3): often 0."""
    slabs = len(cells.slab_first) - 1
    for color in range(2):
        for half in prange((slabs + 1 - color) // 2):
            slab = 2 * half + color
            K, N = np.empty((STENCIL, 3, 3, STENCIL)), np.empty(STENCIL)
            for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
                touched = False
                for p in range(cells.first[cell], cells.first[cell + 1]):
                    if H[p, 0, 0] + H[p, 1, 1] + H[p, 2, 2] == 0.0:
                        continue
                    if not touched:
                        K[:], touched = 0.0, True
                    _particle_splines(weights[p], N)
                    for node in range(STENCIL):
                        for i in range(3):
                            for k in range(3):
                                h = N[node] * H[p, i, k]
                                for other in range(STENCIL if h != 0.0 else 0):
                                    K[node, i, k, other] += h * N[other]
                if touched:
                    _scatter_matrix(cells.plane[cell], cells.row[cell], split, K, panels)
