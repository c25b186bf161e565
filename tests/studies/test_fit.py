"""magmpm fit: tables as people have them, slopes of residuals, intervals of known problems, and what the data can't tell."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import curve_fit

from magmpm import load_scene, run, sensitivities
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.addresses import changed, written
from magmpm.scene.variables import Variable
from magmpm.studies.fitting import (
    Refused,
    doubtful_fields,
    fit,
    prediction,
    read_measured,
    read_tables,
    residuals_table,
    shown,
    summary,
    text,
)
from magmpm.studies.fitting.constants import (
    Constant,
    applied,
    constants_of,
    diameter_of,
    with_known,
)
from magmpm.studies.fitting.identify import _fewer
from magmpm.studies.fitting.misfit import doubted
from magmpm.studies.fitting.prediction import Prediction
from magmpm.studies.fitting.solve import least_squares

ROOT = Path(__file__).resolve().parents[2]
SCENE = load_scene(ROOT / "data/scenes/axial_transverse.yaml").with_cells(2)
MATERIAL = "magnetic silicone"


def table(folder: Path, text: str) -> Path:
    path = folder / "measured.csv"
    path.write_text(text, encoding="utf-8")
    return path


def with_modulus(scene: Scene, modulus: float) -> Scene:
    data = scene.to_si()
    data["materials"][MATERIAL]["shear_modulus"] = modulus
    return Scene.from_si(data)


def tips(
    folder: Path, modulus: float = 100e3, fields: tuple[float, ...] = (2.0, 4.0), noise: float = 0.0
) -> Path:
    """Tips of the body with another modulus, mm, in fields along z, mT."""
    rng = np.random.default_rng(5)
    rows = ["field_z_mT,tip_x_mm,tip_z_mm"]
    for strength in fields:
        tip = (
            1e3 * run(with_modulus(SCENE, modulus).with_field([0, 0, 1e-3 * strength])).tip
            + rng.normal(0, noise, 3) * 1e3
        )
        rows.append(f"{strength},{tip[0]:.9f},{tip[2]:.9f}")
    return table(folder, "\n".join(rows) + "\n")


def test_units_and_columns(tmp_path: Path) -> None:
    text = "# a comment\nnote,field_x_G,field_z_T,tip_z_in,tip_angle_deg\nfirst,10,0.004,1,90\n,10,0.004,,45\nother,0,0,2,\n"
    found = read_measured(table(tmp_path, text), SCENE)
    assert (found.kind, found.numbers, len(found.states)) == ("tips", 4, 2)
    np.testing.assert_allclose(found.states[0].field, [1e-3, 0.0, 4e-3])
    np.testing.assert_allclose(found.states[0].points[:, 2], [25.4e-3, np.nan])
    np.testing.assert_allclose(found.states[0].angles, [math.pi / 2, math.pi / 4])
    assert found.states[0].lines.tolist() == [3, 4]


@pytest.mark.parametrize(
    ("column", "field"),
    [
        ("field_mT", (6e-3, 0.0, 8e-3)),  # along the scene's
        ("field_y_mT", (3e-3, 10e-3, 4e-3)),  # components without a column are the scene's
        ("s_mm", None),
    ],
)
def test_the_field_of_a_row(column: str, field: tuple[float, ...] | None, tmp_path: Path) -> None:
    scene = SCENE.with_field([3e-3, 0.0, 4e-3])
    measured = "x_mm" if column == "s_mm" else "tip_x_mm"
    (state,) = read_measured(table(tmp_path, f"{column},{measured}\n10,38\n10,39\n"), scene).states
    assert state.field == (
        None if field is None else pytest.approx(field, rel=1e-14)
    )  # to rounding
    assert len(state.lines) == 2, "one state of the body"


@pytest.mark.parametrize(("separator", "point"), [(";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_spreadsheets_separate_by_semicolons_and_tabs(
    tmp_path: Path, separator: str, point: str
) -> None:
    """With decimal commas too, as in most of Europe: the same numbers."""
    text = "field_z_mT,tip_x_mm,tip_z_mm\n2.5,38.25,-4.125\n4,,9\n"
    usual = read_measured(table(tmp_path, text), SCENE)
    other = read_measured(table(tmp_path, text.replace(",", separator).replace(".", point)), SCENE)
    for one, same in zip(usual.states, other.states, strict=True):
        assert one.field == same.field
        np.testing.assert_array_equal(one.points, same.points)


WRONG = [
    ("tip_x\n1\n", "measured.csv:1", 'add the unit: "tip_x_mm"'),
    ("tip_x_mn\n1\n", 'the column "tip_x_mn"', 'did you mean "tip_x_mm"'),
    ("tip_x_mm\nabc\n", '"abc" in tip_x_mm', "must be a finite number"),
    ("tip_x_mm\n1e5\n", "1e5 in tip_x_mm", "at most 10000"),
    ("tip_x_mm,tip_z_mm\n1\n", "measured.csv:2", "must have 2 cells"),
    ("tip_x_mm,s_mm\n1,2\n", "measured.csv:1", "not both"),
    ("s_mm,x_mm\n41,2\n", "s = 41 mm", "0 to 40 mm"),
    ("t_ms,tip_x_mm\n1,2\n", "t_ms", "no time"),
    ("tip_x_mm\n", "a header alone", "begin the file"),
    ("tip_angle_deg\n-5\n", "-5 deg", "without a sign"),
    ("field_mT,tip_x_mm\n,5\n", "field_mT empty", "can't be empty"),
    ("x_mm,z_mm\n1,\n", "measured.csv:2", "all its coordinates"),
    ("tip_x_mm,tip_x_m\n1,1\n", "tip_x_m", "appears twice"),
    ("field.unifrom[2] (mT),tip_x_mm\n1,1\n", "field.unifrom[2]", "did you mean field.uniform[2]"),
    ("field.uniform[2],tip_x_mm\n1,1\n", "field.uniform[2]", 'write, say, "field.uniform[2] (mT)"'),
    ("field.uniform[2] (mm),tip_x_mm\n1,1\n", "field.uniform[2]", "one of T, mT"),
    ("field.uniform[*] (mT),tip_x_mm\n1,1\n", "field.uniform[*]", "the address of one number"),
    ("field.uniform[2] (mT),field_z_mT,tip_x_mm\n1,1,1\n", "field_z", "appears twice"),
]


@pytest.mark.parametrize(("text", "place", "words"), WRONG)
def test_wrong_tables(tmp_path: Path, text: str, place: str, words: str) -> None:
    """Every message names the file, what was received, a rule and a remedy."""
    with pytest.raises(InputError) as refused:
        read_measured(table(tmp_path, text), SCENE)
    said = str(refused.value)
    for part in ("measured.csv", place, words, "rule:", "remedy:"):
        assert part in said, said


PLACES = "field_z_mT,s_mm,x_mm,y_mm,z_mm\n3,13,12,0.1,2\n3,40,35,,15\n"
CURVE = "field_z_mT,x_mm,z_mm\n3,10,1\n3,30,8\n3,38,16\n"
IN_SPACE = "field_z_mT,x_mm,y_mm,z_mm\n3,10,1,1\n3,30,0,8\n"
POSE = "field_z_mT,tip_x_mm,tip_z_mm,tip_angle_deg\n3,36,14,50\n"
TABLES = [PLACES, CURVE, POSE, pytest.param(IN_SPACE, marks=pytest.mark.slow)]


@pytest.mark.parametrize("text", TABLES, ids=["places", "curve", "pose", "curve in space"])
def test_slopes_are_those_of_the_residuals(tmp_path: Path, text: str) -> None:
    """Central differences of the residuals, away from the start; 2e-5 of the largest: their own error at a step of 1e-3.

    Across a curve in space there are two directions, whose turn about the curve is left out: their sum of squares has the slope it has.
    """
    measured = read_measured(table(tmp_path, text), SCENE)
    constants = constants_of(SCENE, ["shear_modulus", "remanence", "magnetization", "field"])
    prediction = Prediction(SCENE, measured, constants)
    x = np.array([0.1, -0.05, 0.2, -0.1, 0.3, 0.2, -0.4])
    residuals, slopes = prediction.at(x)
    weights = residuals[None] if text == IN_SPACE else np.eye(len(residuals))
    for k, step in enumerate(1e-3 * np.eye(len(x))):
        central = (
            prediction.at(x + step, slopes=False)[0] - prediction.at(x - step, slopes=False)[0]
        ) / 2e-3
        atol = 2e-5 * np.abs(weights @ slopes).max()
        np.testing.assert_allclose(weights @ slopes[:, k], weights @ central, rtol=0, atol=atol)


def test_constants_of_exact_tips_are_found(tmp_path: Path) -> None:
    """1e-4: the search ends 1e-3 standard errors from the minimum, and readings are not taken as more exact than 1e-6 of the length."""
    found = fit(read_measured(tips(tmp_path), SCENE), SCENE, vary=["shear_modulus"], thorough=False)
    assert found.constants[0].value == pytest.approx(100e3, rel=1e-4)
    assert found.rms_m < 1e-6 * SCENE.length


def test_further_descents_run_on_the_coarsest_grid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scene's own grid descends from their minimum alone, in at most two steps; its minimum is that of a descent on it from afar."""
    scene = SCENE.with_cells(4)
    solved = []
    measured = read_measured(tips(tmp_path, noise=1e-4), scene)
    monkeypatch.setattr(
        prediction,
        "sensitivities",
        lambda at, **k: solved.append(at.resolution.cells_across) or sensitivities(at, **k),
    )
    found = fit(measured, scene, vary=["shear_modulus"], noise=1e-4)
    assert solved == sorted(solved)
    assert solved.count(2) > 12
    assert solved.count(4) <= 2 * 3 + 2, "of the two fields, and to free the suspects"
    alone = Prediction(scene, measured, constants_of(scene, ["shear_modulus"]))
    far = least_squares(
        lambda x, slopes: tuple(1e4 * part for part in alone.at(x, slopes=slopes)),
        np.array([np.log(4.0)]),
        scale=1.0,
    )
    assert found.x == pytest.approx(
        far.x, abs=2e-3 * found.constants[0].error / found.constants[0].value
    )  # each search ends 1e-3 away


