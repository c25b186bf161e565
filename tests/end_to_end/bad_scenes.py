"""Broken scene files, a case a line: what is edited, and what the message must say.

`CASES` is data, so that `load_scene` and the command are tested with the same files (bad_scene.write, bad_scene.expected).
"""

from bad_scene import BadScene, edit, effect, field, motion, whole

# ruff: noqa: E501  (a case a line reads best)
# fmt: off

TABLE = "s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n20,20,0,0\n40,38,0,9\n"
CATHETER = "body.catheter"
MAGNETIC = 'materials."magnetic silicone"'
SEGMENT = "body.catheter.segments[0]"
GROUND = "point: [0 mm, 0 mm, -2 mm]"
TUBE = "radius: 5 mm, path: [[-10 mm, 0 mm, 0 mm], [60 mm, 0 mm, 0 mm]]"
SHAPE = "solver:\n"  # where the reference cases insert their key
REFERENCE = "reference: {centreline: shape.csv}\nsolver:\n"

FILES = [
    whole("missing file", None, "no such file", "check the path"),
    whole("empty file", b"", "the file is empty", "start from one of the files in data/scenes"),
    whole("only comments", b"# nothing yet\n", "the file is empty", "start from one of"),
    whole("folder", None, "this is a folder", "name a file in it", folder=True),
    whole("binary file", b"\x89PNG\r\n\x1a\n\x00\x00\xff\xfe", "not a text file", "0x89", "`key: value` lines"),
    whole("zero bytes", b"name: a\x00b\n", "not a text file", "#x0000"),
    whole("Latin-1 text", b"name: cath\xe9ter\n", "not a text file", "0xe9", "UTF-8"),
    whole("a list", b"- name: probe\n- body: {}\n", "received a list", "`key: value` lines"),
    whole("a sentence", b"forty millimetres of silicone\n", 'received "forty millimetres', "`key: value` lines"),
    whole("two documents", b"name: a\n---\nname: b\n", "one YAML document", "remove the second `---`"),
    whole("JSON cut short", b'{"name": "probe", "body": {', "must be valid YAML", "brackets"),
    whole("a tag of Python", b"name: !!python/object:os.system x\n", "name: received the tag", "plain YAML", "remove"),
    whole("an alias in itself", b"name: &a [*a]\n", "aliases must not contain themselves", "write the values out"),
    whole("a wrong merge", b"name: a\nbody:\n  <<: 3\n", "body: received <<", "expected a mapping", "`<<: *its_name`"),
    whole("brackets as a key", b"name: a\n[a, b]: 3\n", "a key must be a word", "write `key: value`"),
    whole("nested without end", b"a: " + b"[" * 2_000, "nested too deeply"),
    whole("too large", b"# " + b"x" * 1_000_000, "received 1000002 bytes", "must not exceed 1000000 bytes"),
    edit("tab", "    length: 40 mm\n", "\tlength: 40 mm\n", "", '"length: 40 mm"', "a tab cannot indent", "with spaces"),
    edit("no space after the colon", "name: probe", "name:probe", "", "", "must be valid YAML", "space after each colon", line=2),
    edit("quote left open", "name: probe", 'name: "probe', "", "", "must be valid YAML", "quotes", line=1),
    edit("bracket left open", "[0 mT, 6 mT, 8 mT]", "[0 mT, 6 mT, 8 mT", "", "", "must be valid YAML", "brackets", line=22),
    edit(
        "duplicate key", "    diameter: 4 mm\n", "    diameter: 4 mm\n    length: 50 mm\n", CATHETER + ".length",
        'the key "length" a second time', "a key may appear once (the first is in line 12)", "remove or rename", line=14,
    ),
    edit("duplicate part", "effects:", "field: {}\neffects:", "field", 'the key "field" a second time', "may appear once"),
    edit(
        "duplicate material", "  plain silicone:", "  magnetic silicone:", MAGNETIC,
        'the key "magnetic silicone" a second time', "a key may appear once", "rename",
    ),
]

UNITS = [
    edit("no unit", "length: 40 mm", "length: 40", CATHETER + ".length", "40", "a length needs a unit", '"40 mm"'),
    edit("no unit, in quotes", "length: 40 mm", 'length: "40"', CATHETER + ".length", '"40"', "a length needs a unit"),
    edit("zero without unit", "[0 mT, 6 mT", "[0, 6 mT", "field.uniform[0]", "0", "a flux density needs a unit", '"8 mT"'),
    edit("no unit of pressure", "120 kPa", "120e3", MAGNETIC + ".shear_modulus", "120000.0", "a pressure needs a unit"),
    edit("no unit of angle", "30 deg", "30", CATHETER + ".segments[2].magnetization.azimuth", "30", "an angle needs a unit"),
    edit("percent is no angle", "30 deg", "30 %", CATHETER + ".segments[2].magnetization.azimuth", '"30 %"', "an angle is expected"),
    edit("mass for length", "40 mm", "40 mg", CATHETER + ".length", '"40 mg"', '"mg" is not a unit of length', '"40 mm"'),
    edit("field for length", "40 mm", "40 mT", CATHETER + ".length", '"40 mT"', '"mT" is not a unit of length', '"40 mm"'),
    edit("wrong exponent", "1882 kg/m^3", "1882 kg/m^2", MAGNETIC + ".density", '"1882 kg/m^2"', '"kg/m^2" is not', '"kg/m^3"'),
    edit("wrong case", "120 kPa", "120 kpa", MAGNETIC + ".shear_modulus", '"120 kpa"', "not a known unit", 'mean "kPa"?'),
    edit("unknown unit", "40 mm", "40 smoots", CATHETER + ".length", '"40 smoots"', '"smoots" is not a known unit', '"40 mm"'),
    edit("offset unit", "120 kPa", "20 degC", MAGNETIC + ".shear_modulus", '"20 degC"', '"degC" is not a unit of pressure'),
    edit("field strength", "138 mT", "110 kA/m", MAGNETIC + ".remanence", '"110 kA/m"', '"kA/m" is not a unit of flux density'),
    edit("logarithmic unit", "138 mT", "3 dBm", MAGNETIC + ".remanence", '"3 dBm"', '"dBm" is not a unit'),
    edit("words", "40 mm", "forty mm", CATHETER + ".length", '"forty mm"', "must begin with a number", '"40 mm"'),
    edit("decimal comma", "40 mm", "40,5 mm", CATHETER + ".length", '"40,5 mm"', "decimal point", '"40 mm"'),
    edit("thousands apart", "1882 kg/m^3", "1 882 kg/m^3", MAGNETIC + ".density", '"1 882 kg/m^3"', "no separators"),
    edit("a sum", "40 mm", "40 mm + 2 mm", CATHETER + ".length", '"40 mm + 2 mm"', "is not a unit"),
    edit("absurd exponent", "40 mm", "40 mm^999999999", CATHETER + ".length", '"40 mm^999999999"', "is not a unit"),
    edit("nan with unit", "40 mm", "nan mm", CATHETER + ".length", '"nan mm"', "must be a finite number", '"40 mm"'),
    edit("nan", "40 mm", ".nan", CATHETER + ".length", ".nan", "must be a finite number"),
    edit("inf with unit", "8 mT]", "inf mT]", "field.uniform[2]", '"inf mT"', "must be a finite number", '"8 mT"'),
    edit("beyond floats", "40 mm", "4e999 mm", CATHETER + ".length", '"4e999 mm"', "a computer can hold"),
    edit("true", "40 mm", "true", CATHETER + ".length", "true", "a length is expected here", '"40 mm"'),
    edit("list for length", "length: 40 mm", "length: [40 mm]", CATHETER + ".length", '["40 mm"]', "a length is expected here"),
]

