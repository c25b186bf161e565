"""Energy that the updated formulation loses to its grid: counted where the scene itself loses none, and told."""

from __future__ import annotations

import pytest
from reference.moving import block, moving_scene

from magmpm.dynamics.lost_energy import LostEnergy, closed
from magmpm.dynamics.time_loop import begin
from magmpm.model import build

SIZE = (6e-3, 6e-3, 3e-3)
FRAMES = [{"kinetic": 0.0, "elastic": 0.0, "gravity": 0.0}, {"kinetic": 2.0, "elastic": 3.0, "gravity": -5.0}]


@pytest.mark.parametrize(("lost", "told"), [(0.4, False), (0.6, True)])
def test_a_loss_of_more_than_a_tenth_is_told(lost: float, told: bool) -> None:
    """Of 5 J; the same after a checkpoint between two frames."""
    motion = begin(build(moving_scene(block(SIZE), {"gravity": {}}, formulation="updated"))).motion
    counted = LostEnergy()
    for frame in FRAMES:
        counted.see(motion, frame)
    counted = LostEnergy.restored(counted.state())
    counted.see(motion, {"kinetic": 1.0, "elastic": 2.0, "gravity": -3.0 - lost})
    assert bool(counted.warnings()) is told
    if told:
        assert "lost 12 % of the energy" in counted.warnings()[0]


def test_only_the_updated_formulation_is_counted() -> None:
    motion = begin(build(moving_scene(block(SIZE), {"gravity": {}}))).motion
    counted = LostEnergy()
    for frame in (*FRAMES, {"kinetic": 0.0, "elastic": 0.0, "gravity": -5.0}):
        counted.see(motion, frame)
    assert counted.warnings() == []


@pytest.mark.parametrize("effects", [{"damping": {"rate": 3.0}}, {"ground": {"point": [0.0, 0.0, 0.0]}}, {"viscosity": {"viscosity": 1.0}}])
def test_where_the_scene_takes_energy_nothing_is_counted(effects: dict[str, dict[str, object]]) -> None:
    assert closed(build(moving_scene(block(SIZE), {"gravity": {}})))
    assert not closed(build(moving_scene(block(SIZE), {"gravity": {}, **effects})))
