"""Contact with ground and walls: distances, values of the force laws, and bodies that start inside an obstacle."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.dynamics import held
from reference.scenes import G, rod_scene
from reference.solids import box

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve, tightest_radius
from magmpm.bodies.surface_mesh import write_stl
from magmpm.effects import contact_force, ground, self_contact
from magmpm.effects import contact_law as contact
from magmpm.effects.acting import Effects
from magmpm.effects.contact_force import PARTS
from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.model import build
from magmpm.scene import Scene

STIFFNESS, MASS = 1e9, 2e-9  # 1/s^2, kg


def test_a_straight_tube(rng: np.random.Generator) -> None:
    """Along x the distance is radius - r, near the wall within the accuracy that the module states; its gradient points to the axis."""
    radius = 5e-3
    path = curve(np.array([[-5e-3, 0, 0], [20e-3, 0, 0]]), 1e-4)
    table = distance.tube(path, radius, radius / 6)
    angle, r = 2 * np.pi * rng.random(500), radius * rng.uniform(0.8, 1.2, 500)
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
    np.testing.assert_allclose(distance.to_path(before, path), np.hypot(before[:, 1], before[:, 2]), rtol=0, atol=3e-5)


def test_inside_of_a_closed_surface(rng: np.random.Generator) -> None:
    """A box: exact beside its faces; its edges rounded off by at most 0.2 of the table's spacing; the sign right everywhere."""
    size, spacing = np.array([20e-3, 10e-3, 8e-3]), 0.5e-3
    solid = box((0, 0, 0), tuple(size.tolist()))
    table = distance.surface(solid.vertices, solid.faces, spacing)
    x = rng.uniform(-0.1, 1.1, (2000, 3)) * size
    beyond = np.maximum(-x, x - size)
    exact = -(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))
    d, slope = table.at(x)
    near = np.isfinite(d) & (np.abs(exact) < 3 * spacing)
    assert near.sum() > 1000
    assert np.abs(d - exact)[near].max() < 0.2 * spacing
    second = np.sort(beyond, axis=1)[:, 1]
    face = (near & (second < beyond.max(axis=1) - 4 * spacing) & (second < -4 * spacing) & (np.abs(exact) < 1.5 * spacing))
    assert face.sum() > 100
    np.testing.assert_allclose(d[face], exact[face], rtol=0, atol=3e-3 * spacing)  # the band's end rings
    np.testing.assert_allclose(np.linalg.norm(slope[face], axis=1), 1.0, rtol=0, atol=1e-2)
    away = np.isfinite(d) & (np.abs(exact) > 0.2 * spacing)
    assert np.array_equal(d[away] > 0, exact[away] > 0)


def test_push_and_grip_have_the_numbers_of_their_formulas() -> None:
    """m w^2 depth - m r v upward, not below 0, mu times that as grip, m w^2 as stiffness; nothing above the plane. Without a dashpot no
    difference by the speed."""

    def force(z: float, v: list[float], friction: float = 0.4, rate: float = 2 * np.sqrt(STIFFNESS)) -> np.ndarray:
        law = {"friction": friction, "stiffness": STIFFNESS, "damping": rate}
        named = ground.parameters(point=[0, 0, 1.1e-3], normal=[0, 0, 2], **law)
        f = np.zeros(PARTS)
        ground.contact(named[0][0], named[1], np.array([5.0, -3.0, z]), np.array(v), MASS, 1e-6, f)
        return f

    assert not force(1.2e-3, [1, 0, 0]).any()
    normal = MASS * STIFFNESS * 3e-4
    slow = 0.1 * np.sqrt(STIFFNESS) * 3e-4  # m/s: the dashpot takes a fifth of the push
    for v, push in (([3.0, 4.0, 0.0], normal), ([3.0, 4.0, slow], 0.8 * normal), ([0, 0, -slow], 1.2 * normal), ([0, 0, 6 * slow], 0.0)):
        np.testing.assert_allclose(force(0.8e-3, v), [0, 0, push, 0, 0, 0.4 * push, MASS * STIFFNESS], rtol=1e-12)
        np.testing.assert_allclose(force(0.8e-3, v, 0.0, 0.0), [0, 0, normal, 0, 0, 0, MASS * STIFFNESS], rtol=1e-12)