def test_tips_without_any_error_have_an_interval(tmp_path: Path) -> None:
    """Residuals of zero, as of a table that the scene itself made: readings are not taken as more exact than 1e-6 of the length."""
    measured = read_measured(tips(tmp_path, modulus=SCENE.materials[MATERIAL].shear_modulus), SCENE)
    found = fit(measured, SCENE, vary=["shear_modulus"], thorough=False)
    one = found.constants[0]
    assert one.low is not None
    assert one.high is not None
    assert one.low < one.value < one.high < 1.001 * one.low
    assert found.sigma_m == 1e-6 * SCENE.length
    assert found.warnings == ()


@pytest.mark.slow
def test_what_no_constant_moves_is_refused_without_an_error_of_measurement_too(
    tmp_path: Path,
) -> None:
    words = (
        "do not determine the magnetic silicone.s shear modulus: it can change without moving any"
        " measured number"
    )
    with pytest.raises(Refused, match=words):
        fit(
            read_measured(table(tmp_path, "field_z_mT,tip_z_mm\n0,0\n0,0\n0,0\n"), SCENE),
            SCENE,
            vary=["shear_modulus"],
            thorough=False,
        )


def test_a_constant_far_from_the_scenes_is_told(tmp_path: Path) -> None:
    """The field's unit mistaken by 20: so is the modulus."""
    path = tips(tmp_path, noise=1e-5)
    head, *rows = path.read_text().splitlines()
    wrong = [f"{20 * float(row.split(',')[0])},{row.partition(',')[2]}" for row in rows]
    found = fit(
        read_measured(table(tmp_path, "\n".join([head, *wrong]) + "\n"), SCENE),
        SCENE,
        vary=["shear_modulus"],
        thorough=False,
    )
    assert any("times the scene's: check the units" in said for said in found.warnings)


