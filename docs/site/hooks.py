"""What MkDocs calls while it builds the site: formulas become MathML, and the API's pages are made from docstrings.

MathML needs no script and no network: every browser draws it.
"""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

API = Path(__file__).with_name("api.py")
FORMULA = re.compile(r"^\$\$(.*?)\$\$$", re.DOTALL | re.MULTILINE)


def on_config(config: Any) -> Any:
    """Pages that the navigation does not list come under `More`, so that none is lost."""
    listed = str(config.nav)
    pages = sorted(
        path.name for path in Path(config.docs_dir).glob("*.md") if f"'{path.name}'" not in listed
    )
    if pages:
        config.nav.append({"More": pages})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Pages without files of their own: one for each script of examples/, to which docs/examples.md links, and the rooms of studies."""
    from mkdocs.structure.files import File

    for path in sorted(Path(config.docs_dir).parent.glob("examples/*.py")):
        text = f"# {path.name}\n\n```python\n{path.read_text(encoding='utf-8')}```\n"
        files.append(File.generated(config, f"examples/{path.stem}.md", content=text))
    made: str = runpy.run_path(str(API))["studies_page"]()
    files.append(File.generated(config, "api_studies.md", content=made))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The API's page from docstrings; elsewhere formulas between double dollars as MathML, without the comments for tests."""
    from latex2mathml.converter import convert

    if page.file.src_uri == "api_studies.md":
        return markdown
    if page.file.src_uri == "api.md":
        made: str = runpy.run_path(str(API))["page"]()
        return made
    if page.file.src_uri == "examples.md":
        markdown = re.sub(r"\(\.\./examples/(\w+)\.py\)", r"(examples/\1.md)", markdown)
    markdown = re.sub(r"^<!-- test: .*? -->\n", "", markdown, flags=re.MULTILINE)
    return FORMULA.sub(
        lambda found: f'<div class="formula">{convert(found[1].strip(), display="block")}</div>',
        markdown,
    )
