"""Broken study files: a good study with its scene and target, and for each case one edit that breaks it, with the required message.

`CASES` is data, so that `load_study` and the command are tested with the same files. `write(case, folder)` writes the
files and returns the path of the study.
"""

from dataclasses import dataclass
from pathlib import Path

# ruff: noqa: E501  (a case a line reads best)
# fmt: off

GOOD = """\
scene: scene.yaml
vary:
  magnetization: {}
  field: {max: 10 mT}
match:
  centreline: target.csv
trials: 35
sampler: tpe
seed: 1
stop: {rms: 2 mm}
"""

SCENE = """\
name: probe
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  catheter:
    length: 40 mm
    diameter: 4 mm
    material: magnetic
    segments: [{magnetization: [1, 0, 0]}, {magnetization: [0, 1, 0]}]
field: {uniform: [0 mT, 6 mT, 8 mT]}
effects: {magnetic_torque: {}}
"""

TARGET = "s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n20,19.5,0,4\n40,37,0,13\n"

FILES = {"study.yaml": GOOD, "scene.yaml": SCENE, "target.csv": TARGET}


@dataclass(frozen=True)
class BadStudy:
    """One error in a study.

    edit: (old, new) in `file`, once; new None: the file is missing. says: phrases of the message; study: the study file before
    the edit.
    """

    name: str
    edit: tuple[str, str | None]
    says: tuple[str, ...]
    file: str = "study.yaml"
    study: str = GOOD


