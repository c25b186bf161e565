"""Shapes as goals and constraints, with all that goals may vary: what the shape was made with is found again."""

from pathlib import Path

import pytest
import yaml
from goal_study import SCENE, plain, searched, written

import magmpm
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import read_centreline, write_centreline
from magmpm.scene import Scene
from magmpm.studies.goals.goal_study import load_goal
from magmpm.studies.problem.shape_distance import root_mean_square

MAGNETIC = SCENE.replace("magnetization: [0, 0, 0]", "magnetization: [1, 0, 0.5]")
FOUND = """\
scene: scene.yaml
vary: {numbers: [NUMBER]}
goal: GOAL
trials: 8
"""


def study(number: str, goal: str) -> str:
    return FOUND.replace("NUMBER", number).replace("GOAL", goal)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With the shape of the scene: in 4 mT."""
    shape = magmpm.run(Scene.from_si(plain(MAGNETIC))).centreline
    write_centreline(tmp_path / "shape.csv", shape)
    return tmp_path


def test_a_target_shape_is_met_by_gauss_newton(folder: Path) -> None:
    """By one free direction, which studies with `match` don't vary alone: atan(1 / 2) from the axis."""
    number = '{of: "body.catheter.segments[1].magnetization", direction: {across: [0, -1, 0]}}'
    text = study(number, "{target: {shape: {centreline: shape.csv}, value: 0 mm}}")
    found = searched(folder, text, MAGNETIC.replace("[1, 0, 0.5]", "[1, 0, 0]"))
    assert found.sampler == "gauss-newton"
    assert found.best["values"][0] < 1e-7
    (angle,) = found.best["params"].values()
    assert angle == pytest.approx(26.565, abs=0.02)  # the table has steps of 1 nm


def test_the_weakest_field_that_keeps_a_shape(folder: Path) -> None:
    """The shape is as far as it may be. Deflections are nearly proportional to the field, of 4 mT where the shape was made."""
    text = study(
        '{of: "field.uniform[2]", min: 1 mT, max: 8 mT}',
        "{minimize: {largest_field: {}}}\nsubject_to: [{shape: {centreline: shape.csv}, at_most: 0.2 mm}]",
    )
    found = searched(folder, text, MAGNETIC)
    assert found.sampler == "slsqp"
    assert found.best["measures"]["subject_to[0]"] == pytest.approx(0.2e-3, rel=1e-3)
    target = read_centreline(folder / "shape.csv")
    bent = root_mean_square(target[:, 3:])
    assert found.best["values"][0] == pytest.approx(4e-3 * (1 - 0.2e-3 / bent), rel=0.02)


def test_a_thickness_among_choices_is_found_by_its_shape(folder: Path) -> None:
    text = study(
        "{of: body.catheter.diameter, choices: [3 mm, 4 mm, 5 mm]}",
        "{minimize: {shape: {centreline: shape.csv}}}",
    )
    found = searched(folder, text, MAGNETIC.replace("diameter: 4 mm", "diameter: 5 mm"))
    assert found.best["params"]["body.catheter.diameter"] == "4 mm"
    assert found.best["values"][0] < 1e-7


def test_a_shape_along_a_path_is_that_of_its_moment(folder: Path) -> None:
    """Half way up a ramp the field is half of the last one."""
    ramp = {"uniform": ["0 mT", "0 mT", "8 mT"], "over_time": {"ramp": {"duration": "1 s"}}}
    scene = {**plain(MAGNETIC), "field": ramp, "solver": {"quasi_static": {"steps": 4}}}
    text = study(
        "{of: materials.m.shear_modulus, min: 110 kPa, max: 150 kPa}",
        "{minimize: {shape: {centreline: shape.csv, at: 0.5 s}}}",
    )
    found = searched(folder, text, yaml.safe_dump(scene))
    assert found.best["values"][0] < 1e-6
    assert list(found.best["params"].values()) == pytest.approx([120.0], rel=1e-2)  # kPa


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (None, "shape.csv"),
        ("s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n30,30,0,0\n", "must not exceed the catheter's length"),
        ("s_mm,x_mm\n0,0\n", "must name the columns"),
    ],
    ids=["missing", "longer", "columns"],
)
def test_a_wrong_target_is_said(table: str | None, says: str, tmp_path: Path) -> None:
    if table is not None:
        (tmp_path / "shape.csv").write_text(table)
    text = study(
        '{of: "field.uniform[2]", min: 1 mT, max: 8 mT}',
        "{minimize: {shape: {centreline: shape.csv}}}",
    )
    with pytest.raises(InputError, match=says):
        load_goal(written(tmp_path, text, MAGNETIC))
