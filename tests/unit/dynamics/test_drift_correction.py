"""dynamics.drift_correction: positions and F move to the fit with the splines of the undeformed body, as in the plain reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference import dynamics as reference
from reference.in_motion import advance, free_rod, quantities
from reference.moving import filled, moving_scene
from reference.scenes import rod_scene
from reference.solids import box

from magmpm.bodies.surface_mesh import write_stl
from magmpm.dynamics import drift_correction, energies
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.drift_correction import DriftCorrection
from magmpm.dynamics.time_loop import begin, interval
from magmpm.model import Model, build
from magmpm.scene import Scene

WHOLE = 10**9  # steps: the full correction
L = 8e-3


@pytest.fixture(scope="module")
def model() -> Model:
    return build(rod_scene(length=L))


def bent(model: Model, angle: float = 0.8) -> np.ndarray:
    """A section of a ring: its center line keeps its length."""
    x, y, z = model.particles.position.T
    radius = L / angle
    return np.column_stack([(radius - z) * np.sin(x / radius), 0.98 * y, radius - (radius - z) * np.cos(x / radius)])


def relaxed(model: Model, x: np.ndarray, F: np.ndarray, steps: int, fits: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Positions and F of a motion that starts there and is corrected; more fits come nearer to the least-squares solution."""
    motion, n = UpdatedMotion(model), len(x)
    motion.place(x, np.zeros((n, 3)), F, np.zeros((n, 3, 3)))
    assert motion.drift_correction is not None
    for _ in range(fits - 1):
        motion.drift_correction.fit(x - model.particles.position)
    motion.since = steps
    motion._relax()
    found = motion.particles()
    return found[0], found[2]


@pytest.mark.parametrize("averaged", [True, False], ids=["f-bar", "plain"])
def test_goes_to_the_fit_of_the_reference(model: Model, averaged: bool) -> None:
    """A bent rod: positions and F of the least-squares fit, after one fit from zero, and nearer after more."""
    if not averaged:
        model = replace(model, modes=np.zeros((len(model.density), 0)))
    x, start = bent(model), np.tile(np.eye(3), (len(model.density), 1, 1))
    places, A = reference.drift_corrected(model, x)
    h = model.grid.spacing.min()
    for fits, near in ((1, 1e-3), (40, 1e-5)):
        found, F = relaxed(model, x, start, WHOLE, fits=fits)
        assert np.abs(found - places).max() < near * h
        assert np.abs(F - A).max() < 5 * near
    assert np.abs(places - x).max() > 1e-4 * h
    assert np.abs(A - start).max() > 0.3


def test_goes_part_of_the_way(model: Model) -> None:
    """The share 1 - exp(-steps / SPAN) of the way."""
    x = bent(model)
    start = np.tile(np.eye(3), (len(x), 1, 1))
    _, whole = relaxed(model, x, start, WHOLE)
    _, some = relaxed(model, x, start, round(drift_correction.SPAN / 2))
    np.testing.assert_allclose(some - start, (1 - np.exp(-0.5)) * (whole - start), rtol=1e-9, atol=1e-12)


