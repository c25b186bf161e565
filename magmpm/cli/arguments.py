"""The command line: commands and their arguments, one function a command.

Nothing heavy is imported here, so that `magmpm --help` answers at once. `_NAME` belongs to the command in magmpm/cli/NAME.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from magmpm.cli.answers import STYLES
from magmpm.results.file_names import FORMATS

Commands = Any  # argparse gives its sub-commands no public type

HELP = """\
Simulate magnetic soft catheters, and find the magnetization that makes a target shape.

  magmpm run data/scenes/five_segments.yaml --render    one shape, with its picture
  magmpm design data/studies/s_shape.yaml               the magnetization that makes a shape
  magmpm accuracy data/scenes/five_segments.yaml        what accuracy costs in time
  magmpm stability                                      the hard cases, with their bounds
  magmpm effects data/scenes/five_segments.yaml         what each effect would do here, and cost
"""


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    whole = argparse.ArgumentParser(prog="magmpm", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter)
    whole.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (
        _run, _view, _map, _design, _accuracy, _effects, _render, _dashboard, _report, _examples, _import_robot, _prepare, _stability, _fit,
        _doctor,
    ):  # fmt: skip
        made = add(commands)
        made.set_defaults(command=add.__name__.removeprefix("_"))
        if {action.dest for action in made._actions} & {"scene", "scenes", "study", "robot"}:
            made.add_argument("--allow-outside", action="store_true", help="let files name files anywhere, not only near them")
    return whole


def _run(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser("run", help="simulate a scene", description="Simulate a scene file.")
    parser.add_argument("scene", metavar="SCENE", help="scene file, such as data/scenes/five_segments.yaml")
    parser.add_argument("--render", action="store_true", help="draw the result as well")
    parser.add_argument("--resume", action="store_true", help="go on with a motion that was interrupted")
    parser.add_argument("--time-limit", type=float, metavar="S", help="seconds after which the run ends by itself, and keeps what it has "
        "[none]")  # fmt: skip
    _overwriting(parser, "results of another scene")
    _style(parser, "surface")
    _common(parser, "runs/NAME, with the scene's name")
    return parser


def _design(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "design",
        help="search the design that makes a target shape",
        description="Run a design study; run it again to resume it.",
    )
    parser.add_argument("study", metavar="STUDY", help="study file, such as data/studies/s_shape.yaml")
    parser.add_argument("--trials", type=int, metavar="N", help="trials in all, in place of the file's number and its `stop`")
    parser.add_argument("--sampler", metavar="S", help="tpe, gp, cmaes, nsga2, random, gauss-newton or optuna:NAME, in place of the file's")
    parser.add_argument("--storage", metavar="URL", help="database of the trials: sqlite:///FILE, postgresql://USER@HOST/NAME or "
        "grpc://HOST:PORT; with a password in it, by the variable MAGMPM_STORAGE [sqlite in the results folder]")  # fmt: skip
    parser.add_argument("--workers", type=int, metavar="N", help="processes that solve; with --storage other machines can join")
    parser.add_argument("--time-limit", type=float, metavar="S", help="seconds after which a worker that still solves a design is ended, "
        "and the design given to another one [100 times the usual, at least 600]")  # fmt: skip
    parser.add_argument("--artifacts", metavar="PLACE", help="folder or s3://BUCKET for the trials' pictures, which sessions can share "
        "[the results folder]")  # fmt: skip
    parser.add_argument("--trial", type=int, metavar="K", help="in place of the search: solve trial K again from what is stored of it")
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")
    _style(parser, "particles")
    _common(parser, "runs/NAME, with the study file's name")
    return parser


def _accuracy(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "accuracy",
        help="what accuracy costs in time",
        description="Solve a scene over a ladder of cell sizes: table, CSV, JSON and a picture of error against time.",
    )
    parser.add_argument("scene", metavar="SCENE", help="scene file; its `reference` is compared with where given")
    parser.add_argument("--cells", metavar="N,N,...", help="cells across the diameter [2,3,4,5,6,8]")
    parser.add_argument("--motion", action="store_true", help="compare with motions that settle, too")
    _format(parser)
    _overwriting(parser, "results of another scene")
    _common(parser, "runs/NAME, with the scene's name")
    return parser


def _effects(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "effects",
        help="what each effect does to a scene and costs",
        description="For every effect, named in the scene or not: how far it moves the body's rest, by an estimate, and what it adds "
        "to a time step.",
    )
    parser.add_argument("scene", metavar="SCENE", help="scene file, such as data/scenes/five_segments.yaml")
    parser.add_argument("--quick", action="store_true", help="leave out the costs, which are counted")
    parser.add_argument("--all", action="store_true", help="a row for each effect, those that do not matter here too")
    _json(parser)
    return parser


def _render(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "render",
        help="pictures and movies of a saved result",
        description="Draw a saved run, the movie of a motion, or a study's best designs.",
    )
    parser.add_argument("result", metavar="RESULT", help="folder of a run or of a study, such as runs/s_shape")
    parser.add_argument("--frames", metavar="N,N,...", help="frames of a motion as pictures of their own, or `all`")
    parser.add_argument("--fps", type=_rate, metavar="N", help="frames of the movie a second [it lasts about 6 s]")
    _style(parser, "surface for a run, particles for a study")
    _format(parser)
    _common(parser, "into the folder itself")
    return parser


def _dashboard(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser("dashboard", help="optuna-dashboard on a study", description="Browse a study's trials and their pictures.")
    parser.add_argument("folder", metavar="DIR", help="folder of a study, such as runs/s_shape")
    parser.add_argument("--port", type=int, default=8080, help="port on this machine [8080]")
    parser.add_argument("--write", action="store_true", help="let the page edit: notes, names, and the deletion of studies")
    parser.add_argument("--storage", metavar="URL", help="database of the trials [as the study says, or the variable MAGMPM_STORAGE]")
    return parser


def _view(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "view",
        help="a scene in the browser, with sliders",
        description="Turn the field, the magnets, the directions and the inserted length of a scene at rest, and watch its shape; "
        "play a motion.",
    )
    parser.add_argument("scene", metavar="SCENE", help="scene file, or a study file: its scene with its target")
    parser.add_argument("--target", metavar="FILE", help="a CSV table of a center line, or a study: the shape is compared with it")
    parser.add_argument("--cells", type=int, metavar="N", help="cells across, in place of the scene's resolution")
    parser.add_argument("--port", type=int, metavar="N", help="port of the page; 0: any that is free [the first free one from 8090 on]")
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="listen there; more names after commas [127.0.0.1]")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    _common(parser, "runs/NAME, with the scene's name")
    return parser


def _report(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "report",
        help="a study as one page, and as PDF",
        description="Write a study's page: the best design as a sheet ready to make, with drawing, tolerances and accuracy, pictures, and "
        "how to make it again. The HTML file holds everything; PDF by WeasyPrint or Chromium, where there is one.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder of a study, such as runs/s_shape")
    parser.add_argument("--quick", action="store_true", help="leave out what solves the best design again: tolerances and accuracy")
    parser.add_argument("--motion", action="store_true", help="run the best design of an insertion or schedule in time (minutes)")
    parser.add_argument("--no-pdf", action="store_true", help="HTML only")
    parser.add_argument("--storage", metavar="URL", help="database of the trials [the study's; MAGMPM_STORAGE where that hides a password]")
    _common(parser, "the study's folder")
    return parser


def _map(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "map",
        help="where the tip goes over many fields",
        description="Solve a scene at rest in many uniform fields in place of its own: the tip in each, and which are not sure. "
        "Table, JSON and picture.",
    )
    parser.add_argument("scene", metavar="SCENE", help="scene file of a catheter or strip that is held at its base")
    parser.add_argument("--fields", type=int, default=1000, metavar="N", help="about how many fields [1000]")
    parser.add_argument("--max", metavar="B", help="their greatest strength, or component with --plane [20mT]")
    parser.add_argument("--strengths", type=int, metavar="N", help="strengths along each direction [8]")
    parser.add_argument("--plane", metavar="AXES", help="a grid of two components, such as xz, in place of directions to all sides")
    parser.add_argument("--cells", type=int, metavar="N", help="cells across, in place of the scene's resolution")
    _format(parser)
    _common(parser, "runs/NAME, with the scene's name")
    return parser


def _examples(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "examples",
        help="copy the example scenes and studies",
        description="Copy the scenes, studies, targets and tables that come with magmpm into DIR/data; the pages name them there.",
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder that gets `data`, such as .")
    _overwriting(parser, "files there that were changed")
    _json(parser)
    return parser


def _import_robot(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "import",
        help="a robot of the magneticMPM format becomes a scene",
        description="Make a scene of a robot file of the magneticMPM format; its meshes stay where they are.",
    )
    parser.add_argument("robot", metavar="ROBOT", help="robot file; its meshes are in the folder `meshes` beside it")
    parser.add_argument("-o", "--output", metavar="SCENE", type=Path, required=True, help="scene file to write")
    _overwriting(parser, "a file that says something else")
    _json(parser)
    return parser


def _prepare(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "prepare",
        help="compile kernels ahead of their first use",
        description="Compile the kernels of scenes, or without any of the usual combinations of effects, so that no run waits for them. "
        "They are kept in the user's cache and serve until magmpm, Numba or the processor changes.",
    )
    parser.add_argument("scenes", metavar="SCENE", nargs="*", help="scene files; their values make no difference, only what they name")
    _json(parser)
    return parser


def _stability(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "stability",
        help="the hard cases, each with its measure and bound",
        description="Run scenes at the edge of what the solvers can do, and compare a measure of each with its bound. "
        "Exit status 3 where one fails.",
    )
    parser.add_argument("--case", metavar="NAME", help="only the cases whose names contain this")
    parser.add_argument("--quick", action="store_true", help="leave out the cases that take long")
    parser.add_argument("--random", type=int, metavar="N", help="in place of the cases: N scenes drawn at random, each checked")
    parser.add_argument("--seed", type=int, metavar="S", help="of the random scenes; the same seed draws the same ones [0]")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the random scenes; begun again, it goes on [runs/random-S]")
    _json(parser)
    return parser


def _fit(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "fit",
        help="material constants from measured tips, shapes or motions",
        description="Find the constants of a scene that explain measurements best, with confidence intervals; constants that the "
        "measurements can't tell apart are refused, with the measurement that would. docs/fitting.md has the columns of the table.",
    )
    parser.add_argument("measured", metavar="MEASURED.csv", nargs="+", help="table with units in its header, such as "
        "field_z_mT,tip_x_mm,tip_z_mm; or several tables of the same body")  # fmt: skip
    parser.add_argument("scene", metavar="SCENE", help="scene file of the body; its values are where the search begins")
    parser.add_argument(
        "--vary", metavar="NAME,...", help="shear_modulus, remanence, density, length, magnetization, field, damping, viscosity, or one "
        "constant's own name [shear_modulus,remanence, and a motion's losses]",
    )  # fmt: skip
    parser.add_argument("--noise", metavar="LENGTH", help="standard deviation of each measured coordinate; or one for each table, "
        '"0.2 mm, 0.5 mm" [from the residuals]')  # fmt: skip
    parser.add_argument("--angle-noise", metavar="ANGLE", help="standard deviation of each measured angle")
    parser.add_argument("--known", metavar="NAME=SHARE,...", help="constants known beforehand, with standard deviations, remanence=2%%")
    parser.add_argument("--level", metavar="PERCENT", type=float, default=95.0, help="of the intervals [95]")
    parser.add_argument("--hold-out", metavar="COLUMN=VALUE,...", help="rows to predict from a fit of the others, by what a column holds")
    parser.add_argument("--quick", action="store_true", help="one descent alone, and no finer grid to compare with")
    _format(parser)
    _common(parser, "runs/NAME-fit, with the scene's name")
    return parser


def _doctor(commands: Commands) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "doctor",
        help="what is missing here, and whether the numbers come out right",
        description="Look at Python, libraries, OpenGL, threads and the cache of kernels, and test a few numbers against stored answers. "
        "Exit status 1 where something fails.",
    )
    parser.add_argument("--quick", action="store_true", help="leave out the self-test")
    _json(parser)
    return parser


def _common(parser: argparse.ArgumentParser, folder: str) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"folder of the results [{folder}]")
    _json(parser)


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")


def _overwriting(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def _style(parser: argparse.ArgumentParser, usual: str) -> None:
    parser.add_argument("--style", choices=STYLES, help=f"what a body at rest is drawn by [{usual}]")


def _format(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--format", choices=FORMATS, default="png", help="of pictures: plots are drawn in lines, bodies are an image [png]")


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
