"""The `magmpm` command: the only place that joins physics, studies and pictures.

Exit status: 0 done; 2 the input is wrong; 3 the run ended unstable or unconverged, with the last good state saved if there was one;
1 anything else. arguments.py says what can be typed; a command's module is imported only to run it: `--help` answers at once.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module

from magmpm.cli.arguments import COMMANDS, parser
from magmpm.compiled.environment import refuse_unusable
from magmpm.errors import InputError, MagmpmError, SolveError, require
from magmpm.inputs.user_files import VARIABLE
from magmpm.results.whole_file import REFUSED, explained


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if given and not given[0].startswith("-") and given[0] not in COMMANDS:
            near = get_close_matches(given[0], COMMANDS, n=1) or ["--help"]
            raise InputError(
                f"{given[0]}: unknown command",
                rule=f"the commands are {', '.join(COMMANDS)}",
                remedy=f"try: magmpm {near[0]}",
            )
        whole = parser()
        if "_ARGCOMPLETE" in os.environ:  # set by the shell's completion alone
            import_module("argcomplete").autocomplete(whole)
        options = whole.parse_args(given)
        os.environ.setdefault(
            "PYDANTIC_DISABLE_PLUGINS", "__all__"
        )  # nobody's code but magmpm's reads its files
        refuse_unusable()
        if getattr(options, "allow_outside", False):
            os.environ[VARIABLE] = os.sep
        _require_packages(options, given[0])
        module, function = options.command.split(".")
        status: int = getattr(import_module(f"magmpm.cli.{module}"), function)(options)
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


def _require_packages(options: argparse.Namespace, name: str) -> None:
    """Raise MissingPackage if a command needs an optional package that is not installed, before it begins."""
    drawing = ("matplotlib", "render", "pictures")
    needed = {
        "design.command": ("optuna", "design", "studies"),
        "report.command": ("optuna", "design", "studies"),
        "first_steps.import_robot": ("manifold3d", "parts", "closed meshes"),
        "fit.command": drawing,
        "render.command": drawing,
        "tables.accuracy": drawing,
        "tables.tip_map": drawing,
    }
    if options.command in needed:
        package, extra, use = needed[options.command]
        require(package, extra, key=name, use=use)
    if getattr(options, "render", False):
        require("matplotlib", "render", key=f"{name} --render", use="pictures")


def _say(message: str, status: int) -> int:
    print(message, file=sys.stderr)
    return status
