"""The `magmpm` command: the only place that joins physics, studies and pictures.

Exit status: 0 done; 2 the input is wrong; 3 the run ended unstable or unconverged, with the last good state saved, if
there was one; 1 anything else.
Heavy imports stay inside the commands, so that `magmpm --help` answers at once.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from magmpm.cli.answers import STYLES, print_summary, results_folder
from magmpm.cli.progress import Progress
from magmpm.compiled.environment import refuse_unusable
from magmpm.errors import InputError, MagmpmError, SolveError
from magmpm.results.folder_lock import folder_lock
from magmpm.results.whole_file import REFUSED, explained

HELP = """\
Simulate magnetic soft catheters, and find the magnetisation that makes a wanted shape.

  magmpm run data/scenes/five_segments.yaml --render    one shape, with its picture
  magmpm design data/studies/s_shape.yaml               the magnetisation that makes a shape
  magmpm accuracy data/scenes/five_segments.yaml        what accuracy costs in time
  magmpm stability                                      the hard cases, with their bounds
  magmpm effects data/scenes/five_segments.yaml         what each effect would do here, and cost
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        options = _parser().parse_args(given)
        refuse_unusable()
        status: int = options.command(options)
        return status
    except SolveError as error:
        return _say(f"magmpm: {error.reason}", SolveError.exit_status)
    except MagmpmError as error:
        return _say(f"magmpm: {error}", error.exit_status)
    except KeyboardInterrupt:
        return _say("magmpm: interrupted; what was finished is kept", 1)
    except BrokenPipeError:  # the reader of our output has gone
        sys.stderr.close()
        return 1
    except OSError as error:  # a disk that is full, a folder that went away
        return _say(f"magmpm: {explained(error)}", 2 if error.errno in REFUSED else 1)


