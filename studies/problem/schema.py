"""Writes the JSON schema by which editors complete and explain study files.

python -m magmpm.studies.problem.schema             # rewrites studies/study.schema.json
"""

from __future__ import annotations

from pathlib import Path

from magmpm.inputs.settings import write_json_schema
from magmpm.studies.problem.study_file import StudyFile

PATH = Path(__file__).parents[1] / "study.schema.json"


if __name__ == "__main__":
    write_json_schema(StudyFile, PATH)
    print(PATH)
