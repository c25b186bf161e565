"""What is read off a deformed body: its axis, its tip, its distance from a wanted shape."""

from __future__ import annotations

import numpy as np

from magmpm.bodies.grid import spline_weights
from magmpm.bodies.regions import Line
from magmpm.compiled.arrays import Array
from magmpm.model import Model
from magmpm.results.result import Result
from magmpm.statics.layout import StaticModel


def section_weights(model: StaticModel) -> Array:
    """Weights (nodes_per_plane,) that give the axis from a plane's coefficients: at y = z = 0, or a tube's mean over its section."""
    catheter = model.scene.body.catheter
    if catheter is not None and catheter.inner_diameter > 0.0:
        return end_face_weights(model)
    return _plane_weights(model, np.array([_line(model).base[1:]]), np.ones(1))


def _line(model: Model) -> Line:
    if model.line is None:
        raise ValueError("only a straight body (catheter, strip) has an axis to measure")
    return model.line


def end_face_weights(model: StaticModel) -> Array:
    """Weights (nodes_per_plane,) of the mean over a section."""
    position = model.particles.position
    slice_ = position[:, 0] == position[:, 0].min()
    share = model.particles.volume[slice_]
    return _plane_weights(model, position[slice_, 1:], share / share.sum())


def _plane_weights(model: StaticModel, points: Array, share: Array) -> Array:
    """Sum over points (q, 2) of share times the splines of y and z, for each node of a plane."""
    grid, layout = model.grid, model.layout
    scaled = (points - grid.origin[1:]) / grid.spacing[1:]
    cell = np.clip(np.floor(scaled + 1e-12).astype(int), 0, np.array(grid.cells[1:]) - 1)
    weights = spline_weights(scaled - cell)
    if model.plane_strain:  # the middle row of nodes stands for all three
        weights[:, 0] = np.array([0.0, 1.0, 0.0])
    dense = np.zeros(grid.nodes[1:])
    for a in range(3):
        for b in range(3):
            np.add.at(dense, (cell[:, 0] + a, cell[:, 1] + b), share * weights[:, 0, a] * weights[:, 1, b])
    return dense[layout.node_yz[:, 0], layout.node_yz[:, 1]]


def along_axis(model: StaticModel, grid: Array, weights: Array, s: Array) -> Array:
    """Deformed positions (m, 3) m at arc lengths s (m,) m, for plane weights as the functions above give.

    grid (planes, m): coefficients of the displacement.
    """
    planes = grid.reshape(model.layout.planes, -1, 3).transpose(0, 2, 1) @ weights
    if model.clamped_face:
        planes = np.concatenate([-planes[:1], planes])  # node 0, which the clamp eliminates
    if model.scene.body.shape.clamp == "both":
        planes[-1] = -planes[-2]  # as at the lower face
    h = model.grid.spacing[0]
    cell = np.clip(np.floor(s / h + 1e-12).astype(int), 0, model.grid.cells[0] - 1)
    N = spline_weights(s / h - cell)
    u = sum(N[:, a, None] * planes[cell + a] for a in range(3))
    return u + np.outer(s, [1.0, 0.0, 0.0]) + np.array(_line(model).base)


def centreline(model: StaticModel, grid: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m: the deformed axis at the cells' faces and middles; none for a body without an axis."""
    if model.line is None:
        return np.zeros((0, 4))
    cells = model.grid.cells[0]
    s = np.linspace(0.0, model.grid.spacing[0] * cells, 2 * cells + 1)
    return np.column_stack([s, along_axis(model, grid, section_weights(model), s)])


def tip(model: StaticModel, grid: Array, position: Array) -> Array:
    """Where the far end is, (3,) m: the mean of a straight body's end face, or the centroid of the last part.

    grid (planes, m): coefficients of the displacement; position (n, 3) m: deformed particles.
    """
    if model.line is not None:
        return along_axis(model, grid, end_face_weights(model), np.array([model.line.length]))[0]
    return piece_means(model, position)[-1]


def piece_means(model: Model, values: Array) -> Array:
    """Mean over each piece's volume, (k, m), of values (n, m) at the particles."""
    particles = model.particles
    count = len(model.scene.regions())
    share = np.zeros((count, len(values)))
    share[particles.segment, np.arange(len(values))] = particles.volume
    share /= share.sum(axis=1, keepdims=True)
    return share @ values


def axis_of_particles(model: Model, position: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m of a straight body's axis from its particles alone; none for a body without an axis.

    position (n, 3) m: deformed. The means of the sections are fitted by the splines along the axis, by least squares: for a
    displacement that these splines hold this is the mean of the section exactly, whatever moved the particles.
    """
    if model.line is None:
        return np.zeros((0, 4))
    x, of = np.unique(model.particles.position[:, 0], return_inverse=True)
    volume = np.bincount(of, model.particles.volume)
    mean = np.stack([np.bincount(of, model.particles.volume * p) / volume for p in position.T], axis=1)
    cells, base = model.grid.cells[0], model.line.base[0]

    def splines(s: Array) -> Array:
        scaled = s / model.grid.spacing[0]
        cell = np.clip(np.floor(scaled + 1e-12).astype(int), 0, cells - 1)
        dense = np.zeros((len(s), cells + 2))
        for a, values in enumerate(spline_weights(scaled - cell).T):
            dense[np.arange(len(s)), cell + a] += values
        return dense

    root = np.sqrt(volume)[:, None]
    coefficients = np.linalg.lstsq(root * splines(x - base), root * mean, rcond=None)[0]
    s = np.linspace(0.0, model.line.length, 2 * cells + 1)
    return np.column_stack([s, splines(s) @ coefficients])


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
