"""Bodies of parts in all directions at rest: a helix against a frame of straight pieces, and a gripper against itself, turned."""

from typing import Any

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.solids import box, turned
from scipy.spatial.transform import Rotation

from magmpm.bodies.surface_mesh import Mesh, pack_mesh
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model

RADIUS = 6e-3  # m, of the helix
WIRE = 1e-3  # m, radius of its wire
PITCH = 6e-3  # m
TURNS = 2.0
SIDES = 32  # of the wire's section
SHEAR = 6e6  # Pa
RATIO = 20.0  # bulk over shear modulus
DENSITY = 1100.0  # kg/m^3
GRAVITY = 9.81  # m/s^2


def on_helix(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) m of the wire's axis, and its tangents (n, 3)."""
    place = np.stack(
        [RADIUS * np.cos(angle), RADIUS * np.sin(angle), -PITCH * angle / (2 * np.pi)], axis=1
    )
    along = np.stack(
        [
            -RADIUS * np.sin(angle),
            RADIUS * np.cos(angle),
            np.full_like(angle, -PITCH / (2 * np.pi)),
        ],
        axis=1,
    )
    return place, along / np.linalg.norm(along, axis=1)[:, None]


def helix(per_turn: int = 48) -> Mesh:
    """The wire, its sections (regular polygons) across its axis, in mm."""
    angle = np.linspace(0, 2 * np.pi * TURNS, int(per_turn * TURNS) + 1)
    place, along = on_helix(angle)
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    aside = np.cross(along, outward)
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(turn)[:, None] * outward[:, None] + np.sin(turn)[:, None] * aside[:, None]
    rings = place[:, None] + WIRE * ring
    # The first section is cut in the plane of the block that holds it.
    rings[0] -= along[0] * (rings[0][:, 1:2] / along[0][1])
    n = len(angle)
    corners = np.concatenate([rings.reshape(-1, 3), place[[0, -1]]])
    faces = []
    for k in range(SIDES):
        after = (k + 1) % SIDES
        for r in range(n - 1):
            low = r * SIDES
            high = low + SIDES
            faces += [(low + k, low + after, high + after), (low + k, high + after, high + k)]
        last = (n - 1) * SIDES
        faces += [(n * SIDES, after, k), (n * SIDES + 1, last + k, last + after)]
    return Mesh(1e3 * corners, np.array(faces))


def end_of_frame(pieces: int = 400) -> np.ndarray:
    """Displacement (3,) m of the end of the helix under its weight: straight pieces that bend, twist, stretch and shear a little.

    Source: Przemieniecki, Theory of Matrix Structural Analysis, chapter 5 (a piece's stiffness with shear).
    """
    area = SIDES / 2 * WIRE**2 * np.sin(2 * np.pi / SIDES)
    bend = (
        area * WIRE**2 / 12 * (2 + np.cos(2 * np.pi / SIDES))
    )  # second moment of a regular polygon
    young = 9 * RATIO * SHEAR / (3 * RATIO + 1)
    place, _ = on_helix(np.linspace(0, 2 * np.pi * TURNS, pieces + 1))
    size = 6 * (pieces + 1)
    K = np.zeros((size, size))
    f = np.zeros(size)
    for e in range(pieces):
        way = place[e + 1] - place[e]
        length = np.linalg.norm(way)
        x = way / length
        y = np.cross([0.0, 0.0, 1.0], x)
        y /= np.linalg.norm(y)
        frame = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
        k = np.zeros((12, 12))
        for at, stiffness in ((0, young * area / length), (3, SHEAR * 2 * bend / length)):
            k[np.ix_([at, at + 6], [at, at + 6])] += stiffness * np.array([[1, -1], [-1, 1]])
        give = 12 * young * bend / (0.9 * SHEAR * area * length**2)  # by shear
        first = 6 * length
        near = (4 + give) * length**2
        far = (2 - give) * length**2
        for u, turn, s in ((1, 5, 1.0), (2, 4, -1.0)):
            at = [u, turn, u + 6, turn + 6]
            k[np.ix_(at, at)] += (young * bend / length**3 / (1 + give)) * np.array(
                [
                    [12, s * first, -12, s * first],
                    [s * first, near, -s * first, far],
                    [-12, -s * first, 12, -s * first],
                    [s * first, far, -s * first, near],
                ]
            )
        part = slice(6 * e, 6 * e + 12)
        K[part, part] += frame.T @ k @ frame
        f[[6 * e + 2, 6 * e + 8]] -= DENSITY * GRAVITY * area * length / 2
    return np.linalg.solve(K[6:, 6:], f[6:])[-6:-3]


