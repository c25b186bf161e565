"""The contract of bodies: what scenes, models, effects and solvers may expect of every kind (bodies.body_shape); strips."""

from typing import Any

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.solids import box

from magmpm.bodies.body import Body
from magmpm.bodies.body_shape import BodyShape, Discretization
from magmpm.bodies.segments import StraightBody, torsion_constant
from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.model import build
from magmpm.results import measures
from magmpm.scene import Scene
from magmpm.simulate import run

SEGMENTS = [
    {"magnetization": [1, 0, 0]},
    {"magnetization": [0, 0, 0]},
    {"magnetization": [0, 0.6, 0.8]},
]
PLATE = {"length": 8e-3, "width": 4e-3, "thickness": 1e-3, "material": "soft"}
BODIES: dict[str, dict[str, Any]] = {
    "tube": {
        "catheter": {
            "length": 8e-3,
            "diameter": 2e-3,
            "inner_diameter": 0.8e-3,
            "material": "soft",
            "segments": SEGMENTS,
        }
    },
    "strip": {
        "strip": {**PLATE, "position": [1e-3, 2e-3, 3e-3], "clamp": "both", "segments": SEGMENTS}
    },
    "sheet": {
        "strip": {
            **PLATE,
            "plane_strain": True,
            "magnetization_profile": {"harmonic": {"periods": 1.0}},
        }
    },
    "parts": {
        "parts": {
            "unit": "mm",
            "meshes": [
                {"mesh": pack_mesh(box((0, 0, 0), (1, 1, 1))), "material": "soft", "clamp": True},
                {
                    "mesh": pack_mesh(box((1, 0, 0), (4, 1, 1))),
                    "material": "soft",
                    "magnetization": [0, 0, 1],
                },
                {"mesh": pack_mesh(box((0, 3, 0), (4, 4, 1))), "material": "soft"},
            ],
        }
    },
}
ACROSS = 3
COUNT = 2


@pytest.fixture(params=BODIES)
def shape(request: pytest.FixtureRequest) -> BodyShape:
    return Body(**BODIES[request.param]).shape


@pytest.fixture
def made(shape: BodyShape) -> Discretization:
    return shape.discretize(ACROSS, COUNT)


def test_the_grid_is_that_of_the_particles(shape: BodyShape, made: Discretization) -> None:
    """One grid a body; particles are in the cells they name, in their order; cells are about as wide as asked for through the thickness."""
    grid = shape.grid(ACROSS)
    assert (grid.origin.tobytes(), grid.spacing.tobytes(), grid.cells) == (
        made.grid.origin.tobytes(),
        made.grid.spacing.tobytes(),
        made.grid.cells,
    )
    made.grid.locate(made.particles.position, made.particles.cell)
    assert np.all(np.diff(np.ravel_multi_index(made.particles.cell.T, made.grid.cells)) >= 0), (
        "sorted"
    )
    assert made.grid.spacing[2] == pytest.approx(
        shape.cell_size(ACROSS), rel=1e-9
    )  # every body here is a whole number of cells high


def test_particles_fill_the_body(shape: BodyShape, made: Discretization) -> None:
    """They lie in its box, reach all of its regions, and are no fewer than it says. Quadrature is exact: errors are rounding."""
    low, high = (np.array(corner) for corner in shape.box())
    assert np.all((made.particles.position > low) & (made.particles.position < high))
    assert np.unique(made.particles.segment).tolist() == list(range(len(shape.regions())))
    assert shape.fewest_particles(ACROSS, COUNT) <= len(made.particles.volume) * (1 + 1e-12)
    assert max(made.errors.values()) < 1e-9  # sums over hundreds of particles


def test_magnetization_has_length_one_or_none(shape: BodyShape, made: Discretization) -> None:
    """And is that of each region, where a region has one."""
    found = np.linalg.norm(shape.magnetization(made.particles), axis=1)
    wanted = np.array([np.linalg.norm(region.magnetization) for region in shape.regions()])[
        made.particles.segment
    ]
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_components_and_parts(shape: BodyShape, made: Discretization) -> None:
    """Parts that touch are one component, the part apart from them is another; bodies of one piece are one component and one part."""
    component = shape.components(made.particles)
    part = shape.part_of(made.particles)
    several = not isinstance(shape, StraightBody)
    assert [len(np.unique(component)), len(np.unique(part))] == ([2, 3] if several else [1, 1])
    assert (shape.line is None) == several


def test_a_kind_must_answer_everything() -> None:
    """A class that leaves a question of the interface open can't be made."""

    class Blob(BodyShape):
        pass

    with pytest.raises(TypeError, match="abstract"):
        Blob()  # type: ignore[abstract]


L = 8e-3
B = 3e-3
T = 1e-3


def strip_scene(
    *, field: tuple[float, ...] = (0.0, 0.0, 3e-3), cells: int = 2, **strip: Any
) -> Scene:
    """A strip of 8 x 3 x 1 mm; strip: keys to add or replace."""
    shape = {"length": L, "width": B, "thickness": T, "material": "m", **strip}
    if "magnetization_profile" not in strip:
        shape.setdefault("segments", [{"magnetization": [1, 0, 0]}])
    return resting_scene(
        {"strip": shape}, {"magnetic_torque": {}}, cells=cells, field={"uniform": list(field)}
    )


