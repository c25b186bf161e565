"""Bodies of STL parts: exact quadrature of any closed mesh, clamps, statics along any axis, and refusals."""

import base64
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from reference.moving import resting_scene
from reference.solids import ball, box, stl_text, turned
from scipy.spatial.transform import Rotation

from magmpm.bodies.grid import AT_REST, Grid, Knots
from magmpm.bodies.mesh_quadrature import (
    axes_of_parts,
    cell_moments,
    grid_of_parts,
    part_errors,
    part_particles,
)
from magmpm.bodies.shells import shells_of, solid_of, solids_of
from magmpm.bodies.surface_mesh import (
    PREFIX,
    Mesh,
    MeshError,
    _merged,
    checked,
    overlaps,
    pack_mesh,
    read_stl,
    thickness_of,
    unpack_mesh,
    volume_of,
    write_stl,
)
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model


def parts_scene(
    *parts: dict[str, Any], field: tuple[float, ...] = (0.0, 0.0, 3e-3), **body: Any
) -> Scene:
    """A scene of meshes in mm."""
    meshes = [{"material": "m", **part, "mesh": pack_mesh(part["mesh"])} for part in parts]
    return resting_scene(
        {"parts": {"unit": "mm", "meshes": meshes, **body}},
        {"magnetic_torque": {}},
        field={"uniform": list(field)},
    )


