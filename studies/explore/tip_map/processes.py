"""Equilibria of one scene over many fields, in processes of their own: each follows paths of fields, every solve beginning at the last.

The equilibria are those that `magmpm run` finds: the rod follows the branch that grows from no load. What the solves of a path have added
to their rods tells what the next one will add (studies.neighbors). Paths know nothing of each other: it does not matter who takes one.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.compiled.process import DIED, RAISED, TOLD, answers, started, with_threads
from magmpm.effects import acting
from magmpm.errors import MagmpmError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.axis import tip
from magmpm.statics.equilibrium import Following, solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.studies.explore.neighbors import Neighbors

Path_ = Sequence[tuple[int, Sequence[float]]]  # indices and fields, T


@dataclass(frozen=True)
class Tip:
    """Tip in one field: its index; tip (3,) m, stability and Newton steps; or why there is none."""

    index: int
    tip: tuple[float, float, float] | None
    stability: float
    steps: int
    failure: str = ""


def solved(scene: Scene, paths: Sequence[Path_], processes: int) -> Iterator[Tip]:
    """The tips of all fields of all paths, in the order in which they are found. Of a process that ends, the field that it was at has no
    answer, and another one takes up the rest of its path."""
    left = deque(list(path) for path in paths)
    env = with_threads(max((os.cpu_count() or 1) // processes, 1))
    with started(min(processes, len(paths)), _begin, scene, env=env) as pool:
        for path, kind, found in answers(left, pool):
            if kind == RAISED:
                raise found
            if kind == TOLD:
                yield found
                path.pop(0)
            elif kind == DIED and path:
                index, _ = path.pop(0)
                yield Tip(index, None, np.nan, 0, f"the process that solved it {found}")
                if path:
                    left.append(path)


def _begin(pipe: Any, scene: Scene) -> Callable[[Path_], None]:
    """Begin a process: it follows a path, and sends each tip."""
    model = static_model(build(scene))

    def follow(path: Path_) -> None:
        for found in _along(scene, model, path):
            pipe.send((TOLD, found))

    return follow


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
