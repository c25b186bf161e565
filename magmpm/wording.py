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


def undotted(key: str) -> Key:
    """What `dotted` made: "segments[2].length" -> ("segments", 2, "length")."""
    parts = re.findall(r'"([^"]*)"|\[(\d+)\]|([^.\[\]"]+)', key)
    return tuple(int(index) if index else quoted or word for quoted, index, word in parts)


def flow(value: Any) -> str:
    """Plain data as one would write them on a line of YAML: {uniform: [0 mT, 6 mT, 8 mT]}."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return value if isinstance(value, str) else str(value)


def show(value: Any) -> str:
    """A value as the user might have written it, cut to a readable length."""
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}[str(value)]
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (TypeError, ValueError, RecursionError):
        text = str(type(value).__name__)
    return text if len(text) <= 80 else text[:77] + "..."
