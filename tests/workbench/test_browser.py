"""The page in a real browser: as an engineer uses it, with the mouse and with the keyboard."""

import contextlib
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calib.command import cli
from calib.command.example import write_example
from calib.study.loading import module_of

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="there is no Chromium")]
ROOT = Path(__file__).resolve().parents[2]
MAST = module_of(ROOT / "tests/template/mast_effects.py")
OPTIONS = ["--no-sandbox", "--disable-quic", "--disable-background-networking", "--enable-unsafe-swiftshader"]
FITS = "document.getElementById('view').scrollWidth <= document.getElementById('view').clientWidth"
DRAWN = {
    "Overview": ".found", "Search": ".panel h2", "Missing physics": ".panel h2", "Correlation": ".shapes[data-drawn]",
    "What if": "#rows tbody tr", "Designs": "#further h2", "Measurement": "#space canvas", "Parameters": "#parameter",
}  # fmt: skip
"""Each view, and what is there once it is drawn, whatever was run."""
REFUSAL = "409 (Conflict)"
"""A refused request, which the page tells in a sentence."""
PATIENT = 120_000
"""Milliseconds for what another process computes."""


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=BROWSER, args=OPTIONS)
        yield opened
        opened.close()


@contextlib.contextmanager
def served(folder, study="mast"):
    """The address of the page of a study, from a server of its own."""
    command = [sys.executable, "-m", "calib", "open", study, "--no-browser"]
    server = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        yield re.search(r"http://\S+", server.stdout.readline())[0]
    finally:
        server.terminate()
        server.wait()


@pytest.fixture(scope="module")
def explained(tmp_path_factory, no_drawing):
    """A mast that lacks a guy rope, after a comparison, a calibration and an explanation."""
    folder = tmp_path_factory.mktemp("explained")
    MAST.write_study(folder / "mast", {"guy": 12000.0})
    with contextlib.chdir(folder), no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        for verb in ("compare", "calibrate", "explain"):
            assert cli.execute([verb, "mast", "--workers", "1"][: 2 if verb == "compare" else 4]) == 0
    with served(folder) as address:
        yield address


@pytest.fixture
def tab(browser):
    """Opens an address; the test fails where the page complains on its console."""
    complaints, contexts = [], []

    def opened(address, wide=1440, high=900, colours="light"):
        context = browser.new_context(viewport={"width": wide, "height": high}, color_scheme=colours)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENT)
        page.on(
            "console",
            lambda told: complaints.append(told.text) if told.type == "error" and REFUSAL not in told.text else None,
        )
        page.on("pageerror", lambda fault: complaints.append(str(fault)))
        page.goto(address)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert complaints == []


def test_the_first_view_says_what_was_found(tab, explained):
    page = tab(explained)
    assert "Guy rope" in page.locator("#answer .found").inner_text()
    assert page.locator(".step").count() >= 4
    page.locator("figure[data-drawn=comparison] svg").wait_for()
    assert page.title().endswith("calib")


def test_views_are_reached_by_the_keyboard(tab, explained):
    page = tab(explained)
    page.locator("#answer").wait_for()
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == "Missing physics":
            break
    page.keyboard.press("Enter")
    page.locator("#verdict").wait_for()
    assert page.locator("#side a[aria-current=page]").inner_text() == "Missing physics"


@pytest.mark.parametrize("wide", [1280, 2560])
@pytest.mark.parametrize("colours", ["light", "dark"])
def test_nothing_is_wider_than_the_window(tab, explained, wide, colours):
    page = tab(explained, wide, 900, colours)
    page.locator("#answer").wait_for()
    for view in DRAWN:
        page.get_by_role("link", name=view, exact=True).click()
        page.wait_for_timeout(1500)
        assert page.evaluate(FITS), view
    assert page.evaluate("document.documentElement.dataset.theme") == colours


def test_what_is_missing_is_found_looked_at_and_added(tab, explained):
    page, other = tab(explained), tab(explained)
    page.get_by_role("link", name="Missing physics", exact=True).click()
    other.get_by_role("link", name="Missing physics", exact=True).click()
    page.locator("figure[data-drawn=why_this_effect] svg").wait_for()
    page.locator("#space canvas").wait_for()
    first = page.locator("#effects button").first
    assert first.get_attribute("data-name") == "guy" and first.get_attribute("aria-pressed") == "true"
    page.locator("#effects button").nth(1).click()
    assert page.locator("#effects button").nth(1).get_attribute("aria-pressed") == "true"
    page.locator("#add").click()
    page.get_by_role("link", name="Open the study with guy").wait_for()
    words = page.locator("#versions .errors").get_attribute("aria-label")
    before, after = (float(value) for value in re.findall(r"mast(?:_with_guy)? ([\d.]+)", words)[:2])
    assert after < 0.5 * before  # of the data that were used
    other.get_by_role("link", name="Open the study with guy").click()
    other.locator("#answer .found").wait_for()
    assert "fits" in other.locator("#answer .found").inner_text()


