"""What can go wrong, and the exit status each kind ends a command with."""

from __future__ import annotations

from typing import Any

from magmpm.wording import report


class MagmpmError(Exception):
    """Base of every error magmpm raises on purpose."""

    exit_status = 1


class InputError(MagmpmError):
    """What the user wrote is wrong; the message names file, key, value, rule and remedy."""

    exit_status = 2


class NotThereYet(InputError):
    """A key, command or sampler of the published contract that this version does not have yet."""


class SceneError(InputError):
    """What a scene says under a key can't be had, which shows only once its body is built.

    key: its path (of several with ", " between, the first counts), which the message begins with, and to which commands add file, line
    and the words of the file (yamlfile.placed); received: the value, in SI; found: what is wrong with it.
    """

    def __init__(self, key: str, *, rule: str, remedy: str, received: str | None = None, found: str | None = None) -> None:
        super().__init__(self.text(key, received, found, rule, remedy))
        self.key, self.received, self.found, self.rule, self.remedy = key, received, found, rule, remedy

    @staticmethod
    def text(place: str, received: str | None, found: str | None, rule: str, remedy: str) -> str:
        """The message; place: the key, with file and line where they are known."""
        if found is None:
            return report(place, received=received, rule=rule, remedy=remedy)
        return report(f"{place}: {found}" if received is None else f"{place}: received {received}; {found}", rule=rule, remedy=remedy)


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
