"""Energy that the updated formulation loses to its grid: counted, in any scene, and told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.moving import block, filled, moving_scene

from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.lost_energy import LostEnergy
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.model import build
from magmpm.results.file_names import ENERGIES

SIZE = (6e-3, 6e-3, 3e-3)
SWING = {"catheter": {"length": 12e-3, "diameter": 4e-3, "material": "m", "segments": [{"magnetization": [1, 0, 0]}]}}


@pytest.mark.parametrize(("lost", "told"), [(0.4, False), (0.6, True)])
@pytest.mark.parametrize("load", [{"kinetic": 5.0, "elastic": 5.0}, {"kinetic": 1.0, "elastic": 19.0}])
def test_a_loss_of_more_than_a_tenth_of_what_swings_is_told(load: dict[str, float], lost: float, told: bool) -> None:
    """Of 5 J: all the energy of motion, or a quarter of what a load that is put on at once stores at most. The same after a checkpoint."""
    counted = LostEnergy(lost, lost)
    counted.see({**load, "gravity": -10.0})
    counted = LostEnergy.restored(counted.state())
    counted.see({"kinetic": 1.0, "elastic": 2.0, "gravity": -3.5})
    assert bool(counted.warnings()) is told
    if told:
        assert "lost at least 12 % of the energy" in counted.warnings()[0]


def test_the_loss_counted_is_most_of_what_is_missing(tmp_path: Path) -> None:
    """A swing in a constant field, which neither takes nor gives energy: what is counted is missing, and is more than half of it."""
    scene = moving_scene(SWING, {"magnetic_torque": {}}, formulation="updated", duration=10e-3, field={"uniform": [0.0, 0.0, 10e-3]})
    moved = integrate(begin(build(scene)), folder=tmp_path)
    total = np.genfromtxt(tmp_path / ENERGIES, delimiter=",", names=True)["total"]
    missing = total[0] - total[-1]
    assert 0.1 * moved.lost.largest < missing
    assert 0.5 * missing < moved.lost.lost <= 1.01 * missing


def test_what_a_transfer_loses_is_that_of_the_plain_one() -> None:
    """A body that moves as a whole, straight and turning, loses nothing; one whose neighbors move against each other loses nearly all.

    Affine transfers keep linear and angular momentum and every velocity that is linear in space (Jiang et al. 2015).
    """
    motion = begin(build(moving_scene(block(SIZE), {}, formulation="updated"))).motion
    assert isinstance(motion, UpdatedMotion)
    x, _, F = motion.particles()
    turn = np.array([[0.0, -7.0, 2.0], [7.0, 0.0, -4.0], [-2.0, 4.0, 0.0]])  # 1/s
    motion.place(x, x @ turn.T + [1.0, 2.0, 3.0], F, np.tile(turn, (len(x), 1, 1)))
    assert abs(motion.lost_in_a_transfer()) <= 1e-12 * motion.kinetic_energy()
    noise = np.random.default_rng(1).choice([-1.0, 1.0], size=(len(x), 3))
    motion.place(x, noise, F, np.zeros((len(x), 3, 3)))
    assert 0.5 < motion.lost_in_a_transfer() / motion.kinetic_energy() < 1.0
    before = motion.particles()[1]
    motion.lost_in_a_transfer()
    assert np.array_equal(before, motion.particles()[1])


@pytest.mark.slow  # it compiles for most of its 40 s
def test_it_is_counted_where_the_scene_takes_energy_too_and_never_in_the_total_formulation() -> None:
    """With all effects of motion in the kernel."""
    scenes = {name: moving_scene(block(SIZE), {"gravity": {}}, formulation=name) for name in ("updated", "total")}
    updated, total = UpdatedMotion(filled(build(scenes["updated"]))), TotalMotion(filled(build(scenes["total"])))
    x, _, F = updated.particles()
    updated.place(x, np.random.default_rng(1).normal(size=x.shape), F, 0 * F)
    counted, never = LostEnergy(), LostEnergy()
    counted.passed(updated, 20)
    never.passed(total, 20)
    assert counted.lost == 10 * updated.lost_in_a_transfer() > updated.kinetic_energy()
    assert never.lost == 0.0
