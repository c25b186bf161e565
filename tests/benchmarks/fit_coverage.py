"""`make bench-fit`: how often the intervals of `magmpm fit` hold the true constants, over synthetic measurements.

    python tests/benchmarks/fit_coverage.py [FITS [FIRST [poses]]]     # FIRST: number of the first: a run can be in parts

Each fit has five tips with normal errors of 0.2 mm in each coordinate, of a body whose constants are drawn within 25 % of the scene's; with
`poses`, six angles of the tip with errors of 0.5 degrees, each beside a magnet that stands elsewhere. Four kinds in turn: the shear modulus
alone, or both shear modulus and remanence, of a body with weight; the noise given, or estimated. The 95 % intervals should hold 95 % of the
true values; of n the share itself scatters by sqrt(0.95 * 0.05 / n): 0.7 % of 1 000.
"""

import math
import multiprocessing
import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import machine
import numpy as np

FIELDS = (0.0, 1.5, 3.0, 4.5, 6.0)  # mT along z
DISTANCES = (140.0, 110.0, 90.0, 80.0, 72.0, 65.0)  # mm, of a magnet's center above the base
# m, degrees
NOISE = 0.2e-3
ANGLE_NOISE = 0.5
KINDS = (("shear_modulus",), ("shear_modulus", "remanence"))


def scene(poses: bool) -> Any:
    """The scene that the fits begin with: 40 x 4 mm, magnetized along its axis, with its weight; beside a magnet."""
    from magmpm import load_scene

    found = load_scene(machine.ROOT / "data/scenes/axial_transverse.yaml").with_cells(2)
    data = found.to_si()
    data["materials"]["magnetic silicone"]["density"] = 1882.0
    if not poses:
        return type(found).from_si(data).with_effects(gravity={})
    magnet = {
        "cylinder": {"diameter": 0.02, "length": 0.02},
        "position": [0.0, 0.0, 0.1],
        "remanence": 1.3,
    }
    data["field"] = {"magnet": [magnet]}
    return type(found).from_si(data).with_effects(gravity={}, magnetic_force={})


def one(number: int, poses: str = "") -> dict[str, Any]:
    """A fit: the true values, and the intervals."""
    from magmpm import run
    from magmpm.scene.apparatus import POSITION, Apparatus
    from magmpm.studies.fitting import fit, read_measured
    from magmpm.studies.fitting.prediction import Axis, tip_angle

    rng = np.random.default_rng([11, number])
    start = scene(bool(poses))
    data = start.to_si()
    vary = KINDS[number % 2]
    material = data["materials"]["magnetic silicone"]
    for name in vary:
        material[name] *= float(np.exp(rng.uniform(-0.22, 0.22)))
    truth = {name: material[name] for name in vary}
    body = type(start).from_si(data)
    rows = ["magnet_z_mm,tip_angle_xz_deg" if poses else "field_z_mT,tip_x_mm,tip_y_mm,tip_z_mm"]
    last = None
    for size in DISTANCES if poses else FIELDS:
        noise = rng.normal(0.0, NOISE, 3)
        off = rng.normal(0.0, ANGLE_NOISE)
        there = (
            Apparatus(((POSITION, (0.0, 0.0, 1e-3 * size)),)).applied(body)
            if poses
            else body.with_field([0.0, 0.0, 1e-3 * size])
        )
        last = run(there, start=last)
        tip = 1e3 * (np.asarray(last.tip) + noise)
        angle = math.degrees(tip_angle(Axis.alone(last.centreline, last.tip), 2)[0]) + off
        rows.append(
            f"{size},{angle:.6f}" if poses else f"{size},{tip[0]:.6f},{tip[1]:.6f},{tip[2]:.6f}"
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tips.csv"
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")
        given = NOISE if number % 4 >= 2 else None
        known = (
            {"angle_noise": math.radians(ANGLE_NOISE) if given else None}
            if poses
            else {"noise": given}
        )
        found = fit(read_measured(path, start), start, vary=vary, **known, thorough=False)
    held = {}
    for each in found.constants:
        low = each.low or 0.0
        high = math.inf if each.high is None else each.high
        held[each.constant.kind] = {
            "true": truth[each.constant.kind],
            "low": low,
            "high": high,
            "method": each.method,
        }
    about = {"number": number, "noise": "given" if given else "estimated"}
    return {**about, "constants": held, "seconds": found.seconds, "solves": found.solves}


def main(fits: str = "1000", first: str = "0", poses: str = "") -> int:
    """Print the table, and write runs/bench/fit.json."""
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    begun = time.perf_counter()
    one(1, poses)  # kernels
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        done = list(
            pool.imap_unordered(
                partial(one, poses=poses), range(int(first), int(first) + int(fits)), chunksize=4
            )
        )
    groups: dict[tuple[str, str], list[bool]] = {}
    for each in done:
        for name, interval in each["constants"].items():
            held = interval["low"] <= interval["true"] <= interval["high"]
            groups.setdefault((f"{name} of {len(each['constants'])}", each["noise"]), []).append(
                held
            )
    print(f"{'constant':<24}{'noise':<12}{'intervals':>10}{'hold the truth':>16}")
    for (name, noise), held in sorted(groups.items()):
        print(f"{name:<24}{noise:<12}{len(held):>10}{100 * np.mean(held):>14.1f} %")
    every = [held for group in groups.values() for held in group]
    share = float(np.mean(every))
    scatter = math.sqrt(0.95 * 0.05 / len(every))
    seconds = float(np.median([each["seconds"] for each in done]))
    print(
        f"{len(done)} fits, {len(every)} intervals: {100 * share:.1f} % hold the truth (95 % +-"
        f" {100 * scatter:.1f} % expected)"
    )
    solves = np.median([each["solves"] for each in done])
    print(
        f"median {seconds:.2f} s and {solves:.0f} solves a fit; {time.perf_counter() - begun:.0f} s"
        " in all"
    )
    machine.save(
        f"fit{'_' * bool(poses)}{poses}",
        {"share": share, "intervals": len(every), "seconds_per_fit": seconds, "fits": done},
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
