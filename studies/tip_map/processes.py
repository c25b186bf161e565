"""Equilibria of one scene over many fields, in processes of their own: each follows paths of fields, every solve beginning at the last.

The equilibria are those that `magmpm run` finds: the rod follows the branch that grows from no load. What the solves of a path have added
to their rods tells what the next one will add (studies.neighbors). Paths know nothing of each other: it does not matter who takes one.
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

import magmpm
from magmpm.effects import acting
from magmpm.errors import MagmpmError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.axis import tip
from magmpm.statics.equilibrium import Following, solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.studies.neighbors import Neighbors

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
    """One process and its pipe; left: the fields of its path that it has not told of."""

    def __init__(self, scene: Scene, threads: int) -> None:
        self._scene, self._threads, self.left = scene, threads, list[tuple[int, Sequence[float]]]()
        self._start()

    def _start(self) -> None:
        self.pipe, theirs = Pipe()
        root = str(Path(magmpm.__file__).resolve().parents[1])
        code = f"import sys; sys.path.insert(0, {root!r}); from magmpm.studies.tip_map.processes import serve; serve({theirs.fileno()})"
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
        self.left = list(path)
        self.pipe.send(path)
        return True

    def received(self) -> list[Tip]:
        """What it has told; of a process that ended: that the field it was at has no answer. Another one takes up the rest of its path."""
        try:
            found: Tip = self.pipe.recv()
        except (EOFError, OSError):
            status = self.process.wait()
            (index, _), rest = self.left[0], self.left[1:]
            self.end()
            self._start()
            self.left = []
            self.begin(rest or None)
            return [Tip(index, None, np.nan, 0, f"the process that solved it ended with status {status}")]
        self.left = [one for one in self.left if one[0] != found.index]
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
    neighbors = Neighbors()
    following = Following(neighbors.expected)
    for index, field in path:
        here = scene.with_field(field)
        loaded = replace(model, scene=here, effects=acting.collect(here))
        try:
            found = solve_static(loaded, following=following)
        except (MagmpmError, ArithmeticError) as error:
            yield Tip(index, None, np.nan, 0, getattr(error, "reason", str(error)))
            continue
        neighbors.learn(found.correction)
        at = tip(loaded, found.point.grid)
        yield Tip(index, tuple(at.tolist()), float(found.stability if found.stability is not None else np.nan), found.steps)
