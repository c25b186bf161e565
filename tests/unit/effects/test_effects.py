"""The physics of the effects, and the mechanism by which kernels call them."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.effects import acting as effects
from magmpm.effects import gravity, hooks, magnetic_torque
from magmpm.effects.base import one_record
from magmpm.effects.hooks import add_energy, add_force, add_stress, add_tangent
from magmpm.fields.dipole import MU0
from magmpm.model import build
from magmpm.simulate import run
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model

B, BR, G_EARTH = np.array([2e-3, -3e-3, 5e-3]), np.array([0.1, 0.05, -0.08]), np.array([0.3, 0.2, -9.81])
RHO, U = 1882.0, np.array([1e-3, 2e-3, -3e-3])
F0 = np.array([[1.1, 0.2, -0.3], [0.1, 0.8, 0.4], [-0.2, 0.3, 1.2]])
PERMUTATION = np.array([[[(i - j) * (j - k) * (k - i) / 2 for k in range(3)] for j in range(3)] for i in range(3)])


@numba.njit
def total_energy(named, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    return add_energy(named, 0, magnet, rho, x, F)


@numba.njit
def totals(named, magnet, rho, x, F, P, A, f):  # type: ignore[no-untyped-def]
    add_stress(named, 0, magnet, rho, x, F, P)
    add_tangent(named, 0, magnet, rho, x, F, A)
    add_force(named, 0, magnet, rho, x, F, f)


def derivatives(named: tuple, u: np.ndarray = U, F: np.ndarray = F0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stress (3, 3), tangent (9, 9) and force (3,) that a tuple of effects adds."""
    P, A, f = np.zeros((3, 3)), np.zeros((9, 9)), np.zeros(3)
    totals(named, BR, RHO, u, F, P, A, f)
    return P, A, f


# magnetic_torque


def test_magnet_energy_and_stress() -> None:
    """W = -(1/mu0) B . (F Br), and P = dW/dF = -(1/mu0) B (x) Br: W is linear in F, so differences of
    any size are exact.
    """
    named = magnetic_torque.parameters(B)
    P, A, f = derivatives(named)
    W = total_energy(named, BR, RHO, U, F0)
    assert pytest.approx(-B @ F0 @ BR / MU0, rel=1e-14) == W
    for i in range(3):
        for j in range(3):
            moved = F0.copy()
            moved[i, j] += 1.0
            difference = total_energy(named, BR, RHO, U, moved) - W
            assert P[i, j] == pytest.approx(difference, abs=1e-12 * abs(W))  # rounding error of the two energies
    assert np.array_equal(P, -np.outer(B / MU0, BR))
    assert not A.any()
    assert not f.any(), "a uniform field turns, it does not pull"


def test_skew_part_of_the_stress_is_the_torque() -> None:
    """Kirchhoff stress tau = P F^T is not symmetric: eps_ijk tau_jk is the torque density (1/mu0) F Br x B.

    So the balance of angular momentum, eps_ijk tau_kj + torque_i = 0, holds with a symmetric elastic stress
    beside it.
    """
    P, _, _ = derivatives(magnetic_torque.parameters(B))
    tau = P @ F0.T
    torque = np.einsum("ijk,jk->i", PERMUTATION, tau)
    expected = np.cross(F0 @ BR, B) / MU0
    np.testing.assert_allclose(torque, expected, rtol=1e-13)
    assert np.linalg.norm(expected) > 1  # N/m^2: the compared values are not zero


def test_torque_turns_the_magnet_into_the_field() -> None:
    """The energy falls as F Br rotates toward B: this sign determines the direction in which a catheter bends."""
    named, field = magnetic_torque.parameters(np.array([0, 0, 1e-3])), 0.0
    for angle in (0.3, 0.6, 0.9):  # about -y: from +x toward +z
        turned = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        W = total_energy(named, np.array([0.1, 0, 0]), RHO, U, turned)
        assert field > W
        field = W


# gravity


def test_gravity_energy_and_force() -> None:
    """W = -rho g . x, f = rho g: 0 at the origin, linear in x, independent of F."""
    named = one_record(gravity.DTYPE, gravity=G_EARTH)
    P, A, f = derivatives(named)
    assert total_energy(named, BR, RHO, U, F0) == pytest.approx(-RHO * G_EARTH @ U, rel=1e-14)
    assert total_energy(named, BR, RHO, np.zeros(3), F0) == 0
    np.testing.assert_allclose(f, RHO * G_EARTH, rtol=1e-15)
    assert not P.any()
    assert not A.any()


# the mechanism


def test_empty_tuple_adds_nothing() -> None:
    assert total_energy((), BR, RHO, U, F0) == 0
    assert not any(out.any() for out in derivatives(()))


