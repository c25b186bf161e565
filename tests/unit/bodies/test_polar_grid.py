"""The grid of a tube: its splines hold rigid motion and uniform strain of a section, its particles the section's area and moments."""

import numpy as np
import pytest

from magmpm.bodies.grid import Knots
from magmpm.bodies.polar_grid import PolarGrid, tube_grid, tube_particles

ENDS = np.array([5e-3, 12e-3])
ROUNDING = 1e-13  # of numbers of order 1, from a few products


def tube(cells: int = 3, inner: float = 1.5e-3, **more: object) -> PolarGrid:
    return tube_grid(ENDS, 2e-3, inner, cells, Knots(at_rest=True), **more)


def section(grid: PolarGrid, points: np.ndarray) -> np.ndarray:
    """Splines (q, nodes) of a section at points (q, 2)."""
    first, weights = grid.section_splines(points)
    dense = np.zeros((len(points), *grid.nodes[1:]))
    for a, b in np.ndindex(3, 3):
        np.add.at(
            dense,
            (np.arange(len(points)), (first[:, 0] + a) % grid.nodes[1], first[:, 1] + b),
            weights[:, 0, a] * weights[:, 1, b],
        )
    return dense.reshape(len(points), -1)


@pytest.mark.parametrize("turn", [0.0, 0.37])
def test_splines_hold_uniform_strain_of_a_section(turn: float) -> None:
    """1, y and z are sums of splines, with the coefficients that `section_nodes` tells."""
    grid = tube(turn=turn)
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, 300)
    radius = rng.uniform(1.5e-3, 2e-3, 300)
    points = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    splines = section(grid, points)
    nodes = grid.section_nodes(
        np.stack(np.meshgrid(*map(np.arange, grid.nodes[1:]), indexing="ij"), -1).reshape(-1, 2)
    )
    np.testing.assert_allclose(splines.sum(axis=1), 1.0, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(splines @ nodes, points, rtol=0, atol=2e-3 * ROUNDING)


@pytest.mark.parametrize("inner", [0.2e-3, 1e-3, 1.996e-3])
@pytest.mark.parametrize("cells", [2, 5])
def test_section_is_exact(inner: float, cells: int) -> None:
    """Area and second moments, of every segment."""
    grid = tube(cells, inner)
    p = tube_particles(
        grid, outer=2e-3, segment_ends=ENDS, cells_across=cells, particles_per_cell=2
    )
    area = np.pi * (2e-3**2 - inner**2)
    moment = np.pi / 4 * (2e-3**4 - inner**4)
    for segment, length in enumerate(np.diff(ENDS, prepend=0.0)):
        v, (y, z) = p.volume[p.segment == segment] / length, p.position[p.segment == segment, 1:].T
        assert v.sum() == pytest.approx(area, rel=1e-12)  # sums of hundreds of terms
        np.testing.assert_allclose(
            [v @ y**2, v @ z**2, v @ (y * z)], [moment, moment, 0.0], rtol=0, atol=1e-12 * moment
        )
    assert p.box[:, 1:].min() == 0
    assert p.box[:, 1:].max() == cells - 1


def test_cells_are_fine_at_the_base_and_thin_walls_have_more_around() -> None:
    """12 cells of 1 mm, the first cut in three; around, as the cube root of cells across times radius over wall."""
    h = tube(4, 1.2e-3).along.width
    np.testing.assert_allclose(h, 1e-3 * np.array([0.25, 0.25, 0.5, *[1.0] * 11]), rtol=1e-12)
    assert [tube(4, inner).cells[1] for inner in (0.1e-3, 1.2e-3, 1.6e-3, 1.8e-3)] == [
        8,
        12,
        16,
        20,
    ]


@pytest.mark.parametrize("joints", [(), (0,)])
@pytest.mark.parametrize("from_tip", [False, True])
def test_nearly_the_same_tube_has_as_many_cells(joints: tuple[int, ...], from_tip: bool) -> None:
    """And as many in each run."""
    knots = Knots(joints, from_tip, at_rest=True)
    grid = tube_grid(ENDS, 2e-3, 1.5e-3, 3, knots)
    again = tube_grid(
        1.1 * ENDS, 2.7e-3, 1.1e-3, 3, Knots(joints, from_tip, like=grid, at_rest=True)
    )
    assert again.cells == grid.cells
    assert [(run.cells, run.after) for run in again.runs] == [
        (run.cells, run.after) for run in grid.runs
    ]
    assert again.faces[-1] == pytest.approx(1.1 * ENDS[-1], rel=1e-12)
