"""`magmpm stability`: the hard cases, each with its measure and bound."""

from __future__ import annotations

import argparse
import sys

from magmpm.cli.answers import print_summary
from magmpm.cli.progress import Progress
from magmpm.errors import InputError
from studies.hard_cases import CASES, table


def command(options: argparse.Namespace) -> int:
    """Run the chosen cases and print their table. Returns the exit status: 3 if one fails."""
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
