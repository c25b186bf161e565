"""Measures against formulas, and the search for a goal."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import optuna
import pytest
from goal_study import SCENE, STUDY, plain, searched, written
from jsonschema import Draft202012Validator
from optuna.distributions import FloatDistribution
from reference.moving import DENSITY, block, moving_scene
from reference.parts import parts_scene
from reference.solids import box
from scipy.spatial.transform import Rotation

import magmpm
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.errors import InputError, significant
from magmpm.inputs.settings import json_schema, validate
from magmpm.inputs.yaml_document import read_yaml
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.solving.solve import at_rest, result_of
from magmpm.statics.energy import Energy
from magmpm.statics.newton import refined
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.evaluate import beyond
from magmpm.studies.goals.goal_file import SCHEMA, GoalFile
from magmpm.studies.goals.goal_study import load_goal
from magmpm.studies.goals.measures import Measure
from magmpm.studies.goals.report import GoalReport, spread, text
from magmpm.studies.goals.slopes import stencil, values_and_slopes
from magmpm.studies.search.knobs import distributions, made

ROOT = Path(__file__).parents[2]
SOFT = 12e3  # Pa: a tenth of the usual shear modulus, and steps that are three times as long


def measured(answer: Answer, **measure: Any) -> float:
    return validate(Measure, measure).of_answer(answer, "measure", Path())


@pytest.fixture(scope="module")
def bent() -> Answer:
    """An equilibrium."""
    scene = Scene.from_si(plain(SCENE))
    return Answer(scene, run(scene))


@pytest.fixture(scope="module")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> Answer:
    """A block that falls for 20 ms, with 0.5 mm to the ground: it hits after 10.1 ms; in a field that grows for all the time."""
    folder = tmp_path_factory.mktemp("fallen")
    effects = {"gravity": {}, "ground": {"point": [0.0, 0.0, -0.5e-3]}, "damping": {"rate": 0.0}}
    ramp = {"ramp": {"duration": 0.02}}
    scene = moving_scene(
        block((2e-3, 2e-3, 2e-3)),
        effects,
        duration=0.02,
        field={"uniform": [3e-3, 0.0, 4e-3], "over_time": ramp},
    )
    return Answer(scene, run(scene, folder=folder), Motion.load(folder))


def test_measures_of_an_equilibrium(bent: Answer) -> None:
    result = bent.result
    assert result is not None
    assert result.tip is not None
    up = [0.0, 0.0, 1.0]
    assert measured(bent, position={"of": "tip", "along": up}) == result.tip[2]
    lifted = measured(bent, displacement={"of": "tip", "along": up})
    assert lifted == pytest.approx(result.tip[2], abs=1e-12)
    assert lifted > 1e-3
    assert measured(bent, travel={"of": "tip", "along": up}) == pytest.approx(lifted, abs=1e-12)
    back = measured(bent, displacement={"of": "tip"})
    assert back == pytest.approx(result.tip[0] - 20e-3, abs=1e-12)
    turn = measured(bent, turn={"of": "segment 2", "about": [0, -1, 0]})
    end = result.centreline[-1, 1:] - result.centreline[-3, 1:]
    assert turn == pytest.approx(np.arctan2(end[2], end[0]), abs=0.05)
    end = result.centreline[-1, 1:] - result.centreline[-2, 1:]  # half a cell
    turn = measured(bent, turn={"of": "tip", "about": [0, -1, 0]})
    assert turn == pytest.approx(np.arctan2(end[2], end[0]), abs=0.005), "to its shear"
    apart = measured(bent, distance={"between": ["segment 1", "segment 2"]})
    assert apart == pytest.approx(
        float(np.linalg.norm(result.segment_center[1] - result.segment_center[0])), rel=1e-9
    )
    assert measured(bent, strain={}) == result.largest_stretch - 1.0
    assert measured(bent, largest_field={}) == pytest.approx(4e-3)
    assert measured(bent, field_energy={}) == pytest.approx(16e-6)
    volume = np.pi * 2e-3**2 * 10e-3
    assert measured(bent, magnetized_volume={}) == pytest.approx(volume, rel=1e-6)
    assert measured(bent, stability={}) == result.stability


def test_measures_of_a_motion(fallen: Answer) -> None:
    up = [0.0, 0.0, 1.0]
    fall = measured(fallen, travel={"along": up, "from": 0.0, "to": 0.008})
    t = fallen.times[fallen.moment(0.008, 0)]
    assert fall == pytest.approx(-0.5 * 9.81 * t**2, rel=1e-3)
    assert measured(fallen, displacement={"along": up, "at": 0.008}) == pytest.approx(fall)
    assert measured(fallen, contact_force={"with": "ground"}) > 0
    mean = measured(fallen, contact_force={"with": "ground", "over": "mean"})
    assert 0 < mean < measured(fallen, contact_force={"with": "ground"})
    assert measured(fallen, largest_field={}) == pytest.approx(5e-3, rel=1e-9)
    assert measured(fallen, field_energy={}) == pytest.approx(25e-6 * 0.02 / 3, rel=1e-5)
    assert abs(measured(fallen, turn={})) < 1e-3


@pytest.mark.parametrize(
    ("measure", "told"),
    [
        ({"position": {"of": "nose"}}, "must be one of body, segment 1, segment 2"),
        ({"turn": {"along": [0, 1, 0]}}, r"write `about: \[0, 1, 0\]`"),
        ({"contact_force": {"with": "walls"}}, "name ground, walls or self_contact in the scene"),
        ({}, "`python`, one of them"),
        ({"strain": {}, "stability": {}}, "`python`, one of them"),
        ({"python": "none.py:f"}, "there is no file"),
    ],
)
def test_wrong_measures_are_refused(bent: Answer, measure: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        measured(bent, **measure)


def test_a_moment_between_two_frames_is_neither(fallen: Answer) -> None:
    """A fall of g t^2 / 2, at the middle between two frames; they are stored in single precision of 1e-10 m."""
    t = 0.5 * (fallen.times[20] + fallen.times[21])
    fall = measured(fallen, travel={"along": [0.0, 0.0, 1.0], "to": t})
    assert fall == pytest.approx(-0.5 * 9.81 * t**2, abs=2e-9)


def test_a_body_that_turns_farther_than_half_a_turn_counts_on(tmp_path: Path) -> None:
    """Two turns and a half about an axis that is none of the grid's, in frames 50 degrees apart, and back by one and a half."""
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    degrees = np.concatenate([np.arange(0, 901, 50), np.arange(850, 359, -49)])
    scene = Scene.from_si(plain(SCENE) | {"solver": {"quasi_static": {"at": [0.0, 1.0]}}})
    rest = Answer(scene, None).model.particles.position
    turned = [Rotation.from_rotvec(np.radians(one) * axis).apply(rest) for one in degrees]
    motion = SimpleNamespace(times=np.arange(len(turned)), position=turned.__getitem__)
    answer = Answer(scene, None, motion)
    for at, one in enumerate(degrees):
        for of in ("body", "segment 2"):
            found = measured(answer, turn={"of": of, "about": axis.tolist(), "at": float(at)})
            assert np.degrees(found) == pytest.approx(one, abs=1e-6)


