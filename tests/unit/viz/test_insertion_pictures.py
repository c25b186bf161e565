"""Pictures of an insertion: one body a depth, each beside its own field, over evenly spaced dots, in the colors of the movie."""

from typing import Any

import numpy as np
import pytest

from magmpm.cli.design import several_snapshot as trial_snapshot
from magmpm.scene import Scene
from magmpm.studies.evaluate.trajectory import CATHETER, SHAPES, shapes_of
from magmpm.viz.camera import Framing
from magmpm.viz.insertion import InsertionPictures
from magmpm.viz.layout import PAGE, Views
from magmpm.viz.snapshot import Snapshot

LENGTH = 0.03
DEPTHS = (4e-3, 8e-3, 12e-3, 16e-3, 20e-3)


def scene() -> Scene:
    """Three segments, the first plain."""
    segments = [
        {"magnetization": [0, 0, 0]},
        {"magnetization": [1, 0, 0]},
        {"magnetization": [0, 0, 1]},
    ]
    silicone = {"shear_modulus": 120e3, "bulk_to_shear": 20, "density": 1882.0, "remanence": 0.138}
    catheter = {"length": LENGTH, "diameter": 3e-3, "material": "silicone", "segments": segments}
    return Scene.from_si(
        {
            "name": "of the scene",
            "materials": {"silicone": silicone},
            "body": {"catheter": catheter},
        }
    )


def path() -> np.ndarray:
    """An arc up, its rows unevenly spaced."""
    s = DEPTHS[-1] * np.linspace(0.0, 1.0, 47) ** 2
    return np.column_stack([s, 0.02 * np.sin(s / 0.02), 0 * s, 0.02 * (1 - np.cos(s / 0.02))])


def frame(depth: float, field: float) -> dict[str, Any]:
    """A straight body at a depth, in a field along z."""
    axis = np.linspace([0.0, 0.0, 0.0], [depth, 0.0, 0.0], 25)
    count = len(scene().inserted(depth).regions())
    remanence = 0.138 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])[3 - count :]
    return {
        "depth_m": depth,
        "field_T": [0.0, 0.0, field],
        "rms_m": 0.0,
        "axis_m": axis.tolist(),
        "centers_m": axis[:: 25 // count][:count].tolist(),
        "remanence_T": remanence.tolist(),
    }


FRAMES = [frame(depth, 2e-3 * k) for k, depth in enumerate(DEPTHS)]


@pytest.fixture(scope="module")
def trial() -> Snapshot:
    """As from a result, whose scene is what is outside the guide at the last depth."""
    kept = {"insertion": FRAMES, SHAPES: FRAMES, CATHETER: scene().to_si()["body"]["catheter"]}
    return trial_snapshot(
        "of the study", scene().inserted(DEPTHS[-1]).to_si(), path(), shapes_of(kept), 0, 0.0
    )


def test_every_depth_has_its_field(trial: Snapshot) -> None:
    assert trial.field is None  # no arrow that would be of one depth alone
    np.testing.assert_allclose(
        trial.fields[:, 1] / trial.fields[-1, 1, 2],
        np.outer([0.25, 0.5, 0.75, 1.0], [0, 0, 1]),
        atol=1e-12,
    )
    assert [text for text, _ in trial.notes] == [
        "at 8 mm: 2.0 mT",
        "at 12 mm: 4.0 mT",
        "at 16 mm: 6.0 mT",
        "at 20 mm: 8.0 mT",
    ]


def test_dots_are_evenly_spaced(trial: Snapshot) -> None:
    """On each path by itself; of an arc of a third of a circle chords are as long as arcs to 0.1 %."""
    assert trial.target is not None
    for dots in (
        *np.split(trial.target, 4),
        InsertionPictures("", scene().to_si(), path()).moment(FRAMES[-1]).target,
    ):
        apart = np.linalg.norm(np.diff(dots, axis=0), axis=1)
        np.testing.assert_allclose(apart, apart.mean(), rtol=0.01)


def test_segments_have_the_colors_of_the_movie(trial: Snapshot) -> None:
    """Though the path is shorter than the catheter, so that its plain segment is never outside."""
    moment = InsertionPictures("", scene().to_si(), path()).moment(FRAMES[-1])
    np.testing.assert_array_equal(trial.colors[-len(moment.colors) :], moment.colors)
    assert trial.title == "of the study"


def test_arrows_and_notes_are_in_view(trial: Snapshot) -> None:
    framing = Framing.of(trial)
    (view,), (panel,) = Views.of(framing, PAGE, 16 / 9).mains, PAGE.mains
    arrows = np.concatenate([trial.arrows, trial.fields])
    ends = np.vstack([arrows[:, 0], arrows.sum(axis=1), *(place[None] for _, place in trial.notes)])
    flat = view.project(ends)[:, :2] / [panel.aspect(16 / 9), 1.0]
    assert np.abs(flat).max() < 1.0