def test_the_spring_of_friction_begins_soft(rng: np.random.Generator) -> None:
    """Its push has the slope of `soft` times the full stiffness at the surface, and of all of it from the knee on, without a jump."""
    named = ground.parameters(point=[0, 0, 0], normal=[0, 0, 1], friction=0.0, stiffness=STIFFNESS, soft=0.1, knee=1e-5)

    def push(depth: float) -> float:
        f = np.zeros(PARTS)
        ground.contact(named[0][0], named[1], np.array([0.0, 0.0, -depth]), np.zeros(3), MASS, 1e-6, f)
        return float(f[2]) / (MASS * STIFFNESS)

    assert push(1e-9) == pytest.approx(0.1e-9, rel=1e-3)
    for depth, slope in ((5e-6, 0.55), (1e-5, 1.0), (3e-5, 1.0)):
        assert (push(depth * (1 + 1e-6)) - push(depth * (1 - 1e-6))) / (2e-6 * depth) == pytest.approx(slope, rel=1e-5)


def test_friction_is_a_spring_with_a_slider() -> None:
    """3 um to the side: the spring's force. 50 um: the grip, 0.4 of the push, and the anchor follows at the distance it can hold. Back by
    3 um: less by the spring's 3 um, toward the same side. Lifted: no force, and the anchor is where the particle is."""
    depth = 3e-5
    push, rigidity = MASS * STIFFNESS * depth, MASS * STIFFNESS
    anchor = np.zeros(3)

    def at(x: list[float], pressed: bool = True) -> np.ndarray:
        f = np.array([0, 0, push, 0, 0, 0.4 * push, rigidity]) if pressed else np.zeros(PARTS)
        told = held(np.array(x), anchor, f)
        contact_force.hold(np.array(x), anchor, f)
        np.testing.assert_allclose(f[:3], told[0], rtol=0, atol=1e-12 * push)
        np.testing.assert_allclose(anchor, told[1], rtol=0, atol=1e-18)
        return f[:3]

    np.testing.assert_allclose(at([3e-6, 0, -depth]), [-3e-6 * rigidity, 0, push], rtol=1e-12)
    np.testing.assert_allclose(at([3e-5, 4e-5, -depth]), push * np.array([-0.24, -0.32, 1]), rtol=0, atol=1e-2 * push)
    np.testing.assert_allclose(np.linalg.norm(at([3e-5, 4e-5, -depth])[:2]), 0.4 * push, rtol=1e-9)
    np.testing.assert_allclose(anchor[2], -depth, rtol=1e-12)
    before = at([3e-5, 4e-5, -depth])
    np.testing.assert_allclose(at([2.7e-5, 4e-5, -depth]) - before, [3e-6 * rigidity, 0, 0], rtol=0, atol=1e-9 * push)
    assert not at([0.1, 0.2, 0.3], pressed=False).any()
    np.testing.assert_array_equal(anchor, [0.1, 0.2, 0.3])


def test_friction_gives_back_no_more_than_it_took(rng: np.random.Generator) -> None:
    """Along any closed way under constant push its work is negative, but for the energy that its spring holds at the end."""
    depth = 3e-5
    push, rigidity = MASS * STIFFNESS * depth, MASS * STIFFNESS
    for _ in range(10):
        way = np.cumsum(2e-6 * rng.standard_normal((400, 3)), axis=0)  # the spring holds 12 um: it sticks and slides
        way -= np.linspace(0, 1, 400)[:, None] * (way[-1] - way[0]) + way[0]
        anchor, work, last = way[0].copy(), 0.0, np.zeros(3)
        for k in range(1, 400):
            f = np.array([0, 0, push, 0, 0, 0.4 * push, rigidity])
            contact_force.hold(way[k], anchor, f)
            f[2] -= push
            work += 0.5 * (f[:3] + last) @ (way[k] - way[k - 1])
            last = f[:3].copy()
        assert work < -(0.4 * push) * 1e-5, "it slid: energy is lost"


