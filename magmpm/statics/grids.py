"""One scene on several grids: `Grids` is what the search for a grid needs of them; `Equilibria` are those of a straight body at rest.

Each equilibrium begins at a coarser one's, and is exact or just good enough to tell the error of another grid: one factorization, mostly.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.bodies.curves import AXIS_STATIONS
from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.errors import SolveError, TimeOver
from magmpm.model import build
from magmpm.scene import Scene, memory
from magmpm.scene.coarsest import knots_of
from magmpm.statics import axis
from magmpm.statics.axis import carried
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Equilibrium, solve_from, solve_static
from magmpm.statics.error_estimate import ALGEBRAIC, ORDER, farthest
from magmpm.statics.layout import StaticModel, model_at_rest
from magmpm.statics.newton import PAIRS, OnStep, corrected
from magmpm.statics.tangent_matrix import Bands

# multiply-adds, at the pace of the factorization, that a particle costs in a Newton step: measured,
# docs/accuracy.md
PARTICLE = 2.0e4
PROOF_SETTLED = 0.03  # of the difference from the coarser grid: a proof may still move by so much
# length over thickness: above, factors are of double precision. Steps settled as they do with those
# up to 20, not at 24
SLENDER = 15.0


@dataclass
class Solved:
    """Solution of a scene on a grid. exact: solved to the scene's tolerance, not just enough for a reference; steps: factorizations, or
    steps of a motion; centreline rows [s, x, y, z] m and tip (3,) m at the end; moved: the farthest that a point of the body went, m.
    """

    cells: int
    exact: bool
    seconds: float
    steps: float
    dof: int
    centreline: Array
    tip: Array | None  # of parts only where they name one
    moved: float


class Grids(ABC):
    """A scene that requests an error or a time, on grids that are solved one by one. on_step: as of solves."""

    on_step: OnStep | None = None

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.solved: dict[int, Solved] = {}
        self._scenes: dict[int, Scene] = {}

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes whose answers are compared."""
        return (self.scene,)

    def on(self, cells: int) -> Scene:
        """The scene with so many cells across."""
        if cells not in self._scenes:
            self._scenes[cells] = self.scene.with_cells(cells)
        return self._scenes[cells]

    @abstractmethod
    def solve(self, cells: int) -> None:
        """Solve with so many cells across, to the scene's tolerance. Raises as solve_static does."""

    @abstractmethod
    def prove(self, cells: int, against: int) -> None:
        """Solve with so many cells across, well enough to tell the error of the grid `against`."""

    @abstractmethod
    def distance_between(self, coarse: int, fine: int) -> float:
        """The largest distance (m) between the answers of two grids, where errors are meant."""

    @abstractmethod
    def effort(self, cells: int, steps: float) -> float:
        """Work of a run on a grid, in multiply-adds or a unit of its own; steps: factorizations."""

    def takes(self, cells: int, proof: bool) -> float:
        """Seconds that solving or proving will take on a grid, at the better pace of the last two that were solved."""
        last = list(self.solved.values())[-2:]
        pace = min(one.seconds / self.effort(one.cells, one.steps) for one in last)
        # a proof takes one factorization, and now and then a solve; a solve three, with its stability
        return pace * self.effort(cells, 1.3 if proof else 3.0)

    @abstractmethod
    def size(self, cells: int) -> float:
        """Bytes that a grid takes, about."""

    @abstractmethod
    def left_by_blocks(self, cells: int) -> float:
        """Error (m) that the blocks of `magnetic_interaction` leave, whatever the cells."""

    @property
    def algebraic(self) -> float:
        """Error that the solves themselves leave, m."""
        return left_by_solve(self.scene, next(iter(self.solved.values())).moved)


def left_by_solve(scene: Scene, moved: float) -> float:
    """Error (m) that a solve leaves where the body went as far as `moved` (m): it ends at a fraction of the energy."""
    return ALGEBRAIC * float(np.sqrt(scene.solver.static.tolerance)) * moved


