"""A Newton direction followed along an arc: planes of nodes turn by finite rotations, as the sections of a bending or twisting body do.

A straight step moves every node along a line. Where sections turn by an angle a, this stretches the body by a^2/2, and stretching is up to
a million times as stiff as bending and twist. So in a soft mode, near a critical load, only tiny straight steps lower the energy. Here
the direction of each plane of nodes is split into a translation, a rotation and a rest. The rotations are applied as rotations, and the
distances between planes are turned with them and added up again from the first plane. To first order in the fraction this is the straight
step, so the direction still goes down. Source: retractions, Absil, Mahony, Sepulchre, Optimization Algorithms on Matrix Manifolds, ch. 4.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.statics.layout import StaticModel


def rest_nodes(model: StaticModel) -> Array:
    """Positions (planes, nodes, 3) m of the nodes of the undeformed grid, in x, y, z."""
    grid, layout = model.grid, model.layout
    first, second, third = model.order
    X = np.empty((layout.planes, layout.nodes_per_plane, 3))
    X[..., first] = grid.node_coordinates(0)[int(model.clamped_face) :, None]
    X[..., second], X[..., third] = grid.section_nodes(layout.node_yz).T
    return X


def along_arc(model: StaticModel, grid: Array, direction: Array, fraction: float) -> Array:
    """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from `grid` (planes, m) m, along an arc."""
    X = rest_nodes(model)
    x, d = X + grid.reshape(X.shape), direction.reshape(X.shape)
    center, shift = x.mean(axis=1), d.mean(axis=1)
    arm, turn = x - center[:, None], d - shift[:, None]
    # The rotation that is nearest to each plane's motion, by least squares: of the sum of |w x arm - turn|^2.
    inertia = np.einsum("pni,pni->p", arm, arm)[:, None, None] * np.eye(3) - np.einsum("pni,pnj->pij", arm, arm)
    w = np.einsum("pij,pj->pi", np.linalg.pinv(inertia, rcond=1e-9, hermitian=True), np.cross(arm, turn).sum(axis=1))
    section = _turned(fraction * w, arm + fraction * (turn - np.cross(w[:, None], arm)))
    between, change = np.diff(center, axis=0), np.diff(shift, axis=0)
    mean = (w[1:] + w[:-1]) / 2
    gaps = _turned(fraction * mean, (between + fraction * (change - np.cross(mean, between)))[:, None])[:, 0]
    start = center[:1] + fraction * shift[:1]
    moved = np.concatenate([start, start + np.cumsum(gaps, axis=0)])
    out = (moved[:, None] + section - X).reshape(grid.shape)
    out[model.layout.fixed] = grid[model.layout.fixed]
    return np.ascontiguousarray(out)


def _turned(angles: Array, vectors: Array) -> Array:
    """Vectors (p, n, 3) turned by rotation vectors (p, 3) rad."""
    from scipy.spatial.transform import Rotation  # 0.1 s to import, and few solves need it

    return np.einsum("pij,pnj->pni", Rotation.from_rotvec(angles).as_matrix(), vectors)
