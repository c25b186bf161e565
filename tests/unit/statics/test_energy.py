"""The energy of a whole model: derivatives, conservation, the patch test."""

from dataclasses import replace

import numpy as np
import pytest
from reference.panels import multiply
from reference.plain_forms import to_dense
from reference.scenes import G, rod_scene
from scipy.spatial.transform import Rotation

from magmpm.fields.dipole import MU0
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model

LOCKING = pytest.mark.parametrize("locking", ["f-bar", "none"])
FIELD = (4e-3, -3e-3, 6e-3)


def model_of(**changes: object) -> StaticModel:
    given = {
        "length": 8e-3,
        "directions": [(1, 0, 0), (0.3, -0.5, 0.8)],
        "shear": [G, G / 3],
        "cells": 3,
    }
    return static_model(build(rod_scene(**{**given, **changes})))


def unclamped(model: StaticModel) -> StaticModel:
    """The body without the cells at the clamp: the rest is free in space."""
    free = model.particles.cell[:, 0] > 0
    volume = np.where(free, model.particles.volume, 0.0)
    return replace(model, particles=replace(model.particles, volume=volume))


def coordinates(model: StaticModel) -> np.ndarray:
    """Greville points of the free nodes, (planes, nodes, 3) m: the coefficients with which the splines represent x, y and z."""
    grid = model.grid
    nodes = model.layout.node_yz
    x = grid.node_coordinates(0)[1:]
    y, z = grid.section_nodes(nodes).T
    return np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)


