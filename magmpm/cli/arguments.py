"""The command line: a table of the commands and their arguments.

Nothing heavy is imported here, so that `magmpm --help` answers at once.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

from magmpm.cli.answers import STYLES
from magmpm.results.file_names import FORMATS

HELP = """\
Simulate magnetic soft catheters, and find the magnetization that makes a target shape.

  magmpm run data/scenes/five_segments.yaml --render    one shape, with its picture
  magmpm design data/studies/s_shape.yaml               the magnetization that makes a shape
  magmpm accuracy data/scenes/five_segments.yaml        what accuracy costs in time
  magmpm stability                                      the hard cases, with their bounds
  magmpm effects data/scenes/five_segments.yaml         what each effect would do here, and cost
"""


class _Version(argparse.Action):
    """--version, looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(" ".join(f"{name} {version(name)}" for name in ("magmpm", "numpy", "numba", "scipy")))
        parser.exit()


def _rate(text: str) -> float:
    """Frames a second."""
    try:
        if 1 <= float(text) <= 100:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(
        f"received {text!r}; must be a number from 1 to 100, such as 25"
    )


Argument = tuple[
    str, dict[str, Any]
]  # its names, with spaces between, and what argparse takes of it


def _value(names: str, metavar: str, help: str, **more: Any) -> Argument:
    return names, {"metavar": metavar, "help": help, **more}


def _flag(name: str, help: str) -> Argument:
    return name, {"action": "store_true", "help": help}


def _overwrite(what: str) -> Argument:
    return _flag("--overwrite", f"replace {what}")


def _style(usual: str) -> Argument:
    return "--style", {"choices": STYLES, "help": f"what a body at rest is drawn by [{usual}]"}


def _out(folder: str) -> tuple[Argument, Argument]:
    return _value("--out", "DIR", f"folder of the results [{folder}]", type=Path), _JSON


_JSON = _flag("--json", "print one JSON object and nothing else")
_FORMAT: Argument = (
    "--format",
    {
        "choices": FORMATS,
        "default": "png",
        "help": "of pictures: plots are drawn in lines, bodies are an image [png]",
    },
)
_SCENE = _value("scene", "SCENE", "scene file, such as data/scenes/five_segments.yaml")
_CELLS = _value("--cells", "N", "cells across, in place of the scene's resolution", type=int)
_OF_SCENE = _out("runs/NAME, with the scene's name")


class Command(NamedTuple):
    """A command: its function in magmpm/cli, a line and a paragraph of help, and its arguments."""

    function: str
    help: str
    description: str
    arguments: tuple[Argument, ...]


