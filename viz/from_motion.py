"""Snapshots of a motion: its body's surface, what stands around it, and a framing that holds all of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Named
from magmpm.errors import PAIR, MagmpmError, RenderError
from magmpm.fields.magnets import frame_of
from magmpm.scene import Scene
from magmpm.viz.body import DrawnBody
from magmpm.viz.camera import Framing, best_direction, extremes
from magmpm.viz.obstacles import REACH_OF_VIEW, ground, in_reach, sources, standing, surfaces
from magmpm.viz.snapshot import DrawnSolid, History, Snapshot

DONE = {
    "limit point": "snapped",
    "bifurcation": "buckled",
}  # what a body did where a branch of equilibria ended


def scene_of(data: Named | None) -> Scene | None:
    """The scene saved with a result (Scene.to_si), or None where none was. Raises RenderError."""
    if not data:
        return None
    try:
        return Scene.from_si(data)
    except (MagmpmError, ValueError) as error:
        raise RenderError(
            f"the scene that is saved with this result can't be read: {error}"
        ) from None


def gravity_of(scene: Scene | None) -> np.ndarray | None:
    """Acceleration (3,) m/s^2, or None where gravity is not simulated."""
    gravity = None if scene is None else scene.effects.gravity
    return None if gravity is None else np.array(gravity.acceleration, dtype=float)


class MotionRenderer:
    """A motion (magmpm.results.trajectory.Motion) ready to be drawn: `snapshot(k)` of each frame, all in view in one `framing`."""

    def __init__(self, motion: Any) -> None:
        """Raises RenderError for a motion without frames."""
        if len(motion) == 0:
            raise RenderError("this motion has no frames yet")
        self.motion = motion
        self._scene = scene_of(motion.scene)
        self.body = DrawnBody(
            self._scene, motion.reference, motion.volume, motion.part, motion.remanence
        )
        self.ground = ground(self._scene)
        self._standing = standing(self._scene)
        self.title = motion.name or "motion"
        self.gravity = gravity_of(self._scene)
        known = np.isfinite(motion.fields).all(axis=1)
        self._jumps = list(getattr(motion, "jumps", []))
        jumps = tuple(jump["time"] for jump in self._jumps)
        self.history = (
            History(motion.times[known], motion.fields[known], jumps) if known.any() else None
        )
        self._surfaces = surfaces(self._scene)
        self._usual_force = _usual([_forces(contact) for contact in motion.contacts.values()])
        self._trace = self._traced()
        self.framing = self._framed()

    def __len__(self) -> int:
        return len(self.motion)

    def snapshot(self, number: int = 0, pace: float | None = None) -> Snapshot:
        """The snapshot of a frame; pace: how many times slower than life the movie is."""
        frame = self.motion[number]
        contact, forces = self._contact(frame, self.body.points(frame.position))
        return Snapshot(
            body=self.body.surface_at(frame.position),
            magnetized=self.body.magnetized,
            held=self.body.held,
            length=self.body.length,
            thickness=self.body.thickness,
            arrows=self.body.arrows(
                frame.position, frame.quantities.get("magnetisation", self.motion.remanence)
            ),
            arrow_width=self.body.arrow_width,
            obstacles=tuple(self._standing + self._sources(frame.time)),
            ground=self.ground,
            contact=contact,
            forces=forces,
            touches=self._usual_force > 0,
            trace=self._trace[: number + 1],
            field=frame.field,
            history=self.history,
            gravity=self.gravity,
            time=frame.time,
            duration=float(np.ptp(self.motion.times)) or 1.0,
            pace=(
                None if getattr(self.motion, "steps", None) else pace
            ),  # equilibria have no speed of their own
            title=self.title,
            event=self._event(number),
        )

    def _event(self, number: int) -> str:
        """Describe what the body has just done in a frame of equilibria along time: it left a branch that ended, a moment ago."""
        times = self.motion.times
        now = float(times[number])
        # 0.06 of the duration: how long it is said that a body has jumped
        shown = max(0.06 * float(np.ptp(times)), float(now - times[number - 1]) if number else 0.0)
        past = [jump for jump in self._jumps if now - shown <= jump["time"] <= now]
        return "" if not past else f"{DONE[past[-1]['kind']]} at {1e3 * past[-1]['field']:.3g} mT"

    def framing_of(self, numbers: Sequence[int]) -> Framing:
        """Framing of some frames: with the sources that come near where they are then, unless that is very far."""
        # in place of obstacles.REACH for a few moments, where a source is shown before it has come near
        reach_of_moments = 3.5
        ends = [self._sources(float(time)) for time in np.unique(self.motion.times[[0, -1]])]
        near = [any(source.framed for source in same) for same in zip(*ends)]
        seen = [self.framing.points]
        for time in self.motion.times[np.asarray(numbers, dtype=int)]:
            there = self._sources(float(time), reach_of_moments)
            seen += [
                _near(source, self._around, 0.0)
                for source, comes in zip(there, near)
                if comes and source.framed
            ]
        return replace(self.framing, points=np.vstack(seen))

    def _sources(self, time: float, reach: float = REACH_OF_VIEW) -> list[DrawnSolid]:
        return in_reach(sources(self._scene, time), self._around, reach * self.body.length)

    def _contact(self, frame: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points where the surface touches something that pushes it, (c, 3) m, and the forces of it as arrows (f, 2, 3) m."""
        marks = [np.zeros((0, 3))]
        arrows = []
        names = [region.name for region in self._scene.regions()] if self._scene else []
        for name, contact in self.motion.contacts.items():
            now = np.flatnonzero(np.isclose(contact["t"], frame.time, rtol=1e-9, atol=1e-15))
            if not len(now) or not np.any(_forces(contact)[now[0]]):
                continue
            effect, _, part = name.partition(PAIR)
            if effect in self._surfaces:
                on = self._surfaces[effect]
                some = frame.position[self.motion.part == names.index(part)] if part else points
                height = on.height(some)
                near = max(0.75 * self.body.size, float(np.nanmin(height)) + 1e-9)
                place = _spread(on.dropped(some[height < near]), self.body.size)
            elif part:
                place = np.array([[contact[f"p{axis}"][now[0]] for axis in "xyz"]])
            else:
                continue
            if not part or effect not in self._surfaces:
                marks.append(place)
            if not part and any(
                other.startswith(f"{effect}{PAIR}") for other in self.motion.contacts
            ):
                continue  # its parts have arrows of their own
            force = _forces(contact)[now[0]] / self._usual_force
            vector = 0.25 * self.body.length * force * min(1.0, 2.0 / float(np.linalg.norm(force)))
            arrows.append(np.stack([place.mean(axis=0), vector]))
        return np.vstack(marks), np.array(arrows).reshape(-1, 2, 3)

    def _traced(self) -> np.ndarray:
        """The path (frames, 3) m of a held catheter's or strip's free end, or of a free body's middle; of held parts nothing."""
        if self.body.held.any():
            return np.zeros((0, 3))
        x = self.body.reference[:, 0]
        tip = self._scene is not None and self._scene.anchored
        members = x > x.max() - 1.5 * self.body.size if tip else np.ones(len(x), dtype=bool)
        # Positions alone, a frame at a time: a motion may be larger than the memory.
        return np.array(
            [self.motion.position(k)[members].mean(axis=0, dtype=float) for k in range(len(self))]
        )

    def _framed(self) -> Framing:
        found = []
        for k in np.unique(
            np.linspace(0, len(self) - 1, 60).round().astype(int)
        ):  # frames looked at to place the camera
            points = self.motion.position(k).astype(float)
            points = points[np.isfinite(points).all(axis=1)]
            if len(points):
                found.append(extremes(points, 300))
        self._around = points = np.vstack(found)
        margin = max(0.5 * self.body.thickness + self.body.size, 0.5 * self.body.arrow_reach)
        framed = [points]
        for time in np.unique(self.motion.times[[0, -1]]):
            obstacles = self._standing + self._sources(float(time))
            framed += [
                _near(obstacle, points, 0.3 * self.body.length)
                for obstacle in obstacles
                if obstacle.framed
            ]
        if self.ground is not None:
            framed.append(self.ground.dropped(points))
        up = self._up()
        turn = frame_of(tuple(up))
        return Framing(
            np.vstack(framed), turn @ best_direction(points @ turn), margin, self.ground, up
        )

    def _up(self) -> np.ndarray:
        """Against gravity; without it away from the ground; else z."""
        if self.gravity is not None and np.any(self.gravity):
            return np.asarray(-self.gravity / np.linalg.norm(self.gravity))
        return np.array([0.0, 0.0, 1.0]) if self.ground is None else self.ground.normal


