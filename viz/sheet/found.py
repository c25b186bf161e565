"""The parts of a page that say what a study found, and how it can be made again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from magmpm.compiled.arrays import Named
from magmpm.errors import length, significant
from magmpm.results.result import CITATION, SOURCES
from magmpm.viz.sheet.markup import NOTHING, Markup, joined, pairs, safe, table, tag, wide

WORDS = {
    "insertion": "insertion along a path",
    "schedule": "shapes at given times",
    "shape": "one target shape",
}


def heading(facts: Named) -> Markup:
    """Name of the study, what it sought, and when."""
    sought = WORDS[facts["kind"]]
    robust = ", robust to errors of manufacture" if facts.get("measure_m") else ""
    two = (
        f", two objectives ({' and '.join(facts['objectives'])})" if facts.get("objectives") else ""
    )
    ran = f" \u00b7 {facts['began']} to {facts['ended_at']}" if facts.get("began") else ""
    return tag("h1", facts["name"]) + tag(
        "p", f"A design study by magmpm: {sought}{robust}{two}{ran}", class_="lead"
    )


def large(boxes: Iterable[tuple[str, str]]) -> Markup:
    """Figures that count, large, each with its words."""
    shown = (tag("div", tag("b", value), tag("span", words)) for value, words in boxes)
    return tag("div", *shown, class_="answer")


def answer(facts: Named) -> Markup:
    """The figures that count, large."""
    best = facts.get("best")
    boxes: list[tuple[str, str]] = []
    if best:
        boxes.append(
            (
                length(best["rms_m"]),
                "rms from the target" if facts["kind"] == "shape" else "rms over all equilibria",
            )
        )
        for key, words in (
            ("tip_error_m", "tip error"),
            ("exit_error_m", "exit error"),
            ("worst_m", "worst equilibrium, rms"),
        ):
            if best.get(key) is not None and not (key == "tip_error_m" and "exit_error_m" in best):
                boxes.append((length(best[key]), words))
        if "measure_m" in best:
            boxes.append((length(best["measure_m"]), "mean + 2 sigma, made with errors"))
            boxes.append((length(best["scatter_m"]), "scatter of the made shape"))
        if best.get("stability") is not None:
            boxes.append((significant(best["stability"], 2), "stability (1: at rest, 0: critical)"))
        boxes.append((f"{best['number']}", "its trial"))
    boxes.append(
        (f"{facts['trials']}", f"trial{'s' * (facts['trials'] != 1)} by {facts['sampler']}")
    )
    if facts.get("seconds_per_trial") is not None:
        boxes.append((f"{significant(facts['seconds_per_trial'], 2)} s", "a trial (median)"))
    return large(boxes)


def alarms(facts: Named) -> Markup:
    """Alarms that a reader must not overlook: no design at all, a target that was missed, warnings of the search and of the best solve."""
    says = []
    if not facts.get("best"):
        says.append(
            "This study has no feasible design: no trial was solved and accepted, so there is"
            " nothing to make."
        )
    elif not facts.get("body"):
        says.append(
            "The files of the best design are missing or damaged in this folder; run `magmpm"
            " design` again: it writes them again."
        )
    stop = facts.get("stop_rms_m")
    best = facts.get("best")
    if best and stop is not None and facts.get("first_trial_below_stop") is None:
        says.append(f"The study's stop, {length(stop)}, was not reached.")
    says += [str(one["says"]) for one in facts.get("limits") or []]
    says += list(facts.get("warnings") or []) + list(
        (facts.get("result") or {}).get("warnings") or []
    )
    return joined(tag("div", text, class_="alarm") for text in says)


def search(facts: Named) -> Markup:
    """Counts, why it ended, why trials failed, and the best of them."""
    refused = (
        f", {facts['refused']} were refused as less stable than the margin"
        if facts.get("refused")
        else ""
    )
    failed = f"{facts['failed']} failed{refused}"
    parts = [
        tag(
            "p",
            f"{facts['trials']} trial{'s' * (facts['trials'] != 1)}, of which {failed}. The study"
            f" {_why(facts)}.",
        )
    ]
    if facts.get("why_not"):
        head = ["", "why", "trials"]
        parts.append(
            table(head, [[kind, reason, count] for kind, reason, count in facts["why_not"][:12]])
        )
    rows = facts.get("best_trials") or []
    if rows:
        robust = bool(facts.get("measure_m"))
        two = bool(facts.get("objectives"))
        more = [
            *(["mean + 2 sigma, mm"] if robust else []),
            *(facts["objectives"][1:] if two else []),
        ]
        head = ["trial", "rms, mm", "tip error, mm", "stability", *more]
        lines = [
            [
                row["number"],
                _mm(row["rms_m"]),
                _mm(row["tip_error_m"]),
                "" if row["stability"] is None else f"{row['stability']:.3f}",
                *([_mm(row["value_m"])] if robust else []),
                *([f"{v:.4g}" for v in row["values"][1:]] if two else []),
            ]
            for row in rows
        ]
        parts += [tag("h3", "The best trials"), table(head, lines, class_="numbers")]
    return joined(parts)


def _why(facts: Named) -> str:
    """Reason why the study ended."""
    ended = facts.get("ended")
    if ended == "stop":
        return (
            f"stopped at trial {facts['first_trial_below_stop']}, the first within its stop of"
            f" {length(facts['stop_rms_m'])}"
        )
    if ended == "exhausted":
        return "stopped because no descent from the rod's designs gets better"
    return (
        "was interrupted"
        if ended == "interrupted"
        else f"made all trials that were asked for ({facts['wanted']})"
    )


def importances(facts: Named) -> Markup:
    """Bars of PED-ANOVA's shares."""
    shares = facts.get("importances")
    if not shares:
        return NOTHING
    if "values" not in shares:
        return tag("p", shares["why"][:1].upper() + shares["why"][1:] + ".")
    shown = list(shares["values"].items())[:16]
    largest = max(share for _, share in shown) or 1.0
    rows = [
        [
            name,
            Markup(f'<i style="width:{100 * share / largest:.1f}%"></i>'),
            f"{100 * share:.1f} %",
        ]
        for name, share in shown
    ]
    body = [
        tag("tr", tag("td", name), tag("td", bar, class_="bar"), tag("td", text))
        for name, bar, text in rows
    ]
    left = len(shares["values"]) - len(shown)
    words = (
        f"Shares by PED-ANOVA over {shares['trials']} trials: how differently the best tenth lies"
        " along each parameter, compared with all. "
        + ("With so few trials they are only a hint. " if shares["trials"] < 50 else "")
        + (f"{left} more parameters have less. " if left else "")
        + "The tolerances of the best design say how each change moves the tip."
    )
    return wide(tag("table", tag("tbody", *body), class_="bars")) + tag("p", words, class_="note")


