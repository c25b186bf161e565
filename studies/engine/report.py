"""Report of what a study has found so far, read from its storage; and its best designs evaluated on finer grids."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import MagmpmError
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene
from magmpm.studies.problem import REPORT, STABILITY_AT_BRINK
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.samplers.optuna_ids import value_of

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

    from magmpm.results.result import Result
    from magmpm.studies.problem.study import Study

QUANTITIES = (
    "segment_lengths_m",
    "diameter_m",
    "remanence_T",
    "shear_modulus_Pa",
)  # of a trial, where the study varies them
OF_SEVERAL = (  # of a trial of an insertion or a schedule
    "exit_error_m",
    "worst_m",
    "worst_depth_m",
    "worst_time_s",
    "field_largest_change_T",
    "field_total_variation_T",
    "insertion",
    "schedule",
)
SCATTER = (
    "measure_m",
    "mean_rms_m",
    "sigma_rms_m",
    "scatter_m",
)  # of a trial of a study with `robust`
Ended = Literal["stop", "trials", "exhausted", "interrupted"]
# times the least rms: what the more stable design may cost, and how much more than its rms one on
# the brink counts
NEARLY = 1.1


@dataclass(frozen=True)
class StudyReport:
    """State of a study, in SI, with its finished trials.

    Attributes
    ----------
    name : str
        Of the study.
    out : Path
        The folder of its results.
    storage : str
        URL of the database, without a password.
    sampler : str
        Its name.
    seed : int
        Of the study.
    wanted : int
        Trials that are asked for.
    stop_rms_m : float, m, or None
        The distance below which the study stops; None without one.
    trials : int
        Number of finished ones.
    failed : int
        How many of these got the penalty.
    refused : int
        How many were less stable than the study's margin.
    best : dict[str, Any] or None
        Of the best trial (best_trial): number, rms_m, tip_error_m, stability, params,
        magnetization (k, 3), field_T; None without one.
    first_trial_below_stop : int or None
        Number (from 0, as the dashboard counts) of the first trial that reached `stop`; None
        without one.
    seconds_per_trial : float, s, or None
        Median of whole trials, from the request for one until its value was stored.
    ended : Ended
        Why the study is not running any more.
    rms_m : list of float, m
        Distance of every finished trial in order; failed ones have the penalty.
    failed_trials : list of int
        Places of the failed ones in `rms_m`.
    reasons : list of str
        Why each of them failed, or was refused.
    measure_m : list of float, m, or None
        Of a study with `robust`, what each trial counts as: the mean plus two standard
        deviations.
    front : dict[str, Any] or None
        Of a study with two objectives: objectives, values, pareto, compromise (objectives.py).
    warnings : list of str
        What a user should know of the search.
    why_sampler : str or None
        Why this sampler, where the study's file names none.
    artifacts : str or None
        Where the trials' pictures are, if not in the folder itself.
    study_file : str or None
        The study's file, from the root.
    limits : list of dict[str, Any]
        What holds the best design back (explain_miss), each with what it `says`.
    exchanged : int
        Trials beyond the wanted ones that exchanged a direction of the best design, or went a
        step on from it.
    verified : list of dict[str, Any]
        The best designs on finer grids, best first.
    """

    name: str
    out: Path
    storage: str
    sampler: str
    seed: int
    wanted: int
    stop_rms_m: float | None
    trials: int
    failed: int
    refused: int
    best: Plain | None
    first_trial_below_stop: int | None
    seconds_per_trial: float | None
    ended: Ended
    rms_m: list[float]
    failed_trials: list[int]
    reasons: list[str] = field(default_factory=list)
    measure_m: list[float] | None = None
    front: Plain | None = None
    warnings: list[str] = field(default_factory=list)
    why_sampler: str | None = None
    artifacts: str | None = None
    study_file: str | None = None
    limits: list[Plain] = field(default_factory=list)
    exchanged: int = 0
    verified: list[Plain] = field(default_factory=list)

    def __repr__(self) -> str:
        best = (
            "none"
            if self.best is None
            else f"trial {self.best['number']}, rms {1e3 * self.best['rms_m']:.3f} mm"
        )
        return (
            f"StudyReport({self.name!r}: {self.trials} trial{'s' * (self.trials != 1)} by"
            f" {self.sampler}; best {best}; in {self.out})"
        )

    @property
    def why(self) -> str:
        """Reason why the study has stopped, and how it is continued: one sentence."""
        if self.ended == "interrupted":
            return "interrupted; run the same command to go on"
        done = f"{self.trials} trial{'s are' if self.trials != 1 else ' is'} done"
        if self.exchanged:
            done += (
                f" ({self.exchanged} exchanged single directions of the best design, or went a step"
                " on from it)"
            )
        if self.ended == "exhausted":
            return (
                f"{done}, and the search is exhausted: no descent from the rod's designs gets "
                "better; for others, change `seed`"
            )
        if self.ended == "trials" or self.best is None or self.stop_rms_m is None:
            return (
                f"{done}, and {self.wanted} {'were' if self.wanted != 1 else 'was'} asked for; for"
                f" more, say, --trials {2 * self.trials}"
            )
        return (
            f"stopped after trial {self.first_trial_below_stop}, because its rms is within `stop`,"
            f" {1e3 * self.stop_rms_m:g} mm ({done}); to go on past it, say, --trials"
            f" {2 * self.trials}"
        )

    def summary(self) -> Plain:
        """Return what `magmpm design --json` prints.

        Returns
        -------
        dict[str, Any]
            Plain data in SI.
        """
        found = asdict(self)
        two = found.pop("front") or {}
        return {**found, **two, "out": str(self.out), "why": self.why}

    def save(self) -> Path:
        """Write the summary to OUT/study.json, whole or not at all.

        Returns
        -------
        Path
            The file.
        """
        path = self.out / REPORT
        with whole_file(path) as part:
            part.write_text(json.dumps(self.summary(), indent=1) + "\n", encoding="utf-8")
        return path


def best_trial(trials: Sequence[FrozenTrial]) -> FrozenTrial | None:
    """Find the feasible trial nearest to the target; of equals, the first.

    If it is less stable than STABILITY_AT_BRINK: of those whose value is at most NEARLY times as large, and not
    on the brink if one is not, the least value times its cost, 1 + (NEARLY - 1) STABILITY_AT_BRINK / stability.

    Parameters
    ----------
    trials : sequence of FrozenTrial
        All trials.

    Returns
    -------
    FrozenTrial or None
        The best; None where none is feasible.
    """
    near = nearest_first(trials)
    stability = {
        t.number: 1.0 if (known := t.user_attrs.get("stability")) is None else max(known, 1e-9)
        for t in near
    }
    if not near or stability[near[0].number] >= STABILITY_AT_BRINK:
        return next(iter(near), None)
    close = [t for t in near if value_of(t) <= NEARLY * value_of(near[0])]
    stable = [t for t in close if stability[t.number] >= STABILITY_AT_BRINK] or close
    return min(
        stable,
        key=lambda t: (
            value_of(t) * (1.0 + (NEARLY - 1.0) * STABILITY_AT_BRINK / stability[t.number])
        ),
    )


def on_the_brink(best: Named | None) -> list[str]:
    """Warn where a best design is less stable than STABILITY_AT_BRINK.

    Parameters
    ----------
    best : Mapping[str, Any] or None
        As `describe` has it.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    if best is None or best.get("stability") is None or best["stability"] >= STABILITY_AT_BRINK:
        return []
    depth = next(
        (
            f" at {1e3 * row['depth_m']:.4g} mm"
            for row in best.get("insertion") or ()
            if row["stability"] == best["stability"]
        ),
        "",
    )
    return [
        f"the best design is nearly unstable: its stability{depth} is {best['stability']:.2g} (1: "
        "at rest, 0: a critical load), so small errors of body or field may make it snap; "
        f"`stability: {{margin: {STABILITY_AT_BRINK:g}}}` in the study refuses such designs"
    ]


