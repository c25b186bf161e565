"""Equilibria of one scene over many fields, in processes of their own: each follows paths of fields, every solve beginning at the last.

The equilibria are those that `magmpm run` finds: the rod follows the branch that grows from no load. What the solves add to their rods
changes smoothly along a path, so it is extrapolated from the last fields to the next.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.errors import MagmpmError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.axis import tip
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import StaticModel, static_model

Path_ = Sequence[tuple[int, Sequence[float]]]  # indices and fields, T


@dataclass(frozen=True)
class Tip:
    """Of a field: its index; tip (3,) m, stability and Newton steps; or why there is none."""

    index: int
    tip: tuple[float, float, float] | None
    stability: float
    steps: int
    failure: str = ""


def solved(scene: Scene, paths: Sequence[Path_], processes: int) -> Iterator[Tip]:
    """The tips of all fields of all paths, in the order in which they are found."""
    waiting = iter(paths)
    pool = [_Process(scene, max((os.cpu_count() or 1) // processes, 1)) for _ in range(min(processes, len(paths)))]
    try:
        busy = {one for one in pool if one.begin(next(waiting, None))}
        while busy:
            ready = set(wait([one.pipe for one in busy]))
            for one in [one for one in busy if one.pipe in ready]:
                yield from one.received()
                if not one.left and not one.begin(next(waiting, None)):
                    busy.discard(one)
    finally:
        for one in pool:
            one.end()


class _Process:
    """One process and its pipe; left: indices of its path that it has not told of."""

    def __init__(self, scene: Scene, threads: int) -> None:
        self._scene, self._threads, self.left = scene, threads, list[int]()
        self._start()

    def _start(self) -> None:
        self.pipe, theirs = Pipe()
        root = str(Path(__file__).resolve().parents[2])
        code = f"import sys; sys.path.insert(0, {root!r}); from studies.tip_map.processes import serve; serve({theirs.fileno()})"
        env = {**os.environ, "OMP_NUM_THREADS": str(self._threads), "NUMBA_NUM_THREADS": str(self._threads)}
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()], env=env,
            )  # fmt: skip
        self.pipe.send(self._scene)

    def begin(self, path: Path_ | None) -> bool:
        """Begin a path. Returns whether there was one."""
        if path is None:
            return False
        self.left = [index for index, _ in path]
        self.pipe.send(path)
        return True

    def received(self) -> list[Tip]:
        """What it has told; of a process that ended: that the rest of its path has no answer. It is then replaced."""
        try:
            found: Tip = self.pipe.recv()
        except (EOFError, OSError):
            status = self.process.wait()
            lost = [Tip(index, None, np.nan, 0, f"the process that solved it ended with status {status}") for index in self.left]
            self.left = []
            self.end()
            self._start()
            return lost
        self.left.remove(found.index)
        return [found]

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        self.pipe.close()


def serve(descriptor: int) -> None:
    """A process: follows the paths that come through the pipe until it closes."""
    pipe: Any = Connection(descriptor)
    try:
        scene: Scene = pipe.recv()
        model = static_model(build(scene))
        while True:
            path: Path_ = pipe.recv()
            for found in _along(scene, model, path):
                pipe.send(found)
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _along(scene: Scene, model: StaticModel, path: Path_) -> Iterator[Tip]:
    """The tips along a path, each found from the ones before."""
    known: list[Array] = []  # what the last solves added to their rods
    for index, field in path:
        here = scene.with_field(field)
        loaded = replace(model, scene=here, effects=acting.collect(here))
        try:
            found = solve_static(loaded, correction=_extrapolated(known))
        except (MagmpmError, ArithmeticError) as error:
            known = []
            yield Tip(index, None, np.nan, 0, getattr(error, "reason", str(error)))
            continue
        known = [*known[-2:], found.correction] if found.correction.any() else []
        at = tip(loaded, found.point.grid)
        yield Tip(index, tuple(at.tolist()), float(found.stability if found.stability is not None else np.nan), found.steps)


def _extrapolated(known: Sequence[Array]) -> Array | None:
    """What the next solve will add to its rod, by a polynomial through the last three at equal steps."""
    if not known:
        return None
    if len(known) == 1:
        return known[0]
    return 2.0 * known[1] - known[0] if len(known) == 2 else 3.0 * known[2] - 3.0 * known[1] + known[0]
