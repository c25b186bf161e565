"""What is read off a deformed body: its axis, its tip, its distance from a wanted shape."""

from __future__ import annotations

import numpy as np

from magmpm.basis import Array, spline_weights
from magmpm.model import Model
from magmpm.results import Result


def section_weights(model: Model) -> Array:
    """Weights (nodes_per_plane,) that give the axis from a plane's coefficients: at y = z = 0, or a tube's mean over its section."""
    catheter = model.scene.body.catheter
    if catheter.inner_diameter == 0.0:
        points, share = np.zeros((1, 2)), np.ones(1)
    else:
        return end_face_weights(model)
    return _plane_weights(model, points, share)


def end_face_weights(model: Model) -> Array:
    """Weights (nodes_per_plane,) of the mean over a section."""
    position = model.particles.position
    slice_ = position[:, 0] == position[:, 0].min()
    share = model.particles.volume[slice_]
    return _plane_weights(model, position[slice_, 1:], share / share.sum())


def _plane_weights(model: Model, points: Array, share: Array) -> Array:
    """Sum over points (q, 2) of share times the splines of y and z, for each node of a plane."""
    grid, layout = model.grid, model.layout
    scaled = (points - grid.origin[1:]) / grid.spacing[1:]
    cell = np.clip(np.floor(scaled + 1e-12).astype(int), 0, np.array(grid.cells[1:]) - 1)
    weights = spline_weights(scaled - cell)
    dense = np.zeros(grid.nodes[1:])
    for a in range(3):
        for b in range(3):
            np.add.at(dense, (cell[:, 0] + a, cell[:, 1] + b), share * weights[:, 0, a] * weights[:, 1, b])
    return dense[layout.node_yz[:, 0], layout.node_yz[:, 1]]


def along_axis(model: Model, grid: Array, weights: Array, s: Array) -> Array:
    """Deformed positions (m, 3) m at arc lengths s (m,) m, for plane weights as the functions above give.

    grid (planes, m): coefficients of the displacement.
    """
    planes = grid.reshape(model.layout.planes, -1, 3).transpose(0, 2, 1) @ weights
    planes = np.concatenate([-planes[:1], planes])  # node 0, which the clamp eliminates
    h = model.grid.spacing[0]
    cell = np.clip(np.floor(s / h + 1e-12).astype(int), 0, model.grid.cells[0] - 1)
    N = spline_weights(s / h - cell)
    u = sum(N[:, a, None] * planes[cell + a] for a in range(3))
    return u + np.outer(s, [1.0, 0.0, 0.0])


def centreline(model: Model, grid: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m: the deformed axis at the cells' faces and middles."""
    cells = model.grid.cells[0]
    s = np.linspace(0.0, model.grid.spacing[0] * cells, 2 * cells + 1)
    return np.column_stack([s, along_axis(model, grid, section_weights(model), s)])


def centreline_at(result: Result, s: Array) -> Array:
    """Positions (m, 3) m of the deformed axis at arc lengths s (m,) m, 0 to the length.

    Exact: between the rows of a cell the axis is a parabola. Raises ValueError for s outside the body.
    """
    rows = result.centreline
    s = np.asarray(s, dtype=float)
    length = rows[-1, 0]
    if np.any(s < -1e-9 * length) or np.any(s > (1 + 1e-6) * length):
        raise ValueError(f"s must lie between 0 and the length, {length} m")
    cells = (len(rows) - 1) // 2
    cell = np.clip((s / length * cells).astype(int), 0, cells - 1)
    t = (s / length * cells - cell)[:, None]
    a, b, c = (rows[2 * cell + k, 1:] for k in range(3))
    return a * (1 - t) * (1 - 2 * t) + b * 4 * t * (1 - t) + c * t * (2 * t - 1)


def rms_distance(result: Result, target: Array) -> float:
    """Root mean square distance (m) between the axis and target rows [s, x, y, z] (m, 4) m, at the same arc lengths."""
    gap = centreline_at(result, target[:, 0]) - target[:, 1:]
    return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))


def tip_error(result: Result, target: Array) -> float:
    """Distance (m) at the target's last row."""
    return float(np.linalg.norm(centreline_at(result, target[-1:, 0])[0] - target[-1, 1:]))


def largest_distance(result: Result, target: Array) -> float:
    """Largest distance (m) between the axis and target rows [s, x, y, z] (m, 4) m, at the same arc lengths."""
    return float(np.linalg.norm(centreline_at(result, target[:, 0]) - target[:, 1:], axis=1).max())
