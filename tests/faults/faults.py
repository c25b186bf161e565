"""`make faults`: injects faults into studies and motions, and counts the completed trials and frames that are lost.

python tests/faults/faults.py [--kills N] [--seed S] [--out DIR]: prints the table, writes it to DIR/faults.json; exit status 1 where
something was lost, or was not as it has to be.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import kinds
from kinds import Row


def rows(base: Path, kills: int, drawn: random.Random) -> Iterator[Row]:
    """The rows of the table, as they come: a third of the kills for motions, the rest for studies."""
    single: list[Callable[[Path], Row]] = [
        kinds.disk_full, kinds.read_only, kinds.quota, kinds.two_at_once, kinds.corrupted_artifact, kinds.clock_set_back,
        kinds.dying_in_a_solve,
    ]  # fmt: skip
    for fault in single:
        yield fault(base)
    yield from kinds.server_faults(base)
    yield kinds.corrupted_checkpoint(base, drawn)
    yield kinds.kills_of_motions(base, max(kills // 3, 1), drawn)
    yield kinds.kills_of_studies(base, max(kills // 3, 1), drawn, 0)
    yield kinds.kills_of_studies(base, max(kills - 2 * (kills // 3), 1), drawn, 2)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=500, help="SIGKILLs in all [500]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/faults"))
    options = parser.parse_args()
    begun, found = time.monotonic(), []
    base = Path(tempfile.mkdtemp(prefix="magmpm-faults-"))
    base.chmod(0o755)
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"{'fault':<38} {'injected':>8} {'completed':>9} {'lost':>4}  what was said", flush=True)
    try:
        for row in rows(base, options.kills, random.Random(options.seed)):
            found.append(row)
            print(f"{row.kind:<38} {row.injected:>8} {row.completed:>9} {row.lost:>4}  {'; '.join(row.said)[:110]}", flush=True)
            for what in row.wrong:
                print(f"    WRONG: {what}", flush=True)
            table = {"seconds": time.monotonic() - begun, "seed": options.seed, "rows": [asdict(one) for one in found]}
            (options.out / "faults.json").write_text(json.dumps(table, indent=1) + "\n")
    finally:
        shutil.rmtree(base, ignore_errors=True)
    lost, wrong = sum(row.lost for row in found), sum(len(row.wrong) for row in found)
    print(f"{sum(row.injected for row in found)} faults, {sum(row.completed for row in found)} completed trials and frames looked at, "
          f"{lost} lost, {wrong} wrong, {time.monotonic() - begun:.0f} s")  # fmt: skip
    return 1 if lost or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
