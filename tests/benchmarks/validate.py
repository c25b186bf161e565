"""`make validate`: statics against every finite-element reference, for several cell sizes, with and without F-bar."""

import sys
from pathlib import Path

import numpy as np

from magmpm.errors import SolveError
from magmpm.results.measures import largest_distance
from magmpm.simulate import run

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))
from reference.problems import finite_element_problems  # noqa: E402

CELLS = (2, 3, 4, 6, 8)


def main() -> int:
    """Print the table."""
    print(
        "largest distance of the axis, % of length (Newton steps), by cells across; order fitted"
        " from 4 to 8"
    )
    print(
        f"{'case':<38}{'F-bar':>6}{'of reference':>14}"
        + "".join(f"{n:>14}" for n in CELLS)
        + f"{'order':>8}"
    )
    for name, problem in finite_element_problems(ROOT / "data/references/fem.json").items():
        for locking in ("f-bar", "none"):
            row = []
            errors = []
            for n in CELLS:
                try:
                    result = run(problem.scene(n, anti_locking=locking))
                except SolveError as error:
                    row.append(f"{error.reason[:12]:>14}")
                    continue
                errors.append(largest_distance(result, problem.centreline) / problem.length)
                row.append(f"{100 * errors[-1]:9.4f} ({result.iterations:2d})")
            known = len(errors) == len(CELLS)
            order = np.polyfit(np.log(CELLS[2:]), np.log(errors[2:]), 1)[0] if known else np.nan
            yes = "yes" if locking == "f-bar" else "no"
            print(
                f"{name:<38}{yes:>6}{100 * problem.error:14.4f}" + "".join(row) + f"{-order:8.1f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
