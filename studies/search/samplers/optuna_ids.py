"""Names that Optuna 5 keeps private: a study's storage, the numbers by which storages know studies and trials; and a trial's numbers in SI.

Trials that another process left running are put back, ended or copied by the storage's own calls with these numbers; so are a sampler's
notes on the requested trial, of which it gets a copy without methods. All private names of Optuna stand here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import optuna
    from optuna.storages import BaseStorage
    from optuna.trial import FrozenTrial

SI = "values_si"  # of a trial that was told its values in the units that people read


def storage_of(study: optuna.Study) -> BaseStorage:
    """Find the storage that a study uses.

    Parameters
    ----------
    study : optuna.Study
        The study.

    Returns
    -------
    BaseStorage
        The storage.
    """
    return study._storage


def study_id(study: optuna.Study) -> int:
    """Find the study's number in its storage.

    Parameters
    ----------
    study : optuna.Study
        The study.

    Returns
    -------
    int
        The number.
    """
    return study._study_id


def trial_id(trial: optuna.Trial | FrozenTrial) -> int:
    """Find the trial's number in its storage: another one than its number in its study.

    Parameters
    ----------
    trial : optuna.Trial or FrozenTrial
        The trial.

    Returns
    -------
    int
        The number.
    """
    return trial._trial_id


def other_trials(
    study: optuna.Study, trial: FrozenTrial, names: Iterable[str]
) -> tuple[list[FrozenTrial], list[FrozenTrial], int]:
    """Find the other trials of a study.

    Parameters
    ----------
    study : optuna.Study
        The study.
    trial : FrozenTrial
        The trial that is to be chosen.
    names : iterable of str
        Parameters that a trial must have to be known.

    Returns
    -------
    ended : list of FrozenTrial
        Those that have ended.
    running : list of FrozenTrial
        Those that run and whose designs are known.
    before : int
        How many that run have smaller numbers.
    """
    # at once: one that ends between two readings would be in neither
    trials = study.get_trials(deepcopy=False)
    requested = set(names)
    running = [t for t in trials if t.state.name == "RUNNING" and t.number != trial.number]
    known = [t for t in running if requested <= set(t.params)]
    return (
        [t for t in trials if t.state.is_finished()],
        known,
        sum(t.number < trial.number for t in running),
    )


def si_values(trial: FrozenTrial) -> list[float]:
    """Find a trial's values in SI. Trials of before 0.1.0 were told in SI.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    list of float
        The values; none of a trial that has none.
    """
    return list(trial.user_attrs.get(SI, trial.values or ()))


def value_of(trial: FrozenTrial) -> float:
    """Find the first of a trial's values in SI.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    float
        The value; infinite where it has none.
    """
    return next(iter(si_values(trial)), math.inf)


def set_constraints(trial: optuna.Trial, beyond: Sequence[float]) -> None:
    """Store by how much a trial breaks each constraint, at most 0 where it keeps it.

    As one list, which both Optuna and optuna-dashboard read; what `Trial.set_constraint` of Optuna 5
    stores is unknown to dashboard 0.21.

    Parameters
    ----------
    trial : optuna.Trial
        The trial, which runs.
    beyond : sequence of float
        A number for each constraint of the study, in the same order in each trial.
    """
    trial.storage.set_trial_system_attr(trial_id(trial), "constraints", list(beyond))