def affine(model: StaticModel, A: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Coefficients (planes, m) of the displacement that carries X to A X + shift, except in the clamped cells."""
    X = coordinates(model)
    return (X @ A.T + shift - X).reshape(model.layout.planes, -1)


def random_coefficients(
    model: StaticModel, rng: np.random.Generator, size: float = 5e-5
) -> np.ndarray:
    return size * rng.standard_normal((model.layout.planes, model.layout.m))


@LOCKING
def test_undeformed_body(rng: np.random.Generator, locking: str) -> None:
    """No load: no energy, no residual, and a positive definite tangent, because the clamp holds every rigid motion."""
    energy = Energy(model_of(cells=2, anti_locking=locking))
    rest = energy.at(np.zeros(energy.shape))
    assert rest.energy == 0
    residual, matrix = energy.tangent(rest)
    assert not residual.any()
    values = np.linalg.eigvalsh(to_dense(matrix.panels, energy.model.layout.split))
    # The softest modes are bending, and coefficients at corners with little material: 1e-5 of the stiffest. A free motion
    # would have an eigenvalue of rounding size, 1e-16.
    assert values[0] > 1e-7 * values[-1]


@LOCKING
def test_torque_is_the_magnets(rng: np.random.Generator, locking: str) -> None:
    """Angular momentum in P2G: moments of the grid forces about the origin sum to minus the integral of (1/mu0) F Br x B.

    The coefficients of the deformed position, Greville points plus displacement, are the lever arms.
    """
    model = unclamped(model_of(field=FIELD, anti_locking=locking))
    energy = Energy(model)
    c = random_coefficients(model, rng)
    point = energy.at(c)
    r = energy.residual(point).reshape(-1, 3)
    arm = (coordinates(model) + c.reshape(coordinates(model).shape)).reshape(-1, 3)
    torque = np.cross(np.einsum("nij,nj->ni", point.F, model.remanence), FIELD) / MU0
    expected = -model.particles.volume @ torque
    found = np.cross(arm, r)
    np.testing.assert_allclose(
        r.sum(axis=0), 0, atol=1e-14 * np.abs(r).sum()
    )  # Newton's third law, to rounding of the sum
    np.testing.assert_allclose(
        found.sum(axis=0), expected, rtol=0, atol=1e-13 * np.abs(found).sum()
    )
    assert np.linalg.norm(expected) > 1e-6  # N m: the compared values are not zero


@LOCKING
@pytest.mark.parametrize("angle", [30, 90, 180, 270, 360])
def test_rigid_motion_is_free_of_stress(locking: str, angle: float) -> None:
    """A free body, rotated by any angle about a skew axis and moved: F = R, no energy, no force. Including full turns."""
    model = unclamped(model_of(anti_locking=locking))
    energy = Energy(model)
    R = Rotation.from_rotvec(np.radians(angle) * np.array([2, -1, 2]) / 3).as_matrix()
    point = energy.at(affine(model, R, np.array([1e-2, -3e-3, 5e-3])))
    free = model.particles.volume > 0
    np.testing.assert_allclose(
        point.F[free], np.broadcast_to(R, (free.sum(), 3, 3)), rtol=0, atol=1e-13
    )
    stiffness = G * model.particles.volume.sum()  # J per unit strain
    assert point.energy == pytest.approx(
        0, abs=1e-14 * stiffness
    )  # rounding error of J^(-2/3) I1 - 3
    # Strain from rounding 1e-14, times stress 20 G, over the section, of which a node carries a share.
    np.testing.assert_allclose(energy.residual(point), 0, atol=1e-12 * 20 * G * 1.6e-5)


@LOCKING
@pytest.mark.parametrize("particles", [2, 3])
def test_patch(locking: str, particles: int) -> None:
    """Patch test: an affine deformation gives the same F everywhere, and no residual at nodes inside the material.

    Inside: all cells of a node are full and of one material. There the Gauss points integrate the gradients exactly.
    """
    model = model_of(
        cells=5, particles=particles, directions=[(1, 0, 0)], shear=G, anti_locking=locking
    )
    energy = Energy(model)
    A = np.eye(3) + np.array([[0.1, 0.2, -0.1], [0.05, -0.2, 0.3], [0.1, -0.05, 0.15]])
    point = energy.at(affine(model, A, np.array([1e-3, 2e-3, -1e-3])))
    away = model.particles.cell[:, 0] > 0
    np.testing.assert_allclose(
        point.F[away], np.broadcast_to(A, (away.sum(), 3, 3)), rtol=0, atol=1e-13
    )

    residual = energy.residual(point).reshape(model.layout.planes, -1, 3)
    middle = np.flatnonzero(
        np.all(model.layout.node_yz == 3, axis=1)
    )  # its 3 x 3 cells lie inside the disc
    assert len(middle) == 1
    inside = residual[3 : model.layout.planes - 2, middle[0]]  # nor at the clamp or the free end
    assert len(inside) >= 4
    traction = np.abs(residual).max()  # forces on the nodes of the surface
    np.testing.assert_allclose(inside, 0, atol=1e-12 * traction)


@pytest.mark.parametrize(
    "effects",
    [{"magnetic_torque": {}}, {"magnetic_torque": {}, "magnetic_force": {}, "gravity": {}}],
)
# test_stability compares the same products with the tangent of one combination of effects
@pytest.mark.slow
def test_products_are_those_of_the_tangents_matrix(effects: dict) -> None:
    """Without a matrix: the tangent times columns, with loads that also soften, and the mass of unit density."""
    data = rod_scene(cells=2, field=(1e-3, 4e-3, 7e-3)).to_si() | {"effects": effects}
    data["field"]["dipole"] = {"position": [0.04, 0.01, 0.02], "moment": [2.0, 1.0, -3.0]}
    energy = Energy(static_model(build(Scene.from_si(data))))
    rng, (planes, m) = np.random.default_rng(3), energy.shape
    point = energy.at(1e-4 * rng.standard_normal(energy.shape))
    columns = energy.free_columns(rng.standard_normal((planes, 3, m)))
    stiff, _ = energy.products(point, columns)
    _, matrix = energy.tangent(point)
    expected = np.empty_like(columns)
    for k in range(3):
        out = np.empty(energy.shape)
        multiply(matrix.panels, energy.model.layout.split, np.ascontiguousarray(columns[:, k]), out)
        expected[:, k] = energy.free(out)
    np.testing.assert_allclose(stiff, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    moved = np.zeros((planes, 1, m))
    moved[:, 0, 0::3] = 1.0  # splines sum to one beyond the clamp, so its mass is the volume there
    u = energy.at(moved[:, 0]).displacement
    volume = energy.model.particles.volume
    np.testing.assert_allclose(
        np.sum(moved * energy.products(point, moved)[1]), np.sum(volume * u[:, 0] ** 2), rtol=1e-12
    )
