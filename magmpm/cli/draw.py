"""Pictures of a run's folder, and the movie of a motion."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.cli.answers import PARTICLES
from magmpm.errors import InputError
from magmpm.results.file_names import (
    ABOUT,
    ENERGIES_PLOT,
    FRAMES,
    MOMENTS,
    MOTION,
    MOVIE,
    NUMBERS,
    PICTURE,
)
from magmpm.results.run_folder import read_mapping

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.results.trajectory import Motion
    from magmpm.viz.worker import Renderer


def listed(files: list[Path], note: str) -> list[str]:
    """Return the paths as text, and print the note on what could not be drawn as requested."""
    if note:
        print(note, file=sys.stderr)
    return [str(path) for path in files]


def draw_run(
    folder: Path,
    out: Path,
    *,
    frames: str | None = None,
    fps: float | None = None,
    style: str | None = None,
    kind: str = "png",
) -> list[str]:
    """Draw what a run left in a folder into `out`. Returns the files; a note on what could not be done as wished goes to stderr.

    A motion gets its movie, its moments (the first, the last, and that between which is most unlike both), its last moment as a picture
    and its energies; an equilibrium gets its picture. frames: "all" or numbers with commas: these frames as pictures of their own; fps:
    frames of the movie a second; style: how an equilibrium is drawn, by its surface unless given. Motions are always drawn by it.
    kind: of picture files, one of FORMATS. Raises InputError where the folder holds neither, RenderError where nothing can be drawn.
    """
    from magmpm.viz.worker import Renderer

    motion = motion_of(folder)
    if motion is None and (frames is not None or fps is not None):
        raise InputError(
            f"{folder}: holds no motion: --frames and --fps are for results of dynamic scenes"
        )
    if motion is not None and style == PARTICLES:
        raise InputError(
            f"{folder}: holds a motion, which is drawn by its surface: --style {PARTICLES} is for"
            f" equilibria; ParaView shows the particles of {MOTION}"
        )
    with Renderer() as renderer:
        if motion is not None:
            files, note = _render_motion(motion, out, renderer, frames, fps, kind)
        else:
            from magmpm.results.result import Result

            files = [draw_result(Result.load(folder), _named(out / PICTURE, kind), renderer, style)]
            note = ""
        return listed(files, " ".join(filter(None, (note, renderer.note))))


def draw_result(result: Result, path: Path, renderer: Renderer, style: str | None = None) -> Path:
    """The picture of an equilibrium: the body's surface with what stands around it, or its particles, also from the top and the side."""
    from magmpm.viz.from_result import Still, trial_snapshot
    from magmpm.viz.style import FINAL_SIZE

    if style == PARTICLES:
        return renderer.render(trial_snapshot(result), path, size=FINAL_SIZE)
    still = Still(result)
    return renderer.render(still.snapshot(), path, framing=still.framing)


def motion_of(folder: Path) -> Motion | None:
    """The motion in a folder, unless an equilibrium was saved there later; a result that can't be read does not count."""
    from magmpm.results.trajectory import Motion

    if not (folder / MOTION).exists():
        return None
    motion = Motion.load(folder)
    saved = folder / NUMBERS
    if saved.exists() and saved.stat().st_mtime > (folder / ABOUT).stat().st_mtime:
        scene = read_mapping(saved).get("scene")
        if isinstance(scene, dict) and scene != motion.scene:
            return None
    return motion


def _render_motion(
    motion: Motion, out: Path, renderer: Renderer, frames: str | None, fps: float | None, kind: str
) -> tuple[list[Path], str]:
    from magmpm.viz import movies, plots
    from magmpm.viz.figure_panels import figure
    from magmpm.viz.from_motion import MotionRenderer

    if len(motion) == 0:
        raise InputError(
            f"{motion.folder}: the motion has no frames yet; wait for the first, or run the scene"
            " again"
        )
    wanted = _numbers(frames, len(motion))
    shown = MotionRenderer(motion)
    if read_mapping(motion.folder / NUMBERS).get("failure"):
        shown.title += " (stopped before its end)"
    files = movies.pictures(shown, out / FRAMES, renderer, wanted, kind)
    last = len(motion) - 1
    files.append(
        renderer.render(shown.snapshot(last), _named(out / PICTURE, kind), framing=shown.framing)
    )
    files.append(figure(shown, _named(out / MOMENTS, kind), renderer))
    if motion.energies:
        jumps = [jump["time"] for jump in motion.jumps]
        energies = _named(out / ENERGIES_PLOT, kind)
        files.append(
            renderer.run(
                plots.motion, motion.energies, motion.contacts, energies, motion.name, jumps
            )
        )
    made = movies.movie(shown, out / MOVIE, renderer, fps=fps)
    return [made.path, *files], made.note


def _named(path: Path, kind: str) -> Path:
    return path.with_suffix(f".{kind}")


def _numbers(text: str | None, count: int) -> Sequence[int]:
    """Numbers of the frames that get pictures of their own. Raises InputError."""
    if text is None:
        return []
    if text == "all":
        return range(count)
    try:
        return [range(count)[int(part)] for part in text.split(",")]
    except ValueError:
        raise InputError(
            f"--frames: received {text!r}; must be `all` or whole numbers separated by commas, "
            "such as 0,10,20"
        ) from None
    except IndexError:
        raise InputError(
            f"--frames: received {text!r}; this motion has the frames 0 to {count - 1} (-1 is the"
            " last)"
        ) from None
