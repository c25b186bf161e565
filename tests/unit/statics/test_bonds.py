"""Bonds of cut grids: what stretches them and what does not, how held faces hold, and arcs of bodies of any form."""

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.scenes import rod_scene
from reference.solids import Mesh, box, turned
from scipy.spatial.transform import Rotation

from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.arcs import rest_nodes
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.newton import _search, factored, minimize

AXIS = (1.0, 2.0, 3.0)
ANGLE = 0.7
FIELD = np.array([0.0, 0.0, 2e-3])
SPACING = 0.7e-3  # m


def beam(
    *, angle: float, boxes: tuple[tuple[float, float], ...] = ((0, 12),)
) -> tuple[Scene, np.ndarray]:
    """A beam of 3 x 3 mm on a held block, turned about AXIS with its magnetization and field; and the rotation."""
    turn = Rotation.from_rotvec(angle * np.array(AXIS) / np.linalg.norm(AXIS)).as_matrix()
    held = {
        "mesh": pack_mesh(turned(box((-3, -2.5, -2.5), (0, 2.5, 2.5)), AXIS, angle)),
        "material": "m",
        "clamp": True,
    }
    free = [
        {
            "mesh": pack_mesh(turned(box((a, -1.5, -1.5), (b, 1.5, 1.5)), AXIS, angle)),
            "material": "m",
            "magnetization": turn[:, 0].tolist(),
        }
        for a, b in boxes
    ]
    body = {"parts": {"unit": "mm", "spacing": SPACING, "meshes": [held, *free]}}
    return (
        resting_scene(body, {"magnetic_torque": {}}, field={"uniform": (turn @ FIELD).tolist()}),
        turn,
    )


def along_xyz(scene: Scene) -> StaticModel:
    """The model on a grid along x, y and z, which cuts a turned body obliquely. Equilibria of these beams are sought along their faces."""
    at = scene.resolution
    made = scene.body.shape.discretize(at.cells_across, at.particles_per_cell)
    return static_model(build(scene, made))


@pytest.fixture(scope="module")
def oblique() -> StaticModel:
    return along_xyz(beam(angle=ANGLE)[0])


def end(scene: Scene, turn: np.ndarray) -> np.ndarray:
    """Mean displacement (3,) m of the last millimeter, in the beam's own axes."""
    model = along_xyz(scene)
    found = solve_static(model)
    last = model.particles.volume * ((model.particles.position @ turn)[:, 0] > 11e-3)
    return last @ found.point.displacement @ turn / last.sum()


@pytest.mark.parametrize("boxes", [((0, 12),), ((0, 5), (5, 12))], ids=["one part", "two parts"])
def test_a_turned_beam_bends_as_the_straight_one(boxes: tuple[tuple[float, float], ...]) -> None:
    """To 0.5 %, as asked: at four cells across. With all nodes fixed that the held block touches it was 15 % stiffer."""
    straight, oblique = (end(*beam(angle=angle, boxes=boxes)) for angle in (0.0, ANGLE))
    assert np.linalg.norm(oblique - straight) < 5e-3 * np.linalg.norm(straight)


def test_a_turned_beam_along_its_own_grid_is_the_straight_one() -> None:
    """The same cells, turned: the solves end within a decrement of 1e-11 of the energy, 3e-6 of the displacement."""
    ends = []
    for angle in (0.0, ANGLE):
        scene, turn = beam(angle=angle)
        model = static_model(build(scene))
        found = solve_static(model)
        order = np.lexsort(np.round((model.particles.position @ turn).T / SPACING, 5))
        ends.append(found.point.displacement[order] @ turn)
        assert model.layout.bonds is None
    straight, oblique = ends
    assert np.abs(oblique - straight).max() < 3e-6 * np.abs(straight).max()


