"""docs/fitting.md and docs/sensitivities.md: their code runs, and finds what they say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


def names_of(page: str, count: int) -> dict[str, Any]:
    """Names that all blocks of a page, one after the other as a reader would type them, have made."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == count
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


@pytest.mark.slow
def test_fitting(monkeypatch: pytest.MonkeyPatch) -> None:
    """The interval holds the modulus that was hidden, and the refusal names what would tell."""
    monkeypatch.chdir(ROOT)
    constant = names_of("fitting.md", 2)["found"].constants[0]
    assert constant.low < 105e3 < constant.high
    assert constant.high - constant.low < 0.1 * 105e3


def test_sensitivities(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two tips are each other's mirror."""
    monkeypatch.chdir(ROOT)
    names = names_of("sensitivities.md", 3)
    up, down = names["up"], names["down"]
    assert abs(up.tip[2]) > 5e-3
    np.testing.assert_allclose(down.tip, up.tip * [1, 1, -1], atol=1e-6 * 40e-3)
    assert np.linalg.norm(names["scatter"]) > 1e-4
