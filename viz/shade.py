"""How bright each particle is, so that the body reads as a bent rod and not as a band of balls."""

from __future__ import annotations

import numpy as np

from viz.camera import View
from viz.picture import Picture

# To the light: from the viewer's upper left.
_RIGHT, _UP, _TOWARD = -0.45, 0.65, 0.62


def outward(picture: Picture) -> np.ndarray:
    """Unit direction (n, 3) from the body's axis to each particle."""
    points, axis = picture.particles, picture.axis.astype(np.float32)
    axis = axis[:: max(len(axis) // 40, 1)]
    # |p - a|^2 without |p|^2, which is the same for all a: one matrix product instead of an (n, m, 3) array.
    nearest = np.argmin((axis**2).sum(axis=1) - 2.0 * (points @ axis.T), axis=1)
    away = (points - axis[nearest]).astype(float)
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))


def brightness(directions: np.ndarray, view: View, contrast: float) -> np.ndarray:
    """Factor (n,) for the colour of particles lying in these directions (n, 3) from the axis.

    1 for those facing the light, down to 1 - 1.6 contrast for those turned away.
    """
    light = _RIGHT * view.right + _UP * view.up + _TOWARD * view.toward
    facing = np.clip(directions @ (light / np.linalg.norm(light)), -0.6, 1.0)
    return np.asarray(1.0 - contrast * (1.0 - facing))
