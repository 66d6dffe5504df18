"""Pictures of the live page for the documents: every view of a study that has run, taken in headless Chromium.

python docs/workbench_pictures.py STUDY [--results DIR] [--into docs/figures]
"""

import argparse
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image

VIEWS = {
    "overview": ("Overview", "figure[data-drawn] svg"),
    "search": ("Search", "figure[data-drawn=searches] svg"),
    "missing": ("Missing physics", "figure[data-drawn=why_this_effect] svg"),
    "correlation": ("Correlation", ".shapes[data-drawn]"),
    "what_if": ("What if", ".shapes[data-drawn]"),
    "designs": ("Designs", "#table tbody tr"),
    "measurement": ("Measurement", "#space canvas"),
    "parameters": ("Parameters", "figure[data-drawn=parameters] svg"),
    "beside": ("Correlation", ".pane:nth-child(2) .shapes[data-drawn]"),
}
"""Name of the picture: that of the view, and what is there once it is drawn."""
COLOURS, LARGEST = (128, 64, 40, 24, 16), 140_000
"""Of a picture: the most colours with which it is small enough for the documents, in bytes."""
FAITHFUL, VARIED = Image.Quantize.MEDIANCUT, Image.Quantize.MAXCOVERAGE
"""How they are chosen: where there are many, and where few must reach from one end to the other."""
OPTIONS = ["--no-sandbox", "--enable-unsafe-swiftshader"]


def take(address: str, into: Path) -> None:
    """Take one picture of each view."""
    from playwright.sync_api import sync_playwright  # only who takes pictures needs it

    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=browser, args=OPTIONS)
        page = opened.new_page(viewport={"width": 1440, "height": 900}, color_scheme="light")
        page.set_default_timeout(900_000)
        page.goto(address)
        for name, (title, drawn) in VIEWS.items():
            page.get_by_role("link", name=title, exact=True).click()
            if name == "beside":  # the version with the cause
                page.get_by_label("Beside").select_option(index=1)
            page.locator(drawn).first.wait_for(state="attached")
            page.wait_for_timeout(1500)
            path = into / f"workbench_{name}.png"
            with Image.open(io.BytesIO(page.screenshot())) as picture:
                for colours in COLOURS:
                    method = FAITHFUL if colours == COLOURS[0] else VARIED
                    picture.convert("RGB").quantize(colours, method).save(path, optimize=True)
                    if path.stat().st_size <= LARGEST:
                        break
            print(path)
        opened.close()


def main() -> None:
    """Serve the study, and take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", type=Path)
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--into", type=Path, default=Path("docs/figures"))
    given = parser.parse_args()
    command = [sys.executable, "-m", "calib", "open", str(given.study), "--results", str(given.results), "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        assert found is not None, "the server has not begun"
        take(found[0], given.into)
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
