"""Every effect must satisfy the same laws, in a scene in which it acts (reference.acting). A new one joins by its key in `Effects`.

Here what every effect is, and its conservative hooks (energy, stress, force, tangent, softening), which belong together by Taylor tests;
those of motion in test_effect_contract_motion.py."""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.acting import KEYS, Point, acting, having, hook, scene
from reference.dynamics import Total

from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import take
from magmpm.effects import acting as effects
from magmpm.effects import hooks
from magmpm.effects.acting import Effects
from magmpm.effects.base import PHASES, BodyEffect
from magmpm.inputs.settings import validate
from magmpm.model import build

DT = 1e-6  # s
STATIC = ("energy", "stress", "force", "tangent", "softening")
OUTPUTS: dict[str, tuple[tuple[int, ...], ...]] = {
    "stress": ((3, 3),),
    "force": ((3,),),
    "tangent": ((9, 9),),
    "softening": ((3, 3), (3, 9)),
}


@pytest.mark.parametrize("key", KEYS)
def test_it_is_described_and_has_records(key: str) -> None:
    """In its scene and with its first example; only self_contact, an effect without hooks, has none."""
    kind = effects.Effects.every()[key]
    assert kind.key() == key, "the file's name"
    assert (sys.modules[kind.__module__].__doc__ or "").startswith(f"{key}: "), (
        "the first words of the file are its key"
    )
    assert kind.PHASE in PHASES
    example = (Effects.model_fields[key].examples or [{}])[0]
    assert getattr(validate(Effects, {key: example}, "example.yaml"), key) is not None
    own = acting(key).own
    if key == "self_contact":
        assert not own
        return
    _, data = own
    assert any(hooks.has_hook(name, own) for name in hooks.HOOKS)
    assert data.dtype == np.float64
    assert data.ndim == 1


@pytest.mark.parametrize(
    "key", [key for key in KEYS if key != "self_contact"]
)  # without hooks: tested below
def test_it_acts(key: str) -> None:
    """In its scene the plain reference moves differently than without it, by far more than rounding."""
    found = []
    for there in (True, False):
        one = acting(key)
        total = Total.of(
            replace(
                one.model,
                effects=(
                    one.all
                    if there
                    else effects.collect(one.model.scene.with_effects(**{key: None}))
                ),
            )
        )
        L = np.array(
            [[0.0, 1.0, -2.0], [3.0, 0.0, 1.0], [2.0, 1.0, -1.0]]
        )  # 1/s: a motion with viscous stress
        c = np.zeros((len(total.X), 3))
        v = np.where(total.mass[:, None] > 0, 1e-3 + total.X @ L.T, 0.0)
        for _ in range(2):
            c, v = total.step(c, v, DT)
        assert np.isfinite(c).all()
        found.append(v)
    assert (
        np.abs(found[0] - found[1]).max() > 1e-8 * np.abs(found[1]).max()
    )  # rounding error: 1e-13


def test_self_contact_acts() -> None:
    """Two blocks 0.1 mm apart; the upper one moves: down it pushes the lower one, up it leaves it. Without the effect it passes through."""
    moved = {}
    for named in (True, False):
        given = scene("self_contact")
        body = build(given if named else given.with_effects(self_contact=None))
        lower = body.particles.segment == 0
        for speed in (-1.0, 1.0):  # m/s
            motion = begin(body).motion
            motion.v.reshape(-1, 3)[np.prod(body.grid.nodes) :, 2] = speed
            assert take(motion, (), 40, 5e-6) == (40, False)
            assert bool(motion.body_contacts().get("self_contact", {"count": 0})["count"]) == (
                named and speed < 0
            )
            moved[named, speed] = motion.particles()[1][lower, 2].mean()
    assert moved[True, -1.0] < -0.03
    assert moved[True, 1.0] == moved[False, 1.0] == moved[False, -1.0] == 0.0