def test_an_affine_deformation_is_its_own_fit() -> None:
    """x stays, and F becomes its gradient: the splines contain rotations and uniform strains."""
    model = build(free_rod(formulation="updated", length=L))
    G = np.array([[0.9, -0.4, 0.1], [0.5, 1.1, 0.0], [0.2, 0.1, 1.05]])
    x = model.particles.position @ G.T + 1e-3
    found, F = relaxed(model, x, np.tile(np.eye(3), (len(x), 1, 1)), WHOLE, fits=10)
    np.testing.assert_allclose(found, x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(F, np.tile(G, (len(x), 1, 1)), rtol=0, atol=1e-5)


STRIP = {"length": L, "segments": [{"magnetization": [1, 0, 0]}], "width": 4e-3, "thickness": 2e-3, "material": "m"}


def held_beam(tmp_path: Path) -> Scene:
    """A beam along x on a held base."""
    for name, low, high in (("beam", (0.0, -1.0, 0.0), (8.0, 1.0, 2.0)), ("base", (0.0, -1.0, -2.0), (8.0, 1.0, 0.0))):
        write_stl(box(low, high), tmp_path / f"{name}.stl")
    meshes = [{"mesh": str(tmp_path / f"{name}.stl"), "material": "m", "clamp": name == "base"} for name in ("beam", "base")]
    return moving_scene({"parts": {"unit": "mm", "spacing": 1e-3, "meshes": meshes}}, {}, formulation="updated")


@pytest.mark.parametrize(("clamp", "faces"), [("base", [0.0]), ("both", [0.0, L]), ("none", []), ("held", [0.0])])
def test_the_fit_is_at_rest_on_clamps(tmp_path: Path, rng: np.random.Generator, clamp: str, faces: list[float]) -> None:
    """Whatever the particles do. Statics says where clamps are: its splines fit the same displacement as well as these do."""
    scene = held_beam(tmp_path) if clamp == "held" else moving_scene({"strip": {**STRIP, "clamp": clamp}}, {}, formulation="updated")
    model = build(scene)
    fitted = DriftCorrection(model)
    moved = 1e-4 * rng.standard_normal((len(model.density), 3)) + 1e-3
    moved[model.held] = 0.0
    for _ in range(40):
        fitted.fit(moved)
    found = []
    for outer, inner in fitted.faces:
        assert len(outer)
        np.testing.assert_array_equal(fitted.field[outer], -fitted.field[inner])
        found += np.unique(((fitted.node_place[outer] + fitted.node_place[inner]) / 2)[:, 2 if clamp == "held" else 0].round(9)).tolist()
    np.testing.assert_allclose(sorted(found), faces, atol=1e-12)
    weights, _ = model.splines()
    free = ~model.held
    values, root = statics_values(model, weights)[free], np.sqrt(model.density * model.particles.volume)[free, None]
    best = values @ np.linalg.lstsq(root * values, root * moved[free], rcond=None)[0]
    np.testing.assert_allclose(fitted._values(fitted.field)[free], best, rtol=0, atol=drift_correction.GOOD * fitted.size)


def statics_values(model: Model, weights: np.ndarray) -> np.ndarray:
    """Splines of statics at the particles, (n, nodes)."""
    cell, nodes = model.particles.cell.astype(int), np.array(model.grid.nodes) + 1
    values = np.zeros((len(cell), int(np.prod(nodes))))
    shift = (model.clamped_face & (cell[:, 0] == 0)).astype(int)
    for a, b, c in product(range(3), repeat=3):
        node = np.ravel_multi_index((cell + np.column_stack([a + shift, 0 * shift + b, 0 * shift + c])).T, nodes)
        values[np.arange(len(cell)), node] += weights[:, 0, a] * weights[:, 1, b] * weights[:, 2, c]
    return values


def test_centre_momentum_and_spin_of_a_free_body_stay(rng: np.random.Generator) -> None:
    model = build(free_rod(formulation="updated", length=L))
    motion, n = UpdatedMotion(model), len(model.density)
    x = bent(model) + 4e-5 * rng.standard_normal((n, 3))
    motion.place(x, rng.standard_normal((n, 3)), np.tile(np.eye(3), (n, 1, 1)), 50 * rng.standard_normal((n, 3, 3)))
    mass = model.density * model.particles.volume
    before = quantities(motion)
    assert motion.drift_correction is not None
    for _ in range(20):  # for such a scattered state one fit is not accurate enough to be used
        motion.drift_correction.fit(x - model.particles.position)
    motion.since = WHOLE
    motion._relax()
    after = quantities(motion)
    assert np.abs(motion.particles()[0] - x).max() > 1e-5
    np.testing.assert_allclose(mass @ motion.particles()[0], mass @ x, rtol=0, atol=1e-12 * mass.sum() * L)
    np.testing.assert_allclose(after.momentum, before.momentum, rtol=0, atol=1e-13 * np.abs(before.momentum).max())
    np.testing.assert_allclose(after.spin, before.spin, rtol=0, atol=1e-12 * np.abs(before.spin).max())


def test_what_touches_is_left_alone() -> None:
    """A rod folded flat on itself: particles of the two halves that share nodes stay; those of the hinge and those far apart are corrected.
    """
    model = build(rod_scene(length=40e-3))
    h = model.grid.spacing.min()
    rest = model.particles.position
    far = rest[:, 0] > 20e-3
    folded = np.where(far[:, None], rest * [-1, 1, 1] + [40e-3, 0, 4e-3 + 0.5 * h], rest)
    apart = np.where(far[:, None], rest * [-1, 1, 1] + [40e-3, 0, 4e-3 + 4 * h], rest)
    found = []
    for x in (folded, apart):
        motion, n = UpdatedMotion(model), len(x)
        motion.place(x, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))
        found.append(motion.touching)
    facing = np.where(far, rest[:, 2] < -1e-3, rest[:, 2] > 1e-3) & (np.abs(rest[:, 0] - 20e-3) > 4 * h)
    assert found[0][facing].all()
    assert not found[0][np.where(far, rest[:, 2] > 1e-3, rest[:, 2] < -1e-3)].any(), "the outer sides touch nothing"
    assert not found[1].any()


