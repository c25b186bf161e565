"""How much of a motion's energy the updated formulation loses: its particles hand their velocities to the grid and back in every step.

Each transfer smooths the velocities a little, so a motion fades without damping, the faster the shorter the step is: a stiff short body on
two cells fades within a swing. A transfer without forces shows what one step loses; it is tried once in every chunk of steps. What the
step's own impulse loses at once is not in it: two thirds to four fifths of the loss are counted (docs/stability.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from magmpm.dynamics.apic import UpdatedMotion

TOLD = 0.1  # of the largest energy of motion and strain


@dataclass
class LostEnergy:
    """What transfers have lost so far, what the last one tried lost, and the largest kinetic and elastic energy of all frames, J."""

    lost: float = 0.0
    last: float = 0.0
    largest: float = 0.0

    def passed(self, motion: Any, steps: int) -> None:
        """Count steps just taken: the mean of what transfers lose before and after them."""
        if isinstance(motion, UpdatedMotion):
            before, self.last = self.last, motion.lost_in_a_transfer()
            self.lost += steps * (before + self.last) / 2

    def see(self, energies: dict[str, float]) -> None:
        """Keep the largest energy of motion and strain, J."""
        self.largest = max(self.largest, energies["kinetic"] + energies["elastic"])

    def warnings(self) -> list[str]:
        """What a user must know."""
        if self.lost <= TOLD * self.largest:
            return []
        share = 100 * self.lost / self.largest
        return [
            f"energy: the updated formulation lost at least {share:.0f} % of the energy of the motion to its grid, as if it were damped; "
            "where parts do not touch, write solver.dynamic.formulation: total; else raise cells_across"
        ]

    def state(self) -> dict[str, float]:
        """What `restored` needs."""
        return {"energy_lost": self.lost, "energy_lost_last": self.last, "energy_largest": self.largest}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> LostEnergy:
        """As it was; of a checkpoint from before, as if it began there."""
        return cls(state.get("energy_lost", 0.0), state.get("energy_lost_last", 0.0), state.get("energy_largest", 0.0))
