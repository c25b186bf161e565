"""A scene at hand: its numbers as sliders, and its shape as they move. `magmpm view` shows it."""

from magmpm.studies.explore.live.sliders import Control, changed, checked, controls, ready, saved
from magmpm.studies.explore.live.solver import Overtaken, Preview, Shape, Solved, Solver

__all__ = [
    "Control",
    "Overtaken",
    "Preview",
    "Shape",
    "Solved",
    "Solver",
    "changed",
    "checked",
    "controls",
    "ready",
    "saved",
]