def test_a_pair_is_changed_and_taken_back(tab, explained):
    page = tab(explained)
    page.get_by_role("link", name="Correlation", exact=True).click()
    page.locator(".shapes[data-drawn]").wait_for()
    assert page.locator("#pair canvas").count() == 3
    page.locator(".cell").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.dataset.column") == "1"
    page.locator(".cell:not(.paired)").first.click()
    chosen = page.locator(".cell[aria-pressed=true]").get_attribute("aria-label")
    mode, number = re.match(r"(\S+) with model mode (\d+)", chosen).groups()
    page.get_by_role("button", name=f"Pair {mode} with {number}").click()
    page.locator("#make").wait_for()
    assert f"{mode} = {number}" in page.locator("#diff .plus").last.inner_text()
    page.locator("#make").click()
    page.locator("#undo").click()
    page.locator("#undo").wait_for(state="detached")
    page.locator(".cell").first.wait_for()


def test_sliders_move_the_model_and_a_start_is_written_and_taken_back(tab, explained):
    page = tab(explained)
    page.get_by_role("link", name="What if", exact=True).click()
    page.locator(".shapes[data-drawn]").wait_for()
    page.get_by_role("button", name="Calibrated").click()
    first = page.locator("#rows tbody tr").first
    model = first.locator("td").nth(1)
    reached(page, lambda: page.locator("input[name=guy]").get_attribute("aria-valuetext") == "off")
    drawn, before = page.locator("canvas").first.screenshot(), model.inner_text()
    page.locator("input[name=guy]").focus()
    for _ in range(3):
        page.keyboard.press("PageUp")
    reached(page, lambda: model.inner_text() != before)
    assert page.locator(".effect[data-name=guy] input[type=checkbox]").is_checked()
    assert page.locator("canvas").first.screenshot() != drawn
    page.get_by_role("button", name="With guy").click()
    reached(page, lambda: float(re.search(r"[\d.]+", page.locator("#facts strong").inner_text())[0]) < 1.2)
    page.locator("#start").click()
    page.locator("#make").wait_for()
    assert "begin_at" in page.locator("#diff .plus").last.inner_text()
    page.locator("#make").click()
    page.locator("#undo").click()
    page.locator("#undo").wait_for(state="detached")


def test_one_selection_of_designs_holds_in_all_pictures(tab, explained):
    page = tab(explained)
    page.get_by_role("link", name="Designs", exact=True).click()
    page.locator("#table tbody tr").first.wait_for()
    kept = lambda: [int(number) for number in re.findall(r"\d+", page.locator("#chosen").inner_text())][:2]  # noqa: E731
    count, every = kept()
    assert count == every > 10
    matrix = page.locator("#correlations tbody").inner_text()
    cloud = page.locator("canvas").nth(1).screenshot()
    box = page.locator("canvas").first.bounding_box()
    page.mouse.move(box["x"] + 34, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 34, box["y"] + 230, steps=3)
    page.mouse.up()
    reached(page, lambda: 0 < kept()[0] < every)
    assert page.locator("#correlations tbody").inner_text() != matrix
    assert page.locator("canvas").nth(1).screenshot() != cloud
    picked = page.locator("#table tbody tr").nth(1)
    number = picked.get_attribute("data-design")
    picked.click()
    page.locator("#begin").click()
    page.locator("#make").wait_for()
    assert f'begin_at = "design {number}"' in page.locator("#diff .plus").last.inner_text()
    page.get_by_title("Drop this filter").click()
    reached(page, lambda: kept()[0] == every)


def test_the_measurement_shows_its_sensors_and_what_to_measure_next(tab, explained):
    page = tab(explained)
    page.get_by_role("link", name="Measurement", exact=True).click()
    page.locator("#space canvas").wait_for()
    assert page.locator("#next tbody tr").count() > 0
    page.get_by_role("button", name="Hold out", exact=True).first.click()
    page.locator("#make").wait_for()
    assert "modes" in page.locator("#diff .plus").last.inner_text()


