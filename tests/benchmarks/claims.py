"""`make claims`: measures every figure of the README and the docs again, and reports differences.

    python tests/benchmarks/claims.py [--quick] [--write] [GROUP ...]

docs/claims.yaml lists the figures in groups: the page, its text with the names of the figures in braces, and the tolerance. Each group
names the command that produces its figures; the function with its name here measures them. `--quick` skips the groups that take minutes;
`--write` puts new figures into the pages, with the same digits, and draws docs/images/accuracy.png again. Exit status 1 if a figure
differs. Times and rates have large tolerances, because they also depend on the machine.

tests/unit/project/test_claims.py checks that every figure of the list is on its page, and that the tests it names exist.
"""

import argparse
import functools
import importlib
import json
import math
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from magmpm import model
from magmpm.results.measures import largest_distance
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run, sensitivities

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))
from reference.in_motion import moving  # noqa: E402
from reference.problems import finite_element_problems  # noqa: E402
from reference.scenes import field_for_load, rod_scene  # noqa: E402

PROBLEMS = finite_element_problems(ROOT / "data/references/fem.json")
TABLE = "docs/claims.yaml"
FIGURE = r"[-+]?\d[\d ]*(?:\.\d+)?(?:e[-+]?\d+)?"  # 23 328, 0.009, 5e-7
ACCURACY_SCENE = "data/scenes/five_segments.yaml"
ACCURACY_IMAGE = "docs/images/accuracy.png"

Figures = dict[str, float]


@dataclass(frozen=True)
class Claim:
    """A figure on a page. name: its key in the result of the group's function; tolerance: relative difference allowed."""

    group: str
    page: str
    name: str
    text: str  # as on the page
    tolerance: float

    @property
    def value(self) -> float:
        return float(self.text.replace(" ", ""))

    @property
    def rounding(self) -> float:
        """Half of the last written digit."""
        digits, _, power = self.text.replace(" ", "").partition("e")
        places = len(digits.partition(".")[2])
        return 0.5 * 10.0 ** (int(power or 0) - places)

    def agrees(self, measured: float) -> bool:
        """Return True if the page agrees with the measurement, within its digits and the tolerance."""
        return (
            abs(measured - self.value)
            <= self.tolerance * max(abs(measured), abs(self.value)) + 1.001 * self.rounding
        )

    def written(self, measured: float) -> str:
        """The measured value with the digits of the page; with one more digit if otherwise none would remain."""
        if "e" in self.text:
            digits = len(self.text.split("e")[0].replace(".", "").lstrip("-"))
            number, power = f"{measured:.{digits - 1}e}".split("e")
            return f"{number}e{int(power)}"
        places = len(self.text.partition(".")[2])
        while measured and places < 9 and abs(measured) < 0.5 * 10.0**-places:
            places += 1
        return f"{measured:,.{places}f}".replace(",", " ")


@dataclass(frozen=True)
class Place:
    """A text of a page that contains figures: the pattern, and the names of its figures in order."""

    group: str
    page: str
    text: str
    tolerance: float

    @property
    def names(self) -> list[str]:
        return re.findall(r"\{([^}]*)\}", self.text)

    @property
    def pattern(self) -> re.Pattern[str]:
        """The text with any figures, and with its lines broken anywhere."""
        parts = re.split(r"\{[^}]*\}", self.text)
        text = f"({FIGURE})".join(re.escape(part) for part in parts)
        return re.compile(re.sub(r"\\\s", r"\\s+", text))

    def found(self, root: Path = ROOT) -> re.Match[str]:
        """Its match on the page. Raises ValueError unless it is there exactly once."""
        page = (root / self.page).read_text(encoding="utf-8")
        matches = list(self.pattern.finditer(page))
        if len(matches) != 1:
            raise ValueError(
                f"{self.page}: the text {self.text!r} of {TABLE} is there {len(matches)} times; it"
                " must be there once"
            )
        return matches[0]

    def claims(self, root: Path = ROOT) -> list[Claim]:
        """Its figures as on the page."""
        match = self.found(root)
        return [
            Claim(self.group, self.page, name, text, self.tolerance)
            for name, text in zip(self.names, match.groups(), strict=True)
        ]


