"""What a hard case is, and what running it gives."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any

from magmpm.errors import SolveError
from magmpm.scene import Scene


@dataclass(frozen=True)
class Control:
    """A remedy that is switched off: what it is, a context that does it, and a change of the scene; either may be nothing."""

    remedy: str
    off: Callable[[], AbstractContextManager[None]] = nullcontext
    scene: Callable[[Scene], Scene] = lambda scene: scene


@dataclass(frozen=True)
class Case:
    """A scene at the edge of what the solvers can do, and one number that tells whether it went well.

    weak: what a weak code does there; quantity: what `measure(scene)` returns, with its unit; it must be at most `bound`;
    source: of the bound or of the exact answer; slow: takes longer than a few seconds.
    """

    name: str
    scene: Callable[[], Scene]
    weak: str
    quantity: str
    measure: Callable[[Scene], float]
    bound: float
    source: str
    slow: bool = False
    control: Control | None = None

    def run(self) -> Outcome:
        """Measure it. A failed run counts as infinite, with its reason."""
        begun, reason = perf_counter(), ""
        try:
            value = float(self.measure(self.scene()))
        except SolveError as error:
            value, reason = math.inf, error.reason
        return self._outcome(value, reason, begun)

    def run_control(self) -> Outcome:
        """Measure it with its remedy switched off. What a crippled solver raises counts as infinite, but no InputError."""
        assert self.control is not None
        begun, reason = perf_counter(), ""
        try:
            with self.control.off():
                value = float(self.measure(self.control.scene(self.scene())))
        except (SolveError, ArithmeticError, ValueError, IndexError) as error:
            value, reason = math.inf, str(error)
        found = self._outcome(value, reason, begun)
        return replace(found, name=f"{self.name}, without", control=self.control.remedy)

    def _outcome(self, value: float, reason: str, begun: float) -> Outcome:
        passed, seconds = value <= self.bound, perf_counter() - begun
        return Outcome(self.name, self.weak, self.quantity, value, self.bound, passed, seconds, self.source, reason)


@dataclass(frozen=True)
class Outcome:
    """A case that was run. measure and bound in the unit of `quantity`; reason: why the run failed, if it did."""

    name: str
    weak: str
    quantity: str
    measure: float
    bound: float
    passed: bool
    seconds: float
    source: str
    reason: str
    control: str = ""  # the remedy that was switched off

    def summary(self) -> dict[str, Any]:
        """Plain data; a measure that is not finite is None."""
        return {**asdict(self), "measure": self.measure if math.isfinite(self.measure) else None}


def controls_table(outcomes: list[Outcome]) -> str:
    """The outcomes of controls as text."""
    lines = [f"{'case':<44} {'without':>10} {'bound':>9}  {'':<20} {'seconds':>7}  switched off"]
    for o in outcomes:
        word = "PASSED ALL THE SAME" if o.passed else "fails, as it should"
        lines.append(f"{o.name.removesuffix(', without'):<44} {o.measure:10.2e} {o.bound:9.2e}  {word:<20} {o.seconds:7.1f}  {o.control}")
    return "\n".join(lines)


def table(outcomes: list[Outcome]) -> str:
    """The outcomes as text."""
    lines = [f"{'case':<36} {'measure':>9} {'bound':>9}  {'':<6} {'seconds':>7}  what is measured"]
    for o in outcomes:
        word = "ok" if o.passed else "FAILED"
        lines.append(f"{o.name:<36} {o.measure:9.2e} {o.bound:9.2e}  {word:<6} {o.seconds:7.1f}  {o.quantity}")
        if not o.passed:
            lines.append(f"    a weak code: {o.weak}" + (f"; here: {o.reason}" if o.reason else ""))
    return "\n".join(lines)
