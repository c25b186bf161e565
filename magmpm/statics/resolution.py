"""The grid chosen for an error or a time that a scene asks for: the coarsest that will do, its error proven by a finer one.

Equilibria on coarse grids first (statics.ladder); the error of a grid is told by a grid half as coarse again or more
(statics.error_estimate), on the centreline or at the tip. What the next grids will take is foretold from counted operations, at the pace of
those solved.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from magmpm.errors import SceneError, SolveError, TimeOver
from magmpm.model import build, knots_of
from magmpm.scene import Scene, memory
from magmpm.scene.coarsest import coarsest_cells
from magmpm.statics import axis
from magmpm.statics import error_estimate as law
from magmpm.statics.equilibrium import Equilibrium, one_blas_thread, solve_static
from magmpm.statics.error_estimate import ALGEBRAIC, PROOF, caution, observed_order
from magmpm.statics.ladder import PER_PROOF, PER_SOLVE, Ladder, Load, Loads, OnStep, operations
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.stability import stability

PATIENCE = 3600.0  # s: an error that would take longer is out of reach
LARGEST = 0.5  # of the length: a larger error tells nothing
FLOOR = 1e-6  # of the length: equilibria are known no better (docs/design.md, "End.")
SHARE = 0.5  # of the machine's memory that a grid may take
LATE = 1.15  # of the time asked for: a grid that takes longer is given up
RESERVE = 0.9  # of the time left that a grid may be foretold to take
HOPE = 0.5  # errors may fall by this order faster than they did
# Where materials meet, grids begin here: of 143 drawn bodies 2 by 4 cells told errors up to 2 times too small, of 97 3 by 5 one 4 times.
JOINTED = {3: 6}
FIRST_LEAP = 6  # cells across, at most, of the second grid that is proven


@dataclass
class Choice:
    """The chosen grid. models and found: of its equilibria, one a load; error: bound, m; told: what results say of it (`resolution`)."""

    scene: Scene
    models: list[StaticModel]
    found: list[Equilibrium]
    error: float
    told: dict[str, Any]


class _Late(Exception):
    """The time that the scene asks for is over."""


def nothing(cells: int) -> float:
    """Seconds that a grid takes besides its equilibria and their proof, where nothing else is computed on it."""
    return 0.0


@dataclass
class _Search:
    ladder: Ladder
    begun: float
    beside: Callable[[int], float]
    errors: dict[int, float] = field(default_factory=dict)  # m, of the grids that are proven
    proof: dict[int, int] = field(init=False)  # of a grid, by cells across, the one that tells its error

    def __post_init__(self) -> None:
        self.proof = PROOF | JOINTED if knots_of(self.scene).joints else PROOF

    @property
    def scene(self) -> Scene:
        return self.ladder.asked

    def prove(self, cells: int) -> None:
        """Solve a grid, and the finer one that tells its error."""
        finer = self.proof[cells]
        self.ladder.solve(cells)
        self.ladder.prove(finer, cells)
        for witness in law.WITNESS.get(cells, ()):
            self.ladder.prove(witness, cells)
        others = {n: self.ladder.apart(n, finer) for n in self.ladder.solved if n < finer and n != cells}
        known = law.bound(cells, finer, self.ladder.apart(cells, finer), others)
        self.errors[cells] = caution(self.scene.length / self.scene.thickness, self.wall(cells)) * known + self.algebraic()

    def wall(self, cells: int) -> float:
        """Cells across a tube's wall, where there are so many across its diameter; inf without a bore, and where cells fit it."""
        tube = self.scene.body.catheter
        if tube is None or not tube.hollow or (self.scene.static and tube.round_cells):
            return float("inf")
        return cells * (tube.diameter - tube.inner_diameter) / (2.0 * tube.diameter)

    def algebraic(self) -> float:
        """What the solves themselves leave, m: they end at a share of the energy."""
        tolerance = self.scene.solver.static.tolerance
        first = next(iter(self.ladder.solved.values()))
        moved = max(float(np.abs(grid).max()) for grid in first.grids)
        return float(ALGEBRAIC * np.sqrt(tolerance) * moved)

    def takes(self, cells: int) -> float:
        """What it will take to prove a grid's error, s."""
        ladder, finer = self.ladder, self.proof[cells]
        known = ladder.solved.get(cells)
        solve = 0.0 if known is not None and known.exact else ladder.seconds_at(cells, PER_SOLVE)
        return solve + (0.0 if finer in ladder.solved else ladder.seconds_at(finer, PER_PROOF))

    def fits(self, cells: int) -> bool:
        """Whether a grid and its proof fit into memory."""
        return operations(self.ladder.on(self.proof[cells]))[1] <= SHARE * memory.machine()


