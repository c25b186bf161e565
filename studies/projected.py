"""Samplers of an insertion that choose directions alone: the field at each depth follows from them.

Fields at different depths do not touch each other's shapes, so for given directions each depth's best field can be found by itself; the rod
finds it in milliseconds (rod_trajectory). That leaves tpe, gp, cmaes and others two numbers a segment, in place of three more a depth. All
numbers are stored as parameters of the trial, as if they had been sampled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import optuna

from magmpm.studies.blocks import Direction

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

    from magmpm.studies.insertion import Insertion


class FieldsByRod(optuna.samplers.BaseSampler):
    """`base` samples the directions; the rod finds the fields."""

    def __init__(self, base: optuna.samplers.BaseSampler, insertion: Insertion) -> None:
        self.base, self.insertion = base, insertion
        self.names = {name for block in insertion.space.blocks if isinstance(block, Direction) for name in block.bounds()}

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        return self.insertion.space.distributions()

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        chosen = {name: kind for name, kind in search_space.items() if name in self.names}
        found = self.base.sample_relative(study, trial, chosen)
        for name, kind in chosen.items():
            if name not in found:
                found[name] = self.base.sample_independent(study, trial, name, kind)
        return self.insertion.with_fields(found)

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        return self.base.sample_independent(study, trial, param_name, param_distribution)