BOUNDS = [
    edit("negative length", "40 mm", "-40 mm", CATHETER + ".length", '"-40 mm"', "greater than 0 mm", "reads as -0.04 m"),
    edit("zero diameter", " diameter: 4 mm", " diameter: 0 mm", CATHETER + ".diameter", '"0 mm"', "greater than 0 mm"),
    edit("kilometre", "40 mm", "40 km", CATHETER + ".length", '"40 km"', "must be at most 10 m", "reads as 40000 m"),
    edit("metres for millimetres", "40 mm", "4 m", CATHETER + ".diameter", '"4 mm"', "1 to 500 times", "length 4000 mm", line=13),
    edit("thicker than long", " diameter: 4 mm", " diameter: 5 cm", CATHETER + ".diameter", '"5 cm"', "1 to 500 times", "50 mm"),
    edit("inner over outer", "1 mm", "5 mm", CATHETER + ".inner_diameter", '"5 mm"', "less than the diameter", "than 4 mm"),
    edit("no wall", "1 mm", "4 mm", CATHETER + ".inner_diameter", '"4 mm"', "must be less than the diameter"),
    edit("negative bore", "1 mm", "-1 mm", CATHETER + ".inner_diameter", '"-1 mm"', "must be at least 0 mm"),
    edit("negative modulus", "120 kPa", "-120 kPa", MAGNETIC + ".shear_modulus", '"-120 kPa"', "greater than 0 kPa"),
    edit("huge modulus", "120 kPa", "120e9 kPa", MAGNETIC + ".shear_modulus", '"120e9 kPa"', "must be at most 500 GPa"),
    edit("negative density", "1882", "-1882", MAGNETIC + ".density", '"-1882 kg/m^3"', "greater than 0 kg/m^3"),
    edit("g/cm^3 mistaken", "1882 kg/m^3", "1882 g/cm^3", MAGNETIC + ".density", '"1882 g/cm^3"', "at most 30000 kg/m^3"),
    edit("negative remanence", "138 mT", "-138 mT", MAGNETIC + ".remanence", '"-138 mT"', "must be at least 0 mT"),
    edit("remanence in T", "138 mT", "138 T", MAGNETIC + ".remanence", '"138 T"', "must be at most 3 T"),
    edit("negative friction of a material", "1882 kg/m^3", "1882 kg/m^3\n    friction: -0.1", MAGNETIC + ".friction", "-0.1", "at least 0", line=8),
    edit("field in T", "8 mT]", "80 T]", "field.uniform[2]", '"80 T"', "must be at most 20 T"),
    edit("elevation too high", "10 deg", "100 deg", CATHETER + ".segments[2].magnetization.elevation", '"100 deg"', "90 deg"),
    edit("K below 2/3 G", "    bulk_to_shear: 20", "    bulk_to_shear: 0.5", MAGNETIC + ".bulk_to_shear", "0.5", "than 2/3"),
    edit("K in kPa", "    bulk_to_shear: 20", "    bulk_to_shear: 2400 kPa", MAGNETIC + ".bulk_to_shear", '"2400 kPa"', "a plain number"),
    edit("K in quotes", "    bulk_to_shear: 20", '    bulk_to_shear: "20"', MAGNETIC + ".bulk_to_shear", '"20"', "must be a number"),
    edit("K infinite", "    bulk_to_shear: 20", "    bulk_to_shear: .inf", MAGNETIC + ".bulk_to_shear", ".inf", "finite number"),
    edit("one cell", "cells_across: 4", "cells_across: 1", "resolution.cells_across", "1", "must be at least 2"),
    edit("too many cells", "cells_across: 4", "cells_across: 40", "resolution.cells_across", "40", "must be at most 16"),
    edit("half a cell", "cells_across: 4", "cells_across: 4.5", "resolution.cells_across", "4.5", "must be a whole number"),
    edit("cells in words", "cells_across: 4", "cells_across: four", "resolution.cells_across", '"four"', "a whole number"),
    edit("cells: yes", "cells_across: 4", "cells_across: yes", "resolution.cells_across", '"yes"', "`cells_across: 4`"),
    edit("cells: true", "cells_across: 4", "cells_across: true", "resolution.cells_across", "true", "must be a whole number"),
    edit("one particle", "per_cell: 2", "per_cell: 1", "resolution.particles_per_cell", "1", "must be at least 2"),
    edit("tolerance zero", "1e-9", "0", "solver.static.tolerance", "0", "must be at least 1e-14", "`tolerance: 1e-11`"),
    edit("no steps", "max_steps: 60", "max_steps: -1", "solver.static.max_steps", "-1", "must be at least 1"),
]

