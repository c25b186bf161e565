"""Errors, their wording (place, value received, rule, remedy), and the exit status with which they end a command; and numbers for people.

Such numbers have significant digits, a fitting prefix, and no "-0", in messages, tables, reports and pictures; `--json` is not rounded.
"""

from __future__ import annotations

import importlib.util
import json
import math
import re
import sys
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

Key = tuple[str | int, ...]
PAIR = ": "  # before the part, or the two, of a contact: such rows are there only while they touch
PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
LENGTHS = ((1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))


def report(place: str, *, rule: str, remedy: str, received: str | None = None) -> str:
    """Write the message of an InputError.

    Parameters
    ----------
    place : str
        Names the file, with line and key where they are known.
    rule : str
        What must hold.
    remedy : str
        What to do.
    received : str, optional
        The value that was received, as text.

    Returns
    -------
    str
        Lines of text.
    """
    first = place if received is None else f"{place}: received {received}"
    return f"{first}\n  rule: {rule}\n  remedy: {remedy}"


def dotted(at: Key) -> str:
    """Write a key as people do: ("segments", 2, "length") is "segments[2].length"; what is no plain word stands in quotes.

    Parameters
    ----------
    at : Key
        The key, part by part.

    Returns
    -------
    str
        Its text.
    """
    out = ""
    for part in at:
        if isinstance(part, int):
            out += f"[{part}]"
        else:
            word = part if re.fullmatch(r"[\w<>-]+", part) else f'"{part}"'
            out += f".{word}" if out else word
    return out


def undotted(key: str) -> Key:
    """Read a key: the inverse of `dotted`, "segments[2].length" is ("segments", 2, "length").

    Parameters
    ----------
    key : str
        Its text.

    Returns
    -------
    Key
        The key, part by part.
    """
    parts = re.findall(r'"([^"]*)"|\[(\d+)\]|([^.\[\]"]+)', key)
    return tuple(int(index) if index else quoted or word for quoted, index, word in parts)


def flow(value: Any) -> str:
    """Write plain data on one line of YAML: {uniform: [0 mT, 6 mT, 8 mT]}.

    Parameters
    ----------
    value : object
        Dicts, lists, tuples, text and numbers.

    Returns
    -------
    str
        The line.
    """
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return value if isinstance(value, str) else str(value)


def show(value: Any) -> str:
    """Write a value as the user might have written it, cut to a readable length.

    Parameters
    ----------
    value : object
        Any value.

    Returns
    -------
    str
        At most 80 characters.
    """
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
    """Error of an input; the message names file, key, value, rule and remedy.

    Parameters
    ----------
    place : str
        What is wrong, such as "scene.yaml:9: field.uniform"; without a rule it is the whole
        message.
    rule : str, default ''
        What must hold.
    remedy : str, default ''
        What to do.
    received : str, optional
        The value that was received, as text.
    """

    exit_status = 2

    def __init__(
        self, place: str, *, rule: str = "", remedy: str = "", received: str | None = None
    ) -> None:
        super().__init__(
            report(place, rule=rule, remedy=remedy, received=received) if rule else place
        )


def in_one_line(error: BaseException) -> str:
    """Say what went wrong, and the rule that was broken, without the remedy; of several problems the first.

    Parameters
    ----------
    error : BaseException
        Any error; of those that are no InputError it is the first line.

    Returns
    -------
    str
        The line.
    """
    told = re.sub(r"^\d+ problems in .*\n", "", str(error))
    told = told.removeprefix("input: ").replace("\n  rule: ", "; ")
    return told.partition("\n")[0] or type(error).__name__


class SceneError(InputError):
    """A value of a scene that turns out to be wrong only when the scene's body is built.

    The message begins with the key; inputs.yaml_document.placed adds file and line, and shows the
    value as the file has it.

    Parameters
    ----------
    key : str
        Where the value stands, as in "effects.ground"; of several keys with ", " between them,
        the first gives the line.
    rule : str
        What the value must be.
    remedy : str
        What to do.
    received : str, optional
        The value, in SI.
    found : str, optional
        What is wrong with it.
    """

    def __init__(
        self,
        key: str,
        *,
        rule: str,
        remedy: str,
        received: str | None = None,
        found: str | None = None,
    ) -> None:
        super().__init__(self.text(key, received, found, rule, remedy))
        self.key = key
        self.received = received
        self.found = found
        self.rule = rule
        self.remedy = remedy

    @staticmethod
    def text(place: str, received: str | None, found: str | None, rule: str, remedy: str) -> str:
        """Write the message.

        Parameters
        ----------
        place : str
            The key, with file and line if known.
        received : str or None
            As of the class.
        found : str or None
            As of the class.
        rule : str
            As of the class.
        remedy : str
            As of the class.

        Returns
        -------
        str
            The message.
        """
        if found is None:
            return report(place, received=received, rule=rule, remedy=remedy)
        return report(
            f"{place}: {found}" if received is None else f"{place}: received {received}; {found}",
            rule=rule,
            remedy=remedy,
        )


