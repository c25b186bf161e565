"""Answer of a scene's run, for measures: places over time, contacts, and the field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.model import Model, build
from magmpm.results.measures import of_particles
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene

SAMPLES = 1000  # moments at which the field of a motion is looked at


def pushed(scene: Scene) -> bool:
    """True if a catheter is pushed out of a guide."""
    return scene.effects.feed is not None and scene.effects.feed.speed > 0.0


def time_of(scene: Scene, inserted: float) -> float:
    """The time (s) at which a length (m) of a fed catheter is out of its guide."""
    feed = scene.effects.feed
    assert feed is not None  # Measure.moments
    return (inserted - (scene.length - feed.exit)) / feed.speed


@dataclass(frozen=True)
class Answer:
    """A scene, its result, and the frames of what ran along time. Of a motion that still runs, result is None; of a scene that has not run,
    both are."""

    scene: Scene
    result: Result | None
    motion: Motion | None = None

    @cached_property
    def model(self) -> Model:
        """The undeformed body."""
        return build(self.scene, time=0.0 if self.scene.static else None)

    @cached_property
    def times(self) -> Array:
        """Moments (k,) s: of an equilibrium 0 for the undeformed body, then 1."""
        return np.array([0.0, 1.0]) if self.motion is None else self.motion.times

    def particles(self, k: int | None) -> Array:
        """Positions (n, 3) m of the particles at moment number k; None: of the undeformed body."""
        if k is None and not self._path:  # which may be bent as it begins
            k = 0
        if k is None:
            return self.model.particles.position
        if self.motion is not None:
            return np.asarray(self.motion.position(k), dtype=float)
        assert self.result is not None
        moved = k % len(self.times) > 0
        return self.result.particle_position if moved else self.model.particles.position

    def region(self, name: str, at: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Select the particles (n,) of the body, or of a part or segment by its name. Raises InputError."""
        if name == "body":
            return np.ones(len(self.model.density), bool)
        names = [region.name for region in self.scene.regions()]
        if name not in names:
            raise InputError(
                f"{at}.of",
                received=repr(name),
                rule=f"must be tip, body, or one of {', '.join(names)}",
                remedy="correct the name",
            )
        return np.asarray(self.model.particles.segment == names.index(name))

    @property
    def _path(self) -> bool:
        """True for equilibria along time."""
        return self.scene.solver.quasi_static is not None

    def place(self, of: str, k: int | None, at: str) -> Array:
        """The mean place (3,) m of the tip, the body, a part or a segment at moment k, None: undeformed. Raises InputError."""
        if of == "tip" and k is not None and self._path and self.result is not None:
            known = self.result.steps[k].get("tip")
            if known is not None:  # all digits, which frames have not
                return np.array(known)
        x = self.particles(k)
        if of != "tip":
            on = self.region(of, at)
            volume = self.model.particles.volume[on]
            return np.asarray(volume @ x[on] / volume.sum())
        if self.motion is None and self.result is not None and x is self.result.particle_position:
            tip = self.result.tip
        else:
            tip = of_particles(self.model, x)[1]
        if tip is None:
            raise InputError(
                f"{at}.of",
                received="'tip'",
                rule="this body of parts names no tip",
                remedy="name a part, or give the scene `body.parts.tip`",
            )
        return np.asarray(tip)

    def moment(self, time: float | None, otherwise: int, inserted: float | None = None) -> int:
        """Number of the moment nearest to a time (s), or to when a length (m) is out of the guide; `otherwise` where neither is given."""
        if inserted is not None:
            time = time_of(self.scene, inserted)
        if time is None or self.motion is None:
            return range(len(self.times))[otherwise]
        return int(np.argmin(np.abs(self.times - time)))

    @cached_property
    def field(self) -> tuple[Array, Array]:
        """Times (k,) s, and the strength (k,) T of the strongest field at the centers of the body's regions then."""
        field = self.scene.external_field()
        if not field.source.varies:  # the same everywhere
            end = self.scene.duration if self.scene.in_time else 0.0
            times = np.linspace(0.0, end, SAMPLES if end > 0.0 else 1)
            at = [None] if end == 0.0 else times.tolist()
            strengths = [float(np.linalg.norm(field.at(np.zeros(3), t)[0])) for t in at]
            return times, np.array(strengths)
        if self.motion is None:
            assert self.result is not None
            strength = np.linalg.norm(field.at(self.result.segment_center), axis=1).max()
            return np.zeros(1), np.array([strength])
        times = np.linspace(float(self.times[0]), float(self.times[-1]), SAMPLES)
        segment = self.model.particles.segment
        volume = self.model.particles.volume
        whole = np.bincount(segment, volume)
        near = [self.moment(float(t), -1) for t in times]
        centers = {}
        for k in set(near):
            x = self.particles(k)
            sums = [np.bincount(segment, volume * x[:, i]) / whole for i in range(3)]
            centers[k] = np.column_stack(sums)
        strengths = [
            float(np.linalg.norm(field.at(centers[k], float(t)), axis=1).max())
            for t, k in zip(times, near, strict=True)
        ]
        return times, np.array(strengths)

    def pushes(self, of: str) -> Array:
        """Force (k, 3) N of an obstacle at each moment of what runs along time, or (1, 3) at rest."""
        if self.motion is not None:
            found = self.motion.contacts.get(of)
            if found is None:
                return np.zeros((len(self.times), 3))  # nothing has touched it
            return np.column_stack([found[f"F{axis}"] for axis in "xyz"])
        assert self.result is not None
        return np.array([self.result.contacts[of]["force"]])

    @property
    def contacts(self) -> Mapping[str, Array]:
        """Size (k,) N of the force of each obstacle and pair over time."""
        if self.motion is not None:
            return {
                name: np.linalg.norm(np.column_stack([of[f"F{axis}"] for axis in "xyz"]), axis=1)
                for name, of in self.motion.contacts.items()
            }
        assert self.result is not None
        return {
            name: np.array([float(np.linalg.norm(of["force"]))])
            for name, of in self.result.contacts.items()
        }