KEYS = [
    edit("misspelt at the top", "effects:", "efects:", "efects", "{", 'unknown key "efects"', 'did you mean "effects"?'),
    edit("misspelt material key", "density: 1882", "densty: 1882", MAGNETIC + ".densty", '"1882', 'did you mean "density"?'),
    edit("misspelt catheter key", " length: 40 mm", " lenght: 40 mm", CATHETER + ".lenght", '"40 mm"', 'mean "length"?'),
    edit("British spelling", "{magnetization: [1", "{magnetisation: [1", SEGMENT + ".magnetisation", "[1, 0, 0]", 'mean "magnetization"?'),
    edit("misspelt angle", "azimuth:", "azimut:", CATHETER + ".segments[2].magnetization.azimut", '"30', 'mean "azimuth"?'),
    edit("misspelt effect", "  gravity:", "  gravty:", "effects.gravty", "{}", 'unknown key "gravty"', 'did you mean "gravity"?'),
    edit("misspelt solver option", "max_steps", "maxsteps", "solver.static.maxsteps", "60", 'did you mean "max_steps"?'),
    edit("misspelt resolution", "cells_across", "cell_across", "resolution.cell_across", "4", 'mean "cells_across"?'),
    edit("capital letter", "field:", "Field:", "Field", "{", 'unknown key "Field"', 'did you mean "field"?'),
    edit("unknown key", "  uniform:", "  colour: 3\n  uniform:", "field.colour", "3", "known here: uniform", "remove it"),
    edit("key in the wrong place", "solver:", "cells_across: 4\nsolver:", "cells_across", "4", "it belongs in resolution"),
    edit("no name", "name: probe\n", "", "name", "nothing", "this key is required", "`name: five-segment catheter`", line=1),
    edit("no length", "    length: 40 mm\n", "", CATHETER + ".length", "nothing", "is required", "`length: 40 mm`", line=11),
    edit("no bulk modulus", "    bulk_to_shear: 20\n", "", MAGNETIC + ".bulk_to_shear", "nothing", "is required", line=3),
    edit("azimuth left out", "azimuth: 30 deg, ", "", CATHETER + ".segments[2].magnetization.azimuth", "nothing", "is required"),
    edit("no body", "body:", "bodies:", "bodies", "{", 'did you mean "body"?'),
    edit("empty value", "  gravity: {}", "  gravity:", "effects.gravity", "nothing", "must have a value", "write {}"),
    edit("null", "40 mm", "~", CATHETER + ".length", "nothing", "a key must have a value"),
]

SHAPES = [
    edit("number for a part", "resolution: {cells_across: 4, particles_per_cell: 2}", "resolution: 4", "resolution", "4",
         "must be a mapping of keys", "`resolution: {cells_across: 4}`"),
    edit("list for a part", "  uniform: [0 mT, 6 mT, 8 mT]", "  - 0 mT", "field", '["0 mT"]', "must be a mapping of keys", line=21),
    edit("text for an effect", "gravity: {}", "gravity: on", "effects.gravity", '"on"', "a mapping of keys", "`gravity: {}`"),
    edit("no as an effect", "gravity: {}", "gravity: no", "effects.gravity", '"no"', "must be a mapping of keys"),
    edit("effects and auto", "  gravity: {}", "  gravity: {}\n  auto: true", "effects.auto", "true", "leaves the choice to the program",
         "write `effects: auto`", line=26),
    edit("effects as a list", "  magnetic_torque: {}\n  gravity: {}", "  - gravity", "effects", '["gravity"]', "a mapping of keys", line=23),
    edit("number as a name", "name: probe", "name: 12", "name", "12", "must be text", 'put it in quotes: "12"'),
    edit("empty name", "name: probe", 'name: ""', "name", '""', "must not be empty", "`name: five-segment catheter`"),
    edit("name with a slash", "name: probe", "name: ../probe", "name", '"../probe"', "as the name of a folder", "leave out /:"),
    edit("name with a tab", "name: probe", 'name: "a\\tb"', "name", '"a\\tb"', "as the name of a folder", "leave out U+0009:", "all signs but"),
    edit("name in spaces", "name: probe", 'name: " probe "', "name", '" probe "', "as the name of a folder", "remove spaces"),
    edit("name of dots", "name: probe", "name: ..", "name", '".."', "as the name of a folder", "other than a dot"),
    edit("name that ends in a dot", "name: probe", "name: probe.", "name", '"probe."', "as the name of a folder", "other than a dot"),
    edit("name of a device", "name: probe", "name: aux.1", "name", '"aux.1"', "as the name of a folder", "device on Windows"),
    edit("segment of no length to speak of", "length: 5 mm}", "length: 1e-9 mm}", CATHETER + ".segments[1].length", '"1e-9 mm"', "at least 0.01 times the catheter's diameter long, 0.04 mm here", "segment 2 is 1e-09 mm", "check its unit"),
    edit("nothing left for the last segment", "length: 15 mm}", "length: 34.99 mm}", CATHETER + ".segments", '[{"magnetization"', "at least 0.01 times the catheter's diameter", "segment 3 is 0.01 mm", line=17),
    edit("wall of no thickness to speak of", "inner_diameter: 1 mm", "inner_diameter: 3.999 mm", CATHETER + ".inner_diameter", '"3.999 mm"', "wall must be at least 0.001 times its diameter thick, 0.004 mm here", "at most 3.992 mm"),
    edit("two solvers", "  static: {", "  dynamic: {duration: 1 ms}\n  static: {", "solver", '{"dynamic": {"duration": "1 ms"}, "static": {"tolerance": 1e-09, "max_steps":...', "`quasi_static` or `dynamic`, one of them", "this has `static` and `dynamic`", "remove one", "`anti_locking`", line=26),
    edit("cure within statics", "{tolerance", "{anti_locking: f-bar, tolerance", "solver.static.anti_locking", '"f-bar"', "unknown key", "it belongs in solver"),
    edit("unknown model", "neo-hookean", "neohookean", MAGNETIC + ".model", '"neohookean"', "must be 'neo-hookean'", "did you mean"),
    edit("clamp at the tip", "clamp: base", "clamp: tip", CATHETER + ".clamp", '"tip"', "must be 'base'", "`clamp: base`"),
    edit("unknown cure", "  static: {tolerance", "  anti_locking: fbar\n  static: {tolerance", "solver.anti_locking", '"fbar"', 'mean "f-bar"?'),
    edit("segment as a number", "- {material: plain silicone, length: 5 mm}", "- 5", CATHETER + ".segments[1]", "5", "a mapping"),
    edit("two components", "[1, 0, 0]", "[1, 0]", SEGMENT + ".magnetization", "[1, 0]", "a list of 3", "[1, 0, 0] or {azimuth"),
    edit("four components", "[1, 0, 0]", "[1, 0, 0, 0]", SEGMENT + ".magnetization", "[1, 0, 0, 0]", "must be a list of 3"),
    edit("a word as direction", "[1, 0, 0]", "axial", SEGMENT + ".magnetization", '"axial"', "must be a list of 3"),
    edit("text in a direction", "[1, 0, 0]", "[1, x, 0]", SEGMENT + ".magnetization[1]", '"x"', "must be a number"),
    edit("unit in a direction", "[1, 0, 0]", "[1 mT, 0, 0]", SEGMENT + ".magnetization[0]", '"1 mT"', "without quotes or unit"),
    edit("nan in a direction", "[1, 0, 0]", "[1, .nan, 0]", SEGMENT + ".magnetization[1]", ".nan", "must be a finite number"),
    edit("field as a number", "[0 mT, 6 mT, 8 mT]", "8 mT", "field.uniform", '"8 mT"', "a list of 3", "[0 mT, 6 mT, 8 mT]"),
    edit("field of two", "[0 mT, 6 mT, 8 mT]", "[6 mT, 8 mT]", "field.uniform", '["6 mT", "8 mT"]', "must be a list of 3"),
    edit("gravity as a number", "gravity: {}", "gravity: {acceleration: 9.81 m/s^2}", "effects.gravity.acceleration",
         '"9.81 m/s^2"', "must be a list of 3", "-9.81 m/s^2"),
]

