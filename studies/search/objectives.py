"""Values of a trial: its distance from the target, and of two objectives also the largest field or the magnetized volume.

A design is on the Pareto front if no other is better in one objective and no worse in the other. A trial that failed has the worst values
that any design can have, the penalty and the greatest field or volume within the bounds, so it never is on the front and samplers avoid it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Plain
from magmpm.errors import shown_unit
from magmpm.studies.search.parameters import FieldVector, Parameters
from magmpm.studies.search.samplers.optuna_ids import si_values
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

NAMES = {
    "rms": "rms_m",
    "largest_field": "largest_field_T",
    "magnetized_volume": "magnetized_volume_m3",
}  # with SI units, for reports
SHOWN = {
    "rms": shown_unit("rms (m)"),
    "largest_field": shown_unit("largest field (T)"),
    "magnetized_volume": shown_unit("magnetized volume (m^3)"),
}  # as trials are told, with the factor from SI


def told_factors(kept: optuna.Study, shown: Sequence[tuple[str, float]]) -> list[float] | None:
    """Find the factors from SI by which a study's trials are told.

    Parameters
    ----------
    kept : optuna.Study
        The study in its storage.
    shown : sequence of (str, float)
        Each of its values as it is shown, and the factor from SI.

    Returns
    -------
    list of float or None
        The factors; None of a study that was begun before 0.1.0, as the names of its values say:
        it is told in SI.
    """
    same = kept.metric_names == [label for label, _ in shown]
    return [factor for _, factor in shown] if same else None


def second(name: str, space: SearchSpace, parameters: Parameters) -> float:
    """Find the second objective of a design.

    Parameters
    ----------
    name : str
        "largest_field", the strength of its strongest field; or "magnetized_volume", the volume
        of its magnetized segments.
    space : SearchSpace
        The search space.
    parameters : Parameters
        The design.

    Returns
    -------
    float, T or m^3
        The value.
    """
    if name == "largest_field":
        return max(
            float(np.linalg.norm(block.read(parameters))) for block, _ in space.those(FieldVector)
        )
    shape = space.scene_of(parameters).body.shape
    assert isinstance(shape, StraightBody)
    magnetized = np.linalg.norm(space.directions(parameters), axis=1) > 0
    return _area(shape) * float(np.sum(np.array(shape.segment_lengths())[magnetized]))


def worst(name: str, space: SearchSpace) -> float:
    """Find an upper bound of the second objective over all designs.

    Parameters
    ----------
    name : str
        As of `second`.
    space : SearchSpace
        The search space.

    Returns
    -------
    float, T or m^3
        The bound.
    """
    if name == "largest_field":
        return max(block.radius for block, _ in space.those(FieldVector))
    shape = space.scene.body.shape
    assert isinstance(shape, StraightBody)
    highest = {number.what: number.ends[1] for number in space.numbers_within}
    thickest = highest.get("diameter", shape.thickness) / shape.thickness
    return (
        _area(shape)
        * max(thickest, 1.0) ** 2
        * max(shape.length, highest.get("length", 0.0) * len(space.scene.regions()))
    )


def _area(shape: StraightBody) -> float:
    one = np.ones(1)
    return float(shape.section(one, 3 * one, 0.45 * one).area)  # the moduli do not matter


def trial_values(
    minimize: Sequence[str], space: SearchSpace, parameters: Parameters, first: float, failed: bool
) -> list[float]:
    """Put a trial's values together.

    Parameters
    ----------
    minimize : sequence of str
        Names of the objectives.
    space : SearchSpace
        The search space.
    parameters : Parameters
        The design.
    first : float, m
        The first of the values.
    failed : bool
        Whether the trial failed; then the second value is the worst one.

    Returns
    -------
    list of float, SI
        The values, in the order of `minimize`.
    """
    return [
        first,
        *(
            worst(name, space) if failed else second(name, space, parameters)
            for name in minimize[1:]
        ),
    ]


def front(trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Find the trials that no other dominates; of equals the first.

    Parameters
    ----------
    trials : sequence of FrozenTrial
        Trials with two values.

    Returns
    -------
    list of FrozenTrial
        By their first value.
    """
    found: list[FrozenTrial] = []
    for trial in sorted(trials, key=lambda t: (*si_values(t), t.number)):
        if not found or si_values(trial)[1] < si_values(found[-1])[1]:
            found.append(trial)
    return found


def compromise(values: Sequence[Sequence[float]]) -> int:
    """Find the point of a front that is nearest to the ideal one, both objectives scaled to the front's extent.

    Parameters
    ----------
    values : sequence of sequence of float
        The points (a, b).

    Returns
    -------
    int
        Number of the point.
    """
    points = np.array(values, dtype=float)
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0)
    return int(
        np.argmin(np.linalg.norm((points - low) / np.where(extent > 0, extent, 1.0), axis=1))
    )


def pareto_report(
    minimize: Sequence[str], trials: Sequence[FrozenTrial], feasible: Callable[[FrozenTrial], bool]
) -> Plain:
    """Describe a front for reports.

    Parameters
    ----------
    minimize : sequence of str
        Names of the objectives.
    trials : sequence of FrozenTrial
        All trials.
    feasible : callable
        Tells whether a trial counts.

    Returns
    -------
    dict[str, Any]
        `objectives`; `values` of every trial (None if it failed); `pareto`, with number, values
        and params of each; and `compromise`, the number of the trial nearest to the ideal
        point.
    """
    on_it = front([t for t in trials if feasible(t)])
    return {
        "objectives": [NAMES[name] for name in minimize],
        "values": [si_values(t) if feasible(t) else None for t in trials],
        "pareto": [
            {"number": t.number, "values": si_values(t), "params": dict(t.params)} for t in on_it
        ],
        "compromise": on_it[compromise([si_values(t) for t in on_it])].number if on_it else None,
    }


def ranked(trials: Sequence[FrozenTrial]) -> list[int]:
    """Order trials: by their value; of two objectives front by front, along each from its compromise outward.

    Parameters
    ----------
    trials : sequence of FrozenTrial
        The trials.

    Returns
    -------
    list of int
        Their places in the sequence, best first.
    """
    if not trials or len(si_values(trials[0])) == 1:
        return sorted(range(len(trials)), key=lambda k: (si_values(trials[k])[0], k))
    left = dict(enumerate(trials))
    order = []
    while left:
        place = {trial.number: k for k, trial in left.items()}
        layer = [place[trial.number] for trial in front(list(left.values()))]
        order += _spread(np.array([si_values(trials[k]) for k in layer]), layer)
        for k in layer:
            del left[k]
    return order


def _spread(points: np.ndarray, places: list[int]) -> list[int]:
    """The places of the points of a front, each next one farthest from those before."""
    scaled = (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-300)
    chosen = [compromise(points.tolist())]
    while len(chosen) < len(places):
        distance = np.min(np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2), axis=1)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return [places[k] for k in chosen]
