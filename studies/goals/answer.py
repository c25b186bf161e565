"""Answer of a scene's run, for measures: places over time, contacts, and the field."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.fields import schedule
from magmpm.model import Model, build
from magmpm.results.measures import of_particles
from magmpm.results.result import Result
from magmpm.results.trajectory import Frame, Motion
from magmpm.scene import Scene


def pushed(scene: Scene) -> bool:
    """True if a catheter is pushed out of a guide."""
    return scene.effects.feed is not None and scene.effects.feed.speed > 0.0


def time_of(scene: Scene, inserted: float) -> float:
    """The time (s) at which a length (m) of a fed catheter is out of its guide."""
    feed = scene.effects.feed
    assert feed is not None  # Measure.moments
    return (inserted - (scene.length - feed.exit)) / feed.speed


def inserted_at(scene: Scene, time: float) -> float:
    """The length (m) of a fed catheter that is out of its guide at a time (s)."""
    feed = scene.effects.feed
    assert feed is not None  # as of time_of
    return scene.length - feed.exit + feed.speed * time


def check_region(scene: Scene, name: str, at: str) -> None:
    """Raises InputError for a name that is not body, tip where there is one, or one of a scene's parts or segments."""
    parts = scene.body.parts
    _known(name, [] if parts is not None and parts.tip is None else ["tip"], scene, at)


def _known(name: str, more: list[str], scene: Scene, at: str) -> None:
    """Raises InputError for a name that is neither body, nor of a region, nor one of these."""
    names = ["body", *more, *(region.name for region in scene.regions())]
    if name not in names:
        raise InputError(
            f"{at}.of",
            received=repr(name),
            rule=f"must be one of {', '.join(names)}",
            remedy="correct the name; parts have a tip where `body.parts.tip` says so, which"
            " has a place alone",
        )


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

    def particles(self, k: float | None) -> Array:
        """Positions (n, 3) m of the particles at moment number k; None: of the undeformed body.

        Between two frames of a motion they are the cubic through places and velocities of both.
        """
        if k is None and not self._path:  # which may be bent as it begins
            k = 0
        if k is None:
            return self.model.particles.position
        if self.motion is None:
            assert self.result is not None
            moved = k % len(self.times) > 0
            return self.result.particle_position if moved else self.model.particles.position
        share = k % 1.0
        if share == 0.0:
            return np.asarray(self.motion.position(int(k)), dtype=float)
        before = self._frame(int(k))
        after = self._frame(int(k) + 1)
        begin = np.asarray(before.position, dtype=float)
        way = after.position - begin
        time = after.time - before.time
        first = time * before.quantities["velocity"] - way
        last = time * after.quantities["velocity"] - way
        bent = (1.0 - share) * first - share * last
        return np.asarray(begin + share * (way + (1.0 - share) * bent))

    @cached_property
    def _frame(self) -> Callable[[int], Frame]:
        """A frame of the motion by its number; the last two are remembered."""
        assert self.motion is not None
        return lru_cache(maxsize=2)(self.motion.__getitem__)

    def region(self, name: str, at: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Select the particles (n,) of the body, of the last cells at its tip, or of a part or segment by its name. Raises InputError."""
        if name == "body":
            return np.ones(len(self.model.density), bool)
        if name == "tip" and self.model.line is not None:
            along = self.model.particles.cell[:, 0]
            return np.asarray(along == along.max())
        _known(name, [], self.scene, at)
        names = [region.name for region in self.scene.regions()]
        return np.asarray(self.model.particles.segment == names.index(name))

    @property
    def given(self) -> Any:
        """Argument of a user's function: the motion, or else the result."""
        return self.result if self.motion is None else self.motion

    @property
    def _path(self) -> bool:
        """True for equilibria along time."""
        return self.scene.solver.quasi_static is not None

    def place(self, of: str, k: float | None, at: str) -> Array:
        """The mean place (3,) m of the tip, the body, a part or a segment at moment k, None: undeformed. Raises InputError."""
        if of == "tip" and k is not None and self._path and self.result is not None:
            known = self.result.steps[int(k)].get("tip")
            if known is not None:  # all digits, which frames have not
                return np.array(known)
        if of != "tip":
            on = self.region(of, at)
            volume = self.model.particles.volume[on]
            return np.asarray(volume @ self.particles(k)[on] / volume.sum())
        check_region(self.scene, of, at)
        return np.asarray(self.axis_and_tip(k)[1])

    def axis_and_tip(self, k: float | None) -> tuple[Array, Array | None]:
        """Rows [s, x, y, z] (m, 4) m of a straight body's axis, and the tip (3,) m if there is one, at moment k, None: undeformed."""
        x = self.particles(k)
        if self.motion is None and self.result is not None and x is self.result.particle_position:
            return self.result.centreline, self.result.tip
        return of_particles(self.model, x)[:2]

    def moment(self, time: float | None, otherwise: int, inserted: float | None = None) -> float:
        """Number of the moment at a time (s), or when a length (m) is out of the guide; `otherwise` where neither is given.

        Along a path it is that of an equilibrium; in a motion a fraction counts from frame to frame.
        """
        if inserted is not None:
            time = time_of(self.scene, inserted)
        if time is None or self.motion is None:
            return range(len(self.times))[otherwise]
        nearest = int(np.argmin(np.abs(self.times - time)))
        if self._path or math.isclose(self.times[nearest], time, rel_tol=1e-9):
            return nearest
        return float(np.interp(time, self.times, np.arange(len(self.times))))

    @cached_property
    def field(self) -> tuple[Array, Array]:
        """Times (k,) s, and the strength (k,) T of the strongest field at any particle then."""
        field = self.scene.external_field()
        end = self.scene.duration if self.motion is None else float(self.times[-1])
        times = schedule.moments(field.source, end)
        if not field.source.varies:  # the same everywhere
            known = schedule.places(field.source, times if self.scene.in_time else None)["uniform"]
            return times, np.broadcast_to(np.linalg.norm(known, axis=1), len(times))
        if self.motion is None:
            assert self.result is not None
            strength = np.linalg.norm(field.at(self.result.particle_position), axis=1).max()
            return np.zeros(1), np.array([strength])
        times = np.union1d(times, self.times)
        number = np.interp(times, self.times, np.arange(len(self.times)))
        if self._path:  # between two equilibria there is no answer
            number = np.rint(number)
        strength = [
            np.linalg.norm(field.at(self.particles(k), float(time)), axis=1).max()
            for k, time in zip(number, times, strict=True)
        ]
        return times, np.array(strength)

    def pushes(self, of: str) -> Array:
        """Force (k, 3) N of a contact, named as in contacts.csv, at each moment of what runs along time, or (1, 3) at rest."""
        if self.motion is None:
            assert self.result is not None
            return np.array([self.result.contacts.get(of, {}).get("force", np.zeros(3))])
        out = np.zeros((len(self.times), 3))
        rows = self.motion.contacts.get(of)  # of parts while they touch, of what is fed once it can
        if rows is not None:
            on = rows["t"] <= self.times[-1]
            force = np.column_stack([rows[f"F{axis}"] for axis in "xyz"])
            out[np.searchsorted(self.times, rows["t"][on])] = force[on]
        return out
