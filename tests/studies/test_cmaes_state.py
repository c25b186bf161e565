"""The state of cmaes in a database is data: what Optuna wrote is read, and code is refused before it runs."""

import pickle
from pathlib import Path

import optuna
import pytest

from magmpm.errors import InputError

pytest.importorskip("cmaes")


class Owned:
    """A pickle that makes a file where it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> object:
        return Path.touch, (self.path,)


def study_of(sampler: optuna.samplers.BaseSampler, trials: int) -> optuna.Study:
    study = optuna.create_study(sampler=sampler)
    study.optimize(
        lambda trial: sum(trial.suggest_float(name, -1, 1) ** 2 for name in "xyz"), n_trials=trials
    )
    return study


def test_the_same_trials_as_optuna() -> None:
    """Read back with numbers alone, the optimizer goes on as Optuna's does."""
    from magmpm.studies.search.samplers.optuna_own import DataOnlyCmaEsSampler

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    plain, ours = (
        study_of(kind(seed=3), 30) for kind in (optuna.samplers.CmaEsSampler, DataOnlyCmaEsSampler)
    )
    assert [t.params for t in plain.trials] == [t.params for t in ours.trials]


def test_code_in_a_database_is_refused(tmp_path: Path) -> None:
    from magmpm.studies.search.samplers.optuna_own import DataOnlyCmaEsSampler

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = DataOnlyCmaEsSampler(seed=3)
    study = study_of(sampler, 12)
    last = study.trials[-1]
    hostile = pickle.dumps(Owned(tmp_path / "owned")).hex()
    last.system_attrs[f"{sampler._attr_key_optimizer}:0"] = hostile
    for key in [
        key
        for key in last.system_attrs
        if key.startswith(sampler._attr_key_optimizer) and not key.endswith(":0")
    ]:
        del last.system_attrs[key]
    with pytest.raises(InputError, match="as Optuna wrote it"):
        sampler._restore_optimizer([last])
    assert not (tmp_path / "owned").exists()
    pickle.loads(bytes.fromhex(hostile))
    assert (tmp_path / "owned").exists(), "the pickle of this test does what it is refused for"
