"""`magmpm dashboard` in a real browser: numbers in mm, notes, pictures, downloads, and failed and refused trials as such."""

import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("optuna_dashboard", reason="an extra: pip install -e '.[dashboard]'")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "studies")]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of six trials with pictures: trial 2 could not be solved, trial 4 is refused by the margin."""
    from rod_solve import SCENE, STUDY, solve, write_study

    from magmpm.cli.design import TrialPicture
    from magmpm.errors import SolveError
    from magmpm.scene import Scene
    from magmpm.simulate import run
    from magmpm.studies.engine.loop import run_study
    from magmpm.studies.search.definition import load_study

    folder = tmp_path_factory.mktemp("study")
    study = load_study(
        write_study(
            folder,
            STUDY + "stability: {margin: 0.1}\n",
            SCENE.replace("cells_across: 4", "cells_across: 2"),
        )
    )
    calls: list[Scene] = []

    def sometimes(scene: Scene, **options: Any) -> Any:
        calls.append(scene)
        if len(calls) == 3:
            raise SolveError("the body <b>folded</b> over")
        if len(calls) == 5:
            found = solve(scene)
            found.stability = 0.01
            return found
        return run(scene)

    run_study(
        study,
        solve=sometimes,
        picture=TrialPicture(study, smooth=False),
        out=folder / "out",
        trials=6,
    )
    return folder / "out"


@pytest.fixture(scope="module")
def served(out: Path) -> Iterator[Any]:
    from dashboard_client import dashboard

    with dashboard(out) as running:
        yield running


@pytest.fixture(scope="module")
def page(served: Any, browser: Any) -> Iterator[Any]:
    """A page of the browser; errors that pages print fail the test at its end."""
    errors: list[str] = []
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(served.url)  # the browser has the secret from here on
    yield page
    page.close()
    assert errors == []


def study_of(served: Any) -> tuple[int, Any]:
    """The study's number and what the dashboard knows of it, once all six trials have notes."""
    (study,) = served.ask("/api/studies")["study_summaries"]
    number = study["study_id"]
    until = time.monotonic() + 60
    while True:
        detail = served.ask(f"/api/studies/{number}?after=0")
        if len(detail["trials"]) == 6 and all(trial["note"]["body"] for trial in detail["trials"]):
            return number, detail
        assert time.monotonic() < until, "no notes"
        time.sleep(0.5)


def test_what_the_dashboard_is_told(served: Any, out: Path) -> None:
    _, detail = study_of(served)
    states = [trial["state"] for trial in detail["trials"]]
    assert states == ["Complete", "Complete", "Fail", "Complete", "Complete", "Complete"]
    assert [max(trial["constraints"], default=0.0) > 0 for trial in detail["trials"]] == [
        False
    ] * 4 + [True, False]
    assert "Not solved: the body &#60;b&#62;folded" in detail["trials"][2]["note"]["body"]
    assert "Refused: stability 0.01 is below the margin" in detail["trials"][4]["note"]["body"]
    for trial in detail["trials"]:
        names = {Path(artifact["filename"]).suffix for artifact in trial["artifacts"]}
        if trial["number"] in (0, 1, 3, 5):
            assert names == {".png", ".stl", ".csv"}
        assert f"--trial {trial['number']}\n" in trial["note"]["body"]


def test_the_list_of_trials(page: Any, served: Any, out: Path) -> None:
    """Value in mm, note, picture, and the files to download, as a reader sees them."""
    number, detail = study_of(served)
    page.goto(f"{served.address}/dashboard/studies/{number}/trials?numbers=0")
    page.get_by_text("Trial 0 (trial_id=").first.wait_for(timeout=60000)
    text = page.inner_text("body")
    value = detail["trials"][0]["values"][0]
    assert f"{value:.3f}"[:4] in text
    assert "Reproduce:" in text
    assert "trial_000.stl" in text
    assert "trial_000.csv" in text
    picture = page.locator("img[src*='/artifacts/']").first
    picture.wait_for(timeout=30000)
    until = time.monotonic() + 30
    while picture.evaluate("image => image.naturalWidth") == 0 and time.monotonic() < until:
        time.sleep(0.2)
    assert picture.evaluate("image => image.naturalWidth") > 300, "the picture is displayed"
    picture.scroll_into_view_if_needed()


def test_what_failed_and_what_is_infeasible(page: Any, served: Any) -> None:
    """In the list, in the details and in the table, as in the plots."""
    number, _ = study_of(served)
    for trial, state in ((0, "Complete"), (2, "Fail"), (4, "Infeasible")):
        page.goto(f"{served.address}/dashboard/studies/{number}/trials?numbers={trial}")
        page.get_by_text(f"Trial {trial} (trial_id=").first.wait_for(timeout=60000)
        chips = page.locator(".MuiChip-label").all_inner_texts()
        assert [chips.count(name) for name in ("Complete", "Fail", "Infeasible")] == [
            4 + (trial == 0),
            1 + (trial == 2),
            1 + (trial == 4),
        ]
        assert state in chips
    page.goto(f"{served.address}/dashboard/studies/{number}/smartSelection")
    page.get_by_role("cell", name="Infeasible").wait_for(timeout=60000)
    assert page.get_by_role("cell", name="Complete").count() == 4


def test_the_study(page: Any, served: Any) -> None:
    """The history in mm, and the study's note."""
    number, _ = study_of(served)
    page.goto(f"{served.address}/dashboard/studies/{number}")
    page.locator(".js-plotly-plot").first.wait_for(timeout=60000)
    page.wait_for_timeout(1500)
    assert "rms (mm)" in page.inner_text("body")
    page.goto(f"{served.address}/dashboard/studies/{number}/note")
    page.get_by_text("Reproduce:").first.wait_for(timeout=30000)


@pytest.mark.parametrize(
    "place", ["", "/graph", "/trials?numbers=0", "/trialTable", "/smartSelection", "/note"]
)
def test_on_a_phone_nothing_scrolls_sideways(place: str, page: Any, served: Any) -> None:
    """420 px wide. What is wide, such as the table of trials, scrolls in a box of its own."""
    number, _ = study_of(served)
    page.set_viewport_size({"width": 420, "height": 800})
    try:
        page.goto(f"{served.address}/dashboard/studies/{number}{place}")
        page.wait_for_load_state("networkidle")
        page.wait_for_timeout(1500)  # plots are drawn when their data are there
        assert page.evaluate("document.scrollingElement.scrollWidth") <= 420
    finally:
        page.set_viewport_size({"width": 1400, "height": 1000})


def test_the_list_of_studies_has_no_button_that_would_be_refused(
    page: Any, browser: Any, served: Any, out: Path, tmp_path: Path
) -> None:
    """Begun with --write, it has."""
    from dashboard_client import dashboard

    page.goto(f"{served.address}/dashboard")
    page.get_by_text("probe").first.wait_for(timeout=60000)
    button = page.get_by_label("delete study")
    assert button.count() == 1
    assert not button.is_visible()
    shutil.copytree(out, tmp_path / "out")  # one dashboard writes to a folder
    with dashboard(tmp_path / "out", "--write") as editing:
        edits = browser.new_context().new_page()
        edits.goto(editing.url)
        edits.goto(f"{editing.address}/dashboard")
        edits.get_by_label("delete study").wait_for(state="visible", timeout=60000)
