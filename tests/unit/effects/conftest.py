"""Effects that a test registers, and that no other test sees."""

import pytest

from magmpm.effects import hooks


@pytest.fixture
def own_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget what a test registers."""
    monkeypatch.setattr(
        hooks, "_registry", {hook: dict(table) for hook, table in hooks._registry.items()}
    )
