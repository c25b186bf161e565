"""Contact at equilibrium, against plain NumPy: where the surface's points are, their energy, force and tangent, on every kind of cells."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.panels import multiply
from reference.solids import box

from magmpm.bodies.surface_mesh import write_stl
from magmpm.effects import acting
from magmpm.effects.contact_law import FREE
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.tangent_matrix import Bands

GROUND = {"point": [0.0, 0.0, -0.998e-3], "normal": [-3e-4, 1e-3, 1.0]}
WALLS = {
    "tube": {"radius": 1.005e-3, "path": [[-4e-3, 0.0, 0.0], [4e-3, 0.0, 1e-6], [12e-3, 0.0, 5e-6]]}
}


def scene(body: dict[str, Any], **effects: Any) -> Scene:
    return resting_scene(body, effects)


def catheter(**more: Any) -> dict[str, Any]:
    return {
        "catheter": {
            "length": 8e-3,
            "diameter": 2e-3,
            "material": "m",
            "clamp": "base",
            "segments": [{}],
            **more,
        }
    }


def strip(**more: Any) -> dict[str, Any]:
    return {
        "strip": {
            "length": 8e-3,
            "width": 3e-3,
            "thickness": 2e-3,
            "material": "m",
            "clamp": "base",
            "segments": [{}],
            **more,
        }
    }


def bodies(folder: Path) -> dict[str, dict[str, Any]]:
    """One of each kind of cells and clamps; the longest side of the parts is along z."""
    for name, part in {
        "low": box((-1, -1, -1), (1, 1, 1)),
        "high": box((-1, -1, 1), (1, 1, 7)),
    }.items():
        write_stl(part, folder / f"{name}.stl")
    meshes = [
        {"mesh": str(folder / "low.stl"), "material": "m"},
        {"mesh": str(folder / "high.stl"), "material": "m", "clamp": True},
    ]
    return {
        "rod": catheter(),
        "tube": catheter(inner_diameter=1e-3),
        "strip": strip(),
        "both ends": strip(clamp="both"),
        "plane strain": strip(plane_strain=True),
        "parts": {"parts": {"unit": "mm", "spacing": 1e-3, "meshes": meshes}},
    }


KINDS = ("rod", "tube", "strip", "both ends", "plane strain", "parts")


def resting(kind: str, folder: Path, **effects: Any) -> StaticModel:
    """The model of a kind of body at rest."""
    return static_model(build(scene(bodies(folder)[kind], **effects)))


def on_nodes(model: StaticModel, grid: np.ndarray) -> np.ndarray:
    """Coefficients (nodes x, y, z, 3) m of the whole grid, from those of the unknowns."""
    out = np.zeros((*model.grid.nodes, 3))
    first = int(model.clamped_face)
    node = model.layout.node_yz
    out[first:, node[:, 0], node[:, 1]] = grid.reshape(model.layout.planes, -1, 3)
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_points_move_with_the_splines_of_their_cells(
    kind: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Each by the sum of splines times coefficients, written out; a field that is linear in the clamp's distance is exact."""
    model = resting(kind, tmp_path, ground=GROUND)
    on = model.touching
    grid = 1e-5 * rng.standard_normal((model.layout.planes, model.layout.m))
    nodes = on_nodes(model, grid)
    moved = on.positions(grid) - on.place
    for p in range(0, len(on.mass), 7):
        u = np.zeros(3)
        for a, b, c in np.ndindex(3, 3, 3):
            share = on.weights[p, 0, a] * on.weights[p, 1, b] * on.weights[p, 2, c]
            if share != 0.0:
                i, j, k = on.first[p] + [a, b, c]
                u += share * nodes[i, j % model.grid.nodes[1], k]
        np.testing.assert_allclose(moved[p], u, rtol=0, atol=1e-18)
    if kind in ("rod", "tube", "strip"):
        linear = np.repeat(
            model.plane_coordinates()[:, None], model.layout.nodes_per_plane, axis=1
        )[..., None] * [1e-2, 2e-2, -3e-2]
        np.testing.assert_allclose(
            on.positions(linear.reshape(grid.shape)) - on.place,
            on.place[:, :1] * [1e-2, 2e-2, -3e-2],
            rtol=0,
            atol=1e-16,
        )


@pytest.mark.parametrize("kind", KINDS)
def test_the_energy_is_that_of_the_push(kind: str, tmp_path: Path) -> None:
    """At rest sum of m w^2 depth^2 / 2 over the surface, whose area the masses share, and the force m w^2 depth along the normal."""
    model = resting(kind, tmp_path, ground={**GROUND, "stiffness": 1.0})
    normal = np.array(GROUND["normal"]) / np.linalg.norm(GROUND["normal"])
    shear = 120e3
    bulk = 20 * 120e3
    stiffness = FREE * (bulk + 4 / 3 * shear) / 1882.0 / model.scene.cell**2
    surface = model.surface
    depth = np.maximum((np.array(GROUND["point"]) - surface.place) @ normal, 0.0)
    touched = model.touching.touched(model.effects, np.zeros((model.layout.planes, model.layout.m)))
    assert touched.energy == pytest.approx(
        0.5 * stiffness * (surface.mass * depth**2).sum(), rel=1e-12
    )
    assert touched.energy > 0
    np.testing.assert_allclose(
        touched.f.sum(axis=0),
        stiffness * (surface.mass * depth).sum() * normal,
        rtol=1e-12,
        atol=1e-12,
    )


