"""Contact between components in the updated formulation, against the plain reference and free fall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from reference import dynamics as reference
from reference.moving import filled, follow, moving_scene
from reference.solids import box

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.effects import self_contact
from magmpm.kernels import multi_grid_contact as meeting
from magmpm.model import Model, build

G_EARTH = 9.81  # m/s^2, default of the effect


def parts(folder: Path, meshes: Sequence[tuple[Mesh, bool]], **effects: object) -> Model:
    """Solids (mm), each held or not, on cells of 1 mm."""
    listed = []
    for k, (mesh, clamp) in enumerate(meshes):
        write_stl(mesh, folder / f"{k}.stl")
        listed.append({"mesh": str(folder / f"{k}.stl"), "material": "m", "clamp": clamp})
    body = {"parts": {"unit": "mm", "spacing": 1e-3, "meshes": listed}}
    return build(moving_scene(body, {"self_contact": {}, **effects}, formulation="updated"))


def center(model: Model, values: np.ndarray, part: int) -> np.ndarray:
    """Mean of values (n, 3) over a part, by mass."""
    mass = model.density * model.particles.volume * (model.particles.segment == part)
    return np.asarray(mass @ values / mass.sum())


def gap(model: Model, x: np.ndarray) -> float:
    """As in contacts.csv, m."""
    depth = self_contact.observe(model, x)["depth"]
    assert isinstance(depth, float)
    return -depth


def test_distance_of_a_half_space_is_read_off_its_mass() -> None:
    """For any position of the surface in the grid, the table inverts the ratio, to 0.01 cells, a fiftieth of CLOSE."""
    curve = meeting.distances()
    for distance in np.linspace(-1.4, 1.45, 58):
        mass, before, after = meeting.filling(distance + np.array([0.0, -1.0, 1.0]))
        rise = 0.5 * (before - after)
        found = np.interp(meeting.share(mass, rise), np.linspace(0, 1, len(curve)), curve)
        assert found == pytest.approx(distance, abs=0.01)
        assert reference.distance(mass / rise) == pytest.approx(distance, abs=1e-3)


@pytest.mark.parametrize("held", [False, True], ids=["free", "on a held part"])
def test_a_step_is_the_reference_s(held: bool, tmp_path: Path, rng: np.random.Generator) -> None:
    """Three components, 0.05 to 0.3 cells apart, that approach, separate, and slide along each other."""
    boxes = [box((0, 0, -3), (4, 4, 0)), box((0.3, 0, 0.1), (3.3, 3, 3)), box((3.35, 0.4, 0.3), (6, 3, 3))]
    model = parts(tmp_path, [(boxes[0], held), (boxes[1], False), (boxes[2], False)])
    model = replace(model, modes=np.zeros((len(model.density), 0)))
    n, part = len(model.density), model.particles.segment
    assert len(np.unique(model.scene.body.shape.components(model.particles))) == 3
    v = np.array([[0.0, 0.0, 0.4], [0.3, 0.1, -0.2], [-0.1, 0.2, -0.4]])[part] + 0.1 * rng.standard_normal((n, 3))
    F, C = np.eye(3) + 0.02 * rng.standard_normal((n, 3, 3)), 50.0 * rng.standard_normal((n, 3, 3))
    free = ~model.held
    v[~free], F[~free], C[~free] = 0.0, np.eye(3), 0.0
    x = model.particles.position
    plain, motion = reference.Updated(model, x.copy(), v.copy(), F.copy(), C.copy(), C.copy()), UpdatedMotion(model)
    motion.place(x, v, F, C)
    motion.curve = meeting.distances(100_001)  # as exact as the reference, so that no gap is on different sides of CLOSE in the two
    alone = UpdatedMotion(model)
    alone.curve = np.full_like(alone.curve, 9.0)  # far from everything
    alone.place(x, v, F, C)
    for _ in range(3):
        plain.step(1e-6)
    for moving in (motion, alone):
        assert moving.advance(3, 1e-6, model.effects) == (3, False)
    for found, wanted in zip((*motion.particles(), motion.affine()), (plain.x, plain.v, plain.F, plain.C), strict=True):
        np.testing.assert_allclose(found[free], wanted[free], rtol=0, atol=1e-13 * np.abs(wanted).max())
    assert np.abs(alone.particles()[1] - motion.particles()[1]).max() > 0.01, "the components have met"


def test_a_part_falls_freely_from_under_another(tmp_path: Path) -> None:
    """At any initial distance, 0.1 to 1.1 cells: nothing holds it back."""
    time = 0.01
    for gap in (0.1, 0.5, 1.1):
        model = parts(tmp_path, [(box((0, 0, 0), (4, 4, 3)), True), (box((0, 0, -3 - gap), (4, 4, -gap)), False)], gravity={})
        (last,) = follow(model, [time])
        fell = center(model, model.particles.position - last.x, 1)
        assert fell[2] == pytest.approx(G_EARTH * time**2 / 2, rel=2e-3)  # a step of 40 us: the first one counts fully, 2 t / dt
        assert np.abs(fell[:2]).max() < 1e-12


def test_a_part_that_falls_on_another_rests_half_a_cell_above_it(tmp_path: Path) -> None:
    """On grid lines and off them; it stays in place, and the reported gap is that of its faces."""
    for offset in (0.0, 0.37):
        block = box((1 + offset, 1 + offset, 3.7), (5 + offset, 5 + offset, 6.7))
        model = parts(tmp_path, [(box((0, 0, 0), (7, 7, 3)), True), (block, False)], gravity={})
        *_, before, last = follow(model, [0.04, 0.06])
        x = model.particles.position
        above = 0.7e-3 + center(model, last.x - x, 1)[2]
        assert above == pytest.approx(0.5e-3, abs=0.02e-3)  # half a cell, as docs/effects.md says
        assert np.abs(center(model, last.x - before.x, 1)).max() < 1e-3 * 1e-3
        assert gap(model, last.x) == pytest.approx(above, abs=0.1e-3)


def test_parts_that_collide_keep_their_momentum_gain_no_energy_and_part(tmp_path: Path) -> None:
    """Two blocks of different size, with an off-center collision."""
    model = filled(parts(tmp_path, [(box((0, 0, 0), (3, 3, 3)), False), (box((0.6, 0.9, 3.9), (3.6, 5, 6.9)), False)]))
    motion = UpdatedMotion(model)
    n, mass = len(model.density), model.density * model.particles.volume
    v = np.outer(np.where(model.particles.segment == 0, 0.3, -0.3), [0.0, 0.0, 1.0])
    motion.place(model.particles.position, v, np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))
    momentum, energy = mass @ v, motion.kinetic_energy()
    gaps = []
    for moment in follow(model, np.arange(1, 13) * 1e-3, motion):
        np.testing.assert_allclose(mass @ moment.v, momentum, rtol=0, atol=1e-12 * 0.3 * mass.sum())
        gaps.append(gap(model, moment.x))
        assert motion.kinetic_energy() < energy
    assert min(gaps) > -0.1e-3  # a tenth of a cell
    assert min(gaps) < 0.6e-3
    assert gaps[-1] > 1e-3, "they have parted"


def test_every_pair_of_many_pieces_meets(tmp_path: Path) -> None:
    """Two towers of two cubes fall on a plate: no component passes another, and all come to rest, 0.1 to 0.65 cells apart.

    At nodes that all three share, a component between two others reacts to both.
    """
    cubes = [box((4 * i, 0, 3.7 * k), (4 * i + 3, 3, 3.7 * k + 3)) for i, k in product(range(2), repeat=2)]
    model = parts(tmp_path, [(box((-1, -1, -3.7), (8, 4, -0.7)), True), *((cube, False) for cube in cubes)], gravity={})
    assert UpdatedMotion(model).component.max() == 4
    before, last = follow(model, [0.07, 0.08])
    fell = np.array([center(model, last.x - model.particles.position, 1 + k)[2] for k in range(4)])
    lower, upper = fell.reshape(2, 2).T
    for above in (lower, upper - lower):
        assert (0.7e-3 + above).min() > 0.1e-3
        assert (0.7e-3 + above).max() < 0.65e-3
    assert np.abs(last.x - before.x).max() < 0.05e-3
