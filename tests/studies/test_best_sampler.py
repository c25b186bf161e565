"""A study whose file names no sampler gets the one that suits what it asks, and keeps the one by which it was begun."""

from __future__ import annotations

from pathlib import Path

import pytest

from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study
from tests.studies.rod_solve import SCENE, STUDY, differentiate, solve, write_study

UNNAMED = STUDY.replace("sampler: random\n", "")
PLAIN = SCENE.replace("      - magnetization: [0, 1, 0]\n", "      - {}\n")


@pytest.mark.parametrize(
    ("text", "scene", "sampler", "why"),
    [
        (UNNAMED, SCENE, "gauss-newton", "derivatives by all that varies"),
        (UNNAMED + "stability: {margin: 0.1}\nrobust: {direction: 5 deg}\n", SCENE, "gauss-newton", "derivatives"),
        (UNNAMED.replace("magnetization: {}", "magnetization: {}\n  order: {}"), PLAIN, "tpe", "can't choose an order"),
        (UNNAMED.replace("{}", "{}\n  field: {max: 9 mT}") + "minimize: [rms, largest_field]\n", SCENE, "tpe", "one objective"),
        (UNNAMED, SCENE + "solver: {dynamic: {duration: 0.1 s}}\n", "tpe", "the scene is a motion"),
    ],
)
def test_the_sampler_follows_from_what_the_study_asks(text: str, scene: str, sampler: str, why: str, tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, text, scene))
    assert study.sampler == sampler
    assert why in str(study.why_sampler)


def test_a_named_sampler_is_taken_without_a_word(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, STUDY))
    assert (study.sampler, study.why_sampler) == ("random", None)
    unnamed = load_study(write_study(tmp_path / "unnamed", UNNAMED)).changed(sampler="cmaes")
    assert (unnamed.sampler, unnamed.why_sampler) == ("cmaes", None)


def test_a_study_that_was_begun_goes_on_with_its_sampler(tmp_path: Path) -> None:
    """Files without a sampler meant tpe once: their studies are resumed as what they are."""
    named = write_study(tmp_path, STUDY.replace("random", "tpe"))
    whole = run_study(load_study(named), solve=solve, out=tmp_path / "whole")
    run_study(load_study(named), solve=solve, out=tmp_path / "out", trials=4)
    named.write_text(UNNAMED)
    report = run_study(load_study(named), solve=solve, differentiate=differentiate, out=tmp_path / "out")
    assert (report.sampler, report.why_sampler) == ("tpe", "the study was begun with it")
    assert report.rms_m == whole.rms_m


def test_without_derivatives_tpe(tmp_path: Path) -> None:
    report = run_study(load_study(write_study(tmp_path, UNNAMED)), solve=solve, out=tmp_path / "out", trials=2)
    assert report.sampler == "tpe"
    assert "differentiates" in str(report.why_sampler)


def test_the_report_says_which_and_why(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, UNNAMED))
    report = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out", trials=2)
    assert report.summary()["why_sampler"] == study.why_sampler
