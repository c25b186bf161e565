"""The command line: `main` is the `magmpm` command."""

from magmpm.cli.command import main

__all__ = ["main"]
