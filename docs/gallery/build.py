"""Builds the gallery: runs the scenes of data/scenes/gallery, draws them, and updates the pictures and numbers on the pages.

    python docs/gallery/build.py [--fresh] [NAME ...]

Results and movies go to runs/gallery/NAME. A poster of less than 300 kB goes to docs/images/gallery/NAME.png, and the movie beside it if it
is smaller than 1 MiB. If the page docs/gallery/NAME.md is missing, it is written, with the leading comment of the scene as its text. On an
existing page, only the text between the marks `<!-- measured -->` and `<!-- /measured -->` is replaced. A scene is not run again if its
results belong to exactly this scene, unless --fresh is given.

MOMENTS names the moments that a poster shows, for scenes where the default (the first, the last, and the one that differs most from both)
is not the best choice. BESIDE names scenes that are shown on the page of another scene.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from magmpm.cli import main as magmpm
from magmpm.errors import InputError
from magmpm.results.trajectory import Motion
from magmpm.scene import load_scene
from magmpm.viz import style
from magmpm.viz.camera import Framing
from magmpm.viz.figure_panels import composed, figure
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.movies import MOST_FRAMES_SHOWN, chosen, frames_movie
from magmpm.viz.picture_file import save_image
from magmpm.viz.worker import Renderer

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
POSTER_BYTES = 300_000
MOVIE_BYTES = 1024 * 1024
MOMENTS = {  # s
    "catheter_swing": (0.0, 0.03, 0.088),
    "folding_strip": (0.0, 0.07, 0.2),
    "gripper": (0.0, 0.1, 0.26),
    "zhao_beam": (0.4, 0.7, 1.05),
}
BESIDE = {"zhao_beam": ("zhao_beam_5mm",)}
BEGIN = "<!-- measured -->"
END = "<!-- /measured -->"


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """The command. root: the repository, or a folder with the same layout. Returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", metavar="NAME", nargs="*", help="scenes, without .yaml [all]")
    parser.add_argument(
        "--fresh", action="store_true", help="run all scenes again, also those with results"
    )
    options = parser.parse_args(arguments)
    scenes = {path.stem: path for path in sorted((root / "data/scenes/gallery").glob("*.yaml"))}
    unknown = [name for name in options.names if name not in scenes]
    if unknown:
        print(f"no such scene: {unknown[0]}; there are {', '.join(scenes)}", file=sys.stderr)
        return 2
    page_of = {other: name for name, others in BESIDE.items() for other in others if name in scenes}
    worst = 0
    for name in dict.fromkeys(page_of.get(name, name) for name in options.names or scenes):
        status = build(
            root, name, [scenes[key] for key in (name, *BESIDE.get(name, ()))], fresh=options.fresh
        )
        worst = max(worst, status)
    write_index(root, {name: scene for name, scene in scenes.items() if name not in page_of})
    return worst


def build(root: Path, name: str, scenes: Sequence[Path], *, fresh: bool = False) -> int:
    """Run and draw the scenes of a page, and update the page. Returns the exit status of the step that failed, or 0."""
    folders = [root / "runs/gallery" / scene.stem for scene in scenes]
    for scene, results in zip(scenes, folders):
        if fresh or not is_result_of(scene, results):
            status = magmpm(["run", str(scene), "--out", str(results)])
            if status:
                return status
        status = magmpm(["render", str(results)])
        if status:
            return status
    draw_moments(name, folders)
    images = root / "docs/images/gallery"
    images.mkdir(parents=True, exist_ok=True)
    moments = folders[0] / "moments.png"
    movie = folders[0] / "movie.mp4"
    (images / f"{name}.png").write_bytes(
        poster(moments if moments.exists() else folders[0] / "picture.png")
    )
    on_page = images / f"{name}.mp4"
    on_page.unlink(missing_ok=True)
    if movie.exists() and movie.stat().st_size < MOVIE_BYTES:
        shutil.copyfile(movie, on_page)
    write_page(root, name, scenes[0], folders)
    return 0