def test_fields_far_from_the_scenes_are_told_before_the_fit(tmp_path: Path) -> None:
    """Fields of 3 mT and 3000 mT beside the scene's own: a unit off by a thousand is reported, fields of the same size are not."""
    own = SCENE.with_field([0.0, 0.0, 3e-3])
    said = (
        "the table's fields reach 3000 mT, the scene's own is 3 mT: check the units of its columns"
    )
    for strength, told in ((4.0, []), (3000.0, [said])):
        assert (
            doubtful_fields(
                read_measured(table(tmp_path, f"field_z_mT,tip_z_mm\n{strength},5\n0,0\n"), own),
                own,
            )
            == told
        )


def three_tables(
    folder: Path, modulus: float, noises: tuple[float, float, float], seed: int = 3
) -> list[Path]:
    """Tips in two fields, places of the axis in one of these, and a curve in another field, of the body with a modulus; noises in mm."""
    rng = np.random.default_rng(seed)
    real = with_modulus(SCENE, modulus)
    shapes = {strength: run(real.with_field([0, 0, 1e-3 * strength])) for strength in (2.0, 4.0)}
    rows: list[list[str]] = [
        ["field_z_mT,tip_x_mm,tip_z_mm"],
        ["field_z_mT,s_mm,x_mm,z_mm"],
        ["field_z_mT,x_mm,z_mm"],
    ]
    for strength, result in shapes.items():
        tip = 1e3 * result.tip + rng.normal(0, noises[0], 3)
        rows[0].append(f"{strength},{tip[0]:.9f},{tip[2]:.9f}")
        for s, *point in 1e3 * result.centreline[4::3]:
            k = 2 if strength == 2.0 else 1
            x, _, z = np.array(point) + rng.normal(0, noises[k], 3)
            rows[k].append(
                f"{strength},{x:.9f},{z:.9f}" if k == 2 else f"{strength},{s:.9f},{x:.9f},{z:.9f}"
            )
    paths = [folder / name for name in ("tips.csv", "places.csv", "curve.csv")]
    for path, lines in zip(paths, rows, strict=True):
        path.write_text("\n".join(lines) + "\n")
    return paths


