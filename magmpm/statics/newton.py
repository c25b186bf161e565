"""Globalized Newton's method for a minimum of the energy.

* Steps along arcs (statics.arcs), on which what turns is not stretched: so the next tangent is nearer to the minimum's. Where an arc wins
  less than half of what a quadratic would, the straight step is compared with it.
* An energy line search (Armijo), so every step lowers the energy.
* A tangent that is not positive definite is shifted until it is. The first shift is 1e-5 of its largest diagonal entry. Bending is
  about 1e-6 as stiff as the stiffest mode, so this shift freezes bending while the stiff modes settle. A positive definite tangent
  is never shifted: even 1e-7 would stall the soft modes for dozens of steps.
* At a stationary point that is not a minimum (buckling, twist), the step goes down the direction of least curvature.
* The method stops when the energy decrement is small relative to the energy of the load. Near the end, steps reuse the last factors. Such
  a chord step costs an eighth of a Newton step, and still reduces the error by a factor of about its own size.

Sources: Nocedal and Wright, Numerical Optimization, 2nd ed., chapter 3; negative curvature: More and Sorensen, Math. Prog. 16 (1979).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.scene import time_limit
from magmpm.statics.energy import Energy, Point

FIRST_SHIFT = 1e-5  # of the largest diagonal entry
NEAR_MINIMUM = 1e-5  # of the energy scale: below this decrement the tangent hardly changes
PAIRS = 6  # steps that a chord step remembers
LONGEST_ARC_STEP = 16.0  # times as far as `_leave` says
LEAST_FRACTION = 1e-8  # of a step: below it the line search gives up
ENERGY_ROUNDING = 1e-13  # of the energy scale: smaller differences of energies are rounding errors
# of Energy.least_scale, 1e-15 of shear modulus times volume: nor below it, however small the load
ROUNDING_AT_REST = 1e3
OnStep = Callable[
    [int, float], None
]  # of a solve: called after each step with its number and its energy decrement


@dataclass(frozen=True)
class Chord:
    """Rule by which steps reuse the last factors.

    near: those with a decrement below this part of the energy scale; gain: while each leaves less than this part of the decrement;
    corrected: by L-BFGS, which makes up for the change of the tangent since it was factored by what the gradient did in the last steps
    (Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 7.4, with the factored tangent as the first Hessian); trusted: a
    start is a neighbor's shape, so that its tangent is not shifted unless its factors fail.
    """

    near: float = NEAR_MINIMUM
    gain: float = 0.1
    corrected: bool = False
    trusted: bool = False


USUAL = Chord()
FOLLOWING = Chord(
    near=1e-3, gain=0.5, corrected=True, trusted=True
)  # where many neighbors are solved, each from the last


@dataclass
class Minimum:
    """Result of Newton's method: the point, number of steps, and energy decrement of the factored tangent relative to the scale."""

    point: Point
    steps: int
    decrement: float


