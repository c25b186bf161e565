"""Solves scenes in a process of its own, the newest first: what has been overtaken is not begun, or is given up."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import magmpm
from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError, SolveError
from magmpm.results.result import Result
from magmpm.scene import Scene
from magmpm.simulate import simulated
from magmpm.statics.equilibrium import Following
from magmpm.studies.neighbors import Neighbors
from magmpm.studies.shape_distance import gaps, root_mean_square

MOST = 400  # solves that are remembered, the last ones
PATIENCE = 0.4  # s: a solve that has taken longer is given up when a newer one waits; a shorter one is finished, so that shapes keep coming


class Overtaken(Exception):
    """A newer scene is to be solved in place of this one."""


@dataclass(frozen=True)
class Solved:
    """What came of a scene: its result and rms (m) from the target, or `failure`, in words; seconds it took."""

    result: Result | None
    rms: float | None
    failure: str
    seconds: float


class Solver:
    """One process that solves; requests come from several threads, and the newest counts."""

    def __init__(self, target: Array | None = None) -> None:
        """target (m, 4) m: rows [s, x, y, z] that shapes are compared with, or None."""
        self._target, self._newest = target, 0
        self._counting, self._working = threading.Lock(), threading.Lock()
        self._start()

    def _start(self) -> None:
        self._pipe, theirs = Pipe()
        root = str(Path(magmpm.__file__).resolve().parents[1])
        code = f"import sys; sys.path.insert(0, {root!r}); from magmpm.studies.live.solver import serve; serve({theirs.fileno()})"
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()], env=os.environ, start_new_session=True,
            )  # fmt: skip
        self._pipe.send(self._target)

    def solved(self, scene: Scene) -> Solved:
        """Solve a scene. Raises Overtaken when a newer one was asked for meanwhile."""
        with self._counting:
            self._newest += 1
            ticket = self._newest
        with self._working:
            self._unless_newer(ticket)
            begun = time.perf_counter()
            try:
                self._pipe.send(scene)
                while not self._pipe.poll(0.02):
                    if ticket != self._newest and time.perf_counter() - begun > PATIENCE:
                        self._pipe.send(None)  # give up
                        self._pipe.recv()
                        raise Overtaken
                kind, answer, rms = self._pipe.recv()
            except (EOFError, OSError):
                return Solved(None, None, self._revived(), time.perf_counter() - begun)
            seconds = time.perf_counter() - begun
            return Solved(answer, rms, "", seconds) if kind == "result" else Solved(None, None, answer, seconds)

    def _unless_newer(self, ticket: int) -> None:
        if ticket != self._newest:
            raise Overtaken

    def _revived(self) -> str:
        status = self.process.wait()
        self._pipe.close()
        self._start()
        return f"the process that solves ended (status {status}) and was started anew; move a slider to go on"

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self.process.kill()
        self.process.wait()


def serve(descriptor: int) -> None:
    """The process: solves what comes through the pipe until it closes."""
    pipe: Any = Connection(descriptor)
    neighbors = Neighbors(MOST)
    following = Following(neighbors.expected)
    try:
        target = pipe.recv()
        while True:
            scene = pipe.recv()
            if scene is None:  # what was to be given up had ended by then
                continue
            answer = _answer(scene, following, target, pipe)
            pipe.send(answer)
            if answer[0] == "result":
                neighbors.learn(answer[1].grid_correction)
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _answer(scene: Scene, following: Following, target: Array | None, pipe: Any) -> tuple[str, Any, float | None]:
    """("result", Result, rms) or ("failure" or "overtaken", words, None)."""

    def look(step: int, decrement: float) -> None:
        if pipe.poll():
            raise Overtaken

    try:
        result = simulated(scene, start=following, on_progress=look)
        rms = None if target is None else root_mean_square(gaps(result, target))
        return "result", result, rms
    except Overtaken:
        return "overtaken", "", None
    except SolveError as error:
        return "failure", error.reason, None
    except MagmpmError as error:
        return "failure", str(error), None
    except (ArithmeticError, ValueError) as error:
        return "failure", f"the solve failed: {error}", None
