"""Pairs of surface points and solids: places, depths and forces against plain NumPy."""

import numpy as np
import pytest
from reference.parts import parts_scene
from reference.solids import box

from magmpm.bodies.contact_solid import FINE, TABLE, Solids, box_solid, mesh_solids, rod_solid, solid_distance
from magmpm.dynamics.body_contact import SHARE
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.kernels.body_contact import DEPTH, FORCE, MEMORY, NORMAL, PLACE, _add_all, _touch
from magmpm.kernels.total_lagrangian_step import State
from magmpm.model import build

SIZE, CELL = 3e-3, 1.5e-3  # m
CLOSE = 2e-3  # of a table's spacing: its splines feel that distances end at four points from the surface
F = np.array([[1.1, 0.0, 0.0], [0.1, 0.95, 0.05], [0.02, 0.0, 1.0]])


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> TotalMotion:
    """Two cubes with a gap of 0.1 mm along x."""
    meshes = {"a": box((0.0, 0.0, 0.0), (SIZE,) * 3), "b": box((SIZE + 0.1e-3, 0.2e-3, 0.3e-3), (2 * SIZE + 0.1e-3, 3.2e-3, 3.3e-3))}
    found = begin(build(parts_scene(tmp_path_factory.mktemp("parts"), meshes, {"self_contact": {}}, CELL))).motion
    assert isinstance(found, TotalMotion)
    return found


def bent(motion: TotalMotion) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (3 nodes,) m that press b, deformed by F, into a, and the shift t (3,) m of F X + t."""
    X, half = motion.packed.node_place, len(motion.packed.node_place) // 2
    shift = np.array([SIZE - 0.05e-3, 0.1e-3, 0.0]) - F @ np.array([SIZE + 0.1e-3, 0.2e-3, 0.3e-3])
    u = np.zeros_like(X)
    u[half:] = X[half:] @ F.T + shift - X[half:]
    return u.ravel(), shift


def touched(motion: TotalMotion, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The memory (pairs, MEMORY) of the pairs at displacements u, and the forces (3 nodes,) N of them."""
    meeting, p = motion.contact.copy(), motion.packed
    force = np.zeros_like(u)
    state = State(u, np.zeros_like(u), force, motion.stiffness, motion.anchor, motion.memory)
    _touch(0, 1, 1e-5, meeting, p.surface, p.cells.along_x, p.cells.along_y, state)
    _add_all(meeting, p.surface, p.cells.along_x, p.cells.along_y, force)
    return meeting.memory[:-1].reshape(-1, MEMORY), force


def test_places_and_depths_in_a_deformed_solid(motion: TotalMotion) -> None:
    """Points of a lie at F^-1 (x - t) of b, as deep as that is below the faces of the undeformed b."""
    u, shift = bent(motion)
    contact = motion.contact
    contact.list(u)
    memory, _ = touched(motion, u)
    on = np.flatnonzero((memory[:, DEPTH] > 0) & (contact.meeting.solid == 1))
    assert len(on) > 10
    x = motion.packed.surface.place.reshape(-1, 3)[contact.meeting.point[on]]  # a is not deformed
    X = np.linalg.solve(F, (x - shift).T).T
    np.testing.assert_allclose(memory[on, PLACE : PLACE + 3], X, rtol=0, atol=1e-12 * CELL)
    low, high = np.array([SIZE + 0.1e-3, 0.2e-3, 0.3e-3]), np.array([2 * SIZE + 0.1e-3, 3.2e-3, 3.3e-3])
    nearest = np.sort(np.minimum(X - low, high - X), axis=1)
    np.testing.assert_allclose(memory[on, DEPTH], nearest[:, 0], rtol=0, atol=1e-7 * SIZE)  # of single precision, as STL has
    reports = [contact.report(np.append(memory, 0.0), u, 0.0 * u)["self_contact: a, b"]]
    memory[:, FORCE : FORCE + 3] += 1e3 * memory[:, [DEPTH]] * np.cross(memory[:, NORMAL : NORMAL + 3], [0.3, 1.0, X[0, 0]])
    reports.append(contact.report(np.append(memory, 0.0), u, 0.0 * u)["self_contact: a, b"])
    np.testing.assert_allclose(reports[1]["point"], reports[0]["point"], rtol=0, atol=1e-9 * SIZE)  # of the push: friction moves it not