SOLIDS = {
    "box": box((-0.4, -0.3, -0.2), (0.8, 0.5, 0.7)),
    "ball": ball((0.1, -0.2, 0.05), 1.0),
    "turned box": turned(box((-1.0, -0.5, -0.15), (1.0, 0.5, 0.15)), (1, 2, 3), 0.7),
    "thin plate": turned(box((-1.0, -1.0, -0.02), (1.0, 1.0, 0.02)), (3, -1, 1), 1.1),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_moments_of_cut_cells_add_up_to_the_mesh(name: str) -> None:
    """Volume and first and second moments over all cells are those of the mesh (divergence theorem), for 8 random offsets of the grid."""
    triangles = SOLIDS[name].triangles
    whole = cell_moments(triangles, Grid(np.full(3, -2.0), np.full(3, 4.0), (1, 1, 1)))[1][0]
    assert whole[0] * 64 == pytest.approx(volume_of(triangles), rel=1e-12)
    rng = np.random.default_rng(3)
    for _ in range(8):
        spacing = rng.uniform(0.2, 0.4, 3)
        grid = Grid(
            np.full(3, -2.0) + rng.uniform(0, 0.4, 3),
            spacing,
            tuple(np.ceil(4.0 / spacing).astype(int)),
        )
        cell, m = cell_moments(triangles, grid)
        assert m[:, 0].max() <= 1 + 1e-12
        low = grid.origin + grid.spacing * cell
        v = m[:, 0] * spacing.prod()
        first = low * m[:, :1] + spacing * m[:, 1:4]
        # Regions below 1e-9 of a cell are dropped, and there are at most some hundreds of cells: 1e-7.
        assert v.sum() == pytest.approx(volume_of(triangles), rel=1e-7)
        mean = first.sum(0) * spacing.prod() / v.sum()
        np.testing.assert_allclose(mean, -2 + 4 * whole[1:4] / whole[0], atol=1e-7)


def test_moments_of_one_cell_of_a_known_piece() -> None:
    """The tetrahedron x + y + z < 1 in the unit cell: integrals of x^a y^b z^c are a! b! c!/(a + b + c + 3)!."""
    tetrahedron = checked(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    )
    _, m = cell_moments(tetrahedron.triangles, Grid(np.zeros(3), np.ones(3), (1, 1, 1)))
    want = [1 / 6, *[1 / 24] * 3, 1 / 60, 1 / 120, 1 / 120, 1 / 60, 1 / 120, 1 / 60]
    np.testing.assert_allclose(m[0], want, rtol=1e-13)


@pytest.mark.parametrize(
    ("name", "spacing"), [("box", 0.23), ("ball", 0.3), ("turned box", 0.12), ("ball", 0.11)]
)
def test_particles_have_the_mesh_s_moments_and_are_sorted(name: str, spacing: float) -> None:
    """Volume and centroid to 1e-7 (dropped slivers); second moments have an error from skew slivers: less than 1e-4 at 2 cells and more."""
    parts = [SOLIDS[name].triangles]
    grid, _ = grid_of_parts(parts, [False], spacing)
    particles = part_particles(grid, parts, 2)
    errors = part_errors(particles, parts)
    assert errors["volume_error"] < 1e-7
    assert errors["centroid_error"] < 1e-7
    assert errors["second_moment_error"] < 1e-4
    assert np.all(particles.volume > 0)
    assert np.all(np.diff(np.ravel_multi_index(particles.cell.T, grid.cells)) >= 0)
    grid.locate(particles.position, particles.cell)  # raises if one lies outside its cell


def test_stl_text_and_binary_say_the_same(tmp_path: Path) -> None:
    solid = ball((1.0, 2.0, 3.0), 2.0)
    write_stl(solid, tmp_path / "b.stl")
    lines = ["solid b"]
    for corners in solid.triangles.astype(np.float32):
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
        lines += ["endloop", "endfacet"]
    (tmp_path / "t.stl").write_text("\n".join([*lines, "endsolid b"]))
    binary = read_stl(tmp_path / "b.stl")
    text = read_stl(tmp_path / "t.stl")
    np.testing.assert_array_equal(binary.triangles, text.triangles)
    again = unpack_mesh(pack_mesh(text))
    np.testing.assert_array_equal(again.vertices, text.vertices)
    np.testing.assert_array_equal(again.faces, text.faces)


def together(*solids: Mesh, inverted: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Solids as one mesh, as in an STL file: near vertices are merged."""
    corners = [s.triangles[:, ::-1] if k in inverted else s.triangles for k, s in enumerate(solids)]
    return _merged(np.concatenate(corners))


def other_diagonals(solid: Mesh) -> Mesh:
    """A box whose faces are split along the other diagonals."""
    quads = [(a, b, c, d) for (a, b, c), (_, _, d) in solid.faces.reshape(-1, 2, 3)]
    return Mesh(
        solid.vertices, np.array([t for a, b, c, d in quads for t in ((b, c, d), (b, d, a))])
    )


BLOCK = box((0, 0, 0), (4, 4, 4))
SMALL = box((1, 1, 1), (3, 3, 3))
APART = box((6, 0, 0), (9, 3, 3))


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        (
            together(BLOCK, APART, inverted=(1,)),
            r"has 2 shells: shell 2 of volume 27 faces inward and is no cavity.*flip the normals",
        ),
        (together(BLOCK, BLOCK), "12 of this one appear again.*remove the duplicate solid"),
        (
            together(box((0, 0, 0), (10, 2, 2)), box((4, -4, 0), (6, 6, 2))),
            "2 shells: shell 1 of volume 40 and shell 2 of volume 40 share 8 .*merge",
        ),
        (
            together(box((0, 0, 0), (6, 2, 2)), box((4, 0, 0), (9, 2, 2))),
            "shell 1 of volume 24 and shell 2 of volume 20 share 8 ",
        ),
        (together(BLOCK, SMALL), "shell 2 of volume 8 lies in the material of another"),
        (together(BLOCK, ball((2, 2, 2), 1)), "lies in the material of another"),
        (
            together(BLOCK, other_diagonals(BLOCK)),
            "solids overlap or one is inverted.*merge overlapping solids",
        ),
        (
            together(BLOCK, other_diagonals(box((0, 0, 0), (4, 4, 9)))),
            "solids overlap or one is inverted",
        ),
        (together(BLOCK, turned(BLOCK, (0, 0, 1), np.pi / 2)), None),
        (together(BLOCK, SMALL, SMALL, inverted=(1, 2)), "appear again"),
        (
            together(BLOCK, box((3, 1, 1), (5, 3, 3)), inverted=(1,)),
            "shell 1 of volume 64 and shell 2 of volume 8 share 4",
        ),
        (together(BLOCK, SMALL, inverted=(1,)), None),  # a cavity
        (together(BLOCK, ball((2, 2, 2), 1), inverted=(1,)), None),
        (
            together(BLOCK, SMALL, box((1.5, 1.5, 1.5), (2, 2, 2)), inverted=(1,)),
            None,
        ),  # a solid in a cavity
        (
            together(BLOCK, SMALL, box((1.5, 1.5, 1.5), (2, 2, 2)), inverted=(1, 2)),
            "shell 3 of volume 0.125 faces inward",
        ),
        (together(BLOCK, APART), None),
        (together(BLOCK, box((4, 0, 0), (8, 4, 4))), None),  # a common face
        (together(BLOCK, box((4, 4, 0), (8, 8, 4))), None),  # a common edge
        (together(BLOCK, box((4, 4, 0), (8, 8, 4)), box((4, 0, 0), (8, 4, 4))), None),
        (together(BLOCK, box((4, 4, 4), (8, 8, 8))), None),  # a common corner
    ],
)
def test_shells_of_a_mesh_cover_each_point_once(
    mesh: tuple[np.ndarray, np.ndarray], says: str | None
) -> None:
    """Shells that overlap, face inward or lie inside each other are refused; cavities, and shells that are apart or touch, are not."""
    if says is None:
        checked(*mesh)
        return
    with pytest.raises(MeshError, match=says):
        checked(*mesh)


def test_boxes_that_touch_are_shells_of_their_own() -> None:
    vertices, faces = together(BLOCK, box((4, 4, 0), (8, 8, 4)), box((4, 0, 0), (8, 4, 4)))
    shells, overlapping = shells_of(vertices, faces)
    assert len(overlapping) == 0
    assert [shell.volume() for shell in shells] == pytest.approx(
        [64.0, 64.0, 64.0], rel=1e-12
    )  # rounding


def test_thickness_and_overlap() -> None:
    plate = box((0, 0, 0), (10, 6, 0.5))
    assert thickness_of(pack_mesh(plate)) == pytest.approx(0.5)
    assert thickness_of(pack_mesh(turned(plate, (1, 1, 0), 0.5))) == pytest.approx(0.5)
    # A polyhedron within the ball: cos(pi/24)^2 of its diameter between opposite faces.
    assert thickness_of(pack_mesh(ball((0, 0, 0), 2.0))) == pytest.approx(4.0, rel=0.03)
    one = pack_mesh(plate)
    sphere = pack_mesh(ball((0, 0, 0), 1))
    assert list(overlaps([one, pack_mesh(box((10, 0, 0), (12, 6, 0.5)))])) == []
    ((_, _, shared, smaller),) = overlaps([one, pack_mesh(box((9, 0, 0), (12, 6, 0.5)))])
    assert (shared, smaller) == pytest.approx((3.0, 9.0), rel=1e-12)  # exact except for rounding
    ((_, _, shared, smaller),) = overlaps([sphere, sphere])
    assert shared == pytest.approx(volume_of(ball((0, 0, 0), 1).triangles), rel=1e-12)


def voxels(
    cells: set[tuple[int, int, int]], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The surface of unit cubes without the faces between two of them, with triangles in any order."""
    cube = box((0, 0, 0), (1, 1, 1)).triangles
    outward = np.cross(cube[:, 1] - cube[:, 0], cube[:, 2] - cube[:, 0]).round().astype(int)
    corners = [
        t + c
        for c in cells
        for t, n in zip(cube, outward, strict=True)
        if tuple((n + c).tolist()) not in cells
    ]
    vertices, faces = _merged(np.array(corners))
    return vertices, faces[rng.permutation(len(faces))]


@pytest.mark.parametrize("seed", range(20))
def test_volumes_are_exact_whatever_order_the_triangles_have(seed: int) -> None:
    """Cubes at random places touch along edges and at corners. Two such bodies share the sum over pairs of cubes, for any shift."""
    rng = np.random.default_rng(seed)
    one, other = (
        {tuple(c) for c in np.argwhere(rng.random((4, 4, 4)) < 0.5).tolist()} for _ in range(2)
    )
    solids = []
    for cells in (one, other):
        mesh = voxels(cells, rng)
        checked(*mesh)
        solids.append(solid_of(*mesh))
        # 64 cubes of volume 1: rounding of a few hundred sums
        assert sum(shell.volume() for shell in shells_of(*mesh)[0]) == pytest.approx(
            len(cells), rel=1e-12
        )
        assert solids[-1].volume() == pytest.approx(len(cells), rel=1e-12)
    for shift in ((0.0, 0.0, 0.0), (0.3, 0.45, 0.2)):
        apart = np.abs(np.array(list(one))[:, None] - np.array(list(other)) - shift)
        want = np.clip(1 - apart, 0, None).prod(axis=2).sum()
        assert (solids[0] ^ solids[1].translate(shift)).volume() == pytest.approx(want, abs=1e-10)


CROSS = [((4, -2, -0.6), (18, 2, 0.6)), ((-2, 4, -0.6), (2, 18, 0.6))]
AXIS = np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize("angle", [0.3, 0.7])
@pytest.mark.parametrize("digits", [4, 9])
def test_cells_lie_along_the_faces_of_turned_boxes(angle: float, digits: int) -> None:
    """Two arms: as many particles as straight ones have, each where it is turned to. Files have so many digits after the point (mm): the
    faces are known to 1e-5 rad at four, and the grid to 1e-4 of the arms' 18 mm."""
    scenes = []
    for one in (0.0, angle):
        meshes = [turned(box((-4, -4, -1), (4, 4, 1)), AXIS, one)]
        meshes += [turned(box(low, high), AXIS, one) for low, high in CROSS]
        known = [Mesh(mesh.vertices.round(digits), mesh.faces) for mesh in meshes]
        scenes.append(parts_scene(*({"mesh": m, "clamp": m is known[0]} for m in known)))
    straight, oblique = (build(scene) for scene in scenes)
    np.testing.assert_array_equal(straight.grid.axes, np.eye(3))
    turn = Rotation.from_rotvec(angle * AXIS / np.linalg.norm(AXIS)).as_matrix()
    np.testing.assert_allclose(oblique.grid.axes, turn, atol=10.0 ** (1 - digits))
    assert oblique.grid.cells == straight.grid.cells
    np.testing.assert_allclose(
        oblique.particles.position @ turn,
        straight.particles.position,
        atol=20 * 10.0 ** (-3 - digits),
    )
    np.testing.assert_array_equal(oblique.particles.cell, straight.particles.cell)


@pytest.mark.parametrize(
    ("parts", "spacing"),
    [
        ([ball((0, 0, 0), 1.0)], 0.5),
        ([turned(ball((0, 0, 0), 1.0), (1, 0, 0), 0.5)], 0.5),
        ([box((0, 0, 0), (8, 2, 2)), turned(box((0, 0, 0), (7, 2, 2)), (1, 2, 3), 0.5)], 1.0),
    ],
    ids=["ball", "turned ball", "more faces along x, y, z"],
)
def test_cells_stay_along_x_y_z_where_others_save_none(parts: list[Mesh], spacing: float) -> None:
    np.testing.assert_array_equal(
        axes_of_parts([each.triangles for each in parts], [], spacing), np.eye(3)
    )


def test_cells_lie_along_the_larger_of_two_parts() -> None:
    parts = [box((0, 0, 0), (7, 2, 2)), turned(box((0, 0, 0), (16, 2, 2)), (0, 1, 0), 0.5)]
    axes = axes_of_parts([each.triangles for each in parts], [], 1.0)
    np.testing.assert_allclose(axes, Rotation.from_rotvec([0, 0.5, 0]).as_matrix(), atol=1e-12)


def split(triangles: np.ndarray, times: int) -> np.ndarray:
    """Each triangle as four, so many times."""
    for _ in range(times):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(each, axis=1) for each in quarters])
    return triangles


