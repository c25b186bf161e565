"""What a plain `pip install magmpm` does without its extras, and what is said where an extra is missing."""

import ast
import configparser
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from test_commands import SCENE, STUDY

import magmpm
from magmpm.errors import MissingPackage, install, installed, require
from magmpm.inputs.quantities import KINDS, BadQuantity, _factor_in_pint, parse_quantity

ROOT = Path(__file__).resolve().parents[2]
IMPORTS = {  # where a package's import name is another
    "grpcio": "grpc",
    "imageio-ffmpeg": "imageio_ffmpeg",
    "optuna-dashboard": "optuna_dashboard",
    "pillow": "PIL",
    "protobuf": "google.protobuf",
}
GRIPPER = ROOT / "data/scenes/gallery/gripper.yaml"
MOTION = SCENE.replace("name: ", "solver: {dynamic: {duration: 1 ms}}\nname: ")


def extras() -> dict[str, set[str]]:
    """The extras of setup.cfg, each with the import names of the packages that it brings itself."""
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    found = {}
    for extra, lines in told["options.extras_require"].items():
        names = {re.split(r"[\s\[>]", line)[0] for line in lines.split("\n") if line}
        found[extra] = {IMPORTS.get(name, name) for name in names}
    return found


def test_a_plain_installation_names_six_packages() -> None:
    """Numba and what equilibria need; all else is an extra."""
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    needed = {line.split()[0] for line in told["options"]["install_requires"].split("\n") if line}
    assert needed == {
        "PyYAML",
        "filelock",
        "numba",
        "numpy",
        "pydantic",
        "scipy",
    }


