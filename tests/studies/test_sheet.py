"""A report's sheet of a design: tolerances by their definition, and the body that is to be made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from rod_solve import write_study

from magmpm.scene import Scene, load_scene
from magmpm.scene.variables import Variable, variables
from magmpm.studies.sheet.facts import describe_body, without_guide
from magmpm.studies.sheet.verified_best import allowed, together, tolerances


@dataclass
class Known:
    """Derivatives that a test chooses."""

    variables: tuple[Variable, ...]
    tip: np.ndarray


@pytest.fixture
def scene(tmp_path: object) -> Scene:
    return load_scene(write_study(tmp_path).with_name("scene.yaml"))  # type: ignore[arg-type]


def test_a_direction_counts_by_its_worst_turn(scene: Scene) -> None:
    """Two turns that move the tip the same way add as a vector: the worst turn is between them, by the root of two."""
    found = variables(scene, ["magnetization"])[:2]
    row, = tolerances(scene, Known(found, np.array([[0.01, 0.01], [0.0, 0.0], [0.0, 0.0]])))
    assert row["unit"] == "deg"
    assert row["tip_m_per_unit"] == pytest.approx(np.deg2rad(1.0) * 0.01 * np.sqrt(2))
    assert allowed(row, 0.4e-3) == pytest.approx(0.4e-3 / row["tip_m_per_unit"])
    assert allowed(row, 1.0) is None  # beyond what the first order says
    assert together([row]) == pytest.approx(np.sqrt(2) * 5 * row["tip_m_per_unit"])


def test_field_and_materials_count_by_their_own_size(scene: Scene) -> None:
    """A tip that follows the field: 1 % of it, and a turn of it; a material by its own value."""
    field, remanence = variables(scene, ["field"]), variables(scene, ["remanence"])
    rows = tolerances(scene, Known((*field, *remanence), np.hstack([np.eye(3), [[0.5], [0.0], [0.0]]])))
    by_name = {(row["what"], row["of"]): row["tip_m_per_unit"] for row in rows}
    assert by_name["strength", "field"] == pytest.approx(0.01 * 10e-3)  # m per T is one here, and the field 10 mT
    assert by_name["direction", "field"] == pytest.approx(np.deg2rad(1.0) * 10e-3)
    assert by_name["remanence", "magnetic"] == pytest.approx(0.01 * 0.138 * 0.5)


def test_segments_keep_their_numbers_where_the_first_are_in_the_guide(scene: Scene) -> None:
    found = variables(scene, ["magnetization"])[:2]
    row, = tolerances(scene, Known(found, np.ones((3, 2))), hidden=2)
    assert row["of"] == "segment 3"
    body = describe_body(scene)
    assert without_guide(body, len(body["segments"])) == body
    cut = without_guide(body, len(body["segments"]) - 1)
    assert [segment["number"] for segment in cut["segments"]] == [1, 2, 3, 4]
    assert cut["segments"][0]["from_m"] == 0.0
    assert cut["length_m"] == pytest.approx(0.032)
