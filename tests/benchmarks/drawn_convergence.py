"""How the discretization error falls on bodies drawn at random, none of which set any constant: `make bench-convergence`.

    python tests/benchmarks/drawn_convergence.py [--jointed] [--first SEED] [--scenes N] [--out FILE]

N scenes of drawn_scenes.py (catheters, tubes and strips, K/G 5 to 500, L/D 3 to 80; with --jointed bodies of soft and stiff
segments) are solved with 2 to 10 cells across, as far
as MOST_OPERATIONS allow. Printed, for each kind of body and range of K/G: the median and the largest error of each number of cells
against the finest, over the length, and the median order at which the errors of 2, 3, 4 and 5 cells fall; of jointed bodies the median
and the 90th percentile of all.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from drawn_scenes import drawn, jointed, options_of, rows_of

from magmpm import run
from magmpm.errors import MagmpmError
from magmpm.results.measures import largest_distance
from magmpm.scene import Scene
from magmpm.statics.grids import operations

SCENES = 100
CELLS = (2, 3, 4, 5, 6, 8, 10, 12)
MOST_OPERATIONS = 1.2e11  # of a factorization
FINEST = 6  # cells across that the finest grid has at least
STIFF = (50.0, 200.0)  # K/G between the ranges


def main() -> None:
    options = options_of(__doc__, 0, SCENES, "drawn_convergence.json", jointed=True)
    draw_scene = jointed if options.jointed else drawn
    rows = rows_of(
        options,
        lambda seed: solved(draw_scene(seed), seed),
        lambda row: f"{row['seed']} {row['errors']}",
    )
    print(percentiles(rows) if options.jointed else summary(rows))


def solved(scene: Scene, seed: int) -> dict[str, Any]:
    """Errors over the length of each number of cells against the finest."""
    results = {}
    for cells in CELLS:
        here = scene.with_cells(cells)
        if operations(here)[0] > MOST_OPERATIONS:
            break
        try:
            results[cells] = run(here)
        except MagmpmError as error:
            print(f"{seed}, {cells} cells: {error}")
    finest = max(results)
    errors = {
        n: largest_distance(result, results[finest].centreline) / scene.length
        for n, result in results.items()
        if n != finest
    }
    ratio = next(iter(scene.materials.values())).bulk_to_shear
    kind = scene.name.split("(")[1].rstrip(")")
    about = {
        "seed": seed,
        "kind": kind,
        "bulk_to_shear": ratio,
        "slender": scene.length / scene.thickness,
    }
    return {**about, "finest": finest, "errors": errors}


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """The table."""
    lines = [
        "| body | K/G | scenes | " + " | ".join(f"{n} cells" for n in CELLS[:4]) + " | order |",
        "| --- " * 8 + "|",
    ]
    for kind in ("catheter", "tube", "strip"):
        for low, high in ((0.0, STIFF[0]), STIFF, (STIFF[1], np.inf)):
            some = [
                row
                for row in rows
                if row["kind"] == kind
                and low <= row["bulk_to_shear"] < high
                and row["finest"] >= FINEST
            ]
            if not some:
                continue
            cells = []
            for n in CELLS[:4]:
                known = np.array(
                    [float(row["errors"].get(str(n), row["errors"].get(n, np.nan))) for row in some]
                )
                cells.append(f"{100 * np.nanmedian(known):.3f} ({100 * np.nanmax(known):.3f}) %")
            orders = [order(row["errors"]) for row in some]
            span = f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}"
            lines.append(
                f"| {kind} | {span} | {len(some)} | {' | '.join(cells)} | {np.median(orders):.1f} |"
            )
    return "\n".join(lines)


def percentiles(rows: Sequence[dict[str, Any]]) -> str:
    """Medians and 90th percentiles of the errors of bodies whose finest grid has at least FINEST cells across."""
    lines = [
        f"| of {len(rows)} bodies | median | 90th percentile | largest |",
        "| --- | --- | --- | --- |",
    ]
    for n in CELLS[:5]:
        known = [
            float(row["errors"].get(str(n), row["errors"].get(n, np.nan)))
            for row in rows
            if row["finest"] >= max(FINEST, n + 2)
        ]
        low, high, most = 100 * np.nanquantile(known, [0.5, 0.9, 1.0])
        lines.append(
            f"| {n} cells, {len(known)} bodies | {low:.4f} % | {high:.4f} % | {most:.4f} % |"
        )
    return "\n".join(lines)


def order(errors: dict[Any, float]) -> float:
    """The order at which the errors of 2 to 5 cells fall, by least squares."""
    known = [(float(n), error) for n, error in errors.items() if float(n) <= 5 and error > 0]
    n, error = np.log(np.array(known)).T
    return float(-np.polyfit(n, error, 1)[0])


if __name__ == "__main__":
    main()
