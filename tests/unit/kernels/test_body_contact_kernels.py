"""Pairs of surface points and solids: places, depths and forces against plain NumPy."""

from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from reference.parts import parts_scene
from reference.solids import ball, box
from scipy.spatial.transform import Rotation

from magmpm.bodies.contact_solid import (
    NEEDLE,
    TABLE_POINTS_PER_CELL,
    box_solid,
    mesh_solids,
    rod_solid,
    solid_distance,
)
from magmpm.bodies.signed_distance import solid
from magmpm.bodies.surface_mesh import Mesh, outline, pack_mesh
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects.contact_force import MOST_PUSH, NORMAL
from magmpm.kernels.body_contact import (
    DEPTH,
    FORCE,
    FRICTION,
    MEMORY,
    PLACE,
    ROOM,
    _add_all,
    _rub,
    _touch,
)
from magmpm.kernels.mass_correction import begin_impulses
from magmpm.kernels.total_lagrangian_step import State
from magmpm.model import build
from magmpm.statics.surface_pairs import SHARE_OF_EACH_BODY

# m
SIZE = 3e-3
CELL = 1.5e-3
# of a table's spacing: its splines feel that distances end at four points from the surface
CLOSE = 2e-3
F = np.array([[1.1, 0.0, 0.0], [0.1, 0.95, 0.05], [0.02, 0.0, 1.0]])


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> TotalMotion:
    """Two cubes with a gap of 0.1 mm along x."""
    meshes = {
        "a": box((0.0, 0.0, 0.0), (SIZE,) * 3),
        "b": box((SIZE + 0.1e-3, 0.2e-3, 0.3e-3), (2 * SIZE + 0.1e-3, 3.2e-3, 3.3e-3)),
    }
    found = begin(
        build(parts_scene(tmp_path_factory.mktemp("parts"), meshes, {"self_contact": {}}, CELL))
    ).motion
    assert isinstance(found, TotalMotion)
    return found


def bent(motion: TotalMotion) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (3 nodes,) m that press b, deformed by F, into a, and the shift t (3,) m of F X + t."""
    X = motion.packed.node_place
    half = len(motion.packed.node_place) // 2
    shift = np.array([SIZE - 0.05e-3, 0.1e-3, 0.0]) - F @ np.array([SIZE + 0.1e-3, 0.2e-3, 0.3e-3])
    u = np.zeros_like(X)
    u[half:] = X[half:] @ F.T + shift - X[half:]
    return u.ravel(), shift


def touched(motion: TotalMotion, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The memory (pairs, MEMORY) of the pairs at displacements u, and the forces (3 nodes,) N of them."""
    meeting = motion.contact.copy()
    p = motion.packed
    force = np.zeros_like(u)
    state = State(u, np.zeros_like(u), force, motion.stiffness, motion.touching, motion.memory)
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
    low = np.array([SIZE + 0.1e-3, 0.2e-3, 0.3e-3])
    high = np.array([2 * SIZE + 0.1e-3, 3.2e-3, 3.3e-3])
    nearest = np.sort(np.minimum(X - low, high - X), axis=1)
    np.testing.assert_allclose(
        memory[on, DEPTH], nearest[:, 0], rtol=0, atol=1e-7 * SIZE
    )  # of single precision, as STL has
    reports = [contact.report(np.append(memory, 0.0), u, 0.0 * u)["self_contact: a, b"]]
    memory[:, FORCE : FORCE + 3] += (
        1e3
        * memory[:, [DEPTH]]
        * np.cross(memory[:, FRICTION + NORMAL : FRICTION + MOST_PUSH], [0.3, 1.0, X[0, 0]])
    )
    reports.append(contact.report(np.append(memory, 0.0), u, 0.0 * u)["self_contact: a, b"])
    np.testing.assert_allclose(
        reports[1]["point"], reports[0]["point"], rtol=0, atol=1e-9 * SIZE
    )  # of the push: friction moves it not


