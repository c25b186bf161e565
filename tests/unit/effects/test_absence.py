"""An effect that a scene does not name, or names at zero strength, is not there: not in its kernels' machine code, arguments or memory."""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from reference.moving import moving_scene
from reference.scenes import rod_scene

from magmpm.compiled.jit import FASTMATH
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import gravity, hooks
from magmpm.effects.acting import Effects
from magmpm.effects.base import one_record
from magmpm.kernels import total_lagrangian_step as steps
from magmpm.model import Model, build
from magmpm.simulate import run

BODY = {
    "catheter": {
        "length": 12e-3,
        "diameter": 4e-3,
        "material": "m",
        "segments": [{"magnetization": [1, 0, 0]}],
    }
}
WEIGHT = one_record(gravity.DTYPE, gravity=np.array([0.0, 0.0, -9.81]))


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


def with_hooks(effects, magnet, rho, x, F, P, f, A):
    """A loop that asks effects for all that kernels ask of them."""
    total = 0.0
    for _ in range(100):
        total += P[0, 0] * F[0, 0] + hooks.add_energy(effects, 0, magnet, rho, x, F)
        hooks.add_stress(effects, 0, magnet, rho, x, F, P)
        hooks.add_force(effects, 0, magnet, rho, x, F, f)
        hooks.add_tangent(effects, 0, magnet, rho, x, F, A)
        if hooks.has_node(effects):
            hooks.change_node(effects, 0, x, x, f, True, 1e-5)
    return total


def without_hooks(effects, magnet, rho, x, F, P, f, A):
    """The same loop, in which nobody asks."""
    total = 0.0
    for _ in range(100):
        total += P[0, 0] * F[0, 0]
    return total


def opcodes(code: str) -> Counter[str]:
    """The instructions of LLVM code, by their names: names of variables and of functions apart."""
    return Counter(re.findall(r"(?:=|^) *(?:tail )?([a-z]+) ", code, flags=re.MULTILINE))


def fresh(function: Any, *given: Any) -> str:
    """The optimized LLVM code of a function for these arguments, compiled here and now."""
    compiled = numba.njit(fastmath=FASTMATH, error_model="numpy")(function)
    compiled(*given)
    whole = str(next(iter(compiled.inspect_llvm().values())))
    return next(part for part in whole.split("define ")[1:] if "%retptr" in part).partition("\n}")[
        0
    ]  # not what wraps it for Python


def test_without_effects_the_code_is_that_of_a_loop_that_never_heard_of_them() -> None:
    """The same instructions, in number and kind, and nothing allocated; with gravity there are more, so the look can fail."""
    given = (
        np.ones(3),
        1.0,
        np.ones(3),
        np.ones((3, 3)),
        np.ones((3, 3)),
        np.ones(3),
        np.ones((9, 9)),
    )
    bare = fresh(with_hooks, (), *given)
    plain = fresh(without_hooks, (), *given)
    heavy = fresh(with_hooks, WEIGHT, *given)
    assert opcodes(bare) == opcodes(plain)
    assert opcodes(heavy)["fmul"] > opcodes(bare)["fmul"]
    assert "NRT" not in bare  # Numba's functions that allocate


def given_to_steps(
    monkeypatch: pytest.MonkeyPatch, moved: list[tuple[Model, tuple[Any, ...]]]
) -> list[tuple[Any, ...]]:
    """Arguments of the kernel for each of these models with these effects."""
    seen: list[tuple[Any, ...]] = []
    with monkeypatch.context() as patch:
        patch.setattr(steps, "advance", lambda *given: seen.append(given) or 1)
        for model, effects in moved:
            TotalMotion(model).advance(1, 1e-9, effects)
    return seen


@pytest.mark.slow
def test_the_kernel_of_motion_holds_no_effect_that_is_not_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The real one, compiled here and now: for a bare scene it has as many operations on numbers (within 1 %) as its twin without effects,
    and no symbol of any effect; for weight it has gravity's and no other's."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    twin = __import__("plain_total")
    model = build(moving_scene(BODY, {}))
    seen = given_to_steps(monkeypatch, [(model, ()), (model, WEIGHT)])
    bare, heavy = (compiled_code(steps._sum_forces, forces_of(given)) for given in seen)
    _, _, cells, particles, *_, state, _, _, slabs = seen[0]
    plain = compiled_code(
        twin._sum_forces, (1, cells, particles, state, slabs)
    )  # no surface, no effects
    for key in Effects.every():
        assert key not in bare, key
        assert (key in heavy) == (key == "gravity"), key
    for one in (
        "fadd",
        "fmul",
        "fdiv",
        "fsub",
    ):  # not the same number: LLVM unrolls what it inlines by how much there is around it
        assert opcodes(bare)[one] == pytest.approx(opcodes(plain)[one], rel=0.01), one
    assert opcodes(heavy)["fmul"] > opcodes(bare)["fmul"]


@pytest.mark.slow
def test_contact_that_does_not_touch_counts_no_references(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba counts references in 32 places of the kernel of forces, with a ground in 77: once a slab or a point.

    With 114 more, a step took half as long again."""
    models = [
        build(moving_scene(BODY, effects))
        for effects in ({}, {"ground": {"point": [0.0, 0.0, -1.0]}})
    ]
    seen = given_to_steps(monkeypatch, [(model, model.effects) for model in models])
    bare, ground = (
        compiled_code(steps._sum_forces, forces_of(given)).count("@NRT_incref(") for given in seen
    )
    assert bare <= 35
    assert ground <= 80


def forces_of(given: tuple[Any, ...]) -> tuple[Any, ...]:
    """Arguments of the kernel that sums forces, from those of `advance`."""
    _, dt, cells, particles, _, _, surface, meeting, state, (effects, _), _, slabs = given
    return 0, dt, dt, 1, cells, particles, surface, meeting, state, effects, slabs


def compiled_code(function: Any, given: tuple[Any, ...]) -> str:
    """Optimized LLVM code of a compiled function for these arguments, not from the cache."""
    found = numba.njit(parallel=True, fastmath=FASTMATH, error_model="numpy", nogil=True)(
        function.py_func
    )
    found.compile(tuple(numba.typeof(one) for one in given))
    return str(next(iter(found.inspect_llvm().values())))


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


def test_python_is_told_that_only_compiled_code_calls_hooks() -> None:
    with pytest.raises(TypeError, match="only compiled code can call this"):
        hooks.add_energy((), 0, np.zeros(3), 1.0, np.zeros(3), np.eye(3))


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
