"""The energy of a whole model: derivatives, conservation, the patch test."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from reference.panels import multiply
from reference.plain_forms import to_dense
from reference.scenes import G, rod_scene
from reference.taylor import slopes
from scipy.spatial.transform import Rotation

from magmpm.fields.dipole import MU0
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model

LOCKING = pytest.mark.parametrize("locking", ["f-bar", "none"])
FIELD = (4e-3, -3e-3, 6e-3)
LINEAR_STIFFNESS = 5.0  # times G: the value that docs/design.md chose by measurement


def model_of(**changes: object) -> StaticModel:
    given = {"length": 8e-3, "directions": [(1, 0, 0), (0.3, -0.5, 0.8)], "shear": [G, G / 3], "cells": 3}
    return static_model(build(rod_scene(**{**given, **changes})))


def unclamped(model: StaticModel) -> StaticModel:
    """The body without the cells at the clamp: the rest is free in space."""
    free = model.particles.cell[:, 0] > 0
    volume = np.where(free, model.particles.volume, 0.0)
    return replace(model, particles=replace(model.particles, volume=volume))


def coordinates(model: StaticModel) -> np.ndarray:
    """Greville points of the free nodes, (planes, nodes, 3) m: the coefficients with which the splines represent x, y and z."""
    grid, nodes = model.grid, model.layout.node_yz
    x = grid.node_coordinates(0)[1:]
    y, z = grid.section_nodes(nodes).T
    return np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)


def affine(model: StaticModel, A: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Coefficients (planes, m) of the displacement that carries X to A X + shift, except in the clamped cells."""
    X = coordinates(model)
    return (X @ A.T + shift - X).reshape(model.layout.planes, -1)


def random_coefficients(model: StaticModel, rng: np.random.Generator, size: float = 5e-5) -> np.ndarray:
    return size * rng.standard_normal((model.layout.planes, model.layout.m))


@LOCKING
def test_gradient_and_tangent_are_derivatives(rng: np.random.Generator, locking: str) -> None:
    """Taylor test of the whole energy, with both effects: remainders of order 2 without the tangent, 3 with it; and dr = K d, order 2."""
    energy = Energy(model_of(field=FIELD, gravity=(0, 1, -9.81), anti_locking=locking))
    c, d = random_coefficients(energy.model, rng), random_coefficients(energy.model, rng)
    point = energy.at(c)
    gradient, panels = energy.tangent(point)
    Kd = np.empty_like(d)
    multiply(panels, energy.model.layout.split, d, Kd)
    linear, quadratic = float(np.sum(gradient * d)), float(np.sum(d * Kd)) / 2
    steps = [0.2, 0.1, 0.05, 0.025]  # strains of 5 % down to 0.6 %

    def first(t: float) -> float:
        return energy.at(c + t * d).energy - point.energy - t * linear

    def stress(t: float) -> np.ndarray:
        return energy.residual(energy.at(c + t * d)) - gradient - t * Kd

    # The next term of the series changes the slope by about the strain; the last slope is used, where that is 1 %.
    assert slopes(first, steps)[-1] == pytest.approx(2.0, abs=0.05)
    assert slopes(lambda t: first(t) - t**2 * quadratic, steps)[-1] == pytest.approx(3.0, abs=0.1)
    assert slopes(stress, steps)[-1] == pytest.approx(2.0, abs=0.05)


@LOCKING
def test_undeformed_body(rng: np.random.Generator, locking: str) -> None:
    """No load: no energy, no residual, and a positive definite tangent, because the clamp holds every rigid motion."""
    energy = Energy(model_of(cells=2, anti_locking=locking))
    rest = energy.at(np.zeros(energy.shape))
    assert rest.energy == 0
    residual, panels = energy.tangent(rest)
    assert not residual.any()
    values = np.linalg.eigvalsh(to_dense(panels, energy.model.layout.split))
    # The softest modes are bending, and coefficients at corners with little material: 1e-5 of the stiffest. A free motion
    # would have an eigenvalue of rounding size, 1e-16.
    assert values[0] > 1e-7 * values[-1]


@LOCKING
def test_internal_and_magnetic_forces_balance(rng: np.random.Generator, locking: str) -> None:
    """Newton's third law in P2G: in a free body the grid forces of elasticity and of a uniform field sum to zero."""
    energy = Energy(unclamped(model_of(field=FIELD, anti_locking=locking)))
    r = energy.residual(energy.at(random_coefficients(energy.model, rng)))
    total = r.reshape(-1, 3).sum(axis=0)
    np.testing.assert_allclose(total, 0, atol=1e-14 * np.abs(r).sum())  # rounding of the sum