def choose(
    scene: Scene,
    loads: Loads | None = None,
    on_step: OnStep | None = None,
    begun: float | None = None,
    beside: Callable[[int], float] = nothing,
    coarsest: int | None = None,
) -> Choice:
    """The coarsest grid that meets the error, or the best within the time, that a scene asks for; solved, and its error proven.

    loads: those of the scene on a grid that are judged; the one of its equilibrium unless given. begun: when the time that is asked for
    began (time.perf_counter), now unless given; beside: the seconds of it that a grid with so many cells across will take afterwards;
    coarsest: cells across to begin with, where it is not the coarsest grid that there is.
    Raises SceneError where no grid can: with what it would take. Raises as solve_static does.
    """
    check_possible(scene)
    with one_blas_thread():  # all along: threads that BLAS started go on spinning for a while, and slow the next kernel to half its pace
        began = time.perf_counter() if begun is None else begun
        return _chosen(_searched(scene, loads or at_rest, on_step, began, beside, coarsest))


def _searched(
    scene: Scene, loads: Loads, on_step: OnStep | None, begun: float, beside: Callable[[int], float], coarsest: int | None
) -> _Search:
    """Grids solved and proven, the last of them good enough. Raises as `choose` does."""
    limit = scene.resolution.seconds
    proven: dict[int, float] = {}

    # It holds nothing of the search: a circle would keep its matrices until Python collects it, and the next one would touch fresh memory.
    def tell(step: int, number: float) -> None:
        if limit is not None and proven and time.perf_counter() - begun > LATE * limit:
            raise _Late
        if on_step is not None:
            on_step(step, number)

    search = _Search(Ladder(scene, loads, tell), begun, beside, proven)
    cells: int | None = coarsest or max(coarsest_cells(scene), min(JOINTED) if knots_of(scene).joints else 2)
    failure: SolveError | None = None
    failed = 0
    while cells is not None:
        failed = cells
        try:
            search.prove(cells)
            failure = None
        except TimeOver:
            raise
        except SolveError as error:  # some bodies need finer cells to be solved at all
            failure = error
        except _Late:
            break
        cells = _next(search, cells, failure)
    if not search.errors:
        assert failure is not None
        raise failure
    _check_met(search, failed, failure)
    return search


def _check_met(search: _Search, failed: int, failure: SolveError | None) -> None:
    """Raises SceneError where the search ended without what was asked for: as a finer grid failed, or on grids that tell nothing.

    failed: cells across of the last grid that was tried.
    """
    wanted, best = search.scene.resolution.allowed(search.scene.length), min(search.errors.values())
    if wanted is not None and search.errors[max(search.errors)] > wanted:
        found = "" if failure is None else f"{failed} cells across found no equilibrium ({failure.reason.split('; ')[0]})"
        raise _out_of_reach(search, wanted, failed=found)
    if wanted is None and best > LARGEST * search.scene.length:
        raise _on_branches(search, f"{search.scene.resolution.seconds:g} s")


def at_rest(scene: Scene, *, of_motion: bool = False) -> list[Load]:
    """The load of a scene's equilibrium, or of that of a motion, in the cells in which it moves."""
    shape, at = scene.body.shape, scene.resolution
    with memory.within(scene):
        knots = replace(knots_of(scene), at_rest=False)
        made = shape.discretize(at.cells_across, at.particles_per_cell, knots) if of_motion else None
        model = static_model(build(scene, made))
    return [Load(model, lambda on_step: solve_static(model, on_step=on_step, judged=False))]


