"""docs/first_hour.ipynb: it is stored without outputs, its code is that of Python, and (slow) all of it runs.

Executed by nbclient in a kernel, where the extra `notebook` is installed (`make test-docs`); else cell by cell in one process.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs/first_hour.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def test_it_is_stored_without_outputs() -> None:
    assert len(CODE) >= 8
    for cell in CELLS:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    assert NOTEBOOK.stat().st_size < 20_000
    for text in CODE:
        ast.parse(text)


@pytest.mark.slow
def test_all_of_it_runs(tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(ROOT / "data")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    if find_spec("nbclient") and find_spec("ipykernel"):
        import nbclient
        import nbformat

        os.environ["PYTHONPATH"] = str(ROOT)  # of the kernel
        notebook = nbformat.read(NOTEBOOK, as_version=4)  # type: ignore[no-untyped-call]
        done = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
        shown = [output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs]
        pictures = [output for output in shown if "<svg" in str(output.get("data", {}).get("text/html", ""))]
        assert len(pictures) == 3  # the scene, the result, the best design
    else:
        script = tmp_path / "cells.py"
        script.write_text("\n".join(CODE), encoding="utf-8")
        ran = subprocess.run([sys.executable, str(script)], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr[-3000:]