def test_stiffness_is_that_of_the_stiffest_material() -> None:
    """(K + 4/3 G) / rho / h^2: a wave through a cell. With friction it begins with h over three diameters of that, beside a dashpot."""
    scene = rod_scene(shear=[G, 3 * G], directions=[(1, 0, 0), (0, 1, 0)], cells=4)
    wave = np.sqrt(3 * G * (20 + 4 / 3) / 1882)
    slippery = {"stiffness": 2 * wave**2 / (1e-3) ** 2}
    assert contact.law(scene, 2.0, 0.0) == pytest.approx(slippery)
    assert contact.law(scene, 2.0, 0.1) == pytest.approx(slippery | {"soft": 1 / 12, "knee": 2e-5, "damping": wave / 1e-3})
    data = scene.to_si()
    data["materials"]["steel"] = {"shear_modulus": 8e9, "bulk_to_shear": 2.0, "density": 7850.0}
    assert contact.law(Scene.from_si(data), 2.0, 0.0) == contact.law(scene, 2.0, 0.0), "of what the body is made of"


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
        ({"ground": {"point": ["0 mm", "0 mm", "-2 mm"], "normal": [-0.2, 0, 1]}}, "the ground", lambda x: x[0] > 0 and x[2] < 0),
        ({"walls": {"tube": {"radius": "3 mm", "path": [["-10 mm", "0 mm", "0 mm"], ["30 mm", "0 mm", "3 mm"]]}}},
         "the wall", lambda x: x[0] > 6 and x[2] < 0),
    ],
    ids=["ground", "walls"],
)  # fmt: skip
def test_where_a_body_begins_inside_is_said(obstacle: dict[str, Any], inside: str, at: Any) -> None:
    """The message names the obstacle, the segment by its key, and the place: the lower side of the tip, for a plane or tube that rises
    along x."""
    named = validate(Effects, obstacle, "example.yaml")
    with pytest.raises(InputError) as caught:
        build(rod_scene(length=12e-3, cells=4, directions=[(1, 0, 0)] * 3).model_copy(update={"effects": named}))
    found = re.search(rf"inside {inside}, deepest with segment 3 \(body.catheter.segments\[2\]\), at \(([^)]*)\) mm", str(caught.value))
    assert found is not None, str(caught.value)
    assert at([float(c) for c in found[1].split(", ")])


def test_a_body_may_begin_just_touching_its_tube() -> None:
    def tube(height: str) -> dict[str, Any]:
        return {"tube": {"radius": "3 mm", "path": [["-10 mm", "0 mm", height], ["30 mm", "0 mm", height]]}}

    build(scene(walls=tube("0 mm")))
    build(scene(walls=tube("-1 mm")))
    with pytest.raises(InputError, match=r"effects.walls: the body begins 0\.\d+ mm inside.*\n.*\n.*remedy: make the lumen wider"):
        build(scene(walls=tube("1.4 mm")))


def test_a_lumen_from_a_mesh(tmp_path: Path) -> None:
    """An STL box around the catheter: the same laws, with the unit of the file; a box that is too small or elsewhere is refused."""

    def lumen(unit: str) -> dict[str, Any]:
        write_stl(box((-5, -3, -3), (20, 3, 3)), tmp_path / "box.stl")
        return {"surface": {"mesh": str(tmp_path / "box.stl"), "unit": unit}}

    model = build(scene(walls=lumen("mm")))
    x = np.array([[6e-3, 0, 0], [6e-3, 0, 3.2e-3], [6e-3, -3.2e-3, 0.5e-3]])
    told = [contact.contact_of(model.effects, contact.at_rest(x[k : k + 1], np.full(1, MASS)), 1e-6) for k in range(3)]
    assert [t["count"] for t in told] == [0, 1, 1]
    pushes = MASS * contact.law(model.scene, 1.0, 0.0)["stiffness"] * 0.2e-3
    np.testing.assert_allclose(told[1]["force"], [0, 0, -pushes], rtol=0, atol=0.02 * pushes)
    np.testing.assert_allclose(told[2]["force"], [0, pushes, 0], rtol=0, atol=0.02 * pushes)
    with pytest.raises(InputError, match=r"the body begins .*outside the lumen"):
        build(scene(walls=lumen("um")))


def test_gap_of_two_folds(rng: np.random.Generator) -> None:
    """Two layers of a folded strip: their distance minus the size of a particle; neighbors in the body do not count."""
    x = np.arange(100) * 0.5e-3
    flat = np.column_stack([x, 0 * x, 0 * x])
    folded = np.where(x[:, None] < 25e-3, flat, np.column_stack([50e-3 - x, 0 * x, 0 * x + 2e-3]))
    gap = self_contact.gap(folded, flat, size=0.5e-3, apart=5e-3, within=4e-3)
    assert gap == pytest.approx(1.5e-3)
    assert self_contact.gap(flat, flat, size=0.5e-3, apart=5e-3, within=4e-3) == np.inf
