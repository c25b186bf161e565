"""The physics of the effects, and the mechanism by which kernels call them."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.effects import gravity, hooks
from magmpm.effects.hooks import add_energy
from magmpm.simulate import run

B, BR, G_EARTH = np.array([2e-3, -3e-3, 5e-3]), np.array([0.1, 0.05, -0.08]), np.array([0.3, 0.2, -9.81])
RHO, U = 1882.0, np.array([1e-3, 2e-3, -3e-3])
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