def nearest_first(trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Order the feasible trials, nearest to the target first; of equals, the first.

    Parameters
    ----------
    trials : sequence of FrozenTrial
        All trials.

    Returns
    -------
    list of FrozenTrial
        The feasible ones.
    """
    return sorted((t for t in trials if feasible(t)), key=value_of)


def feasible(trial: FrozenTrial) -> bool:
    """Tell whether a trial's solve succeeded and it did not get the penalty.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    bool
        True if so.
    """
    return bool(trial.user_attrs.get("feasible"))


def refused(trial: FrozenTrial) -> bool:
    """Tell whether a trial was solved, but was less stable than its study's margin.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    bool
        True if so.
    """
    return bool(trial.user_attrs.get("refused"))


def describe(trial: FrozenTrial) -> Plain:
    """Describe a trial for a report.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    dict[str, Any]
        Plain data in SI.
    """
    kept = {
        key: trial.user_attrs.get(key)
        for key in ("tip_error_m", "stability", "magnetization", "field_T")
    }
    varied = {
        key: trial.user_attrs[key]
        for key in (*QUANTITIES, *SCATTER, *OF_SEVERAL)
        if key in trial.user_attrs
    }
    rms = trial.user_attrs.get("rms_m", value_of(trial))  # with `robust`, the value is another
    return {"number": trial.number, "rms_m": rms, "params": dict(trial.params), **kept, **varied}


def seconds_per_trial(trials: Sequence[FrozenTrial]) -> float | None:
    """Find the median of the trials' whole seconds, by the storage's clock: from the request for a trial until its value was stored.

    Parameters
    ----------
    trials : sequence of FrozenTrial
        Finished ones.

    Returns
    -------
    float, s, or None
        The median; None where there is none.
    """
    spans = [(t.datetime_start, t.datetime_complete) for t in trials]
    seconds = [
        (end - begin).total_seconds()
        for begin, end in spans
        if begin is not None and end is not None
    ]
    return statistics.median(seconds) if seconds else None


def verified(
    study: Study,
    designs: Sequence[FrozenTrial],
    scene_of: Callable[[FrozenTrial], Scene],
    solve: Callable[[Scene], Result],
    known: Sequence[Plain],
) -> list[Plain]:
    """Solve the best designs of a study that requests an error on finer grids.

    Trials run on the coarsest grid, which sorts good from bad. At the end every design that its
    error can't tell from the best one is run with the error that is requested. A design whose finer
    run fails keeps the reason.

    Parameters
    ----------
    study : Study
        The study.
    designs : sequence of FrozenTrial
        Feasible trials, nearest to the target first.
    scene_of : callable
        Makes the scene of a trial on the coarse grid.
    solve : callable
        From a scene to its Result.
    known : sequence of dict[str, Any]
        Those solved before.

    Returns
    -------
    list of dict[str, Any]
        Best first. Each has number, rms_m (of the trial), trial_cells, verified_rms_m (m), which
        is right to error_estimate_m, cells_across, and coarse_error_m, bound of the trial's own
        error, None where the coarse grid was not among those that were tried; or a `reason`.
    """
    before = {one["number"]: one for one in known}
    found: list[Plain] = []
    for trial in designs[:5]:
        # its rms and that of the first may both be wrong by the coarse error
        bars = [one["coarse_error_m"] for one in found if one.get("coarse_error_m") is not None]
        if found and trial.user_attrs["rms_m"] > found[0]["rms_m"] + 2.0 * max(bars, default=0.0):
            break
        found.append(
            before.get(trial.number) or _verified_one(study, trial, scene_of(trial), solve)
        )
    return sorted(
        found,
        key=lambda one: (
            one.get("verified_rms_m") is None,
            one.get("verified_rms_m", 0.0),
            one["number"],
        ),
    )


def _verified_one(
    study: Study, trial: FrozenTrial, coarse: Scene, solve: Callable[[Scene], Result]
) -> Plain:
    assert study.requested is not None
    first = coarse.resolution.cells_across
    about: Plain = {
        "number": trial.number,
        "rms_m": trial.user_attrs["rms_m"],
        "trial_cells": first,
    }
    try:
        fine = {**study.requested.model_dump(mode="json"), "from_tip": coarse.resolution.from_tip}
        result = solve(Scene.from_si({**coarse.to_si(), "resolution": fine}))
    except MagmpmError as error:
        return {**about, "reason": str(error)}
    assert result.resolution is not None
    return {
        **about,
        "verified_rms_m": root_mean_square(gaps(result.centreline, study.target)),
        "error_estimate_m": result.error_estimate,
        "cells_across": result.resolution["cells_across"],
        "coarse_error_m": next(
            (one["error"] for one in result.resolution["tried"] if one["cells_across"] == first),
            None,
        ),
    }


def verified_lines(found: Sequence[Plain]) -> list[str]:
    """Write messages on the designs that were verified.

    Parameters
    ----------
    found : sequence of dict[str, Any]
        As `verified` returns them.

    Returns
    -------
    list of str
        A line for each.
    """
    lines = []
    for one in found:
        if "reason" in one:
            lines.append(f"trial {one['number']}: not judged on a finer grid: {one['reason']}")
            continue
        bar = "" if one["coarse_error_m"] is None else f" (to {1e3 * one['coarse_error_m']:.2g} mm)"
        lines.append(
            f"trial {one['number']}: rms {1e3 * one['verified_rms_m']:.4g} mm, its shape right to"
            f" {1e3 * one['error_estimate_m']:.2g} mm at {one['cells_across']} cells;"
            f" {1e3 * one['rms_m']:.4g} mm{bar} in the trial, at {one['trial_cells']}"
        )
    return lines
