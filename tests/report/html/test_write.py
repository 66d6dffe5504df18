"""The whole page: what is told, that it needs nothing beside it, and that its numbers are those of the tables."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from plotly.offline import get_plotlyjs

from calib.errors import InputError
from calib.report.html import write
from calib.report.html.answers import Answers
from calib.report.html.page import LONGEST, Plot, Shapes, Table
from calib.report.html.write import page, sections, write_report

TITLE = "A mast that may lack something"
WHOLE = [
    "measured", "compared", "fails", "sensitivity", "calibrated", "strained", "effects", "verdict", "next", "errors",
    "tried", "assumptions", "versions",
]  # fmt: skip


class Reader(HTMLParser):
    """Elements with their attributes, the words of the page, tables by caption, and contents of scripts."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.words, self.tables, self.scripts, self.styles = [], [], {}, [], []
        self._open, self._caption, self._rows = [], "", []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "br", "img", "link", "input"):
            self._open.append(tag)
        if tag == "table":
            self._caption, self._rows = "", []
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")
        elif tag == "script":
            self.scripts.append((dict(attrs).get("type", ""), []))

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass
        if tag == "table":
            self.tables[self._caption] = self._rows

    def handle_data(self, data):
        if "script" in self._open:
            self.scripts[-1][1].append(data)
        elif "style" in self._open:
            self.styles.append(data)
        else:
            self.words.append(data)
            if self._open and self._open[-1] == "caption":
                self._caption += data
            if self._open and self._open[-1] in ("td", "th"):
                self._rows[-1][-1] += data

    def named(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def text(everything):
    return page(Answers(everything, TITLE, True))


@pytest.fixture(scope="module")
def read(text):
    return Reader(text)


def number(cell):
    return float(cell.replace("−", "-").replace("×", ""))


def blocks(folder, kind, synthetic=True):
    found = sections(Answers(folder, TITLE, synthetic))
    return {getattr(b, "name", getattr(b, "caption", "")): b for s in found for b in s.blocks if isinstance(b, kind)}


# -- the story ---------------------------------------------------------------------------------------------------------


def test_everything_that_was_asked_is_told_in_order(read):
    assert [a["id"] for a in read.named("section")] == WHOLE
    assert [a["href"] for a in read.named("a")] == [f"#{name}" for name in WHOLE]
    assert len(read.named("h1")) == 1 and len(read.named("h2")) == len(WHOLE)


def test_the_verdict_and_what_is_synthetic_come_before_any_section(text, read):
    top = Reader(text[: text.index("<section")]).text
    assert "Something is missing in the model, and it is named: Guy rope along x." in top
    assert "Synthetic measurement" in top


def test_a_measured_structure_is_not_called_synthetic(everything):
    assert "ynthetic" not in Reader(page(Answers(everything, TITLE, False))).text


@pytest.mark.parametrize(
    ("gone", "section", "command"),
    [
        (["selection", "sensitivity", "partial", "influence", "input_correlation"], "sensitivity", "calib sensitivity"),
        (["parameters"], "calibrated", "calib calibrate"),
        (["explanation"], "verdict", "calib explain"),
        (["comparison_before"], "compared", "calib compare"),
    ],
)
def test_what_was_not_asked_is_left_out_and_its_command_is_named(folder, gone, section, command):
    for name in gone:
        for suffix in ("csv", "json"):
            (folder / f"{name}.{suffix}").unlink(missing_ok=True)
    *told, last = sections(Answers(folder, TITLE, True))
    assert [s.name for s in told] == [n for n in WHOLE if n != section] and last.name == "not-asked"
    assert any(f"{command} mast" in words.text for words in last.blocks)


def test_every_section_stands_on_its_own_tables(folder):
    for name in ("strain", "effects", "next_measurement", "tried"):
        (folder / f"{name}.csv").unlink()
    told = [s.name for s in sections(Answers(folder, TITLE, True))]
    assert told == [n for n in WHOLE if n not in ("strained", "effects", "next", "tried")]


def test_a_study_without_library_is_not_asked_to_explain(folder):
    (folder / "explanation.json").unlink()
    record = json.loads((folder / "record.json").read_text())
    (folder / "record.json").write_text(json.dumps({**record, "effects_known": 0}))
    assert [s.name for s in sections(Answers(folder, TITLE, True))] == [n for n in WHOLE if n != "verdict"]


def test_results_without_a_record_are_told_as_far_as_they_go(folder):
    for name in ("record.json", "measured.csv", "sensors.csv"):
        (folder / name).unlink()
    told = [s.name for s in sections(Answers(folder, TITLE, False))]
    assert told == [n for n in WHOLE if n not in ("measured", "versions")]


def test_plain_responses_have_neither_modes_nor_shapes(plain):
    found = Reader(page(Answers(plain, "Five masses", True)))
    names = [a["id"] for a in found.named("section")]
    assert {"measured", "compared", "fails", "effects", "verdict", "errors"} <= set(names)
    assert not found.named("select") and "EMAC" not in found.text
    table = pd.read_csv(plain / "comparison_before.csv")
    rows = found.tables["Every response before calibration"][1:]
    assert [r[0] for r in rows] == list(table["response"])
    np.testing.assert_allclose([number(r[3]) for r in rows], 100 * table["error"], atol=0.00501)


def test_versions_seeds_and_times_of_every_question_are_told(everything, read):
    record = json.loads((everything / "record.json").read_text())
    rows = read.tables["Questions asked"][1:]
    assert [r[0] for r in rows] == [f"calib {q}" for q in record["questions"]]
    assert f"numpy {np.__version__}" in read.text
    assert any("A1 1" in r[3] for r in rows)


def test_values_taken_over_are_told(folder):
    record = json.loads((folder / "record.json").read_text())
    (folder / "record.json").write_text(json.dumps({**record, "adopted": {"E": 205.25}, "adopted_from": "../older"}))
    told = next(s for s in sections(Answers(folder, TITLE, True)) if s.name == "versions").blocks
    assert any("Taken over from the study ../older and held: E 205.25." == getattr(b, "text", "") for b in told)


# -- one file, nothing beside it ---------------------------------------------------------------------------------------


def test_nothing_is_loaded_from_anywhere(text, read):
    assert not read.named("link") and not read.named("iframe") and not read.named("object")
    for _, attributes in read.elements:
        assert "src" not in attributes and attributes.get("href", "#").startswith("#")
        assert not any(name.startswith("on") for name in attributes)
    style = "".join(read.styles)
    assert "@import" not in style and "url(" not in style
    own = [content for kind, content in read.scripts if kind != "application/json"]
    assert len(own) == 2 and not re.search(r"https?:|import\s*\(|fetch\(", "".join(own[1]))
    policy = next(a["content"] for a in read.named("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "http" not in policy and "form-action 'none'" in policy


def test_the_library_is_embedded_once_and_sends_nothing(text):
    assert text.count(get_plotlyjs().strip()[:200]) == 1
    assert "showSendToCloud: false" in text and 'plotlyServerURL: ""' in text


def test_every_figure_has_a_text_alternative_and_a_caption(everything, read):
    figures = blocks(everything, (Plot, Shapes))
    assert len(read.named("figure")) == len(figures) == len(read.named("figcaption")) > 12
    drawings = [a for a in read.named("div") if a.get("class") == "drawing"]
    assert len(drawings) == len(figures)
    for name, figure in figures.items():
        assert len(figure.alt) > 20 and figure.caption.endswith("."), name
        assert "nan" not in figure.alt and "None" not in figure.alt, name
        assert {"role": "img", "aria-label": figure.alt, "class": "drawing"} in drawings


def test_every_table_has_a_caption_heads_and_as_many_cells(everything, plain):
    for folder in (everything, plain):
        for caption, table in blocks(folder, Table).items():
            assert caption and table.rows, caption
            assert {len(row) for row in table.rows} == {len(table.heads)}, caption
            assert all("nan" not in cell for row in table.rows for cell in row), caption


def test_long_tables_are_folded_and_only_they(everything, read):
    tables = blocks(everything, Table)
    long = [c for c, t in tables.items() if len(t.rows) > LONGEST]
    assert long and len(read.named("details")) == len(long)


# -- escaping ----------------------------------------------------------------------------------------------------------

ODD = "</script><script>alert(\"1\")</script> & <b>'x'</b>"


def test_names_are_shown_as_they_are_whatever_characters_they_have(folder):
    plain_names = pd.read_csv(folder / "comparison_before.csv")["mode"].tolist()
    quoted = '"' + ODD.replace('"', '""') + '"'
    for file in [*folder.glob("*.csv")]:
        lines = file.read_text().splitlines(keepends=True)
        lines = [re.sub(rf"(?m)(^|,){plain_names[0]}(,)", lambda m: m[1] + quoted + m[2], line) for line in lines]
        file.write_text("".join(lines))
    found = Reader(page(Answers(folder, ODD, True)))
    usual = Reader(page(Answers(folder, TITLE, True)))
    assert len(found.elements) == len(usual.elements) and len(found.named("b")) == 0
    assert ODD in found.words[found.words.index(ODD)] and any(row[0] == ODD for row in found.tables["Measured modes"])
    for kind, content in found.scripts:
        if kind == "application/json":
            json.loads("".join(content))
    shown = json.loads(
        "".join(next(c for k, c in found.scripts if k and "xaxis" in "".join(c) and "bar" in "".join(c)))
    )
    assert shown["layout"]["xaxis"]["ticktext"][0].startswith("&lt;/script&gt;")


# -- numbers -----------------------------------------------------------------------------------------------------------


def test_measured_modes_are_those_of_the_table(everything, read):
    table = pd.read_csv(everything / "measured.csv")
    rows = read.tables["Measured modes"][1:]
    assert [r[0] for r in rows] == list(table["mode"])
    np.testing.assert_allclose([number(r[1]) for r in rows], table["natural_freq"], atol=0.000501)
    np.testing.assert_allclose([number(r[2]) for r in rows], table["freq_std"], atol=0.000501)
    assert [r[-1] for r in rows] == ["withheld" if w else "used" for w in table["withheld"]]


@pytest.mark.parametrize("stage", ["before", "after"])
def test_compared_modes_are_those_of_the_table(everything, read, stage):
    table = pd.read_csv(everything / f"comparison_{stage}.csv")
    caption = "Mode by mode before calibration" if stage == "before" else "The model after calibration (case A1)"
    head, *rows = read.tables[caption]
    assert [r[0] for r in rows] == list(table["mode"])
    for column, name, factor, tolerance in (
        ("measured, Hz", "natural_freq_measured", 1, 6e-4),
        ("model, Hz", "natural_freq_model", 1, 6e-4),
        ("error, %", "freq_error", 100, 6e-3),
        ("MAC", "mac", 1, 6e-4),
        ("margin", "margin", 1, 6e-4),
    ):
        cells = [number(r[head.index(column)]) for r in rows]
        np.testing.assert_allclose(cells, factor * table[name], atol=tolerance, err_msg=column)


def test_effects_errors_and_trials_are_those_of_the_tables(everything, read):
    effects = pd.read_csv(everything / "effects.csv").set_index("name")
    head, *rows = read.tables["Every effect of the library, ranked"]
    assert {r[1] for r in rows} == set(effects.index)
    for row in rows:
        assert number(row[head.index("z")]) == pytest.approx(effects["z"][row[1]], abs=0.0501)
        assert number(row[head.index("ln Bayes")]) == pytest.approx(effects["ln_bayes"][row[1]], abs=0.0501)
    errors = pd.read_csv(everything / "added_errors.csv")
    rows = read.tables["Errors before and after adding guy, calibrated both times"][1:]
    for k, stage in enumerate(("before", "after")):
        own = errors[errors["stage"] == stage]
        np.testing.assert_allclose([number(r[2 + k]) for r in rows], own["rms"], atol=0.00501)
        np.testing.assert_allclose([number(r[4 + k]) for r in rows], own["expected"], atol=0.00501)
    tried = pd.read_csv(everything / "tried.csv")
    assert [r[0] for r in read.tables["Models that were fitted"][1:]] == list(tried["effects"].fillna("none"))


def test_what_was_added_is_told_by_parameter_and_by_mode(everything, text, read):
    found = pd.read_csv(everything / "added_parameters.csv").set_index("parameter")
    head, *rows = read.tables["Calibrated parameters without and with what was added"]
    assert [r[0] for r in rows] == list(found.index) and head[3] == "without" and head[5] == "with guy"
    for row in rows:
        assert (row[1] == "added") == found["added"][row[0]] == (row[0] == "guy") == (row[3] == "–")
        assert number(row[5]) == pytest.approx(found["after"][row[0]], rel=6e-4)
    moved = found[(found["after"] - found["before"]).abs() > 2 * found["before_std"]].index
    (words,) = [w for w in read.text.split("standard deviations: ") if w.startswith(f"{moved[0]} ")]
    words = words[: words.index("). ")]
    assert [w.split()[0] for w in words.split("; ")] == list(moved) and "guy" not in words
    modes = pd.read_csv(everything / "added_modes.csv")
    ((head, *rows),) = (t for name, t in read.tables.items() if name.startswith("Every measured mode: nothing fitted"))
    assert [r[1] for r in rows] == ["withheld" if held else "fitted" for held in modes["withheld"]]
    for stage, words in (("initial", "nothing fitted"), ("before", "calibrated"), ("after", "extended")):
        cells = [number(r[head.index(f"error {words}, %")]) for r in rows]
        np.testing.assert_allclose(cells, 100 * modes[f"error_{stage}"], atol=0.00501)
    top = " ".join(Reader(text[: text.index("<section")]).text.split())
    assert "With it the model fits better and predicts better what no fit has seen." in top
    assert "0.03 % (noise allows 0.16 %)" in top  # the scatter of each frequency is 0.2 %: 0.2 sqrt(2/pi)
    rms = pd.read_csv(everything / "added_errors.csv").set_index(["group", "stage"])["rms"]
    told = [f"{rms['withheld_modes', stage]:.2f}" for stage in ("before", "after")]
    assert f"error in withheld modes {told[0]} → {told[1]} σ" in top


def test_until_something_is_added_the_errors_are_those_of_the_explanation(folder):
    for file in folder.glob("added*"):
        file.unlink()
    *told, last = sections(Answers(folder, TITLE, True))
    assert [s.name for s in told] == WHOLE and last.name == "not-asked"
    assert any("calib run mast" in words.text for words in last.blocks)
    errors = pd.read_csv(folder / "errors.csv")
    rows = blocks(folder, Table)["Errors before and after adding guy"].rows
    np.testing.assert_allclose([number(r[3]) for r in rows], errors["rms"], atol=0.00501)


def test_why_nothing_was_added_is_told(folder):
    for file in folder.glob("added*"):
        file.unlink()
    (folder / "added.json").write_text('{"sentence": "None of them is added.", "conclusion": "", "effects": []}')
    read = Reader(page(Answers(folder, TITLE, True)))
    assert "None of them is added." in read.text and "errors" in [a["id"] for a in read.named("section")]


def test_the_sentences_are_those_that_were_said(everything, read):
    told = json.loads((everything / "explanation.json").read_text())["sentence"]
    assert " ".join(told.replace("->", "→").split()) in read.text
    record = json.loads((everything / "record.json").read_text())
    for question in ("compare", "sensitivity", "calibrate", "extend"):
        sentences = record["questions"][question]["sentences"]
        assert sentences and all(" ".join(s.replace("->", "→").split()) in read.text for s in sentences)


def test_figures_show_the_tables(everything):
    plots = blocks(everything, Plot)
    before, after = (pd.read_csv(everything / f"comparison_{s}.csv") for s in ("before", "after"))
    bars = plots["errors-after"].figure.data
    np.testing.assert_allclose(bars[0].y, 100 * before["freq_error"])
    np.testing.assert_allclose(bars[2].y, 100 * after["freq_error"])
    np.testing.assert_allclose(bars[3].y, after["mac"])
    mac = pd.read_csv(everything / "mac_before.csv").set_index("mode")
    np.testing.assert_allclose(plots["mac-before"].figure.data[0].z, mac)
    errors = pd.read_csv(everything / "added_errors.csv")
    drawn = plots["errors"].figure.data
    np.testing.assert_allclose(drawn[0].y, errors[errors["stage"] == "before"]["rms"])
    np.testing.assert_allclose(drawn[1].y, errors[errors["stage"] == "before"]["expected"])
    effects = pd.read_csv(everything / "effects.csv")
    shown = [v for trace in plots["ranked-effects"].figure.data if trace.type == "bar" for v in trace.x]
    np.testing.assert_allclose(sorted(shown), sorted(effects["ln_bayes"]))


def test_what_cannot_be_seen_is_grey(folder):
    effects = pd.read_csv(folder / "effects.csv")
    effects["visible"] = effects["name"] != "lamp"
    effects.to_csv(folder / "effects.csv", index=False)
    table = blocks(folder, Table)["Every effect of the library, ranked"]
    assert [table.rows[k][1] for k in table.grey] == ["lamp"] and "cannot be seen" in table.rows[table.grey[0]][-1]
    axis = blocks(folder, Plot)["ranked-effects"].figure.layout.yaxis
    assert [t for t in axis.ticktext if "color" in t] == ['<span style="color:#767676">Lamp near the top</span>']


# -- writing -----------------------------------------------------------------------------------------------------------


def test_the_page_is_written_beside_its_tables_and_is_the_same_each_time(folder, text):
    path = write_report(folder, TITLE, True)
    assert path == folder / "report.html" and path.read_text(encoding="utf-8") == text
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


def test_a_stop_while_writing_leaves_the_old_page(folder, monkeypatch):
    path = write_report(folder, TITLE, True)
    old = path.read_bytes()
    monkeypatch.setattr(write, "page", lambda answers: "a new page")
    write_text = type(path).write_text

    def stop(self, content, **options):
        write_text(self, content[:3], **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(type(path), "write_text", stop)
    with pytest.raises(KeyboardInterrupt):
        write_report(folder, TITLE, True)
    assert path.read_bytes() == old and not [p for p in folder.iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("measured.csv", "natural_freq", "frequency"), ("effects.csv", "True", "maybe"), ("record.json", "{", "")],
)
def test_a_damaged_table_is_named_and_nothing_is_written(folder, name, old, new):
    file = folder / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(name)):
        write_report(folder, TITLE, True)
    assert not (folder / "report.html").exists()


def test_a_missing_folder(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        write_report(tmp_path / "nowhere", TITLE, False)


def test_an_empty_folder_says_what_to_ask(tmp_path):
    found = Reader(page(Answers(tmp_path, TITLE, False)))
    assert [a["id"] for a in found.named("section")] == ["not-asked"] and "Nothing was compared yet." in found.text
