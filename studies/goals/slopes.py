"""Derivatives of measures at rest by the parameters of a study.

A parameter turns numbers of the scene (its places), and the equilibrium answers to these: dm/dp = sum of dm/dv dv/dp over the numbers v.
dm/dv is that of `magmpm.sensitivities`, exact; dv/dp, and measures that are known without a run, come of differences of scenes, which cost
no run: of smooth functions, with steps of 1e-4 of a parameter's range, exact to some 1e-8. They are central, and at a bound one-sided, of
second order too: no step goes beyond it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from optuna.distributions import FloatDistribution

from magmpm.compiled.arrays import Array
from magmpm.inputs.settings import validate
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, value_at, written
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.measures import Measure, OneMeasure, Slopes, Smooth

Params = dict[str, float]


def values_and_slopes(
    made: Callable[[Params], Scene],
    places: Sequence[Place],
    params: Params,
    ranges: Mapping[str, FloatDistribution],
    measures: Mapping[str, Mapping[str, Any]],
    folder: Path,
) -> dict[str, tuple[float, Array]]:
    """Value, SI, and derivatives (k,), SI per unit of each parameter, of measures by name; the run's result goes to `folder`.

    made: the scene of parameters; places: of the scene that they turn; ranges: of the parameters. Raises MagmpmError as `run` does.
    """
    from magmpm.simulate import sensitivities

    scene = made(params)
    near = {
        name: [
            (share, made({**params, name: params[name] + way}))
            for way, share in _stencil(params[name], space)
        ]
        for name, space in ranges.items()
    }
    leaves = [leaf for place in places for leaf in _leaves(scene, place)]
    turns = np.zeros((len(leaves), len(params)))  # dv/dp
    for i, leaf in enumerate(leaves):
        number = partial(_number, leaf)
        turns[i] = [_slope(near[name], number) for name in params]
    found = sensitivities(scene, [written(leaf) for leaf in leaves])
    found.result.save(folder)
    answer = Answer(scene, found.result)
    names = [region.name for region in scene.regions()]

    def place(of: str) -> Array:
        if of == "tip":
            assert found.tip is not None  # the measure has asked for it
            return np.asarray(found.tip @ turns)
        return found.mean(None if of == "body" else names.index(of)) @ turns

    slopes = Slopes(
        place,
        lambda of: found.moments(None if of == "body" else names.index(of)) @ turns,
        lambda of: found.contact_force(of) @ turns,
    )
    out = {}
    for at, data in measures.items():
        measure = validate(Measure, data)
        kind = getattr(measure, measure.name)
        value = measure.of_answer(answer, at, folder)
        if isinstance(kind, Smooth):
            out[at] = (value, kind.slopes(answer, at, slopes))
            continue
        known = partial(_before, kind, at)
        out[at] = (value, np.array([_slope(near[name], known) for name in params]))
    return out


def _stencil(
    value: float, space: FloatDistribution, step: float = 1e-4
) -> list[tuple[float, float]]:
    """Ways from a value within a range, and shares of a function there, whose sum is its derivative.

    step: of the range. Source: Fornberg, Mathematics of Computation 51 (1988) 699, table 3.
    """
    h = step * (space.high - space.low)
    if value + h > space.high:
        return [(0.0, 1.5 / h), (-h, -2.0 / h), (-2.0 * h, 0.5 / h)]
    if value - h < space.low:
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
