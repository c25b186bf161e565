"""Stress and energies of a motion's particles, for its frames."""

from typing import Any, NamedTuple

import numpy as np

from magmpm import materials
from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.compiled.jit import compiled
from magmpm.effects import acting, viscosity
from magmpm.effects.base import BodyEffect, Contact, Records
from magmpm.effects.calls import rows
from magmpm.effects.contact_law import most_friction, obstacle_contacts, springs
from magmpm.effects.hooks import has_hook, pairs
from magmpm.kernels.changes import loads, potentials
from magmpm.model import Model


def volume_change(model: Model, J: Array) -> Array:
    """J - 1 (n,) as it enters the volume part of the energy: with F-bar projected on the modes of the cells (model.volume_modes)."""
    change = J - 1.0
    if model.modes.shape[1] == 0:
        return change
    first = model.particles.cell_first
    moments = np.add.reduceat(
        model.modes * (model.particles.volume * change)[:, None], first[:-1], axis=0
    )
    return np.einsum("nk,nk->n", model.modes, np.repeat(moments, np.diff(first), axis=0))


def elastic(model: Model, F: Array) -> tuple[float, Array]:
    """Strain energy, J, and first Piola-Kirchhoff stress (n, 3, 3) Pa (materials)."""
    J = np.empty(len(F))
    P = np.empty_like(F)
    _determinants(F, J)
    change = volume_change(model, J)
    energy = _elastic(F, J, change, model.shear, model.bulk, model.particles.volume, P)
    return float(energy), P


def elastic_energy(model: Model, F: Array) -> float:
    """Strain energy alone, J."""
    return elastic(model, F)[0]


def add_effects_stress(model: Model, x: Array, F: Array, named: tuple[Any, ...], P: Array) -> None:
    """Add the stress of the effects `named` to P (n, 3, 3) Pa."""
    if has_hook("stress", named):
        force = np.zeros((len(x), 3))  # nobody adds to it
        loads(rows(named, "load"), model.remanence, model.density, x, F, P, force)


def effect_energies(model: Model, x: Array, F: Array, time: float) -> NamedNumbers:
    """Potential energy of each named effect that has one, J."""
    found = {}
    for key, effect in model.scene.effects.named().items():
        named = effect.records(model.scene, 1.0, np.array([time]))
        if named and isinstance(effect, BodyEffect):
            found[key] = acting.shared_energy(named, model, x, F)
        elif named and has_hook("energy", named):
            each = np.zeros(len(x))
            potentials(rows(named, "energy"), model.remanence, model.density, x, F, each)
            found[key] = float(np.sum(each * model.particles.volume))
    return found


def loads_conserve(model: Model) -> bool:
    """True if no load can add energy: loads are constant, no guide feeds the body, and what holds it does not move.

    Contact and damping only take. Loads of the body on itself have an energy (dynamics.own_loads).
    """
    named = model.scene.effects
    if model.scene.move or named.feed is not None or named.fluid is not None:
        return False
    if model.scene.field.varies and (named.magnetic_torque is None) != (
        named.magnetic_force is None
    ):
        return False  # one without the other has no energy
    records = [
        record for record, _ in pairs(acting.collect(model.scene, times=np.array([0.0, 1.0])))
    ]
    return all(len(record) == 1 for record in records)


def loses(model: Model) -> bool:
    """True if something takes energy: damping, viscosity, or friction."""
    named = model.scene.effects
    touching = (named.ground, named.walls, named.self_contact)
    rubs = any(
        effect is not None and most_friction(model.scene, effect.friction) > 0
        for effect in touching
    )
    return rubs or acting.loses(model.scene)


class MeasuredState(NamedTuple):
    """Stress P (n, 3, 3) Pa, energies (J) and contacts by name, at one time."""

    P: Array
    energies: NamedNumbers
    contacts: dict[str, Contact]


def measure(motion: Any, named: Records, now: Any, time: float) -> MeasuredState:
    """Stress, energies and contacts of a TotalMotion with the kinematics `now`, at a time (s); named: its effects then,
    with tables of the present shape."""
    model = motion.model
    with motion.threads.alone():
        strain, P = elastic(model, now.F)
        add_effects_stress(model, now.x, now.F, named, P)
        potentials = effect_energies(model, now.x, now.F, time)
        losses = model.scene.effects.viscosity
        branches = () if losses is None else losses.relaxing(model.scene)
        if branches:
            W, more = viscosity.stored(branches, now.F, motion.remembered(), motion.lag)
            P = P + more
            potentials["viscosity"] = float(W @ model.particles.volume)
    surface = model.surface
    point = motion.packed.point
    particle = point if surface is None else surface.particle[point]
    parts = model.particles.segment[particle]
    contacts = obstacle_contacts(model, motion.touching_points(), parts)
    contacts |= motion.body_contacts()
    stored = {**potentials, **springs(contacts)}
    return MeasuredState(P, {"kinetic": now.kinetic, "elastic": strain, **stored}, contacts)


@compiled
def _determinants(F, J):  # type: ignore[no-untyped-def]
    for p in range(len(F)):
        J[p] = materials.determinant(F[p])


@compiled
def _elastic(F, J, change, shear, bulk, volume, P):  # type: ignore[no-untyped-def]
    """Energy of all particles, J, and the stress of each into P; change (n,): J - 1 as it enters the volume part."""
    cof = np.empty((3, 3))
    total = 0.0
    for p in range(len(F)):
        materials.cofactor(F[p], cof)
        materials.stress(F[p], cof, J[p], shear[p], bulk[p] * change[p], P[p])
        total += volume[p] * (
            materials.shape_energy(F[p], J[p], shear[p]) + 0.5 * bulk[p] * change[p] * (J[p] - 1.0)
        )
    return total