TOGETHER = [
    edit("unknown material", "    material: magnetic silicone", "    material: magnetic silicon", CATHETER + ".material",
         '"magnetic silicon"', "must be a name from `materials`: magnetic silicone, plain silicone", "did you mean"),
    edit("unknown material of a segment", "{material: plain silicone", "{material: rubber", CATHETER + ".segments[1].material",
         '"rubber"', "must be a name from `materials`", "add the material"),
    BadScene("no segments", (("      - {magnetization: [1, 0, 0], length: 15 mm}\n", ""),
                             ("      - {material: plain silicone, length: 5 mm}\n", ""),
                             ("    segments:\n      - magnetization: {azimuth: 30 deg, elevation: 10 deg}", "    segments: []")),
             CATHETER + ".segments", "[]", ("must have 1 or more entries",), line=17),
    edit("segments too long", "15 mm", "35 mm", CATHETER + ".segments", "[{", "must leave some of the catheter's length",
         "those given sum to 40 mm, the catheter 40 mm", line=17),
    edit("segments beyond the length", "15 mm", "50 mm", CATHETER + ".segments", "[{", "must leave some", "sum to 55 mm", line=17),
    edit("segments too short", "- magnetization: {", "- length: 10 mm\n        magnetization: {", CATHETER + ".segments", "[{",
         "segment lengths must sum to the catheter's length", "they sum to 30 mm, the catheter 40 mm", line=17),
    edit("negative segment", "15 mm", "-15 mm", SEGMENT + ".length", '"-15 mm"', "must be greater than 0 mm"),
    edit("no density for gravity", ", density: 1070 kg/m^3", "", 'materials."plain silicone".density', "nothing",
         "gravity needs the density of each material", "`density: 1100 kg/m^3`"),
    *(BadScene(f"no density for contact with {key}", ((", density: 1070 kg/m^3", ""), ("  gravity: {}\n", f"  {key}: {{{settings}}}\n")),
               'materials."plain silicone".density', "nothing", ("contact needs the density of each material", "`density: 1100 kg/m^3`"))
      for key, settings in {"ground": GROUND, "walls": f"tube: {{{TUBE}}}"}.items()),
    edit("torque without field", "field:\n  uniform: [0 mT, 6 mT, 8 mT]\n", "", "field", "nothing",
         "magnetic_torque needs a field", "do not name magnetic_torque", line=1),
    edit("torque without remanence", "    remanence: 138 mT\n", "", "effects.magnetic_torque", "{}",
         "magnetic_torque needs a segment with a magnetization whose material has a remanence", "remanence: 138 mT", line=23),
    BadScene("torque without direction", (("magnetization: [1, 0, 0], ", ""),
                                          ("magnetization: {azimuth: 30 deg, elevation: 10 deg}", "magnetization: [0, 0, 0]")),
             "effects.magnetic_torque", "{}", ("needs a segment with a magnetization", "[1, 0, 0]"), line=24),
]

REFERENCES = [
    edit("no such table", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "no such file", "check the path"),
    edit("reference as a number", SHAPE, "reference: {centreline: 3}\nsolver:\n", "reference.centreline", "3", "path of a CSV"),
    edit("table without header", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "shape.csv:1", "the header must name the columns",
         table="0,0,0,0\n1,1,0,0\n"),
    edit("table of metres", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "s_mm,x_mm,y_mm,z_mm",
         table=TABLE.replace("_mm", "_m")),
    edit("table with text", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "shape.csv:3", "4 numbers, in mm",
         table=TABLE.replace("20,20", "20,twenty")),
    edit("table with nan", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "shape.csv:3", "numbers must be finite",
         table=TABLE.replace("20,20", "20,nan")),
    edit("table out of order", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "shape.csv:4", "s_mm must increase",
         table=TABLE.replace("40,38", "10,38")),
    edit("table of one row", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "2 to 100000 rows",
         table="s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n"),
    edit("table of another catheter", SHAPE, REFERENCE, "reference.centreline", '"shape.csv"', "catheter's length, 40 mm",
         "belongs to this catheter", table=TABLE.replace("40,38", "50,38")),
]

