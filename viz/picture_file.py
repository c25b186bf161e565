"""A rendered picture as a file: PNG, or an image on the page of an SVG or PDF file, which papers take beside plots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from magmpm.results.whole_file import whole_file


def save_image(image: np.ndarray, path: str | Path, **png: Any) -> Path:
    """Write a picture (h, w, 3) uint8 as its path's ending says, without loss; its folder is made. png: Pillow's options."""
    pixels_per_inch = 200
    path = Path(path)
    if path.suffix in (".svg", ".pdf"):
        from matplotlib.figure import Figure  # 0.3 s and 30 MB: PNG does without

        from magmpm.viz.plots import saved

        height, width = image.shape[:2]
        figure = Figure(figsize=(width / pixels_per_inch, height / pixels_per_inch))
        page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        page.set_axis_off()
        page.imshow(
            image, interpolation="none", aspect="auto"
        )  # "none": the file gets the pixels as they are
        return saved(figure, path)
    from PIL import Image  # stays out of those who only ask for pictures

    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        Image.fromarray(image).save(unfinished, format="PNG", **png)
    return path
