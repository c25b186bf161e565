"""Errors of `magmpm accuracy` are relative to the length, and refer to the finest cells or to the reference."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rod_solve import RodResult, solve, write_study

from magmpm.cli import main
from magmpm.errors import SolveError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.scene import Scene, load_scene
from magmpm.studies.explore.accuracy import Solve, climb


def off(scene: Scene) -> RodResult:
    """The result of a rod with an error of 0.16 mm over the squared number of cells; no time."""
    found = solve(scene)
    cells = scene.resolution.cells_across
    found.centreline[:, 3] += 0.16e-3 / cells**2 * found.centreline[:, 0] / 40e-3
    found.__dict__.update(seconds={}, particles=8 * cells**3, dof=3 * cells**3)
    return found


def test_errors_are_shares_of_the_length(tmp_path: Path) -> None:
    """40 mm: an error of 0.04 mm at 2 cells, 0.01 at 4; relative to the thickness of 4 mm they would be ten times as large."""
    write_study(tmp_path)
    scene = load_scene(tmp_path / "scene.yaml")
    shape = solve(scene).centreline
    ladder = climb(scene, off, (2, 4))
    assert ladder.length == 40e-3
    assert [rung.error_finest for rung in ladder.rungs] == [pytest.approx((0.04e-3 - 0.01e-3) / 40e-3, rel=1e-6), None]
    assert [rung.error_reference for rung in ladder.rungs] == [None, None]
    assert ladder.rungs[0].cell_size == 2e-3
    # 0.03 mm apart, at the slowest order 1.5 and with a safety of 1.25; the finer one has 2^-1.5 of that
    bar = 1.25 * 0.03 / 40 / (1 - 2**-1.5)
    assert [rung.bar for rung in ladder.rungs] == [pytest.approx(bar, rel=1e-6), pytest.approx(bar * 2**-1.5, rel=1e-6)]
    rod, more, places = ladder.beside
    assert 0.0 < rod.error_finest < 6e-4  # the finest is a rod itself, 0.01 mm off at the tip; the rows between stations are another 2e-4
    assert rod.error_reference is None
    assert more.error_finest < 1e-12
    assert places.name == "3 other places of the grid, at 4 cells, the worst"
    assert 1e-4 < places.error_finest < 0.02  # solved in truth: a rod is off by 0.7 % here
    assert ladder.conclusions[-1].startswith("The rod would do for 1 % and for 0.1 %")
    assert "0.1 % of the length costs" in ladder.conclusions[1]

    write_centreline(tmp_path / "reference.csv", shape)
    text = (tmp_path / "scene.yaml").read_text() + "reference: {centreline: reference.csv}\n"
    (tmp_path / "scene.yaml").write_text(text)
    ladder = climb(load_scene(tmp_path / "scene.yaml"), off, (2, 4))
    rows = 1e-4  # the table has few digits: 4e-9 m of the smallest error
    np.testing.assert_allclose([rung.error_reference for rung in ladder.rungs], [1e-3, 0.25e-3], rtol=10 * rows)
    assert ladder.order_reference == pytest.approx(2.0, abs=0.01)


def test_bodies_of_parts_are_compared_by_the_centers_of_these() -> None:
    """Centers 0.8 mm off over the squared number of cells: at 2 cells 0.15 mm farther than at 4."""
    scene = load_scene(Path(__file__).parents[2] / "data/scenes/gallery/gripper.yaml")

    assert scene.cell == 0.5e-3, "the file gives a spacing"
    assert [scene.with_cells(n).cell for n in (2, 4)] == [scene.thickness / n for n in (2, 4)]

    def centers(scene: Scene) -> RodResult:
        cells = scene.resolution.cells_across
        found = RodResult(scene.to_si(), np.zeros((0, 4)))
        places = np.arange(42.0).reshape(14, 3) * 1e-3
        places[3, 1] += 0.8e-3 / cells**2
        found.__dict__.update(segment_center=places, seconds={}, particles=cells, dof=cells)
        return found

    ladder = climb(scene, centers, (2, 4))
    assert ladder.rungs[0].error_finest == pytest.approx(0.15e-3 / scene.length, rel=1e-9)
    assert ladder.beside == []
    assert ladder.algebraic_error is None


def failing(*cells: int) -> Solve:
    """A solver that finds no answer with so many cells across."""

    def solve_or_fail(scene: Scene) -> RodResult:
        if scene.resolution.cells_across in cells:
            raise SolveError(f"nothing at {scene.resolution.cells_across}")
        return off(scene)

    return solve_or_fail


def test_cells_that_find_no_answer_are_named_and_the_others_kept(tmp_path: Path) -> None:
    write_study(tmp_path)
    scene = load_scene(tmp_path / "scene.yaml")
    whole, ladder = climb(scene, off, (2, 5)), climb(scene, failing(3), (2, 3, 5))
    assert [rung.cells_across for rung in ladder.rungs] == [2, 5]
    assert [rung.error_finest for rung in ladder.rungs] == [rung.error_finest for rung in whole.rungs]
    assert ladder.failed == {"3 cells across": "nothing at 3"}
    assert "3 cells across failed: nothing at 3" in ladder.table()

    more = climb(scene, failing(4), (2, 5))  # what is compared beside the ladder has 4
    assert [name.partition(",")[0] for name in more.failed] == ["3 particles a cell along each direction"]
    assert more.beside[0].name == "rod"

    alone = climb(scene, failing(3, 5), (2, 3, 5))
    assert alone.conclusions == ["Nothing can be told of the error: 2 cells across alone were solved."]
    with pytest.raises(SolveError, match="nothing at 2"):
        climb(scene, failing(2, 3, 5), (2, 3, 5))


def test_one_size_alone_ends_with_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Solved grids are kept."""
    write_study(tmp_path)
    monkeypatch.setattr("magmpm.simulate.run", failing(3))
    assert main(["accuracy", str(tmp_path / "scene.yaml"), "--cells", "2,3", "--out", str(tmp_path / "ladder"), "--json"]) == 3
    told = json.loads(capsys.readouterr().out)
    kept = json.loads((tmp_path / "ladder/accuracy.json").read_text())
    assert told["failed"] == kept["failed"] == {"3 cells across": "nothing at 3"}
    assert len(kept["rungs"]) == 1
    assert not (tmp_path / "ladder/accuracy.png").exists(), "there is no error to be drawn"


def test_along_a_path_it_is_told_what_the_errors_are_of(tmp_path: Path) -> None:
    """Its end: `run`, asked for an error, judges the whole path, and may need finer cells."""
    write_study(tmp_path)
    data = load_scene(tmp_path / "scene.yaml").to_si()
    field = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    ladder = climb(Scene.from_si({**data, "field": field, "solver": {"quasi_static": {"steps": 4}}}), off, (2, 5))
    assert "of the path's end" in ladder.conclusions[-1]
    assert not any("of the path's end" in said for said in climb(load_scene(tmp_path / "scene.yaml"), off, (2, 5)).conclusions)
