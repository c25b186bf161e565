"""Tables that say how a magnet stood in each row, and readings that are held out of a fit."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from test_fit import table

from magmpm import load_scene, run
from magmpm.cli import main
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.apparatus import Apparatus
from magmpm.studies.fitting import fit, read_measured, read_split
from magmpm.studies.fitting.constants import constants_of
from magmpm.studies.fitting.prediction import Axis, Prediction, tip_angle

ROOT = Path(__file__).resolve().parents[2]
PLAIN = load_scene(ROOT / "data/scenes/axial_transverse.yaml").with_cells(2)
MAGNET = {"cylinder": {"diameter": 0.02, "length": 0.02}, "position": [0.01, 0.0, 0.08], "remanence": 1.3}
COIL = {"position": [0.0, 0.0, -0.1], "diameter": 0.08, "current": 1.0}


SCENE, COILS = (
    Scene.from_si({**PLAIN.to_si(), "field": field}).with_effects(magnetic_force={})
    for field in ({"magnet": [MAGNET]}, {"coils": [COIL, {**COIL, "position": [0.0, 0.0, 0.1]}]})
)


@pytest.mark.parametrize(("columns", "cells", "apparatus"), [
    ("magnet_z_mm", "90", Apparatus((0.01, 0.0, 0.09))),  # components without a column are the scene's
    ("magnet_azimuth_deg,magnet_elevation_deg", "90,0", Apparatus(axis=pytest.approx((0.0, 1.0, 0.0), abs=1e-15))),
    ("magnet_axis_x,magnet_axis_z", "-2,0", Apparatus(axis=(-2.0, 0.0, 0.0))),
    ("inserted_mm", "30", Apparatus(inserted=0.03)),
])  # fmt: skip
def test_the_apparatus_of_a_row(columns: str, cells: str, apparatus: Apparatus, tmp_path: Path) -> None:
    (state,) = read_measured(table(tmp_path, f"repeat,{columns},tip_x_mm\n1,{cells},38\n2,{cells},39\n"), SCENE).states
    assert state.apparatus == apparatus
    assert len(state.lines) == 2, "repeats are of one state"
    (state,) = read_measured(table(tmp_path, "current_2_A,tip_x_mm\n-3,38\n"), COILS).states
    assert [coil.current for coil in state.apparatus.applied(COILS).field.coils] == [1.0, -3.0]


@pytest.mark.parametrize(("text", "words"), [
    ("magnet_z_cn,tip_x_mm\n1,1\n", 'did you mean "magnet_z_mm"'),
    ("magnet_z_mm,tip_x_mm\n5,38\n", "measured.csv:2: received field.magnet centered at (10, 0, 5) mm"),
    ("magnet_z_mm,tip_x_mm\n,38\n", "magnet_z_mm empty"),
    ("magnet_axis_x,tip_x_mm\n0,38\n", "an axis of zeros"),
    ("magnet_axis_x,magnet_azimuth_deg,tip_x_mm\n1,0,38\n", "by angles or by components"),
    ("current_A,tip_x_mm\n1,38\n", "as many coils in the scene, and it has none"),
    ("inserted_mm,tip_x_mm\n-5,38\n", "measured.csv:2"),
    ("tip_angle_deg,tip_angle_xz_deg\n1,1\n", "one angle of the tip"),
])  # fmt: skip
def test_wrong_columns(text: str, words: str, tmp_path: Path) -> None:
    """Every message names the file, what was received, a rule and a remedy."""
    with pytest.raises(InputError) as refused:
        read_measured(table(tmp_path, text), SCENE)
    for part in ("measured.csv:", words, "rule:", "remedy:"):
        assert part in str(refused.value)


@pytest.mark.parametrize(("hold_out", "words"), [("series=c", "series is one of a, b"), ("phi=1", "the columns are series")])
def test_what_is_held_out_must_be_there(hold_out: str, words: str, tmp_path: Path) -> None:
    path = table(tmp_path, "series,magnet_z_mm,tip_x_mm\na,80,1\nb,90.0,2\n")
    with pytest.raises(InputError, match=words):
        read_split([path], SCENE, hold_out)
    known, held = read_split([path], SCENE, "magnet_z_mm=90")
    assert [state.lines.tolist() for state in (*known.states, *held.states)] == [[2], [3]], "numbers are equal, however written"


def test_slopes_beside_magnets_are_those_of_the_residuals(tmp_path: Path) -> None:
    """Central differences of a signed angle and of the tip, by modulus and length too; 1e-4 of the largest: their own error."""
    text = "magnet_x_mm,magnet_z_mm,magnet_elevation_deg,tip_x_mm,tip_angle_xz_deg\n20,90,90,38,-20\n30,80,-80,,30\n"
    prediction = Prediction(SCENE, read_measured(table(tmp_path, text), SCENE), constants_of(SCENE, ["shear_modulus", "length"]))
    x = np.array([0.1, -0.03])
    slopes = prediction.at(x)[1]
    for k, step in enumerate(1e-3 * np.eye(2)):
        ends = [prediction.at(x + side * step, slopes=False)[0] for side in (1, -1)]
        np.testing.assert_allclose(slopes[:, k], (ends[0] - ends[1]) / 2e-3, atol=1e-4 * np.abs(slopes).max())


def test_a_length_that_the_rows_give_is_not_fitted(tmp_path: Path) -> None:
    measured = read_measured(table(tmp_path, "inserted_mm,tip_x_mm\n30,29\n35,33\n"), SCENE)
    with pytest.raises(InputError, match=r"(?s)received inserted_mm, and --vary segment_1_length.*rule: .*remedy: leave length out"):
        fit(measured, SCENE, vary=["shear_modulus", "length"], noise=1e-4)


def test_the_command_predicts_what_is_held_out(tmp_path: Path) -> None:
    """Exact angles of a body with another modulus: it is found, and the rows held out are met, to 1e-3 of a degree; a reading is expected
    within the noise of a degree at least."""
    rows, body = ["series,magnet_z_mm,tip_angle_xz_deg"], SCENE.with_material(shear_modulus=100e3)
    for series, z in (("a", 110.0), ("a", 90.0), ("b", 100.0), ("a", 80.0)):
        there = run(Apparatus((0.01, 0.0, 1e-3 * z)).applied(body))
        rows.append(f"{series},{z},{math.degrees(tip_angle(Axis.alone(there.centreline, there.tip), 2)[0]):.9f}")
    SCENE.save(tmp_path / "scene.yaml")
    out, names = tmp_path / "out", (str(table(tmp_path, "\n".join(rows))), str(tmp_path / "scene.yaml"))
    options = ["--quick", "--angle-noise", "1 deg", "--hold-out", "series=b", "--out", str(out)]
    assert main(["fit", *names, "--vary", "shear_modulus", *options]) == 0
    found = json.loads((out / "fit.json").read_text())
    assert found["constants"][0]["value"] == pytest.approx(100e3, rel=1e-4)
    (reading,) = found["held_out"]["readings"]
    assert abs(reading["residual"]) < math.radians(1e-3)
    assert reading["half_interval"] > math.radians(1.95)
    assert (out / "held_out.csv").read_text().splitlines()[1].startswith("4,tip_angle,")
