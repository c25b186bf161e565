"""Scatter of a design: the linear model's moments are those of samples, the standard deviations those of the errors, studies use them."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rod_solve import STUDY, RodSensitivities, solve, write_study

from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.scene import Scene, load_scene
from magmpm.scene.addresses import written
from magmpm.scene.variables import variables
from magmpm.studies.engine.loop import run_study
from magmpm.studies.evaluate.trial import Scatter, deviations
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps, root_mean_square
from magmpm.studies.problem.study_file import Robust
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.knobs import errors_of
from magmpm.studies.search.search_space import SearchSpace

ERRORS = Robust(direction=math.radians(5), remanence=0.05, shear_modulus=0.04)
ROBUST = STUDY + "robust: {direction: 5 deg, remanence: 5 %, shear_modulus: 4 %}\n"


def named(errors: Robust, scene: Scene) -> list[str]:
    """Addresses of the numbers that have an error."""
    return list(dict.fromkeys(written(p) for change in errors_of(errors, scene) for p in change))


def differentiate(scene: Scene, of: Sequence[str]) -> RodSensitivities:
    """Central differences of the rod by every variable."""
    found = variables(scene, of)
    step = {"rad": 1e-4, "T": 1e-6, "Pa": 10.0, "m": 1e-6, "1": 1e-4}
    pairs = [
        [solve(v.changed(scene, sign * step[v.unit])).centreline[:, 1:] for sign in (1, -1)]
        for v in found
    ]
    columns = [(a - b) / (2 * step[v.unit]) for (a, b), v in zip(pairs, found, strict=True)]
    return RodSensitivities(solve(scene), found, np.stack(columns, axis=2))


@pytest.mark.parametrize("away", [0.0, 0.1, 1.0, 10.0, 1e4])
def test_moments_are_those_of_samples(away: float) -> None:
    """200 000 samples: their mean is known to 0.2 % of sigma, their sigma to 0.2 %; four of these."""
    rng = np.random.default_rng(1)
    scatter = Scatter(
        away * rng.normal(size=(9, 3)), rng.normal(size=(9, 3, 4)) * [3.0, 1.0, 0.2, 0.0]
    )
    z = rng.normal(size=(200_000, 4))
    made = scatter.gaps.reshape(-1) + z @ scatter.spread.reshape(27, 4).T
    rms = np.sqrt(np.sum(made**2, axis=1) / 9)
    mean, sigma = scatter.moments()
    assert mean == pytest.approx(rms.mean(), abs=0.01 * rms.std())
    assert sigma == pytest.approx(rms.std(), rel=0.01)
    assert scatter.measure == mean + 2 * sigma
    assert scatter.scatter**2 == pytest.approx(
        np.mean(np.sum((made - scatter.gaps.reshape(-1)) ** 2, axis=1)) / 9, rel=0.02
    )
    assert mean**2 + sigma**2 == pytest.approx(
        root_mean_square(scatter.gaps) ** 2 + scatter.scatter**2, rel=1e-12
    ), "exactly E[rms^2]"


def test_moments_in_closed_form() -> None:
    """On target with one error the rms is |z| of a normal z; with three alike at one point it is Maxwell's; without errors it is sure."""
    one = Scatter(np.zeros((1, 3)), np.array([[[2.0], [0.0], [0.0]]]))
    assert one.moments() == pytest.approx(
        (2 * math.sqrt(2 / math.pi), 2 * math.sqrt(1 - 2 / math.pi)), rel=1e-12
    )
    three = Scatter(np.zeros((1, 3)), 2.0 * np.eye(3)[None])
    assert three.moments() == pytest.approx(
        (4 * math.sqrt(2 / math.pi), 2 * math.sqrt(3 - 8 / math.pi)), rel=1e-12
    )
    sure = Scatter(np.ones((2, 3)), np.zeros((2, 3, 1)))
    assert sure.moments() == (math.sqrt(3), 0.0)
    assert Scatter(np.zeros((2, 3)), np.zeros((2, 3, 1))).moments() == (0.0, 0.0)


