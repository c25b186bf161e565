"""Text with a unit -> SI float: "40 mm" -> 0.04.

The number is read as an exact decimal and multiplied by the unit's exact factor; only the product is rounded. So "40 mm", "4 cm" and
"0.04 m" are the same float, wherever the factor comes from: the table of plain units below (microseconds, no import) or pint's registry
(every unit that pint knows; half a second, once, when first needed).
"""

import difflib
import math
import re
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

from magmpm.errors import InputError, install, installed, quantity

# pi to 50 digits: degrees keep an exact rational factor, rounded once with the number
_PI = Fraction("3.1415926535897932384626433832795028841971693993751")


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: its name in messages, its SI unit, an example, the factors of its plain units.

    related: units of a quantity that people give in its place, each with the factor to this one's SI unit, and what is multiplied.
    """

    name: str
    si: str
    example: str
    plain: dict[str, Fraction]
    related: dict[str, tuple[float, str]] = field(default_factory=dict)


def _powers(base: str, **prefixes: int) -> dict[str, Fraction]:
    """{prefix + base: 10**power}; the keyword `none` stands for no prefix."""
    return {("" if p == "none" else p) + base: Fraction(10) ** n for p, n in prefixes.items()}


def _each(factor: Fraction | int, *units: str) -> dict[str, Fraction]:
    """{unit: factor}, for several ways to write a unit."""
    return dict.fromkeys(units, Fraction(factor))


_MILLI = Fraction(1, 1000)
# the gauss is not in pint's SI context, but a gauss of flux density is 1e-4 T to everybody
_FLUX_DENSITY = {
    **_powers("T", none=0, m=-3, u=-6, µ=-6),
    **_powers("G", none=-4, m=-7, k=-1),
    "gauss": Fraction(1, 10**4),
}
_MU0 = 4e-7 * math.pi  # T m/A, as magmpm.fields.dipole has it, which this layer can't import
# Magnetization and field strength, also in units of Gauss: M in emu/cm^3 is 1e3 A/m, H in Oe 1e3/(4 pi) A/m.
_MAGNETIZATION = {
    **{
        unit: (float(factor) * _MU0, "mu0 times it")
        for unit, factor in _powers("A/m", none=0, k=3, M=6).items()
    },
    **dict.fromkeys(("emu/cm^3", "emu/cm3", "emu/cc"), (1e3 * _MU0, "4 pi times it, in gauss")),
    "Oe": (1e-4, "as many gauss"),
    "kOe": (1e-1, "as many kilogauss"),
}
_DENSITY = _each(1, "kg/m^3", "kg/m**3", "kg/m³") | _each(1000, "g/cm^3", "g/cm**3", "g/cm³")
_MOMENT = _each(1, "A*m^2", "A m^2", "A m²") | _each(_MILLI, "mA*m^2", "mA m^2", "mA m²")
KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "length",
            "m",
            "40 mm",
            {**_powers("m", none=0, c=-2, m=-3, u=-6, µ=-6), "in": Fraction(254, 10000)},
        ),
        Kind(
            "pressure",
            "Pa",
            "120 kPa",
            {**_powers("Pa", none=0, k=3, M=6, G=9), "bar": Fraction(10**5)},
        ),
        Kind("density", "kg/m^3", "1882 kg/m^3", _DENSITY),
        Kind("flux density", "T", "8 mT", _FLUX_DENSITY, _MAGNETIZATION),
        Kind("angle", "rad", "30 deg", _each(1, "rad") | _each(_PI / 180, "deg", "°", "degree")),
        Kind(
            "acceleration",
            "m/s^2",
            "9.81 m/s^2",
            _each(1, "m/s^2", "m/s**2", "m/s²") | _each(_MILLI, "mm/s^2"),
        ),
        Kind("time", "s", "5 ms", _powers("s", none=0, m=-3, u=-6, µ=-6)),
        Kind("rate", "1/s", "60 1/s", _each(1, "1/s", "s^-1")),
        Kind("speed", "m/s", "5 mm/s", _powers("m/s", none=0, c=-2, m=-3)),
        Kind("viscosity", "Pa s", "5 Pa s", _each(1, "Pa s", "Pa*s") | _each(_MILLI, "mPa s")),
        Kind("size", "B", "2 GB", _powers("B", none=0, k=3, M=6, G=9, T=12)),
        Kind("frequency", "Hz", "2 Hz", {**_powers("Hz", none=0, k=3, m=-3), "1/s": Fraction(1)}),
        Kind("current", "A", "2 A", _powers("A", none=0, k=3, m=-3)),
        Kind("force", "N", "20 mN", _powers("N", none=0, m=-3, u=-6, µ=-6)),
        Kind("percentage", "times 1", "5 %", _each(Fraction(1, 100), "%", "percent")),
        Kind("magnetic moment", "A*m^2", "0.5 A*m^2", _MOMENT),
        Kind("volume", "m^3", "20 mm^3", _powers("m^3", none=0, c=-6, m=-9)),
        Kind("field energy", "T^2 s", "40 mT^2 s", _powers("T^2 s", none=0, m=-6)),
    )
}

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_NOT_FINITE = re.compile(r"[+-]?\.?(?:nan|inf|infinity)\b", re.IGNORECASE)
MOST_UNIT = 40  # characters of a unit, also in messages
# three-digit or chained exponents name no unit, and would let pint raise factors to absurd powers
_ABSURD_UNIT = re.compile(r"\d{3}|(?:\*\*|\^)[^*/ ]*(?:\*\*|\^)")


class BadQuantity(ValueError):
    """Text that is not a quantity of the kind wanted; `rule` says what is expected, `remedy` what to write.

    meant: the value in SI, where the text gives a related quantity; None otherwise.
    """

    def __init__(self, rule: str, remedy: str, meant: float | None = None) -> None:
        super().__init__(f"{rule}; {remedy}")
        self.rule = rule
        self.remedy = remedy
        self.meant = meant


def parse_quantity(text: str, kind: Kind) -> float:
    """SI value of `text`, a number and a unit, as the nearest float.

    Raises BadQuantity: no number, no unit, an unknown unit, another dimension, or a value that is not finite.
    """
    text = text.strip()
    write = f'write a number and a unit, such as "{kind.example}"'
    if _NOT_FINITE.match(text):
        raise BadQuantity(f"{a(kind.name)} must be a finite number", write)
    number = _NUMBER.match(text)
    if number is None:
        raise BadQuantity(f"{a(kind.name)} must begin with a number", write)
    unit = text[number.end() :].strip()
    if not unit:
        raise BadQuantity(
            f"{a(kind.name)} needs a unit",
            f'add one, such as "{number.group()[:MOST_UNIT]} {kind.example.split()[1]}"',
        )
    if unit.startswith("/"):
        unit = f"1{unit}"
    if unit[0] == "," or (unit[0].isdigit() and not unit.startswith("1/")):
        raise BadQuantity("a number has a decimal point and no separators", write)
    magnitude = float(number.group())
    if unit in kind.related:
        factor, words = kind.related[unit]
        raise BadQuantity(
            f'{a(kind.name)} is expected here, and "{unit}" is not a unit of {kind.name}',
            f'write {words}: "{quantity(magnitude * factor, kind.si, 4)}"',
            magnitude * factor,
        )
    is_zero = not re.search("[1-9]", number.group().lower().split("e")[0])
    if not math.isfinite(magnitude) or (abs(magnitude) < 1e-290 and not is_zero):
        raise BadQuantity(f"{a(kind.name)} must be a finite number that a computer can hold", write)
    if is_zero:
        _factor(unit, kind)  # zero needs a valid unit too
        return 0.0
    try:
        return float(Fraction(number.group()) * _factor(unit, kind))
    except OverflowError:
        raise BadQuantity(f"{a(kind.name)} must be a finite number", write) from None


def divided(given: object) -> tuple[float, str] | None:
    """A quantity's number and its unit, "" of a plain number; None of what is no quantity."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return float(given), ""
    match = _NUMBER.match(given.strip()) if isinstance(given, str) else None
    if match is None or not isinstance(given, str):
        return None
    return float(match[0]), given.strip()[match.end() :].strip()