def test_the_least_broken_bounds_are_counted_in_shares_of_each(tmp_path: Path) -> None:
    """1 mm of 2 mm is more than 1 kPa of 1 MPa, or 10 mT of 20, though each is less in SI than a hundredth of a kPa."""
    assert beyond(3e-3, (None, 2e-3)) == pytest.approx([0.5])
    assert beyond(1.001e6, (None, 1e6)) == pytest.approx([1e-3])
    assert beyond(0.03, (0.01, 0.02)) == pytest.approx([-1.0, 0.5])
    assert beyond(-0.2, (0.0, None)) == pytest.approx([0.2])


def test_a_pulse_is_the_largest_field(tmp_path: Path) -> None:
    """It is shorter than a thousandth of the time; a vibration whose thousand samples are all zero is seen, too."""
    pulse = [(0.0, 0.0), (0.01, 0.0), (0.010002, 4.0), (0.010004, 0.0), (0.02, 1.0)]
    over: Any = {"keyframes": [{"time": t, "strength": of} for t, of in pulse]}
    seen = moving_scene(block((2e-3, 2e-3, 2e-3)), {"magnetic_torque": {}}, duration=0.02)

    def answer() -> Answer:
        field = {"uniform": [3e-3, 0.0, 4e-3], "over_time": over}
        return Answer(Scene.from_si({**seen.to_si(), "field": field}), None)

    assert measured(answer(), largest_field={}) == pytest.approx(20e-3, rel=1e-9)
    over = {"oscillation": {"frequency": 999 / 0.02}}
    assert measured(answer(), largest_field={}) == pytest.approx(5e-3, rel=1e-9)
    assert measured(answer(), field_energy={}) == pytest.approx(12.5e-6 * 0.02, rel=1e-3)


def test_the_largest_field_of_a_magnet_is_that_at_the_nearest_particle() -> None:
    """Of a dipole on the axis of a straight rod: mu0 m / (2 pi r^3) at its end, and half of a cell before it at least."""
    data = plain(SCENE)
    data["body"]["catheter"]["segments"] = [{"magnetization": [0.0, 0.0, 0.0]}]
    data["field"] = {
        "dipole": [{"position": ["45 mm", "0 mm", "0 mm"], "moment": ["1 A*m^2", 0.0, 0.0]}]
    }
    data["effects"] = {"magnetic_torque": {}, "magnetic_force": {}}
    scene = Scene.from_si(data)
    found = measured(Answer(scene, run(scene)), largest_field={})
    assert 2e-7 / 26e-3**3 < found < 2e-7 / 25e-3**3


def test_the_largest_field_of_what_moves_past_a_magnet(tmp_path: Path) -> None:
    """A block that falls past a dipole between two of its four frames: that of a rigid fall, g t^2 / 2, at the nearest moment. To 1e-4:
    a thousandth of the time, in which it falls by 0.01 mm of 8, and places in single precision."""
    data = moving_scene(
        block((2e-3, 2e-3, 2e-3)),
        {"gravity": {}, "magnetic_torque": {}, "magnetic_force": {}},
        solver={"dynamic": {"duration": 0.04, "output_every": 0.01}},
        field={"dipole": [{"position": [6e-3, 0.0, -4e-3], "moment": [1e-3, 0.0, 0.0]}]},
    )
    answer = Answer(data, run(data, folder=tmp_path), Motion.load(tmp_path))
    field = data.external_field()
    begun = answer.particles(0)
    strongest = 0.0
    for time in np.linspace(0.0, 0.04, 401):
        fallen = begun - [0.0, 0.0, 9.81 * time**2 / 2]
        strongest = max(strongest, np.linalg.norm(field.at(fallen), axis=1).max())
    assert measured(answer, largest_field={}) == pytest.approx(strongest, rel=1e-4)


def test_a_mean_force_is_that_over_time(tmp_path: Path) -> None:
    """A tip that is pressed on the ground in uneven steps: each force counts for the time until the next and since the one before."""
    data = plain(SCENE)
    data["effects"] = {"magnetic_torque": {}, "ground": {"point": ["0 mm", "0 mm", "-2.1 mm"]}}
    data["field"] = {
        "uniform": ["0 mT", "0 mT", "-6 mT"],
        "over_time": {"ramp": {"duration": "1 s"}},
    }
    times = ["0 s", "0.5 s", "0.7 s", "0.95 s", "1 s"]
    data["solver"] = {"quasi_static": {"at": times}}
    scene = Scene.from_si(data)
    answer = Answer(scene, run(scene, folder=tmp_path), Motion.load(tmp_path))
    force = answer.pushes("ground")[:, 2]
    found = measured(answer, contact_force={"with": "ground", "over": "mean"})
    assert 0.0 < force[1] < force[-1]
    assert found == pytest.approx(np.trapezoid(force, [0.0, 0.5, 0.7, 0.95, 1.0]), rel=1e-6)


