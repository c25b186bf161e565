"""Bounds of errors by their formulas: orders, bounds of grids in between, errors foretold."""

from __future__ import annotations

import pytest

from magmpm.statics.error_estimate import ORDER, SAFETY, WARY, bound, foretold, observed_order


def test_the_order_of_errors_that_fall_as_h_squared_is_two() -> None:
    assert observed_order({2: 1.0, 4: 0.25}) == pytest.approx(2.0)
    assert observed_order({2: 1.0}) is None


def test_a_finer_grids_error_is_foretold_by_the_last_order_shown_four_at_most_else_two() -> None:
    assert foretold({2: 1.0, 4: 0.25}, 8) == pytest.approx(1 / 16)
    assert foretold({2: 1.0, 3: 0.9, 4: 0.225}, 8) == pytest.approx(0.225 / 16)
    assert foretold({2: 1.0}, 4) == pytest.approx(1 / 4)


def test_a_bound_counts_what_a_grid_in_between_tells() -> None:
    """At order 1.5, 2^-1.5 of an error is left on twice the cells, and grid 3 leaves (3/4)^1.5 of its own on grid 4."""
    left = 0.5**ORDER
    assert bound(2, 4, 1.0, {}) == pytest.approx(SAFETY[2] / (1 - left))
    own = 10.0 * 0.75**ORDER / (1 - 0.75**ORDER)
    assert bound(2, 4, 1.0, {3: 10.0}) == pytest.approx(1.0 + WARY * own)
    assert bound(4, 6, 1.0, {}) == pytest.approx(1 / (1 - (4 / 6) ** ORDER))