def test_tables_of_three_kinds_are_explained_together(tmp_path: Path) -> None:
    """Their residuals are those of each alone, one after the other; a field that tables share is solved once; the constant is found."""
    paths = three_tables(tmp_path, 100e3, (0.0, 0.0, 0.0))
    measured = read_tables(paths, SCENE)
    constants = constants_of(SCENE, ["shear_modulus"])
    both = Prediction(SCENE, measured, constants)
    x = np.array([0.2])
    residuals, slopes = both.at(x)
    assert both.solves == 2
    assert both.at(x)[0] is residuals, "what was solved is known"
    alone = [Prediction(SCENE, read_measured(path, SCENE), constants).at(x) for path in paths]
    np.testing.assert_allclose(
        residuals, np.concatenate([one for one, _ in alone]), rtol=0, atol=1e-9 * SCENE.length
    )
    np.testing.assert_allclose(
        slopes, np.concatenate([one for _, one in alone]), rtol=0, atol=1e-6 * np.abs(slopes).max()
    )
    assert [label.table for label in both.labels] == [
        k for k, (one, _) in enumerate(alone) for _ in one
    ]
    assert measured.numbers == len(residuals)
    found = fit(measured, SCENE, vary=["shear_modulus"], thorough=False)
    assert found.constants[0].value == pytest.approx(100e3, rel=1e-4)
    told = summary(found)
    assert [one["kind"] for one in told["tables"]] == ["tips", "places", "curve"]
    assert "tips.csv" in text(found)
    assert [panel["title"] for panel in shown(found)["panels"]] == [path.name for path in paths]
    assert residuals_table(found).splitlines()[-1].endswith(",3")


def test_each_table_counts_by_its_own_noise(tmp_path: Path) -> None:
    """The error of a constant that one number of each table tells: 1 over the root of the sum of squared slopes in standard errors."""
    paths = three_tables(tmp_path, 100e3, (0.05, 0.05, 0.8))
    measured = read_tables(paths, SCENE)
    noise = [0.05e-3, 0.05e-3, 0.8e-3]
    found = fit(measured, SCENE, vary=["shear_modulus"], noise=noise, thorough=False)
    prediction = Prediction(SCENE, measured, constants_of(SCENE, ["shear_modulus"]))
    _, slopes = prediction.at(found.x)
    sigmas = np.array([noise[label.table] for label in prediction.labels])
    error = 1 / np.linalg.norm(slopes[:, 0] / sigmas)
    one = found.constants[0]
    assert found.noise == "given"
    assert one.error / one.value == pytest.approx(error, rel=1e-3)
    assert abs(one.value - 100e3) < 4 * one.error
    assert [entry["sigma_m"] for entry in summary(found)["tables"]] == pytest.approx(noise)
    equal = fit(measured, SCENE, vary=["shear_modulus"], thorough=False)
    assert any("give each table its noise" in line for line in equal.warnings)
    assert equal.constants[0].error > 1.5 * one.error