@pytest.mark.parametrize("arms", [1, 3, 5])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.35), (0.3, -0.5, 0.7)])
@pytest.mark.parametrize("times", [0, 3])
def test_cells_turn_with_the_parts(arms: int, turn: tuple[float, float, float], times: int) -> None:
    """Arms of a star, which share no axes but their plane's normal, with a knob of large triangles: fine ones count as well."""
    each = 2 * np.pi / arms
    free = [
        split(turned(box((4, -2, -0.6), (18, 2, 0.6)), (0, 0, 1), k * each).triangles, times)
        for k in range(arms)
    ]
    free.append(ball((20.0, 0.0, 0.0), 2.0, rings=4).triangles)
    held = [box((-3, -3, -1), (3, 3, 1)).triangles]
    by = Rotation.from_rotvec(turn).as_matrix()
    straight = axes_of_parts(free, held, 0.6)
    oblique = axes_of_parts([one @ by.T for one in free], [one @ by.T for one in held], 0.6)
    np.testing.assert_allclose(np.abs(straight.T @ by.T @ oblique).max(axis=0), 1.0, atol=1e-9)
    assert np.abs(straight[2]).max() == 1.0  # all arms lie flat


def test_cells_lie_along_what_holds_parts_that_have_no_axes_in_common() -> None:
    """A brush of leaning bristles: along one of them there are hardly fewer cells, and along the brush its face is a plane of the grid."""
    rng = np.random.default_rng(5)
    brush = box((-6, -6, -2), (6, 6, 0)).triangles
    bristles = []
    for k in range(12):
        bristle = turned(box((-1.2, -0.7, 0), (1.2, 0.7, 12)), (1, 0, 0), rng.uniform(0.2, 0.6))
        bristles.append(turned(bristle, (0, 0, 1), k + rng.uniform()).triangles)
    by = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
    axes = axes_of_parts([one @ by.T for one in bristles], [brush @ by.T], 0.7)
    assert np.abs(by[:, 2] @ axes).max() == pytest.approx(1.0, abs=1e-9)