def test_two_parts_that_have_left_each_other_press_no_more(tmp_path: Path) -> None:
    """A block that bounces: its pair has rows only while it touches. Either order is its name, and no other."""
    scene = parts_scene(
        tmp_path,
        {
            "plate": box((-4e-3, -2e-3, -2e-3), (4e-3, 2e-3, 0.0)),
            "block": box((-1.5e-3, -1.5e-3, 0.3e-3), (1.5e-3, 1.5e-3, 3e-3)),
        },
        {"gravity": {"acceleration": [0.0, 0.0, -40.0]}, "self_contact": {}},
        1e-3,
        held=("plate",),
        solver={"dynamic": {"duration": 7e-3, "output_every": 0.2e-3}},
    )
    result = run(scene, folder=tmp_path / "out")
    answer = Answer(scene, result, Motion.load(tmp_path / "out"))
    for pair in ("self_contact: plate, block", "self_contact: block, plate"):
        assert measured(answer, contact_force={"with": pair}) > 1e-3
        assert measured(answer, contact_force={"with": pair, "over": "last"}) == 0.0
    whole = measured(answer, contact_force={"with": "self_contact: plate, block"})
    for of, by in (("plate", "block"), ("block", "plate"), ("block", "self_contact")):
        assert measured(answer, contact_force={"of": of, "with": by}) == whole
    for wrong, remedy in (
        ({"with": "self_contact"}, "name the part that is pushed, one of plate, block"),
        ({"with": "self_contact: plate, blokc"}, "name one of block"),
        ({"of": "blokc", "with": "plate"}, "name one of body, plate, block"),
        ({"of": "block", "with": "block"}, "name one of plate"),
        ({"of": "block", "with": "ground"}, "name one of plate"),
    ):
        with pytest.raises(InputError, match=remedy):
            measured(answer, contact_force=wrong)


def test_each_segment_bears_its_share_of_the_weight(tmp_path: Path) -> None:
    """A block that lies on the ground: a third of its weight on the first segment, within the 2 % of points on the edge between both, and
    of the ends; what both bear adds up to the weight. The largest force in any frame is in the result."""
    segments = [{"magnetization": [0.0, 0.0, 0.0], "length": length} for length in (4e-3, 8e-3)]
    effects = {"gravity": {}, "ground": {"point": [0.0, 0.0, 0.0]}, "damping": {"rate": 500.0}}
    scene = moving_scene(
        block((12e-3, 2e-3, 2e-3), segments=segments),
        effects,
        solver={"dynamic": {"duration": 0.03, "output_every": 3e-3}},
    )
    result = run(scene, folder=tmp_path)
    answer = Answer(scene, result, Motion.load(tmp_path))
    weight = DENSITY * 12e-3 * 2e-3 * 2e-3 * 9.81
    last = {"with": "ground", "over": "last"}
    short = measured(answer, contact_force={**last, "of": "segment 1"})
    long = measured(answer, contact_force={**last, "of": "segment 2"})
    assert short == pytest.approx(weight / 3, rel=0.02)
    assert short + long == pytest.approx(weight, rel=5e-3)
    assert short + long == pytest.approx(measured(answer, contact_force=last), rel=1e-9)
    for name in ("ground", "ground: segment 1", "ground: segment 2"):
        forces = np.linalg.norm(answer.pushes(name), axis=1)
        told = result.contacts[name]
        assert told["largest"] == pytest.approx(forces.max(), rel=1e-12)
        assert told["largest_at"] == answer.times[forces.argmax()]


def test_a_bound_of_a_magnets_field_has_no_derivative(tmp_path: Path) -> None:
    """It is known by a run alone; of a field that is the same everywhere before it, with its derivative."""
    near = "{dipole: {position: [60 mm, 0 mm, 0 mm], moment: [1 A*m^2, 0 A*m^2, 0 A*m^2]}}"
    scene = SCENE.replace("{uniform: [0 mT, 0 mT, 4 mT]}", near)
    scene = scene.replace("magnetic_torque: {}", "magnetic_torque: {}, magnetic_force: {}")
    study = STUDY.replace("field.uniform[2]", "field.dipole[0].position[2]").replace("mT", "mm")
    study = study.replace("sampler: tpe\n", "subject_to: [{largest_field: {}, at_most: 20 mT}]\n")
    found = searched(tmp_path, study, scene, trials=2)
    assert not found.failed
    assert found.best is not None
    assert load_goal(tmp_path / "study.yaml").sampler == "tpe"


def test_stability_is_that_of_an_equilibrium(fallen: Answer) -> None:
    with pytest.raises(InputError, match="stability"):
        measured(fallen, stability={})


@pytest.mark.parametrize("path", sorted((ROOT / "data/goals").glob("*.yaml")))
def test_shipped_goals_load_and_fit_the_schema(path: Path) -> None:
    assert load_goal(path).knobs
    Draft202012Validator(json_schema(GoalFile)).validate(dict(read_yaml(path)))


def test_schema_file_is_current() -> None:
    """`python -m magmpm.studies.goals.goal_file` rewrites it."""
    assert json.loads(SCHEMA.read_text()) == json_schema(GoalFile)


def test_a_search_begins_with_the_scene_and_goes_on(tmp_path: Path) -> None:
    """It keeps the best run and its scene, and runs it on more cells; the same file goes on, another one is refused."""
    first = searched(tmp_path, trials=3)
    assert first.trials == 3
    assert first.best is not None
    assert first.values[0] is not None
    again = searched(tmp_path)
    assert again.trials == 6
    assert again.values[:3] == first.values
    assert again.best is not None
    best = max(value[0] for value in again.values if value is not None)
    assert again.best["values"] == [best]
    assert best >= again.values[0][0]  # type: ignore[index]
    kept = run(tmp_path / "out" / "best.yaml")
    assert kept.tip is not None
    assert kept.tip[2] == pytest.approx(best, rel=1e-9)
    assert again.finer is not None
    assert again.finer["values"][0] == pytest.approx(best, rel=0.02)
    assert not list((tmp_path / "out").glob("trial_*"))
    with pytest.raises(InputError, match="another definition"):
        searched(tmp_path, STUDY.replace("8 mT", "7 mT"))


def test_a_search_killed_as_it_keeps_its_best_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trial is told, and its run is not yet in best/: the next session puts it there."""

    def killed(*_: object) -> None:
        raise SystemExit

    file = written(tmp_path, STUDY)
    whole = magmpm.design(file, folder=tmp_path / "whole", trials=1, progress=False)
    with monkeypatch.context() as patched:
        patched.setattr("magmpm.studies.goals.search.shutil.move", killed)
        with pytest.raises(SystemExit):
            magmpm.design(file, folder=tmp_path / "killed", trials=1, progress=False)
    found = magmpm.design(file, folder=tmp_path / "killed", trials=1, progress=False)
    assert isinstance(found, GoalReport)
    assert isinstance(whole, GoalReport)
    assert found.best == whole.best
    kept = [Result.load(tmp_path / name / "best").particle_position for name in ("whole", "killed")]
    assert np.array_equal(*kept)
    assert not (tmp_path / "killed" / "trial_0").exists()


def test_a_target_with_a_constraint_in_two_processes(tmp_path: Path) -> None:
    """The tip comes within 0.2 mm of 1.5 mm, at less than 3.5 mT, which takes the stronger material; ties share one value."""
    study = """\
