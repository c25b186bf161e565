"""Every effect goes through the same laws. A new one joins by its key in `parts.Effects`, with the settings of its first example there.

Conservative hooks (energy, stress, force, tangent, softening) belong together by Taylor tests; viscous stress is objective, exerts no
torque and makes heat; contact is conservative but for friction, which only brakes; damping only brakes; no strength is no effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total, Updated
from reference.scenes import rod_scene

from magmpm import effects
from magmpm.effects import hooks
from magmpm.inputs import validate
from magmpm.model import Model, build
from magmpm.parts import Effects
from magmpm.scene import Scene

KEYS = list(effects.every())
BR, RHO, MASS, DT = np.array([0.1, 0.05, -0.08]), 1882.0, 2e-9, 1e-6
SPEED = 0.1  # m/s
NOTHING = np.zeros(0)


def scene_with(key: str, settings: dict[str, Any] | None = None, example: int = 0) -> Scene:
    """A short catheter in a field with one effect: at the settings given, or at those of an example of its key.

    Not through the scene's own rules, by which some effects need the dynamic solver and a field of a kind.
    """
    given = settings if settings is not None else (Effects.model_fields[key].examples or [{}])[example]
    named = validate(Effects, {key: given}, "example.yaml")
    scene = rod_scene(length=12e-3, field=(2e-3, -3e-3, 5e-3))
    return scene.model_copy(update={"effects": named})


def named(key: str) -> tuple[np.ndarray, ...]:
    return tuple(effects.collect(scene_with(key)))


def hook_of(named: tuple[np.ndarray, ...], hook: str) -> Callable[..., Any] | None:
    """One hook of an effect as a function of what comes after its record and data; None where it has none."""
    if not named:
        return None
    function = hooks._registry[hook].get(named[0].dtype.names)
    return None if function is None else lambda *given: function(named[0][0], named[1], *given)


def having(*wanted: str) -> list[str]:
    """Keys of the effects that have one of these hooks."""
    return [key for key in KEYS if any(hook_of(named(key), hook) for hook in wanted)]


def point(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A place in the catheter and a deformation gradient, random."""
    x = np.array([12e-3, 4e-3, 4e-3]) * (rng.random(3) - [0.0, 0.5, 0.5])
    return x, np.eye(3) + 0.2 * rng.standard_normal((3, 3))