SURROUNDINGS = [
    *(
        effect(f"{key} in statics", f"{key}: {{{settings}}}", key, "{", f"{key} acts in motion only", "solver: {dynamic: {duration")
        for key, settings in {
            "damping": "rate: 60 1/s", "viscosity": "viscosity: 5 Pa s", "feed": "speed: 5 mm/s, exit: 10 mm",
        }.items()
    ),
    effect("no rate", "damping: {}", "damping.rate", "nothing", "this key is required", "`rate: 60 1/s`"),
    effect("rate without unit", "damping: {rate: 60}", "damping.rate", "60", "a rate needs a unit", '"60 1/s"'),
    effect("a frequency for a rate", "damping: {rate: 60 rad}", "damping.rate", '"60 rad"', "is not a unit of rate"),
    effect("negative damping", "damping: {rate: -1 1/s}", "damping.rate", '"-1 1/s"', "must be at least 0 1/s"),
    effect("viscosity in Pa", "viscosity: {viscosity: 5 Pa}", "viscosity.viscosity", '"5 Pa"', "is not a unit of viscosity", '"5 Pa s"'),
    effect("negative viscosity", "viscosity: {viscosity: -5 Pa s}", "viscosity.viscosity", '"-5 Pa s"', "at least 0 Pa s"),
    effect("ground nowhere", "ground: {friction: 0.3}", "ground.point", "nothing", "is required", "`point: [0 mm, 0 mm, -2 mm]`"),
    effect("ground by its height", "ground: {point: -2 mm}", "ground.point", '"-2 mm"', "must be a list of 3"),
    effect("ground without normal", f"ground: {{{GROUND}, normal: [0, 0, 0]}}", "ground.normal", "[0, 0, 0]", "must have a direction",
           "`normal: [0, 0, 1]`"),
    effect("negative friction", f"ground: {{{GROUND}, friction: -0.1}}", "ground.friction", "-0.1", "must be at least 0", "0.3"),
    effect("friction with a unit", f"ground: {{{GROUND}, friction: 30 deg}}", "ground.friction", '"30 deg"', "must be a number"),
    effect("no stiffness", f"ground: {{{GROUND}, stiffness: 0}}", "ground.stiffness", "0", "must be greater than 0"),
    effect("walls of nothing", "walls: {friction: 0.1}", "walls", "{", "give `tube` or `surface`, one of them", "`tube: {radius"),
    effect("walls of a lumen that is not there", "walls: {tube: {" + TUBE + "}, surface: {mesh: vessel.stl, unit: mm}}", "walls.surface.mesh", '"vessel.stl"',
           "can't be read"),
    effect("lumen without its mesh", "walls: {surface: {unit: mm}}", "walls.surface.mesh", "nothing", "is required", "`mesh: vessel.stl`"),
    effect("lumen that is no mesh", "walls: {surface: {mesh: probe.yaml, unit: mm}}", "walls.surface.mesh", '"probe.yaml"', "must be an STL mesh"),
    effect("tube of no width", "walls: {tube: {" + TUBE.replace("5 mm", "0 mm") + "}}", "walls.tube.radius", '"0 mm"', "greater than 0 mm"),
    effect("tube of one point", "walls: {tube: {radius: 5 mm, path: [[0 mm, 0 mm, 0 mm]]}}", "walls.tube.path", "[[", "2 or more points"),
    effect("tube of one point twice", "walls: {tube: {radius: 5 mm, path: [[0 mm, 0 mm, 0 mm], [0 mm, 0 mm, 0 mm]]}}", "walls.tube.path",
           "[[", "each apart from the next"),
    effect("tube that bends too tightly", "walls: {tube: {radius: 5 mm, path: [[0 mm, 0 mm, 0 mm], [9 mm, 0 mm, 0 mm], [9 mm, 9 mm, 0 mm]]}}",
           "walls.tube.path", "[[", "must not bend more tightly than its radius", "the path smoother"),
    effect("tube without its table", "walls: {tube: {radius: 5 mm, path: vessel.csv}}", "walls.tube.path", '"vessel.csv"', "no such file"),
    effect("tube along a bad table", "walls: {tube: {radius: 5 mm, path: shape.csv}}", "walls.tube.path", '"shape.csv"', "shape.csv:3",
           "4 numbers, in mm", table=TABLE.replace("20,20", "20,twenty")),
    effect("self-contact that pulls", "self_contact: {friction: -0.3}", "self_contact.friction", "-0.3", "must be at least 0"),
    effect("feed without exit", "feed: {speed: 5 mm/s}", "feed.exit", "nothing", "is required", "`exit: 10 mm`"),
    effect("feed per minute mistaken", "feed: {speed: 5 mm, exit: 10 mm}", "feed.speed", '"5 mm"', "is not a unit of speed", '"5 mm/s"'),
]

CELLS = "{cells_across: 4, particles_per_cell: 2}"
RESOLUTION = [
    edit("error and cells", CELLS, "{cells_across: 4, error: 1 %}", "resolution.error", '"1 %"', "give `cells_across`, `error` or `seconds`", "cells_across: 4"),
    edit("time and cells", CELLS, "{seconds: 2 s, cells_across: 4}", "resolution.seconds", '"2 s"', "one of them", "remove"),
    edit("error and time", CELLS, "{seconds: 2 s, error: 1 %}", "resolution.seconds", '"2 s"', "one of them", "error: 0.01"),
    edit("no error at all", CELLS, "{error: 0 %}", "resolution.error", '"0 %"', "greater than 0", "this reads as 0 %"),
    edit("negative error", CELLS, "{error: -1 %}", "resolution.error", '"-1 %"', "greater than 0", "this reads as -1 %"),
    edit("negative length of error", CELLS, "{error: -0.1 mm}", "resolution.error", '"-0.1 mm"', "must be greater than 0 mm"),
    edit("error of 100 times the length", CELLS, "{error: 10000 %}", "resolution.error", '"10000 %"', "at most 50 %"),
    edit("error without unit", CELLS, "{error: 0.01}", "resolution.error", "0.01", "needs its unit", '"0.1 mm"'),
    edit("error in seconds", CELLS, "{error: 2 s}", "resolution.error", '"2 s"', "unit of length"),
    edit("error of nothing known", CELLS, "{error: 1 %, of: base}", "resolution.of", '"base"', "'centreline' or 'tip'"),
    edit("where, but no error", CELLS, "{of: tip}", "resolution.of", '"tip"', "no error is given", "error: 0.1 mm"),
    edit("no seconds", CELLS, "{seconds: 0 s}", "resolution.seconds", '"0 s"', "must be greater than 0 s"),
    edit("negative seconds", CELLS, "{seconds: -2 s}", "resolution.seconds", '"-2 s"', "must be greater than 0 s"),
    edit("seconds without unit", CELLS, "{seconds: 2}", "resolution.seconds", "2", "needs a unit"),
]


