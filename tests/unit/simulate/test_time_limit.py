"""Runs that end by themselves when their time is over: typed, with what they have, and whole when they go on."""

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm import Scene, run
from magmpm.cli import main
from magmpm.cli import run as command
from magmpm.errors import BudgetError, InputError, TimeOver
from magmpm.results.trajectory import Motion
from magmpm.scene.time_limit import check, limited
from magmpm.solving.precompile import prepare_kernels


def ticks() -> Callable[[], float]:
    """A clock that goes on by one second whenever it is looked at."""
    return count().__next__


def test_a_limit_holds_in_its_context_alone() -> None:
    with limited(1.5, clock=ticks()):
        check()
        with pytest.raises(TimeOver, match=r"time limit of 1\.5 s reached"):
            check()
    check()
    with limited(None):
        check()


def test_of_two_limits_the_earlier_one_counts() -> None:
    for outer, inner in ((0.5, 100.0), (100.0, 0.5)):
        with (
            limited(outer, clock=ticks()),
            limited(inner, clock=ticks()),
            pytest.raises(BudgetError, match=r"0\.5 s"),
        ):
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
    assert "of the load: time limit" in caught.value.reason
    remedy, *_ = caught.value.remedies
    assert remedy.words.startswith("a weaker field")
    assert run(remedy.applied(scene)).converged


def path_scene() -> Scene:
    given = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3]).to_si()
    field = {**given["field"], "over_time": {"ramp": {"duration": 1.0}}}
    return Scene.from_si({**given, "field": field, "solver": {"quasi_static": {"steps": 12}}})


def test_equilibria_along_time_look_at_the_clock_too(tmp_path: Path) -> None:
    """They end between two of them, and go on from there to the same."""
    scene = path_scene()
    whole = run(scene, folder=tmp_path / "whole")
    looks = count()
    with limited(1e9, clock=lambda: next(looks)):
        run(scene)
    assert next(looks) > 24, "more than once for each equilibrium"
    with limited(16.0, clock=ticks()), pytest.raises(TimeOver):
        run(scene, folder=tmp_path / "broken")
    assert 0 < len(Motion.load(tmp_path / "broken")) < 13
    resumed = run(scene, folder=tmp_path / "broken", resume=True)
    np.testing.assert_array_equal(resumed.particle_position, whole.particle_position)


def test_an_equilibrium_that_needs_no_ramp_tries_none() -> None:
    """Nothing is known of its load then, and a weaker one is no remedy for too little time."""
    scene = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3])
    prepare_kernels(scene)
    with limited(1.5, clock=ticks()), pytest.raises(TimeOver) as caught:
        run(scene)
    assert caught.value.reason.startswith("time limit of 1.5 s reached")
    assert caught.value.remedies == ()


def test_an_asked_error_is_not_answered_by_what_the_time_allowed() -> None:
    data = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3]).to_si()
    scene = Scene.from_si({**data, "resolution": {"error": 0.0002}})
    run(scene)  # compiling looks at the clock as well
    looks = count()
    with limited(1e9, clock=lambda: next(looks)):
        run(scene)
    most = next(looks)
    for share in (0.3, 0.6):
        with limited(share * most, clock=ticks()), pytest.raises(TimeOver):
            run(scene)


def test_what_is_to_be_resumed_stays_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A limit ends a motion in a folder that held another one: --resume goes on with the new one, and the old one is kept meanwhile."""
    path = tmp_path / "scene.yaml"
    out = tmp_path / "out"
    path.write_text(MOVING.format(field=3, duration="2 ms"))
    assert main(["run", str(path), "--out", str(out)]) == 0
    path.write_text(MOVING.format(field=4, duration="4 ms"))
    with monkeypatch.context() as changed:
        changed.setattr(command, "limited", lambda seconds: limited(20.0, clock=ticks()))
        assert main(["run", str(path), "--out", str(out), "--time-limit", "1"]) == 3
    said = capsys.readouterr().err
    assert "`--resume` continues from its last frame" in said
    assert "earlier results are kept in" in said
    before = len(Motion.load(out))
    assert before > 1
    assert main(["run", str(path), "--out", str(out), "--resume"]) == 0
    assert len(Motion.load(out)) == 41 > before
    assert main(["run", str(path), "--out", str(tmp_path / "whole")]) == 0
    np.testing.assert_array_equal(
        Motion.load(out)[40].position, Motion.load(tmp_path / "whole")[40].position
    )
    assert main(["run", str(path), "--out", str(out), "--time-limit", "0"]) == 2
    assert "time limit: received 0 s" in capsys.readouterr().err


MOVING = """\
name: moves
materials: {{m: {{shear_modulus: 300 kPa, bulk_to_shear: 20, density: 1100 kg/m^3, remanence: 100 mT}}}}
body: {{catheter: {{length: 12 mm, diameter: 4 mm, material: m, segments: [{{magnetization: [1, 0, 0]}}]}}}}
field: {{uniform: [0 mT, 0 mT, {field} mT]}}
effects: {{magnetic_torque: {{}}}}
resolution: {{cells_across: 2}}
solver: {{dynamic: {{duration: {duration}, output_every: 0.1 ms}}}}
"""
