"""Derivatives of measures at rest by the parameters of a study.

A parameter turns numbers of the scene (its places), and the equilibrium answers to these: dm/dp = sum of dm/dv dv/dp over the numbers v.
dm/dv is that of `magmpm.sensitivities`, exact; dv/dp, and measures that are known without a run, come of central differences of scenes,
which cost no run: of smooth functions, with steps of 1e-4 of a parameter's range, exact to some 1e-8.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.inputs.settings import validate
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, value_at, written
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.measures import Measure, Slopes, Smooth

Params = dict[str, float]


def values_and_slopes(
    made: Callable[[Params], Scene],
    places: Sequence[Place],
    params: Params,
    ranges: Mapping[str, float],
    measures: Mapping[str, Mapping[str, Any]],
    folder: Path,
) -> dict[str, tuple[float, Array]]:
    """Value, SI, and derivatives (k,), SI per unit of each parameter, of measures by name; the run's result goes to `folder`.

    made: the scene of parameters; places: of the scene that they turn; ranges: of the parameters. Raises MagmpmError as `run` does.
    """
    from magmpm.simulate import sensitivities

    scene = made(params)
    steps = {name: 1e-4 * width for name, width in ranges.items()}
    sides = {
        name: [made({**params, name: params[name] + sign * step}) for sign in (1.0, -1.0)]
        for name, step in steps.items()
    }
    leaves = [leaf for place in places for leaf in _leaves(scene, place)]
    turns = np.zeros((len(leaves), len(params)))  # dv/dp
    for k, name in enumerate(params):
        ahead, behind = sides[name]
        for i, leaf in enumerate(leaves):
            turns[i, k] = (value_at(ahead, leaf) - value_at(behind, leaf)) / (2.0 * steps[name])
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
        ends = np.array(
            [[kind.of_answer(Answer(one, None), at) for one in sides[name]] for name in params]
        )
        out[at] = (value, (ends[:, 0] - ends[:, 1]) / (2.0 * np.array(list(steps.values()))))
    return out


def _leaves(scene: Scene, place: Place) -> list[Place]:
    """The numbers at a place: itself, or the components of a vector."""
    value = value_at(scene, place)
    return [(*place, k) for k in range(len(value))] if isinstance(value, list) else [place]
