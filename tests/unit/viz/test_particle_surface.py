"""The surface around particles is closed and of nearly their volume."""

from __future__ import annotations

import numpy as np
import pytest
from reference import motions
from test_meshes import volume

from magmpm.viz.particle_surface import around_particles, spacing, surface_nets


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
    normal, middle = np.cross(b - a, c - a), (a + b + c) / 3 - 11.4
    outward = np.einsum("ij,ij->i", normal, middle) / np.linalg.norm(normal, axis=1) / np.linalg.norm(middle, axis=1)
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