def accuracy(facts: Named) -> Markup:
    """The best design on a finer grid."""
    finer = facts.get("finer")
    if not isinstance(finer, Mapping):
        return tag("p", finer or "Not asked for (--quick).")
    whole = facts["body"]["length_m"]
    rows = [
        ("grid of the study", f"{finer['cells']} cells across"),
        ("solved again on", f"{finer['finer_cells']} cells across"),
        (
            "the axis moves by",
            (
                f"at most {length(finer['moved_m'])} ({100 * finer['moved_m'] / whole:.2g} % of the"
                " length)"
            ),
        ),
        ("the tip moves by", length(finer["tip_moved_m"])),
        (
            "error of the study's grid",
            f"at most {length(finer['error_estimate_m'])}, estimated as docs/accuracy.md says",
        ),
    ]
    if finer["rms_m"] is not None:
        which = {"insertion": " at full insertion", "schedule": " at the last time"}.get(
            facts["kind"], ""
        )
        both = (
            f"{length(finer['rms_m'], 4)} on the study's grid, {length(finer['finer_rms_m'], 4)} on"
            " the finer one"
        )
        rows.append((f"rms from the target{which}", both))
    result = facts["result"]
    rows.append(
        (
            "det F",
            f"{result['min_det_F']:.4f} to {result['max_det_F']:.4f} (1: no change of volume)",
        )
    )
    rows.append(("largest stretch", f"{result['largest_stretch']:.3f}"))
    verified = [
        [
            one["number"],
            _mm(one["rms_m"]),
            _mm(one["verified_rms_m"]),
            _mm(one.get("error_estimate_m")),
            one.get("cells_across", ""),
        ]
        for one in facts.get("verified") or []
        if one.get("verified_rms_m") is not None
    ]
    head = [
        "trial",
        "rms of the trial, mm",
        "rms on a finer grid, mm",
        "shape right to, mm",
        "cells across",
    ]
    more = (
        tag("h3", "Judged by the error that the study asks for")
        + table(head, verified, class_="numbers")
        if verified
        else NOTHING
    )
    note = (
        "Not in these errors: the material's law, effects that the scene does not name, and errors"
        " of manufacture."
    )
    return pairs(rows) + more + tag("p", note, class_="note")


