"""Loads that change have the value of their step; those by which a body acts on itself are held while they change little."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total, elastic_stress
from reference.in_motion import free_rod, moving
from reference.moving import moving_scene
from reference.scenes import rod_scene

from magmpm.dynamics import time_loop
from magmpm.dynamics.time_loop import OwnLoads, SimulationState, begin, integrate, interval
from magmpm.effects import acting
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run

ROUNDING = 1e-9  # of the largest value: about ten steps, in which the load of another step would have an error of a tenth


def ramped(duration: float) -> Scene:
    """A short clamped catheter in a field that rises from zero in `duration` (s)."""
    data = moving(rod_scene(length=8e-3, field=(0, 0, 20e-3))).to_si()
    return Scene.from_si({**data, "field": {"uniform": (0, 0, 20e-3), "over_time": {"ramp": {"duration": duration}}}})


def test_a_schedule_goes_on_within_a_chunk_of_steps() -> None:
    """A dozen steps, far fewer than a chunk, while the field rises from zero: the body is at rest then, and half a step earlier."""
    model = build(ramped(1e-3))
    moved = begin(model)
    interval(moved, 12 * moved.control.step)
    named = acting.collect(model.scene, times=moved.dt * np.arange(moved.steps, dtype=float))
    assert moved.steps == 12
    total = Total.of(replace(model, effects=named))
    c, v = np.zeros((2, *total.X.shape))
    for step in range(moved.steps):
        c, v = total.step(c, v, moved.dt, step)
    assert np.abs(c).max() > 1e-9  # m
    np.testing.assert_allclose(moved.motion.u.reshape(-1, 3), c, rtol=0, atol=ROUNDING * np.abs(c).max() + 1e-16)


def test_what_segments_do_to_each_other_follows_the_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held for 4 steps: fields of the present shape, a thousandth off those of the undeformed one, and half of their change in 4 steps."""
    for name, value in {"FIRST": 4, "MOST": 4, "CHANGE": 1e9}.items():
        monkeypatch.setattr(time_loop, name, value)
    body: dict[str, Any] = {"length": 8e-3, "directions": [(0.3, 0.2, 1.0), (-1.0, 0.4, 0.0)]}
    model = build(free_rod({"magnetic_interaction": {}}, **body))
    moved = begin(model)
    interval(moved, 12 * moved.control.step)
    assert moved.steps == 12
    found = {}
    for every in (4, 12):
        total, dt = Total.of(model), moved.dt
        c, v = np.zeros((2, *total.X.shape))
        before: list[np.ndarray] = []
        for step in range(12):
            if step % every == 0:
                acting.refresh(model.effects, model, model.particles.position + total.N @ c, np.eye(3) + total.gradient(c))
                tables = acting.own_tables(model.effects)
                now = [table.copy() for table in tables]
                for table, old in zip(tables, before, strict=bool(before)):
                    table += (table - old) / 2
                before = now
            if step == 0:
                v = -total.step(c, v, dt / 2)[1]  # a load from the first step on: velocities are those of half a step before
            c, v = total.step(c, v, dt)
        found[every] = c
    size = np.abs(found[4]).max()
    np.testing.assert_allclose(moved.motion.u.reshape(-1, 3), found[4], rtol=0, atol=ROUNDING * size)
    assert np.abs(found[12] - found[4]).max() > 1e3 * ROUNDING * size


DT = 1e-5


def driven(monkeypatch: pytest.MonkeyPatch, rate: float) -> list[tuple[float, float, int]]:
    """The middle of the time for which loads 1 + rate t (t in s) are held, the value they are given, and for how many steps: 40 times."""
    table, clock = np.zeros(2), [0.0]

    def refresh(named: Any, model: Any, x: Any, F: Any) -> None:
        table[:] = 1.0 + rate * clock[0]

    monkeypatch.setattr(acting, "refresh", refresh)
    monkeypatch.setattr(acting, "own_tables", lambda named: [table])
    own, seen = OwnLoads(None), []  # type: ignore[arg-type]
    for _ in range(40):
        steps = own.steps
        own.refresh((), np.zeros((0, 3)), np.zeros((0, 3, 3)), steps * DT)
        seen.append((clock[0] + steps * DT / 2, float(table[0]), steps))
        clock[0] += steps * DT
        own.passed(steps, DT)
    return seen


def test_loads_that_change_evenly_have_their_value_in_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    for middle, value, _ in driven(monkeypatch, rate=3.0)[1:]:
        assert value == pytest.approx(1.0 + 3.0 * middle, rel=1e-12)


