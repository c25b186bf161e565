"""A body that touches itself at rest: places, energy, force and tangent, against plain NumPy and differences."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from reference import own_contact as plain
from reference.moving import block, resting_scene
from reference.parts import parts_scene
from reference.solids import box

from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.own_contact import HeldPairs, RestingPairs, holding, released

# m
SIZE = 3e-3
CELL = 1.5e-3
GAP = 0.1e-3
LOW = (SIZE + GAP, 0.2e-3, 0.3e-3)
HIGH = (2 * SIZE + GAP, 3.2e-3, 3.3e-3)
REST = {"solver": {"static": {}}}


def cubes(folder: Path, **more: Any) -> Scene:
    """Two free cubes with a gap along x."""
    meshes = {"a": box((0.0, 0.0, 0.0), (SIZE,) * 3), "b": box(LOW, HIGH)}
    return parts_scene(folder, meshes, {"self_contact": {}}, CELL, **REST, **more)


def held_cubes(folder: Path) -> StaticModel:
    """The same, each on a held one behind it."""
    meshes = {
        "behind": box((-SIZE, 0.0, 0.0), (0.0, SIZE, SIZE)),
        "a": box((0.0, 0.0, 0.0), (SIZE,) * 3),
        "b": box(LOW, HIGH),
        "beyond": box((HIGH[0], *LOW[1:]), (HIGH[0] + SIZE, *HIGH[1:])),
    }
    held = ["behind", "beyond"]
    effects = {"self_contact": {"friction": 0.4}}  # of paths alone
    scene = parts_scene(folder, meshes, effects, CELL, held=held, **REST)
    return static_model(build(scene))


def pressed(model: StaticModel, rng: np.random.Generator) -> np.ndarray:
    """Coefficients (planes, m) m that press a into b, unevenly."""
    layout = model.layout
    grid = np.zeros((layout.planes, layout.nodes_per_plane, 3))
    grid[: layout.planes // 2, :, 0] = 1.6 * GAP
    grid += 2e-5 * rng.standard_normal(grid.shape)
    grid = grid.reshape(layout.planes, -1)
    grid[layout.fixed] = 0.0
    return grid


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> StaticModel:
    return held_cubes(tmp_path_factory.mktemp("held"))


def test_pairs_are_those_of_plain_numpy(tmp_path: Path, rng: np.random.Generator) -> None:
    """Points, depths and energy of free cubes, pressed and bent; the forces and their moments cancel to rounding."""
    free = build(cubes(tmp_path))
    nodes = free.nodes_in_motion
    yz = np.stack(np.meshgrid(*map(np.arange, nodes[1:]), indexing="ij"), -1).reshape(-1, 2)
    pairs = RestingPairs(free, False).numbered(SimpleNamespace(planes=nodes[0], node_yz=yz), 0)
    u = np.zeros((nodes[0], int(np.prod(nodes[1:])), 3))
    u[: nodes[0] // 2, :, 0] = 1.5 * GAP
    u += 2e-5 * rng.standard_normal(u.shape)
    found = pairs.touched(u.reshape(nodes[0], -1))
    expected = plain.depths(free, u.reshape(-1, 3), [((0.0,) * 3, (SIZE,) * 3), (LOW, HIGH)])
    told = dict(
        zip(zip(found.point.tolist(), found.solid.tolist(), strict=True), found.depth, strict=True)
    )
    assert len(expected) > 30
    clear = 1e-7 * SIZE  # meshes are of single precision
    assert {key for key, d in expected.items() if d > clear} <= set(told) <= set(expected)
    for key, deep in told.items():
        assert deep == pytest.approx(expected[key], abs=clear)
    assert found.energy == pytest.approx(plain.energy(free, expected), rel=1e-4)  # 2 clear / depth
    force = found.force(u.size // 3)
    axes = [free.grid.node_coordinates(axis) for axis in range(3)]
    axes[0] = np.tile(axes[0], 2)
    place = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) + u.reshape(-1, 3)
    size = np.abs(force).sum()
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-13 * size)
    moment = np.cross(place, force).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12 * SIZE * size)  # places are found to 1e-12


def rubbed(model: StaticModel, grid: np.ndarray, before: np.ndarray) -> StaticModel:
    """The model as friction holds it on the way to coefficients (planes, m) m from those `before`."""
    nodes, start = grid.reshape(-1, 3), before.reshape(-1, 3)
    begun = released(model.pairs.touched(before), start, None)
    held = holding(model.pairs.touched(grid), nodes, (begun, start))
    return replace(model, pairs=model.pairs.held_by(held))


@pytest.mark.parametrize("rough", [False, True])
def test_force_and_tangent_are_derivatives_of_the_energy(
    model: StaticModel, rng: np.random.Generator, rough: bool
) -> None:
    """By central differences of one set of pairs; with the tangent's factors what its products give is solved for again. rough: friction
    holds some, and others slide."""
    grid = pressed(model, rng)
    if rough:
        before = grid + 5e-5 * rng.standard_normal(grid.shape)
        before[model.layout.fixed] = 0.0
        model = rubbed(model, grid, before)
    energy = Energy(model)
    point = energy.at(grid)
    own = point.own
    assert len(own.point) > 30
    if rough:
        assert 5 < np.count_nonzero(own.rubs.slides) < len(own.rubs.slides) - 5
    d = 1e-6 * rng.standard_normal(grid.shape)
    energy.free(d)
    step = 1e-3  # of d: 1e-9 m
    ahead, behind = (model.pairs.touched(grid + side * step * d) for side in (1, -1))
    np.testing.assert_array_equal(ahead.pattern, behind.pattern)
    nodes = grid.size // 3
    slope = (ahead.energy - behind.energy) / (2 * step)
    assert -np.sum(own.force(nodes).reshape(grid.shape) * d) == pytest.approx(slope, rel=1e-8)
    bend = -(ahead.force(nodes) - behind.force(nodes)) / (2 * step)
    product = own.product(d.reshape(-1, 3))
    np.testing.assert_allclose(product, bend, rtol=0, atol=1e-8 * np.abs(bend).max())
    whole = energy.products(point, d[:, None])[0][:, 0]
    residual, matrix = energy.tangent(point)
    more = 2.0 * matrix.diagonal().max()
    matrix.add_diagonal(more)
    assert matrix.factor()
    solved = matrix.solve(energy.free(whole + more * d))
    np.testing.assert_allclose(solved, d, rtol=0, atol=1e-12 * np.abs(d).max())
    np.testing.assert_array_equal(residual, energy.residual(point))


def test_friction_is_equal_and_opposite_and_what_it_may_be(
    model: StaticModel, rng: np.random.Generator
) -> None:
    """Along each surface, at most 0.4 of its push, and that where it slides; what stays held goes on with no more than that."""
    grid = pressed(model, rng)
    before = np.zeros_like(grid)  # nothing touches
    own = rubbed(model, grid, before).pairs.touched(grid)
    rubs = own.rubs
    assert rubs is not None
    push = own.push * np.linalg.norm(own.normal, axis=1)
    size = np.linalg.norm(rubs.f, axis=1)
    np.testing.assert_allclose(size[rubs.slides], 0.4 * push[rubs.slides], rtol=1e-12)
    assert (size <= 0.4 * push * (1 + 1e-12)).all()
    assert np.abs(np.einsum("ti,ti->t", rubs.f, own.normal)).max() < 1e-12 * push.max()
    held = rubs.pairs
    assert HeldPairs.restored(held.state()).share is held.share
    free = released(own, grid.reshape(-1, 3), held)
    kept = free.stretch(grid.reshape(-1, 3)) - free.held.anchor
    pull = held.held.stiffness * np.linalg.norm(kept, axis=1)
    assert (pull <= 0.4 * push * (1 + 1e-9)).all()


def test_what_begins_to_touch_is_held_where_it_met(model: StaticModel) -> None:
    """Of a way of 1.6 gaps toward the other and half a gap along it, 0.6 of 1.6 are left when it touches: to 1e-6, as meshes are of single
    precision."""
    layout = model.layout
    grid = np.zeros((layout.planes, layout.nodes_per_plane, 3))
    grid[: layout.planes // 2] = [1.6 * GAP, 0.5 * GAP, 0.0]
    grid = grid.reshape(layout.planes, -1)
    grid[layout.fixed] = 0.0
    held = rubbed(model, grid, np.zeros_like(grid)).pairs.held
    assert held is not None
    stretch = held.stretch(grid.reshape(-1, 3)) - held.held.anchor
    along = 0.5 * GAP * 0.6 / 1.6 * np.where(held.held.normal[:, 0] < 0, 1.0, -1.0)
    assert len(along) > 30
    np.testing.assert_allclose(stretch[:, 1], along, rtol=0, atol=1e-6 * SIZE)


def test_nothing_passes_unseen(model: StaticModel) -> None:
    """Of a step that takes one cube through the other a share is taken that leaves it at most half a cell in; a short one is whole."""
    layout = model.layout
    way = np.zeros((layout.planes, layout.nodes_per_plane, 3))
    way[: layout.planes // 2, :, 0] = 10 * SIZE
    way = way.reshape(layout.planes, -1)
    still = np.zeros_like(way)
    share = model.pairs.clear(still, way)
    assert 0.0 < 10 * SIZE * share <= GAP + 0.5 * CELL + 1e-12
    assert model.pairs.clear(still, 0.04 * way) < 1.0
    assert model.pairs.clear(still, 1e-3 * way) == 1.0


STRIP = {
    "length": 8e-3,
    "width": 3e-3,
    "thickness": 1e-3,
    "material": "m",
    "clamp": "base",
    "segments": [{"magnetization": [1.0, 0.0, 0.0]}],
    "plane_strain": True,
}


def bent_strip(**effects: Any) -> Scene:
    field = {"uniform": [0.0, 0.0, 5e-3]}
    return resting_scene({"strip": STRIP}, {"magnetic_torque": {}, **effects}, field=field)


def test_what_touches_nothing_is_as_without(rng: np.random.Generator) -> None:
    """Energy and its slope bit for bit; the equilibrium to the solver's tolerance, for its matrix is another."""
    models = [static_model(build(bent_strip(**more))) for more in ({}, {"self_contact": {}})]
    grid = 1e-6 * rng.standard_normal((models[0].layout.planes, models[0].layout.m))
    grid[models[0].layout.fixed] = 0.0
    bare, touching = (Energy(each) for each in models)
    assert bare.at(grid).energy == touching.at(grid).energy
    np.testing.assert_array_equal(
        bare.residual(bare.at(grid)), touching.residual(touching.at(grid))
    )
    without, found = (run(bent_strip(**more)) for more in ({}, {"self_contact": {}}))
    np.testing.assert_allclose(
        found.particle_position, without.particle_position, rtol=0, atol=1e-6 * STRIP["length"]
    )
    assert found.contacts["self_contact"]["count"] == 0
    assert found.stability == pytest.approx(without.stability, rel=1e-5)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="Numba was started with one thread")
