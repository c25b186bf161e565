"""Statistics of the trials of a study: which were best, which parameters mattered, and when it ran. Read from its storage."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from magmpm.studies.engine.report import feasible, refused

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

SHOWN = 10  # best trials in the table
FEWEST = 4  # trials below which nothing is said of what mattered


def kept_trials(storage: optuna.storages.BaseStorage, name: str) -> tuple[optuna.Study, list[FrozenTrial]]:
    """A study in its storage, and its finished trials in order."""
    import optuna
    from optuna.trial import TrialState

    kept = optuna.load_study(study_name=name, storage=storage)
    return kept, kept.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def best_rows(trials: Sequence[FrozenTrial]) -> list[dict[str, Any]]:
    """The feasible trials nearest to the target: number, value_m, rms_m, tip_error_m, stability, values."""
    good = sorted((t for t in trials if feasible(t)), key=lambda t: (t.values[0], t.number))[:SHOWN]
    return [
        {
            "number": t.number,
            "value_m": float(t.values[0]),
            "rms_m": float(t.user_attrs.get("rms_m", t.values[0])),
            "tip_error_m": t.user_attrs.get("tip_error_m"),
            "stability": t.user_attrs.get("stability"),
            "values": [float(v) for v in t.values],
        }
        for t in good
    ]


def reasons(trials: Sequence[FrozenTrial]) -> list[tuple[str, str, int]]:
    """Reasons why trials failed or were refused: which of the two, the reason, and how many trials, most first."""
    counted: dict[tuple[str, str], int] = {}
    for trial in trials:
        if not feasible(trial):
            key = ("refused" if refused(trial) else "failed", str(trial.user_attrs.get("reason") or "not told"))
            counted[key] = counted.get(key, 0) + 1
    return [(kind, reason, count) for (kind, reason), count in sorted(counted.items(), key=lambda item: -item[1])]


def importances(kept: optuna.Study, trials: Sequence[FrozenTrial]) -> dict[str, Any]:
    """Which parameters the best trials differ in from all: PED-ANOVA (Watanabe et al., IJCAI 2023), shares that sum to 1.

    `values`: parameter -> share, largest first; `trials`: of how many. Or `why` there are none.
    """
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    good = [t for t in trials if feasible(t)]
    if len(good) < FEWEST:
        return {"why": f"{len(good)} feasible trials are too few to tell which parameters mattered"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # experimental
        try:
            found = get_param_importances(kept, evaluator=PedAnovaImportanceEvaluator(), target=lambda t: t.values[0])
        except (ValueError, RuntimeError) as error:
            return {"why": f"not known: {error}"}
    if not found or not sum(found.values()) > 0:
        return {"why": "no parameter tells the better trials from the others"}
    return {"values": {name: float(share) for name, share in found.items()}, "trials": len(trials)}


def when(trials: Sequence[FrozenTrial]) -> dict[str, Any]:
    """`began` and `ended` (ISO dates), of the trials that say so."""
    begun = [t.datetime_start for t in trials if t.datetime_start is not None]
    done = [t.datetime_complete for t in trials if t.datetime_complete is not None]
    return {
        "began": min(begun).isoformat(" ", "seconds") if begun else None,
        "ended_at": max(done).isoformat(" ", "seconds") if done else None,
    }
