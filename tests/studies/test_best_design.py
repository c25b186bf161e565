"""Which trial is the best one, and what is said where it is on the brink."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from magmpm.studies.engine.report import best_trial, describe, on_the_brink
from magmpm.viz.sheet.found import alarms


def trials(*pairs: tuple[float, float | None]) -> Any:
    """Feasible trials by rms (mm) and stability."""
    return [
        SimpleNamespace(
            number=k, values=[1e-3 * rms], params={}, user_attrs={"feasible": True, "rms_m": 1e-3 * rms, "stability": stability}
        )
        for k, (rms, stability) in enumerate(pairs)
    ]


@pytest.mark.parametrize(("pairs", "best"), [
    ([(0.30, 0.02), (0.32, 0.3), (0.31, 0.2)], 2),  # the nearest that is not on the brink
    ([(0.30, 0.02), (0.34, 0.9)], 0),  # costs 13 %
    ([(0.30, 0.02), (0.32, 0.05), (0.31, 0.04)], 1),  # all on it: the most stable
    ([(0.610, 0.065), (0.619, 0.107), (0.621, 0.398)], 2),  # of those not on it: 0.3 % of rms for four times the stability
    ([(0.511, 0.078), (0.537, 0.080)], 0),  # all on it: 5 % of rms is too much for so little
    ([(0.30, 0.2), (0.31, 0.9)], 0),  # stable enough: rms decides
    ([(0.30, None), (0.31, 0.9)], 0),  # not known: rms decides
])  # fmt: skip
def test_of_nearly_equal_designs_the_stable_one_is_the_best(pairs: list[tuple[float, float | None]], best: int) -> None:
    chosen = best_trial(trials(*pairs))
    assert chosen is not None
    assert chosen.number == best


def test_a_design_on_the_brink_is_told_with_its_depth() -> None:
    (trial,) = trials((0.3, 0.011))
    best = {**describe(trial), "insertion": [{"depth_m": 0.02, "stability": 0.5}, {"depth_m": 0.037, "stability": 0.011}]}
    (says,) = on_the_brink(best)
    assert "at 37 mm is 0.011" in says
    assert "on the brink" in str(alarms({"best": best, "body": {}, "warnings": [says]}))
    assert not on_the_brink({**best, "stability": 0.2})
    assert not on_the_brink(None)
