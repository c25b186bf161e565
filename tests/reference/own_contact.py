"""Contact of a body of boxes with itself, in plain NumPy: which points lie in another box, how deep, and with which energy."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import root

from magmpm.effects.contact_law import FREE
from magmpm.model import Model

Box = tuple[Sequence[float], Sequence[float]]
GIVES = 0.25  # of an obstacle's stiffness: both surfaces have points, and both bodies give


def displacement(model: Model, u: np.ndarray, one: int, X: np.ndarray) -> np.ndarray:
    """Displacement (3,) m of a component at a place X (3,) m; u (nodes in motion, 3) m."""
    grid = model.grid
    mine = np.unique(model.particles.cell[model.component == one], axis=0)
    cell = np.floor((X - grid.origin) / grid.spacing).astype(int)
    cell = np.clip(cell, mine.min(axis=0), mine.max(axis=0))
    weights = grid.splines(X[None], cell[None])[0][0]
    nx, ny, nz = grid.nodes
    nodes = u.reshape(-1, ny, nz, 3)
    found = np.zeros(3)
    for a, b, c in np.ndindex(3, 3, 3):
        i, j, k = cell + np.array([a, b, c])
        found += weights[0, a] * weights[1, b] * weights[2, c] * nodes[one * nx + i, j, k]
    return found


def depths(model: Model, u: np.ndarray, boxes: Sequence[Box]) -> dict[tuple[int, int], float]:
    """Depth (m) of each point of the surface in each component (point, component) that it is in."""
    surface = model.surface
    found = {}
    for p, place in enumerate(surface.place):
        own = int(model.component[surface.particle[p]])
        x = place + displacement(model, u, own, place)
        for one, (low, high) in enumerate(boxes):
            if one == own:
                continue

            def off(X: np.ndarray, one: int = one, x: np.ndarray = x) -> np.ndarray:
                return (X + displacement(model, u, one, X) - x) / model.scene.cell

            X = root(off, x, tol=1e-13).x
            deep = float(np.minimum(X - np.array(low), np.array(high) - X).min())
            if deep > 0.0:
                found[p, one] = deep
    return found


def energy(model: Model, deep: dict[tuple[int, int], float]) -> float:
    """Energy (J) of points so deep."""
    material = model.scene.materials["m"]
    stiffness = material.shear_modulus * (material.bulk_to_shear + 4 / 3) / material.density
    square = FREE * stiffness / model.scene.cell**2
    return sum(GIVES * square * model.surface.mass[p] * d**2 / 2 for (p, _), d in deep.items())
