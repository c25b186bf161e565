"""`magmpm report`: a study as one page, and as PDF. Here what studies know of it meets what viz draws."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.cli.answers import is_study, print_summary
from magmpm.cli.design import draw_study, saved_report, saved_target
from magmpm.cli.goals import page_of_goal, saved_goal
from magmpm.errors import InputError
from magmpm.results.folder_lock import folder_lock
from magmpm.results.run_folder import holds_run
from magmpm.results.whole_file import whole_file

if TYPE_CHECKING:
    from magmpm.compiled.arrays import Named, Plain
    from magmpm.viz.sheet import Pictures

PAGE = "report.html"
PDF = "report.pdf"
MOVIES = {
    "insertion.mp4": "The best design on its way along the path.",
    "best_shapes.mp4": "The designs that were the best so far, one after the other.",
}


def command(options: argparse.Namespace) -> int:
    """Write the page. Returns the exit status. Raises InputError."""
    folder = Path(options.folder)
    out: Path = options.out or folder
    if not is_study(folder):
        drawn = f"for a run, `magmpm render {folder}` draws it"
        remedy = drawn if holds_run(folder) else "give the folder of a study, such as runs/s_shape"
        raise InputError(
            f"{folder}: holds no study", rule="a report is written for a study", remedy=remedy
        )
    if out.resolve() != folder.resolve() and (is_study(out) or holds_run(out)):
        raise InputError(
            f"{out}: holds other results",
            rule="a report goes beside its study, or into a folder without results",
            remedy="give another --out, or omit it",
        )
    from magmpm.studies.engine.storage_url import known_url

    goal = saved_goal(folder)
    if goal is not None:
        with folder_lock(out):
            made = saved_page(page_of_goal(folder, goal), out, pdf=not options.no_pdf)
        return _told(options, {**made, "best": goal["best"]})
    report = saved_report(folder)
    if options.motion and not {"insertion", "schedule"} & (report.get("best") or {}).keys():
        raise InputError(
            "--motion",
            received=str(folder),
            rule="only the best design of an insertion or a schedule can be run in time",
            remedy="leave it out",
        )
    storage = known_url(report["storage"], options.storage, os.environ)
    with folder_lock(out):
        made = write(
            folder,
            report,
            out,
            storage=storage,
            quick=options.quick,
            motion=options.motion,
            pdf=not options.no_pdf,
        )
    return _told(options, made)


def _told(options: argparse.Namespace, made: Plain) -> int:
    """Say what was made. Returns the exit status."""
    for note in made["notes"]:
        print(f"magmpm: note: {note}", file=sys.stderr)
    lines = [f"saved {made['html']}", *([f"saved {made['pdf']}"] if made["pdf"] else [])]
    print_summary(options, made, "\n".join(lines))
    return 0


def write(
    folder: Path,
    report: Named,
    out: Path,
    *,
    storage: str | None,
    quick: bool,
    motion: bool,
    pdf: bool,
) -> Plain:
    """Gather, draw, write OUT/report.html and, where it can, OUT/report.pdf: `html`, `pdf` (or None), `notes`, `best`, `motion`."""
    from magmpm.simulate import run, sensitivities
    from magmpm.studies.sheet import gather
    from magmpm.viz.sheet import page

    facts = gather(
        folder,
        report,
        run=run,
        differentiate=sensitivities,
        storage=storage,
        quick=quick,
        motion=motion,
    )
    with tempfile.TemporaryDirectory(prefix="magmpm-report-") as drawn:
        text = page(facts, _pictures(folder, report, Path(drawn), facts))
    made = saved_page(text, out, pdf=pdf)
    made["notes"] = [*facts["notes"], *made["notes"]]
    return {**made, "best": report.get("best"), "motion": facts.get("motion", [])}


def saved_page(text: str, out: Path, *, pdf: bool) -> Plain:
    """Write a page as HTML, and as PDF where there is a printer: `html`, `pdf` (or None), `notes`."""
    from magmpm.viz.sheet import PrintError, printed

    with whole_file(out / PAGE) as part:
        part.write_text(text, encoding="utf-8")
    made: Plain = {"html": str(out / PAGE), "pdf": None, "notes": []}
    if pdf:
        try:
            printed(text, out / PDF)
            made["pdf"] = str(out / PDF)
        except PrintError as error:
            made["notes"].append(str(error))
    return made


def _pictures(folder: Path, report: Named, drawn: Path, facts: Named) -> Pictures:
    """The study's pictures; drawn now where it was run without them."""
    from magmpm.studies.engine.records import IMPROVEMENTS, PICTURES
    from magmpm.viz.sheet import Pictures

    at = folder
    wanted = report["rms_m"] or report.get("best")
    if wanted and not (folder / "convergence.png").exists():
        try:
            from magmpm.viz.worker import Renderer

            with Renderer() as renderer:
                target = saved_target(folder)
                draw_study(
                    folder,
                    dict(report),
                    facts["target"] if target is None else target,
                    renderer,
                    drawn,
                )
            at = drawn
        except Exception as error:  # drawing goes through OpenGL, worker processes and disks: the page is worth more than its pictures
            facts["notes"].append(f"Pictures could not be drawn: {error}")

    def there(name: str) -> Path | None:
        return at / name if (at / name).exists() else None

    improved = sorted(
        path.name for path in (folder / IMPROVEMENTS).glob("[0-9]*") if path.name.isdigit()
    )
    trials = [
        (folder / PICTURES / f"trial_{name}.png", f"Trial {int(name)}") for name in improved[-6:]
    ]
    return Pictures(
        best=there("best.png"),
        convergence=there("convergence.png"),
        pareto=there("pareto.png"),
        movies=[(at / name, words) for name, words in MOVIES.items() if (at / name).exists()],
        trials=[(path, words) for path, words in trials if path.exists()],
    )
