"""`python -m random_scenes N --seed S`: draw, solve and check N scenes. Exit status 3 if one is wrong, hangs, is refused or ends with a
traceback.
"""

import argparse
import json
import sys
from pathlib import Path

from magmpm.errors import InputError
from random_scenes.suite import BROKEN, random_table, run_random


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="random_scenes", description=__doc__)
    parser.add_argument("count", type=int, metavar="N", help="scenes, 1 or more")
    parser.add_argument("--seed", type=int, default=0, help="the same seed draws the same ones [0]")
    parser.add_argument("--out", type=Path, help="folder; begun again, it goes on [runs/random-S]")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(given)
    if options.count < 1 or options.seed < 0:
        parser.error("N must be 1 or more, and the seed 0 or more")
    folder = options.out or Path("runs") / f"random-{options.seed}"
    try:
        summary = run_random(options.count, options.seed, folder, on_done=_tell)
    except InputError as error:
        parser.error(str(error))
    print(json.dumps(summary) if options.json else random_table(summary))
    return 3 if any(summary[end] for end in BROKEN) else 0


def _tell(done: int, count: int) -> None:
    if done % 10 == 0 or done == count:
        print(f"{done} of {count} scenes", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
