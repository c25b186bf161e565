"""The grid chosen for an error or a time that a scene requests: the coarsest that will do, its error proven by a finer one.

Coarse grids first; the error of a grid is known from a grid half as coarse again or more (statics.error_estimate), on the centreline or at
the tip. The search needs of the grids only what statics.grids.Grids offers: equilibria of straight bodies at rest are solved quickly, all
else (compare) by whole runs.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magmpm.bodies.polar_grid import PolarGrid
from magmpm.compiled.arrays import Plain
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.errors import SceneError, SolveError, TimeOver, quantity
from magmpm.scene import Scene, memory
from magmpm.scene.coarsest import coarsest_cells, knots_of
from magmpm.statics import error_estimate as law
from magmpm.statics.error_estimate import PROOF, caution, observed_order
from magmpm.statics.grids import Grids
from magmpm.statics.newton import OnStep

LONGEST_RUN = 3600.0  # s: an error that would take longer is out of reach
LARGEST = 0.5  # of the length: a larger error tells nothing
LEAST_REACHABLE_ERROR = (
    1e-6  # of the length: equilibria are known no better (docs/design.md, "End.")
)
SHARE_OF_MEMORY = 0.5  # of the machine's memory that a grid may take
LATE = 1.15  # of the time requested: a grid that takes longer is given up
FIRST_LEAP = 6  # cells across, at most, of the second grid that is proven


@dataclass(frozen=True)
class ChosenGrid:
    """The grid chosen: cells across; error: bound of the error it leaves, m; report: what results have of it (`resolution`)."""

    cells: int
    error: float
    report: Plain


class _Late(Exception):
    """The time that the scene requests is over."""


@dataclass
class _GridSearch:
    grids: Grids
    begun: float
    extra: Callable[
        [int], float
    ]  # seconds of the time requested that a grid will take once it is chosen
    errors: dict[int, float] = field(default_factory=dict)  # m, of the grids that are proven

    @cached_property
    def proof(self) -> dict[int, int]:
        """Finer grid that tells the error of a grid, by cells across."""
        return proofs(*self.grids.scenes)

    @property
    def scene(self) -> Scene:
        return self.grids.scene

    def prove(self, cells: int) -> None:
        """Solve a grid, and the finer one from which its error is known."""
        grids = self.grids
        finer = self.proof[cells]
        grids.solve(cells)
        for other in reversed(needed_for(cells, *grids.scenes)):
            grids.prove(other, cells)
        others = {
            n: grids.distance_between(n, finer) for n in grids.solved if n < finer and n != cells
        }
        around = max(left_in_tube(scene, cells, finer) for scene in grids.scenes)
        known = law.bound(cells, finer, grids.distance_between(cells, finer), others, around)
        self.errors[cells] = (
            max(
                caution(scene.length / scene.thickness, _wall(scene, cells))
                for scene in grids.scenes
            )
            * known
            + grids.algebraic
            + grids.left_by_blocks(cells)
        )

    def takes(self, cells: int) -> float:
        """Seconds that it will take to solve a grid and to know its error."""
        grids = self.grids
        finer = self.proof[cells]
        known = grids.solved.get(cells)
        solve = 0.0 if known is not None and known.exact else grids.takes(cells, proof=False)
        return solve + (0.0 if finer in grids.solved else grids.takes(finer, proof=True))

    def fits(self, cells: int) -> bool:
        """True if a grid and the finer one that gives its error fit into memory."""
        return self.grids.size(self.proof[cells]) <= SHARE_OF_MEMORY * memory.machine()


def _wall(scene: Scene, cells: int) -> float:
    """Cells across a tube's wall, where there are so many across its diameter; inf without a bore, and where cells fit it."""
    tube = scene.body.catheter
    if tube is None or not tube.hollow or (scene.static and tube.round_cells):
        return float("inf")
    return cells * (tube.diameter - tube.inner_diameter) / (2.0 * tube.diameter)


def known_error(grids: Grids, cells: int) -> ChosenGrid:
    """The error of the grid with so many cells across. Raises SceneError where no finer grid tells it, SolveError where one fails."""
    search = _GridSearch(grids, time.perf_counter(), lambda cells: 0.0)
    if cells not in search.proof:
        raise SceneError(
            "resolution.cells_across",
            received=f"{cells}",
            rule=f"must be at most {max(search.proof)}: the error of finer grids is not known",
            remedy="use fewer",
        )
    with one_blas_thread():
        search.prove(cells)
        return _chosen(search, cells)


