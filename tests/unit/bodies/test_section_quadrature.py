"""Particles: exact volume and exact section moments, for any cell size, wall and segments.

Exact: area pi (R^2 - r^2), second moments pi/4 (R^4 - r^4), first and mixed moments 0. With the particle lattice of common MPM codes, the
second moments of a 4 mm disc at 0.5 mm have errors of 2 to 5 %, and so has bending."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from magmpm.bodies import section_quadrature as bodies

# Sections are differences of two discs: their rounding error grows for thin walls, 1e-16 / (1 - ratio).
EXACT = 1e-11


def rectangles(edges_y: np.ndarray, edges_z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners low, high (n, 2) of all rectangles between the edges."""
    low = np.stack(np.meshgrid(edges_y[:-1], edges_z[:-1], indexing="ij"), -1).reshape(-1, 2)
    high = np.stack(np.meshgrid(edges_y[1:], edges_z[1:], indexing="ij"), -1).reshape(-1, 2)
    return low, high


def check_section(
    low: np.ndarray, high: np.ndarray, outer: float, inner: float, count: int, dropped: float = 0.0
) -> None:
    """Areas and moments of a ring on rectangles. dropped: the most area of slivers that the quadrature may leave out."""
    points, areas, home = bodies.section_points(low, high, outer, inner, count)
    area = np.pi * (outer**2 - inner**2)
    moment = np.pi / 4 * (outer**4 - inner**4)
    y, z = points.T
    assert areas.min() > 0
    slack = (
        1e-9 * (high - low)[home]
    )  # rounding error of a point on a face; Grid.locate refuses more
    assert np.all(points >= low[home] - slack)
    assert np.all(points <= high[home] + slack)
    assert np.all(np.diff(home) >= 0), "sorted by rectangle"
    assert areas.sum() == pytest.approx(area, abs=EXACT * area + dropped)
    assert areas @ y**2 == pytest.approx(moment, abs=EXACT * moment + dropped * outer**2)
    assert areas @ z**2 == pytest.approx(moment, abs=EXACT * moment + dropped * outer**2)
    assert areas @ (y * z) == pytest.approx(0, abs=EXACT * moment + dropped * outer**2)
    assert areas @ y == pytest.approx(0, abs=EXACT * area * outer + dropped * outer)
    assert areas @ z == pytest.approx(0, abs=EXACT * area * outer + dropped * outer)


@given(
    st.integers(2, 16), st.one_of(st.just(0.0), st.floats(1e-3, 0.999)), st.sampled_from([2, 3, 4])
)
@example(7, 0.999, 2)  # a wall of 1/285 of a cell
@example(6, 0.0, 3)  # slivers at the corners
@settings(max_examples=60)
def test_section_is_exact(cells: int, ratio: float, count: int) -> None:
    """Discs and tubes on the grid that a scene would use."""
    edges = np.linspace(-2e-3, 2e-3, cells + 1)
    check_section(*rectangles(edges, edges), 2e-3, 2e-3 * ratio, count)


@given(
    st.lists(st.floats(-1.2, 1.2), min_size=0, max_size=5, unique=True),
    st.lists(st.floats(-1.2, 1.2), min_size=0, max_size=5, unique=True),
    st.floats(0.0, 0.95),
)
@example([0.96875], [0.24687], 0.0)  # a sliver of 2e-10 of the largest rectangle
@settings(max_examples=60)
def test_section_is_exact_on_any_rectangles(
    cuts_y: list[float], cuts_z: list[float], ratio: float
) -> None:
    """Unequal rectangles, off the center of the disc: the result does not depend on symmetry.

    A cut less than 1e-9 of the largest rectangle is left out. On a scene's grid, whose cells are alike, there is none: the test above.
    """
    edges = [np.unique(np.round([-1.3, *cuts, 1.3], 3)) for cuts in (cuts_y, cuts_z)]
    low, high = rectangles(*edges)
    check_section(
        low, high, 1.0, ratio, 2, dropped=len(low) * 1e-9 * float(np.prod(high - low, axis=1).max())
    )


@given(st.tuples(*[st.floats(-1.5, 1.5)] * 4))
def test_disk_moments_against_a_fine_sum(corners: tuple[float, float, float, float]) -> None:
    """Each rectangle separately, against a midpoint sum over 1000 strips along y, exact in z."""
    a, b, c, d = np.round(corners, 3)
    low = np.array([[min(a, b), min(c, d)]])
    high = np.array([[max(a, b), max(c, d)]])
    y = np.linspace(low[0, 0], high[0, 0], 1001)
    dy = (high[0, 0] - low[0, 0]) / 1000
    y = (y[1:] + y[:-1]) / 2
    half = np.sqrt(np.maximum(1 - y**2, 0))
    top = np.minimum(high[0, 1], half)
    bottom = np.minimum(np.maximum(low[0, 1], -half), top)
    m0, m1, m2 = ((top ** (k + 1) - bottom ** (k + 1)) / (k + 1) for k in range(3))
    expected = dy * np.array([m0.sum(), y @ m0, m1.sum(), y**2 @ m0, y @ m1, m2.sum()])
    # Midpoint sums over the edge of the circle: error (dy)^(3/2) where its slope is infinite, dy <= 3e-3.
    np.testing.assert_allclose(bodies.disk_moments(low, high, 1.0)[0], expected, atol=2e-4)


