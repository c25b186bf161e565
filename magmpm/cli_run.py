"""`magmpm run`: one simulation, its results and pictures."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.cli_parts import of_file, print_summary, results_folder
from magmpm.cli_render import draw_run
from magmpm.errors import SolveError
from magmpm.folder_lock import folder_lock
from magmpm.motion_files import CHECKPOINT, forget
from magmpm.progress import Progress

if TYPE_CHECKING:
    from magmpm.results import Result
    from magmpm.scene import Scene


def run_scene(options: argparse.Namespace) -> int:
    """Simulate a scene file, save the result, and draw it if asked. Returns the exit status."""
    from magmpm.scene import load_scene

    scene = load_scene(options.scene)
    folder = options.out or results_folder(scene.name)
    with folder_lock(folder):
        return _run_into(folder, scene, options)


def _run_into(folder: Path, scene: Scene, options: argparse.Namespace) -> int:
    from magmpm.simulate import run

    dynamic = scene.solver.dynamic
    if options.resume:
        _say_if_afresh(folder, dynamic is not None)
    with Progress(f"{scene.name}") as progress:

        def tell(step: int, number: float) -> None:
            if dynamic is None:
                progress.note(f"Newton step {step}, energy gap {number:.0e}")
            else:  # in thousandths, of which the time left is guessed
                progress.at(int(1000 * number / dynamic.duration), 1000, f"step {step}, t = {number:.4g} s")

        try:
            with of_file(options.scene):
                result = run(scene, folder=folder, resume=options.resume, on_progress=tell)
        except SolveError as error:
            if error.state is None:
                raise
            saved = _save(error.state, folder)
            if options.json:
                print(json.dumps({**error.state.summary(), "folder": str(folder), "reason": error.reason}))
            raise SolveError(f"{error.reason}; the last good state is in {saved}", error.state) from None
    _save(result, folder)
    summary = {**result.summary(), "folder": str(folder)}
    if options.render:
        summary["files"] = draw_run(folder, folder)
        summary["picture"] = next(path for path in summary["files"] if path.endswith("picture.png"))
    print_summary(options, summary, _report(result, folder))
    return 0


def _say_if_afresh(folder: Path, moving: bool) -> None:
    """--resume where there is nothing to go on from."""
    if not moving:
        print("magmpm: --resume: a static scene has no checkpoints; it is solved from the start", file=sys.stderr)
    elif not (folder / CHECKPOINT).exists():
        print(f"magmpm: --resume: {folder} holds no {CHECKPOINT}; the motion begins at the start", file=sys.stderr)


def _save(result: Result, folder: Path) -> Path:
    """Save a result, in place of an earlier one of either kind. Returns the folder."""
    if result.formulation == "static":
        forget(folder)
    return result.save(folder)


def _report(result: Result, folder: Path) -> str:
    tip = ", ".join(f"{1e3 * x:.3f}" for x in result.tip)
    seconds = result.seconds
    lines = [
        f"{result.name}: {_done(result)}",
        f"  tip             ({tip}) mm",
        f"  det F           {result.min_det_F:.4f} to {result.max_det_F:.4f}",
        f"  particles, dof  {result.particles}, {result.dof}; section area and second moment exact to "
        f"{max(result.section.values()):.0e}",
        f"  seconds         {seconds['setup'] + seconds['solve']:.3f} (and {seconds['compile']:.2f} to load or compile the kernels)",
        *(f"  warning         {warning}" for warning in result.warnings),
        f"  saved in        {folder}",
    ]
    return "\n".join(lines)


def _done(result: Result) -> str:
    if result.formulation == "static":
        return f"equilibrium in {result.iterations} Newton steps"
    bounds = ", ".join(f"{name} {step:.3g}" for name, step in result.stable_steps.items())
    rate = result.iterations * result.particles / max(result.seconds["solve"], 1e-9) / 1e6
    return (
        f"{result.time:g} s of motion in {result.iterations} steps of {result.time_step:.3g} s ({result.formulation} formulation)\n"
        f"  stable steps    {bounds} s\n"
        f"  rate            {rate:.1f} million particle-steps a second, frames and looks included\n"
        f"  energy          kinetic {result.kinetic_energy:.3g} J, potential {result.energy:.3g} J"
    )
