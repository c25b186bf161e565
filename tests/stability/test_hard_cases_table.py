"""Every hard case that `magmpm stability` runs stays within its bound."""

from __future__ import annotations

import json

import pytest

from magmpm.bodies.catheter import Catheter
from magmpm.cli import main
from magmpm.statics import equilibrium, newton
from magmpm.studies.hard_cases import CASES, Case, run_cases
from magmpm.studies.hard_cases.controls import control_of

PARAMETERS = [pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else []) for case in CASES]


@pytest.mark.parametrize("case", PARAMETERS)
def test_hard_case(case: Case) -> None:
    outcome = case.run()
    assert outcome.passed, f"{outcome.quantity}: {outcome.measure:.3g}, at most {outcome.bound:.3g}; {outcome.reason}"


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_control_fails(case: Case) -> None:
    """With the remedy switched off that it is about, a case fails: otherwise it would tell nothing. The switch is back afterwards."""
    outcome = case.run_control()
    assert not outcome.passed, f"{outcome.control}: {outcome.measure:.3g}, at most {outcome.bound:.3g} all the same"


def test_switches_go_back() -> None:
    """What a control replaces is there again after it, also after an error."""
    replaced = ((newton, "_search"), (equilibrium, "solve_rod"), (Catheter, "discretize"))
    before = [(owner, name, getattr(owner, name)) for owner, name in replaced]
    [one] = [case for case in CASES if case.name == "thin tube, K/G = 100"]
    for begun in ("needle, L/D 200", "8 offsets", "antiparallel field through buckling"):
        with pytest.raises(ZeroDivisionError), control_of(begun).off():
            raise ZeroDivisionError
    assert all(getattr(owner, name) is value for owner, name, value in before)
    assert one.run().passed
    assert not one.run_control().passed
    assert one.run().passed


@pytest.mark.slow
def test_cases_in_two_processes() -> None:
    """They and their controls come back in their order, with the same numbers as in one process."""
    some = [case for case in CASES if case.name.startswith(("thin tube", "no load"))]
    for controls in (False, True):
        one, two = (run_cases(some, controls=controls, processes=count) for count in (1, 2))
        assert [o.name for o in one] == [o.name for o in two]
        assert [(o.measure, o.passed) for o in one] == [(o.measure, o.passed) for o in two]


def test_names_tell_cases_apart() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 40


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    """A table or one JSON object; exit status 0 if all pass, 3 if one fails, 2 for an unknown case."""
    quick = "no load, begun from a loaded neighbor"
    assert main(["stability", "--case", "LOADED NEIGHBOR", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [case["name"] for case in found["cases"]] == [quick]
    assert found["failed"] == []
    tube = "thin tube, K/G = 100"
    assert main(["stability", "--case", tube, "--controls", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [control["name"] for control in found["controls"]] == [f"{tube}, without"]
    assert found["passed_all_the_same"] == []
    assert main(["stability", "--case", "perpetual motion"]) == 2
    assert quick in capsys.readouterr().err

    [case] = [case for case in CASES if case.name == quick]
    object.__setattr__(case, "bound", -1.0)
    try:
        assert main(["stability", "--case", quick]) == 3
    finally:
        object.__setattr__(case, "bound", 1e-8)
    printed = capsys.readouterr()
    assert "FAILED" in printed.out
    assert case.weak in printed.out
    assert quick in printed.err
