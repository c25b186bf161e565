"""Rendered pictures as files of papers."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magmpm.viz.picture_file import save_image


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_a_picture_is_in_its_file_without_loss(kind: str, tmp_path: Path) -> None:
    image = np.random.default_rng(1).integers(0, 256, (120, 200, 3), dtype=np.uint8)
    written = save_image(image, tmp_path / f"a/picture.{kind}").read_bytes()
    if kind == "svg":
        (coded,) = re.findall(rb"data:image/png;base64,\s*([^\"]+)", written)
        written = base64.b64decode(coded)
    assert (np.asarray(Image.open(io.BytesIO(written)).convert("RGB")) == image).all()


def test_the_same_picture_gives_the_same_page(tmp_path: Path) -> None:
    image = np.zeros((120, 200, 3), dtype=np.uint8)
    first, again = (save_image(image, tmp_path / f"{name}.pdf").read_bytes() for name in "ab")
    assert first == again
    assert first.startswith(b"%PDF-")
    assert b"/MediaBox [ 0 0 72 43.2 ]" in first  # 200 pixels to the inch of 72 points