scene: scene.yaml
vary:
  numbers:
    - {of: "field.uniform[2]", min: 1 mT, max: 8 mT}
    - {of: [materials.m.remanence], choices: [138 mT, 250 mT]}
goal:
  target: {displacement: {of: tip, along: [0, 0, 1]}, value: 1.5 mm}
subject_to:
  - {largest_field: {}, at_most: 3.5 mT}
trials: 20
"""
    found = searched(tmp_path, study, workers=2)
    assert found.best is not None
    assert found.best["feasible"]
    assert found.best["values"][0] < 0.2e-3
    assert found.best["measures"]["subject_to[0]"] <= 3.5e-3
    assert found.skipped == sum(value is None for value in found.values) > 3, "not run"
    assert found.best["measures"]["goal[0].target"] == pytest.approx(1.5e-3, abs=0.2e-3)


def test_a_search_in_parts_is_that_in_one(tmp_path: Path) -> None:
    """Ended after some trials, and with one that was at work: the same designs, none twice."""
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = searched(tmp_path / "whole", trials=14)
    searched(tmp_path / "parts", trials=3)
    kept = optuna.load_study(
        study_name="study", storage=f"sqlite:///{tmp_path / 'parts/out/study.db'}"
    )
    there = optuna.load_study(
        study_name="study", storage=f"sqlite:///{tmp_path / 'whole/out/study.db'}"
    )
    kept.enqueue_trial(there.trials[3].params)
    assert kept.ask().number == 3  # as a session that is killed leaves it
    parts = searched(tmp_path / "parts", trials=14)
    assert parts.values == whole.values
    assert len({tuple(of) for of in whole.values if of}) == 14


def test_a_scene_outside_of_the_bounds_begins_at_the_nearest(tmp_path: Path) -> None:
    """And the report has the scene's own number."""
    found = searched(
        tmp_path, STUDY.replace("min: 1 mT, max: 8 mT", "min: 5 mT, max: 8 mT"), trials=1
    )
    assert found.best is not None
    assert found.best["params"] == {"field.uniform[2] (mT)": 5.0}
    assert found.begun == {"field.uniform[2] (mT)": pytest.approx(4.0)}


def test_several_goals_and_a_users_function(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def reach(result):\n    return float(result.tip[2])\n")
    study = STUDY.replace(
        "goal:\n  maximize: {displacement: {of: tip, along: [0, 0, 1]}}",
        "goal:\n  - maximize: {python: own.py:reach}\n  - minimize: {largest_field: {}}",
    )
    found = searched(tmp_path, study)
    assert found.pareto
    for one in found.pareto:
        assert run(Scene.from_si(plain(SCENE)).with_field([0.0, 0.0, one["values"][1]])).tip[
            2
        ] == pytest.approx(one["values"][0], rel=1e-6)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("raise ValueError('no stride')", "it raised ValueError: no stride"),
        ("return float('nan')", "returned nan, and must return a finite number"),
        ("return 'far'", "returned str, and must return a finite number"),
    ],
)
def test_a_function_that_fails_is_a_failed_trial(tmp_path: Path, body: str, told: str) -> None:
    (tmp_path / "own.py").write_text(f"def reach(result):\n    {body}\n")
    study = STUDY.replace("{displacement: {of: tip, along: [0, 0, 1]}}", "{python: own.py:reach}")
    found = searched(tmp_path, study, trials=2)
    assert found.best is None
    assert [told in one["why"] for one in found.failed] == [True, True]


def scene_of(study: str, scene: str, folder: Path, params: dict[str, float]) -> Scene:
    """The scene that a study makes of these parameters."""
    found = load_goal(written(folder, study, scene))
    return made(found.scene, found.knobs, params)


def test_a_vector_within_a_length_and_in_a_plane(tmp_path: Path) -> None:
    """The angle is right-handed about the axis; the scene's own vector is where the search begins."""
    study = STUDY.replace(
        '{of: "field.uniform[2]", min: 1 mT, max: 8 mT}',
        "{of: field.uniform, within: 8 mT, direction: {across: [0, -1, 0], at_most: 60 deg}}",
    )
    angle, length = "field.uniform angle (deg)", "field.uniform length (mT)"
    found = scene_of(study, SCENE, tmp_path, {angle: 30.0, length: np.float64(4.0)})
    assert found.field.uniform == pytest.approx([2e-3 * 3**0.5, 0.0, 2e-3], abs=1e-15)
    (knob,) = load_goal(tmp_path / "study.yaml").knobs
    space = knob.distributions()[angle]
    assert isinstance(space, FloatDistribution)
    assert (space.low, space.high) == pytest.approx((30.0, 150.0))
    begun = knob.begun(load_goal(tmp_path / "study.yaml").scene)
    assert begun == pytest.approx({angle: 90.0, length: 4.0})


def test_a_vector_that_turns_keeps_its_length(tmp_path: Path) -> None:
    """A field of 5 mT stays one of 5 mT, in whatever direction; the search begins with the scene's own."""
    study = STUDY.replace(
        '{of: "field.uniform[2]", min: 1 mT, max: 8 mT}', "{of: field.uniform, direction: {}}"
    )
    scene = SCENE.replace("[0 mT, 0 mT, 4 mT]", "[3 mT, 0 mT, 4 mT]")
    found = load_goal(written(tmp_path, study, scene))
    own = made(found.scene, found.knobs, found.begun)
    assert own.field.uniform == pytest.approx([3e-3, 0.0, 4e-3], abs=1e-15)
    azimuth, elevation = found.begun
    turned = made(found.scene, found.knobs, {azimuth: 90.0, elevation: 0.0})
    assert turned.field.uniform == pytest.approx([0.0, 5e-3, 0.0], abs=1e-15)


def test_directions_that_stand_around_an_axis(tmp_path: Path) -> None:
    segments = [f"body.catheter.segments[{k}].magnetization" for k in range(2)]
    study = STUDY.replace(
        '{of: "field.uniform[2]", min: 1 mT, max: 8 mT}',
        f"{{of: {json.dumps(segments)}, direction: {{across: [0, -1, 0]}}, turned_about: [0, 0, 1]}}",
    )
    name = "body.catheter.segments[0].magnetization angle (deg)"
    found = scene_of(study, SCENE, tmp_path, {name: 60.0})
    first, second = (region.magnetization for region in found.regions())
    assert first == pytest.approx([0.5, 0.0, 0.75**0.5])
    assert second == pytest.approx([-0.5, 0.0, 0.75**0.5], abs=1e-15)


