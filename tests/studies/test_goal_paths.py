"""Goals over several equilibria: a body whose field changes, and a catheter that is pushed out of its guide."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from goal_study import SCENE, searched, written

from magmpm.errors import InputError
from magmpm.results.trajectory import Motion
from magmpm.simulate import run
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.goal_study import load_goal
from magmpm.studies.goals.slopes import stencil, values_and_slopes
from magmpm.studies.search.knobs import distributions, made

BENT = SCENE.replace("[0, 0, 0]", "[1, 0, 0]")
FRAMES = """\
field:
  uniform: [0 mT, 0 mT, 0 mT]
  over_time:
    keyframes:
      - {time: 0 s, uniform: [0 mT, 0 mT, 2 mT]}
      - {time: 1 s, uniform: [0 mT, 3 mT, 4 mT]}
      - {time: 2 s, uniform: [1 mT, -2 mT, 7 mT]}
"""
TURNED = BENT.replace("field: {uniform: [0 mT, 0 mT, 4 mT]}\n", FRAMES).replace(
    "static: {}", "quasi_static: {at: [0 s, 0.5 s, 1 s, 2 s]}"
)
LUMEN = "walls: {tube: {radius: 4 mm, path: [[-5 mm, 0 mm, 0 mm], [20 mm, 0 mm, 0 mm], [60 mm, 0 mm, 0 mm]]}}"
FED = (
    TURNED.replace("0 s, 0.5 s, 1 s", "0 s, 1 s")
    .replace("length: 20 mm", "length: 40 mm")
    .replace(
        "magnetic_torque: {}", "magnetic_torque: {}, feed: {speed: 10 mm/s, exit: 30 mm}, " + LUMEN
    )
    .replace("4 mT]", "9 mT]")
)
ALONG = """\
scene: scene.yaml
vary:
  magnetization: {only: [segment 2]}
  numbers:
    - {of: "field.over_time.keyframes[2].uniform[2]", min: -15 mT, max: 15 mT}
    - {of: materials.m.shear_modulus, min: 80 kPa, max: 200 kPa}
goal:
"""
TURNS = (
    ALONG
    + """\
  maximize: {displacement: {of: segment 2, along: [0, 0, 1], at: 1 s}}
subject_to:
  - {position: {of: tip, along: [0, 0, 1], at: 0.5 s}, at_least: 0 mm}
  - {travel: {of: body, along: [0, 1, 0], from: 0.5 s, to: 2 s}, at_least: -20 mm}
  - {turn: {of: segment 2, about: [0, -1, 0], at: 1 s}, at_least: 0 deg}
  - {distance: {between: [tip, segment 1]}, at_least: 0 mm}
  - {contact_force: {with: ground}, at_most: 1 N}
  - {contact_force: {with: ground, over: mean}, at_most: 1 N}
"""
)
FEEDS = (
    ALONG
    + """\
  target: {distance: {between: [tip, [22 mm, 1 mm, 2 mm]], inserted: 20 mm}, value: 0 mm}
subject_to:
  - {position: {of: tip, along: [0, 0, 1], inserted: 10 mm}, at_least: -20 mm}
  - {contact_force: {with: walls}, at_most: 1 N}
  - {contact_force: {with: walls, over: last}, at_most: 1 N}
"""
)
GROUND = "ground: {point: [0 mm, 0 mm, 3 mm], normal: [0, 0, -1]}"


def numbers_of(study: Path, params: dict[str, float], folder: Path) -> dict[str, float]:
    """The measures of a design's own run."""
    found = load_goal(study)
    scene = made(found.scene, found.knobs, params)
    answer = Answer(scene, run(scene, folder=folder), Motion.load(folder))
    return {at: of.of_answer(answer, at, folder) for at, of in found.measures.items()}


@pytest.mark.parametrize(
    ("study", "scene", "share", "most"),
    [
        (
            TURNS,
            TURNED.replace("magnetic_torque: {}", "magnetic_torque: {}, " + GROUND),
            1e-3,
            1e-3,
        ),
        pytest.param(FEEDS, FED, 1e-5, 3e-4, marks=pytest.mark.slow),
    ],
    ids=["field", "feed"],
)
def test_derivatives_along_a_path_are_those_of_runs(
    study: str, scene: str, share: float, most: float, tmp_path: Path
) -> None:
    """Central differences of runs, over a share of each range to either side. Frames hold places of particles to 7 digits, by which turns
    and means are known: there a step of 1e-3 leaves 1e-3. Tips and forces have all digits: 1e-5, within which no other points begin to
    touch, leaves 3e-4 (paths repeat to some 1e-11 m, and such a step moves the tip by 1e-7 m)."""
    path = written(tmp_path, study + "sampler: slsqp\n", scene)
    found = load_goal(path)
    params: dict[str, float] = {}
    for knob in found.knobs:
        params |= knob.begun(found.scene)
    params = {name: value + 0.02 * abs(value) + 0.1 for name, value in params.items()}
    ranges: Any = distributions(found.knobs)
    near = [stencil(params, name, space) for name, space in ranges.items()]
    places = [place for knob in found.knobs for place in knob.places]

    def scene_at(values: dict[str, float]) -> Any:
        return made(found.scene, found.knobs, values)

    given = values_and_slopes(scene_at, places, params, near, found.measures, tmp_path / "run")
    own = numbers_of(path, params, tmp_path / "own")
    for at, value in own.items():
        assert given[at].value == pytest.approx(value, rel=1e-6, abs=1e-9), at
    pressed = [value for at, value in own.items() if found.measures[at].contact_force]
    assert min(pressed) > 0.0
    for k, (name, space) in enumerate(ranges.items()):
        h = share * (space.high - space.low)
        ahead, behind = (
            numbers_of(path, {**params, name: params[name] + way}, tmp_path / "near")
            for way in (h, -h)
        )
        for at, one in given.items():
            difference = (ahead[at] - behind[at]) / (2.0 * h)
            size = np.abs(one.slope).max()
            assert one.slope[k] == pytest.approx(difference, abs=most * size), (name, at)


