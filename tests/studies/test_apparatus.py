"""Tables that say how a magnet stood in each row, and readings that are held out of a fit."""

import json
import math
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_fit import table

from magmpm import load_scene, run
from magmpm.cli import main
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.apparatus import AXIS, POSITION, Apparatus
from magmpm.studies.fitting import Refused, fit, read_measured, read_split, search
from magmpm.studies.fitting.constants import constants_of
from magmpm.studies.fitting.identify import refuse_twins
from magmpm.studies.fitting.misfit import doubted
from magmpm.studies.fitting.prediction import Axis, Label, Prediction, tip_angle
from magmpm.studies.fitting.solve import LeastSquares, interval_of, least_squares
from magmpm.studies.fitting.table import Measurements

ROOT = Path(__file__).resolve().parents[2]
PLAIN = load_scene(ROOT / "data/scenes/axial_transverse.yaml").with_cells(2)
MAGNET = {
    "cylinder": {"diameter": 0.02, "length": 0.02},
    "position": [0.01, 0.0, 0.08],
    "remanence": 1.3,
}
COIL = {"position": [0.0, 0.0, -0.1], "diameter": 0.08, "current": 1.0}


SCENE, COILS = (
    Scene.from_si({**PLAIN.to_si(), "field": field}).with_effects(magnetic_force={})
    for field in ({"magnet": [MAGNET]}, {"coils": [COIL, {**COIL, "position": [0.0, 0.0, 0.1]}]})
)


@pytest.mark.parametrize(
    ("columns", "cells", "apparatus"),
    [
        (
            "magnet_z_mm",
            "90",
            Apparatus(((POSITION, (0.01, 0.0, 0.09)),)),
        ),  # components without a column are the scene's
        (
            "magnet_azimuth_deg,magnet_elevation_deg",
            "90,0",
            Apparatus(((AXIS, pytest.approx((0.0, 1.0, 0.0), abs=1e-15)),)),
        ),
        ("magnet_axis_x,magnet_axis_z", "-2,0", Apparatus(((AXIS, (-2.0, 0.0, 0.0)),))),
        ("inserted_mm", "30", Apparatus(inserted=0.03)),
    ],
)
def test_the_apparatus_of_a_row(
    columns: str, cells: str, apparatus: Apparatus, tmp_path: Path
) -> None:
    (state,) = read_measured(
        table(tmp_path, f"repeat,{columns},tip_x_mm\n1,{cells},38\n2,{cells},39\n"), SCENE
    ).states
    assert state.apparatus == apparatus
    assert len(state.lines) == 2, "repeats are of one state"
    (state,) = read_measured(table(tmp_path, "current_2_A,tip_x_mm\n-3,38\n"), COILS).states
    assert [coil.current for coil in state.apparatus.applied(COILS).field.coils] == [1.0, -3.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("magnet_z_cn,tip_x_mm\n1,1\n", 'did you mean "magnet_z_mm"'),
        (
            "magnet_z_mm,tip_x_mm\n5,38\n",
            "measured.csv:2: received field.magnet centered at (10, 0, 5) mm",
        ),
        ("magnet_z_mm,tip_x_mm\n,38\n", "magnet_z_mm empty"),
        ("magnet_axis_x,tip_x_mm\n0,38\n", "an axis of zeros"),
        ("magnet_axis_x,magnet_azimuth_deg,tip_x_mm\n1,0,38\n", "by angles or by components"),
        ("current_A,tip_x_mm\n1,38\n", "as many coils in the scene, and it has none"),
        ("inserted_mm,tip_x_mm\n-5,38\n", "measured.csv:2"),
        ("tip_angle_deg,tip_angle_xz_deg\n1,1\n", "one angle of the tip"),
    ],
)
def test_wrong_columns(text: str, words: str, tmp_path: Path) -> None:
    """Every message names the file, what was received, a rule and a remedy."""
    with pytest.raises(InputError) as refused:
        read_measured(table(tmp_path, text), SCENE)
    for part in ("measured.csv:", words, "rule:", "remedy:"):
        assert part in str(refused.value)


@pytest.mark.parametrize(
    ("hold_out", "words"),
    [
        ("series=d", "series is one of a, b, phi=1"),
        ("series=a,d", "no row has series = 'd'"),
        ("series=a,series=d", "no row has series = 'd'"),
        ("phi=1", "the columns are series"),
        ("series=a,b,phi=1", "some rows must remain for the fit"),
        ("series=a,", "COLUMN=VALUE"),
    ],
)
def test_what_is_held_out_must_be_there(hold_out: str, words: str, tmp_path: Path) -> None:
    """A value that stands in no row would be left out in silence: it is an error, alone and beside others."""
    path = table(tmp_path, "series,magnet_z_mm,tip_x_mm\na,80,1\nb,90.0,2\nphi=1,95,3\n")
    with pytest.raises(InputError, match=words):
        read_split([path], SCENE, hold_out)