def turn(rng: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Q * np.linalg.det(Q)


# what every effect is


@pytest.mark.parametrize("key", KEYS)
def test_it_is_described_and_its_example_runs(key: str) -> None:
    module = effects.module_of(key)
    assert (module.__doc__ or "").startswith(f"{key}: "), "the first words of the file are its key"
    assert module.PHASE in effects.PHASES
    found = named(key)
    assert len(found) in {0, 2}
    if found:
        assert any(found[0].dtype.names in table for table in hooks._registry.values())
        assert found[1].dtype == np.float64
        assert found[1].ndim == 1


@pytest.mark.parametrize("key", KEYS)
def test_it_is_deterministic(key: str, rng: np.random.Generator) -> None:
    """The same scene gives the same records and table, bit for bit."""
    one, two = named(key), named(key)
    assert [a.tobytes() for a in one] == [a.tobytes() for a in two]


def test_order_is_by_phase_not_by_file() -> None:
    examples = {key: (Effects.model_fields[key].examples or [{}])[0] for key in KEYS}
    orders = []
    for keys in (KEYS, KEYS[::-1]):
        named = validate(Effects, {key: examples[key] for key in keys}, "example.yaml")
        scene = rod_scene(length=12e-3, field=(2e-3, -3e-3, 5e-3)).model_copy(update={"effects": named})
        orders.append([record.dtype.names for record in effects.collect(scene)[::2]])
    assert orders[0] == orders[1]
    phases = [effects.PHASES.index(effects.module_of(key).PHASE) for key in KEYS]
    assert phases == sorted(phases)


# conservative hooks


def derivatives(found: tuple[np.ndarray, ...], x: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, ...]:
    """W, P = dW/dF (9,), f = -dW/dx (3,), A = d2W/dF2 (9, 9), H = d2W/dx2 (3, 3), M = d2W/dxdF (3, 9); zeros where there is no hook."""
    P, f, A, H, M = np.zeros((3, 3)), np.zeros(3), np.zeros((9, 9)), np.zeros((3, 3)), np.zeros((3, 9))
    outputs: dict[str, tuple[np.ndarray, ...]] = {
        "stress": (P,), "force": (f,), "tangent": (A,), "softening": (H, M),
    }  # fmt: skip
    for hook, out in outputs.items():
        if (function := hook_of(found, hook)) is not None:
            function(BR, RHO, x, F, *out)
    energy = hook_of(found, "energy")
    return (energy(BR, RHO, x, F) if energy else 0.0), P.ravel(), f, A, H, M


@pytest.mark.parametrize("key", having("energy", "stress", "force", "tangent", "softening"))
def test_derivatives_belong_to_the_energy(key: str, rng: np.random.Generator) -> None:
    """Taylor: with slope and curvature taken away, what is left of W falls at order 3; with the slope only, at order 2."""
    found = named(key)
    assert hook_of(found, "energy"), "an effect with a stress or force has an energy"
    for _ in range(4):
        x, F = point(rng)
        dx, dF = 1e-3 * rng.standard_normal(3), 0.3 * rng.standard_normal((3, 3))
        W, P, f, A, H, M = derivatives(found, x, F)
        d = dF.ravel()
        slope, curve = P @ d - f @ dx, d @ A @ d + dx @ H @ dx + 2 * dx @ M @ d
        steps = np.array([0.1, 0.05, 0.025, 0.0125])
        change = np.array([derivatives(found, x + t * dx, F + t * dF)[0] - W for t in steps])
        rounding = 1e-13 * abs(W) + 1e-13 * abs(slope) + 1e-300
        for order, left in ((2, change - steps * slope), (3, change - steps * slope - steps**2 * curve / 2)):
            size = np.abs(left)
            if size[-1] > 100 * rounding:
                assert np.log2(size[-2] / size[-1]) == pytest.approx(order, abs=0.15)
            else:  # nothing is left: W is of lower degree
                assert size.max() <= max(1e4 * rounding, 2 * 8**3 * size[-1])
        np.testing.assert_allclose(A, A.T, rtol=0, atol=1e-12 * np.abs(A).max())
        np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-12 * np.abs(H).max())


@pytest.mark.parametrize("key", having("stress", "force", "tangent", "softening"))
def test_hooks_add_to_what_is_there(key: str, rng: np.random.Generator) -> None:
    found, (x, F) = named(key), point(rng)
    shapes: dict[str, tuple[tuple[int, ...], ...]] = {
        "stress": ((3, 3),), "force": ((3,),), "tangent": ((9, 9),), "softening": ((3, 3), (3, 9)),
    }  # fmt: skip
    for hook, sizes in shapes.items():
        function = hook_of(found, hook)
        if function is not None:
            empty, full = [np.zeros(s) for s in sizes], [np.ones(s) for s in sizes]
            function(BR, RHO, x, F, *empty)
            function(BR, RHO, x, F, *full)
            for a, b in zip(empty, full, strict=True):
                np.testing.assert_allclose(b, a + 1.0, rtol=1e-14)


@pytest.mark.parametrize("key", having("energy"))
def test_no_load_is_no_effect(key: str) -> None:
    """A load at zero strength is left out of the kernels."""
    assert effects.collect(scene_with(key), strength=0.0) == ()


# viscous stress