def test_the_same_bits_for_any_number_of_threads(
    model: StaticModel, rng: np.random.Generator
) -> None:
    """Energy, residual and Newton's step of pressed cubes."""
    grid = pressed(model, rng)
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, 2, 2):
            numba.set_num_threads(threads)
            energy = Energy(model)
            point = energy.at(grid)
            residual, matrix = energy.tangent(point)
            matrix.add_diagonal(matrix.diagonal().max())
            assert matrix.factor()
            found.append((point.energy, residual, matrix.solve(residual)))
    finally:
        numba.set_num_threads(before)
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_what_has_no_answer_is_refused(tmp_path: Path) -> None:
    """Parts that hang on nothing; magnetic interaction. Friction is left out with a warning, and the gap is no joint."""
    loose = cubes(tmp_path)
    with pytest.raises(
        InputError, match=r"(?s)touches no part that is held.*contact and friction alone"
    ):
        run(loose)
    resting = resting_scene(
        block((SIZE, SIZE, SIZE)), {"gravity": {}, "ground": {"point": [0, 0, 0]}}
    )
    with pytest.raises(InputError, match="body: no clamp holds it"):
        static_model(build(resting))  # before any kernel is compiled
    with pytest.raises(
        InputError, match="equilibria with self_contact can't be combined with magnetic_interaction"
    ):
        bent_strip(self_contact={}, magnetic_interaction={})
    told = bent_strip(self_contact={"friction": 0.3}).warnings()
    assert any("effects.self_contact: equilibria ignore friction" in text for text in told)
    assert not any("stay joined" in text for text in loose.warnings())
