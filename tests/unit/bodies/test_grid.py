"""Grids: splines of cells and of runs between repeated knots are those of SciPy, with an exact clamp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.mpm_numpy import spline_matrix
from scipy.interpolate import BSpline

from magmpm.bodies.grid import (
    EVEN,
    LEAST_JOINT_DISTANCE_AT_REST,
    Grid,
    Knots,
    clamp_first_node,
    runs_along,
    spline_slopes,
    spline_weights,
)

inside = st.floats(0.0, 1.0)


def test_same_splines_as_scipy() -> None:
    """Cell i carries nodes i, i + 1, i + 2 of the grid's B-splines, node i centered on cell i - 1."""
    cells = 5
    h = 0.4
    origin = -1.0
    grid = Grid(np.full(3, origin), np.full(3, h), (cells, cells, cells))
    xi = np.linspace(0.01, 0.99, 7)
    for cell in range(cells):
        x = origin + h * (cell + xi)
        for ours, derivative in ((spline_weights(xi), 0), (spline_slopes(xi) / h, 1)):
            theirs = spline_matrix(x, origin, h, cells, derivative)
            np.testing.assert_allclose(ours, theirs[:, cell : cell + 3], rtol=0, atol=1e-14 / h)
            assert np.all(np.delete(theirs, [cell, cell + 1, cell + 2], axis=1) == 0)
    peak = spline_matrix(grid.node_coordinates(0)[1:-1], origin, h, cells)
    assert np.all(peak.argmax(axis=1) == np.arange(1, cells + 1)), (
        "a spline is largest at its node's coordinate"
    )


def test_clamp_holds_the_face_exactly() -> None:
    """On the face every spline of the clamped cell is exactly 0, for any coefficients: no motion, bit for bit."""
    N, _ = clamp_first_node(spline_weights(np.array(0.0)), spline_slopes(np.array(0.0)))
    assert np.array_equal(N, np.zeros(3))


@given(st.tuples(*[st.floats(-1, 1)] * 2), inside)
def test_clamp_holds_nothing_but_the_face(c: tuple[float, float], xi: float) -> None:
    """Every spline function with value 0 on the face (c_0 = -c_1) is still representable, with the same values and slopes."""
    free = np.array([-c[0], c[0], c[1]])
    N = spline_weights(np.array(xi))
    D = spline_slopes(np.array(xi))
    clamped, clamped_slope = clamp_first_node(N, D)
    assert clamped @ [c[0], c[1], 7.0] == pytest.approx(N @ free, abs=1e-15)
    assert clamped_slope @ [c[0], c[1], 7.0] == pytest.approx(D @ free, abs=4e-15)


def test_grid_refuses_a_point_outside_its_cell() -> None:
    """An index outside the grid would corrupt memory in a kernel."""
    grid = Grid(np.zeros(3), np.ones(3), (3, 3, 3))
    inside_cell = np.array([[1.25, 0.5, 2.75]])
    np.testing.assert_array_equal(
        grid.locate(inside_cell, np.array([[1, 0, 2]])), [[0.25, 0.5, 0.75]]
    )
    with pytest.raises(ValueError, match="outside the cell"):
        grid.locate(inside_cell, np.array([[0, 0, 2]]))
    with pytest.raises(ValueError, match="outside the cell"):
        grid.locate(np.array([[3.5, 0.5, 0.5]]), np.array([[3, 0, 0]]))


H = 1e-3


def grid(ends: list[float], knots: Knots = EVEN, across: int = 4) -> Grid:
    """The grid of a body 4 H thick."""
    h = 4 * H / across
    cells, width, runs = runs_along(np.array(ends), h, across, knots)
    return Grid(np.zeros(3), np.array([width, h, h]), (cells, across, across), runs)


def by_scipy(made: Grid, repeated: list[float]) -> list[BSpline]:
    """The same splines from a knot vector: cells' faces, one more cell at each end, joints twice."""
    faces = made.faces
    first = faces[1] - faces[0]
    last = faces[-1] - faces[-2]
    knots = [-2 * first, -first, *faces, faces[-1] + last, faces[-1] + 2 * last, *repeated]
    t = np.sort(knots)
    return [BSpline(t, np.eye(len(t) - 3)[k], 2) for k in range(len(t) - 3)]


