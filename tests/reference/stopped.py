"""Paths that end on their way."""

import pytest

from magmpm.errors import SolveError
from magmpm.statics.branch import Branch, Jump


def switched_off(monkeypatch: pytest.MonkeyPatch, at: float) -> None:
    """Let every path fail at this time (s), in the midst of a step."""
    advance = Branch.advance

    def stops(branch: Branch, until: float) -> list[Jump]:
        jumps = advance(branch, min(until, at))
        if until > at:
            raise SolveError("switched off")
        return jumps

    monkeypatch.setattr(Branch, "advance", stops)