def minimize(
    energy: Energy,
    start: Array,
    *,
    tolerance: float,
    max_steps: int,
    on_step: OnStep | None = None,
    chord: Chord = USUAL,
) -> Minimum:
    """A minimum of the energy, from grid coefficients `start` (planes, m) m.

    tolerance: energy decrement over the energy scale at which to stop; on_step(step, decrement): called after each step.
    Raises SolveError, with the last point as its state, if max_steps or 15 steps lead nowhere, or no step lowers the energy.
    """
    most_left = 8  # unstable equilibria that one solve may leave
    # steps that together win less than a tenth of what the next one promises: the solve leads nowhere
    stall = 15
    # shifted steps in a row, after which the body goes along the mode that the shift slows down
    crawl = 8
    point = energy.at(start)
    rest = energy.rest_energy()
    if not point.min_det_F > 0:
        raise SolveError("the start has det F <= 0", point)
    left = 0
    shifted = 0
    least_shift = 0.0 if chord.trusted else _expected_shift(energy, point)
    energies = [point.energy]
    for step in range(1, max_steps + 1):
        residual, direction, shift = _step(energy, point, least_shift)
        least_shift = 0.0
        shifted = shifted + 1 if shift > 0.0 else 0
        decrement = fall(residual, direction)
        scale = max(abs(point.energy - rest), energy.least_scale())
        if (
            tolerance * scale < decrement < NEAR_MINIMUM * scale and shift > 0.0
        ):  # only a soft mode is left: FIRST_SHIFT would freeze it
            residual, direction, shift = _step(
                energy, point, 1e-9
            )  # the softest modes, bending and twist, are 1e-7 to 1e-9 as stiff
            decrement = fall(residual, direction)
        if decrement < chord.near * scale and shift == 0.0:
            near, reached = _chord_steps(
                energy, point, residual, direction, decrement, tolerance * scale, chord
            )
            if reached < tolerance * scale:
                return Minimum(near, step, reached / scale)
            # A soft direction (just past buckling) may be too nonlinear for chord steps. Then the line search continues from here.
            point = (
                near if reached < decrement else _search(energy, point, direction, decrement, scale)
            )
        elif decrement < tolerance * scale:
            left += 1
            if left > most_left:
                raise SolveError(
                    f"the solve returned to unstable equilibria {most_left} times", point
                )
            point = _search(energy, point, _leave(energy, residual, left), 0.0, scale)
        else:
            point = _search(energy, point, direction, decrement, scale)
            if shifted and shifted % crawl == 0:
                point = _along_mode(energy, point, residual, shifted // crawl)
        if on_step is not None:
            on_step(step, decrement / scale)
        energies.append(point.energy)
        if (
            step >= stall
            and decrement > NEAR_MINIMUM * scale
            and energies[-1 - stall] - point.energy < 0.1 * decrement
        ):
            raise _not_found(
                point,
                f"after {step} Newton steps, of which the last {stall} made no progress",
                decrement / scale,
                tolerance,
                _unsettled(energy, direction),
            )
    raise _not_found(
        point,
        f"within {max_steps} Newton steps",
        decrement / scale,
        tolerance,
        _unsettled(energy, direction),
    )


def _not_found(
    point: Point, after: str, decrement: float, tolerance: float, unsettled: str
) -> SolveError:
    return SolveError(
        f"no equilibrium {after} (energy decrement {decrement:.1e} of the energy, wanted"
        f" {tolerance:.1e}){unsettled}",
        point,
    )


def _unsettled(energy: Energy, direction: Array) -> str:
    """Words that name the part which the last Newton direction (planes, m) m moves most; none for a body of one part."""
    model = energy.model
    particles = model.particles
    regions = model.scene.regions()
    if model.scene.body.shape.line is not None or len(regions) < 2:
        return ""
    squares = np.sum(energy.displacement(direction) ** 2, axis=1)
    volume = np.bincount(particles.segment, particles.volume, len(regions))
    moved = np.bincount(particles.segment, particles.volume * squares, len(regions))
    size = np.sqrt(moved / np.maximum(volume, 1e-300))
    most = int(np.argmax(size))
    return (
        f"; {regions[most].name} does not settle: the last step would move it by"
        f" {1e3 * size[most]:.2g} mm (root mean square over it)"
    )


def fall(residual: Array, direction: Array) -> float:
    """Decrement of the energy, J, that a quadratic has along a Newton step."""
    return -float(np.sum(residual * direction)) / 2


def _expected_shift(energy: Energy, point: Point) -> float:
    """Likely shift for a start: its section field ignores the clamp, and where the pressure there exceeds G, no factorization succeeds."""
    ratio = float(np.max(energy.model.bulk / energy.model.shear))
    return FIRST_SHIFT if ratio * max(1 - point.min_det_F, point.max_det_F - 1) > 1.0 else 0.0


def _step(energy: Energy, point: Point, shift: float) -> tuple[Array, Array, float]:
    """Residual, Newton direction, and the shift it needed (at least `shift`), in units of the largest diagonal entry."""
    residual, shift = factored(energy, point, shift)
    return residual, -energy.matrix.solve(residual), shift


def factored(energy: Energy, point: Point, shift: float = 0.0) -> tuple[Array, float]:
    """Residual, and the shift (at least `shift`) that made the tangent positive definite. The energy's matrix is then factored."""
    time_limit.check()
    while True:
        residual, matrix = energy.tangent(point)
        if shift > 0.0:
            matrix.add_diagonal(shift * matrix.diagonal().max())
        if matrix.factor():
            return residual, shift
        shift = 10.0 * shift if shift > 0.0 else FIRST_SHIFT
        if shift > 1e3:
            raise SolveError(
                "the tangent can't be made positive definite: it holds values that are not finite",
                point,
            )


def _chord_steps(
    energy: Energy,
    point: Point,
    residual: Array,
    direction: Array,
    decrement: float,
    enough: float,
    chord: Chord = USUAL,
) -> tuple[Point, float]:
    """Take full steps with the last factors, while each gains enough. Returns the last point and its decrement.

    Near a minimum, differences of the energy are rounding errors (ENERGY_ROUNDING). So the decrement decides, not a line search.
    """
    pairs: list[tuple[Array, Array]] = []
    while True:
        trial = energy.at(point.grid + direction)
        if not trial.min_det_F > 0 or not _same_contact(point, trial):
            return point, decrement
        residual, before = energy.residual(trial), residual
        if chord.corrected:
            pairs = [*pairs[1 - PAIRS :], (direction, residual - before)]
        direction = corrected(residual, pairs, lambda right: -energy.matrix.solve(right))
        reached = fall(residual, direction)
        if reached < enough:
            last = energy.at(trial.grid + direction)  # its decrement is even smaller
            return (last, reached) if _same_contact(trial, last) else (point, decrement)
        if not reached < chord.gain * decrement:
            return point, decrement
        point = trial
        decrement = reached


def _same_contact(one: Point, other: Point) -> bool:
    """True if the same points touch: else the factors of one tell nothing of the other, such as that it is a minimum."""
    if one.pattern is None or other.pattern is None:
        return True
    return np.array_equal(one.pattern, other.pattern)


def corrected(
    residual: Array, pairs: list[tuple[Array, Array]], newton: Callable[[Array], Array]
) -> Array:
    """The direction of a step, from the last steps and what they changed in the residual; newton: that of the factors alone.

    Steps along which the energy does not curve upward, steps of length zero among them, tell nothing and are left out.
    """
    usable = [
        (step, change, curved)
        for step, change in pairs
        if (curved := float(np.sum(step * change))) > 0.0
    ]
    q = residual
    parts = []
    for step, change, curved in reversed(usable):
        parts.append(float(np.sum(step * q)) / curved)
        q = q - parts[-1] * change
    direction = newton(q)
    for (step, change, curved), part in zip(usable, reversed(parts), strict=True):
        direction -= step * (part + float(np.sum(change * direction)) / curved)
    return direction


def refined(energy: Energy, point: Point, enough: float = 1e-18) -> Point:
    """The minimum near a point that `minimize` found with these factors, more closely: what is differentiated needs more digits.

    Chord steps until the decrement is below `enough` of the energy scale, or falls no further; six of them at most. The step after such a
    decrement is still taken: it leaves an error of less than the root of `enough` in the energy's norm, usually a thirtieth of that.
    """
    scale = max(abs(point.energy - energy.rest_energy()), energy.least_scale())
    last = np.inf
    for _ in range(6):
        residual = energy.residual(point)
        direction = -energy.matrix.solve(residual)
        decrement = fall(residual, direction)
        trial = energy.at(point.grid + direction)
        if not (0.0 < decrement < 0.5 * last and trial.min_det_F > 0):
            break
        point = trial
        last = decrement
        if decrement < enough * scale:
            break
    return point


def _leave(energy: Energy, residual: Array, attempt: int) -> Array:
    """Direction of least curvature, from the shifted factors, by inverse iteration from a fixed vector."""
    layout = energy.model.layout
    model = energy.model
    x = model.plane_coordinates()
    # A straight rod buckles toward +z unless a load decides otherwise. Each attempt starts from another mix of bending.
    aside = model.frame @ [0.0, 1e-3 * attempt, 1.0]
    d = energy.free(np.outer(x**2, np.tile(aside, layout.nodes_per_plane)))
    for _ in range(40):
        d = energy.matrix.solve(d)
        d /= np.abs(d).max()
    if float(np.sum(residual * d)) > 0.0:
        d = -d
    length = x[-1] - x[0]
    return 0.05 * length * d


def _along_mode(energy: Energy, point: Point, residual: Array, attempt: int) -> Point:
    """The lowest of states along the direction of least curvature, each twice as far as the one before; the point itself if none is lower.

    Where a body is about to buckle, a shift that makes the tangent positive definite slows down the very mode that it buckles in: steps
    then grow by a percent each, for hundreds of steps.
    """
    way = _leave(energy, residual, attempt)
    found = _doubled(energy, point, way, 2.0**-6, point)
    return _doubled(energy, point, way, -(2.0**-6), point) if found is point else found


def _doubled(energy: Energy, point: Point, way: Array, part: float, best: Point) -> Point:
    """The lowest of `best` and states along an arc, each twice as far as the one before, from a part of it on, which may be negative."""
    while abs(part) <= LONGEST_ARC_STEP:
        trial = energy.at(energy.arc(point, way, part))
        if not (trial.min_det_F > 0 and trial.energy < best.energy):
            break
        if energy.clear_share(point.grid, trial.grid - point.grid) < 1.0:
            break
        best = trial
        part *= 2.0
    return best


def _farther(energy: Energy, point: Point, direction: Array, reached: Point) -> Point:
    """The lowest of the states beyond a full step of parts, each twice as far along its arc as the one before.

    A shift holds steps back: where the energy falls almost as fast at the end of a step as at its beginning, more of the same is free of
    a new tangent. Straight bodies have a rod to start from, and little to gain.
    """
    if energy.model.layout.straight:
        return reached
    return _doubled(energy, point, direction, 2.0, reached)


def _search(
    energy: Energy, point: Point, direction: Array, decrement: float, scale: float
) -> Point:
    """Backtrack along a direction, on an arc or straight, until the energy satisfies the Armijo condition."""
    # times the decrement: what a step wins whose end is far from the minimum along its way (of a
    # quadratic the step wins as much as the decrement, and twice as much if the energy falls evenly)
    beyond = 1.5
    fraction = energy.clear_share(point.grid, direction)
    noise = max(ENERGY_ROUNDING * scale, ROUNDING_AT_REST * energy.least_scale())
    while True:
        enough = point.energy - 2e-4 * fraction * decrement + noise
        trial = energy.at(energy.arc(point, direction, fraction))
        won = point.energy - trial.energy if trial.min_det_F > 0 else -np.inf
        if won < 0.5 * fraction * decrement:  # half of what it wins in a quadratic
            straight = energy.at(point.grid + fraction * direction)
            if straight.min_det_F > 0 and not straight.energy >= trial.energy:
                trial = straight
        if trial.min_det_F > 0 and trial.energy <= enough:
            if fraction == 1.0 and point.energy - trial.energy > beyond * decrement:
                return _farther(energy, point, direction, trial)
            return trial
        fraction *= 0.5
        if fraction < LEAST_FRACTION:
            raise SolveError("no step lowers the energy: the line search failed", point)
