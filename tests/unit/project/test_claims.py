"""docs/claims.yaml: its figures are on their pages, its tests exist, and `make claims` reports a figure that differs."""

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tests/benchmarks"))
    return __import__("claims")


def test_every_figure_is_on_its_page_once(claims: ModuleType) -> None:
    """Detects a page that was edited without the list, and vice versa."""
    for name, group in claims.groups().items():
        for place in claims.places(name, group):
            if place.names:
                assert all(
                    claim.value == float(claim.text.replace(" ", "")) for claim in place.claims()
                )
            else:
                assert (ROOT / place.page).read_text().count(place.text) == 1, place.text
                assert "held_by" in group, f"{place.text} holds no figure in braces"


def test_every_group_has_what_makes_it(claims: ModuleType) -> None:
    """A function and a command, or an existing test; the pages name the command that makes their figures."""
    for name, group in claims.groups().items():
        if "held_by" in group:
            path, _, test = group["held_by"].partition("::")
            assert re.search(rf"^def {test}\(", (ROOT / path).read_text(), re.MULTILINE), group[
                "held_by"
            ]
        else:
            assert callable(getattr(claims, name))
            assert group["command"].split()[0] in ("magmpm", "make", "python")
            for page in group["figures"]:
                text = (ROOT / page).read_text()
                assert group["command"] in text or "make claims" in text, (
                    f"{page} does not say how {name} is made"
                )
    assert "`make claims`" in (ROOT / "README.md").read_text()
    assert re.search(r"^claims: .*\n\t.*claims\.py", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_every_row_of_the_table_of_comparisons_is_listed(claims: ModuleType) -> None:
    """So that no new figure is forgotten."""
    page = (ROOT / "docs/accuracy.md").read_text()
    texts = [
        claims.Place.found(place).group(0) if place.names else place.text
        for name, group in claims.groups().items()
        for place in claims.places(name, group)
        if place.page == "docs/accuracy.md"
    ]
    table = (
        page.split("## What it was measured against")[1].split("\n## ")[0].partition("| --- |")[2]
    )
    rows = [row for row in table.splitlines() if re.match(r"\|.*\d.*\|", row)]
    assert rows
    for row in rows:
        assert any(line in row and len(line) > 5 for text in texts for line in text.splitlines()), (
            row
        )


def test_the_picture_of_accuracy_shows_the_figures_of_the_page(claims: ModuleType) -> None:
    from PIL import Image

    with Image.open(ROOT / claims.ACCURACY_IMAGE) as image:
        errors = json.loads(image.info["errors"])
    table = [
        c
        for place in claims.places("accuracy", claims.groups()["accuracy"])
        for c in place.claims()
        if c.name.startswith("error")
    ]
    assert len(table) == 2
    for claim in table:
        assert claim.agrees(100 * errors[claim.name.split()[1]]), claim


@pytest.mark.parametrize(
    ("text", "measured", "agrees", "written"),
    [
        ("0.089", 0.08912, True, "0.089"),
        ("0.26", 0.08912, False, "0.09"),
        ("23 328", 23328.0, True, "23 328"),
        ("0.009", 0.0094246, True, "0.009"),
        ("7e-6", 6.73e-6, True, "7e-6"),
        ("7e-6", 9.1e-6, False, "9e-6"),
        ("0.02", 0.0021, False, "0.002"),
        ("11", 12.0, True, "12"),
    ],
)
def test_what_agrees_and_what_is_written(
    claims: ModuleType, text: str, measured: float, agrees: bool, written: str
) -> None:
    claim = claims.Claim("g", "p", "n", text, 0.1)
    assert claim.agrees(measured) == agrees
    assert claim.written(measured) == written


def test_a_figure_that_differs_is_told_and_written(
    claims: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Status 1 and the line; --write updates the page, and the next run agrees; figures that agree stay unchanged."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/claims.yaml").write_text(
        'memory: {command: make bench, figures: {page.md: ["takes {now} or {peak} bytes"]}}\n'
    )
    page = tmp_path / "page.md"
    page.write_text("A body takes 500 or 1 020 bytes, more or less.\n")
    monkeypatch.setattr(claims, "memory", lambda: {"now": 949.8, "peak": 1022.0})
    assert claims.main([], tmp_path) == 1
    said = capsys.readouterr().out
    assert re.search(r"DIFFERS page.md +now +says +500 +now 949.8", said)
    assert "1 figure differs" in said
    assert claims.main(["--write"], tmp_path) == 0
    assert page.read_text() == "A body takes 950 or 1 020 bytes, more or less.\n"
    assert claims.main(["memory"], tmp_path) == 0
    assert claims.main(["weather"], tmp_path) == 2
