"""Cosserat rod: an independent low-order model of a catheter or strip, solved in milliseconds.

It gives the 3D solver its start and its branch, checks it on slender scenes, and supports advice to the user.

The rod is a chain of orthonormal frames R_0 .. R_n (R_0 clamped). The columns of R are the tangent and the two axes of the section. The
energy has bending and twist between neighboring frames, and a potential at each frame. This potential is local in R, because in a uniform
field and weight the force in a section does not depend on the shape:

    E = sum_elements 1/2 kappa^T D kappa l + sum_frames U(R)
    U = -[ b.(m x-axis and transverse) + 1/2 f^T C f ] l,   b = R^T B, f = R^T (force in the section)

The last term is the work of stretch and shear, which depend on the frames alone: v = e_1 + C f with
C = diag(1/EA, 1/(k GA), 1/(k GA)). In a magnet the force in the section includes A/mu0 B Br_1 (the first column of the magnetic
stress), so a rod magnetized along its axis and pulled by the field stretches and shears.

kappa is the chord form 2/l Im(conj(q_k) q_(k+1)) of unit quaternions, second order in l. By its Hessian Newton finds buckling and twist.

Sources: Antman, Nonlinear Problems of Elasticity, chapter 8; Lang et al., Multibody Syst. Dyn. 25 (2011); Wang et al., JMPS 142 (2020).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.fields import schedule as fields
from magmpm.fields.dipole import MU0
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.rod.kernels import LoadedRod, frames_of, relax
from magmpm.scene import Scene

# elastica to 1e-4 in deflection and angle, also past buckling (second order: 120 gives 2e-4)
ROD_ELEMENTS = 180
Surroundings = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class RodShape:
    """Shape of a rod at rest, at its n + 1 frames.

    Attributes
    ----------
    s : array (n + 1,), m
        Arc lengths of the undeformed rod.
    position : array (n + 1, 3), m
        Of the frames' origins.
    frames : array (n + 1, 3, 3), no unit
        Columns: the tangent and the two axes of the section.
    curvature : array (n + 1, 3), 1/m
        In the frame: twist and two bendings.
    strain : array (n + 1, 3), no unit
        Of the material, v: (1, 0, 0) when unloaded.
    iterations : int
        Of the solve.
    stable : bool
        Whether the energy has a minimum there.
    energy : float, J
        Of the rod.
    quaternions : array (n + 1, 4), no unit
        Of the frames.
    field : array (n + 1, 3), T
        The external field that the frames are in.
    weight : array (n + 1, 3), N
        The weight beyond each frame.
    """

    s: Array
    position: Array
    frames: Array
    curvature: Array
    strain: Array
    iterations: int
    stable: bool
    energy: float
    quaternions: Array
    field: Array
    weight: Array

    def at(self, s: Array) -> Array:
        """Find places on the axis.

        Parameters
        ----------
        s : array (k,), m
            Arc lengths of the undeformed rod.

        Returns
        -------
        array (k, 3), m
            Positions there.
        """
        return linear(s, self.s, self.position)


@dataclass(frozen=True)
class RodModel:
    """A scene as a rod of n elements.

    Attributes
    ----------
    length : array (n,), m
        Of the elements.
    twist_bend : array (n, 3), N m^2
        Stiffness against twist and the two bendings.
    compliance : array (n, 3), 1/N
        Against stretch and the two shears.
    moment : array (n, 3), A m
        Magnetic moment per length in the frame, A Br/mu0.
    weight : array (n + 1, 3), N
        Beyond each frame.
    field : array (n + 1, 3), T
        At each frame.
    """

    length: Array
    twist_bend: Array
    compliance: Array
    moment: Array
    weight: Array
    field: Array

    @property
    def places(self) -> Array:
        """Arc lengths (n + 1,) m of the frames."""
        return np.concatenate([[0.0], np.cumsum(self.length)])

    def straight(self) -> Array:
        """Make the frames of the straight rod.

        Returns
        -------
        array (n + 1, 4), no unit
            Quaternions.
        """
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(self.length) + 1, 1))

    def loaded(self, **loads: Array) -> LoadedRod:
        """Make what the compiled functions take.

        Parameters
        ----------
        **loads : array
            moment, field or weight in place of its own; of many rods, with a first axis.

        Returns
        -------
        LoadedRod
            The rod with its loads.
        """
        own = {"moment": self.moment, "field": self.field, "weight": self.weight}
        return LoadedRod(self.length, self.twist_bend, self.compliance, **{**own, **loads})

    def relax(self, quaternions: Array) -> tuple[int, int, float, bool]:
        """Find the equilibrium near given frames (rod.kernels.relax).

        Parameters
        ----------
        quaternions : array (n + 1, 4), no unit
            The frames, changed in place.

        Returns
        -------
        status : int
            0 where it has converged.
        steps : int
            Newton steps.
        energy : float, J
            Of the rod.
        stable : bool
            Whether it is a minimum.
        """
        status, steps, energy, stable = relax(quaternions, self.loaded())
        return status, steps, energy, bool(stable)

    def shape(self, quaternions: Array, iterations: int, energy: float, stable: bool) -> RodShape:
        """Make the shape of an equilibrium.

        Parameters
        ----------
        quaternions : array (n + 1, 4), no unit
            Its frames.
        iterations : int
            Of the solve.
        energy : float, J
            Of the rod.
        stable : bool
            Whether it is a minimum.

        Returns
        -------
        RodShape
            The shape.
        """
        position, frames, curvature, strain = frames_of(quaternions, self.loaded())
        return RodShape(
            self.places,
            position,
            frames,
            curvature,
            strain,
            iterations,
            stable,
            energy,
            quaternions,
            self.field,
            self.weight,
        )


def rod_model(
    scene: Scene,
    elements: int = ROD_ELEMENTS,
    *,
    extensible: bool = True,
    time: float | None = None,
) -> RodModel:
    """Make the rod of a scene. Elements end where segments end.

    Parameters
    ----------
    scene : Scene
        The scene.
    elements : int, default ROD_ELEMENTS
        How many.
    extensible : bool, default True
        Whether it stretches and shears; else it is the pure elastica.
    time : float, s, optional
        Of the field's schedule; its end unless given.

    Returns
    -------
    RodModel
        The rod.

    Raises
    ------
    SolveError
        Where the body is no rod.
    """
    body = scene.body.shape
    if not isinstance(body, StraightBody):
        raise SolveError("a body made of parts is not a rod")
    lengths = np.array(body.segment_lengths())
    counts = np.maximum(
        np.round(elements * lengths / lengths.sum()).astype(np.int64), 2
    )  # of each segment, about so many in all
    of = np.repeat(np.arange(len(lengths)), counts)
    materials = [scene.materials[region.material_name] for region in body.regions()]
    G = np.array([material.shear_modulus for material in materials])
    K = G * [material.bulk_to_shear for material in materials]
    section = body.section(G, young_modulus(G, K), poisson_ratio(G, K))
    area = section.area
    density = np.array([material.density or 0.0 for material in materials])
    torque = scene.effects.magnetic_torque
    gravity = scene.effects.gravity
    if scene.effects.fluid is not None:  # what is displaced has no weight
        density = density - scene.effects.fluid.density
    magnetized = scene.region_remanence() * (0.0 if torque is None else area / MU0)
    length = (lengths / counts)[of]
    acceleration = np.zeros(3) if gravity is None else np.array(gravity.acceleration)
    mass = (density * area)[of] * length
    beyond = np.concatenate([np.cumsum(mass[::-1])[::-1], [0.0]])
    times = None if time is None else np.array([time])
    return RodModel(
        length=length,
        twist_bend=section.twist_bend[of],
        compliance=section.compliance[of] if extensible else np.zeros((len(of), 3)),
        moment=magnetized[of],
        weight=beyond[:, None] * acceleration,
        field=np.tile(fields.places(scene.field, times)[0]["uniform"], (len(of) + 1, 1)),
    )


def solve_rod(
    scene: Scene,
    elements: int = ROD_ELEMENTS,
    *,
    extensible: bool = True,
    time: float | None = None,
) -> RodShape:
    """Find the equilibrium of the scene's rod on the branch that grows from zero load.

    Field and weight grow together from zero. At every step, Newton's method with an energy line
    search finds a minimum. Where the continuation has become unstable, it goes down the direction
    of negative curvature.

    Parameters
    ----------
    scene : Scene
        The scene.
    elements : int, default ROD_ELEMENTS
        How many.
    extensible : bool, default True
        As of `rod_model`.
    time : float, s, optional
        As of `rod_model`.

    Returns
    -------
    RodShape
        The shape.

    Raises
    ------
    SolveError
        If a step does not converge.

    Examples
    --------
    >>> import magmpm
    >>> from magmpm.rod.cosserat import solve_rod
    >>> rod = solve_rod(magmpm.load_scene("data/scenes/axial_transverse.yaml"))
    >>> rod.position.shape, rod.stable  # m
    ((181, 3), True)
    """
    rod = rod_model(scene, elements, extensible=extensible, time=time)
    surroundings = (
        along_rod(scene, rod, time) if scene.field.varies and scene.effects.in_a_field else None
    )
    return solve_rod_model(rod, surroundings=surroundings)


def along_rod(scene: Scene, rod: RodModel, time: float | None) -> Surroundings:
    """Find field and pull of a field that varies in space, along the axis of a rod. They are taken as uniform within a section.

    Parameters
    ----------
    scene : Scene
        The scene.
    rod : RodModel
        Its rod.
    time : float, s, or None
        Of the field's schedule; None: its end.

    Returns
    -------
    Surroundings
        From positions (n + 1, 3) m and frames (n + 1, 3, 3) to the field at the frames (n + 1,
        3) T and the pull on the elements (n, 3) N.
    """
    source = scene.external_field()
    line = scene.body.shape.line
    assert line is not None  # only straight bodies are rods
    base = np.array(line.base)
    pulls = scene.effects.magnetic_force is not None

    def along(position: Array, frames: Array) -> tuple[Array, Array]:
        field = source.at(base + position, time)
        force = np.zeros((len(rod.length), 3))
        if pulls:
            gradient = source.gradient(base + position, time)
            for side in (slice(None, -1), slice(1, None)):
                moment = np.einsum("kij,kj->ki", frames[side], rod.moment)
                force += np.einsum("kji,kj->ki", gradient[side], moment) * rod.length[:, None] / 2
        return field, force

    return along


def solve_rod_model(
    rod: RodModel, loads: Array | None = None, *, surroundings: Surroundings | None = None
) -> RodShape:
    """Find the equilibrium of a rod.

    Parameters
    ----------
    rod : RodModel
        The rod.
    loads : array (k,), no unit, optional
        Load factors, of which the last one is that of the answer; equal steps unless given,
        more for a larger load.
    surroundings : Surroundings, optional
        As of `along_rod`, if field and pull depend on the shape. They are kept constant while
        the rod relaxes, then found again, until the shape converges to 1e-4 of the length.

    Returns
    -------
    RodShape
        The shape.

    Raises
    ------
    SolveError
        If a step does not converge.
    """
    if surroundings is not None:
        return _follow(rod, surroundings)
    quaternions = rod.straight()
    total = 0
    if loads is None:
        loads = np.linspace(0.0, 1.0, _steps(rod) + 1)[1:]
    for factor in loads:
        loaded = replace(rod, field=factor * rod.field, weight=factor * rod.weight)
        status, steps, energy, stable = loaded.relax(quaternions)
        total += steps
        if status != 0:
            raise SolveError(
                f"the rod found no equilibrium at {100 * factor:.0f} % of the load within {steps}"
                " steps"
            )
    return loaded.shape(quaternions, total, energy, stable)


def _follow(rod: RodModel, surroundings: Surroundings) -> RodShape:
    """Equilibrium with field and pull that depend on the shape: a fixed-point iteration at each load step."""
    start_accuracy = 1e-4  # of the length: accuracy that a start needs
    most_turns = 40  # iterations of a fixed point
    s = rod.places
    position = s[:, None] * np.array([1.0, 0.0, 0.0])
    field, force = surroundings(position, np.tile(np.eye(3), (len(s), 1, 1)))
    first = replace(rod, field=field, weight=rod.weight + _beyond(force))
    quaternions = rod.straight()
    total = 0
    loads = np.linspace(0.0, 1.0, max(_steps(first), 6) + 1)[
        1:
    ]  # load steps in a field that depends on the shape
    for factor in loads:
        for turn in range(most_turns):
            here = replace(rod, field=factor * field, weight=factor * (rod.weight + _beyond(force)))
            status, steps, energy, stable = here.relax(quaternions)
            total += steps
            found = here.shape(quaternions, total, energy, stable)
            if status != 0 or not np.isfinite(found.position).all():
                break
            new_field, new_force = surroundings(found.position, found.frames)
            share = (
                1.0 if turn < most_turns // 2 else 0.5
            )  # damp a rod that alternates between two sides
            field = field + share * (new_field - field)
            force = force + share * (new_force - force)
            moved = np.abs(found.position - position).max()
            position = found.position
            if moved < (start_accuracy if factor == 1.0 else 20 * start_accuracy) * s[-1]:
                break
        else:
            status = 1
        if status != 0:
            raise SolveError(
                f"the rod found no equilibrium at {100 * factor:.0f} % of the load in a field that"
                " varies"
            )
    return found


def _beyond(force: Array) -> Array:
    """Sum of the elements' forces (n, 3) beyond each frame, (n + 1, 3)."""
    return np.concatenate([np.cumsum(force[::-1], axis=0)[::-1], np.zeros((1, 3))])


def _steps(rod: RodModel) -> int:
    """Number of load steps: one for each unit of load over bending stiffness, B A Br L^2/(mu0 E I) + rho g A L^3/(E I), within 3 to 30."""
    total = rod.length.sum()
    bending = rod.twist_bend[:, 1].min()
    magnetic = (
        np.linalg.norm(rod.moment, axis=1).max()
        * np.linalg.norm(rod.field, axis=1).max()
        * total**2
    )
    load = (magnetic + np.linalg.norm(rod.weight[0]) * total**2) / bending
    return int(np.clip(np.ceil(load), 3, 30))
