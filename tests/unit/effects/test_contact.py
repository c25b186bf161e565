"""Contact with ground and walls: distances, force laws, bodies that start inside an obstacle, obstacles out of reach."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene
from reference.scenes import G, rod_scene
from reference.solids import box

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve, tightest_radius
from magmpm.bodies.surface_mesh import pack_mesh, write_stl
from magmpm.effects import acting as effects
from magmpm.effects import contact_law as contact
from magmpm.effects import ground, self_contact
from magmpm.effects.acting import Effects
from magmpm.effects.body_reach import FARTHEST_MOVE, STRETCHED, body_reach
from magmpm.effects.contact_force import PARTS
from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.model import build
from magmpm.scene import Scene, load_scene

# 1/s^2, kg
STIFFNESS = 1e9
MASS = 2e-9


def test_a_straight_tube(rng: np.random.Generator) -> None:
    """Along x the distance is radius - r, near the wall within the accuracy that the module states; its gradient points to the axis."""
    radius = 5e-3
    path = curve(np.array([[-5e-3, 0, 0], [20e-3, 0, 0]]), 1e-4)
    table = distance.tube(path, radius, radius / 6)
    angle = 2 * np.pi * rng.random(500)
    r = radius * rng.uniform(0.8, 1.2, 500)
    x = np.column_stack([rng.uniform(-5e-3, 20e-3, 500), r * np.cos(angle), r * np.sin(angle)])
    d, slope = table.at(x)
    np.testing.assert_allclose(d, radius - r, rtol=0, atol=0.02 * (radius / 6) ** 2 / radius)
    inwards = -x * [0, 1, 1] / r[:, None]
    np.testing.assert_allclose(slope, inwards, rtol=0, atol=0.01)


def test_a_bent_tube_goes_on_straight(rng: np.random.Generator) -> None:
    """A quarter of a circle with known distances; beyond its ends they are those to its tangents."""
    t = np.linspace(0, np.pi / 2, 30)
    path = curve(20e-3 * np.column_stack([np.sin(t), 1 - np.cos(t), 0 * t]), 1e-5)
    assert tightest_radius(path) == pytest.approx(20e-3, rel=2e-2)
    x = np.column_stack([rng.uniform(0, 10e-3, (100, 2)), rng.uniform(-2e-3, 2e-3, 100)])
    ring = np.hypot(np.hypot(x[:, 0], x[:, 1] - 20e-3) - 20e-3, x[:, 2])
    np.testing.assert_allclose(distance.to_path(x, path), ring, rtol=0, atol=5e-6)
    before = np.column_stack([-rng.uniform(1e-3, 5e-3, 50), rng.uniform(-2e-3, 2e-3, (50, 2))])
    np.testing.assert_allclose(
        distance.to_path(before, path), np.hypot(before[:, 1], before[:, 2]), rtol=0, atol=3e-5
    )


def test_inside_of_a_closed_surface(rng: np.random.Generator) -> None:
    """A box: exact beside its faces; its edges rounded off by at most 0.2 of the table's spacing; the sign right everywhere."""
    size = np.array([20e-3, 10e-3, 8e-3])
    spacing = 0.5e-3
    solid = box((0, 0, 0), tuple(size.tolist()))
    table = distance.solid([solid.triangles], solid.triangles, spacing, 0.0)
    x = rng.uniform(-0.1, 1.1, (2000, 3)) * size
    beyond = np.maximum(-x, x - size)
    exact = -(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))
    d, slope = table.at(x)
    near = np.isfinite(d) & (np.abs(exact) < 3 * spacing)
    assert near.sum() > 1000
    assert np.abs(d - exact)[near].max() < 0.2 * spacing
    second = np.sort(beyond, axis=1)[:, 1]
    face = (
        near
        & (second < beyond.max(axis=1) - 4 * spacing)
        & (second < -4 * spacing)
        & (np.abs(exact) < 1.5 * spacing)
    )
    assert face.sum() > 100
    np.testing.assert_allclose(
        d[face], exact[face], rtol=0, atol=3e-3 * spacing
    )  # the band's end rings
    np.testing.assert_allclose(np.linalg.norm(slope[face], axis=1), 1.0, rtol=0, atol=1e-2)
    away = np.isfinite(d) & (np.abs(exact) > 0.2 * spacing)
    assert np.array_equal(d[away] > 0, exact[away] > 0)


