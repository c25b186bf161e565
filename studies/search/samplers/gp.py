"""gp: Bayesian search with a model of the shape, not of its distance from the target.

The distance is a known function of the shape: from a model of the points at the target's stations (shape_model.py), the expected square of
the rms has a closed form, with its gradient. The next trial is the design at which it is least, on the sphere of each direction and within
the bounds of all else, from several starts. So a trial teaches where every point goes, also one that is far from the target.

The first two trials magnetize all segments alike, in two of the directions with which `tpe` begins. After two trials that brought little,
one looks where the model knows least: a model of designs that are alike is too sure of itself. A trial that failed has no shape and is left
out of the model; its design is not tried again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState
from scipy.optimize import minimize

from magmpm.compiled.arrays import Array
from magmpm.studies.search.parameters import Direction, FieldVector
from magmpm.studies.search.samplers.pending_trials import others_running
from magmpm.studies.search.samplers.shape_model import ShapeModel, layout_of
from magmpm.studies.search.search_space import SearchSpace

ALIKE = 2  # trials before there is a model
BEST, RANDOM = 2, 6  # starts of the search for the next design: the best so far, and random ones
STEPS = 60  # of each
BESIDE = 0.05  # how far from a good design its start is, so that it is no maximum of certainty
LITTLE = 0.9  # of the distance: two trials that leave more of it brought little
DRAWN = 64  # designs among which the one is chosen that the model knows least of
SAME = 1e-3  # designs nearer than this, in every coordinate, are one
MOST = 120  # designs in a model: the nearest ones to the target
SETTINGS = {"alike": ALIKE, "starts": [BEST, RANDOM], "steps": STEPS, "most": MOST, "little": LITTLE, "drawn": DRAWN}
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)


class ShapeSampler(optuna.samplers.BaseSampler):
    """Chooses the trial after `finished` ones by a Gaussian process of the shape.

    The choice depends on the seed, and on finished and running trials alone.
    """

    def __init__(self, space: SearchSpace, seed: int, finished: int) -> None:
        self._space, self._seed, self._finished = space, seed, finished
        self._rng = np.random.default_rng([seed, finished, 1])
        self._caution = 1.0
        self._scale = np.ones(space.size)
        sizes = []
        for block, at in zip(space.blocks, space.slices, strict=True):
            if isinstance(block, FieldVector):
                self._scale[at] = block.max
            sizes.append(("direction" if isinstance(block, Direction) else "other", block.size, 1.0))
        self._layout = layout_of(sizes)

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        return self._space.distributions()

    def sample_independent(self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution) -> Any:
        """For parameters that are not of the search space; a study has none. Drawn evenly, as by the other samplers."""
        drawn = optuna.samplers.RandomSampler(seed=int(self._rng.integers(2**32)))
        return drawn.sample_independent(study, trial, param_name, param_distribution)

    def sample_relative(self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]) -> dict[str, Any]:
        trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        running, before = others_running(study, trial, search_space)
        order = self._order(trials)
        if len(trials) + before < ALIKE:
            return self._space.parameters_at(self._alike(len(trials) + before) * self._scale, order)
        running = [t for t in running if t.params.get("order") == order]
        known = [t for t in trials if "residuals" in t.user_attrs and t.params.get("order") == order]
        done = [self._embedded(t) for t in trials if t.params.get("order") == order]
        asked = np.array([self._embedded(t) for t in running]).reshape(-1, self._space.size)
        tried = np.concatenate([np.array(done).reshape(-1, self._space.size), asked])
        if len(known) < ALIKE or not self._space.size:
            return self._space.parameters_at(self._drawn() * self._scale, order)
        known = sorted(known, key=lambda t: (_square(t), t.number))[:MOST]
        x = np.array([self._embedded(t) for t in known])
        self._caution = 1.0 if _improved(trials) else 0.0
        residuals = np.array([t.user_attrs["residuals"] for t in known], dtype=float)
        model = ShapeModel(self._layout, x, residuals)
        if len(asked):  # what is being solved counts as found where the model expects it (the kriging believer, Ginsbourger et al. 2010)
            expected = np.array([model.predicted(one)[0] for one in asked])
            model = ShapeModel(self._layout, np.concatenate([x, asked]), np.concatenate([residuals, expected]))
        chosen = self._farthest(model) if self._stuck(trials) else self._least(model, x, tried)
        return self._space.parameters_at(chosen * self._scale, order)

    def _stuck(self, trials: list[FrozenTrial]) -> bool:
        """True if two trials have brought little. Every other trial then looks elsewhere: a model of similar designs is too sure."""
        values = [float("inf") if t.value is None else t.value for t in trials]
        return len(values) > ALIKE + 1 and len(values) % 2 == 0 and min(values[-2:]) > LITTLE * min(values[:-2])

    def _farthest(self, model: ShapeModel) -> Array:
        """Design of several random ones that the model knows least of."""
        drawn = [self._drawn() for _ in range(DRAWN)]
        return drawn[int(np.argmax([model.predicted(x)[1] for x in drawn]))]

    def _least(self, model: ShapeModel, x: Array, tried: Array) -> Array:
        """The design with the least expected sum of squares; a random one if that has been tried."""
        starts = [x[k] + BESIDE * self._rng.normal(size=x.shape[1]) for k in range(min(BEST, len(x)))]
        starts += [self._drawn() for _ in range(RANDOM)]
        options = {"maxiter": STEPS}
        found = [minimize(self._folded, s, args=(model,), jac=True, method="L-BFGS-B", options=options) for s in starts]
        for one in sorted(found, key=lambda one: float(one.fun)):
            design = self._nearest(one.x)
            if np.all(np.abs(tried - design).max(axis=1) > SAME):
                return design
        return self._drawn()

    def _folded(self, u: Array, model: ShapeModel) -> tuple[float, Array]:
        """Logarithm of the expected square at the design nearest to u, which may be outside of it, and the gradient by u."""
        x = self._nearest(u)
        value, gradient = model.expected(x, self._caution)
        gradient = gradient / value
        for block, at in zip(self._space.blocks, self._space.slices, strict=True):
            length = float(np.linalg.norm(u[at]))
            if isinstance(block, Direction) or (isinstance(block, FieldVector) and length > 1.0):
                gradient[at] = (gradient[at] - (gradient[at] @ x[at]) * x[at]) / max(length, 1e-12)
        # a pull back toward the design, without which the search would wander where nothing changes
        return float(np.log(value) + 0.5 * np.sum((u - x) ** 2)), gradient * (1.0 - self._outside(u)) + (u - x)

    def _outside(self, u: Array) -> Array:
        """1 at plain numbers outside their bounds, where the nearest design stays the same."""
        found = np.zeros(len(u))
        for block, at in zip(self._space.blocks, self._space.slices, strict=True):
            if not isinstance(block, (Direction, FieldVector)):
                found[at] = (u[at] < 0) | (u[at] > 1)
        return found

    def _nearest(self, u: Array) -> Array:
        return self._space.nearest(u * self._scale) / self._scale

    def _embedded(self, trial: FrozenTrial) -> Array:
        return self._space.embedded(trial.params) / self._scale

    def _drawn(self) -> Array:
        return self._space.drawn(self._rng) / self._scale

    def _alike(self, corner: int) -> Array:
        """All segments in the direction of one corner of the study's tetrahedron; everything else at random."""
        turn, _ = np.linalg.qr(np.random.default_rng([self._seed]).normal(size=(3, 3)))
        found = self._drawn()
        for first in self._layout.directions:
            found[first : first + 3] = TETRAHEDRON[corner] @ turn
        return found

    def _order(self, trials: list[FrozenTrial]) -> str | None:
        """The order of the segments, where it varies: that of the best trial, or any, turn by turn."""
        if not self._space.choices:
            return None
        solved = [t for t in trials if "residuals" in t.user_attrs]
        if not solved or len(trials) % 2 == 0:
            return str(self._rng.choice(self._space.choices[0].choices))
        return str(min(solved, key=lambda t: (_square(t), t.number)).params["order"])


def _improved(trials: list[FrozenTrial]) -> bool:
    """True if the last trial is the best so far. If not, what is uncertain is no reason against the next design."""
    values = [float("inf") if t.value is None else t.value for t in trials]
    return values[-1] <= min(values)


def _square(trial: FrozenTrial) -> float:
    """Sum of squares of a trial's residuals."""
    return float(np.sum(np.square(trial.user_attrs["residuals"])))
