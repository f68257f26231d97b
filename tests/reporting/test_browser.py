"""The pages in a real browser, driven as their readers do: no error, no request, and every control does what it says."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imsave

from tests.browser import OPTIONS
from tests.truth.png import read_png
from twin import cli

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (pip install playwright)")

ROOT = Path(__file__).resolve().parents[2]
PICTURES = Path(__file__).with_name("pictures")
"""Screenshots as they should look; each pixel is the mean of `BLOCK` × `BLOCK` pixels, so that fonts do not matter. After an intended
change: TWIN_RENEW_PICTURES=1 pytest tests/reporting/test_browser.py, and look at the pages."""
BLOCK = 20
MEAN, FEW = 4.0, 40.0
"""Permitted difference of 255: on average, and of the 99th percentile of the pixels."""


class Visit:
    """A page in the browser, with what it asked for and what went wrong."""

    def __init__(self, page: Any, path: Path) -> None:
        self.page, self.errors, self.requests = page, [], []
        page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_load_state("load")

    def check(self) -> None:
        """Fail if the page logged an error, asked for anything but itself, or has no policy that forbids it."""
        assert self.errors == []
        outside = [url for url in self.requests if not url.startswith(("file:", "data:", "blob:"))]
        assert outside == [] and sum(url.startswith("file:") for url in self.requests) == 1
        policies = self.page.locator("meta[http-equiv='Content-Security-Policy']")
        assert policies.count() == 1 and str(policies.get_attribute("content")).startswith("default-src 'none'")

    def picture(self, path: Path) -> np.ndarray:
        """Return the page as it is seen, (height, width, 3)."""
        path.write_bytes(self.page.screenshot())
        return np.asarray(read_png(path), dtype=float)[:, :, :3]

    def difference(self, name: str, path: Path) -> float:
        """Return the difference between the page and its stored picture, 1: the largest that is permitted."""
        seen = self.picture(path)
        rows, columns = (size // BLOCK * BLOCK for size in seen.shape[:2])
        coarse = seen[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK, 3).mean(axis=(1, 3))
        stored = PICTURES / f"{name}.png"
        if os.environ.get("TWIN_RENEW_PICTURES"):
            imsave(stored, np.round(coarse).astype(np.uint8))
        off = np.abs(np.asarray(read_png(stored), dtype=float)[:, :, :3] - coarse)
        return float(max(off.mean() / MEAN, np.percentile(off, 99.0) / FEW))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("Chromium is not installed (Debian: apt install chromium)")
    with sync_api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=found, args=[one for one in OPTIONS if "headless" not in one])
        yield chromium
        chromium.close()


def make(*words: object, status: int = 0) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(word) for word in words])
    assert stopped.value.code == status


@pytest.mark.slow
def test_the_scene_plays_seeks_and_resets(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.html"
    make("scene", "cone_frustum.nc", "-o", path, "--tool-length", "120")
    visit = Visit(browser.new_page(viewport={"width": 1000, "height": 700}), path)
    page = visit.page
    page.wait_for_selector("#now span")
    shown = page.locator("#now")
    page.wait_for_timeout(300)

    def seek(value: int) -> str:
        page.locator("#slider").evaluate(f"one => {{ one.value = {value}; one.dispatchEvent(new Event('input')); }}")
        page.wait_for_timeout(400)
        return str(shown.inner_text())

    start, middle, end = seek(0), seek(500), seek(1000)
    assert len({start, middle, end}) == 3 and all("line" in text and "X" in text for text in (start, middle, end))
    assert seek(500) == middle
    assert int(start.split("line")[1].split()[0]) < int(middle.split("line")[1].split()[0])

    first = visit.picture(tmp_path / "first.png")
    assert visit.difference("scene", tmp_path / "scene.png") < 1.0
    seek(0)
    assert np.abs(visit.picture(tmp_path / "moved.png") - first).max() > 50.0, "the machine did not move"
    seek(500)
    assert np.abs(visit.picture(tmp_path / "again.png") - first).mean() < 0.5, "the same moment looks different"

    page.mouse.move(300, 350)
    page.mouse.down()
    page.mouse.move(420, 300, steps=5)
    page.mouse.up()
    page.wait_for_timeout(300)
    assert np.abs(visit.picture(tmp_path / "turned.png") - first).mean() > 1.0, "dragging did not turn the view"
    page.click("#view")
    page.wait_for_timeout(400)
    assert np.abs(visit.picture(tmp_path / "reset.png") - first).mean() < 0.5, "the view was not reset"

    seek(0)
    page.click("#play")
    assert "Pause" in page.locator("#play").inner_text()
    page.wait_for_timeout(1500)
    page.click("#play")
    assert "Play" in page.locator("#play").inner_text()
    stopped = shown.inner_text()
    assert stopped != start
    page.wait_for_timeout(500)
    assert shown.inner_text() == stopped
    visit.check()


@pytest.mark.slow
def test_the_report_and_its_print_view(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    make("report", "-o", path, "--tool-length", "120")
    visit = Visit(browser.new_page(viewport={"width": 1280, "height": 900}), path)
    page = visit.page
    for link in page.locator("a[href^='#']").all():
        target = str(link.get_attribute("href"))
        assert page.locator(f"[id='{target[1:]}']").count() == 1, target
    for picture in page.locator("img").all():
        assert picture.evaluate("one => one.complete && one.naturalWidth > 0")
    assert page.locator("svg, img, canvas").count() > 5
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert "ILLUSTRATIVE" in page.locator("body").inner_text()
    assert visit.difference("report", tmp_path / "seen.png") < 1.0
    page.evaluate("window.scrollTo(0, 1500)")
    if not os.environ.get("TWIN_RENEW_PICTURES"):
        assert visit.difference("report", tmp_path / "lower.png") > 1.0, "another part of the page looks the same"
    page.emulate_media(media="print")
    assert page.evaluate("[...document.querySelectorAll('button, input')].every(one => one.offsetParent === null)")
    assert page.pdf(format="A4").startswith(b"%PDF")
    visit.check()


@pytest.mark.slow
def test_the_page_of_a_diagnosis(browser: Any, tmp_path: Path) -> None:
    measured, path = tmp_path / "measured.csv", tmp_path / "diagnosis.html"
    calibration = ROOT / "urdf" / "dmu50.calibration.yaml"
    make("simulate", "thesis_plan.csv", "-o", measured, "--seed", "7")
    make("diagnose", measured, "--calibration", calibration, "--html", path)
    visit = Visit(browser.new_page(viewport={"width": 1280, "height": 900}), path)
    page = visit.page
    assert "no error found" in page.locator("body").inner_text().lower()
    assert visit.difference("diagnosis", tmp_path / "seen.png") < 1.0
    assert page.locator("svg, img").count() > 0
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    visit.check()


def test_the_page_of_standard_tests(browser: Any, tmp_path: Path) -> None:
    plan, measured, path = tmp_path / "plan.csv", tmp_path / "measured.csv", tmp_path / "tests.html"
    rows = [
        f"{x},225,-200,0,0,K,tool,{d}"
        for _ in range(5)
        for d in (1, -1)
        for x in (range(0, 501, 50) if d > 0 else range(500, -1, -50))
    ]
    plan.write_text("X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,approach_X\n" + "\n".join(rows) + "\n")
    make("simulate", plan, "-o", measured, "--instrument", "tracker", "--seed", "3")
    make("evaluate", measured, "--html", path)
    visit = Visit(browser.new_page(viewport={"width": 1280, "height": 900}), path)
    assert "230-2" in visit.page.locator("body").inner_text()
    assert visit.page.locator("svg, img").count() > 0
    visit.check()


@pytest.mark.slow
def test_the_page_of_an_identification(browser: Any, tmp_path: Path) -> None:
    measured, path = tmp_path / "measured.csv", tmp_path / "identified.html"
    make("simulate", "thesis_plan.csv", "-o", measured, "--seed", "7")
    make("identify", measured, "-o", tmp_path / "mine.yaml", "--html", path)
    visit = Visit(browser.new_page(viewport={"width": 1280, "height": 900}), path)
    page = visit.page
    assert "SIMULATED READINGS" in page.locator("body").inner_text()
    for picture in page.locator("img").all():
        assert picture.evaluate("one => one.complete && one.naturalWidth > 0") and picture.get_attribute("alt")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert visit.difference("identification", tmp_path / "seen.png") < 1.0
    visit.check()
