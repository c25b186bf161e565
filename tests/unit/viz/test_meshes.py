"""Surfaces: known shapes and those around particles are closed, of the right volume, and move as a body does."""

import numpy as np
import pytest
from reference import motions
from scipy.spatial.transform import Rotation

from magmpm.viz.binding import Binding, gradients
from magmpm.viz.meshes import TriangleSurface, ball, bar, creased, normals, refined, swept, tube
from magmpm.viz.particle_surface import (
    around_particles,
    connected_components,
    spacing,
    surface_nets,
)


def volume(surface: TriangleSurface) -> float:
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
    k = np.arange(24)
    after = (np.arange(24) + 1) % 24
    sides = np.vstack(
        [np.stack([k, 24 + after, 24 + k], axis=1), np.stack([k, after, 24 + after], axis=1)]
    )
    ends = np.vstack(
        [
            np.stack([np.full(24, 48), after, k], axis=1),
            np.stack([np.full(24, 49), 24 + k, 24 + after], axis=1),
        ]
    )
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
        np.testing.assert_allclose(
            found[face], np.tile([side, 0.0, 0.0], (rings, 1)), atol=tolerance
        )


def test_normals_of_a_ball_lie_along_its_radii() -> None:
    """At the poles they lean by half of the 7.5 degrees between two rings: each of a pole's points has triangles of its own."""
    sphere = ball(1e-3)
    found = normals(sphere.points.astype(np.float32), sphere.triangles)
    radii = sphere.points / np.linalg.norm(sphere.points, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", found, radii).min() > np.cos(np.radians(3.8))


def test_a_tube_around_a_path_is_nowhere_narrower() -> None:
    """Its area is the circumference times the path's length, as Pappus has it: rings that turned about the path would make a waist."""
    t = np.linspace(0.0, 4 * np.pi, 400)
    path = np.stack([np.cos(t), np.sin(t), 0.2 * t], axis=1)
    surface = swept(path, 0.1)
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(2 * np.pi * 0.1 * np.hypot(1.0, 0.2) * t[-1], rel=0.01)
    outward = np.einsum(
        "ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - np.repeat(path[:-1], 2 * 32, axis=0)
    )
    assert outward.min() > 0.0


def test_surface_nets_find_a_ball() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(24.0)] * 3, indexing="ij"), axis=-1)
    distance = 8.3 - np.linalg.norm(grid - 11.4, axis=-1)
    points, triangles = surface_nets(distance, 0.0)
    # Closed: every edge belongs to two triangles, once in each direction.
    directed = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert {tuple(e) for e in directed} == {tuple(e[::-1]) for e in directed}
    # Points at the mean of a cell's crossings lie a little inside of the ball: by less than 1/8 R of the cell's diagonal squared.
    away = np.linalg.norm(points - 11.4, axis=1)
    assert np.abs(away - 8.3).max() < 3 / (8 * 8.3) + 0.02
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    middle = (a + b + c) / 3 - 11.4
    outward = (
        np.einsum("ij,ij->i", normal, middle)
        / np.linalg.norm(normal, axis=1)
        / np.linalg.norm(middle, axis=1)
    )
    assert outward.min() > 0.9


def test_the_surface_around_particles_holds_nearly_their_volume() -> None:
    model = motions.body(0.25e-3)
    p = model.particles
    surface = around_particles(p.position, p.volume, p.segment)
    # Edges come out rounded by about a particle: 16 across a diameter.
    assert volume(surface) == pytest.approx(p.volume.sum(), rel=0.04)
    assert set(surface.part) == {0, 1, 2}
    for part in range(3):
        x = surface.points[surface.triangles[surface.part == part], 0].mean()
        assert x == pytest.approx((part + 0.5) * motions.LENGTH / 3, abs=1e-3)


def test_spacing_is_that_of_whole_particles() -> None:
    volumes = np.concatenate([np.full(80, 8e-9), np.full(20, 1e-9)])
    assert spacing(volumes) == pytest.approx(2e-3)


def test_a_bound_surface_moves_as_the_body_does() -> None:
    """Affine motion exactly; bending to second order in the particles' distance."""
    model = motions.body(0.5e-3)
    X = model.particles.position
    surface = tube([motions.LENGTH], motions.DIAMETER / 2, 0.0, 0.5e-3)
    binding = Binding(surface.points, X)
    A = np.array([[1.1, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.4, 1.2]])
    b = np.array([0.1, -0.2, 0.3])
    # The regularization of 1e-9 keeps it from being exact to rounding.
    np.testing.assert_allclose(
        binding.at(X @ A.T + b), surface.points @ A.T + b, atol=1e-6 * motions.DIAMETER
    )
    for curvature in (20.0, 60.0):
        # Half the curvature times the square of the neighbors' reach, about three particles.
        bound = 0.5 * curvature * (3 * 0.5e-3) ** 2
        moved = binding.at(motions.bent(X, curvature)[0])
        assert np.abs(moved - motions.bent(surface.points, curvature)[0]).max() < bound


def test_particles_that_are_wider_apart_one_way_are_enough() -> None:
    """Twice as far apart along y: the nearest ones of a point on a side lie in one plane, and more must be asked."""
    X = np.stack(
        np.meshgrid(np.arange(20.0), np.arange(6) * 2.5, np.arange(4.0), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    surface = bar([20.0], 15.0, 4.0, 1.0, (-0.5, 6.25, 1.5))
    np.testing.assert_allclose(Binding(surface.points, X).at(X), surface.points, atol=1e-5)


def test_gradients_are_those_of_the_motion() -> None:
    """A bent rod's surface is right to second order in the neighbors' reach of about two particles."""
    X = motions.body(0.5e-3).particles.position
    x, F = motions.bent(X, 40.0)
    found = gradients(X, x)
    inside = (X[:, 0] > 2e-3) & (X[:, 0] < motions.LENGTH - 2e-3)
    assert np.abs(found - F)[inside].max() < 40.0 * 2 * 0.5e-3
    np.testing.assert_allclose(gradients(X, X), np.broadcast_to(np.eye(3), F.shape), atol=1e-7)


def test_separate_bodies_are_told_apart_and_do_not_pull_each_other() -> None:
    cube = np.stack(np.meshgrid(*[np.arange(6.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    both = np.vstack([cube, cube + np.array([9.0, 0.0, 0.0])])
    of = connected_components(both, 1.0)
    np.testing.assert_array_equal(of, np.repeat([0, 1], len(cube)))
    points = np.array([[5.5, 2.0, 2.0], [8.5, 2.0, 2.0]])
    binding = Binding(points, both, np.array([0, 1]), of)
    moved = np.where(of[:, None] == 0, both, both + np.array([0.0, 0.0, 7.0]))
    np.testing.assert_allclose(
        binding.at(moved), points + np.array([[0, 0, 0], [0, 0, 7.0]]), atol=1e-6
    )
