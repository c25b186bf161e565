"""A catheter that swings, as a scene file."""

from pathlib import Path

from reference.commands import scene_text


def text(dynamic: str | None = None, **more: str) -> str:
    """In motion with these settings of the solver, or at rest."""
    solver = {} if dynamic is None else {"solver": f"{{dynamic: {{{dynamic}}}}}"}
    return scene_text(
        "swing", length="16 mm", **{"field": "{uniform: [0 mT, 2 mT, 20 mT]}", **solver, **more}
    )


def scene(folder: Path, dynamic: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(text(dynamic), encoding="utf-8")
    return path