def check_possible(scene: Scene) -> None:
    """Raises SceneError where no choice can be made, before anything is solved."""
    wanted = scene.resolution.allowed(scene.length)
    key = "resolution.error" if wanted is not None else "resolution.seconds"
    if scene.body.shape.line is None:
        raise SceneError(
            key, rule="errors are those of a centreline, and a body of STL parts has none", remedy="give `cells_across` instead, say 4"
        )
    if wanted is not None and wanted > LARGEST * scene.length:
        rule = f"must be at most half of the length, {500 * scene.length:g} mm"
        raise SceneError(key, received=f"{1e3 * wanted:g} mm", rule=rule, remedy="check number and unit")
    if wanted is not None and wanted < FLOOR * scene.length:
        raise SceneError(
            key,
            received=f"{100 * wanted / scene.length:.2g} % of the length",
            rule=f"equilibria are known to {100 * FLOOR:g} % of the length at best: their solve ends there, whatever the grid",
            remedy=f"ask for {100 * FLOOR:g} % or more",
        )


def _next(search: _Search, tried: int, failure: SolveError | None) -> int | None:
    """The grid to prove next; None where the last one will do. Raises SceneError where none can."""
    finer = [n for n in search.proof if n > tried]
    if failure is not None:
        return finer[0] if finer and finer[0] <= coarsest_cells(search.scene) + 2 else None
    wanted = search.scene.resolution.allowed(search.scene.length)
    if wanted is None:
        return _next_in_time(search, finer)
    if search.errors[tried] <= wanted:
        return None
    order = observed_order(search.errors)
    hoped = law.FASTEST if order is None else min(max(order, law.LEAST) + HOPE, law.FASTEST)
    if not finer or search.errors[tried] * (tried / finer[-1]) ** hoped > wanted:
        # Two coarse grids far apart may be too coarse, rather than on other branches: then how far they are apart foretells nothing.
        if tried < FIRST_LEAP and search.errors[tried] > LARGEST * search.scene.length:
            return min(search.proof[tried], FIRST_LEAP)
        raise _out_of_reach(search, wanted)
    if order is None:  # one grid says little of how errors fall here: no leap on its word
        finer = [n for n in finer if n <= FIRST_LEAP]
    elif order < law.ORDER:  # errors that don't yet fall as they will tell as little
        finer = [n for n in finer if n <= search.proof[tried]] or finer[:1]
    cells = next((n for n in finer if law.foretold(search.errors, n) <= wanted), finer[-1])
    solved = search.proof[tried]  # already, to prove the last grid, and what proves it in turn is where the next one would begin
    if solved < cells and solved in search.proof and search.errors[tried] * (tried / solved) ** hoped <= wanted:
        cells = solved
    if not (search.fits(cells) and search.takes(cells) <= PATIENCE):
        raise _out_of_reach(search, wanted, cells)
    return cells


def _next_in_time(search: _Search, finer: list[int]) -> int | None:
    limit = search.scene.resolution.seconds
    assert limit is not None
    gone = time.perf_counter() - search.begun
    if gone > LATE * limit and len(search.errors) == 1:
        raise SceneError(
            "resolution.seconds",
            received=f"{limit:g} s",
            rule=f"must be enough for the coarsest grid and the proof of its error, {gone:.2g} s here",
            remedy=f"allow {1.2 * gone:.2g} s or more",
        )
    if len(search.errors) == 1:  # whose pace says little: it was the first to run
        finer = [n for n in finer if n <= FIRST_LEAP]
    return max((n for n in finer if search.fits(n) and search.takes(n) + search.beside(n) <= RESERVE * (limit - gone)), default=None)


