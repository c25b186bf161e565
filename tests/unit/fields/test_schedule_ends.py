"""The end of a schedule is the end of its last part, and the field then stays constant: statics uses that moment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from magmpm.fields.schedule import end_time, places
from magmpm.fields.sources import FieldSource

STARTED_LATE: dict[str, tuple[dict[str, Any], float]] = {
    "ramp": ({"ramp": {"start": 0.3, "duration": 0.2, "end": 0.5}}, 0.5),
    "rotation": ({"rotation": {"axis": (0, 1, 0), "frequency": 2.0, "start": 1.0, "turns": 0.75}}, 1.375),
    "rotation the other way": ({"rotation": {"axis": (0, 1, 0), "frequency": -2.0, "start": 1.0, "turns": 0.75}}, 1.375),
    "oscillation": ({"oscillation": {"frequency": 5.0, "amplitude": 2.0, "mean": 1.0, "start": 0.1, "cycles": 1.25}}, 0.35),
    "keyframes": ({"keyframes": [{"time": 0, "strength": 0}, {"time": 0.7, "strength": 1}]}, 0.7),
}


def field(over: dict[str, Any]) -> FieldSource:
    return FieldSource.model_validate({"uniform": (1e-3, 0, 1e-2), "over_time": over})


@pytest.mark.parametrize("part", STARTED_LATE)
def test_the_end_counts_from_the_start_of_each_part(part: str) -> None:
    """Just before the end the field still changes, after it no more."""
    over, end = STARTED_LATE[part]
    given = field(over)
    assert end_time(given) == pytest.approx(end, rel=1e-12)
    before, at, after, long_after = places(given, np.array([end - 0.01, end, end + 0.01, 1e5]))["uniform"]
    assert np.abs(before - at).max() > 1e-5  # T
    np.testing.assert_allclose([after, long_after], [at, at], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(places(given)["uniform"][0], places(given, np.array([end_time(given)]))["uniform"][0])


def test_the_last_part_to_end_counts() -> None:
    parts = [over for over, _ in STARTED_LATE.values()]
    assert end_time(field({**parts[0], **parts[1], **parts[3]})) == pytest.approx(1.375)
    assert end_time(FieldSource.model_validate({"uniform": (0, 0, 1e-2)})) == 0.0