def _say(message: str, status: int) -> int:
    print(message, file=sys.stderr)
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="magmpm", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    run = commands.add_parser("run", help="simulate a scene", description="Simulate a scene file.")
    run.add_argument("scene", metavar="SCENE", help="scene file, such as data/scenes/five_segments.yaml")
    run.add_argument("--render", action="store_true", help="draw the result as well")
    run.add_argument("--resume", action="store_true", help="go on with a motion that was interrupted")
    _overwriting(run, "results of another scene")
    _style(run, "surface")
    _common(run, "runs/NAME, with the scene's name")
    run.set_defaults(command=_run)

    design = commands.add_parser(
        "design",
        help="search the design that makes a wanted shape",
        description="Run a design study; run it again to resume it.",
    )
    design.add_argument("study", metavar="STUDY", help="study file, such as data/studies/s_shape.yaml")
    design.add_argument("--trials", type=int, metavar="N", help="trials in all, in place of the file's number and its `stop`")
    design.add_argument("--sampler", metavar="S", help="tpe, gp, cmaes or random, in place of the file's")
    design.add_argument(
        "--storage", metavar="URL", help="database of the trials [sqlite in the results folder]"
    )
    design.add_argument("--no-pictures", action="store_true", help="draw nothing")
    _style(design, "particles")
    _common(design, "runs/NAME, with the study file's name")
    design.set_defaults(command=_design)

    accuracy = commands.add_parser(
        "accuracy",
        help="what accuracy costs in time",
        description="Solve a scene over a ladder of cell sizes: table, CSV, JSON and a picture of error against time.",
    )
    accuracy.add_argument(
        "scene", metavar="SCENE", help="scene file; its `reference` is compared with where given"
    )
    accuracy.add_argument("--cells", metavar="N,N,...", help="cells across the diameter [2,3,4,5,6,8]")
    _overwriting(accuracy, "results of another scene")
    _common(accuracy, "runs/NAME, with the scene's name")
    accuracy.set_defaults(command=_accuracy)

    table = commands.add_parser(
        "effects",
        help="what each effect does to a scene and costs",
        description="For every effect, named in the scene or not: how far it moves the body's rest, by an estimate, and what it adds "
        "to a time step.",
    )
    table.add_argument("scene", metavar="SCENE", help="scene file, such as data/scenes/five_segments.yaml")
    table.add_argument("--quick", action="store_true", help="leave out the costs, which are measured (and compiled for, once)")
    table.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    table.set_defaults(command=_effects)

    render = commands.add_parser(
        "render",
        help="pictures and movies of a saved result",
        description="Draw a saved run, the movie of a motion, or a study's best designs.",
    )
    render.add_argument(
        "result", metavar="RESULT", help="folder of a run or of a study, such as runs/s_shape"
    )
    render.add_argument("--frames", metavar="N,N,...", help="frames of a motion as pictures of their own, or `all`")
    render.add_argument("--fps", type=_rate, metavar="N", help="frames of the movie a second [it lasts about 6 s]")
    _style(render, "surface for a run, particles for a study")
    _common(render, "into the folder itself")
    render.set_defaults(command=_render)

    dashboard = commands.add_parser(
        "dashboard",
        help="optuna-dashboard on a study",
        description="Browse a study's trials and their pictures.",
    )
    dashboard.add_argument("folder", metavar="DIR", help="folder of a study, such as runs/s_shape")
    dashboard.add_argument("--port", type=int, default=8080, help="port on this machine [8080]")
    dashboard.set_defaults(command=_dashboard)

    robot = commands.add_parser(
        "import",
        help="a robot of the magneticMPM format becomes a scene",
        description="Make a scene of a robot file of the magneticMPM format; its meshes stay where they are.",
    )
    robot.add_argument("robot", metavar="ROBOT", help="robot file; its meshes are in the folder `meshes` beside it")
    robot.add_argument("-o", "--output", metavar="SCENE", type=Path, required=True, help="scene file to write")
    _overwriting(robot, "a file that says something else")
    robot.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    robot.set_defaults(command=_import)

    ahead = commands.add_parser(
        "prepare",
        help="compile kernels ahead of their first use",
        description="Compile the kernels of scenes, or without any of the usual combinations of effects, so that no run waits for them. "
        "They are kept in the user's cache and serve until magmpm, Numba or the processor changes.",
    )
    ahead.add_argument("scenes", metavar="SCENE", nargs="*", help="scene files; their values make no difference, only what they name")
    ahead.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    ahead.set_defaults(command=_prepare)

    stability = commands.add_parser(
        "stability",
        help="the hard cases, each with its measure and bound",
        description="Run scenes at the edge of what the solvers can do, and compare a measure of each with its bound. "
        "Exit status 3 where one fails.",
    )
    stability.add_argument("--case", metavar="NAME", help="only the cases whose names contain this")
    stability.add_argument("--quick", action="store_true", help="leave out the cases that take long")
    stability.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    stability.set_defaults(command=_stability)
    return parser


def _common(parser: argparse.ArgumentParser, folder: str) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"folder of the results [{folder}]")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")


def _overwriting(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def _style(parser: argparse.ArgumentParser, usual: str) -> None:
    parser.add_argument("--style", choices=STYLES, help=f"what a body at rest is drawn by [{usual}]")


def _rate(text: str) -> float:
    """Frames a second."""
    try:
        if 1 <= float(text) <= 100:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"received {text!r}; must be a number from 1 to 100, such as 25")


