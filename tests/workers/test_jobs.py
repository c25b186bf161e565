"""The job files of docs/jobs pass their own linters, and name what is there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import rod_solve
import yaml
from rod_solve import STUDY, write_study

from magmpm.cli.arguments import parser

ROOT = Path(__file__).parents[2]
JOBS = ROOT / "docs" / "jobs"
pytestmark = pytest.mark.slow


def needs(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"needs {program}: apt-get install {program}")
    return found


def test_slurm_script_is_a_shell_script() -> None:
    subprocess.run(["bash", "-n", str(JOBS / "slurm.sbatch")], check=True)
    lines = (JOBS / "slurm.sbatch").read_text().splitlines()
    code = [k for k, line in enumerate(lines) if line and not line.startswith("#")]
    options = [k for k, line in enumerate(lines) if line.startswith("#SBATCH ")]
    assert max(options) < min(code), "sbatch reads options up to the first command"
    assert all(re.fullmatch(r"#SBATCH --[a-z-]+(=\S+)?", lines[k]) for k in options)


def test_slurm_script_by_shellcheck() -> None:
    subprocess.run([needs("shellcheck"), str(JOBS / "slurm.sbatch")], check=True)


def test_slurm_script_begins_the_command(tmp_path: Path) -> None:
    """With a magmpm that prints what it is given: no password is among it."""
    (tmp_path / "magmpm").write_text('#!/bin/sh\necho "$MAGMPM_STORAGE" >&2\necho "$@"\n')
    (tmp_path / "magmpm").chmod(0o755)
    (tmp_path / "storage").write_text("postgresql://me:secret@host/db\n")
    env = {
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "MAGMPM_STORAGE_FILE": str(tmp_path / "storage"),
        "HOME": str(tmp_path),
    }
    slurm = {"SLURM_CPUS_PER_TASK": "8", "SLURM_ARRAY_TASK_ID": "3"}
    done = subprocess.run(
        ["bash", str(JOBS / "slurm.sbatch"), "a/study.yaml"],
        env={**env, **slurm},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "design a/study.yaml --workers 8 --out runs/study-3 --no-pictures\n"
    assert done.stderr == "postgresql://me:secret@host/db\n"
    parser().parse_args(done.stdout.split())


def test_kubernetes_job() -> None:
    (job,) = (
        document
        for document in yaml.safe_load_all((JOBS / "kubernetes.yaml").read_text())
        if document
    )
    assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
    pod = job["spec"]["template"]["spec"]
    assert pod["restartPolicy"] in ("OnFailure", "Never"), "a Job allows no other"
    (container,) = pod["containers"]
    assert {mount["name"] for mount in container["volumeMounts"]} == {
        volume["name"] for volume in pod["volumes"]
    }
    parser().parse_args([*container["command"][1:], *container["args"]])
    assert "value" not in container["env"][0], "the URL comes from a secret"


def test_kubernetes_job_by_yamllint() -> None:
    rules = "{extends: default, rules: {line-length: {max: 140}, braces: {max-spaces-inside: 1}}}"
    subprocess.run(
        [needs("yamllint"), "-s", "-d", rules, str(JOBS / "kubernetes.yaml")], check=True
    )


def test_dask_runs_a_study_on_a_cluster_of_this_machine(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="pip install distributed")
    study = write_study(
        tmp_path, STUDY, rod_solve.SCENE.replace("cells_across: 4", "cells_across: 2")
    )
    env = {**os.environ, "MAGMPM_STORAGE": f"sqlite:///{tmp_path}/trials.db"}
    env["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    command = [
        sys.executable,
        str(JOBS / "dask_study.py"),
        str(study),
        "--sessions",
        "2",
        "--out",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("8 trials") >= 2
