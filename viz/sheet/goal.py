"""The page of a search for a goal, from its report and its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from magmpm.compiled.arrays import Named
from magmpm.errors import in_words, significant, unitless
from magmpm.viz.sheet.found import cite, large
from magmpm.viz.sheet.markup import NOTHING, Markup, figure, joined, movie, pairs, table, tag
from magmpm.viz.sheet.whole import document, section


def goal_page(report: Named, facts: Named, pictures: Sequence[tuple[Path, str]]) -> str:
    """The page as HTML.

    facts: `command` that goes on; `scene`, the best design's file; `directions`, pairs of a region's name and its magnetization in the
    best design. pictures: files and what they show.
    """
    best = report["best"]
    held = [(movie if path.suffix == ".mp4" else figure)(path, words) for path, words in pictures]
    parts = [
        tag("h1", report["name"])
        + tag(
            "p",
            f"A design study by magmpm: {'; '.join(map(unitless, report['goals']))}",
            class_="lead",
        ),
        _answer(report),
        _alarms(report),
        joined(held[:1]),
        section("The best design", _params(report), _directions(facts)) if best else NOTHING,
        section("What it does", _measures(report)),
        section("How sure that is", _checks(report)) if best else NOTHING,
        section("Pictures", joined(held[1:])),
        section("Trials that failed", _failed(report)),
        section(
            "Reproduce it",
            tag("p", f"The study: {report['study_file']}"),
            tag("pre", facts["command"]),
            tag("pre", facts["scene"]) if facts["scene"] else NOTHING,
        ),
        section("How to cite", cite()),
    ]
    return document(report["name"], joined(parts))


def _answer(report: Named) -> Markup:
    """The figures that count, large."""
    boxes: list[tuple[str, str]] = []
    best = report["best"]
    if best:
        boxes += [
            (in_words(goal, value), unitless(goal))
            for goal, value in zip(report["goals"], best["values"], strict=True)
        ]
        boxes.append((str(best["number"]), "its trial"))
    boxes.append((str(report["trials"]), f"trials by {report['sampler']}"))
    boxes.append((f"{significant(report['seconds_per_trial'], 2)} s", "a trial (median)"))
    return large(boxes)


def _alarms(report: Named) -> Markup:
    """Alarms that a reader must not overlook."""
    says = list(report["warnings"])
    if report["best"] is None:
        says.append("No trial was run to its end: there is no design.")
    elif not report["best"]["feasible"]:
        says.append("No trial satisfies all constraints; this design violates them least.")
    if report["ended"] != "done":
        says.append(f"The search has not ended: {report['ended']}.")
    return joined(tag("p", one, class_="alarm") for one in says)


def _params(report: Named) -> Markup:
    """Each number of the best design beside the scene's own."""
    begun = report["begun"]
    tied = report["tied"]
    rows = [
        (
            name + (f" and {tied[name] - 1} tied to it" if name in tied else ""),
            _number(begun.get(name)),
            _number(value),
        )
        for name, value in report["best"]["params"].items()
    ]
    return table(("number", "in the scene", "best"), rows, "numbers")


def _number(value: Any) -> str:
    return significant(value, 5) if isinstance(value, float) else str(value)


def _directions(facts: Named) -> Markup:
    rows = [(name, *(f"{x:+.4f}" for x in direction)) for name, direction in facts["directions"]]
    if not rows:
        return NOTHING
    return tag("h3", "Magnetization") + table(("region", "x", "y", "z"), rows, "numbers")


def _measures(report: Named) -> Markup:
    """Goals and constraints of the best design."""
    values = report["best"]["values"] if report["best"] else ()
    rows = [
        (unitless(goal), in_words(goal, value), "")
        for goal, value in zip(report["goals"], values, strict=False)
    ]
    for limit in report["limits"]:
        rows.append((unitless(limit["label"]), limit["value"] + limit["missed"], limit["bounds"]))
    return table(("measure", "value", "bound"), rows)


def _checks(report: Named) -> Markup:
    """The best design on more cells, and the noise around it."""
    rows: list[tuple[str, str]] = []
    finer = report["finer"]
    goals = report["goals"]
    if finer is not None and "values" in finer:
        values = ", ".join(map(in_words, goals, finer["values"]))
        rows.append((f"on {finer['cells_across']} cells across", values))
    elif finer is not None:
        rows.append((f"on {finer['cells_across']} cells across", finer["failed"]))
    scatter = report["scatter"]
    if scatter is not None:
        values = ", ".join(
            "failed" if one is None else in_words(goals[0], one[0]) for one in scatter["values"]
        )
        rows.append((f"designs within {scatter['nearness']:g} of each range", values))
    return pairs(rows) if rows else NOTHING


def _failed(report: Named, most: int = 10) -> Markup:
    """The last trials that failed."""
    rows = [(str(one["number"]), one["why"]) for one in report["failed"][-most:]]
    return table(("trial", "why"), rows) if rows else NOTHING