@pytest.mark.slow
def test_a_helix_hangs_as_a_frame_of_straight_pieces() -> None:
    """Two turns of a spring, held by a block at the upper end. Five cells through the wire are within 3 % of a frame."""
    meshes: list[dict[str, Any]] = [
        {"mesh": pack_mesh(box((4, -2, -2), (8, 0, 2))), "material": "m", "clamp": True},
        {"mesh": pack_mesh(helix()), "material": "m"},
    ]
    material = {"shear_modulus": SHEAR, "bulk_to_shear": RATIO, "density": DENSITY}
    scene = resting_scene(
        {"parts": {"unit": "mm", "spacing": 0.4e-3, "meshes": meshes}},
        {"gravity": {}},
        materials={"m": material},
    )
    result = run(scene)
    place, along = on_helix(np.array([2 * np.pi * TURNS]))
    last = np.abs((result.particle_reference - place[0]) @ along[0]) < 0.3e-3
    last &= np.linalg.norm(result.particle_reference - place[0], axis=1) < 1.2 * WIRE
    moved = (result.particle_position - result.particle_reference)[last].mean(axis=0)
    frame = end_of_frame()
    assert np.linalg.norm(moved - frame) < 0.03 * np.linalg.norm(frame)


ARM = 80e3  # Pa
HUB = 1e6  # Pa
FIELD = np.array([0.0, 0.0, 10e-3])  # T
PLACES = (6.0, 9.0, 12.0, 15.0, 17.3)  # mm from the hub's center, along an arm


def gripper(axis: tuple[float, float, float], angle: float) -> Scene:
    """A held hub with four arms of two parts, turned about the origin with its magnetization, field and weight."""
    turn = Rotation.from_rotvec(angle * np.array(axis))
    hub = turned(box((-4, -4, -1), (4, 4, 1)), axis, angle)
    meshes: list[dict[str, Any]] = [{"mesh": pack_mesh(hub), "material": "hub", "clamp": True}]
    for k in range(4):
        for low, high in ((4, 11), (11, 18)):
            arm = turned(box((low, -2, -0.6), (high, 2, 0.6)), (0, 0, 1), k * np.pi / 2)
            along = turn.apply([np.cos(k * np.pi / 2), np.sin(k * np.pi / 2), 0.0])
            mesh = pack_mesh(turned(arm, axis, angle))
            meshes.append({"mesh": mesh, "material": "arm", "magnetization": along.tolist()})
    arm_material = {"shear_modulus": ARM, "density": 1882.0, "remanence": 0.1}
    materials = {"hub": {"shear_modulus": HUB, "density": 1100.0}, "arm": arm_material}
    return resting_scene(
        {"parts": {"unit": "mm", "meshes": meshes}},
        {
            "magnetic_torque": {},
            "gravity": {"acceleration": turn.apply([0.0, 0.0, -GRAVITY]).tolist()},
        },
        field={"uniform": turn.apply(FIELD).tolist()},
        materials={name: {"bulk_to_shear": RATIO, **one} for name, one in materials.items()},
        cells=2,
    )


def arms(axis: tuple[float, float, float], angle: float) -> tuple[np.ndarray, int]:
    """Displacements (20, 3) m of places on the middle lines of the arms, in the gripper's own axes; and the Newton steps."""
    model = static_model(build(gripper(axis, angle)))
    found = solve_static(model)
    turn = Rotation.from_rotvec(angle * np.array(axis))
    X = turn.inv().apply(model.particles.position)
    u = turn.inv().apply(found.point.displacement)
    out = []
    for k in range(4):
        own = Rotation.from_rotvec([0, 0, -k * np.pi / 2])
        Y = own.apply(X)
        v = own.apply(u)
        for place in PLACES:
            off = Y - np.array([1e-3 * place, 0.0, 0.0])
            near = (np.abs(off[:, 0]) < 0.7e-3) & (np.abs(off[:, 1]) < 2.05e-3)
            terms = np.column_stack([np.ones(near.sum()), off[near], off[near, 0] ** 2])
            out.append(np.linalg.lstsq(terms, v[near], rcond=None)[0][0])
    return np.array(out), found.steps


@pytest.mark.slow
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.36, 0.48, 0.8)])
def test_a_turned_gripper_bends_as_the_straight_one(axis: tuple[float, float, float]) -> None:
    """By 20 degrees about an axis: on as many cells. Both end within a decrement of 1e-11 of the energy, and so within its root, 3e-6, of
    how far they move."""
    straight, steps = arms(axis, 0.0)
    oblique, as_many = arms(axis, np.deg2rad(20))
    most = np.linalg.norm(straight, axis=1).max()
    assert np.linalg.norm(oblique - straight, axis=1).max() < 3e-6 * most
    assert steps == as_many <= 20