ARC = "s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n8,7.9,0.1,0.8\n20,18,0.5,7\n"
SMOOTH = """\
scene: scene.yaml
vary:
  magnetization: {}
  numbers:
    - {of: field.uniform, within: 8 mT}
    - {of: materials.m.shear_modulus, min: 80 kPa, max: 200 kPa, log: true}
    - {of: "body.catheter.segments[1].magnetization", direction: {across: [0, -1, 0]}}
goal:
  maximize: {displacement: {of: segment 2, along: [0, 0, 1]}}
subject_to:
  - {distance: {between: [segment 1, tip]}, at_least: 1 mm}
  - {distance: {between: [[15 mm, 3 mm, 5 mm], tip]}, at_least: 1 mm}
  - {position: {of: body, along: [1, 0, 0]}, at_least: 1 mm}
  - {turn: {of: segment 2, about: [0.2, -1, 0.4]}, at_least: 0 deg}
  - {turn: {of: body, about: [1, 0, 0]}, at_least: -90 deg}
  - {turn: {of: tip, about: [0, -1, 0]}, at_least: -90 deg}
  - {contact_force: {with: ground}, at_most: 1 N}
  - {shape: {centreline: arc.csv}, at_most: 10 mm}
  - {field_energy: {}, at_most: 1 T^2 s}
trials: 5
"""


def test_derivatives_of_measures_are_those_of_runs(tmp_path: Path) -> None:
    """Of places of the tip, segments and the body, distance, shape, turns, what presses, and the field; by angles, lengths, moduli.

    To 1e-8 of a measure's steepest slope. Differences are of the fourth order, of equilibria to the last digits, or they would not say so.
    """
    (tmp_path / "arc.csv").write_text(ARC)
    scene = SCENE.replace("magnetization: [0, 0, 0]", "magnetization: [1, 0, 0.5]")
    ground = "ground: {point: [0 mm, 0 mm, 2.6 mm], normal: [0.1, 0.2, -1]}"
    scene = scene.replace("magnetic_torque: {}", f"magnetic_torque: {{}}, {ground}")
    study = SMOOTH.replace("magnetization: {}", "magnetization: {only: [segment 1]}")
    study = study.replace("at_most: 1 T^2 s}", "at_most: 1 T^2 s}\nsampler: slsqp")
    scene = scene.replace("static: {}", "static: {tolerance: 1.0e-14, max_steps: 200}")
    found = load_goal(written(tmp_path, study, scene))
    params: dict[str, float] = {}
    for knob in found.knobs:
        params |= knob.begun(found.scene)
    params = {name: value + 0.01 * abs(value) for name, value in params.items()}
    ranges: Any = distributions(found.knobs)

    def scene_at(values: dict[str, float]) -> Scene:
        return made(found.scene, found.knobs, values)

    places = [place for knob in found.knobs for place in knob.places]
    near = [stencil(params, name, space) for name, space in ranges.items()]
    derived = values_and_slopes(scene_at, places, params, near, found.measures, tmp_path)
    given = {at: (one.value, one.slope) for at, one in derived.items()}
    for k, name in enumerate(params):
        h = 2e-4 * (ranges[name].high - ranges[name].low)
        sides = []
        for steps in (1.0, -1.0, 0.5, -0.5):
            near = scene_at({**params, name: params[name] + steps * h})
            answer = Answer(near, settled(near))
            sides.append(
                {at: of.of_answer(answer, at, tmp_path) for at, of in found.measures.items()}
            )
        for at, (_, slope) in given.items():
            values = [one[at] for one in sides]
            coarse = (values[0] - values[1]) / (2.0 * h)
            fine = (values[2] - values[3]) / h
            size = np.abs(slope).max()
            assert slope[k] == pytest.approx((4.0 * fine - coarse) / 3.0, abs=1e-8 * size), at


def settled(scene: Scene) -> Result:
    """The result of an equilibrium whose steps went on until they were rounding."""
    result, found = at_rest(scene, None, None)
    energy = found.energy
    assert isinstance(energy, Energy)
    with one_blas_thread():
        point = refined(energy, found.point, enough=0.0)
    return result_of(energy.model, replace(found, point=point), result.seconds)


def test_differences_stay_within_the_bounds(tmp_path: Path) -> None:
    """At either bound they are one-sided: the derivatives of B^2 by B, exact for a parabola; no scene is beyond."""
    found = load_goal(written(tmp_path, STUDY.replace("sampler: tpe\n", "")))
    ranges: Any = distributions(found.knobs)
    (name,) = ranges
    asked: list[float] = []

    def scene_at(values: dict[str, float]) -> Scene:
        asked.append(values[name])
        return made(found.scene, found.knobs, values)

    places = [place for knob in found.knobs for place in knob.places]
    measures = {"energy": validate(Measure, {"field_energy": {}})}
    for value in (1.0, 4.0, 8.0):
        params = {name: value}
        near = [stencil(params, name, ranges[name])]
        given = values_and_slopes(scene_at, places, params, near, measures, tmp_path)
        assert given["energy"].slope == pytest.approx([2e-6 * value], rel=1e-9)
    assert (min(asked), max(asked)) == (1.0, 8.0)


