"""Where a picture is seen from: parallel projections fitted to what must be in the frame.

The projection is parallel, not perspective, so that one scale bar holds for the whole view and both
backends can place text exactly. Depth is read from the shading, from the floor's grid and the shadows on
it, and from two orthographic views beside the main one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viz.picture import Picture

# Directions the main view may be seen from: the base on the left, the axis pointing to the right, from a
# little above and never face on, so that depth is read; rather from the tip's side, where the clamp is
# behind the body, than from the clamp's.
_AZIMUTHS = np.radians([-70.0, -55.0, -40.0, -110.0, -125.0, -140.0])
_BEHIND_CLAMP = 0.6
_ELEVATIONS = np.radians([20.0, 28.0, 40.0])
_PREFERRED_ELEVATION, _ELEVATION_WIDTH = np.radians(24.0), np.radians(30.0)


@dataclass(frozen=True)
class View:
    """A parallel projection.

    right, up, toward: (3,) orthonormal, the picture's axes and the direction to the camera.
    center: (3,) m, the point in the middle of the picture. half_height: m from there to its upper edge.
    """

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray
    center: np.ndarray
    half_height: float

    def project(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) m -> (n, 3): right and up from the centre in half heights, depth to the camera in m."""
        offset = np.asarray(points, dtype=float) - self.center
        flat = np.stack([offset @ self.right, offset @ self.up, offset @ self.toward], axis=1)
        flat[:, :2] /= self.half_height
        return flat

    def lift(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points moved by a distance (m) towards the camera: seen at the same place, but in front."""
        return np.asarray(points, dtype=float) + distance * self.toward


@dataclass(frozen=True)
class Frame:
    """What must be seen, and from where: share one between pictures and they show things at the same place.

    points: (m, 3) m, all of which lie in every view. radius: m, half the body's thickness around them.
    toward: (3,) direction to the camera of the main view.
    """

    points: np.ndarray
    radius: float
    toward: np.ndarray

    @classmethod
    def of(cls, pictures: Picture | Sequence[Picture]) -> Frame:
        """The frame that holds all bodies and targets of these pictures, and the magnets and coils near them.

        The direction comes from the first picture's target where there is one, so that it is the same for
        every trial of a study; else from the first body's own shape.
        """
        many = [pictures] if isinstance(pictures, Picture) else list(pictures)
        points = [
            shape[_thinned(len(shape), 40)] for p in many for shape in (p.axis, p.target) if shape is not None
        ]
        points += [
            prop.points[[*prop.points.argmin(axis=0), *prop.points.argmax(axis=0)]]
            for p in many
            for prop in p.props
            if prop.framed
        ]
        first = many[0]
        shape = first.axis if first.target is None else np.vstack([np.zeros((1, 3)), first.target])
        radius = 0.5 * max(p.diameter for p in many)
        return cls(points=np.vstack(points), radius=radius, toward=best_direction(shape))

    @property
    def floor(self) -> tuple[np.ndarray, np.ndarray]:
        """Opposite corners (3,), (3,) m of the floor under the body; both have the same z."""
        low = self.points.min(axis=0) - 1.6 * self.radius
        high = self.points.max(axis=0) + 1.6 * self.radius
        return low, np.array([high[0], high[1], low[2]])

    def main(self, aspect: float) -> View:
        """The tilted view, with the floor in it. aspect: width over height of its panel."""
        (x0, y0, z), (x1, y1, _) = self.floor
        corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1)])
        # The body is as thick as twice the radius, and the clamp's plate a little more.
        edges = [self.points + side * 0.95 * self.radius * axis for axis in _basis(self.toward) for side in (-1, 1)]
        return fitted(self.toward, np.vstack([*edges, corners]), 0.5 * self.radius, aspect, 1.02)

    def top_and_side(self, aspect: float) -> tuple[View, View]:
        """Views along -z and along +y, at one and the same scale."""
        top = fitted(np.array([0.0, 0.0, 1.0]), self.points, self.radius, aspect, 1.3)
        side = fitted(np.array([0.0, -1.0, 0.0]), self.points, self.radius, aspect, 1.3)
        half = max(top.half_height, side.half_height)
        return (
            View(top.right, top.up, top.toward, top.center, half),
            View(side.right, side.up, side.toward, side.center, half),
        )


def best_direction(points: np.ndarray) -> np.ndarray:
    """Direction (3,) to the camera from which a curve spreads widest, slightly tilted.

    points: (m, 3) m along the curve. Each candidate is judged by the area of the curve's projection (the
    root of the determinant of its covariance), times a mild preference for looking from a little above.
    """
    centred = points - points.mean(axis=0)
    best, best_score = np.array([0.0, -1.0, 0.0]), -1.0
    for elevation in _ELEVATIONS:
        for azimuth in _AZIMUTHS:
            flat = np.cos(elevation)
            toward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
            right, up = _basis(toward)
            spread = np.stack([centred @ right, centred @ up])
            # A straight curve has no area from anywhere: the small term then picks its longest view.
            area = np.sqrt(max(np.linalg.det(spread @ spread.T), 0.0)) + 1e-3 * np.sum(spread**2)
            score = area * np.exp(-(((elevation - _PREFERRED_ELEVATION) / _ELEVATION_WIDTH) ** 2))
            score *= _BEHIND_CLAMP if toward[0] < 0 else 1.0
            # The first of equals wins: rounding must not make two trials of a study be seen from two sides.
            if score > best_score * (1 + 1e-6):
                best, best_score = toward, score
    return best


def fitted(toward: np.ndarray, points: np.ndarray, radius: float, aspect: float, margin: float) -> View:
    """The view along -toward that holds balls of that radius (m) at all points, in a panel of that aspect."""
    right, up = _basis(toward)
    flat = np.stack([points @ right, points @ up, points @ toward], axis=1)
    low, high = flat.min(axis=0) - radius, flat.max(axis=0) + radius
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    center = middle[0] * right + middle[1] * up + middle[2] * toward
    return View(right, up, toward, center, margin * max(half[1], half[0] / aspect))


def _basis(toward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right and up of a picture seen from there: z is up, except straight from above, where y is."""
    hint = np.array([0.0, 1.0, 0.0]) if abs(toward[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    right = np.cross(hint, toward)
    right /= np.linalg.norm(right)
    return right, np.cross(toward, right)


def _thinned(count: int, most: int) -> np.ndarray:
    """Indices of at most `most` of `count` entries, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
