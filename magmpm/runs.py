"""Compare runs: how far apart two are (`distance`), two scenes' answers (`compare`), and how wrong a scene's grid is (`error`).

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
from magmpm.solving.effects_choice import choose_effects
from magmpm.solving.several_grids import (
    Frames,
    Pair,
    choose_grid,
    error_of_grid,
    frames_of,
    grids_of,
)


def distance(one: Result | Motion, other: Result | Motion, *, of: str = "centreline") -> float:
    """Measure how far apart two runs of the same body are: the largest distance over all frames that both have.

    Parameters
    ----------
    one : Result or Motion
        A run. Where one of the two is a Result, the ends of both are compared.
    other : Result or Motion
        The other run.
    of : str, default 'centreline'
        "centreline": at equal shares of the arc length; of parts between their centers, and at
        the tip if one is named. "tip": at the tip alone.

    Returns
    -------
    float, m
        The largest distance.

    Raises
    ------
    ValueError
        If the two share no time.
    InputError
        For the tip of parts that name none.

    Examples
    --------
    >>> import magmpm
    >>> from magmpm.runs import distance
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> one = magmpm.run(scene)
    >>> distance(one, one)
    0.0
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
    """The error that a grid leaves in an answer, and how it is known.

    Attributes
    ----------
    error : float, m
        Bound of the discretization error, in any frame: anywhere on the axis; of parts, of
        their centers, and of the tip if one is named.
    report : dict[str, Any]
        As `Result.resolution`, with the grids that were compared.
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

    The scene is run on its grid and on a finer one, and bodies on 2 cells on one between. Where the
    scene requests an error or a time, this is the error of the grid that a run would choose.

    Parameters
    ----------
    scene : Scene, Path or str
        A Scene, or the path of a scene file.

    Returns
    -------
    GridError
        The bound as `error`, m.

    Raises
    ------
    InputError
        As of `run`.
    SolveError
        As of `run`.

    References
    ----------
    docs/accuracy.md, magmpm/statics/error_estimate.py.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> found = magmpm.error(scene)
    >>> 0.0 < found.error < 0.01 * scene.length  # both in m
    True
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


@dataclass(frozen=True)
class Comparison:
    """Distance of two scenes' answers, and how well it is known.

    Attributes
    ----------
    distance : float, m
        The farthest that a point of the axis (of parts: a part's center, or the tip that they
        name) is from its place in the other answer, in any frame.
    uncertainty : float, m
        Bound of what the grid adds to it or takes from it.
    time : float, s, or None
        Of the frame in which they are farthest apart; None of single equilibria.
    length : float, m
        Of the longer body.
    cells : int
        Cells across of the grid of the answers.
    finer_cells : int
        Cells across of the grid that tells the uncertainty.
    results : tuple[Result, Result]
        Of the two scenes on `cells`; of what runs along time at its end.
    unknown : list of (float, float), s
        Spans of paths around jumps, which come sooner or later on other grids, and which are
        left out.
    """

    distance: float
    uncertainty: float
    time: float | None
    length: float
    cells: int
    finer_cells: int
    results: tuple[Result, Result]
    unknown: list[tuple[float, float]]

    @property
    def distinct(self) -> bool:
        """True if the answers are farther apart than the grid may have made them."""
        return self.distance > self.uncertainty

    def __repr__(self) -> str:
        """The distance, how well it is known, and from which grids."""
        when = "" if self.time is None else f", at t = {self.time:.3g} s"
        told = "" if self.distinct else "; no more than the grid may make it"
        return (
            f"Comparison({1e3 * self.distance:.3g} +- {1e3 * self.uncertainty:.2g} mm,"
            f" {100 * self.distance / self.length:.2g} % of the length{when}:"
            f" {self.cells} cells across, known from {self.finer_cells}{told})"
        )


def compare(
    scene_a: Scene | Path | str,
    scene_b: Scene | Path | str,
    *,
    cells: int | None = None,
    of: str = "centreline",
) -> Comparison:
    """Find the distance of two scenes' answers, and how well it is known: what another material, law, load, tolerance or magnet changes.

    Both are run on the same number of cells across, and on the finer grids that would tell the
    error of an answer. What the grid does to both alike cancels: the uncertainty is that of the way
    from one answer to the other, point by point, and mostly a small part of either answer's own
    error. Straight bodies are compared along their axes at equal shares of the arc length, parts at
    their centers, runs along time in all frames that both have.

    Parameters
    ----------
    scene_a : Scene, Path or str
        A scene, or the path of its file.
    scene_b : Scene, Path or str
        Another: two equilibria, or two of what runs along time (paths or motions, which end
        together).
    cells : int, optional
        Cells across of both scenes, 2 to 12. Unless given, those of the scenes, which must
        agree.
    of : {'centreline', 'tip'}, default 'centreline'
        Where distances are meant.

    Returns
    -------
    Comparison
        With distance and uncertainty (m), when they are farthest apart (s), and both results.

    Raises
    ------
    InputError
        If either scene can't be run, or the two can't be compared.
    SolveError
        If a run fails; it says which.

    References
    ----------
    Roache, J. Fluids Eng. 116 (1994) 405: the error of a quantity from two grids
    (statics.error_estimate), here of a difference.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml")
    >>> softer = scene.with_material(shear_modulus="110 kPa")
    >>> found = magmpm.compare(scene, softer, cells=2)
    >>> found.distance > found.uncertainty  # both in m
    True
    """
    by_user = notices.called_by_user()
    one, other = (_with_effects(scene) for scene in (scene_a, scene_b))
    pair = Pair(one, other, cells, of)
    across = pair.scene.resolution.cells_across
    known = error_of_grid(pair, across)
    finer = known.report["finer"]["cells_across"]
    apart = pair.apart(across, finer)
    if by_user:
        notices.warn(known.report.get("warnings", []), one.hash())
    time = max(apart, key=apart.__getitem__)
    first, second = (pair.answer(scene, across).result for scene in pair.scenes)
    return Comparison(
        distance=apart[time],
        uncertainty=known.error,
        time=time if one.in_time else None,
        length=max(one.length, other.length),
        cells=across,
        finer_cells=finer,
        results=(first, second),
        unknown=pair.spans(across, finer),
    )


def _with_effects(scene: Scene | Path | str) -> Scene:
    """A scene with the effects that it calls for."""
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    return choose_effects(scene).scene if scene.effects.auto else scene
