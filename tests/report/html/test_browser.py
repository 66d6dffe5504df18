"""The page in a real browser, offline."""

import html
import json
import re
import shutil
import subprocess

import pytest

from calib.report.html.study_results import StudyResults
from calib.report.html.write import page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--enable-unsafe-swiftshader",
    "--enable-logging=stderr", "--v=0", "--window-size=1366,768", "--virtual-time-budget=30000", "--dump-dom",
]  # fmt: skip
PROBE = """
<script>
(async () => {
  const report = {};
  const figures = [...document.querySelectorAll("figure")];
  const wait = (time) => new Promise((done) => setTimeout(done, time));
  while (figures.some((f) => !f.dataset.drawn)) await wait(100);
  report.empty = figures.filter((f) => !f.querySelector(".main-svg, canvas")).map((f) => f.id);
  report.silent = figures.filter((f) => !f.querySelector("[role=img]").getAttribute("aria-label")).map((f) => f.id);
  report.wide = document.documentElement.scrollWidth > window.innerWidth;
  report.loaded = performance.getEntriesByType("resource").map((r) => r.name).filter((r) => !/^(data|blob):/.test(r));
  const shapes = document.getElementById("mode-shapes");
  if (shapes) {
    const place = shapes.querySelector(".drawing"), play = shapes.querySelector(".play");
    const modes = shapes.querySelector("select.mode");
    const here = () => JSON.stringify(place.data[1].x) + JSON.stringify(place.data[3].x);
    const still = here();
    play.click();
    await wait(400);
    const moving = here();
    play.click();
    await wait(200);
    const paused = here();
    await wait(400);
    report.moved = still !== moving;
    report.held = paused === here();
    modes.value = 1;
    modes.dispatchEvent(new Event("change"));
    await wait(200);
    report.other = shapes.querySelector(".facts").textContent;
    report.label = place.getAttribute("aria-label");
  }
  const place = document.createElement("pre");
  place.id = "probe";
  place.textContent = JSON.stringify(report);
  document.body.append(place);
})();
</script>
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed, so the page is not opened"),
]


def opened(text, tmp_path):
    """The page after its scripts have run, the probe's report, and the console's lines."""
    file = tmp_path / "report.html"
    file.write_text(text.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    command = [BROWSER, *OPTIONS, f"--user-data-dir={tmp_path / 'profile'}", file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    probe = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout, re.S)
    assert probe is not None, done.stderr[-2000:]
    return done.stdout, json.loads(html.unescape(probe[1])), [x for x in done.stderr.splitlines() if "CONSOLE" in x]


def faults(console):
    """Lines of the console other than notes on speed."""
    return [line for line in console if not re.search(r"willReadFrequently|GPU stall due to ReadPixels", line)]


def test_every_figure_is_drawn_and_moves_without_a_fault(everything, tmp_path):
    page_after, report, console = opened(page(StudyResults(everything, "A mast", True)), tmp_path)
    assert faults(console) == []
    assert re.search(r'<p id="faults"[^>]*hidden', page_after)
    assert report["empty"] == [] and report["silent"] == [] and report["loaded"] == [] and not report["wide"]
    assert report["moved"] and report["held"]
    assert report["other"].startswith("B1z: measured")
    assert report["label"] == f"Mode shape before calibration: {report['other']}"


def test_a_study_without_modes_is_drawn_too(scalar, tmp_path):
    page_after, report, console = opened(page(StudyResults(scalar, "Five masses", True)), tmp_path)
    assert faults(console) == [] and re.search(r'<p id="faults"[^>]*hidden', page_after)
    assert report["empty"] == [] and report["silent"] == [] and report["loaded"] == []