@pytest.mark.parametrize("crushed", [1.0, 0.3, 0.1])
def test_no_point_touches_before_it_is_looked_at_again(motion: TotalMotion, crushed: float) -> None:
    """A pair that does not touch rests until points may have moved by half of their present gap, however b is crushed."""
    gap = 0.05e-3
    X = motion.packed.node_place
    near = np.flatnonzero(np.arange(len(X)) >= len(X) // 2)
    u = np.zeros_like(X)
    u[near, 0] = SIZE + gap + crushed * (X[near, 0] - SIZE - 0.1e-3) - X[near, 0]
    contact = motion.contact
    contact.list(u.ravel())
    meeting = contact.meeting
    meeting.memory[:-1].reshape(-1, MEMORY)[:, ROOM] = 0.0  # look at all
    memory, _ = touched(motion, u.ravel())
    on = np.flatnonzero(meeting.solid == 1)
    assert len(on) > 10
    assert not memory[on, DEPTH].any()
    x = motion.packed.surface.place.reshape(-1, 3)[meeting.point[on]]
    low = np.array([SIZE + gap, 0.2e-3, 0.3e-3])
    distance = np.linalg.norm(np.maximum(low - x, 0.0), axis=1)
    room = (memory[on, ROOM] - meeting.memory[-1]) / distance
    assert room.max() <= 0.5
    before_the_face = distance < gap * (1 + 1e-9)
    np.testing.assert_allclose(
        room[before_the_face], 0.25, rtol=1e-5
    )  # corners are in single precision, as STL has them: 0.2 nm of the gap


def test_forces_are_the_slope_of_the_energy_and_cancel(motion: TotalMotion) -> None:
    """-f . du = dW for W = sum of SHARE_OF_EACH_BODY m w^2 d^2 / 2, by central differences; their sum, and their moment about the origin,
    are zero."""
    u, _ = bent(motion)
    contact = motion.contact
    contact.list(u)
    meeting = contact.meeting
    rigidity = SHARE_OF_EACH_BODY * motion.packed.surface.mass[meeting.point] * meeting.law[0]
    change = np.random.default_rng(1).standard_normal(u.shape) * 1e-9

    def energy(at: np.ndarray) -> float:
        return float(0.5 * rigidity @ touched(motion, at)[0][:, DEPTH] ** 2)

    _, force = touched(motion, u)
    assert -force @ change == pytest.approx((energy(u + change) - energy(u - change)) / 2, rel=1e-5)
    each = force.reshape(-1, 3)
    np.testing.assert_allclose(each.sum(axis=0), 0.0, atol=1e-12 * np.abs(each).sum())
    moment = np.cross(motion.packed.node_place + u.reshape(-1, 3), each).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12 * SIZE * np.abs(each).sum())


@pytest.mark.parametrize("held", [False, True])
def test_friction_between_parts_keeps_momentum_and_leaves_what_is_held(
    motion: TotalMotion, held: bool
) -> None:
    """With lumped masses alone the nodes' momentum and its moment stay; where no node can move, nothing changes, and nothing is NaN."""
    u, _ = bent(motion)
    motion.contact.list(u)
    memory, _ = touched(motion, u)
    memory[memory[:, DEPTH] > 0, FRICTION + MOST_PUSH] = 1e-3
    meeting = motion.contact.meeting._replace(memory=np.append(memory, 0.0))
    p = motion.packed
    nodes = p.nodes._replace(inverse_mass=(0.0 if held else 1.0) * p.nodes.inverse_mass)
    correction = p.mass.correction._replace(
        plane_of=np.full_like(p.mass.correction.plane_of, len(p.mass.correction.left))
    )
    v = np.random.default_rng(2).standard_normal(u.shape) * (p.nodes.inverse_mass > 0)
    begun = v.reshape(-1, 3).copy()
    state = State(u, v, np.zeros_like(u), motion.stiffness, motion.touching, motion.memory)
    rubbing(1e-5, meeting, p.surface, p.cells, nodes, correction, state)
    assert np.isfinite(meeting.memory).all()
    change = p.mass.lumped[:, None] * (v.reshape(-1, 3) - begun)
    assert (np.abs(change).max() > 0) != held
    size = 1e-12 * np.abs(change).sum()
    np.testing.assert_allclose(change.sum(axis=0), 0.0, atol=size)
    moment = np.cross(p.node_place + u.reshape(-1, 3), change).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=SIZE * size)


@njit
def rubbing(push, meeting, surface, cells, nodes, correction, state):  # type: ignore[no-untyped-def]
    """Friction of all pairs, there and back."""
    begin_impulses(correction)
    for back in range(2):
        _rub(push, meeting, surface, cells, nodes, correction, state, back)


@pytest.mark.parametrize("kind", ["box", "rod", "ball"])
def test_distances_of_solids(kind: str) -> None:
    """Signed distances and slopes within 0.2 cells of a face: of a box and a rod, exact; and of a mesh without edges, by its table."""
    low = np.array([0.0, -1e-3, -1e-3])
    high = np.array([4e-3, 1e-3, 1e-3])
    fine = ball((2e-3, 0.0, 0.0), 1e-3, 60).triangles
    solids = {
        "box": box_solid(low.tolist(), high.tolist()),
        "rod": rod_solid(0.0, 4e-3, 1e-3),
        "ball": mesh_solids([[fine]], 0.5e-3),
    }[kind]
    off_by, turned_by = (
        (1e-3 * (np.pi / 60) ** 2, np.pi / 60) if kind == "ball" else (1e-12, 1e-12)
    )  # its triangles, across and along
    assert solids.near.max(initial=0) <= len(solids.coefficients) + 1
    rng = np.random.default_rng(0)
    normal = np.empty(3)
    for off in rng.uniform(-0.1e-3, 0.1e-3, 50):
        angle = rng.uniform(0, 2 * np.pi)
        around = np.array([np.cos(angle), np.sin(angle)]) * (1e-3 + off)
        flat = np.array([rng.uniform(-0.5e-3, 0.5e-3), 1e-3 + off])
        aside = flat if kind == "box" else around
        x = np.array([2e-3 if kind == "ball" else rng.uniform(1e-3, 3e-3), *aside])
        assert solid_distance(solids, 0, x, normal) == pytest.approx(off, abs=off_by)
        outward = (0.0, 1.0) if kind == "box" else aside / np.linalg.norm(aside)
        np.testing.assert_allclose(normal, [0.0, *outward], atol=turned_by)


