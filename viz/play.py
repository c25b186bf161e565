"""A motion, or a result, made ready to be drawn: its body's surface, what stands around it, and where the camera stands.

Reads a scene's JSON (Scene.to_si()); what it does not know it leaves out, so that every motion can be drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from viz import scenery, style
from viz.camera import best_direction
from viz.picture import beyond, failure
from viz.process import RenderError
from viz.shapes import Surface, bar, refined, tube
from viz.stage import History, Shot, Stage
from viz.surface import Binding, PartedBinding, around_particles, bodies, creased, gradients, spacing

MOST_ARROWS = 16
LOOKS = 60  # frames looked at to place the camera
# How far from the body, in its lengths, a source may be to be in the picture; in one of a few moments, where it is before it has come near.
REACH, FAR = scenery.REACH, 3.5


class Body:
    """The body's surface and its magnetisation arrows, and how both follow the particles."""

    def __init__(
        self,
        scene: Mapping[str, Any],
        reference: np.ndarray,
        volume: np.ndarray,
        part: np.ndarray,
        remanence: np.ndarray,
    ) -> None:
        """reference (n, 3) m, volume (n,) m^3, part (n,), remanence (n, 3) T of the undeformed particles."""
        self.reference, self.part = np.asarray(reference, dtype=float), np.asarray(part)
        self.size = spacing(np.asarray(volume))
        self._plane_strain = bool(((scene.get("body") or {}).get("strip") or {}).get("plane_strain"))
        self.surface, self._binding = self._bound(scene, np.asarray(volume, dtype=float))
        strength = np.linalg.norm(remanence, axis=1)
        parts = int(self.part.max()) + 1
        strongest = np.bincount(self.part, strength, minlength=parts) / np.maximum(
            np.bincount(self.part, minlength=parts), 1
        )
        self.magnetised = strongest > 1e-9 * max(float(strongest.max()), 1e-12)
        held = [
            bool(m.get("clamp")) for m in ((scene.get("body") or {}).get("parts") or {}).get("meshes") or ()
        ]
        self.held = np.array(held or [False] * parts)
        self.length = float(np.ptp(self.reference, axis=0).max()) + self.size
        # In plane strain the particles' one layer is not as wide as the body.
        sides = (
            np.sort(np.ptp(self.surface.points if self._plane_strain else self.reference, axis=0)) + self.size
        )
        self.thickness = float(np.clip(sides[1], 0.06 * self.length, 0.12 * self.length))
        self.clusters = self._clusters(np.asarray(remanence, dtype=float))

    def points(self, position: np.ndarray) -> np.ndarray:
        """The surface's points (m, 3) m when the particles are at position (n, 3) m."""
        if not self._plane_strain:
            return self._binding.at(position)
        points = self._binding.at(self._layered(position))
        points[:, 1] = self.surface.points[:, 1]
        return points

    def _layered(self, position: np.ndarray) -> np.ndarray:
        """In plane strain one layer of particles stands for all of the width, along which nothing moves: three, then, to fit to."""
        return np.vstack([position + shift * self.size * np.eye(3)[1] for shift in (-1, 0, 1)])

    def arrows(self, position: np.ndarray, magnetisation: np.ndarray) -> np.ndarray:
        """Starts and vectors (a, 2, 3) m of the magnetisation's arrows; magnetisation (n, 3) T, deformed."""
        if not self.clusters:
            return np.zeros((0, 2, 3))
        centre = np.array([position[near].mean(axis=0) for _, near in self.clusters])
        mean = np.array([magnetisation[members].mean(axis=0) for members, _ in self.clusters])
        longest = float(np.linalg.norm(mean, axis=1).max())
        if not longest > 0:
            return np.zeros((0, 2, 3))
        vector = mean / longest * self._arrow_length
        return np.stack([centre - 0.5 * vector, vector], axis=1)

    def _bound(self, scene: Mapping[str, Any], volume: np.ndarray) -> tuple[Surface, Binding | PartedBinding]:
        known = _known_shape(scene, self.size, int(self.part.max()) + 1)
        if known is not None and self._plane_strain:
            middle = np.array(known.points)
            middle[:, 1] = self.reference[:, 1].mean()
            return known, Binding(middle, self._layered(self.reference))
        if known is not None:
            return known, Binding(known.points, self.reference)
        meshes = (scene.get("body") or {}).get("parts")
        if meshes is not None:
            whole = _meshes(meshes, self.size)
            return whole, PartedBinding(whole.points, whole.part_of_point, self.reference, self.part)
        separate = bodies(self.reference, self.size)
        surfaces = [
            around_particles(self.reference[of], volume[of], self.part[of])
            for body in range(int(separate.max()) + 1)
            for of in [separate == body]
        ]
        whole = Surface.joined(surfaces)
        body_of_point = np.repeat(np.arange(len(surfaces)), [len(s.points) for s in surfaces])
        return whole, PartedBinding(whole.points, body_of_point, self.reference, separate)

    def _clusters(self, remanence: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each arrow: the particles whose magnetisation it shows, and those at its middle.

        A part magnetised evenly has one arrow, or a few if it is most of the body; one whose magnetisation turns has one for each piece
        of its length.
        """
        parts = np.flatnonzero(self.magnetised)
        pieces: list[np.ndarray] = []
        for k in parts:
            members = np.flatnonzero(self.part == k)
            mean = remanence[members].mean(axis=0)
            even = np.linalg.norm(mean) > 0.97 * np.linalg.norm(remanence[members], axis=1).mean()
            place = self.reference[members]
            along = place[:, np.argmax(np.ptp(place, axis=0))]
            long = max(1, round(float(np.ptp(along)) / (0.34 * self.length)))
            count = long if even else max(2, min(8, MOST_ARROWS // max(len(parts), 1)))
            edges = np.linspace(along.min(), along.max() * (1 + 1e-12) + 1e-300, count + 1)
            which = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, count - 1)
            pieces += [members[which == i] for i in range(count) if np.any(which == i)]
        # As long as the pieces are, and so short that neighbours do not cross.
        middles = np.array([self.reference[p].mean(axis=0) for p in pieces]).reshape(-1, 3)
        sizes = [float(np.linalg.norm(np.ptp(self.reference[p], axis=0))) for p in pieces]
        longest = 0.9 * float(np.median(sizes)) if sizes else self.length
        if len(middles) > 1:
            apart = np.asarray(cKDTree(middles).query(middles, k=2)[0])[:, 1]
            longest = min(longest, max(0.95 * float(np.median(apart)), 0.07 * self.length))
        self._arrow_length = float(np.clip(longest, 0.05 * self.length, 0.3 * self.length))
        self.arrow_reach = self._arrow_length if pieces else 0.0
        self.arrow_width = min(style.ARROW_WIDTH * self.thickness, 0.085 * self._arrow_length)
        nearest = [
            p[np.argsort(np.linalg.norm(self.reference[p] - self.reference[p].mean(axis=0), axis=1))[:8]]
            for p in pieces
        ]
        return list(zip(pieces, nearest))


def _known_shape(scene: Mapping[str, Any], step: float, parts: int) -> Surface | None:
    """The surface of a catheter or strip, sharp edges and all; None for a body of parts."""
    body = {name: shape for name, shape in (scene.get("body") or {}).items() if shape is not None}
    if "catheter" in body:
        c = body["catheter"]
        ends = np.cumsum(_lengths(c))
        return tube(
            ends.tolist(), 0.5 * float(c["diameter"]), 0.5 * float(c.get("inner_diameter") or 0.0), step
        )
    if "strip" in body:
        c = body["strip"]
        # A magnetisation that varies steadily comes in equal pieces.
        even = float(c["length"]) / parts * np.arange(1, parts + 1)
        ends = np.cumsum(_lengths(c)) if c.get("segments") else even
        return bar(
            ends.tolist(),
            float(c["width"]),
            float(c["thickness"]),
            step,
            c.get("position") or (0.0, 0.0, 0.0),
        )
    return None


def _meshes(parts: Mapping[str, Any], step: float) -> Surface:
    """The surfaces of STL parts, with triangles of about two particles."""
    from magmpm.bodies.assembly import UNITS
    from magmpm.bodies.surface_mesh import unpack_mesh

    scale = UNITS[parts["unit"]]
    surfaces = []
    for k, part in enumerate(parts["meshes"]):
        mesh = unpack_mesh(part["mesh"])
        surfaces.append(refined(creased(mesh.vertices * scale, mesh.faces, k), 3 * step))
    return Surface.joined(surfaces)


def _lengths(shape: Mapping[str, Any]) -> np.ndarray:
    """Length (k,) m of each segment; those without one share the rest."""
    given = [segment.get("length") for segment in shape["segments"]]
    free = float(shape["length"]) - sum(length for length in given if length is not None)
    share = free / max(given.count(None), 1)
    return np.array([share if length is None else float(length) for length in given])


def surface_of(result: Any) -> Surface:
    """The deformed surface of a result's body: points (m, 3) m in single precision, triangles, parts."""
    reference = np.asarray(result.particle_reference, dtype=float)
    body = Body(
        result.scene, reference, result.particle_volume, result.particle_segment, np.zeros_like(reference)
    )
    points = body.points(np.asarray(result.particle_position, dtype=float))
    whole = np.isfinite(points).all(axis=1)[body.surface.triangles].all(axis=1)
    return Surface(np.nan_to_num(points).astype(np.float32), body.surface.triangles[whole].astype(np.int32), body.surface.part[whole])


class Play:
    """A motion (magmpm.results.trajectory.Motion) ready to be drawn: `stage(k)` of each frame, all to be seen in one `shot`."""

    def __init__(self, motion: Any) -> None:
        """Raises RenderError for a motion without frames."""
        if len(motion) == 0:
            raise RenderError("this motion has no frames yet: there is nothing to show")
        self.motion = motion
        scene = motion.scene or {}
        self.body = Body(scene, motion.reference, motion.volume, motion.part, motion.remanence)
        self.ground = scenery.ground(scene)
        self._standing = scenery.standing(scene, self.body.length)
        self._scene = scene
        self.title = motion.name or "motion"
        self.gravity = _gravity(scene)
        known = np.isfinite(motion.fields).all(axis=1)
        self.history = History(motion.times[known], motion.fields[known]) if known.any() else None
        self._touched = scenery.surfaces(scene)
        self._usual_force = _usual([_forces(contact) for contact in motion.contacts.values()])
        self._trace = self._traced()
        self.shot = self._shot()

    def __len__(self) -> int:
        return len(self.motion)

    def stage(self, number: int, pace: float | None = None) -> Stage:
        """The stage of a frame; pace: how many times slower than life the movie is."""
        frame = self.motion[number]
        points = self.body.points(frame.position)
        magnetisation = frame.quantities.get("magnetisation", self.motion.remanence)
        touching, forces = self._contact(frame, points)
        good = np.isfinite(points).all(axis=1)
        whole = good[self.body.surface.triangles].all(axis=1)
        return Stage(
            points=np.where(good[:, None], points, 0.0).astype(np.float32),
            triangles=self.body.surface.triangles[whole].astype(np.int32),
            part=self.body.surface.part[whole],
            magnetised=self.body.magnetised,
            held=self.body.held,
            length=self.body.length,
            thickness=self.body.thickness,
            arrow_width=self.body.arrow_width,
            arrows=np.nan_to_num(self.body.arrows(frame.position, magnetisation)),
            props=tuple(self._standing + self._sources(frame.time)),
            ground=self.ground,
            contact=touching,
            forces=forces,
            touches=self._usual_force > 0,
            trace=self._trace[: number + 1],
            field=frame.field,
            history=self.history,
            gravity=self.gravity,
            time=frame.time,
            duration=float(np.ptp(self.motion.times)) or 1.0,
            pace=pace,
            title=self.title,
        )

    def shot_of(self, numbers: Sequence[int]) -> Shot:
        """What must be seen in some frames: with where the sources that come near are then, unless that is very far."""
        ends = [self._sources(float(time)) for time in np.unique(self.motion.times[[0, -1]])]
        near = [any(p.framed for p in same) for same in zip(*ends)]
        seen = [self.shot.points]
        for time in self.motion.times[np.asarray(numbers, dtype=int)]:
            there = self._sources(float(time), FAR)
            seen += [_near(p, self._around, 0.0) for p, come in zip(there, near) if come and p.framed]
        return replace(self.shot, points=np.vstack(seen))

    def _sources(self, time: float, reach: float = REACH) -> list[scenery.Prop]:
        return scenery.in_reach(scenery.sources(self._scene, time), self._around, reach * self.body.length)

    def _contact(self, frame: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the surface touches something that pushes it, (c, 3) m, and the forces of it as arrows (f, 2, 3) m."""
        marks, arrows = [np.zeros((0, 3))], []
        for effect, contact in self.motion.contacts.items():
            now = np.flatnonzero(np.isclose(contact["t"], frame.time, rtol=1e-9, atol=1e-15))
            if effect not in self._touched or not len(now) or not np.any(_forces(contact)[now[0]]):
                continue
            height = self._touched[effect].height(points)
            touching = points[height < max(0.75 * self.body.size, float(np.nanmin(height)) + 1e-9)]
            marks.append(_spread(self._touched[effect].dropped(touching), self.body.size))
            force = _forces(contact)[now[0]] / self._usual_force
            vector = 0.25 * self.body.length * force * min(1.0, 2.0 / float(np.linalg.norm(force)))
            arrows.append(np.stack([marks[-1].mean(axis=0), vector]))
        return np.vstack(marks), np.array(arrows).reshape(-1, 2, 3)

    def _looked_at(self) -> np.ndarray:
        """Numbers of frames spread over the motion."""
        return np.unique(np.linspace(0, len(self) - 1, LOOKS).round().astype(int))

    def _traced(self) -> np.ndarray:
        """The way (frames, 3) m of a held catheter's or strip's free end, or of a free body's middle if it goes far; else nothing."""
        x = self.body.reference[:, 0]
        kind: Mapping[str, Any] = next(
            (shape for shape in (self._scene.get("body") or {}).values() if shape is not None), {}
        )
        held = kind.get("clamp", "base" if "diameter" in kind else "none") == "base" or self.body.held.any()
        if held and "meshes" in kind:
            return np.zeros((0, 3))
        members = x > x.max() - 1.5 * self.body.size if held else np.ones(len(x), dtype=bool)
        # Positions alone, a frame at a time: a motion may be larger than the memory.
        return np.array(
            [self.motion.position(k)[members].mean(axis=0, dtype=float) for k in range(len(self))]
        )

    def _shot(self) -> Shot:
        extremes = []
        for k in self._looked_at():
            points = self.motion.position(k).astype(float)
            points = points[np.isfinite(points).all(axis=1)]
            if len(points):
                keep = np.concatenate([points.argmin(axis=0), points.argmax(axis=0)])
                some = np.linspace(0, len(points) - 1, min(len(points), 300)).astype(int)
                extremes += [points[keep], points[some]]
        return self._framed(np.vstack(extremes))

    def _framed(self, points: np.ndarray) -> Shot:
        self._around = points
        margin = max(0.5 * self.body.thickness + self.body.size, 0.5 * self.body.arrow_reach)
        framed = [points]
        for time in np.unique(self.motion.times[[0, -1]]):
            props = self._standing + self._sources(float(time))
            framed += [_near(p, points, 0.3 * self.body.length) for p in props if p.framed]
        if self.ground is not None:
            framed.append(self.ground.dropped(points))
        up = self._up()
        turn = scenery.least_turn(up)
        return Shot(np.vstack(framed), turn @ best_direction(points @ turn), margin, self.ground, up)

    def _up(self) -> np.ndarray:
        """Against gravity; without it away from the ground; else z."""
        if self.gravity is not None and np.any(self.gravity):
            return np.asarray(-self.gravity / np.linalg.norm(self.gravity))
        return np.array([0.0, 0.0, 1.0]) if self.ground is None else self.ground.normal


class Still(Play):
    """A result of statics drawn as a motion is, with a smooth surface and what stands around it: one stage."""

    def __init__(self, result: Any) -> None:
        super().__init__(_OneFrame(result))
        self._mark = failure(result)[0] or beyond(result)

    def picture(self) -> Stage:
        """The stage, without a time."""
        return replace(self.stage(0), time=None, trace=np.zeros((0, 3)), mark=self._mark)


class _OneFrame:
    """A result with the face of a Motion."""

    def __init__(self, result: Any) -> None:
        position = np.asarray(result.particle_position, dtype=float)
        n = len(position)
        self.name, self.scene = result.name, result.scene
        self.reference, self.volume, self.part = (
            result.particle_reference,
            result.particle_volume,
            result.particle_segment,
        )
        # A result holds each part's mean of F Br; F is found from the particles' places, and Br is what gives that mean.
        F = gradients(np.asarray(self.reference, dtype=float), position)
        self.remanence, magnetisation = np.zeros((n, 3)), np.zeros((n, 3))
        for k, mean in enumerate(np.asarray(result.segment_remanence, dtype=float)):
            of = self.part == k
            turned = np.average(F[of], axis=0, weights=self.volume[of])
            self.remanence[of] = np.linalg.lstsq(turned, mean, rcond=0.05)[0]
            magnetisation[of] = np.einsum("nij,nj->ni", F[of], self.remanence[of])
        time = scenery.END if getattr(result, "formulation", "static") == "static" else float(result.time)
        self.times = np.full(1, time)
        self.fields = failure(result)[1] * np.asarray(result.field, dtype=float).reshape(1, 3)
        self.contacts: dict[str, Any] = {}
        self._frame = _Moment(time, position.reshape(n, 3), self.fields[0], {"magnetisation": magnetisation})

    def __len__(self) -> int:
        return 1

    def __getitem__(self, number: int) -> _Moment:
        return self._frame

    def position(self, number: int) -> np.ndarray:
        return self._frame.position


class _Moment:
    def __init__(
        self, time: float, position: np.ndarray, field: np.ndarray, quantities: dict[str, np.ndarray]
    ) -> None:
        self.time, self.position, self.field, self.quantities = time, position, field, quantities


def _near(prop: scenery.Prop, points: np.ndarray, reach: float) -> np.ndarray:
    """What of a prop must be seen: all of it, but of a wall that is much larger than what is near only what is within reach (m) of the
    body's points."""
    some = prop.points[:: max(len(prop.points) // 400, 1)]
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    if prop.name != "wall" or np.ptp(prop.points, axis=0).max() < 2.5 * (high - low).max():
        return np.vstack(
            [some, prop.points[prop.points.argmin(axis=0)], prop.points[prop.points.argmax(axis=0)]]
        )
    return some[((some > low) & (some < high)).all(axis=1)]


def _forces(contact: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.stack([contact[name] for name in ("Fx", "Fy", "Fz")], axis=1)


def _usual(forces: list[np.ndarray]) -> float:
    """A strong but not extreme force, N, of all there are (k, 3): impacts are many times stronger than what stands. 0 if none."""
    sizes = np.concatenate([np.zeros(0), *(np.linalg.norm(f, axis=1) for f in forces)])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    return float(np.quantile(sizes, 0.75)) if len(sizes) else 0.0


def _spread(points: np.ndarray, apart: float) -> np.ndarray:
    """At most one point in every cube of that edge (m)."""
    _, first = np.unique(np.floor(points / apart).astype(int), axis=0, return_index=True)
    return points[np.sort(first)]


def _gravity(scene: Mapping[str, Any]) -> np.ndarray | None:
    effect = (scene.get("effects") or {}).get("gravity")
    if effect is None:
        return None
    return np.asarray(effect.get("acceleration") or (0.0, 0.0, -9.81), dtype=float)
