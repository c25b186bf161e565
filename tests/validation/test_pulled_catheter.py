"""Catheters in nonuniform fields: against the rod, against other descriptions of the same field, and without an equilibrium."""

import base64
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.errors import InputError, SolveError
from magmpm.fields.measured_map import Grid3
from magmpm.model import build
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run

pytest.importorskip("magpylib")
ROOT = Path(__file__).parents[2]
L = 40e-3
MAGNET = {
    "cylinder": {"diameter": 20e-3, "length": 20e-3},
    "position": (75e-3, 0.0, 20e-3),
    "axis": (1.0, 0.0, 0.0),
    "remanence": 1.3,
}


def pulled(field: dict[str, Any], **more: Any) -> Scene:
    data = rod_scene(length=L, **more).to_si()
    named = {**data["effects"], "magnetic_torque": {}, "magnetic_force": {}}
    return Scene.from_si({**data, "field": field, "effects": named})


CASES = {
    "beside and beyond": {"magnet": MAGNET},
    "repelled": {"magnet": {**MAGNET, "position": (30e-3, 5e-3, 45e-3)}},
    "coil": {
        "coils": {
            "position": (80e-3, 0, 20e-3),
            "axis": (0.6, 0, 0.8),
            "diameter": 60e-3,
            "current": 20.0,
            "turns": 300,
        }
    },
    "inside a coil": {
        "coils": {
            "position": (20e-3, 0, 0),
            "axis": (0, 0, 1),
            "diameter": 120e-3,
            "current": 10.0,
            "turns": 300,
        }
    },
    "dipole in a uniform field": {
        "uniform": (0, 4e-3, 0),
        "dipole": {"position": (70e-3, 0, 15e-3), "moment": (4.0, 0, 0), "diameter": 18e-3},
    },
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name == "beside and beyond" else name
        for name in CASES
    ],
)
def test_rod_and_solve_agree(name: str) -> None:
    """Two models with two methods for the field: the tips agree within 0.7 % of the length at 2 cells across (0.2 to 1 % in uniform
    fields). The solve starts near enough to end in a few Newton steps, the last of which converge quadratically.
    """
    scene = pulled(CASES[name])
    decrements = []
    found = run(scene, on_progress=lambda step, decrement: decrements.append(decrement))
    rod = solve_rod(scene)
    bend = np.linalg.norm(found.tip - [L, 0, 0])
    assert bend > 0.04 * L, "the field acts"
    assert np.linalg.norm(found.tip - rod.position[-1]) < 0.007 * L
    assert found.iterations <= 6
    assert not found.warnings
    # Energy decrements are squares of steps: quadratic convergence squares them, up to a constant given by the first pair.
    for before, after in pairwise(decrements[1:]):
        assert after < max(50 * decrements[1] / decrements[0] ** 2, 50) * before**2


def test_a_measured_map_gives_the_magnets_answer() -> None:
    """The example map, with 4 mm spacing and the noise of a Hall probe, against the magnet itself: 0.1 % of the length."""
    magnet, field_map = (
        load_scene(ROOT / f"data/scenes/pulled_by_{kind}.yaml").with_cells(2)
        for kind in ("magnet", "map")
    )
    one = run(magnet)
    other = run(field_map)
    assert np.linalg.norm(one.tip - other.tip) < 1e-3 * L
    assert not other.warnings


def test_a_magnet_as_table_cloud_and_dipole() -> None:
    """The same magnet as a table; as a cloud of dipoles, if it rotates (here by a full turn); from twice the distance, as one dipole."""
    table = run(pulled({"magnet": MAGNET}))
    field = {"magnet": MAGNET}
    once = {
        "rotation": {
            "axis": (0, 0, 1),
            "frequency": 1.0,
            "turns": 1.0,
            "center": MAGNET["position"],
        }
    }
    turning = pulled({**field, "over_time": once})
    assert turning.external_field().data[0] > 1, "dipoles"
    assert turning.external_field().data[1] == 0, "no table"
    cloud = run(turning)
    assert np.linalg.norm(cloud.tip - table.tip) < 1e-4 * L
    away = (110e-3, 0.0, 20e-3)
    moment = (1.3 * np.pi * 1e-4 * 20e-3 / (4e-7 * np.pi), 0, 0)
    far = run(pulled({"magnet": {**MAGNET, "position": away}}))
    dipole = run(pulled({"dipole": {"position": away, "moment": moment}}))
    apart = np.linalg.norm(far.tip - dipole.tip)
    assert apart < 0.02 * np.linalg.norm(far.tip - [L, 0, 0]), (
        "(radius/distance)^2, the magnet's next moment"
    )


def test_a_catheter_that_snaps_to_the_magnet_is_an_error_that_says_so() -> None:
    """A strong pull from 20 mm leaves no equilibrium before contact: the message names the magnet and where the body met it."""
    with pytest.raises(
        SolveError,
        match=r"the body's point at .* mm is (inside|outside of the box where) field.magnet",
    ):
        run(pulled({"magnet": {**MAGNET, "position": (30e-3, 0, 32e-3), "axis": (0, 0, 1)}}))


def test_a_magnet_in_the_body_is_refused() -> None:
    says = (
        r"field.magnet: the magnet, center .* mm, is in the box around the body.*\n  rule: the"
        r" undeformed body must be outside of"
    )
    with pytest.raises(InputError, match=says):
        run(pulled({"magnet": {**MAGNET, "position": (45e-3, 0, 0)}}))


def test_a_map_that_does_not_cover_the_body_is_refused() -> None:
    scene = load_scene(ROOT / "data/scenes/pulled_by_map.yaml")
    data = scene.to_si()
    data["field"]["map"]["position"] = (60e-3, 0, 20e-3)
    says = (
        r"field.map: the map reaches over -30 to 42, -28 to 28, -8 to 48 mm, and lacks 2 mm along"
        r" x\n  rule: .* 0 to 40, .*margin"
    )
    with pytest.raises(InputError, match=says):
        run(Scene.from_si(data))


def test_a_map_that_covers_the_body_to_rounding_is_taken() -> None:
    """Grid planes with errors of a millionth of a millimeter, as in tables with rounded coordinates."""
    data = load_scene(ROOT / "data/scenes/pulled_by_map.yaml").with_cells(2).to_si()
    grid = data["field"]["map"]["table"]
    data["field"]["map"]["position"][0] -= (
        grid["lower"][0] + data["field"]["map"]["position"][0] + grid["spacing"][0]
    )  # exactly the margin
    build(Scene.from_si(data))
    data["field"]["map"]["position"][0] += 1e-9
    build(Scene.from_si(data))
    data["field"]["map"]["position"][0] += 0.01 * grid["spacing"][0]
    with pytest.raises(InputError, match=r"lacks 0\.0\d+ mm along x"):
        build(Scene.from_si(data))


def test_a_map_with_curl_is_warned_of() -> None:
    """A map with exchanged columns has a curl; its force would be wrong, and the run says by how much."""
    data = load_scene(ROOT / "data/scenes/pulled_by_map.yaml").with_cells(2).to_si()
    grid = Grid3.model_validate(data["field"]["map"]["table"])
    swapped = np.ascontiguousarray(grid.array()[..., [1, 0, 2]])
    data["field"]["map"]["table"]["values"] = base64.b64encode(
        swapped.astype("<f8").tobytes()
    ).decode()
    told = Scene.from_si(data).external_field().warnings
    assert len(told) == 2
    assert "curl" in told[0]
    assert "divergence" in told[1]
    assert not load_scene(ROOT / "data/scenes/pulled_by_map.yaml").external_field().warnings
