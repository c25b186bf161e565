"""The laws of effects in motion, each in a scene in which it acts: see test_effect_contract.py.

Viscous stress is objective, exerts no torque and dissipates; contact is conservative except for friction, which only brakes, and tells
where it acts; damping only brakes; zero resistance is no effect; and a motion is stable at the step that the effect allows.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.acting import KEYS, Acting, Point, acting, having, hook, scene
from reference.dynamics import Total, allowed
from scipy.stats import special_ortho_group

from magmpm.bodies.grid import spline_slopes, spline_weights
from magmpm.dynamics.step_control import body_step
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting as effects
from magmpm.effects.base import Effect, Records, Touching
from magmpm.effects.contact_force import GRIP, KEPT, MOST_PUSH, PARTS, own_grip, rubbed, touches
from magmpm.effects.contact_law import at_rest, contact_of

# kg
MASS = 2e-9


@pytest.mark.parametrize("key", having("rate_stress"))
def test_viscous_stress(key: str, rng: np.random.Generator) -> None:
    """Objective: P(Q F, Q dF + W Q F) = Q P(F, dF) for any rotation Q and spin W; without torque; and dissipative."""
    one = acting(key)
    function = hook(one.own, "rate_stress")

    def stress(F: np.ndarray, dF: np.ndarray) -> np.ndarray:
        P = np.zeros((3, 3))
        function(one.model.density[0], F, dF, P)
        return P

    for _ in range(5):
        F = Point(one, rng).F
        dF = rng.standard_normal((3, 3))
        Q = special_ortho_group.rvs(3, random_state=rng)
        w = rng.standard_normal((3, 3))
        W = w - w.T
        P = stress(F, dF)
        scale = np.abs(P).max()
        np.testing.assert_allclose(
            stress(Q @ F, Q @ dF + W @ Q @ F), Q @ P, rtol=0, atol=1e-12 * scale
        )
        np.testing.assert_allclose(stress(F, W @ F), 0.0, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(P @ F.T, F @ P.T, rtol=0, atol=1e-12 * scale)
        assert np.sum(P * dF) > 0


CONTACT = [key for key in having("contact") if effects.Effects.every()[key].PHASE == "contact"]


def pushed(function: Any, x: np.ndarray, mass: float = MASS) -> np.ndarray:
    """What contact gives a point at x."""
    f = np.zeros(PARTS)
    function(x, mass, f)
    return f


def depth(function: Any, x: np.ndarray) -> float:
    """What contact tells of a point at x."""
    return float(function(x, MASS, np.zeros(PARTS)))


def touching(key: str, rng: np.random.Generator) -> np.ndarray:
    """Places (20, 3) m, within half a millimeter of points of the surface, where the effect pushes what is at rest."""
    function = hook(acting(key).own, "contact")
    place = acting(key).model.surface.place
    places: list[np.ndarray] = []
    while len(places) < 20:
        found = [
            x for x in place + 5e-4 * rng.uniform(-1, 1, place.shape) if pushed(function, x).any()
        ]
        assert found, "in its scene it touches nothing"
        places += found
    return np.array(places[:20])


@pytest.mark.parametrize("key", CONTACT)
def test_contact_is_conservative_without_friction(key: str, rng: np.random.Generator) -> None:
    """On a particle at rest the force has a potential: its Jacobian is symmetric. It grows with the depth: the Jacobian is negative."""
    function = hook(acting(key).own, "contact")
    for x in touching(key, rng):
        # of a depth of about 1 mm, so that differences have 7 digits, and away from kinks of a
        # table
        step = 1e-8
        J = np.stack(
            [
                (pushed(function, x + step * e)[:3] - pushed(function, x - step * e)[:3])
                / (2 * step)
                for e in np.eye(3)
            ],
            axis=1,
        )
        assert np.abs(J - J.T).max() <= 1e-4 * np.abs(J).max()
        assert np.linalg.eigvalsh((J + J.T) / 2)[0] < 0


@pytest.mark.parametrize(
    "key", [key for key in CONTACT if not effects.Effects.every()[key].ONLY_IN_MOTION]
)
def test_at_rest_contact_has_the_energy_of_its_push(key: str, rng: np.random.Generator) -> None:
    """Without friction: the force of `touch` is that of `contact` on what stays in place, minus the slope of its energy; H is its own."""
    slippery = scene(key, {"friction": 0.0})
    found = slippery.effects.named()[key].records(slippery)
    push = hook(found, "contact")
    touch = hook(found, "touch")

    def at(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        f = np.zeros(3)
        H = np.zeros((3, 3))
        return touch(x, MASS, f, H), f, H

    for x in touching(key, rng):
        (_, f, H), step = at(x), 1e-8
        np.testing.assert_allclose(f, pushed(push, x)[:3], rtol=1e-12, atol=1e-12 * np.abs(f).max())
        sides = [[at(x + side * step * e) for side in (1, -1)] for e in np.eye(3)]
        slope = np.array([(ahead[0] - behind[0]) / (2 * step) for ahead, behind in sides])
        bend = np.array([(ahead[1] - behind[1]) / (2 * step) for ahead, behind in sides])
        np.testing.assert_allclose(-f, slope, rtol=0, atol=1e-4 * np.abs(f).max())
        np.testing.assert_allclose(H, -bend, rtol=0, atol=1e-4 * np.abs(H).max())


@pytest.mark.parametrize("key", CONTACT)
def test_friction_is_coulombs_law_on_velocities(key: str, rng: np.random.Generator) -> None:
    """Friction is along the surface, and at most friction times the push. Where it is less, the point stops; where it is as much, it
    opposes what is left of the sliding. The friction of a step before is taken over as far as it is allowed.
    """
    heft = 1e-4  # kg/s
    for friction in (0.0, 0.2, 10.0):
        rough = scene(key, {"friction": friction})
        function = hook(rough.effects.named()[key].records(rough), "contact")
        stopped = 0
        for k, x in enumerate(touching(key, np.random.default_rng(3))):
            f = pushed(function, x)
            push = f[:3].copy()
            size = float(np.linalg.norm(push))
            n = push / size
            kept = np.zeros(KEPT)
            before = (0.0, 0.5, 3.0)[k % 3] * friction * size * rng.standard_normal(3)
            kept[:3] = before
            assert touches(f, kept, 0) == (friction > 0)
            assert kept[MOST_PUSH] == pytest.approx(friction * size, rel=1e-12)
            begun = kept[:3].copy()
            np.testing.assert_allclose(
                begun, allowed(before, n, kept[MOST_PUSH]), atol=1e-12 * size
            )
            np.testing.assert_allclose(f[:3], push + begun, atol=1e-12 * size)
            v = 10.0 ** rng.uniform(-2, 2) * friction * size / heft * rng.standard_normal(3)
            change = np.array(rubbed(kept, 0, v, heft))
            drag = kept[:3]
            np.testing.assert_allclose(change, drag - begun, atol=1e-12 * size)
            assert abs(drag @ n) <= 1e-12 * size * max(1.0, friction)
            assert np.linalg.norm(drag) <= friction * size * (1 + 1e-12)
            after = v - (v @ n) * n + change / heft
            if np.linalg.norm(drag) < friction * size * (1 - 1e-9):
                stopped += 1
                np.testing.assert_allclose(after, 0.0, atol=1e-9 * np.linalg.norm(v))
            else:
                assert drag @ after <= 1e-12 * size
        assert friction == 0.0 or 2 < stopped < 18


@pytest.mark.parametrize("key", CONTACT)
def test_report_is_the_sum_of_the_forces(key: str, rng: np.random.Generator) -> None:
    """Of the pushes, and of the friction of their points as far as this obstacle's push allows it; a material's own coefficient counts."""
    found = acting(key).own
    function = hook(found, "contact")
    x = np.concatenate([touching(key, rng), np.full((5, 3), 4.0)])  # and five that are far away
    mass = MASS * (1 + rng.random(len(x)))
    own = np.where(rng.random(len(x)) < 0.5, np.nan, 0.7)
    pull = rng.standard_normal(x.shape)
    forces = np.zeros_like(x)
    most = np.ones(len(x))
    for p in range(20):
        f = pushed(function, x[p], mass[p])
        own_grip(own[p], f)
        share = (0.0, 0.5, 2.0)[p % 3]  # of this obstacle's push in the largest friction
        most[p] = f[GRIP] / share if share > 0 else 0.0
        if p % 2:  # it slides
            pull[p] *= most[p] / np.linalg.norm(pull[p])
        else:
            pull[p] *= 0.5 * most[p] / np.linalg.norm(pull[p])
        forces[p] = f[:3] + (share if p % 2 else min(share, 1.0)) * pull[p]
    told = contact_of(found, Touching(x, mass, own, pull, most))
    np.testing.assert_allclose(told["force"], np.sum(forces, axis=0), rtol=1e-12)
    assert told["count"] == 20
    assert 0 < told["depth"] < 60e-3
    far = contact_of(found, at_rest(x[20:], mass[20:]))
    assert (far["force"].any(), far["count"], far["depth"]) == (False, 0, 0.0)


@pytest.mark.parametrize("key", CONTACT)
def test_contact_pushes_where_it_tells_a_depth(key: str, rng: np.random.Generator) -> None:
    """And nowhere else."""
    model = acting(key).model
    contact = hook(acting(key).own, "contact")
    places = np.concatenate(
        [touching(key, rng), model.surface.place, 6e-3 * rng.uniform(-1, 1, (2000, 3))]
    )
    acted = np.array([pushed(contact, x).any() for x in places])
    told = np.array([depth(contact, x) for x in places]) > 0
    assert np.array_equal(told, acted)
    assert acted[20 : 20 + len(model.surface.mass)].any(), "the body touches it"
    assert not told.all()


@pytest.mark.parametrize("key", CONTACT)
def test_nothing_touches_within_the_distance_that_contact_tells(
    key: str, rng: np.random.Generator
) -> None:
    """Kernels do not look again before a point has moved that far. A tenth of the table's spacing is its error."""
    contact = hook(acting(key).own, "contact")
    checked = 0
    for x, way in zip(
        3e-3 * rng.uniform(-1, 1, (3000, 3)), rng.standard_normal((3000, 3)), strict=True
    ):
        gap = -depth(contact, x)
        if 0 < gap < math.inf:
            assert depth(contact, x + gap * way / np.linalg.norm(way)) < 0.1 * 2e-3 / 6
            checked += 1
    assert checked > 200


