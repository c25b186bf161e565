"""Friction in equilibria along time: Coulomb's law, hysteresis, short increments, a slow motion, going on from a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_contact_statics import rod, scene, strip

from magmpm.dynamics.quasi_static import PathState, follow
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.contact import contacts_at_rest

FRICTION = 0.4
PLANE = {"point": [0.0, 0.0, -1.4e-3]}


def along(steps: int, body: dict[str, Any], effects: dict[str, Any], **more: Any) -> Scene:
    """A path of so many equilibria over a second."""
    data = scene(body, effects, **more).to_si()
    data["solver"] = {"quasi_static": {"duration": 1.0, "steps": steps}}
    return Scene.from_si(data)


def pressed(steps: int, friction: float) -> Scene:
    """A tip that is pressed onto a plane by a field that grows, and falls to less than half."""
    return along(steps, rod(), {"magnetic_torque": {}, "ground": {**PLANE, "friction": friction}}, field=growing(1.0))


def growing(time: float) -> dict[str, Any]:
    moments = [{"time": share * time, "strength": strength} for share, strength in ((0.0, 0.0), (0.5, 1.0), (1.0, 0.4))]
    return {"uniform": [0.0, 0.0, -25e-3], "over_time": {"keyframes": moments}}


def contact(state: PathState) -> Any:
    """Contact with the ground at the last equilibrium."""
    shape = state.shape
    assert shape.touched is not None
    return contacts_at_rest(shape.model, shape.touched)["ground"]


def test_a_strip_that_is_dragged_feels_friction_times_its_push() -> None:
    """A moved base drags it: every point slides, so the ground pulls back by 0.3 of what it bears."""
    ramp = {"base": {"along": [1.0, 0.0, 0.0], "distance": 0.1e-3, "over_time": {"ramp": {"duration": 1.0}}}}
    heavy = {"gravity": {"acceleration": [0.0, 0.0, -40.0]}, "ground": {"point": [0.0, 0.0, -0.75e-3], "friction": 0.3}}
    told = contact(follow(along(3, strip(), heavy, move=ramp)))
    assert told["force"][0] == pytest.approx(-0.3 * told["force"][2], rel=1e-6)
    assert abs(told["force"][1]) < 1e-9 * told["force"][2]


def test_a_pressed_tip_has_hysteresis() -> None:
    """It slides as the field grows, with Coulomb's friction; as the field falls it sticks, then slides back, later than it came. Half the
    increments change no force by more than 0.1 % of the largest, once it has landed."""
    forces: dict[int, list[np.ndarray]] = {10: [], 20: []}
    for steps, found in forces.items():
        follow(pressed(steps, FRICTION), on_state=lambda state, found=found: found.append(contact(state)["force"]))
    force = np.array(forces[10])
    np.testing.assert_allclose(force[2:], forces[20][4::2], rtol=0, atol=1e-3 * force.max())
    assert (np.abs(force[:, 0]) <= FRICTION * force[:, 2] * (1 + 1e-3) + 1e-9).all()
    assert force[5, 0] == pytest.approx(FRICTION * force[5, 2], rel=2e-3)
    assert force[10, 0] == pytest.approx(-FRICTION * force[10, 2], rel=2e-3)


def test_a_path_goes_on_from_a_checkpoint_bit_for_bit(tmp_path: Path) -> None:
    """Anchors, and how strongly points are held, are stored."""

    class Stopped(Exception):
        pass

    def stop(state: PathState) -> None:
        if state.frame == 4:
            raise Stopped

    run(pressed(6, FRICTION), folder=tmp_path / "whole")
    with pytest.raises(Stopped):
        follow(pressed(6, FRICTION), folder=tmp_path / "cut", on_state=stop)
    follow(pressed(6, FRICTION), folder=tmp_path / "cut", resume=True)
    for name in ("energies.csv", "contacts.csv", "steps.csv"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


@pytest.mark.slow
def test_the_path_is_that_of_a_slow_motion() -> None:
    """The forces of a damped motion of 0.6 s, which drags a little, differ by less than 4 % of the largest at any time."""
    slow = scene(rod(), {"magnetic_torque": {}, "ground": {**PLANE, "friction": FRICTION}}, field=growing(0.6), settle=0.6, rate=60.0)
    moved: list[tuple[float, np.ndarray]] = []
    integrate(begin(build(slow)), on_state=lambda state: moved.append((state.time / 0.6, state.contacts["ground"]["force"])))
    times, force = np.array([time for time, _ in moved]), np.array([one for _, one in moved])
    found: list[np.ndarray] = []
    follow(pressed(20, FRICTION), on_state=lambda state: found.append(contact(state)["force"]))
    for k, one in enumerate(found[4:], start=4):
        at = [np.interp(k / 20, times, force[:, axis]) for axis in range(3)]
        np.testing.assert_allclose(one, at, rtol=0, atol=0.04 * force.max())
