"""gp: Bayesian search with a model of the shape, not of its distance from the target.

The distance is a known function of the shape: from a model of the points at the target's stations (ShapeModel), the expected square of
the rms has a closed form, with its gradient. The next trial is the design at which it is least, on the sphere of each direction and within
the bounds of all else, from several starts. So a trial teaches where every point goes, also one that is far from the target.

The first two trials magnetize all segments alike, in two of the directions with which `tpe` begins. After two trials that brought little,
one looks where the model knows least: a model of designs that are alike is too sure of itself. A trial that failed has no shape and is left
out of the model; its design is not tried again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from magmpm.compiled.arrays import Array, Plain
from magmpm.studies.search.parameters import corner_of
from magmpm.studies.search.samplers.blocks import Ball, Direction
from magmpm.studies.search.samplers.optuna_ids import other_trials, value_of
from magmpm.studies.search.search_space import SearchSpace

# of the parameters: five of the axes, correlation and power of the place, factor of the others, weight, range
PRIOR = np.array(
    [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0, 1.0]
)  # their means: logarithms, but for shears and the power
SPREAD = np.array([1.0, 1.0, 0.5, 0.5, 0.5, 1.0, 0.7, 1.0, 1.5, 1.0])  # and standard deviations
OWN = 0.5  # weight of the sample's variance in an amplitude, in designs


@dataclass(frozen=True)
class CoordinateKinds:
    """Places of the embedded coordinates that are directions, three each, base to tip, and of those that are not, one each.

    Attributes
    ----------
    directions : tuple of int
        First coordinate of each direction.
    others : tuple of int
        Each other coordinate.
    """

    directions: tuple[int, ...]  # first coordinate of each
    others: tuple[int, ...]

    @property
    def count(self) -> int:
        """Directions and other coordinates."""
        return max(1, len(self.directions) + len(self.others))

    def matrix(self, p: Array, size: int) -> Array:
        """Make the matrix that brings coordinates to those of the kernel, z = x @ A.T.

        Parameters
        ----------
        p : array (10,)
            The model's parameters (PRIOR).
        size : int
            Number of embedded coordinates.

        Returns
        -------
        array (size, size)
            A transposed.
        """
        found = np.zeros((size, size))
        k = len(self.directions)
        if k:
            axes = np.array(
                [[np.exp(p[0]), 0, 0], [p[2], np.exp(p[1]), 0], [p[3], p[4], np.exp(-p[0] - p[1])]]
            )
            place = (np.arange(k) + 0.5) / k
            distance = np.abs(np.subtract.outer(place, place))
            correlation = p[5]
            power = p[6]
            along = (
                np.linalg.cholesky(np.exp(-distance * np.exp(-correlation)))
                * (place**power)[:, None]
            )
            both = np.kron(along, axes)
            both *= np.sqrt(3 * k / np.sum(both**2))
            rows = np.concatenate([np.arange(first, first + 3) for first in self.directions])
            found[np.ix_(rows, rows)] = both
        found[list(self.others), list(self.others)] = np.exp(p[7])
        return found


class ShapeModel:
    """A Gaussian process of a shape, of n >= 2 designs.

    Residuals are reduced to their principal components over the known designs, and each component
    is a Gaussian process of its own amplitude. All share one kernel of the embedded coordinates x,
    brought to z = A x:

        k(x, x') = (1 + z.z') / (1 + n) + w (1 + r + r^2 / 3) exp(-r),   r = sqrt(5) |z - z'| / l,

    with n the number of directions and other coordinates. The first part is linear: a shape is
    nearly linear in small moments. The second is Matern's kernel with smoothness 5/2. A says how
    much which coordinate matters. Of the directions it is a Kronecker product: axes of a direction
    count differently (a magnet along the field feels no torque), segments that are neighbors act
    alike (their correlation falls as exp(-distance / c)), and segments matter by a power of their
    place along the body. Of a field or a number it is a factor (docs/design.md has its errors of
    prediction).

    The parameters are those of greatest posterior density: their likelihood, with the amplitudes at
    their best, and normal priors.

    Parameters
    ----------
    layout : CoordinateKinds
        Kinds of the coordinates.
    x : array (n, size)
        Embedded coordinates of the designs.
    residuals : array (n, m)
        Of each design.

    References
    ----------
    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2, 4.2 and
    5.4.1; the composite of a model and a known function: Astudillo and Frazier, ICML 2019.
    """

    def __init__(self, layout: CoordinateKinds, x: Array, residuals: Array) -> None:
        self._layout = layout
        self._x = x
        self._mean = residuals.mean(axis=0)
        _, sizes, basis = np.linalg.svd(residuals - self._mean, full_matrices=False)
        share = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
        self._basis = basis[: max(1, min(int(np.sum(share < 1 - 1e-6)) + 1, len(x) - 1))]
        self._scores = (residuals - self._mean) @ self._basis.T
        self._variance = self._scores.var(axis=0) + 1e-300
        found = minimize(
            self._cost,
            PRIOR,
            method="L-BFGS-B",
            bounds=[(-4.0, 4.0)] * len(PRIOR),
            options={"maxiter": 30},
        )
        self._p = np.asarray(found.x, dtype=float)
        self._a = layout.matrix(self._p, x.shape[1])
        self._z = x @ self._a
        self._factor, white = self._whitened(self._z, self._p)
        self._amplitude = self._amplitudes(white)
        self._weights: Array = np.asarray(cho_solve((self._factor, True), self._scores))
        self._left = (
            -self._basis @ self._mean
        )  # scores at which the residuals within the basis vanish
        self._beyond = float(self._mean @ self._mean - self._left @ self._left)

    def _whitened(self, z: Array, p: Array) -> tuple[Array, Array]:
        # 1e-7 of the variance of 1: solves are exact but for rounding and their tolerance
        factor = np.asarray(np.linalg.cholesky(self._kernel(z, z, p) + 1e-7 * np.eye(len(z))))
        return factor, np.asarray(solve_triangular(factor, self._scores, lower=True))

    def _amplitudes(self, white: Array) -> Array:
        """Variance of each component: the best, drawn a little toward that of its scores."""
        return np.asarray((np.sum(white**2, axis=0) + OWN * self._variance) / (len(white) + OWN))

    def _cost(self, p: Array) -> float:
        """Negative logarithm of the posterior density of the parameters, to a constant."""
        factor, white = self._whitened(self._x @ self._layout.matrix(p, self._x.shape[1]), p)
        n, count = self._scores.shape
        likelihood = count * np.sum(np.log(np.diag(factor))) + 0.5 * (n + OWN) * np.sum(
            np.log(self._amplitudes(white))
        )
        return float(likelihood + 0.5 * np.sum(((p - PRIOR) / SPREAD) ** 2))

    def _kernel(self, a: Array, b: Array, p: Array) -> Array:
        product = a @ b.T
        squares = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * product
        r = np.sqrt(5 * np.maximum(squares, 0.0)) / np.exp(p[9])
        return np.asarray(
            (1 + product) / (1 + self._layout.count)
            + np.exp(p[8]) * (1 + r + r * r / 3) * np.exp(-r)
        )

    def predicted(self, x: Array) -> tuple[Array, Array]:
        """Predict the residuals of a design.

        Parameters
        ----------
        x : array (size,)
            Its embedded coordinates.

        Returns
        -------
        mean : array (m,)
            Of the residuals.
        variance : array ()
            Of their whole.
        """
        scores, variance, _, _ = self._at(x)
        return scores @ self._basis + self._mean, np.array(variance * self._amplitude.sum())

    def _at(self, x: Array) -> tuple[Array, float, Array, Array]:
        z = x @ self._a
        k = self._kernel(z[None], self._z, self._p)[0]
        white = np.asarray(solve_triangular(self._factor, k, lower=True))
        own = (1 + z @ z) / (1 + self._layout.count) + np.exp(self._p[8])
        return k @ self._weights, max(float(own - white @ white), 1e-12), z, white

    def expected(self, x: Array, caution: float = 1.0) -> tuple[float, Array]:
        """Find the expected sum of squares of the residuals of a design, and its gradient.

        Of independent normal components with means m_j and variances v_j, that of the sum of m_j^2
        is the sum of m_j^2 + v_j.

        Parameters
        ----------
        x : array (size,)
            Its embedded coordinates.
        caution : float, default 1.0
            How much the variances count; 0 gives the square of the means alone.

        Returns
        -------
        value : float
            The expected sum.
        gradient : array (size,)
            By the coordinates.
        """
        scores, variance, z, white = self._at(x)
        off = scores - self._left
        total = caution * float(self._amplitude.sum())
        weight = np.exp(self._p[8])
        range_ = float(np.exp(self._p[9]))
        difference = z - self._z
        r = np.sqrt(5 * np.sum(difference**2, axis=1)) / range_
        slopes = self._z / (1 + self._layout.count)
        slopes = (
            slopes - (weight * 5 / (3 * range_**2) * (1 + r) * np.exp(-r))[:, None] * difference
        )
        back = np.asarray(solve_triangular(self._factor, white, lower=True, trans=1))
        of_variance = 2 * z / (1 + self._layout.count) - 2 * back @ slopes
        gradient = 2 * off @ (self._weights.T @ slopes) + total * of_variance
        return float(off @ off + total * variance + self._beyond), gradient @ self._a.T


def layout_of(sizes: Sequence[tuple[bool, int]]) -> CoordinateKinds:
    """Find which coordinates of blocks are directions.

    Parameters
    ----------
    sizes : sequence of tuple[bool, int]
        Of each block in order: whether it is a direction, and how many coordinates it has.

    Returns
    -------
    CoordinateKinds
        The kinds of the coordinates.
    """
    directions: list[int] = []
    others: list[int] = []
    first = 0
    for is_direction, size in sizes:
        if is_direction:
            directions.append(first)
        else:
            others += range(first, first + size)
        first += size
    return CoordinateKinds(tuple(directions), tuple(others))


@dataclass(frozen=True)
class GpSettings:
    """Settings of the sampler gp.

    Attributes
    ----------
    alike : int
        Trials before there is a model.
    starts : tuple[int, int]
        Of the search for the next design: the best so far, and random ones.
    steps : int
        Of each start.
    most : int
        Designs in a model, the nearest to the target.
    little : float
        Two trials that leave more than this part of the distance have brought little.
    drawn : int
        Designs among which the one is chosen that the model knows least of.
    """

    alike: int = 2
    starts: tuple[int, int] = (2, 6)
    steps: int = 60
    most: int = 120
    little: float = 0.9
    drawn: int = 64


class ShapeSampler(optuna.samplers.BaseSampler):
    """Chooses the trial after a number of finished ones by a Gaussian process of the shape.

    The choice depends on the seed, and on finished and running trials alone.

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
        self._space = space
        self._seed = seed
        self._settings = GpSettings()
        self._rng = np.random.default_rng([seed, finished, 1])
        self._caution = 1.0
        self._scale = np.ones(space.size)
        for block, at in space.those(Ball):
            self._scale[at] = block.radius
        self._layout = layout_of(
            [(isinstance(block, Direction), block.size) for block in space.blocks]
        )

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        return self._space.distributions()

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """A value of a parameter that is not of the search space, of which a study has none. Drawn evenly, as by the other samplers."""
        drawn = optuna.samplers.RandomSampler(seed=int(self._rng.integers(2**32)))
        return drawn.sample_independent(study, trial, param_name, param_distribution)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> Plain:
        ended, running, before = other_trials(study, trial, search_space)
        trials = [t for t in ended if t.state == TrialState.COMPLETE]
        if len(trials) + before < self._settings.alike:
            return self._space.parameters_at(self._alike(len(trials) + before) * self._scale)
        known = [t for t in trials if "residuals" in t.user_attrs]
        done = [self._embedded(t) for t in trials]
        pending = np.array([self._embedded(t) for t in running]).reshape(-1, self._space.size)
        tried = np.concatenate([np.array(done).reshape(-1, self._space.size), pending])
        if len(known) < self._settings.alike or not self._space.size:
            return self._space.parameters_at(self._drawn() * self._scale)
        known = sorted(known, key=lambda t: (_square(t), t.number))[: self._settings.most]
        x = np.array([self._embedded(t) for t in known])
        # if the last trial is not the best so far, what is uncertain is no reason against the next design
        values = [value_of(t) for t in trials]
        self._caution = 1.0 if values[-1] <= min(values) else 0.0
        residuals = np.array([t.user_attrs["residuals"] for t in known], dtype=float)
        model = ShapeModel(self._layout, x, residuals)
        if len(
            pending
        ):  # what is being solved counts as found where the model expects it (the kriging believer, Ginsbourger et al. 2010)
            expected = np.array([model.predicted(one)[0] for one in pending])
            model = ShapeModel(
                self._layout, np.concatenate([x, pending]), np.concatenate([residuals, expected])
            )
        if self._stuck(values):
            drawn = [self._drawn() for _ in range(self._settings.drawn)]
            chosen = drawn[
                int(np.argmax([model.predicted(one)[1] for one in drawn]))
            ]  # that the model knows least of
        else:
            chosen = self._least(model, x, tried)
        return self._space.parameters_at(chosen * self._scale)

    def _stuck(self, values: list[float]) -> bool:
        """True if two trials have brought little. Every other trial then looks elsewhere: a model of similar designs is too sure."""
        enough = len(values) > self._settings.alike + 1 and len(values) % 2 == 0
        return enough and min(values[-2:]) > self._settings.little * min(values[:-2])

    def _least(self, model: ShapeModel, x: Array, tried: Array) -> Array:
        """The design with the least expected sum of squares; a random one if that has been tried."""
        best, random = self._settings.starts
        # beside good designs, where no start is a maximum of certainty
        starts = [x[k] + 0.05 * self._rng.normal(size=x.shape[1]) for k in range(min(best, len(x)))]
        starts += [self._drawn() for _ in range(random)]
        options = {"maxiter": self._settings.steps}
        found = [
            minimize(self._folded, s, args=(model,), jac=True, method="L-BFGS-B", options=options)
            for s in starts
        ]
        for one in sorted(found, key=lambda one: float(one.fun)):
            design = self._nearest(one.x)
            if np.all(np.abs(tried - design).max(axis=1) > 1e-3):
                return design
        return self._drawn()

    def _folded(self, u: Array, model: ShapeModel) -> tuple[float, Array]:
        """Logarithm of the expected square at the design nearest to u, which may be outside of it, and the gradient by u."""
        x = self._nearest(u)
        value, gradient = model.expected(x, self._caution)
        gradient = gradient / value
        for block, at in self._space.parts:
            length = float(np.linalg.norm(u[at]))
            if isinstance(block, Direction) or (isinstance(block, Ball) and length > 1.0):
                gradient[at] = (gradient[at] - (gradient[at] @ x[at]) * x[at]) / max(length, 1e-12)
        # a pull back toward the design, without which the search would wander where nothing changes
        return float(np.log(value) + 0.5 * np.sum((u - x) ** 2)), gradient * (
            1.0 - self._outside(u)
        ) + (u - x)

    def _outside(self, u: Array) -> Array:
        """1 at plain numbers outside their bounds, where the nearest design stays the same."""
        found = np.zeros(len(u))
        for block, at in self._space.parts:
            if not isinstance(block, (Direction, Ball)):
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
        found = self._drawn()
        for first in self._layout.directions:
            found[first : first + 3] = corner_of(self._seed, corner)
        return found


def _square(trial: FrozenTrial) -> float:
    """Sum of squares of a trial's residuals."""
    return float(np.sum(np.square(trial.user_attrs["residuals"])))