def test_motions_are_on_a_grid_along_x_y_z() -> None:
    """Their kernels know no other axes."""
    meshes = [{"mesh": turned(SOLIDS["box"], AXIS, 0.7), "clamp": held} for held in (True, False)]
    mesh = meshes[1]["mesh"]
    meshes[1]["mesh"] = Mesh(mesh.vertices + np.array([3.0, 0.0, 0.0]), mesh.faces)
    scene = parts_scene(*meshes, field=(0.0, 0.0, 0.0), spacing=0.2e-3)
    assert not np.array_equal(scene.body.shape.grid(2, AT_REST).axes, np.eye(3))
    np.testing.assert_array_equal(scene.body.shape.grid(2).axes, np.eye(3))
    with pytest.raises(ValueError, match="follows from their meshes"):
        scene.body.shape.grid(2, Knots(from_tip=True))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_box_of_parts_is_the_strip(axis: int) -> None:
    """Two boxes, one held, equal a strip clamped at its base, along any axis: same grid, same result to 1e-9 m."""
    segments = [{"magnetization": [1, 0, 0]}, {"magnetization": [0, 1, 1]}]
    shape = {
        "length": 6e-3,
        "width": 1e-3,
        "thickness": 1e-3,
        "material": "m",
        "segments": segments,
    }
    strip = resting_scene(
        {"strip": shape}, {"magnetic_torque": {}}, field={"uniform": [0.0, 2e-3, 4e-3]}
    )

    def along(vector: tuple[float, float, float]) -> Any:
        return tuple(np.roll(vector, axis).tolist())

    parts = parts_scene(
        {"mesh": box(along((-1, -0.6, -0.6)), along((0, 0.6, 0.6))), "clamp": True, "name": "wall"},
        {
            "mesh": box(along((0, -0.5, -0.5)), along((3, 0.5, 0.5))),
            "magnetization": along((1, 0, 0)),
        },
        {
            "mesh": box(along((3, -0.5, -0.5)), along((6, 0.5, 0.5))),
            "magnetization": along((0, 1, 1)),
        },
        field=along((0.0, 2e-3, 4e-3)),
        spacing=0.5e-3,
    )
    want = run(strip)
    found = run(parts)
    np.testing.assert_allclose(
        np.roll(found.segment_center[1:], -axis, axis=1), want.segment_center, atol=1e-9
    )
    np.testing.assert_allclose(
        np.roll(found.segment_remanence[1:], -axis, axis=1), want.segment_remanence, atol=1e-7
    )
    assert found.tip is None
    wall = found.particle_segment == 0
    np.testing.assert_array_equal(found.particle_position[wall], found.particle_reference[wall])
    assert found.dof == want.dof
    assert found.centreline.shape == (0, 4)


