"""Writes the JSON schema by which editors complete and explain scene files.

python -m magmpm.scene.json_schema             # rewrites magmpm/scene.schema.json
"""

from __future__ import annotations

from pathlib import Path

from magmpm.inputs.settings import write_json_schema
from magmpm.scene import Scene

PATH = Path(__file__).parents[1] / "scene.schema.json"


if __name__ == "__main__":
    write_json_schema(Scene, PATH)
    print(PATH)
