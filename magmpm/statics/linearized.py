"""An equilibrium and its neighbors: how its unknowns and its axis answer to a small change of what the scene says.

At equilibrium r(c, p) = 0, with r the gradient of the energy with respect to the grid's coefficients c, and p any number of the scene. So
dc/dp = -K^-1 dr/dp, with the tangent K = dr/dc. An objective J of the axis has dJ/dp = -(K^-1 dJ/dc) . dr/dp, and what the axis depends on
p at fixed c: one substitution for any number of variables.
Source: implicit function theorem; Tortorelli and Michaleris, Inverse Problems in Engineering 1 (1994) 71, for both forms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any, Literal

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.errors import PAIR, SolveError
from magmpm.scene.variables import Variable
from magmpm.statics import axis
from magmpm.statics.changes import (
    contact_changes,
    geometry_changes,
    magnet_changes,
    push_changes,
    right_sides,
    touched_by,
)
from magmpm.statics.definite import NEUTRAL
from magmpm.statics.energy import Energy, Point
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.newton import refined
from magmpm.statics.surface_pairs import pair_name


class Linearized:
    """Neighborhood of an equilibrium for k variables of its scene, with the factors of its tangent.

    Parameters
    ----------
    found : Equilibrium
        The equilibrium, with its energy.
    variables : sequence of Variable
        Numbers of the scene that may change.

    Raises
    ------
    SolveError
        Where the tangent has an eigenvalue that is not positive, or counts as zero.
    """

    def __init__(self, found: Equilibrium, variables: Sequence[Variable]) -> None:
        """Factor the tangent, and find how the residual changes with each variable."""
        assert found.energy is not None
        if found.stability is not None and found.stability < NEUTRAL:
            raise SolveError(
                "the equilibrium is at a critical load, or free to turn about an axis: its softest"
                f" motion has {found.stability:.1e} of the unloaded body's stiffness (less than"
                f" {NEUTRAL:g} counts as none), so it has no sensitivities; remedy: take a load"
                " farther from the critical one, or hold what is free to turn by a small load"
                " across"
            )
        self._whole = found.energy
        self.energy = found.energy.alone
        self.model = found.energy.model
        self.variables = variables
        with one_blas_thread():
            self._point = self._refined(found.point.grid)
            self._factor()
            self._geometry = geometry_changes(self.model, self._point.grid, self.variables)
            self._right = self._right_sides()

    def _factor(self) -> None:
        if not isinstance(
            self._whole, Energy
        ):  # whether the whole tangent is positive definite, its products tell as it is solved with
            self._whole.factor(self._point)
            return
        _, matrix = self.energy.tangent(self._point)
        if not matrix.factor():
            raise SolveError(
                "the equilibrium is at a critical load: its tangent is not positive definite, so it"
                " has no sensitivities"
            )

    def _refined(self, grid: Array) -> Point:
        if isinstance(self._whole, Energy):
            return refined(self._whole, self._whole.at(grid))
        for _ in range(3):  # Newton steps: each doubles the digits of what the solve found
            self._point = self._whole.at(grid)
            residual = self._whole.residual(self._point)
            self._factor()
            grid = grid - self._whole.solve_columns(residual[:, None])[:, 0]
        return self._whole.at(grid)

    def _right_sides(self) -> Array:
        whole = self._whole
        right = right_sides(
            whole if isinstance(whole, Energy) else whole.whole, self._point, self.variables
        )
        changes = magnet_changes(self.model, self.variables)
        if changes and not isinstance(whole, Energy):
            right[:, list(changes)] += whole.refresh_by_remanence(
                self._point, np.array(list(changes.values()))
            )
        for k, change in self._geometry.items():
            right[:, k] = change.residual
        for k, stiffer in contact_changes(self.model, self._point.grid, self.variables).items():
            right[:, k] += self.energy.free(stiffer)
        return right

    def solve(self, right: Array) -> Array:
        """K^-1 times right-hand sides (planes, k, m), by block substitution; with interaction, conjugate gradients of these."""
        with one_blas_thread():
            return self._whole.solve_columns(right)

    @cached_property
    def unknowns(self) -> Array:
        """dc/dp (planes, k, m), m per unit."""
        return -self.solve(self._right)

    @cached_property
    def tip(self) -> Array:
        """Derivatives (3, k), m per unit, of the tip (Result.tip)."""
        out = np.einsum("pn,pkni->ik", self._tip_weights, self._by_node(self.unknowns))
        for k, change in self._geometry.items():
            out[:, k] += change.tip
        return out

    @cached_property
    def centreline(self) -> Array:
        """Derivatives (rows, 3, k), m per unit, of the axis's rows."""
        along, across = self._axis
        out = np.einsum(
            "rp,pkni,n->rik", along, self._by_node(self.unknowns), across, optimize=True
        )
        for k, change in self._geometry.items():
            out[:, :, k] += change.rows[:, 1:]
        return out

    @cached_property
    def stations(self) -> Array:
        """Derivatives (rows, k), m per unit, of the rows' arc lengths."""
        out = np.zeros(
            (len(self.model.grid.stations) if self.model.line else 0, len(self.variables))
        )
        for k, change in self._geometry.items():
            out[:, k] = change.rows[:, 0]
        return out

    def adjoint(self, gradient: Array) -> Array:
        """dJ/dp (k,) for dJ/d(axis) (rows, 3)."""
        along, across = self._axis
        right = np.einsum("rp,ri,n->pni", along, gradient, across, optimize=True).reshape(
            len(self._right), 1, -1
        )
        multiplier = self.solve(self.energy.free_columns(right))
        out = -np.einsum("pm,pkm->k", multiplier[:, 0], self._right)
        for k, change in self._geometry.items():
            out[k] += np.sum(gradient * change.rows[:, 1:])
        return out

    @cached_property
    def _axis(self) -> tuple[Array, Array]:
        """Splines along (rows, planes) and weights across (nodes,) that give the axis's rows from the coefficients."""
        if self.model.line is None:
            return np.zeros((0, self.model.layout.planes)), np.zeros(
                self.model.layout.nodes_per_plane
            )
        return axis.splines_along(self.model, self.model.grid.stations), axis.section_weights(
            self.model
        )

    def mean(self, share: Array) -> Array:
        """Derivatives (3, k), m per unit, of the particles' positions summed by these shares (n,), of an unchanged shape."""
        if self._geometry and any(change.rows.any() for change in self._geometry.values()):
            raise ValueError(
                "where lengths or diameters change, a mean of particles has no derivative"
            )
        return np.einsum("pn,pkni->ik", self._mean_weights(share), self._by_node(self.unknowns))

    def pushed(self, obstacle: str) -> Array:
        """Derivatives (3, k), N per unit, of the sum of an obstacle's forces on the body or a part, or of two parts', while the same points
        touch.

        Of the points' forces f(x) and slopes H = -df/dx: df/dp = -H dx/dp, and what f depends on p at fixed coefficients.
        """
        model = self.model
        grid = self._point.grid
        by_node = np.moveaxis(self._by_node(self.unknowns), 1, -1)
        k = by_node.shape[-1]
        fixed = push_changes(model, grid, self.variables, obstacle)
        if obstacle.startswith("self_contact"):
            assert model.pairs is not None  # of a scene that names self_contact
            own = model.pairs.touched(grid)
            columns = np.moveaxis(by_node.reshape(-1, 3, k), -1, 0)
            each = [own.change_between(obstacle, nodes) for nodes in columns]
            return fixed + np.reshape(each, (k, 3)).T
        assert model.touching is not None  # it has the obstacle
        touched = touched_by(model, grid, obstacle)
        moved = model.touching.splines[touched.on] @ by_node.reshape(-1, 3 * k)
        return fixed - np.einsum("tij,tjk->ik", touched.H, moved.reshape(-1, 3, k))

    @property
    def touchable(self) -> list[str]:
        """Names that `pushed` takes: the scene's obstacles, each with each part, and each two parts that may touch."""
        named = self.model.scene.effects.named()
        parts = [region.name for region in self.model.scene.regions()]
        obstacles = [key for key in ("ground", "walls") if key in named]
        of_parts = [f"{key}{PAIR}{part}" for key in obstacles for part in parts]
        between = [] if self.model.pairs is None else combinations(parts, 2)
        return [*obstacles, *of_parts, *(pair_name(*two) for two in between)]

    def _mean_weights(self, share: Array) -> Array:
        """Weights (planes, nodes) that give the mean position of particles from the coefficients."""
        force = (-share / self.model.particles.volume)[:, None] * np.array([1.0, 0.0, 0.0])
        out = self.energy.each_scattered(np.zeros((1, len(share), 3, 3)), force[None])
        return np.asarray(out[:, 0, ::3])

    @cached_property
    def _tip_weights(self) -> Array:
        """Weights (planes, nodes) that give the tip from the coefficients."""
        model = self.model
        if model.line is not None:
            return axis.splines_along(model, model.grid.stations[-1:])[0][
                :, None
            ] * axis.end_face_weights(model)
        share = model.tip_weights
        assert share is not None  # Sensitivities.tip
        return self._mean_weights(share)

    def _by_node(self, columns: Array) -> Array:
        """Columns (planes, k, m) as (planes, k, nodes, 3)."""
        return columns.reshape(*columns.shape[:2], -1, 3)


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of an equilibrium's shape with respect to k variables of its scene, in SI per unit of each variable.

    Each derivative is computed when it is first requested.

    Attributes
    ----------
    result : Result
        The equilibrium.
    variables : tuple of Variable
        What is changed, in the order of the last axis of the derivatives.

    Examples
    --------
    >>> import magmpm
    >>> import numpy as np
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> found = magmpm.sensitivities(scene, of=["field"])
    >>> found.units
    ('T', 'T', 'T')
    >>> at_the_tip = np.zeros((len(found.result.centreline), 3))
    >>> at_the_tip[-1, 2] = 1.0  # of an objective that is the height of the axis's end
    >>> bool(np.allclose(found.adjoint(at_the_tip), found.centreline[-1, 2]))
    True
    """

    result: Any  # results.result.Result, which statics does not know
    variables: tuple[Variable, ...]
    _near: Linearized = field(repr=False)

    @property
    def tip(self) -> Array | None:
        """Derivatives (3, k), m per unit, of `result.tip`; None where the body has no tip."""
        return None if self.result.tip is None else self._near.tip

    @property
    def centreline(self) -> Array:
        """Derivatives (stations, 3, k), m per unit, of x, y, z in `result.centreline`, row by row; no rows for a body without an axis.

        A row stays in its place in a cell, so where a segment gets longer the row's arc length grows; `at` is for fixed arc lengths.
        """
        return self._near.centreline

    def mean(self, region: int | None = None) -> Array:
        """Find the derivatives of the mean position of a region, or of the body, for variables that leave the undeformed shape as it is.

        Parameters
        ----------
        region : int, optional
            Index of a segment or part; the whole body unless given.

        Returns
        -------
        array (3, k), m per unit
            A column for each variable.

        Raises
        ------
        ValueError
            For lengths and diameters.
        """
        volume = self._volumes(region)
        return self._near.mean(volume / volume.sum())

    def moments(self, region: int | Literal["tip"] | None = None) -> Array:
        """Find the derivatives of the first moments of a region, or of the body, which decide how it turns.

        They are the mean of x_i X_j, where X is the undeformed place, from its mean. For variables
        that leave the undeformed shape as it is.

        Parameters
        ----------
        region : int or "tip", optional
            Index of a segment or part, or the last cells of a straight body; the whole body unless
            given.

        Returns
        -------
        array (3, 3, k), m^2 per unit
            Of i and j for each variable.

        Raises
        ------
        ValueError
            For lengths and diameters.
        """
        volume = self._volumes(region)
        share = volume / volume.sum()
        place = self._near.model.particles.position
        arms = place - share @ place
        return np.stack([self._near.mean(share * arm) for arm in arms.T], axis=1)

    def contact_force(self, obstacle: str) -> Array:
        """Find the derivatives of the sum of an obstacle's forces on the body, or of two parts of it on each other.

        They are exact while the same points of the surface touch; where one begins to, the derivative
        jumps.

        Parameters
        ----------
        obstacle : str
            As `contacts` names it: "ground", "walls", "walls: tip", or "self_contact: a, b": the
            force on a.

        Returns
        -------
        array (3, k), N per unit
            A column for each variable.

        Raises
        ------
        ValueError
            For a name that is none of the scene's obstacles or pairs.
        """
        known = self._near.touchable
        if obstacle not in known:
            raise ValueError(f"obstacle {obstacle!r} is not one of the scene's: {known}")
        return self._near.pushed(obstacle)

    def _volumes(self, region: int | Literal["tip"] | None) -> Array:
        """Volume (n,) m^3 of each particle, 0 outside of a region."""
        particles = self._near.model.particles
        if region == "tip":
            return particles.volume * (particles.cell[:, 0] == particles.cell[:, 0].max())
        return particles.volume * (True if region is None else particles.segment == region)

    @property
    def names(self) -> tuple[str, ...]:
        """The variables' names, such as segment_1_azimuth, field_x, remanence_silicone."""
        return tuple(variable.name for variable in self.variables)

    @property
    def units(self) -> tuple[str, ...]:
        """The variables' units: rad, T, Pa, m or kg/m^3."""
        return tuple(variable.unit for variable in self.variables)

    def at(self, arc_lengths: Array) -> Array:
        """Find the derivatives of the axis at fixed arc lengths, those of `results.measures.centreline_at(result, arc_lengths)`.

        They are exact, as that is: parabolas through three rows.

        Parameters
        ----------
        arc_lengths : array (m,), m
            Along the undeformed axis.

        Returns
        -------
        array (m, 3, k), m per unit
            Of x, y and z at each arc length for each variable.

        Raises
        ------
        ValueError
            For an arc length outside the body.
        """
        s = np.asarray(arc_lengths, dtype=float)
        rows = self.result.centreline
        stations, _, k = self.centreline.shape
        values, _ = on_rows(rows[:, 0], self.centreline.reshape(stations, 3 * k), s)
        _, slope = on_rows(rows[:, 0], rows[:, 1:], s)
        moved, _ = on_rows(rows[:, 0], self._near.stations, s)
        return values.reshape(len(s), 3, k) - slope[:, :, None] * moved[:, None, :]

    def adjoint(self, gradient: Array) -> Array:
        """Find the derivatives of an objective of the axis, by one substitution, however many variables there are.

        Parameters
        ----------
        gradient : array (stations, 3), the objective's unit per m
            Its derivatives with respect to x, y and z of the rows of `result.centreline`.

        Returns
        -------
        array (k,), the objective's unit per unit of each variable
            Its derivatives with respect to the variables.

        Raises
        ------
        ValueError
            For a gradient of another shape.
        """
        gradient = np.asarray(gradient, dtype=float)
        rows = self.result.centreline
        if gradient.shape != (len(rows), 3):
            raise ValueError(
                f"gradient has shape {gradient.shape}; must be {(len(rows), 3)}, a row for each of"
                " the centreline's"
            )
        return self._near.adjoint(gradient)