@pytest.mark.parametrize("root", [0.0, -1.0], ids=["stands on it", "embedded in it"])
def test_a_wide_base_adds_no_unknowns_and_changes_nothing(root: float) -> None:
    """Blocks that hold an arm, whether or not on one plane: when they are wider, planes grow by the three nodes that they share."""

    def held_by(wide: float) -> Scene:
        over = [
            {"mesh": box((-1, -wide, low), (0, wide, high)), "clamp": True}
            for low, high in ((-wide, -0.5), (-0.5, 0.5), (0.5, wide))
        ]
        arm = {"mesh": box((root, -0.5, -0.5), (5, 0.5, 0.5)), "magnetization": [1, 0, 0]}
        return parts_scene(
            *(over if root == 0.0 else over[::2]), arm, field=(0.0, 1e-3, 3e-3), spacing=0.5e-3
        )

    small, large = (static_model(build(held_by(wide))) for wide in (1.0, 3.0))
    assert large.layout.m <= small.layout.m + 9
    assert large.dof == small.dof
    one = run(held_by(1.0))
    other = run(held_by(3.0))
    np.testing.assert_allclose(other.segment_center[-1], one.segment_center[-1], atol=1e-10)
    held = other.particle_segment < len(other.segment_center) - 1
    np.testing.assert_array_equal(other.particle_position[held], other.particle_reference[held])
    assert np.linalg.norm(other.segment_center[-1] - [(5 + root) / 2e3, 0.0, 0.0]) > 5e-5