@pytest.mark.slow
def test_the_tip_is_led_sideways_at_each_depth(tmp_path: Path) -> None:
    """To where a hidden design leads it: a direction of a segment, and a field for each depth, that do the same are found."""
    free = FED.replace(", " + LUMEN, "")
    hidden = free.replace("9 mT]", "-3 mT]").replace("[1, 0, 0]\nfield", "[0.6, -0.8, 0]\nfield")
    written(tmp_path, scene=hidden)
    steps = run(tmp_path / "scene.yaml").steps
    study = ALONG.replace("[2].uniform[2]", "[*].uniform[2]").partition("    - {of: materials")[0]
    study += (
        '    - {of: "field.over_time.keyframes[*].uniform[1]", min: -15 mT, max: 15 mT}\ngoal:\n'
    )
    for row, depth in zip(steps[1:], (20, 30), strict=True):
        for along, i in (("[0, 1, 0]", 1), ("[0, 0, 1]", 2)):
            study += (
                f"  - target: {{position: {{of: tip, along: {along}, inserted: {depth} mm}},"
                f" value: {1e3 * row['tip'][i]!r} mm}}\n"
            )
    found = searched(tmp_path, study + "trials: 12\n", free)
    assert found.sampler == "gauss-newton"
    assert found.values[0] is not None
    assert found.values[0][0] > 1e-3
    assert found.best is not None
    assert found.best["values"][0] < 1e-6 * found.values[0][0]
    best = run(tmp_path / "out/best.yaml").steps
    for row, there in zip(steps[1:], best[1:], strict=True):
        np.testing.assert_allclose(there["tip"][1:], row["tip"][1:], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("scene", "measure", "told"),
    [
        (
            BENT,
            "position: {of: tip, at: 1 s}",
            "position.at: received 1.00 s\n  rule: an equilibrium has no times",
        ),
        (TURNED, "turn: {of: tip, at: 0.7 s}", "the nearest is at 500 ms"),
        (TURNED, "travel: {of: tip, from: 0 s, to: 3 s}", "travel.to: received 3.00 s"),
        (
            TURNED,
            "position: {of: tip, inserted: 10 mm}",
            "a catheter that is fed comes out of a guide",
        ),
        (FED, "position: {of: tip, inserted: 12 mm}", "received 12 mm, out of the guide at 200 ms"),
        (FED, "position: {of: tip, inserted: 10 mm, at: 0 s}", "at and inserted both say when"),
    ],
)
def test_a_moment_that_the_scene_has_not_is_refused(
    scene: str, measure: str, told: str, tmp_path: Path
) -> None:
    """In place of the nearest one, silently."""
    study = ALONG.partition("    - {of: materials")[0].replace("over_time.keyframes[2].", "")
    study += f"goal: {{maximize: {{{measure}}}}}\n"
    with pytest.raises(InputError, match=r"study\.yaml:") as error:
        load_goal(written(tmp_path, study, scene))
    assert told in str(error.value)


def test_what_has_no_derivative_is_searched_by_tpe(tmp_path: Path) -> None:
    """The length of a body, a segment of a fed catheter, and friction along a path."""
    rough = {
        SCENE: "{of: body.catheter.length, min: 15 mm, max: 25 mm}",
        FED: "{of: materials.m.shear_modulus, min: 80 kPa, max: 200 kPa}",
        TURNED.replace(
            "magnetic_torque: {}", f"magnetic_torque: {{}}, {GROUND[:-1]}, friction: 0.3}}"
        ): ("{of: materials.m.shear_modulus, min: 80 kPa, max: 200 kPa}"),
    }
    for scene, number in rough.items():
        study = f"scene: scene.yaml\nvary: {{numbers: [{number}]}}\n"
        study += "goal: {maximize: {position: {of: segment 2, along: [0, 0, 1]}}}\n"
        found = load_goal(written(tmp_path, study, scene))
        assert found.sampler == "tpe"
        with pytest.raises(InputError, match="sampler"):
            load_goal(written(tmp_path, study + "sampler: slsqp\n", scene))