DIPOLE = "dipole: {position: [60 mm, 0 mm, 0 mm], moment: [0 A*m^2, 0 A*m^2, 0.5 A*m^2]}"
MAGNET = "magnet: {cylinder: {diameter: 20 mm, length: 20 mm}, position: [70 mm, 0 mm, 0 mm], remanence: 1.3 T}"
MAP = "x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT\n" + "".join(f"{x},{y},{z},1,2,3\n" for x in range(4) for y in range(4) for z in range(4))

FIELDS = [
    field("the size of a magnet beside its shape", "magnet: {cylinder: {diameter: 20 mm, length: 20 mm}, position: [70 mm, 0 mm, 0 mm], remanence: 1.3 T, diameter: 20 mm}",
          "field.magnet.diameter", '"20 mm"', "known here: cuboid, cylinder, position", "it belongs in field.magnet.cylinder"),
    field("dipole without moment", "dipole: {position: [60 mm, 0 mm, 0 mm]}", "field.dipole.moment", "nothing", "is required"),
    field("moment of no unit", DIPOLE.replace("0.5 A*m^2", "0.5"), "field.dipole.moment[2]", "0.5", "needs a unit", "A*m^2"),
    field("moment in tesla", DIPOLE.replace("0.5 A*m^2", "0.5 T"), "field.dipole.moment[2]", '"0.5 T"', "not a unit of magnetic moment"),
    field("second dipole without place", "dipole:\n  - {position: [60 mm, 0 mm, 0 mm], moment: [0 A*m^2, 0 A*m^2, 1 A*m^2]}\n"
          "  - {moment: [0 A*m^2, 0 A*m^2, 1 A*m^2]}", "field.dipole[1].position", "nothing", "is required", line=24),
    field("pull without turn", DIPOLE, "effects.magnetic_force", "nothing", "neither alone has an energy", "`magnetic_force: {}`",
          force=False, line=23),
    field("magnet of two shapes", MAGNET.replace("position", "cuboid: {size: [9 mm, 9 mm, 9 mm]}, position"), "field.magnet", "{",
          "give `cuboid` or `cylinder`, one of them", "keep one"),
    field("magnet of no shape", "magnet: {position: [70 mm, 0 mm, 0 mm], remanence: 1.3 T}", "field.magnet", "{", "give `cuboid` or `cylinder`, one of them", "write, say"),
    field("flat magnet", MAGNET.replace("length: 20 mm", "length: 0 mm"), "field.magnet.cylinder.length", '"0 mm"', "greater than 0 mm"),
    field("magnet of no axis", MAGNET.replace("remanence", "axis: [0, 0, 0], remanence"), "field.magnet.axis", "[0, 0, 0]", "must not be zero"),
    field("coil of no turns", "coils: {position: [0 mm, 0 mm, -60 mm], diameter: 80 mm, current: 5 A, turns: 0}", "field.coils.turns",
          "0", "at least 1"),
    field("current in tesla", "coils: {position: [0 mm, 0 mm, -60 mm], diameter: 80 mm, current: 5 T}", "field.coils.current", '"5 T"',
          "not a unit of current", '"2 A"'),
    field("half a box", MAGNET + "\ntabulation: {lower: [0 mm, 0 mm, 0 mm]}", "field.tabulation", "{", "both corners"),
    field("box inside out", MAGNET + "\ntabulation: {lower: [1 mm, 0 mm, 0 mm], upper: [0 mm, 9 mm, 9 mm]}", "field.tabulation", "{",
          "must exceed"),
    field("schedule of nothing", DIPOLE + "\nover_time: {}", "field.over_time", "{}", "something must change"),
    field("time that falls", DIPOLE + "\nover_time: {keyframes: [{time: 1 s, strength: 1}, {time: 1 s, strength: 0}]}",
          "field.over_time.keyframes[1].time", '"1 s"', "must rise", "follows 1 s"),
    field("empty keyframe", DIPOLE + "\nover_time: {keyframes: [{time: 0 s}, {time: 1 s, strength: 0}]}",
          "field.over_time.keyframes[0]", "{", "strength, uniform or move"),
    field("one keyframe", DIPOLE + "\nover_time: {keyframes: [{time: 0 s, strength: 1}]}", "field.over_time.keyframes", "[", "2 or more"),
    field("rotation without end", DIPOLE + "\nover_time: {rotation: {frequency: 2 Hz}}", "field.over_time.rotation", "{",
          "has no end", "add `turns`"),
    field("swing without end", DIPOLE + "\nover_time: {oscillation: {frequency: 2 Hz}}", "field.over_time.oscillation", "{",
          "has no end", "add `cycles`"),
    field("no rotation", DIPOLE + "\nover_time: {rotation: {frequency: 0 Hz, turns: 1}}", "field.over_time.rotation.frequency", '"0 Hz"',
          "must not be zero"),
    field("angular frequency", DIPOLE + "\nover_time: {rotation: {frequency: 12 rad/s, turns: 1}}", "field.over_time.rotation.frequency",
          '"12 rad/s"', "not a unit of frequency"),
    field("turn of no end", DIPOLE + "\nover_time: {rotation: {frequency: 2 Hz, turns: -1}}", "field.over_time.rotation.turns", "-1",
          "greater than 0"),
    field("schedule missing", DIPOLE + "\nover_time: {table: current.csv}", "field.over_time.table", '"current.csv"', "no such file"),
    field("table whose time falls", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"', "shape.csv:4",
          "times must rise", "0.2 s after 1 s", table="time_s,strength\n0,0\n1,1\n0.2,0\n"),
    field("table of a field too strong", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"',
          "shape.csv:3 has 25 in the column Bz_T", "Bz must be at least -20 T and at most 20 T", "this reads as 25 T",
          table="time_s,Bx_T,By_T,Bz_T\n0,0,0,0\n1,0,0,25\n"),
    field("table that begins too soon", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"',
          "shape.csv:2 has -50 in the column time_ms", "time must be at least 0 s", "this reads as -0.05 s", table="time_ms,strength\n-50,0\n1,2\n"),
    field("table of a strength beyond all", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"',
          "shape.csv:3 has 1e7 in the column strength", "strength must be at least -1e6", table="time_s,strength\n0,0\n1,1e7\n"),
    field("table of time alone", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"', "at least one of",
          table="time_s\n0\n1\n"),
    field("table of no unit", DIPOLE + "\nover_time: {table: shape.csv}", "field.over_time.table", '"shape.csv"', "a time needs a unit",
          table="time,strength\n0,0\n1,1\n"),
    field("keyframes and a table", DIPOLE + "\nover_time: {table: shape.csv, keyframes: [{time: 0 s, strength: 0}, {time: 1 s, strength: 1}]}",
          "field.over_time", "{", "both give the schedule", table="time_s,strength\n0,0\n1,1\n"),
    field("map missing", "map: {table: magnet.csv}", "field.map.table", '"magnet.csv"', "no such file"),
    field("map without Bz", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "Bz is missing",
          table="x_mm,y_mm,z_mm,Bx_mT,By_mT\n0,0,0,1,2\n1,0,0,1,2\n"),
    field("map of a plane", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "along z it has 1",
          table="x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT\n" + "".join(f"{x},{y},0,1,2,3\n" for x in range(5) for y in range(5))),
    field("map with a hole", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "1 are missing", "(0, 0, 1) mm",
          table=MAP.replace("\n0,0,1,1,2,3", "")),
    field("map point twice", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "may appear once", table=MAP + "0,0,1,1,2,3\n"),
    field("map of an uneven grid", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "grid of a map must be evenly spaced", "3.5 mm",
          table=MAP.replace("\n3,", "\n3.5,")),
    field("map in the wrong unit", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "Bx must be at least -100 T and at most 100 T",
          "1e6 in the column Bx_mT", "reads as 1000 T", table=MAP + "9,9,9,1e6,0,0\n"),
    field("map of words", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "shape.csv:2", "6 finite numbers",
          table=MAP.replace("\n0,0,0,1", "\n0,0,0,one")),
    field("map in kiloamps a metre", "map: {table: shape.csv}", "field.map.table", '"shape.csv"', "not a unit of flux density",
          table=MAP.replace("Bx_mT", "Bx_kA/m")),
]

