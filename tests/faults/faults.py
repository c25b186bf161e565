"""`make faults`: injects faults into studies and motions, and counts the completed trials and frames that are lost.

python tests/faults/faults.py [--kills N] [--seed S] [--out DIR] [--only PART]: prints the table, adds it to that of DIR/faults.json; exit
status 1 where something was lost, or was not as it has to be. "met" counts the faults that found completed trials (or frames) to lose;
N is of kills that did.
"""

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

import commands
import kinds
from kinds import Row

PARTS = ("single", "motions", "commands", "studies", "workers")
Fault = Callable[[], Row | list[Row]]


def faults(
    base: Path, kills: int, drawn: random.Random, parts: tuple[str, ...] = PARTS
) -> dict[str, Fault]:
    """The faults by name: a third of the kills for motions, the rest for studies."""
    single = [kinds.disk_full, kinds.read_only, kinds.quota, kinds.clock_set_back]
    third = max(kills // 3, 1)
    known: dict[str, dict[str, Fault]] = {
        "single": {fault.__name__: partial(fault, base) for fault in single},
        "motions": {"kills_of_motions": partial(kinds.kills_of_motions, base, third, drawn)},
        "commands": {
            "kills_of_commands": partial(
                commands.kills_of_commands, base, max(kills // 60, 2), drawn
            )
        },
        "studies": {"kills_of_studies": partial(kinds.kills_of_studies, base, third, drawn, 0)},
        "workers": {
            "kills_of_workers": partial(
                kinds.kills_of_studies, base, max(kills - 2 * third, 1), drawn, 2
            )
        },
    }
    return {name: fault for part in parts for name, fault in known[part].items()}


def rows(faults: dict[str, Fault]) -> Iterator[Row]:
    """The rows of the table, as they come. A fault whose own probe fails is a row that says so, and the others go on."""
    for name, fault in faults.items():
        try:
            found = fault()
        except Exception as error:
            traceback.print_exc()
            found = Row(name, wrong=[f"the probe itself failed: {error!r}"[:300]])
        for row in found if isinstance(found, list) else [found]:
            if row.injected and not row.met:
                row.wrong.append("it met no completed trial or frame, so it shows nothing")
            yield row


def add(found: list[Row], row: Row) -> None:
    """A row, or what it adds to the one of its kind that is there."""
    for old in found:
        if old.kind == row.kind:
            for name in ("injected", "met", "completed", "lost"):
                setattr(old, name, getattr(old, name) + getattr(row, name))
            old.said += [line for line in row.said if line not in old.said]
            old.wrong += row.wrong
            return
    found.append(row)


def show(row: Row) -> None:
    """A row of the table."""
    said = "; ".join(row.said)[:110]
    print(
        f"{row.kind:<38} {row.injected:>8} {row.met:>4} {row.completed:>9} {row.lost:>4}  {said}",
        flush=True,
    )
    for what in row.wrong:
        print(f"    WRONG: {what}", flush=True)


def main() -> int:
    """Inject them. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--kills",
        type=int,
        default=500,
        help="SIGKILLs that meet completed trials or frames, in all [500]",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/faults"))
    parser.add_argument(
        "--only", choices=PARTS, action="append", help="these parts of the table alone"
    )
    options = parser.parse_args()
    table = options.out / "faults.json"
    known = (
        json.loads(table.read_text())
        if table.exists() and options.only
        else {"seconds": 0.0, "rows": []}
    )
    begun = time.monotonic()
    found = [Row(**one) for one in known["rows"]]
    new = []
    base = Path(tempfile.mkdtemp(prefix="magmpm-faults-"))
    base.chmod(0o755)
    options.out.mkdir(parents=True, exist_ok=True)
    print(
        f"{'fault':<38} {'injected':>8} {'met':>4} {'completed':>9} {'lost':>4}  what was said",
        flush=True,
    )
    try:
        chosen = faults(
            base, options.kills, random.Random(options.seed), tuple(options.only or PARTS)
        )
        for row in rows(chosen):
            show(row)
            new.append(row)
            add(found, row)
            seconds = known["seconds"] + time.monotonic() - begun
            table.write_text(
                json.dumps({"seconds": seconds, "rows": [asdict(one) for one in found]}, indent=1)
                + "\n"
            )
    finally:
        shutil.rmtree(base, ignore_errors=True)
    if len(found) > len(new):
        print("with what was there:")
        for row in found:
            show(row)
    lost = sum(row.lost for row in found)
    wrong = sum(len(row.wrong) for row in found)
    print(
        f"{sum(row.injected for row in found)} faults, {sum(row.met for row in found)} of them met"
        f" completed trials and frames, {sum(row.completed for row in found)} looked at, {lost}"
        f" lost, {wrong} wrong, {seconds:.0f} s"
    )
    return 1 if lost or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
