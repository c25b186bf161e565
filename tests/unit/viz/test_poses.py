"""Picture of a schedule: every time has its body, its target and its field in words."""

from typing import Any

import numpy as np
import pytest

from magmpm.cli.design import several_snapshot
from magmpm.scene import Scene
from magmpm.studies.evaluate.trajectory import SHAPES, shapes_of
from magmpm.viz.camera import Framing
from magmpm.viz.snapshot import Snapshot

LENGTH = 0.03
WIDTH = 5e-3
THICKNESS = 1e-3
SEGMENTS = [
    {"magnetization": [0, 0, 0]},
    {"magnetization": [1, 0, 0]},
    {"magnetization": [0, 0, 1]},
]
BODIES: dict[str, dict[str, Any]] = {
    "strip": {
        "length": LENGTH,
        "width": WIDTH,
        "thickness": THICKNESS,
        "material": "silicone",
        "segments": SEGMENTS,
    },
    "catheter": {"length": LENGTH, "diameter": 2e-3, "material": "silicone", "segments": SEGMENTS},
}


def scene(kind: str) -> Scene:
    silicone = {"shear_modulus": 120e3, "bulk_to_shear": 20, "density": 1882.0, "remanence": 0.138}
    return Scene.from_si(
        {"name": "of the scene", "materials": {"silicone": silicone}, "body": {kind: BODIES[kind]}}
    )


def pose(time: float, field: float, turn: float) -> dict[str, Any]:
    """An arc in the plane of x and z that turns by an angle, rad, on its target."""
    s = np.linspace(0.0, 1.0, 25)
    axis = LENGTH / turn * np.column_stack([np.sin(turn * s), 0 * s, 1 - np.cos(turn * s)])
    about = {"time_s": time, "field_T": [0.0, 0.0, field], "target_m": axis[4::4].tolist()}
    return {
        **about,
        "axis_m": axis.tolist(),
        "centers_m": axis[[4, 12, 20]].tolist(),
        "remanence_T": (0.138 * np.eye(3)).tolist(),
    }


POSES = [pose(1.0, 5e-3, 0.5), pose(2.5, 10e-3, -1.0)]


def shown(kind: str) -> Snapshot:
    kept = {"schedule": [], SHAPES: POSES}
    return several_snapshot(
        "c to s", scene(kind).to_si(), np.zeros((2, 4)), shapes_of(kept), 7, 1e-3
    )


@pytest.mark.parametrize("kind", ["strip", "catheter"])
def test_every_time_is_there_and_labeled(kind: str) -> None:
    found = shown(kind)
    assert [text for text, _ in found.notes] == ["at 1 s: 5.0 mT", "at 2.5 s: 10.0 mT"]
    assert found.field is None, "an arrow of one time alone"
    np.testing.assert_allclose(
        found.fields[:, 1, 2] / found.fields[1, 1, 2], [0.5, 1.0], rtol=1e-12
    )  # in proportion, but for rounding
    assert found.caption() == "trial 7   rms 1.00 mm"
    Framing.of([found])


@pytest.mark.parametrize("kind", ["strip", "catheter"])
def test_bodies_stand_apart_each_on_its_target(kind: str) -> None:
    """The first body is at larger y, and between the two there is room; each has its target's dots on its axis."""
    found = shown(kind)
    assert found.target is not None
    middle = (found.target[:, 1].min() + found.target[:, 1].max()) / 2
    assert np.abs(found.body.points[:, 1] - middle).min() > 0.099 * LENGTH, (
        "a fifth of the length is left between, but for rounding"
    )
    for first in (True, False):
        body = found.body.points[(found.body.points[:, 1] > middle) == first]
        dots = found.target[(found.target[:, 1] > middle) == first]
        assert len(dots) > 3
        nearest = np.linalg.norm(body[:, None] - dots, axis=2).min(axis=0)
        # the surface is half a diameter, or half of thickness and width, away; rows of points are a 79th of the length apart
        assert nearest.max() < 0.5 * np.hypot(WIDTH, THICKNESS) + LENGTH / 79


def test_a_strip_keeps_its_section() -> None:
    """Across the arc its edges are as far apart as its width, and its faces as its thickness."""
    found = shown("strip")
    base = found.body.points[np.abs(found.body.points[:, 0]) < 1e-3 * LENGTH]
    first = base[base[:, 1] > base[:, 1].mean()]
    np.testing.assert_allclose(np.ptp(first[:, 1]), WIDTH, rtol=1e-6)  # single steps of rounding
    np.testing.assert_allclose(
        np.ptp(first[:, 2]), THICKNESS, rtol=1e-3
    )  # the first pieces of the arcs are inclined by 0.01 and 0.02 rad
