"""docs/sensitivities.md: its code runs, and its numbers are what it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_code_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks, one after the other, as a reader would type them; the two tips are each other's mirror."""
    monkeypatch.chdir(ROOT)
    text = (ROOT / "docs" / "sensitivities.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, "docs/sensitivities.md", "exec"), names)
    up, down = names["up"], names["down"]
    assert abs(up.tip[2]) > 5e-3
    np.testing.assert_allclose(down.tip, up.tip * [1, 1, -1], atol=1e-6 * 40e-3)
    assert np.linalg.norm(names["scatter"]) > 1e-4
