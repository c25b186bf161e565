"""Energy that a motion loses in the updated formulation: its particles hand their velocities to the grid and back in every step.

Each transfer smooths the velocities a little, so a motion fades without damping, the faster the shorter the step is: a stiff short body on
two cells fades within a swing. A transfer without forces shows what one step loses; it is tried once in every chunk of steps. What the
step's own impulse loses at once is not in it: half to nine tenths of the loss are counted (docs/stability.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from magmpm.dynamics.apic import UpdatedMotion

TOLD = 0.1  # of the energy of the motion
SWINGS = 0.25  # of the largest energy of motion and strain swings, where a load is put on at once: the rest only holds the load


@dataclass
class LostEnergy:
    """Energy lost to transfers so far, and in the last one tried; the largest kinetic energy, and sum of kinetic and elastic, of all
    frames; J."""

    lost: float = 0.0
    last: float = 0.0
    kinetic: float = 0.0
    largest: float = 0.0

    def passed(self, motion: Any, steps: int) -> None:
        """Count steps just taken: the mean of what transfers lose before and after them."""
        if isinstance(motion, UpdatedMotion):
            before, self.last = self.last, motion.lost_in_a_transfer()
            self.lost += steps * (before + self.last) / 2

    def see(self, energies: dict[str, float]) -> None:
        """Keep the largest energies of motion and strain, J."""
        self.kinetic = max(self.kinetic, energies["kinetic"])
        self.largest = max(self.largest, energies["kinetic"] + energies["elastic"])

    def warnings(self) -> list[str]:
        """Warn of energy lost to the grid."""
        swinging = max(self.kinetic, SWINGS * self.largest)
        if self.lost <= TOLD * swinging:
            return []
        share = 100 * self.lost / swinging
        return [
            f"energy: the updated formulation lost at least {share:.0f} % of the energy of the motion to its grid, as if it were damped; "
            "where parts do not touch, write solver.dynamic.formulation: total; else raise cells_across"
        ]

    def state(self) -> dict[str, float]:
        """Values that `restored` needs."""
        return {"energy_lost": self.lost, "energy_lost_last": self.last, "energy_kinetic": self.kinetic, "energy_largest": self.largest}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> LostEnergy:
        """Energies restored from a checkpoint; an older checkpoint has none of them, and they begin at zero there."""
        return cls(state.get("energy_lost", 0.0), *(state.get(f"energy_{name}", 0.0) for name in ("lost_last", "kinetic", "largest")))
