"""Stress and energies of a motion's particles, for its frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm import effects
from magmpm.basis import Array
from magmpm.effects.hooks import add_energy, add_stress, has_hook
from magmpm.jit import kernel, prange
from magmpm.model import Model


def volume_change(model: Model, J: Array, averaged: bool) -> Array:
    """J - 1 (n,) as the volume part of the energy sees it: projected on the cells' modes where averaged (model.volume_modes)."""
    change = J - 1.0
    if not averaged or model.modes.shape[1] == 0:
        return change
    first = model.layout.cell_first
    moments = np.add.reduceat(model.modes * (model.particles.volume * change)[:, None], first[:-1], axis=0)
    return np.einsum("nk,nk->n", model.modes, np.repeat(moments, np.diff(first), axis=0))


def elastic_energy(model: Model, F: Array, averaged: bool) -> float:
    """Strain energy, J (materials). averaged: whether the formulation averages the volume part over cells."""
    J = np.linalg.det(F)
    change = volume_change(model, J, averaged)
    shape = 0.5 * model.shear * (J ** (-2.0 / 3.0) * np.einsum("nij,nij->n", F, F) - 3.0)
    return float(np.sum(model.particles.volume * (shape + 0.5 * model.bulk * change * (J - 1.0))))


def stress(model: Model, x: Array, F: Array, averaged: bool, named: tuple[Any, ...]) -> Array:
    """First Piola-Kirchhoff stress (n, 3, 3) Pa, with what the effects `named` add."""
    J = np.linalg.det(F)
    H = np.linalg.inv(F).transpose(0, 2, 1)
    g = model.shear * J ** (-2.0 / 3.0)
    pressure = model.bulk * volume_change(model, J, averaged)
    P = g[:, None, None] * F + (pressure * J - g * np.einsum("nij,nij->n", F, F) / 3.0)[:, None, None] * H
    if has_hook("stress", named):
        _add_stress(named, model.magnet, model.density, x, F, P)
    return P


def effect_energies(model: Model, x: Array, F: Array, time: float) -> dict[str, float]:
    """Potential energy of each named effect that has one, J."""
    found = {}
    for key, module in effects.every().items():
        if getattr(model.scene.effects, key) is None:
            continue
        named = module.of_scene(model.scene, 1.0, np.array([time]))
        if named and hasattr(module, "shared_energy"):
            found[key] = effects.shared_energy(named, model, x, F)
            continue
        if named and has_hook("energy", named):
            each = np.empty(len(x))
            _energies(named, model.magnet, model.density, x, F, each)
            found[key] = float(np.sum(each * model.particles.volume))
    return found


@kernel
def _add_stress(named, magnet, density, x, F, P):  # type: ignore[no-untyped-def]
    for p in prange(len(x)):
        add_stress(named, 0, magnet[p], density[p], x[p], F[p], P[p])


@kernel
def _energies(named, magnet, density, x, F, each):  # type: ignore[no-untyped-def]
    for p in prange(len(x)):
        each[p] = add_energy(named, 0, magnet[p], density[p], x[p], F[p])