CASES = [
    # keys and values
    BadStudy("unknown key", ("trials: 35", "trails: 35"), ("study.yaml:7: trails", "unknown key", 'did you mean "trials"?')),
    BadStudy("key of another part", ("trials: 35", "rms: 2 mm"), ("study.yaml:7: rms", "it belongs in stop")),
    BadStudy("key twice", ("seed: 1", "seed: 1\nseed: 2"), ("study.yaml:10", "seed", "a second time")),
    BadStudy("no scene", ("scene: scene.yaml\n", ""), ("scene: received nothing", "required", "write, say, `scene:")),
    BadStudy("no match", ("match:\n  centreline: target.csv\n", ""), ("match: received nothing", "required")),
    BadStudy("no trials", ("trials: 35", "trials: 0"), ("study.yaml:7: trials: received 0", "at least 1", "trials: 35")),
    BadStudy("half a trial", ("trials: 35", "trials: 35.5"), ("trials: received 35.5", "whole number")),
    BadStudy("trials in quotes", ("trials: 35", 'trials: "35"'), ('trials: received "35"', "whole number", "without quotes")),
    BadStudy("negative seed", ("seed: 1", "seed: -1"), ("seed: received -1", "at least 0")),
    BadStudy("unknown sampler", ("sampler: tpe", "sampler: tep"), ('sampler: received "tep"', "tpe, gp, cmaes, nsga2, random, gauss-newton, or optuna:NAME", 'did you mean "tpe"?')),
    BadStudy("sampler by another name", ("sampler: tpe", "sampler: annealing"), ('received "annealing"', "write, say, `sampler: tpe`")),
    BadStudy("Optuna's sampler nearly", ("sampler: tpe", "sampler: optuna:nsga2"), ('received "optuna:nsga2"', "NSGAIISampler or NSGAIIISampler", 'did you mean "optuna:NSGAIISampler"?')),
    BadStudy("Optuna's sampler without its mark", ("sampler: tpe", "sampler: QMCSampler"), ('received "QMCSampler"', 'write "optuna:QMCSampler"')),
    BadStudy("sampler of any module", ("sampler: tpe", "sampler: optuna:os.system"), ("NAME of optuna:NAME must be TPESampler", "write, say, `sampler: optuna:TPESampler`")),
    BadStudy("sampler of grids", ("sampler: tpe", "sampler: optuna:GridSampler"), ("Optuna's GridSampler needs a grid of values", "optuna:QMCSampler")),
    BadStudy("sampler of all values", ("sampler: tpe", "sampler: optuna:brute-force"), ("Optuna's BruteForceSampler tries every value",)),
    BadStudy("stop without a unit", ("rms: 2 mm", "rms: 2"), ("stop.rms: received 2", "unit", '"40 mm"')),
    BadStudy("stop in another unit", ("rms: 2 mm", "rms: 2 mT"), ('stop.rms: received "2 mT"', "length")),
    BadStudy("stop at nothing", ("rms: 2 mm", "rms: 0 mm"), ("stop.rms", "greater than 0 mm")),
    BadStudy("stop is no mapping", ("stop: {rms: 2 mm}", "stop: 2 mm"), ("stop: received", "must be a mapping")),
    BadStudy("stop left empty", ("stop: {rms: 2 mm}", "stop:"), ("stop: received nothing", "must have a value")),
    # varied quantities
    BadStudy("vary nothing", ("vary:\n  magnetization: {}\n  field: {max: 10 mT}\n", "vary: {}\n"), ("study.yaml:2: vary", "must vary something", "`magnetization: {}`")),
    BadStudy("vary what it can't", ("  magnetization: {}", "  density: {}"), ("vary.density", "unknown key", "magnetization, length, order, numbers, field, diameter")),
    BadStudy("field without a limit", ("field: {max: 10 mT}", "field: {}"), ("vary.field.max: received nothing", "`max: 10 mT`")),
    BadStudy("no field at most", ("max: 10 mT", "max: 0 mT"), ("vary.field.max", "greater than 0 mT")),
    BadStudy("settings where there are none", ("magnetization: {}", "magnetization: {angles: 2}"), ("vary.magnetization.angles", "unknown key")),
    BadStudy("least above greatest", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  length: {min: 12 mm, max: 4 mm}"), ("study.yaml:5: vary.length.max: received", "max must be greater than min: max is 0.004 m, min 0.012 m", "exchange them")),
    BadStudy("one value is no range", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  diameter: {min: 4 mm, max: 4 mm}"), ("vary.diameter.max", "max must be greater than min", "write it in the scene")),
    BadStudy("lengths that can't sum", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  length: {min: 4 mm, max: 12 mm}"), ("study.yaml:5: vary.length: received 4 to 12 mm", "2 segments of this length are 8 to 24 mm long", "the body's length, 40 mm", "total: free")),
    BadStudy("lengths in another unit", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  length: {min: 4 kPa, max: 12 mm}"), ("vary.length.min", "length")),
    BadStudy("diameter beyond the length", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  diameter: {min: 2 mm, max: 60 mm}"), ("study.yaml:5: vary.diameter", "the length must be 1 to 500 times the diameter", "diameter 60 mm")),
    BadStudy("remanence beyond all magnets", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  remanence: {min: 0 mT, max: 4 T}"), ("vary.remanence.max", "at most 3 T", "4 T")),
    BadStudy("order of one kind", ("field: {max: 10 mT}", "field: {max: 10 mT}\n  order: {}"), ("study.yaml:5: vary.order", "all 2 of the scene's are magnetized")),
    BadStudy("field at each depth without depths", ("field: {max: 10 mT}", "field: {max: 10 mT, at: each depth}"), ("study.yaml:4: vary.field.at", "needs an insertion")),
    BadStudy("field at each time without times", ("field: {max: 10 mT}", "field: {max: 10 mT, at: each time}"), ("study.yaml:4: vary.field.at", "needs a schedule")),
    BadStudy("field at no known time", ("field: {max: 10 mT}", "field: {max: 10 mT, at: noon}"), ("vary.field.at: received \"noon\"", "each depth")),
    # what goes together
    BadStudy("insertion without a path", ("trials: 35", "insertion: {depths: 12}\ntrials: 35"), ("study.yaml:7: insertion", "an insertion follows a path")),
    BadStudy("depths that fall", ("trials: 35", "insertion: {depths: [20 mm, 10 mm]}\ntrials: 35"), ("insertion.depths[1]", "depths must rise: 10 mm follows 20 mm")),
    BadStudy("no depths", ("trials: 35", "insertion: {depths: 0}\ntrials: 35"), ("insertion.depths: received 0", "1 to 200 depths")),
    BadStudy("depth below a diameter", ("trials: 35", "insertion: {depths: [2 mm, 10 mm]}\ntrials: 35"), ("insertion.depths", "received 2 mm", "at least one diameter of the catheter, 4 mm"), study=GOOD.replace("centreline: target.csv", "path: target.csv")),
    BadStudy("depths by name", ("trials: 35", "insertion: {depths: many}\ntrials: 35"), ("insertion.depths: received \"many\"", "or a list of lengths")),
    BadStudy("path without an insertion", ("  centreline: target.csv", "  path: target.csv"), ("study.yaml:6: match.path", "a path is followed by an insertion")),
    BadStudy("path and centreline", ("  centreline: target.csv", "  centreline: target.csv\n  path: target.csv"), ("study.yaml:5: match", "give `centreline` or `path`, one of them", "keep one")),
    BadStudy("schedule of one shape", ("trials: 35", "schedule: {}\ntrials: 35"), ("study.yaml:7: schedule", "shapes at given times")),
    BadStudy("times that fall", ("match:\n  centreline: target.csv", "schedule: {}\nmatch: [{time: 2 s, centreline: target.csv}, {time: 1 s, centreline: target.csv}]"), ("match[1].time", "times must rise: 1 s follows 2 s")),
    BadStudy("shape without its time", ("match:\n  centreline: target.csv", "schedule: {}\nmatch: [{centreline: target.csv}]"), ("match[0].time: received nothing", "required")),
    BadStudy("robust over time", ("match:\n  centreline: target.csv", "robust: {direction: 5 deg}\nschedule: {}\nmatch: [{time: 2 s, centreline: target.csv}]"), ("robust", "judges one equilibrium", "a schedule has several"), study=GOOD.replace("max: 10 mT", "max: 10 mT, at: each time")),
    BadStudy("schedule of a fixed field", ("match:\n  centreline: target.csv", "schedule: {}\nmatch: [{time: 2 s, centreline: target.csv}]"), ("a schedule varies the field at each time", "at: each time")),
    BadStudy("schedule in a changing field", ("field: {uniform: [0 mT, 6 mT, 8 mT]}", "field: {uniform: [0 mT, 6 mT, 8 mT], over_time: {ramp: {duration: 1 s}}}"), ("study.yaml:1: scene", "a schedule makes the field over time itself"), file="scene.yaml", study=GOOD.replace("max: 10 mT", "max: 10 mT, at: each time").replace("match:\n  centreline: target.csv", "schedule: {}\nmatch: [{time: 2 s, centreline: target.csv}]")),
    BadStudy("two objectives alike", ("trials: 35", "minimize: [rms, rms]\ntrials: 35"), ("study.yaml:7: minimize", "the first objective is rms, the second another")),
    BadStudy("an objective there is not", ("trials: 35", "minimize: [rms, beauty]\ntrials: 35"), ("minimize[1]: received \"beauty\"", "largest_field")),
    BadStudy("robust against nothing", ("trials: 35", "robust: {}\ntrials: 35"), ("study.yaml:7: robust", "an error that is not zero")),
    BadStudy("percentage without a sign", ("trials: 35", "robust: {remanence: 5}\ntrials: 35"), ("robust.remanence: received 5", "a percentage needs a unit")),
    BadStudy("percentage in degrees", ("trials: 35", "robust: {remanence: 5 deg}\ntrials: 35"), ("robust.remanence", "a percentage is expected here")),
    BadStudy("all of the remanence", ("trials: 35", "robust: {remanence: 100 %}\ntrials: 35"), ("robust.remanence", "at most 50 %")),
    BadStudy("margin of more than all", ("trials: 35", "stability: {margin: 1.5}\ntrials: 35"), ("stability.margin: received 1.5", "less than 1")),
    BadStudy("limits of nothing", ("trials: 35", "limits: {}\ntrials: 35"), ("study.yaml:7: limits", "must limit something")),
    BadStudy("limits that repeat", ("trials: 35", "limits: {directions: [[1, 0, 0], [2, 0, 0]]}\ntrials: 35"), ("limits.directions", "each direction must be there once")),
    BadStudy("limits that leave one design", ("trials: 35", "limits: {directions: [[1, 0, 0]]}\ntrials: 35"), ("limits.directions", "leaves one design", "two directions or more"), study=GOOD.replace("  field: {max: 10 mT}\n", "")),
    BadStudy("a direction of zeros", ("trials: 35", "limits: {directions: [[0, 0, 0]]}\ntrials: 35"), ("limits.directions[0]", "must not be zero")),
    BadStudy("start from elsewhere", ("trials: 35", "start: beam\ntrials: 35"), ("start: received \"beam\"", "rod")),
    # the named scene
    BadStudy("missing scene", ("", None), ("scene.yaml: no such file", "named in", "study.yaml:1: scene"), file="scene.yaml"),
    BadStudy("scene is a folder", ("scene: scene.yaml", "scene: ."), ("this is a folder", "named in", "study.yaml:1: scene")),
    BadStudy("broken scene", ("length: 40 mm", "length: 40"), ("scene.yaml:6: body.catheter.length", "unit", "study.yaml:1: scene"), file="scene.yaml"),
    BadStudy("scene that asks for a time", ("effects: {magnetic_torque: {}}", "effects: {magnetic_torque: {}}\nresolution: {seconds: 2 s}"), ("study.yaml:1: scene", "not a time", "cells_across: 4"), file="scene.yaml"),
    BadStudy("scene without torque", ("effects: {magnetic_torque: {}}", "effects: {gravity: {}}"), ("study.yaml:1: scene", "magnetic_torque"), file="scene.yaml"),
    BadStudy("scene without magnets", ("segments: [{magnetization: [1, 0, 0]}, {magnetization: [0, 1, 0]}]", "segments: [{}]"), ("segment with a magnetization",), file="scene.yaml"),
    # the named target
    BadStudy("missing target", ("", None), ("target.csv: no such file", "study.yaml:6: match.centreline"), file="target.csv"),
    BadStudy("target without a header", ("s_mm,x_mm,y_mm,z_mm\n", ""), ("target.csv:1", "s_mm,x_mm,y_mm,z_mm", "study.yaml:6: match.centreline"), file="target.csv"),
    BadStudy("target of words", ("19.5", "far"), ("target.csv:3", "numbers", "study.yaml:6: match.centreline"), file="target.csv"),
    BadStudy("target too long", ("40,37,0,13", "50,47,0,13"), ("target.csv", "received s_mm up to 50", "the catheter's length, 40 mm"), file="target.csv"),
    BadStudy("target elsewhere", ("\n0,0,0,0", "\n0,0,0,5"), ("mm at s = 0", "must start at the catheter's base"), file="target.csv"),
    BadStudy("target that stretches", ("40,37,0,13", "40,37,0,33"), ("33.87 mm apart at s_mm = 20 and 40", "further apart"), file="target.csv"),
    BadStudy("target along another axis", ("20,19.5,0,4\n40,37,0,13", "20,-0.5,0,60\n40,0,0,120"), ("apart", "leaves the base along +x"), file="target.csv"),
    BadStudy("target in metres", ("20,19.5,0,4\n40,37,0,13", "20,0.0195,0,0.004\n40,0.037,0,0.013"), ("along 40 mm of catheter", "in mm"), file="target.csv"),
    BadStudy("target of one point", ("20,19.5,0,4\n40,37,0,13", "40,37,0,13"), ("target.csv", "received 1 point beyond the base", "at least 2 points beyond the base"), file="target.csv"),
    BadStudy("volume that nothing changes", ("trials: 35", "minimize: [rms, magnetized_volume]\ntrials: 35"), ("study.yaml:7: minimize", "magnetized_volume is that of `length` and `diameter`", "diameter")),
    BadStudy("robust in motion", ("effects: {magnetic_torque: {}}", "effects: {magnetic_torque: {}}\nsolver: {dynamic: {duration: 1 s}}"), ("study.yaml:1: scene", "robust differentiates equilibria"), file="scene.yaml", study=GOOD + "robust: {direction: 5 deg}\n"),
    BadStudy("stability in motion", ("effects: {magnetic_torque: {}}", "effects: {magnetic_torque: {}}\nsolver: {dynamic: {duration: 1 s}}"), ("study.yaml:1: scene", "stability asks for equilibria", "leave `dynamic` out"), file="scene.yaml", study=GOOD + "stability: {margin: 0.1}\n"),
    BadStudy("insertion in motion", ("effects: {magnetic_torque: {}}", "effects: {magnetic_torque: {}}\nsolver: {dynamic: {duration: 1 s}}"), ("study.yaml:1: scene", "an insertion asks for equilibria"), file="scene.yaml", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path beyond the catheter", ("40,37,0,13", "50,46,0,16"), ("target.csv", "received s_mm up to 50", "length, 40 mm"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path off the guide", ("\n0,0,0,0", "\n0,0,3,0"), ("target.csv", "mm at s = 0", "the origin"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path with a kink", ("40,37,0,13", "20.5,19.5,0.5,4\n40,37,5,12"), ("target.csv", "a bend of", "at s_mm = 20", "sharper than the catheter's diameter allows", "4 mm"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path that leaves sideways", ("20,19.5,0,4\n40,37,0,13", "3,0,0,3\n40,0,0,40"), ("a bend of 90 deg at s_mm = 0", "leave the guide along +x"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("depths beyond the path", ("40,37,0,13", "30,29,0,8"), ("received a path up to s_mm = 30", "the last one is 35 mm"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: [10 mm, 35 mm]}\n"),
    BadStudy("path below a diameter", ("\n20,19.5,0,4\n40,37,0,13", "\n1,1,0,0\n2,2,0,0"), ("received a path up to s_mm = 2", "at least one diameter of the catheter long, 4 mm"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path that is bent between its points", ("\n20,19.5,0,4\n40,37,0,13", "\n14,0,0,14\n28,0,0,28"), ("whose smooth curve, which leaves the guide along +x, has a radius of", "4 mm"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path whose s is not its length", ("\n20,19.5,0,4\n40,37,0,13", "\n20,15,0,1\n40,30,0,2"), ("received s_mm up to 40 for a curve that is", "s_mm is the length along the path, to 5 %"), file="target.csv", study=GOOD.replace("centreline: target.csv", "path: target.csv") + "insertion: {depths: 4}\n"),
    BadStudy("path is a list", ("centreline: target.csv", "centreline: [target.csv]"), ("match.centreline", "must be text")),
    BadStudy("no YAML", ("vary:", "vary: {"), ("study.yaml:2", "YAML")),
    BadStudy("empty", (GOOD, ""), ("study.yaml: the file is empty",)),
    BadStudy("no file", ("", None), ("study.yaml: no such file",)),
]


def write(case: BadStudy, folder: Path) -> Path:
    """Writes the files of a case in a folder. Returns the path of the study."""
    for name, text in {**FILES, "study.yaml": case.study}.items():
        old, new = case.edit
        if name == case.file:
            if new is None:
                continue
            assert text.count(old) == 1, f"{case.name}: the edit must apply exactly once"
            text = text.replace(old, new)
        (folder / name).write_text(text)
    return folder / "study.yaml"