class _Version(argparse.Action):
    """--version, looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(" ".join(f"{name} {version(name)}" for name in ("magmpm", "numpy", "numba", "scipy")))
        parser.exit()


def _run(options: argparse.Namespace) -> int:
    from magmpm.cli.run import run_scene

    return run_scene(options)


def _design(options: argparse.Namespace) -> int:
    from magmpm.cli.design import design

    return design(options)


def _accuracy(options: argparse.Namespace) -> int:
    from magmpm.cli.design import refuse_study
    from magmpm.inputs.yaml_document import of_file
    from magmpm.results.run_folder import RunFolder
    from magmpm.scene import load_scene
    from magmpm.simulate import run
    from studies.accuracy import LADDER, climb, save
    from viz.plots import accuracy

    scene = load_scene(options.scene)
    cells = _cells(options.cells) or LADDER
    folder = options.out or results_folder(scene.name)
    with folder_lock(folder):
        refuse_study(folder)
        kept = RunFolder(folder, scene, options.scene)
        kept.claim(options.overwrite)
        with Progress(f"accuracy of {scene.name}") as progress, of_file(options.scene):
            ladder = climb(scene, run, cells, progress.at)
        files = [
            *save(ladder, folder),
            accuracy(ladder.summary()["rungs"], folder / "accuracy.png", title=scene.name),
        ]
        kept.sign_accuracy()
    summary = {**ladder.summary(), "files": [str(path) for path in files]}
    print_summary(options, summary, "\n".join([ladder.table(), *(f"saved {path}" for path in files)]))
    return 0


def _effects(options: argparse.Namespace) -> int:
    from magmpm.inputs.yaml_document import of_file
    from magmpm.scene import load_scene
    from studies.effects_table import survey

    scene = load_scene(options.scene)
    with Progress(f"effects of {scene.name}") as progress, of_file(options.scene):
        table = survey(scene, measure=not options.quick, on_progress=progress.at)
    print_summary(options, table.summary(), table.text())
    return 0


def _cells(text: str | None) -> list[int]:
    try:
        return [int(part) for part in text.split(",")] if text else []
    except ValueError:
        raise InputError(
            f"--cells: got {text!r}; must be whole numbers with commas between, such as 2,3,4,6"
        ) from None


def _render(options: argparse.Namespace) -> int:
    from magmpm.cli.render import render

    files = render(Path(options.result), options.out, frames=options.frames, fps=options.fps, style=options.style)
    print_summary(options, {"files": files}, "\n".join(f"saved {path}" for path in files))
    return 0


def _dashboard(options: argparse.Namespace) -> int:
    from magmpm.cli.dashboard import dashboard

    return dashboard(Path(options.folder), options.port)


def _import(options: argparse.Namespace) -> int:
    from magmpm.scene.magnetic_mpm_import import import_robot

    scene, warnings = import_robot(options.robot, options.output, overwrite=options.overwrite)
    regions = scene.regions()
    held = sum(region.held for region in regions)
    summary = {"scene": str(options.output), "name": scene.name, "parts": len(regions), "held": held, "warnings": warnings}
    text = [
        f"{scene.name}: {len(regions)} parts, {held} held",
        *(f"  warning  {warning}" for warning in warnings),
        f"saved {options.output}; set its field, then: magmpm run {shlex.quote(str(options.output))}",
    ]
    print_summary(options, summary, "\n".join(text))
    return 0


def _prepare(options: argparse.Namespace) -> int:
    from magmpm.cli.prepare import prepare

    done = prepare(options.scenes)
    lines = [f"{'compiled' if each['compiled'] else 'ready':<9} {each['kernels']}" for each in done]
    print_summary(options, {"kernels": done}, "\n".join(lines))
    return 0


def _stability(options: argparse.Namespace) -> int:
    from studies.hard_cases import CASES, table

    named = [case for case in CASES if options.case is None or options.case.lower() in case.name.lower()]
    chosen = [case for case in named if not (options.quick and case.slow)]
    if not chosen:
        raise InputError(f"--case: received {options.case!r}; must be part of a name: {', '.join(case.name for case in CASES)}")
    outcomes = []
    with Progress("hard cases") as progress:
        for k, case in enumerate(chosen):
            progress.at(k, len(chosen), case.name)
            outcomes.append(case.run())
    failed = [outcome.name for outcome in outcomes if not outcome.passed]
    summary = {"cases": [outcome.summary() for outcome in outcomes], "failed": failed}
    print_summary(options, summary, table(outcomes))
    if failed:
        print(f"magmpm: {len(failed)} of {len(outcomes)} hard cases failed: {', '.join(failed)}", file=sys.stderr)
    return 3 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
