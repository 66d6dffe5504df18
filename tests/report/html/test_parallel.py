"""Samples over parallel axes in the page: data true to the tables, and ranges chosen by dragging in a real browser."""

import json

import numpy as np
import pandas as pd
import pytest

from calib.report.html.sensitivity import MOST_NUMBERS, designs_section
from calib.report.html.study_results import StudyResults
from calib.report.html.write import page, sections
from tests.report.html import test_browser as browser

SPACE = """parameter,value,lower,upper,unit,scale,description,source,distribution,integer,prior_sd
k,1e4,1e3,1e5,N/m,log,,,,false,
m,2,1,3,kg,linear,,,,false,
held,7,7,7,-,linear,,,,false,
"""
MEASURED = "response,value,std,repeats,held_out\nf,2.5,0.01,1,False\n"


def samples(count=40):
    random = np.random.default_rng(1)
    table = pd.DataFrame({"k": 10 ** random.uniform(3, 5, count), "m": random.uniform(1, 3, count)})
    return table.assign(f=np.log10(table["k"]) - table["m"] / 3, same=1.0, never=np.nan)


@pytest.fixture
def made(tmp_path):
    def write(table):
        table.to_csv(tmp_path / "sensitivity_samples.csv", index=False)
        (tmp_path / "parameter_space.csv").write_text(SPACE)
        (tmp_path / "measured.csv").write_text(MEASURED)
        return StudyResults(tmp_path, "Parallel", True)

    return write


def test_axes_have_units_scales_and_what_was_measured(made):
    table = samples()
    table.loc[3, "f"] = np.nan
    found = designs_section(made(table))
    assert [axis["name"] for axis in found["axes"]] == ["k (N/m)", "m (kg)", "f"]  # what never changes has no axis
    assert [axis["log"] for axis in found["axes"]] == [True, False, False]
    assert [axis["measured"] for axis in found["axes"]] == [None, None, 2.5]
    lows = [axis["low"] for axis in found["axes"]]
    assert lows == np.min(found["rows"], axis=0).tolist() and found["left_out"] == 1  # all lines are between the ends
    np.testing.assert_allclose(found["rows"], table.drop(3)[["k", "m", "f"]], rtol=1e-3)


def test_many_samples_stay_within_the_size_of_a_page(made):
    found = designs_section(made(samples(10_000)))
    assert sum(map(len, found["rows"])) <= MOST_NUMBERS and len(json.dumps(found)) < 200_000
    assert found["left_out"] == 10_000 - len(found["rows"])


def test_without_samples_there_is_no_figure(made, tmp_path):
    made(samples())
    (tmp_path / "sensitivity_samples.csv").unlink()
    results = StudyResults(tmp_path, "Parallel", True)
    assert designs_section(results) is None
    assert "figure.parallel" not in page(results)
    assert all("parallel" not in section.body for section in sections(results))


PROBE = """
<script>
(async () => {
  const report = { counts: [] };
  const wait = (time) => new Promise((done) => setTimeout(done, time));
  document.querySelectorAll("details").forEach((part) => { part.open = true; });
  const figure = document.getElementById("parallel"), canvas = figure.querySelector("canvas");
  while (!canvas.clientWidth) await wait(50);
  await wait(200);
  const box = () => canvas.getBoundingClientRect();
  const send = (kind, x, y) => canvas.dispatchEvent(
    new PointerEvent(kind, { clientX: box().left + x, clientY: box().top + y, pointerId: 1, bubbles: true }));
  const drag = (x, from, to) => { send("pointerdown", x, from); send("pointermove", x, to); send("pointerup", x, to); };
  const told = () => report.counts.push([Number(figure.dataset.drawn), figure.querySelector(".facts").textContent]);
  const width = box().width, top = 110, low = box().height - 26, middle = (top + low) / 2;
  told();
  drag(46, middle, low + 40);
  told();
  drag(width - 46, top - 40, middle);
  told();
  drag(46, middle, middle);
  told();
  figure.querySelector(".reset").click();
  told();
  drag(width / 2, top, middle);
  const place = document.createElement("pre");
  place.id = "probe";
  place.textContent = JSON.stringify(report);
  document.body.append(place);
})();
</script>
"""


@pytest.mark.slow
@pytest.mark.skipif(browser.BROWSER is None, reason="no Chromium is installed, so the page is not opened")
def test_ranges_are_chosen_by_dragging_along_axes(made, tmp_path, monkeypatch):
    monkeypatch.setattr(browser, "PROBE", PROBE)
    table = samples()
    after, report, console = browser.opened(page(made(table)), tmp_path)
    assert browser.faults(console) == [] and "THREE" not in after.replace(PROBE, "")
    middle = np.sqrt(table["k"].min() * table["k"].max())
    low, high = table["k"] <= middle, table["f"] >= 0.5 * (table["f"].min() + table["f"].max())
    expected = [40, low.sum(), (low & high).sum(), high.sum(), 40]
    assert [count for count, _ in report["counts"]] == expected
    assert report["counts"][0][1] == "40 designs" and "k (N/m)" in report["counts"][1][1]
    assert report["counts"][2][1].startswith(f"{expected[2]} of 40 designs: ") and "; f " in report["counts"][2][1]
