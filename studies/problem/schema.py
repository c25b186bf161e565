"""Writes the JSON schema by which editors complete and explain study files.

python -m magmpm.studies.problem.schema             # rewrites studies/study.schema.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from magmpm.inputs.settings import json_schema, write_json_schema
from magmpm.studies.problem.study_file import StudyFile

PATH = Path(__file__).parents[1] / "study.schema.json"


def study_schema() -> dict[str, Any]:
    """JSON schema of study files, made from the models."""
    return json_schema(StudyFile)


if __name__ == "__main__":
    write_json_schema(StudyFile, PATH)
    print(PATH)