def draw_moments(name: str, folders: Sequence[Path]) -> None:
    """Draw the moments of MOMENTS instead of those that `magmpm render` chose; scenes of BESIDE one below another, with a common movie."""
    if name not in MOMENTS and len(folders) == 1:
        return
    motions = [MotionRenderer(Motion.load(folder)) for folder in folders]
    numbers = [
        [shown.motion.nearest(t) for t in MOMENTS.get(name, shown.motion.times[[0, -1]])]
        for shown in motions
    ]
    with Renderer() as renderer:
        if len(motions) == 1:
            figure(motions[0], folders[0] / "moments.png", renderer, numbers[0])
            return
        words = measures().words
        moments = [(shown, k) for shown, some in zip(motions, numbers) for k in some]
        image = composed(
            moments,
            renderer,
            len(numbers[0]),
            1800,
            [words(shown.motion, k) for shown, k in moments],
        )
        save_image(image, folders[0] / "moments.png", optimize=True)
        framing = Framing.of_all([motion.framing for motion in motions])

        def side_by_side(k: int) -> np.ndarray:
            shown = [(motion, k) for motion in motions]
            texts = [words(motion.motion, k) for motion in motions]
            return composed(shown, renderer, len(motions), style.MOVIE_SIZE[0], texts, framing)

        frames = chosen(min(len(motion) for motion in motions), MOST_FRAMES_SHOWN)
        frames_movie(folders[0] / "movie.mp4", side_by_side, frames)


def is_result_of(scene: Path, results: Path) -> bool:
    """Whether a folder holds the finished result of exactly this scene."""
    try:
        saved = json.loads((results / "result.json").read_text(encoding="utf-8"))
        now = load_scene(scene).hash()
    except (OSError, ValueError, InputError):
        return False
    return bool(saved.get("converged")) and saved.get("scene_hash") == now


def poster(picture: Path, most: int = POSTER_BYTES) -> bytes:
    """A PNG of at most `most` bytes: first with fewer colors, then smaller."""
    with Image.open(picture) as opened:
        image = opened.convert("RGB")
    for share in (1.0, 0.85, 0.7, 0.55, 0.4):
        sized = image.resize(
            (round(share * image.width), round(share * image.height)), Image.Resampling.LANCZOS
        )
        stream = io.BytesIO()
        sized.quantize(192, dither=Image.Dither.NONE).save(stream, format="PNG", optimize=True)
        if stream.tell() <= most:
            return stream.getvalue()
    raise ValueError(f"{picture} does not fit into {most} bytes at 40 % of its size")


def replaced(page: Path, block: str) -> bool:
    """Write a block, with its marks, in place of the one that a page has. Returns False for a page that has none."""
    before, mark, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    if mark:
        page.write_text(before + block + rest.partition(END)[2], encoding="utf-8")
    return bool(mark)


def write_page(root: Path, name: str, scene: Path, folders: Sequence[Path]) -> Path:
    """The page, with the numbers of its scenes as they are now; scene: the first."""
    page = root / "docs/gallery" / f"{name}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    results = [
        json.loads((folder / "result.json").read_text(encoding="utf-8")) for folder in folders
    ]
    saved = results[0]
    block = "\n".join(
        [BEGIN, *table({r["name"]: measured(r, of) for r, of in zip(results, folders)}), END]
    )
    if page.exists() and replaced(page, block):
        return page
    movie = root / "docs/images/gallery" / f"{name}.mp4"
    lines = [
        f"# {saved['name'][:1].upper()}{saved['name'][1:]}",
        "",
        leading_comment(scene),
        "",
        f"![{saved['name']}](../images/gallery/{name}.png)",
        "",
        *([f"[Movie](../images/gallery/{name}.mp4)", ""] if movie.exists() else []),
        f"Run it with `magmpm run data/scenes/gallery/{name}.yaml --render`; run the whole gallery with `make gallery`.",
        "",
        block,
        "",
    ]
    page.write_text("\n".join(lines), encoding="utf-8")
    return page


def leading_comment(scene: Path) -> str:
    """The text of the comment at the start of a scene file."""
    lines = []
    for line in scene.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)