@pytest.mark.parametrize(
    "key", [k for k in having("node") if effects.Effects.every()[k].PHASE == "damping"]
)
def test_damping_only_brakes(key: str, rng: np.random.Generator) -> None:
    """It removes energy, along the velocity, and none in zero time."""
    function = hook(acting(key).own, "node")
    X = np.zeros(3)
    v = rng.standard_normal(3)
    slower = v.copy()
    function(X, np.zeros(3), slower, True, 1e-3)
    assert 0 < np.linalg.norm(slower) < np.linalg.norm(v)
    np.testing.assert_allclose(np.cross(slower, v), 0.0, rtol=0, atol=1e-14)
    same = v.copy()
    function(X, np.zeros(3), same, True, 0.0)
    assert np.array_equal(same, v)


ZERO = {"damping": {"rate": "0 1/s"}, "viscosity": {"viscosity": "0 Pa s"}}


@pytest.mark.parametrize("key", ZERO)
def test_no_resistance_is_no_effect(key: str) -> None:
    assert effects.collect(scene(key, ZERO[key])) == ()


STIFF = [key for key in KEYS if effects.Effects.every()[key].stable_step is not Effect.stable_step]


@pytest.mark.parametrize("key", having("contact", "rate_stress"))
def test_what_is_stiff_tells_its_step(key: str) -> None:
    assert key in STIFF
    step = acting(key).effect.stable_step(acting(key).model)
    assert 0 < step < math.inf


