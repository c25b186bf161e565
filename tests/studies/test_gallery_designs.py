"""Designs of the gallery: with the numbers on its pages they come out as the pages say."""

import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from magmpm.inputs.quantities import KINDS, parse_quantity
from magmpm.studies.goals import evaluate
from magmpm.studies.goals.goal_study import GoalStudy, load_goal
from magmpm.studies.search.knobs import made

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs/gallery").glob("designed_*.md"))


def rows_of(page: str) -> dict[str, str]:
    """What the page's table of measured numbers says, by its first column."""
    return dict(re.findall(r"^\| `?(.*?)`? \| (.*) \|$", page, re.MULTILINE))


def half_a_digit(number: str) -> float:
    """By how much a number may differ from what is printed of it."""
    exponent = Decimal(number).as_tuple().exponent
    assert isinstance(exponent, int)
    return 0.5 * 10.0**exponent


def figure(text: str, kind: str) -> tuple[float, float]:
    """A printed quantity and half of its last digit, SI."""
    number, unit = text.split()
    return tuple(
        parse_quantity(f"{one} {unit}", KINDS[kind]) for one in (number, half_a_digit(number))
    )  # type: ignore[return-value]


def tried(study: GoalStudy, params: dict[str, Any], folder: Path, cells: int = 0) -> list[float]:
    """The goal of a design, SI, and how far it is beyond each bound, of which shares count."""
    scene = made(study.scene, study.knobs, params)
    if cells:
        scene = scene.with_cells(cells)
    job = evaluate.Job(scene, folder, study.measures, study.path.parent)
    outcome = evaluate.tried(job)
    evaluate.forget(folder)
    assert "values" in outcome, outcome
    values, beyond = study.values(outcome["values"])
    return [*values, *beyond]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_a_design_comes_out_as_its_page_says(page: Path, tmp_path: Path) -> None:
    """As near as what is printed lets it: to half of the figure's last digit, the sum of what half of the last digit of each number of the
    design changes, and, where the page has designs that are all but the same, how far apart those are. Bounds too are kept to that."""
    text = page.read_text(encoding="utf-8")
    rows = rows_of(text)
    name = re.search(r"data/goals/(\w+)\.yaml", text)
    assert name is not None
    study = load_goal(ROOT / f"data/goals/{name[1]}.yaml")
    (goal,) = study.file.goals
    assert goal.measure.kind is not None
    printed = {key: rows[key].rpartition(" -> ")[2] for key in study.begun}
    params = {key: float(number) for key, number in printed.items()}
    found = tried(study, params, tmp_path / "run")
    off = [0.0] * len(found)
    for key, number in printed.items():
        near = tried(study, {**params, key: params[key] + half_a_digit(number)}, tmp_path / "run")
        off = [most + abs(one - its) for most, one, its in zip(off, near, found, strict=True)]
    alike = [text for title, text in rows.items() if title.startswith("designs within")]
    noise = [figure(one, goal.measure.kind)[0] for text in alike for one in text.split(", ")]
    value, digit = figure(rows[f"{goal.key} {goal.measure.name}"], goal.measure.kind)
    apart = max([value, *noise]) - min([value, *noise])
    most = digit + off[0] + apart
    assert found[0] == pytest.approx(value, abs=most)
    assert all(one <= share for one, share in zip(found[1:], off[1:], strict=True))
    begun, digit = figure(rows["the scene as it is"], goal.measure.kind)
    assert tried(study, study.begun, tmp_path / "run")[0] == pytest.approx(begun, abs=digit + apart)
    (cells,) = re.findall(r"the best on (\d+) cells across", text)
    finer, digit = figure(rows[f"the best on {cells} cells across"], goal.measure.kind)
    again = tried(study, params, tmp_path / "run", int(cells))[0]
    assert again == pytest.approx(finer, abs=digit + off[0] + apart)