def motion(facts: Named) -> Markup:
    """The best design in time, against the equilibria of an insertion or the shapes of a schedule."""
    rows = facts.get("motion")
    if not rows:
        return NOTHING
    units = {"m": ("mm", 1e3), "s": ("s", 1.0), "N": ("mN", 1e3)}
    columns = [(key, *units[key.rpartition("_")[2]]) for key in rows[0]]
    head = [f"{key.rpartition('_')[0].replace('_', ' ')}, {unit}" for key, unit, _ in columns]
    note = (
        "Distances of the axis, of an insertion from the equilibrium of each depth, of a schedule"
        " from each shape (rms)."
    )
    lines = [[f"{factor * row[key]:.4g}" for key, _, factor in columns] for row in rows]
    return table(head, lines, class_="numbers") + tag("p", note, class_="note")


def settings(facts: Named) -> Markup:
    """Settings of the search: what was searched, by what, and with which versions."""
    best = facts.get("best") or {}
    solved = (facts.get("result") or {}).get("versions") or {}
    rows: list[tuple[Any, Any]] = [
        ("sampler, seed", f"{facts['sampler']}, {facts['seed']}"),
        ("trials asked for", facts["wanted"]),
        ("stop", "none" if facts.get("stop_rms_m") is None else length(facts["stop_rms_m"])),
        ("storage", facts["storage"]),
        ("definition (SHA-256)", facts.get("hash") or "not known"),
        (
            "versions of the best solve",
            ", ".join(f"{name} {number}" for name, number in solved.items()) or "not known",
        ),
        (
            "versions of this page",
            ", ".join(f"{name} {number}" for name, number in facts["versions"].items()),
        ),
    ]
    parts = [pairs(rows)]
    if best.get("params"):
        found = [
            (name, f"{value:.8g}" if isinstance(value, float) else str(value))
            for name, value in best["params"].items()
        ]
        parts.append(_folded("Parameters of the best trial", pairs(found)))
    return joined(parts)


def reproduce(facts: Named) -> Markup:
    """The one line, and the files that it needs."""
    parts = [tag("pre", facts["command"])]
    if not facts.get("study_file"):
        words = (
            "The folder does not say which study file it was made from: put its name in place of"
            " STUDY.yaml."
        )
        parts.append(tag("p", words, class_="note"))
    words = (
        "The same versions, seed and trials give the same trials bit for bit on the same machine"
        " with one worker."
    )
    parts.append(tag("p", words, class_="note"))
    for name, text in (facts.get("files") or {}).items():
        parts.append(_folded(name, tag("pre", _short(text))))
    if facts.get("best_scene"):
        parts.append(
            _folded(
                "best/scene.yaml: the best design as a scene (magmpm run)",
                tag("pre", _short(facts["best_scene"])),
            )
        )
    if facts.get("definition") and not facts.get("files"):
        text = _short(json.dumps(facts["definition"], indent=1))
        parts.append(
            _folded("The definition of the study as stored with its trials, SI", tag("pre", text))
        )
    return joined(parts)


def cite() -> Markup:
    """The program, and the methods that a study stands on."""
    return tag("p", CITATION) + tag("ul", *(tag("li", source) for source in SOURCES))


def _folded(title: str, content: Markup) -> Markup:
    return Markup(f"<details><summary>{safe(title)}</summary>{content.text}</details>")


def _short(text: str) -> str:
    longest_text = 60_000  # characters of a file or a definition on the page
    return text if len(text) <= longest_text else text[:longest_text] + "\n... (shortened)"


def _mm(value: float | None) -> str:
    return "" if value is None else f"{1e3 * value:.4g}"