@pytest.mark.parametrize("key", CONTACT)
def test_the_step_of_contact_is_that_of_its_stiffness(key: str, rng: np.random.Generator) -> None:
    """0.7 of 2 / w, with w^2 the largest eigenvalue of the force's Jacobian over the mass."""
    own = acting(key).own
    function = hook(own, "contact")
    stiffest = 0.0
    for x in touching(key, rng):
        small = 1e-8 * np.eye(3)
        J = (
            np.array([pushed(function, x + e)[:3] - pushed(function, x - e)[:3] for e in small])
            / 2e-8
        )
        stiffest = max(stiffest, -np.linalg.eigvalsh((J + J.T) / 2)[0] / MASS)
    bound = 1.4 / math.sqrt(stiffest)
    assert acting(key).effect.stable_step(acting(key).model) == pytest.approx(bound, rel=0.02)


def growth(one: Acting, everything: Records, dt: float) -> float:
    """Spectral radius of a step of the reference about the undeformed body: the growth of a small motion. Friction is part of its state."""
    total = Total.of(replace(one.model, effects=everything))
    on = np.flatnonzero(np.repeat((total.mass > 0) & ~total.fixed, 3))
    n = 3 * len(total.X)
    m = len(on)
    touching = np.flatnonzero(total.touching())
    size = 1e-9  # m: far less than the depth of contact
    force = 1e-9 * size / dt**2

    def step(c: np.ndarray, v: np.ndarray, friction: np.ndarray) -> np.ndarray:
        total.friction[:] = friction
        after = total.step(c.reshape(-1, 3), v.reshape(-1, 3), dt)
        held = total.friction[touching].ravel() * size / force
        return np.concatenate([after[0].ravel()[on], after[1].ravel()[on] * dt, held])

    rest = np.zeros(n)
    step(rest, rest, np.zeros_like(total.friction))
    before = total.friction.copy()
    start = step(rest, rest, before)
    columns = []
    for k in range(2 * m + 3 * len(touching)):
        c, v, friction = np.zeros(n), np.zeros(n), before.copy()
        if k < 2 * m:
            (c if k < m else v)[on[k % m]] = size if k < m else size / dt
        else:
            friction[touching[(k - 2 * m) // 3], (k - 2 * m) % 3] += force
        columns.append((step(c, v, friction) - start) / size)
    return float(np.abs(np.linalg.eigvals(np.array(columns))).max())


# The plain reference has no pairs; walls have the law of contact that the ground has.
@pytest.mark.parametrize(
    "key",
    [
        pytest.param(key, marks=[pytest.mark.slow] * (key == "walls"))
        for key in STIFF
        if key != "self_contact"
    ],
)
def test_a_body_with_it_bears_the_step_it_allows(key: str) -> None:
    """At the default 0.8 of the smaller bound of body and effect no small motion grows. Contact sticks: what slides may flutter, as
    friction follows the push (Martins, Oden, Simoes, Int. J. Eng. Sci. 28 (1990) 29)."""
    one = acting(key)
    own = one.effect.stable_step(one.model)
    dt = 0.8 * min(own, body_step(TotalMotion(one.model)))
    everything = effects.collect(scene(key, {"friction": 10.0})) if key in CONTACT else one.all
    assert growth(one, everything, dt) <= 1 + 1e-6  # differences over 1 nm carry some 8 digits


@pytest.mark.parametrize("key", having("rate_stress"))
def test_the_step_of_viscous_stress_is_that_of_its_fastest_decay(key: str) -> None:
    """A single particle on its nodes, anywhere in its cell, decays at rates up to r: r dt stays far below 2, together with the elastic
    stress below 0.9 (its file says why), and is not less than a quarter of that."""
    one = acting(key)
    function = hook(one.own, "rate_stress")
    rho = one.model.density[0]
    h = one.model.grid.spacing
    viscous = np.zeros((9, 9))
    for k in range(9):
        P = np.zeros((3, 3))
        function(rho, np.eye(3), np.eye(9)[k].reshape(3, 3), P)
        viscous[k] = P.ravel()
    fastest = 0.0
    for place in (
        1e-4,
        0.1,
        0.3,
        0.5,
    ):  # of the cell; a node with a small share in the particle moves most easily
        xi = np.full((1, 3), place)
        N = spline_weights(xi)[0]
        slope = spline_slopes(xi)[0] / h[:, None]
        a, b, c = np.indices((3, 3, 3)).reshape(3, -1)
        gradient = np.stack(
            [
                slope[0, a] * N[1, b] * N[2, c],
                N[0, a] * slope[1, b] * N[2, c],
                N[0, a] * N[1, b] * slope[2, c],
            ]
        )
        strain = np.einsum("ik,Ja->iJak", np.eye(3), gradient).reshape(9, -1) / np.repeat(
            np.sqrt(N[0, a] * N[1, b] * N[2, c]), 3
        )
        fastest = max(fastest, np.linalg.eigvalsh(strain.T @ viscous @ strain)[-1] / rho)
    assert 0.9 / 4 < fastest * one.effect.stable_step(one.model) <= 0.9