def test_tables_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    paths = three_tables(tmp_path, 100e3, (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="the same file twice"):
        read_tables([paths[0], tmp_path / "." / paths[0].name], SCENE)
    with pytest.raises(InputError, match="one for all tables, or one for each, 3"):
        fit(read_tables(paths, SCENE), SCENE, noise=[1e-4, 1e-4])


def test_what_is_known_beforehand_widens_the_interval(tmp_path: Path) -> None:
    """A tip in a uniform field tells the ratio: with a remanence known to 5 %, the modulus is known to 5 % as well, and no better."""
    measured = read_measured(tips(tmp_path, noise=1e-5), SCENE)
    found = fit(
        measured,
        SCENE,
        vary=["shear_modulus", "remanence"],
        known={"remanence": 0.05},
        noise=1e-5,
        thorough=False,
    )
    modulus = found.constants[0]
    assert modulus.error / modulus.value == pytest.approx(0.05, rel=0.02)
    assert modulus.value == pytest.approx(100e3, rel=1e-2)
    assert abs(found.correlation[0, 1]) > 0.99


def test_modulus_and_remanence_are_not_told_apart_by_tips_in_a_uniform_field(
    tmp_path: Path,
) -> None:
    """The answer depends on their ratio alone. Refused, with the ratio's accuracy and measurements that would tell."""
    silicone = "the magnetic silicone.s"
    words = (
        f"these tips do not separate {silicone} shear modulus and {silicone} remanence: they can"
        " change together"
    )
    with pytest.raises(Refused, match=words) as refused:
        fit(read_measured(tips(tmp_path, noise=2e-4), SCENE), SCENE, thorough=False)
    assert len(refused.value.together) == 2
    assert (
        "shear_modulus_magnetic_silicone * remanence_magnetic_silicone^-1" in refused.value.known[0]
    )
    assert any("moment" in words for words in refused.value.advice)
    assert any("weight" in words for words in refused.value.advice)


def test_constants_that_are_left_to_vary_are_those_that_the_data_tell() -> None:
    """A soft tip that bears nothing: neither its modulus, which moves nothing, nor the remanence, which moves what the modulus does."""
    of = [("soft", "shear_modulus"), ("stiff", "shear_modulus"), ("Br", "remanence")]
    constants = [Constant(Variable(kind, name, "", ()), 1.0) for name, kind in of]
    assert (
        _fewer(constants, np.array([[1e-3, 50.0, -50.0], [0.0, 20.0, -20.0]]), 1.96, 2) == "stiff"
    )


def test_fewer_numbers_than_constants_are_refused(tmp_path: Path) -> None:
    measured = read_measured(table(tmp_path, "field_z_mT,tip_z_mm\n3,12\n"), SCENE)
    with pytest.raises(Refused, match="2 constants"):
        fit(measured, SCENE, vary=["shear_modulus", "remanence"])
    with pytest.raises(InputError, match="errors of measurement can't be estimated"):
        fit(measured, SCENE, vary=["shear_modulus"])


def test_unknown_constants_are_refused() -> None:
    with pytest.raises(InputError, match=r'did you mean "shear_modulus"'):
        constants_of(SCENE, ["shear_moduls"])
    with pytest.raises(InputError, match="acts in motion only"):
        constants_of(SCENE, ["damping"])


def test_turns_are_turns() -> None:
    """A quarter turn of azimuth brings +x to +y, one of elevation to +z."""
    constants = constants_of(SCENE, ["magnetization"])
    for x, expected in (([math.pi / 2, 0], [0, 1, 0]), ([0, math.pi / 2], [0, 0, 1])):
        np.testing.assert_allclose(
            applied(SCENE, constants, np.array(x)).regions()[0].magnetization, expected, atol=1e-15
        )


def missing(
    folder: Path,
    stray: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: float = 0.0,
    larger: float = 0.0,
) -> Path:
    """Tips to 0.1 mm of a body with 118 kPa that is not quite the scene's: stray field (mT), turn of its direction (rad), diameter."""
    data = with_modulus(SCENE, 118e3).to_si()
    data["body"]["catheter"]["diameter"] *= 1 + larger
    for segment in data["body"]["catheter"]["segments"]:
        segment["magnetization"] = [math.cos(turn), math.sin(turn), 0.0]
    real = Scene.from_si(data)
    rng = np.random.default_rng(5)
    rows = ["field_z_mT,tip_x_mm,tip_y_mm,tip_z_mm"]
    for strength in (1, 2, 3, 4, 5):
        tip = run(
            real.with_field([1e-3 * stray[0], 1e-3 * stray[1], 1e-3 * (strength + stray[2])])
        ).tip + rng.normal(0, 0.1e-3, 3)
        rows.append(f"{strength},{1e3 * tip[0]:.4f},{1e3 * tip[1]:.4f},{1e3 * tip[2]:.4f}")
    return table(folder, "\n".join(rows) + "\n")


@pytest.mark.parametrize(
    ("lacks", "name"),
    [
        ({"stray": (0.1, 0.17, -0.28)}, "a stray field"),  # 0.34 mT
        pytest.param(
            {"stray": (0.2, 0.34, -0.56)}, "a stray field", marks=pytest.mark.slow
        ),  # to first order the modulus is too high then
        pytest.param(
            {"turn": math.radians(6.0)}, "the direction of segment 1", marks=pytest.mark.slow
        ),
    ],
)
def test_what_the_scene_lacks_is_named_and_the_interval_holds_the_truth(
    lacks: dict[str, Any], name: str, tmp_path: Path
) -> None:
    found = fit(read_measured(missing(tmp_path, **lacks), SCENE), SCENE, vary=["shear_modulus"])
    (one,) = found.constants
    assert found.suspects[0].name == name
    assert found.suspects[0].probability < 0.01
    assert not any(np.isnan(suspect.errors).any() for suspect in doubted(found.suspects)), (
        "each was fitted, not only to first order"
    )
    assert any(
        name in warning and "explains the residuals better" in warning for warning in found.warnings
    )
    assert one.method in ("widened", "withheld")
    assert one.low is None or one.low < 118e3
    assert one.high is None or one.high > 118e3
    if "turn" in lacks:  # to first order, what a fit says that varies the direction as well
        freed = fit(
            found.measured, SCENE, vary=["shear_modulus", "magnetization"], thorough=False
        ).constants[0]
        assert found.suspects[0].errors[0] == pytest.approx(freed.error / freed.value, rel=0.04)


@pytest.mark.slow
def test_geometry_is_told_to_be_exact(tmp_path: Path) -> None:
    """A diameter 10 % larger bends by 1/1.1^2 in a field: no residual shows it, so the output says what it does to the modulus."""
    found = fit(read_measured(missing(tmp_path, larger=0.1), SCENE), SCENE, vary=["shear_modulus"])
    (one,) = found.constants
    assert one.method == "linear", "nothing else explains the residuals"
    assert one.value == pytest.approx(
        1.21 * 118e3, rel=0.02
    )  # d^4 over d^2, less the clamp's share of the length, d/L
    finer = fit(
        found.measured, SCENE.with_cells(4), vary=["shear_modulus"], thorough=False
    ).constants[0]
    assert one.grid_shift == pytest.approx(
        finer.value - one.value, rel=0.1
    )  # one Gauss-Newton step
    assert found.moves["diameter"][one.constant.name] == pytest.approx(-2.0, abs=0.1)  # likewise
    assert "1 % more diameter in the scene: shear_modulus_magnetic_silicone -2 %" in text(found)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told) -> None:
    """Files that are whole; the fitted scene gives the constant that was found; --json is one object."""
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / "scene.yaml"
    text = (ROOT / "data/scenes/axial_transverse.yaml").read_text(encoding="utf-8")
    scene.write_text(
        text.split("reference:")[0].replace("cells_across: 4", "cells_across: 2"), encoding="utf-8"
    )
    measured = tips(tmp_path, noise=1e-4)
    found = json.loads(
        told(
            "fit", measured, scene, "--vary", "shear_modulus", "--quick", "--json", "--out", "found"
        ).out
    )
    constant = found["constants"][0]
    assert constant["low"] < 100e3 < constant["high"]
    assert all(Path(name).stat().st_size > 0 for name in found["files"])
    fitted = load_scene("found/fitted_scene.yaml")
    assert fitted.materials[MATERIAL].shear_modulus == pytest.approx(constant["value"], rel=1e-9)
    turned = ("--vary", "shear_modulus", "--vary", "segment_1_elevation", "--out", "turned")
    turned = json.loads(told("fit", measured, scene, *turned, "--quick", "--json").out)
    x, _, z = load_scene("turned/fitted_scene.yaml").regions()[0].magnetization
    assert math.atan2(z, x) == pytest.approx(turned["constants"][1]["value"], abs=1e-8)
    several = [*three_tables(tmp_path, 100e3, (0.1, 0.2, 0.2)), scene, "--out", "all"]
    assert (
        "tips.csv, "
        in told(
            "fit",
            *several,
            "--vary",
            "shear_modulus",
            "--quick",
            "--noise",
            "0.1 mm, 0.2 mm, 0.2 mm",
        ).out
    )
    assert json.loads(
        told("fit", measured, scene, "--quick", "--json", "--out", "found", status=2).out
    )["measure"]
    told("fit", measured, scene, "--noise", "0.2", status=2, says="needs a unit")


