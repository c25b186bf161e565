"""Changing loads have the value of their step: compared with the plain reference, which receives them one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total
from reference.in_motion import free_rod, moving
from reference.scenes import rod_scene

from magmpm.dynamics import time_loop
from magmpm.dynamics.time_loop import begin, interval
from magmpm.effects import acting as effects
from magmpm.model import build
from magmpm.scene import Scene

ROUNDING = 1e-9  # of the largest value: about ten steps, in which the load of another step would have an error of a tenth


def ramped(duration: float) -> Scene:
    """A short clamped catheter in a field that rises from zero in `duration` (s)."""
    data = moving(rod_scene(length=8e-3, field=(0, 0, 20e-3))).to_si()
    return Scene.from_si({**data, "field": {"uniform": (0, 0, 20e-3), "over_time": {"ramp": {"duration": duration}}}})


def test_a_schedule_goes_on_within_a_chunk_of_steps() -> None:
    """A dozen steps, far fewer than a chunk, while the field rises. At zero field the undeformed body is at rest, so the velocities are
    also zero half a step earlier."""
    model = build(ramped(1e-3))
    moved = begin(model)
    interval(moved, 12 * moved.control.step)
    named = effects.collect(model.scene, times=moved.dt * np.arange(moved.steps, dtype=float))
    assert moved.steps == 12
    total = Total.of(replace(model, effects=named))
    c, v = np.zeros((2, *total.X.shape))
    for step in range(moved.steps):
        c, v = total.step(c, v, moved.dt, step)
    assert np.abs(c).max() > 1e-9  # m
    np.testing.assert_allclose(moved.motion.u.reshape(-1, 3), c, rtol=0, atol=ROUNDING * np.abs(c).max() + 1e-16)


def test_what_segments_do_to_each_other_follows_the_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held for 4 steps: the fields of the current shape, which differ by a thousandth from those of the undeformed body, and half of
    their change in the 4 steps before."""
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
                effects.refresh(model.effects, model, model.particles.position + total.N @ c, np.eye(3) + total.gradient(c))
                tables = effects.own_tables(model.effects)
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
