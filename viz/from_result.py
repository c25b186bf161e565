"""Snapshots of a result: by its surface as a motion is drawn, or by its particles, as a trial of a study with its target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from magmpm.bodies.curves import face_normals
from magmpm.compiled.arrays import Named
from magmpm.fields.schedule import end_time
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene
from magmpm.viz import style
from magmpm.viz.binding import gradients
from magmpm.viz.body import DrawnBody
from magmpm.viz.from_motion import MotionRenderer, gravity_of, scene_of
from magmpm.viz.meshes import TriangleSurface
from magmpm.viz.obstacles import REACH_OF_VIEW, in_reach, sources, standing
from magmpm.viz.snapshot import Balls, Snapshot, spread


class Still(MotionRenderer):
    """A result of statics drawn as a motion is, with a smooth surface and what stands around it: one snapshot."""

    def __init__(self, result: Any) -> None:
        super().__init__(_one_frame(result))
        self._mark = failure(result)[0] or beyond(result)

    def snapshot(self, number: int = 0, pace: float | None = None) -> Snapshot:
        """The snapshot, without a time."""
        return replace(
            super().snapshot(number, pace), time=None, trace=np.zeros((0, 3)), mark=self._mark
        )


class _OneFrame(list[Any]):
    """A motion of a single frame."""

    def __init__(self, frame: Any, **about: Any) -> None:
        super().__init__([frame])
        self.__dict__.update(about)

    def position(self, number: int) -> np.ndarray:
        """Positions (n, 3) m."""
        return np.asarray(self[number].position)


def _one_frame(result: Any) -> _OneFrame:
    """A result with the face of a Motion."""
    reference, position = (
        np.asarray(x, dtype=float) for x in (result.particle_reference, result.particle_position)
    )
    part = result.particle_segment
    volume = result.particle_volume
    # A result holds each part's mean of F Br; F is found from the particles' places, and Br is what gives that mean.
    F = gradients(reference, position)
    remanence = np.zeros_like(position)
    magnetization = np.zeros_like(position)
    for k, mean in enumerate(np.asarray(result.segment_remanence, dtype=float)):
        of = part == k
        turned = np.average(F[of], axis=0, weights=volume[of])
        remanence[of] = np.linalg.lstsq(turned, mean, rcond=0.05)[0]
        magnetization[of] = np.einsum("nij,nj->ni", F[of], remanence[of])
    scene = scene_of(result.scene)
    static = getattr(result, "formulation", "static") == "static"
    time = (0.0 if scene is None else end_time(scene.field)) if static else float(result.time)
    field = failure(result)[1] * np.asarray(result.field, dtype=float)
    frame = SimpleNamespace(
        time=time, position=position, field=field, quantities={"magnetisation": magnetization}
    )
    return _OneFrame(
        frame,
        name=result.name,
        scene=result.scene,
        reference=reference,
        volume=volume,
        part=part,
        remanence=remanence,
        times=np.array([time]),
        fields=field[None],
        contacts={name: _row(time, one) for name, one in result.contacts.items()},
    )


def _row(time: float, contact: Named) -> dict[str, np.ndarray]:
    """A contact of a result as columns (1,) of contacts.csv."""
    known = {"F": contact["force"], "p": contact.get("point", (np.nan,) * 3)}
    columns = {
        f"{of}{axis}": np.array([each[i]])
        for of, each in known.items()
        for i, axis in enumerate("xyz")
    }
    return {"t": np.array([time]), **columns}


def trial_snapshot(
    result: Any,
    *,
    target: np.ndarray | None = None,
    target_name: str = "target",
    trial: int | None = None,
    rms: float | None = None,
    title: str | None = None,
    max_particles: int = 40_000,
    smooth: bool = False,
) -> Snapshot:
    """A result with its axis, its target, one arrow a segment, and insets.

    result: magmpm.results.result.Result, or anything with its attributes. target: (q, 4) rows [s, x, y, z] or (q, 3) rows [x, y, z], m.
    smooth: the body's surface is drawn; else the skin's particles, at most max_particles, that are finite and no slivers. Raises
    ValueError where nothing can be drawn, RenderError where the scene can't be read.
    """
    scene = scene_of(result.scene)
    reference = np.asarray(result.particle_reference, dtype=float)
    length, thickness = _size(scene, reference)
    centers, remanence = (
        np.asarray(x, dtype=float) for x in (result.segment_center, result.segment_remanence)
    )
    centerline = np.asarray(result.centreline, dtype=float)[:, 1:4]
    axis = centerline if len(centerline) > 1 else centers
    strength = np.linalg.norm(remanence, axis=1)
    mark, share = failure(result)
    if not mark and trial is None:  # a trial's caption is its number
        mark = beyond(result)
    obstacles = standing(scene) + in_reach(sources(scene), reference, REACH_OF_VIEW * length)
    return Snapshot(
        body=_surface(result, scene) if smooth else _particles(result, scene, max_particles),
        magnetized=strength > 1e-9 * max(float(strength.max(initial=0.0)), 1e-12),
        length=length,
        thickness=thickness,
        axis=axis,
        target=None if target is None else spread(np.asarray(target, dtype=float)[:, -3:]),
        target_name=target_name,
        arrows=segment_arrows(axis, centers, remanence, length, thickness),
        arrow_width=style.ARROW_WIDTH * thickness,
        obstacles=tuple(obstacles),
        field=share * np.asarray(result.field, dtype=float),
        gravity=gravity_of(scene),
        title=result.name if title is None else title,
        trial=trial,
        rms=rms,
        mark=mark,
        insets=True,
    )


def segment_arrows(
    axis: np.ndarray, centers: np.ndarray, remanence: np.ndarray, length: float, thickness: float
) -> np.ndarray:
    """Start and vector (a, 2, 3), m, of an arrow through the axis (m, 3) m in each magnetized segment.

    centers (k, 3) m; remanence (k, 3) T, deformed; length, thickness: m, of the body. The strongest is nearly as long as the segments
    are apart; the others in proportion to their remanence. The center of a segment bent far lies off its axis: the arrow goes
    through the axis's nearest point.
    """
    strength = np.linalg.norm(remanence, axis=1)
    longest = float(np.clip(0.9 * length / max(len(strength), 1), 1.2 * thickness, 2.4 * thickness))
    arrows = []
    for k in np.flatnonzero(strength > 1e-9 * max(float(strength.max(initial=0.0)), 1e-12)):
        vector = remanence[k] / strength.max() * longest
        nearest = axis[np.argmin(np.linalg.norm(axis - centers[k], axis=1))]
        arrows.append(np.stack([nearest - 0.5 * vector, vector]))
    return np.array(arrows).reshape(-1, 2, 3)


def failure(result: Any) -> tuple[str, float]:
    """Text for the picture of a result that is no answer, "" for one that is; and the fraction of the load that it carries."""
    share = float(getattr(result, "load_share", 1.0))
    if getattr(result, "converged", True):
        return "", share
    if share < 1.0:
        return f"NOT THE ANSWER: at {min(100 * share, 99.9):.3g} % of the load", share
    return "NOT THE ANSWER: the solve failed", share


def beyond(result: Any) -> str:
    """Text for the picture of an answer whose strain its material law does not carry (magmpm.results.strain); else ""."""
    strained = any(
        str(warning).startswith("strain: ") for warning in getattr(result, "warnings", ())
    )
    return f"BEYOND THE MATERIAL LAW: stretch {result.largest_stretch:.2g}" if strained else ""


def _size(scene: Scene | None, reference: np.ndarray) -> tuple[float, float]:
    """Length, and thickness or what a slender body's marks are sized by, lest they be too small to see, m."""
    sides = np.sort(np.ptp(reference, axis=0))
    length = float(sides[2])
    thickness = float(sides[0])
    if scene is not None and scene.body.shape.line is not None:
        length = scene.length
        thickness = scene.thickness
    return length, max(thickness, 0.06 * length)


