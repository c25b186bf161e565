"""Static equilibrium of a model, on the branch that grows from zero load.

First the rod model is followed from zero to full load (milliseconds). Its shape starts the 3D solve. If the rod fails, if the 3D solve
fails, or if its result is far from the rod, the load is ramped in the 3D solve itself. Where a rod's shape is given, the equilibrium near
it is found instead, on whatever branch it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from magmpm.bodies.curves import tightest_radius
from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.effects import acting
from magmpm.errors import LeftField, SolveError, TimeOver
from magmpm.materials import poisson_ratio
from magmpm.rod.cosserat import RodShape, solve_rod
from magmpm.scene.load_progress import load_step
from magmpm.statics import axis
from magmpm.statics.branch import (
    EquilibriumPath,
    GrowingLoads,
    Lift,
    Reached,
    outside_domain,
    point_of,
)
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy, minimize_with_interaction
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import FOLLOWING, USUAL, Minimum, OnStep, minimize
from magmpm.statics.rod_start import from_rod, local_correction, straight, with_correction
from magmpm.statics.stability import stability
from magmpm.statics.steady_stream import in_stream

RAMP_STEPS = 8


@dataclass
class Following:
    """Data that a solve leaves for its neighbors: its energy with all arrays.

    expected: what neighbors say that a solve will add to its rod, coefficients (planes, m), m, in the rod's frames; None: they don't know.
    judged: whether the stability of each is found.
    """

    expected: Callable[[RodShape], Array | None]
    with_stability: bool = True
    energy: Energy | None = None

    def loaded(self, model: StaticModel) -> Energy:
        """The energy of a model: the last one with another load, if it is of the same body (model_at_rest), magnetized in the same way."""
        last = None if self.energy is None else self.energy.model
        if self.energy is None or last is None or not _alike(model, last):
            self.energy = Energy(model)
        self.energy.load(model)
        return self.energy


def _alike(one: StaticModel, other: StaticModel) -> bool:
    """True if two models share what loads do not change (model_at_rest), and what loads act on is the same to the last bit."""
    return (
        one.layout is other.layout
        and np.array_equal(one.remanence, other.remanence)
        and np.array_equal(one.density, other.density)
    )


@dataclass(frozen=True)
class _Start:
    """Start of a solve: see solve_static."""

    correction: Array | None
    rod: RodShape | None
    following: Following | None = None


@dataclass
class Equilibrium:
    """Result of a static solve.

    point: the state; steps: Newton steps of the solves that led there; correction (planes, m) m: what the solve added to the rod's
    shape, in the rod's frames, a start for a neighboring design; warnings: what a user should know; load_share: share of the load
    in this state; energy: of the model with its axes in the solver's order (None where the solve failed), its matrix with the last factors;
    stability: smallest eigenvalue of the tangent over the unloaded body's (statics.stability), None where the solve failed; model: whose
    it is, where the solve failed; start: name of the way in which the solve began (WAYS).
    """

    point: Point
    steps: int
    correction: Array
    warnings: list[str] = field(default_factory=list)
    load_share: float = 1.0
    energy: Energy | InteractingEnergy | None = None
    stability: float | None = None
    model: StaticModel | None = None
    start: str = ""


def solve_static(
    model: StaticModel,
    *,
    correction: Array | None = None,
    rod: RodShape | None = None,
    on_step: OnStep | None = None,
    with_stability: bool = True,
    following: Following | None = None,
) -> Equilibrium:
    """Equilibrium of a model. correction (planes, m) m: that of a neighboring design, to start from; rod: a shape to find it near;
    judged: find its stability as well; following: what solves of neighbors left, which makes this one quick, and which it changes.

    Raises SolveError, with the last good Equilibrium as its state, or where none is found near `rod`; ValueError for a rod's shape of
    another length, or a body that is not straight and held at its base alone.
    """
    model.scene.check_energy()
    body = model.scene.body.shape
    if rod is not None and (
        body.clamp != "base" or not isinstance(body, StraightBody) or model.touching is not None
    ):
        raise ValueError(
            "start: a rod's shape is a start for catheters and strips that are held at the base"
            " alone and touch no obstacle"
        )
    if rod is not None and abs(rod.s[-1] - model.scene.length) > 1e-6 * model.scene.length:
        lengths = (
            f"the rod is {1e3 * rod.s[-1]:.6g} mm long, and the body"
            f" {1e3 * model.scene.length:.6g} mm"
        )
        raise ValueError(f"start: {lengths}; give a rod of its length")
    with one_blas_thread():
        try:
            found = _solve(model, _Start(correction, rod, following), on_step)
            fluid = model.scene.effects.fluid
            if fluid is not None and fluid.flows:
                found = _in_stream(model, found, on_step)
            assert found.energy is not None
            found.energy.alone.settled()
            with_stability = with_stability and (following is None or following.with_stability)
            settled = stability(found.energy, found.point) if with_stability else None
            return replace(found, stability=settled)
        except SolveError as error:
            state = error.state
            rest = straight(model)
            if not isinstance(state, Equilibrium):  # none was found under load
                state = Equilibrium(Energy(model).at(rest), 0, rest, load_share=0.0)
            raise type(error)(error.reason, replace(state, model=model)) from None


def _in_stream(model: StaticModel, found: Equilibrium, on_step: OnStep | None) -> Equilibrium:
    """The equilibrium in the stream of a model's fluid, from that without drag."""
    energy = found.energy
    assert energy is not None
    try:
        last = in_stream(model, energy, found.point, on_step)
    except SolveError as error:
        at = error.state if isinstance(error.state, Point) else found.point
        raise type(error)(error.reason, replace(found, point=at)) from None
    return replace(found, point=last.point, steps=found.steps + last.steps)


