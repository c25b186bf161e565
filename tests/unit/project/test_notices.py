"""What a Python user is told besides the answer: warnings at the user's line, a log, bars of progress, a count in repr."""

import inspect
import logging
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magmpm
from magmpm.cli import main
from magmpm.results import notices
from magmpm.scene import Scene
from tests.end_to_end.small_study import finished, study_file

SHORT = {
    "name": "short",
    "materials": {
        "silicone": {
            "shear_modulus": 120e3,
            "bulk_to_shear": 20,
            "density": 1882.0,
            "remanence": 0.138,
        },
        "spare": {"shear_modulus": 120e3, "bulk_to_shear": 20},
    },
    "body": {
        "catheter": {
            "length": 24e-3,
            "diameter": 4e-3,
            "material": "silicone",
            "segments": [{"magnetization": [1, 0, 0]}],
        }
    },
    "field": {"uniform": [0.0, 0.0, 8e-3]},
    "effects": {"magnetic_torque": {}},
    "resolution": {"cells_across": 2},
}
UNUSED = "materials: spare is not used"


@pytest.fixture
def scene(request: pytest.FixtureRequest) -> Scene:
    """A scene with a warning, which Python users did not see; another one for each test, since it is told once a scene."""
    number = sum(map(ord, request.node.name)) % 997
    return magmpm.load_scene(SHORT).with_field([0.0, 0.0, 8e-3 + 1e-7 * number])


def test_a_warning_points_at_the_user_s_line_once_a_scene(scene: Scene, tmp_path: Path) -> None:
    file = scene.save(tmp_path / "short.yaml")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        line = inspect.currentframe().f_lineno + 1  # type: ignore[union-attr]
        result = magmpm.run(scene)
        magmpm.run(file)  # the same scene, by its hash
        magmpm.sensitivities(scene, ["field"])
    told = [one for one in caught if issubclass(one.category, magmpm.MagmpmWarning)]
    assert UNUSED in result.warnings
    assert sorted(str(one.message) for one in told) == sorted(result.warnings)
    assert {(one.filename, one.lineno) for one in told} == {(__file__, line)}
    with pytest.warns(magmpm.MagmpmWarning, match=UNUSED):
        magmpm.run(scene.with_field("9 mT"))


def test_the_field_of_8_tesla_in_place_of_millitesla_is_told_of() -> None:
    """The case of the issue: a catheter of 24 mm whose tip is drawn out to ten times that."""
    with pytest.warns(magmpm.MagmpmWarning) as told:
        result = magmpm.run(magmpm.load_scene(SHORT).with_field([0.0, 0.0, 8.0]))
    every = [str(one.message) for one in told]
    assert (
        "the loads (880 kPa) stretch a shear modulus of 120 kPa to more than 1.5 times" in every[0]
    )
    assert every == result.warnings
    assert any("check the units of loads" in warning for warning in result.warnings)
    assert f", {len(result.warnings)} warnings)" in repr(result)
    assert ", 1 warning)" in repr(replace(result, warnings=["one"]))
    assert "warning" not in repr(replace(result, warnings=[]))


def test_the_command_prints_its_warnings_itself(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = scene.save(tmp_path / "short.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error", magmpm.MagmpmWarning)
        assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().err.count(UNUSED) == 1


def test_begin_end_and_errors_are_logged(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    assert any(
        isinstance(handler, logging.NullHandler) for handler in logging.getLogger("magmpm").handlers
    )
    with caplog.at_level(logging.INFO, logger="magmpm"), pytest.warns(magmpm.MagmpmWarning):
        result = magmpm.run(scene)
    assert caplog.messages == ["short: begins", f"short: {result!r}"]
    caplog.clear()
    with (
        caplog.at_level(logging.ERROR, logger="magmpm"),
        pytest.raises(magmpm.SolveError),
        notices.Watched("short", None, "s", progress=False),
    ):
        raise magmpm.SolveError("it diverged")
    assert caplog.messages == ["short: it diverged"]
    assert caplog.records[0].levelno == logging.ERROR


@pytest.mark.parametrize(
    ("progress", "terminal", "switch", "shown"),
    [
        (None, True, None, True),
        (None, False, None, False),
        (None, True, "0", False),
        (False, True, None, False),
        (True, False, "0", True),
    ],
)
def test_bars_are_shown_where_someone_sees_them(
    progress: bool | None,
    terminal: bool,
    switch: str | None,
    shown: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(notices.SWITCH, raising=False)
    if switch is not None:
        monkeypatch.setenv(notices.SWITCH, switch)
    assert notices.shows_bars(progress, seen=terminal) == shown


def test_a_motion_has_a_bar_and_a_user_s_own_progress_too(
    scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    moving = Scene.from_si(
        {**scene.to_si(), "solver": {"dynamic": {"duration": 2e-3, "output_every": 1e-3}}}
    )
    times: list[float] = []
    with pytest.warns(magmpm.MagmpmWarning):
        magmpm.run(moving, progress=True, on_progress=lambda step, at: times.append(at))
    told = capsys.readouterr().err
    assert "short: " in told
    assert "| of 2.00 ms [" in told
    assert times[-1] == pytest.approx(2e-3, rel=1e-9)  # rounding of sums of steps
    magmpm.run(moving, progress=False)
    assert "short: " not in capsys.readouterr().err


def test_designs_and_fits_have_bars(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[int] = []
    out = finished(tmp_path, trials=1)
    capsys.readouterr()
    report = magmpm.design(
        study_file(tmp_path),
        folder=out,
        trials=2,
        progress=True,
        on_trial=lambda trial: seen.append(trial.number),
    )
    told = capsys.readouterr().err
    assert (seen, report.trials) == ([1], 2)
    assert "2/2" in told
    assert "best " in told
    rows = []
    for field in (2e-3, 4e-3, 6e-3):
        tip = magmpm.run(scene.with_field([0, 0, field])).tip
        rows.append(f"{1e3 * field:g},{1e3 * tip[0]:.5f},{1e3 * tip[2]:.5f}")
    (tmp_path / "tips.csv").write_text("\n".join(["field_z_mT,tip_x_mm,tip_z_mm", *rows, ""]))
    known = scene.with_material("silicone", shear_modulus="150 kPa")
    found = magmpm.fit(
        tmp_path / "tips.csv", known, vary=["shear_modulus"], thorough=False, progress=True
    )
    assert found.constants[0].value == pytest.approx(
        120e3, rel=1e-3
    )  # tips have five decimals of a mm
    assert " solves" in capsys.readouterr().err
    assert np.isfinite(found.rms_m)