MOTION = [
    motion("motion without end", "output_every: 5 ms", "duration", "nothing", "this key is required", "0.5 s"),
    motion("motion of no unit", "duration: 0.5", "duration", "0.5", "a time needs a unit"),
    motion("motion backwards", "duration: -1 s", "duration", '"-1 s"', "must be greater than 0 s"),
    motion("a rate of frames", "duration: 1 s, output_every: 100", "output_every", "100", "a time needs a unit"),
    motion("a formulation", "duration: 1 s, formulation: total", "formulation", '"total"', "one formulation of motion", "leave it out"),
    motion("beyond safety", "duration: 1 s, safety: 1.5", "safety", "1.5", "must be at most 1"),
    motion("disk in metres", "duration: 1 s, max_disk: 2 m", "max_disk", '"2 m"', "is not a unit of size", "2 GB"),
    motion("no memory", "duration: 1 s, max_memory: 0 B", "max_memory", '"0 B"', "must be greater than 0 B"),
    motion("a frame a nanosecond", "duration: 1 s, output_every: 1 ns", "output_every", '"1 ns"', "at most 100000 frames", "1e+09", "`output_every: 10 ms`"),
    motion("a step of no unit", "duration: 1 s, time_step: 0.001", "time_step", "0.001", "a time needs a unit"),
]

STRIP = (("  catheter:", "  strip:"), ("    diameter: 4 mm\n    inner_diameter: 1 mm", "    width: 4 mm\n    thickness: 2 mm"), ("clamp: base", "clamp: both"))
SHORTER = "tip: {along: [-1, 0, 0], distance: 41 mm"


def moved(name: str, settings: str, key: str, received: str, *says: str, more: tuple[tuple[str, str], ...] = (), line: int = 26) -> BadScene:
    """A scene whose key `move` has these settings."""
    return BadScene(name, ((SHAPE, f"move: {{{settings}}}\nsolver:\n"), *more), f"move.{key}", received, says, line=line)


MOVED = [
    moved("a free end is moved", "tip: {along: [1, 0, 0], distance: 1 mm}", "tip", "{", "only held ends and parts can be moved; held here: base", "clamp: both"),
    moved("moved nowhere", "base: {along: [0, 0, 0], distance: 1 mm}", "base.along", "[0, 0, 0]", "must not be zero"),
    moved("a way of no unit", "base: {along: [1, 0, 0], distance: 1}", "base.distance", "1", "a length needs a unit"),
    moved("a way back", "base: {along: [1, 0, 0], distance: -1 mm}", "base.distance", '"-1 mm"', "must be greater than 0 mm"),
    moved("no way", "base: {along: [1, 0, 0]}", "base.distance", "nothing", "this key is required", "0.47 mm"),
    moved("a way that turns", "base: {along: [1, 0, 0], distance: 1 mm, over_time: {rotation: {frequency: 1 Hz}}}", "base.over_time.rotation", "{", "does not rotate"),
    moved("a way of a field", "base: {along: [1, 0, 0], distance: 1 mm, over_time: {keyframes: [{time: 0 s, strength: 0}, {time: 1 s, uniform: [1 mT, 0 mT, 0 mT]}]}}",
          "base.over_time.keyframes[1]", "{", "only the share of its distance", "strength: 1"),
    moved("a way without end", "base: {along: [1, 0, 0], distance: 1 mm, over_time: {oscillation: {frequency: 1 Hz}}}", "base.over_time.oscillation", "{",
          "has no end", "cycles"),
    moved("a motion that begins elsewhere", "base: {along: [1, 0, 0], distance: 1 mm}", "base", "{", "begins with the undeformed body", "ramp",
          more=(("  static: {tolerance: 1e-9, max_steps: 60}", "  dynamic: {duration: 1 s}"),)),
    moved("fed and moved", "base: {along: [1, 0, 0], distance: 1 mm, over_time: {ramp: {duration: 1 s}}}", "base", "{", "feed moves the base already",
          more=(("  static: {tolerance: 1e-9, max_steps: 60}", "  dynamic: {duration: 1 s}"), ("  gravity: {}", "  feed: {speed: 1 mm/s, exit: 10 mm}"))),
    moved("ends pass through each other", SHORTER + "}", "tip.distance", '"41 mm"', "pass through each other", "-1 mm of 40 mm", "unit of the distance", more=STRIP),
    moved("ends torn apart", "tip: {along: [0, 0, 1], distance: 41 cm}", "tip.distance", '"41 cm"', "tears before it is 10 times as long", "411.9 mm apart, from 40 mm", "unit of the distance", more=STRIP),
    moved("ends meet on the way", SHORTER + ", over_time: {keyframes: [{time: 0 s, strength: 1}, {time: 1 s, strength: 0}]}}", "tip.distance", '"41 mm"', "pass through each other", more=STRIP),
    moved("moved across plane strain", "tip: {along: [0, 1, 0], distance: 1 mm}", "tip.along", "[0, 1, 0]", "nothing moves along y in plane strain",
          more=(*STRIP[:2], ("clamp: base", "clamp: both\n    plane_strain: true")), line=27),
]

