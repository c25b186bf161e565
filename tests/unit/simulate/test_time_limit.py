"""Runs that end by themselves when their time is over: typed, with what they have, and whole when they go on."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from reference.in_motion import moving
from reference.scenes import rod_scene

from magmpm import run
from magmpm.cli import main
from magmpm.errors import BudgetError, InputError, TimeOver
from magmpm.precompile import prepare_kernels
from magmpm.results.file_names import CHECKPOINT, MOTION
from magmpm.results.trajectory import Motion
from magmpm.scene.time_limit import check, limited


def ticks() -> Callable[[], float]:
    """A clock that goes on by one second whenever it is looked at."""
    return count().__next__


def test_a_limit_holds_in_its_context_alone() -> None:
    with limited(1.5, clock=ticks()):
        check()
        with pytest.raises(TimeOver, match=r"the time is over: 1\.5 s were allowed"):
            check()
    check()
    with limited(None):
        check()


def test_of_two_limits_the_earlier_one_counts() -> None:
    for outer, inner in ((0.5, 100.0), (100.0, 0.5)):
        with limited(outer, clock=ticks()), limited(inner, clock=ticks()), pytest.raises(BudgetError, match=r"0\.5 s"):
            check()


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_no_time_is_refused(seconds: float) -> None:
    with pytest.raises(InputError, match="must be above zero"), limited(seconds):
        pass


def test_an_equilibrium_ends_with_the_share_that_was_reached() -> None:
    """Its remedies lead to less, not to smaller steps, which would take longer."""
    scene = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3], field_steps=40)
    prepare_kernels(scene)  # which looks at the clock as well
    with limited(20.0, clock=ticks()), pytest.raises(TimeOver) as caught:
        run(scene)
    state = caught.value.state
    assert not state.converged
    assert 0.0 < state.load_share < 1.0
    assert "of the load: the time is over" in caught.value.reason
    remedy, *_ = caught.value.remedies
    assert remedy.words.startswith("a weaker field")
    assert run(remedy.applied(scene)).converged


def test_a_motion_that_goes_on_is_the_unbroken_one(tmp_path: Path) -> None:
    """Bit for bit: its frames up to the limit are there, and --resume begins at the last."""
    scene = moving(rod_scene(length=8e-3), {}, duration=2e-3, output_every=1e-4)
    whole = run(scene, folder=tmp_path / "whole")
    with limited(12.0, clock=ticks()), pytest.raises(TimeOver) as caught:
        run(scene, folder=tmp_path / "broken")
    assert caught.value.state.time < scene.duration
    assert (tmp_path / "broken" / CHECKPOINT).exists()
    assert 0 < len(Motion.load(tmp_path / "broken")) < len(Motion.load(tmp_path / "whole"))
    resumed = run(scene, folder=tmp_path / "broken", resume=True)
    np.testing.assert_array_equal(resumed.particle_position, whole.particle_position)
    assert (tmp_path / "broken" / MOTION).exists()
    assert len(Motion.load(tmp_path / "broken")) == len(Motion.load(tmp_path / "whole"))


SCENE = """\
name: bends
materials: {m: {shear_modulus: 300 kPa, bulk_to_shear: 20, remanence: 100 mT}}
body: {catheter: {length: 24 mm, diameter: 4 mm, material: m, segments: [{magnetization: [1, 0, 0]}]}}
field: {uniform: [0 mT, 0 mT, 3 mT]}
effects: {magnetic_torque: {}}
resolution: {cells_across: 2}
"""


def test_the_command_ends_with_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--time-limit", "1e-9"]) == 3
    assert "the time is over: 1e-09 s were allowed" in capsys.readouterr().err
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--time-limit", "0"]) == 2
    assert "time limit: received 0 s" in capsys.readouterr().err
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--time-limit", "600"]) == 0
