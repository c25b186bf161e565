"""A broken scene file: a good scene with an edit that breaks it, or another file instead, and the message that is required.

`write(case, folder)` writes the file; `expected(case, path)` lists the phrases that its message must contain.
"""

from dataclasses import dataclass
from pathlib import Path

GOOD = """\
name: probe
materials:
  magnetic silicone:
    model: neo-hookean
    shear_modulus: 120 kPa
    bulk_to_shear: 20
    density: 1882 kg/m^3
    remanence: 138 mT
  plain silicone: {shear_modulus: 60 kPa, bulk_to_shear: 20, density: 1070 kg/m^3}
body:
  catheter:
    length: 40 mm
    diameter: 4 mm
    inner_diameter: 1 mm
    material: magnetic silicone
    clamp: base
    segments:
      - {magnetization: [1, 0, 0], length: 15 mm}
      - {material: plain silicone, length: 5 mm}
      - magnetization: {azimuth: 30 deg, elevation: 10 deg}
field:
  uniform: [0 mT, 6 mT, 8 mT]
effects:
  magnetic_torque: {}
  gravity: {}
solver:
  static: {tolerance: 1e-9, max_steps: 60}
resolution: {cells_across: 4, particles_per_cell: 2}
"""
GRAVITY = "  gravity: {}\n"  # where cases insert effects of motion


@dataclass(frozen=True)
class BadScene:
    """One way to get a scene file wrong.

    name: identifies the case; edits: (old, new) replacements in GOOD, each of which must apply exactly once; content:
    the whole file instead, None for no file, "folder" for a folder; key: the key path in the message; received: the
    value in the message; says: phrases of rule and remedy; line: the reported line, by
    default that of the first edit; table: content of shape.csv beside the scene.
    """

    name: str
    edits: tuple[tuple[str, str], ...] = ()
    key: str = ""
    received: str = ""
    says: tuple[str, ...] = ()
    content: bytes | None = b""
    folder: bool = False
    line: int | None = None
    table: str | None = None


def edit(
    name: str, old: str, new: str, key: str, received: str, *says: str, **more: object
) -> BadScene:
    """A case that replaces one piece of text of GOOD."""
    return BadScene(name, ((old, new),), key, received, says, **more)  # type: ignore[arg-type]


def whole(name: str, content: bytes | None, *says: str, **more: object) -> BadScene:
    """A case that replaces the whole file."""
    return BadScene(name, says=says, content=content, **more)  # type: ignore[arg-type]


def effect(
    name: str, settings: str, key: str, received: str, *says: str, **more: object
) -> BadScene:
    """A case that names an effect of motion, with settings on its line."""
    return edit(name, GRAVITY, f"  {settings}\n", f"effects.{key}", received, *says, **more)


def field(
    name: str,
    settings: str,
    key: str,
    received: str,
    *says: str,
    force: bool = True,
    **more: object,
) -> BadScene:
    """A scene in this field, by default with magnetic_force."""
    edits = [
        (
            "  uniform: [0 mT, 6 mT, 8 mT]\n",
            "".join(f"  {line}\n" for line in settings.splitlines()),
        )
    ]
    if force:
        edits.append(("  gravity: {}", "  gravity: {}\n  magnetic_force: {}"))
    line = 22 if "\n" not in settings else 23  # the error is last
    return BadScene(name, tuple(edits), key, received, says, **{"line": line, **more})  # type: ignore[arg-type]


def motion(name: str, settings: str, key: str, received: str, *says: str) -> BadScene:
    """A scene whose dynamic solver has these settings."""
    return edit(
        name,
        "  static: {tolerance: 1e-9, max_steps: 60}",
        f"  dynamic: {{{settings}}}",
        f"solver.dynamic.{key}",
        received,
        *says,
    )


def text_of(case: BadScene) -> str:
    """GOOD with the case's edits."""
    text = GOOD
    for old, new in case.edits:
        if text.count(old) != 1:
            raise ValueError(
                f"{case.name}: {old!r} stands {text.count(old)} times in the good scene"
            )
        text = text.replace(old, new)
    return text


def write(case: BadScene, folder: Path) -> Path:
    """Writes the broken scene in the folder; returns the path for `load_scene` or `magmpm run`."""
    path = folder / "probe.yaml"
    if case.table is not None:
        (folder / "shape.csv").write_text(case.table)
    if case.folder:
        path.mkdir()
    elif case.edits:
        path.write_text(text_of(case))
    elif case.content is not None:
        path.write_bytes(case.content)
    return path


def expected(case: BadScene, path: Path) -> list[str]:
    """Phrases that the message must contain: file and line, key path, received value, rule and remedy."""
    phrases = [str(path), *case.says]
    if case.edits:
        line = case.line or 1 + GOOD[: GOOD.index(case.edits[0][0])].count("\n") + _lines_kept(
            *case.edits[0]
        )
        place = f"{path}:{line}: {case.key}: " if case.key else f"{path}:{line}: "
        phrases.append(f"{place}received {case.received}")
    return phrases


def _lines_kept(old: str, new: str) -> int:
    """Number of line breaks at the start of an edit, before the changed text."""
    same = next((n for n, (a, b) in enumerate(zip(old, new)) if a != b), min(len(old), len(new)))
    return new[:same].count("\n")
