"""Designs of an insertion by the rod: directions of magnetization that all depths share, and a field at each depth.

Most designs that would put a rod onto the path can't hold it there: magnets that point against the field are inverted pendulums, and the
rod falls to another branch. So designs *grow with the path*: they begin with a path without curvature (and a rod without weight), where
magnets along the axis in a field along the axis are stable, and least squares follows the path as it bends, in small steps. Where rods
leave their branch all the same, rod_path.py mends the design; what is hopeless is given up for the next random start.

The fields of two depths do not touch each other's shapes: the normal equations are an arrow, and each depth is eliminated by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from magmpm.bodies.catheter import Catheter
from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import rod_model
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.studies.problem.path import Path
from magmpm.studies.search.samplers.blocks import across, unit

# of the whole catheter: positions to a tenth of a per cent of the length; designs need no more
TRAJECTORY_ELEMENTS = 48
# of the path's curvature: a step with which it grows, and the least one
FIRST_CURVATURE_STEP = 1 / 6
LEAST_CURVATURE_STEP = 1 / 48
STEPS_PER_CURVATURE = 12  # of least squares at each share of the curvature
Shapes = tuple[Array, ...]  # the frames of each depth's rod as quaternions (n + 1, 4)


@dataclass(frozen=True)
class Depth:
    """One depth of the trajectory as a rod of n elements, and the path there.

    Attributes
    ----------
    rod : RodFamily
        The rod.
    segments : array of int
        Which of the whole catheter's segments are outside and magnetized.
    place : array (n + 1,), m
        Arc lengths.
    path : array (n + 1, 3), m
        The path's points there.
    roots : array (n + 1,), no unit
        Square roots of the weights of the points' squared distances.
    """

    rod: RodFamily
    segments: np.ndarray
    place: Array
    path: Array
    roots: Array

    def weighing(self, share: float) -> Depth:
        """Make the depth with a share of its weight.

        Parameters
        ----------
        share : float, no unit
            0 to 1.

        Returns
        -------
        Depth
            The lighter depth.
        """
        return replace(
            self,
            rod=replace(self.rod, rod=replace(self.rod.rod, weight=share * self.rod.rod.weight)),
        )

    def settled(
        self, q: Array, directions: Array, uniform: Array
    ) -> tuple[Array, Array, Array] | None:
        """Find the equilibrium that the rod comes to.

        Parameters
        ----------
        q : array (1, n + 1, 4), no unit
            The frames that it begins from; changed in place.
        directions : array (k, 3), no unit
            Unit vectors of all segments.
        uniform : array (3,), T
            The field.

        Returns
        -------
        tuple[Array, Array, Array] or None
            Weighted gaps (3 (n + 1),) m, their slopes by directions and field, and positions (n
            + 1, 3) m; None where there is no equilibrium.
        """
        position, slopes, found = self.rod.relaxed(
            q, directions[None, self.segments], uniform[None]
        )
        if not found[0]:
            return None
        gaps = (position[0] - self.path) * self.roots[:, None]
        return (
            gaps.ravel(),
            (slopes[0] * self.roots[:, None, None]).reshape(gaps.size, -1),
            position[0],
        )


@dataclass(frozen=True)
class RodStates:
    """Rods in equilibrium, one a depth.

    Attributes
    ----------
    shapes : Shapes
        Their frames as quaternions.
    gaps : tuple of array, m
        Their weighted gaps.
    slopes : tuple of array
        Derivatives of these by directions and field.
    positions : tuple of array, m
        Their axes.
    """

    shapes: Shapes
    gaps: tuple[Array, ...]
    slopes: tuple[Array, ...]
    positions: tuple[Array, ...]

    @property
    def squares(self) -> float:
        """Sum of squared gaps, m^2."""
        return float(sum(gap @ gap for gap in self.gaps))


@dataclass(frozen=True)
class RodTrajectoryDesign:
    """A design of a trajectory.

    Attributes
    ----------
    directions : array (k, 3), no unit
        Unit vectors of all segments.
    fields : array (D, 3), T
        The field at each depth.
    value : float, m
        Root of the weighted mean of the squared distances.
    state : RodStates or None
        Its rods, where they are known.
    """

    directions: Array
    fields: Array
    value: float
    state: RodStates | None = field(default=None, repr=False)


@dataclass(frozen=True)
class RodTrajectory:
    """An insertion along a path as rods.

    Attributes
    ----------
    depths : tuple of Depth
        The rods, one a depth.
    max_field : float, T
        Greatest strength of the field.
    movable : array of int
        The magnetized segments, whose directions may turn.
    count : int
        Number of all segments.
    """

    depths: tuple[Depth, ...]
    max_field: float
    movable: np.ndarray
    count: int

    @classmethod
    def of(
        cls,
        scene: Scene,
        path: Path,
        lengths: Sequence[float],
        *,
        max_field: float,
        exit_weight: float,
    ) -> RodTrajectory:
        """Make the rods of a scene's catheter at inserted lengths.

        Parameters
        ----------
        scene : Scene
            The scene.
        path : Path
            The path of the insertion.
        lengths : sequence of float, m
            Inserted lengths, rising.
        max_field : float, T
            Greatest strength of the field.
        exit_weight : float
            How much the exit counts (evaluate.trajectory.InsertionTrajectory).

        Returns
        -------
        RodTrajectory
            The rods.
        """
        depths = [depth_of(scene, path, float(length), len(lengths)) for length in lengths]
        roots = depths[-1].roots.copy()
        roots[-1] = np.sqrt(roots[-1] ** 2 + exit_weight)
        depths[-1] = replace(depths[-1], roots=roots)
        return cls(
            tuple(depths),
            max_field,
            np.array(scene.magnetized_regions(), dtype=int),
            len(scene.regions()),
        )

    def bent(self, path: Path, share: float) -> RodTrajectory:
        """Make the same rods along another path, with a share of their weight.

        Parameters
        ----------
        path : Path
            The other path.
        share : float, no unit
            0 to 1.

        Returns
        -------
        RodTrajectory
            The other rods.
        """
        return replace(
            self,
            depths=tuple(
                replace(depth.weighing(share), path=path.at(depth.place)) for depth in self.depths
            ),
        )

    def settled(self, directions: Array, fields: Array, shapes: Shapes | None) -> RodStates | None:
        """Find stable equilibria at all depths.

        Parameters
        ----------
        directions : array (k, 3), no unit
            Unit vectors of all segments.
        fields : array (D, 3), T
            The field at each depth.
        shapes : Shapes or None
            Frames that they begin from; None: straight.

        Returns
        -------
        RodStates or None
            The rods; None where one finds no equilibrium.
        """
        found = []
        for k, depth in enumerate(self.depths):
            q = depth.rod.straight(1) if shapes is None else shapes[k][None].copy()
            answer = depth.settled(q, directions, fields[k])
            if answer is None:
                return None
            found.append((q[0], *answer))
        return RodStates(*(tuple(part) for part in zip(*found, strict=True)))

    def least_squares(
        self, start: RodTrajectoryDesign, steps: int, *, turning: bool = True
    ) -> RodTrajectoryDesign:
        """Improve a design in equilibrium by Levenberg's and Marquardt's method.

        Parameters
        ----------
        start : RodTrajectoryDesign
            The design, with its state.
        steps : int
            How many there may be.
        turning : bool, default True
            Whether directions may change, not fields alone.

        Returns
        -------
        RodTrajectoryDesign
            The improved design.
        """
        d = start.directions
        v = to_ball(start.fields / self.max_field)
        state = start.state
        assert state is not None
        damping = 1e-2
        little = 0
        normal: tuple[Array, ...] | None = None
        for _ in range(steps):
            if normal is None:
                normal = self._normal(d, v, state, turning)
            bases, A, X, V, g, h = normal
            p, q = _arrow_step(A, X, V, g, h, damping)
            scale = min(1.0, 0.6 / max(np.abs(p).max(initial=0.0), np.abs(q).max(), 1e-300))
            d_new = self._turned(d, bases, scale * p)
            v_new = v + scale * q
            v_new *= np.minimum(1.0, 8.0 / np.maximum(np.linalg.norm(v_new, axis=1), 1e-300))[
                :, None
            ]  # 8: the boundary of the ball, 0.992
            tried = self.settled(d_new, self.max_field * from_ball(v_new), state.shapes)
            if tried is not None and tried.squares < state.squares:
                little = little + 1 if tried.squares > 0.99 * state.squares else 0
                d = d_new
                v = v_new
                state = tried
                normal = None
                damping = max(damping / 4, 1e-6)
            else:
                damping *= 5
            if little > 4 or damping > 1e5:
                break
        return RodTrajectoryDesign(
            d, self.max_field * from_ball(v), float(np.sqrt(state.squares)), state
        )

    def _normal(self, d: Array, v: Array, state: RodStates, turning: bool) -> tuple[Array, ...]:
        """Bases across the directions, and the blocks of J^T J and J^T r as _arrow_step takes them, in mm."""
        bases = across(d[self.movable])
        m = 2 * len(self.movable) if turning else 0
        depths = len(self.depths)
        A = np.zeros((m, m))
        X = np.zeros((depths, m, 3))
        V = np.empty((depths, 3, 3))
        g = np.zeros(m)
        h = np.empty((depths, 3))
        for k, depth in enumerate(self.depths):
            slopes = 1e3 * state.slopes[k]
            gaps = 1e3 * state.gaps[k]
            root = np.sqrt(1 + v[k] @ v[k])
            of_v = (
                self.max_field
                * slopes[:, -3:]
                @ (np.eye(3) / root - np.outer(v[k], v[k]) / root**3)
            )  # db/dv
            V[k], h[k] = of_v.T @ of_v, of_v.T @ gaps
            if turning:
                of_d = np.zeros((len(gaps), len(self.movable), 2))
                at = np.searchsorted(self.movable, depth.segments)
                of_d[:, at] = np.einsum(
                    "rka,kat->rkt", slopes[:, :-3].reshape(len(gaps), -1, 3), bases[at]
                )
                flat = of_d.reshape(len(gaps), m)
                A += flat.T @ flat
                g += flat.T @ gaps
                X[k] = flat.T @ of_v
        return bases, A, X, V, g, h

    def _turned(self, d: Array, bases: Array, p: Array) -> Array:
        """Directions (k, 3) after a step p of those that move; none move without a step."""
        if not len(p):
            return d
        moved = d.copy()
        moved[self.movable] += np.einsum("kat,kt->ka", bases, p.reshape(-1, 2))
        return unit(moved)

    def grown(self, path: Path, rng: np.random.Generator) -> RodTrajectoryDesign | None:
        """Grow a design with the path from a random start: the path's curvature and the weight grow from none.

        Parameters
        ----------
        path : Path
            The path.
        rng : np.random.Generator
            The generator.

        Returns
        -------
        RodTrajectoryDesign or None
            The design; None where it can't grow, or where it is hopeless.
        """
        d = unit(0.5 * rng.normal(size=(self.count, 3)) + [1.0, 0.0, 0.0])
        fields = self.max_field * np.tile(
            [0.5, 0.0, 0.0] + 0.2 * rng.normal(size=3), (len(self.depths), 1)
        )
        fields *= np.minimum(1.0, 0.95 * self.max_field / np.linalg.norm(fields, axis=1))[:, None]
        design = RodTrajectoryDesign(d, fields, 0.0)
        share = 0.0
        step = FIRST_CURVATURE_STEP
        size = self.depths[-1].place[-1]
        while share < 1.0:
            now = min(1.0, share + step)
            bent = self.bent(path.flattened(now), now) if now < 1.0 else self
            state = bent.settled(
                design.directions,
                design.fields,
                None if design.state is None else design.state.shapes,
            )
            found = None
            if state is not None:
                found = bent.least_squares(
                    replace(design, state=state), STEPS_PER_CURVATURE if now < 1.0 else 60
                )
            fell = (
                found is None or found.value > 1.5 * design.value + 5e-3 * size
            )  # to another branch
            if fell and step > LEAST_CURVATURE_STEP:
                step /= 2
            elif found is None or found.value > 0.1 * size:
                return None
            else:
                design = found
                share = now
                step = min(1.5 * step, FIRST_CURVATURE_STEP)
        return design

    def fitted(self, path: Path, directions: Array) -> RodTrajectoryDesign:
        """Find the fields that bring rods with given directions nearest to their path, depth by depth: the best of several first fields.

        The path's curvature and the weight grow as in `grown`. Where rods fall to another branch on
        the way, the fields follow them there.

        Parameters
        ----------
        path : Path
            The path.
        directions : array (k, 3), no unit
            Unit vectors of all segments.

        Returns
        -------
        RodTrajectoryDesign
            The design.
        """
        found = [RodTrajectoryDesign(directions, np.zeros((len(self.depths), 3)), np.inf)]
        for first in ((1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (-0.6, 0.0, 0.8)):
            design = RodTrajectoryDesign(
                directions, 0.5 * self.max_field * np.tile(first, (len(self.depths), 1)), np.inf
            )
            for share in np.linspace(0.0, 1.0, 5)[1:]:
                bent = self.bent(path.flattened(share), share) if share < 1.0 else self
                state = bent.settled(
                    directions, design.fields, None if design.state is None else design.state.shapes
                )
                if state is None:
                    break
                design = bent.least_squares(
                    replace(design, state=state), STEPS_PER_CURVATURE, turning=False
                )
            else:
                found.append(design)
        return min(found, key=lambda each: each.value)


def to_ball(b: Array) -> Array:
    """Map the unit ball to all of space: v with b = v/sqrt(1 + v^2).

    Parameters
    ----------
    b : array (D, 3)
        Points in the unit ball; those near its surface are drawn in.

    Returns
    -------
    array (D, 3)
        v.
    """
    size = np.linalg.norm(b, axis=1)
    inside = np.minimum(size, 0.99)
    return np.asarray(b * (inside / np.sqrt(1 - inside**2) / np.maximum(size, 1e-300))[:, None])


def from_ball(v: Array) -> Array:
    """Map all of space to the unit ball: b = v/sqrt(1 + v^2).

    Parameters
    ----------
    v : array (D, 3)
        Points.

    Returns
    -------
    array (D, 3)
        b.
    """
    return np.asarray(v / np.sqrt(1 + np.sum(v * v, axis=1))[:, None])


def _arrow_step(
    A: Array, X: Array, V: Array, g: Array, h: Array, damping: float
) -> tuple[Array, Array]:
    """The step of damped least squares (Marquardt's scaling): p (m,) of what depths share, q (D, 3) of each depth's own.

    A (m, m), X (D, m, 3), V (D, 3, 3): blocks of J^T J; g (m,), h (D, 3): of J^T r. Each depth is eliminated by itself.
    """
    small = 1e-3 * (np.trace(A) + np.trace(V, axis1=1, axis2=2).sum()) / (len(g) + h.size)
    own = np.einsum("kii->ki", V)
    V = V + np.eye(3) * (damping * (own + small) + 1e-12 * small)[:, None, :]
    Y = np.linalg.solve(V, np.concatenate([X.transpose(0, 2, 1), -h[:, :, None]], axis=2))
    S = (
        A
        + np.diag(damping * (np.diag(A) + small) + 1e-12 * small)
        - np.einsum("kix,kxj->ij", X, Y[:, :, :-1])
    )
    p = np.linalg.solve(S, -g - np.einsum("kix,kx->i", X, Y[:, :, -1]))
    return p, Y[:, :, -1] - Y[:, :, :-1] @ p


def depth_of(whole: Scene, path: Path, length: float, count: int) -> Depth:
    """Make the rod of one depth. Each depth counts the same, and within it each piece of its length.

    Parameters
    ----------
    whole : Scene
        The scene of the whole catheter.
    path : Path
        The path of the insertion.
    length : float, m
        The inserted length.
    count : int
        Number of depths.

    Returns
    -------
    Depth
        The depth.
    """
    scene = whole.with_field([0.0, 0.0, 0.0]).inserted(length)
    catheter = scene.body.shape
    assert isinstance(catheter, Catheter)
    rod = rod_model(scene, max(10, round(TRAJECTORY_ELEMENTS * length / whole.length)))
    magnetized = scene.magnetized_regions()
    place = rod.places
    share = np.zeros(len(place))
    share[1:] += rod.length / 2
    share[:-1] += rod.length / 2
    return Depth(
        rod=RodFamily.of(rod, catheter.segment_lengths(), magnetized),
        segments=np.array(magnetized, dtype=int) + len(whole.regions()) - len(scene.regions()),
        place=place,
        path=path.at(place),
        roots=np.sqrt(share / place[-1] / count),
    )