def deformed_surface(result: Any) -> TriangleSurface:
    """The deformed surface of the body of a result, m. Raises RenderError where its scene cannot be read."""
    return _surface(result, scene_of(result.scene))


def polydata(result: Any) -> Any:
    """The deformed surface as a pyvista.PolyData, points in m, with the cell data `region`. Raises RenderError as deformed_surface."""
    import pyvista

    surface = deformed_surface(result)
    triangles = np.asarray(surface.triangles, dtype=np.int64)
    found = pyvista.PolyData(
        np.asarray(surface.points, dtype=float), np.insert(triangles, 0, 3, axis=1).ravel()
    )
    found.cell_data["region"] = surface.part
    return found


def _surface(result: Any, scene: Scene | None) -> TriangleSurface:
    """The deformed surface of a result's body."""
    reference = np.asarray(result.particle_reference, dtype=float)
    body = DrawnBody(
        scene, reference, result.particle_volume, result.particle_segment, np.zeros_like(reference)
    )
    return body.surface_at(np.asarray(result.particle_position, dtype=float))


def _particles(result: Any, scene: Scene | None, most: int) -> Balls:
    """The particles that can be seen."""
    position = np.asarray(result.particle_position, dtype=float)
    finite = np.isfinite(position).all(axis=1)
    if not finite.any():
        raise ValueError(
            "no particle of this result has a finite position: there is nothing to draw"
        )
    # Particles at the surface fill cut cells; the largest fills a whole one.
    volume = np.asarray(result.particle_volume)
    size = float(volume.max() ** (1 / 3))
    keep = np.flatnonzero(finite & (volume > 1e-3 * size**3))
    keep = keep[_skin(np.asarray(result.particle_reference)[keep], 2.5 * size, most, scene)]
    return Balls(
        position[keep].astype(np.float32),
        np.asarray(result.particle_segment)[keep].astype(np.int32),
        size,
    )


def _skin(reference: np.ndarray, thickness: float, most: int, scene: Scene | None) -> np.ndarray:
    """Indices of the particles less than `thickness` (m) below the surface of a straight body along x.

    reference: (n, 3) m. A catheter's particle is as deep as its distance to the mantle or to the nearer end face, a strip's to the
    nearest face. The outermost `most` are taken, where a plain stride would show holes. In other bodies the inside is not known: all of
    their particles are taken, or an even choice of them.
    """
    if scene is None or scene.body.shape.line is None:
        return np.unique(np.linspace(0, len(reference) - 1, min(most, len(reference))).astype(int))
    faces = np.minimum(reference - reference.min(0), reference.max(0) - reference)
    if scene.body.catheter is not None:
        radius = np.hypot(reference[:, 1], reference[:, 2])
        depth = np.minimum(radius.max() - radius, faces[:, 0])
    else:
        depth = faces.min(axis=1)
    outermost = np.argsort(depth, kind="stable")[:most]
    return np.sort(outermost[depth[outermost] < thickness])


TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
)  # binary STL, 50 bytes


def write_stl(result: Any, path: Path) -> Path:
    """Write the deformed surface of a result into a binary STL file, whole or not at all; lengths in mm. Returns the path."""
    surface = deformed_surface(result)
    corners = 1e3 * np.asarray(surface.points, dtype=float)[surface.triangles]
    across = face_normals(corners)
    rows = np.zeros(len(corners), dtype=TRIANGLE)
    rows["corners"] = corners
    rows["normal"] = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    with whole_file(path) as part:
        part.write_bytes(
            b"magmpm, millimeters".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()
        )
    return path
