"""Samplers of Optuna with one thing changed in each: the state of CMA-ES is data, Sobol points count finished trials, rods give fields."""

from __future__ import annotations

import io
import pickle
from typing import TYPE_CHECKING, Any

from optuna import Study
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler, CmaEsSampler, QMCSampler
from optuna.trial import FrozenTrial

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError
from magmpm.studies.search.parameters import SegmentDirection
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.studies.search.samplers.blocks import Distributions

_ALLOWED = {  # module -> names
    "cmaes": {"CMA", "SepCMA", "CMAwM"},
    "cmaes._cma": {"CMA"},
    "cmaes._sepcma": {"SepCMA"},
    "cmaes._cmawm": {"CMAwM"},
    "numpy": {"ndarray", "dtype", "float64", "int64", "bool"},
    "numpy.random._mt19937": {"MT19937"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy.random._pickle": {"__randomstate_ctor", "__bit_generator_ctor", "__generator_ctor"},
}


class _Unpickler(pickle.Unpickler):
    """Finds only what an optimizer's state is made of."""

    def find_class(self, module: str, name: str) -> Any:
        """Raises UnpicklingError for anything else."""
        if name in _ALLOWED.get(module, ()):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it names {module}.{name}")


class DataOnlyCmaEsSampler(CmaEsSampler):
    """CmaEsSampler that takes nothing but numbers from a database. Raises InputError for a state that is no optimizer's.

    Optuna keeps the optimizer as a pickle in the trials' system attributes. A pickle can name any function, so whoever can write a database
    could run code where it is read. Here only the optimizer's class and NumPy's arrays and generators are found in it.
    """

    def _restore_optimizer(self, completed_trials: list[FrozenTrial]) -> Any:
        key = self._attr_key_optimizer
        for trial in reversed(completed_trials):
            parts = {
                name: value for name, value in trial.system_attrs.items() if name.startswith(key)
            }
            if not parts:
                continue
            try:
                return _Unpickler(
                    io.BytesIO(bytes.fromhex(self._concat_optimizer_attrs(parts)))
                ).load()
            except Exception as error:  # a damaged pickle raises a dozen kinds
                rule = "the state of cmaes must be as Optuna wrote it"
                remedy = "continue the study with another sampler, such as --sampler tpe"
                place = f"the study's database: trial {trial.number}: {key}"
                raise InputError(
                    place,
                    received=f"a state that can't be read ({error})",
                    rule=rule,
                    remedy=remedy,
                ) from None
        return None


class SobolSampler(QMCSampler):
    """Scrambled Sobol points: the scrambling is the study's seed, the place in the sequence the number of finished trials.

    Optuna counts the points it gave in the study's storage, and counts one too many when a process
    is killed between the count and its trial: a study that is interrupted there would go on with
    other points than one that is not.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    seed : int
        Of the study.
    finished : int
        How many trials are finished.
    """

    def __init__(self, space: SearchSpace, seed: int, finished: int) -> None:
        super().__init__(seed=seed, scramble=True, warn_independent_sampling=False)
        self._space = space
        self._finished = finished

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> Distributions:
        return self._space.distributions()  # of the first trial too, which Optuna draws at random

    def _find_sample_id(self, study: Study, search_space: Distributions) -> int:
        return self._finished


class FieldsByRod(BaseSampler):
    """Sampler of an insertion: another one samples the directions, and the rod finds the fields.

    Fields at different depths do not touch each other's shapes, so for given directions each
    depth's best field can be found by itself, in milliseconds (rod_trajectory). That leaves two
    numbers a segment, in place of three more a depth. All are stored as parameters.

    Parameters
    ----------
    base : BaseSampler
        Samples the directions.
    insertion : InsertionTrajectory
        The insertion.
    """

    def __init__(self, base: BaseSampler, insertion: Any) -> None:
        self.base = base
        self.insertion = insertion
        self.names = {
            name for block, _ in insertion.space.those(SegmentDirection) for name in block.bounds()
        }

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> Distributions:
        return self.insertion.space.distributions()

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: Distributions
    ) -> Plain:
        chosen = {name: kind for name, kind in search_space.items() if name in self.names}
        found = self.base.sample_relative(study, trial, chosen)
        for name, kind in chosen.items():
            if name not in found:
                found[name] = self.base.sample_independent(study, trial, name, kind)
        return self.insertion.with_fields(found)

    def sample_independent(
        self,
        study: Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        return self.base.sample_independent(study, trial, param_name, param_distribution)
