"""Measures of a deformed body, and results that are saved and loaded."""

from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.model import build
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.simulate import run
from magmpm.statics import axis as axis_of_statics
from magmpm.statics.layout import StaticModel, static_model
from magmpm.studies.problem.shape_distance import gaps, root_mean_square

L = 16e-3


@pytest.fixture(scope="module")
def bent() -> Result:
    return run(rod_scene(length=L, directions=[(1, 0, 0), (0, 1, 1)], field=(0, 8e-3, 20e-3)))


def coefficients(model: StaticModel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Coefficients of displacements a x + b x^2, which the clamped splines represent exactly: a g + b (g^2 - h^2/4) at node centers g."""
    # of a cell at each node: they differ in a tube
    g = model.grid.node_coordinates(0)[1:]
    h = model.grid.node_widths[1:]
    planes = np.outer(g, a) + np.outer(g**2 - h**2 / 4, b)
    return np.repeat(planes[:, None, :], model.layout.nodes_per_plane, axis=1).reshape(
        model.layout.planes, -1
    )


@pytest.mark.parametrize("inner", [0.0, 2e-3])
def test_axis_of_a_known_displacement(inner: float) -> None:
    """u = a x + b x^2 over every section: centerline and tip are exact, both for the axis of a rod and the mean of a tube."""
    model = static_model(build(rod_scene(length=L, inner_diameter=inner, cells=3)))
    a = np.array([0.02, -0.1, 0.2])
    b = np.array([-3.0, 5.0, 8.0])
    grid = coefficients(model, a, b)
    rows = axis_of_statics.centreline(model, grid)
    s = rows[:, 0]
    assert s[0] == 0
    assert s[-1] == pytest.approx(L, rel=1e-15)
    expected = np.outer(s, [1, 0, 0]) + np.outer(s, a) + np.outer(s**2, b)
    np.testing.assert_allclose(rows[:, 1:], expected, rtol=0, atol=1e-14 * L)
    tip = axis_of_statics.along_axis(
        model, grid, axis_of_statics.end_face_weights(model), np.array([L])
    )
    np.testing.assert_allclose(tip[0], expected[-1], rtol=0, atol=1e-14 * L)


def test_end_face_mean_sees_the_section() -> None:
    """A displacement that varies over the section, y^2 + z^2 along z: the mean over the face is D^2/8, on the axis it is 0."""
    model = static_model(build(rod_scene(length=L, cells=4)))
    grid = model.grid
    nodes = model.layout.node_yz
    h = model.grid.spacing[1]
    y = grid.node_coordinates(1)[nodes[:, 0]]
    z = grid.node_coordinates(2)[nodes[:, 1]]
    field = np.zeros((model.layout.planes, model.layout.nodes_per_plane, 3))
    field[:, :, 2] = y**2 + z**2 - h**2 / 2  # coefficients of y^2 + z^2
    flat = field.reshape(model.layout.planes, -1)
    at = np.array([L])
    mean = axis_of_statics.along_axis(model, flat, axis_of_statics.end_face_weights(model), at)[
        0, 2
    ]
    axis = axis_of_statics.along_axis(model, flat, axis_of_statics.section_weights(model), at)[0, 2]
    assert mean == pytest.approx(4e-3**2 / 8, rel=1e-12)
    assert axis == pytest.approx(0, abs=1e-20)


def test_centreline_between_its_rows(bent: Result) -> None:
    """Exact between rows, where the axis is a parabola, and at the rows; a point outside the body is an error."""
    s = bent.centreline[:, 0]
    np.testing.assert_allclose(
        measures.centreline_at(bent, s), bent.centreline[:, 1:], rtol=0, atol=1e-16
    )
    a, b, c = bent.centreline[:3, 1:]  # one cell: Lagrange's parabola at a quarter of it
    expected = 0.375 * a + 0.75 * b - 0.125 * c
    np.testing.assert_allclose(
        measures.centreline_at(bent, s[1:2] / 2)[0], expected, rtol=0, atol=1e-16
    )
    for outside in (-1e-5, 1.001 * L):
        with pytest.raises(ValueError, match="between 0 and the length"):
            measures.centreline_at(bent, np.array([outside]))


def test_distances_to_a_target(bent: Result) -> None:
    """A target shifted by (0, 3, 4) mm at every row, or at the tip, is 5 mm away; of the latter the rms distance is 5/sqrt(n)."""
    s = np.linspace(0, L, 9)
    axis = np.column_stack([s, measures.centreline_at(bent, s)])
    assert root_mean_square(gaps(bent.centreline, axis)) == 0
    shifted = axis + np.array([0, 0, 3e-3, 4e-3])
    assert root_mean_square(gaps(bent.centreline, shifted)) == pytest.approx(5e-3, rel=1e-12)
    at_tip = axis.copy()
    at_tip[-1, 2:] += [3e-3, 4e-3]
    assert root_mean_square(gaps(bent.centreline, at_tip)) == pytest.approx(5e-3 / 3, rel=1e-12)


def test_result_adds_up(bent: Result) -> None:
    """Segments, volumes and det F agree with the particles; the remanence of a segment rotates with it and keeps its length."""
    moved = bent.particle_position
    V = bent.particle_volume
    for k in range(2):
        mine = bent.particle_segment == k
        np.testing.assert_allclose(
            bent.segment_center[k], V[mine] @ moved[mine] / V[mine].sum(), rtol=1e-12
        )
    assert V.sum() == pytest.approx(np.pi * 2e-3**2 * L, rel=1e-12)
    assert bent.min_det_F == pytest.approx(bent.particle_det_F.min(), rel=1e-14)
    assert bent.max_det_F == pytest.approx(bent.particle_det_F.max(), rel=1e-14)
    assert 0.9 < bent.min_det_F < 1 < bent.max_det_F < 1.1
    lengths = np.linalg.norm(bent.segment_remanence, axis=1)
    np.testing.assert_allclose(
        lengths, 0.1, rtol=0.05
    )  # the mean over a segment bent by 30 degrees is a chord, 1 % shorter
    assert bent.segment_remanence[0, 2] > 0.005, "turned toward the field"
    assert bent.particles == len(moved)


def test_result_survives_saving(bent: Result, tmp_path: Path) -> None:
    folder = bent.save(tmp_path / "deep" / "folder")
    back = Result.load(folder)
    assert back.summary() == bent.summary()
    for name in (
        "particle_position",
        "particle_reference",
        "particle_segment",
        "centreline",
        "tip",
    ):
        assert np.array_equal(getattr(back, name), getattr(bent, name))
    again = run(
        rod_scene(length=L, directions=[(1, 0, 0), (0, 1, 1)], field=(0, 8e-3, 20e-3)), start=back
    )
    assert again.iterations <= bent.iterations, "a saved result is a start"
    assert not [p.name for p in folder.iterdir() if p.name.startswith(".")], (
        "no half-written file is left"
    )