def test_push_and_grip_have_the_numbers_of_their_formulas() -> None:
    """m w^2 depth upward, mu times that as grip, m w^2 as stiffness; nothing above."""

    def force(z: float, friction: float = 0.4) -> np.ndarray:
        law = {"friction": friction, "stiffness": STIFFNESS}
        named = ground.parameters(point=[0, 0, 1.1e-3], normal=[0, 0, 2], **law)
        f = np.zeros(PARTS)
        ground.contact(named[0][0], named[1], np.array([5.0, -3.0, z]), MASS, f)
        return f

    assert not force(1.2e-3).any()
    normal = MASS * STIFFNESS * 3e-4
    for friction in (0.0, 0.4):
        expected = [0, 0, normal, friction * normal, MASS * STIFFNESS]
        np.testing.assert_allclose(force(0.8e-3, friction), expected, rtol=1e-12)


def test_stiffness_is_that_of_the_stiffest_material() -> None:
    """Twice (K + 4/3 G) / rho / h^2: of a wave through a cell."""
    scene = rod_scene(shear=[G, 3 * G], directions=[(1, 0, 0), (0, 1, 0)], cells=4)
    wave = np.sqrt(3 * G * (20 + 4 / 3) / 1882)
    assert np.isnan(contact.own_friction(scene)).all()
    assert contact.stiffness_of(scene, 3.0) == pytest.approx(6 * wave**2 / (1e-3) ** 2)
    data = scene.to_si()
    data["materials"]["steel"] = {"shear_modulus": 8e9, "bulk_to_shear": 2.0, "density": 7850.0}
    assert contact.stiffness_of(Scene.from_si(data), 2.0) == contact.stiffness_of(scene, 2.0), (
        "of what the body is made of"
    )


def scene(**effects: dict[str, Any]) -> Scene:
    named = validate(Effects, effects, "example.yaml")
    return rod_scene(length=12e-3, cells=4).model_copy(update={"effects": named})


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0.3, 1], [0, 1, 1], [0, 0.5, -1]])
def test_a_catheter_may_begin_on_the_ground(normal: list[float]) -> None:
    """It lies on the plane with its surface in contact, at any angle of the cells of the section: it is not thrown off."""
    point = [f"{-2 * c / np.linalg.norm(normal)} mm" for c in normal]
    build(scene(ground={"point": point, "normal": normal}))


@pytest.mark.parametrize(
    ("obstacle", "inside", "at"),
    [
        (
            {"ground": {"point": ["0 mm", "0 mm", "-2 mm"], "normal": [-0.2, 0, 1]}},
            "the ground",
            lambda x: x[0] > 0 and x[2] < 0,
        ),
        (
            {
                "walls": {
                    "tube": {
                        "radius": "3 mm",
                        "path": [["-10 mm", "0 mm", "0 mm"], ["30 mm", "0 mm", "3 mm"]],
                    }
                }
            },
            "the wall",
            lambda x: x[0] > 6 and x[2] < 0,
        ),
    ],
    ids=["ground", "walls"],
)
def test_where_a_body_begins_inside_is_said(obstacle: dict[str, Any], inside: str, at: Any) -> None:
    """The message names the obstacle, the segment by its key, and the place, the tip's lower side, where a plane or tube rises."""
    named = validate(Effects, obstacle, "example.yaml")
    with pytest.raises(InputError) as caught:
        build(
            rod_scene(length=12e-3, cells=4, directions=[(1, 0, 0)] * 3).model_copy(
                update={"effects": named}
            )
        )
    found = re.search(
        rf"initial overlap of .* mm with {inside} in segment 3 \(body.catheter.segments\[2\]\), at"
        r" \(([^)]*)\) mm",
        str(caught.value),
    )
    assert found is not None, str(caught.value)
    assert at([float(c) for c in found[1].split(", ")])