@LOCKING
def test_torque_is_the_magnets(rng: np.random.Generator, locking: str) -> None:
    """Angular momentum in P2G: moments of the grid forces about the origin sum to minus the integral of (1/mu0) F Br x B.

    The coefficients of the deformed position, Greville points plus displacement, are the lever arms."""
    model = unclamped(model_of(field=FIELD, anti_locking=locking))
    energy = Energy(model)
    c = random_coefficients(model, rng)
    point = energy.at(c)
    r = energy.residual(point).reshape(-1, 3)
    arm = (coordinates(model) + c.reshape(coordinates(model).shape)).reshape(-1, 3)
    torque = np.cross(np.einsum("nij,nj->ni", point.F, model.remanence), FIELD) / MU0
    expected = -model.particles.volume @ torque
    found = np.cross(arm, r)
    np.testing.assert_allclose(found.sum(axis=0), expected, rtol=0, atol=1e-13 * np.abs(found).sum())
    assert np.linalg.norm(expected) > 1e-6  # N m: the compared values are not zero


def test_weight_is_all_there(rng: np.random.Generator) -> None:
    """The grid forces of gravity sum to the weight, density times exact volume times g, and are zero in the other directions."""
    g = np.array([1.0, -2.0, -9.81])
    model = unclamped(model_of(gravity=g))
    energy = Energy(model)
    total = energy.residual(energy.at(random_coefficients(model, rng))).reshape(-1, 3).sum(axis=0)
    length = 8e-3 - model.grid.spacing[0]
    np.testing.assert_allclose(-total, 1882 * np.pi * 2e-3**2 * length * g, rtol=1e-11)


def test_reaction_at_the_clamp_carries_the_weight(rng: np.random.Generator) -> None:
    """With the clamp, the sum of the residual lacks exactly what the clamped cells transmit: sum V (P + ...) grad(2 N_0)."""
    model = model_of(gravity=(0, 0, -9.81))
    energy = Energy(model)
    point = energy.at(random_coefficients(model, rng))
    free = Energy(unclamped(model))
    held = energy.residual(point).reshape(-1, 3).sum(0) - free.residual(point).reshape(-1, 3).sum(0)
    clamped = replace(model, particles=replace(model.particles, volume=model.particles.volume - free.model.particles.volume))
    only = Energy(clamped).residual(point)
    np.testing.assert_allclose(held, only.reshape(-1, 3).sum(0), rtol=0, atol=1e-13 * np.abs(only).sum())
    assert not only[3:].any(), "the clamped cells reach three planes and no further"


@LOCKING
@pytest.mark.parametrize("angle", [30, 90, 180, 270, 360])
def test_rigid_motion_is_free_of_stress(locking: str, angle: float) -> None:
    """A free body, rotated by any angle about a skew axis and moved: F = R, no energy, no force. Including full turns."""
    model = unclamped(model_of(anti_locking=locking))
    energy = Energy(model)
    R = Rotation.from_rotvec(np.radians(angle) * np.array([2, -1, 2]) / 3).as_matrix()
    point = energy.at(affine(model, R, np.array([1e-2, -3e-3, 5e-3])))
    free = model.particles.volume > 0
    np.testing.assert_allclose(point.F[free], np.broadcast_to(R, (free.sum(), 3, 3)), rtol=0, atol=1e-13)
    stiffness = G * model.particles.volume.sum()  # J per unit strain
    assert point.energy == pytest.approx(0, abs=1e-14 * stiffness)  # rounding error of J^(-2/3) I1 - 3
    # Strain from rounding 1e-14, times stress 20 G, over the section, of which a node carries a share.
    np.testing.assert_allclose(energy.residual(point), 0, atol=1e-12 * 20 * G * 1.6e-5)


@LOCKING
@pytest.mark.parametrize("particles", [2, 3])
def test_patch(locking: str, particles: int) -> None:
    """Patch test: an affine deformation gives the same F everywhere, and no residual at nodes inside the material.

    Inside: all cells of a node are full and of one material. There the Gauss points integrate the gradients exactly."""
    model = model_of(cells=5, particles=particles, directions=[(1, 0, 0)], shear=G, anti_locking=locking)
    energy = Energy(model)
    A = np.eye(3) + np.array([[0.1, 0.2, -0.1], [0.05, -0.2, 0.3], [0.1, -0.05, 0.15]])
    point = energy.at(affine(model, A, np.array([1e-3, 2e-3, -1e-3])))
    away = model.particles.cell[:, 0] > 0
    np.testing.assert_allclose(point.F[away], np.broadcast_to(A, (away.sum(), 3, 3)), rtol=0, atol=1e-13)

    residual = energy.residual(point).reshape(model.layout.planes, -1, 3)
    middle = np.flatnonzero(np.all(model.layout.node_yz == 3, axis=1))  # its 3 x 3 cells lie inside the disc
    assert len(middle) == 1
    inside = residual[3 : model.layout.planes - 2, middle[0]]  # nor at the clamp or the free end
    assert len(inside) >= 4
    traction = np.abs(residual).max()  # forces on the nodes of the surface
    np.testing.assert_allclose(inside, 0, atol=1e-12 * traction)


