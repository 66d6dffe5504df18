"""A number in several places of the page, the figures and the tables has one value and one rounding."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from calib.inference.verdicts import identified_sentence
from calib.report.calibration import draw_searches
from calib.report.comparison import draw_frequency_error
from calib.report.frequencies import draw_frequencies
from calib.report.html.space import scene
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.report.numbers import fixed, percent
from calib.report.parameters import draw_parameters
from calib.workbench.missing import missing, versions
from calib.workbench.studies import Studies
from tests.report.html.page_blocks import Picture, Viewer


@pytest.fixture
def parameters(everything):
    return pd.read_csv(everything / "parameters.csv")


def test_identified_parameters_are_counted_once(everything, results):
    verdicts = pd.read_csv(everything / "verdicts.csv")
    sentences = json.loads((everything / "record.json").read_text())["analyses"]["calibrate"]["sentences"]
    counted = f"{verdicts['identified'].sum()} of {len(verdicts)}"
    extended = pd.read_csv(everything / "added_parameters.csv")["after_identified"].dropna()
    after = f"{int(extended.sum())} of {len(extended)}"
    assert dict(page_summary(results).facts)["parameters identified"] == f"{counted} → {after}"
    assert [s for s in sentences if "parameters are identified" in s] == [identified_sentence(verdicts)]
    assert identified_sentence(verdicts).startswith(counted)


@pytest.mark.medium
def test_the_figures_of_the_parameters_are_those_of_the_page(folder, parameters, blocks):
    span = parameters["upper"] - parameters["lower"]
    shifted = parameters.assign(search_value=parameters["value"] + 0.1 * span * (1 - 2 * (parameters["ratio"] > 0.5)))
    other = shifted.assign(case="A2", search_value=parameters["lower"] + 0.3 * span)
    pd.concat([shifted, other]).to_csv(folder / "parameters.csv", index=False)
    found, best = pd.read_csv(folder / "parameters.csv"), parameters["case"].iloc[0]
    bars = [container for container in draw_searches(found, best_case=best).containers]
    assert len(bars) == 2
    (dots,) = [line for line in draw_parameters(found, best_case=best).lines if line.get_gid() == "identified True"]
    told = dict(re.findall(r"(\S+) ([\d.]+)(?=[,.] )", blocks(folder, Picture)["parameters"].alt.split(": ", 1)[1]))
    assert told == {n: fixed(v, 2) for n, v in zip(parameters["parameter"], parameters["ratio"], strict=True)}
    names = list(parameters["parameter"])
    for place, row in zip(dots.get_xdata(), dots.get_ydata(), strict=True):
        assert told[names[int(row)]] == fixed(place, 2)
    assert {"parameters", "searches"} <= set(blocks(folder, Picture))


@pytest.mark.medium
def test_without_a_search_its_ends_are_not_drawn(folder, parameters, blocks):
    parameters.assign(search_value=np.nan).to_csv(folder / "parameters.csv", index=False)
    assert "searches" not in blocks(folder, Picture)


def test_the_mean_error_has_one_value_and_one_rounding(everything, results):
    stored = json.loads((everything / "summary.json").read_text())
    tables = {s: pd.read_csv(everything / f"comparison_{s}.csv") for s in ("before", "after")}
    words = [t.get_text() for t in draw_frequency_error(tables["before"], tables["after"]).get_legend().get_texts()]
    fact = dict(page_summary(results).facts)
    (label,) = [name for name in fact if name.startswith("mean error of natural frequencies")]
    for stage, text in zip(tables, words, strict=True):
        number = percent(stored[f"mean_freq_error_{stage}"])
        assert percent(tables[stage]["freq_error"].abs().mean()) == number
        assert re.findall(r"[\d.]+(?= %)", text) == [number] and number in fact[label]
    every = draw_frequencies(pd.read_csv(everything / "modes.csv"))
    assert not any("%" in t.get_text() for t in every.get_legend().get_texts())  # held-out modes have another mean


@pytest.mark.medium
def test_the_viewer_opens_with_the_stage_of_its_section(everything, results, blocks):
    shapes = blocks(everything, Viewer)["viewer"]
    assert [stage["name"] for stage in scene(results)["stages"]] == ["before calibration", "after calibration"]
    assert "before calibration" in shapes.alt


def test_the_sentence_of_a_comparison_has_the_rounding_of_the_page(everything):
    stored = json.loads((everything / "summary.json").read_text())
    (sentence,) = [
        words
        for words in json.loads((everything / "record.json").read_text())["analyses"]["compare"]["sentences"]
        if "frequency error" in words
    ]
    assert f"{percent(stored['mean_freq_error_before'])} %" in sentence


def test_the_live_page_tells_the_effects_of_the_tables(everything, results):
    told = missing(results)
    table = pd.read_csv(everything / "effects.csv").sort_values("ln_bayes", ascending=False, kind="stable")
    assert [one["evidence"] for one in told["effects"]] == [fixed(value, 1) for value in table["ln_bayes"]]
    assert {one["name"] for one in told["effects"] if one["credible"]} == set(table.loc[table["credible"], "name"])
    explanation = json.loads((everything / "explanation.json").read_text())
    assert told["to_add"] == explanation["to_add"] == told["chosen"] == explanation["chosen"] == ["guy"]
    assert told["answer"]["found"] == page_summary(results).found
    why = pd.read_csv(everything / "why.csv")
    assert told["shown"] == list(dict.fromkeys(why["effect"]))
    largest = pd.read_csv(everything / "perturbations.csv").sort_values("score", key=lambda z: -z.abs(), kind="stable")
    assert [one["name"] for one in told["places"]] == largest["perturbation"].head(6).tolist()
    gains = set(pd.read_csv(everything / "next_measurement.csv")["gain"].map(lambda gain: f"× {fixed(gain, 2)}"))
    assert told["measurements"] and {one["gain"] for one in told["measurements"]} <= gains


@pytest.mark.parametrize(("verdict", "composed"), [("effect", False), ("partial", True), ("nothing_detectable", False)])
@pytest.mark.parametrize("to_add", [[], ["guy"]])
def test_the_live_page_offers_what_the_explanation_would_add(folder, verdict, composed, to_add):
    stored = json.loads((folder / "explanation.json").read_text())
    (folder / "explanation.json").write_text(json.dumps({**stored, "verdict": verdict, "to_add": to_add}))
    told = missing(StudyResults(folder, "", True))
    assert (told["to_add"], told["composed"]) == (to_add, composed)


def test_the_live_page_tells_the_errors_of_every_version(everything):
    studies = Studies(everything.parents[1] / "mast", everything.parent)
    first, second = versions(studies, next(iter(studies.all().values())), "")
    assert (first["effects"], second["effects"], second["parent"]) == ([], ["guy"], first["key"])
    added = pd.read_csv(everything / "added_errors.csv").set_index(["group", "stage"])["rms"]
    for one, stage in ((first, "before"), (second, "after")):
        assert {own["group"]: own["text"] for own in one["errors"]} == {
            group: fixed(rms, 2) for (group, of), rms in added.items() if of == stage
        }