def test_effects_add_up_in_any_order() -> None:
    """Two effects give the sum of each alone, in any order."""
    magnet, weight = magnetic_torque.parameters(B), one_record(gravity.DTYPE, gravity=G_EARTH)
    both, swapped = derivatives(magnet + weight), derivatives(weight + magnet)
    alone = [derivatives(magnet), derivatives(weight)]
    for k in range(3):
        np.testing.assert_array_equal(both[k], alone[0][k] + alone[1][k])
        np.testing.assert_array_equal(both[k], swapped[k])
    W = total_energy(magnet + weight, BR, RHO, U, F0)
    assert pytest.approx(sum(total_energy(e, BR, RHO, U, F0) for e in (magnet, weight)), rel=1e-14) == W


def test_collect_names_only_what_the_scene_names() -> None:
    """By phase, never by the order in the file; the strength scales every load."""
    none = rod_scene()
    both = rod_scene(field=B, gravity=G_EARTH)
    assert effects.collect(none) == ()
    assert [e.dtype for e in effects.collect(both)[::2]] == [magnetic_torque.DTYPE, gravity.DTYPE]
    assert [e.dtype for e in effects.collect(none.with_effects(gravity={}))[::2]] == [gravity.DTYPE]
    half = effects.collect(both, 0.5)
    np.testing.assert_array_equal(half[0]["field_over_mu0"][0], 0.5 * B / MU0)
    np.testing.assert_array_equal(half[2]["gravity"][0], 0.5 * G_EARTH)


@numba.njit
def _nothing(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    return 0.0


@pytest.mark.usefixtures("own_registry")
def test_unknown_hook_is_refused_and_leaves_no_trace() -> None:
    dtype = np.dtype([("test_unknown", np.float64)])
    with pytest.raises(ValueError, match=r"unknown hook 'friction'; hooks are energy, stress, force, tangent"):
        hooks.register(dtype, energy=_nothing, friction=_nothing)
    hooks.register(dtype, energy=_nothing)  # a refused registration has no effect


@pytest.mark.usefixtures("own_registry")
def test_field_names_tell_effects_apart() -> None:
    """Otherwise a second effect with the same names would be called instead of the first."""
    with pytest.raises(ValueError, match="field names of its own"):
        hooks.register(gravity.DTYPE, energy=_nothing)
    with pytest.raises(ValueError, match="field names of its own"):
        hooks.register(np.dtype([("gravity", np.float32)]), stress=_nothing)
    with pytest.raises(ValueError, match="field names of its own"):
        hooks.register(np.dtype(np.float64), energy=_nothing)


def test_python_is_told_that_only_compiled_code_calls_hooks() -> None:
    with pytest.raises(TypeError, match="only compiled code can call this"):
        add_energy((), 0, np.zeros(3), 1.0, np.zeros(3), np.eye(3))


STRENGTHLESS = {"field": {"field": (0, 0, 0), "gravity": (0, 0, -9.81)}, "gravity": {"field": (1e-3, 0, 3e-3), "gravity": (0, 0, 0)}}


@pytest.mark.parametrize("absent", STRENGTHLESS)
def test_zero_strength_is_bitwise_the_effect_absent(absent: str) -> None:
    """An effect at zero strength beside another at full: the whole run gives the same bits as without it."""
    zero = rod_scene(length=12e-3, **STRENGTHLESS[absent])
    key = {"field": "magnetic_torque", "gravity": "gravity"}[absent]
    a, b = run(zero), run(zero.with_effects(**{key: None}))
    assert np.abs(a.particle_position - a.particle_reference).max() > 1e-5, "the other effect moves the body"
    assert np.array_equal(a.particle_position, b.particle_position)
    assert np.array_equal(a.particle_det_F, b.particle_det_F)
    assert (a.energy, a.iterations) == (b.energy, b.iterations)


@pytest.mark.parametrize("zeros", [magnetic_torque.parameters(np.zeros(3)), one_record(gravity.DTYPE, gravity=np.zeros(3))])
def test_kernels_with_an_effect_of_zeros(rng: np.random.Generator, zeros: tuple[np.ndarray, ...]) -> None:
    """A record of zeros in the kernels changes only the last bits, where sums are
    reassociated.
    """
    bare = static_model(build(rod_scene(length=8e-3)))
    without, with_zero = Energy(bare), Energy(replace(bare, effects=zeros))
    c = 1e-5 * rng.standard_normal(without.shape)
    r0, r1 = (e.residual(e.at(c)) for e in (without, with_zero))
    np.testing.assert_allclose(r1, r0, rtol=0, atol=1e-13 * np.abs(r0).max())
    assert with_zero.at(c).energy == pytest.approx(without.at(c).energy, rel=1e-13)
