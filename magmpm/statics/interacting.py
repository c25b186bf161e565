"""Equilibrium of a body that acts on itself: in one part of its energy, every particle interacts with all others.

The second derivative of this part is dense, and is never formed. Instead the step is preconditioned L-BFGS. It takes the gradient of the
whole energy and the factored tangent of the other parts; changes of the gradient in recent steps stand in for the missing tangent. Every
step lowers the whole energy, so the result is a minimum. Source: Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 7.4.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.errors import SolveError
from magmpm.statics.block_cholesky import solve
from magmpm.statics.energy import Energy, Point
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import (
    LEAST_FRACTION,
    ROUNDING,
    ROUNDING_AT_REST,
    Minimum,
    Progress,
    factored,
)

REMEMBERED = 12  # steps
FRESH = 6  # steps with one factorization
SHORT = 0.25  # of a full step: a shorter one asks for a new factorization
MOST_STEPS = 10  # times max_steps: these steps are cheap


class InteractingEnergy:
    """Whole energy of a model: effects on each particle by itself, and effects between all particles of the body."""

    def __init__(self, model: StaticModel) -> None:
        scene = model.scene.with_effects(magnetic_interaction=None)
        self.model = model
        self.alone = Energy(replace(model, scene=scene, effects=acting.collect(scene, times=model.times)))
        self.named = acting.collect(model.scene, times=model.times)
        self.whole = Energy(replace(model, effects=self.named))

    def at(self, grid: Array) -> Point:
        """State and whole energy for grid coefficients (planes, m) m. `residual` then uses its loads."""
        point = self.alone.at(grid)
        if not point.min_det_F > 0:
            return point
        acting.refresh(self.named, self.model, point.position, point.F)
        return replace(point, energy=point.energy + acting.shared_energy(self.named, self.model, point.position, point.F))

    def residual(self, point: Point) -> Array:
        """Gradient (planes, m) N of the whole energy, at the point from the last call of `at`."""
        return self.whole.residual(point)


def minimize_with_interaction(
    energy: InteractingEnergy, start: Array, *, tolerance: float, max_steps: int, on_step: Progress | None = None
) -> Minimum:
    """A minimum of the whole energy, from grid coefficients `start` (planes, m) m, as newton.minimize.

    Raises SolveError, with the last point as its state, if MOST_STEPS * max_steps steps do not reach it, or no step lowers the energy.
    """
    alone, split = energy.alone, energy.model.layout.split
    rest = energy.at(np.zeros_like(start)).energy
    point = energy.at(start)
    gradient = energy.residual(point)
    remembered: deque[tuple[Array, Array]] = deque(maxlen=REMEMBERED)
    age, decrement, scale = FRESH, np.inf, 1.0
    for step in range(1, MOST_STEPS * max_steps + 1):
        if age >= FRESH:
            factored(alone, point)
            age = 0
        direction = -_two_loop(gradient, remembered, lambda g: solve(alone.panels, split, g))
        decrement = -float(np.sum(gradient * direction)) / 2
        if not decrement > 0:  # the remembered steps are out of date
            remembered.clear()
            direction = -solve(alone.panels, split, gradient)
            decrement = -float(np.sum(gradient * direction)) / 2
        scale = max(abs(point.energy - rest), alone.least_scale())
        if on_step is not None:
            on_step(step, decrement / scale)
        if decrement < tolerance * scale:
            return Minimum(point, step, decrement / scale, 0)
        before, fraction = point, 1.0
        noise = max(ROUNDING * scale, ROUNDING_AT_REST * alone.least_scale())
        while True:
            point = energy.at(before.grid + fraction * direction)
            if point.min_det_F > 0 and point.energy <= before.energy - 2e-4 * fraction * decrement + noise:
                break
            fraction *= 0.5
            if fraction < LEAST_FRACTION:
                raise SolveError("no step lowers the energy: the line search gave up", before)
        after = energy.residual(point)
        remembered.append((point.grid - before.grid, after - gradient))
        if float(np.sum(remembered[-1][0] * remembered[-1][1])) <= 0:
            remembered.pop()
        gradient, age = after, FRESH if fraction <= SHORT else age + 1
    raise SolveError(
        f"no equilibrium of segments that act on each other within {MOST_STEPS * max_steps} steps (energy decrement "
        f"{decrement / scale:.1e} of the energy, wanted {tolerance:.1e}); raise solver.static.max_steps",
        point,
    )


def _two_loop(gradient: Array, remembered: deque[tuple[Array, Array]], precondition) -> Array:  # type: ignore[no-untyped-def]
    """The L-BFGS inverse Hessian times the gradient: the two-loop recursion."""
    q = gradient.copy()
    shares = []
    for s, y in reversed(remembered):
        share = float(np.sum(s * q)) / float(np.sum(s * y))
        shares.append(share)
        q -= share * y
    out = precondition(q)
    for (s, y), share in zip(remembered, reversed(shares), strict=True):
        out = out + (share - float(np.sum(y * out)) / float(np.sum(s * y))) * s
    return np.asarray(out)