def test_a_result_of_parts_survives_being_saved(tmp_path: Path) -> None:
    scene = parts_scene(
        {"mesh": box((-1, 0, 0), (0, 1, 1)), "clamp": True},
        {"mesh": box((0, 0, 0), (2, 1, 1)), "magnetization": [1, 0, 0]},
    )
    result = run(scene)
    again = Result.load(result.save(tmp_path / "r"))
    assert Scene.from_si(again.scene).hash() == scene.hash() == again.scene_hash
    np.testing.assert_array_equal(again.particle_position, result.particle_position)


def test_held_inside_its_neighbours_both_sides_are_held_by_their_faces() -> None:
    """A held core in the middle of a bar: there is no clamping plane. Each half bends as the one alone, which a plane clamps exactly."""
    core = {"mesh": box((2, 0, 0), (3, 1, 1)), "clamp": True}
    left, right = (
        {"mesh": box((x, 0, 0), (x + 2, 1, 1)), "magnetization": [1, 0, 0]} for x in (0, 3)
    )
    model, alone = (
        static_model(build(parts_scene(core, *free))) for free in ((left, right), (right,))
    )
    assert model.held.sum() == model.held.size // 5
    assert not model.planes
    assert alone.planes
    assert model.dof == 3 * 4 * 4 * 12  # 10 cells of 0.5 mm along x: no node is held
    assert not model.free
    ends = []
    for each in (model, alone):
        moved = solve_static(each).point.displacement
        assert not moved[each.held].any()
        x = each.particles.position[:, 0]
        ends += [
            np.linalg.norm(moved[np.isclose(x, place)], axis=1).max()
            for place in (x[~each.held].min(), x.max())
        ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)
    assert ends[1] == pytest.approx(
        ends[3], rel=0.03
    )  # of a half twice as long as thick; two cells across


