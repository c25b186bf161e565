"""A scene at hand: its numbers as sliders, and its shape as they move. `magmpm view` shows it."""

from magmpm.studies.explore.live.changes import changed, ready, saved
from magmpm.studies.explore.live.preview import Preview, Shape
from magmpm.studies.explore.live.sliders import Control, checked, controls
from magmpm.studies.explore.live.solver import Overtaken, Solved, Solver

__all__ = ["Control", "Overtaken", "Preview", "Shape", "Solved", "Solver", "changed", "checked", "controls", "ready", "saved"]
