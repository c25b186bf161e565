"""A scene at hand: its numbers as sliders, and its shape as they move. `magmpm view` shows it."""

from magmpm.studies.explore.live.sliders import Control, changed, checked, controls, ready, saved
from magmpm.studies.explore.live.solver import (
    DeformedShape,
    Overtaken,
    Preview,
    SolverAnswer,
    SolverProcess,
)

__all__ = [
    "Control",
    "DeformedShape",
    "Overtaken",
    "Preview",
    "SolverAnswer",
    "SolverProcess",
    "changed",
    "checked",
    "controls",
    "ready",
    "saved",
]
