"""The part of a page from which a design can be made: its drawing, its segments, its field, and how exact all that must be."""

from __future__ import annotations

import math
from collections.abc import Sequence

from magmpm.compiled.arrays import Named
from magmpm.errors import fixed, significant
from magmpm.viz.sheet.drawing import drawing
from magmpm.viz.sheet.markup import NOTHING, Markup, joined, table, tag


def sheet(facts: Named) -> Markup:
    """Drawing, segments, field and tolerances of the best design."""
    body = facts["body"]
    best = facts["design"]
    picture = tag(
        "figure", Markup(drawing(body)), tag("figcaption", _caption(body)), class_="drawing"
    )
    parts = [
        tag("h2", f"The design, ready to make (trial {best['number']})"),
        picture,
        tag("h3", "Segments, from base to tip"),
        _segments(facts),
        tag("p", _words_of_directions(), class_="note"),
        tag("h3", "The field"),
        _field(facts),
        tag("h3", "How exactly it has to be made"),
        _tolerances(facts),
    ]
    return joined(parts)


def _caption(body: Named) -> str:
    return (
        f"The undeformed {body['kind']}; arrows: magnetization in the plane of the view; "
        "a dot in a circle: toward the reader, a cross: away. Numbers: segments. Dimensions in mm."
    )


def _words_of_directions() -> str:
    return (
        "Directions are those of the magnetization in the undeformed body, whose base is at the"
        " origin and whose axis is +x: azimuth from +x toward +y about +z, elevation from there up"
        " toward +z. Remanence is the remanent flux density of the magnetized material."
    )


def _segments(facts: Named) -> Markup:
    head = [
        "",
        "from \u2013 to, mm",
        "length, mm",
        "material",
        "G, kPa",
        "remanence, mT",
        "direction (x, y, z)",
        "azimuth",
        "elevation",
    ]
    rows = []
    for s in facts["body"]["segments"]:
        begin = 1e3 * s["from_m"]
        length = 1e3 * s["length_m"]
        extent = f"{begin:.2f} \u2013 {begin + length:.2f}"
        shear = f"{s['shear_modulus_Pa'] / 1e3:.4g}"
        rows.append([s["number"], extent, f"{length:.3f}", s["material"], shear, *_direction(s)])
    return table(head, rows, class_="numbers")


def _direction(segment: Named) -> list[str]:
    x, y, z = segment["direction"]
    if not any((x, y, z)):
        return ["0", "not magnetized", "", ""]
    azimuth = math.degrees(math.atan2(y, x))
    elevation = math.degrees(math.asin(max(-1.0, min(1.0, z))))
    vector = ", ".join(f"{fixed(c, 4):>7}" for c in (x, y, z))
    return [
        f"{1e3 * segment['remanence_T']:.4g}",
        f"({vector})",
        f"{fixed(azimuth, 1)}\u00b0",
        f"{fixed(elevation, 1)}\u00b0",
    ]


def _field(facts: Named) -> Markup:
    """One field, or one for each depth or time."""
    design = facts["design"]
    for key, place, unit, scale in (
        ("insertion", "depth_m", "depth, mm", 1e3),
        ("schedule", "time_s", "time, s", 1.0),
    ):
        if design.get(key):
            head = [unit, "Bx, mT", "By, mT", "Bz, mT", "|B|, mT", "rms, mm", "tip error, mm"]
            rows = [
                [
                    f"{scale * row[place]:.4g}",
                    *_flux(row["field_T"]),
                    _mm(row.get("rms_m")),
                    _mm(row.get("tip_error_m")),
                ]
                for row in design[key]
            ]
            return table(head, rows, class_="numbers")
    field = design.get("field_T")
    if not field:
        return tag("p", "As in the scene's file below.")
    varied = "field_mT" in design.get("params", {})
    words = "Found by the study." if varied else "Given by the scene; the study did not vary it."
    more = (
        ""
        if varied
        else " Magnets, coils and maps of the scene, if any, come in addition: see its file below."
    )
    numbers = table(["Bx, mT", "By, mT", "Bz, mT", "|B|, mT"], [_flux(field)], class_="numbers")
    return numbers + tag("p", f"Uniform. {words}{more}", class_="note")


def _flux(field: Sequence[float]) -> list[str]:
    return [
        *(fixed(1e3 * part, 3) for part in field),
        f"{1e3 * math.sqrt(sum(part * part for part in field)):.3f}",
    ]


def _mm(value: float | None) -> str:
    return "" if value is None else f"{1e3 * value:.3f}"


def _tolerances(facts: Named) -> Markup:
    """The error of each number that alone moves the tip by 1 % of the length, and by the study's stop."""
    rows = facts.get("tolerances")
    if not isinstance(rows, list):
        return tag("p", rows or "Not asked for (--quick).")
    moves = facts["moves"]
    head = [
        "",
        "tip moves by, of 1 unit",
        *(f"error that moves the tip by {name}" for name in moves),
    ]
    lines = []
    for row in rows:
        name = f"{row['what']} of {row['of']}" if row["what"] not in ("diameter",) else "diameter"
        limits = [_limit(value, row["unit"]) for value in row["allowed"]]
        lines.append(
            [name, f"{1e3 * row['tip_m_per_unit']:.3g} mm per {_unit(row['unit'])}", *limits]
        )
    tightest = _tightest(rows)
    return (
        (tag("p", tightest) if tightest else NOTHING)
        + table(head, lines, class_="numbers")
        + tag(
            "p",
            "Each error alone, to first order, from the exact derivatives of the equilibrium; a"
            " direction's by a turn about the worst axis across it. Above 30\u00b0 or 30 % the"
            " first order says no more. Independent errors add as the root of their squares: turns"
            " of 5\u00b0 (one sigma, about each of two axes) of every segment and 5 % of every"
            f" remanence and shear modulus move the tip by at most {_length(facts['together_m'])}"
            " (one sigma).",
            class_="note",
        )
    )


def _tightest(rows: Sequence[Named]) -> str:
    """The segment whose direction matters most, in words."""
    turned = [
        row
        for row in rows
        if row["what"] == "direction"
        and row["segment"] is not None
        and row["allowed"][0] is not None
    ]
    if not turned:
        return ""
    row = min(turned, key=lambda each: each["allowed"][0])
    return (
        f"The direction of {row['of']} matters most: {_limit(row['allowed'][0], 'deg')} move the"
        " tip by 1 % of the length."
    )


def _limit(value: float | None, unit: str) -> str:
    if value is None:
        return "> 30" + _unit(unit, True)
    return f"{significant(value, 2)}{_unit(unit, True)}"


def _unit(unit: str, after: bool = False) -> str:
    return {"deg": "\u00b0", "%": " %" if after else "%", "mm": " mm" if after else "mm"}[unit]


def _length(value: float) -> str:
    return f"{significant(1e3 * value, 2)} mm"