def test_parts_in_a_file_are_found_beside_it(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    write_stl(box((-1, 0, 0), (0, 1, 1)), tmp_path / "meshes" / "base plate.stl")
    write_stl(box((0, 0, 0), (2, 1, 1)), tmp_path / "meshes" / "arm.stl")
    path = tmp_path / "scene.yaml"
    path.write_text(
        "name: p\nmaterials:\n  m: {shear_modulus: 100 kPa, bulk_to_shear: 20, remanence: 100 mT}\n"
        "body:\n  parts:\n    unit: mm\n    meshes:\n"
        "      - {mesh: meshes/base plate.stl, material: m, clamp: true}\n"
        "      - {mesh: meshes/arm.stl, material: m, magnetization: [1, 0, 0]}\n"
        "field: {uniform: [0 mT, 0 mT, 1 mT]}\neffects: {magnetic_torque: {}}\n"
    )
    scene = load_scene(path)
    assert [piece.name for piece in scene.regions()] == ["base plate", "arm"]
    assert scene.thickness == pytest.approx(1e-3)
    assert build(scene).particles.volume.sum() == pytest.approx(3e-9, rel=1e-12)


CUBE = box((0, 0, 0), (1, 1, 1))


def test_parts_that_nearly_touch_are_told_of() -> None:
    """At a distance of one cell, half a millimeter, they share grid nodes and are joined at rest; in motion each has its own grid."""
    near = [{"mesh": CUBE, "name": "a"}, {"mesh": box((1.5, 0, 0), (2.5, 1, 1)), "name": "b"}]
    scene = parts_scene({"mesh": box((-1, 0, 0), (0, 1, 1)), "clamp": True, "name": "wall"}, *near)
    told = [w for w in scene.warnings() if w.startswith("body.parts:")]
    assert len(told) == 1
    assert "a and b are 0.5 mm apart, less than two cells of 0.5 mm" in told[0]
    moving = {**scene.to_si(), "solver": {"dynamic": {"duration": 1.0}}}
    assert not [w for w in Scene.from_si(moving).warnings() if w.startswith("body.parts:")]
    moving["effects"] = {"self_contact": {}}
    assert not [w for w in Scene.from_si(moving).warnings() if w.startswith("effects.self_contact")]
    one = parts_scene({"mesh": CUBE, "clamp": True}, {"mesh": box((1, 0, 0), (2, 1, 1))}).to_si()
    one |= {key: moving[key] for key in ("solver", "effects")}
    assert "all parts touch" in next(
        w for w in Scene.from_si(one).warnings() if w.startswith("effects.self_contact")
    )


def test_equilibrium_needs_every_part_to_hang_on_something() -> None:
    loose = {"mesh": box((5, 0, 0), (6, 1, 1)), "name": "loose"}
    held = [{"mesh": box((-1, 0, 0), (0, 1, 1)), "clamp": True}, {"mesh": CUBE}]
    with pytest.raises(InputError, match="loose touches no part that is held"):
        run(parts_scene(*held, loose))


FEET = ((0.0, 0.0, -2.0), (3.0, 2.0, 0.0)), ((13.0, 0.0, -2.0), (16.0, 2.0, 0.0))
RING = [
    ((0, 0, -2), (12, 2, 0)),
    ((0, 10, -2), (12, 12, 0)),
    ((0, 2, -2), (2, 10, 0)),
    ((10, 2, -2), (12, 10, 0)),
]


@pytest.mark.parametrize(
    ("solver", "gap"),
    [({"static": {}}, 4.0), ({"quasi_static": {"steps": 2}}, 4.0), ({"static": {}}, 12.0)],
    ids=["at rest", "along time", "far"],
)
def test_every_solid_of_a_mesh_must_hang_on_something(
    solver: dict[str, Any], gap: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One mesh of two solids, one of which nothing holds: refused before a kernel is loaded, with its part, size and place."""

    def never(*_: object, **__: object) -> float:
        raise AssertionError("kernels were asked for")

    monkeypatch.setattr("magmpm.solving.solve.prepare_kernels", never)
    begin = 10.0 + gap
    two = Mesh(*together(box((0, -2, -2), (10, 2, 2)), box((begin, -2, -2), (begin + 10, 2, 2))))
    data = parts_scene(
        {"mesh": box((-3, -3, -3), (0, 3, 3)), "clamp": True},
        {"mesh": two, "name": "two"},
        spacing=1e-3,
    ).to_si()
    data["solver"] = solver
    data["field"]["over_time"] = {"ramp": {"duration": 0.1}} if "quasi_static" in solver else None
    with pytest.raises(
        InputError,
        match=(
            r"meshes\[1\]: a piece of two, 160 of its 320 mm\^3, touches no part .*"
            rf" \({begin + 5:.3f}, "
        ),
    ):
        run(Scene.from_si(data))


def test_solids_of_a_mesh_that_are_near_each_other_are_told_of() -> None:
    """Two solids of one mesh share a grid at rest and in motion; a solid in another one's cavity is a solid of its own."""
    near = Mesh(*together(CUBE, box((1.5, 0, 0), (2.5, 1, 1))))
    scene = parts_scene(
        {"mesh": box((-1, 0, 0), (0, 1, 1)), "clamp": True}, {"mesh": near, "name": "pair"}
    )
    moving = Scene.from_si({**scene.to_si(), "solver": {"dynamic": {"duration": 1.0}}})
    for each in (scene, moving):
        assert [
            w
            for w in each.warnings()
            if "two solids of pair are 0.5 mm apart, less than two cells of 0.5 mm" in w
        ]
    nested = solids_of(
        *together(BLOCK, box((1, 1, 1), (3, 3, 3)), box((1.5, 1.5, 1.5), (2, 2, 2)), inverted=(1,))
    )
    assert sorted(solid.volume() for solid in nested) == pytest.approx(
        [0.125, 56.0], rel=1e-12
    )  # rounding
    assert nested[0].min_gap(nested[1], 1.0) == pytest.approx(0.5, rel=1e-12)


def test_a_speck_beside_large_parts_is_told_of() -> None:
    """A file in meters that is read as millimeters, where no spacing is given that would refuse it."""
    speck = box((0, 0, 0), (0.01, 0.004, 0.004))
    scene = parts_scene(
        {"mesh": box((-6, -3, -3), (0, 3, 3)), "clamp": True}, {"mesh": speck, "name": "speck"}
    )
    assert [
        w
        for w in scene.warnings()
        if "speck is 0.01 mm long, all parts together 6.01 mm: are all files in mm?" in w
    ]


@pytest.mark.parametrize(
    "written",
    [
        lambda text: text.upper(),
        lambda text: text.replace(".", ","),
        lambda text: text.replace(" 1.5\n", " 1.5,\n"),
    ],
    ids=["capitals", "decimal commas", "commas between"],
)
def test_text_stl_of_other_programs_is_read(written: Any, tmp_path: Path) -> None:
    solid = box((0.5, 0.5, 0.5), (3.5, 2.25, 1.5))
    (tmp_path / "s.stl").write_text(written(stl_text(solid)))
    assert volume_of(read_stl(tmp_path / "s.stl").triangles) == pytest.approx(
        3 * 1.75 * 1.0, rel=1e-12
    )  # exact in binary


@pytest.mark.parametrize(
    ("free", "held", "planes"),
    [
        ([((0, 0, 0), (16, 2, 2))], [((-2, -2, -2), (18, 4, 0))], 1),
        ([((0, 0, 0), (16, 2, 2))], [((0, 0, -2), (16, 2, 0))], 1),
        ([((0, 0, 0), (16, 2, 2))], [((0, 0, -2), (15.6, 2, 0))], 1),
        ([((0, 0, 0), (16, 2, 2))], FEET, 0),
        ([((0, 0, 0), (3, 2, 6)), ((13, 0, 0), (16, 2, 6))], FEET, 1),
        ([((0, 0, 0), (12, 12, 1))], RING, 0),
        ([((0, 0, 0), (12, 12, 1))], [*RING, ((2, 2, -2), (10, 10, 0))], 1),
    ],
    ids=[
        "wide base",
        "flush base",
        "rim of less than half a cell",
        "bridge",
        "two legs",
        "membrane on a ring",
        "ring that is filled",
    ],
)
def test_only_what_stands_on_held_parts_is_clamped(
    free: list[Any], held: list[Any], planes: int
) -> None:
    """A layer of cells is at rest only where held parts are below all of it: the middle of a bridge and a membrane move."""
    solids = [box(low, high) for low, high in [*free, *held]]
    parts = [1e-3 * solid.vertices[solid.faces] for solid in solids]
    _, found = grid_of_parts(parts, [False] * len(free) + [True] * len(held), 1e-3)
    assert len(found) == planes


def text_of(content: bytes) -> str:
    return PREFIX + base64.b64encode(zlib.compress(content, 9)).decode()


def triangle(last: int) -> bytes:
    """One triangle of three vertices; last: the number of its last vertex."""
    return (
        np.array([3, 1], "<i8").tobytes()
        + np.eye(3).tobytes()
        + np.array([0, 1, last], "<i4").tobytes()
    )


HOSTILE = {
    "bomb": bytes(50_000_000),
    "far": triangle(10**6),
    "negative": triangle(-1),
    "empty": b"",
    "none": bytes(16),
}
TEXTS = {name: text_of(content) for name, content in HOSTILE.items()} | {
    "cut off": text_of(triangle(2))[:-8]
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_damaged_text_is_refused(text: str) -> None:
    """Before memory is taken for what a small text stands for, and before a face's number is used."""
    with pytest.raises(MeshError, match="damaged"):
        unpack_mesh(text)


def test_a_text_in_a_file_is_checked_as_a_mesh_is(tmp_path: Path) -> None:
    part = {"mesh": text_of(triangle(2)), "material": "s", "clamp": True}
    materials = {"s": {"shear_modulus": "100 kPa", "bulk_to_shear": 20}}
    file = tmp_path / "scene.yaml"
    data = {
        "name": "x",
        "materials": materials,
        "body": {"parts": {"unit": "mm", "meshes": [part]}},
    }
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(InputError, match="watertight"):
        load_scene(file)


def test_a_mesh_whose_vertices_all_count_as_one_is_refused(tmp_path: Path) -> None:
    """A vertex that is far away makes all others near each other, so that no triangle is left (found by `make fuzz-coverage`)."""
    corners = np.zeros((4, 3, 3), "<f4")
    corners[:, 1], corners[:, 2] = [1e-3, 0, 0], [0, 1e-3, 0]  # mm
    corners[3, 2] = [1e8, 0, 0]
    corners[3, 1] = [1e8, 0, 0]
    records = np.zeros(
        4, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    records["corners"] = corners
    path = tmp_path / "far.stl"
    path.write_bytes(bytes(80) + len(records).to_bytes(4, "little") + records.tobytes())
    with pytest.raises(MeshError, match="encloses none"):
        read_stl(path)
