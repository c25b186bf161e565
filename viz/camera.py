"""Cameras of a picture: parallel projections fitted to what must be in view.

The projection is parallel, not perspective, so that one scale bar holds for the whole view and both renderers place text exactly.
Depth is read from the shading, from the floor's grid and the shadows on it, and from orthographic insets where there are any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from magmpm.viz.snapshot import DrawnSolid, Plane, Snapshot

# Directions the main view may be seen from: the base on the left, the axis to the right, from a little above and never face on, so
# that depth is read; and rather from the tip's side, where the clamp is behind the body, than from the clamp's.
_AZIMUTHS = np.radians([-70.0, -55.0, -40.0, -110.0, -125.0, -140.0])
_ELEVATIONS = np.radians([20.0, 28.0, 40.0])
_PREFERRED_ELEVATION = np.radians(24.0)
_ELEVATION_WIDTH = np.radians(30.0)

_LIGHT = np.array([-0.45, 0.65, 0.62]) / np.linalg.norm(
    [-0.45, 0.65, 0.62]
)  # toward it: right, up and toward the viewer


@dataclass(frozen=True)
class View:
    """A parallel projection.

    right, up, toward: (3,) orthonormal, the picture's axes and the direction to the camera. center: (3,) m, the point in the middle
    of the picture. half_height: m from there to its upper edge.
    """

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray
    center: np.ndarray
    half_height: float

    def project(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) m -> (n, 3): right and up from the center in half heights, depth toward the camera in m."""
        offset = np.asarray(points, dtype=float) - self.center
        flat = np.stack([offset @ self.right, offset @ self.up, offset @ self.toward], axis=1)
        flat[:, :2] /= self.half_height
        return flat

    def lift(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points moved by a distance (m) toward the camera: seen at the same place, but in front."""
        return np.asarray(points, dtype=float) + distance * self.toward

    def compass(self) -> View:
        """The same directions around the origin, one unit to half the panel's height."""
        return View(self.right, self.up, self.toward, np.zeros(3), 1.0)

    def brightness(self, directions: np.ndarray, contrast: float) -> np.ndarray:
        """Factor (n,) for the color of faces with these unit normals (n, 3): 1 facing the light, 1 - 1.6 contrast turned away."""
        light = _LIGHT @ np.stack([self.right, self.up, self.toward])
        return np.asarray(1.0 - contrast * (1.0 - np.clip(directions @ light, -0.6, 1.0)))


@dataclass(frozen=True)
class Framing:
    """Region that must be in view, and the direction to the camera: share one between pictures, and they show things at the same place.

    points (m, 3) m; toward (3,) direction to the camera; margin m; ground: the plane, or None for a floor below all points; up (3,)
    unit vector: what is upward in the picture.
    """

    points: np.ndarray
    toward: np.ndarray
    margin: float
    ground: Plane | None = None
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @classmethod
    def of(cls, snapshots: Snapshot | Sequence[Snapshot]) -> Framing:
        """Holds all bodies and targets of these snapshots, and the obstacles near them.

        The direction comes from the first snapshot's target where there is one, so that it is the same for every trial of a study;
        else from the first body's own shape.
        """
        many = [snapshots] if isinstance(snapshots, Snapshot) else list(snapshots)
        points = [
            extremes(shape, 300)
            for s in many
            for shape in (s.body.points, s.target)
            if shape is not None
        ]
        points += [extremes(o.points, 0) for s in many for o in s.obstacles if o.framed]
        points += [ends for s in many for ends in _ends(s)]
        shape = many[0].axis if len(many[0].axis) else many[0].body.points
        if many[0].target is not None:
            shape = np.vstack([np.zeros((1, 3)), many[0].target])
        direction = best_direction(np.asarray(shape, dtype=float))
        return cls(np.vstack(points), direction, max(0.5 * s.thickness for s in many))

    @classmethod
    def of_all(cls, framings: Sequence[Framing]) -> Framing:
        """Framing of all that is in view in any of the framings, seen from where the first is seen from."""
        points = np.vstack([f.points for f in framings])
        return replace(framings[0], points=points, margin=max(f.margin for f in framings))

    @property
    def plane(self) -> Plane:
        """The ground, or a floor a little below everything."""
        if self.ground is not None:
            return self.ground
        low = float((self.points @ self.up).min()) - self.margin
        return Plane(low * self.up, self.up)

    def floor(self) -> np.ndarray:
        """Corners (4, 3) m of the rectangle of ground, or of a floor, under everything, counter-clockwise from its free side."""
        plane = self.plane
        low, high = self._on_floor(self.points)
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        u, v = _across(plane.normal)
        return np.array([plane.point + a * u + b * v for a, b in corners])

    def _on_floor(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates (2,), (2,) m in the floor's plane, with a margin."""
        flat = (points - self.plane.point) @ np.stack(_across(self.plane.normal), axis=1)
        return flat.min(axis=0) - 1.5 * self.margin, flat.max(axis=0) + 1.5 * self.margin

    def floor_lines(self, spacing: float) -> np.ndarray:
        """Lines (n, 2, 3) m on the floor at multiples of the spacing (m)."""
        plane, (low, high) = self.plane, self._on_floor(self.points)
        axes = _across(plane.normal)
        lines = []
        for i, (along, across) in enumerate((axes, axes[::-1])):
            shift = float(plane.point @ along)
            first = np.ceil((low[i] + shift) / spacing)
            last = np.floor((high[i] + shift) / spacing)
            for mark in np.arange(first, last + 1) * spacing - shift:
                lines.append(
                    [plane.point + mark * along + end * across for end in (low[1 - i], high[1 - i])]
                )
        return np.array(lines).reshape(-1, 2, 3)

    def view(self, aspect: float) -> View:
        """The main view, with the floor in it, in a panel of that aspect (width over height)."""
        seen = np.vstack([self.points, self.floor()])
        return fitted(self.toward, seen, 0.5 * self.margin, aspect, 1.01, self.up)

    def orthographic(self, directions: Sequence[Sequence[float]], aspect: float) -> list[View]:
        """Views from these directions in panels of that aspect, at one and the same scale."""
        views = [
            fitted(np.array(toward, dtype=float), self.points, 0.5 * self.margin, aspect, 1.3)
            for toward in directions
        ]
        half = max((view.half_height for view in views), default=1.0)
        return [replace(view, half_height=half) for view in views]

    @property
    def aspect(self) -> float:
        """Width over height of what must be in view, as it is seen."""
        flat = self.view(1.0).project(np.vstack([self.points, self.floor()]))[:, :2]
        across, up = np.ptp(flat, axis=0)
        return float(across / max(up, 1e-300))

    def turned(self) -> Framing:
        """The same, seen from a quarter of a turn further about what is upward."""
        along = float(self.toward @ self.up)
        return replace(self, toward=np.cross(self.up, self.toward) + along * self.up)

    @property
    def reach(self) -> float:
        """m from the middle to the camera."""
        return 10 * float(np.linalg.norm(np.ptp(self.points, axis=0)))


def _ends(snapshot: Snapshot) -> list[np.ndarray]:
    """Ends of a snapshot's arrows, and places of its notes, (n, 3) m."""
    arrows = np.concatenate([snapshot.arrows, snapshot.fields])
    return [arrows[:, 0], arrows.sum(axis=1), *(place[None] for _, place in snapshot.notes)]


def extremes(points: np.ndarray, some: int) -> np.ndarray:
    """The outermost of points (n, 3) along x, y and z, and about so many others, evenly spread."""
    spread = np.linspace(0, len(points) - 1, min(len(points), some)).astype(int)
    return np.asarray(
        points[np.concatenate([points.argmin(axis=0), points.argmax(axis=0), spread])], dtype=float
    )


def in_view(obstacle: DrawnSolid, view: View, aspect: float) -> bool:
    """True if any triangle of an obstacle reaches into a view, tested with the rectangle around it."""
    flat = view.project(obstacle.points)[:, :2] / np.array([aspect, 1.0])
    corners = flat[obstacle.triangles]
    return bool(((corners.min(axis=1) < 1.0) & (corners.max(axis=1) > -1.0)).all(axis=1).any())


def best_direction(points: np.ndarray) -> np.ndarray:
    """Direction (3,) to the camera from which a curve spreads widest, slightly tilted.

    points: (m, 3) m along the curve. Each candidate is evaluated by the area of the curve's projection (the root of the determinant of
    its covariance), times a mild preference for looking from a little above.
    """
    centered = points - points.mean(axis=0)
    best = np.array([0.0, -1.0, 0.0])
    best_score = -1.0
    for elevation in _ELEVATIONS:
        for azimuth in _AZIMUTHS:
            flat = np.cos(elevation)
            toward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
            right, up = _basis(toward, np.eye(3)[2])
            spread = np.stack([centered @ right, centered @ up])
            # A straight curve has no area from anywhere: the small term then picks its longest view.
            area = np.sqrt(max(np.linalg.det(spread @ spread.T), 0.0)) + 1e-3 * np.sum(spread**2)
            score = area * np.exp(-(((elevation - _PREFERRED_ELEVATION) / _ELEVATION_WIDTH) ** 2))
            score *= 0.6 if toward[0] < 0 else 1.0
            # The first of equals wins: rounding must not make two trials of a study be seen from two sides.
            if score > best_score * (1 + 1e-6):
                best = toward
                best_score = score
    return best


def fitted(
    toward: np.ndarray,
    points: np.ndarray,
    radius: float,
    aspect: float,
    margin: float,
    up: np.ndarray | None = None,
) -> View:
    """The view along -toward that holds balls of that radius (m) at all points, in a panel of that aspect; up (3,): z unless given."""
    right, upward = _basis(toward, np.eye(3)[2] if up is None else up)
    flat = np.stack([points @ right, points @ upward, points @ toward], axis=1)
    low = flat.min(axis=0) - radius
    high = flat.max(axis=0) + radius
    middle = 0.5 * (low + high)
    half = 0.5 * (high - low)
    center = middle[0] * right + middle[1] * upward + middle[2] * toward
    return View(right, upward, toward, center, margin * max(half[1], half[0] / aspect))


def _basis(toward: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right and up of a picture seen from there, for what is upward in space; seen straight from above, y is up."""
    hint = np.array([0.0, 1.0, 0.0]) if abs(toward @ up) > 0.999 else up
    right = np.cross(hint, toward)
    right /= np.linalg.norm(right)
    return right, np.cross(toward, right)


def _across(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors in a plane: along x where that is in it, and across."""
    u = np.eye(3)[0] - normal * normal[0]
    if np.linalg.norm(u) < 0.1:
        u = np.eye(3)[1] - normal * normal[1]
    u /= np.linalg.norm(u)
    return u, np.cross(normal, u)
