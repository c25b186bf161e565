"""Pictures of a study's insertion: where its designs meet viz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from magmpm.viz.snapshot import Snapshot
    from magmpm.viz.worker import Renderer

MOVIE = "insertion.mp4"


def design_snapshot(name: str, scene: Mapping[str, Any], path: np.ndarray | None, known: Mapping[str, Any]) -> Snapshot | None:
    """The picture of a design's insertion, from what is stored of it; None where it is none. path: rows [s, x, y, z], (m, 4) m."""
    from magmpm.studies.evaluate.insertion import shapes_of

    shapes = shapes_of(known)
    if not shapes or path is None:
        return None
    return trial_snapshot(name, scene, path, shapes, known["number"], known["rms_m"])


def trial_snapshot(
    name: str, scene: Mapping[str, Any], path: np.ndarray, shapes: tuple[Mapping[str, Any], ...], trial: int, rms: float
) -> Snapshot:
    """The picture of a trial."""
    from magmpm.viz.insertion import Insertion

    if "catheter" in shapes[-1]:  # a result's scene has what is outside alone
        scene = {**scene, "body": {"catheter": shapes[-1]["catheter"]}}
    return Insertion(name, scene, path).trial(shapes, trial=trial, rms=rms)


def draw_movie(folder: Path, out: Path, name: str, renderer: Renderer) -> list[Path]:
    """The movie of the best design in `folder`, into `out`; nothing where its frames are not there."""
    from magmpm.studies.evaluate.insertion import MOVIE as FRAMES
    from magmpm.viz.camera import Framing
    from magmpm.viz.insertion import Insertion
    from magmpm.viz.movies import frames_movie

    if not (folder / FRAMES).exists():
        return []
    content = json.loads((folder / FRAMES).read_text(encoding="utf-8"))
    shown = Insertion(name, content["scene"], np.array(content["path_m"]))
    moments = [shown.moment(frame) for frame in content["frames"]]
    framing = Framing.of(moments)
    numbers = np.arange(len(moments))
    made = frames_movie(out / MOVIE, lambda k: renderer.image(moments[k], framing=framing), numbers)
    return [Path(made.path)]
