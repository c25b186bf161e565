"""Quadratic B-splines: those of SciPy, with an exact clamp.

Source: de Boor, A Practical Guide to Splines, chapters 9 to 11. Tolerances of 1e-15 to 1e-14 are a few rounding errors of numbers near
1."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.mpm_numpy import spline_matrix

from magmpm.bodies.grid import Grid, clamp_first_node, spline_slopes, spline_weights

inside = st.floats(0.0, 1.0)
def test_same_splines_as_scipy() -> None:
    """Cell i carries nodes i, i + 1, i + 2 of the grid's B-splines, node i centered on cell i - 1."""
    cells, h, origin = 5, 0.4, -1.0
    grid = Grid(np.full(3, origin), np.full(3, h), (cells, cells, cells))
    xi = np.linspace(0.01, 0.99, 7)
    for cell in range(cells):
        x = origin + h * (cell + xi)
        for ours, derivative in ((spline_weights(xi), 0), (spline_slopes(xi) / h, 1)):
            theirs = spline_matrix(x, origin, h, cells, derivative)
            np.testing.assert_allclose(ours, theirs[:, cell : cell + 3], rtol=0, atol=1e-14 / h)
            assert np.all(np.delete(theirs, [cell, cell + 1, cell + 2], axis=1) == 0)
    peak = spline_matrix(grid.node_coordinates(0)[1:-1], origin, h, cells)
    assert np.all(peak.argmax(axis=1) == np.arange(1, cells + 1)), ("a spline is largest at its node's coordinate")


def test_clamp_holds_the_face_exactly() -> None:
    """On the face every spline of the clamped cell is exactly 0, for any coefficients: no motion, bit for bit."""
    N, _ = clamp_first_node(spline_weights(np.array(0.0)), spline_slopes(np.array(0.0)))
    assert np.array_equal(N, np.zeros(3))


@given(st.tuples(*[st.floats(-1, 1)] * 2), inside)
def test_clamp_holds_nothing_but_the_face(c: tuple[float, float], xi: float) -> None:
    """Every spline function with value 0 on the face (c_0 = -c_1) is still representable, with the same values and slopes."""
    free = np.array([-c[0], c[0], c[1]])
    N, D = spline_weights(np.array(xi)), spline_slopes(np.array(xi))
    clamped, clamped_slope = clamp_first_node(N, D)
    assert clamped @ [c[0], c[1], 7.0] == pytest.approx(N @ free, abs=1e-15)
    assert clamped_slope @ [c[0], c[1], 7.0] == pytest.approx(D @ free, abs=4e-15)


def test_grid_refuses_a_point_outside_its_cell() -> None:
    """An index outside the grid would corrupt memory in a kernel."""
    grid = Grid(np.zeros(3), np.ones(3), (3, 3, 3))
    inside_cell = np.array([[1.25, 0.5, 2.75]])
    np.testing.assert_array_equal(grid.locate(inside_cell, np.array([[1, 0, 2]])), [[0.25, 0.5, 0.75]])
    with pytest.raises(ValueError, match="outside the cell"):
        grid.locate(inside_cell, np.array([[0, 0, 2]]))
    with pytest.raises(ValueError, match="outside the cell"):
        grid.locate(np.array([[3.5, 0.5, 0.5]]), np.array([[3, 0, 0]]))