SHEAR = "    shear_modulus: 120 kPa"
RATIO = "    bulk_to_shear: 20\n"
BR = "    remanence: 138 mT"
# constants of data sheets and papers; the numbers by hand: E/(2 (1 + nu)), 2 (1 + nu)/(3 (1 - 2
# nu)), 4e-7 pi M
IN_OTHER_WORDS = [
    edit("Young's modulus", SHEAR, "    youngs_modulus: 300 kPa", MAGNETIC + ".youngs_modulus", '"300 kPa"', "`shear_modulus: 101.7 kPa`",
         "E/(2 (1 + nu)) with nu = 0.4754, which is bulk_to_shear 20"),
    edit("Young's modulus by its letter", SHEAR, "    E: 300 kPa", MAGNETIC + ".E", '"300 kPa"', "`shear_modulus: 101.7 kPa`"),
    edit("Young's modulus in words", SHEAR, "    elastic modulus: 300", MAGNETIC + '."elastic modulus"', "300", "write `shear_modulus: 101.7 Pa`"),
    edit("Young's modulus of another ratio", SHEAR + "\n" + RATIO, "    youngs_modulus: 300 kPa\n    bulk_to_shear: 4.667\n",
         MAGNETIC + ".youngs_modulus", '"300 kPa"', "`shear_modulus: 107.1 kPa`"),
    edit("Poisson's ratio", RATIO, "    poisson_ratio: 0.49\n", MAGNETIC + ".poisson_ratio", "0.49", "`bulk_to_shear: 49.67`",
         "K/G = 2 (1 + nu)/(3 (1 - 2 nu))"),
    edit("Poisson's ratio of what can't be compressed", RATIO, "    nu: 0.5\n", MAGNETIC + ".nu", "0.5", "at most 10000", "the usual 20 is nu = 0.4754"),
    edit("bulk modulus", RATIO, "    bulk_modulus: 2.4 MPa\n", MAGNETIC + ".bulk_modulus", '"2.4 MPa"', "`bulk_to_shear: 20`"),
    edit("remanence as a magnetization", "remanence: 138 mT", "remanence: 110 kA/m", MAGNETIC + ".remanence", '"110 kA/m"', 'write mu0 times it: "138.2 mT"'),
    edit("remanence in emu", "remanence: 138 mT", "remanence: 110 emu/cm^3", MAGNETIC + ".remanence", '"110 emu/cm^3"', '"138.2 mT"'),
    edit("field in oersted", "8 mT]", "80 Oe]", "field.uniform[2]", '"80 Oe"', '"8.000 mT"'),
    edit("magnetization of a material", BR, "    magnetization: 110 kA/m", MAGNETIC + ".magnetization", '"110 kA/m"', "`remanence: 138.2 mT`", "mu0 M"),
    edit("remanence by its symbol", BR, "    Br: 138 mT", MAGNETIC + ".Br", '"138 mT"', "`remanence: 138.0 mT`"),
    edit("direction of a material", BR, "    magnetization: [1, 0, 0]", MAGNETIC + ".magnetization", "[1, 0, 0]", "belongs to a segment or part"),
    *(
        edit(f"effect {key}", "  gravity: {}", f"  {key}: {{}}", f"effects.{key}", "{}", f'unknown key "{key}"', instead)
        for key, instead in {
            "drag": "`fluid: {density: 1000 kg/m^3, viscosity: 1 mPa s}`", "flow": "velocity: [10 cm/s", "obstacle": "`ground: {point",
            "contact": "`walls: {tube", "friction": "`ground: {..., friction: 0.3}`", "torque": "`magnetic_torque: {}`",
            "weight": "`gravity: {}`", "force": "there is no other force", "dipoles": "`magnetic_interaction: {}`",
            "viscoelasticity": "`viscosity: {loss_factor: 0.1}`", "insertion": "`feed: {speed", "inertia": "solver: {dynamic",
            "sparkles": "docs/effects.md",
        }.items()
    ),
    edit("fluid without its numbers", "  gravity: {}", "  fluid: {density: 1000 kg/m^3}", "effects.fluid.viscosity", "nothing"),
    edit("two streams", "  gravity: {}", "  fluid: {density: 1 g/cm^3, viscosity: 1 mPa s, velocity: [1 m/s, 0 m/s, 0 m/s], mean_speed: 1 m/s}",
         "effects.fluid.mean_speed", '"1 m/s"', "give `velocity` or `mean_speed`, not both"),
    edit("flow without a tube", "  gravity: {}", "  fluid: {density: 1 g/cm^3, viscosity: 1 mPa s, mean_speed: 1 m/s}", "effects.fluid.mean_speed",
         '"1 m/s"', "needs the tube that it flows through"),
    edit("stream of negative density", "  gravity: {}", "  fluid: {density: -1 g/cm^3, viscosity: 1 mPa s}", "effects.fluid.density", '"-1 g/cm^3"'),
    edit("a key of studies", "solver:", "vary: {magnetization: {}}\nsolver:", "vary", '{"magnetization": {}}', "magmpm design STUDY"),
]

# fmt: on
CASES = [
    *FILES,
    *UNITS,
    *BOUNDS,
    *KEYS,
    *SHAPES,
    *TOGETHER,
    *REFERENCES,
    *SURROUNDINGS,
    *FIELDS,
    *MOTION,
    *MOVED,
    *RESOLUTION,
    *IN_OTHER_WORDS,
]
