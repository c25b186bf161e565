"""Picture of a schedule: the body at several times side by side, each with its own target, field, and time in words.

A schedule is drawn from the axes that its trials store, not from particles: each body is its section carried along its axis, without twist.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Named
from magmpm.scene import Scene
from magmpm.viz import style
from magmpm.viz.from_motion import gravity_of, scene_of
from magmpm.viz.from_result import segment_arrows
from magmpm.viz.meshes import TriangleSurface, circle, fan, lofted, ring_sections
from magmpm.viz.obstacles import standing
from magmpm.viz.snapshot import DrawnSolid, Snapshot, spread


def poses_snapshot(
    name: str,
    scene: Named,
    poses: Sequence[Named],
    *,
    trial: int,
    rms: float,
) -> Snapshot:
    """The snapshot of a trial of a schedule.

    scene: plain SI data; poses: of each time shown time_s, field_T (3,), axis_m (n, 3), target_m (m, 3), and of the segments centers_m
    (k, 3) and remanence_T (k, 3); rms: m. Raises RenderError where the scene can't be read, or its body has no axis.
    """
    whole = scene_of(scene)
    assert whole is not None
    length = whole.length
    thickness = max(whole.thickness, 0.06 * length)
    shifts = _shifts(
        poses, length, whole.thickness if whole.body.strip is None else whole.body.strip.width
    )
    axes = [np.array(pose["axis_m"]) + shift for pose, shift in zip(poses, shifts)]
    bodies = [_body(whole, axis) for axis in axes]
    arrows = []
    for pose, axis, shift in zip(poses, axes, shifts):
        centers = np.array(pose["centers_m"]).reshape(-1, 3) + shift
        arrows.append(
            segment_arrows(
                axis, centers, np.array(pose["remanence_T"]).reshape(-1, 3), length, thickness
            )
        )
    dots = [
        spread(np.array(pose["target_m"]), style.TARGET_DOTS // 2 + 1) + shift
        for pose, shift in zip(poses, shifts)
    ]
    fields, notes = _fields(poses, shifts, length)
    return Snapshot(
        body=TriangleSurface.joined(bodies),
        magnetized=np.array([any(region.magnetization) for region in whole.regions()]),
        length=length,
        thickness=thickness,
        target=np.vstack(dots),
        arrows=np.vstack(arrows).reshape(-1, 2, 3),
        arrow_width=style.ARROW_WIDTH * thickness,
        obstacles=_clamps(whole, shifts),
        gravity=gravity_of(whole),
        fields=fields,
        notes=notes,
        title=name,
        trial=trial,
        rms=rms,
    )


def _shifts(poses: Sequence[Named], length: float, width: float) -> list[np.ndarray]:
    """Shifts (3,) m along y that bring the poses of a body of this width (m) next to each other, the first one at y = 0 or below."""
    gap_between_bodies = 0.2  # between two bodies, of the length
    shifts = []
    free = 0.0
    for pose in poses:
        across = np.concatenate([np.array(pose["axis_m"])[:, 1], np.array(pose["target_m"])[:, 1]])
        shifts.append(np.array([0.0, free - across.max(), 0.0]))
        free += across.min() - across.max() - width - gap_between_bodies * length
    return shifts


def _body(scene: Scene, axis: np.ndarray) -> TriangleSurface:
    """The section of a straight body along an axis (n, 3) m; its parts are the body's segments."""
    axis_points = 80  # points of an axis as it is drawn
    at = np.linspace(0.0, 1.0, axis_points)
    line = linear(at, np.linspace(0.0, 1.0, len(axis)), axis)
    faces, flat = _section(scene)
    ends = np.cumsum(scene.body.shape.segment_lengths()) / scene.length  # type: ignore[attr-defined]
    of_piece = np.minimum(np.searchsorted(ends, (at[1:] + at[:-1]) / 2), len(ends) - 1)
    pieces = []
    for face in faces:
        side = lofted(
            ring_sections(line, face, np.array([0.0, 1.0, 0.0])), 0, closed=not flat, flip=True
        )
        piece = side.triangles.min(axis=1) // len(face)
        pieces.append(
            TriangleSurface(
                side.points, side.triangles, of_piece[np.minimum(piece, axis_points - 2)]
            )
        )
    outline = np.vstack([face[:1] for face in faces]) if flat else faces[0]
    for end, backward in ((0, True), (-1, False)):
        rim = ring_sections(line, outline, np.array([0.0, 1.0, 0.0]))[end]
        count = len(rim)
        cap = fan(count)
        points = np.vstack([rim, line[end : end + 1] if end == 0 else line[-1:]])
        pieces.append(
            TriangleSurface(
                points, cap[:, ::-1] if backward else cap, np.full(count, of_piece[end])
            )
        )
    return TriangleSurface.joined(pieces)


def _section(scene: Scene) -> tuple[list[np.ndarray], bool]:
    """The faces of a section, each points (n, 3) m with x = 0, counter-clockwise as seen from the tip; whether they are flat."""
    points_around_section = 32  # points around a round section
    strip = scene.body.strip
    if strip is None:
        return [circle(scene.thickness / 2, points_around_section)], False
    corners = np.array([[0.0, y, z] for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))]) * [
        0.0,
        strip.width / 2,
        strip.thickness / 2,
    ]
    return [
        np.stack([corner, after]) for corner, after in zip(corners, np.roll(corners, -1, axis=0))
    ], True


def _clamps(scene: Scene, shifts: Sequence[np.ndarray]) -> tuple[DrawnSolid, ...]:
    """Clamps, and walls around the body, at each of its places; the legend names them once."""
    found = []
    for k, shift in enumerate(shifts):
        for one in standing(scene):
            found.append(
                DrawnSolid(
                    "" if k else one.name,
                    one.points + shift,
                    one.triangles,
                    one.color,
                    one.hollow,
                    one.framed,
                )
            )
    return tuple(found)


def _fields(
    poses: Sequence[Named], shifts: Sequence[np.ndarray], length: float
) -> tuple[np.ndarray, tuple[tuple[str, np.ndarray], ...]]:
    """An arrow of each time's field behind the base, as long as it is strong, and below it time and strength in words."""
    longest_field_of_pose = 0.15  # the longest arrow of a time's field, of the length
    fields = np.array([pose["field_T"] for pose in poses], dtype=float)
    strength = np.linalg.norm(fields, axis=1)
    longest = longest_field_of_pose * length
    vectors = longest * fields / max(float(strength.max()), 1e-300)
    places = np.array(shifts) - [0.2 * length + longest, 0.0, 0.0]
    words = [
        f"at {pose['time_s']:.4g} s: {1e3 * size:.1f} mT" for pose, size in zip(poses, strength)
    ]
    notes = tuple(zip(words, places - [0.0, 0.0, 0.7 * longest]))
    return np.stack([places - 0.5 * vectors, vectors], axis=1), notes