def test_forces_are_the_slope_of_the_energy_and_cancel(motion: TotalMotion) -> None:
    """-f . du = dW for W = sum of SHARE m w^2 d^2 / 2, by central differences; their sum, and their moment about the origin, are zero."""
    u, _ = bent(motion)
    contact = motion.contact
    contact.list(u)
    meeting = contact.meeting
    rigidity = SHARE * motion.packed.surface.mass[meeting.point] * meeting.law[0]
    change = np.random.default_rng(1).standard_normal(u.shape) * 1e-9

    def energy(at: np.ndarray) -> float:
        return float(0.5 * rigidity @ touched(motion, at)[0][:, DEPTH] ** 2)

    _, force = touched(motion, u)
    assert -force @ change == pytest.approx((energy(u + change) - energy(u - change)) / 2, rel=1e-5)
    each = force.reshape(-1, 3)
    np.testing.assert_allclose(each.sum(axis=0), 0.0, atol=1e-12 * np.abs(each).sum())
    moment = np.cross(motion.packed.node_place + u.reshape(-1, 3), each).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12 * SIZE * np.abs(each).sum())


@pytest.mark.parametrize("kind", ["box", "rod", "mesh", "table"])
def test_distances_of_solids(kind: str) -> None:
    """Signed distances and slopes within 0.2 cells of a face: of a box, given, as a mesh, and with a bump far away; and of a rod."""
    low, high = np.array([0.0, -1e-3, -1e-3]), np.array([4e-3, 1e-3, 1e-3])
    solids: Solids = {
        "box": box_solid(low.tolist(), high.tolist()), "rod": rod_solid(0.0, 4e-3, 1e-3),
        "mesh": mesh_solids([[box(tuple(low), tuple(high)).triangles]], 0.5e-3),
        "table": mesh_solids([[np.vstack([box((*low,), (*high,)).triangles, box((0, -1e-3, -2e-3), (1e-4, 0, -1e-3)).triangles])]], 5e-4),
    }[kind]  # fmt: skip
    assert (solids.kind[0] == TABLE) == (kind == "table")
    rng, normal, off_by = np.random.default_rng(0), np.empty(3), CLOSE * 0.5e-3 / FINE if kind == "table" else 1e-12
    for off in rng.uniform(-0.1e-3, 0.1e-3, 50):
        angle = rng.uniform(0, 2 * np.pi)
        around, flat = np.array([np.cos(angle), np.sin(angle)]) * (1e-3 + off), np.array([rng.uniform(-0.5e-3, 0.5e-3), 1e-3 + off])
        aside = around if kind == "rod" else flat
        x = np.array([rng.uniform(1e-3, 3e-3), *aside])
        assert solid_distance(solids, 0, x, normal) == pytest.approx(off, abs=off_by)
        outward = aside / np.linalg.norm(aside) if kind == "rod" else (0.0, 1.0)
        np.testing.assert_allclose(normal, [0.0, *outward], atol=5 * CLOSE if kind == "table" else 1e-12)


def test_parts_that_hold_together_are_one_solid() -> None:
    """Two boxes have no surface where they meet: the depth in the middle is that below their common sides."""
    halves = [box((0.0, -1e-3, -1e-3), (2e-3, 1e-3, 1e-3)).triangles, box((2e-3, -1e-3, -1e-3), (4e-3, 1e-3, 1e-3)).triangles]
    solids, normal = mesh_solids([halves], 0.5e-3), np.empty(3)
    for x in np.linspace(1.6e-3, 2.4e-3, 9):
        assert solid_distance(solids, 0, np.array([x, 0.1e-3, 0.9e-3]), normal) == pytest.approx(-0.1e-3, abs=CLOSE * 0.5e-3 / FINE)
        np.testing.assert_allclose(normal, [0, 0, 1], atol=5 * CLOSE)
