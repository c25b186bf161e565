"""Equilibrium of a body that acts on itself: in one part of its energy, every particle interacts with all others.

The second derivative of this part is dense, and is never formed. Instead the step is preconditioned L-BFGS. It takes the gradient of the
whole energy and the factored tangent of the other parts; changes of the gradient in recent steps stand in for the missing tangent. Every
step lowers the whole energy, so the result is a minimum. Source: Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 7.4.

The tangent of the other parts may have no Cholesky factors at a stable equilibrium: magnets that attract each other press the body
together, and only the way in which this force follows them keeps it from buckling. So the factors are those of statics.definite, and where
the tangent itself is meant (`solve_columns`, statics.stability) they only precondition: its products, all parts included, decide.
"""

from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.effects.base import BodyChange
from magmpm.effects.calls import rows
from magmpm.errors import Collapsed, SolveError
from magmpm.kernels.changes import loads
from magmpm.kernels.equilibrium import grid_to_particles
from magmpm.statics.definite import Definite
from magmpm.statics.energy import Energy, Point
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import (
    ENERGY_ROUNDING,
    LEAST_FRACTION,
    ROUNDING_AT_REST,
    Minimum,
    OnStep,
    corrected,
    factored,
    fall,
)

MOST_PRODUCTS = 200


class InteractingEnergy:
    """Whole energy of a model: effects on each particle by itself, and effects between all particles of the body."""

    def __init__(self, model: StaticModel, share: float = 1.0) -> None:
        """share: of all loads, those within the body too."""
        scene = model.scene.with_effects(magnetic_interaction=None)
        self.model = model
        self.alone = Energy(
            replace(model, scene=scene, effects=acting.collect(scene, share, model.times))
        )
        self.named = acting.collect(model.scene, share, model.times)
        self.whole = Energy(replace(model, effects=self.named))
        self._definite = Definite()

    def held_load(self, load: Array | None) -> None:
        """Put the body under a load, as of Energy."""
        self.alone.held_load(load)
        self.whole.held_load(load)

    def at(self, grid: Array) -> Point:
        """State and whole energy for grid coefficients (planes, m) m. `residual` then uses its loads."""
        self._point = point = self.alone.at(grid)
        if not point.min_det_F > 0:
            return point
        acting.refresh(self.named, self.model, point.position, point.F)
        return replace(
            point,
            energy=point.energy
            + acting.shared_energy(self.named, self.model, point.position, point.F),
        )

    def factor(self, point: Point) -> None:
        """Factor the tangent of the other parts, with as much of the mass matrix as that takes, in the matrix of `alone`.

        Raises SolveError where values are not finite.
        """
        residual, _ = self._definite.made(self.alone, point)
        if residual is None:
            raise SolveError(
                "the tangent can't be made positive definite: it holds values that are not finite",
                point,
            )

    @property
    def shift(self) -> float:
        """Multiple of the mass matrix in the last factors, Pa/m^2."""
        return self._definite.shift

    def residual(self, point: Point) -> Array:
        """Gradient (planes, m) N of the whole energy, at the point from the last call of `at`."""
        return self.whole.residual(point)

    def products(self, point: Point, columns: Array) -> tuple[Array, Array]:
        """Products as those of Energy, at the point from the last call of `at`."""
        stiff, heavy = self.alone.products(point, columns)
        return stiff + self.refresh_product(point, columns), heavy

    def refresh_product(self, point: Point, columns: Array) -> Array:
        """The second derivative of the shared energy times columns (planes, k, m), N, at the point from the last call of `at`."""
        model = self.model
        alone = self.alone
        n = len(model.shear)
        count = columns.shape[1]
        P = np.zeros((count, n, 3, 3))
        f = np.zeros((count, n, 3))
        dx = np.empty((n, 3))
        dF = np.empty((n, 3, 3))
        still = np.zeros((n, 3))
        for k in range(count):
            grid_to_particles(
                alone.cells,
                alone.particles,
                np.ascontiguousarray(columns[:, k]),
                np.zeros_like(model.axes),
                dx,
                dF,
            )
            self._add_refreshed(point, BodyChange(still, dx, dF), P[k], f[k])
        return self.alone.each_scattered(P, f)

    def _add_refreshed(self, point: Point, by: BodyChange, P: Array, f: Array) -> None:
        """Add the change of stress P (n, 3, 3) Pa and force f (n, 3) N/m^3 as tables follow a change of the body."""
        model = self.model
        change = acting.refresh_change(self.named, model, point.position, point.F, by)
        magnet = model.remanence
        loads(rows(change, "load"), magnet, model.density, point.position, point.F, P, f)

    def refresh_by_remanence(self, point: Point, changes: Array) -> Array:
        """Change (planes, k, m) N of the residual as tables follow changes (k, n, 3) T of the remanence, at the point of the last `at`."""
        n = len(self.model.shear)
        count = len(changes)
        P = np.zeros((count, n, 3, 3))
        f = np.zeros((count, n, 3))
        for k in range(count):
            by = BodyChange(changes[k], np.zeros((n, 3)), np.zeros((n, 3, 3)))
            self._add_refreshed(point, by, P[k], f[k])
        return self.alone.each_scattered(P, f)

    def solve_columns(self, right: Array) -> Array:
        """K^-1 times right-hand sides (planes, k, m), K the tangent of the whole energy at the last point of `at` and `factor`.

        Conjugate gradients, preconditioned by the factors: a product with their matrix is a sum of earlier ones, and what of the mass is in
        it is taken out again. Raises SolveError where K is not positive definite. Source: Nocedal and Wright, algorithm 5.3.
        """
        added = (self.shift * self._definite.mass(self.alone))[:, None]
        x = np.zeros_like(right)
        left = right.copy()
        z = self.alone.solve_columns(left)
        # Ap: the matrix of the factors times p
        p = z.copy()
        Ap = left.copy()
        size = start = _dots(left, z)
        for _ in range(MOST_PRODUCTS):
            on = size > 1e-11**2 * start  # of the first residual, in the energy's norm
            if not on.any():
                return x
            product = Ap - added * p + self.refresh_product(self._point, p)
            curvature = _dots(p, product)
            if np.any(curvature[on] <= 0.0):
                raise SolveError(
                    "the tangent of the whole energy is not positive definite: the equilibrium is"
                    " at a critical load"
                )
            step = np.where(on, size / np.where(on, curvature, 1.0), 0.0)[None, :, None]
            x += step * p
            left -= step * product
            z = self.alone.solve_columns(left)
            before = size
            size = _dots(left, z)
            again = (size / np.where(before > 0.0, before, 1.0))[None, :, None]
            p = z + again * p
            Ap = left + again * Ap
        raise SolveError(
            f"sensitivities did not converge in {MOST_PRODUCTS} conjugate-gradient steps: the "
            "equilibrium is too close to a critical load"
        )


