"""The best designs of a study that requests an error, evaluated on finer grids: trials run on the coarsest, which sorts good from bad.

A study's scene may ask for `resolution: {error: ...}`. All its trials are then compared on one coarse grid (scene.coarsest), and
at the end every design that the coarse grid's own error can't tell from the best one is run with the error that is requested. Each gets its
distance from the target on that finer grid, and the bound of that grid's error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from magmpm.errors import MagmpmError
from magmpm.scene import Scene
from magmpm.studies.problem.shape_distance import gaps, root_mean_square

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

    from magmpm.results.result import Result
    from magmpm.studies.problem.study import Study

MOST = 5  # designs that are evaluated


def judged(
    study: Study, designs: Sequence[FrozenTrial], scene_of: Callable[[FrozenTrial], Scene], solve: Callable[[Scene], Result],
    known: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:  # fmt: skip
    """The evaluated designs, best first.

    Each {number, rms_m, trial_cells, judged_rms_m, error_estimate_m, cells_across, coarse_error_m}, or a `reason`.

    designs: feasible trials, nearest to the target first; scene_of: the scene of a trial on the coarse grid; known: those evaluated before.
    rms_m is that of the trial; judged_rms_m (m) is right to error_estimate_m; coarse_error_m: bound of the trial's own error, None where
    the coarse grid was not among those that were tried. A design whose finer run fails keeps the reason.
    """
    before = {one["number"]: one for one in known}
    found: list[dict[str, Any]] = []
    for trial in designs[:MOST]:
        if found and trial.user_attrs["rms_m"] > _least(found):
            break
        found.append(before.get(trial.number) or _judge(study, trial, scene_of(trial), solve))
    return sorted(found, key=lambda one: (one.get("judged_rms_m") is None, one.get("judged_rms_m", 0.0), one["number"]))


def _least(found: Sequence[dict[str, Any]]) -> float:
    """The trial's rms (m) above which a design can't be the best: its rms and that of the first may both be wrong by the coarse error."""
    bars = [one["coarse_error_m"] for one in found if one.get("coarse_error_m") is not None]
    return float(found[0]["rms_m"] + 2.0 * max(bars, default=0.0))


def _judge(study: Study, trial: FrozenTrial, coarse: Scene, solve: Callable[[Scene], Result]) -> dict[str, Any]:
    assert study.asked is not None
    first = coarse.resolution.cells_across
    told: dict[str, Any] = {"number": trial.number, "rms_m": trial.user_attrs["rms_m"], "trial_cells": first}
    try:
        fine = {**study.asked.model_dump(mode="json"), "from_tip": coarse.resolution.from_tip}
        result = solve(Scene.from_si({**coarse.to_si(), "resolution": fine}))
    except MagmpmError as error:
        return {**told, "reason": str(error)}
    assert result.resolution is not None
    return {
        **told,
        "judged_rms_m": root_mean_square(gaps(result, study.target)),
        "error_estimate_m": result.error_estimate,
        "cells_across": result.resolution["cells_across"],
        "coarse_error_m": next((one["error"] for one in result.resolution["tried"] if one["cells_across"] == first), None),
    }


def said(found: Sequence[dict[str, Any]]) -> list[str]:
    """Messages on the designs that were verified, a line each."""
    lines = []
    for one in found:
        if "reason" in one:
            lines.append(f"trial {one['number']}: not judged on a finer grid: {one['reason']}")
            continue
        bar = "" if one["coarse_error_m"] is None else f" (to {1e3 * one['coarse_error_m']:.2g} mm)"
        lines.append(
            f"trial {one['number']}: rms {1e3 * one['judged_rms_m']:.4g} mm, its shape right to {1e3 * one['error_estimate_m']:.2g} mm at "
            f"{one['cells_across']} cells; {1e3 * one['rms_m']:.4g} mm{bar} in the trial, at {one['trial_cells']}"
        )
    return lines