@pytest.mark.parametrize("colours", ["light", "dark"])
def test_contrast_and_names_are_those_of_wcag_aa(tab, explained, colours):
    script = ROOT / "node_modules/axe-core/axe.min.js"
    if not script.is_file():
        pytest.skip("axe-core is not installed: npm install --no-save axe-core")
    page = tab(explained, colours=colours)
    page.evaluate(script.read_text())
    drawn = {
        "Overview": "#answer", "Search": "#view .panel", "Missing physics": "#space canvas",
        "What if": "#rows tbody tr", "Correlation": ".shapes[data-drawn]", "Designs": "#table tbody tr",
        "Measurement": "#space canvas", "Parameters": "#parameter",
    }  # fmt: skip
    for view, place in drawn.items():
        page.get_by_role("link", name=view, exact=True).click()
        page.locator(place).first.wait_for()
        found = page.evaluate("axe.run({ runOnly: ['wcag2a', 'wcag2aa'] })")
        wrong = [(one["id"], node["target"]) for one in found["violations"] for node in one["nodes"]]
        assert not wrong, (view, wrong)
        assert found["passes"]


def test_a_search_is_started_stopped_and_resumed(tab, tmp_path):
    write_example(tmp_path / "mast")
    file = tmp_path / "mast/study.toml"
    text = (
        file.read_text()
        .replace('method = "auto"', 'method = "genetic"')
        .replace("generations = 60", "generations = 400")
    )
    file.write_text(text)
    with served(tmp_path) as address:
        page = tab(address)
        assert "Nothing has been run yet" in page.locator("#view .found").inner_text()
        page.get_by_role("link", name="Search", exact=True).click()
        page.get_by_role("button", name="Calibrate").click()
        generation = page.locator("tbody td").first
        reached(page, lambda: int(generation.inner_text()) >= 3)
        page.get_by_role("button", name="Stop").first.click()
        page.get_by_role("button", name="Resume").wait_for()
        stopped = int(generation.inner_text())
        page.get_by_role("button", name="Resume").click()
        reached(page, lambda: int(generation.inner_text()) > stopped + 2)
        page.get_by_role("button", name="Stop").first.click()
        page.get_by_role("button", name="Resume").wait_for()
        page.close()


def test_two_studies_stand_beside_each_other_in_every_view(tab, tmp_path, no_drawing):
    with contextlib.chdir(tmp_path), no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        for name in ("mast", "twin"):
            write_example(tmp_path / name)
            assert cli.execute(["compare", name]) == 0
    with served(tmp_path, ".") as address:
        page = tab(address, wide=1280)
        page.locator("#side").get_by_role("link", name="mast", exact=True).click()
        page.get_by_label("Beside").select_option(label="twin")
        for view, drawn in DRAWN.items():
            page.get_by_role("link", name=view, exact=True).click()
            panes = page.locator(".pane")
            for k, name in enumerate(("mast", "twin")):
                panes.nth(k).locator(drawn).first.wait_for()
                assert panes.nth(k).locator("header h2").inner_text() == name, view
            assert panes.count() == 2 and page.evaluate(FITS), view
        page.get_by_role("link", name="Correlation", exact=True).click()
        panes.nth(1).locator(".cell.paired").nth(2).wait_for()
        panes.nth(0).locator(".cell.paired").nth(2).click()
        pressed = [panes.nth(k).locator(".cell[aria-pressed=true]").get_attribute("aria-label") for k in range(2)]
        assert pressed[0] == pressed[1] and pressed[0].endswith("paired")
        panes.nth(1).get_by_role("link", name="Show alone").click()
        page.locator("#pair").wait_for()
        assert page.locator("#side a.study[aria-current=true]").inner_text() == "twin"
        page.close()


def test_a_new_study_is_written_from_the_page(tab, tmp_path):
    with served(tmp_path, ".") as address:
        page = tab(address)
        form = page.locator("#new")
        form.get_by_label("name of the new folder").fill("../tower")
        form.get_by_role("button").click()
        page.get_by_text("is no name of a folder").wait_for()
        form.get_by_label("name of the new folder").fill("tower")
        form.get_by_label("kind of model").select_option("table")
        form.get_by_role("button").click()
        page.get_by_text("Nothing has been run yet").wait_for()
        assert (tmp_path / "tower/runs.csv").is_file() and not (tmp_path.parent / "tower").exists()
        page.close()


def reached(page, holds):
    """Wait until something holds; the page's policy lets no condition of a driver in."""
    for _ in range(1000):
        if holds():
            return
        page.wait_for_timeout(100)
    pytest.fail("it did not come to that")