def energy_of(model: StaticModel) -> Energy | InteractingEnergy:
    """The whole energy of a model, of whichever kind."""
    return InteractingEnergy(model) if acting.feels_itself(model.scene) else Energy(model)


def _dots(a: Array, b: Array) -> Array:
    """Inner products (k,) of columns (planes, k, m)."""
    return np.einsum("pkm,pkm->k", a, b)


def minimize_with_interaction(
    energy: InteractingEnergy,
    start: Array,
    *,
    tolerance: float,
    max_steps: int,
    on_step: OnStep | None = None,
) -> Minimum:
    """A minimum of the whole energy, from grid coefficients `start` (planes, m) m, as newton.minimize.

    Raises SolveError, with the last point as its state, if 10 max_steps steps do not reach it, or no step lowers the energy.
    """
    steps_factor = 10  # times max_steps: these steps are cheap
    fresh = 6  # steps with one factorization
    alone = energy.alone
    rest = energy.at(np.zeros_like(start)).energy
    point = energy.at(start)
    gradient = energy.residual(point)
    remembered: list[
        tuple[Array, Array]
    ] = []  # the last twelve steps, and what they changed in the gradient
    age = fresh
    decrement = np.inf
    scale = 1.0
    for step in range(1, steps_factor * max_steps + 1):
        if age >= fresh:
            factored(alone, point)
            age = 0
        direction = corrected(gradient, remembered, lambda g: -alone.matrix.solve(g))
        decrement = fall(gradient, direction)
        if not decrement > 0:  # the remembered steps are out of date
            remembered.clear()
            direction = -alone.matrix.solve(gradient)
            decrement = fall(gradient, direction)
        scale = max(abs(point.energy - rest), alone.least_scale())
        if on_step is not None:
            on_step(step, decrement / scale)
        if decrement < tolerance * scale:
            return Minimum(point, step, decrement / scale)
        before = point
        fraction = alone.clear_share(point.grid, direction)
        noise = max(ENERGY_ROUNDING * scale, ROUNDING_AT_REST * alone.least_scale())
        while True:
            point = energy.at(before.grid + fraction * direction)
            if (
                point.min_det_F > 0
                and point.energy <= before.energy - 2e-4 * fraction * decrement + noise
            ):
                break
            fraction *= 0.5
            if fraction < LEAST_FRACTION:
                raise SolveError("no step lowers the energy: the line search failed", before)
        if (
            point.min_det_F < 1e-3
        ):  # dipoles of neighbors fall onto each other: their energy has no lower bound
            raise Collapsed(
                "the segments attract each other more strongly than their material can resist, "
                f"and collapse onto each other: det F fell to {point.min_det_F:.2g} (bodies "
                "resist up to a Br^2/(mu0 G) of about 1)",
                before,
            )
        after = energy.residual(point)
        pair = point.grid - before.grid, after - gradient
        remembered = [*remembered[-11:], *([pair] if float(np.sum(pair[0] * pair[1])) > 0 else [])]
        gradient = after
        age = fresh if fraction <= 0.25 else age + 1
    raise SolveError(
        f"no equilibrium of segments that act on each other within {steps_factor * max_steps} steps"
        f" (energy decrement {decrement / scale:.1e} of the energy, wanted {tolerance:.1e})",
        point,
    )