COMMANDS = {
    "run": Command(
        "run.command",
        "simulate a scene",
        "Simulate a scene file.",
        (
            _SCENE,
            _flag("--render", "draw the result as well"),
            _flag("--resume", "go on with a motion that was interrupted"),
            _value(
                "--time-limit",
                "S",
                "seconds after which the run ends by itself, and keeps what it has [none]",
                type=float,
            ),
            _overwrite("results of another scene"),
            _style("surface"),
            *_OF_SCENE,
        ),
    ),
    "view": Command(
        "view.command",
        "a scene in the browser, with sliders",
        "Turn the field, the magnets, the directions and the inserted length of a "
        "scene at rest, and watch its shape; play a motion.",
        (
            _value("scene", "SCENE", "scene file, or a study file: its scene with its target"),
            _value(
                "--target",
                "FILE",
                "a CSV table of a center line, or a study: the shape is compared with it",
            ),
            _CELLS,
            _value(
                "--port",
                "N",
                "port of the page; 0: any that is free [the first free one from 8090 on]",
                type=int,
            ),
            _value(
                "--host",
                "ADDRESS",
                "listen there; more names after commas [127.0.0.1]",
                default="127.0.0.1",
            ),
            _flag("--open", "open the page in the browser"),
            *_OF_SCENE,
        ),
    ),
    "map": Command(
        "tables.tip_map",
        "where the tip goes over many fields",
        "Solve a scene at rest in many uniform fields in place of its own: the "
        "tip in each, and which are not sure. Table, JSON and picture.",
        (
            _value("scene", "SCENE", "scene file of a catheter or strip that is held at its base"),
            _value("--fields", "N", "about how many fields [1000]", type=int, default=1000),
            _value("--max", "B", "their greatest strength, or component with --plane [20mT]"),
            _value("--strengths", "N", "strengths along each direction [8]", type=int),
            _value(
                "--plane",
                "AXES",
                "a grid of two components, such as xz, in place of directions to all sides",
            ),
            _CELLS,
            _FORMAT,
            *_OF_SCENE,
        ),
    ),
    "design": Command(
        "design.command",
        "search the design that makes a target shape",
        "Run a design study; run it again to resume it.",
        (
            _value("study", "STUDY", "study file, such as data/studies/s_shape.yaml"),
            _value(
                "--trials",
                "N",
                "trials in all, in place of the file's number and its `stop`",
                type=int,
            ),
            _value(
                "--sampler",
                "S",
                "tpe, gp, cmaes, nsga2, random, gauss-newton or optuna:NAME, in place of the"
                " file's",
            ),
            _value(
                "--storage",
                "URL",
                "database of the trials: sqlite:///FILE, postgresql://USER@HOST/NAME or"
                " grpc://HOST:PORT; with a password in it, by the variable MAGMPM_STORAGE [sqlite"
                " in the results folder]",
            ),
            _value(
                "--workers",
                "N",
                "processes that solve; with --storage other machines can join",
                type=int,
            ),
            _value(
                "--time-limit",
                "S",
                "seconds after which a worker that still solves a design is ended, and the design"
                " given to another one [100 times the usual, at least 600]",
                type=float,
            ),
            _value(
                "--artifacts",
                "PLACE",
                "folder or s3://BUCKET for the trials' pictures, which sessions can share [the"
                " results folder]",
            ),
            _value(
                "--trial",
                "K",
                "in place of the search: solve trial K again from what is stored of it",
                type=int,
            ),
            _flag("--no-pictures", "draw nothing"),
            _style("particles"),
            *_out("runs/NAME, with the study file's name"),
        ),
    ),
    "sweep": Command(
        "goals.sweep",
        "run a scene over values of its numbers",
        "Run a scene for every combination of values, in parallel, and print its measures; with "
        "--out it goes on where it was.",
        (
            _SCENE,
            _value(
                "--set",
                "ADDRESS=V1,V2",
                "a number of the scene and its values, such as 'field.uniform[2]=2 mT,4 mT';"
                " may be repeated",
                action="append",
            ),
            _value(
                "--measure",
                "M",
                "tip, another measure, or its settings, '{travel: {of: tip}}'; may be repeated"
                " [tip]",
                action="append",
            ),
            _value("--workers", "N", "processes that run scenes [one for each CPU]", type=int),
            *_out("none: rows are printed"),
        ),
    ),
    "accuracy": Command(
        "tables.accuracy",
        "what accuracy costs in time",
        "Solve a scene over a ladder of cell sizes: table, CSV, JSON and a picture of "
        "error against time.",
        (
            _value("scene", "SCENE", "scene file; its `reference` is compared with where given"),
            _value("--cells", "N,N,...", "cells across the diameter [2,3,4,5,6,8]"),
            _flag("--motion", "compare with motions that settle, too"),
            _FORMAT,
            _overwrite("results of another scene"),
            *_OF_SCENE,
        ),
    ),
    "effects": Command(
        "tables.effects",
        "what each effect does to a scene and costs",
        "For every effect, named in the scene or not: how far it moves "
        "the body's rest, by an estimate, and what it adds to a time step.",
        (
            _SCENE,
            _flag("--quick", "leave out the costs, which are timed"),
            _flag("--all", "a row for each effect, those that do not matter here too"),
            _JSON,
        ),
    ),
    "render": Command(
        "render.command",
        "pictures and movies of a saved result",
        "Draw a saved run, the movie of a motion, or a study's best designs.",
        (
            _value("result", "RESULT", "folder of a run or of a study, such as runs/s_shape"),
            _value("--frames", "N,N,...", "frames of a motion as pictures of their own, or `all`"),
            _value("--fps", "N", "frames of the movie a second [it lasts about 6 s]", type=_rate),
            _style("surface for a run, particles for a study"),
            _FORMAT,
            *_out("into the folder itself"),
        ),
    ),
    "dashboard": Command(
        "dashboard.command",
        "optuna-dashboard on a study",
        "Browse a study's trials and their pictures.",
        (
            _value("folder", "DIR", "folder of a study, such as runs/s_shape"),
            ("--port", {"type": int, "default": 8080, "help": "port on this machine [8080]"}),
            _flag("--write", "let the page edit: notes, names, and the deletion of studies"),
            _value(
                "--storage",
                "URL",
                "database of the trials [as the study says, or the variable MAGMPM_STORAGE]",
            ),
        ),
    ),
    "report": Command(
        "report.command",
        "a study as one page, and as PDF",
        "Write a study's page: the best design as a sheet ready to make, with drawing, tolerances"
        " and accuracy, pictures, and how to make it again. The HTML file holds everything; PDF by"
        " WeasyPrint or Chromium, where there is one.",
        (
            _value("folder", "DIR", "folder of a study, such as runs/s_shape"),
            _flag(
                "--quick", "leave out what solves the best design again: tolerances and accuracy"
            ),
            _flag("--motion", "run the best design of an insertion or schedule in time (minutes)"),
            _flag("--no-pdf", "HTML only"),
            _value(
                "--storage",
                "URL",
                "database of the trials [the study's; MAGMPM_STORAGE where that hides a password]",
            ),
            *_out("the study's folder"),
        ),
    ),
    "examples": Command(
        "first_steps.examples",
        "copy the example scenes and studies",
        "Copy the scenes, studies, targets and tables that come with magmpm "
        "into DIR/data; the pages name them there.",
        (
            _value("folder", "DIR", "folder that gets `data`, such as .", type=Path),
            _overwrite("files there that were changed"),
            _JSON,
        ),
    ),
    "import": Command(
        "first_steps.import_robot",
        "a robot of the magneticMPM format becomes a scene",
        "Make a scene of a robot file of the magneticMPM format; its meshes stay where they are.",
        (
            _value("robot", "ROBOT", "robot file; its meshes are in the folder `meshes` beside it"),
            _value("-o --output", "SCENE", "scene file to write", type=Path, required=True),
            _overwrite("a file that says something else"),
            _JSON,
        ),
    ),
    "prepare": Command(
        "first_steps.prepare",
        "compile kernels ahead of their first use",
        "Compile the kernels of scenes, or without any of the usual combinations of effects, so"
        " that no run waits for them. They are kept in the user's cache and serve until magmpm,"
        " Numba or the processor changes.",
        (
            _value(
                "scenes",
                "SCENE",
                "scene files; their values make no difference, only what they name",
                nargs="*",
            ),
            _JSON,
        ),
    ),
    "stability": Command(
        "tables.stability",
        "the hard cases, each with its measure and bound",
        "Run scenes at the edge of what the solvers can do, and "
        "compare a measure of each with its bound. Exit status 3 where one fails.",
        (
            _value("--case", "NAME", "only the cases whose names contain this"),
            _flag("--quick", "leave out the cases that take long"),
            _value("--random", "N", "moved: says where scenes drawn at random are now", type=int),
            _value("--seed", "S", "moved with --random", type=int),
            _value("--out", "DIR", "moved with --random", type=Path),
            _JSON,
        ),
    ),
    "fit": Command(
        "fit.command",
        "material constants from measured tips, shapes or motions",
        "Find the constants of a scene that explain measurements best, with confidence intervals;"
        " constants that the measurements can't tell apart are refused, with the measurement that"
        " would. docs/fitting.md has the columns of the table.",
        (
            _value(
                "measured",
                "MEASURED.csv",
                "table with units in its header, such as field_z_mT,tip_x_mm,tip_z_mm; or several"
                " tables of the same body",
                nargs="+",
            ),
            _value(
                "scene", "SCENE", "scene file of the body; its values are where the search begins"
            ),
            _value(
                "--vary",
                "NAME,...",
                "shear_modulus, remanence, density, length, magnetization, field, damping,"
                " viscosity, or one constant's own name or address [shear_modulus,remanence, and a"
                " motion's losses]",
            ),
            _value(
                "--noise",
                "LENGTH",
                "standard deviation of each measured coordinate; or one for each table, "
                '"0.2 mm, 0.5 mm" [from the residuals]',
            ),
            _value("--angle-noise", "ANGLE", "standard deviation of each measured angle"),
            _value(
                "--known",
                "NAME=SHARE,...",
                "constants known beforehand, with standard deviations, remanence=2%%",
            ),
            _value("--level", "PERCENT", "of the intervals [95]", type=float, default=95.0),
            _value(
                "--hold-out",
                "COLUMN=VALUE,...",
                "rows to predict from a fit of the others, by what a column holds; more values of"
                " it, or other columns with theirs, after commas: a row that has one of them is"
                " held out",
            ),
            _flag("--quick", "one descent alone, and no finer grid to compare with"),
            _FORMAT,
            *_out("runs/NAME-fit, with the scene's name"),
        ),
    ),
    "doctor": Command(
        "doctor.command",
        "what is missing here, and whether the numbers come out right",
        "Look at Python, libraries, OpenGL, threads and the cache of kernels, and test a few"
        " numbers against stored answers. Exit status 1 where something fails.",
        (
            _flag("--quick", "leave out the self-test"),
            _JSON,
        ),
    ),
}


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    whole = argparse.ArgumentParser(
        prog="magmpm", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    whole.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        made = commands.add_parser(name, help=command.help, description=command.description)
        made.set_defaults(command=command.function)
        for names, how in command.arguments:
            made.add_argument(*names.split(), **how)
        if {names for names, _ in command.arguments} & {"scene", "scenes", "study", "robot"}:
            made.add_argument(
                "--allow-outside",
                action="store_true",
                help="let files name files anywhere, not only near them",
            )
    return whole