def test_clamped_face_does_not_move(rng: np.random.Generator) -> None:
    """For any coefficients the displacement at x = 0 is 0; it grows from there in proportion to x."""
    model = model_of(cells=2)
    energy = Energy(model)
    c = random_coefficients(model, rng)
    weights = model.weights.copy()
    first = model.particles.cell[:, 0] == 0
    weights[first, 0] = [0.0, 0.0, 0.0]  # of grid.clamp_first_node at xi = 0, see test_grid
    assert not Energy(replace(model, weights=weights)).at(c).displacement[first].any()
    assert np.abs(energy.at(c).displacement[first]).max() > 0


@pytest.mark.parametrize(("cells", "inner"), [(2, 0.0), (3, 0.0), (6, 0.0), (3, 3.2e-3), (3, 3.8e-3)])
@pytest.mark.parametrize("ratio", [2.0, 20.0, 500.0])
def test_volume_modes_are_orthogonal(cells: int, inner: float, ratio: float) -> None:
    """In each cell sum V m_j m_k = 0 for j != k; 1 for the mean, and for linear modes their stiffness relative to K.

    A mode that the few particles of a cell cannot distinguish from the others is left out, as 0."""
    model = model_of(cells=cells, inner_diameter=inner, bulk_to_shear=ratio)
    V, modes = model.particles.volume, model.modes
    share = min(1.0, LINEAR_STIFFNESS / ratio)
    wall = 1.0 if inner == 3.2e-3 else share  # through the wall of a tube with cells around its axis the linear mode has all of K
    full = 0
    for a, b in pairwise(model.particles.cell_first):
        gram = modes[a:b].T @ (V[a:b, None] * modes[a:b])
        kept = np.diag(gram) > share / 2
        np.testing.assert_allclose(gram, np.diag(kept * [1, share, share, wall]), rtol=0, atol=1e-12)
        assert kept[0], "the mean is always there"
        full += kept.all()
    assert full > len(model.particles.cell_first) / 2


def test_projection_leaves_linear_fields_alone() -> None:
    """Below K = LINEAR_STIFFNESS G, a linear variation of J over a cell is unchanged: F-bar softens no more than necessary."""
    model = model_of(cells=4, bulk_to_shear=0.9 * LINEAR_STIFFNESS)
    V, modes = model.particles.volume, model.modes
    J = 1 + model.particles.position @ [30.0, -20.0, 10.0]
    for a, b in pairwise(model.particles.cell_first):
        seen = 1 + modes[a:b] @ (modes[a:b].T @ (V[a:b] * (J[a:b] - 1)))
        np.testing.assert_allclose(seen, J[a:b], rtol=1e-12)


def test_f_bar_is_never_stiffer(rng: np.random.Generator) -> None:
    """The projected volume energy is at most the plain one; it is lower if J varies within cells, and equal otherwise."""
    plain, averaged = (Energy(model_of(anti_locking=choice)) for choice in ("none", "f-bar"))
    c = random_coefficients(plain.model, rng)
    assert averaged.at(c).energy < plain.at(c).energy
    free = [Energy(unclamped(e.model)) for e in (plain, averaged)]
    even = affine(plain.model, np.diag([1.1, 1.05, 0.98]), np.zeros(3))
    assert free[0].at(even).energy == pytest.approx(free[1].at(even).energy, rel=1e-12)


@pytest.mark.parametrize("effects", [{"magnetic_torque": {}}, {"magnetic_torque": {}, "magnetic_force": {}, "gravity": {}}])
@pytest.mark.slow  # test_stability compares the same products with the tangent of one combination of effects
def test_products_are_those_of_the_tangents_matrix(effects: dict) -> None:
    """Without a matrix: the tangent times columns, with loads that also soften, and the mass of unit density."""
    data = rod_scene(cells=2, field=(1e-3, 4e-3, 7e-3)).to_si() | {"effects": effects}
    data["field"]["dipole"] = {"position": [0.04, 0.01, 0.02], "moment": [2.0, 1.0, -3.0]}
    energy = Energy(static_model(build(Scene.from_si(data))))
    rng, (planes, m) = np.random.default_rng(3), energy.shape
    point = energy.at(1e-4 * rng.standard_normal(energy.shape))
    columns = energy.free_columns(rng.standard_normal((planes, 3, m)))
    stiff, _ = energy.products(point, columns)
    _, panels = energy.tangent(point)
    expected = np.empty_like(columns)
    for k in range(3):
        out = np.empty(energy.shape)
        multiply(panels, energy.model.layout.split, np.ascontiguousarray(columns[:, k]), out)
        expected[:, k] = energy.free(out)
    np.testing.assert_allclose(stiff, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    moved = np.zeros((planes, 1, m))
    moved[:, 0, 0::3] = 1.0  # splines sum to one beyond the clamp, so its mass is the volume there
    u = energy.at(moved[:, 0]).displacement
    volume = energy.model.particles.volume
    np.testing.assert_allclose(np.sum(moved * energy.products(point, moved)[1]), np.sum(volume * u[:, 0] ** 2), rtol=1e-12)
