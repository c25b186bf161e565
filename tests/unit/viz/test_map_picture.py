"""The picture of a map of tips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from magmpm.viz import tip_map


def test_the_color_bar_has_the_strengths_of_the_fields(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the weakest to the strongest, no color for what is not there."""
    bars: list[Any] = []
    whole = Figure.colorbar
    monkeypatch.setattr(Figure, "colorbar", lambda self, shown, **kind: bars.append(shown) or whole(self, shown, **kind))
    strengths = np.linspace(3e-3, 20e-3, 4)
    fields = np.kron(np.array([[0, 0, 1.0], [0, 0.6, 0.8], [0, 1.0, 0]]), strengths[:, None])
    tips = np.array([0.04, 0.0, 0.0]) + fields
    path = tip_map.draw(
        tmp_path / "map.svg", fields=fields, tips=tips, marks=np.full(12, "sure"), kind="rays", axes=(1, 2), shape=(3, 4), length=0.04,
        name="", words={},
    )  # fmt: skip
    assert bars[0].get_clim() == pytest.approx((3.0, 20.0))
    assert "strength of the field, mT" in path.read_text(encoding="utf-8"), "text as text"