@pytest.mark.parametrize(
    ("old", "new", "at"),
    [
        ("field.uniform[2]", "field.unifrom[2]", "study.yaml:4: vary.numbers[0].of"),
        ("trials: 6", "trials: 6\nprune: true", "study.yaml:8: prune"),
        (
            "trials: 6",
            "subject_to:\n  - {strain: {}, at_most: 1 mm}\ntrials: 6",
            "study.yaml:8: subject_to[0].at_most",
        ),
        (
            "maximize: {displacement: {of: tip, along: [0, 0, 1]}}",
            "target: {displacement: {of: tip}, value: 3 mT}",
            "study.yaml:6: goal[0].target.value",
        ),
    ],
)
def test_errors_name_the_line_of_the_study(old: str, new: str, at: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        load_goal(written(tmp_path, STUDY.replace(old, new)))
    assert at in str(told.value)


RAISED = """\
scene: scene.yaml
vary:
  magnetization: {}
  numbers:
    - {of: "field.uniform[1]", min: -5 mT, max: 5 mT}
    - {of: "field.uniform[2]", min: 0 mT, max: 8 mT}
goal:
  maximize: {position: {of: tip, along: [0, 0.6, 0.8]}}
subject_to:
  - {largest_field: {}, at_most: 6 mT}
trials: 14
"""


def test_without_a_sampler_it_goes_along_derivatives(tmp_path: Path) -> None:
    """Farther in 14 trials than TPE in 20, within the bound; resumed; and what has none is searched by TPE."""
    scene = SCENE.replace("[0, 0, 0]", "[1, 0, 0]")
    (tmp_path / "tpe").mkdir()
    (tmp_path / "own").mkdir()
    by_chance = searched(tmp_path / "tpe", RAISED + "sampler: tpe\n", scene, trials=20)
    first = searched(tmp_path / "own", RAISED, scene, trials=3)
    assert first.trials == 3
    assert (first.sampler, first.why_sampler) == ("slsqp", "goal and constraints have derivatives")
    out = tmp_path / "own/out"
    kept = optuna.load_study(study_name="study", storage=f"sqlite:///{out}/study.db")
    kept.enqueue_trial(dict(kept.trials[1].params))  # as a session that is killed leaves it
    found = searched(tmp_path / "own", RAISED, scene)
    assert found.values[:3] == first.values
    tip = run(out / "best.yaml").tip
    assert tip is not None
    assert found.best is not None
    assert found.best["values"] == [pytest.approx(0.6 * tip[1] + 0.8 * tip[2], rel=1e-6)]
    study = load_goal(tmp_path / "own/study.yaml")
    for trial in kept.trials[-2:]:
        if trial.values is not None:
            there = run(made(study.scene, study.knobs, trial.params)).tip
            assert there is not None
            expected = 1e3 * (0.6 * there[1] + 0.8 * there[2])
            assert trial.values == [pytest.approx(expected, rel=1e-6)]
    assert found.best is not None
    assert by_chance.best is not None
    assert found.best["feasible"]
    assert found.best["values"][0] > 1.1 * by_chance.best["values"][0]
    rough = RAISED.replace("largest_field: {}, at_most: 6 mT", "strain: {}, at_most: 1")
    study = load_goal(written(tmp_path, rough, scene))
    assert study.sampler == "tpe"
    assert study.why_sampler == "subject_to[0] has none"


def test_steps_along_derivatives_go_on_where_they_ended(tmp_path: Path) -> None:
    """A search that is ended twice makes the trials of one that is not, to the last bit, and none again: nor the one that was killed."""
    scene = SCENE.replace("[0, 0, 0]", "[1, 0, 0]")
    for name in ("whole", "ended"):
        (tmp_path / name).mkdir()
    whole = searched(tmp_path / "whole", RAISED, scene, trials=7)
    for count in (2, 3):
        assert searched(tmp_path / "ended", RAISED, scene, trials=count).trials == count
    kept = optuna.load_study(study_name="study", storage=f"sqlite:///{tmp_path}/ended/out/study.db")
    kept.ask()  # it runs as its process is killed
    found = searched(tmp_path / "ended", RAISED, scene, trials=7)
    assert found.values == whole.values
    assert len(set(map(str, found.values))) == 7


def test_noise_about_the_best_is_told(tmp_path: Path) -> None:
    """A block that falls on the ground: designs that are all but the best one end all but where it does; resumed, nothing is run again."""
    effects = {"gravity": {}, "ground": {"point": [0.0, 0.0, -0.1e-3]}, "damping": {"rate": 10.0}}
    solver = {"dynamic": {"duration": 0.01, "output_every": 2.5e-3}}
    scene = moving_scene(block((2e-3, 2e-3, 2e-3)), effects, shear=SOFT, solver=solver)
    scene.save(tmp_path / "scene.yaml")
    (tmp_path / "study.yaml").write_text(
        "scene: scene.yaml\n"
        "vary: {numbers: [{of: effects.damping.rate, min: 1 1/s, max: 50 1/s}]}\n"
        "goal: {maximize: {travel: {of: body, along: [0, 0, 1]}}}\ntrials: 2\n"
    )
    out = tmp_path / "out"
    found = magmpm.design(tmp_path / "study.yaml", folder=out, progress=False)
    assert isinstance(found, GoalReport)
    assert found.scatter is not None
    assert len(found.scatter["values"]) == 4
    apart = spread(found)
    assert apart is not None
    assert apart < 1e-3 * abs(found.best["values"][0]) if found.best else False
    before = sorted(path.name for path in out.iterdir())
    again = magmpm.design(tmp_path / "study.yaml", folder=out, progress=False)
    assert isinstance(again, GoalReport)
    assert again.scatter == found.scatter
    assert sorted(path.name for path in out.iterdir()) == before


def test_a_process_that_ends_is_a_failed_trial(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "import os\n\n\ndef reach(result):\n"
        "    if result.field[2] > 4e-3:\n        os._exit(1)\n    return result.tip[2]\n"
    )
    study = STUDY.replace("{displacement: {of: tip, along: [0, 0, 1]}}", "{python: own.py:reach}")
    found = searched(tmp_path, study, workers=2)
    assert found.trials == 6
    assert found.failed
    told = {one["why"] for one in found.failed}
    assert told == {"the process that ran it ended with status 1"}
    for one in found.failed:  # no other trial goes with it
        assert next(iter(one["params"].values())) > 4e-3


def test_what_comes_nearest_to_bounds_that_nothing_keeps_is_told(tmp_path: Path) -> None:
    """With its unit, and by how much it misses each; of trials that were not run, the least of what is known of them."""
    bounds = (
        "subject_to: [{largest_field: {}, at_least: 9 mT}, {strain: {}, at_most: 2}]\ntrials: 3"
    )
    found = searched(tmp_path, STUDY.replace("trials: 6", bounds))
    assert found.best is None
    assert found.skipped == 3
    said = text(found)
    assert f"nearest to the constraints is trial {found.nearest}" in said
    field, strain = found.limits
    assert strain["value"] == ""
    tried = optuna.load_study(study_name="study", storage=f"sqlite:///{tmp_path}/out/study.db")
    least = max(trial.params["field.uniform[2] (mT)"] for trial in tried.trials)
    assert float(field["value"].removesuffix(" mT")) == pytest.approx(least, rel=1e-3)
    assert field["missed"] == f", missed by {significant(9.0 - least, 4)} mT"
    assert f"largest_field: {field['value']} (at least 9.000 mT){field['missed']}" in said
    bounds = "subject_to: [{displacement: {of: tip, along: [0, 0, 1]}, at_least: 9 mm}]\ntrials: 3"
    folder = tmp_path / "run"
    folder.mkdir()
    found = searched(folder, STUDY.replace("trials: 6", bounds))
    assert found.best is not None
    assert not found.best["feasible"]
    missed = 9.0 - 1e3 * found.best["measures"]["subject_to[0]"]
    assert f"(at least 9.000 mm), missed by {significant(missed, 4)} mm" in text(found)


def test_a_trial_keeps_the_measures_that_are_known(tmp_path: Path) -> None:
    """One that gives no number fails it, by its name."""
    (tmp_path / "own.py").write_text("def lost(result):\n    return float('nan')\n")
    bounds = "subject_to: [{strain: {}, at_most: 2}, {python: own.py:lost, at_most: 1}]\ntrials: 1"
    found = searched(tmp_path, STUDY.replace("trials: 6", bounds))
    (failed,) = found.failed
    assert "subject_to[1].python: it returned nan" in failed["why"]
    assert failed["measures"]["subject_to[0]"] > 0.0
    assert failed["measures"]["goal[0].maximize"] > 0.0


def test_segments_keep_their_sum_and_change_their_order(tmp_path: Path) -> None:
    """As in a study of shapes: lengths travel with their segments, and all that differ are shifted alike until they meet a bound."""
    third = "      - magnetization: [0, 0, 1]\n"
    scene = SCENE.replace("[0, 0, 0]\n", f"[0, 0, 0]\n{third}")
    ways = "  length: {min: 4 mm, max: 12 mm}\n  order: {}\n  magnetization: {only: [segment 3]}\n"
    study = STUDY.replace("vary:\n", f"vary:\n{ways}").replace("trials: 6", "trials: 3")
    found = load_goal(written(tmp_path, study.replace("sampler: tpe\n", ""), scene))
    assert found.sampler == "tpe"
    assert [found.begun[f"segment_{k}_length_mm"] for k in (1, 2, 3)] == pytest.approx([20 / 3] * 3)
    lengths = dict(
        zip((f"segment_{k}_length_mm" for k in (1, 2, 3)), (12.0, 4.0, 9.0), strict=True)
    )
    turned = made(found.scene, found.knobs, {**found.begun, **lengths, "order": "PMM"})
    assert turned.body.catheter is not None
    assert turned.body.catheter.segment_lengths() == pytest.approx([4e-3, 9.5e-3, 6.5e-3])
    assert [region.magnetization for region in turned.regions()] == [
        (0, 0, 0),
        (1, 0, 0),
        (0, 0, 1),
    ]
    report = searched(tmp_path, study, scene)
    assert report.best is not None
    assert report.tied == {}
    best = magmpm.load_scene(tmp_path / "out" / "best.yaml")
    assert best.body.catheter is not None
    assert sum(best.body.catheter.segment_lengths()) == pytest.approx(20e-3, rel=1e-12)
    whole = SCENE.replace("[0, 0, 0]", "[1, 0, 0]")
    with pytest.raises(InputError, match=r"study\.yaml:3: vary\.order.*\n.*an order needs"):
        load_goal(written(tmp_path, STUDY.replace("vary:\n", "vary:\n  order: {}\n"), whole))


def test_what_a_file_leaves_out_may_be_chosen(tmp_path: Path) -> None:
    """Null among choices: the key's default, or nothing, here no gravity, which the best design does without."""
    study = STUDY.replace(
        '"field.uniform[2]", min: 1 mT, max: 8 mT', "effects.gravity, choices: [null, {}]"
    )
    found = searched(tmp_path, study)
    assert found.best is not None
    assert found.best["params"] == {"effects.gravity": None}
    assert found.begun == {"effects.gravity": None}
    assert "effects.gravity = null" in text(found)
    assert magmpm.load_scene(tmp_path / "out" / "best.yaml").effects.gravity is None
    with pytest.raises(InputError, match="must have a value"):
        load_goal(written(tmp_path, STUDY + "seed:\n"))


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("field.uniform[2]", "field.unifrom[2]", "did you mean field.uniform[2]"),
        ("min: 1 mT", "min: 1 mm", "must have the unit of min"),
        ("min: 1 mT, max: 8 mT", "min: 1 mT, max: 90000 mT", "the scene refuses it"),
        (
            '"field.uniform[2]", min: 1 mT, max: 8 mT',
            "materials.m.shear_modulus, min: -5 kPa, max: 10 kPa",
            'materials.m.shear_modulus: received "-5.0 kPa"; must be greater than 0 kPa',
        ),
        ('"field.uniform[2]", min', "name, min", "must be an address of a number"),
        ("of: tip", "of: nose", "must be one of body, tip, segment 1, segment 2"),
        ("min: 1 mT, max: 8 mT", "min: 8 mT, max: 1 mT", "min must be less than max"),
        ("min: 1 mT, max: 8 mT", "min: 1 mT", "must have min and max"),
        ("min: 1 mT, max: 8 mT", "direction: {}", "an address of three numbers"),
        (
            '"field.uniform[2]", min: 1 mT, max: 8 mT',
            "field.uniform, direction: {at_most: 1 deg}",
            "in a plane",
        ),
        ("min: 1 mT, max: 8 mT", "within: 8 mT", "an address of three numbers"),
        ("min: 1 mT, max: 8 mT", "direction: {}, turned_about: [0, 0, 1]", "list of directions"),
        ('"field.uniform[2]", min: 1 mT, max: 8 mT', "field.uniform, within: -8 mT", "above 0"),
        ('"field.uniform[2]", min: 1 mT, max: 8 mT', "field.uniform, within: 8 mm", "refuses it"),
        ("maximize: {", "largest: {", "largest"),
        ("trials: 6", "trials: 6\nprune: true", "only motions are pruned"),
        (
            "sampler: tpe",
            "subject_to: [{distance: {between: [[1 mm, 0 mm, 0 mm], [0 mm, 0 mm, 0 mm]]}, at_most: 1 mm}]",
            "one of the two must be of the body",
        ),
        (
            '"field.uniform[2]", min: 1 mT, max: 8 mT}',
            '"field.uniform[2]", min: 1 mT, max: 8 mT}\n    - {of: field.uniform, within: 8 mT}',
            "is varied twice",
        ),
        (
            "sampler: tpe",
            "subject_to: [{largest_field: {}, at_least: 3 mT, at_most: 2 mT}]",
            "at_least must be below at_most",
        ),
        ("sampler: tpe", "sampler: newton", "sampler must be one of"),
        (
            "sampler: tpe",
            "sampler: slsqp\nsubject_to: [{strain: {}, at_most: 3}]",
            "has none",
        ),
        ("trials: 6", "subject_to: [{strain: {}, at_most: 3 mm}]", "plain number"),
        (
            "trials: 6",
            "subject_to: [{contact_force: {with: walls}, at_most: 3 mN}]",
            "subject_to[0].with: received 'walls'",
        ),
        ("trials: 6", "subject_to: [{largest_field: {}, at_most: 3}]", "needs a unit"),
        (
            "vary:",
            "vary:\n  length: {min: 12 mm, max: 14 mm}",
            "must sum to the body's length, 20 mm",
        ),
        ("vary:", "vary:\n  length: {min: 4, max: 14}", "a length needs a unit"),
        (
            '"field.uniform[2]", min: 1 mT, max: 8 mT}',
            "body.catheter.length, min: 10 mm, max: 30 mm}\n  length: {min: 4 mm, max: 14 mm}",
            "is varied twice, by length as well",
        ),
        ("trials: 6", "subject_to: [{field_energy: {}, at_most: 3}]", "needs a unit"),
        ("trials: 6", "subject_to: [{magnetized_volume: {}, at_most: 3}]", "needs a unit"),
        ("min: 1 mT, max: 8 mT", "min: 1, max: 8", "a flux density needs a unit"),
        ("min: 1 mT, max: 8 mT", "choices: [1 mT, 2]", "a flux density needs a unit"),
        ('"field.uniform[2]", min: 1 mT, max: 8 mT', "field.uniform, within: 8", "needs a unit"),
        (
            '"field.uniform[2]", min: 1 mT, max: 8 mT',
            "effects.gravity, choices: [{}, {acceleration: [0, 0, -9]}]",
            'such as "9.81 m/s^2"',
        ),
        ("{displacement: {of: tip, along: [0, 0, 1]}}", "{python: own.py:reach}", "no file"),
    ],
)
def test_wrong_studies_are_refused(tmp_path: Path, before: str, after: str, told: str) -> None:
    assert before in STUDY
    with pytest.raises(InputError, match=r"study\.yaml") as error:
        load_goal(written(tmp_path, STUDY.replace(before, after)))
    assert told in str(error.value)