def _solve(model: StaticModel, start: _Start, on_step: OnStep | None) -> Equilibrium:
    itself = acting.feels_itself(model.scene)
    try:
        found = (_settle if itself else _branch)(model, start, on_step)
    except SolveError as error:
        at = error.state.point if isinstance(error.state, Equilibrium) else error.state
        raise (
            _outside_domain(model, at, error.state) or _kinked(model, at, error) or error
        ) from None
    outside = _outside_domain(model, found.point, found)
    if outside is not None:
        raise outside
    return found


def _outside_domain(model: StaticModel, point: object, state: object) -> SolveError | None:
    """The error of `outside_domain`, with the state of the solve."""
    found = outside_domain(model, point) if isinstance(point, Point) else None
    return None if found is None else type(found)(found.reason, state)


def _kinked(model: StaticModel, point: object, error: SolveError) -> SolveError | None:
    """The error if a solve failed where a tube is about to kink; else None."""
    tube = model.scene.body.catheter
    if tube is None or not isinstance(point, Point) or type(error) is not SolveError:
        return None
    limit = tube.kink_radius(float(poisson_ratio(model.shear, model.bulk).max()))
    if (
        not tightest_radius(axis.centreline(model, point.grid)[:, 1:]) < 1.5 * limit
    ):  # then it has most likely met its limit
        return None
    text = (
        f"the tube kinks: bent to a radius of about {1e3 * limit:.3g} mm its section flattens, "
        "and it carries no more load (Brazier)"
    )
    return SolveError(f"{text}; thicken the wall, or bend it less ({error.reason})", error.state)


def _settle(model: StaticModel, start: _Start, on_step: OnStep | None) -> Equilibrium:
    """Equilibrium with magnetic interaction within the body, starting from the one without; where that fails, all loads are ramped."""
    options = model.scene.solver.static

    def settled(
        factor: float, begin: Array, energy: InteractingEnergy | None = None
    ) -> tuple[InteractingEnergy, Minimum]:
        energy = energy or InteractingEnergy(model, factor)
        found = minimize_with_interaction(
            energy, begin, tolerance=options.tolerance, max_steps=options.max_steps, on_step=on_step
        )
        return energy, found

    energy = InteractingEnergy(model)
    try:
        found = _branch(energy.alone.model, start, on_step)
        _, last = settled(1.0, found.point.grid, energy)
        return replace(found, point=last.point, steps=found.steps + last.steps, energy=energy)
    except (LeftField, TimeOver):
        raise
    except SolveError as error:
        warnings = [f"{error.reason}; the load and the interaction were ramped together"]
        return replace(_ramped(model, RAMP_STEPS, warnings, settled), start="growing load")


@dataclass
class _Task:
    """A solve under the load that a scene names. count: equal steps in which its load grows, where it has to; warnings: so far."""

    energy: Energy
    start: _Start
    on_step: OnStep | None
    count: int
    warnings: list[str] = field(default_factory=list)


def _branch(model: StaticModel, start: _Start, on_step: OnStep | None) -> Equilibrium:
    """Equilibrium on the branch from zero load, or near the rod's shape that is given: by the first of WAYS that applies and has one."""
    following = start.following
    energy = Energy(model) if following is None else following.loaded(model)
    straight_body = isinstance(model.scene.body.shape, StraightBody)
    # by arcs, parts come to rest from the whole load at once
    usual = RAMP_STEPS if straight_body else 1
    count = model.scene.solver.static.field_steps or usual
    task = _Task(energy, start, on_step, count)
    for name, applies, solve in WAYS:
        found = solve(task) if applies(task) else None
        if found is not None:
            return replace(found, start=found.start or name)
    raise AssertionError("the last way always leads to an equilibrium, or raises")


