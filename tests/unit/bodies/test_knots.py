"""Cells along a straight body: runs between repeated knots, cells counted from the tip, and their splines against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from magmpm.bodies.grid import EVEN, THIN, Grid, Knots, runs_along

H = 1e-3


def grid(ends: list[float], knots: Knots = EVEN, across: int = 4) -> Grid:
    """The grid of a body 4 H thick."""
    h = 4 * H / across
    cells, width, runs = runs_along(np.array(ends), h, across, knots)
    return Grid(np.zeros(3), np.array([width, h, h]), (cells, across, across), runs)


def by_scipy(made: Grid, repeated: list[float]) -> list[BSpline]:
    """The same splines from a knot vector: cells' faces, one more cell at each end, joints twice."""
    faces = made.faces
    first, last = faces[1] - faces[0], faces[-1] - faces[-2]
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
def test_splines_are_those_of_the_knot_vector(ends: list[float], knots: Knots, repeated: list[float]) -> None:
    made = grid(ends, knots)
    x = np.random.default_rng(0).uniform(0.0, ends[-1], 200)
    node, values, slopes = made.splines_along(x)
    dense, steep = np.zeros((2, len(x), made.nodes[0]))
    for a in range(3):
        dense[np.arange(len(x)), node + a] = values[:, a]
        steep[np.arange(len(x)), node + a] = slopes[:, a]
    splines = by_scipy(made, repeated)
    assert len(splines) == made.nodes[0]
    np.testing.assert_allclose(dense, np.stack([one(x) for one in splines], 1), atol=1e-13)  # rounding of values up to 1
    np.testing.assert_allclose(steep, np.stack([one.derivative()(x) for one in splines], 1), atol=1e-13 * 4 / H)  # of slopes up to 4/h
    # A straight line is the sum of its values at the splines' centers (Greville).
    np.testing.assert_allclose(dense @ made.node_coordinates(0), x, atol=1e-13 * ends[-1])


def test_joints_too_near_to_another_or_to_an_end_get_no_knot() -> None:
    """Chosen from the tip on, so that what is in the guide changes nothing beyond it."""
    starts = [run.start for run in grid([0.4e-3, 3e-3, 3.3e-3, 6e-3, 6.4e-3], Knots((0, 1, 2, 3))).runs]
    assert starts == pytest.approx([0.0, 3.3e-3])


def test_twice_as_many_cells_across_are_twice_as_many_in_each_run(rng: np.random.Generator) -> None:
    """And no cell is wider than requested, by more than THIN of it."""
    for _ in range(50):
        ends = np.cumsum(rng.uniform(0.5e-3, 9e-3, 3)).tolist()
        for cells in (2, 3, 5):
            one, two = (grid(ends, Knots((0, 1), at_rest=True), across) for across in (cells, 2 * cells))
            assert [2 * run.cells for run in one.runs] == [run.cells for run in two.runs]
            for made, across in ((one, cells), (two, 2 * cells)):
                assert max(run.width for run in made.runs) <= (1 + THIN) * 4 * H / across


@pytest.mark.parametrize("joints", [(), (0,)])
def test_cells_counted_from_the_tip_stay_in_the_material(joints: tuple[int, ...]) -> None:
    """As a catheter with a joint 3.7 mm from its tip is pushed out, new faces appear at the base; all others keep their places."""
    known = np.zeros(0)
    for outside in np.arange(4.2, 9.0, 0.37) * 1e-3:
        faces = grid([outside - 3.7e-3, outside], Knots(joints, from_tip=True)).faces
        from_tip = (faces[-1] - faces[1:])[::-1]  # m, of all faces but the base
        assert np.abs(from_tip[: len(known)] - known).max(initial=0.0) < 1e-12 * outside  # rounding
        assert THIN * H * (1 - 1e-9) <= faces[1] - faces[0] <= (1 + THIN) * H * (1 + 1e-9)
        known = from_tip


def test_a_grid_like_another_has_as_many_cells_in_each_run() -> None:
    for knots in (EVEN, Knots((0, 1)), Knots((0, 1), from_tip=True)):
        made = grid([3.3e-3, 5.1e-3, 9e-3], knots)
        again = grid([3.3e-3, 5.1e-3, 9.9e-3], Knots(knots.joints, knots.from_tip, like=made))
        assert again.cells == made.cells
        assert [run.cells for run in again.runs] == [run.cells for run in made.runs]
