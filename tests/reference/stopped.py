"""Paths and motions that end on their way."""

from pathlib import Path

import pytest

from magmpm.dynamics.quasi_static import PathState, follow
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.branch import EquilibriumPath, Jump


def switched_off(monkeypatch: pytest.MonkeyPatch, at: float) -> None:
    """Let every path fail at this time (s), in the midst of a step."""
    advance = EquilibriumPath.advance

    def stops(branch: EquilibriumPath, until: float) -> list[Jump]:
        jumps = advance(branch, min(until, at))
        if until > at:
            raise SolveError("switched off")
        return jumps

    monkeypatch.setattr(EquilibriumPath, "advance", stops)


def interrupted(scene: Scene, folder: Path, at: float) -> None:
    """Run a motion in a folder, and interrupt it after this time (s)."""

    def look(time: float, _: int) -> None:
        if time > at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        integrate(begin(build(scene)), folder=folder, on_progress=look)


def interrupted_path(scene: Scene, folder: Path, frame: int) -> None:
    """Follow a path in a folder, and interrupt it after this frame."""

    def look(state: PathState) -> None:
        if state.frame == frame:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        follow(scene, folder=folder, on_state=look)
