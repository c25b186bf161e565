"""What several commands share: where results go, and how they answer."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from magmpm.errors import SceneError

SURFACE, PARTICLES = STYLES = ("surface", "particles")  # what a body at rest is drawn by

def results_folder(name: str) -> Path:
    """runs/NAME for a scene or study of that name."""
    return Path("runs") / name.replace(" ", "-")


@contextmanager
def of_file(path: str) -> Iterator[None]:
    """What turns out to be wrong with a scene once it is built is told with its file and line, as what its loading finds."""
    try:
        yield
    except SceneError as error:
        from magmpm.inputs.yaml_document import placed

        raise placed(error, path) from None


def print_summary(options: argparse.Namespace, summary: dict[str, Any], text: str) -> None:
    """The one JSON object, or the text for people."""
    print(json.dumps(summary) if options.json else text)