def test_a_body_may_begin_just_touching_its_tube() -> None:
    def tube(height: str) -> dict[str, Any]:
        return {
            "tube": {
                "radius": "3 mm",
                "path": [["-10 mm", "0 mm", height], ["30 mm", "0 mm", height]],
            }
        }

    build(scene(walls=tube("0 mm")))
    build(scene(walls=tube("-1 mm")))
    with pytest.raises(
        InputError,
        match=(
            r"effects.walls: initial overlap of 0\.\d+ mm with the wall in.*\n.*\n.*remedy: make the lumen wider"
        ),
    ):
        build(scene(walls=tube("1.4 mm")))


def test_a_lumen_from_a_mesh(tmp_path: Path) -> None:
    """An STL box around the catheter: the same laws, with the unit of the file; a box that is too small or elsewhere is refused."""

    def lumen(unit: str) -> dict[str, Any]:
        write_stl(box((-5, -3, -3), (20, 3, 3)), tmp_path / "box.stl")
        return {"surface": {"mesh": str(tmp_path / "box.stl"), "unit": unit}}

    model = build(scene(walls=lumen("mm")))
    x = np.array([[6e-3, 0, 0], [6e-3, 0, 3.2e-3], [6e-3, -3.2e-3, 0.5e-3]])
    told = [
        contact.contact_of(model.effects, contact.at_rest(x[k : k + 1], np.full(1, MASS)))
        for k in range(3)
    ]
    assert [t["count"] for t in told] == [0, 1, 1]
    pushes = MASS * contact.stiffness_of(model.scene, 1.0) * 0.2e-3
    np.testing.assert_allclose(told[1]["force"], [0, 0, -pushes], rtol=0, atol=0.02 * pushes)
    np.testing.assert_allclose(told[2]["force"], [0, pushes, 0], rtol=0, atol=0.02 * pushes)
    with pytest.raises(InputError, match=r"the body starts .*outside the lumen"):
        build(scene(walls=lumen("um")))


def test_gap_of_two_folds(rng: np.random.Generator) -> None:
    """Two layers of a folded strip: their distance minus the size of a particle; neighbors in the body do not count."""
    x = np.arange(100) * 0.5e-3
    flat = np.column_stack([x, 0 * x, 0 * x])
    folded = np.where(x[:, None] < 25e-3, flat, np.column_stack([50e-3 - x, 0 * x, 0 * x + 2e-3]))
    gap = self_contact.gap(folded, flat, size=0.5e-3, apart=5e-3, within=4e-3)
    assert gap == pytest.approx(1.5e-3)
    assert self_contact.gap(flat, flat, size=0.5e-3, apart=5e-3, within=4e-3) == np.inf


ROOT = Path(__file__).parents[3]
L = 40e-3
D = 4e-3
CATHETER = {"catheter": {"length": L, "diameter": D, "material": "m", "segments": [{}]}}
REACH = STRETCHED * float(np.sqrt(L**2 + 2 * D**2))  # of the diagonal of the box


def placed(named: dict[str, Any], *, clamp: str = "base", duration: float = 0.1) -> Scene:
    body = {"catheter": {**CATHETER["catheter"], "clamp": clamp}}
    return moving_scene(body, named, solver={"dynamic": {"duration": duration}})


def pipe(start: float, end: float, radius: float = 5e-3) -> dict[str, Any]:
    return {"tube": {"radius": radius, "path": [[start, 0, 0], [end, 0, 0]]}}


def vessel(half: float) -> dict[str, Any]:
    solid = box((-half, -half, -half), (half, half, half))
    return {"surface": {"mesh": pack_mesh(solid), "unit": "m"}}


def plane(below: float) -> dict[str, Any]:
    return {"point": [0, 0, -below], "normal": [0, 0, 1]}