def test_an_equilibrium_needs_no_extra(tmp_path: Path) -> None:
    """With every package of every extra made impossible to import, `magmpm run` gives the same numbers, to the last bit."""
    packages = set().union(*extras().values())
    refused = sorted(packages - {"magmpm", "google.protobuf"})
    assert {"h5py", "matplotlib", "optuna", "pint", "tqdm"} <= set(refused)
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "sitecustomize.py").write_text(
        f"import sys\nsys.modules.update(dict.fromkeys({refused}))\n"
    )
    found = {}
    for name, path in (("bare", str(tmp_path)), ("whole", "")):
        done = subprocess.run(
            [sys.executable, "-m", "magmpm", "run", "scene.yaml", "--json", "--out", name],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        found[name] = json.loads(done.stdout)
    assert found["bare"]["converged"]
    for key in ("tip", "centreline", "energy"):
        assert found["bare"][key] == found["whole"][key]


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        (["run", "motion.yaml"], "h5py", "motion"),
        (["run", "scene.yaml", "--render"], "matplotlib", "render"),
        (["render", "."], "matplotlib", "render"),
        (["accuracy", "scene.yaml"], "matplotlib", "render"),
        (["map", "scene.yaml"], "matplotlib", "render"),
        (["fit", "tips.csv", "scene.yaml"], "matplotlib", "render"),
        (["design", "study.yaml"], "optuna", "design"),
        (["report", "."], "optuna", "design"),
        (["dashboard", "."], "optuna_dashboard", "dashboard"),
        (["run", str(GRIPPER)], "manifold3d", "parts"),
        (["run", "magnet.yaml"], "magpylib", "magnets"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_a_command_names_the_extra_that_it_lacks(
    command: list[str],
    package: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    told,
) -> None:
    """Before it begins, with status 2, and no results are left."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)  # type: ignore[arg-type]
    magnet = (
        "{cylinder: {diameter: 5 mm, length: 5 mm}, position: [60 mm, 0 mm, 0 mm], remanence: 1 T}"
    )
    Path("scene.yaml").write_text(SCENE)
    Path("motion.yaml").write_text(MOTION)
    Path("study.yaml").write_text(STUDY)
    Path("study.json").write_text("{}")  # what `magmpm dashboard` takes a study's folder by
    Path("magnet.yaml").write_text(
        re.sub("field: .*", f"field: {{magnet: {magnet}}}", SCENE).replace(
            "magnetic_torque: {}", "magnetic_torque: {}, magnetic_force: {}"
        )
    )
    before = files_in(tmp_path)
    said = told(
        *command,
        status=2,
        says=(
            f"the package {package}, which is not installed\n",
            f"rule: it belongs to the extra `{extra}` of magmpm\n",
            f"remedy: {install(extra)}",
        ),
    )
    assert said.out == ""
    assert files_in(tmp_path) == before


def test_what_has_meshes_is_named_where_their_package_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told
) -> None:
    """Once for all meshes of a body; with file, line, key and value, as every error of a scene."""
    monkeypatch.setitem(sys.modules, "manifold3d", None)  # type: ignore[arg-type]
    vessel = tmp_path / "vessel.yaml"
    walls = "walls: {surface: {mesh: vessel.stl, unit: mm}}"
    vessel.write_text(SCENE.replace("magnetic_torque: {}", f"magnetic_torque: {{}}, {walls}"))
    for scene, key, value in (
        (GRIPPER, "body.parts.meshes", '[{"mesh": "meshes/gripper_hub.stl"'),
        (vessel, "effects.walls.surface.mesh", '"vessel.stl"'),
    ):
        lines = scene.read_text().splitlines()
        line = next(n for n, text in enumerate(lines, 1) if re.search("meshes:|vessel.stl", text))
        said = told("run", str(scene), status=2).err
        assert said.startswith(f"magmpm: {scene}:{line}: {key}: received {value}")
        assert said.count("the package manifold3d, which is not installed\n") == 1


def test_in_python_the_error_is_one_class(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)  # type: ignore[arg-type]
    with pytest.raises(MissingPackage, match=r"magmpm\.design: studies need the package optuna"):
        magmpm.design(ROOT / "data/studies/s_shape.yaml")
    assert issubclass(MissingPackage, magmpm.InputError)


def test_a_result_without_the_extra_of_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # type: ignore[arg-type]
    for kind in (magmpm.Result, magmpm.Motion):
        with pytest.raises(MissingPackage, match=r"render: pictures need .*\n.*\n.*\[render\]"):
            kind.render(object.__new__(kind), "picture.png")


def test_what_searches_nothing_imports_without_optuna() -> None:
    """Fits, sweeps, influence, maps and the viewer."""
    modules = (
        "cli.tables, cli.view_pages, studies.explore.accuracy, studies.explore.effects_table, "
        "studies.explore.live, studies.explore.tip_map, studies.fitting, studies.goals.sweep, "
        "studies.hard_cases, studies.in_python"
    )
    code = "import sys\nsys.modules.update(dict.fromkeys(['optuna', 'sqlalchemy', 'h5py', 'matplotlib']))\n"
    code += "".join(f"import magmpm.{name}\n" for name in modules.split(", "))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_units_without_pint(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the table are read; of others the message has the table, the unit that was meant, and the extra."""
    monkeypatch.setitem(sys.modules, "pint", None)  # type: ignore[arg-type]
    _factor_in_pint.cache_clear()
    assert parse_quantity("40 mm", KINDS["length"]) == 0.04
    with pytest.raises(BadQuantity, match=r"m, cm, mm, .* need the package pint") as error:
        parse_quantity("1 furlong", KINDS["length"])
    assert error.value.remedy == f"write one of these, or {install('units')}"
    with pytest.raises(BadQuantity, match="did you mean"):
        parse_quantity("1 kpa", KINDS["pressure"])


def test_what_is_installed_is_found_without_being_imported() -> None:
    require("json", "design", key="here", use="tests")
    assert installed("json.decoder")
    assert not installed("no_such_package")
    assert not installed("no_such_package.inside")
    with pytest.raises(MissingPackage) as error:
        require("no_such_package", "parts", key="body", use="boxes", instead="use a strip")
    assert str(error.value) == (
        "body: boxes need the package no_such_package, which is not installed\n"
        "  rule: it belongs to the extra `parts` of magmpm\n"
        f"  remedy: {install('parts')}, or use a strip"
    )


def test_each_extra_that_is_named_brings_its_package() -> None:
    """Of every call of `require` and `install` in the sources."""
    known = extras()
    named = []
    for top in ("magmpm", "studies", "viz"):
        for path in (ROOT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if (
                    isinstance(node, ast.Call)
                    and ast.unparse(node.func).split(".")[-1] == "require"
                ):
                    named.append([ast.literal_eval(of) for of in node.args if is_text(of)])
                if isinstance(node, ast.Call) and ast.unparse(node.func) == "install":
                    named.append([ast.literal_eval(of) for of in node.args if is_text(of)])
    assert len(named) > 15
    for words in named:
        if words:
            assert words[-1] in known
        if len(words) == 2:
            assert words[0] in known[words[1]], words


def files_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


@pytest.mark.parametrize(
    ("source", "command"),
    [
        (None, "pip install 'magmpm[parts]'"),  # from an index
        ({"url": "file:///a%20b/m.whl", "archive_info": {}}, "pip install '/a b/m.whl[parts]'"),
        (
            {"url": "file:///clone", "dir_info": {"editable": True}},
            "pip install -e '/clone[parts]'",
        ),
        ({"url": "file:///clone", "dir_info": {}}, "pip install '/clone[parts]'"),
    ],
)
def test_an_extra_is_installed_from_where_magmpm_came(
    source: dict[str, object] | None,
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By what pip notes of an installation (PEP 610): an index need not have magmpm."""
    installation = tmp_path / "magmpm-9.dist-info"
    installation.mkdir()
    (installation / "METADATA").write_text("Metadata-Version: 2.1\nName: magmpm\nVersion: 9\n")
    if source is not None:
        (installation / "direct_url.json").write_text(json.dumps(source))
    monkeypatch.syspath_prepend(tmp_path)
    assert install("parts") == command
