"""Optuna's CMA-ES, with the optimizer's state read from the database as data.

Optuna keeps the optimizer as a pickle in the trials' system attributes. A pickle can name any function, so whoever can write a database
could run code where it is read. Here only the optimizer's class and NumPy's arrays and generators are found in it.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

from optuna.samplers import CmaEsSampler
from optuna.trial import FrozenTrial

from magmpm.errors import InputError, report

_ALLOWED = {  # module -> names
    "cmaes": {"CMA", "SepCMA", "CMAwM"},
    "cmaes._cma": {"CMA"},
    "cmaes._sepcma": {"SepCMA"},
    "cmaes._cmawm": {"CMAwM"},
    "numpy": {"ndarray", "dtype", "float64", "int64", "bool"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy.random._pickle": {"__randomstate_ctor", "__bit_generator_ctor", "__generator_ctor"},
    "numpy.random._mt19937": {"MT19937"},
}


class _Unpickler(pickle.Unpickler):
    """Finds only what an optimizer's state is made of."""

    def find_class(self, module: str, name: str) -> Any:
        """Raises UnpicklingError for anything else."""
        if name in _ALLOWED.get(module, ()):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it names {module}.{name}")


class DataOnlyCmaEsSampler(CmaEsSampler):
    """CmaEsSampler that takes nothing but numbers from a database. Raises InputError for a state that is no optimizer's."""

    def _restore_optimizer(self, completed_trials: list[FrozenTrial]) -> Any:
        key = self._attr_key_optimizer
        for trial in reversed(completed_trials):
            parts = {name: value for name, value in trial.system_attrs.items() if name.startswith(key)}
            if not parts:
                continue
            try:
                return _Unpickler(io.BytesIO(bytes.fromhex(self._concat_optimizer_attrs(parts)))).load()
            except Exception as error:  # a damaged pickle raises a dozen kinds
                rule, remedy = "the state of cmaes must be as Optuna wrote it", "take up the study with another sampler, say, --sampler tpe"
                place = f"the study's database: trial {trial.number}: {key}"
                raise InputError(report(place, received=f"a state that can't be read ({error})", rule=rule, remedy=remedy)) from None
        return None
