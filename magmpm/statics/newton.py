"""Newton's method to a minimum of the energy, globalised.

* Energy line search (Armijo), so every step goes down.
* Where the tangent is not positive definite, it is shifted until it is. The first shift is 1e-5 of its largest diagonal entry: bending is
  about 1e-6 as stiff as the stiffest mode, so this holds bending still while the stiff modes settle. A positive definite tangent
  is never shifted: even 1e-7 would stall the soft modes for dozens of steps.
* At a stationary point that is not a minimum (buckling, twist), the step goes down the direction of least curvature.
* It stops on the energy decrement relative to the energy of the load. Near the end, steps reuse the last factors (chord steps cost an
  eighth of a Newton step, and still shrink the error by its own size each).

Sources: Nocedal and Wright, Numerical Optimization, 2nd ed., chapter 3; negative curvature: More and Sorensen, Math. Prog. 16 (1979).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.statics.block_cholesky import factor, solve
from magmpm.statics.energy import Energy, Point

FIRST_SHIFT = 1e-5  # of the largest diagonal entry
SPURIOUS_PRESSURE = 1.0  # of G: a start that holds more is not factored before it is shifted, it would fail
NEAR = 1e-5  # of the energy scale: decrement below which the tangent hardly changes any more
LARGEST_SHIFT = 1e3
MOST_LEFT = 8  # unstable equilibria a solve may leave
LEAST_FRACTION = 1e-8  # of a step, before the line search gives up
ROUNDING = 1e-13  # of the energy scale: below it two energies can't be told apart
ROUNDING_AT_REST = (
    1e3  # of Energy.least_scale, 1e-15 of shear modulus times volume: nor below it, however small the load
)
Progress = Callable[[int, float], None]


@dataclass
class Minimum:
    """What Newton's method found: the point, its steps, and the factored tangent's energy decrement relative to the scale."""

    point: Point
    steps: int
    decrement: float
    left_unstable: int  # stationary points that were left along negative curvature


def minimise(
    energy: Energy, start: Array, *, tolerance: float, max_steps: int, on_step: Progress | None = None
) -> Minimum:
    """A minimum of the energy, from grid coefficients `start` (planes, m).

    tolerance: energy decrement over the energy scale at which to stop; on_step(step, decrement) is told of each step.
    Raises SolveError, with the last point as its state, when max_steps do not reach it or no step goes down.
    """
    point = energy.at(start)
    rest = energy.rest_energy()
    if not point.min_det_F > 0:
        raise SolveError("the start has det F <= 0", point)
    left, least_shift = 0, _expected_shift(energy, point)
    for step in range(1, max_steps + 1):
        residual, direction, shift = _step(energy, point, least_shift)
        least_shift = 0.0
        decrement = -float(np.sum(residual * direction)) / 2
        scale = max(abs(point.energy - rest), energy.least_scale())
        if decrement < NEAR * scale and shift == 0.0:
            near, reached = _chord_steps(energy, point, direction, decrement, tolerance * scale)
            if reached < tolerance * scale:
                return Minimum(near, step, reached / scale, left)
            # A soft direction (just past buckling) may be too curved for chord steps: then the line search goes on from here.
            point = near if reached < decrement else _search(energy, point, direction, decrement, scale)
        elif decrement < tolerance * scale:
            left += 1
            if left > MOST_LEFT:
                raise SolveError(f"the solve returned to unstable equilibria {MOST_LEFT} times", point)
            point = _search(energy, point, _leave(energy, residual, left), 0.0, scale)
        else:
            point = _search(energy, point, direction, decrement, scale)
        if on_step is not None:
            on_step(step, decrement / scale)
    raise SolveError(
        f"no equilibrium within {max_steps} Newton steps (energy decrement {decrement / scale:.1e} of the energy, "
        f"wanted {tolerance:.1e}); raise solver.static.max_steps or set solver.static.field_steps",
        point,
    )


def _expected_shift(energy: Energy, point: Point) -> float:
    """The shift a start is likely to need: its section field ignores the clamp, which leaves a spurious pressure there."""
    ratio = float(np.max(energy.model.bulk / energy.model.shear))
    return FIRST_SHIFT if ratio * max(1 - point.min_det_F, point.max_det_F - 1) > SPURIOUS_PRESSURE else 0.0


def _step(energy: Energy, point: Point, shift: float) -> tuple[Array, Array, float]:
    """Residual, Newton direction and the shift it took (at least `shift`), in units of the largest diagonal entry."""
    residual, shift = factored(energy, point, shift)
    return residual, -solve(energy.panels, energy.model.layout.split, residual), shift


def factored(energy: Energy, point: Point, shift: float = 0.0) -> tuple[Array, float]:
    """Residual, and the shift (at least `shift`) with which the tangent could be factored; the energy's panels hold the factors."""
    layout = energy.model.layout
    while True:
        residual, panels = energy.tangent(point)
        if shift > 0.0:
            diagonal = np.einsum("jaa->ja", panels[: layout.planes, :, : layout.m])
            diagonal += shift * diagonal.max()
        if factor(panels, layout.split) < 0:
            return residual, shift
        shift = max(FIRST_SHIFT, 10.0 * shift)
        if shift > LARGEST_SHIFT:
            raise SolveError(
                "the tangent can't be made positive definite: it holds values that are not finite", point
            )


