"""The key to p-values and limits: once, before their first table, with the numbers of the tables."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from calib.correlation import rules
from calib.correlation.modal import comparison
from calib.missing.rules import RULES
from calib.report.explanation import COLLINEAR, LEAST_BAYES_FACTOR
from calib.report.html.fails import BEYOND, BY_CHANCE, CONTRADICTED, NONE, TESTS, WITHIN
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed
from tests.report.html.page_blocks import Picture, Table, Terms, page_blocks

KEY = "Key to p-values and limits"


def key(folder, blocks):
    """Rows of the key by their number."""
    return {row[0].split()[0]: row for row in blocks(folder, Table)[KEY].rows}


@pytest.mark.medium
def test_the_key_stands_once_before_every_table_and_figure_of_p_values_and_limits(results):
    every = page_blocks(results)
    (place,) = [k for k, block in enumerate(every) if isinstance(block, Table) and block.caption == KEY]
    later = [b.name for b in every[place:] if isinstance(b, Picture)]
    assert {"where_it_fails", "where_it_fails_sigma", "pulls", "ranked_effects", "perturbation_map"} <= set(later)
    first = [b for b in every[:place] if isinstance(b, Table)]
    assert not {head.split(" ")[0] for table in first for head in table.heads} & {"p", "shift", "evidence", "verdict"}
    terms = [term for b in every if isinstance(b, Terms) for term, _ in b.pairs]
    assert "p" not in terms  # told by the key


@pytest.mark.medium
def test_the_limits_are_those_of_the_tests(everything, blocks):
    rows = key(everything, blocks)
    pulls, effects = pd.read_csv(everything / "pulls.csv"), pd.read_csv(everything / "effects.csv")
    scores = pd.read_csv(everything / "perturbations.csv")["score"]
    of_base = int((pulls["model"] == "base").sum())
    assert rows["p-value"][1] == f"{json.loads((everything / 'explanation.json').read_text())['alpha']:g}" == "0.01"
    assert rows["shift"][1] == f"± {fixed(norm.isf(0.01 / 2 / of_base), 1)}" and f" {of_base} " in rows["shift"][2]
    assert rows["evidence"][1] == fixed(3 + math.log(len(effects)), 1)
    assert rows["score"][1] == f"± {fixed(norm.isf(0.01 / 2 / scores.notna().sum()), 1)}"


@pytest.mark.medium
def test_what_lies_beyond_a_limit_is_named_or_counted(everything, blocks):
    rows = key(everything, blocks)
    effects, found = pd.read_csv(everything / "effects.csv"), json.loads((everything / "explanation.json").read_text())
    known = effects.sort_values("ln_bayes", ascending=False)
    beyond = known[known["ln_bayes"] > 3 + math.log(len(effects))]
    told = {"": beyond["credible"], "ruled out: ": ~beyond["credible"] & beyond["refitted"]}
    told["ruled out, linear prediction only: "] = ~beyond["credible"] & ~beyond["refitted"]
    parts = [f"{words}{', '.join(beyond['name'][some])}" for words, some in told.items() if some.any()]
    assert rows["evidence"][3] == "; ".join(parts) and len(parts) > 1
    below = [words for name, words in TESTS.items() if found[name] <= 0.01]
    assert below and rows["p-value"][3] == "; ".join(below) and len(below) < len(TESTS)
    tables = [pd.read_csv(everything / f"where_it_fails_{stage}.csv") for stage in ("before", "after", "added")]
    counts = [f"{t['verdict'].str.startswith('beyond').sum()} of {len(t)}" for t in tables]
    assert [words.split(",")[0] for words in rows["comparison,"][3].split("; ")] == counts
    scores = pd.read_csv(everything / "perturbations.csv")
    count = int((scores["score"].abs() > scores["limit"]).sum())
    assert rows["score"][3] == f"{count} of {len(scores)}" and count


@pytest.mark.medium
def test_an_effect_below_the_limit_of_the_evidence_is_not_beyond_it(folder, blocks):
    table = pd.read_csv(folder / "effects.csv")
    limit = 3 + math.log(len(table))
    values = [limit + 0.1, limit - 0.1, 0.5]
    table["ln_bayes"] = [*values, *[-1.0] * (len(table) - 3)]
    table.to_csv(folder / "effects.csv", index=False)
    assert key(folder, blocks)["evidence"][3] == table["name"][0]


@pytest.mark.medium
def test_effects_above_the_limit_that_were_not_refitted_are_said_to_be_predicted_only(folder, blocks):
    table = pd.read_csv(folder / "effects.csv")
    assert len(table) >= 4
    table["ln_bayes"] = [204.5, 67.3, 51.0, 51.0, *[-1.0] * (len(table) - 4)]
    table["credible"] = [True, *[False] * (len(table) - 1)]
    table["refitted"] = [True, True, *[False] * (len(table) - 2)]
    table["implausible"], table["confounded_with"], table["stands_for"] = "", "", ""
    table.loc[1, "stands_for"] = table.loc[3, "name"]  # it has the evidence of the fitted one
    table.to_csv(folder / "effects.csv", index=False)
    first, second, third, fourth, *_ = table["name"]
    told = f"{first}; ruled out: {second}, {fourth}; ruled out, linear prediction only: {third}"
    assert key(folder, blocks)["evidence"][3] == told
    shown = {row[1]: row[-1] for row in blocks(folder, Table)["Every listed effect, ranked"].rows}
    words = f"evidence less than {first} by 153.5; linear prediction only"
    assert words in shown[third] and not any("linear" in remark for name, remark in shown.items() if name != third)


def test_the_levels_are_those_of_the_analyses():
    """The report reads tables only, so it holds these numbers itself."""
    assert (BEYOND, WITHIN) == (comparison.BEYOND, rules.RULES.level)
    assert RULES.pull == RULES.noise_level == BY_CHANCE and RULES.contradicted == CONTRADICTED
    assert (RULES.credible, RULES.confounded) == (LEAST_BAYES_FACTOR, COLLINEAR)


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("pulled", [(), (0,), (0, 2)])
def test_pulled_parameters_are_named_with_their_model(folder, blocks, pulled):
    table = pd.read_csv(folder / "pulls.csv")
    table["pulled"] = np.isin(np.arange(len(table)), pulled)
    table.to_csv(folder / "pulls.csv", index=False)
    names = [f"{table['parameter'][k]} ({table['model'][k]})" for k in pulled]
    assert key(folder, blocks)["shift"][3] == (", ".join(names) or NONE)


@pytest.mark.medium
def test_without_an_explanation_p_is_told_with_the_errors(folder, blocks):
    (folder / "explanation.json").unlink()
    assert KEY not in blocks(folder, Table)
    every = page_blocks(StudyResults(folder, "", True))
    assert [t for b in every if isinstance(b, Terms) for t, _ in b.pairs].count("p") == 1