@pytest.mark.parametrize(
    ("named", "far"),
    [
        ({"ground": plane(REACH - 1e-3)}, None),
        ({"ground": plane(REACH + 0.42)}, "the ground does nothing: it is 420 mm beyond"),
        ({"walls": pipe(-10e-3, 60e-3)}, None),
        ({"walls": pipe(-10e-3, 60e-3, 0.5)}, "the lumen's wall does nothing: it is 439 mm beyond"),
        ({"walls": vessel(REACH - 1e-3)}, None),
        ({"walls": vessel(REACH + 0.42)}, "the lumen's wall does nothing: it is 420 mm beyond"),
    ],
    ids=["ground", "far ground", "tube", "wide tube", "vessel", "wide vessel"],
)
def test_what_a_held_body_can_not_reach_is_warned_of(
    named: dict[str, Any], far: str | None
) -> None:
    """A body inside the lumen and above the ground: the run is the same without them, and says so."""
    found = effects.warnings(placed(named))
    assert len(found) == (far is not None)
    if far is not None:
        assert far in found[0]
        assert found[0].startswith(f"effects.{next(iter(named))}: ")
        assert "1.5 times its length from its base" in found[0]


def test_a_tube_that_begins_far_before_the_body_is_refused_as_a_far_vessel_is() -> None:
    """480 mm before the tip; within reach, or with a feed that brings the body there, it is accepted."""
    says = (
        r"before an open end of its tube; the lumen's wall does nothing: it is 4\d\d mm"
        r" beyond.*\n.*rule.*\n.*remedy"
    )
    with pytest.raises(InputError, match=says):
        build(placed({"walls": pipe(0.52, 0.6)}))
    build(placed({"walls": pipe(50e-3, 80e-3)}))
    assert effects.warnings(placed({"walls": pipe(50e-3, 80e-3)})) == []
    fed = {"walls": pipe(0.52, 0.6), "feed": {"speed": 0.5, "exit": 0.51}}
    build(placed(fed, duration=1.0))
    assert effects.warnings(placed(fed, duration=1.0)) == []
    with pytest.raises(InputError, match="from all places its base is pushed to"):
        build(placed(fed, duration=0.5))


def test_a_free_body_may_go_as_far_as_a_motion_lets_it() -> None:
    """Ten times its size: beyond that, the watchdog ends the motion before it reaches the ground."""
    size = float(np.sqrt(L**2 + 2 * D**2))
    near = FARTHEST_MOVE * size
    far = (FARTHEST_MOVE + 1) * size
    assert effects.warnings(placed({"ground": plane(near), "gravity": {}}, clamp="none")) == []
    (said,) = effects.warnings(placed({"ground": plane(far), "gravity": {}}, clamp="none"))
    assert "10 times its size, where a motion is stopped" in said
    assert body_reach(placed({}, clamp="none")).radius == pytest.approx(
        (FARTHEST_MOVE + 0.5) * size
    )


def test_distance_from_a_tube() -> None:
    """Inside, beside and before a straight tube of 5 mm that continues 2 mm beyond its ends; exact up to the curve's steps of 0.1 mm."""
    path = curve(np.array([[0, 0, 0], [60e-3, 0, 0]]), 1e-4)
    points = np.array([[30e-3, 1e-3, 0], [30e-3, 0, 9e-3], [-5e-3, 5e-3, 0], [-5e-3, 0, 1e-3]])
    found = distance.to_tube(points, path, 5e-3, 2e-3)
    np.testing.assert_allclose(found, [4e-3, 4e-3, 3e-3, 5e-3], atol=1e-6)


@pytest.mark.parametrize(
    "path", sorted((ROOT / "data/scenes").rglob("*.yaml")), ids=lambda path: path.stem
)
def test_the_scenes_that_come_along_reach_what_they_name(path: Path) -> None:
    assert effects.warnings(load_scene(path)) == []


def test_a_lumen_in_another_unit_is_refused() -> None:
    """A vessel in millimeters read as meters reaches to kilometers."""
    solid = box((-5e3, -5e3, -5e3), (5e3, 5e3, 5e3))
    says = (
        r"walls.surface.mesh.*\n  rule: coordinates must be at most 10 m, .* 5e\+03 m\n.*check the"
        r" unit \(m\)"
    )
    with pytest.raises(InputError, match=says):
        placed({"walls": {"surface": {"mesh": pack_mesh(solid), "unit": "m"}}})
