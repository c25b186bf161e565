"""Numbers for people: significant digits, a fitting prefix, and no "-0". For tables, reports and pictures; `--json` is not rounded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
LENGTHS = ((1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))


def significant(value: float, digits: int = 3) -> str:
    """A number with this many significant digits, without an exponent where that is short: 0.0123, 41.0, 1230, 3.91e-05."""
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
    """A value in an SI unit, with its prefix: 3.91e-5 s is "39.1 µs", 0.006 T "6.00 mT". Zero has none."""
    if value == 0.0 or not math.isfinite(value):
        return f"{significant(value)} {unit}"
    rounded = float(f"{value:.{digits - 1}e}")
    power = 3 * math.floor(math.log10(abs(rounded)) / 3 + 1e-12)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{significant(rounded / 10.0**power, digits)} {PREFIXES[power]}{unit}"


def length(value: float, digits: int = 3) -> str:
    """A length (m) without trailing zeros: "10 mm", "1.93 mm", "5 nm"; in mm from a hundredth of it on."""
    size, unit = next((u for u in LENGTHS if abs(value) >= 0.01 * u[0]), LENGTHS[0])
    return f"{value / size:.{digits}g} {unit}"


def lengths(values: Sequence[float] | np.ndarray) -> str:
    """Lengths (m) in one unit with three decimals: "(38.670, 0.000, 10.366) mm"; small ones in µm, nm or pm."""
    largest = max((abs(float(value)) for value in values if math.isfinite(value)), default=0.0)
    size, unit = next((u for u in LENGTHS if largest >= u[0]), LENGTHS[-1] if largest > 0 else LENGTHS[0])
    return f"({', '.join(fixed(float(value) / size, 3) for value in values)}) {unit}"


def count(number: int, noun: str) -> str:
    """A number of things: "1 jump", "2 jumps"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def stability_in_words(value: float) -> str:
    """The stability of an equilibrium, and what it is measured by."""
    return (
        f"{value:.3f} (stiffness of its softest motion over the unloaded body's: 1 without load, 0 at a critical load; "
        "more than 1: the load stiffens it)"
    )


def fixed(value: float, places: int) -> str:
    """A number with this many decimals, and no -0.000."""
    text = f"{value:.{places}f}"
    return text[1:] if text.startswith("-") and float(text) == 0.0 else text