def test_a_torn_body_is_left_alone(model: Model) -> None:
    """Two halves three cells apart: where the error of the fit is a quarter of a cell, F stays unchanged."""
    x = model.particles.position.copy()
    x[x[:, 0] > L / 2, 0] += 3 * model.grid.spacing[0]
    start = np.tile(np.eye(3), (len(x), 1, 1))
    places, F = relaxed(model, x, start, WHOLE)
    at_crack = np.abs(model.particles.position[:, 0] - L / 2) < 0.5 * model.grid.spacing[0]
    assert np.array_equal(F[at_crack], start[at_crack])
    assert np.array_equal(places[at_crack], x[at_crack])


def test_numbering_keeps_pieces_apart() -> None:
    """Cells of two components have no common node; cells of one component share the nodes between them."""
    base = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    node, key = drift_correction._stencils(base, np.array([0, 0, 1]), (5, 3, 3))
    assert len(set(node[0]) & set(node[1])) == 18
    assert not set(node[1]) & set(node[2])
    assert len(key) == 36 + 27


def cubes(tmp_path: Path, gap: float) -> Scene:
    """Two free cubes of 8 mm, so far apart along z (mm), on cells of 2 mm."""
    write_stl(box((0.0, 0.0, gap), (8.0, 8.0, 8.0 + gap)), tmp_path / "upper.stl")
    write_stl(box((0.0, 0.0, -8.0), (8.0, 8.0, 0.0)), tmp_path / "lower.stl")
    meshes = [{"mesh": str(tmp_path / f"{name}.stl"), "material": "m"} for name in ("upper", "lower")]
    return moving_scene({"parts": {"unit": "mm", "spacing": 2e-3, "meshes": meshes}}, {"self_contact": {}}, formulation="updated")


@pytest.mark.parametrize(("gap", "count"), [(0.0, 1), (0.4, 2), (3.0, 2), (7.0, 2)])
def test_parts_that_touch_are_one_piece(tmp_path: Path, gap: float, count: int) -> None:
    """Parts that do not touch are separate components, even if they share cells of the grid."""
    assert len(np.unique(DriftCorrection(build(cubes(tmp_path, gap))).component)) == count


def test_cubes_that_fly_apart_gain_no_energy(tmp_path: Path) -> None:
    """They start 1.5 cells apart, where they still interact: their total energy only falls, over ten fits."""
    motion = begin(build(cubes(tmp_path, 3.0)))
    state, model = motion.motion, motion.motion.model
    assert isinstance(state, UpdatedMotion)
    x, n = model.particles.position, len(model.density)
    v = np.outer(np.where(model.particles.segment == 0, 0.2, -0.2), [0.0, 0.0, 1.0])
    state.place(x, v, np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))
    found = []
    for _ in range(10):
        advance(state, drift_correction.INTERVAL, motion.dt)
        found.append(state.kinetic_energy() + energies.elastic_energy(model, state.particles()[2], False))
    assert np.diff(found).max() < 0.01 * found[0]
    assert (state.particles()[0] - x)[:, 2].max() > 10e-3, "they have flown apart"


BEAM, BASE = ("beam", (0.0, 0.0, 0.0), (8.0, 4.0, 4.0), False), ("base", (-2.0, 0.0, -2.0), (8.0, 4.0, 0.0), True)


