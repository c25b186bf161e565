"""Loads by which a body acts on itself: extrapolated to the middle of the time they are held, and held while they change little."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene

from magmpm.dynamics.time_loop import CHANGE, FIRST, MOST, OwnLoads
from magmpm.effects import acting
from magmpm.scene import Scene
from magmpm.simulate import run

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


@pytest.mark.parametrize(("rate", "steps"), [(0.0, MOST), (1e5, 1)])
def test_they_are_held_by_how_much_they_change(monkeypatch: pytest.MonkeyPatch, rate: float, steps: int) -> None:
    seen = driven(monkeypatch, rate)
    assert seen[0][2] == FIRST
    assert seen[-1][2] == steps


def test_the_change_while_held_is_the_one_that_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of steps settles where the value changes by CHANGE."""
    middle, value, steps = driven(monkeypatch, rate=30.0)[-1]
    assert steps * DT * 30.0 / value == pytest.approx(CHANGE, rel=0.1)
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
