"""Every effect of statics says how its loads change with the numbers of a scene: remanence, density, the field, and the body's shape.

What `sensitivities` takes for derivatives, in the scene in which each effect acts (reference.acting), by Taylor slopes: the remainder after
the derivative falls with order 2, or is rounding where the load is linear."""

from typing import Any

import numpy as np
import pytest
from reference.acting import KEYS, Point, acting, having, hook

from magmpm.compiled.jit import compiled
from magmpm.effects import acting as effects
from magmpm.effects import hooks
from magmpm.effects.base import BodyChange, BodyEffect
from magmpm.effects.calls import rows
from magmpm.effects.hooks import register
from magmpm.kernels.changes import load_changes, loads

STATIC = having("stress", "force")
STEPS = np.array([0.04, 0.02, 0.01])
ROUNDING = 1e-13  # of the load: a sum of some ten products


def load(named: Any, at: Point, magnet: np.ndarray, rho: float) -> np.ndarray:
    """Stress and force of all effects, (12,)."""
    P = np.zeros((1, 3, 3))
    f = np.zeros((1, 3))
    own = rows(named, "load")
    loads(own, np.array([magnet]), np.array([rho]), at.x[None], at.F[None], P, f)
    return np.concatenate([P.ravel(), f.ravel()])


def change(named: Any, at: Point, dmagnet: np.ndarray, drho: float) -> np.ndarray:
    """Their change with remanence and density, (12,)."""
    P = np.zeros((1, 1, 3, 3))
    f = np.zeros((1, 1, 3))
    own = rows(named, "load_change")
    load_changes(
        own,
        at.magnet[None],
        np.array([at.rho]),
        at.x[None],
        at.F[None],
        dmagnet[None, None],
        np.array([[drho]]),
        P,
        f,
    )
    return np.concatenate([P.ravel(), f.ravel()])


def assert_derivative(moved: list[np.ndarray], was: np.ndarray, slope: np.ndarray) -> None:
    """Return True if the remainder (steps, ...) after the slope is rounding, or falls with order 2."""
    left = [np.abs(there - was - t * slope).max() for t, there in zip(STEPS, moved, strict=True)]
    if left[0] > ROUNDING * max(np.abs(was).max(), np.abs(slope).max()):
        np.testing.assert_allclose(np.log2(np.array(left[:-1]) / left[1:]), 2.0, atol=0.2)


def moving(at: Point) -> tuple[np.ndarray, float]:
    """A change of remanence (with a mark that stays) and density of their own size."""
    dmagnet = 0.07 * np.array([0.6, -1.0, 0.8])
    return np.concatenate([dmagnet, np.zeros(len(at.magnet) - 3)]), 0.3 * at.rho


@pytest.mark.parametrize("key", STATIC)
def test_change_with_remanence_and_density(key: str, rng: np.random.Generator) -> None:
    one = acting(key)
    at = Point(one, rng)
    dmagnet, drho = moving(at)
    for d, r in ((dmagnet, 0.0), (0.0 * dmagnet, drho)):
        was = load(one.all, at, at.magnet, at.rho)
        moved = [load(one.all, at, at.magnet + t * d, at.rho + t * r) for t in STEPS]
        assert_derivative(moved, was, change(one.all, at, d, r))


@pytest.mark.parametrize("key", STATIC)
def test_change_with_the_field(key: str, rng: np.random.Generator) -> None:
    one = acting(key)
    at = Point(one, rng)
    scene = one.model.scene
    slopes = one.effect.field_changes(scene)
    was = load(one.effect.records(scene), at, at.magnet, at.rho)
    uniform = np.array(scene.field.uniform)
    moves = 0
    for component, slope in enumerate(slopes):
        e = 1e-2 * np.eye(3)[component]  # T
        moved = [
            load(one.effect.records(scene.with_field(uniform + t * e)), at, at.magnet, at.rho)
            for t in STEPS
        ]
        if not isinstance(one.effect, BodyEffect):  # its table is not of the field
            assert_derivative(moved, was, 1e-2 * load(slope, at, at.magnet, at.rho))
        moves += bool(np.abs(moved[0] - was).max() > ROUNDING * max(np.abs(was).max(), 1.0))
    assert moves == (3 if "magnetic_torque" in key else 0)