@pytest.mark.slow
def test_damping_and_modulus_from_a_marker_that_swings(tmp_path: Path) -> None:
    """A motion's markers tell both: within 4 standard errors, with noise of 0.05 mm; runs of 60 ms at two cells."""
    data = SCENE.to_si()
    data["materials"][MATERIAL]["density"] = 1882.0
    data["effects"] |= {"magnetic_torque": {}, "damping": {"rate": 40.0}}
    data["solver"] = {"dynamic": {"duration": 0.06, "output_every": 1e-3}}
    data["field"]["uniform"] = [0.0, 0.0, 1.5e-3]
    start = Scene.from_si(data)
    constants = constants_of(start, ["shear_modulus", "damping"])
    truth = np.log([0.9, 1.25])
    measured = table(
        tmp_path,
        "t_ms,s_mm,x_mm,z_mm\n"
        + "".join(f"{t},{s},0,0\n" for t in range(5, 60, 5) for s in (25, 40)),
    )
    empty = read_measured(measured, start)
    shapes, _ = Prediction(start, empty, constants).at(truth, slopes=False)
    noisy = 1e3 * (shapes + np.random.default_rng(1).normal(0, 5e-5, len(shapes))).reshape(-1, 2)
    rows = [(t, s) for t in range(5, 60, 5) for s in (25, 40)]
    lines = "".join(
        f"{t},{s},{x:.6f},{z:.6f}\n" for (t, s), (x, z) in zip(rows, noisy, strict=True)
    )
    found = fit(
        read_measured(table(tmp_path, "t_ms,s_mm,x_mm,z_mm\n" + lines), start),
        start,
        vary=["shear_modulus", "damping"],
    )
    for one, true in zip(found.constants, (0.9 * 120e3, 1.25 * 40.0), strict=True):
        assert abs(one.value - true) < 4 * one.error
        assert one.error < 0.1 * true