def _out_of_reach(search: _Search, wanted: float, cells: int | None = None, failed: str = "") -> SceneError:
    """cells: the grid that would do, but for memory or time; failed: what a finer grid failed of."""
    length, tried = search.scene.length, max(search.errors)
    received, limits = f"{100 * wanted / length:.3g} % of the length", f" of {SHARE * memory.machine() / 1e9:.3g} GB and {PATIENCE:g} s"
    if search.errors[tried] > LARGEST * length:
        return _on_branches(search, received, failed)
    within = [n for n in search.proof if n > tried and search.fits(n) and search.takes(n) <= PATIENCE and not failed]
    most = max(within, default=tried)
    least = law.foretold(search.errors, most)
    if failed:
        why, limits = failed, ""
    elif cells is None:
        end = max(search.proof)
        off = 100 * law.foretold(search.errors, end) / length
        why = f"{end} cells across, the most whose error can be proven, are off by {off:.2g} %, as {tried} cells tell"
    else:
        needed, seconds = operations(search.ladder.on(search.proof[cells]))[1], search.takes(cells)
        why = f"{cells} cells across and their proof by {search.proof[cells]} take {needed / 1e9:.2g} GB and {seconds:.2g} s"
    remedy = f"ask for {_up(100 * search.errors[tried] / length):.2g} % or more, which {tried} cells give"
    if most > tried:
        remedy += f", or try {_up(100 * least / length):.2g} %, which {most} cells give only if its errors fall as they should"
    return SceneError("resolution.error", received=received, rule=f"must be within reach{limits}: {why}", remedy=remedy)


def _up(number: float) -> float:
    """Rounded up to two digits, so that asking for it is enough."""
    digit = 10.0 ** (np.floor(np.log10(number)) - 1)
    return float(np.ceil(number / digit) * digit)


def _on_branches(search: _Search, received: str, failed: str = "") -> SceneError:
    """Where two grids are so far apart that their difference tells no error.

    received: what was asked for; failed: what a finer grid failed of.
    """
    tried, length = max(search.errors), search.scene.length
    key, proof = "seconds" if search.scene.resolution.error is None else "error", search.proof[tried]
    return SceneError(
        f"resolution.{key}",
        received=received,
        rule=f"the grids must find the same equilibrium: those of {tried} and {proof} cells across are "
        f"{100 * search.ladder.apart(tried, proof) / length:.2g} % of the length apart, on other branches perhaps"
        + (f"; {failed}" if failed else ""),
        remedy="give `cells_across`, and compare runs; along a path, leave out times near a jump or another critical load",
    )


def _best_in_time(search: _Search) -> int:
    """The grid of the smallest error, of those on which there is time left for what is computed besides; the coarsest one is done."""
    limit, gone = search.scene.resolution.seconds, time.perf_counter() - search.begun
    assert limit is not None
    left = [n for n in search.errors if n == min(search.errors) or gone + search.beside(n) <= limit]
    return min(left, key=lambda n: search.errors[n])


def _chosen(search: _Search) -> Choice:
    cells = max(search.errors) if search.scene.resolution.error is not None else _best_in_time(search)
    ladder, asked, length = search.ladder, search.scene.resolution, search.scene.length
    last, finer, error = ladder.solved[cells], ladder.solved[search.proof[cells]], search.errors[cells]
    order, spent = observed_order(search.errors), sum(one.seconds for one in ladder.solved.values())
    told = {
        "cells_across": cells,
        "particles_per_cell": asked.particles_per_cell,
        "asked": {key: value for key, value in asked.model_dump().items() if key in ("error", "of", "seconds")},
        "error_of_length": error / length,
        "algebraic_error": search.algebraic(),
        "order": order,
        "asymptotic": law.steady(order),
        "tried": [
            {
                "cells_across": n,
                "dof": one.loads[0].model.dof,
                "seconds": one.seconds,
                "factorizations": one.steps,
                "error": search.errors.get(n),
            }
            for n, one in sorted(ladder.solved.items())
        ],
        "seconds_of_answer": last.seconds,
        "seconds_of_proof": spent - last.seconds,
        "finer": {
            "cells_across": finer.cells,
            "tip": axis.tip(finer.loads[-1].model, finer.grids[-1]).tolist(),
            "centreline": axis.centreline(finer.loads[-1].model, finer.grids[-1]).tolist(),
        },
    }
    found = list(last.found)
    assert found[-1].energy is not None
    found[-1] = replace(found[-1], stability=stability(found[-1].energy, found[-1].point))
    return Choice(ladder.on(cells), [load.model for load in last.loads], found, error, told)


