"""Scenes, results and motions as notebooks show them: well-formed, true, and drawn without a picture library."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

import magmpm

ROOT = Path(__file__).resolve().parents[3]
SCENE = ROOT / "data/scenes/axial_transverse.yaml"


def drawn(thing: object) -> ElementTree.Element:
    """The picture that it shows, which must be whole XML."""
    return ElementTree.fromstring(f"<div>{thing._repr_html_()}</div>")  # type: ignore[attr-defined]


def test_a_result_shows_its_axis_and_figures() -> None:
    """The end of the drawn axis lies where the tip is, to scale; a failed one says so; names can't break it."""
    scene = magmpm.load_scene(SCENE).with_cells(2)
    result = dataclasses.replace(magmpm.run(scene), name="a <b> & c")
    found = drawn(result)
    text = " ".join(found.itertext())
    assert "a <b> & c" in text
    assert f"({1e3 * result.tip[0]:.3f}, " in text
    lines = [each for each in found.iter() if each.tag.endswith("polyline") and "dasharray" not in str(each.attrib)]
    side = np.array([[float(x) for x in pair.split(",")] for pair in lines[0].get("points", "").split()])
    moved, axis = side[-1] - side[0], result.centreline[-1, 1:] - result.centreline[0, 1:]
    assert abs(moved[0] / -moved[1] - axis[0] / axis[2]) < 0.02 * abs(axis[0] / axis[2])  # pixels are rounded to a tenth
    failed = dataclasses.replace(result, converged=False, failure="no equilibrium")
    assert "no equilibrium" in " ".join(drawn(failed).itertext())


def test_scenes_of_all_kinds_draw_themselves() -> None:
    for path in sorted((ROOT / "data/scenes").rglob("*.yaml")):
        scene = magmpm.load_scene(path)
        text = " ".join(drawn(scene).itertext())
        assert scene.name in text
        assert "side: x right, z up" in text


def test_no_picture_library_is_loaded() -> None:
    code = (
        f"import sys, magmpm; magmpm.load_scene({str(SCENE)!r})._repr_html_(); "
        "print(sorted({'matplotlib', 'pyvista', 'vtk', 'viz', 'IPython', 'PIL'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"\[\]\s*", done.stdout)
