"""Solves scenes in a process of its own, the newest first: what has been overtaken is not begun, or is given up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.compiled.process import DONE, RAISED, Died, Process
from magmpm.errors import InputError, MagmpmError, SolveError
from magmpm.results.measures import region_means
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import simulated
from magmpm.solving.solve import RunOptions
from magmpm.statics.axis import centreline
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Following
from magmpm.statics.layout import model_at_rest
from magmpm.statics.neighbors import Neighbors
from magmpm.statics.rod_start import from_rod, with_correction
from magmpm.studies.problem.shape_distance import gaps, root_mean_square


@dataclass(frozen=True)
class DeformedShape:
    """A deformed body. SI units.

    reference, position (n, 3) m, volume (n,) m^3, part (n,): its particles; axis (m, 3) m, deformed, or none; center (k, 3) m and
    remanence (k, 3) T: of its regions, deformed; field (3,) T at its center.
    """

    reference: Array
    position: Array
    volume: Array
    part: NDArray[np.int32]
    axis: Array
    center: Array
    remanence: Array
    field: Array

    @classmethod
    def of(cls, result: Result) -> DeformedShape:
        """Shape of a result."""
        return cls(
            result.particle_reference,
            result.particle_position,
            result.particle_volume,
            result.particle_segment,
            result.centreline[:, 1:4],
            result.segment_center,
            result.segment_remanence,
            np.asarray(result.field),
        )


class Preview:
    """The shape at once, of one scene's variants: the rod's, dressed with what the last solve added to its rod.

    The rod takes milliseconds. Seen from the rod's frames, what the 3D solve adds to it is nearly the same for a neighboring scene, so that
    a preview is close to the solution where a slider has moved a little. It is a preview all the same, and the page says so.
    """

    def __init__(self) -> None:
        self._correction = np.zeros((0, 0))

    def learn(self, result: Result) -> None:
        """Take from a solve what it added to its rod."""
        self._correction = result.grid_correction

    def shape(self, scene: Scene) -> DeformedShape | None:
        """The shape of a scene's rod; None where there is none: the body is no rod, or its rod finds no equilibrium.

        Raises InputError for a scene whose body and field do not go together.
        """
        body = scene.body.shape
        if not isinstance(body, StraightBody) or body.clamp != "base":
            return None
        try:
            rod = solve_rod(scene)
            model = model_at_rest(scene)
        except InputError:
            raise
        except SolveError:
            return None
        known = self._correction.shape == (model.layout.planes, model.layout.m)
        grid = with_correction(model, rod, self._correction) if known else from_rod(model, rod)
        point = Energy(model).at(grid)
        position = point.position
        particles = model.particles
        return DeformedShape(
            particles.position,
            position,
            particles.volume,
            particles.segment,
            centreline(model, grid)[:, 1:4],
            region_means(model, position),
            region_means(model, np.einsum("nij,nj->ni", point.F, model.remanence[:, :3])),
            np.asarray(rod.field[len(rod.s) // 2]),
        )


class Overtaken(Exception):
    """A newer scene is to be solved in place of this one."""


@dataclass(frozen=True)
class SolverAnswer:
    """Outcome of a scene: its result and rms (m) from the target, or `failure`, as text; seconds it took."""

    result: Result | None
    rms: float | None
    failure: str
    seconds: float


class SolverProcess:
    """One process that solves; requests come from several threads, and the newest counts."""

    def __init__(self, target: Array | None = None) -> None:
        """target (m, 4) m: rows [s, x, y, z] that shapes are compared with, or None."""
        self._newest = 0
        self._counting = threading.Lock()
        self._working = threading.Lock()
        self.process = Process(_begin, target, quiet=False)

    def solved(self, scene: Scene) -> SolverAnswer:
        """Solve a scene. Raises Overtaken when a newer one was requested meanwhile."""
        with self._counting:
            self._newest += 1
            ticket = self._newest
        with self._working:
            if ticket != self._newest:
                raise Overtaken
            begun = time.perf_counter()
            self.process.give(scene)
            try:
                kind, answer, rms = self._answer(ticket)
            except Died as death:
                self.process.start()
                kind = "failure"
                answer = (
                    f"the process that solves {death} and was restarted; move a slider to go on"
                )
                rms = None
            seconds = time.perf_counter() - begun
            return (
                SolverAnswer(answer, rms, "", seconds)
                if kind == "result"
                else SolverAnswer(None, None, answer, seconds)
            )

    def _answer(self, ticket: int) -> tuple[str, Any, float | None]:
        """Answer of the process to the scene that it was given. Raises Overtaken, Died."""
        # s: a solve that has taken longer is given up when a newer one waits; a shorter one is finished, so
        # that shapes keep coming
        longest_live_solve = 0.4
        begun = time.perf_counter()
        while True:
            if self.process.pipe.poll(0.02):
                kind, found = self.process.receive()
                if kind == RAISED:
                    raise found
                if kind == DONE:
                    return found  # type: ignore[no-any-return]
            elif ticket != self._newest and time.perf_counter() - begun > longest_live_solve:
                self.process.give(None)  # give up; both are answered
                answered = 0
                while answered < 2:
                    answered += self.process.receive()[0] == DONE
                raise Overtaken

    def close(self) -> None:
        """End the process."""
        self.process.end()


def _begin(pipe: Any, target: Array | None) -> Callable[[Scene | None], Any]:
    """Begin the process: it solves the scenes that come; None only ends the solve before it."""
    neighbors = Neighbors(400)  # the last solves
    following = Following(neighbors.expected)

    def answer(scene: Scene | None) -> Any:
        found: Any = (
            ("overtaken", "", None) if scene is None else _answer(scene, following, target, pipe)
        )
        if found[0] == "result":
            neighbors.learn(found[1].grid_correction)
        return found

    return answer


def _answer(
    scene: Scene, following: Following, target: Array | None, pipe: Any
) -> tuple[str, Any, float | None]:
    """("result", Result, rms) or ("failure" or "overtaken", words, None)."""

    def look(step: int, decrement: float) -> None:
        if pipe.poll():
            raise Overtaken

    try:
        result = simulated(scene, RunOptions(start=following, on_progress=look))
        rms = None if target is None else root_mean_square(gaps(result.centreline, target))
        return "result", result, rms
    except Overtaken:
        return "overtaken", "", None
    except SolveError as error:
        return "failure", error.reason, None
    except MagmpmError as error:
        return "failure", str(error), None
    except (ArithmeticError, ValueError) as error:
        return "failure", f"the solve failed: {error}", None
