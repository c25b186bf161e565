"""Loads that an equilibrium's scene does not name and that would move it: its weight, and the segments' field on each other.

One load vector and one substitution each with the factors that the solve leaves, so they cost next to nothing. To first order: a large
shift may be less, so no number is reported.
"""

from collections.abc import Iterator

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.base import MarkedParticles
from magmpm.effects.gravity import Gravity
from magmpm.effects.magnetic_interaction import LOAD_SIZE, MagneticInteraction
from magmpm.effects.magnetization import rotating
from magmpm.errors import InputError
from magmpm.kernels.equilibrium import grid_to_particles
from magmpm.scene import Scene
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy

SURE = 1.25  # times the error: what a shift to first order must be, to be reported
WORDS = {
    "gravity": "the body's weight",
    "magnetic_interaction": "the segments' field on each other",
}


def missed_loads(
    scene: Scene, energy: Energy | InteractingEnergy | None, point: Point
) -> list[str]:
    """Warn of loads that a scene does not name, and that would move its equilibrium by more than its error. energy: with its tangent's
    factors.
    """
    if scene.advice == "off" or energy is None:
        return []
    alone = energy.alone
    return [
        missed(scene, key)
        for key, P, f in _unnamed(scene, alone, point)
        if _moved(scene, alone, P, f) > SURE * scene.allowed_error
    ]


def missed(scene: Scene, key: str) -> str:
    """A warning of an effect that a scene does not name."""
    share = 100 * scene.allowed_error / scene.length
    return (
        f"effects: {key} is not named, and {WORDS[key]} may move the answer by more than "
        f"{share:.2g} % of its length; name it, or write `advice: off` to silence this warning "
        "(`magmpm effects` gives the amount)"
    )


def _unnamed(scene: Scene, energy: Energy, point: Point) -> Iterator[tuple[str, Array, Array]]:
    """Loads that the scene does not name: stress (n, 3, 3) Pa and force (n, 3) N/m^3 of each, by its effect's key."""
    model = energy.model
    named = scene.effects
    none = np.zeros((len(model.shear), 3, 3))
    if named.gravity is None and all(
        scene.materials[region.material_name].density is not None for region in scene.regions()
    ):
        yield "gravity", none, model.density[:, None] * np.array(Gravity().acceleration)
    if (
        named.magnetic_interaction is None
        and len(scene.magnetized_regions()) > 1
        and not rotating(scene).any()
        and not scene.body.shape.in_plane_strain
    ):
        try:
            block = MagneticInteraction().marks(model.particles, model.remanence[:, :3])
        except InputError:  # too many blocks
            return
        particles = model.particles
        of = block.astype(int)
        data = np.zeros(
            LOAD_SIZE * (of.max() + 2)
        )  # and a row of zeros at the end, of particles in no block
        marked = MarkedParticles(block, particles.segment, particles.volume, model.remanence)
        MagneticInteraction.refresh(data, marked, point.position, point.F)
        rows = data.reshape(-1, LOAD_SIZE)[of]
        yield "magnetic_interaction", -rows[:, :3, None] * model.remanence[:, None, :3], rows[:, 3:]


def _moved(scene: Scene, energy: Energy, P: Array, f: Array) -> float:
    """The farthest (m) that loads move a particle, about."""
    moved = float(np.linalg.norm(first_order(energy, P, f), axis=1).max())
    strip = scene.body.strip
    return (
        moved
        if strip is None or scene.body.shape.clamp != "both"
        else _stretched(moved, strip.thickness)
    )


def _stretched(shift: float, thickness: float) -> float:
    """The way (m) w that a strip held at both ends goes where it would go `shift` (m) if it did not stretch: w + 3/4 w^3/t^2 is the shift.

    By its first shape, w (1 - cos(2 pi x/L))/2, and the force that its longer axis needs (Timoshenko and Woinowsky-Krieger, Theory of
    Plates and Shells, 2nd ed., section 1.4); 1 and 2 % from whole runs at w = 1.5 and 8 t.
    """
    cubic = np.roots([0.75 / thickness**2, 0.0, 1.0, -shift])
    return float(cubic[np.argmin(np.abs(cubic.imag))].real)


def first_order(energy: Energy, P: Array, f: Array) -> Array:
    """Shift (particles, 3) m of an equilibrium by more stress P (n, 3, 3) Pa and force f (n, 3) N/m^3, to first order."""
    model = energy.model
    n = len(energy.model.shear)
    moved = energy.solve_columns(energy.each_scattered(-P[None], -f[None]))
    shift = np.empty((n, 3))
    F = np.empty((n, 3, 3))
    grid_to_particles(
        energy.cells, energy.particles, np.ascontiguousarray(moved[:, 0]), model.axes, shift, F
    )
    return shift
