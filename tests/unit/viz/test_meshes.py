"""Known shapes are closed and of the right volume, and finer copies keep their shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmpm.viz.meshes import Surface, ball, bar, creased, normals, refined, tube


def volume(surface: Surface) -> float:
    """By the divergence theorem: positive where the triangles look outward."""
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def test_known_shapes_enclose_their_volume() -> None:
    # A polygon of 40 corners has sin(2 pi / 40) / (2 pi / 40) = 0.9959 of its circle's area.
    share = np.sin(2 * np.pi / 40) / (2 * np.pi / 40)
    rod = tube([0.01, 0.03], 0.002, 0.0, 1e-3)
    assert volume(rod) == pytest.approx(share * np.pi * 0.002**2 * 0.03, rel=1e-5)
    hollow = tube([0.03], 0.002, 0.001, 1e-3)
    assert volume(hollow) == pytest.approx(share * np.pi * (0.002**2 - 0.001**2) * 0.03, rel=1e-5)
    assert volume(bar([1.0, 3.0], 2.0, 0.5, 0.3, (5.0, 6.0, 7.0))) == pytest.approx(3.0, rel=1e-12)


def test_parts_of_known_shapes_end_where_they_were_told_to() -> None:
    surface = bar([0.01, 0.03, 0.04], 0.004, 0.002, 1e-3)
    for part, (low, high) in enumerate([(0.0, 0.01), (0.01, 0.03), (0.03, 0.04)]):
        x = surface.points[surface.triangles[surface.part == part], 0]
        np.testing.assert_allclose([x.min(), x.max()], [low, high], atol=1e-15)


def test_refining_keeps_the_shape_and_shortens_every_edge() -> None:
    coarse = bar([3.0], 2.0, 0.5, 9.0)
    fine = refined(coarse, 0.4)
    assert volume(fine) == pytest.approx(volume(coarse), rel=1e-12)
    edges = fine.points[fine.triangles] - fine.points[np.roll(fine.triangles, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() <= 0.4


def test_edges_of_a_drawing_stay_sharp_and_round_sides_smooth() -> None:
    """A welded rod has the points of its two end circles split into side and end, and no others."""
    turn = 2 * np.pi * np.arange(24) / 24
    circle = np.stack([0 * turn, np.cos(turn), np.sin(turn)], axis=1)
    points = np.vstack([circle, circle + np.eye(3)[0], [[0, 0, 0], [1, 0, 0]]])
    k, after = np.arange(24), (np.arange(24) + 1) % 24
    sides = np.vstack([np.stack([k, 24 + after, 24 + k], axis=1), np.stack([k, after, 24 + after], axis=1)])
    ends = np.vstack([np.stack([np.full(24, 48), after, k], axis=1), np.stack([np.full(24, 49), 24 + k, 24 + after], axis=1)])
    surface = creased(points, np.vstack([sides[:, ::-1], ends]), 3)
    assert len(surface.points) == 2 * 24 + 2 * 24 + 2
    assert set(surface.part) == {3}


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-6), (np.float32, 2e-5)])
def test_normals_of_the_end_faces_lie_along_the_axis(kind: type, tolerance: float) -> None:
    """Also at the center, whose slivers are lost in the rounding of float32: 5e-10 m, which tilts triangles 6e-5 m wide by 1e-5."""
    rod = tube([0.01], 2e-3, 0.0, 4e-4)
    turn = Rotation.from_rotvec([0.3, -0.7, 0.5]).as_matrix()
    found = normals((rod.points @ turn.T).astype(kind), rod.triangles) @ turn
    rings = 40 * 6  # the points of a face
    for face, side in ((slice(-2 * rings, -rings), -1.0), (slice(-rings, None), 1.0)):
        assert np.ptp(rod.points[face, 0]) == 0.0
        np.testing.assert_allclose(found[face], np.tile([side, 0.0, 0.0], (rings, 1)), atol=tolerance)


def test_normals_of_a_ball_lie_along_its_radii() -> None:
    """At the poles they lean by half of the 7.5 degrees between two rings: each of a pole's points has triangles of its own."""
    sphere = ball(1e-3)
    found = normals(sphere.points.astype(np.float32), sphere.triangles)
    radii = sphere.points / np.linalg.norm(sphere.points, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", found, radii).min() > np.cos(np.radians(3.8))
