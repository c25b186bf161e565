"""The page of `magmpm view` in a real browser: sliders move the body, states are told as they are, saved scenes run, motions play."""

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from reference.commands import scene_text

from magmpm import load_scene, run

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "data" / "scenes"
FIVE = SCENES / "five_segments.yaml"
View = Callable[..., Any]
PATIENCE = 300_000  # ms: a first run compiles, also where others use the machine
SAID = 0.6e-6  # m: the page says the tip to a thousandth of a mm


def settled(page: Any, kind: str = "solved") -> None:
    """Wait until the shape of the newest values is told as that kind."""
    page.wait_for_selector(f"#state.{kind}", timeout=PATIENCE)


def pixels(page: Any) -> np.ndarray:
    """The picture without the panel."""
    return np.asarray(
        Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB"), dtype=int
    )


def turn(page: Any, slider: str, value: float) -> None:
    """Move a slider as a hand does."""
    page.locator(f'input[data-id="{slider}"]').evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input', {"
        " bubbles: true })); }",
        value,
    )


def number(page: Any, label: str) -> str:
    """Text beside the shape."""
    return str(page.locator(f'#numbers tr:has(th:text-is("{label}")) td').inner_text())


def tip(page: Any) -> np.ndarray:
    """m."""
    return 1e-3 * np.array([float(x) for x in re.findall(r"-?[\d.]+", number(page, "tip"))])


def test_a_slider_moves_the_body(view: View) -> None:
    """The picture changes, and the tip is that of a run in the new field."""
    page = view(FIVE)
    settled(page)
    scene = load_scene(FIVE)
    np.testing.assert_allclose(tip(page), run(scene).tip, atol=SAID)
    before = pixels(page)
    turn(page, "field.uniform[2]", -6.0)
    assert (
        page.locator("#state").get_attribute("class") != "solved"
    )  # at once: what is shown is not yet that of the new value
    settled(page)
    moved = np.abs(pixels(page) - before).max(axis=2) > 40
    assert moved.mean() > 0.01  # of the picture: the body is elsewhere
    np.testing.assert_allclose(tip(page), run(scene.with_field([0.0, 6e-3, -6e-3])).tip, atol=SAID)


def test_strength_and_direction_turn_the_components(view: View) -> None:
    """Two ways to the same field."""
    page = view(FIVE, "--cells", "2")
    settled(page)
    turn(page, "polar.strength", 5.0)
    for axis, value in (("x", 0.0), ("y", 3.0), ("z", 4.0)):  # of [0, 6, 8] mT
        assert float(
            page.locator(f'input[data-number="field.{axis}"]').input_value()
        ) == pytest.approx(value, abs=0.02)
    turn(page, "field.uniform[2]", 0.0)
    assert float(
        page.locator('input[data-number="polar.elevation"]').input_value()
    ) == pytest.approx(0.0, abs=0.5)
    settled(page)


def test_old_shapes_are_never_told_as_new(view: View) -> None:
    """While a slider is dragged, what is told as solved has been solved for the values that the sliders have then; else as a preview."""
    page = view(FIVE)
    settled(page)
    wrong = page.evaluate("""async () => {
      const view = window.magmpm, slider = document.querySelector('input[data-id="field.uniform[2]"]'), wrong = [];
      const look = () => {
        const kind = document.getElementById('state').className;
        if (kind === 'solved' && (view.shown.version !== view.version || view.shown.state !== 'solved')) wrong.push('solved');
        if (kind === 'preview' && view.shown.state !== 'preview') wrong.push('preview');
      };
      for (let k = 0; k < 150; k++) {
        slider.value = 8 - 0.05 * k;
        slider.dispatchEvent(new Event('input', { bubbles: true }));
        look();
        await new Promise((done) => setTimeout(done, 8));
        look();
      }
      return wrong;
    }""")
    assert wrong == []
    settled(page)
    scene = load_scene(FIVE)
    np.testing.assert_allclose(
        tip(page), run(scene.with_field([0.0, 6e-3, 0.55e-3])).tip, atol=SAID
    )


def test_a_saved_scene_gives_the_same_shape(view: View) -> None:
    """The button says where it is; its run has the tip that was shown."""
    page = view(FIVE, "--cells", "2")
    settled(page)
    turn(page, "field.uniform[0]", -3.0)
    turn(page, "body.catheter.segments[4].magnetization.azimuth", 20.0)
    turn(page, "inserted", 31.5)
    settled(page)
    page.get_by_role("button", name="Save this scene").click()
    page.wait_for_selector("#told:has-text('Saved')")
    saved = Path(re.search(r"Saved (.*)", page.locator("#told").inner_text()).group(1))  # type: ignore[union-attr]
    np.testing.assert_allclose(run(saved).tip, tip(page), atol=SAID)


def test_the_distance_to_a_target_is_told(view: View) -> None:
    """As measured by the run; the target is drawn."""
    from magmpm.inputs.csv_tables import read_centreline
    from magmpm.studies.problem.shape_distance import gaps, root_mean_square

    target = ROOT / "data" / "targets" / "s_shape.csv"
    page = view(FIVE, "--cells", "2", "--target", str(target))
    settled(page)
    rms = root_mean_square(
        gaps(run(load_scene(FIVE).with_cells(2)).centreline, read_centreline(target))
    )
    assert float(number(page, "rms to target").split()[0]) == pytest.approx(1e3 * rms, rel=6e-3)
    blue = (pixels(page)[:, :, 2] > 150) & (pixels(page)[:, :, 0] < 80)
    assert blue.sum() > 100


