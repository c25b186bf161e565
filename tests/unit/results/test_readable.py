"""What readers see: numbers by significant digits and prefixes, never -0; scenes and results as notebooks draw them."""

import dataclasses
import math
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import magmpm
from magmpm.errors import count, fixed, length, lengths, quantity, significant, stability_in_words


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.01234, "0.0123"),
        (41.0, "41.0"),
        (1234.0, "1230"),
        (9.996, "10.0"),
        (0.0, "0"),
        (-0.5, "-0.500"),
        (3.912e-5, "3.91e-05"),
        (1e7, "1.00e+07"),
    ],
)
def test_significant(value: float, text: str) -> None:
    assert significant(value) == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1e-12, "s", "1.00 ps"),
        (3.91e-5, "s", "39.1 µs"),
        (0.3, "s", "300 ms"),
        (2.0, "s", "2.00 s"),
        (0.006, "T", "6.00 mT"),
        (0.9999, "T", "1.00 T"),
        (999.9e-6, "T", "1.00 mT"),
        (0.0, "J", "0 J"),
        (-4.2e-8, "J", "-42.0 nJ"),
        (1e-30, "J", "1.00e-12 aJ"),
    ],
)
def test_quantity(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_lengths_share_a_unit_that_shows_them() -> None:
    assert lengths([0.03867, -1e-9, 0.010366]) == "(38.670, 0.000, 10.366) mm"
    assert lengths([1e-18, 0.0, 0.0]) == "(0.000, 0.000, 0.000) mm"  # rounding
    assert lengths([20e-9, 0.0, -1.5e-9]) == "(20.000, 0.000, -1.500) nm", (
        "a body of 20 nm is not 0.000 mm long"
    )
    assert lengths([0.0, 0.0, 0.0]) == "(0.000, 0.000, 0.000) mm"
    assert lengths([math.nan, 0.001, 0.0]) == "(nan, 1.000, 0.000) mm"


def test_length_of_a_bar() -> None:
    assert [length(value) for value in (0.01, 2e-3, 1e-4, 5e-9)] == [
        "10 mm",
        "2 mm",
        "0.1 mm",
        "5 nm",
    ]


def test_fixed_has_no_negative_zero() -> None:
    assert [fixed(value, 0) for value in (-0.3, 0.4, -12.6)] == ["0", "0", "-13"]


@given(st.floats(1e-15, 1e9), st.sampled_from([2, 3, 5]))
def test_nothing_is_lost_but_digits(value: float, digits: int) -> None:
    """The text, read back, gives the value to its digits."""
    assert float(significant(value, digits)) == pytest.approx(value, rel=0.6 * 10.0 ** (1 - digits))
    number, unit = quantity(value, "s", digits).split()
    factor = {
        "f": 1e-15,
        "p": 1e-12,
        "n": 1e-9,
        "µ": 1e-6,
        "m": 1e-3,
        "": 1.0,
        "k": 1e3,
        "M": 1e6,
        "G": 1e9,
    }[unit[:-1]]
    assert float(number) * factor == pytest.approx(value, rel=0.6 * 10.0 ** (1 - digits))


def test_things_are_counted_in_words() -> None:
    assert [count(number, "jump") for number in (0, 1, 2)] == ["0 jumps", "1 jump", "2 jumps"]


def test_more_than_1_of_stability_is_explained() -> None:
    assert stability_in_words(1.41).startswith("1.410 (")
    assert "more than 1: the load stiffens it" in stability_in_words(1.41)


ROOT = Path(__file__).resolve().parents[3]
SCENE = ROOT / "data/scenes/axial_transverse.yaml"


def picture(thing: object) -> ElementTree.Element:
    """The picture that it shows, which must be whole XML."""
    return ElementTree.fromstring(f"<div>{thing._repr_html_()}</div>")  # type: ignore[attr-defined]


def test_a_result_shows_its_axis_and_figures() -> None:
    """The end of the picture axis lies where the tip is, to scale; a failed one says so; names can't break it."""
    scene = magmpm.load_scene(SCENE).with_cells(2)
    result = dataclasses.replace(magmpm.run(scene), name="a <b> & c")
    found = picture(result)
    text = " ".join(found.itertext())
    assert "a <b> & c" in text
    assert f"({1e3 * result.tip[0]:.3f}, " in text
    lines = [
        each
        for each in found.iter()
        if each.tag.endswith("polyline") and "dasharray" not in str(each.attrib)
    ]
    side = np.array(
        [[float(x) for x in pair.split(",")] for pair in lines[0].get("points", "").split()]
    )
    moved = side[-1] - side[0]
    axis = result.centreline[-1, 1:] - result.centreline[0, 1:]
    assert abs(moved[0] / -moved[1] - axis[0] / axis[2]) < 0.02 * abs(
        axis[0] / axis[2]
    )  # pixels are rounded to a tenth
    failed = dataclasses.replace(result, converged=False, failure="no equilibrium")
    assert "no equilibrium" in " ".join(picture(failed).itertext())


def test_scenes_of_all_kinds_draw_themselves() -> None:
    for path in sorted((ROOT / "data/scenes").rglob("*.yaml")):
        scene = magmpm.load_scene(path)
        text = " ".join(picture(scene).itertext())
        assert scene.name in text
        assert "side: x right, z up" in text


def test_no_picture_library_is_loaded() -> None:
    code = (
        f"import sys, magmpm; magmpm.load_scene({str(SCENE)!r})._repr_html_();"
        " print(sorted({'matplotlib', 'pyvista', 'vtk', 'viz', 'IPython', 'PIL'} &"
        " set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"\[\]\s*", done.stdout)