def test_a_motion_that_does_worse_than_others_is_ended(tmp_path: Path) -> None:
    """Blocks slide down slopes that trials choose; half of the later ones are pruned, and none that is the best so far."""
    scene = moving_scene(
        block((2e-3, 2e-3, 2e-3)),
        {"gravity": {"acceleration": [0.5, 0.0, -9.81]}, "ground": {"point": [0.0, 0.0, 0.0]}},
        shear=SOFT,
        solver={"dynamic": {"duration": 0.005, "output_every": 5e-4}},
    )
    scene.save(tmp_path / "scene.yaml")
    (tmp_path / "study.yaml").write_text(
        "scene: scene.yaml\n"
        "vary: {numbers: [{of: 'effects.gravity.acceleration[0]', min: 0 m/s^2, max: 2 m/s^2}]}\n"
        "goal: {maximize: {travel: {along: [1, 0, 0]}}}\n"
        "prune: true\nsampler: random\ntrials: 12\n"
    )
    found = magmpm.design(tmp_path / "study.yaml", folder=tmp_path / "out", progress=False)
    assert isinstance(found, GoalReport)
    assert found.pruned >= 2
    assert found.best is not None
    way = 0.5 * found.best["params"]["effects.gravity.acceleration[0] (m/s^2)"] * 0.005**2
    assert found.best["values"][0] == pytest.approx(way, rel=0.01)