def _has_rod(task: _Task) -> bool:
    """True if the rod model of the body tells where to begin, and nothing says that the load is to grow."""
    scene = task.energy.model.scene
    body = scene.body.shape
    at_once = scene.solver.static.field_steps is None
    return isinstance(body, StraightBody) and body.clamp == "base" and at_once


def _from_rod(task: _Task) -> Equilibrium | None:
    """Equilibrium near the rod's, from a neighbor's correction of it or from the rod alone; None where there is none, and why is noted."""
    energy = task.energy
    model = energy.model
    body = model.scene.body.shape
    assert isinstance(body, StraightBody)  # _has_rod
    try:
        rod = solve_rod(model.scene, time=model.time)
    except SolveError as error:
        task.warnings.append(f"{error}; the load was ramped in the 3D solve")
        return None
    starts = _starts(energy, rod, task.start)
    if model.touching is not None and any(
        len(model.touching.touched(model.effects, begin).on) for begin in starts.values()
    ):
        # this rod lies in an obstacle. 135 drawn scenes: at once as in 8 or 32 steps
        task.count = 1
        return None
    if model.pairs is not None and any(
        len(model.pairs.touched(begin).point) for begin in starts.values()
    ):
        return None  # this rod goes through itself
    steps = 0
    for name, begin in starts.items():
        try:
            found = minimize(
                energy,
                begin,
                tolerance=model.scene.solver.static.tolerance,
                max_steps=_most_steps(model),
                on_step=task.on_step,
                chord=USUAL if task.start.following is None else FOLLOWING,
            )
        except TimeOver:
            raise
        except SolveError:
            steps += _most_steps(model)
            continue
        steps += found.steps
        if _distance(model, found.point, rod) < body.branch_distance:
            correction = local_correction(model, rod, found.point.grid)
            return Equilibrium(
                found.point, steps, correction, task.warnings, energy=energy, start=name
            )
    task.warnings.append(
        "the solve from the rod's shape did not stay near it; the load was ramped in the 3D solve"
        " instead"
    )
    return None


def _starts(energy: Energy, rod: RodShape, start: _Start) -> dict[str, Array]:
    """Starts of a solve by their names, the next one for where the first fails: a neighbor's correction, then the rod alone.

    Where neighbors are followed, what they tell is an extrapolation, which may be worse than the rod: the lower energy is the first.
    """
    model = energy.model
    alone = from_rod(model, rod)
    known = start.correction
    correction = known if start.following is None else start.following.expected(rod)
    if correction is None or correction.shape != alone.shape:
        return {"rod": alone}
    starts = {"neighbor": with_correction(model, rod, correction), "rod": alone}
    if start.following is None:
        return starts
    return dict(sorted(starts.items(), key=lambda one: energy.at(one[1]).energy))


def _all_of_it(task: _Task) -> Equilibrium:
    """The whole load, in as many steps as the task says, or more where it has to."""
    return _ramp(task.energy.model, task.count, task.on_step, task.warnings)


def _near_rod(task: _Task) -> Equilibrium:
    """Equilibrium near a rod's shape. Raises SolveError if the solve leads away from it."""
    energy = task.energy
    model = energy.model
    rod = task.start.rod
    assert rod is not None  # the way applies
    options = model.scene.solver.static
    body = model.scene.body.shape
    assert isinstance(body, StraightBody)  # solve_static has looked
    found = minimize(
        energy,
        from_rod(model, rod),
        tolerance=options.tolerance,
        max_steps=options.max_steps,
        on_step=task.on_step,
    )
    if (distance := _distance(model, found.point, rod)) >= body.branch_distance:
        away = f"it went to one {100 * distance:.2g} % of the length away"
        raise SolveError(
            f"no equilibrium was found near the rod's shape that the solve started from: {away}"
        )
    return Equilibrium(
        found.point, found.steps, local_correction(model, rod, found.point.grid), [], energy=energy
    )


def _most_steps(model: StaticModel) -> int:
    """Most Newton steps of one solve."""
    # times as many steps without the start from a rod, since a body may have to turn around: 100 to 300
    # steps in robots tried
    steps_without_rod = 10
    return model.scene.solver.static.max_steps * (
        1 if model.line is not None else steps_without_rod
    )


def _distance(model: StaticModel, point: Point, rod: RodShape) -> float:
    """Largest distance between the body's axis and the rod, over the length."""
    assert model.line is not None  # only straight bodies are rods
    rows = axis.centreline(model, point.grid)
    return float(
        np.linalg.norm(rows[:, 1:] - np.array(model.line.base) - rod.at(rows[:, 0]), axis=1).max()
        / rod.s[-1]
    )


