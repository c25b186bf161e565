"""The command line: a table of the commands and their arguments.

Nothing heavy is imported here, so that `magmpm --help` answers at once.
"""

import argparse
from pathlib import Path
from textwrap import fill, indent
from typing import Any, NamedTuple

from magmpm.cli.answers import STYLES
from magmpm.results.file_names import FORMATS

HELP = "Simulate and design magnetic soft robots (catheters, strips, STL parts)."
AFTER = """\
examples:
  magmpm examples .                                     copy the example scenes and studies into ./data
  magmpm run data/scenes/five_segments.yaml --render    one shape, with its picture
  magmpm effects data/scenes/five_segments.yaml         what each effect changes, and what it costs
  magmpm design data/studies/s_shape.yaml               the magnetization that makes a shape

`magmpm COMMAND --help` describes a command. Defaults are in brackets.
exit status: 0 done; 2 wrong input; 3 no equilibrium or a failed motion, with the last good state saved; 1 anything else
"""


class _Version(argparse.Action):
    """--version, looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(" ".join(f"{name} {version(name)}" for name in ("magmpm", "numpy", "numba", "scipy")))
        parser.exit()


def _rate(text: str) -> float:
    """Frames per second."""
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
    return "--style", {"choices": STYLES, "help": f"how to draw a body at rest [{usual}]"}


def _out(folder: str) -> tuple[Argument, Argument]:
    return _value("--out", "DIR", f"folder for the results [{folder}]", type=Path), _JSON


_JSON = _flag("--json", "print one JSON object in SI units, and nothing else")
_FORMAT: Argument = (
    "--format",
    {"choices": FORMATS, "default": "png", "help": "picture format [png]"},
)
_SCENE = _value("scene", "SCENE", "scene file, such as data/scenes/five_segments.yaml")
_CELLS = _value("--cells", "N", "cells across the thickness [the scene's resolution]", type=int)
_OF_SCENE = _out("runs/NAME, with the scene's name")


class Command(NamedTuple):
    """A command: its function in magmpm/cli, a line and a paragraph of help, its arguments, and examples, one a line."""

    function: str
    help: str
    description: str
    arguments: tuple[Argument, ...]
    examples: str


COMMANDS = {
    "run": Command(
        "run.command",
        "simulate a scene",
        "Simulate a scene: its equilibrium, equilibria along time, or its motion, as the scene's"
        " `solver` says. The results go to a folder, and a summary to the terminal.",
        (
            _SCENE,
            _flag("--render", "also draw the result: a picture, or the movie of a motion"),
            _flag("--resume", "continue an interrupted run from its last checkpoint"),
            _value(
                "--time-limit",
                "S",
                "stop after S seconds and keep what was computed; exit status 3 [no limit]",
                type=float,
            ),
            _overwrite("results of another scene"),
            _style("surface"),
            *_OF_SCENE,
        ),
        "magmpm run data/scenes/five_segments.yaml --render\n"
        "magmpm run swing.yaml --out runs/swing --time-limit 600\n"
        "magmpm run swing.yaml --out runs/swing --resume",
    ),
    "sweep": Command(
        "goals.sweep",
        "run a scene over values of its numbers",
        "Run a scene for every combination of values, in parallel, and print measures of each"
        " result. With --out, a repeated command runs only what is missing.",
        (
            _SCENE,
            _value(
                "--set",
                "ADDRESS=V1,V2",
                "number of the scene and its values, such as 'field.uniform[2]=2 mT,4 mT'; may be"
                " repeated",
                action="append",
            ),
            _value(
                "--measure",
                "M",
                "tip, another measure, or its settings, '{travel: {of: tip}}'; may be repeated"
                " [tip]",
                action="append",
            ),
            _value("--workers", "N", "number of processes [one for each CPU]", type=int),
            *_out("none: rows are only printed"),
        ),
        "magmpm sweep data/scenes/five_segments.yaml --set 'field.uniform[2]=2 mT,4 mT,8 mT'\n"
        "magmpm sweep scene.yaml --set 'effects.gravity=null,{}' --measure strain --out runs/sweep",
    ),
    "map": Command(
        "tables.tip_map",
        "map the tip over many fields",
        "Map the tip over many uniform fields, the scene's field.uniform, and flag fields with"
        " several stable shapes. Writes a table, JSON and a picture.",
        (
            _value("scene", "SCENE", "scene file of a catheter or strip that is held at its base"),
            _value("--fields", "N", "approximate number of fields [1000]", type=int, default=1000),
            _value("--max", "B", "largest strength, or largest component with --plane [20mT]"),
            _value("--strengths", "N", "number of strengths along each direction [8]", type=int),
            _value("--plane", "AXES", "vary two components, such as xz [all directions]"),
            _CELLS,
            _FORMAT,
            *_OF_SCENE,
        ),
        "magmpm map data/scenes/five_segments.yaml --fields 200 --max 10mT\n"
        "magmpm map data/scenes/five_segments.yaml --plane xz --fields 400",
    ),
    "view": Command(
        "view.command",
        "view a scene in the browser, with sliders",
        "Serve a page on which sliders change the field, the magnets, the directions and the"
        " inserted length of a scene at rest, or which plays a motion. Ctrl-C stops it.",
        (
            _value("scene", "SCENE", "scene file, or a study file: its scene with its target"),
            _value(
                "--target",
                "FILE",
                "CSV table of a centerline, or a study: the shape is compared with it",
            ),
            _value(
                "--vary",
                "ADDRESS=MIN,MAX",
                "slider of any number of the scene, such as 'materials.rubber.remanence=50 mT,200"
                " mT'; may be repeated",
                action="append",
            ),
            _CELLS,
            _value(
                "--port",
                "N",
                "port of the page; 0: any free one [the first free one from 8090 on]",
                type=int,
            ),
            _value(
                "--host",
                "ADDRESS",
                "address of the page; further names after commas [127.0.0.1]",
                default="127.0.0.1",
            ),
            _flag("--open", "open the page in the browser"),
            *_OF_SCENE,
        ),
        "magmpm view data/scenes/five_segments.yaml --open\nmagmpm view data/studies/s_shape.yaml",
    ),
    "design": Command(
        "design.command",
        "search for the design with a target shape or goal",
        "Run a design study; the same command resumes it. The study file names the scene, what"
        " varies, and the shape (`match`) or goal that is sought. The results go to a folder.",
        (
            _value("study", "STUDY", "study file, such as data/studies/s_shape.yaml"),
            _value(
                "--trials",
                "N",
                "total number of trials; overrides `trials` and `stop` in the study file",
                type=int,
            ),
            _value(
                "--sampler",
                "S",
                "tpe, gp, cmaes, nsga2, random, gauss-newton or optuna:NAME [the study file's]",
            ),
            _value(
                "--storage",
                "URL",
                "database of the trials: sqlite:///FILE, postgresql://USER@HOST/NAME or"
                " grpc://HOST:PORT; URLs with a password go into MAGMPM_STORAGE [sqlite in the"
                " results folder]",
            ),
            _value(
                "--workers",
                "N",
                "number of processes that solve designs; with --storage, other machines can join"
                " [none: this process solves]",
                type=int,
            ),
            _value(
                "--time-limit",
                "S",
                "seconds after which a worker is stopped and its design solved again [100 times"
                " the usual time, at least 600]",
                type=float,
            ),
            _value(
                "--artifacts",
                "PLACE",
                "folder or s3://BUCKET for the pictures of trials [the results folder]",
            ),
            _value("--trial", "K", "solve trial K again from what is stored, and stop", type=int),
            _flag("--no-pictures", "draw nothing"),
            _style("particles"),
            *_out("runs/NAME, with the study file's name"),
        ),
        "magmpm design data/studies/s_shape.yaml\n"
        "magmpm design data/studies/s_shape.yaml --sampler tpe --trials 35 --out runs/s_by_tpe\n"
        "magmpm design data/goals/lifted_tip.yaml --workers 2",
    ),
    "report": Command(
        "report.command",
        "write a study as one page, HTML and PDF",
        "Write the page of a study: the best design as a sheet from which it can be made, with"
        " drawing, tolerances and accuracy; pictures; and how to reproduce it. PDF needs"
        " WeasyPrint.",
        (
            _value("folder", "DIR", "folder of a study, such as runs/s_shape"),
            _flag("--quick", "omit tolerances and accuracy, which solve the best design again"),
            _flag("--motion", "run the best design of an insertion or schedule in time (minutes)"),
            _flag("--no-pdf", "HTML only"),
            _value(
                "--storage",
                "URL",
                "database of the trials [the study's, or the variable MAGMPM_STORAGE]",
            ),
            *_out("the study's folder"),
        ),
        "magmpm report runs/s_shape",
    ),
    "dashboard": Command(
        "dashboard.command",
        "browse a study in optuna-dashboard",
        "Browse the trials of a study and their pictures in optuna-dashboard. Prints the address"
        " to open; Ctrl-C stops it.",
        (
            _value("folder", "DIR", "folder of a study, such as runs/s_shape"),
            _value("--port", "N", "port on this machine [8080]", type=int, default=8080),
            _flag("--write", "allow the page to edit notes and names, and to delete studies"),
            _value(
                "--storage",
                "URL",
                "database of the trials [the study's, or the variable MAGMPM_STORAGE]",
            ),
        ),
        "magmpm dashboard runs/s_shape",
    ),
    "fit": Command(
        "fit.command",
        "fit material constants to measured tips, shapes or motions",
        "Find the constants of a scene that explain measurements best, with confidence intervals."
        " Constants that the measurements can't separate are refused, with the measurement that"
        " would separate them.",
        (
            _value(
                "measured",
                "MEASURED.csv",
                "table with units in its header, such as field_z_mT,tip_x_mm,tip_z_mm; or several"
                " tables of the same body",
                nargs="+",
            ),
            _value("scene", "SCENE", "scene file of the body; the search starts at its values"),
            _value(
                "--vary",
                "NAME,...",
                "addresses of the scene's numbers, with = between those that share one value, or"
                " their words: shear_modulus, remanence, density, length, magnetization, field,"
                " damping, viscosity [shear_modulus,remanence, and a motion's losses]; may be"
                " repeated",
                action="append",
            ),
            _value(
                "--noise",
                "LENGTH",
                "standard deviation of a measured coordinate; or one for each table, "
                '"0.2 mm, 0.5 mm" [estimated from the residuals]',
            ),
            _value(
                "--angle-noise", "ANGLE", "standard deviation of a measured angle, such as 1deg"
            ),
            _value(
                "--known",
                "NAME=SHARE,...",
                "constants known beforehand, by word or address, with their standard deviations,"
                " such as remanence=2%%; may be repeated",
                action="append",
            ),
            _value("--level", "PERCENT", "level of the intervals [95]", type=float, default=95.0),
            _value(
                "--hold-out",
                "COLUMN=VALUE,...",
                "rows to leave out of the fit and predict: those with one of these values",
            ),
            _flag("--quick", "one start only, and no comparison with a finer grid"),
            _FORMAT,
            *_out("runs/NAME-fit, with the scene's name"),
        ),
        "magmpm fit tips.csv scene.yaml --vary shear_modulus --noise 0.2mm\n"
        "magmpm fit tips.csv scene.yaml --vary shear_modulus,remanence --known remanence=2%",
    ),
    "accuracy": Command(
        "tables.accuracy",
        "show what accuracy costs in time",
        "Solve a scene on several grids and compare them: table, CSV, JSON and a picture of error"
        " against time. Exit status 3 if fewer than two grids have an answer.",
        (
            _value(
                "scene", "SCENE", "scene file; also compared with its `reference`, if it has one"
            ),
            _value("--cells", "N,N,...", "numbers of cells across the thickness [2,3,4,5,6,8]"),
            _flag("--motion", "also compare with motions that settle to the equilibrium"),
            _FORMAT,
            _overwrite("results of another scene"),
            *_OF_SCENE,
        ),
        "magmpm accuracy data/scenes/five_segments.yaml --cells 2,3,4,6",
    ),
    "effects": Command(
        "tables.effects",
        "show what each effect changes in a scene, and what it costs",
        "Run a scene with and without each effect, on a coarse grid, and print how far each one"
        " moves the body, the uncertainty, its cost, and whether to keep, drop or add it.",
        (
            _SCENE,
            _flag("--quick", "omit the costs"),
            _flag("--all", "give every effect a row; without it, negligible ones share one line"),
            _JSON,
        ),
        "magmpm effects data/scenes/five_segments.yaml --quick",
    ),
    "stability": Command(
        "tables.stability",
        "run the hard cases, each with its bound",
        "Run scenes at the edge of what the solvers can do, and compare a measure of each with"
        " its bound. Exit status 3 if one fails.",
        (
            _value("--case", "NAME", "only cases whose names contain NAME"),
            _flag("--quick", "omit the cases that take long"),
            _JSON,
        ),
        "magmpm stability --quick\nmagmpm stability --case snap",
    ),
    "render": Command(
        "render.command",
        "draw a saved result: pictures and movies",
        "Draw a saved run, the movie of a motion, or the best designs of a study.",
        (
            _value("result", "RESULT", "folder of a run or of a study, such as runs/s_shape"),
            _value("--frames", "N,N,...", "also draw these frames of a motion, or `all`"),
            _value(
                "--fps", "N", "frames per second of the movie [so that it lasts 6 s]", type=_rate
            ),
            _style("surface for a run, particles for a study"),
            _FORMAT,
            *_out("RESULT itself"),
        ),
        "magmpm render runs/swing --frames 0,10,-1 --fps 25\n"
        "magmpm render runs/five-segment-catheter --format svg",
    ),
    "import": Command(
        "first_steps.import_robot",
        "convert a robot of the magneticMPM format to a scene",
        "Write a scene for a robot file of the magneticMPM format. Its meshes stay where they are.",
        (
            _value("robot", "ROBOT", "robot file; its meshes are in the folder `meshes` beside it"),
            _value("-o --output", "SCENE", "scene file to write", type=Path, required=True),
            _overwrite("an existing file with other contents"),
            _JSON,
        ),
        "magmpm import gripper.yaml -o gripper_scene.yaml",
    ),
    "examples": Command(
        "first_steps.examples",
        "copy the example scenes and studies",
        "Copy the scenes, studies, targets and tables that come with magmpm into DIR/data, where"
        " the documentation expects them.",
        (
            _value("folder", "DIR", "folder that gets `data`, such as .", type=Path),
            _overwrite("changed files"),
            _JSON,
        ),
        "magmpm examples .",
    ),
    "prepare": Command(
        "first_steps.prepare",
        "compile kernels ahead of their first use",
        "Compile the kernels that scenes need, or those of the usual effects, so that no run waits"
        " for them. They stay in your cache until magmpm, Numba or the processor changes.",
        (
            _value("scenes", "SCENE", "scene files [the usual solvers and effects]", nargs="*"),
            _JSON,
        ),
        "magmpm prepare\nmagmpm prepare data/scenes/gallery/gripper.yaml",
    ),
    "doctor": Command(
        "doctor.command",
        "check the installation and test a few numbers",
        "Check Python, libraries, OpenGL, threads and the kernel cache, and compare a few numbers"
        " with stored answers. Exit status 1 if something fails.",
        (
            _flag("--quick", "omit the numerical tests"),
            _JSON,
        ),
        "magmpm doctor",
    ),
}


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    raw = argparse.RawDescriptionHelpFormatter
    whole = argparse.ArgumentParser(
        prog="magmpm", description=HELP, epilog=AFTER, formatter_class=raw
    )
    whole.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        made = commands.add_parser(
            name,
            help=command.help,
            description=fill(command.description, 79),
            epilog=indent(f"examples:\n{command.examples}", "  ").lstrip(),
            formatter_class=raw,
        )
        made.set_defaults(command=command.function)
        for names, how in command.arguments:
            made.add_argument(*names.split(), **how)
        if {names for names, _ in command.arguments} & {"scene", "scenes", "study", "robot"}:
            made.add_argument(
                "--allow-outside",
                action="store_true",
                help="allow paths in input files that lead outside their folders",
            )
    return whole