def groups(root: Path = ROOT) -> dict[str, dict[str, Any]]:
    """The table: for each group its `command`, `slow` and `figures`, or the test in `held_by`."""
    found: dict[str, dict[str, Any]] = yaml.safe_load((root / TABLE).read_text(encoding="utf-8"))
    return found


def places(name: str, group: Mapping[str, Any]) -> Iterator[Place]:
    """The texts of a group."""
    for page, texts in group["figures"].items():
        for entry in texts:
            text, tolerance = (
                (entry, group.get("tolerance", 0.1))
                if isinstance(entry, str)
                else (entry["text"], entry["tolerance"])
            )
            yield Place(name, page, text, float(tolerance))


# For each group a function with its name, without arguments, that returns the figures in the units of the pages.


def accuracy() -> Figures:
    """The cell sizes on the page about accuracy; errors in % of L."""
    found: Figures = {}
    for rung in _ladder()["rungs"]:
        n = rung["cells_across"]
        found |= {
            f"unknowns {n}": rung["dof"],
            f"seconds {n}": rung["seconds"],
            f"error {n}": 100 * (rung["error_finest"] or 0.0),
        }
    return found


def seconds() -> Figures:
    """The times of the same table, s."""
    return accuracy()


@functools.cache
def _ladder() -> dict[str, Any]:
    from magmpm.studies.explore.accuracy import climb

    return climb(load_scene(ROOT / ACCURACY_SCENE), run).summary()


def references() -> Figures:
    """Statics against the finite-element references: smallest and largest error in % of L, order from 4 to 8 cells, Newton steps."""
    errors: dict[int, list[float]] = {4: [], 6: [], 8: []}
    orders = []
    steps = 0
    for problem in PROBLEMS.values():
        for n, row in errors.items():
            result = run(problem.scene(n))
            row.append(100 * largest_distance(result, problem.centreline) / problem.length)
            steps = max(steps, result.iterations)
        orders.append(
            -np.polyfit(np.log(list(errors)), np.log([row[-1] for row in errors.values()]), 1)[0]
        )
    found: Figures = {"least order": min(orders), "largest order": max(orders), "steps": steps}
    for n, row in errors.items():
        found |= {f"least {n}": min(row), f"largest {n}": max(row)}
    return found


def asked() -> Figures:
    """The five-segment catheter, asked for errors in % of L: cells across, and what it is told to be right to, % of L."""
    scene = load_scene(ROOT / ACCURACY_SCENE)
    found = {}
    for percent in (1.0, 0.1, 0.02):
        result: Any = run(Scene.from_si({**scene.to_si(), "resolution": {"error": percent / 100}}))
        found[f"cells {percent:g}"] = float(result.resolution["cells_across"])
        found[f"told {percent:g}"] = 100 * result.error_estimate / scene.length
    return found


def promised() -> Figures:
    """True error over the promised one, against finite elements, asked for 1 and 0.1 % of L."""
    found: Figures = {}
    for name, problem in PROBLEMS.items():
        for percent in (1.0, 0.1):
            result = run(
                Scene.from_si({**problem.scene(2).to_si(), "resolution": {"error": percent / 100}})
            )
            found[f"{name} {percent:g}"] = largest_distance(result, problem.centreline) / float(
                result.error_estimate or 0.0
            )
    return found


def insertion() -> Figures:
    """Body rms and exit error (mm) of the first trajectory of both paths."""
    import tempfile

    from magmpm.studies.engine.loop import run_study
    from magmpm.studies.search.definition import load_study

    found: Figures = {}
    for name, file in (("planar", "insertion_s"), ("spatial", "insertion_spatial")):
        with tempfile.TemporaryDirectory() as folder:
            study = load_study(ROOT / f"data/studies/{file}.yaml")
            best = (
                run_study(study, solve=run, differentiate=sensitivities, out=folder, trials=1).best
                or {}
            )
        found |= {f"{name} rms": 1e3 * best["rms_m"], f"{name} exit": 1e3 * best["exit_error_m"]}
    return found


def locking() -> Figures:
    """Anti-locking of docs/design.md on axial_transverse_5mT: none, the linear part of J with at most 10 G, 5 G; errors in % of L."""
    problem = PROBLEMS["axial_transverse_5mT"]
    usual = model.LINEAR_STIFFNESS
    found = {}
    try:
        for name, kind, stiffness in (
            ("none", "none", usual),
            ("10 G", "f-bar", 10.0),
            ("5 G", "f-bar", 5.0),
        ):
            model.LINEAR_STIFFNESS = stiffness
            for n in (3, 4, 6, 8):
                result = run(problem.scene(n, anti_locking=kind))
                found[f"{name} {n}"] = (
                    100 * largest_distance(result, problem.centreline) / problem.length
                )
    finally:
        model.LINEAR_STIFFNESS = usual
    return found


