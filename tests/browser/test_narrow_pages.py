"""Pages on a phone, 420 px wide: nothing scrolls sideways but what is wide by itself, such as a table of many columns."""

from pathlib import Path
from typing import Any

import pytest

from magmpm.cli import main

WIDTH = 420
ROOT = Path(__file__).resolve().parents[2]
WIDER = """() => [...document.querySelectorAll("body *")]
  .filter(one => one.getBoundingClientRect().right > innerWidth + 0.5).slice(0, 8)
  .map(one => one.tagName + "." + one.className + " " + Math.round(one.getBoundingClientRect().right))"""


def narrow(browser: Any, url: str) -> Any:
    page = browser.new_page(viewport={"width": WIDTH, "height": 800})
    page.goto(url)
    page.wait_for_load_state()
    return page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of three trials whose best design is checked on finer grids: every section has a table."""
    folder = tmp_path_factory.mktemp("narrow")
    out = folder / "out"
    study = ROOT / "data/studies/s_shape.yaml"
    assert main(["design", str(study), "--trials", "3", "--out", str(out), "--json"]) == 0
    assert main(["report", str(out), "--no-pdf", "--json"]) == 0
    return out / "report.html"


def test_the_report_does_not_scroll_sideways(report: Path, browser: Any) -> None:
    page = narrow(browser, report.as_uri())
    assert page.evaluate("document.scrollingElement.scrollWidth") <= WIDTH, page.evaluate(WIDER)
    widths = page.evaluate(
        '[...document.querySelectorAll(".wide > table")].map(one =>'
        " one.getBoundingClientRect().width)"
    )
    assert len(widths) > 5
    assert max(widths) > WIDTH, "a wide table is as wide as it needs, and scrolls in its own box"
    page.close()


def test_the_viewer_does_not_scroll_sideways(view: Any, browser: Any) -> None:
    page = view(ROOT / "data/scenes/five_segments.yaml")
    page.set_viewport_size({"width": WIDTH, "height": 800})
    page.wait_for_selector("#state.solved", timeout=600_000)
    assert page.evaluate("document.scrollingElement.scrollWidth") <= WIDTH, page.evaluate(WIDER)