def kind_of(unit: str) -> str:
    """The name of the first kind of quantity that has a unit, "" where none has."""
    return next((name for name, kind in KINDS.items() if unit in kind.plain), "")


def in_si(value: float | str, kind: str, what: str) -> float:
    """A number as it is, text with a unit in SI. Raises InputError, about `what`."""
    try:
        return parse_quantity(value, KINDS[kind]) if isinstance(value, str) else float(value)
    except BadQuantity as error:
        raise InputError(what, received=repr(value), rule=error.rule, remedy=error.remedy) from None


def as_text(si: float, kind: Kind) -> str:
    """A value in SI as text with a unit, which `parse_quantity` reads as the same float: in the unit of the kind's example where that is
    a whole power of ten of the SI unit, which a decimal number can be multiplied by without rounding.
    """
    unit = kind.example.split(maxsplit=1)[1]
    power = Decimal(kind.plain[unit].denominator) / kind.plain[unit].numerator
    if Fraction(power) * kind.plain[unit] != 1:  # an angle
        unit = kind.si
        power = Decimal(1)
    number = (Decimal(repr(float(si))) * power).normalize()
    return f"{number:{'f' if -9 < number.adjusted() < 9 else ''}} {unit}"


def a(noun: str) -> str:
    """The noun with its indefinite article."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def format_si(value: float, kind: Kind) -> str:
    """A value in SI for messages: 0.04 -> "0.04 m"."""
    return f"{value:.6g} {kind.si}"


@cache
def _factor_in_pint(unit: str, kind_name: str) -> Fraction:
    """Exact factor from `unit` to the kind's SI unit, by pint. Raises BadQuantity."""
    kind = KINDS[kind_name]
    write = f'use a unit such as in "{kind.example}"'
    if _ABSURD_UNIT.search(unit) or len(unit) > MOST_UNIT:
        raise BadQuantity(f'"{unit[:MOST_UNIT]}" is not a unit', write)
    if not installed("pint"):
        raise BadQuantity(
            f'"{unit}" is not one of {", ".join(kind.plain)}; other units need the package pint,'
            " which is not installed",
            _nearest_unit(unit, kind) or f"write one of these, or {install('units')}",
        )
    registry = _registry()
    import pint

    try:
        found = registry.parse_units(unit)
        wanted = registry.parse_units(kind.si)
        names = set(found._units)
        same = found.dimensionality == wanted.dimensionality
    except pint.UndefinedUnitError:
        raise BadQuantity(
            f'"{unit}" is not a known unit', _nearest_unit(unit, kind) or write
        ) from None
    except Exception:  # pint's tokenizer raises half a dozen types for text that is not a unit
        raise BadQuantity(f'"{unit}" is not a unit', write) from None
    # an angle has no dimension for pint, and neither has a percentage: ask for a unit of angle by name
    if kind.name == "angle" and not names <= _ANGLES:
        same = False
    if kind.name == "frequency" and names & (_ANGLES | _ANGULAR):  # 1 rad/s is not 1 Hz
        same = False
    if not same:
        raise BadQuantity(
            f'{a(kind.name)} is expected here, and "{unit}" is not a unit of {kind.name}',
            _nearest_unit(unit, kind) or write,
        )
    factor = registry.convert(Fraction(1), found, wanted)
    return factor if isinstance(factor, Fraction) else Fraction(factor)


