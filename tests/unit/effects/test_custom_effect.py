"""A new effect as a user would write it: one dtype, four hooks, one call of `register`.

W = k/4 (F:F - 3)^2 - rho a . x: nonlinear in F, with stress k (F:F - 3) F, tangent k (2 F (x) F + (F:F - 3) 1) and force rho a.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.plain_forms import to_dense
from reference.scenes import G, rod_scene
from reference.taylor import slopes

from magmpm.compiled.jit import compiled
from magmpm.effects import gravity
from magmpm.effects.base import one_record
from magmpm.effects.hooks import NO_DATA, register
from magmpm.model import build
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model

# Kernels are cached on disk by the field names of their effects: a name that changes with this file avoids
# outdated ones.
_STAMP = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:8]
DTYPE = np.dtype([("stiffness", np.float64), ("pull", np.float64, (3,)), (f"test_{_STAMP}", np.int8)])


def parameters(stiffness: float, pull: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    record = np.zeros(1, DTYPE)
    record["stiffness"], record["pull"] = stiffness, pull
    return record, NO_DATA


@compiled
def squares(F):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += F[i, j] * F[i, j]
    return total


@compiled
def energy(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    a = effect.pull
    return 0.25 * effect.stiffness * (squares(F) - 3.0) ** 2 - rho * (a[0] * x[0] + a[1] * x[1] + a[2] * x[2])


@compiled
def stress(effect, data, magnet, rho, x, F, P):  # type: ignore[no-untyped-def]
    s = effect.stiffness * (squares(F) - 3.0)
    for i in range(3):
        for j in range(3):
            P[i, j] += s * F[i, j]


@compiled
def tangent(effect, data, magnet, rho, x, F, A):  # type: ignore[no-untyped-def]
    s = effect.stiffness * (squares(F) - 3.0)
    for i in range(9):
        for j in range(9):
            A[i, j] += 2.0 * effect.stiffness * F[i // 3, i % 3] * F[j // 3, j % 3]
        A[i, i] += s


@compiled
def force(effect, data, magnet, rho, x, F, f):  # type: ignore[no-untyped-def]
    for i in range(3):
        f[i] += rho * effect.pull[i]


register(DTYPE, energy=energy, stress=stress, tangent=tangent, force=force)


@pytest.fixture(scope="module")
def model() -> StaticModel:
    return static_model(build(rod_scene(length=6e-3)))


def test_gradient_and_tangent_belong_to_its_energy(model: StaticModel, rng: np.random.Generator) -> None:
    """Taylor test of the whole model, with only the new effect, as stiff as the material: orders 2 and
    3.
    """
    named = Energy(replace(model, effects=parameters(G, (3.0, 2.0, -9.81))))
    c, d = 2e-5 * rng.standard_normal((2, *named.shape))
    point = named.at(c)
    gradient, panels = named.tangent(point)
    np.testing.assert_allclose(gradient, named.residual(point), rtol=0, atol=1e-12 * np.abs(gradient).max())
    linear = float(np.sum(gradient * d))
    quadratic = float(d.ravel() @ to_dense(panels, model.layout.split) @ d.ravel()) / 2
    steps = [0.4, 0.2, 0.1, 0.05]
    first = slopes(lambda t: named.at(c + t * d).energy - point.energy - t * linear, steps)
    second = slopes(lambda t: named.at(c + t * d).energy - point.energy - t * linear - t**2 * quadratic, steps)
    # Strains here reach 0.1, and the next term of the series changes the slope by about as much at the first
    # step.
    np.testing.assert_allclose(first[-1], 2.0, atol=0.1)
    assert second[-1] == pytest.approx(3.0, abs=0.2)


def test_its_pull_is_gravity(model: StaticModel, rng: np.random.Generator) -> None:
    """Without stiffness it equals the weight of gravity.py: the same residual, bit for bit, through other hooks."""
    a = (3.0, 2.0, -9.81)
    both = parameters(0.0, a), one_record(gravity.DTYPE, gravity=np.array(a))
    ours, theirs = (Energy(replace(model, effects=named)) for named in both)
    c = 1e-5 * rng.standard_normal(ours.shape)
    assert np.array_equal(ours.residual(ours.at(c)), theirs.residual(theirs.at(c)))
    assert ours.at(c).energy == pytest.approx(theirs.at(c).energy, rel=1e-13)


def test_its_strength_is_a_value_not_a_program(model: StaticModel, rng: np.random.Generator) -> None:
    """Other parameters act without a new compilation: the stress doubles with the stiffness."""
    c = 1e-5 * rng.standard_normal((model.layout.planes, model.layout.m))
    bare, one, two = (Energy(replace(model, effects=parameters(k, (0.0, 0.0, 0.0)))) for k in (0.0, G, 2 * G))
    r0, r1, r2 = (e.residual(e.at(c)) for e in (bare, one, two))
    np.testing.assert_allclose(r2 - r0, 2 * (r1 - r0), rtol=0, atol=1e-12 * np.abs(r2).max())
    assert np.abs(r1 - r0).max() > 0.01 * np.abs(r0).max(), "it acts"
