"""The page of a study, from what is known of it (studies.sheet.facts) and its pictures; and as PDF, by WeasyPrint."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magmpm.compiled.arrays import Named
from magmpm.errors import MagmpmError, install
from magmpm.results.whole_file import whole_file
from magmpm.viz.sheet import design, found
from magmpm.viz.sheet.markup import NOTHING, Markup, PictureError, figure, joined, movie, safe, tag

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 960px; padding: 24px 28px 60px; color: #1a1a1a; background: #fff;
  font: 15px/1.5 "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif; overflow-wrap: break-word; }
h1 { font-size: 26px; line-height: 1.2; margin: 0 0 4px; }
h2 { font-size: 18px; margin: 34px 0 8px; padding-bottom: 3px; border-bottom: 1px solid #ccc; break-after: avoid; }
h3 { font-size: 15px; margin: 18px 0 4px; break-after: avoid; }
p { margin: 6px 0 10px; }
.lead { color: #555; margin-bottom: 14px; }
.alarm { border-left: 4px solid #b3261e; background: #fbeeed; padding: 8px 12px; margin: 12px 0; }
.note { color: #555; font-size: 13px; }
.answer { display: flex; flex-wrap: wrap; margin: 10px 0 14px; }
.answer div { border: 1px solid #ddd; padding: 6px 14px; margin: 0 8px 8px 0; min-width: 116px; }
.answer b { display: block; font-size: 20px; font-weight: 600; }
.answer span { color: #555; font-size: 12.5px; }
table { border-collapse: collapse; font-size: 13px; margin: 8px 0 12px; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 10px 3px 0; text-align: left; vertical-align: top; }
thead th { border-bottom: 1.5px solid #1a1a1a; font-weight: 600; vertical-align: bottom; }
tbody tr { border-bottom: 1px solid #e3e3e3; break-inside: avoid; }
.numbers td, .numbers th { text-align: right; padding: 3px 0 3px 14px; }
.numbers td:first-child, .numbers th:first-child { text-align: left; padding-left: 0; }
.pairs th { font-weight: 600; padding-right: 18px; white-space: nowrap; }
.pairs td { overflow-wrap: anywhere; }
figure { margin: 10px 0 14px; break-inside: avoid; }
figure img, figure video, figure svg { max-width: 100%; height: auto; display: block; }
figcaption { color: #555; font-size: 12.5px; margin-top: 3px; }
.plot img { max-width: 620px; width: 100%; }
.movie video { max-width: 720px; width: 100%; }
.strip { display: flex; flex-wrap: wrap; }
.strip figure { width: 33%; padding-right: 10px; margin: 4px 0; }
.bars td.bar { width: 320px; padding-top: 7px; }
.bars i { display: block; height: 10px; background: #4477aa; }
pre { background: #f6f6f4; border: 1px solid #e3e3e3; padding: 8px 10px; font: 12px/1.4 Menlo, Consolas, "DejaVu Sans Mono", monospace;
  white-space: pre-wrap; overflow-wrap: anywhere; margin: 6px 0 12px; }
code { font: 12.5px Menlo, Consolas, "DejaVu Sans Mono", monospace; }
@media screen { .wide { overflow-x: auto; } }
@media (max-width: 600px) {
  body { padding: 16px 14px 40px; }
  .pairs th { white-space: normal; min-width: 84px; }
  .bars td.bar { width: 40vw; }
  .strip figure { width: 50%; }
}
summary { cursor: pointer; color: #333; font-weight: 600; font-size: 13.5px; margin: 4px 0; }
@page { size: A4; margin: 16mm 15mm 18mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 9px sans-serif; color: #777; } }
@media print {
  body { max-width: none; padding: 0; font-size: 10.5px; }
  h1 { font-size: 19px; } h2 { font-size: 14px; margin-top: 20px; } h3 { font-size: 11.5px; }
  table, pre, code, .note, figcaption, summary { font-size: 9px; }
  .answer b { font-size: 14px; } .answer span { font-size: 9px; }
  .movie video { display: none; } .movie figcaption::after { content: " (moves in the HTML page)"; }
  .best img { max-height: 105mm; width: auto; }
  .plot img { max-width: 110mm; }
}
"""

# What a page may load: nothing but what it holds. No scripts at all.
POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"


