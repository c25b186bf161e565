"""What can go wrong, and the exit status each kind ends a command with."""

from __future__ import annotations

from typing import Any


class MagmpmError(Exception):
    """Base of every error magmpm raises on purpose."""

    exit_status = 1


class InputError(MagmpmError):
    """What the user wrote is wrong; the message names file, key, value, rule and remedy."""

    exit_status = 2


class NotThereYet(InputError):
    """A key, command or sampler of the published contract that this version does not have yet."""


class SolveError(MagmpmError):
    """A run that ended unstable or unconverged.

    reason: what happened, in one sentence; state: the last good result, or None.
    """

    exit_status = 3

    def __init__(self, reason: str, state: Any = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.state = state


class BudgetError(SolveError):
    """A run that would outgrow the disk or memory it was told to keep to; everything up to then is saved and readable."""
