"""Targets with derivatives: steps of Gauss-Newton's method."""

import math
from pathlib import Path

import numpy as np
import pytest
from goal_study import SCENE, plain, searched, written

from magmpm.errors import InputError, in_words
from magmpm.results.result import Result
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.goals.goal_study import load_goal

BENT = SCENE.replace("[0, 0, 0]", "[1, 0, 0]")
POINT = """\
scene: scene.yaml
vary:
  magnetization: {only: [segment 2]}
  numbers:
    - {of: field.uniform, within: 20 mT}
goal:
  target: {distance: {between: [tip, POINT]}, value: 0 mm}
trials: 16
"""


def reached() -> Result:
    """The equilibrium of a design that trials can make: what it does can be met."""
    data = Scene.from_si(plain(BENT)).to_si()
    data["body"]["catheter"]["segments"][1]["magnetization"] = [0.5, -0.8, 0.3]
    return run(Scene.from_si(data).with_field([2e-3, -6e-3, 12e-3]))


def to_the_point() -> tuple[str, np.ndarray]:
    """A study whose target is where that equilibrium's tip is, and the tip (3,) m."""
    tip = reached().tip
    assert tip is not None
    return POINT.replace("POINT", str([f"{1e3 * x!r} mm" for x in tip.tolist()])), tip


@pytest.mark.parametrize(
    "begun", ["[0 mT, 0 mT, 4 mT]", "[2 mT, 6 mT, 1 mT]", "[-4 mT, 0 mT, -9 mT]"]
)
def test_a_point_is_reached_in_few_steps(begun: str, tmp_path: Path) -> None:
    """To a millionth of the way there; the reason is told; the best design's own run ends in that point. In parts it is the same search."""
    study, point = to_the_point()
    scene = BENT.replace("[0 mT, 0 mT, 4 mT]", begun)
    first = searched(tmp_path, study, scene, trials=2)
    found = searched(tmp_path, study, scene)
    assert found.sampler == "gauss-newton"
    assert found.why_sampler == "all that counts is targets, and they have derivatives"
    assert found.values[:2] == first.values
    assert found.best is not None
    assert found.values[0] is not None
    assert found.values[0][0] > 1e-3
    assert found.best["values"][0] < 1e-6 * found.values[0][0]
    assert found.trials <= 10
    tip = run(tmp_path / "out/best.yaml").tip
    np.testing.assert_allclose(tip, point, rtol=0, atol=1e-8)


def test_several_targets_are_one_goal(tmp_path: Path) -> None:
    """Of the tip's height and the middle's place, from a field that bends the body the other way; their root mean square is the value."""
    known = reached()
    assert known.tip is not None
    height = float(known.tip[2])
    aside = float(known.segment_center[1, 1])
    study = POINT.replace(
        "  target: {distance: {between: [tip, POINT]}, value: 0 mm}",
        f"  - target: {{position: {{of: tip, along: [0, 0, 1]}}, value: {1e3 * height!r} mm}}\n"
        f"  - target: {{position: {{of: segment 2, along: [0, 1, 0]}}, value: {1e3 * aside!r} mm}}",
    )
    found = searched(tmp_path, study, BENT.replace("4 mT]", "-4 mT]"))
    assert found.goals == ["target missed by (m)"]
    assert found.pareto == []
    assert found.best is not None
    assert found.best["values"][0] < 1e-6 * height
    assert found.best["measures"]["goal[0].target"] == pytest.approx(height, rel=1e-6)
    assert found.best["measures"]["goal[1].target"] == pytest.approx(aside, rel=1e-6)
    assert found.values[0] is not None
    assert found.values[0][0] > 1e-3
    assert [limit["label"] for limit in found.limits] == [
        "position of tip along [0, 0, 1] (m)",
        "position of segment 2 along [0, 1, 0] (m)",
    ]
    assert [limit["bounds"] for limit in found.limits] == [
        f"target {in_words('position (m)', height)}",
        f"target {in_words('position (m)', aside)}",
    ]


def test_a_list_within_a_target_is_told_to_be_a_list_of_goals(tmp_path: Path) -> None:
    study = POINT.replace(
        "  target: {distance: {between: [tip, POINT]}, value: 0 mm}",
        "  target: [{position: {of: tip}, value: 1 mm}, {position: {of: body}, value: 2 mm}]",
    )
    with pytest.raises(InputError, match=r"goal: \[\{target: \.\.\.\}, \{target: \.\.\.\}\]"):
        load_goal(written(tmp_path, study, BENT))


def test_a_target_out_of_reach_is_sought_from_several_starts(tmp_path: Path) -> None:
    """The rod is not as long: descents end at the point that is nearest, along the way there, and the next begins elsewhere."""
    study = POINT.replace("POINT", "[15 mm, 0 mm, 25 mm]")
    found = searched(tmp_path, study, BENT, trials=20)
    assert found.trials == 20
    assert found.best is not None
    best = found.best["values"][0]
    assert best > math.hypot(15e-3, 25e-3) - 20e-3
    assert found.values[-1] is not None
    assert found.values[-1][0] > 1.001 * best


def test_targets_with_a_bound_go_by_slsqp(tmp_path: Path) -> None:
    study, _ = to_the_point()
    study = study.replace("trials", "subject_to: [{largest_field: {}, at_most: 15 mT}]\ntrials")
    aslant = BENT.replace("[0 mT, 0 mT, 4 mT]", "[1 mT, -2 mT, 4 mT]")
    found = searched(tmp_path, study, aslant, trials=25)
    assert found.sampler == "slsqp"
    assert found.best is not None
    assert found.best["feasible"]
    assert found.values[0] is not None
    assert found.best["values"][0] < 0.2 * found.values[0][0]
    with pytest.raises(InputError, match="gauss-newton meets targets, without constraints"):
        load_goal(written(tmp_path, study + "sampler: gauss-newton\n", BENT))


@pytest.mark.parametrize(
    ("goal", "told"),
    [
        ("maximize: {position: {of: tip}}\nsampler: gauss-newton", "gauss-newton meets targets"),
        (
            "- target: {position: {of: tip}, value: 1 mm}\n"
            "  - target: {turn: {of: tip}, value: 10 deg}\nsampler: gauss-newton",
            "targets of one unit",
        ),
        (
            "target: {strain: {}, value: 0.1}\nsampler: gauss-newton",
            "it goes along derivatives, and goal[0].target has none",
        ),
    ],
)
def test_what_it_can_not_meet_is_refused(goal: str, told: str, tmp_path: Path) -> None:
    study = POINT.replace("target: {distance: {between: [tip, POINT]}, value: 0 mm}", goal)
    with pytest.raises(InputError, match=r"study\.yaml") as error:
        load_goal(written(tmp_path, study, BENT))
    assert told in str(error.value)
    assert "remedy" in str(error.value)