@pytest.mark.parametrize(
    "radius",
    [0.000676558326395903, 0.005520024078098786, 0.00861724779971481, 0.0038367353394736224],
)
def test_a_radius_whose_square_rounds_two_ways(radius: float) -> None:
    """The square of a float (by libm's pow) and of an array's element differ in the last bit: the root at the circle's edge was NaN."""
    low, high = rectangles(*[np.array([-radius, 0.0, radius])] * 2)
    assert bodies.disk_moments(low, high, radius)[:, 0].sum() == pytest.approx(
        np.pi * radius**2, rel=1e-12
    )


@given(
    st.lists(st.floats(0.05, 1.0), min_size=1, max_size=6),
    st.integers(2, 5),
    st.sampled_from([2, 3]),
    st.sampled_from([0.0, 0.6, 0.95]),
)
@settings(max_examples=30)
def test_volumes_and_centres_of_segments(
    shares: list[float], cells: int, count: int, ratio: float
) -> None:
    """Segments of any length, whose ends cut cells: volume, centroid and axial second moment of each are exact."""
    lengths = np.array(shares) / np.sum(shares) * 20e-3
    ends = np.cumsum(lengths)
    outer = 2e-3
    inner = 2e-3 * ratio
    grid = bodies.rod_grid(np.asarray(ends), 2 * outer, cells)
    p = bodies.rod_particles(
        grid, outer=outer, inner=inner, segment_ends=ends, particles_per_cell=count
    )
    grid.locate(p.position, p.cell)  # raises if a particle lies outside its cell
    area = np.pi * (outer**2 - inner**2)
    for k, length in enumerate(lengths):
        mine = p.segment == k
        x = p.position[mine, 0]
        v = p.volume[mine]
        assert np.all((x > ends[k] - length) & (x < ends[k]))
        assert v.sum() == pytest.approx(area * length, rel=EXACT)
        assert v @ x == pytest.approx(
            area * (ends[k] ** 2 - (ends[k] - length) ** 2) / 2, rel=EXACT
        )
        assert v @ x**2 == pytest.approx(
            area * (ends[k] ** 3 - (ends[k] - length) ** 3) / 3, rel=EXACT
        )
    assert np.all(np.diff(p.cell[:, 0]) >= 0), (
        "sorted along the axis: the kernels' slabs rely on it"
    )


def test_a_segment_end_within_rounding_of_a_face_is_that_face() -> None:
    """0.1 + 0.2 is not 0.3: no cell may be cut into a full part and one of the size of a rounding error, a cell without stiffness."""
    grid = bodies.rod_grid(np.array([3e-3]), 1e-3, 4)  # faces every 0.25 mm
    ends = np.array([1e-3 * (1 + 4e-16), 2e-3 * (1 - 4e-16), 3e-3])
    p = bodies.rod_particles(grid, outer=0.5e-3, inner=0.0, segment_ends=ends, particles_per_cell=2)
    one = bodies.rod_particles(
        grid, outer=0.5e-3, inner=0.0, segment_ends=ends[-1:], particles_per_cell=2
    )
    np.testing.assert_array_equal(p.position, one.position)
    np.testing.assert_array_equal(np.bincount(p.segment), [len(p.volume) // 3] * 3)


def test_section_errors_see_a_wrong_section() -> None:
    """The printed value is measured on the particles: points moved inward by 1 % give moments that are 2 % too small."""
    grid = bodies.rod_grid(np.array([8e-3]), 4e-3, 4)
    p = bodies.rod_particles(
        grid, outer=2e-3, inner=0.0, segment_ends=np.array([8e-3]), particles_per_cell=2
    )
    wrong = bodies.Particles(p.position * [1, 0.99, 0.99], p.volume * 1.003, p.segment, p.cell)
    errors = bodies.section_errors(wrong, outer=2e-3, inner=0.0, length=8e-3)
    assert errors["area_error"] == pytest.approx(0.003, rel=1e-9)
    assert errors["second_moment_error"] == pytest.approx(1 - 1.003 * 0.99**2, rel=1e-9)


def test_grid_has_knots_on_both_end_faces() -> None:
    """The clamp is exact only on a face of the grid, and the free end needs no spline beyond it."""
    for length, diameter, cells in ((40e-3, 4e-3, 4), (10.3e-3, 4e-3, 3), (6e-3, 4e-3, 2)):
        grid = bodies.rod_grid(np.array([length]), diameter, cells)
        assert grid.origin[0] == 0
        assert grid.spacing[0] * grid.cells[0] == pytest.approx(length, rel=1e-15)
        assert grid.cells[0] >= 3
        assert grid.spacing[1] == grid.spacing[2] == diameter / cells
        assert 0.7 < grid.spacing[0] / grid.spacing[1] < 1.5, "cells stay near cubes"