def proofs(*scenes: Scene) -> dict[int, int]:
    """Finer grid that gives the error of a grid, by cells across.

    It is finer in every direction: a difference does not show the error of one that has as many cells as before. Where materials meet
    it has twice as many, and so has each run between joints (bodies.grid). A tube's has more around its axis, where their number grows
    slowly, and twice as many through its wall, unless one is enough. If no grid has so many, the finest one gives the error, unless it
    is as coarse there.
    """
    jointed = any(knots_of(scene).joints for scene in scenes)
    most = max(PROOF.values())  # that a scene can have
    known = {}
    for cells, usual in PROOF.items():
        finer = max(_finer_in_tube(one, cells, 2 * cells if jointed else usual) for one in scenes)
        known[cells] = min(finer, most)
    return {n: m for n, m in known.items() if max(left_in_tube(one, n, m) for one in scenes) < 1.0}


def needed_for(cells: int, *scenes: Scene) -> list[int]:
    """The finer grids from which a grid's error is known, by their cells across: last the one that gives it, before it one that tells
    whether errors fall steadily: where that is finer than others need, the one that they do.
    """
    return sorted({law.INTERMEDIATE.get(cells, PROOF[cells]), proofs(*scenes)[cells]})


def _finer_in_tube(scene: Scene, cells: int, finer: int) -> int:
    """The coarsest grid from `finer` on that is finer around a tube's axis and through its wall; `finer` where cells lie in rows."""
    around, through = _in_tube(scene, cells)
    least = (around + 1, 2 * through if through > 1 else 1)
    while around and np.less(_in_tube(scene, finer), least).any():
        finer += 1
    return finer


def _in_tube(scene: Scene, cells: int) -> tuple[int, int]:
    """Numbers of cells around a tube's axis and through its wall on a grid; 0 where cells lie in rows."""
    grid = scene.body.shape.grid(cells, knots_of(scene))
    return grid.cells[1:] if isinstance(grid, PolarGrid) else (0, 0)


def left_in_tube(scene: Scene, cells: int, finer: int) -> float:
    """The part of the error of the cells in a tube's section that a finer grid leaves, at most, whatever those along; 0 where cells lie
    in rows. Around, the slowest order in six tubes, with walls of 0.1 to 0.65 of the radius, between 8 and 18 cells, was 5.28.
    """
    around, through = _in_tube(scene, cells)
    more_around, more_through = _in_tube(scene, finer)
    section = law.left(around, more_around or 1, order=5.2)
    return max(section, law.left(through, more_through)) if through > 1 else section


def first_cells(scene: Scene) -> int:
    """Cells across of the first grid that is tried: where materials meet, 3, as of 143 drawn bodies errors of 2 were up to 2 times too
    large for their bounds.
    """
    return max(coarsest_cells(scene), 3 if knots_of(scene).joints else 0)


def choose(
    grids: Grids, on_step: OnStep | None = None, extra: Callable[[int], float] = lambda cells: 0.0
) -> ChosenGrid:
    """The coarsest grid that meets the error, or the best within the time, that a scene requests; solved, with its error known.

    extra: seconds of the time requested that a grid with so many cells across will take once it is chosen.
    Raises SceneError where no grid can: with what it would take. Raises as the solves do.
    """
    check_possible(grids.scene)
    # all along: threads that BLAS started go on spinning for a while, and slow the next kernel to
    # half its pace
    with one_blas_thread():
        search = _searched(grids, on_step, extra)
        return _chosen(
            search,
            (
                max(search.errors)
                if search.scene.resolution.error is not None
                else _best_in_time(search)
            ),
        )


def _searched(grids: Grids, on_step: OnStep | None, extra: Callable[[int], float]) -> _GridSearch:
    """Grids solved, their errors known, the last of them good enough. Raises as `choose` does."""
    limit = grids.scene.resolution.seconds
    begun = time.perf_counter()
    proven: dict[int, float] = {}
    stops = grids.scene.in_time  # even the coarsest grid, which may take hours

    # It holds nothing of the search: a circle would keep its matrices until Python collects it, and the next one would touch fresh memory.
    def tell(step: int, number: float) -> None:
        if limit is not None and (proven or stops) and time.perf_counter() - begun > LATE * limit:
            raise _Late
        if on_step is not None:
            on_step(step, number)

    grids.on_step = tell
    search = _GridSearch(grids, begun, extra, proven)
    cells: int | None = first_cells(grids.scene)
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
        raise failure or _too_short(search, time.perf_counter() - begun)
    _check_met(search, failed, failure)
    return search


