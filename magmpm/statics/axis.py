"""Deformed axis and tip of an equilibrium, from the spline coefficients of its displacement."""

from __future__ import annotations

import numpy as np

from magmpm.bodies.regions import Line
from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.model import Model
from magmpm.statics.layout import StaticModel


def section_weights(model: StaticModel) -> Array:
    """Weights (nodes_per_plane,) that give the axis from a plane's coefficients: at y = z = 0, or a tube's mean over its section."""
    shape = model.scene.body.shape
    if isinstance(shape, StraightBody) and shape.hollow:
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
    first, weights = grid.section_splines(points)
    if model.plane_strain:  # the middle row of nodes represents all three
        weights[:, 0] = np.array([0.0, 1.0, 0.0])
    dense = np.zeros(grid.nodes[1:])
    for a in range(3):
        for b in range(3):
            np.add.at(dense, ((first[:, 0] + a) % len(dense), first[:, 1] + b), share * weights[:, 0, a] * weights[:, 1, b])
    return dense[layout.node_yz[:, 0], layout.node_yz[:, 1]]


def along_axis(model: StaticModel, grid: Array, weights: Array, s: Array) -> Array:
    """Deformed positions (m, 3) m at arc lengths s (m,) m, with plane weights from the functions above.

    grid (planes, m): coefficients of the displacement.
    """
    planes = grid.reshape(model.layout.planes, -1, 3).transpose(0, 2, 1) @ weights
    if model.clamped_face:
        planes = np.concatenate([-planes[:1], planes])  # node 0, eliminated by the clamp
    elif model.driven:  # the first coefficient is the displacement of the base, which moves
        planes[0] = 2.0 * planes[0] - planes[1]
    if model.scene.body.shape.clamp == "both":  # as at the lower face; the last coefficient is 0 where that face does not move
        planes[-1] = 2.0 * planes[-1] - planes[-2]
    node, N, _ = model.grid.splines_along(s)
    u = sum(N[:, a, None] * planes[node + a] for a in range(3))
    return u + np.outer(s, [1.0, 0.0, 0.0]) + np.array(_line(model).base)


def splines_along(model: StaticModel, s: Array) -> Array:
    """Splines (m, planes) along the axis at arc lengths s (m,) m, clamps built in: times a plane's weighted coefficients they give u."""
    node, N, _ = model.grid.splines_along(s)
    out = np.zeros((len(s), model.grid.nodes[0]))
    for a in range(3):
        out[np.arange(len(s)), node + a] += N[:, a]
    if model.scene.body.shape.clamp == "both":  # as along_axis has it
        out[:, -2] -= out[:, -1]
        out[:, -1] *= 2.0 * ("tip" in dict(model.driven))
    if model.clamped_face or model.driven:
        out[:, 1] -= out[:, 0]
        out[:, 0] *= 2.0
    if model.clamped_face:
        out = out[:, 1:]
    return np.ascontiguousarray(out)


def centreline(model: StaticModel, grid: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m: the deformed axis at faces and middles of the cells; no rows for a body without an axis."""
    if model.line is None:
        return np.zeros((0, 4))
    s = model.grid.stations
    return np.column_stack([s, along_axis(model, grid, section_weights(model), s)])


def tip(model: StaticModel, grid: Array) -> Array:
    """Position (3,) m of the far end of a straight body: the mean over its end face.

    grid (planes, m): coefficients of the displacement.
    """
    return along_axis(model, grid, end_face_weights(model), np.array([_line(model).length]))[0]