def test_a_loss_factor_from_a_swing_takes_ten_motions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tip is exp(-tan(delta) w t / 2) cos(w t) here, in place of motions: the least squares of SciPy find the same constant and error,
    and each residual is the simulated number at the best constant less the measured one."""
    turn = 2 * np.pi * 20.0
    times = np.linspace(0, 0.2, 101)
    runs = []

    def tip_at(loss_factor: float, t: np.ndarray) -> np.ndarray:
        return 5e-3 * np.exp(-loss_factor * turn * t / 2) * np.cos(turn * t)

    def frames(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        runs.append(scene.effects.viscosity.loss_factor)
        tips = np.column_stack([0 * times, 0 * times, tip_at(runs[-1], times)])
        return times, np.zeros((len(times), 0, 4)), tips

    monkeypatch.setattr(prediction, "_frames", frames)
    data = SCENE.to_si()
    data["materials"][MATERIAL]["density"] = 1882.0
    data["effects"] |= {"viscosity": {"loss_factor": 0.2}}
    data["solver"] = {"dynamic": {"duration": 0.2, "output_every": 2e-3}}
    scene = Scene.from_si(data)
    t = np.arange(5, 200, 5) / 1e3
    z = tip_at(0.1, t) + np.random.default_rng(1).normal(0, 1e-4, len(t))
    lines = [f"{1e3 * one:g},{1e3 * height:.9f}\n" for one, height in zip(t, z, strict=True)]
    measured = read_measured(table(tmp_path, "t_ms,tip_z_mm\n" + "".join(lines)), scene)
    found = fit(measured, scene, vary=["viscosity"])
    assert len(runs) <= 12
    (one,) = found.constants
    (best,), covariance = curve_fit(lambda t, loss: tip_at(loss, t), t, z, 0.2)
    # a search along motions ends within 0.03 standard errors; slopes by differences of 1 % are right to 1e-4
    assert one.value == pytest.approx(best, abs=0.03 * one.error)
    assert one.error == pytest.approx(covariance[0, 0] ** 0.5, rel=1e-3)
    assert one.low < 0.1 < one.high
    for residual, label in zip(found.residuals, found.labels, strict=True):
        # of times between frames: a cubic spline through 25 frames a period, far from its ends
        assert residual == pytest.approx(label.simulated[0] - label.measured[0], abs=1e-12)
        assert label.simulated[0] == pytest.approx(tip_at(one.value, t[label.line - 2]), abs=2e-6)


def test_a_secant_search_ends_where_one_with_slopes_does() -> None:
    """Rosenbrock's valley, whose minimum is (1, 1), with noise-free residuals: fewer slopes than steps."""
    asked = []

    def model(x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        asked.append(slopes)
        jacobian = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), jacobian

    for secant in (False, True):
        asked.clear()
        found = least_squares(model, np.array([-0.5, 0.5]), scale=1.0, small=1e-6, secant=secant)
        assert found.converged
        np.testing.assert_allclose(found.x, 1.0, rtol=0, atol=1e-5)
        np.testing.assert_allclose(found.slopes, model(found.x, True)[1], rtol=1e-12)
    assert sum(asked) < found.steps


def test_a_suspected_diameter_changes_the_scene() -> None:
    """A descent in which it is freed must move what its slopes say moves."""
    found = applied(SCENE, diameter_of(SCENE), np.array([0.1]))
    assert found.body.shape.thickness == pytest.approx(SCENE.thickness * math.exp(0.1), rel=1e-15)


def test_constants_by_address_are_those_of_their_kind(tmp_path: Path) -> None:
    """The same number, under another name, gets the same answer to the last bit."""
    measured = read_measured(tips(tmp_path), SCENE)
    answers = [
        fit(measured, SCENE, vary=[word], noise=1e-5, thorough=False)
        for word in ("shear_modulus", f"materials.{MATERIAL}.shear_modulus")
    ]
    (one,), (other,) = (found.constants for found in answers)
    assert (one.value, one.low, one.high) == (other.value, other.low, other.high)
    assert (one.constant.name, other.constant.name) == (
        "shear_modulus_magnetic_silicone",
        f"materials.{MATERIAL}.shear_modulus",
    )


def two_materials() -> Scene:
    """Five segments; the last one is of another material."""
    scene = load_scene(ROOT / "data/scenes/five_segments.yaml").with_cells(2)
    other = {"shear_modulus": "80 kPa", "bulk_to_shear": 20.0, "remanence": "80 mT"}
    data = scene.with_material("other", **other).to_si()
    data["body"]["catheter"]["segments"][-1]["material"] = "other"
    return Scene.from_si(data)


def test_numbers_that_share_a_value_are_one_constant(tmp_path: Path) -> None:
    """Their slope is the sum of both; both addresses stand in JSON and in the table."""
    scene = two_materials()
    addresses = [f"materials.{MATERIAL}.shear_modulus", "materials.other.shear_modulus"]
    measured = read_measured(tips(tmp_path), scene)
    both = constants_of(scene, ["=".join(addresses)])
    assert len(both) == 1
    x = np.array([0.1])
    one = Prediction(scene, measured, both)
    assert {m.shear_modulus for m in applied(scene, both, x).materials.values()} == {
        both[0].value(0.1)
    }
    there = applied(scene, both, x)
    apart = Prediction(there, measured, constants_of(there, addresses)).at(np.zeros(2))[1]
    np.testing.assert_allclose(one.at(x)[1][:, 0], apart.sum(axis=1), rtol=1e-6)
    found = fit(measured, scene, vary=["=".join(addresses)], noise=1e-5, thorough=False)
    assert summary(found)["constants"][0]["address"] == "=".join(addresses)
    assert "=".join(addresses) in text(found)


@pytest.mark.parametrize("word", ["field", "magnetization", "remanence"])
def test_what_has_no_value_to_share_is_refused(word: str) -> None:
    with pytest.raises(InputError, match="what shares a value changes by factors"):
        constants_of(SCENE, [f"shear_modulus={word}"])