@pytest.mark.parametrize("angle", [0.0, ANGLE])
@pytest.mark.parametrize("gap", [0.05, 0.2])
def test_a_part_across_a_gap_moves_as_if_joined(gap: float, angle: float) -> None:
    """As bodies.assembly says of parts less than two cells apart. A strip of half a gap beside the face is held too, which shortens a beam
    of 12 mm by up to 1 %, and lowers its deflection, which goes with the cube, by 3 %; the rest is the clamp's own give."""
    joined, apart = (end(*beam(angle=angle, boxes=((at, at + 12),))) for at in (0.0, gap))
    assert np.linalg.norm(apart - joined) < 0.06 * np.linalg.norm(joined)


def test_solids_of_one_part_across_a_gap_are_held_too() -> None:
    """One touches the held block by an oblique face, the other does not: the nodes that the block touches hold it, up to two cells of its
    14. Deflections go with the cube of the length, (12 / 14)^3 = 0.63."""
    turn = Rotation.from_rotvec(ANGLE * np.array(AXIS) / np.linalg.norm(AXIS)).as_matrix()
    block, one, other = (
        turned(solid, AXIS, ANGLE)
        for solid in (
            box((-3, -6, -3), (0, 6, 3)),
            box((0, -5, -1.5), (10, -2, 1.5)),
            box((0.2, 2, -1.5), (10, 5, 1.5)),
        )
    )
    both = Mesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]),
    )
    held = {"mesh": pack_mesh(block), "material": "m", "clamp": True}
    free = {"mesh": pack_mesh(both), "material": "m", "magnetization": turn[:, 0].tolist()}
    body = {"parts": {"unit": "mm", "spacing": SPACING, "meshes": [held, free]}}
    field = {"uniform": (turn @ FIELD).tolist()}
    model = along_xyz(resting_scene(body, {"magnetic_torque": {}}, field=field))
    found = solve_static(model)
    place = model.particles.position @ turn
    joined, apart = (
        (found.point.displacement @ turn)[(place[:, 0] > 9e-3) & (side * place[:, 1] > 0)].mean(
            axis=0
        )[2]
        for side in (-1, 1)
    )
    assert 0.6 * joined < apart < joined


def test_the_unloaded_tangent_of_a_turned_beam_is_positive_definite(oblique: StaticModel) -> None:
    energy = Energy(oblique)
    _, matrix = energy.tangent(energy.at(np.zeros(energy.shape)))
    assert matrix.diagonal().min() > 0.0
    assert matrix.factor()


def test_bodies_along_the_grid_have_no_bonds() -> None:
    model = static_model(
        build(
            resting_scene(
                {
                    "parts": {
                        "unit": "mm",
                        "spacing": 0.75e-3,
                        "meshes": [
                            {
                                "mesh": pack_mesh(box((-1.5, -1.5, -1.5), (0, 1.5, 1.5))),
                                "material": "m",
                                "clamp": True,
                            },
                            {
                                "mesh": pack_mesh(box((0, -1.5, -1.5), (6, 1.5, 1.5))),
                                "material": "m",
                            },
                        ],
                    }
                },
                {"gravity": {}},
            )
        )
    )
    assert model.layout.bonds is None
    assert model.layout.springs is None


def test_even_motions_stretch_no_bond_of_an_outer_node(oblique: StaticModel) -> None:
    """Shifts, turns, strains and even bending: coefficients that are quadratic in the nodes' places. Rounding is 1e-16 of 27 terms."""
    layout = oblique.layout
    assert layout.bonds is not None
    outer = layout.bonds.share[:, 0] == 1.0
    assert outer.sum() > 20
    X = rest_nodes(oblique) / 10e-3
    x, y, z = np.moveaxis(X, -1, 0)
    for values in (np.ones_like(x), x, y, z, x * y, x * z, y * z, x**2, y**2, z**2):
        grid = np.repeat(values[..., None], 3, axis=-1).reshape(layout.planes, layout.m)
        assert np.abs(layout.springs.stretched(grid)[outer]).max() < 1e-12 * np.abs(values).max()
    cubic = np.repeat((x**3)[..., None], 3, axis=-1).reshape(layout.planes, layout.m)
    assert np.abs(layout.springs.stretched(cubic)[outer]).max() > 1e-6


