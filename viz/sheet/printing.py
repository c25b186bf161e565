"""A page as PDF, without LaTeX: by WeasyPrint where it is installed, else by a Chromium that is on this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from magmpm.errors import MagmpmError, install
from magmpm.results.whole_file import whole_file

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
)
QUIET = (
    "--headless",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)
REMEDY = (
    f"{install('report')} (WeasyPrint), or install Chromium (apt-get install chromium), or print"
    " the page from a browser"
)


class PrintError(MagmpmError):
    """Reason why no PDF could be made."""


def printed(html: str, path: Path) -> str:
    """Write a page as PDF. Returns what printed it. Raises PrintError where nothing here can."""
    html = html.replace(
        "<details>", "<details open>"
    )  # paper can't be clicked; user texts are escaped and hold no such tag
    reasons = []
    for printer in (_by_weasyprint, _by_browser):
        try:
            with whole_file(path) as part:
                return printer(html, part)
        except PrintError as error:
            reasons.append(str(error))
    raise PrintError(f"no PDF: {'; '.join(reasons)}; {REMEDY}")


def _by_weasyprint(html: str, path: Path) -> str:
    try:
        import weasyprint
        from weasyprint.urls import URLFetcher
    except (ImportError, OSError) as error:  # OSError: Pango, which it draws with, is missing
        raise PrintError(f"WeasyPrint is not at hand ({str(error).splitlines()[0]})") from None

    try:
        only_within = URLFetcher(allowed_protocols=["data"])  # a page loads nothing from elsewhere
        weasyprint.HTML(string=html, url_fetcher=only_within).write_pdf(str(path))
    except Exception as error:  # a printer's own faults: the other one may do
        raise PrintError(f"WeasyPrint did not print ({type(error).__name__}: {error})") from None
    return f"WeasyPrint {weasyprint.__version__}"


def _by_browser(html: str, path: Path) -> str:
    seconds_to_print = 120.0  # s
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise PrintError("there is no Chromium or Chrome")
    with tempfile.TemporaryDirectory(prefix="magmpm-print-") as folder:
        page = Path(folder) / "page.html"
        made = Path(folder) / "page.pdf"
        page.write_text(html, encoding="utf-8")
        unsafe = (
            ["--no-sandbox"] if getattr(os, "geteuid", lambda: 1)() == 0 else []
        )  # its sandbox does not run as root
        options = [*QUIET, *unsafe, f"--user-data-dir={folder}/profile", f"--print-to-pdf={made}"]
        try:
            done = subprocess.run(
                [browser, *options, page.as_uri()],
                capture_output=True,
                text=True,
                timeout=seconds_to_print,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise PrintError(f"{browser} did not print ({error})") from None
        if done.returncode or not made.exists() or not made.read_bytes().startswith(b"%PDF"):
            last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise PrintError(f"{browser} did not print ({last})")
        shutil.copyfile(made, path)
    return Path(browser).name
