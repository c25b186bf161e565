"""Warnings of a study before its first trial: that nothing moves the shape, or that the target can't tell its variables apart."""

from pathlib import Path

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, solve, write_study

from magmpm.errors import InputError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.search_space import SearchSpace
from magmpm.studies.search.well_posed import check_search, judge

STRAIGHT = SCENE.replace("[0 mT, 6 mT, 8 mT]", "[9 mT, 0 mT, 0 mT]")
ALONG = "\n".join("      - magnetization: [1, 0, 0]" if "- magnetization" in line else line for line in STRAIGHT.split("\n"))


def study_of(folder: Path, vary: str, scene: str = SCENE, points: int = 20):
    path = write_study(folder, STUDY.replace("\n  magnetization: {}", f" {vary}"), scene)
    s = np.linspace(0.0, 0.04, points + 1)
    write_centreline(folder / "target.csv", np.column_stack([s, 0.99 * s, 0.1 * s, 0 * s]))
    return load_study(path)


def test_a_good_study_has_nothing_to_say(tmp_path: Path) -> None:
    study = study_of(tmp_path, "{magnetization: {}}")
    assert check_search(study, SearchSpace.of(study)) == []
    found = judge(study, SearchSpace.of(study))
    assert found.freedom == found.seen == 10
    assert (found.moves > 1e-4).all(), "each turns the catheter by a radian's worth of some segment"


def test_nothing_that_varies_moves_the_shape(tmp_path: Path, told) -> None:
    """A field along a catheter that is magnetized along its axis bends nothing, whatever its remanence; it stretches less than counts."""
    study, out = study_of(tmp_path, "{remanence: {min: 10 mT, max: 10.1 mT}}", ALONG), tmp_path / "out"
    parts = ("probe.yaml: vary: received 1 variable that moves", "at most", "something must move the shape", "remedy")
    assert told("design", study.path, "--out", out, "--no-pictures", status=2, says=parts).out == ""
    assert not out.exists()


def test_more_variables_than_the_target_can_tell_apart(tmp_path: Path) -> None:
    """Two points beyond the base are six numbers, and ten angles vary: said with both numbers, and the study runs."""
    study, said = study_of(tmp_path, "{magnetization: {}}", points=2), []
    report = run_study(study, solve=solve, out=tmp_path / "out", trials=1, on_advice=said.extend)
    assert said == report.warnings
    assert len(said) == 1
    assert "10 numbers vary" in said[0]
    assert "2 points beyond the base tell 6 combinations of them apart" in said[0]


def test_a_field_and_directions_share_a_turn_only_if_all_turn(tmp_path: Path) -> None:
    """Field and magnetization may turn together about the axis, and the shape with them: the target tells all 13 numbers apart."""
    study = study_of(tmp_path, "{magnetization: {}, field: {max: 10 mT}}")
    found = judge(study, SearchSpace.of(study))
    assert found.freedom == 13
    assert 11 <= found.seen <= 13


@pytest.mark.parametrize(
    ("sampler", "extra", "said"),
    [
        ("gauss-newton", "", "gauss-newton differentiates equilibria, and the scene is a motion"),
        ("tpe", "minimize: [rms, largest_field]\nrobust: {direction: 5 deg}\n", "`robust` judges a design by one objective"),
        ("cmaes", "stability: {margin: 0.1}\n", "cmaes would learn from designs that `stability` refuses"),
    ],
)
def test_the_command_leaves_nothing_of_what_its_sampler_cannot_search(sampler: str, extra: str, said: str, tmp_path: Path, told) -> None:
    """With the sampler of the command line, too; the message names the study file."""
    study = study_of(tmp_path, "{magnetization: {}, field: {max: 10 mT}}").path
    study.write_text(study.read_text() + extra)
    if not extra:
        scene = tmp_path / "scene.yaml"
        scene.write_text(scene.read_text() + "\nsolver: {dynamic: {duration: 1 ms}}\n")
    out = tmp_path / "out"
    told("design", study, "--sampler", sampler, "--out", out, "--no-pictures", status=2, says=(said, "probe.yaml: "))
    assert not out.exists()


def test_orders_alone_have_no_derivatives_and_are_not_judged(tmp_path: Path) -> None:
    plain = "      - {}\n"
    last = [line for line in SCENE.split("\n") if "- magnetization" in line][-1] + "\n"
    study = study_of(tmp_path, "{order: {}}", SCENE.replace(last, plain))
    assert check_search(study, SearchSpace.of(study)) == []


def test_an_insertion_is_judged_at_its_depths() -> None:
    """Fields of their own at three depths: a variable moves the shapes that have it, and all numbers but few can be told apart."""
    from test_insertion import insertion

    found = insertion()
    seen = judge(found.study, found.space)
    assert seen.freedom == 15
    assert len(seen.moves) == 15
    assert (seen.moves > 1e-5).all()
    assert 12 <= seen.seen <= 15


def test_an_insertion_that_nothing_moves_is_refused() -> None:
    """Segments whose remanence alone varies, without a field: said before the first trial."""
    from dataclasses import replace

    from test_insertion import insertion

    from magmpm.studies.problem.variables import Vary, VaryRemanence

    found = insertion()
    assert found.study.scene.field.uniform == (0.0, 0.0, 0.0), "a remanence that varies needs a field to move anything"
    study = replace(found.study, vary=Vary(remanence=VaryRemanence(min=0.1, max=0.1001)), sampler="tpe")
    with pytest.raises(InputError, match="something must move the shape"):
        check_search(study, SearchSpace.of(study))
