"""What a scene should name, by its rod: an effect that matters is told, one that does not is not, and what rods do not have stays."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from reference.scenes import rod_scene

from magmpm.rod import advice
from magmpm.rod.advice import allowed_error, judge, worth_naming
from magmpm.rod.cosserat import solve_rod
from magmpm.rod.shifts import RodAnswers
from magmpm.scene import load_scene

FIELD, DOWN = (0.0, 0.0, 2e-3), (0.0, 0.0, -9.81)


def test_a_weight_that_matters_is_worth_naming() -> None:
    """The shift is what two rods differ by, and more than the error meant, a hundredth of the length; in a stiff body it is less."""
    scene = rod_scene(field=FIELD)
    told = {one.effect: one for one in worth_naming(scene)}
    assert set(told) == {"gravity"}
    heavy = rod_scene(field=FIELD, gravity=DOWN)
    apart = abs(solve_rod(heavy).position[-1, 2] - solve_rod(scene).position[-1, 2])
    assert told["gravity"].shift == pytest.approx(apart, rel=0.2)
    assert apart > allowed_error(scene)
    assert worth_naming(rod_scene(field=FIELD, shear=100 * 120e3)) == []


def test_an_effect_that_rods_do_not_have_is_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is named stays, and nothing is said of how much it does."""
    scene = rod_scene(field=FIELD, gravity=DOWN)
    monkeypatch.setattr(advice, "IN_RODS", advice.IN_RODS - {"gravity"})
    found = judge(scene, "gravity", RodAnswers(scene), allowed_error(scene))
    assert (found.shift, found.uncertainty, found.advice) == (None, None, "keep")
    assert "not estimated" in found.why


def test_a_section_of_one_plane_is_a_section() -> None:
    """In plane strain all particles have one y: nothing is divided by that width, and the shift is not absurd."""
    scene = load_scene(Path(__file__).parents[3] / "data/scenes/gallery/folding_strip.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told = judge(scene, "magnetic_interaction", RodAnswers(scene, quick=True), allowed_error(scene))
    assert told.shift is None
    assert told.why == "not estimated: the rod's answer flies apart"
