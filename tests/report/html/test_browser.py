"""The page in a real browser, offline."""

import html
import json
import re
import shutil
import subprocess

import pandas as pd
import pytest

from calib.report.html.space import scene
from calib.report.html.study_results import StudyResults
from calib.report.html.write import page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--enable-unsafe-swiftshader",
    "--enable-logging=stderr", "--v=0", "--window-size=1280,900",
    "--hide-scrollbars", "--virtual-time-budget=30000", "--dump-dom",
]  # fmt: skip
COUNTER = """
<script>
window.draws = 0;
window.drawn = () => {};
// Virtual time does not wait for frames, so they follow its clock here. What a canvas holds can be read only in the
// frame in which it is drawn.
window.requestAnimationFrame = (draw) => setTimeout(() => { draw(performance.now()); window.drawn(); }, 16);
window.cancelAnimationFrame = clearTimeout;
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) { window.draws += 1; return draw.apply(this, given); };
}
</script>
"""
PROBE = """
<script>
(async () => {
  const report = {};
  const wait = (time) => new Promise((done) => setTimeout(done, time));
  const all = (what) => [...document.querySelectorAll(what)];
  report.screens = document.documentElement.scrollHeight / 900;
  location.hash = "#versions";
  await wait(100);
  report.unfolded = all("section.folded > details[open]").map((part) => part.parentNode.id);
  all("details").forEach((part) => { part.open = true; });
  while (all("figure.viewer").some((f) => !f.dataset.drawn)) await wait(100);
  report.empty = all("figure").filter((f) => !f.querySelector("svg, canvas")).map((f) => f.id);
  const label = (f) => f.querySelector("[role=img]").getAttribute("aria-label");
  report.silent = all("figure").filter((f) => !label(f)).map((f) => f.id);
  report.wide = document.documentElement.scrollWidth > window.innerWidth;
  report.loaded = performance.getEntriesByType("resource").map((r) => r.name).filter((r) => !/^(data|blob):/.test(r));
  const figure = document.getElementById("viewer");
  if (figure) await viewed(figure).catch((fault) => { report.fault = String(fault); });
  const place = document.createElement("pre");
  place.id = "probe";
  place.textContent = JSON.stringify(report);
  document.body.append(place);

  async function viewed(figure) {
    const part = (name) => figure.querySelector(name);
    const place = part(".drawing"), canvas = part("canvas"), tip = part(".tip"), paper = part(".paper");
    if (!canvas) {
      report.words = place.textContent;
      report.controls = getComputedStyle(part(".controls")).display;
      return;
    }
    const choose = async (name, value) => {
      part(name).value = value;
      part(name).dispatchEvent(new Event("change"));
      await wait(600);
      return { value, words: part(".facts").textContent, label: place.getAttribute("aria-label"), alt: paper.alt,
        key: part(".key").textContent, picture: paper.src, still: part(".play").hidden };
    };
    const colours = async (url) => {
      const image = new Image(), pen = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
      await new Promise((done) => { image.onload = done; image.src = url; });
      pen.drawImage(image, 0, 0);
      const { data } = pen.getImageData(0, 0, canvas.width, canvas.height), found = {};
      for (let k = 0; k < data.length; k += 4) {
        const name = "#" + [0, 1, 2].map((i) => data[k + i].toString(16).padStart(2, "0")).join("");
        found[name] = (found[name] || 0) + 1;
      }
      return found;
    };
    await wait(600);
    const before = window.draws;
    await wait(600);
    report.idle = window.draws - before;
    report.first = await colours(paper.src);
    const still = paper.src;

    part(".play").click();
    const frames = new Set();
    window.drawn = () => frames.add(canvas.toDataURL());
    for (let k = 0; k < 100 && frames.size < 3; k++) await wait(30);
    window.drawn = () => {};
    report.frames = frames.size;
    report.pressed = [part(".play").getAttribute("aria-pressed")];
    part(".play").click();
    await wait(600);
    const paused = [window.draws, paper.src];
    await wait(600);
    report.held = window.draws === paused[0] && paper.src === paused[1] && paper.src !== still;
    report.pressed.push(part(".play").getAttribute("aria-pressed"));
    part(".play").click();
    await wait(200);
    window.dispatchEvent(new Event("beforeprint"));
    report.pressed.push(part(".play").getAttribute("aria-pressed"));

    report.modes = [await choose("select.mode", part("select.mode").options[1].value), await choose("select.stage", 1)];
    report.layers = [];
    for (const { value } of [...part("select.layer").options]) report.layers.push(await choose("select.layer", value));
    for (const one of [...report.modes, ...report.layers]) {
      one.colours = Object.keys(await colours(one.picture));
      one.image = one.picture.slice(0, 22);
      delete one.picture;
    }

    const press = async (key) => {
      place.dispatchEvent(new KeyboardEvent("keydown", { key, cancelable: true }));
      await wait(50);
    };
    const scrolls = (more) => {
      const event = new WheelEvent("wheel", { deltaY: 100, bubbles: true, cancelable: true, ...more });
      canvas.dispatchEvent(event);
      return !event.defaultPrevented;
    };
    report.scrolls = [scrolls({}), scrolls({ ctrlKey: true })];
    place.focus();
    report.scrolls.push(scrolls({}));
    // A busy machine draws late: the picture stands still when it is the same twice.
    const settled = async () => {
      for (let before = ""; before !== paper.src;) {
        before = paper.src;
        await wait(600);
      }
    };
    await press("Home");
    await settled();
    const home = paper.src;
    await press("ArrowLeft");
    await settled();
    report.turned = paper.src !== home;
    await press("Home");
    await settled();
    report.back = paper.src === home;

    // Words under the mouse of a figure: an area that is not painted has them too.
    const worded = [...document.querySelectorAll("figure svg g[pointer-events] > title:not(:only-child)")].filter(
      (title) => getComputedStyle(title.nextElementSibling).fill === "none"
        && title.nextElementSibling.getBoundingClientRect().width > 0);
    report.worded = worded.length;
    const box_of = (title) => title.nextElementSibling.getBoundingClientRect();
    const covers = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
    const boxes = worded.map(box_of);  // of areas that cover each other the last one is under the mouse
    const alone = worded[boxes.findIndex((a, i) => !boxes.some((b, k) => k !== i && covers(a, b)))];
    alone.parentNode.scrollIntoView({ block: "center", behavior: "instant" });
    await wait(100);
    const area = box_of(alone);
    report.area = [area.x, area.y, area.width, area.height, innerWidth, innerHeight];
    const under = document.elementFromPoint(area.x + area.width / 2, area.y + area.height / 2);
    report.underTheMouse = under?.closest("g")?.querySelector("title")?.textContent;
    report.meant = alone.textContent;
    canvas.scrollIntoView({ block: "center" });
    await settled();

    await press("n");
    report.named = tip.textContent;
    // The words stand beside the dot, so that the dot is found under the mouse again.
    const box = canvas.getBoundingClientRect();
    const [left, top] = [parseFloat(tip.style.left) - 12, parseFloat(tip.style.top) + 32];
    const at = { clientX: box.left + left, clientY: box.top + top };
    canvas.dispatchEvent(new PointerEvent("pointerleave", at));
    await wait(50);
    report.left = tip.hidden;
    canvas.dispatchEvent(new PointerEvent("pointermove", at));
    await wait(50);
    report.pointed = tip.textContent;
    canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + 2, clientY: box.top + 2 }));
    await wait(50);
    report.nothing = tip.textContent;
  }
})();
</script>
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed, so the page is not opened"),
]


def opened(text, tmp_path, *options):
    """The page after its scripts have run, the probe's report, and the console's lines."""
    file = tmp_path / "report.html"
    probed = text.replace("</head>", COUNTER + "</head>").replace("</body>", PROBE + "</body>")
    file.write_text(probed, encoding="utf-8")
    command = [BROWSER, *OPTIONS, *options, f"--user-data-dir={tmp_path / 'profile'}", file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    probe = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout, re.S)
    assert probe is not None, done.stderr[-2000:]
    return done.stdout, json.loads(html.unescape(probe[1])), [x for x in done.stderr.splitlines() if "CONSOLE" in x]


def faults(console):
    """Lines of the console other than notes on speed."""
    return [line for line in console if not re.search(r"willReadFrequently|GPU stall due to ReadPixels", line)]


@pytest.fixture(scope="module")
def mast(everything, tmp_path_factory):
    return opened(page(StudyResults(everything, "A mast", True)), tmp_path_factory.mktemp("browser"))


def test_every_figure_is_drawn_without_a_fault(mast):
    page_after, report, console = mast
    assert faults(console) == []
    assert re.search(r'<p id="faults"[^>]*hidden', page_after)
    assert report["empty"] == [] and report["silent"] == [] and report["loaded"] == [] and not report["wide"]


def test_the_answer_takes_six_screens_at_most_and_a_link_unfolds_its_section(mast):
    assert 1 < mast[1]["screens"] <= 6
    assert mast[1]["unfolded"] == ["versions"]


def test_the_viewer_shows_the_model_at_rest_moved_and_measured(mast, results):
    colours = {name.lower() for name in mast[1]["first"]}
    drawn = scene(results)["colours"]
    assert {drawn["model"].lower(), drawn["measured"].lower()} <= colours
    assert mast[1]["first"]["#ffffff"] < sum(mast[1]["first"].values())


def test_it_draws_only_when_something_changes(mast):
    assert mast[1]["idle"] == 0


def test_a_mode_shape_moves_until_it_is_paused_or_printed(mast):
    report = mast[1]
    assert report["frames"] >= 3 and report["held"]
    assert report["pressed"] == ["true", "false", "false"]


def test_the_choice_of_mode_and_stage_changes_words_and_text_alternative(mast, results):
    stages = scene(results)["stages"]
    for shown, stage in zip(mast[1]["modes"], stages, strict=True):
        words = stage["modes"][1]["words"]
        assert shown["words"] == words
        assert shown["label"] == shown["alt"] == f"Mode shape {stage['name']}: {words}"


def test_every_layer_is_drawn_in_its_colours_with_its_words(mast, results):
    data, (modes, *layers) = scene(results), mast[1]["layers"]
    assert modes["value"] == "modes" and not modes["still"]
    assert [shown["value"] for shown in layers] == [layer["name"] for layer in data["layers"]]
    for shown, layer in zip(layers, data["layers"], strict=True):
        assert shown["words"] == layer["words"]
        assert shown["label"] == shown["alt"] == f"{layer['title']}: {layer['words']}"
        assert shown["key"] == "".join(entry["words"] for entry in layer["key"])
        assert {*layer["colours"]} & {*shown["colours"]} or {*map(str.lower, layer["colours"])} & {*shown["colours"]}
        assert shown["still"] and shown["image"] == "data:image/png;base64,"


def test_the_wheel_scrolls_the_page_unless_the_viewer_is_meant(mast):
    assert mast[1]["scrolls"] == [True, False, False]


def test_keys_turn_the_view_and_reset_it(mast):
    assert mast[1]["turned"] and mast[1]["back"]


def test_a_dot_is_named_by_keys_and_under_the_mouse(mast, everything):
    report = mast[1]
    table = pd.read_csv(everything / "perturbations.csv").set_index("perturbation")
    last = report["layers"][-1]["value"].removeprefix("perturbations of ")  # the layer chosen last
    strongest = table.loc[table["kind"] == last, "score"].abs().idxmax()
    assert strongest in report["named"] and report["pointed"] == report["named"]
    assert report["left"] and report["nothing"] == ""


def test_words_appear_under_the_mouse_where_nothing_is_painted(mast):
    assert mast[1]["worded"] > 10 and mast[1]["underTheMouse"] == mast[1]["meant"], mast[1]["area"]


def test_without_webgl_a_sentence_stands_there_and_nothing_breaks(everything, tmp_path):
    page_after, report, console = opened(page(StudyResults(everything, "A mast", True)), tmp_path, "--disable-3d-apis")
    assert faults(console) == [] and re.search(r'<p id="faults"[^>]*hidden', page_after)
    assert report["empty"] == ["viewer"] and report["silent"] == []
    assert report["words"] and report["controls"] == "none"


def test_a_study_without_modes_is_drawn_too(scalar, tmp_path):
    page_after, report, console = opened(page(StudyResults(scalar, "Five masses", True)), tmp_path)
    assert faults(console) == [] and re.search(r'<p id="faults"[^>]*hidden', page_after)
    assert report["empty"] == [] and report["silent"] == [] and report["loaded"] == []
    assert "THREE" not in page_after.replace(PROBE, "")
