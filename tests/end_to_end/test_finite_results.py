"""No result file contains a NaN or an infinity: a run that ends with one has failed, and says where."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magmpm.cli import main
from magmpm.errors import SolveError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.scene import load_scene
from magmpm.simulate import run

ROOT = Path(__file__).parents[2]
HOLLOW = ROOT / "data/scenes/hollow.yaml"


@pytest.fixture(scope="module")
def good() -> Result:
    return run(load_scene(HOLLOW).with_cells(2))


@pytest.mark.parametrize("broken", ["tip", "stable_steps", "energy", "particle_position", "section"])
def test_what_is_not_finite_is_named_and_not_saved(broken: str, good: Result, tmp_path: Path) -> None:
    values = {
        "tip": np.array([0.0, np.nan, 0.0]),
        "stable_steps": {"wave": np.inf},
        "energy": np.nan,
        "particle_position": np.full_like(good.particle_position, -np.inf),
        "section": {"area_error": np.nan},
    }
    assert good.not_finite() == []
    bad = replace(good, **{broken: values[broken]})
    assert bad.not_finite() == [broken]
    with pytest.raises(ValueError, match=broken):
        bad.save(tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_run_that_ends_in_nan_ends_with_status_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for means over a segment without particles: no result is written, and the reason names the value that is not finite."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(HOLLOW.read_text(encoding="utf-8").replace("cells_across: 4", "cells_across: 2"), encoding="utf-8")
    monkeypatch.setattr(measures, "region_means", lambda model, values: np.full((1, 3), np.nan))
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--json"]) == 3
    printed = capsys.readouterr()
    assert "not finite (in segment_center, segment_remanence)" in printed.err
    assert "remedy: " in printed.err
    assert not (tmp_path / "out" / "result.json").exists()
    if printed.out:
        json.loads(printed.out, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    with pytest.raises(SolveError, match="not finite"):
        run(load_scene(scene))
