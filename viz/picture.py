"""What a picture shows: plain arrays, so that it travels to the drawing process and nothing else has to.

A Picture knows neither scene nor solver. It is small (single precision, at most about 1 MB) because one is
pickled for every trial of a study.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.results import readable

if TYPE_CHECKING:
    from viz.scenery import Prop
    from viz.shapes import Surface

MAX_PARTICLES = 40_000

# How deep below the surface particles are kept, in their own sizes: the rest cannot be seen.
SKIN = 2.5

# Particles of less than this share of a whole one's volume are not drawn.
SLIVER = 1e-3


@dataclass(frozen=True)
class Picture:
    """One body, deformed, with what it was meant to reach. SI units throughout.

    particles            (n, 3) float32 m, deformed positions
    particle_segment     (n,) int, segment of each particle, base to tip from 0
    particle_size        m, edge of the cube a particle stands for (drawn as a ball about that wide)
    segment_center       (k, 3) m, deformed centre of each segment
    segment_remanence    (k, 3) T, deformed mean remanence F Br; zero length is an unmagnetised segment
    length, diameter     m, of the undeformed body
    centreline           (m, 3) m, deformed axis from clamp to tip, or shape (0, 3)
    clamp                (3,) m, centre of the face that is held, normal to x; None for bodies held otherwise, or free
    target               (q, 3) m, wanted points, or None; target_name is what the legend calls them
    field                (3,) T, uniform field, zero if there is none
    gravity              (3,) m/s^2, or None
    title, trial, rms    caption; rms in m
    mark                 what stands in the caption's place, in red, where this is no answer, or none to trust; or ""
    surface              what is drawn in place of the particles' cloud, or None
    props                the field's magnets and coils
    """

    particles: np.ndarray
    particle_segment: np.ndarray
    particle_size: float
    segment_center: np.ndarray
    segment_remanence: np.ndarray
    length: float
    diameter: float
    centreline: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    clamp: np.ndarray | None = field(default_factory=lambda: np.zeros(3))
    target: np.ndarray | None = None
    target_name: str = "target"
    field: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gravity: np.ndarray | None = None
    title: str = ""
    trial: int | None = None
    rms: float | None = None
    mark: str = ""
    surface: Surface | None = None
    props: tuple[Prop, ...] = ()

    def __post_init__(self) -> None:
        for name, columns in (
            ("particles", 3),
            ("segment_center", 3),
            ("segment_remanence", 3),
            ("centreline", 3),
        ):
            array = getattr(self, name)
            if array.ndim != 2 or array.shape[1] != columns:
                raise ValueError(f"Picture.{name} has shape {array.shape}; it must be (any, {columns})")
        if self.target is not None and (self.target.ndim != 2 or self.target.shape[1] != 3):
            raise ValueError(f"Picture.target has shape {self.target.shape}; it must be (any, 3)")
        if len(self.particles) == 0:
            raise ValueError("Picture.particles is empty: there is nothing to draw")
        if self.particle_segment.shape != (len(self.particles),):
            raise ValueError(
                f"Picture.particle_segment has shape {self.particle_segment.shape}; "
                f"it must be ({len(self.particles)},), one segment a particle"
            )

    @property
    def magnetised(self) -> np.ndarray:
        """(k,) bool: which segments carry a remanence."""
        strength = np.linalg.norm(self.segment_remanence, axis=1)
        return strength > 1e-9 * max(float(strength.max(initial=0.0)), 1e-12)

    @property
    def thickness(self) -> float:
        """m, the diameter, or what a slender body's marks are sized by, lest they be too small to see."""
        return max(self.diameter, 0.06 * self.length)

    @property
    def axis(self) -> np.ndarray:
        """(m, 3) m: the centreline, or the segments' centres where no centreline was given."""
        return self.centreline if len(self.centreline) > 1 else self.segment_center

    def caption(self) -> str:
        """Trial number and rms as one line, "trial 12   rms 1.93 mm"; empty if neither is known; the mark, where there is one."""
        if self.mark:
            return self.mark
        parts = []
        if self.trial is not None:
            parts.append(f"trial {self.trial}")
        if self.rms is not None:
            parts.append(f"rms {self.rms * 1e3:.2f} mm" if self.rms >= 1e-4 else f"rms {readable.length(self.rms)}")
        return "   ".join(parts)

    @classmethod
    def from_result(
        cls,
        result: Any,
        *,
        target: np.ndarray | None = None,
        target_name: str = "target",
        trial: int | None = None,
        rms: float | None = None,
        title: str | None = None,
        max_particles: int = MAX_PARTICLES,
        smooth: bool = False,
    ) -> Picture:
        """The picture of a simulation's result.

        result: magmpm.results.result.Result, or anything with its attributes. target: (q, 4) rows [s, x, y, z] or
        (q, 3) rows [x, y, z], m. Only the skin's particles are kept, at most max_particles, and only finite
        ones that are not slivers. smooth: the body's surface is drawn in place of them.
        """
        from viz.play import surface_of
        from viz.scenery import sources_at_rest

        position = np.asarray(result.particle_position, dtype=float)
        finite = np.isfinite(position).all(axis=1)
        if not finite.any():
            raise ValueError("no particle of this result has a finite position: there is nothing to draw")
        # Particles at the surface stand for cut cells; the largest stands for a whole one.
        volume = np.asarray(result.particle_volume)
        size = float(volume.max() ** (1 / 3))
        keep = np.flatnonzero(finite & (volume > SLIVER * size**3))
        kind = next(key for key, shape in result.scene["body"].items() if shape is not None)
        keep = keep[_skin(np.asarray(result.particle_reference)[keep], SKIN * size, max_particles, kind)]
        length, diameter = _size(result.scene["body"], np.asarray(result.particle_reference))
        effects = result.scene.get("effects") or {}
        mark, share = failure(result)
        if not mark and trial is None:  # a trial's caption is its number
            mark = beyond(result)
        return cls(
            particles=position[keep].astype(np.float32),
            particle_segment=np.asarray(result.particle_segment)[keep].astype(np.int32),
            particle_size=size,
            segment_center=np.asarray(result.segment_center, dtype=float),
            segment_remanence=np.asarray(result.segment_remanence, dtype=float),
            length=length,
            diameter=diameter,
            centreline=np.asarray(result.centreline, dtype=float)[:, 1:4],
            clamp=_clamp(result.scene["body"][kind]),
            target=None if target is None else np.asarray(target, dtype=float)[:, -3:],
            target_name=target_name,
            field=share * np.asarray(result.field, dtype=float),
            gravity=_gravity(effects.get("gravity")),
            title=result.name if title is None else title,
            trial=trial,
            rms=rms,
            mark=mark,
            surface=surface_of(result) if smooth else None,
            props=tuple(sources_at_rest(result.scene, np.asarray(result.particle_reference), length)),
        )


