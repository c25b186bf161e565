"""A grid chosen for an error or a time: the choice is told with its error, and the answer is that of the grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm import Result, Scene, run
from magmpm.errors import SceneError
from magmpm.model import build
from magmpm.results.measures import largest_distance

LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3])


def asked(**resolution: object) -> Scene:
    """A short catheter that bends, with this resolution."""
    return Scene.from_si({**PLAIN.to_si(), "resolution": resolution})


def test_an_asked_error_is_kept_and_proven(tmp_path: Path) -> None:
    """0.5 % of the length: the bar is within it and holds against 6 cells; the answer is bit for bit that of the chosen cells."""
    scene = asked(error=0.005)
    result = run(scene, folder=tmp_path)
    assert result.error_estimate is not None
    assert result.resolution is not None
    cells = result.resolution["cells_across"]
    plain, fine = run(PLAIN.with_cells(cells)), run(PLAIN.with_cells(6))
    np.testing.assert_array_equal(result.centreline, plain.centreline)
    assert result.stability == plain.stability
    assert largest_distance(result, fine.centreline) < result.error_estimate < 0.005 * LENGTH
    assert (plain.error_estimate, plain.resolution) == (None, None)
    assert result.scene_hash == scene.hash() != plain.scene_hash

    loaded = Result.load(tmp_path)
    assert (loaded.error_estimate, loaded.resolution) == (result.error_estimate, result.resolution)


def test_an_error_in_mm_at_the_tip() -> None:
    """0.1 mm at the tip of 24 mm."""
    result = run(asked(error="0.1 mm", of="tip"))
    assert result.error_estimate is not None
    assert result.resolution is not None
    assert result.error_estimate < 0.1e-3
    assert np.linalg.norm(result.tip - run(PLAIN.with_cells(6)).tip) < result.error_estimate
    assert result.resolution["asked"] == {"error": "0.0001 m", "of": "tip"}


def test_what_is_asked_is_plain_data_and_read_back() -> None:
    for resolution in ({"error": 0.01}, {"error": "0.1 mm", "of": "tip"}, {"seconds": 2.0}):
        scene = asked(**resolution)
        assert Scene.from_si(scene.to_si()) == scene
        assert scene.hash() != PLAIN.hash()
        with pytest.raises(SceneError, match="cells must be given"):
            build(scene)
    assert asked(error="1 %").hash() == asked(error=0.01).hash() != asked(error="0.1 mm").hash()
    assert asked(error=0.01).with_cells(2).hash() == PLAIN.with_cells(2).hash()


@pytest.mark.parametrize(
    ("error", "says"),
    [("1 m", "half of the length, 12 mm"), ("1 nm", "known to 0.0001 %"), (2e-6, "16 cells across, the most there are")],
)
def test_what_no_grid_can_reach_is_refused_with_the_number(error: object, says: str) -> None:
    with pytest.raises(SceneError, match=says):
        run(asked(error=error))
