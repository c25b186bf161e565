"""The sampler's package for OptunaHub: it stands alone, and has what the registry asks for."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[3]


def test_the_package_stands_alone(tmp_path: Path) -> None:
    """Its example finds the certified least of NIST's MGH09 within 1 %, in a process that can't import the project."""
    made = runpy.run_path(str(ROOT / "docs/optunahub/build.py"))
    package = made["build"](tmp_path)
    head = yaml.safe_load((package / "README.md").read_text(encoding="utf-8").split("---\n")[1])
    assert {"author", "title", "description", "tags", "optuna_versions", "license"} == set(head)
    assert "sampler" in head["tags"]
    assert {"LICENSE", "README.md", "__init__.py", "example.py", "requirements.txt", "tests"} <= {
        path.name for path in package.iterdir()
    }
    code = (
        "import sys, runpy; sys.modules['magmpm'] = None; runpy.run_path(sys.argv[1],"
        " run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(package / "example.py")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert float(done.stdout.split()[3]) < 1.01 * 3.0750560385e-4
    with pytest.raises(ValueError, match="needs magmpm"):
        made["standalone"]("from magmpm.errors import InputError\n", ".")
