"""What is shown of a search for a goal: pictures, page, dashboard; and of a sweep."""

import json
from pathlib import Path

import pytest
from dashboard_client import dashboard
from goal_study import SCENE, STUDY, written

GOALS = """\
scene: scene.yaml
vary:
  numbers:
    - {of: "field.uniform[2]", min: 1 mT, max: 8 mT}
goal:
  - maximize: {displacement: {of: tip, along: [0, 0, 1]}}
  - minimize: {largest_field: {}}
subject_to:
  - {largest_field: {}, at_most: 6 mT}
trials: 5
"""


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a search that ended, with its pictures."""
    from magmpm.cli import main

    folder = tmp_path_factory.mktemp("goal")
    assert main(["design", str(written(folder, GOALS)), "--out", str(folder / "out")]) == 0
    return folder / "out"


def test_a_search_leaves_pictures(out: Path) -> None:
    for name in ("progress.png", "front.png", "picture.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG"), name


def test_pictures_are_drawn_again(out: Path, tmp_path: Path, told) -> None:
    told("render", out, "--out", tmp_path / "again", "--format", "svg")
    assert (tmp_path / "again/progress.svg").exists()
    assert (tmp_path / "again/front.svg").exists()


def test_the_page_tells_goals_bounds_and_the_design(out: Path, tmp_path: Path, told) -> None:
    told("report", out, "--no-pdf", "--out", tmp_path)
    page = (tmp_path / "report.html").read_text()
    report = json.loads((out / "goal.json").read_text())
    best = 1e3 * report["best"]["values"][0]
    for words in (
        "maximize displacement",
        f"{best:.4g} mm",
        "at most 6.000 mT",
        "field.uniform[2] (mT)",
        "on 3 cells across",
        "Magnetization",
        "segment 1",
        "magmpm design",
        f"The study: {report['study_file']}",
    ):
        assert words in page, words
    assert page.count("data:image/png") == 3


def test_a_damaged_report_is_refused(tmp_path: Path, told) -> None:
    (tmp_path / "goal.json").write_text("{}")
    for command in ("report", "render", "dashboard"):
        told(command, tmp_path, status=2, says="goal.json: can't be read")


def test_the_dashboard_shows_units_constraints_and_notes(out: Path) -> None:
    pytest.importorskip("optuna_dashboard", reason="an extra: pip install -e '.[dashboard]'")
    stored = json.loads((out / "goal.json").read_text())
    with dashboard(out) as served:
        (study,) = served.ask("/api/studies")["study_summaries"]
        detail = served.ask(f"/api/studies/{study['study_id']}?after=0")
    assert detail["objective_names"] == ["displacement (mm)", "largest_field (mT)"]
    done = [trial for trial in detail["trials"] if trial["state"] == "Complete"]
    shown = [trial["values"] for trial in done]
    kept = [of for of in stored["values"] if of is not None]
    assert shown == [pytest.approx([1e3 * x for x in of]) for of in kept]


def test_a_sweep_leaves_a_table_and_a_plot(tmp_path: Path, told) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    scene = tmp_path / "scene.yaml"
    fields = "field.uniform[2]=2 mT,4 mT"
    gravity = "effects.gravity=null,{}"
    told("sweep", scene, "--set", fields, "--set", gravity, "--out", tmp_path / "s", "--workers", 1)
    rows = (tmp_path / "s/sweep.csv").read_text().splitlines()
    assert rows[0].startswith("field.uniform[2],effects.gravity,tip_x_m")
    assert len(rows) == 5
    assert (tmp_path / "s/sweep.png").read_bytes().startswith(b"\x89PNG")


def test_one_goal_has_no_front(tmp_path: Path, told) -> None:
    told("design", written(tmp_path, STUDY), "--trials", 2, "--out", tmp_path / "out")
    assert (tmp_path / "out/progress.png").exists()
    assert not (tmp_path / "out/front.png").exists()


def test_a_sweep_draws_what_changes() -> None:
    """A coordinate that is zero but for rounding has no panel; one that changes, and numbers of another unit, have one."""
    from magmpm.viz.goal_plots import _that_change

    rows = [
        {
            "field": field,
            "tip_y_m": noise,
            "tip_z_m": 1e-3 * k,
            "strain": 0.2 + 1e-3 * k,
            "failed": "",
        }
        for k, (field, noise) in enumerate([("2 mT", 1e-18), ("4 mT", -3e-17), ("8 mT", 0.0)])
    ]
    assert _that_change(rows, ["field"]) == ["tip_z_m", "strain"]


def test_progress_tells_how_each_trial_ended(tmp_path: Path) -> None:
    """A panel for each goal, and a mark of its own for trials that failed, were pruned, or were not run."""
    from matplotlib.figure import Figure

    from magmpm.viz import goal_plots

    drawn: list[Figure] = []
    report = {
        "goals": ["maximize travel (m)", "minimize largest_field (T)"],
        "values": [[1e-3, 5e-3], None, None, None, [2e-3, 6e-3]],
        "feasible": [True, False, False, False, True],
        "ends": ["done", "failed", "pruned", "not run", "done"],
    }

    def kept(figure: Figure, path: Path) -> Path:
        drawn.append(figure)
        return path

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(goal_plots, "saved", kept)
        goal_plots.progress(report, tmp_path / "progress.png")
    (figure,) = drawn
    assert [axes.get_ylabel() for axes in figure.axes] == ["travel (mm)", "largest field (mT)"]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "trial",
        "best so far",
        "failed",
        "pruned",
        "not run: violates a bound anyway",
    ]