@pytest.mark.parametrize(
    ("hold_out", "lines"),
    [
        ("magnet_z_mm=90", [3]),  # numbers are equal, however written
        ("series=a,b", [2, 3]),
        ("series=a,series=b", [2, 3]),
        ("series=a, magnet_z_mm=95", [2, 4]),
        ("series=phi=1", [4]),  # a value may have an equals sign
        ("series=a,phi=1", [2, 4]),
    ],
)
def test_every_part_of_what_is_held_out_counts(
    hold_out: str, lines: list[int], tmp_path: Path
) -> None:
    path = table(tmp_path, "series,magnet_z_mm,tip_x_mm\na,80,1\nb,90.0,2\nphi=1,95,3\nc,85,4\n")
    known, held = read_split([path], SCENE, hold_out)
    assert held is not None
    assert [line for state in held.states for line in state.lines] == lines
    assert [line for state in known.states for line in state.lines] == [
        line for line in (2, 3, 4, 5) if line not in lines
    ]


@pytest.mark.slow
def test_slopes_beside_magnets_are_those_of_the_residuals(tmp_path: Path) -> None:
    """Central differences of a signed angle and of the tip, by modulus and length too; 1e-4 of the largest: their own error."""
    text = "magnet_x_mm,magnet_z_mm,magnet_elevation_deg,tip_x_mm,tip_angle_xz_deg\n20,90,90,38,-20\n30,80,-80,,30\n"
    prediction = Prediction(
        SCENE,
        read_measured(table(tmp_path, text), SCENE),
        constants_of(SCENE, ["shear_modulus", "length"]),
    )
    x = np.array([0.1, -0.03])
    slopes = prediction.at(x)[1]
    for k, step in enumerate(1e-3 * np.eye(2)):
        ends = [prediction.at(x + side * step, slopes=False)[0] for side in (1, -1)]
        np.testing.assert_allclose(
            slopes[:, k], (ends[0] - ends[1]) / 2e-3, atol=1e-4 * np.abs(slopes).max()
        )


def test_a_length_that_the_rows_give_is_not_fitted(tmp_path: Path) -> None:
    measured = read_measured(table(tmp_path, "inserted_mm,tip_x_mm\n30,29\n35,33\n"), SCENE)
    with pytest.raises(
        InputError,
        match=(
            r"(?s)received inserted_mm, and --vary segment_1_length.*rule: .*remedy: leave"
            r" length out"
        ),
    ):
        fit(measured, SCENE, vary=["shear_modulus", "length"], noise=1e-4)


def test_the_command_predicts_what_is_held_out(tmp_path: Path) -> None:
    """Exact angles of a body with another modulus: it is found; held out rows are met to 1e-3 of a degree, expected to the noise."""
    rows = ["series,magnet_z_mm,tip_angle_xz_deg"]
    body = SCENE.with_material(shear_modulus=100e3)
    for series, z in (("a", 110.0), ("a", 90.0), ("b", 100.0), ("a", 80.0)):
        there = run(Apparatus(((POSITION, (0.01, 0.0, 1e-3 * z)),)).applied(body))
        rows.append(
            f"{series},{z},{math.degrees(tip_angle(Axis.alone(there.centreline, there.tip), 2)[0]):.9f}"
        )
    SCENE.save(tmp_path / "scene.yaml")
    out = tmp_path / "out"
    names = (str(table(tmp_path, "\n".join(rows))), str(tmp_path / "scene.yaml"))
    options = ["--quick", "--angle-noise", "1 deg", "--hold-out", "series=b", "--out", str(out)]
    assert main(["fit", *names, "--vary", "shear_modulus", *options]) == 0
    found = json.loads((out / "fit.json").read_text())
    assert found["constants"][0]["value"] == pytest.approx(100e3, rel=1e-4)
    (reading,) = found["held_out"]["readings"]
    assert abs(reading["residual"]) < math.radians(1e-3)
    assert reading["half_interval"] > math.radians(1.95)
    names, row = (line.split(",") for line in (out / "held_out.csv").read_text().splitlines()[:2])
    assert row[:2] == ["4", "tip_angle"]
    assert float(row[names.index("half_interval")]) > 0.0
    assert 0.0 < float(row[names.index("predicted")]) < 180.0


# Minima and intervals of fits on problems whose answer is known, without a simulation


