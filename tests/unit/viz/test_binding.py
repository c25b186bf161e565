"""A surface moves as its body does."""

from __future__ import annotations

import numpy as np
from reference import motions

from magmpm.viz.binding import Binding, gradients
from magmpm.viz.meshes import bar, tube
from magmpm.viz.particle_surface import connected_components


def test_a_bound_surface_moves_as_the_body_does() -> None:
    """Affine motion exactly; bending to second order in the particles' distance."""
    model = motions.body(0.5e-3)
    X = model.particles.position
    surface = tube([motions.LENGTH], motions.DIAMETER / 2, 0.0, 0.5e-3)
    binding = Binding(surface.points, X)
    A, b = np.array([[1.1, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.4, 1.2]]), np.array([0.1, -0.2, 0.3])
    # The regularization of 1e-9 keeps it from being exact to rounding.
    np.testing.assert_allclose(binding.at(X @ A.T + b), surface.points @ A.T + b, atol=1e-6 * motions.DIAMETER)
    for curvature in (20.0, 60.0):
        # Half the curvature times the square of the neighbors' reach, about three particles.
        bound = 0.5 * curvature * (3 * 0.5e-3) ** 2
        moved = binding.at(motions.bent(X, curvature)[0])
        assert np.abs(moved - motions.bent(surface.points, curvature)[0]).max() < bound


def test_particles_that_are_wider_apart_one_way_are_enough() -> None:
    """Twice as far apart along y: the nearest ones of a point on a side lie in one plane, and more must be asked."""
    X = np.stack(np.meshgrid(np.arange(20.0), np.arange(6) * 2.5, np.arange(4.0), indexing="ij"), axis=-1).reshape(-1, 3)
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
    np.testing.assert_allclose(binding.at(moved), points + np.array([[0, 0, 0], [0, 0, 7.0]]), atol=1e-6)
