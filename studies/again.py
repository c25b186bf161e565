"""A trial of a study, solved again from what is stored of it."""

from __future__ import annotations

from typing import Any

from magmpm.errors import InputError, report
from magmpm.studies.judge import Judge
from magmpm.studies.opened import as_begun
from magmpm.studies.storage import Store, must_exist, shown_url, storage_faults


def solved_again(judge: Judge, store: Store, number: int) -> dict[str, Any]:
    """What is stored of a trial, and what its parameters give now: number, params, rms_m stored and again, and whether the bits agree.

    Raises InputError where the storage has no such trial, or none that is finished.
    """
    import optuna

    must_exist(store.url, judge.out)
    storage = store.opened()
    with storage_faults(store.url, store.timeout):
        judge.study = as_begun(judge.study, storage)
        try:
            kept = optuna.load_study(study_name=judge.study.name, storage=storage)
        except KeyError:
            rule, remedy = f"holds no study named {judge.study.name}", "name the --out or the --storage that it was run with"
            raise InputError(report(shown_url(store.url), rule=rule, remedy=remedy)) from None
        trials = {t.number: t for t in kept.get_trials(deepcopy=False)}
    trial = trials.get(number)
    if trial is None or trial.values is None:
        what = "is not finished" if trial is not None else f"is not there; the study has {len(trials)}, numbered from 0"
        remedy = "--trial 0, say" if trials else "run the study first"
        raise InputError(report("--trial", received=str(number), rule=f"trial {number} {what}", remedy=remedy))
    judged = judge.judged(number, trial.params)
    stored, now = trial.user_attrs.get("rms_m", trial.values[0]), judged.outcome.rms
    return {
        "number": number,
        "params": dict(trial.params),
        "rms_m": now,
        "stored_rms_m": stored,
        "same": bool(stored == now and trial.values[0] == judged.outcome.value),
        "reason": judged.outcome.reason,
        "versions": trial.user_attrs.get("versions", {}),
        "versions_now": judged.known["versions"],
        "files": [str(path) for path in judged.files],
    }
