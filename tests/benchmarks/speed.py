"""Figures of daily use that `make claims` measures again: the map's, and how soon commands begin."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def mapped() -> dict[str, float]:
    """Seconds of a map of 1 000 fields, and Newton steps a field."""
    from magmpm.scene import load_scene
    from magmpm.studies.explore.live import ready
    from magmpm.studies.explore.tip_map import map_tips, on_rays

    found = map_tips(ready(load_scene(ROOT / "data/scenes/five_segments.yaml")), on_rays(1000, 20e-3))
    return {"steps": found.newton_steps / len(found.tip), "seconds": found.seconds}


def begins() -> dict[str, float]:
    """Seconds until the slowest command could begin its work."""
    import json

    import startup

    startup.REPEATS = 2  # a minute in place of two and a half
    startup.main()
    rows = json.loads((ROOT / "runs/bench/startup.json").read_text(encoding="utf-8"))
    return {"begun": max(row["wall_s"] for row in rows)}
