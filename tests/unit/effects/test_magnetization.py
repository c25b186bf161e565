"""Magnetization that rotates and does not stretch. Its derivatives are tested in the contract suite, its kernels against NumPy."""

import numba
import numpy as np
import pytest
from reference.scenes import G, rod_scene

from magmpm.compiled import simd_views
from magmpm.effects import acting as effects
from magmpm.effects.magnetic_torque import (
    DTYPE,
    energy,
    parameters,
    rotating_energy,
    rotating_stress,
)
from magmpm.effects.magnetization import add_stress, rotation
from magmpm.errors import InputError
from magmpm.fields.dipole import MU0
from magmpm.materials import magnetization, young_modulus
from magmpm.model import build
from magmpm.simulate import run

B = np.array([2e-3, -3e-3, 5e-3])
BR = np.array([0.1, 0.05, -0.08])


def turns(rng: np.random.Generator, count: int) -> np.ndarray:
    """Random rotations (count, 3, 3)."""
    Q, R = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    Q *= np.sign(np.einsum("nii->ni", R))[:, None]
    return Q * np.linalg.det(Q)[:, None, None]


def deformed(rng: np.random.Generator, count: int, most: float) -> np.ndarray:
    """Deformations (count, 3, 3) with principal stretches between 1/most and most."""
    stretches = most ** rng.uniform(-1, 1, (count, 3))
    return np.einsum("nij,nj,njk->nik", turns(rng, count), stretches, turns(rng, count))


@pytest.mark.parametrize(
    ("most", "rounding"), [(1.0, 2e-15), (1.0 + 1e-8, 1e-14), (2.0, 1e-14), (10.0, 1e-11)]
)
def test_rotation_is_that_of_the_polar_decomposition(
    most: float, rounding: float, rng: np.random.Generator
) -> None:
    """From no stretch to ratios of 100 between stretches, whose square is lost of the digits."""
    for F in deformed(rng, 200, most):
        left, stretches, right = np.linalg.svd(F)
        R, s, _ = rotation(F)
        np.testing.assert_allclose(np.array(R), left @ right, rtol=0, atol=rounding)
        assert s == pytest.approx(stretches.sum(), rel=rounding)


@numba.njit
def _stress_of_eight(h, magnet, F, P):  # type: ignore[no-untyped-def]
    add_stress(
        (h[0], h[1], h[2]),
        simd_views.vector(magnet, 0),
        simd_views.matrix(F, 0),
        simd_views.matrix(P, 0),
    )


def test_eight_particles_are_each_like_one(rng: np.random.Generator) -> None:
    """In one group are stretches of 2 and no deformation, and both laws, whose steps to the root differ in number."""
    F = deformed(rng, 8, 2.0)
    F[3] = np.eye(3)
    magnet = np.column_stack([np.tile(BR, (8, 1)), np.arange(8) % 2])
    P = np.zeros(72)
    _stress_of_eight(B / MU0, magnet.T.ravel(), F.transpose(1, 2, 0).ravel(), P)
    for p in range(8):
        one = np.zeros((3, 3))
        rotating_stress(
            parameters(B, True)[0][0], np.zeros(0), magnet[p], 0.0, np.zeros(3), F[p], one
        )
        np.testing.assert_allclose(
            P.reshape(3, 3, 8)[:, :, p], one, rtol=0, atol=1e-13 * np.abs(one).max()
        )


def density(field: np.ndarray, F: np.ndarray, law: float = 1.0) -> float:
    """Energy per volume, J/m^3."""
    return rotating_energy(
        parameters(field, True)[0][0], np.zeros(0), np.append(BR, law), 0.0, np.zeros(3), F
    )


def test_energy_is_frame_indifferent_and_blind_to_stretch(rng: np.random.Generator) -> None:
    """Body and field turned together: W(Q F, Q B) = W(F, B). A pure stretch leaves W; with F Br it changes by all. Mixed as alone."""
    for F, Q in zip(deformed(rng, 20, 1.5), turns(rng, 20), strict=True):
        W = density(B, F)
        assert density(Q @ B, Q @ F) == pytest.approx(W, rel=1e-12)
        assert (
            pytest.approx(
                -B @ magnetization(np.array([True]), BR[None], F[None])[0] / MU0, rel=1e-12
            )
            == W
        )
        plain = energy(parameters(B)[0][0], np.zeros(0), BR, 0.0, np.zeros(3), F)
        assert density(B, F, law=0.0) == pytest.approx(plain, rel=1e-12)
    n = BR / np.linalg.norm(BR)
    along = np.eye(3) + 0.7 * np.outer(n, n)
    assert density(B, along) == pytest.approx(density(B, np.eye(3)), rel=1e-14)
    assert density(B, along, law=0.0) == pytest.approx(1.7 * density(B, np.eye(3)), rel=1e-14)


@pytest.mark.slow
def test_only_stretching_magnetization_lengthens_a_rod() -> None:
    """A field along the rod's magnetization: F Br lengthens it by B Br/(mu0 E), up to the clamp; R Br does not.

    Across it, both bend it alike but for shear: the symmetric part of the torque's stress, B Br/(2 mu0), makes an angle of that over G.
    """
    L = 40e-3
    Br = 0.1

    def apart(*field: float) -> np.ndarray:
        return (
            run(rod_scene(field=field)).tip - run(rod_scene(field=field, law="rotates")).tip
        ) / L

    assert abs(run(rod_scene(field=(20e-3, 0, 0), law="rotates")).tip[0] - L) < 1e-12
    assert apart(20e-3, 0, 0)[0] == pytest.approx(
        20e-3 * Br / MU0 / young_modulus(G, 20 * G), rel=0.01
    )
    assert apart(20e-3, 0, 0)[0] == pytest.approx(0.448e-2, abs=0.001e-2)
    assert np.linalg.norm(apart(0, 0, 10e-3)) == pytest.approx(10e-3 * Br / MU0 / (2 * G), rel=0.01)
    assert np.linalg.norm(apart(0, 0, 10e-3)) == pytest.approx(0.33e-2, abs=0.005e-2)


def test_what_is_not_named_costs_nothing() -> None:
    """Written out, the usual law is the same scene; particles carry no law, and the kernels are those without it."""
    named = rod_scene(field=B.tolist())
    assert "magnetization_law" not in named.to_si()["materials"]["m0"]
    assert named.hash() != rod_scene(field=B.tolist(), law="rotates").hash()
    assert build(named).remanence.shape[1] == 3
    assert effects.collect(named)[0].dtype == DTYPE


def test_segments_that_act_on_each_other_stretch() -> None:
    with pytest.raises(
        InputError,
        match=r"materials\.m1\.magnetization_law(?s:.*)supports only magnetization that stretches",
    ):
        rod_scene(directions=[(1, 0, 0), (0, 0, 1)], law=["stretches", "rotates"]).with_effects(
            magnetic_interaction={}
        )
