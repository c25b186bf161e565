"""Rules for scenes of equilibria along time: keys that they need, and keys that they must not have."""

import re
from pathlib import Path

import pytest

from magmpm import Scene, load_scene
from magmpm.errors import InputError

GOOD = """\
name: probe
materials:
  silicone: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1100 kg/m^3, remanence: 138 mT}
body:
  catheter: {length: 20 mm, diameter: 2 mm, material: silicone, segments: [{magnetization: [1, 0, 0]}]}
field:
  uniform: [0 mT, 0 mT, 3 mT]
  over_time: {ramp: {duration: 1 s}}
effects:
  magnetic_torque: {}
solver:
  quasi_static: {steps: 4}
"""
OVER = "  over_time: {ramp: {duration: 1 s}}\n"
FEED = "  magnetic_torque: {}\n  feed: {speed: 10 mm/s, exit: 15 mm}\n"


def read(tmp_path: Path, *edits: tuple[str, str]) -> Scene:
    text = GOOD
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    return load_scene(path)


def test_times_are_steps_of_the_schedule_or_given(tmp_path: Path) -> None:
    assert read(tmp_path).path_times() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert read(tmp_path, ("steps: 4", "steps: 2, duration: 3 s")).path_times() == [0.0, 1.5, 3.0]
    scene = read(tmp_path, ("steps: 4", "at: [100 ms, 0.4 s]"))
    assert scene.path_times() == [0.1, 0.4]
    assert scene.duration == 0.4
    assert scene.static
    assert scene.in_time
    assert Scene.from_si(scene.to_si()) == scene
    assert "2 equilibria over 0.4 s" in repr(scene)


def test_feed_may_be_named(tmp_path: Path) -> None:
    scene = read(
        tmp_path,
        (OVER, ""),
        ("  magnetic_torque: {}\n", FEED),
        ("steps: 4", "steps: 4, duration: 0.5 s"),
    )
    assert scene.path_times()[-1] == 0.5


@pytest.mark.parametrize(
    ("edits", "says"),
    [
        (
            [("steps: 4", "steps: 4}\n  static: {tolerance: 1e-9")],
            ["one of them", "`static` and `quasi_static`", "remove one"],
        ),
        (
            [("steps: 4", "steps: 4}\n  dynamic: {duration: 1 s")],
            ["one of them", "`quasi_static` and `dynamic`"],
        ),
        ([("{steps: 4}", "{}")], ["`steps` or `at`", "`quasi_static: {steps: 40}`"]),
        ([("steps: 4", "steps: 4, at: [0 s, 1 s]")], ["`at` says when", "remove `at` or `steps`"]),
        ([("steps: 4", "at: [0 s, 1 s], duration: 1 s")], ["`at` says when", "`duration`"]),
        (
            [("steps: 4", "at: [0 s, 0.5 s, 0.2 s]")],
            [r"at\[2\]", "times must rise", "0.2 s follows 0.5 s", "sort them"],
        ),
        ([("steps: 4", "at: [0 s]")], ["at", "2 or more entries", "`at: [0 s"]),
        ([("steps: 4", "steps: 0")], ["steps", "0"]),
        ([(OVER, "")], ["nothing changes", "the field has no schedule", "over_time", "static"]),
        ([("steps: 4", "at: [2 s, 3 s]")], ["nothing changes", "the same at all of its times"]),
        (
            [("  magnetic_torque: {}", "  gravity: {}")],
            ["nothing changes", "no effect of the field is named"],
        ),
        (
            [("ramp: {duration: 1 s}", "rotation: {frequency: 2 Hz}")],
            ["rotation has no end", "add `duration`", "`at`"],
        ),
        ([(OVER, ""), ("  magnetic_torque: {}\n", FEED)], ["feed has no end", "add `duration`"]),
        (
            [("  magnetic_torque: {}\n", FEED), ("steps: 4", "steps: 4, duration: 2 s")],
            ["stay in the guide", "-5 mm are left after 2 s"],
        ),
        (
            [("  magnetic_torque: {}", "  magnetic_torque: {}\n  damping: {rate: 5 1/s}")],
            ["damping acts in motion", "equilibria along"],
        ),
        (
            [("quasi_static: {steps: 4}", "static: {}"), ("  magnetic_torque: {}\n", FEED)],
            ["feed acts in motion only", "quasi_static"],
        ),
    ],
)
def test_what_is_wrong_is_said(
    tmp_path: Path, edits: list[tuple[str, str]], says: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, *edits)
    message = str(caught.value)
    for phrase in says:
        assert re.search(phrase if "\\" in phrase else re.escape(phrase), message), message
