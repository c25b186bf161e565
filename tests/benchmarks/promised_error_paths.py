"""True error over promised error along paths drawn at random: at every equilibrium but those around a jump, of which no error is told.

    python tests/benchmarks/promised_error_paths.py [--first SEED] [--scenes N] [--out FILE]

Each path (drawn_scenes.along_path) is asked for an error of 0.05 to 20 % of the length, and run again on the chosen cells and on MORE of
them. Printed: the largest ratio of the difference to the error_estimate, and when.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from drawn_scenes import along_path

from magmpm import run
from magmpm.errors import MagmpmError
from magmpm.results.frames import near_jumps
from magmpm.scene import Scene
from magmpm.scene.time_limit import limited
from magmpm.solving.several_grids import Runs

FIRST, SCENES = 6000, 40
MORE = 3  # cells across
LIMIT = 60.0  # s of processor time for a run
BOUNDS, WORST = (0.3, 1.0), 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--out", type=Path, default=Path("runs/bench/promised_error_paths.json"))
    options = parser.parse_args()
    rows = json.loads(options.out.read_text()) if options.out.exists() else []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {row["seed"] for row in rows}
    for seed in range(options.first, options.first + options.scenes):
        if seed not in done:
            rows.append(judged(along_path(seed), seed))
            options.out.write_text(json.dumps(rows, indent=1) + "\n")
            print(told(rows[-1]), flush=True)
    print(summary(rows))


def judged(scene: Scene, seed: int) -> dict[str, Any]:
    """One path: the largest true over the promised error, or why there is none."""
    row: dict[str, Any] = {"seed": seed, "slenderness": scene.length / scene.thickness, "of": scene.resolution.of}
    try:
        with limited(LIMIT, process_time):
            result = run(scene)
        assert result.resolution is not None
        assert result.error_estimate is not None
        cells = row["cells"] = result.resolution["cells_across"]
        row |= {"promised": result.error_estimate / scene.length, "jumps": len(result.jumps)}
        row |= {"largest_at": result.resolution["largest_at"], "seconds": result.seconds["setup"] + result.seconds["solve"]}
        runs = Runs(scene)
        for n in (cells, cells + MORE):
            with limited(LIMIT, process_time):
                runs.solve(n)
    except MagmpmError as error:
        return {**row, "failed": str(error)}
    skip = [*near_jumps(runs.frames[cells], runs.frames[cells + MORE]), *map(tuple, result.resolution["unknown"])]
    off = runs.frames[cells].distances(runs.frames[cells + MORE], scene.resolution.of, skip)
    row["at"] = max(off, key=lambda t: off[t])
    return {**row, "ratio": off[row["at"]] / result.error_estimate, "answer_seconds": runs.solved[cells].seconds}


def told(row: dict[str, Any]) -> str:
    """A path in a line."""
    begin = f"path {row['seed']}, L/D {row['slenderness']:.1f}, {row['of']}"
    if "failed" in row:
        return f"{begin}: {row['failed'][:200]}"
    jumps = f", {row['jumps']} jumps" if row["jumps"] else ""
    ratio = f"true/promised {row['ratio']:.2f} at {row['at']:.4g} s"
    return f"{begin}: {row['cells']} cells, promised {100 * row['promised']:.4f} %, {ratio}{jumps}"


def summary(rows: list[dict[str, Any]]) -> str:
    """What all paths say together."""
    ratio = np.array([row["ratio"] for row in rows if "ratio" in row])
    inside = (ratio >= BOUNDS[0]) & (ratio <= BOUNDS[1])
    return (
        f"{len(rows)} paths, {len(ratio)} judged: largest true/promised in {BOUNDS} in {100 * inside.mean():.0f} %, above {WORST}: "
        f"{(ratio > WORST).sum()}, above 1: {(ratio > 1).sum()}, median {np.median(ratio):.2f}, largest {ratio.max():.2f}"
    )


if __name__ == "__main__":
    main()