@pytest.mark.parametrize(
    "key", [key for key in KEYS if issubclass(effects.Effects.every()[key], BodyEffect)]
)
def test_tables_change_with_the_body(key: str, rng: np.random.Generator) -> None:
    """The table's change with remanence, place and deformation; and the loads are linear in the table."""
    one = acting(key)
    model, (record, data) = one.model, one.own
    x = model.particles.position
    F = np.eye(3) + 0.05 * rng.standard_normal((len(model.density), 3, 3))
    by = BodyChange(
        0.05 * rng.standard_normal((len(x), 3)),
        1e-3 * rng.standard_normal(x.shape),
        0.3 * rng.standard_normal(F.shape),
    )
    particles = effects._particles(model)

    def table(t: float) -> np.ndarray:
        out = np.zeros_like(data)
        one.effect.refresh(
            out,
            particles._replace(remanence=particles.remanence + t * by.remanence),
            x + t * by.x,
            F + t * by.F,
        )
        return out

    _, slope = effects.refresh_change((record, data), model, x, F, by)
    for kind in (slice(0, 3), slice(3, 6)):  # fields and forces have units of their own
        pick = lambda values, kind=kind: values.reshape(-1, 6)[:, kind]  # noqa: E731
        assert np.abs(pick(slope)).max() > 0
        assert_derivative([pick(table(t)) for t in STEPS], pick(table(0.0)), pick(slope))
    at = Point(one, rng)
    two = [
        load((record, values), at, at.magnet, at.rho)
        for values in (table(0.0), slope, table(0.0) + slope)
    ]
    np.testing.assert_allclose(
        two[0] + two[1], two[2], rtol=0, atol=ROUNDING * np.abs(two[2]).max()
    )


DTYPE = np.dtype([("test_saturates", np.float64)])


@compiled
def stress(effect, data, magnet, rho, x, F, P):  # type: ignore[no-untyped-def]
    size = magnet[0] ** 2 + magnet[1] ** 2 + magnet[2] ** 2
    for i in range(3):
        P[0, i] -= effect.test_saturates * size * magnet[i]


@compiled
def stress_change(effect, data, magnet, rho, dmagnet, drho, x, F, P):  # type: ignore[no-untyped-def]
    size = magnet[0] ** 2 + magnet[1] ** 2 + magnet[2] ** 2
    along = magnet[0] * dmagnet[0] + magnet[1] * dmagnet[1] + magnet[2] * dmagnet[2]
    for i in range(3):
        P[0, i] -= effect.test_saturates * (size * dmagnet[i] + 2.0 * along * magnet[i])


@pytest.mark.usefixtures("own_registry")
def test_an_effect_that_is_not_linear_supplies_its_change(rng: np.random.Generator) -> None:
    """Stress with the cube of the remanence: the contract refuses it without `stress_change`, and takes it with that hook."""
    named = (np.array([(2e3,)], DTYPE), hooks.NO_DATA)
    at = Point(acting("gravity"), rng)
    dmagnet, _ = moving(at)

    def judge(own: Any) -> None:
        moved = [load(own, at, at.magnet + t * dmagnet, at.rho) for t in STEPS]
        assert_derivative(moved, load(own, at, at.magnet, at.rho), change(own, at, dmagnet, 0.0))

    register(DTYPE, stress=stress, stress_change=stress_change)
    judge(named)
    assert hook(named, "stress_change")
    bare = np.dtype([("test_saturates_bare", np.float64)])

    @compiled
    def plain(effect, data, magnet, rho, x, F, P):  # type: ignore[no-untyped-def]
        size = magnet[0] ** 2 + magnet[1] ** 2 + magnet[2] ** 2
        for i in range(3):
            P[0, i] -= effect.test_saturates_bare * size * magnet[i]

    register(bare, stress=plain)
    with pytest.raises(AssertionError):
        judge((np.array([(2e3,)], bare), hooks.NO_DATA))