_ANGLES = {
    "radian",
    "degree",
    "turn",
    "arcminute",
    "arcsecond",
    "grade",
    "milliradian",
    "microradian",
}
_ANGULAR = {"revolutions_per_minute", "revolutions_per_second", "count_per_second"}


def _factor(unit: str, kind: Kind) -> Fraction:
    """Exact factor from `unit` to the kind's SI unit. Raises BadQuantity."""
    plain = kind.plain.get(unit)
    if (
        plain is None and kind.name == "percentage"
    ):  # pint would take any number without a dimension, such as degrees
        raise BadQuantity(
            f'a percentage is expected here, and "{unit[:MOST_UNIT]}" is not %',
            f'write, say, "{kind.example}"',
        )
    return plain if plain is not None else _factor_in_pint(unit, kind.name)


def _nearest_unit(unit: str, kind: Kind) -> str | None:
    """A remedy naming the plain unit that was probably meant, or None."""
    known = {name.lower(): name for name in reversed(kind.plain)}
    near = difflib.get_close_matches(unit.lower(), known, n=1, cutoff=0.7)
    return f'did you mean "{known[near[0]]}"?' if near else None


@cache
def _registry() -> Any:
    """pint's registry, with exact rational factors; loaded when the first unit outside the table is met."""
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)