def table(scenes: dict[str, list[tuple[str, str]]]) -> list[str]:
    """The table of measured values, one column for each scene; with several scenes each column has the name of its scene."""
    known = [dict(rows) for rows in scenes.values()]
    names = dict.fromkeys(name for rows in scenes.values() for name, _ in rows)
    above = f" {' | '.join(scenes)} |" if len(scenes) > 1 else " |"
    head = [f"| measured |{above}", "| --- |" + " --- |" * len(scenes)]
    return [
        *head,
        *(f"| {name} | {' | '.join(rows.get(name, '') for rows in known)} |" for name in names),
    ]


def measured(saved: dict[str, Any], results: Path) -> list[tuple[str, str]]:
    """The measured values (name, value), from result.json, energies.csv and contacts.csv."""
    seconds = saved["seconds"]
    rows = [("particles", f"{saved['particles']:,}".replace(",", " "))]
    if saved.get("formulation", "static") == "static":
        rows.append(("Newton steps", str(saved["iterations"])))
    else:
        rate = saved["iterations"] * saved["particles"] / max(seconds["solve"], 1e-9) / 1e6
        rows += [
            (
                "motion",
                f"{saved['time']:g} s in {saved['iterations']} steps of {1e6 * saved['time_step']:.3g} µs",
            ),
            ("formulation", saved["formulation"]),
            ("particle-steps per second, frames included", f"{rate:.1f} million"),
        ]
    tip = []
    if saved["tip"] is not None:  # parts have one only where the scene names it
        tip.append(("tip at the end (mm)", ", ".join(f"{1e3 * x:.2f}" for x in saved["tip"])))
    rows += [
        (
            "run time",
            f"{seconds['setup'] + seconds['solve']:.1f} s, and {seconds['compile']:.1f} s to load or compile",
        ),
        *tip,
        ("det F at the end", f"{saved['min_det_F']:.3f} to {saved['max_det_F']:.3f}"),
        *_from_tables(results),
        *physics(results.name, results),
    ]
    return rows


def physics(name: str, results: Path) -> list[tuple[str, str]]:
    """The numbers that this scene demonstrates, from measure.py in this folder."""
    found: list[tuple[str, str]] = measures().rows(name, results)
    return found


def measures() -> ModuleType:
    """The module measure.py in this folder."""
    if str(HERE) not in sys.path:
        sys.path.insert(0, str(HERE))
    import measure

    return measure


def _from_tables(results: Path) -> list[tuple[str, str]]:
    rows = []
    energies = _table(results / "energies.csv")
    if energies:
        rows.append(
            (
                "largest kinetic energy",
                f"{1e6 * max(float(row['kinetic']) for row in energies):.3g} µJ",
            )
        )
    contacts = _table(results / "contacts.csv")
    for effect in dict.fromkeys(row["effect"] for row in contacts):
        of = [row for row in contacts if row["effect"] == effect]
        force = max(sum(float(row[f"F{axis}"]) ** 2 for axis in "xyz") ** 0.5 for row in of)
        depths = [float(row["depth"]) for row in of if row["depth"]]
        deepest = f"; largest depth {1e6 * max(depths):.3g} µm" if depths else ""
        rows.append(
            (f"largest contact force, {effect.replace('_', ' ')}", f"{1e3 * force:.3g} mN{deepest}")
        )
    return rows


def _table(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def write_index(root: Path, scenes: dict[str, Path]) -> Path:
    """Write docs/gallery/README.md: every existing page that has a poster, with it."""
    lines = [
        "# Gallery",
        "",
        "Every scene is in `data/scenes/gallery`; `make gallery` runs them all and draws these pictures.",
        "",
    ]
    others = [
        page.stem for page in sorted((root / "docs/gallery").glob("*.md")) if page.stem != "README"
    ]
    for name in dict.fromkeys([*scenes, *others]):
        page = root / "docs/gallery" / f"{name}.md"
        if page.exists() and (root / "docs/images/gallery" / f"{name}.png").exists():
            title = page.read_text(encoding="utf-8").split("\n", 1)[0].lstrip("# ")
            lines += [
                f"## [{title}]({name}.md)",
                "",
                f"[![{title}](../images/gallery/{name}.png)]({name}.md)",
                "",
            ]
    index = root / "docs/gallery/README.md"
    index.parent.mkdir(parents=True, exist_ok=True)
    index.write_text("\n".join(lines), encoding="utf-8")
    return index


if __name__ == "__main__":
    sys.exit(main())
