"""Every table that an explanation writes, against its inputs."""

import json
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.explain import GROUPS, explain
from calib.inference.leave_one_out import leave_one_out
from calib.missing.score import noise_limit
from calib.missing.tables import EFFECT_COLUMNS
from calib.results.results import Results
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
ERRORS = ["group", "stage", "rows", "rms", "expected", "p", "unpaired", "std_from"]
COMMON = {"faults", "effects", "errors", "perturbations", "confounding", "pulls", "misfit_kinds", "candidate_fits",
          "next_measurement", "accuracy", "explained_fits", "suspects_explained", "why", "why_parameters",
          "why_places"}  # fmt: skip
MODAL = COMMON | {
    "test_order",
    "sensor_misfit",
    "unpaired",
    "mesh_points",
    "mesh_elements",
    "model_places",
    "effect_places",
}
GROUND = {"measured", "assumptions", "parameter_space", "repeat_disagreements"}
"""Tables that every analysis writes."""
OF_MODES = ["fit", "left_out", "held_out_sensors", "held_out_modes"]


def saved(results, name):
    return pd.read_csv(results.path / f"{name}.csv", keep_default_na=False, na_values=[""])


def test_every_table_is_written_as_returned(guyed, bare, chain):
    for results, answer, names, ground in (
        (guyed[1], guyed[2], MODAL, GROUND | {"sensors"}),
        (bare[1], bare[2], MODAL, GROUND | {"sensors"}),
        (chain[1], chain[2], COMMON | {"response_misfit"}, GROUND),
    ):
        assert {p.stem for p in results.path.glob("*.csv")} == names | ground
        assert {p.name for p in results.path.iterdir() if p.suffix != ".csv"} == {
            "explanation.json",
            "record.json",
            "written.sha256",
        }
        for name in names:
            table = {"effects": answer.effects, "errors": answer.errors, **answer.tables}[name]
            assert list(saved(results, name).columns) == list(table.columns) and len(saved(results, name)) == len(table)


@pytest.mark.slow
def test_a_second_explanation_is_the_same(guyed, tmp_path):
    study, results, _, _ = guyed
    again = Results.at(tmp_path, study.name)
    explain(LoadedStudy.load(study.file), again)
    first, second = ({p.name: p.read_bytes() for p in r.path.glob("*.csv")} for r in (results, again))
    assert first and first == second


# -- errors and misfit -------------------------------------------------------------------------------------------------


def test_errors_are_given_by_group_before_and_after(guyed, bare):
    _, results, answer, _ = guyed
    table = answer.errors
    assert list(table.columns) == ERRORS == list(saved(results, "errors").columns)
    assert list(zip(table["stage"], table["group"], strict=True)) == [
        (s, g) for s in ("before", "after") for g in OF_MODES
    ]
    by = table.set_index(["group", "stage"])["rms"]
    expected = table.set_index(["group", "stage"])["expected"]
    for group in ("fit", "left_out", "held_out_modes"):
        assert by[group, "after"] < by[group, "before"]
    for group in ("fit", "held_out_sensors", "held_out_modes"):
        assert by[group, "after"] < 1.5 * expected[group, "after"]
    content = json.loads((results.path / "explanation.json").read_text())["errors"]
    unknown = {g: {"before": None, "after": None} for g in GROUPS}
    assert content == {**unknown, **{g: {s: by[g, s] for s in ("before", "after")} for g in OF_MODES}}
    assert set(bare[2].errors["stage"]) == {"before"}


@pytest.mark.slow
def test_held_out_responses_of_a_function_enter_no_fit_and_verify_it(chain_folder, tmp_path):
    file = chain_folder / "study.toml"
    held = '[held_out]\nresponses = ["freq_2", "damping_2", "shape_1_3", "shape_2_4"]\n\n[calibration]'
    file.write_text(file.read_text().replace("[calibration]", held))
    study = LoadedStudy.load(chain_folder)
    answer = explain(study, Results.at(tmp_path / "results", "chain"))
    assert answer.explanation.credible == ("hung_mass_5",)
    table = answer.errors.set_index(["group", "stage"])
    rows = table["rows"].xs("after", level=1).to_dict()
    assert rows == {"fit": 26, "left_out": 26, "held_out_responses": 4}
    values = answer.explanation.chosen.fit.values
    effect = answer.explanation.chosen.effects[0]
    function = effect.build(study.model) or study.model.function
    model = function(values)
    e = [
        (study.experiment.measured.targets[n][0] - model[n]) / study.experiment.measured.targets[n][1]
        for n in study.settings.held_out.responses
    ]
    assert table.loc[("held_out_responses", "after"), "rms"] == pytest.approx(np.sqrt(np.mean(np.square(e))), rel=1e-6)
    assert table.loc[("held_out_responses", "after"), "p"] > 0.01