def _near(obstacle: DrawnSolid, points: np.ndarray, reach: float) -> np.ndarray:
    """Points of an obstacle that must be in view: all of it; of a wall much larger than what is near only what is within reach (m) of the
    body's points."""
    low = points.min(axis=0) - reach
    high = points.max(axis=0) + reach
    if obstacle.name != "wall" or np.ptp(obstacle.points, axis=0).max() < 2.5 * (high - low).max():
        return extremes(obstacle.points, 400)
    some = obstacle.points[:: max(len(obstacle.points) // 400, 1)]
    return some[((some > low) & (some < high)).all(axis=1)]


def _forces(contact: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.stack([contact[name] for name in ("Fx", "Fy", "Fz")], axis=1)


def _usual(forces: list[np.ndarray]) -> float:
    """A strong but not extreme force, N, of all there are (k, 3): impacts are many times stronger than what stands. 0 if none."""
    sizes = np.concatenate([np.zeros(0), *(np.linalg.norm(f, axis=1) for f in forces)])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    return float(np.quantile(sizes, 0.75)) if len(sizes) else 0.0


def _spread(points: np.ndarray, edge: float) -> np.ndarray:
    """The points, at most one in every cube of that edge (m)."""
    _, first = np.unique(np.floor(points / edge).astype(int), axis=0, return_index=True)
    return points[np.sort(first)]