def test_what_can_not_be_is_said_in_words(view: View) -> None:
    """A field beyond what a scene allows; a magnet inside the body: why, and what to do; then on as before."""
    page = view(FIVE, "--cells", "2")
    settled(page)
    typed = page.locator('input[data-number="field.uniform[0]"]')
    typed.fill("1e9")
    typed.press("Enter")
    settled(page, "failed")
    assert "remedy" in page.locator("#words").inner_text()
    page.get_by_role("button", name="As in the file").click()
    settled(page)
    assert not page.locator("#words").is_visible()


def test_a_magnet_can_be_moved(view: View) -> None:
    """The body follows; a place inside the body is refused in words."""
    pytest.importorskip("magpylib")
    page = view(SCENES / "pulled_by_magnet.yaml", "--cells", "2")
    settled(page)
    before = tip(page)
    turn(page, "field.magnet[0].position[2]", -20.0)
    settled(page)
    np.testing.assert_allclose(
        tip(page), before * [1, 1, -1], atol=2e-5
    )  # its mirror image, to the table's error
    turn(page, "field.magnet[0].position[2]", 0.0)
    turn(page, "field.magnet[0].position[0]", 30.0)
    settled(page, "failed")
    assert page.locator("#words").inner_text()


def test_a_motion_plays_pauses_and_scrubs(view: View, tmp_path: Path) -> None:
    """It is run first; frames appear while it runs."""
    solver = "{dynamic: {duration: 10 ms, output_every: 0.2 ms}}"
    field = "{uniform: [0 mT, 0 mT, 27 mT]}"
    (tmp_path / "swing.yaml").write_text(
        scene_text("swing", field=field, solver=solver, advice="off"), encoding="utf-8"
    )
    page = view(tmp_path / "swing.yaml")
    settled(page)
    assert "51 frames" in page.locator("#state").inner_text()
    page.wait_for_timeout(1500)
    page.locator("#toggle").click()
    assert page.locator("#toggle").inner_text() == "Play"
    page.wait_for_timeout(300)
    paused = pixels(page)
    page.wait_for_timeout(500)
    assert np.abs(pixels(page) - paused).max() == 0  # it stands still
    page.locator("#scrub").evaluate("(s) => { s.value = 0; s.dispatchEvent(new Event('input')); }")
    page.wait_for_timeout(500)
    first = pixels(page)
    page.locator("#scrub").evaluate(
        "(s) => { s.value = s.max; s.dispatchEvent(new Event('input')); }"
    )
    page.wait_for_timeout(500)
    assert "10.0 ms" in page.locator("#player .time").inner_text()
    assert (np.abs(pixels(page) - first).max(axis=2) > 40).mean() > 0.005


def test_an_incomplete_address_says_so(view: View) -> None:
    """Without its secret nothing is answered."""
    page = view(FIVE, "--cells", "2")
    settled(page)
    address = page.url
    page.goto("about:blank")
    page.goto(address.split("#")[0])
    page.wait_for_selector("#state.failed")
    assert "whole address" in page.locator("#words").inner_text()


def test_a_narrow_window_shows_body_and_sliders(view: View) -> None:
    """420 px wide: nothing is cut off sideways, the picture keeps 200 px and the sliders can be reached and moved."""
    page = view(FIVE, "--cells", "2")
    page.set_viewport_size({"width": 420, "height": 800})
    settled(page)
    assert (
        page.evaluate(
            "Math.max(document.documentElement.scrollWidth,"
            " document.getElementById('panel').scrollWidth)"
        )
        <= 420
    )
    box = page.locator("#view").bounding_box()
    assert box["width"] >= 400
    assert box["height"] >= 200
    slider = page.locator('input[type=range][data-id="field.uniform[2]"]')
    slider.scroll_into_view_if_needed()
    assert slider.bounding_box()["width"] >= 100
    slider.focus()
    for _ in range(3):
        slider.press("ArrowLeft")
    page.get_by_role("button", name="Save this scene").scroll_into_view_if_needed()
    settled(page)
    labels = page.locator("label.slider:visible input[type=number]")
    assert all(
        labels.nth(k).bounding_box()["x"] + labels.nth(k).bounding_box()["width"] <= 420
        for k in range(3)
    )


def test_html_in_names_is_shown_as_text(view: View, tmp_path: Path) -> None:
    """Names of files and folders; a scene's own name with < in it is refused by the scene."""
    folder = tmp_path / "<b>bold<b>"
    folder.mkdir()
    scene = folder / "<i>scene.yaml"
    target = folder / "<img src=x onerror=alert(1)>.csv"
    scene.write_bytes(FIVE.read_bytes())
    target.write_bytes((ROOT / "data" / "targets" / "s_shape.csv").read_bytes())
    page = view(scene, "--cells", "2", "--target", str(target))
    settled(page)
    assert "<img src=x onerror=alert(1)>" in page.locator("#legend").inner_text()
    page.get_by_role("button", name="Save this scene").click()
    page.wait_for_selector("#told:has-text('Saved')")
    assert page.locator("img, b, #told *").count() == 0
