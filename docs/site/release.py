"""`make release`: sdist and wheel of what git knows, with a page for PyPI on which no link is dead.

PyPI shows README.md without the repository around it, so relative links and pictures lead nowhere there. Where the remote `origin` has an
address on the web, they become links to this version's tag there. Where it has none, pictures are left out, and of a link to a page its
name stays, in italics.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(!?)\[([^\[\]]*)\]\(([^()\s]+)\)")
REMOTE = re.compile(r"(?:https://|ssh://git@|git@)([\w.-]+)[:/]([\w./-]+?)(?:\.git)?/?")


def address(remote: str) -> str | None:
    """The web address of a repository, by that of its remote: https://HOST/OWNER/NAME. None for a folder, or without a remote."""
    found = REMOTE.fullmatch(remote)
    return found and f"https://{found[1]}/{found[2]}"


def page(readme: str, at: str | None, tag: str) -> str:
    """README as PyPI shows it: with links below the address `at` for a tag, or without pictures and links into the repository."""

    def whole(link: re.Match[str]) -> str:
        image, text, target = link.groups()
        if "://" in target or target.startswith("#"):
            return link[0]
        if at is None:
            return "" if image else f"*{text}*"
        return f"{image}[{text}]({at}/{'raw' if image else 'blob'}/{tag}/{target})"

    return re.sub(r"\n{3,}", "\n\n", re.sub(r"[ \t]+$", "", LINK.sub(whole, readme), flags=re.M))


def copied(folder: Path, at: str | None) -> Path:
    """A folder with the files that git knows, README as PyPI's page, and links to the repository in setup.cfg where it has an address."""
    known = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    for name in known:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        # magmpm/studies and magmpm/viz are links
        shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    settings = folder / "setup.cfg"
    told = ConfigParser()
    told.read(settings, encoding="utf-8")
    tag = f"v{told['metadata']['version']}"
    readme = folder / "README.md"
    readme.write_text(page(readme.read_text(encoding="utf-8"), at, tag), encoding="utf-8")
    if at is not None:
        links = "".join(
            f"    {name} = {at}{place}\n"
            for name, place in (
                ("Source", ""),
                ("Documentation", f"/blob/{tag}/docs/index.md"),
                ("Changelog", f"/blob/{tag}/CHANGELOG.md"),
            )
        )
        text = settings.read_text(encoding="utf-8")
        text = text.replace("[metadata]\n", f"[metadata]\nproject_urls =\n{links}", 1)
        settings.write_text(text, encoding="utf-8")
    return folder


def main(out: Path) -> None:
    """Build into a folder, and say what PyPI's page has."""
    remote = subprocess.run(
        ["git", "remote", "get-url", "origin"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    at = address(remote)
    source = copied(out / "source", at)
    subprocess.run([sys.executable, "-m", "build", "--outdir", out, source], check=True)
    shutil.rmtree(source)
    print(
        f"page for PyPI: links and pictures are those of {at}, so push the version's tag first"
        if at
        else f"page for PyPI: without pictures and links, as the remote {remote or '(none)'} has no"
        " address on the web"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
