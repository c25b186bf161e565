"""Hard cases: their definition, and the outcome of a run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

from magmpm.errors import SolveError
from magmpm.scene import Scene


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

    def run(self) -> Outcome:
        """Measure it. A failed run counts as infinite, with its reason."""
        begun, reason = perf_counter(), ""
        try:
            value = float(self.measure(self.scene()))
        except SolveError as error:
            value, reason = math.inf, error.reason
        return self.outcome(value, reason, perf_counter() - begun)

    def outcome(self, value: float, reason: str, seconds: float) -> Outcome:
        """Outcome of a measure, or of the reason why there is none."""
        passed = value <= self.bound
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

    def summary(self) -> dict[str, Any]:
        """Plain data; a measure that is not finite is None."""
        return {**asdict(self), "measure": self.measure if math.isfinite(self.measure) else None}


def table(outcomes: list[Outcome]) -> str:
    """The outcomes as text."""
    lines = [f"{'case':<36} {'measure':>9} {'bound':>9}  {'':<6} {'seconds':>7}  what is measured"]
    for o in outcomes:
        word = "ok" if o.passed else "FAILED"
        lines.append(f"{o.name:<36} {o.measure:9.2e} {o.bound:9.2e}  {word:<6} {o.seconds:7.1f}  {o.quantity}")
        if not o.passed:
            lines.append(f"    a weak code: {o.weak}" + (f"; here: {o.reason}" if o.reason else ""))
    return "\n".join(lines)
