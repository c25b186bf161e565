"""Check that a search can have an answer: what moves the shape at all, and how many variables the target can distinguish.

Evaluated before the first trial, by the rod at a few random designs: a millisecond each. The derivatives are differences in steps along the
embedded coordinates, in which each block's step of 1 is a whole one: a radian, the greatest field, a range from bound to bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError
from magmpm.rod.cosserat import solve_rod
from magmpm.studies.problem.study import Study
from magmpm.studies.search.parameters import FieldVector
from magmpm.studies.search.samplers.blocks import Ball, Block, Direction, across
from magmpm.studies.search.search_space import SearchSpace

# of the length: what a whole step must move the shape by (rms), to be seen in the target: 0.4 um of
# 40 mm
LEAST_SEEN_IN_TARGET = 1e-5


@dataclass(frozen=True)
class Identifiability:
    """Result of the check of a study by the rod.

    Attributes
    ----------
    moves : array (n,), m
        By how much (rms over the target's points) a whole step of each variable moves the
        shape, at the design where it moves it most.
    freedom : int
        How many numbers vary.
    seen : int
        How many of their combinations move the shape, at the design where most do.
    """

    moves: Array
    freedom: int
    seen: int


def check_search(study: Study, space: SearchSpace) -> list[str]:
    """Find what a user should know of a search before its first trial.

    Parameters
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.

    Returns
    -------
    list of str
        One sentence each.

    Raises
    ------
    InputError
        Where no variable moves the shape.
    """
    # of the length: a whole step of a variable that moves the shape less than this moves nothing
    moves_nothing = 1e-5
    found = identifiability(study, space)
    if found is None:
        return []
    length = space.scene.length
    if found.moves.max() < moves_nothing * length:
        most = 1e3 * found.moves.max()
        least = 1e3 * moves_nothing * length
        count = (
            f"{len(found.moves)} variable{'s that move' if len(found.moves) > 1 else ' that moves'}"
        )
        remedy = (
            "vary the magnetization or the field, give the target points toward the tip, or the"
            " scene a stronger field"
        )
        raise InputError(
            f"{study.path}: vary",
            received=f"{count} the shape by at most {most:.2g} mm at the target's points",
            rule=f"something must move the shape, by {least:.2g} mm in a whole step (a radian, the"
            " greatest field, a range)",
            remedy=remedy,
        )
    if found.seen < found.freedom:
        return [
            f"vary: {found.freedom} numbers vary, but {_compared_with(study)} distinguish only "
            f"{found.seen} combinations of them (for the rod, the others move the shape by less "
            f"than {1e6 * LEAST_SEEN_IN_TARGET * length:.2g} um). Many designs then fit"
            " equally well, and which "
            "one is found is left to chance; give the target more points, or vary less"
        ]
    return []


def _compared_with(study: Study) -> str:
    """Describe what a study compares shapes with."""
    if study.depths:
        return f"the path at {len(study.depths)} depths"
    if study.keyframes:
        return f"the targets at {len(study.keyframes)} times"
    return f"the target's {int(np.sum(study.target[:, 0] > 0))} points beyond the base"


@dataclass(frozen=True)
class _Shape:
    """One of the equilibria that a design has: from its embedded coordinates to the rod's points (m, 3) at `stations` (m,) m.

    inserted: m outside of the guide; None: all. field: which of the design's fields it has; -1: the one that all have.
    """

    space: SearchSpace
    stations: Array
    inserted: float | None = None
    field: int = -1

    def at(self, x: Array) -> Array:
        scene = self.space.scene_at(x, field=self.field)
        scene = scene if self.inserted is None else scene.inserted(self.inserted)
        return solve_rod(scene, 20).at(np.minimum(self.stations, scene.length)).reshape(-1)


def _shapes(study: Study, space: SearchSpace) -> list[_Shape]:
    """The equilibria of a design: one, or one at each depth or time."""
    own = space.fields > 1
    if study.depths:
        places = [np.linspace(0.0, depth, 13) for depth in study.depths]
        return [_Shape(space, s, float(s[-1]), k if own else -1) for k, s in enumerate(places)]
    if study.keyframes:
        return [
            _Shape(space, frame.target[:, 0], None, k if own else -1)
            for k, frame in enumerate(study.keyframes)
        ]
    return [_Shape(space, study.target[:, 0])]


def identifiability(study: Study, space: SearchSpace) -> Identifiability | None:
    """Evaluate a study by the rod at random designs.

    Parameters
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.

    Returns
    -------
    Identifiability or None
        What moves the shape; None where the rod finds no equilibrium, or there are only
        choices.
    """
    designs_tried = 3
    # directions of a set have no derivatives
    rng = np.random.default_rng(2024)
    space = replace(space, limits=None)
    moves = []
    seen = []
    shapes = _shapes(study, space)
    for _ in range(4 * designs_tried):
        try:
            J = _jacobian(space, space.nearest(space.drawn(rng)), shapes)
        except (SolveError, InputError):
            continue
        if J.shape[1] == 0:
            return None
        points = len(J) / 3
        moves.append(np.sqrt(np.sum(J**2, axis=0) / points))
        seen.append(
            int(
                np.sum(
                    np.linalg.svd(J, compute_uv=False) / np.sqrt(points)
                    > LEAST_SEEN_IN_TARGET * space.scene.length
                )
            )
        )
        if len(seen) * len(shapes) >= designs_tried or seen[-1] == space.freedom:
            break
    return Identifiability(np.max(moves, axis=0), space.freedom, max(seen)) if seen else None


def _jacobian(space: SearchSpace, x: Array, shapes: list[_Shape]) -> Array:
    """Derivatives (3 m, n) m of the rods' points at all stations by whole steps. A field that one shape has moves no other."""
    # of a whole step: forward differences, whose singular values agree with those of other steps to
    # 1e-6 mm
    difference_step = 1e-6
    if not space.blocks:
        return np.empty((0, 0))
    here = [shape.at(x) for shape in shapes]
    columns = []
    field = -1
    for block, at in space.parts:
        field += isinstance(block, FieldVector)
        for step in _steps(block, x[at]):
            moved = x.copy()
            moved[at] += difference_step * step
            moves = [
                shape.field in (-1, field) or not isinstance(block, FieldVector) for shape in shapes
            ]
            changes = [
                shape.at(moved) - known if can else 0.0 * known
                for shape, known, can in zip(shapes, here, moves, strict=True)
            ]
            columns.append(np.concatenate(changes) / difference_step)
    return np.array(columns).reshape(len(columns), -1).T


def _steps(block: Block, x: Array) -> list[Array]:
    """The whole steps of a block at its embedded coordinates."""
    if isinstance(block, Direction):
        return list(across(x).T)
    return list((block.radius if isinstance(block, Ball) else 1.0) * np.eye(block.size))
