"""Control of the time step: as long as the present shape and motion of the body allow.

The bound at the start of a motion (stable_step) belongs to the undeformed body. Large strain makes silicone stiffer: as a particle is
crushed (J -> 0), its tangent grows without bound, as J^(-8/3). And a body released from a large strain moves by a good part of a cell
in one step, which the bound for small oscillations does not cover. So kernels check two things in every step (kernels.watch):

* the stiffness of the stiffest particle. If it exceeds the stiffness for which the step was chosen, the bound is found again for the
  present shape, and steps become shorter if they must;
* the change of stiffness in one step. If it exceeds CHANGE, steps are halved until they resolve the motion. They grow again as the
  motion calms down. The same holds for the change of F, averaged over the steps between two checks: silicone of K = 5 G keeps its stiffness
  while it swells from det F = 0.2 to 0.5.

A step given in the scene never changes. Where it is too long, the motion ends with a message.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.stable_step import StableStep, body_step, stiffness
from magmpm.dynamics.total_lagrangian import Kinematics, TotalMotion, take
from magmpm.dynamics.watchdog import Trouble
from magmpm.effects.base import Records
from magmpm.kernels.watch import BROKEN, GOING, HIGHEST, LIMIT, QUICK, QUICKEST, SHARE, STIFF, WHY
from magmpm.scene.options import DynamicOptions

CHANGE = 0.15  # of the largest stiffness: how much a particle's stiffness may change in one step
RESERVE = 0.95  # of the bound: a step above it asks for a new bound


class StepControl:
    """The time step of a motion, and when to change it.

    step s: longest next step; shortest s: shortest step so far; why: what shortened it last, in a few words, or "".
    """

    def __init__(self, motion: TotalMotion, stable: StableStep, options: DynamicOptions) -> None:
        self._motion, self._stable, self._options = motion, stable, options
        self._bound = stable.body
        self._stiffness = float(stiffness(motion.model, motion.particles()[2]).max())
        self._longest = options.time_step or options.safety * stable.largest
        self._halvings = 0
        self.step = self.shortest = self._longest
        self.why = ""
        self._F: Array | None = None  # at the last check
        self._set_watch()

    def state(self) -> dict[str, float | str]:
        """Plain numbers and text that `restore` needs."""
        return {
            "bound": self._bound, "stiffness": self._stiffness, "halvings": self._halvings, "step": self.step,
            "shortest": self.shortest, "why": self.why,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a `state`."""
        self._bound, self._stiffness, self._halvings = state["bound"], state["stiffness"], int(state["halvings"])
        self.step, self.shortest, self.why = state["step"], state["shortest"], state.get("why", "as before")
        self._F = None
        self._set_watch()

    def warnings(self) -> list[str]:
        """One sentence if steps had to be much shorter than at the start, else none."""
        if self.shortest > 0.5 * self._longest:
            return []
        return [f"steps were shortened from {self._longest:.3g} s to as little as {self.shortest:.3g} s: {self.why}"]

    def take(self, named: Records, steps: int, dt: float) -> tuple[int, Kinematics, Trouble | None]:
        """Take up to `steps` steps of dt (s), fewer if the next ones must be shorter.

        Returns the number taken, the kinematics after them, and what is wrong if the motion can't go on.
        """
        motion, watch = self._motion, self._motion.watch
        watch[QUICKEST] = 0.0
        kept = motion.kept()
        before = motion.particles()[2] if self._F is None else self._F
        taken, _ = take(motion, named, steps, dt)
        now = motion.kinematics() if watch[WHY] == GOING else None
        changed = 0.0 if now is None else float(np.abs(now.F - before).max()) / max(taken, 1)
        trouble = None
        if watch[WHY] in (QUICK, BROKEN) or changed > CHANGE:
            trouble = self._halve(changed)
            if trouble is None:  # the last step was too long, or all were: take it back
                taken = 0 if changed > CHANGE else max(taken - 1, 0)
                motion.rewind(kept)
                take(motion, named, taken, dt)
                now = None
        elif watch[WHY] == STIFF:
            trouble, now = self._find_bound(), None
        elif self._halvings and watch[QUICKEST] < 0.25 * CHANGE:  # calm: steps grow again
            self._halvings -= 1
            self._choose()
        now = now or motion.kinematics()
        self._F = now.F
        return taken, now, trouble

    def at_frame(self) -> None:
        """Find the bound again if the body is softer than when the steps were shortened."""
        highest = self._motion.watch[HIGHEST]
        if self._bound < self._stable.body and 0.0 < highest < 0.7 * self._stiffness:  # which shortened the steps
            self._find_bound()
        self._motion.watch[HIGHEST] = 0.0

    def _halve(self, changed: float) -> Trouble | None:
        """Halve the step as often as needed, from how far the last one was too long; changed: F in a step."""
        broke, given = self._motion.watch[WHY] == BROKEN, self._options.time_step is not None
        over = 16.0 if broke else max(self._motion.watch[QUICKEST], changed) / CHANGE
        halvings = self._halvings + min(max(1, math.ceil(math.log2(over))), 6)
        if given or 0.5**halvings < 1e-4:  # even a step of 1e-4 of the first one is too long
            return None if broke else self._trouble(f"the motion changes too much within {'a' if given else 'any'} step")
        self._halvings, self.why = halvings, "the body moves too quickly for longer ones"
        self._choose()
        return None

    def _find_bound(self) -> Trouble | None:
        """Find the bound for the present shape of the body."""
        self._bound = body_step(self._motion)
        self._stiffness = float(self._motion.watch[HIGHEST])
        largest = self._stable.largest_beside(self._bound)
        if self._options.time_step is not None and self.step > largest:
            return self._trouble(f"the body has become stiffer, and bears steps of {largest:.3g} s")
        if self.step > RESERVE * largest:
            self.why = "the body has become stiffer"
        self._choose()
        return None

    def _choose(self) -> None:
        """Choose the step from the present bound and number of halvings."""
        if self._options.time_step is None:
            largest = self._stable.largest_beside(self._bound)
            allowed = self._longest if self._longest <= RESERVE * largest else self._options.safety * largest
            self.step = min(allowed, self._longest / 2.0**self._halvings)
            self.shortest = min(self.shortest, self.step)
        self._set_watch()

    def _set_watch(self) -> None:
        reserve = RESERVE if self._options.time_step is None else 1.0
        self._motion.watch[LIMIT] = self._stiffness * max((reserve * self._bound / self.step) ** 2, 1.01)
        self._motion.watch[SHARE] = CHANGE

    def _trouble(self, cause: str) -> Trouble:
        stiffest = int(np.argmax(stiffness(self._motion.model, self._motion.particles()[2])))
        given = self._options.time_step is not None
        remedy = (
            "lower solver.dynamic.time_step, or leave it out: it is then chosen"
            if given
            else "apply the load more slowly (field.over_time, damping), or use more cells across"
        )
        return Trouble(cause, stiffest, remedy)
