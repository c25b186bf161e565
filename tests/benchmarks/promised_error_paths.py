"""True error over promised error along paths drawn at random: at every equilibrium but those around a jump, of which no error is told.

    python tests/benchmarks/promised_error_paths.py [--first SEED] [--scenes N] [--out FILE]

Each path (drawn_scenes.along_path) is asked for an error of 0.05 to 20 % of the length, and run again on the chosen cells and on MORE of
them. Printed: the largest ratio of the difference to the error_estimate, and when.
"""

from time import process_time
from typing import Any

import numpy as np
from drawn_scenes import along_path, options_of, rows_of, shares

from magmpm import run
from magmpm.errors import MagmpmError
from magmpm.results.measures import near_jumps
from magmpm.scene import Scene
from magmpm.scene.time_limit import limited
from magmpm.solving.several_grids import Runs

FIRST = 6000
SCENES = 40
MORE = 3  # cells across
LIMIT = 60.0  # s of processor time for a run


def main() -> None:
    options = options_of(__doc__, FIRST, SCENES, "promised_error_paths.json")
    print(summary(rows_of(options, lambda seed: judged(along_path(seed), seed), told)))


def judged(scene: Scene, seed: int) -> dict[str, Any]:
    """One path: the largest true over the promised error, or why there is none."""
    row: dict[str, Any] = {
        "seed": seed,
        "slenderness": scene.length / scene.thickness,
        "of": scene.resolution.of,
    }
    try:
        with limited(LIMIT, process_time):
            result = run(scene)
        assert result.resolution is not None
        assert result.error_estimate is not None
        cells = row["cells"] = result.resolution["cells_across"]
        row |= {"promised": result.error_estimate / scene.length, "jumps": len(result.jumps)}
        row |= {
            "largest_at": result.resolution["largest_at"],
            "seconds": result.seconds["setup"] + result.seconds["solve"],
        }
        runs = Runs(scene)
        for n in (cells, cells + MORE):
            with limited(LIMIT, process_time):
                runs.solve(n)
    except MagmpmError as error:
        return {**row, "failed": str(error)}
    skip = [
        *near_jumps(runs.frames_on(cells), runs.frames_on(cells + MORE)),
        *map(tuple, result.resolution["unknown"]),
    ]
    off = runs.frames_on(cells).distances(runs.frames_on(cells + MORE), scene.resolution.of, skip)
    row["at"] = max(off, key=lambda t: off[t])
    return {
        **row,
        "ratio": off[row["at"]] / result.error_estimate,
        "answer_seconds": runs.solved[cells].seconds,
    }


def told(row: dict[str, Any]) -> str:
    """A path in a line."""
    begin = f"path {row['seed']}, L/D {row['slenderness']:.1f}, {row['of']}"
    if "failed" in row:
        return f"{begin}: {row['failed'][:200]}"
    jumps = f", {row['jumps']} jumps" if row["jumps"] else ""
    ratio = f"true/promised {row['ratio']:.2f} at {row['at']:.4g} s"
    return f"{begin}: {row['cells']} cells, promised {100 * row['promised']:.4f} %, {ratio}{jumps}"


def summary(rows: list[dict[str, Any]]) -> str:
    """Summary of all paths."""
    ratio = np.array([row["ratio"] for row in rows if "ratio" in row])
    return f"{len(rows)} paths, {len(ratio)} judged: largest {shares(ratio)}"


if __name__ == "__main__":
    main()