def test_far_from_the_target_sigma_is_that_of_the_gradient() -> None:
    """The delta method: the limit of small errors, with an error of their square."""
    rng = np.random.default_rng(2)
    g = rng.normal(size=(7, 3))
    M = rng.normal(size=(7, 3, 5))
    along = np.einsum("mi,mik->k", g, M) / (np.sqrt(7) * np.linalg.norm(g))
    for size in (1e-2, 1e-3, 1e-4, 1e-5):  # by the integral, and by the expansion
        assert Scatter(g, size * M).moments()[1] == pytest.approx(
            size * np.linalg.norm(along), rel=20 * size
        )


def test_each_error_has_its_size(tmp_path: Path) -> None:
    scene = load_scene(write_study(tmp_path).parent / "scene.yaml")
    found = variables(scene, named(ERRORS, scene))
    changes = deviations(scene, found, ERRORS)
    assert changes.shape == (3 * 5 + 2, 2 * 5 + 2)
    tilts = changes[:3, :2]
    np.testing.assert_allclose(tilts.T @ tilts, math.radians(5) ** 2 * np.eye(2), atol=1e-18)
    np.testing.assert_allclose(scene.regions()[0].magnetization @ tilts, 0.0, atol=1e-18)
    sizes = dict(zip((v.name for v in found), changes.sum(axis=1), strict=True))
    assert sizes["materials.magnetic.remanence"] == pytest.approx(0.05 * 0.138)
    assert sizes["materials.magnetic.shear_modulus"] == pytest.approx(0.04 * 120e3)
    assert named(Robust(remanence=0.1), scene) == ["materials.magnetic.remanence"]


def test_scatter_of_the_rod_is_that_of_rods_made_with_errors(tmp_path: Path) -> None:
    """400 rods: sigma is known to 1/sqrt(800), 3.5 %; first order errs by some percent at 5 degrees: 10 % in all."""
    study = load_study(write_study(tmp_path))
    scene = study.scene
    rng = np.random.default_rng(3)
    found = differentiate(scene, named(ERRORS, scene))
    sizes = deviations(scene, found.variables, ERRORS)
    expected = Scatter(
        gaps(found.result.centreline, study.target), gap_derivatives(found, study.target) @ sizes
    )
    shapes = []
    for _ in range(400):
        made = scene
        errors = sizes @ rng.normal(size=sizes.shape[1])
        for variable, error in zip(found.variables, errors, strict=True):
            made = variable.changed(
                made, error
            )  # tilts one after the other: the same to first order
        shapes.append(gaps(solve(made).centreline, study.target))
    rms = np.array([root_mean_square(shape) for shape in shapes])
    moved = math.sqrt(
        np.mean([np.mean(np.sum((shape - expected.gaps) ** 2, axis=1)) for shape in shapes])
    )
    mean, sigma = expected.moments()
    assert expected.scatter == pytest.approx(moved, rel=0.1)
    assert sigma == pytest.approx(rms.std(ddof=1), rel=0.1)
    assert mean == pytest.approx(rms.mean(), rel=0.05)


@pytest.mark.parametrize("sampler", ["random", "tpe"])
def test_a_study_judges_designs_by_mean_and_sigma(sampler: str, tmp_path: Path) -> None:
    """Its best design is that of the least measure, and the report has the rms too; it resumes to the same."""
    path = write_study(tmp_path, ROBUST.replace("random", sampler))
    study = load_study(path)
    run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out", trials=3)
    report = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out")
    once = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "once")
    assert report.measure_m == once.measure_m
    assert report.best["measure_m"] == min(report.measure_m)
    assert report.best["measure_m"] == report.best["mean_rms_m"] + 2 * report.best["sigma_rms_m"]
    assert report.best["rms_m"] == report.rms_m[report.best["number"]] < report.best["measure_m"]
    assert report.best["scatter_m"] > 0
    with pytest.raises(ValueError, match=r"sensitivities"):
        run_study(study, solve=solve, out=tmp_path / "other")


WORDS = "{direction: 5 deg, remanence: 5 %, shear_modulus: 4 %}"
ADDRESSES = """{numbers: [
  {of: 'body.catheter.segments[*].magnetization', deviation: 5 deg},
  {of: materials.magnetic.remanence, deviation: 6.9 mT},
  {of: materials.magnetic.shear_modulus, deviation: 4 %}]}"""