@pytest.mark.parametrize("key", KEYS)
def test_it_is_deterministic(key: str) -> None:
    """The same scene gives the same records and table, bit for bit."""
    one, two = (effects.collect(scene(key)) for _ in range(2))
    assert [a.tobytes() for a in one] == [a.tobytes() for a in two]
    assert len(one) >= len(acting(key).own)


def test_order_is_by_phase_not_by_file() -> None:
    examples = {key: (Effects.model_fields[key].examples or [{}])[0] for key in KEYS}
    orders = []
    for keys in (KEYS, KEYS[::-1]):
        named = validate(Effects, {key: examples[key] for key in keys}, "example.yaml")
        given = scene("magnetic_force").model_copy(update={"effects": named})
        orders.append([record.dtype.names for record in effects.collect(given)[::2]])
    assert orders[0] == orders[1]
    assert len(orders[0]) == len(KEYS) - 1, "all but self_contact, which has none, have records"
    phases = [PHASES.index(effects.Effects.every()[key].PHASE) for key in KEYS]
    assert phases == sorted(phases)


def derivatives(
    named: tuple[np.ndarray, ...], at: Point, x: np.ndarray, F: np.ndarray
) -> tuple[Any, ...]:
    """W, P = dW/dF (9,), f = -dW/dx (3,), A = d2W/dF2 (9, 9), H = d2W/dx2 (3, 3), M = d2W/dxdF (3, 9), summed over effects."""
    sums = {name: tuple(np.zeros(s) for s in shapes) for name, shapes in OUTPUTS.items()}
    W = 0.0
    for own in hooks.pairs(named):
        for name, out in sums.items():
            if (function := hook(own, name)) is not None:
                function(at.magnet, at.rho, x, F, *out)
        if (energy := hook(own, "energy")) is not None:
            W += energy(at.magnet, at.rho, x, F)
    (P,), (f,), (A,), (H, M) = (sums[name] for name in OUTPUTS)
    return W, P.ravel(), f, A, H, M


STEPS = np.array([0.04, 0.02, 0.01, 0.005])


def falls(left: np.ndarray, order: int, rounding: float) -> bool:
    """Return True if the remainder (steps, ...) of a Taylor series is nonzero. If so, asserts that it falls with its order."""
    size = np.array([np.abs(one).max() for one in left])
    if size[0] <= 1e3 * rounding:
        return False
    if size[2] > 1e3 * rounding:  # the finest step is for those that are far from it
        last = 3 if size[3] > 1e3 * rounding else 2
        assert np.log2(size[last - 1] / size[last]) == pytest.approx(order, abs=0.15)
    return True


@pytest.mark.parametrize("key", having(*STATIC))
def test_it_has_an_energy_and_its_law_is_not_zero(key: str, rng: np.random.Generator) -> None:
    """Each of its static hooks is nonzero at some particle; magnetic_force's energy is counted in magnetic_torque; its scene has both."""
    one = acting(key)
    assert any(hook(own, "energy") for own in hooks.pairs(one.all)), (
        "a stress or force has an energy"
    )
    at = Point(one, rng)
    for name in STATIC:
        if (function := hook(one.own, name)) is None:
            continue
        if name == "energy":
            assert function(at.magnet, at.rho, at.x, at.F) != 0
            continue
        out = [np.zeros(shape) for shape in OUTPUTS[name]]
        function(at.magnet, at.rho, at.x, at.F, *out)
        assert any(part.any() for part in out), name


