"""`magmpm report`: the page of a study tells what is in its folder, holds all it shows, and can't be broken by names."""

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_study import finished, study_file

import magmpm
from magmpm.cli import main
from magmpm.results.result import Result


class Page(HTMLParser):
    """Files that a page loads and runs, its text, and whether its elements are closed in order."""

    VOID = frozenset({"meta", "img", "br", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.tags: set[str] = set()
        self.words = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.loads += [
            value or ""
            for name, value in attributes
            if name in ("src", "href", "srcset", "data", "action", "poster")
        ]
        assert not any(name.startswith("on") for name, _ in attributes)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words += data + " "


def reported(folder: Path, *options: str) -> tuple[Page, dict[str, Any]]:
    assert main(["report", str(folder), "--no-pdf", *options]) == 0
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert all(link.startswith("data:") for link in page.loads)
    assert not {"script", "link", "iframe", "object", "embed", "form", "base"} & page.tags
    return page, json.loads((folder / "study.json").read_text())


def test_a_page_of_a_study_has_what_a_workshop_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every number of the sheet against the design's own files; tolerances against a solve with that error."""
    folder = finished(tmp_path, trials=5)
    page, report = reported(folder)
    design = json.loads((folder / "best/design.json").read_text())
    first, plain, last = design["magnetization"]
    for x, y, z in (first, last):
        assert f"({x:>7.4f}, {y:>7.4f}, {z:>7.4f})" in page.words
    assert not any(plain)
    assert "not magnetized" in page.words
    assert f"trial {report['best']['number']}" in page.words
    assert f"magmpm design {Path(report['study_file']).name}" in page.words
    for heading in (
        "ready to make",
        "How exactly",
        "How accurate",
        "Which parameters",
        "Settings and versions",
        "How to cite",
    ):
        assert heading in page.words
    assert "seed" in page.words
    assert "svg" in page.tags
    scene = magmpm.load_scene(folder / "best/scene.yaml")
    best = Result.load(folder / "best")
    told = re.search(r"strength of field \S+ mm per % (\S+) %", page.words)
    assert told, page.words
    percent = float(told[1])
    stronger = magmpm.run(scene.with_field(np.array(scene.field.uniform) * (1 + 0.01 * percent)))
    moved = float(np.linalg.norm(stronger.tip - best.tip))
    assert moved == pytest.approx(
        0.01 * scene.length, rel=0.15
    )  # two digits are shown, and the shape is not linear in the field
    finer = re.search(
        r"rms from the target (\S+) mm on the study's grid, (\S+) mm on the finer", page.words
    )
    assert finer
    assert float(finer[1]) == pytest.approx(1e3 * report["best"]["rms_m"], rel=1e-3)
    assert "2 cells across" in page.words
    assert "4 cells across" in page.words


def test_a_study_without_a_feasible_design_says_so(tmp_path: Path) -> None:

    def fails(*_: Any, **__: Any) -> None:
        raise magmpm.SolveError("fell apart")

    page, _ = reported(finished(tmp_path, trials=2, solve=fails))
    assert "no feasible design" in page.words
    assert "2 trials, of which 2 failed" in page.words
    assert "fell apart" in page.words
    assert "ready to make" not in page.words


def test_a_study_whose_designs_are_all_refused_says_why(tmp_path: Path) -> None:
    """Solved, but each nearer to a critical load than its margin: no sheet, and what was refused is told."""

    def about_to_snap(*arguments: Any, **options: Any) -> Result:
        return dataclasses.replace(magmpm.run(*arguments, **options), stability=0.05)

    page, report = reported(
        finished(tmp_path, trials=3, solve=about_to_snap, more="stability: {margin: 0.1}\n")
    )
    assert report["best"] is None
    assert report["refused"] == 3
    assert "no feasible design" in page.words
    assert (
        "3 trials, of which 0 failed, 3 were refused as less stable than the margin" in page.words
    )
    assert "stability 0.05 is below the margin, 0.1" in page.words
    assert "ready to make" not in page.words


def test_names_cannot_break_a_page(tmp_path: Path) -> None:
    """A material named like a tag, in a scene of that name; the page's elements stay in order and nothing runs."""
    folder = finished(tmp_path, trials=1, material="</td><script>alert(1)</script>&amp;")
    page, _ = reported(folder, "--quick")
    assert "</td><script>alert(1)</script>&amp;" in page.words
    assert "Not asked for (--quick)" in page.words


def test_a_study_whose_database_is_gone_still_has_a_page(tmp_path: Path) -> None:
    folder = finished(tmp_path, trials=1)
    for left in folder.glob("study.db*"):
        left.unlink()
    page, _ = reported(folder, "--quick")
    assert "could not be read" in page.words
    assert "ready to make" in page.words


def test_a_study_file_that_has_changed_is_not_shown_as_this_study(tmp_path: Path) -> None:
    folder = finished(tmp_path, trials=1)
    path = study_file(tmp_path)
    path.write_text(path.read_text().replace("seed: 3", "seed: 4"))
    page, _ = reported(folder, "--quick")
    assert "has changed since" in page.words
    assert "The definition of the study as stored" in page.words


def test_a_folder_without_a_study_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path)]) == 2
    assert "holds no study" in capsys.readouterr().err


def test_a_page_that_cannot_be_printed_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from magmpm.viz.sheet import PrintError, printed

    monkeypatch.setitem(__import__("sys").modules, "weasyprint", None)
    with pytest.raises(PrintError, match=r"WeasyPrint is not at hand.*magmpm\[report\]"):
        printed("<p>page</p>", tmp_path / "page.pdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_page_is_printed_where_a_printer_is(tmp_path: Path) -> None:
    """By WeasyPrint; skipped where it is not: pip install 'magmpm[report]'."""
    from magmpm.viz.sheet import printed

    pytest.importorskip("weasyprint", reason="no printer here: pip install 'magmpm[report]'")
    folder = finished(tmp_path, trials=2)
    reported(folder, "--quick")
    by = printed((folder / "report.html").read_text(encoding="utf-8"), tmp_path / "page.pdf")
    content = (tmp_path / "page.pdf").read_bytes()
    assert by
    assert content.startswith(b"%PDF")
    assert len(content) > 10_000