def with_other_blocks(scene: Scene) -> tuple[Scene, float]:
    """The scene with another number of blocks for `magnetic_interaction`, and the share of the difference that is its own error; or 0.

    As for grids (error_estimate.left), errors fall at least as the size of a block to the power of 1.5; in catheters as its square.
    """
    if scene.effects.magnetic_interaction is None or not acting.feels_itself(scene):
        return scene, 0.0
    count = _blocks(scene)
    for across in (2, 4, 1):
        other = scene.with_effects(magnetic_interaction={"blocks_across": across})
        ratio = count / _blocks(other)
        if ratio != 1.0:
            return other, 1.0 / abs(ratio ** (ORDER / 3.0) - 1.0)
    return scene, 0.0


def _blocks(scene: Scene) -> float:
    """Number of dipoles of a scene with `magnetic_interaction`."""
    return build(scene).remanence[:, 3].max() + 1.0


class Equilibria(Grids):
    """Equilibria of a straight body."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.models: dict[int, StaticModel] = {}
        self.found: dict[int, Equilibrium] = {}
        self._grids: dict[int, Array] = {}  # coefficients (planes, m) m
        self._points: dict[int, Array] = {}

    def solve(self, cells: int) -> None:
        """Solve an equilibrium, from the finest coarser grid's, or from a proof of the same grid."""
        if cells in self.found:
            return
        begun = time.perf_counter()
        model = self._model(cells)
        self.found[cells] = found = self._solved(model, self._nearest(cells))
        self._note(cells, found.point.grid, begun, found.steps)

    def prove(self, cells: int, against: int) -> None:
        """Come so near to an equilibrium that its distance from the grid `against` is known: mostly by one factorization."""
        if cells in self.solved:
            return
        if (
            acting.feels_itself(self.scene) or self._model(cells).touching is not None
        ):  # one tangent will not do
            self.solve(cells)
            return
        begun = time.perf_counter()
        model = self._model(cells)
        coarse = self._nearest(cells)
        assert coarse is not None  # `against` is solved
        start = carried(self.models[coarse], self._grids[coarse], model)
        tell = self.on_step or (lambda step, number: None)
        slenderness = self.scene.length / self.scene.thickness
        near = approached(
            Energy(model),
            start,
            lambda grid: self._where(model, grid),
            self._points[against],
            slenderness,
            tell,
        )
        if near is None:
            found = self._solved(model, coarse)
            self._note(cells, found.point.grid, begun, found.steps)
        else:
            self._note(cells, near, begun, 1.0)

    def distance_between(self, coarse: int, fine: int) -> float:
        """The largest distance (m) between the axes, or the tips, of two grids."""
        return farthest(self._points[coarse], self._points[fine])

    def left_by_blocks(self, cells: int) -> float:
        """Solve the same grid with another number of blocks."""
        other, share = with_other_blocks(self.on(cells))
        if share == 0.0:
            return 0.0
        model = model_at_rest(other)
        found = solve_static(model, on_step=self.on_step, with_stability=False)
        return share * farthest(self._points[cells], self._where(model, found.point.grid))

    def effort(self, cells: int, steps: float) -> float:
        """Counted operations and particles, of the steps and of building the model."""
        # passes over the particles that building a model costs, in units of a Newton step's
        building = 2.0
        weight = PARTICLE * memory.fewest_particles(self.on(cells))
        return steps * (operations(self.on(cells))[0] + weight) + building * weight

    def size(self, cells: int) -> float:
        """Bytes of the matrix."""
        return operations(self.on(cells))[1]

    def _nearest(self, cells: int) -> int | None:
        """The finest grid that is solved and not finer."""
        return max((n for n in self._grids if n <= cells), default=None)

    def _model(self, cells: int) -> StaticModel:
        if cells not in self.models:
            with memory.within(self.on(cells)):
                self.models[cells] = model_at_rest(self.on(cells))
        return self.models[cells]

    def _note(self, cells: int, grid: Array, begun: float, steps: float) -> None:
        model = self.models[cells]
        self._grids[cells], self._points[cells] = grid, self._where(model, grid)
        seconds = time.perf_counter() - begun
        ends = (axis.centreline(model, grid), axis.tip(model, grid))
        self.solved[cells] = Solved(
            cells, cells in self.found, seconds, steps, model.dof, *ends, float(np.abs(grid).max())
        )

    def _where(self, model: StaticModel, grid: Array) -> Array:
        """Points where errors are meant, (k, 3) m: along the centreline, or at the tip."""
        if self.scene.resolution.of == "tip":
            return axis.tip(model, grid)[None]
        s = np.linspace(0.0, model.grid.faces[-1], AXIS_STATIONS)
        return axis.along_axis(model, grid, axis.section_weights(model), s)

    def _solved(self, model: StaticModel, begin_at: int | None) -> Equilibrium:
        if begin_at is not None and not acting.feels_itself(self.scene):
            grid = self._grids[begin_at]
            same = self.models[begin_at] is model
            try:
                return solve_from(
                    model,
                    grid if same else carried(self.models[begin_at], grid, model),
                    on_step=self.on_step,
                )
            except TimeOver:
                raise
            except SolveError:  # from no load, then
                pass
        return solve_static(model, on_step=self.on_step, with_stability=False)


