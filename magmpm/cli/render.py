"""`magmpm render`: pictures of a saved run, and the movie of a motion."""

from __future__ import annotations

import argparse
from pathlib import Path

from magmpm.cli.answers import SURFACE, is_study, print_summary
from magmpm.cli.draw import draw_run, listed
from magmpm.cli.goals import draw_goal, saved_goal
from magmpm.errors import InputError
from magmpm.results.file_names import MOTION, NUMBERS
from magmpm.results.folder_lock import folder_lock
from magmpm.results.run_folder import holds_run


def command(options: argparse.Namespace) -> int:
    """Draw what a run or a study left in a folder, into --out or the folder itself, and say what was made. Returns the exit status.

    Raises InputError where there is nothing to draw or --out can't be written, RenderError where nothing can be drawn.
    """
    folder = Path(options.result)
    out: Path = options.out or folder
    if out.resolve() != folder.resolve() and (is_study(out) or holds_run(out)):
        raise InputError(
            str(out),
            received="a folder that holds other results",
            rule="pictures go beside the results they show, or into a folder without results",
            remedy=(
                "give another --out, or omit it: pictures then go into the folder that is drawn"
            ),
        )
    if not is_study(folder) and not any((folder / name).exists() for name in (MOTION, NUMBERS)):
        raise InputError(
            f"{folder}: holds no saved result ({NUMBERS} is missing); give the folder that `magmpm"
            " run` named, such as runs/NAME"
        )
    with folder_lock(out):
        if saved_goal(folder) is not None:
            files = draw_goal(folder, out, options.format, options.style)
        elif is_study(folder):
            from magmpm.cli.design import render_study

            files = listed(
                *render_study(folder, out, smooth=options.style == SURFACE, kind=options.format)
            )
        else:
            files = draw_run(
                folder,
                out,
                frames=options.frames,
                fps=options.fps,
                style=options.style,
                kind=options.format,
            )
    print_summary(options, {"files": files}, "\n".join(f"saved {path}" for path in files))
    return 0