def test_bonds_are_part_of_energy_gradient_and_tangent(
    oblique: StaticModel, rng: np.random.Generator
) -> None:
    """Central differences of the energy and of the gradient, at steps of 1e-9 m of a body whose coefficients differ by 1e-5 m."""
    energy = Energy(oblique)
    grid = 1e-5 * energy.free(rng.standard_normal(energy.shape))
    d = energy.free(rng.standard_normal(energy.shape))
    h = 1e-9
    ahead, behind = (energy.at(grid + side * h * d) for side in (1, -1))
    point = energy.at(grid)
    assert np.sum(energy.residual(point) * d) == pytest.approx(
        (ahead.energy - behind.energy) / (2 * h), rel=1e-5
    )
    product = energy.products(point, d[:, None])[0][:, 0]
    slope = (energy.residual(ahead) - energy.residual(behind)) / (2 * h)
    np.testing.assert_allclose(product, slope, rtol=0, atol=1e-5 * np.abs(slope).max())
    _, matrix = energy.tangent(point)
    assert matrix.factor()
    back = matrix.solve(product)
    np.testing.assert_allclose(
        back, d, rtol=0, atol=1e-7 * np.abs(d).max()
    )  # the matrix is the one whose products these are


def test_an_arc_is_the_straight_step_to_first_order_and_turns_without_strain(
    oblique: StaticModel,
) -> None:
    """A step along which the whole body would turn: the arc turns it by the angle, the straight step blows it up by the cosine."""
    bare = beam(angle=ANGLE)[0]
    energy = Energy(along_xyz(bare))
    rng = np.random.default_rng(6)
    grid = 1e-6 * energy.free(rng.standard_normal(energy.shape))
    d = energy.free(rng.standard_normal(energy.shape))
    point = energy.at(grid)
    off = [np.abs(energy.arc(point, d, t) - grid - t * d).max() for t in (1e-6, 1e-7)]
    assert off[0] / off[1] == pytest.approx(100, rel=0.1)  # second order
    wanted = np.array([0.0, 0.9, 0.0])
    bend = energy.free(
        np.cross(
            wanted, rest_nodes(energy.model) - rest_nodes(energy.model).mean(axis=(0, 1))
        ).reshape(energy.shape)
    )
    rest = energy.at(np.zeros(energy.shape))
    arc, straight = (energy.at(each).energy for each in (energy.arc(rest, bend, 0.2), 0.2 * bend))
    assert arc < straight


@pytest.mark.parametrize("parts", [True, False])
def test_a_short_step_of_parts_goes_on_along_its_way(oblique: StaticModel, parts: bool) -> None:
    """A tenth of Newton's step: the energy falls almost evenly along it, and goes on to fall. Straight bodies stop at its end."""
    model = oblique if parts else static_model(build(rod_scene(field=(0.0, 0.0, 1e-5))))
    energy = Energy(model)
    point = energy.at(np.zeros(energy.shape))
    residual, _ = factored(energy, point)
    direction = -0.1 * energy.matrix.solve(residual)
    decrement = -float(np.sum(residual * direction)) / 2
    scale = energy.least_scale()
    found = _search(energy, point, direction, decrement, scale)
    won = (point.energy - found.energy) / decrement
    assert won > 4.0 if parts else won == pytest.approx(1.9, abs=0.01)


def test_a_failure_names_the_part_that_does_not_settle() -> None:
    """Of two pieces in a row, the outer one moves farther in every step."""
    scene, _ = beam(angle=0.0, boxes=((0, 6), (6, 12)))
    model = static_model(build(scene.with_field([0.0, 0.0, 50e-3])))
    outer = scene.regions()[2].name
    still = np.zeros((model.layout.planes, model.layout.m))
    with pytest.raises(SolveError, match=rf"{outer} does not settle: .* mm"):
        minimize(Energy(model), still, tolerance=1e-9, max_steps=1)
