"""Bounds of errors by their formulas: orders, bounds of grids in between and of coarser ones, errors foretold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magmpm.statics.error_estimate import SMOOTH, WARY, observed_order

PLAIN = replace(SMOOTH, order=1.0, safety={}, sharpest=2.0)


def test_the_order_of_errors_that_fall_as_h_squared_is_two() -> None:
    assert observed_order({2: 1.0, 4: 0.25}) == pytest.approx(2.0)
    assert observed_order({2: 1.0}) is None


def test_a_finer_grids_error_is_foretold_by_the_order_shown() -> None:
    assert SMOOTH.foretold({2: 1.0, 4: 0.25}, 8) == pytest.approx(1 / 16)


def test_a_bound_counts_what_other_grids_tell() -> None:
    """At order 1 half of an error is left on twice the cells. Grid 3 leaves 3/4 of its own on 4; grid 2, at order 2, tells 4/9 of its."""
    assert PLAIN.bound(2, 4, 1.0, {}) == pytest.approx(2.0)
    assert PLAIN.bound(2, 4, 1.0, {3: 10.0}) == pytest.approx(1.0 + WARY * 30.0)
    assert PLAIN.bound(3, 4, 0.0, {2: 9.0}) == pytest.approx(4.0)
    assert replace(PLAIN, sharpest=np.inf).bound(3, 4, 0.0, {2: 9.0}) == 0.0
