"""`magmpm run`: one simulation, its results and pictures."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from magmpm.cli.answers import PARTICLES, Progress, folder_of_results, print_summary
from magmpm.cli.draw import draw_run
from magmpm.errors import (
    InputError,
    MagmpmError,
    SolveError,
    TimeOver,
    count,
    lengths,
    quantity,
    significant,
    stability_in_words,
)
from magmpm.inputs.yaml_document import of_file
from magmpm.results.file_names import CHECKPOINT, EARLIER
from magmpm.results.motion_tables import jump_in_words
from magmpm.results.result import Result
from magmpm.results.run_folder import RunFolder
from magmpm.results.trajectory import frame_files
from magmpm.scene import Scene, load_progress, load_scene
from magmpm.scene.notebook import MOST_PARTS_LISTED
from magmpm.scene.time_limit import limited


def command(options: argparse.Namespace) -> int:
    """Simulate a scene file, save the result, and draw it if requested. Returns the exit status."""
    scene = load_scene(options.scene)
    if scene.in_time:
        with of_file(options.scene):
            frame_files()
    if options.render:
        from magmpm.viz.worker import forced_backend

        forced_backend()  # before the run, whose pictures it would fail to draw
    if options.style == PARTICLES and scene.in_time:
        raise InputError(
            f"--style: received {PARTICLES}: this scene is a motion, which is drawn by its "
            "surface; omit --style; ParaView shows the particles"
        )
    with folder_of_results(options, scene.name) as folder:
        kept = RunFolder(folder, scene, options.scene)
        kept.claim(options.overwrite)
        return _run_into(kept, scene, options)


def _run_into(kept: RunFolder, scene: Scene, options: argparse.Namespace) -> int:
    from magmpm.simulate import missed_effects  # what solves, after the file is read

    folder = kept.path
    moving = scene.in_time
    timed = (
        scene.resolution.seconds is not None
    )  # of several grids, and a checkpoint is that of one
    resume = options.resume and moving and not timed and (folder / CHECKPOINT).exists()
    if options.resume and not resume:
        _say_afresh(folder, moving, timed)
    kept.written, replaced = resume, "" if resume else kept.holding()
    try:
        result = _simulated(scene, options, kept)
    except SolveError as error:
        waits = (
            kept.written and (resume or error.state is not None) and (folder / CHECKPOINT).exists()
        )
        if isinstance(error, TimeOver) and waits:
            if error.state is not None:
                _tell_failure(error, folder, options)
            _tell_waiting(folder)
            raise TimeOver(
                f"{error.reason}; `--resume` continues from its last frame in {folder}", error.state
            ) from None
        _end(kept, error, options)
    except BaseException:
        if not (folder / CHECKPOINT).exists():  # nothing to resume from
            kept.put_back()
        else:
            _tell_waiting(folder)
        raise
    result = replace(result, warnings=[*result.warnings, *missed_effects(scene)])
    kept.save(result)
    _warn(result)
    summary = {**result.summary(), "folder": str(folder), "replaced": replaced}
    if options.render:
        summary["files"] = draw_run(folder, folder, style=options.style)
        summary["picture"] = next(path for path in summary["files"] if path.endswith("picture.png"))
    print_summary(options, summary, _report(result, folder, replaced))
    return 0


def _end(kept: RunFolder, error: SolveError, options: argparse.Namespace) -> NoReturn:
    """Keep what a failed run has, and raise the error with where that is."""
    folder = kept.path
    if error.state is None:
        kept.put_back()
        raise type(error)(f"{error.reason}; there is no state to save") from None
    saved = kept.save_failed(error.state)
    _warn(error.state)
    _tell_failure(error, saved, options)
    words = f"; the earlier results in {folder} are unchanged" if saved != folder else ""
    raise type(error)(
        f"{error.reason}; the last good state is in {saved}{words}", error.state
    ) from None


def _tell_waiting(folder: Path) -> None:
    """Mention earlier results that are saved while a motion waits to be resumed."""
    if (folder / EARLIER).is_dir():
        print(
            f"magmpm: earlier results are kept in {folder / EARLIER}, until this motion is "
            "resumed and finished",
            file=sys.stderr,
        )


def _simulated(scene: Scene, options: argparse.Namespace, kept: RunFolder) -> Result:
    """The run itself, with a line of progress."""
    from magmpm.simulate import simulated
    from magmpm.solving.several_grids import notes_before
    from magmpm.solving.solve import RunOptions

    def say(note: str) -> None:
        print(f"magmpm: {note}", file=sys.stderr, flush=True)

    with of_file(options.scene):
        for note in notes_before(scene):
            say(note)
    with Progress(f"{scene.name}") as progress, of_file(options.scene), limited(options.time_limit):

        def tell(step: int, number: float) -> None:
            load = load_progress.now()
            if scene.in_time:
                progress.at(number, scene.duration, f"step {step}", "s")
            elif load is None:
                progress.note(f"Newton step {step}, energy gap {number:.0e}")
            else:
                text = f"Newton step {step} toward {100 * load.sought:.3g} %"
                progress.at(100 * load.reached, 100, text, "% of the load")

        return simulated(
            scene,
            RunOptions(
                folder=kept.path,
                resume=kept.written,
                on_progress=tell,
                on_begin=kept.set_aside,
                advise=True,
                on_note=say,
            ),
        )


def _warn(result: Result) -> None:
    """Warnings about a result, on standard error."""
    for warning in result.warnings:
        print(f"magmpm: warning: {warning}", file=sys.stderr)


def _tell_failure(error: SolveError, saved: Path, options: argparse.Namespace) -> None:
    """The last good state: its picture, if requested, and its numbers."""
    summary = {**error.state.summary(), "folder": str(saved), "reason": error.reason}
    if options.render:
        try:
            summary["files"] = draw_run(saved, saved, style=options.style)
        except MagmpmError as failure:  # what went wrong with the run matters more
            print(f"magmpm: the last good state can't be drawn: {failure}", file=sys.stderr)
    if options.json:
        print(json.dumps(summary))


def _say_afresh(folder: Path, moving: bool, timed: bool) -> None:
    """--resume, but there is nothing to continue."""
    if moving and timed:
        print("magmpm: --resume: a run with resolution.seconds starts over", file=sys.stderr)
    elif moving:
        print(
            f"magmpm: --resume: {folder} holds no {CHECKPOINT}; the motion starts over",
            file=sys.stderr,
        )
    else:
        print(
            "magmpm: --resume: a static scene has no checkpoints; it is solved from the start",
            file=sys.stderr,
        )


def _report(result: Result, folder: Path, replaced: str) -> str:
    seconds = result.seconds
    lines = [
        f"{result.name}: {_done(result)}",
        *_places(result),
        (
            f"  det F           {result.min_det_F:.4f} to {result.max_det_F:.4f}; largest stretch"
            f" {result.largest_stretch:.3f}"
        ),
        *_resolution(result),
        *_chosen(result),
        *(
            []
            if result.stability is None
            else [f"  stability       {stability_in_words(result.stability)}"]
        ),
        (
            f"  particles, dof  {result.particles}, {result.dof}; section area and second moment"
            f" exact to {max(result.section.values()):.0e}"
        ),
        (
            f"  seconds         {seconds['setup'] + seconds['solve']:.3f} (and"
            f" {seconds['compile']:.2f} to load or compile the kernels)"
        ),
        *([f"  replaced        {replaced}"] if replaced else []),
        f"  saved in        {folder}",
    ]
    return "\n".join(lines)


def _places(result: Result) -> list[str]:
    """The lines of the tip and of the parts."""
    named = list(result.positions.items())
    lines = [] if result.tip is None else [f"  tip             {lengths(result.tip)}"]
    lines += [
        f"  center          {lengths(place)}: {name}" for name, place in named[:MOST_PARTS_LISTED]
    ]
    if len(named) > MOST_PARTS_LISTED:
        lines.append(
            f"  center          of {len(named) - MOST_PARTS_LISTED} more parts: `positions`"
            " in result.json"
        )
    return lines


def _resolution(result: Result) -> list[str]:
    """The line of the error, where one was requested."""
    if result.error_estimate is None or result.resolution is None:
        return []
    share = 100 * result.resolution["error_of_length"]
    tried = ", ".join(str(one["cells_across"]) for one in result.resolution["tried"])
    return [
        f"  error           at most {quantity(result.error_estimate, 'm')}, {significant(share)} "
        f"% of the length: {result.resolution['cells_across']} cells across; tried: {tried}"
    ]


def _chosen(result: Result) -> list[str]:
    """The lines of the effects that were chosen, and of those that were not."""
    words = {True: "chosen", False: "left out"}
    return [
        f"  {words[one['chosen']]:15} {one['effect']}: {one['why']}"
        for one in result.effects_chosen or []
    ]


def _done(result: Result) -> str:
    if result.formulation == "static":
        return f"equilibrium in {result.iterations} Newton steps"
    if result.formulation == "quasi_static":
        total = sum(step["iterations"] for step in result.steps)
        until = quantity(result.time, "s")
        path = (
            f"{len(result.steps)} equilibria until {until} in {total} Newton steps,"
            f" {count(len(result.jumps), 'jump')}"
        )
        return "\n".join(
            [path, *(f"  jump            {jump_in_words(jump)}" for jump in result.jumps)]
        )
    bounds = ", ".join(
        f"{name} {quantity(step, 's')}" for name, step in result.stable_steps.items()
    )
    rate = result.iterations * result.particles / max(result.seconds["solve"], 1e-9) / 1e6
    return (
        f"{quantity(result.time, 's')} of motion in {result.iterations} steps, the last of "
        f"{quantity(result.time_step, 's')}\n  stable steps    {bounds}\n  rate            "
        f"{significant(rate)} million particle-steps per second, output included\n  energy        "
        f"  kinetic {quantity(result.kinetic_energy, 'J')}, potential "
        f"{quantity(result.energy, 'J')}"
    )