@pytest.mark.parametrize("key", having(*STATIC))
def test_derivatives_belong_to_the_energy(key: str, rng: np.random.Generator) -> None:
    """Taylor: the remainder of W after slope and curvature has order 3, after the slope alone order 2. The remainders of stress and force
    after their slopes (tangent, softening) have order 2; without the slopes only order 1."""
    one = acting(key)
    curved = hook(one.own, "tangent") is not None or hook(one.own, "softening") is not None
    for _ in range(4):
        at = Point(one, rng)
        dx = 1e-3 * rng.standard_normal(3)
        dF = 0.1 * rng.standard_normal((3, 3))
        W, P, f, A, H, M = derivatives(one.all, at, at.x, at.F)
        d = dF.ravel()
        slope = P @ d - f @ dx
        curve = d @ A @ d + dx @ H @ dx + 2 * dx @ M @ d
        moved = [derivatives(one.all, at, at.x + t * dx, at.F + t * dF) for t in STEPS]
        t = STEPS[:, None]
        change = np.array([there[0] - W for there in moved])[:, None]
        scale = 1e-15 * abs(W) + 1e-15 * abs(slope)
        assert falls(change, 1, scale), "it is not constant"
        assert falls(change - t * slope, 2, scale) or not curved
        falls(change - t * slope - t**2 * curve / 2, 3, scale)
        for name, was, rate in (("P", P, A @ d + dx @ M), ("f", f, -(H @ dx + M @ d))):
            change = np.array([there[1 if name == "P" else 2] - was for there in moved])
            falls(change - t * rate, 2, 1e-15 * np.abs(was).max())
            assert not curved or not rate.any() or falls(change, 1, 1e-15 * np.abs(was).max())
        np.testing.assert_allclose(A, A.T, rtol=0, atol=1e-12 * np.abs(A).max())
        np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-12 * np.abs(H).max())


@pytest.mark.parametrize(
    "key", [key for key, kind in effects.Effects.every().items() if issubclass(kind, BodyEffect)]
)
def test_what_depends_on_the_whole_body_belongs_to_its_shared_energy(
    key: str, rng: np.random.Generator
) -> None:
    """With tables computed for every shape: dE = sum V (P : dF - f . dx), at order 2; the energy of the hooks uses the current loads."""
    model = acting(key).model
    x = model.particles.position
    F = np.eye(3) + 0.05 * rng.standard_normal((len(model.density), 3, 3))
    dx = 1e-3 * rng.standard_normal(x.shape)
    dF = 0.3 * rng.standard_normal(F.shape)
    effects.refresh(model.effects, model, x, F)
    slope = 0.0
    for p, volume in enumerate(model.particles.volume):
        P = np.zeros((3, 3))
        f = np.zeros(3)
        hook(model.effects, "stress")(model.remanence[p], model.density[p], x[p], F[p], P)
        hook(model.effects, "force")(model.remanence[p], model.density[p], x[p], F[p], f)
        slope += volume * float(np.sum(P * dF[p]) - f @ dx[p])
    energy = [effects.shared_energy(model.effects, model, x + t * dx, F + t * dF) for t in STEPS]
    E = effects.shared_energy(model.effects, model, x, F)
    change = (np.array(energy) - E)[:, None]
    assert falls(change, 1, 1e-15 * abs(E))
    assert falls(change - STEPS[:, None] * slope, 2, 1e-15 * abs(E))


@pytest.mark.parametrize("key", having("stress", "force", "tangent", "softening"))
def test_hooks_add_to_what_is_there(key: str, rng: np.random.Generator) -> None:
    one = acting(key)
    at = Point(one, rng)
    for name, sizes in OUTPUTS.items():
        function = hook(one.own, name)
        if function is not None:
            empty = [np.zeros(s) for s in sizes]
            full = [np.ones(s) for s in sizes]
            function(at.magnet, at.rho, at.x, at.F, *empty)
            function(at.magnet, at.rho, at.x, at.F, *full)
            for a, b in zip(empty, full, strict=True):
                np.testing.assert_allclose(b, a + 1.0, rtol=1e-14, atol=1e-15 * np.abs(a).max())


@pytest.mark.parametrize("key", having("energy"))
def test_no_load_is_no_effect(key: str) -> None:
    """A load at zero strength is left out of the kernels; otherwise it is proportional to the strength."""
    given = scene(key)
    one = acting(key)
    assert one.effect.records(given, 0.0) == ()
    half = one.effect.records(given, 0.5)
    at = Point(one, np.random.default_rng(1))
    half = (half[0], one.own[1])  # a table of the body's shape is the same
    full, other = (hook(own, "energy")(at.magnet, at.rho, at.x, at.F) for own in (one.own, half))
    assert other == pytest.approx(full / 2, rel=1e-12)
