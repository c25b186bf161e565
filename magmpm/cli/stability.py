"""`magmpm stability`: the hard cases, each with its measure and bound."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from magmpm.cli.answers import print_summary
from magmpm.cli.progress import Progress
from magmpm.errors import InputError, report
from magmpm.studies.hard_cases import BROKEN, CASES, random_table, run_cases, run_random, table


def command(options: argparse.Namespace) -> int:
    """Run the chosen cases, or scenes drawn at random, and print their table. Returns the exit status: 3 if one fails."""
    _refuse_mixed(options)
    if options.random is not None:
        return _random(options)
    named = [case for case in CASES if options.case is None or options.case.lower() in case.name.lower()]
    chosen = [case for case in named if not (options.quick and case.slow)]
    if not chosen:
        raise InputError(f"--case: received {options.case!r}; must be part of a name: {', '.join(case.name for case in CASES)}")
    with Progress("hard cases") as progress:
        outcomes = run_cases(chosen, on_done=progress.at)
    failed = [outcome.name for outcome in outcomes if not outcome.passed]
    summary = {"cases": [outcome.summary() for outcome in outcomes], "failed": failed}
    print_summary(options, summary, table(outcomes))
    if failed:
        print(f"magmpm: {len(failed)} of {len(outcomes)} hard cases failed: {', '.join(failed)}", file=sys.stderr)
    return 3 if failed else 0


def _refuse_mixed(options: argparse.Namespace) -> None:
    """Raises InputError where options of the cases and of random scenes are given together."""
    if options.random is None:
        alone = [f"--{name}" for name in ("seed", "out") if getattr(options, name) is not None]
        if alone:
            rule, remedy = "belongs to random scenes", "add, say, --random 300, or leave it out"
            raise InputError(report(alone[0], rule=rule, remedy=remedy, received="no --random"))
        return
    cases = [f"--{name}" for name in ("case", "quick") if getattr(options, name)]
    if cases:
        rule, remedy = "chooses among the cases, and --random draws scenes in their place", "leave out one of the two"
        raise InputError(report(cases[0], rule=rule, remedy=remedy, received=f"--random {options.random}"))


def _random(options: argparse.Namespace) -> int:
    """Scenes drawn at random. Returns the exit status: 3 if one of them is wrong, hangs, is refused or ends with a traceback."""
    seed = 0 if options.seed is None else options.seed
    if options.random < 1 or seed < 0:
        given, rule = (options.random, "1 or more") if options.random < 1 else (seed, "0 or more")
        key = "--random" if options.random < 1 else "--seed"
        raise InputError(report(key, received=str(given), rule=f"must be {rule}", remedy="write, say, --random 300 --seed 1"))
    folder = options.out or Path("runs") / f"random-{seed}"
    with Progress("random scenes") as progress:
        summary = run_random(options.random, seed, folder, on_done=lambda k, n: progress.at(k, n))
    print_summary(options, summary, random_table(summary))
    broken = sum(summary[end] for end in BROKEN)
    if broken:
        print(f"magmpm: {broken} of {summary['scenes']} random scenes went wrong; see above", file=sys.stderr)
    return 3 if broken else 0