def test_misfit_by_sensor_is_that_of_the_fits(guyed, chain):
    _, results, answer, _ = guyed
    table = saved(results, "sensor_misfit")
    for stage, candidate_fit in (("base", answer.explanation.base), ("explained", answer.explanation.chosen)):
        own = table[table["stage"] == stage]
        shapes = [k for k, row in enumerate(candidate_fit.fit.fit_problem.inner.rows) if row.kind == "shape"]
        np.testing.assert_allclose(own["re"], candidate_fit.fit.residual[shapes], rtol=1e-8, atol=1e-9)
    scalar = saved(chain[1], "response_misfit")
    np.testing.assert_allclose(
        scalar.loc[scalar["stage"] == "base", "residual"], chain[2].explanation.base.fit.residual, rtol=1e-8
    )


# -- effects and local perturbations -----------------------------------------------------------------------------------


def test_effects_have_the_documented_columns(guyed, chain):
    for results in (guyed[1], chain[1]):
        assert tuple(saved(results, "effects").columns) == EFFECT_COLUMNS
    documented = runpy.run_path(str(ROOT / "tests/docs/tables.py"))["documented"]()["effects.csv"]
    assert set(EFFECT_COLUMNS) == set(documented)


def test_the_score_of_the_named_effect_follows_from_the_rows_of_its_pattern(guyed, bare, chain):
    projected = []
    for _, results, answer, *_ in (guyed, chain):
        table, rows = saved(results, "why"), answer.explanation.base.fit.fit_problem.inner.rows
        (name,) = set(table["effect"])
        assert (name,) == answer.explanation.chosen.names
        data = table[table["kind"] != "prior"]
        assert data["kind"].tolist() == [row.kind for row in rows] and len(table) > len(data)
        assert data["sensor"].fillna("").tolist() == [row.sensor for row in rows]
        assert data["part"].astype(object).fillna("").tolist() == [getattr(row, "part", "") for row in rows]
        np.testing.assert_allclose(table["residual"], table["signature"] + table["left"], atol=1e-8)
        base = answer.explanation.base.fit
        if base.active:  # the pattern keeps the limits, the score test does not
            np.testing.assert_allclose(data["residual"], base.residual, atol=0.02 * np.abs(base.residual).max())
            continue
        projected.append(name)
        z = table["signature"] @ table["residual"] / np.linalg.norm(table["signature"])
        assert z == pytest.approx(saved(results, "effects").set_index("name").loc[name, "z"], rel=1e-6)
    assert projected
    assert saved(bare[1], "why").empty and saved(bare[1], "why_places").empty


def test_places_are_those_of_the_local_perturbations(guyed):
    own = saved(guyed[1], "why_places").set_index("perturbation")
    known = saved(guyed[1], "perturbations").set_index("perturbation")
    seen = known[known["unabsorbed"] > 0]
    assert set(own.index) == set(seen.index) and own["correlation"].abs().max() <= 1.0
    columns = ["kind", "x", "y", "z"]
    pd.testing.assert_frame_equal(own.loc[seen.index, columns], seen[columns])


def test_leave_one_out_gains_are_those_of_the_two_models(guyed):
    *_, answer, _ = guyed
    found = answer.explanation
    modes = [row.mode for row in found.base.fit.fit_problem.inner.rows]

    def density(candidate_fit):
        s = candidate_fit.fit
        free = [k for k, name in enumerate(s.names) if name not in s.active]
        return leave_one_out(s.residual, s.slope[:, free], s.prior_sd[free], modes).elpd.sum()

    table = answer.effects.set_index("name")["held_out_gain"]
    for candidate_fit in found.singles:
        assert table[candidate_fit.names[0]] == pytest.approx(density(candidate_fit) - density(found.base))
    assert (
        table["guy"] > 10
        and table[[n for n in table.index if n not in {t.names[0] for t in found.singles}]].isna().all()
    )


def test_local_perturbations_are_written_with_their_locations(guyed, chain):
    study, results, answer, _ = guyed
    table = saved(results, "perturbations")
    columns = ["perturbation", "kind", "x", "y", "z", "sensor", "score", "unabsorbed", "limit", "told"]
    assert list(table.columns) == columns
    places = {s.name: s.point for s in study.measured.sensors}
    for row in table[table["sensor"].notna()].to_dict("records"):
        assert (row["x"], row["y"], row["z"]) == places[row["sensor"]] and row["sensor"] in row["perturbation"]
    scores = answer.explanation.base_adequacy.perturbations
    possible = np.where(scores.signed, scores.z, np.maximum(scores.z, 0))
    assert (possible != scores.z).any()  # a perturbation at a sensor that fits with the unphysical sign
    np.testing.assert_allclose(table["score"], possible, rtol=1e-8, atol=1e-9)
    assert list(set(table["limit"])) == [pytest.approx(noise_limit(possible))]
    assert list(table["perturbation"]) == list(scores.owners) and {"2x", "4z"}.isdisjoint(table["sensor"].dropna())
    scalar = saved(chain[1], "perturbations")
    assert set(scalar.loc[scalar["kind"] == "response", "perturbation"]) == {
        f"{change} of {k}" for change in ("offset", "scale") for k in ("freq", "damping", "shape")
    }
    assert set(scalar["kind"]) == {"parameter", "response"} and scalar[["x", "y", "z"]].isna().all(axis=None)
