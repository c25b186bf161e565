"""How messages about input are worded: place, value received, rule, remedy."""

from __future__ import annotations

import json
import math
import re
from typing import Any

Key = tuple[str | int, ...]


def report(place: str, *, rule: str, remedy: str, received: str | None = None) -> str:
    """The message of an InputError; `place` names the file, with line and key where they are known."""
    first = place if received is None else f"{place}: received {received}"
    return f"{first}\n  rule: {rule}\n  remedy: {remedy}"


def dotted(at: Key) -> str:
    """("segments", 2, "length") -> "segments[2].length"; keys that are no plain word stand in quotes."""
    out = ""
    for part in at:
        if isinstance(part, int):
            out += f"[{part}]"
        else:
            word = part if re.fullmatch(r"[\w<>-]+", part) else f'"{part}"'
            out += f".{word}" if out else word
    return out


def show(value: Any) -> str:
    """A value as the user might have written it, cut to a readable length."""
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}[str(value)]
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (TypeError, ValueError, RecursionError):
        text = str(type(value).__name__)
    return text if len(text) <= 80 else text[:77] + "..."