def _along_branch(task: _Task) -> Equilibrium:
    """Equilibrium to which a branch leads as loads, and what is moved, grow in equal steps: a strip that is compressed buckles."""
    model = task.energy.model
    count = task.count
    options = model.scene.solver.static
    loads = GrowingLoads(model)
    rest = straight(model)
    begin = Reached(0.0, point_of(loads.at(0.0), rest), None, 0, np.inf)
    warnings = []
    steps = 0
    branch = EquilibriumPath(
        loads, begin, tolerance=options.tolerance, max_steps=options.max_steps, on_step=task.on_step
    )
    try:
        branch.settle_in(rest)
        for part in range(1, count + 1):
            warnings += [
                f"at {100 * jump.time:.3g} % of loads and motion a branch ended ({jump.kind}); the"
                f" body moved by {1e3 * jump.moved:.3g} mm"
                for jump in branch.advance(part / count)
            ]
            steps += branch.now.iterations
    except SolveError as error:
        last = branch.now
        state = Equilibrium(last.point, steps, np.zeros_like(rest), warnings, last.time)
        raise type(error)(
            f"after {100 * last.time:.1f} % of the load: {error.reason}", state
        ) from None
    return Equilibrium(
        branch.now.point, steps, np.zeros_like(rest), warnings, energy=branch.energy_at(1.0)
    )


def _ramp(
    model: StaticModel, count: int, on_step: OnStep | None, warnings: list[str]
) -> Equilibrium:
    """Ramp the load from zero in `count` equal steps."""
    options = model.scene.solver.static
    energy = Energy(model)

    def solved(factor: float, begin: Array) -> tuple[Energy, Minimum]:
        energy.load(replace(model, effects=acting.collect(model.scene, factor, model.times)))
        return energy, minimize(
            energy,
            begin,
            tolerance=options.tolerance,
            max_steps=_most_steps(model),
            on_step=on_step,
        )

    return _ramped(model, count, warnings, solved)


def _ramped(
    model: StaticModel,
    count: int,
    warnings: list[str],
    solved: Callable[[float, Array], tuple[Energy | InteractingEnergy, Minimum]],
) -> Equilibrium:
    """The equilibrium at the end of a load that grows in `count` equal steps, and with it the way of what is moved.

    A step that fails is halved, down to 1/32; until one has succeeded it is quartered. After some that were quick it is doubled again.

    solved(share of the load, coefficients to begin from): the energy, and its minimum.
    """
    grid = straight(model)
    reached = 0.0
    size = 1.0 / count
    steps = 0
    least = size / 32
    # `wait` quick steps double one that was halved
    quick = 0
    wait = 3
    grown = False
    last: Point | None = None
    moved = Lift(model).at(model.time) if model.driven else None
    while reached < 1.0:
        factor = min(1.0, reached + size)
        try:
            with load_step(reached, factor):
                energy, found = solved(
                    factor, grid if moved is None else grid + (factor - reached) * moved
                )
        except SolveError as error:
            if size <= least or isinstance(error, TimeOver):
                state = (
                    None
                    if last is None
                    else Equilibrium(last, steps, np.zeros_like(last.grid), warnings, reached)
                )
                raise type(error)(
                    f"at {100 * factor:.1f} % of the load: {error.reason}", state
                ) from None
            size = max(
                size / (4 if last is None else 2), least
            )  # nothing is known of a body's first step
            quick = 0
            wait = 2 * wait if grown else wait
            grown = False
            continue
        grid = found.point.grid
        last = found.point
        reached = factor
        steps = steps + found.steps
        quick = quick + 1 if found.steps <= 6 else 0
        grown = quick >= wait and size < 1.0 / count
        if grown:
            size = 2 * size
            quick = 0
    assert last is not None  # the loop ran at least once
    return Equilibrium(last, steps, np.zeros_like(last.grid), warnings, energy=energy)


def solve_from(model: StaticModel, start: Array, *, on_step: OnStep | None = None) -> Equilibrium:
    """Equilibrium of a straight body from coefficients `start` (planes, m) m of another grid, unjudged. Raises SolveError."""
    options = model.scene.solver.static
    energy = Energy(model)
    with one_blas_thread():
        found = minimize(
            energy, start, tolerance=options.tolerance, max_steps=options.max_steps, on_step=on_step
        )
    still = np.zeros_like(start)
    reached = Equilibrium(found.point, found.steps, still, energy=energy, start="coarser grid")
    outside = _outside_domain(model, found.point, reached)
    if outside is not None:
        raise outside
    return reached


# Ways to begin a solve, in the order in which they are tried: the name in results, when it applies, and the solve, which is None
# where the next one is to be tried.
WAYS: tuple[tuple[str, Callable[[_Task], bool], Callable[[_Task], Equilibrium | None]], ...] = (
    ("given rod", lambda task: task.start.rod is not None, _near_rod),
    ("growing branch", lambda task: bool(task.energy.model.driven), _along_branch),
    ("rod", _has_rod, _from_rod),
    ("whole load", lambda task: task.count == 1, _all_of_it),
    ("growing load", lambda task: True, _all_of_it),
)
