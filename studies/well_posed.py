"""Whether a search can have an answer: what moves the shape at all, and how many variables the target can tell apart.

Judged before the first trial, by the rod at a few random designs: a millisecond each. The derivatives are differences in steps along the
embedded coordinates, in which each block's step of 1 is a whole one: a radian, the greatest field, a range from bound to bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError, report
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from studies.blocks import Block, Choice, Direction, FieldVector
from studies.search_space import SearchSpace
from studies.study import Study

DESIGNS, SEED, ELEMENTS = 3, 20_24, 20
STEP = 1e-6  # of a whole step: forward differences, whose singular values agree with those of other steps to 1e-6 mm
NOTHING = 1e-5  # of the length: a whole step of a variable that moves the shape less than this moves nothing
SEEN = 1e-5  # of the length: what a whole step must move the shape by (rms), to be seen in the target: 0.4 um of 40 mm


@dataclass(frozen=True)
class Judgement:
    """What the rod says of a study.

    moves (n,) m: by how much (rms over the target's points) a whole step of each of the n variables moves the shape, at the design where
    it moves it most; freedom: how many numbers vary; seen: how many of their combinations move the shape, at the design where most do.
    """

    moves: Array
    freedom: int
    seen: int


def check_search(study: Study, space: SearchSpace) -> list[str]:
    """What a search should know before its first trial, one sentence each. Raises InputError where no variable moves the shape.

    Insertions and schedules are not judged: their fields move one shape each, and their magnetization all of them.
    """
    if study.depths or study.keyframes:
        return []
    found = judge(study, space)
    if found is None:
        return []
    length, points = space.scene.length, int(np.sum(study.target[:, 0] > 0))
    if found.moves.max() < NOTHING * length:
        most, least = 1e3 * found.moves.max(), 1e3 * NOTHING * length
        count = f"{len(found.moves)} variable{'s that move' if len(found.moves) > 1 else ' that moves'}"
        received = f"{count} the shape by at most {most:.2g} mm at the target's points"
        rule = f"something must move the shape, by {least:.2g} mm in a whole step (a radian, the greatest field, a range)"
        remedy = "vary the magnetization or the field, give the target points toward the tip, or the scene a stronger field"
        raise InputError(report(f"{study.path}: vary", received=received, rule=rule, remedy=remedy))
    if found.seen < found.freedom:
        return [
            f"vary: {found.freedom} numbers vary, and the target's {points} points beyond the base tell {found.seen} combinations of them "
            f"apart (by the rod: the others move the shape by less than {1e6 * SEEN * length:.2g} um). So many designs fit alike, and "
            "which one is found is left to chance; give the target more points, or vary less"
        ]
    return []


def judge(study: Study, space: SearchSpace) -> Judgement | None:
    """By the rod at random designs; None where it finds no equilibrium, or there are only choices."""
    rng, space = np.random.default_rng(SEED), replace(space, limits=None)  # directions of a set have no derivatives
    moves, seen = [], []
    stations = study.target[:, 0]
    for _ in range(4 * DESIGNS):
        try:
            J = _jacobian(space, space.nearest(space.drawn(rng)), stations)
        except (SolveError, InputError):
            continue
        if J.shape[1] == 0:
            return None
        moves.append(np.sqrt(np.sum(J**2, axis=0) / len(stations)))
        seen.append(int(np.sum(np.linalg.svd(J, compute_uv=False) / np.sqrt(len(stations)) > SEEN * space.scene.length)))
        if len(seen) == DESIGNS or seen[-1] == space.freedom:
            break
    return Judgement(np.max(moves, axis=0), space.freedom, max(seen)) if seen else None


def _jacobian(space: SearchSpace, x: Array, stations: Array) -> Array:
    """Derivatives (3 m, n) m of the rod's points at the stations (m,) m, by whole steps."""

    def shape(scene: Scene) -> Array:
        return solve_rod(scene, ELEMENTS).at(np.minimum(stations, scene.length)).reshape(-1)

    columns, here = [], shape(space.scene_at(x))
    if all(isinstance(block, Choice) for block in space.blocks):
        return np.empty((len(here), 0))
    for block, at in zip(space.blocks, space.slices, strict=True):
        for step in _steps(block, x[at]):
            moved = np.zeros(space.size)
            moved[at] = STEP * step
            columns.append((shape(space.scene_at(x + moved)) - here) / STEP)
    return np.array(columns).reshape(len(columns), -1).T


def _steps(block: Block, x: Array) -> list[Array]:
    """The whole steps of a block at its embedded coordinates."""
    if isinstance(block, Choice):
        return []
    if isinstance(block, Direction):
        first = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
        first /= np.linalg.norm(first)
        return [first, np.cross(x, first)]
    size = block.max if isinstance(block, FieldVector) else 1.0
    return list(size * np.eye(block.size))