def operations(scene: Scene) -> tuple[float, float]:
    """Multiply-adds of a factorization on the scene's grid, and the bytes of its matrix, before anything is built."""
    grid = scene.body.shape.grid(scene.resolution.cells_across, knots_of(scene))
    along, *across = (float(nodes) for nodes in grid.nodes)
    along = along - 2
    m = 3.0 * across[0] * across[1]
    if scene.body.shape.in_plane_strain:
        m /= across[0]
    return 19 / 3 * along * m**3, 8.0 * 3 * (along + 2) * m**2


def approached(
    energy: Energy,
    start: Array,
    points: Callable[[Array], Array],
    compared: Array,
    slenderness: float,
    on_step: OnStep,
) -> Array | None:
    """The equilibrium near grid coefficients `start` (planes, m) m; None where this is not to be had so cheaply: by one factorization.

    The residual of each step is exact, whatever the factors. So these may be of single precision, which takes half the time, unless the
    body is slender: they are right to 1e-7 of the stiffest mode, and the softest one of a body of L/D 30 is no stiffer.
    points(grid): where the difference counts, (k, 3) m; compared (k, 3) m: these of the coarser grid. Steps end when one moves the
    points by less than PROOF_SETTLED of their distance to `compared`. slenderness: length over thickness. on_step(number, 0.0): at each
    step.
    """
    point = energy.at(start)
    if not point.min_det_F > 0:
        return None
    residual, matrix = energy.tangent(point)
    assert isinstance(matrix, Bands)  # bodies with several grids at once are straight
    factors = matrix if slenderness > SLENDER else matrix.rounded()
    if not factors.factor():
        return None
    newton = factors.solve
    first = 0.0
    at = points(start)
    direction = -newton(residual)
    pairs: list[tuple[Array, Array]] = []
    for step in range(10 + 1):
        point = energy.at(point.grid + direction)
        if not point.min_det_F > 0:
            return None
        before = at
        at = points(point.grid)
        moved = farthest(at, before)
        first = first if step else moved
        on_step(step, 0.0)
        if step and moved < PROOF_SETTLED * farthest(at, compared):
            return point.grid
        if moved > 3.0 * first:  # a longer step leads away
            return None
        last = residual
        residual = energy.residual(point)
        pairs = [*pairs[1 - PAIRS :], (direction, residual - last)]
        direction = corrected(residual, pairs, lambda right: -newton(right))
    return None
