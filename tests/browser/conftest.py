"""Chromium, headless, with the page of `magmpm view` before it. Where Playwright or Chromium is missing the tests skip, and say so.

`make test-browser` installs Playwright and runs them; Chromium comes from the system (apt-get install chromium).
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# No display and no graphics card is needed: SwiftShader draws. What else a browser would ask the network for is switched off.
FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Playwright's browser."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="Playwright is not installed: make test-browser"
    )
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=found, headless=True, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def view(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """view(scene, *options) -> the page of that scene, when it is there. At the end: nothing was complained of in the console."""
    servers = []
    troubles = []

    def open_page(scene: Path, *options: str) -> Any:
        usual = ["--json", "--port", "0", "--out", str(tmp_path / "out")]
        command = [sys.executable, "-m", "magmpm.cli", "view", str(scene), *usual, *options]
        server = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
        servers.append(server)
        line = server.stdout.readline()
        assert line, server.stderr.read() if server.stderr else ""
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.on(
            "console",
            lambda message: (
                troubles.append(message.text) if message.type in ("error", "warning") else None
            ),
        )
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.goto(json.loads(line)["url"])
        return page

    yield open_page
    for server in servers:
        server.terminate()
        server.wait()
    # A request that was refused on purpose is told of by the browser itself.
    refused = ("400 (Bad Request)", "403 (Forbidden)")
    assert [text for text in troubles if not any(words in text for words in refused)] == []