@dataclass
class Pictures:
    """Files that the page takes in. best, convergence, pareto: of the study, where there are any; movies, trials: with captions."""

    best: Path | None = None
    convergence: Path | None = None
    pareto: Path | None = None
    movies: list[tuple[Path, str]] = field(default_factory=list)
    trials: list[tuple[Path, str]] = field(default_factory=list)


def page(facts: Named, pictures: Pictures) -> str:
    """The whole page as HTML."""
    notes: list[str] = list(facts["notes"])
    parts = [found.heading(facts), found.answer(facts), found.alarms(facts)]
    shown = _shown(pictures, notes)
    if facts.get("body"):
        parts += [shown["best"], design.sheet(facts), shown["movies"]]
    parts += [
        section(
            "How the search went",
            found.search(facts),
            shown["convergence"],
            shown["pareto"],
            shown["trials"],
        ),
        section("Which parameters mattered", found.importances(facts)),
        (
            section("How accurate the best design is", found.accuracy(facts))
            if facts.get("body")
            else NOTHING
        ),
        section("The best design in motion", found.motion(facts)),
        section("Settings and versions", found.settings(facts)),
        section("Reproduce it", found.reproduce(facts)),
        section("How to cite", found.cite()),
    ]
    if notes:
        parts.append(
            section(
                "What is missing on this page", *(tag("p", note, class_="note") for note in notes)
            )
        )
    return document(facts["name"], joined(parts))


def document(name: str, content: Markup) -> str:
    """A page with this content, which loads nothing."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{safe(POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="generator"'
        ' content="magmpm report">\n'
        f"<title>{safe(name)}: a study by magmpm</title>\n<style>{CSS}</style></head>\n"
        f"<body>\n{content.text}\n</body></html>\n"
    )


def section(title: str, *content: Markup) -> Markup:
    """A part of the page; nothing where it has no content."""
    held = joined(part for part in content if part.text)
    return tag("section", tag("h2", title), held) if held.text else NOTHING


def _shown(pictures: Pictures, notes: list[str]) -> dict[str, Markup]:
    """The pictures as HTML; one that can't be read leaves a note."""

    def one(path: Path | None, make: Any, *words: Any, **more: Any) -> Markup:
        if path is None:
            return NOTHING
        try:
            made: Markup = make(path, *words, **more)
        except PictureError as error:
            notes.append(str(error))
            return NOTHING
        return made

    best = "The best design at its equilibrium. Arrows: magnetization; blue dots: the target."
    front = (
        "The two objectives of every trial, and the front of those that no other is better than."
    )
    return {
        "best": one(pictures.best, figure, best, class_="best"),
        "convergence": one(
            pictures.convergence,
            figure,
            "Distance from the target, trial by trial, and the best so far.",
            class_="plot",
        ),
        "pareto": one(pictures.pareto, figure, front, class_="plot"),
        "movies": joined(one(path, movie, words) for path, words in pictures.movies),
        "trials": _strip([one(path, figure, words) for path, words in pictures.trials]),
    }


def _strip(figures: list[Markup]) -> Markup:
    figures = [each for each in figures if each.text]
    return (
        tag("h3", "Designs that were the best when they ran") + tag("div", *figures, class_="strip")
        if figures
        else NOTHING
    )


class PrintError(MagmpmError):
    """Reason why no PDF could be made."""


def printed(html: str, path: Path) -> str:
    """Write a page as PDF. Returns what printed it. Raises PrintError where it can't be printed."""
    remedy = f"{install('report')}, or print the page from a browser"
    try:
        import weasyprint
        from weasyprint.urls import URLFetcher
    except (ImportError, OSError) as error:  # OSError: Pango, which it draws with, is missing
        reason = str(error).splitlines()[0]
        raise PrintError(f"no PDF: WeasyPrint is not at hand ({reason}); {remedy}") from None

    # paper can't be clicked; user texts are escaped and hold no such tag
    html = html.replace("<details>", "<details open>")
    only_within = URLFetcher(allowed_protocols=["data"])  # a page loads nothing from elsewhere
    try:
        with whole_file(path) as part:
            weasyprint.HTML(string=html, url_fetcher=only_within).write_pdf(str(part))
    except Exception as error:  # a printer's own faults: the page itself is there
        why = f"{type(error).__name__}: {error}"
        raise PrintError(f"no PDF: WeasyPrint did not print ({why}); {remedy}") from None
    return f"WeasyPrint {weasyprint.__version__}"
