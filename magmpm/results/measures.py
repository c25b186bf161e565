"""Measures of a deformed body: the axis through its particles, the middle of its regions, its distance from a target shape."""

from __future__ import annotations

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.materials import magnetization
from magmpm.model import Model
from magmpm.results.result import Result


def region_magnetization(model: Model, F: Array) -> Array:
    """Mean magnetization (k, 3) T of each region, F Br or R Br, for F (n, 3, 3)."""
    return region_means(model, magnetization(model.rotating, model.remanence[:, :3], F))


def region_means(model: Model, values: Array) -> Array:
    """Mean over each region's volume, (k, m), of values (n, m) at the particles."""
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
    grid, base = model.grid, model.line.base[0]

    def splines(s: Array) -> Array:
        node, values, _ = grid.splines_along(s)
        dense = np.zeros((len(s), grid.nodes[0]))
        for a in range(3):
            dense[np.arange(len(s)), node + a] += values[:, a]
        return dense

    root = np.sqrt(volume)[:, None]
    coefficients = np.linalg.lstsq(root * splines(x - base), root * mean, rcond=None)[0]
    s = grid.stations
    return np.column_stack([s, splines(s) @ coefficients])


def centreline_at(result: Result, s: Array) -> Array:
    """Positions (m, 3) m of the deformed axis at arc lengths s (m,) m, 0 to the length.

    Exact: between the rows of a cell the axis is a parabola. Raises ValueError for s outside the body.
    """
    return on_rows(result.centreline[:, 0], result.centreline[:, 1:], s)[0]


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


def of_particles(model: Model, x: Array) -> tuple[Array, Array, Array]:
    """Axis rows, tip and centers of regions of a body in motion, as Frames.see takes them. x (n, 3) m: its particles."""
    axis, centers = axis_of_particles(model, x), region_means(model, x)
    return axis, axis[-1, 1:] if len(axis) else centers[-1], centers
