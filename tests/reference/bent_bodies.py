"""Bodies bent by hand, to draw without solving anything."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.viz import style
from magmpm.viz.from_result import segment_arrows
from magmpm.viz.meshes import tube
from magmpm.viz.snapshot import Balls, DrawnSolid, Snapshot

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
    position = np.zeros((count, 3))
    frame = np.empty((count, 3, 3))
    frame[0] = np.eye(3)
    step = s[1]
    for i in range(1, count):
        bend_y, bend_z = curvature(s[i] - step / 2)
        half = Rotation.from_rotvec(np.array([0.0, bend_y, bend_z]) * step / 2).as_matrix()
        position[i] = position[i - 1] + step * (frame[i - 1] @ half)[:, 0]
        frame[i] = frame[i - 1] @ half @ half
    return s, position, frame


def catheter(
    curvature: Curvature = s_shape,
    target: Curvature | None = None,
    *,
    segments: int = 5,
    unmagnetized: tuple[int, ...] = (),
    spacing: float = 0.5e-3,
    trial: int | None = None,
    rms: float | None = None,
    title: str = "five-segment catheter",
) -> Snapshot:
    """Snapshot of a 40 x 4 mm catheter bent to that curvature; spacing: m between particles."""
    length = 0.04
    diameter = 0.004
    across = (np.arange(round(diameter / spacing)) + 0.5) * spacing - diameter / 2
    y, z = (grid.ravel() for grid in np.meshgrid(across, across))
    inside = np.hypot(y, z) < diameter / 2
    y = y[inside]
    z = z[inside]
    along = (np.arange(round(length / spacing)) + 0.5) * spacing
    s, position, frame = bent_axis(curvature, length)
    section = np.stack([np.zeros_like(y), y, z], axis=1)
    at = np.searchsorted(s, along)
    particles = np.concatenate(
        [
            position[i] + section @ frame[i].T - (s[i] - a) * frame[i][:, 0]
            for i, a in zip(at, along)
        ]
    )
    middle = np.searchsorted(s, (np.arange(segments) + 0.5) * length / segments)
    angles = np.linspace(0.0, 1.5 * np.pi, segments)
    remanence = 0.138 * np.stack([np.cos(angles), 0.5 * np.sin(angles), np.sin(angles)], axis=1)
    remanence[list(unmagnetized)] = 0.0
    deformed = np.einsum("kij,kj->ki", frame[middle], remanence)
    depth = style.CLAMP_THICKNESS * diameter
    plate = tube([depth], style.CLAMP_RADIUS * diameter, 0.0, depth, 48)
    arrows = segment_arrows(position, position[middle], deformed, length, diameter)
    return Snapshot(
        body=Balls(
            particles.astype(np.float32),
            np.repeat((along * segments / length).astype(np.int32), len(y)),
            spacing,
        ),
        magnetized=np.linalg.norm(remanence, axis=1) > 0,
        length=length,
        thickness=diameter,
        axis=position,
        target=None if target is None else bent_axis(target, length)[1][4::4],
        arrows=arrows,
        arrow_width=style.ARROW_WIDTH * diameter,
        obstacles=(
            DrawnSolid("clamp", plate.points - [depth, 0.0, 0.0], plate.triangles, style.CLAMP),
        ),
        field=np.array([0.0, 6e-3, 8e-3]),
        gravity=np.array([0.0, 0.0, -9.81]),
        title=title,
        trial=trial,
        rms=rms,
        insets=True,
    )


def plain(snapshot: Snapshot) -> Snapshot:
    """The same body without magnetization."""
    return replace(
        snapshot, magnetized=np.zeros_like(snapshot.magnetized), arrows=np.zeros((0, 2, 3))
    )