def _check_met(search: _GridSearch, failed: int, failure: SolveError | None) -> None:
    """Raises SceneError where the search ended without what was requested, as `failed` cells across failed or the grids tell nothing."""
    wanted = search.scene.resolution.allowed(search.scene.length)
    best = min(search.errors.values())
    if wanted is not None and search.errors[max(search.errors)] > wanted:
        found = (
            ""
            if failure is None
            else f"{failed} cells across found no equilibrium ({failure.reason.split('; ')[0]})"
        )
        raise _out_of_reach(search, wanted, failed=found)
    if wanted is None and best > LARGEST * search.scene.length:
        raise _on_branches(search, f"{search.scene.resolution.seconds:g} s")


def check_possible(scene: Scene) -> None:
    """Raises SceneError where no choice can be made, before anything is solved."""
    wanted = scene.resolution.allowed(scene.length)
    if wanted is None:
        return
    if wanted > LARGEST * scene.length:
        raise SceneError(
            "resolution.error",
            received=f"{1e3 * wanted:g} mm",
            rule=f"must be at most half of the length, {500 * scene.length:g} mm",
            remedy="check number and unit",
        )
    if wanted < LEAST_REACHABLE_ERROR * scene.length:
        raise SceneError(
            "resolution.error",
            received=f"{100 * wanted / scene.length:.2g} % of the length",
            rule=(
                f"equilibria are accurate to {100 * LEAST_REACHABLE_ERROR:g} % of the"
                " length at best, the "
                "tolerance of the solve on any grid"
            ),
            remedy=f"request {100 * LEAST_REACHABLE_ERROR:g} % or more",
        )


def _next(search: _GridSearch, tried: int, failure: SolveError | None) -> int | None:
    """The grid to prove next; None where the last one will do. Raises SceneError where none can."""
    finer = [n for n in search.proof if n > tried]
    if failure is not None:
        return finer[0] if finer and finer[0] <= coarsest_cells(search.scene) + 2 else None
    wanted = search.scene.resolution.allowed(search.scene.length)
    if wanted is None:
        return _next_in_time(search, tried, finer)
    error = search.errors[tried]
    if error <= wanted:
        return None
    order = observed_order(search.errors)
    hoped = (
        law.FASTEST if order is None else min(max(order, law.LEAST_ORDER) + 0.5, law.FASTEST)
    )  # they may fall faster than they did
    if not finer or error * (tried / finer[-1]) ** hoped > wanted:
        # Two coarse grids far from each other may be too coarse, rather than on other branches: then their distance foretells nothing.
        if tried < FIRST_LEAP and error > LARGEST * search.scene.length:
            return min(search.proof[tried], FIRST_LEAP)
        raise _out_of_reach(search, wanted)
    if order is None:  # one grid says little of how errors fall here: no leap on its word
        finer = [n for n in finer if n <= FIRST_LEAP]
    elif order < law.ORDER:  # errors that don't yet fall as they will tell as little
        finer = [n for n in finer if n <= search.proof[tried]] or finer[:1]
    cells = next((n for n in finer if law.foretold(search.errors, n) <= wanted), finer[-1])
    solved = search.proof[
        tried
    ]  # already, to prove the last grid, and what proves it in turn is where the next one would begin
    if solved < cells and solved in search.proof and error * (tried / solved) ** hoped <= wanted:
        cells = solved
    if not (search.fits(cells) and search.takes(cells) <= LONGEST_RUN):
        raise _out_of_reach(search, wanted, cells)
    return cells


def _next_in_time(search: _GridSearch, tried: int, finer: list[int]) -> int | None:
    limit = search.scene.resolution.seconds
    assert limit is not None
    gone = time.perf_counter() - search.begun
    if gone + search.extra(tried) > LATE * limit and len(search.errors) == 1:
        raise _too_short(search, gone + search.extra(tried))
    if len(search.errors) == 1:  # whose pace says little: it was the first to run
        finer = [n for n in finer if n <= FIRST_LEAP]
    return max(
        (
            n
            for n in finer
            if search.fits(n) and search.takes(n) + search.extra(n) <= 0.9 * (limit - gone)
        ),
        default=None,
    )


def _too_short(search: _GridSearch, needed: float) -> SceneError:
    """needed: seconds that the coarsest grid takes with its proof, as far as that is known."""
    limit = search.scene.resolution.seconds
    if not search.errors and search.grids.solved:
        needed = sum(one.seconds for one in search.grids.solved.values()) + search.grids.takes(
            search.proof[first_cells(search.scene)], proof=True
        )
    known = f"{needed:.2g} s here" if search.grids.solved else "which took longer"
    return SceneError(
        "resolution.seconds",
        received=f"{limit:g} s",
        rule=f"must be enough for the coarsest grid and the proof of its error, {known}",
        remedy=f"allow {1.2 * needed:.2g} s or more" if search.grids.solved else "allow much more",
    )