def test_a_function_of_the_whole_motion_may_be_pruned(tmp_path: Path) -> None:
    """Of a motion that still runs it raises: it says nothing yet, and the trial goes on."""
    scene = moving_scene(
        block((2e-3, 2e-3, 2e-3)),
        {"gravity": {}},
        shear=SOFT,
        solver={"dynamic": {"duration": 0.002, "output_every": 2e-4}},
    )
    scene.save(tmp_path / "scene.yaml")
    (tmp_path / "own.py").write_text(
        "def low(motion):\n    return motion[10].position[:, 2].min()\n"
    )
    (tmp_path / "study.yaml").write_text(
        "scene: scene.yaml\n"
        "vary: {numbers: [{of: 'effects.gravity.acceleration[0]', min: 0 m/s^2, max: 2 m/s^2}]}\n"
        "goal: {minimize: {python: own.py:low}}\nprune: true\nsampler: random\ntrials: 2\n"
    )
    found = magmpm.design(tmp_path / "study.yaml", folder=tmp_path / "out", progress=False)
    assert isinstance(found, GoalReport)
    assert found.failed == []
    assert None not in found.values


def test_commands_print_one_json_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from magmpm.cli.command import main

    study = written(tmp_path)
    out = str(tmp_path / "out")
    assert main(["design", str(study), "--trials", "2", "--out", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trials"] == 2
    for option in (["--trials", "0"], ["--workers", "0"], ["--time-limit", "9"]):
        assert main(["design", str(study), "--out", out, *option]) == 2
        assert f"{option[0]}: received" in capsys.readouterr().err
    shutil.rmtree(out)
    told = ["sweep", str(tmp_path / "scene.yaml"), "--set", "field.uniform[2]=1 mT,2 mT", "--set"]
    assert main([*told, "effects.gravity=null,{}", "--workers", "1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["effects.gravity"] for row in rows] == [None, {}] * 2
    assert main(["sweep", str(tmp_path / "scene.yaml"), "--set", "field.uniform[2]"]) == 2
    assert "ADDRESS=V1,V2" in capsys.readouterr().err
    assert main([*told, "field.uniform[2]=4 mT"]) == 2
    assert "each of them once" in capsys.readouterr().err
    assert main([*told[:3], "field.uniform[2]=1 mT,2", "--json"]) == 2
    assert "field.uniform[2]: received 2; a flux density needs a unit" in capsys.readouterr().err
    assert main([*told[:4], "--measure", "{position: {of: tip}"]) == 2
    assert "settings in brackets that close" in capsys.readouterr().err