def test_volume_centroid_and_second_moments_are_exact_anywhere() -> None:
    """Gauss points in full cells: all moments of degree 2 are exact to rounding, at any position of the strip."""
    base = np.array([3e-3, -2e-3, 7e-3])
    model = build(strip_scene(position=base.tolist(), cells=3))
    p = model.particles.position - base
    v = model.particles.volume
    size = np.array([L, B, T])
    center = np.array([L / 2, 0, 0])
    second = size**2 / 12
    assert v.sum() == pytest.approx(size.prod(), rel=1e-13)
    np.testing.assert_allclose(v @ p / v.sum(), center, atol=1e-15)
    np.testing.assert_allclose(v @ (p - center) ** 2 / v.sum(), second, rtol=1e-12)
    assert max(model.section.values()) < 1e-12


def test_where_it_stands_does_not_matter() -> None:
    """The result moves with the strip, to rounding of 1e-12 of its length."""
    here = run(strip_scene())
    there = run(strip_scene(position=[0.01, 0.02, -0.03]))
    np.testing.assert_allclose(
        there.centreline[:, 1:] - [0.01, 0.02, -0.03], here.centreline[:, 1:], atol=1e-12
    )
    np.testing.assert_allclose(there.tip - [0.01, 0.02, -0.03], here.tip, atol=1e-12)


@pytest.mark.parametrize(
    ("plane_strain", "y", "warned"), [(True, 9.81, True), (True, 0.0, False), (False, 9.81, False)]
)
def test_gravity_across_a_plane_strain_strip_is_warned_of(
    plane_strain: bool, y: float, warned: bool
) -> None:
    """Nothing moves along y in plane strain; the same warning as for a y component of the field."""
    scene = strip_scene(plane_strain=plane_strain).with_effects(
        gravity={"acceleration": [0.0, y, -1.0]}
    )
    assert [text for text in scene.warnings() if "gravity" in text] == [
        "effects.gravity: the y component of its acceleration has no effect on a strip in plane"
        " strain"
    ] * warned


def test_plane_strain_is_plane() -> None:
    """Nothing moves or varies along y, and the strip is stiffer than one that is free to contract."""
    free = run(strip_scene(width=T))
    plane = run(strip_scene(width=T, plane_strain=True))
    moved = plane.particle_position - plane.particle_reference
    assert not moved[:, 1].any()
    assert (
        plane.tip[2] < 0.95 * free.tip[2]
    )  # E/(1 - nu^2) = 1.32 E, minus the effect of the clamp in both


def test_clamped_at_both_ends_both_ends_stay() -> None:
    result = run(
        strip_scene(
            clamp="both", segments=[{"magnetization": [1, 0, 0]}, {"magnetization": [-1, 0, 0]}]
        )
    )
    np.testing.assert_allclose(result.centreline[[0, -1], 1:], [[0, 0, 0], [L, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(result.tip, [L, 0, 0], atol=1e-15)
    assert result.centreline[len(result.centreline) // 2, 3] > 1e-5  # the center rises


def test_a_profile_turns_at_every_particle() -> None:
    profile = {"harmonic": {"periods": 1.0, "phase": np.pi / 2, "plane": "xz", "turn": "cw"}}
    scene = strip_scene(magnetization_profile=profile, cells=4)
    model = build(scene)
    angle = np.pi / 2 - 2 * np.pi * model.particles.position[:, 0] / L
    want = 0.1 * np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    np.testing.assert_allclose(model.remanence, want, atol=1e-15)
    assert len(scene.regions()) == 8
    mean = measures.region_means(model, model.remanence)
    # Mean over an eighth of a turn: sin(pi/8)/(pi/8) = 0.974 of the region's own direction.
    np.testing.assert_allclose(mean, 0.974 * scene.region_remanence(), atol=0.002)


def test_axis_from_particles_is_the_axis() -> None:
    """The mean over sections of a displacement that the splines represent exactly, to rounding."""
    model = build(strip_scene())
    x = model.particles.position
    moved = x + np.outer(x[:, 0] ** 2, [1.0, 2.0, 30.0]) + np.outer(x[:, 2], [0.1, 0, 0])
    rows = measures.axis_of_particles(model, moved)
    s = rows[:, 0]
    np.testing.assert_allclose(
        rows[:, 1:], np.outer(s, [1, 0, 0]) + np.outer(s**2, [1, 2, 30]), atol=1e-13
    )


def test_torsion_constant_of_a_square_and_of_a_thin_strip() -> None:
    """0.1406 a^4 and b t^3/3 (1 - 0.63 t/b). Source: Timoshenko and Goodier, Theory of Elasticity, section 109."""
    assert torsion_constant(1.0, 1.0) == pytest.approx(0.1406, abs=5e-5)
    assert torsion_constant(20.0, 1.0) == pytest.approx(20 / 3 * (1 - 0.63 / 20), rel=1e-4)