@pytest.mark.parametrize(
    ("ends", "knots", "repeated"),
    [
        ([8.2e-3], EVEN, []),
        ([8.2e-3], Knots(from_tip=True), []),
        ([3.3e-3, 5.1e-3, 9e-3], Knots((0, 1)), [3.3e-3, 5.1e-3]),
        ([3.3e-3, 5.1e-3, 9e-3], Knots((0, 1), from_tip=True), [3.3e-3, 5.1e-3]),
        ([3.3e-3, 4.1e-3, 9e-3], Knots((0, 1)), [3.3e-3, 4.1e-3]),  # a segment of less than a cell
    ],
)
def test_splines_are_those_of_the_knot_vector(
    ends: list[float], knots: Knots, repeated: list[float]
) -> None:
    made = grid(ends, knots)
    x = np.random.default_rng(0).uniform(0.0, ends[-1], 200)
    node, values, slopes = made.splines_along(x)
    dense, steep = np.zeros((2, len(x), made.nodes[0]))
    for a in range(3):
        dense[np.arange(len(x)), node + a] = values[:, a]
        steep[np.arange(len(x)), node + a] = slopes[:, a]
    splines = by_scipy(made, repeated)
    assert len(splines) == made.nodes[0]
    np.testing.assert_allclose(
        dense, np.stack([one(x) for one in splines], 1), atol=1e-13
    )  # rounding of values up to 1
    np.testing.assert_allclose(
        steep, np.stack([one.derivative()(x) for one in splines], 1), atol=1e-13 * 4 / H
    )  # of slopes up to 4/h
    # A straight line is the sum of its values at the splines' centers (Greville).
    np.testing.assert_allclose(dense @ made.node_coordinates(0), x, atol=1e-13 * ends[-1])


def test_joints_too_near_to_another_or_to_an_end_get_no_knot() -> None:
    """Chosen from the tip on, so that what is in the guide changes nothing beyond it."""
    starts = [
        run.start for run in grid([0.4e-3, 3e-3, 3.3e-3, 6e-3, 6.4e-3], Knots((0, 1, 2, 3))).runs
    ]
    assert starts == pytest.approx([0.0, 3.3e-3])


def test_twice_as_many_cells_across_are_twice_as_many_in_each_run(rng: np.random.Generator) -> None:
    """And no cell is wider than requested, by more than LEAST_JOINT_DISTANCE_AT_REST of it."""
    for _ in range(50):
        ends = np.cumsum(rng.uniform(0.5e-3, 9e-3, 3)).tolist()
        for cells in (2, 3, 5):
            one, two = (
                grid(ends, Knots((0, 1), at_rest=True), across) for across in (cells, 2 * cells)
            )
            assert [2 * run.cells for run in one.runs] == [run.cells for run in two.runs]
            for made, across in ((one, cells), (two, 2 * cells)):
                assert (
                    max(run.width for run in made.runs)
                    <= (1 + LEAST_JOINT_DISTANCE_AT_REST) * 4 * H / across
                )


@pytest.mark.parametrize("joints", [(), (0,)])
def test_cells_counted_from_the_tip_stay_in_the_material(joints: tuple[int, ...]) -> None:
    """As a catheter with a joint 3.7 mm from its tip is pushed out, new faces appear at the base; all others keep their places."""
    known = np.zeros(0)
    for outside in np.arange(4.2, 9.0, 0.37) * 1e-3:
        faces = grid([outside - 3.7e-3, outside], Knots(joints, from_tip=True)).faces
        from_tip = (faces[-1] - faces[1:])[::-1]  # m, of all faces but the base
        assert np.abs(from_tip[: len(known)] - known).max(initial=0.0) < 1e-12 * outside  # rounding
        assert (
            LEAST_JOINT_DISTANCE_AT_REST * H * (1 - 1e-9)
            <= faces[1] - faces[0]
            <= (1 + LEAST_JOINT_DISTANCE_AT_REST) * H * (1 + 1e-9)
        )
        known = from_tip


def test_a_grid_like_another_has_as_many_cells_in_each_run() -> None:
    for knots in (EVEN, Knots((0, 1)), Knots((0, 1), from_tip=True)):
        made = grid([3.3e-3, 5.1e-3, 9e-3], knots)
        again = grid([3.3e-3, 5.1e-3, 9.9e-3], Knots(knots.joints, knots.from_tip, like=made))
        assert again.cells == made.cells
        assert [run.cells for run in again.runs] == [run.cells for run in made.runs]