class MissingPackage(SceneError):
    """An optional package is not installed; the message names the extra that brings it."""


def installed(package: str) -> bool:
    """Tell whether a package can be imported; it is not imported.

    Parameters
    ----------
    package : str
        Its import name.

    Returns
    -------
    bool
        True if it can.
    """
    if package in sys.modules:
        return sys.modules[package] is not None
    try:
        return importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:  # what a dotted name begins with is missing
        return False


def install(extra: str) -> str:
    """Write the command that installs an extra of magmpm, from where magmpm was installed, for remedies.

    Parameters
    ----------
    extra : str
        Its name; "" for magmpm without any.

    Returns
    -------
    str
        The command.
    """
    wanted = f"[{extra}]" if extra else ""
    try:  # of what did not come from an index (PEP 610)
        source = json.loads(metadata.distribution("magmpm").read_text("direct_url.json") or "{}")
    except metadata.PackageNotFoundError:  # a checkout that is run without being installed
        source = {"url": Path(__file__).parents[1].as_uri(), "dir_info": {"editable": True}}
    url = urlsplit(source.get("url", ""))
    place = unquote(url.path) if url.scheme == "file" else ""
    option = "-e " if source.get("dir_info", {}).get("editable") else ""
    return f"pip install {option}'{place or 'magmpm'}{wanted}'"


def require(package: str, extra: str, *, key: str, use: str, instead: str = "") -> None:
    """Check that an optional package is installed, before anything that needs it begins.

    Parameters
    ----------
    package : str
        Its import name.
    extra : str
        Extra of magmpm that brings it (setup.cfg).
    key : str
        Key, command or function that the user has named.
    use : str
        What needs the package, as the subject of a sentence in the plural.
    instead : str, optional
        Another remedy.

    Raises
    ------
    MissingPackage
        If it is not installed.
    """
    if not installed(package):
        raise MissingPackage(
            key,
            found=f"{use} need the package {package}, which is not installed",
            rule=f"it belongs to the extra `{extra}` of magmpm",
            remedy=f"{install(extra)}, or {instead}" if instead else install(extra),
        )


class RenderError(MagmpmError):
    """A picture that could not be drawn; the message says why. A trial goes on without its picture."""


class SolveError(MagmpmError):
    """A run that became unstable or did not converge. Its `remedies` are changes that may help, the best first.

    Parameters
    ----------
    reason : str
        What happened, in one sentence.
    state : Result, optional
        The last good result.
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


def significant(value: float, digits: int = 3) -> str:
    """Write a number with so many significant digits, without an exponent where that is short: 0.0123, 41.0, 1230, 3.91e-05.

    Parameters
    ----------
    value : float
        Any number.
    digits : int, default 3
        How many count.

    Returns
    -------
    str
        The text.
    """
    if not math.isfinite(value):
        return str(value)
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(value)) + 1e-12)
    rounded = round(value, digits - 1 - power)
    if abs(rounded) >= 10.0 ** (power + 1):
        power += 1  # 9.996 is 10.0
    if not -4 <= power < 6:
        return f"{value:.{digits - 1}e}"
    return f"{rounded:.{max(digits - 1 - power, 0)}f}"


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a value in an SI unit, with its prefix: 3.91e-5 s is "39.1 µs", 0.006 T "6.00 mT". Zero has none.

    Parameters
    ----------
    value : float
        In that unit.
    unit : str
        An SI unit without a prefix.
    digits : int, default 3
        Significant digits.

    Returns
    -------
    str
        The text.
    """
    if value == 0.0 or not math.isfinite(value):
        return f"{significant(value)} {unit}"
    rounded = float(f"{value:.{digits - 1}e}")
    power = 3 * math.floor(math.log10(abs(rounded)) / 3 + 1e-12)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{significant(rounded / 10.0**power, digits)} {PREFIXES[power]}{unit}"