def failure(result: Any) -> tuple[str, float]:
    """What to write on the picture of a result that is no answer, "" for one that is; and the share of the load that it carries."""
    share = float(getattr(result, "load_share", 1.0))
    if getattr(result, "converged", True):
        return "", share
    if share < 1.0:
        return f"NOT THE ANSWER: at {min(100 * share, 99.9):.3g} % of the load", share
    return "NOT THE ANSWER: the solve failed", share


def beyond(result: Any) -> str:
    """What to write on the picture of an answer whose strain its material law does not carry (magmpm.results.strain); else ""."""
    strained = any(str(warning).startswith("strain: ") for warning in getattr(result, "warnings", ()))
    return f"BEYOND THE MATERIAL LAW: stretch {result.largest_stretch:.2g}" if strained else ""


def _clamp(shape: dict[str, Any]) -> np.ndarray | None:
    """Centre (3,) m of the face that holds a straight body (its JSON), or None."""
    if "meshes" in shape or shape.get("clamp", "base") == "none":
        return None
    return np.asarray(shape.get("position") or (0.0, 0.0, 0.0), dtype=float)


def _size(body: dict[str, Any], reference: np.ndarray) -> tuple[float, float]:
    """Length and thickness, m, of a scene's body (its JSON) whose particles lay at `reference` (n, 3) m."""
    shape = next(shape for shape in body.values() if shape is not None)
    if "length" in shape:
        return float(shape["length"]), float(shape.get("diameter") or shape["thickness"])
    sides = np.sort(np.ptp(reference, axis=0))
    return float(sides[2]), float(sides[0])


def _gravity(effect: dict[str, Any] | None) -> np.ndarray | None:
    """Acceleration (3,) m/s^2 of a scene's gravity effect (its JSON), or None if it is not simulated."""
    if effect is None:
        return None
    return np.asarray(effect.get("acceleration", (0.0, 0.0, -9.81)), dtype=float)


def _skin(reference: np.ndarray, thickness: float, most: int, kind: str) -> np.ndarray:
    """Indices of the particles less than `thickness` (m) below the surface of a straight body along x.

    reference: (n, 3) m. A catheter's particle is as deep as its distance to the mantle or to the nearer end face, a strip's to
    the nearest face. The outermost `most` are taken, where a plain stride would show holes. Other bodies are not told inside from
    outside: all of their particles are taken, or an even choice of them.
    """
    if kind == "parts":
        return np.unique(np.linspace(0, len(reference) - 1, min(most, len(reference))).astype(int))
    faces = np.minimum(reference - reference.min(0), reference.max(0) - reference)
    if kind == "catheter":
        radius = np.hypot(reference[:, 1], reference[:, 2])
        depth = np.minimum(radius.max() - radius, faces[:, 0])
    else:
        depth = faces.min(axis=1)
    outermost = np.argsort(depth, kind="stable")[:most]
    return np.sort(outermost[depth[outermost] < thickness])