@pytest.mark.parametrize("gap", [0.0, 1e-7])
@pytest.mark.parametrize(
    ("upper", "left_out"),
    [((0, 6e-3), []), ((0, 3e-3), [(3e-3, 1)]), ((2e-3, 4e-3), [(-1, 2e-3), (4e-3, 1)])],
)
def test_edges_of_solids_are_sharp(
    upper: tuple[float, float], left_out: list[tuple[float, float]], gap: float
) -> None:
    """A box, an L and a T, of two boxes that hold together; a plane of the table's points is in the gap between: depths beside edges and
    corners are those of the box around without what is left out, and lead to the surface. By faces exact, by the table to 0.01 spacings.
    """
    boxes = (
        [(0.0, 0.0, 0.0), (6e-3, 3e-3, 1.5e-3 - gap / 2)],
        [(upper[0], 0.0, 1.5e-3 + gap / 2), (upper[1], 3e-3, 3e-3)],
    )
    solids = mesh_solids([[box(*each).triangles for each in boxes]], 0.75e-3)
    normal = np.empty(3)
    spacing = 0.75e-3 / TABLE_POINTS_PER_CELL
    whole = ((0, 0, 0), (6e-3, 3e-3, 3e-3))
    others = [((low, -1, 1.5e-3 - gap / 2), (high, 1, 1)) for low, high in left_out]

    def exact(x: np.ndarray) -> float:
        apart = [np.maximum(np.array(low) - x, x - high) for low, high in (whole, *others)]
        inner, *outer = (
            np.linalg.norm(np.maximum(each, 0.0)) + min(each.max(), 0.0) for each in apart
        )
        return float(max([inner, *(-each for each in outer)]))

    seam = [
        (3e-3 + aside, 1e-3, 1.5e-3 - deep)
        for aside in np.linspace(0, 2e-8, 9)
        for deep in (1e-6, 5e-5)
    ]  # beside a clipped face
    places = np.random.default_rng(0).uniform(-0.1e-3, (6.1e-3, 3.1e-3, 3.1e-3), (20_000, 3))
    by_faces = list[bool]()
    for x in (x for x in [*np.array(seam), *places] if -0.3 * spacing < exact(x) < 0.02 * spacing):
        point = np.ravel_multi_index(
            np.rint((x - solids.size[0, :3]) / spacing).astype(int), solids.points[0]
        )
        by_faces.append(solids.near[point] < solids.near[point + 1])
        close = pytest.approx(
            0.0, abs=1e-12 + gap if by_faces[-1] else 0.01 * spacing
        )  # clipped to 1e-8 of a tenth of a spacing
        d = solid_distance(solids, 0, x, normal)
        assert d - exact(x) == close
        assert exact(x - d * normal) == close
    assert 0.5 < np.mean(by_faces) < 1.0


def test_needles_have_no_side() -> None:
    """A box with an edge of more vertices on one side than on the other, closed by triangles of no width, turned and rounded to float32:
    they are left out, and what is outside beside them stays outside, of a part and of a lumen."""
    whole = box((0.0, 0.0, 0.0), (6e-3, 5e-3, 3e-3))
    rng = np.random.default_rng(0)
    on = [np.array([x, 0.0, 3e-3]) for x in (0.0, *np.sort(rng.uniform(0.3e-3, 5.7e-3, 7)), 6e-3)]
    top = [face for face in whole.triangles if not (face[:, 2] == 3e-3).all()]
    fan = [(a, b, (0.0, 5e-3, 3e-3)) for a, b in pairwise(on)] + [
        (on[-1], (6e-3, 5e-3, 3e-3), (0.0, 5e-3, 3e-3))
    ]
    needles = [(on[0], b, a) for a, b in pairwise(on[1:])]
    turn = Rotation.from_rotvec([0.3, 0.5, -0.8])
    corners = (
        turn.apply(np.array([*top, *fan, *needles]).reshape(-1, 3)).astype(np.float32).astype(float)
    )
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    text = pack_mesh(Mesh(vertices, faces.reshape(-1, 3)))
    normal = np.empty(3)
    cell = 0.75e-3
    solids = mesh_solids([[found := outline(text, NEEDLE * cell)]], cell)
    table = solid([found], found, cell / TABLE_POINTS_PER_CELL, 0.0)
    assert len(found) == 12
    for off in rng.uniform((0.3e-3, -0.3e-3, 3.0e-3), (5.7e-3, -0.02e-3, 3.3e-3), (500, 3)):
        x = turn.apply(off)
        assert solid_distance(solids, 0, x, normal) > 0.01e-3
        assert table.at(x[None])[0][0] < 0.0
