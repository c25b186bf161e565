"""Derivatives of measures at rest by the parameters of a study.

A parameter turns numbers of the scene (its places), and the equilibrium answers to these: dm/dp = sum of dm/dv dv/dp over the numbers v.
dm/dv is that of `magmpm.sensitivities`, exact; dv/dp, and measures that are known without a run, come of differences of scenes, which cost
no run: of smooth functions, with steps of 1e-5 of a parameter's range, exact to 1e-9 (of an angle over a full turn, whose range is the
longest). They are central, and at a bound one-sided, of second order too: no step goes beyond it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from optuna.distributions import FloatDistribution

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, value_at, written
from magmpm.statics.linearized import Sensitivities
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.measures import Measure, OneMeasure, Slopes, Smooth
from magmpm.studies.problem.shape_distance import gap_derivatives

Near = Sequence[
    Sequence[tuple[float, NamedNumbers]]
]  # for each way shares of a function at parameters


@dataclass(frozen=True)
class Derived:
    """A measure, SI, and its derivatives (k,) by the parameters; parts: numbers (m,) of whose squares it is the root of the sum, with
    their derivatives (m, k), None of others."""

    value: float
    slope: Array
    parts: tuple[Array, Array] | None = None


def values_and_slopes(
    made: Callable[[NamedNumbers], Scene],
    places: Sequence[Place],
    params: NamedNumbers,
    stencils: Near,
    measures: Mapping[str, Measure],
    folder: Path,
) -> dict[str, Derived]:
    """Value, SI, and derivatives, SI per unit of each of some ways near the parameters, of measures by name.

    The run's result goes to `folder`. made: the scene of parameters; places: of the scene that they turn. Raises MagmpmError as `run` does.
    """
    from magmpm.simulate import sensitivities, sensitivities_along

    scene = made(params)
    ways = [[(share, made(there)) for share, there in one] for one in stencils]
    leaves = [leaf for place in places for leaf in _leaves(scene, place)]
    turns = np.zeros((len(leaves), len(ways)))  # dv/dp
    for i, leaf in enumerate(leaves):
        turns[i] = [_slope(way, partial(_number, leaf)) for way in ways]
    addresses = [written(leaf) for leaf in leaves]
    if scene.in_time:
        result, equilibrium = sensitivities_along(scene, addresses, folder)
        answer = Answer(scene, result, Motion.load(folder))
    else:
        found = sensitivities(scene, addresses)
        found.result.save(folder)
        answer = Answer(scene, found.result)

    @cache
    def near(k: int) -> Sensitivities | None:
        """Derivatives of equilibrium number k; None where the body is straight, whatever the numbers are."""
        if scene.in_time:
            return equilibrium(k)
        return found if k else None

    names = [region.name for region in scene.regions()]

    def region(of: str) -> int | None:
        return None if of == "body" else names.index(of)

    def derived(k: float, of: Callable[[Sensitivities], Array], *shape: int) -> Array:
        there = near(int(k))
        return np.zeros((*shape, len(ways))) if there is None else of(there) @ turns

    def place(of: str, k: float) -> Array:
        if of == "tip":  # the measure has asked for it
            return derived(k, lambda there: np.asarray(there.tip), 3)
        return derived(k, lambda there: there.mean(region(of)), 3)

    def moment(of: str, k: float) -> Array:
        return derived(k, lambda there: there.moments("tip" if of == "tip" else region(of)), 3, 3)

    def force(of: str, k: int) -> Array:
        return derived(k if scene.in_time else 1, lambda there: there.contact_force(of), 3)

    def gaps(target: Array, k: float) -> Array:
        return derived(k, lambda there: gap_derivatives(there, target), len(target), 3)

    slopes = Slopes(place, moment, force, gaps)
    out = {}
    for at, measure in measures.items():
        kind = getattr(measure, measure.name)
        value = measure.of_answer(answer, at, folder)
        if isinstance(kind, Smooth):
            parts = kind.parts(answer, at, slopes)
            out[at] = Derived(value, kind.slopes(answer, at, slopes), parts)
            continue
        known = partial(_before, kind, at)
        out[at] = Derived(value, np.array([_slope(way, known) for way in ways]))
    return out


def stencil(
    params: NamedNumbers, name: str, space: FloatDistribution
) -> list[tuple[float, NamedNumbers]]:
    """Weights and nearby parameters: the weighted sum of a function's values there is its derivative by the parameter of this name."""
    return [
        (share, {**params, name: params[name] + way})
        for way, share in shares(params[name], space.low, space.high)
    ]


def shares(value: float, low: float, high: float, step: float = 1e-5) -> list[tuple[float, float]]:
    """Ways from a value within a range, and shares of a function there, whose sum is its derivative.

    step: of the range. Source: Fornberg, Mathematics of Computation 51 (1988) 699, table 3.
    """
    h = step * (high - low)
    if value + h > high:
        return [(0.0, 1.5 / h), (-h, -2.0 / h), (-2.0 * h, 0.5 / h)]
    if value - h < low:
        return [(0.0, -1.5 / h), (h, 2.0 / h), (2.0 * h, -0.5 / h)]
    return [(h, 0.5 / h), (-h, -0.5 / h)]


def _slope(near: Sequence[tuple[float, Scene]], function: Callable[[Scene], float]) -> float:
    """Derivative of a function of a scene, by shares of scenes near it."""
    return sum(share * function(one) for share, one in near)


def _number(place: Place, scene: Scene) -> float:
    """The number at a place."""
    return float(value_at(scene, place))


def _before(kind: OneMeasure, at: str, scene: Scene) -> float:
    """A measure that is known before the run."""
    return kind.of_answer(Answer(scene, None), at)


def _leaves(scene: Scene, place: Place) -> list[Place]:
    """The numbers at a place: itself, or the components of a vector."""
    value = value_at(scene, place)
    return [(*place, k) for k in range(len(value))] if isinstance(value, list) else [place]
