"""Neo-Hookean silicone: W = G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2 and its consequences.

Source: Simo and Hughes, Computational Inelasticity, section 9.2; Holzapfel, Nonlinear Solid Mechanics, sections 5.4 and 6.4. Relative
tolerances of 1e-12: a few dozen rounding errors, times K/G where the volume part cancels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.plain_forms import neo_hookean_reference
from reference.taylor import slopes
from scipy.spatial.transform import Rotation

from magmpm import materials
from magmpm.materials import poisson_ratio, young_modulus

G = 120e3
STEPS = [
    1e-2,
    5e-3,
    2.5e-3,
    1.25e-3,
]  # strains at which a remainder of third order is 1e-6 to 1e-9 of W: far above rounding
RATIOS = [1.0, 20.0, 500.0]  # K/G

seeds = st.integers(0, 2**32 - 1)


def random_F(seed: int, size: float = 0.25) -> np.ndarray:
    """A deformation gradient with det F between about 0.3 and 2.5, rotated by any angle."""
    rng = np.random.default_rng(seed)
    stretch = np.eye(3) + size * rng.uniform(-1, 1, (3, 3))
    return Rotation.random(rng=rng).as_matrix() @ stretch


def rotation(seed: int) -> np.ndarray:
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def energy(F: np.ndarray, K: float) -> float:
    J = materials.determinant(F)
    return materials.shape_energy(F, J, G) + materials.volume_energy(J, K)


def stress(F: np.ndarray, K: float) -> np.ndarray:
    J = materials.determinant(F)
    cof = np.empty((3, 3))
    P = np.empty((3, 3))
    materials.cofactor(F, cof)
    materials.stress(F, cof, J, G, materials.volume_pressure(J, K), P)
    return P


def tangent(F: np.ndarray, K: float) -> np.ndarray:
    J = materials.determinant(F)
    cof = np.empty((3, 3))
    A = np.empty((9, 9))
    materials.cofactor(F, cof)
    materials.tangent(F, cof, J, G, materials.volume_pressure(J, K), K, A)
    return A


@given(seeds, st.sampled_from(RATIOS))
def test_kernels_follow_the_formula(seed: int, ratio: float) -> None:
    """The compiled functions against W and P written with numpy.linalg."""
    F = random_F(seed)
    W, P = neo_hookean_reference(F, G, ratio * G)
    assert energy(F, ratio * G) == pytest.approx(W, rel=1e-12, abs=1e-12 * ratio * G)
    np.testing.assert_allclose(stress(F, ratio * G), P, rtol=0, atol=1e-12 * ratio * G)
    cof = np.empty((3, 3))
    materials.cofactor(F, cof)
    np.testing.assert_allclose(cof, np.linalg.det(F) * np.linalg.inv(F).T, rtol=0, atol=1e-14)
    assert materials.determinant(F) == pytest.approx(np.linalg.det(F), rel=1e-13)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ratio", RATIOS)
def test_stress_and_tangent_are_the_derivatives_of_energy(
    rng: np.random.Generator, ratio: float, seed: int
) -> None:
    """Taylor: W(F + t D) - W(F) - t P:D falls as t^2, with half the tangent subtracted too as t^3; P(F + t D) - P(F) - t A:D as t^2."""
    F = random_F(seed)
    D = rng.standard_normal((3, 3))
    K = ratio * G
    D /= np.linalg.norm(D)
    P = stress(F, K)
    AD = (tangent(F, K) @ D.ravel()).reshape(3, 3)

    def first(t: float) -> float:
        return energy(F + t * D, K) - energy(F, K) - t * np.sum(P * D)

    # The next term of the series changes the slope by about the step, 1 %: 0.1 is ten times that.
    np.testing.assert_allclose(slopes(first, STEPS), 2.0, atol=0.1)
    assert np.all(slopes(lambda t: first(t) - t**2 * np.sum(D * AD) / 2, STEPS) > 2.9)
    np.testing.assert_allclose(
        slopes(lambda t: stress(F + t * D, K) - P - t * AD, STEPS), 2.0, atol=0.1
    )


@given(seeds, seeds, seeds)
def test_frame_indifference_and_isotropy(seed: int, turn: int, other: int) -> None:
    """W(Q F R) = W(F) and P(Q F R) = Q P(F) R: rotations of observer and material cause no strain; alone, no stress. P F^T is symmetric."""
    F = random_F(seed)
    Q = rotation(turn)
    R = rotation(other)
    K = 20 * G
    P = stress(F, K)
    assert energy(Q @ F @ R, K) == pytest.approx(energy(F, K), rel=1e-11, abs=1e-12 * K)
    np.testing.assert_allclose(stress(Q @ F @ R, K), Q @ P @ R, rtol=0, atol=1e-12 * K)
    np.testing.assert_allclose(P @ F.T, F @ P.T, rtol=0, atol=1e-12 * K)
    assert energy(Q, 500 * G) == pytest.approx(0, abs=1e-13 * 500 * G)
    np.testing.assert_allclose(stress(Q, 500 * G), 0, atol=1e-13 * 500 * G)
    assert energy(np.eye(3), K) == 0
    assert not stress(np.eye(3), K).any()


@given(seeds)
def test_shape_and_volume_are_apart(seed: int) -> None:
    """Without pressure the Kirchhoff stress has no trace, a pure change of volume no shape energy: F-bar may average volume alone."""
    F = random_F(seed)
    J = np.linalg.det(F)
    cof = np.empty((3, 3))
    P = np.empty((3, 3))
    materials.cofactor(F, cof)
    materials.stress(F, cof, J, G, 0.0, P)
    assert np.trace(P @ F.T) == pytest.approx(0, abs=1e-11 * G)
    swollen = 1.3 * rotation(seed)
    assert materials.shape_energy(swollen, 1.3**3, G) == pytest.approx(0, abs=1e-12 * G)


@pytest.mark.parametrize("ratio", RATIOS)
def test_small_strain_constants(ratio: float) -> None:
    """At F = I the tangent is 2 G dev + K tr. Uniaxial tension along x: E = 9 K G / (3 K + G) and nu = (3K - 2G) / (2 (3K + G))."""
    K = ratio * G
    A = tangent(np.eye(3), K).reshape(3, 3, 3, 3)
    d = np.eye(3)
    sym = np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    expected = G * sym + (K - 2 * G / 3) * np.einsum("ij,kl->ijkl", d, d)
    np.testing.assert_allclose(A, expected, rtol=0, atol=1e-14 * K)
    normal = np.array([[A[i, i, j, j] for j in range(3)] for i in range(3)])
    strain = np.linalg.solve(normal, [1.0, 0.0, 0.0])  # strain at a stress of 1 Pa along x
    assert 1 / strain[0] == pytest.approx(young_modulus(G, K), rel=1e-12)
    assert -strain[1] / strain[0] == pytest.approx(poisson_ratio(G, K), rel=1e-12)


def test_conversions_known_numbers() -> None:
    """E = 2.951 G, not 3 G, at K = 20 G; E = 2 G (1 + nu) always; 3 G and 1/2 in the incompressible limit."""
    assert young_modulus(1.0, 20.0) == pytest.approx(2.951, abs=5e-4)  # to the given digits
    for ratio in (0.7, 2.0, 20.0, 500.0):
        assert young_modulus(G, ratio * G) == pytest.approx(
            2 * G * (1 + poisson_ratio(G, ratio * G)), rel=1e-15
        )
    assert young_modulus(1.0, 1e9) == pytest.approx(3.0, rel=1e-9)
    assert poisson_ratio(1.0, 1e9) == pytest.approx(0.5, rel=1e-9)
    assert poisson_ratio(3.0, 2.0) == 0.0


def test_crushed_to_nothing_costs_ever_more() -> None:
    """The shape energy grows without bound as det F -> 0, so that a line search rejects such a step."""
    squeezed = [energy(np.diag([s, 1.0, 1.0]), 20 * G) for s in (0.5, 0.1, 1e-2, 1e-4, 1e-6)]
    assert np.all(np.diff(squeezed) > 0)
    assert squeezed[-1] > 1e3 * G