def mapped() -> Figures:
    """Seconds of a map of 1 000 fields, and Newton steps a field."""
    from magmpm.studies.explore.live import ready
    from magmpm.studies.explore.tip_map import map_tips, on_rays

    found = map_tips(ready(load_scene(ROOT / ACCURACY_SCENE)), on_rays(1000, 20e-3))
    return {"steps": found.newton_steps / len(found.tip), "seconds": found.seconds}


def begins() -> Figures:
    """Seconds until the slowest command could begin its work."""
    startup: Any = importlib.import_module("startup")
    startup.REPEATS = 2  # a minute in place of two and a half
    startup.main()
    rows = json.loads((ROOT / "runs/bench/startup.json").read_text(encoding="utf-8"))
    return {"begun": max(row["wall_s"] for row in rows)}


def sampler() -> Figures:
    """The first trial (from 1) within 2 mm, by target and seed, and the hits of seeds 1 to 10; 36 if none of 35 hits."""
    rows_of = importlib.import_module("sampler").rows_of
    found = {}
    for name, letter in (("c_shape", "C"), ("s_shape", "S")):
        reached = [row["reached_in"] or 36 for row in rows_of("tpe", name, 10)]
        found |= {f"{letter} {seed}": trial for seed, trial in enumerate(reached, start=1)}
        found |= {
            f"{letter} least": min(reached[:5]),
            f"{letter} most": max(reached[:5]),
            f"{letter} hits": sum(k <= 35 for k in reached),
        }
    return found


def trial() -> Figures:
    """Seconds that a trial of the S-shape study takes, with its storage and picture."""
    return {"seconds": importlib.import_module("bench").trial()}


def designs() -> Figures:
    """Solves (median) that Gauss-Newton needs to 0.5 mm of the twelve shapes that finite elements made."""
    design = importlib.import_module("design")
    files = sorted(design.TARGETS.glob("reachable_*.csv"))
    studies = [
        design.cached(
            design.study_of(file, "gauss-newton", design.MOST["gauss-newton"]), design.sources()
        )
        for file in files
    ]
    return {"targets": len(files), "solves": design.summary(studies)["0.5 mm"]["solves"][0]}


def robust() -> Figures:
    """Scatter and mean plus two sigma (mm) of designs made with errors: to first order, and of 300 solves."""
    robust = importlib.import_module("robust")
    robust.main()
    found: Figures = {}
    for row in json.loads((ROOT / "runs/bench/robust.json").read_text()):
        name = row["design"]
        first = row["first_order_m"]
        sampled = row["sampled_m"]
        found |= {
            f"rms {name}": 1e3 * row["rms_m"],
            f"scatter {name}": 1e3 * first[0],
            f"measure {name}": 1e3 * first[3],
        }
        found |= {
            f"sampled scatter {name}": 1e3 * sampled[0],
            f"sampled measure {name}": 1e3 * sampled[3],
        }
        found |= {
            f"apart {name}": 100 * row["apart"][0],
            f"measure apart {name}": 100 * row["apart"][3],
        }
    return found


def stability() -> Figures:
    """Hard cases, including the long ones: each measure by the name of the case, also in percent."""
    return _cases(slow=True)


def stability_quick() -> Figures:
    """The hard cases that do not take long."""
    return _cases(slow=False)


def _cases(slow: bool) -> Figures:
    from magmpm.studies.hard_cases import CASES, run_cases

    cases = [case for case in CASES if case.slow == slow]
    found = {}
    for case, outcome in zip(cases, run_cases(cases), strict=True):
        found |= {case.name: outcome.measure, f"{case.name} in %": 100 * outcome.measure}
    return found


def settles() -> Figures:
    """A catheter of L/D 10 whose tip rises by half of L, after 0.3 s with damping: distance of axis and tip from statics, % of L."""
    scene = rod_scene(field=field_for_load(2.0, np.pi / 2, length=40e-3, diameter=4e-3))
    still = run(scene)
    moved = run(moving(scene, {"damping": {"rate": 60.0}}, duration=0.3))
    tip = float(np.linalg.norm(np.subtract(moved.tip, still.tip)))
    return {
        "axis": 100 * largest_distance(moved, still.centreline) / scene.length,
        "tip": 100 * tip / scene.length,
    }


