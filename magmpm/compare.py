"""Compare runs: how far apart two are (`distance`), and how wrong a scene's grid is (`error`).

Straight bodies are compared along their axes at equal arc length, parts at the centers of their regions, both in all frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magmpm.results import notices
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene, load_scene
from magmpm.solving.several_grids import Frames, choose_grid, error_of_grid, frames_of, grids_of


def distance(one: Result | Motion, other: Result | Motion, *, of: str = "centreline") -> float:
    """The largest distance (m) between two runs of the same body, over all frames of two Motions, or at the end where one is a Result.

    of: centreline, at equal shares of the arc length (parts: between their centers, and the tip if one is named); or tip. Raises ValueError
    if they share no time; InputError for the tip of parts that name none.
    """
    first = frames_of(one)
    second = frames_of(other)
    if isinstance(one, Result) or isinstance(other, Result):
        first, second = (
            Frames([0.0], frames.points[-1:], frames.tips[-1:]) for frames in (first, second)
        )
    distances = first.distances(second, of)
    if not distances:
        raise ValueError(
            "the two runs have no frame of the same time: give them the same duration and"
            " output_every, or steps"
        )
    return max(distances.values())


@dataclass(frozen=True)
class GridError:
    """error: bound (m) of the discretization error, anywhere on the axis (of parts: of their centers, and of the tip if one is named), in
    any frame; report: as `Result.resolution`, with grids.
    """

    error: float
    report: dict[str, Any]

    def __repr__(self) -> str:
        """The error, and from which grids it is known."""
        grids = (
            f"{self.report['cells_across']} cells across, known from"
            f" {self.report['finer']['cells_across']}"
        )
        return (
            f"GridError(at most {1e3 * self.error:.3g} mm,"
            f" {100 * self.report['error_of_length']:.2g} % of the length: {grids})"
        )


def error(scene: Scene | Path | str) -> GridError:
    """Bound the error that a scene's grid leaves in its answer: its equilibrium, its path or its motion, whatever acts on it.

    The scene is run on its grid and on a finer one, and bodies on 2 cells on one between (statics.error_estimate). Where it asks for an
    error or a time, this is the error of the grid that a run would choose. Raises InputError and SolveError as `run` does.
    """
    by_user = notices.called_by_user()
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    grids = grids_of(scene)
    choice = (
        choose_grid(grids)[0]
        if scene.resolution.requested
        else error_of_grid(grids, scene.resolution.cells_across)
    )
    if by_user:
        notices.warn(choice.report.get("warnings", []), scene.hash())
    return GridError(choice.error, choice.report)
