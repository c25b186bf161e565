"""Errors, their wording (place, value received, rule, remedy), and the exit status with which they end a command."""

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
    """The inverse of `dotted`: "segments[2].length" -> ("segments", 2, "length")."""
    parts = re.findall(r'"([^"]*)"|\[(\d+)\]|([^.\[\]"]+)', key)
    return tuple(int(index) if index else quoted or word for quoted, index, word in parts)


def flow(value: Any) -> str:
    """Plain data as written on one line of YAML: {uniform: [0 mT, 6 mT, 8 mT]}."""
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


class MagmpmError(Exception):
    """Base of every error magmpm raises on purpose."""

    exit_status = 1


class InputError(MagmpmError):
    """The input is wrong; the message names file, key, value, rule and remedy."""

    exit_status = 2


class NotThereYet(InputError):
    """A key, command or sampler of the published contract that this version does not have yet."""


class SceneError(InputError):
    """A value of a scene that turns out to be wrong only when the scene's body is built.

    key: where the value stands, as in "effects.ground"; of several keys with ", " between them, the first gives the line. received: the
    value, in SI; found: what is wrong with it; rule: what it must be; remedy: what to do. The message begins with the key;
    inputs.yaml_document.placed adds file and line, and shows the value as the file has it.
    """

    def __init__(self, key: str, *, rule: str, remedy: str, received: str | None = None, found: str | None = None) -> None:
        super().__init__(self.text(key, received, found, rule, remedy))
        self.key, self.received, self.found, self.rule, self.remedy = key, received, found, rule, remedy

    @staticmethod
    def text(place: str, received: str | None, found: str | None, rule: str, remedy: str) -> str:
        """The message. place: the key, with file and line if known; received, found, rule and remedy: as of the class."""
        if found is None:
            return report(place, received=received, rule=rule, remedy=remedy)
        return report(f"{place}: {found}" if received is None else f"{place}: received {received}; {found}", rule=rule, remedy=remedy)


class RenderError(MagmpmError):
    """A picture that could not be drawn; the message says why. A trial goes on without its picture."""


class SolveError(MagmpmError):
    """A run that became unstable or did not converge.

    reason: what happened, in one sentence; state: the last good result, or None; remedies: changes of the scene that may bring it to an
    answer, the first to try first (magmpm.scene.remedies).
    """

    exit_status = 3

    def __init__(self, reason: str, state: Any = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.state = state
        self.remedies: tuple[Any, ...] = ()


class LeftField(SolveError):
    """A body that a field has pulled into a magnet, or to where the field is not known."""


class Collapsed(SolveError):
    """A body whose magnetized segments attract each other more strongly than it can bear."""


class BudgetError(SolveError):
    """A run that would exceed its limit of disk space, memory or time; everything up to then is saved and readable."""


class TimeOver(BudgetError):
    """A run that took longer than it may (magmpm.scene.time_limit)."""
