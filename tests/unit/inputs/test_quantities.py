"""Quantities: the exact decimal times the exact factor, rounded once, for both sources of the factor."""

import contextlib
import math
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmpm.inputs import quantities as units
from magmpm.inputs.quantities import KINDS, BadQuantity, parse_quantity

ROOT = Path(__file__).resolve().parents[3]

# pint gives the gauss a dimension of its own (Gaussian units), so only the table knows it as 1e-4 T
PLAIN = [
    (kind.name, unit)
    for kind in KINDS.values()
    for unit in kind.plain
    if unit not in {"G", "mG", "kG", "gauss"}
    and kind.name != "percentage"  # never read by pint, for which it has no dimension
]


@pytest.mark.parametrize(("kind", "unit"), PLAIN)
def test_the_table_has_pints_own_factors(kind: str, unit: str) -> None:
    table = KINDS[kind].plain[unit]
    pint = units._factor_in_pint(unit, kind)
    # exactly, except angles: pint's pi has fewer digits than that of the table, both far more than a float
    assert table == pint or (kind == "angle" and abs(table / pint - 1) < Fraction(1, 10**30))


@settings(max_examples=200, deadline=None)
@given(number=st.decimals(-(10**9), 10**9, allow_nan=False, places=7), which=st.sampled_from(PLAIN))
def test_table_and_pint_give_the_same_float(number: object, which: tuple[str, str]) -> None:
    kind, unit = which
    exact = Fraction(str(number)) * units._factor_in_pint(unit, kind)
    assert parse_quantity(f"{number} {unit}", KINDS[kind]) == float(exact)


VALUES = {
    "length": {
        0.04: ("40 mm", "40mm", " 4.0e1  mm ", "4 cm", ".04 m", "+40000 um", "40 millimeters"),
        0.0254: ("1 inch",),
    },
    "percentage": {0.05: ("5 %",), 0.025: ("2.5 percent",)},
    "rate": {60.0: ("60 1/s", "60 /s", "0.06 1/ms")},
    "speed": {0.005: ("5 mm/s",)},
    "frequency": {2.0: ("2 Hz", "120 1/min")},
    "current": {5.0: ("5000 mA",)},
    "magnetic moment": {0.5: ("0.5 A m^2", "500 mA*m^2", "0.5 J/T")},
    "viscosity": {5.0: ("5 Pa s", "5000 mPa*s")},
    "pressure": {120e3: ("120 kPa", "0.12 N/mm^2"), 6894.757293168361: ("1 psi",)},
    "density": {1882.0: ("1.882 g/cm^3", "1882 kg m^-3", "1.882 g/ml")},
    "flux density": {
        -8e-3: ("-8 mT",),
        8e-3: ("80 G", "80 gauss", "80000 mG", "0.08 kG", "8 millitesla"),
    },
    "angle": {math.pi: ("180 deg", "0.5 turn"), -math.pi / 6: ("-30°",)},
    "acceleration": {9.81: ("9.81 m/s^2",), 9.80665: ("1 standard_gravity",)},
    "time": {5e-3: ("5 ms",)},
}


@pytest.mark.parametrize(
    ("kind", "text", "si"),
    [(kind, text, si) for kind, of in VALUES.items() for si in of for text in of[si]],
)
def test_values(kind: str, text: str, si: float) -> None:
    # exact, except where the expected value itself is rounded: psi above, pi in Python's floats
    exact = kind != "angle" and "psi" not in text
    assert parse_quantity(text, KINDS[kind]) == (si if exact else pytest.approx(si, rel=1e-15))


def test_decimals_are_not_degraded_by_the_unit() -> None:
    # in floats 4.1 * 1e-3 is 0.0040999999999999995, not the written value
    for text, si in (("4.1 mm", 0.0041), ("0.3 mT", 0.0003), ("1.1 um", 1.1e-6), ("70 mT", 0.07)):
        assert parse_quantity(text, KINDS["length" if text.endswith("m") else "flux density"]) == si


BAD = {
    "must begin with a number": ("", "mm"),
    "needs a unit": ("40",),
    "is not a unit of length": ("40 kg", "40 mm mm", "0 kg"),
    "not a known unit": ("40 furlongsx",),
    "is not a unit": ("40 mm/", "40 mm)", "40 $", "1 mm**9**9**9**9", "1 " + "m" * 100),
    "decimal point": ("40 000 mm", "40,0 mm"),
    "finite": ("1e999 mm", "1e-999999999 mm", "nan mm", "-inf mm"),
}


@pytest.mark.parametrize(
    ("text", "rule"), [(text, rule) for rule, texts in BAD.items() for text in texts]
)
def test_bad_quantities(text: str, rule: str) -> None:
    with pytest.raises(BadQuantity, match=r".") as caught:
        parse_quantity(text, KINDS["length"])
    assert rule in caught.value.rule
    assert caught.value.remedy


@given(text=st.text(max_size=20))
def test_any_text_is_a_finite_number_or_a_bad_quantity(text: str) -> None:
    with contextlib.suppress(BadQuantity):
        assert math.isfinite(parse_quantity("1" + text, KINDS["length"]))


def test_percent_is_no_angle() -> None:
    with pytest.raises(BadQuantity, match="is not a unit of angle"):
        parse_quantity("30 %", KINDS["angle"])


def test_plain_units_need_no_pint() -> None:
    """A scene with plain units does not import pint, which takes half a second, nor the heavy parts of SciPy.

    Numba it does import, 0.2 s: an effect's settings and its hooks are one file."""
    code = (
        "import sys; from magmpm.scene import load_scene; load_scene('data/scenes/hollow.yaml'); "
        "scipy = {'scipy.' + part for part in ('linalg', 'spatial', 'interpolate', 'sparse')}; "
        "heavy = ({'pint', 'optuna', 'matplotlib', 'pyvista'} | scipy) & set(sys.modules); "
        "assert not heavy, heavy"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60, cwd=ROOT, env=environment)
