"""What an engineer waits for at a slider of the live page: from the event to the drawn shape, in headless Chromium.

python tests/benchmarks/what_if.py [--study hidden_bogie vehicle] [--results DIR] [--moves 40]

Each study is compared first where it was not; its reduced basis is trained once and kept. Moves follow each other as
fast as they are drawn. Wanted: 100 ms, with the table, the MAC of all pairs and the shape drawn anew.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from page import Page

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = ["--no-sandbox", "--enable-unsafe-swiftshader"]
PATIENT = 1_800_000
"""Milliseconds in which a basis is trained."""
MOVES = """async (moves) => {
  const place = document.getElementById("what-if"), found = [];
  const sliders = [...place.querySelectorAll("input[type=range]")].filter((one) => one.checkVisibility());
  for (let k = 0; k < moves; k += 1) {
    const own = sliders[k % sliders.length], before = place.dataset.moves;
    own.value = 300 + 400 * (k % 7) / 6;
    own.dispatchEvent(new Event("input", { bubbles: true }));
    while (place.dataset.moves === before) await new Promise((done) => setTimeout(done, 5));
    found.push(Number(place.dataset.latency));
  }
  return found;
}"""
"""Moves all sliders by turns; it runs in the page, which nothing else then asks."""


def calib(*arguments: str) -> list[str]:
    """A command of calib."""
    return [sys.executable, "-m", "calib", *arguments]


def moved(page: Any, moves: int) -> np.ndarray:
    """Milliseconds from the event of each move to the drawn shape, over all sliders by turns."""
    page.locator("#rows tbody tr").first.wait_for()
    page.wait_for_timeout(2000)
    return np.array(page.evaluate(MOVES, moves))


def main() -> None:
    """Serve each study, open the view, move its sliders."""
    from playwright.sync_api import sync_playwright  # a part of the tests alone

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", nargs="+", default=["hidden_bogie", "vehicle"])
    parser.add_argument("--results", type=Path)
    parser.add_argument("--moves", type=int, default=40)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    out, rows = Page(given.write), []
    out.begin("From a slider to the drawn shape")
    root = given.results or Path(tempfile.mkdtemp())
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=browser, args=OPTIONS)
        for name in given.study:
            study = str(ROOT / "studies" / name)
            if not (root / name / "comparison_before.csv").is_file():
                subprocess.run(calib("compare", study, "--results", str(root)), check=True, stdout=subprocess.DEVNULL)
            command = calib("open", study, "--results", str(root), "--no-browser")
            server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            try:
                assert server.stdout is not None
                address = re.search(r"http://\S+", server.stdout.readline())
                assert address is not None, "the server has not begun"
                page = opened.new_page(viewport={"width": 1440, "height": 900})
                page.set_default_timeout(PATIENT)
                began = time.perf_counter()
                page.goto(address[0])
                page.get_by_role("link", name="What if", exact=True).click()
                found = moved(page, given.moves)
                seconds = time.perf_counter() - began
                page.close()
            finally:
                server.terminate()
                server.wait()
            quantiles = [f"{q:.0f}" for q in np.quantile(found, [0.5, 0.9, 1.0])]
            rows.append([name, len(found), *quantiles, f"{seconds:.0f}"])
        opened.close()
    out.table(["study", "moves", "median, ms", "90 %, ms", "largest, ms", "seconds with preparation"], rows)


if __name__ == "__main__":
    main()
