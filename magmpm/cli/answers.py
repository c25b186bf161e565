"""Functions shared by several commands: where results go, and how answers are printed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

SURFACE, PARTICLES = STYLES = ("surface", "particles")  # what a body at rest is drawn by


def results_folder(name: str) -> Path:
    """runs/NAME for a scene or study of that name."""
    return Path("runs") / name.replace(" ", "-")


def print_summary(options: argparse.Namespace, summary: dict[str, Any], text: str) -> None:
    """The one JSON object, or the text for people."""
    print(json.dumps(summary) if options.json else text)
