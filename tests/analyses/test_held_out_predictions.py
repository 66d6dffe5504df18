"""Predictions of held-out data with an unexplained misfit, of every kind of test and of several together."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.analyses.explain import decision
from calib.analyses.hypotheses_of_study import adapter_for, adapters_for
from calib.api.pairs import library_of
from calib.correlation import basis as requirements
from calib.errors.errors import EvaluationError
from calib.execution.stage import silent
from calib.missing.discrepancy import discrepancy
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.several import load
from calib.study.study import LoadedStudy
from tests.study.conftest import write_study

FRFS = module_of(__file__.rsplit("/", 2)[0] + "/template/frf_chain.py")
SOFT = 0.1 * FRFS.HIDDEN
"""Stiffness so small that its effect is linear, N/m."""
BOTH = ("rms", "expected", "p")


def wide_of(found):
    """As after a verdict that names nothing, whatever it is."""
    tests = found.base_adequacy
    return discrepancy(found.base.fit, tests.perturbations, tests.named)


def predicted(adapter, found):
    """Predictions and errors, checked against the errors that every explanation tells."""
    table, errors = adapter.predictions(found.base, wide_of(found), found.noise_scale)
    known = adapter.errors({"before": found.base}, found.noise_scale)[0].set_index("group")
    for row in errors.to_dict("records"):
        assert [row[name] for name in ("rows", *BOTH)] == pytest.approx(
            known.loc[row["group"], ["rows", *BOTH]].tolist(), rel=1e-6, abs=1e-12
        )
        assert row["expected_unexplained"] > row["expected"] and row["p_unexplained"] >= row["p"]
    return table, errors


def inside(table):
    return table["inside"].mean(), table["inside_unexplained"].mean()


@pytest.fixture(scope="module")
def frfs():
    """FRFs of a chain with a soft spring that the model lacks: what was found, and the adapter."""
    held_out = {"held_out": ["3x"], "held_out_references": ["4x"], "held_out_bands": [(20.0, 26.0)]}
    test = calib.FRFTest(FRFS.measured(2, ground=SOFT), **held_out)
    problem = calib.Problem(FRFS.chain(), test)
    found = problem.explain(FRFS.effects(), progress=False)
    (adapter,) = adapters_for(problem.study(effects=library_of(problem, FRFS.effects()))).values()
    return found.explanation.explanation, adapter


def test_most_measured_modes_lie_inside_where_those_of_the_fit_alone_do_not(guyed):
    study, results, answer, _ = guyed
    table, errors = predicted(adapter_for(study, results, silent, {}), answer.explanation)
    alone, beside = inside(table)
    assert beside >= 0.93 > alone
    assert set(errors["group"]) == {"held_out_sensors", "held_out_modes"}
    whole = study.whole_problem().measured
    of_mode = table[(table["group"] == "held_out_modes") & (table["kind"] == "frequency")].iloc[0]
    freq = dict(zip(whole.names, whole.natural_freq, strict=True))
    assert of_mode["mode"] == "B3x" and of_mode["value"] == pytest.approx(freq["B3x"])
    shapes = table[table["group"] == "held_out_sensors"].set_index(["mode", "sensor"])["value"]
    at = [sensor.name for sensor in whole.sensors].index("2x")
    entry = whole.shapes[at, whole.names.index("B1x")]
    assert abs(shapes["B1x", "2x"]) == pytest.approx(abs(entry), rel=1e-6)


def test_a_change_of_held_out_rows_is_the_difference_that_the_candidate_makes(guyed):
    """Frequencies exactly, as their rows have no factor; parts of shapes nearly."""
    study, results, answer, _ = guyed
    adapter, found = adapter_for(study, results, silent, {}), answer.explanation
    wide, values = wide_of(found), found.base.fit.values
    changes = adapter._changed(found.base, wide, 2.0)
    here = adapter.residuals_held_out((), values, ())
    for name in ("guy", "platform"):
        k = wide.owners.index(name)
        there = adapter.residuals_held_out((), {**values, name: 1e-3}, ())
        for group, (e, _) in here.items():
            difference = (e - there[group][0]) / (1e-3 * 2.0)
            np.testing.assert_allclose(
                changes[group][:, k], difference, rtol=0.05, atol=0.05 * np.abs(difference).max()
            )


@pytest.mark.medium
def test_held_out_modes_above_the_reach_of_a_reduced_basis_are_predicted_at_full_order(mast, tmp_path, monkeypatch):
    """The basis is trained for the modes that are fitted, of which there are fewer."""
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast", {"guy": 12000.0}))
    test = calib.ModalTest(study.problem.measured, clusters=study.problem.mode_clusters, held_out=["B3x", "B3z"])
    problem = calib.Problem(mast.mast(), test)
    plain = _adapter(problem, mast)
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 10)
    reduced = _adapter(problem, mast)
    basis = reduced.hypotheses.variants.basis
    assert plain.hypotheses.variants.basis is None and reduced.whole.mode_count > basis.count > 0
    values = problem.space.values
    for names, by, at in (((), ("guy", "K_base"), {}), (("platform",), ("platform",), {"platform": 30.0})):
        expected, found = (one.residuals_held_out(names, {**values, **at}, by) for one in (plain, reduced))
        assert set(found) == {"held_out_modes"} == set(expected)
        for k in (0, 1):
            np.testing.assert_allclose(found["held_out_modes"][k], expected["held_out_modes"][k], rtol=1e-9, atol=1e-9)


def _adapter(problem, mast):
    (adapter,) = adapters_for(problem.study(effects=library_of(problem, list(mast.library())))).values()
    return adapter


@pytest.mark.medium
def test_frfs_held_out_are_predicted_with_the_misfit(frfs):
    found, adapter = frfs
    table, errors = predicted(adapter, found)
    assert set(errors["group"]) == {"held_out_sensors", "held_out_references", "held_out_bands"}
    assert len(table) == errors["rows"].sum() and {"freq", "part"} <= set(table)
    alone, beside = inside(table)
    assert beside > 0.9 > 0.7 > alone
    measured = adapter.held_out["held_out_sensors"].measured
    own = table[(table["group"] == "held_out_sensors") & (table["part"] == "im")]
    line = own.iloc[3]
    k = int(np.argmin(np.abs(measured.freq - line["freq"])))
    names = [f"{r.name}/{q.name}" for q in measured.references for r in measured.responses]
    entry = measured.values[k].T.ravel()[names.index(line["sensor"])]
    assert line["value"] == pytest.approx(entry.imag)


@pytest.mark.medium
def test_a_candidate_with_a_grid_changes_held_out_data_by_differences(frfs):
    """The same as the derivative where the grid has one small point."""
    explanation, adapter = frfs
    wide = wide_of(explanation)
    k = wide.owners.index("ground_2")
    by_grid = replace(wide, points=tuple({"ground_2": 1e-2} if j == k else p for j, p in enumerate(wide.points)))
    exact, other = (adapter._changed(explanation.base, one, 1.0) for one in (wide, by_grid))
    for group in exact:
        np.testing.assert_allclose(
            other[group][:, k], exact[group][:, k], rtol=1e-3, atol=1e-3 * np.abs(exact[group][:, k]).max()
        )


@pytest.mark.medium
def test_a_candidate_that_fails_on_held_out_data_is_left_out_there(frfs, monkeypatch):
    (explanation, adapter), own = frfs, type(frfs[1]).residuals_held_out

    def failing(self, names, values, by):
        if "mass_3" in by:
            raise EvaluationError("no solution")
        return own(self, names, values, by)

    monkeypatch.setattr(type(adapter), "residuals_held_out", failing)
    wide = wide_of(explanation)
    changes = adapter._changed(explanation.base, wide, 1.0)
    for group in changes:
        assert not changes[group][:, wide.owners.index("mass_3")].any()
        assert changes[group][:, wide.owners.index("ground_2")].any()


def test_scalar_responses_held_out_are_predicted_without_a_further_call():
    asked = []

    def loads(values):
        asked.append(tuple(sorted(values.items())))
        return {f"load_{d}": values["k"] * d + values["c"] for d in range(1, 8)}

    k = calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m", prior_sd=2.0)
    space = calib.ParameterSpace((k, calib.Parameter("c", 0.0, -5.0, 5.0, "kN", prior_sd=2.0)))
    rng = np.random.default_rng(3)
    targets = {f"load_{d}": (10.2 * d + 0.4 * d**3 / 7 + 0.02 * rng.standard_normal(), 0.02) for d in range(1, 8)}
    test = calib.ResponseTest(targets, held_out=["load_4", "load_7"])
    why = calib.Problem(calib.FunctionModel("spring", space, loads), test).explain([], progress=False)
    assert why.verdict in ("none_explains", "misfit_unlocated") and len(asked) == len(set(asked))
    assert why.predictions["sensor"].tolist() == ["load_4", "load_7"]
    assert why.predictions["value"].tolist() == [targets["load_4"][0], targets["load_7"][0]]
    assert why.intervals["parameter"].tolist() == ["k", "c"]
    assert ".intervals, .predictions; all in .explanation" in why.lines["Evidence"]
    assert any(words.startswith("Validation data inside the 95 % intervals") for words in why.sentences)


@pytest.mark.medium
def test_each_of_several_tests_is_predicted_by_the_discrepancy_of_all(tmp_path):
    folder = write_study(tmp_path / "frame")
    study = load(folder)
    adapter = adapter_for(study, Results.at(tmp_path / "r", "frame"), silent, {})
    found = decision(adapter, study.settings.explain, "frame")
    wide = wide_of(found)
    table, errors = adapter.predictions(found.base, wide, found.noise_scale)
    assert set(table["test"]) == set(errors["test"]) == {"loaded"}
    part = adapter.hypotheses.of("loaded", found.base)
    known = adapter.adapters["loaded"].errors({"before": part}, found.noise_scale)[0].set_index("group")
    for row in errors.to_dict("records"):
        assert row["expected"] == pytest.approx(known.loc[row["group"], "expected"])
        assert row["expected_unexplained"] > row["expected"]


def test_a_test_that_holds_nothing_out_has_no_predictions(bare):
    study, results, answer = bare
    adapter = adapter_for(study, results, silent, {})
    table, errors = adapter.predictions(answer.explanation.base, wide_of(answer.explanation), 1.0)
    assert table.empty and errors.empty
