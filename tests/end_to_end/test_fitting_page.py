"""docs/fitting.md: its code runs, and finds what it says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_code_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks, one after the other; the interval holds the modulus that was hidden, and the refusal names what would tell."""
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "fitting.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 3
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/fitting.md", "exec"), names)
    constant = names["found"].constants[0]
    assert constant.low < 105e3 < constant.high
    assert constant.high - constant.low < 0.1 * 105e3
