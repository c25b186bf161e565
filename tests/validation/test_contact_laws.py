"""Bodies that touch, against the laws of wedges, of impact and of stacks; parts that are near and do not touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.parts import of_part, parts_scene, throw_part
from reference.solids import ball, box, turned

from magmpm.bodies.surface_mesh import Mesh
from magmpm.dynamics import energies
from magmpm.dynamics.time_loop import begin, move
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.kernels.body_contact import DEPTH, MEMORY
from magmpm.model import build
from magmpm.scene import Scene

EARTH, CELL = 9.81, 0.5e-3


def prism(profile: list[tuple[float, float]], half: float) -> Mesh:
    """A prism along y, from -half to half (m), over four corners (x, z) m."""
    corners = np.array([(x, y, z) for y in (-half, half) for x, z in profile])
    quads = [(0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
    return Mesh(corners, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]))


@pytest.mark.slow
def test_a_block_is_pushed_up_a_wedge(tmp_path: Path) -> None:
    """Force over load is (tan a + mu) / (1 - mu tan a), to 0.5 % (NAFEMS, Benchmark tests for finite element modelling of contact, gap and
    sliding, CGS-4: 0.412371)."""
    slope, mu, lift = 0.1, 0.3, 0.02e-3
    expected = (slope + mu) / (1 - mu * slope)
    wedge = prism([(-6e-3, -3e-3), (12e-3, -3e-3), (12e-3, slope * 12e-3), (-6e-3, -slope * 6e-3)], 3e-3)
    block = prism([(0.0, lift), (4e-3, 4e-3 * slope + lift), (4e-3, 3e-3 + lift), (0.0, 3e-3 + lift)], 2e-3)
    pull = {"acceleration": [5 * EARTH * expected, 0.0, -5 * EARTH]}
    effects = {"gravity": pull, "self_contact": {"friction": mu}}
    model = build(parts_scene(tmp_path, {"wedge": wedge, "block": block}, effects, 1.3e-3, held=["wedge"]))
    motion, dt, forces = begin(model).motion, begin(model).dt, []
    throw_part(motion, int(model.component[~model.held][0]), (0.1, 0.0, 0.01))
    for _ in range(60):
        step_on(motion, round(1e-3 / dt), dt)
        forces.append(np.abs(motion.body_contacts()["self_contact: wedge, block"]["force"]))
    mean = np.mean(forces[30:], axis=0)
    assert mean[0] / mean[2] == pytest.approx(expected, rel=5e-3)


def step_on(motion: TotalMotion, steps: int, dt: float) -> None:
    """Take so many steps, however often pairs are listed."""
    while steps:
        taken, broken = motion.advance(steps, dt, motion.model.effects)
        assert taken
        assert not broken
        steps -= taken


def shifted(mesh: Mesh, by: tuple[float, float, float]) -> Mesh:
    return Mesh(mesh.vertices + np.array(by), mesh.faces)


def impact(scene: Scene, time: float) -> tuple[float, float]:
    """Depth in cells, and change of the energy, of a component 1 that falls on 0 at 2 m/s."""
    model = build(scene)
    begun, deepest = begin(model), 0.0
    motion = begun.motion
    assert motion.contact is not None
    throw_part(motion, 1, (0.0, 0.0, -2.0))
    before = motion.kinetic_energy()
    for _ in range(round(time / begun.dt)):
        step_on(motion, 1, begun.dt)
        deepest = max(deepest, float(motion.contact.meeting.memory[:-1].reshape(-1, MEMORY)[:, DEPTH].max(initial=0.0)))
    after = motion.kinetic_energy() + energies.elastic_energy(model, motion.particles()[2])
    return deepest / scene.cell, after / before - 1


def test_an_impact_of_faces_and_of_a_ball(tmp_path: Path) -> None:
    """At 2 m/s: 0.15 cells deep at most, and 0.5 % of the energy gained."""
    a = 3e-3
    faces = {"a": box((0.0, 0.0, 0.0), (a, a, a)), "b": box((0.1e-3, 0.2e-3, a + 0.02e-3), (a, a, 2 * a))}
    sheet = {"a": box((-4e-3, -4e-3, -1e-3), (4e-3, 4e-3, 0.0)), "b": ball((0.1e-3, 0.07e-3, 1.52e-3), 1.5e-3, 24)}
    for meshes in (faces, sheet):
        depth, change = impact(parts_scene(tmp_path, meshes, {"self_contact": {}}, CELL), 3e-3)
        assert depth < 0.15
        assert -0.02 < change < 0.005


def test_edges_do_not_pass_through_each_other(tmp_path: Path) -> None:
    """Two edges that cross, at 2 m/s: half a cell deep at most; no energy is gained."""
    a = 2e-3
    low = turned(box((-a, -a / 2, -a / 2), (a, a / 2, a / 2)), (1.0, 0.0, 0.0), np.pi / 4)
    high = turned(box((-a / 2, -a, -a / 2), (a / 2, a, a / 2)), (0.0, 1.0, 0.0), np.pi / 4)
    rise = a / np.sqrt(2) + 0.02e-3
    meshes = {"a": shifted(low, (0.07e-3, 0.11e-3, -rise)), "b": shifted(high, (0.0, 0.0, rise))}
    depth, change = impact(parts_scene(tmp_path, meshes, {"self_contact": {}}, CELL), 3e-3)
    assert depth < 0.5
    assert -0.02 < change < 0.005


def test_a_ball_just_above_a_held_plate_is_not_joined_to_it(tmp_path: Path) -> None:
    """A gap of 5 um, a thousandth of a cell, and boxes that overlap: the ball moves aside."""
    meshes = {"plate": box((-4e-3, -4e-3, -3e-3), (4e-3, 4e-3, 0.0)), "ball": ball((0.0, 0.0, 1.505e-3), 1.5e-3, 24)}
    scene = parts_scene(tmp_path, meshes, {"gravity": {"acceleration": [5.0, 0.0, 0.0]}}, CELL, held=["plate"], duration=0.01)
    state = move(build(scene))
    assert of_part(state.motion.model, 1, state.x - state.motion.model.particles.position)[0] == pytest.approx(0.25e-3, rel=0.02)