def length(value: float, digits: int = 3) -> str:
    """Write a length without trailing zeros: "10 mm", "1.93 mm", "5 nm"; in mm from a hundredth of it on.

    Parameters
    ----------
    value : float, m
        The length.
    digits : int, default 3
        Significant digits.

    Returns
    -------
    str
        The text.
    """
    size, unit = next((u for u in LENGTHS if abs(value) >= 0.01 * u[0]), LENGTHS[0])
    return f"{value / size:.{digits}g} {unit}"


def shown_unit(label: str) -> tuple[str, float]:
    """Find the unit in which people read a quantity.

    Parameters
    ----------
    label : str
        The quantity with its SI unit, `travel (m)`.

    Returns
    -------
    label : str
        With that unit, `travel (mm)`.
    factor : float
        From the SI unit to that one.
    """
    name, _, unit = label.rpartition(" (")
    known = {
        "m)": ("mm", 1e3),
        "T)": ("mT", 1e3),
        "N)": ("mN", 1e3),
        "rad)": ("deg", math.degrees(1.0)),
        "m^3)": ("mm\u00b3", 1e9),
    }
    if unit not in known:
        return label, 1.0
    shown, factor = known[unit]
    return f"{name} ({shown})", factor


def unitless(label: str) -> str:
    """Find a quantity's name without its unit.

    Parameters
    ----------
    label : str
        The quantity with its unit, `travel (m)`.

    Returns
    -------
    str
        The name.
    """
    return label.rpartition(" (")[0] or label


def in_words(label: str, value: float) -> str:
    """Write a value as people read it: "2.55 mm".

    Parameters
    ----------
    label : str
        The quantity with its SI unit, `travel (m)`.
    value : float
        In SI.

    Returns
    -------
    str
        The text.
    """
    shown, factor = shown_unit(label)
    unit = shown.rpartition(" (")[2].removesuffix(")") if shown.endswith(")") else ""
    return f"{significant(value * factor, 4)} {unit}".strip()


def in_mm(place: Iterable[float], digits: str = ".3g") -> str:
    """Write a place for messages: "(12, 0, -2) mm".

    Parameters
    ----------
    place : iterable of float, m
        Its coordinates.
    digits : str, default '.3g'
        Format of the numbers.

    Returns
    -------
    str
        The text.
    """
    return f"({', '.join(f'{1e3 * value:{digits}}' for value in place)}) mm"


def lengths(values: Iterable[float]) -> str:
    """Write lengths in one unit with three decimals: "(38.670, 0.000, 10.366) mm"; small ones in µm, nm or pm, rounding in mm.

    Parameters
    ----------
    values : iterable of float, m
        The lengths.

    Returns
    -------
    str
        The text.
    """
    largest = max((abs(float(value)) for value in values if math.isfinite(value)), default=0.0)
    size, unit = next(
        (u for u in LENGTHS if largest >= u[0]), LENGTHS[-1] if largest >= 5e-16 else LENGTHS[0]
    )
    return f"({', '.join(fixed(float(value) / size, 3) for value in values)}) {unit}"


def count(number: int, noun: str) -> str:
    """Write a number of things: "1 jump", "2 jumps".

    Parameters
    ----------
    number : int
        How many.
    noun : str
        One of them.

    Returns
    -------
    str
        The text.
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def stability_in_words(value: float) -> str:
    """Write the stability of an equilibrium, and what it is measured by.

    Parameters
    ----------
    value : float, no unit
        As `Result.stability`.

    Returns
    -------
    str
        The text.
    """
    return (
        f"{value:.3f} (stiffness of its softest motion over the unloaded body's: 1 without load, 0"
        " at a critical load; more than 1: the load stiffens it)"
    )


def fixed(value: float, places: int) -> str:
    """Write a number with so many decimals, and no -0.000.

    Parameters
    ----------
    value : float
        Any number.
    places : int
        Number of decimals.

    Returns
    -------
    str
        The text.
    """
    text = f"{value:.{places}f}"
    return text[1:] if text.startswith("-") and float(text) == 0.0 else text