def _chord_steps(
    energy: Energy, point: Point, direction: Array, decrement: float, enough: float
) -> tuple[Point, float]:
    """Full steps with the factors at hand, while each shrinks the decrement at least tenfold; the last point and its decrement.

    Near a minimum the energy can't tell two points apart any more (ROUNDING), so the decrement judges, not a line search.
    """
    split = energy.model.layout.split
    while True:
        trial = energy.at(point.grid + direction)
        if not trial.min_det_F > 0:
            return point, decrement
        residual = energy.residual(trial)
        direction = -solve(energy.panels, split, residual)
        reached = -float(np.sum(residual * direction)) / 2
        if reached < enough:
            last = energy.at(trial.grid + direction)  # its decrement is smaller still
            return last, reached
        if not reached < 0.1 * decrement:
            return (trial, reached) if reached < decrement else (point, decrement)
        point, decrement = trial, reached


def _leave(energy: Energy, residual: Array, attempt: int) -> Array:
    """Direction of least curvature, from the shifted factors the energy's panels hold: inverse iteration from a fixed vector."""
    layout, model = energy.model.layout, energy.model
    x = model.plane_coordinates()
    d = np.zeros((layout.planes, layout.m))
    # A straight rod buckles towards +z, unless something tells it otherwise. Each attempt starts from another mix of bending.
    _, second, third = model.order
    d[:, third::3] = (x**2)[:, None]
    d[:, second::3] = 1e-3 * attempt * (x**2)[:, None]
    energy.free(d)
    for _ in range(40):
        d = solve(energy.panels, layout.split, d)
        d /= np.abs(d).max()
    if float(np.sum(residual * d)) > 0.0:
        d = -d
    length = x[-1] - x[0]
    return 0.05 * length * d


def _search(energy: Energy, point: Point, direction: Array, decrement: float, scale: float) -> Point:
    """Backtrack along a direction until the energy falls as much as Armijo asks."""
    fraction = 1.0
    noise = max(ROUNDING * scale, ROUNDING_AT_REST * energy.least_scale())
    while True:
        trial = energy.at(point.grid + fraction * direction)
        enough = point.energy - 2e-4 * fraction * decrement + noise
        if trial.min_det_F > 0 and trial.energy <= enough:
            return trial
        fraction *= 0.5
        if fraction < LEAST_FRACTION:
            raise SolveError("no step lowers the energy: the line search gave up", point)
