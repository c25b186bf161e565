"""Quantities: the exact decimal times the exact factor, rounded once, for both sources of the factor."""

from __future__ import annotations

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
    if unit not in {"G", "mG", "kG", "gauss"} and kind.name != "percentage"  # never read by pint, for which it has no dimension
]


@pytest.mark.parametrize(("kind", "unit"), PLAIN)
def test_the_table_has_pints_own_factors(kind: str, unit: str) -> None:
    table, pint = KINDS[kind].plain[unit], units._factor_in_pint(unit, kind)
    # exactly, except angles: pint's pi has fewer digits than that of the table, both far more than a float
    assert table == pint or (kind == "angle" and abs(table / pint - 1) < Fraction(1, 10**30))


@settings(max_examples=200, deadline=None)
@given(number=st.decimals(-(10**9), 10**9, allow_nan=False, places=7), which=st.sampled_from(PLAIN))
def test_table_and_pint_give_the_same_float(number: object, which: tuple[str, str]) -> None:
    kind, unit = which
    exact = Fraction(str(number)) * units._factor_in_pint(unit, kind)
    assert parse_quantity(f"{number} {unit}", KINDS[kind]) == float(exact)


@pytest.mark.parametrize(
    ("kind", "text", "si"),
    [
        ("length", "40 mm", 0.04),
        ("percentage", "5 %", 0.05),
        ("percentage", "2.5 percent", 0.025),
        ("length", "40mm", 0.04),
        ("length", " 4.0e1  mm ", 0.04),
        ("length", "4 cm", 0.04),
        ("length", ".04 m", 0.04),
        ("length", "+40000 um", 0.04),
        ("length", "40 millimeters", 0.04),
        ("length", "1 inch", 0.0254),
        ("rate", "60 1/s", 60.0),
        ("rate", "60 /s", 60.0),
        ("rate", "0.06 1/ms", 60.0),
        ("speed", "5 mm/s", 0.005),
        ("frequency", "2 Hz", 2.0),
        ("frequency", "120 1/min", 2.0),
        ("current", "5000 mA", 5.0),
        ("magnetic moment", "0.5 A m^2", 0.5),
        ("magnetic moment", "500 mA*m^2", 0.5),
        ("magnetic moment", "0.5 J/T", 0.5),
        ("viscosity", "5 Pa s", 5.0),
        ("viscosity", "5000 mPa*s", 5.0),
        ("pressure", "120 kPa", 120e3),
        ("pressure", "0.12 N/mm^2", 120e3),
        ("pressure", "1 psi", 6894.757293168361),
        ("density", "1.882 g/cm^3", 1882.0),
        ("density", "1882 kg m^-3", 1882.0),
        ("density", "1.882 g/ml", 1882.0),
        ("flux density", "-8 mT", -8e-3),
        ("flux density", "80 G", 8e-3),
        ("flux density", "80 gauss", 8e-3),
        ("flux density", "80000 mG", 8e-3),
        ("flux density", "0.08 kG", 8e-3),
        ("flux density", "8 millitesla", 8e-3),
        ("angle", "180 deg", math.pi),
        ("angle", "0.5 turn", math.pi),
        ("angle", "-30°", -math.pi / 6),
        ("acceleration", "9.81 m/s^2", 9.81),
        ("acceleration", "1 standard_gravity", 9.80665),
        ("time", "5 ms", 5e-3),
    ],
)
def test_values(kind: str, text: str, si: float) -> None:
    # exact, except where the expected value itself is rounded: psi above, pi in Python's floats
    exact = kind != "angle" and "psi" not in text
    assert parse_quantity(text, KINDS[kind]) == (si if exact else pytest.approx(si, rel=1e-15))


def test_decimals_are_not_degraded_by_the_unit() -> None:
    # in floats 4.1 * 1e-3 is 0.0040999999999999995, not the written value
    for text, si in (("4.1 mm", 0.0041), ("0.3 mT", 0.0003), ("1.1 um", 1.1e-6), ("70 mT", 0.07)):
        assert parse_quantity(text, KINDS["length" if text.endswith("m") else "flux density"]) == si


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", "must begin with a number"),
        ("mm", "must begin with a number"),
        ("40", "needs a unit"),
        ("40 kg", "is not a unit of length"),
        ("40 furlongsx", "not a known unit"),
        ("40 mm/", "is not a unit"),
        ("40 mm)", "is not a unit"),
        ("40 $", "is not a unit"),
        ("40 mm mm", "is not a unit of length"),
        ("40 000 mm", "decimal point"),
        ("40,0 mm", "decimal point"),
        ("1e999 mm", "finite"),
        ("1e-999999999 mm", "finite"),
        ("nan mm", "finite"),
        ("-inf mm", "finite"),
        ("0 kg", "is not a unit of length"),
        ("1 mm**9**9**9**9", "is not a unit"),
        ("1 " + "m" * 100, "is not a unit"),
    ],
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