def exponential(y: float) -> tuple[object, LeastSquares]:
    """One number, r = exp(x) - y: the least sum is 0 at log y, and it rises by q^2 at log(y +- q)."""

    def model(x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        return np.exp(x) - y, np.exp(x)[:, None]

    return model, least_squares(model, np.zeros(1), scale=1.0)


def test_the_profile_of_a_curved_problem() -> None:
    """Ends where exp(x) = y +- q exactly; 1 % of q is the accuracy that is sought (solve._end)."""
    model, best = exponential(4.0)
    covariance = np.linalg.inv(best.slopes.T @ best.slopes)
    found = interval_of(model, best, covariance, 0, 1.96, lambda: None)
    assert found.method == "profile"
    assert np.exp(found.low) == pytest.approx(4 - 1.96, abs=0.02 * 1.96)
    assert np.exp(found.high) == pytest.approx(4 + 1.96, abs=0.02 * 1.96)


def test_one_curved_side_takes_the_profile() -> None:
    """Residuals twice as steep below: that end is half as far."""
    best = LeastSquares(np.zeros(1), np.zeros(1), np.ones((1, 1)), 1, True)
    found = interval_of(
        lambda x, _: ((1 + (x < 0)) * x, 1.0 + (x < 0)[:, None]),
        best,
        np.ones((1, 1)),
        0,
        2.0,
        lambda: None,
    )
    assert (found.method, found.low, found.high) == (
        "profile",
        pytest.approx(-1.0, abs=0.02),
        pytest.approx(2.0, abs=0.04),
    )


def test_an_end_that_the_data_do_not_give_is_open() -> None:
    """exp(x) = 1 +- 1.96 has no lower end: the sum of squares never rises that much."""
    model, best = exponential(1.0)
    found = interval_of(
        model, best, np.linalg.inv(best.slopes.T @ best.slopes), 0, 1.96, lambda: None
    )
    assert found.low is None
    assert np.exp(found.high) == pytest.approx(2.96, abs=0.04)


def test_the_profile_of_a_linear_problem_is_the_t_interval(rng: np.random.Generator) -> None:
    A = rng.normal(size=(9, 3))
    b = rng.normal(size=9)
    best = least_squares(lambda x, slopes: (A @ x - b, A), np.zeros(3))
    np.testing.assert_allclose(best.x, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-6)
    covariance = np.linalg.inv(A.T @ A)
    found = interval_of(lambda x, slopes: (A @ x - b, A), best, covariance, 1, 2.0, lambda: None)
    assert found.method == "linear"
    assert found.high - found.low == pytest.approx(4 * np.sqrt(covariance[1, 1]), rel=1e-9)


def test_least_squares_finds_a_curved_valley() -> None:
    """Rosenbrock's function as two residuals: its minimum is (1, 1)."""

    def model(x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array(
            [[-20 * x[0], 10.0], [-1.0, 0.0]]
        )

    np.testing.assert_allclose(
        least_squares(model, np.array([-1.2, 1.0]), scale=1.0).x, [1, 1], atol=1e-4
    )


def test_a_descent_ends_where_it_comes_to_a_known_minimum() -> None:
    """A fit's further descents need not settle at what the first one found."""
    model, best = exponential(4.0)
    found = least_squares(
        model, np.zeros(1), scale=1.0, known=lambda x: bool(abs(x - best.x)[0] < 0.2)
    )
    assert found.converged
    assert found.steps < best.steps


def test_noise_from_residuals_counts_what_the_constants_took_of_the_lengths() -> None:
    """Four lengths and an angle, which has half of the one constant's leverage, leave 4 - 1/2 numbers."""
    labels = [Label(k, "", angle=k == 4) for k in range(5)]
    best = LeastSquares(
        np.zeros(1),
        np.array([1.0, -1.0, 2.0, 0.0, 9.0]),
        np.array([[1.0], [1.0], [0.0], [0.0], [2**0.5]]),
        1,
        True,
    )
    one: Any = search._Search(
        Prediction(PLAIN, Measurements(Path(), "tips", (), (), (0, 1, 2)), (), 0, labels),
        (),
        None,
        None,
        1.0,
        print,
    )
    one.prediction.measured = SimpleNamespace(angles_alone=False)
    assert one._estimated(best, search._Noise(1e-3, 1.0, False))[0].length == pytest.approx(
        1e-3 * (6 / 3.5) ** 0.5
    )


@pytest.mark.parametrize(("worse", "refused"), [(0.0, True), (3.8, True), (3.9, False)])
def test_two_answers_are_refused_where_both_are_in_the_confidence_region(
    worse: float, refused: bool
) -> None:
    """Within 1.96^2 = 3.84 of the least sum of squares."""
    constants = constants_of(PLAIN, ["shear_modulus"])
    sums = ((0.0, 0.1), (0.9, 0.1 + worse))
    one, other = (
        LeastSquares(np.array([x]), np.array([cost**0.5]), np.full((1, 1), 30.0), 5, True)
        for x, cost in sums
    )
    with pytest.raises(Refused, match="two sets of constants") if refused else nullcontext():
        refuse_twins(constants, one, [other], 1.96)
    refuse_twins(constants, one, [one], 1.96)


@pytest.mark.parametrize(
    ("probabilities", "count"), [((0.01, 0.02, 0.2), 2), ((1e-4, 1e-3, 0.01), 2), ((0.06, 0.5), 0)]
)
def test_suspects_are_doubted_below_one_in_twenty_unless_the_likeliest_is_preferred_by_as_much(
    probabilities: Any, count: int
) -> None:
    suspects: Any = [SimpleNamespace(probability=one) for one in probabilities]
    assert doubted(suspects) == suspects[:count]