@pytest.mark.parametrize("key", having("rate_stress"))
def test_viscous_stress(key: str, rng: np.random.Generator) -> None:
    """Objective: P(Q F, Q dF + W Q F) = Q P(F, dF) for any turn Q and spin W; without torque; and it makes heat."""
    function = hook_of(named(key), "rate_stress")
    assert function is not None

    def stress(F: np.ndarray, dF: np.ndarray) -> np.ndarray:
        P = np.zeros((3, 3))
        function(RHO, F, dF, P)
        return P

    for _ in range(5):
        _, F = point(rng)
        dF, Q, w = rng.standard_normal((3, 3)), turn(rng), rng.standard_normal((3, 3))
        W, P = w - w.T, stress(F, dF)
        scale = np.abs(P).max()
        np.testing.assert_allclose(stress(Q @ F, Q @ dF + W @ Q @ F), Q @ P, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(stress(F, W @ F), 0.0, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(P @ F.T, F @ P.T, rtol=0, atol=1e-12 * scale)
        assert np.sum(P * dF) > 0


# forces on a particle of a velocity

CONTACT = [key for key in having("contact") if effects.module_of(key).PHASE == "contact"]


@pytest.mark.parametrize("key", [key for key in having("contact") if key not in CONTACT])
def test_drag_only_brakes(key: str, rng: np.random.Generator) -> None:
    """It takes energy out wherever the particle is, and does not push what is at rest."""
    function = hook_of(named(key), "contact")
    assert function is not None
    for _ in range(5):
        (x, _), v, moving, rest = point(rng), rng.standard_normal(3), np.zeros(3), np.zeros(3)
        function(x, v, MASS, DT, moving)
        function(x, np.zeros(3), MASS, DT, rest)
        assert moving @ v < 0
        assert not rest.any()


def touching(found: tuple[np.ndarray, ...], rng: np.random.Generator) -> list[np.ndarray]:
    """Places where the effect pushes a particle at rest, a little way in."""
    function = hook_of(found, "contact")
    assert function is not None
    places = []
    for size in (6e-3, 20e-3, 60e-3):
        for x in size * rng.uniform(-1, 1, (3000, 3)):
            f = np.zeros(3)
            function(x, np.zeros(3), MASS, DT, f)
            if f.any():
                places.append(x)
        if len(places) >= 20:
            return places[:20]
    raise AssertionError("the example touches nothing within 60 mm of the base")


@pytest.mark.parametrize("key", CONTACT)
def test_contact_is_conservative_without_friction(key: str, rng: np.random.Generator) -> None:
    """On a particle at rest the force has a potential: its Jacobian is symmetric. It grows with the depth: the Jacobian is negative."""
    found = named(key)
    function = hook_of(found, "contact")
    assert function is not None

    def force(x: np.ndarray) -> np.ndarray:
        f = np.zeros(3)
        function(x, np.zeros(3), MASS, DT, f)
        return f

    smooth = 0
    for x in touching(found, rng):
        step = 1e-8  # of a depth of about a mm, so that differences carry 7 digits, and stays beside kinks of a table
        J = np.stack([(force(x + step * e) - force(x - step * e)) / (2 * step) for e in np.eye(3)], axis=1)
        assert np.abs(J - J.T).max() <= 1e-4 * np.abs(J).max()
        smooth += np.linalg.eigvalsh((J + J.T) / 2)[0] < 0
    assert smooth == 20


@pytest.mark.parametrize("key", CONTACT)
def test_friction_brakes_and_never_turns_back(key: str, rng: np.random.Generator) -> None:
    """What moving adds to the force opposes the motion, lies across the normal, and at most stops the sliding within the step."""
    given = dict((Effects.model_fields[key].examples or [{}])[0])
    most = {}
    for friction in (0.0, 0.2, 10.0):
        found = tuple(effects.collect(scene_with(key, {**given, "friction": friction})))
        function = hook_of(found, "contact")
        assert function is not None
        largest = 0.0
        for x in touching(found, np.random.default_rng(3)):
            v = SPEED * rng.standard_normal(3)
            rest, moving = np.zeros(3), np.zeros(3)
            function(x, np.zeros(3), MASS, DT, rest)
            function(x, v, MASS, DT, moving)
            drag, push = moving - rest, np.linalg.norm(rest)
            n = rest / push
            sliding = v - (v @ n) * n
            assert drag @ v <= 0
            assert abs(drag @ n) <= 1e-12 * push
            assert np.linalg.norm(drag) <= friction * push * (1 + 1e-12)
            assert np.linalg.norm(drag) * DT / MASS <= np.linalg.norm(sliding) * (1 + 1e-12)
            largest = max(largest, np.linalg.norm(drag) / push)
        most[friction] = largest
    assert most[0.0] == 0.0
    assert most[0.2] == pytest.approx(0.2, rel=1e-12), "slides at the edge of the cone"


@pytest.mark.parametrize("key", CONTACT)
def test_report_is_the_sum_of_the_forces(key: str, rng: np.random.Generator) -> None:
    found = named(key)
    function = hook_of(found, "contact")
    assert function is not None
    x = np.concatenate([touching(found, rng), np.full((5, 3), 4.0)])  # and five that are far away
    v, mass = SPEED * rng.standard_normal(x.shape), MASS * (1 + rng.random(len(x)))
    forces = np.zeros_like(x)
    for p in range(len(x)):
        function(x[p], v[p], mass[p], DT, forces[p])
    told = effects.module_of(key).report(found[0], found[1], x, v, mass, DT)
    np.testing.assert_allclose(told["force"], forces.sum(axis=0), rtol=1e-12)
    assert told["count"] == 20
    assert 0 < told["depth"] < 60e-3
    far = effects.module_of(key).report(found[0], found[1], x[20:], v[20:], mass[20:], DT)
    assert (far["force"].any(), far["count"], far["depth"]) == (False, 0, 0.0)


# nodes


@pytest.mark.parametrize("key", [k for k in having("node") if effects.module_of(k).PHASE == "damping"])
def test_damping_only_brakes(key: str, rng: np.random.Generator) -> None:
    """It takes energy out, along the velocity, and none in no time."""
    function = hook_of(named(key), "node")
    assert function is not None
    X, v = np.zeros(3), rng.standard_normal(3)
    slower = v.copy()
    function(X, np.zeros(3), slower, 1e-3)
    assert 0 < np.linalg.norm(slower) < np.linalg.norm(v)
    np.testing.assert_allclose(np.cross(slower, v), 0.0, rtol=0, atol=1e-14)
    same = v.copy()
    function(X, np.zeros(3), same, 0.0)
    assert np.array_equal(same, v)


ZERO = {"damping": {"rate": "0 1/s"}, "viscosity": {"viscosity": "0 Pa s"}}


@pytest.mark.parametrize("key", ZERO)
def test_no_resistance_is_no_effect(key: str) -> None:
    assert effects.collect(scene_with(key, ZERO[key])) == ()


# steps


@pytest.fixture(scope="module")
def model() -> Model:
    return build(rod_scene(length=6e-3))


@pytest.mark.parametrize("key", KEYS)
def test_the_step_it_allows(key: str, model: Model) -> None:
    stable_step = getattr(effects.module_of(key), "stable_step", None)
    found = named(key)
    if stable_step is None or not found:
        assert not hook_of(found, "contact"), "contact is stiff: it has a stable step"
        assert not hook_of(found, "rate_stress"), "viscous stress has a stable step"
    else:
        assert 0 < stable_step(*found, model) < math.inf


@pytest.mark.parametrize("key", KEYS)
def test_both_formulations_take_it(key: str, model: Model) -> None:
    """Three steps of the plain reference in each formulation, finite; what is far from contact moves as if the effect were absent."""
    with_it, without = replace(model, effects=named(key)), replace(model, effects=())
    start = 1e-3 * np.ones(3)
    for body in (with_it, without):
        total, updated = Total.of(body), Updated.of(body)
        c = np.zeros((len(total.X), 3))
        v = np.where(total.mass[:, None] > 0, start, 0.0)
        updated.v[:] = start
        for _ in range(2):
            c, v = total.step(c, v, DT)
            updated.step(DT)
        assert np.isfinite(c).all()
        assert np.isfinite(updated.x).all()
        if body is with_it:
            ours = c, updated.x
    idle = not any(hook_of(named(key), hook) for hook in hooks.HOOKS)
    same = np.array_equal(ours[0], c) and np.array_equal(ours[1], updated.x)
    assert same == (idle or effects.module_of(key).PHASE == "contact"), (
        "the examples' obstacles are out of reach"
    )


def test_unknown_hook_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown hook 'friction'; hooks are energy, stress"):
        hooks.register(np.dtype([("test_contract", np.float64)]), friction=lambda: None)