@pytest.mark.parametrize("kind", [*KINDS[:5], "walls"])
def test_force_and_tangent_are_derivatives_of_the_energy(
    kind: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """By central differences where points touch on both sides; and the matrix is the one whose products `product` gives."""
    effects = {"walls": WALLS} if kind == "walls" else {"ground": GROUND}
    model = resting("rod" if kind == "walls" else kind, tmp_path, **effects)
    on = model.touching
    shape = (model.layout.planes, model.layout.m)

    def energy(grid: np.ndarray) -> float:
        return on.touched(model.effects, grid).energy

    grid = 5e-5 * rng.standard_normal(shape)
    d = rng.standard_normal(shape)
    d[model.layout.fixed], grid[model.layout.fixed] = 0.0, 0.0
    touched = on.touched(model.effects, grid)
    h = 1e-9
    ahead, behind = (on.touched(model.effects, grid + side * h * d) for side in (1, -1))
    force = on.force(touched).reshape(shape)
    assert -np.sum(force * d) == pytest.approx(
        (energy(grid + h * d) - energy(grid - h * d)) / (2 * h), rel=1e-6
    )
    product = on.product(touched, d[:, None])[:, 0]
    slope = -(on.force(ahead) - on.force(behind)).reshape(shape) / (2 * h)
    np.testing.assert_allclose(
        product, slope, rtol=0, atol=2e-4 * np.abs(slope).max()
    )  # points that just begin to touch
    matrix = Bands(model.layout)
    out = np.empty(shape)
    matrix.clear()
    on.add_tangent(touched, matrix.target(on.cells))
    multiply(matrix.panels, model.layout.split, d, out)
    np.testing.assert_allclose(out, product, rtol=0, atol=1e-11 * np.abs(product).max())


def test_the_force_is_what_the_energy_loses_as_the_plane_falls() -> None:
    """At an equilibrium dE/d(height of the plane) is the force on the body, to 1e-6."""

    def found(height: float) -> Any:
        plane = {"point": [0.0, 0.0, -1.2e-3 + height]}
        return run(scene(catheter(), gravity={"acceleration": [0.0, 0.0, -600.0]}, ground=plane))

    low, here, high = (found(height) for height in (-1e-6, 0.0, 1e-6))
    told = here.contacts["ground"]
    assert told["force"][2] == pytest.approx((high.energy - low.energy) / 2e-6, rel=1e-6)
    assert told["count"] > 0
    assert 0 < told["depth"] < 0.1e-3


def test_a_plane_that_is_not_touched_changes_nothing() -> None:
    pull = {"acceleration": [0.0, 0.0, -100.0]}
    free, near = (
        run(scene(catheter(), gravity=pull, **more))
        for more in ({}, {"ground": {"point": [0.0, 0.0, -3e-3]}})
    )
    np.testing.assert_allclose(
        near.particle_position, free.particle_position, rtol=0, atol=1e-6 * 8e-3
    )
    assert near.stability == pytest.approx(free.stability, rel=1e-6)
    assert near.contacts == {"ground": {"force": [0.0, 0.0, 0.0], "count": 0, "depth": 0.0}}


def test_what_has_no_answer_is_refused(tmp_path: Path) -> None:
    """A start from a rod, an inserted length, a body inside the ground, missing densities; friction is left out with a warning."""
    there = scene(catheter(), ground=GROUND)
    rod = run(scene(catheter(), gravity={}))
    assert rod.contacts == {}
    model = static_model(build(there))
    shape = solve_rod(there)
    deep = scene(catheter(), ground={"point": [0.0, 0.0, 0.0]})
    with pytest.raises(ValueError, match="touch no obstacle"):
        solve_static(model, rod=shape)
    with pytest.raises(
        InputError,
        match=r"(?s)effects\.ground.*without obstacles.*name feed, with solver\.quasi_static",
    ):
        there.inserted(6e-3)
    with pytest.raises(InputError, match=r"(?s)effects\.ground.*start clear of it"):
        build(deep)
    assert any(
        "equilibria ignore friction" in text
        for text in scene(catheter(), ground={**GROUND, "friction": 0.3}).warnings()
    )
    assert not any("friction" in text for text in there.warnings())


def test_points_that_went_through_an_obstacle_are_told() -> None:
    """More than a cell deep, or past the table but beside the lumen; what is past its open ends is not in it."""
    inside = [3e-3, 0.0, 0.0]
    ground = scene(catheter(), ground=GROUND)
    there = scene(catheter(), walls=WALLS)
    assert (
        acting.passed(ground, np.array([inside]))
        is acting.passed(there, np.array([inside]))
        is None
    )
    assert "more than a cell" in str(acting.passed(ground, np.array([inside, [3e-3, 0.0, -3e-3]])))
    beside = [3e-3, 0.0, -20e-3]
    past = [60e-3, 0.0, -20e-3]
    assert acting.passed(there, np.array([inside, beside])) == "the body passed through the wall"
    assert acting.passed(there, np.array([inside, past])) is None