@pytest.mark.parametrize(("rate", "steps"), [(0.0, time_loop.MOST), (1e5, 1)])
def test_they_are_held_by_how_much_they_change(monkeypatch: pytest.MonkeyPatch, rate: float, steps: int) -> None:
    seen = driven(monkeypatch, rate)
    assert seen[0][2] == time_loop.FIRST
    assert seen[-1][2] == steps


def test_the_change_while_held_is_the_one_that_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of steps settles where the value changes by CHANGE."""
    middle, value, steps = driven(monkeypatch, rate=30.0)[-1]
    assert steps * DT * 30.0 / value == pytest.approx(time_loop.CHANGE, rel=0.1)
    assert middle > 0


@pytest.mark.slow
def test_a_motion_with_interaction_does_not_depend_on_the_time_step() -> None:
    """Two segments that turn in a field, without frames in between: half the step changes the tip by 0.2 % of what it moves.

    Loads that are held for 256 steps, as computed, change it by 21 %."""

    def scene(safety: float) -> Scene:
        segments = [{"magnetization": [0.0, 0.3, 1.0], "length": 6e-3}, {"magnetization": [0.0, -1.0, 0.3]}]
        body = {"catheter": {"length": 12e-3, "diameter": 2e-3, "material": "m", "segments": segments}}
        effects = {"magnetic_interaction": {"blocks_across": 2}, "magnetic_torque": {}}
        data = moving_scene(body, effects, shear=1e4, duration=0.02, field={"uniform": [0.02, 0.02, 0.0]}).to_si()
        data["solver"]["dynamic"].update(safety=safety, output_every=0.02)
        return Scene.from_si(data)

    one, other = run(scene(0.8)), run(scene(0.4))
    moved = np.linalg.norm(one.tip - [12e-3, 0.0, 0.0])
    assert moved > 0.01
    assert np.linalg.norm(one.tip - other.tip) < 5e-3 * moved


FIELD, RISE = np.array([0.0, 5e-3, 20e-3]), 2e-3  # T, s: twice as long as the motion


def scene() -> Scene:
    """A short clamped catheter in a field that rises throughout the motion."""
    data = moving(rod_scene(length=8e-3, field=FIELD), duration=1e-3, output_every=5e-4).to_si()
    return Scene.from_si({**data, "field": {"uniform": FIELD.tolist(), "over_time": {"ramp": {"duration": RISE}}}})


def energies(model: Model, moved: SimulationState) -> dict[str, float]:
    """Elastic and magnetic energy, J: sum V (G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2), (J - 1)^2 by F-bar, and -sum V B . F Br / mu0."""
    F, V = moved.F, model.particles.volume
    J, I1 = np.linalg.det(F), np.einsum("nij,nij->n", F, F)
    first = model.particles.cell_first
    moments = np.add.reduceat(model.modes * (V * (J - 1))[:, None], first[:-1], axis=0)
    volume = float(np.sum(model.bulk[first[:-1]] * (moments**2).sum(axis=1))) / 2
    shape = float(V @ (model.shear * (J ** (-2 / 3) * I1 - 3))) / 2
    B = FIELD * moved.time / RISE
    magnetic = -float(V @ np.einsum("i,nij,nj->n", B, F, model.remanence)) / MU0
    return {"elastic": shape + volume, "magnetic_torque": magnetic}


def test_stress_field_and_energies_are_those_of_the_moment(tmp_path: Path) -> None:
    """The stress of a frame includes the law and the field of that moment, not of the start, zero. A result's energy is potential."""
    model = build(scene())
    moved, result = integrate(begin(model), folder=tmp_path), run(scene())
    assert moved.time == 1e-3
    B = FIELD * moved.time / RISE
    magnetic = -np.einsum("i,nj->nij", B, model.remanence) / MU0
    elastic = elastic_stress(model, moved.F)
    np.testing.assert_allclose(moved.P, elastic + magnetic, rtol=0, atol=1e-10 * np.abs(elastic).max())  # sums of about ten products
    assert np.abs(magnetic).max() > 0.05 * np.abs(elastic).max(), "to leave it out would be seen"
    wanted = energies(model, moved)
    for name, value in wanted.items():
        assert moved.energies[name] == pytest.approx(value, rel=1e-6)  # of J^(-2/3) I1 - 3, a difference of 1e-4 of its parts
    np.testing.assert_allclose(Motion.load(tmp_path).fields, np.outer([0.0, 0.25, 0.5], FIELD), rtol=0, atol=1e-9)
    assert result.energy == pytest.approx(sum(wanted.values()), rel=1e-6)
    assert result.kinetic_energy == moved.energies["kinetic"] > 1e-3 * abs(result.energy), "to add it would be seen"