def solids(tmp_path: Path, *parts: tuple[str, Any, Any, bool], **more: Any) -> Scene:
    """Boxes: name, lower and upper corner in mm, whether it is held; in cells of 2 mm."""
    for name, low, high, _ in parts:
        write_stl(box(low, high), tmp_path / f"{name}.stl")
    meshes = [{"mesh": str(tmp_path / f"{name}.stl"), "material": "m", "clamp": held} for name, _, _, held in parts]
    return moving_scene({"parts": {"unit": "mm", "spacing": 2e-3, "meshes": meshes}}, **{"effects": {}, **more}, formulation="updated")


def test_where_clamps_meet_the_fit_is_the_best_one(tmp_path: Path, rng: np.random.Generator) -> None:
    """A block on a floor and against a wall, fitted by least squares on nodes of which those behind each face are minus their partners."""
    wall = ("wall", (-2.0, 0.0, 0.0), (0.0, 4.0, 4.0), True)
    model = build(solids(tmp_path, BEAM, BASE, wall, effects={}))
    assert len(model.planes) == 2
    fitted, free = DriftCorrection(model), ~model.held
    moved = np.where(model.held[:, None], 0.0, 1e-4 * rng.standard_normal((len(model.density), 3)) + 1e-3)
    for _ in range(60):
        fitted.fit(moved)
    count = len(fitted.field)
    values, held = np.zeros((len(moved), count)), np.eye(count)
    for node in range(count):
        one = np.zeros((count, 3))
        one[node] = 1.0
        values[:, node] = fitted._values(one)[:, 0]
    for outer, inner in fitted.faces:  # coefficients of all nodes from those that are free
        face = np.eye(count)
        face[outer, outer], face[outer, inner] = 0.0, -1.0
        held = face @ held
    held = np.linalg.matrix_power(held, 3)  # whatever the order of the faces
    root = np.sqrt(model.density * model.particles.volume)[:, None]
    splines = values @ held
    best = splines @ np.linalg.lstsq((root * splines)[free], (root * moved)[free], rcond=1e-10)[0]
    np.testing.assert_allclose(fitted._values(fitted.field)[free], best[free], rtol=0, atol=drift_correction.GOOD * fitted.size)


def test_what_hovers_over_a_clamp_falls_freely(tmp_path: Path) -> None:
    """A pebble a tenth of a cell above the base on which a beam stands: the fit does not hold it."""
    pebble = ("pebble", (12.0, 0.0, 0.2), (16.0, 4.0, 4.2), False)
    base = ("base", (-2.0, 0.0, -2.0), (18.0, 4.0, 0.0), True)
    model = filled(build(solids(tmp_path, BEAM, base, pebble, effects={"gravity": {"acceleration": [0, 0, 0.5]}})))
    assert len(model.planes) == 1
    loose = (model.particles.position[:, 0] > 10e-3) & ~model.held
    moved = interval(begin(model), 0.06).x - model.particles.position
    np.testing.assert_allclose(moved[loose], np.tile([0.0, 0.0, 0.5 * 0.5 * 0.06**2], (loose.sum(), 1)), rtol=0, atol=1e-12)


def test_rows_without_a_particle_follow_the_fit() -> None:
    """They fill up blocks of eight, and the watch sees them: where they kept F as it was before the fit, steps were shortened for nothing,
    in one way in a mirror image (random scene 131: 1429, 0.7 % of L)."""
    model = build(Scene.from_si({**rod_scene(length=L).to_si(), "resolution": {"cells_across": 3, "particles_per_cell": 3}}))
    motion, n = UpdatedMotion(model), len(model.density)
    motion.place(bent(model), np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))
    motion.since = WHOLE
    motion._relax()
    empty = np.flatnonzero(motion.particle < 0)
    assert len(empty)
    before = [np.flatnonzero(motion.particle[:k] >= 0)[-1] for k in empty]
    for blocks, width in ((motion.x, 3), (motion.F, 9)):
        rows = blocks.reshape(-1, width, 8).transpose(0, 2, 1).reshape(-1, width)
        np.testing.assert_array_equal(rows[empty], rows[before])
    assert np.abs(motion.F - np.tile(np.repeat(np.eye(3).ravel(), 8), len(motion.F) // 72)).max() > 0.01
