"""A snapshot refuses what cannot be drawn; its colors and its scale bar follow rules."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference import bent_bodies

from magmpm.viz import style

BODY = bent_bodies.catheter(spacing=1e-3).body


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"body": replace(BODY, points=np.zeros((4, 2)))}, "Snapshot.body.points has shape"),
        ({"body": replace(BODY, points=np.zeros((0, 3)))}, "nothing to draw"),
        ({"target": np.zeros(3)}, "Snapshot.target has shape"),
        ({"body": replace(BODY, part=np.zeros(3, dtype=int))}, "one a particle"),
    ],
)
def test_wrong_shapes_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(bent_bodies.catheter(spacing=1e-3), **change)


def test_segments_get_different_colors_and_plain_ones_grey() -> None:
    colors = style.segment_colors(np.array([True, False, True, True, False]))
    assert np.array_equal(colors[1], style.rgb(style.UNMAGNETIZED))
    assert np.array_equal(colors[4], style.rgb(style.UNMAGNETIZED))
    assert len({tuple(c) for c in colors[[0, 2, 3]]}) == 3


@pytest.mark.parametrize(("length", "nice"), [(0.012, 0.01), (0.02, 0.02), (0.0199, 0.01), (0.0168, 0.01), (5.0, 5.0)])
def test_scale_bars_have_round_lengths(length: float, nice: float) -> None:
    assert style.nice_length(length) == pytest.approx(nice)