def scatter_of(folder: Path, robust: str) -> Scatter:
    study = load_study(write_study(folder, STUDY + f"robust: {robust}\n"))
    assert study.robust is not None
    found = differentiate(study.scene, named(study.robust, study.scene))
    changes = deviations(study.scene, found.variables, study.robust)
    apart = gaps(found.result.centreline, study.target)
    return Scatter(apart, gap_derivatives(found, study.target) @ changes)


def test_errors_by_address_are_those_of_their_words(tmp_path: Path) -> None:
    """Also where both of two tilts, a share, and a quantity of 5 % of 138 mT say it."""
    words = scatter_of(tmp_path / "words", WORDS)
    addresses = scatter_of(tmp_path / "addresses", ADDRESSES)
    assert addresses.scatter == pytest.approx(words.scatter, rel=1e-6)
    assert addresses.moments() == pytest.approx(words.moments(), rel=1e-6)


def test_numbers_of_one_error_change_together(tmp_path: Path) -> None:
    """A field whose components err by the same amount scatters along one line, of several errors along more."""
    tied = "{numbers: [{of: ['field.uniform[0]', 'field.uniform[2]'], deviation: 0.2 mT}]}"
    assert scatter_of(tmp_path / "tied", tied).spread.shape[2] == 1
    each = scatter_of(tmp_path / "each", "{numbers: [{of: 'field.uniform[*]', deviation: 0.2 mT}]}")
    assert each.spread.shape[2] == 3
    one = scatter_of(tmp_path / "one", tied).spread[:, :, 0]
    np.testing.assert_allclose(one, each.spread[:, :, 0] + each.spread[:, :, 2], rtol=1e-12)


def test_a_number_that_varies_and_errs_counts_once(tmp_path: Path) -> None:
    text = STUDY.replace(
        "  magnetization: {}\n",
        "  numbers: [{of: materials.magnetic.remanence, min: 50 mT, max: 200 mT}]\n",
    )
    study = load_study(
        write_study(tmp_path, text.replace("random", "gauss-newton") + "robust: {remanence: 5 %}\n")
    )
    space = SearchSpace.of(study)
    x = np.array([0.4])
    scene = space.scene_at(x)
    assert study.robust is not None
    found = variables(scene, [*space.sensitivities, *named(study.robust, scene)])
    assert len(found) == 1
    assert deviations(scene, found, study.robust).shape == (1, 1)


@pytest.mark.parametrize(
    ("number", "told"),
    [
        ("{of: materials.magnetic.remanense, deviation: 5 %}", "did you mean"),
        ("{of: materials.magnetic.remanence, deviation: 5 mm}", "a flux density is expected"),
        ("{of: materials.magnetic.remanence, deviation: 5}", "in the number's own unit"),
        ("{of: materials.magnetic.remanence, deviation: 60 %}", "at most 50 %"),
        ("{of: 'body.catheter.segments[0].magnetization', deviation: 5 %}", "at most 45 deg"),
        ("{of: body.catheter.length, deviation: 1 mm}", "it has no derivative"),
        ("{of: [field.uniform, 'field.uniform[2]'], deviation: 1 deg}", "is varied twice"),
    ],
)
def test_wrong_errors_by_address_are_refused(number: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"probe\.yaml:\d+: robust\.numbers") as error:
        load_study(write_study(tmp_path, STUDY + f"robust: {{numbers: [{number}]}}\n"))
    assert told in str(error.value)


def test_what_is_zero_has_no_direction_to_err_in(tmp_path: Path) -> None:
    """Segments without magnetization among all, as the word `direction` leaves them out; a field that the study alone gives."""
    scene = load_study(write_study(tmp_path, STUDY)).scene
    plain = scene.model_dump(mode="json")
    plain["body"]["catheter"]["segments"][1]["magnetization"] = [0, 0, 0]
    plain["field"]["uniform"] = [0, 0, 0]
    made = Scene.from_si(plain)
    every = {"of": "body.catheter.segments[*].magnetization", "deviation": "5 deg"}
    field = {"of": "field.uniform", "deviation": "5 deg"}
    by_address = validate(Robust, {"numbers": [every]})
    assert errors_of(by_address, made) == errors_of(Robust(direction=math.radians(5)), made)
    assert errors_of(validate(Robust, {"numbers": [field]}), made) == []
