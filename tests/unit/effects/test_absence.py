"""An effect that a scene does not name, or names at zero strength, is not there: not loaded, not called, and without a byte of memory."""

import inspect
from unittest.mock import patch

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError
from reference.moving import moving_scene
from reference.scenes import rod_scene

from magmpm.compiled.by_address import address
from magmpm.effects import calls, gravity, hooks
from magmpm.effects.base import one_record
from magmpm.model import build
from magmpm.simulate import run

BODY = {
    "catheter": {
        "length": 12e-3,
        "diameter": 4e-3,
        "material": "m",
        "segments": [{"magnetization": [1, 0, 0]}],
    }
}


def test_a_bare_scene_gives_its_kernels_nothing() -> None:
    """No record, no table, no column of marks: the arguments of a bare scene's kernels hold no byte of an effect."""
    for scene in (rod_scene(), moving_scene(BODY, {})):
        model = build(scene)
        assert model.effects == ()
        assert model.remanence.shape[1] == 3
    named = build(
        moving_scene(BODY, {"gravity": {}})
    )  # one effect: its record, and no table where it has none
    assert [part.nbytes for part in named.effects] == [24, 0]
    assert (
        build(moving_scene(BODY, {})).particles.position.nbytes == named.particles.position.nbytes
    )


@pytest.mark.parametrize("moves", [False, True], ids=["at rest", "in motion"])
def test_what_is_absent_is_neither_loaded_nor_called(moves: bool) -> None:
    """A bare scene's run loads no function of any effect, and its kernels get no row; with weight it loads those of gravity alone."""
    bare = (
        moving_scene(BODY, {})
        if moves
        else rod_scene(length=12e-3, field=(0, 0, 0), gravity=(0, 0, 0))
    )
    with patch.dict(calls._ready, clear=True):
        run(bare)
        assert not calls._ready
        every = calls.in_motion(()) if moves else calls.at_rest(())
        assert not any(np.any(one) for one in every)
        run(bare.with_effects(gravity={}))
        hooks_of = [of for _, *called in calls._ready for of in called]
        assert hooks_of
        assert {of.py_func.__module__ for of in hooks_of} == {"magmpm.effects.gravity"}


B = np.array([2e-3, -3e-3, 5e-3])
BR = np.array([0.1, 0.05, -0.08])
G_EARTH = np.array([0.3, 0.2, -9.81])
RHO = 1882.0
U = np.array([1e-3, 2e-3, -3e-3])


@numba.njit
def _nothing(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    return 0.0


@pytest.mark.usefixtures("own_registry")
def test_unknown_hook_is_refused_and_leaves_no_trace() -> None:
    dtype = np.dtype([("test_unknown", np.float64)])
    with pytest.raises(
        ValueError, match=r"unknown hook 'friction'; hooks are energy, stress, force, tangent"
    ):
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


STRENGTHLESS = {
    "field": {"field": (0, 0, 0), "gravity": (0, 0, -9.81)},
    "gravity": {"field": (1e-3, 0, 3e-3), "gravity": (0, 0, 0)},
}


@pytest.mark.parametrize("absent", STRENGTHLESS)
def test_zero_strength_is_bitwise_the_effect_absent(absent: str) -> None:
    """An effect at zero strength beside another at full: the whole run gives the same bits as without it."""
    zero = rod_scene(length=12e-3, **STRENGTHLESS[absent])
    key = {"field": "magnetic_torque", "gravity": "gravity"}[absent]
    a = run(zero)
    b = run(zero.with_effects(**{key: None}))
    assert np.abs(a.particle_position - a.particle_reference).max() > 1e-5, (
        "the other effect moves the body"
    )
    assert np.array_equal(a.particle_position, b.particle_position)
    assert np.array_equal(a.particle_det_F, b.particle_det_F)
    assert (a.energy, a.iterations) == (b.energy, b.iterations)


def test_what_machine_code_could_misread_is_refused() -> None:
    """By their addresses, kernels would take any numbers for a record of another type, or for a table with gaps."""
    record, data = one_record(gravity.DTYPE, gravity=np.array([0.0, 0.0, -9.81]))
    single = record.astype([("gravity", np.float32, (3,))])
    with pytest.raises(
        TypeError, match=r"effects\.gravity: records must be contiguous, of the dtype"
    ):
        calls.rows((single, data), "load")
    with pytest.raises(TypeError, match=r"effects\.gravity: records must be contiguous"):
        calls.rows((np.repeat(record, 4)[::2], data), "load")
    for wrong in (np.zeros(4)[::2], np.zeros((2, 2)), np.zeros(2, np.float32)):
        with pytest.raises(TypeError, match=r"effects\.gravity: the table must be a flat array"):
            calls.rows((record, wrong), "load")


def test_the_c_functions_of_every_effect_have_a_text() -> None:
    """Numba reads it where it compiles one. From a line within a docstring on, Python 3.13 can't: so the effect `fluid` failed there."""
    known = {names for table in hooks._registry.values() for names in table}
    seen = 0
    for pattern, (_, called) in calls.PATTERNS.items():
        for names in known:
            module = hooks.module_of(names, called)
            if module is None:
                continue
            function, _ = calls._plain(calls.Function(pattern, module, names))
            assert inspect.getsource(function).startswith(("@", "def ")), (pattern, module)
            seen += 1
    assert seen > 20


def test_an_array_with_gaps_has_no_address() -> None:
    """A kernel would read what lies between its numbers."""
    with pytest.raises(TypingError, match="must be contiguous"):
        _first(np.zeros((4, 4))[:, ::2])


@numba.njit
def _first(values):  # type: ignore[no-untyped-def]
    return address(values, 0)
