"""The page of a study, from what is known of it (studies.sheet.facts) and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magmpm.viz.sheet import design, found
from magmpm.viz.sheet.look import CSS
from magmpm.viz.sheet.markup import NOTHING, Markup, PictureError, figure, joined, movie, safe, tag

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


def page(facts: Mapping[str, Any], pictures: Pictures) -> str:
    """The whole page as HTML."""
    notes: list[str] = list(facts["notes"])
    parts = [found.heading(facts), found.answer(facts), found.alarms(facts)]
    shown = _shown(pictures, notes)
    if facts.get("body"):
        parts += [shown["best"], design.sheet(facts), shown["movies"]]
    parts += [
        section("How the search went", found.search(facts), shown["convergence"], shown["pareto"], shown["trials"]),
        section("Which parameters mattered", found.importances(facts)),
        section("How accurate the best design is", found.accuracy(facts)) if facts.get("body") else NOTHING,
        section("The best design in motion", found.motion(facts)),
        section("Settings and versions", found.settings(facts)),
        section("Reproduce it", found.reproduce(facts)),
        section("How to cite", found.cite()),
    ]
    if notes:
        parts.append(section("What is missing on this page", *(tag("p", note, class_="note") for note in notes)))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{safe(POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="generator" content="magmpm report">\n'
        f"<title>{safe(facts['name'])}: a study by magmpm</title>\n<style>{CSS}</style></head>\n"
        f"<body>\n{joined(parts).text}\n</body></html>\n"
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
    front = "The two objectives of every trial, and the front of those that no other is better than."
    return {
        "best": one(pictures.best, figure, best, class_="best"),
        "convergence": one(pictures.convergence, figure, "Distance from the target, trial by trial, and the best so far.", class_="plot"),
        "pareto": one(pictures.pareto, figure, front, class_="plot"),
        "movies": joined(one(path, movie, words) for path, words in pictures.movies),
        "trials": _strip([one(path, figure, words) for path, words in pictures.trials]),
    }


def _strip(figures: list[Markup]) -> Markup:
    figures = [each for each in figures if each.text]
    return tag("h3", "Designs that were the best when they ran") + tag("div", *figures, class_="strip") if figures else NOTHING
