"""Hard cases: their definition, and the outcome of a run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from magmpm.compiled.arrays import Plain
from magmpm.errors import SolveError
from magmpm.scene import Scene


@dataclass(frozen=True)
class Case:
    """A scene at the edge of what the solvers can do, and one number that tells whether it went well.

    Attributes
    ----------
    name : str
        Of the case.
    scene : callable
        Makes its scene.
    weak : str
        What a weak code does there.
    quantity : str
        What `measure` returns, in words, with its unit.
    measure : callable
        Runs the scene and returns the number.
    bound : float
        What the number must be at most, in the same unit.
    source : str
        Of the bound, or of the exact answer.
    slow : bool
        Whether it takes longer than a few seconds.
    """

    name: str
    scene: Callable[[], Scene]
    weak: str
    quantity: str
    measure: Callable[[Scene], float]
    bound: float
    source: str
    slow: bool = False

    def run(self) -> tuple[float, float, str]:
        """Run the case.

        Returns
        -------
        measure : float
            The number; infinite if the run failed.
        seconds : float, s
            How long it took.
        reason : str
            Why the run failed; empty if it did not.
        """
        begun = perf_counter()
        reason = ""
        try:
            value = float(self.measure(self.scene()))
        except SolveError as error:
            value = math.inf
            reason = error.reason
        return value, perf_counter() - begun, reason


@dataclass(frozen=True)
class CaseOutcome:
    """A case that was run.

    Attributes
    ----------
    case : Case
        The case.
    measure : float
        Its number, in the unit that the case names.
    seconds : float, s
        How long it took.
    reason : str
        Why the run failed; empty if it did not.
    """

    case: Case
    measure: float
    seconds: float
    reason: str

    @property
    def passed(self) -> bool:
        """True if the measure is within its bound."""
        return self.measure <= self.case.bound

    def summary(self) -> Plain:
        """Write the outcome as plain data; a measure that is not finite is None.

        Returns
        -------
        dict[str, Any]
            Values by name.
        """
        about = {
            key: getattr(self.case, key) for key in ("name", "weak", "quantity", "bound", "source")
        }
        measure = self.measure if math.isfinite(self.measure) else None
        return {
            **about,
            "measure": measure,
            "seconds": self.seconds,
            "passed": self.passed,
            "reason": self.reason,
        }


def table(outcomes: list[CaseOutcome]) -> str:
    """Write outcomes as text.

    Parameters
    ----------
    outcomes : list of CaseOutcome
        The outcomes.

    Returns
    -------
    str
        A line for each.
    """
    lines = [f"{'case':<36} {'measure':>9} {'bound':>9}  {'':<6} {'seconds':>7}  what is measured"]
    for o in outcomes:
        word = "ok" if o.passed else "FAILED"
        lines.append(
            f"{o.case.name:<36} {o.measure:9.2e} {o.case.bound:9.2e}  {word:<6} {o.seconds:7.1f} "
            f" {o.case.quantity}"
        )
        if not o.passed:
            lines.append(
                f"    a weak code: {o.case.weak}" + (f"; here: {o.reason}" if o.reason else "")
            )
    return "\n".join(lines)
