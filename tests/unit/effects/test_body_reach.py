"""Ground and walls out of reach of the body give a warning or are refused, in the same way for all kinds; others do not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene
from reference.solids import box

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve
from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.effects import acting as effects
from magmpm.effects.body_reach import FAR, STRETCHED, body_reach
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene, load_scene

ROOT = Path(__file__).parents[3]
L, D = 40e-3, 4e-3
CATHETER = {"catheter": {"length": L, "diameter": D, "material": "m", "segments": [{}]}}
REACH = STRETCHED * float(np.sqrt(L**2 + 2 * D**2))  # of the diagonal of the box


def scene(named: dict[str, Any], *, clamp: str = "base", duration: float = 0.1) -> Scene:
    body = {"catheter": {**CATHETER["catheter"], "clamp": clamp}}
    return moving_scene(body, named, solver={"dynamic": {"duration": duration}})


def tube(start: float, end: float, radius: float = 5e-3) -> dict[str, Any]:
    return {"tube": {"radius": radius, "path": [[start, 0, 0], [end, 0, 0]]}}


def vessel(half: float) -> dict[str, Any]:
    solid = box((-half, -half, -half), (half, half, half))
    return {"surface": {"mesh": pack_mesh(solid), "unit": "m"}}


def ground(below: float) -> dict[str, Any]:
    return {"point": [0, 0, -below], "normal": [0, 0, 1]}


@pytest.mark.parametrize(
    ("named", "far"),
    [
        ({"ground": ground(REACH - 1e-3)}, None),
        ({"ground": ground(REACH + 0.42)}, "the ground does nothing: it is 420 mm beyond"),
        ({"walls": tube(-10e-3, 60e-3)}, None),
        ({"walls": tube(-10e-3, 60e-3, 0.5)}, "the lumen's wall does nothing: it is 439 mm beyond"),
        ({"walls": vessel(REACH - 1e-3)}, None),
        ({"walls": vessel(REACH + 0.42)}, "the lumen's wall does nothing: it is 420 mm beyond"),
    ],
    ids=["ground", "far ground", "tube", "wide tube", "vessel", "wide vessel"],
)
def test_what_a_held_body_can_not_reach_is_warned_of(named: dict[str, Any], far: str | None) -> None:
    """A body inside the lumen and above the ground: the run is the same without them, and says so."""
    found = effects.warnings(scene(named))
    assert len(found) == (far is not None)
    if far is not None:
        assert far in found[0]
        assert found[0].startswith(f"effects.{next(iter(named))}: ")
        assert "1.5 times its length from its base" in found[0]


def test_a_tube_that_begins_far_before_the_body_is_refused_as_a_far_vessel_is() -> None:
    """480 mm before the tip; within reach, or with a feed that brings the body there, it is accepted."""
    says = r"before an open end of its tube; the lumen's wall does nothing: it is 4\d\d mm beyond.*\n.*rule.*\n.*remedy"
    with pytest.raises(InputError, match=says):
        build(scene({"walls": tube(0.52, 0.6)}))
    build(scene({"walls": tube(50e-3, 80e-3)}))
    assert effects.warnings(scene({"walls": tube(50e-3, 80e-3)})) == []
    fed = {"walls": tube(0.52, 0.6), "feed": {"speed": 0.5, "exit": 0.51}}
    build(scene(fed, duration=1.0))
    assert effects.warnings(scene(fed, duration=1.0)) == []
    with pytest.raises(InputError, match="from all places its base is pushed to"):
        build(scene(fed, duration=0.5))


def test_a_free_body_may_go_as_far_as_a_motion_lets_it() -> None:
    """Ten times its size: beyond that, the watchdog ends the motion before it reaches the ground."""
    size = float(np.sqrt(L**2 + 2 * D**2))
    near, far = FAR * size, (FAR + 1) * size
    assert effects.warnings(scene({"ground": ground(near), "gravity": {}}, clamp="none")) == []
    (said,) = effects.warnings(scene({"ground": ground(far), "gravity": {}}, clamp="none"))
    assert "10 times its size, where a motion is stopped" in said
    assert body_reach(scene({}, clamp="none")).radius == pytest.approx((FAR + 0.5) * size)


def test_distance_from_a_tube() -> None:
    """Inside, beside and before a straight tube of 5 mm that continues 2 mm beyond its ends; exact up to the curve's steps of 0.1 mm."""
    path = curve(np.array([[0, 0, 0], [60e-3, 0, 0]]), 1e-4)
    points = np.array([[30e-3, 1e-3, 0], [30e-3, 0, 9e-3], [-5e-3, 5e-3, 0], [-5e-3, 0, 1e-3]])
    found = distance.to_tube(points, path, 5e-3, 2e-3)
    np.testing.assert_allclose(found, [4e-3, 4e-3, 3e-3, 5e-3], atol=1e-6)


@pytest.mark.parametrize("path", sorted((ROOT / "data/scenes").rglob("*.yaml")), ids=lambda path: path.stem)
def test_the_scenes_that_come_along_reach_what_they_name(path: Path) -> None:
    assert effects.warnings(load_scene(path)) == []


def test_a_lumen_in_another_unit_is_refused() -> None:
    """A vessel in millimeters read as meters reaches to kilometers."""
    solid = box((-5e3, -5e3, -5e3), (5e3, 5e3, 5e3))
    says = r"walls.surface.mesh.*\n  rule: coordinates must be at most 10 m, .* 5e\+03 m\n.*check the unit \(m\)"
    with pytest.raises(InputError, match=says):
        scene({"walls": {"surface": {"mesh": pack_mesh(solid), "unit": "m"}}})
