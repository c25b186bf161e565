"""Builds the page docs/gallery/accuracy.md: what accuracy costs for five kinds of scenes, with a table, a picture and conclusions each.

    python docs/gallery/accuracy.py [--fresh] [NAME ...]

Each scene is solved by `magmpm accuracy`; results go to runs/gallery/accuracy_NAME, pictures to docs/images/gallery. What was solved before
is not solved again, unless --fresh is given.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from build import poster

from magmpm.cli import main as magmpm

ROOT = Path(__file__).resolve().parents[2]
HEAD = """# What accuracy costs

Several scenes over ladders of cell sizes: `make gallery` solves them and writes this page, `magmpm accuracy SCENE` does the same for
any scene. Errors are the largest distance of the axis (of the gripper, of the centers of its parts) from the finest cells, or from a
reference where the scene names one; "at most" is a bound from the difference to the finest cells (`resolution: {error: ...}` has its
own pairs of cells, and witnesses between them). Seconds are of the machine that built this page, with two cores and kernels compiled.
"""


@dataclass(frozen=True)
class Shown:
    """A scene of the page: its file, the cells of its ladder, and what is to be seen."""

    name: str
    scene: str
    cells: str
    about: str


SHOWN = (
    Shown(
        "catheter",
        "data/scenes/three_segments_3d.yaml",
        "2,3,4,5,6,8",
        "An equilibrium, against finite elements.",
    ),
    Shown(
        "beam", "data/scenes/zhao_plane_strain.yaml", "2,3,4,6,8", "Zhao's beam in plane strain."
    ),
    Shown(
        "tentacle",
        "data/scenes/gallery/tentacle_spiral.yaml",
        "2,3,4",
        "A motion in a field that is switched on; its end.",
    ),
    Shown(
        "contact",
        "data/scenes/fed_into_vessel.yaml",
        "2,3,4",
        "A catheter that is pushed along a wall; its end.",
    ),
    Shown(
        "gripper",
        "data/scenes/gallery/gripper.yaml",
        "2,3",
        "STL parts that touch themselves and the ground; the end.",
    ),
)


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """The command. root: the repository, or a folder with the same layout. Returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names", metavar="NAME", nargs="*", help=f"of {', '.join(one.name for one in SHOWN)} [all]"
    )
    parser.add_argument("--fresh", action="store_true", help="solve all again")
    options = parser.parse_args(arguments)
    sections = []
    for one in SHOWN:
        folder = root / "runs/gallery" / f"accuracy_{one.name}"
        wanted = not options.names or one.name in options.names
        if wanted and (options.fresh or not (folder / "accuracy.json").exists()):
            status = magmpm(
                [
                    "accuracy",
                    str(root / one.scene),
                    "--cells",
                    one.cells,
                    "--out",
                    str(folder),
                    "--overwrite",
                ]
            )
            if (
                status and not (folder / "accuracy.json").exists()
            ):  # where one size alone was solved, the page says so
                return status
        if (folder / "accuracy.json").exists():
            sections.append(section(root, one, folder))
    page = root / "docs/gallery/accuracy.md"
    page.write_text("\n".join([HEAD, *sections]), encoding="utf-8")
    return 0


def section(root: Path, one: Shown, folder: Path) -> str:
    """The text of a scene, and its picture beside the page."""
    found: dict[str, Any] = json.loads((folder / "accuracy.json").read_text(encoding="utf-8"))
    lines = [
        f"## {found['scene'][:1].upper()}{found['scene'][1:]}",
        "",
        f"`{one.scene}`. {one.about}",
        "",
    ]
    if (folder / "accuracy.png").exists():
        image = root / "docs/images/gallery" / f"accuracy_{one.name}.png"
        image.parent.mkdir(parents=True, exist_ok=True)
        image.write_bytes(poster(folder / "accuracy.png"))
        lines += [f"![Error against seconds and cell size](../images/gallery/{image.name})", ""]
    lines += [
        "| cells across | particles | seconds | error to the finest | to the reference | at most |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for rung in found["rungs"]:
        shares = [percent(rung[key]) for key in ("error_finest", "error_reference", "bar")]
        lines.append(
            f"| {rung['cells_across']} | {rung['particles']} | {rung['seconds']:.3g} | {' | '.join(shares)} |"
        )
    beside = [
        f"{other['name']}: {other['seconds']:.2g} s, {percent(other['error_finest'])} from the finest"
        for other in found["beside"]
    ]
    said = [*beside, *found["conclusions"]]
    said += [
        f"{name} failed: {reason.partition('; remedy')[0].partition('; to try')[0]}."
        for name, reason in found["failed"].items()
    ]
    said += [
        f"Order of convergence to the {name}: not determined, {reason}."
        for name, reason in found["undetermined"].items()
    ]
    return "\n".join([*lines, "", *(f"- {line}" for line in said), ""])


def percent(share: float | None) -> str:
    """An error over the length, as text."""
    return "" if share is None else f"{100 * share:.3g} %"


if __name__ == "__main__":
    sys.exit(main())