def memory() -> Figures:
    """Growth of a process during a motion, in bytes per particle."""
    resident = importlib.import_module("resident")
    return {"peak": resident.grown()["peak"]}


def rates() -> Figures:
    """Million particle-steps per second, and thousand per Gflop of dgemm."""
    machine = importlib.import_module("machine")
    motion_rates = importlib.import_module("motion_rates")
    flops = machine.dgemm()
    value = motion_rates.all_threads()
    return {"rate": value / 1e6, "rate per Gflop": value / flops * 1e6}


def drawn() -> Path:
    """Draw docs/images/accuracy.png from the new measurement, with its numbers in the file for tests."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    from magmpm.viz.plots import accuracy as plot

    path = ROOT / ACCURACY_IMAGE
    ladder = _ladder()
    rungs = ladder["rungs"]
    plot(rungs, path, title="five-segment catheter", order_finest=ladder["order_finest"])
    text = PngInfo()
    text.add_text(
        "errors", json.dumps({rung["cells_across"]: rung["error_finest"] for rung in rungs})
    )
    with Image.open(path) as image:
        image.load()
        image.save(path, pnginfo=text, optimize=True)
    return path


def replaced(place: Place, measured: Figures, root: Path = ROOT) -> None:
    """Put the measured values into the page where they differ."""
    match = place.found(root)
    claims = place.claims(root)
    text = match.group(0)
    for i in range(len(claims), 0, -1):
        claim = claims[i - 1]
        if not claim.agrees(measured.get(claim.name, math.nan)) and claim.name in measured:
            begin = match.start(i) - match.start()
            end = match.end(i) - match.start()
            text = text[:begin] + claim.written(measured[claim.name]) + text[end:]
    path = root / place.page
    page = path.read_text(encoding="utf-8")
    path.write_text(page[: match.start()] + text + page[match.end() :], encoding="utf-8")


def main(arguments: list[str], root: Path = ROOT) -> int:
    """Measure, and report differences."""
    parser = argparse.ArgumentParser(
        description="Make the measured figures of README and docs again, and say what differs."
    )
    parser.add_argument(
        "groups", metavar="GROUP", nargs="*", help="only these groups of docs/claims.yaml"
    )
    parser.add_argument("--quick", action="store_true", help="leave out what takes minutes")
    parser.add_argument("--write", action="store_true", help="put new figures into the pages")
    options = parser.parse_args(arguments)
    table = {name: group for name, group in groups(root).items() if "held_by" not in group}
    if unknown := [name for name in options.groups if name not in table]:
        print(
            f"unknown groups: {', '.join(unknown)}; known are {', '.join(table)}", file=sys.stderr
        )
        return 2
    chosen = [
        name
        for name in table
        if (name in options.groups or not options.groups)
        and not (options.quick and table[name].get("slow"))
    ]
    differing = 0
    for name in chosen:
        begun = time.perf_counter()
        measure: Callable[[], Figures] = globals()[name]
        try:
            measured = measure()
        except Exception as error:  # the other groups are measured all the same
            traceback.print_exc()
            print(f"{name} ({table[name]['command']}) FAILED: {error!r}", flush=True)
            differing += 1
            continue
        print(f"{name} ({table[name]['command']}), {time.perf_counter() - begun:.0f} s", flush=True)
        for place in places(name, table[name]):
            for claim in place.claims(root):
                value = measured.get(claim.name, math.nan)  # a case that had no answer, say
                same = math.isfinite(value) and claim.agrees(value)
                differing += not same
                print(
                    f"  {'' if same else 'DIFFERS':<8}{claim.page:<20} {claim.name:<44} says"
                    f" {claim.text:>8}   now {value:.4g}"
                )
            if options.write:
                replaced(place, measured, root)
        if name == "accuracy" and options.write:
            print(f"  drawn {drawn().relative_to(ROOT)}")
    print(
        f"{differing} figure{'s differ' if differing != 1 else ' differs'}"
        + (": written anew" if options.write and differing else "")
    )
    return int(differing > 0 and not options.write)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
