"""Bodies bent by hand, to draw without solving anything: for tests, and to try a renderer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viz.picture import Picture

Curvature = Callable[[float], tuple[float, float]]


def c_shape(s: float) -> tuple[float, float]:
    """Curvatures (1/m) about the body's own y and z axes: a C in the x-z plane."""
    return -60.0, 0.0


def s_shape(s: float) -> tuple[float, float]:
    """Curvatures (1/m) of a spatial S: bends up, then back and sideways."""
    return -95.0 * np.cos(np.pi * s / 0.036), 70.0 * np.sin(np.pi * s / 0.03)


def bent_axis(
    curvature: Curvature, length: float, count: int = 81
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axis of a rod with given curvature, clamped at the origin along +x, without twist.

    Returns s (count,) m, positions (count, 3) m, frames (count, 3, 3) whose columns are the section's axes.
    """
    s = np.linspace(0.0, length, count)
    position, frame = np.zeros((count, 3)), np.empty((count, 3, 3))
    frame[0] = np.eye(3)
    step = s[1]
    for i in range(1, count):
        bend_y, bend_z = curvature(s[i] - step / 2)
        half = _rotation(np.array([0.0, bend_y, bend_z]) * step / 2)
        position[i] = position[i - 1] + step * (frame[i - 1] @ half)[:, 0]
        frame[i] = frame[i - 1] @ half @ half
    return s, position, frame


def catheter(
    curvature: Curvature = s_shape,
    target: Curvature | None = None,
    *,
    segments: int = 5,
    unmagnetised: tuple[int, ...] = (),
    spacing: float = 0.5e-3,
    trial: int | None = None,
    rms: float | None = None,
    title: str = "five-segment catheter",
) -> Picture:
    """Picture of a 40 x 4 mm catheter bent to that curvature; spacing: m between particles."""
    length, diameter = 0.04, 0.004
    across = (np.arange(round(diameter / spacing)) + 0.5) * spacing - diameter / 2
    y, z = (grid.ravel() for grid in np.meshgrid(across, across))
    inside = np.hypot(y, z) < diameter / 2
    y, z = y[inside], z[inside]
    along = (np.arange(round(length / spacing)) + 0.5) * spacing
    s, position, frame = bent_axis(curvature, length)
    section = np.stack([np.zeros_like(y), y, z], axis=1)
    at = np.searchsorted(s, along)
    particles = np.concatenate(
        [position[i] + section @ frame[i].T - (s[i] - a) * frame[i][:, 0] for i, a in zip(at, along)]
    )
    middle = np.searchsorted(s, (np.arange(segments) + 0.5) * length / segments)
    angles = np.linspace(0.0, 1.5 * np.pi, segments)
    remanence = 0.138 * np.stack([np.cos(angles), 0.5 * np.sin(angles), np.sin(angles)], axis=1)
    remanence[list(unmagnetised)] = 0.0
    return Picture(
        particles=particles.astype(np.float32),
        particle_segment=np.repeat((along * segments / length).astype(np.int32), len(y)),
        particle_size=spacing,
        segment_center=position[middle],
        segment_remanence=np.einsum("kij,kj->ki", frame[middle], remanence),
        length=length,
        diameter=diameter,
        centreline=position,
        target=None if target is None else bent_axis(target, length)[1][4::4],
        field=np.array([0.0, 6e-3, 8e-3]),
        gravity=np.array([0.0, 0.0, -9.81]),
        title=title,
        trial=trial,
        rms=rms,
    )


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector (3,) rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle > 0 else vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
