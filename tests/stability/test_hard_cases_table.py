"""Every hard case that `magmpm stability` runs stays within its bound; motions, with kernels of their own, in the long run."""

from __future__ import annotations

import json

import pytest

from magmpm.cli import main
from magmpm.studies.hard_cases import CASES, Case, run_cases

PARAMETERS = [pytest.param(one, id=one.name, marks=[pytest.mark.slow] if one.slow or not one.scene().static else []) for one in CASES]


@pytest.mark.parametrize("case", PARAMETERS)
def test_hard_case(case: Case) -> None:
    outcome = case.run()
    assert outcome.passed, f"{outcome.quantity}: {outcome.measure:.3g}, at most {outcome.bound:.3g}; {outcome.reason}"


@pytest.mark.slow
def test_cases_in_two_processes() -> None:
    """They come back in their order, with the same numbers as in one process."""
    some = [case for case in CASES if case.name.startswith(("thin tube", "no load"))]
    one, two = (run_cases(some, processes=count) for count in (1, 2))
    assert [(o.name, o.measure, o.passed) for o in one] == [(o.name, o.measure, o.passed) for o in two]


def test_names_tell_cases_apart() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 38


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    """A table or one JSON object; exit status 0 if all pass, 3 if one fails, 2 for an unknown case."""
    quick = "no load, begun from a loaded neighbor"
    assert main(["stability", "--case", "LOADED NEIGHBOR", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [case["name"] for case in found["cases"]] == [quick]
    assert found["failed"] == []
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
