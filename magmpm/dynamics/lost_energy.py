"""How much of a motion's energy the updated formulation loses: its particles hand their velocities to the grid and back in every step.

Each transfer smooths the velocities a little, so a motion fades without damping, the faster the shorter the step is: for a stiff short body
on two cells within a swing. Where the scene itself loses and gains no energy, the loss can be counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.energies import loads_conserve
from magmpm.effects.hooks import has_hook

TOLD = 0.1  # of the largest energy of motion and strain


@dataclass
class LostEnergy:
    """Sum of all energies at first, the least of it since, and the largest kinetic and elastic energy, J, at the frames of a motion."""

    first: float | None = None
    least: float = 0.0
    largest: float = 0.0

    def see(self, motion: Any, energies: dict[str, float]) -> None:
        """Count a frame. Only for a scene whose loads are constant, in the updated formulation, without what takes energy."""
        if not isinstance(motion, UpdatedMotion) or not closed(motion.model):
            return
        total = sum(energies.values())
        self.first = total if self.first is None else self.first
        self.least = min(self.least, total - self.first)
        self.largest = max(self.largest, energies["kinetic"] + energies["elastic"])

    def warnings(self) -> list[str]:
        """What a user must know."""
        if self.first is None or -self.least <= TOLD * self.largest:
            return []
        share = 100 * -self.least / self.largest
        return [
            f"energy: the updated formulation lost {share:.0f} % of the energy of the motion to its grid, as if it were damped; where "
            "parts do not touch, write solver.dynamic.formulation: total; else raise cells_across"
        ]

    def state(self) -> dict[str, float | None]:
        """What `restored` needs."""
        return {"energy_first": self.first, "energy_least": self.least, "energy_largest": self.largest}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> LostEnergy:
        """As it was; of a checkpoint from before, as if it began there."""
        return cls(state.get("energy_first"), state.get("energy_least", 0.0), state.get("energy_largest", 0.0))


def closed(model: Any) -> bool:
    """Whether no load gives or takes energy, and nothing else does: no damping, viscosity, contact or guide."""
    return loads_conserve(model) and model.scene.effects.self_contact is None and not has_hook("rate_stress", model.effects)
