"""How long from a slider's move to the new shape on the screen, measured in the browser: preview and solution, 4 cells across.

    make bench-view

The slider of Bz is moved to 100 values, each after the solution for the one before was drawn, as by a hand that waits; then it is dragged,
a move every 16 ms, and the shapes that appear are counted. Times: from the input event to the end of the animation frame that drew it.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "browser"))
MOVES = """async (count) => {
  const view = window.magmpm, slider = document.querySelector('input[data-id="field.uniform[2]"]');
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const move = (value) => { slider.value = value; slider.dispatchEvent(new Event('input', { bubbles: true })); };
  const out = [];
  for (let k = 0; k < count; k++) {
    move(2 + 12 * ((k * 37) % 101) / 101);
    const version = view.version;
    while (!view.latencies.some((one) => one.version === version && one.state === 'solved')) await pause(1);
    await pause(60);
  }
  out.push(view.latencies.splice(0));
  const begun = performance.now();
  for (let k = 0; performance.now() - begun < 5000; k++) { move(8 + 4 * Math.sin(k / 30)); await pause(16); }
  const dragged = view.latencies.splice(0), seconds = (performance.now() - begun) / 1e3;
  out.push({ drawn: dragged.length / seconds, solved: dragged.filter((one) => one.state === 'solved').length / seconds });
  return out;
}"""


def measured(count: int) -> dict[str, Any]:
    """Milliseconds and rates."""
    from conftest import BROWSERS, FLAGS  # type: ignore[attr-defined]  # of tests/browser
    from playwright.sync_api import sync_playwright

    scene = ROOT / "data" / "scenes" / "five_segments.yaml"
    command = [sys.executable, "-m", "magmpm.cli", "view", str(scene), "--json", "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert server.stdout is not None
        url = json.loads(server.stdout.readline())["url"]
        with sync_playwright() as running:
            found = next(path for name in BROWSERS if (path := shutil.which(name)))
            browser = running.chromium.launch(executable_path=found, headless=True, args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.goto(url)
            page.wait_for_selector("#state.solved", timeout=120_000)
            page.evaluate(MOVES, 5)
            times, rates = page.evaluate(MOVES, count)
            browser.close()
    finally:
        server.terminate()
        server.wait()
    out: dict[str, Any] = {"drawn_per_second": rates["drawn"], "solved_per_second": rates["solved"]}
    for state in ("preview", "solved"):
        of = [one["ms"] for one in times if one["state"] == state]
        out[state] = (
            {
                "median_ms": float(np.median(of)),
                "p95_ms": float(np.quantile(of, 0.95)),
                "count": len(of),
            }
            if of
            else None
        )
    return out


if __name__ == "__main__":
    print(json.dumps(measured(100), indent=2))
