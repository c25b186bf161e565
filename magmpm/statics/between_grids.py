"""A displacement carried from one grid of a body to another, by least squares: along the axis and across the section apart.

Splines are products of one along the axis and one across, so two small fits do: u_fine = A u_coarse S^T.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.statics.axis import splines_along
from magmpm.statics.layout import StaticModel

GAUSS = 3  # points a cell along the axis
FAINT = 1e-10  # of the largest: what the section's points hardly see is kept small


def carried(coarse: StaticModel, grid: Array, fine: StaticModel) -> Array:
    """Coefficients (planes, m) m on the fine grid of the displacement `grid` (planes, m) m on the coarse one. Straight bodies only."""
    values = grid.reshape(coarse.layout.planes, -1, 3)
    across = np.einsum("kj,pjc->pkc", _section(coarse, fine), values, optimize=True)
    out = along(coarse, fine, across.reshape(coarse.layout.planes, -1))
    moves = fine.scene.move or {}
    given = fine.displaced(**{name: move.displacement(fine.time)[0] for name, move in moves.items()}) if fine.driven else np.zeros_like(out)
    out[fine.layout.fixed] = given[fine.layout.fixed]
    return np.ascontiguousarray(out)


def _section(coarse: StaticModel, fine: StaticModel) -> Array:
    """Nodes of a fine plane from those of a coarse one, (fine nodes, coarse nodes), fitted at the fine section's points."""
    position = fine.particles.position
    slice_ = position[:, 0] == position[:, 0].min()
    points = position[slice_, 1:]
    target, source = (_splines_across(model, points) for model in (fine, coarse))
    normal = target.T @ target
    normal += FAINT * np.trace(normal) / len(normal) * np.eye(len(normal))
    return np.asarray(np.linalg.solve(normal, target.T @ source))


def _splines_across(model: StaticModel, points: Array) -> Array:
    """Splines (q, nodes_per_plane) of a section at points (q, 2) m."""
    grid, node_yz = model.grid, model.layout.node_yz
    first, weights = grid.section_splines(points)
    if model.plane_strain:  # the middle row of nodes represents all three
        weights[:, 0] = np.array([0.0, 1.0, 0.0])
    dense = np.zeros((len(points), *grid.nodes[1:]))
    row = np.arange(len(points))
    for a in range(3):
        for b in range(3):
            dense[row, (first[:, 0] + a) % dense.shape[1], first[:, 1] + b] += weights[:, 0, a] * weights[:, 1, b]
    return np.asarray(dense[:, node_yz[:, 0], node_yz[:, 1]])


def along(coarse: StaticModel, fine: StaticModel, values: Array, moved: float = 0.0) -> Array:
    """Plane coefficients on the fine grid from those (planes, k) on the coarse one, fitted at Gauss points of the fine cells.

    moved: m, where the fine grid's base lies on the coarse one's axis; nothing is displaced before the coarse one's base.
    """
    from scipy.linalg import solveh_banded  # only where a solve goes on to a finer grid

    unit = np.polynomial.legendre.leggauss(GAUSS)[0]
    s = fine.grid.along.at((1 + unit) / 2, np.arange(fine.grid.cells[0])[:, None]).ravel()
    target = splines_along(fine, s)
    used = np.abs(target).max(axis=0) > 0.0  # a far clamp's plane is not
    target = target[:, used]
    normal, right = target.T @ target, target.T @ (splines_along(coarse, np.clip(s + moved, 0.0, coarse.grid.faces[-1])) @ values)
    bands = np.array([np.concatenate([np.zeros(k), np.diagonal(normal, k)]) for k in (2, 1, 0)])
    out = np.zeros((len(used), values.shape[1]))
    out[used] = solveh_banded(bands, right)
    return out