def test_words_are_names_of_addresses(tmp_path: Path) -> None:
    """Of a direction both angles; what is known beforehand may be said by any of the names."""
    scene = two_materials()
    by_word = constants_of(scene, ["magnetization", "shear_modulus"])
    addresses = ["body.catheter.segments[*].magnetization", "materials.other.shear_modulus"]
    by_address = constants_of(scene, addresses)
    turns = [c for c in by_word if c.kind == "magnetization"]
    assert list(by_address[:-1]) == turns
    assert turns[0].address == "body.catheter.segments[0].magnetization.azimuth"
    assert by_word[-1].address == addresses[1] == by_address[-1].name
    for name in ("shear_modulus", "shear_modulus_other", addresses[1]):
        assert with_known(by_word, {name: 0.02})[-1].known == 0.02
    every = with_known(
        constants_of(scene, ["shear_modulus"]), {"shear_modulus": 0.1, addresses[1]: 0.02}
    )
    assert [c.known for c in every] == [0.1, 0.02]


def test_a_column_may_be_an_address(tmp_path: Path) -> None:
    """Of a number that has a word it is that column; any other number is set for its row, and then is no constant to find."""
    word = read_measured(table(tmp_path, "field_z_mT,tip_x_mm\n2,38\n4,37\n"), SCENE)
    address = read_measured(table(tmp_path, "field.uniform[2] (mT),tip_x_mm\n2,38\n4,37\n"), SCENE)
    assert [s.field for s in word.states] == [s.field for s in address.states]
    column = f"materials.{MATERIAL}.remanence (mT)"
    measured = read_measured(
        table(tmp_path, f"{column},tip_x_mm,tip_z_mm\n60,39,5\n90,38,9\n"), SCENE
    )
    made = [state.apparatus.applied(SCENE).materials[MATERIAL] for state in measured.states]
    assert [material.remanence for material in made] == [0.06, 0.09]
    with pytest.raises(InputError, match="a column that sets"):
        fit(measured, SCENE, vary=["remanence"], noise=1e-4)
    found = fit(measured, SCENE, vary=["shear_modulus"], noise=1e-3, thorough=False)
    assert shown(found)["panels"][0]["x_label"] == f"materials.{MATERIAL}.remanence (SI)"


@pytest.mark.slow
def test_a_magnets_remanence_is_found_by_its_address(tmp_path: Path) -> None:
    """From tips in its field, of a scene whose number is 8 % too large; to the readings' 1e-9 mm over the slope, some 1e-6 of it."""
    scene = load_scene(ROOT / "data/scenes/pulled_by_magnet.yaml").with_cells(2)
    place = ("field", "magnet", 0, "remanence")
    rows = ["magnet_x_mm,tip_x_mm,tip_y_mm,tip_z_mm"]
    for x in (70.0, 75.0, 85.0):
        at = {place: "1.2 T", ("field", "magnet", 0, "position", 0): f"{x} mm"}
        tip = 1e3 * run(changed(scene, at)).tip
        rows.append(f"{x},{tip[0]:.9f},{tip[1]:.9f},{tip[2]:.9f}")
    measured = read_tables([table(tmp_path, "\n".join(rows))], scene)
    found = fit(measured, scene, vary=[written(place)], noise=1e-6)
    assert found.constants[0].value == pytest.approx(1.2, rel=1e-5)
    assert "field.magnet[0].remanence  " in text(found)
    assert text(found).splitlines()[2].endswith("  mT")


def test_a_number_has_one_name_and_a_name_may_have_a_dot(tmp_path: Path) -> None:
    """Of a material whose name has one; its own name comes before any address."""
    measured = read_measured(tips(tmp_path), SCENE)
    both = ["shear_modulus", f"materials.{MATERIAL}.shear_modulus"]
    with pytest.raises(InputError, match="two names"):
        fit(measured, SCENE, vary=both, noise=1e-4)
    dotted = SCENE.with_material("mix 0.5", shear_modulus="50 kPa", bulk_to_shear=20.0).to_si()
    dotted["body"]["catheter"]["material"] = "mix 0.5"
    (one,) = constants_of(Scene.from_si(dotted), ["shear_modulus_mix_0.5"])
    assert one.start == 50e3


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("field.magnet[0].remanense", "did you mean field.magnet[0].remanence"),
        ("body.catheter.segments[0].magnetization[0]", "turns by two angles"),
        ("field.magnet[0].position[1]", "it is 0 in the scene"),
        ("field.magnet[0].position[0]", "a column that sets field.magnet[0].position[0]"),
        ("body.catheter.diameter", "it has no derivative"),
    ],
)
def test_addresses_that_no_fit_can_find(address: str, told: str, tmp_path: Path) -> None:
    """Those of the scene's file that a table's columns set, too."""
    scene = load_scene(ROOT / "data/scenes/pulled_by_magnet.yaml").with_cells(2)
    rows = "magnet_x_mm,tip_x_mm,tip_z_mm\n70,35,5\n80,36,4\n"
    measured = read_tables([table(tmp_path, rows)], scene)
    with pytest.raises(InputError, match="--vary") as error:
        fit(measured, scene, vary=[address], noise=1e-4)
    assert told in str(error.value)