def _out_of_reach(
    search: _GridSearch, wanted: float, cells: int | None = None, failed: str = ""
) -> SceneError:
    """cells: the grid that would do, but for memory or time; failed: what a finer grid failed of."""
    length = search.scene.length
    tried = max(search.errors)
    received = f"{100 * wanted / length:.3g} % of the length"
    limits = f" of {SHARE_OF_MEMORY * memory.machine() / 1e9:.3g} GB and {LONGEST_RUN:g} s"
    if search.errors[tried] > LARGEST * length:
        return _on_branches(search, received, failed)
    within = [
        n
        for n in search.proof
        if n > tried and search.fits(n) and search.takes(n) <= LONGEST_RUN and not failed
    ]
    most = max(within, default=tried)
    least = law.foretold(search.errors, most)
    if failed:
        why = failed
        limits = ""
    elif cells is None:
        end = max(search.proof)
        off = law.foretold(search.errors, end)
        why = (
            f"{end} cells across, the most whose error can be proven, are off by"
            f" {quantity(off, 'm')} ({100 * off / length:.2g} %), as {tried} cells tell"
        )
    else:
        needed = search.grids.size(search.proof[cells])
        seconds = search.takes(cells)
        why = (
            f"{cells} cells across and their proof by {search.proof[cells]} take {needed / 1e9:.2g}"
            f" GB and {seconds:.2g} s"
        )
    remedy = (
        f"request {_up(1e3 * search.errors[tried]):.2g} mm, or"
        f" {_up(100 * search.errors[tried] / length):.2g} % or more, which {tried} cells give"
    )
    if most > tried:
        remedy += (
            f", or try {_up(100 * least / length):.2g} %, which {most} cells give only if its"
            " errors fall as they should"
        )
    if search.scene.effects.magnetic_interaction is not None:
        remedy += "; blocks_across of magnetic_interaction has an error of its own: try more"
    return SceneError(
        "resolution.error",
        received=received,
        rule=f"must be within reach{limits}: {why}",
        remedy=remedy,
    )


def _up(number: float) -> float:
    """Rounded up to two digits, so that asking for it is enough."""
    digit = 10.0 ** (np.floor(np.log10(number)) - 1)
    return float(np.ceil(number / digit) * digit)


def _on_branches(search: _GridSearch, received: str, failed: str = "") -> SceneError:
    """Error for two grids too far from each other to tell it. received: what was requested; failed: what a finer grid failed of."""
    tried = max(search.errors)
    length = search.scene.length
    key = "seconds" if search.scene.resolution.error is None else "error"
    proof = search.proof[tried]
    return SceneError(
        f"resolution.{key}",
        received=received,
        rule=(
            f"the grids must find the same equilibrium: {tried} and {proof} cells across converge "
            f"to shapes {100 * search.grids.distance_between(tried, proof) / length:.2g} % of the "
            "length apart, probably different equilibria"
        )
        + (f"; {failed}" if failed else ""),
        remedy=(
            "give `cells_across`, and compare runs; along a path, leave out times near a jump or"
            " another critical load"
        ),
    )


def _best_in_time(search: _GridSearch) -> int:
    """The grid of the smallest error, of those on which there is time left for what is computed besides; the coarsest one is done."""
    limit = search.scene.resolution.seconds
    gone = time.perf_counter() - search.begun
    assert limit is not None
    left = [n for n in search.errors if n == min(search.errors) or gone + search.extra(n) <= limit]
    return min(left, key=search.errors.__getitem__)


def _chosen(search: _GridSearch, cells: int) -> ChosenGrid:
    solved = search.grids.solved
    resolution = search.scene.resolution
    error = search.errors[cells]
    order = observed_order(search.errors)
    last = solved[cells]
    finer = solved[search.proof[cells]]
    report = {
        "cells_across": cells,
        "particles_per_cell": resolution.particles_per_cell,
        "requested": resolution.model_dump(include={"error", "of", "seconds"}),
        "error_of_length": error / search.scene.length,
        "algebraic_error": search.grids.algebraic,
        "order": order if law.steady(order) else None,
        "asymptotic": law.steady(order),
        "tried": [
            {
                "cells_across": n,
                "dof": one.dof,
                "seconds": one.seconds,
                "factorizations": one.steps,
                "error": search.errors.get(n),
            }
            for n, one in sorted(solved.items())
        ],
        "seconds_of_answer": last.seconds,
        "seconds_of_proof": sum(one.seconds for one in solved.values()) - last.seconds,
        "finer": {
            "cells_across": finer.cells,
            "tip": None if finer.tip is None else finer.tip.tolist(),
            "centreline": finer.centreline.tolist(),
        },
    }
    return ChosenGrid(cells, error, report)
