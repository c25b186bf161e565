"""Magnets and coils on a table: a tricubic spline through their exact field, refined to the given tolerance.

A fixed random sample of points, denser at the faces, checks the error of the field, the error of the gradient (at most ten times the
tolerance, relative to the gradient), and the spline's curl and divergence, which are zero for the exact field (the same bound).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SceneError
from magmpm.fields import spline
from magmpm.fields.domain import Box
from magmpm.fields.kernels import PLACE, fields_at, gradients_at

FIRST = 20  # cells along the longest side at first
GROWTH = 1.5
MAX_NODES = 2_500_000  # 60 MB
SAMPLE = 1500
GRADIENT = 10.0  # times the tolerance: allowed error of the gradient; a cubic's derivative converges one order slower
STEP = 2e-6  # m, of the differences for the exact gradient


@dataclass(frozen=True)
class Errors:
    """Largest errors of a table on its sample: of B and grad B relative to their size there, of curl and divergence to grad B's."""

    field: float
    gradient: float
    curl: float
    divergence: float

    def within(self, tolerance: float) -> bool:
        return self.field <= tolerance and max(self.gradient, self.curl, self.divergence) <= GRADIENT * tolerance


def grid_points(lower: Array, spacing: Array, shape: tuple[int, ...]) -> Array:
    """Nodes of a regular grid, (N M K, 3) m, x slowest."""
    axes = [lower[k] + spacing[k] * np.arange(shape[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def tabulate(exact: Callable[[Array], Array], box: Box, tolerance: float, what: str) -> tuple[Array, Errors]:
    """The packed table (fields.spline) of a field over a box, and its errors.

    exact: points (n, 3) m -> B (n, 3) T; tolerance: largest error of B relative to its size at that place.
    Raises SceneError where MAX_NODES do not reach the tolerance; `what` names the sources.
    """
    extent = box.upper - box.lower
    points = _sample(box)
    B, G = exact(points), _differences(exact, points)
    step, errors = float(extent.max()) / FIRST, None
    while True:
        shape = tuple(int(n) for n in np.maximum(np.ceil(extent / step).astype(int) + 1, spline.FEWEST + 2))
        if np.prod(shape, dtype=float) > MAX_NODES:
            found = "" if errors is None else f" (reached: {1e2 * errors.field:.2g} %, gradient {1e2 * errors.gradient:.2g} %)"
            raise SceneError(
                what,
                found=f"a table over {box.text()} can't be as exact as {1e2 * tolerance:g} % with {MAX_NODES} nodes{found}",
                rule="the field near an edge of a magnet or a wire varies too fast for a table that reaches close to it",
                remedy="keep the body farther from it, give a smaller box (field.tabulation.lower and upper), or a larger "
                "field.tabulation.tolerance",
            )
        spacing = extent / (np.array(shape) - 1)
        values = exact(grid_points(box.lower, spacing, shape)).reshape(*shape, 3)
        packed = spline.packed(box.lower, spacing, values)
        errors = _errors(packed, points, B, G, float(extent.max()))
        if errors.within(tolerance):
            return packed, errors
        step /= GROWTH


def of_values(lower: Array, spacing: Array, values: Array) -> tuple[Array, Errors]:
    """The packed table through measured values (N, M, K, 3) T, and its curl and divergence (root mean squares, of grad B's)."""
    packed = spline.packed(lower, spacing, values)
    shape = np.array(values.shape[:3]) - 1
    points = grid_points(lower + spacing / 2, spacing, tuple(shape))
    _, G = evaluate(packed, points)
    size = float(np.sqrt(np.mean(np.sum(G**2, axis=(1, 2))))) or 1.0
    curl = np.stack([G[:, 2, 1] - G[:, 1, 2], G[:, 0, 2] - G[:, 2, 0], G[:, 1, 0] - G[:, 0, 1]], axis=1)
    divergence = np.trace(G, axis1=1, axis2=2)
    return packed, Errors(0.0, 0.0, float(np.sqrt(np.mean(np.sum(curl**2, axis=1)))) / size, float(np.sqrt(np.mean(divergence**2))) / size)


def evaluate(packed: Array, points: Array) -> tuple[Array, Array]:
    """B (n, 3) T and grad B (n, 3, 3) T/m of one packed table at points (n, 3) m."""
    place = np.zeros(1, np.dtype(PLACE))
    place["strength"], place["frame"] = 1.0, np.eye(3).ravel()
    data = np.concatenate([[0.0, 1.0], packed])
    B, G = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
    fields_at(place[0], data, points, B)
    gradients_at(place[0], data, points, G)
    return B, G


def _sample(box: Box) -> Array:
    """Points in the whole box (two thirds) and on its faces."""
    rng = np.random.default_rng(20)
    inside = rng.random((SAMPLE, 3))
    faces = rng.random((SAMPLE // 12 * 6, 3))
    for k in range(3):
        for side in range(2):
            faces[2 * k + side :: 6, k] = 0.999 if side else 0.001
    return box.lower + np.concatenate([inside, faces]) * (box.upper - box.lower)


def _differences(exact: Callable[[Array], Array], points: Array) -> Array:
    """grad B (n, 3, 3) T/m by central differences."""
    out = np.empty((len(points), 3, 3))
    for k in range(3):
        shift = STEP * np.eye(3)[k]
        out[:, :, k] = (exact(points + shift) - exact(points - shift)) / (2 * STEP)
    return out


def _errors(packed: Array, points: Array, B: Array, G: Array, extent: float) -> Errors:
    found, slope = evaluate(packed, points)
    size = np.linalg.norm(B, axis=1)
    steep = np.linalg.norm(G, axis=(1, 2)) + size / extent
    curl = np.stack([slope[:, 2, 1] - slope[:, 1, 2], slope[:, 0, 2] - slope[:, 2, 0], slope[:, 1, 0] - slope[:, 0, 1]], axis=1)
    return Errors(
        field=float((np.linalg.norm(found - B, axis=1) / size).max()),
        gradient=float((np.linalg.norm(slope - G, axis=(1, 2)) / steep).max()),
        curl=float((np.linalg.norm(curl, axis=1) / steep).max()),
        divergence=float((np.abs(np.trace(slope, axis1=1, axis2=2)) / steep).max()),
    )
