"""A study whose function returns modes: child process, stored modes, and the same analyses as for matrices."""

import os
from collections import Counter
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.calibrate import calibrate
from calib.analyses.compare import compare
from calib.analyses.explain import explain
from calib.analyses.provenance.isolation import isolated
from calib.analyses.provenance.places import open_evaluator
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.stored import with_stored_modes
from calib.analyses.reduction import fingerprints
from calib.analyses.sensitivity import sensitivity
from calib.analyses.uncertain import mesh_changes
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import WORKER_DIED
from calib.report.figures import Figures
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy
from tests.api.cantilever import ADOPTED, FEW, write_study

PROP = 2500.0
FREE = tuple(ADOPTED)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    home = tmp_path_factory.mktemp("studies")
    return {kind: write_study(home / kind, home / "calls", kind, PROP) for kind in ("function", "matrices")}


@pytest.fixture
def own(tmp_path):
    """A study of the function, and its logged calls."""
    folder = write_study(tmp_path / "study", tmp_path / "calls", "function", PROP)
    return folder, lambda: Counter((tmp_path / "calls").read_text().splitlines())


@pytest.fixture
def few(tmp_path):
    """The same with two parameters."""
    folder = write_study(tmp_path / "study", tmp_path / "calls", "function", PROP, FEW)
    return folder, lambda: Counter((tmp_path / "calls").read_text().splitlines())


def edit(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.fixture(scope="module")
def fitted(folders):
    """Calibrations by least squares."""
    found = {}
    for kind, folder in folders.items():
        study = LoadedStudy.load(folder)
        results = Results.at(folder / "results", study.name)
        with Ledger.open(folder / "ledger.sqlite") as ledger:
            found[kind] = calibrate(study, results, ledger), results.path
    return found


@pytest.mark.medium
def test_the_study_is_compared_and_fitted_as_with_matrices(fitted):
    (mine, here), (theirs, there) = fitted["function"], fitted["matrices"]
    for table in ("comparison_before", "where_it_fails_before", "mac_before", "shapes_before"):
        one, other = (pd.read_csv(path / f"{table}.csv") for path in (here, there))
        pd.testing.assert_frame_equal(one, other, rtol=1e-4, atol=1e-6)
    std = theirs.parameters.set_index("parameter")["std"]
    values, wanted = (c.best.statistics.values for c in (mine, theirs))
    for name in FREE:
        assert values[name] == pytest.approx(wanted[name], abs=1e-2 * std[name])
        assert mine.parameters.set_index("parameter")["std"][name] == pytest.approx(std[name], rel=1e-2)
    pd.testing.assert_frame_equal(mine.errors, theirs.errors, rtol=1e-2)
    assert list(mine.modes["mode"]) == list(theirs.modes["mode"]) and "m8" in list(mine.modes["mode"])


@pytest.mark.slow
def test_the_explanation_is_that_of_the_matrices_and_evaluates_no_point_twice(own, folders, tmp_path):
    folder, calls = own
    studies = {"function": isolated(LoadedStudy.load(folder)), "matrices": LoadedStudy.load(folders["matrices"])}
    own, theirs = (explain(study, Results.at(tmp_path / kind, study.name)) for kind, study in studies.items())
    assert set(calls().values()) == {1} and len(calls()) > 100
    assert own.verdict == theirs.verdict == "effect"
    assert own.explanation.credible == theirs.explanation.credible == ("prop",)
    mine, other = (e.effects.set_index("name") for e in (own, theirs))
    for column in ("magnitude", "magnitude_low", "magnitude_high", "ln_bayes"):
        assert mine.loc["prop", column] == pytest.approx(other.loc["prop", column], rel=1e-2)
    assert mine.loc["prop", "magnitude_low"] < PROP < mine.loc["prop", "magnitude_high"]
    assert {"sensor_misfit", "mesh_points"} <= set(own.tables)


@pytest.mark.slow
def test_no_point_is_solved_twice_and_a_second_run_solves_none(few, tmp_path):
    folder, calls = few
    study = LoadedStudy.load(folder)
    tables, counted = [], []
    for _ in range(2):
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            tables.append(calibrate(study, Results.at(tmp_path / "results", study.name), ledger).parameters)
            kept = ledger.count(study.problem.ledger_key)
        counted.append(calls())
        study = LoadedStudy.load(folder)
    assert tables[0].equals(tables[1])
    first, second = counted
    # The reproducibility check evaluates again: first the nominal values, then one stored point.
    assert sorted(first.values())[-2:] == [1, 2] and len(first) == kept > 20
    assert sum((second - first).values()) == 1


@pytest.mark.slow
def test_an_explanation_behind_the_ledger_reuses_the_points_of_a_calibration(few, tmp_path):
    folder, calls = few
    found, counted = [], []
    for ask in ("calibrate", "explain", "explain"):
        study, results = LoadedStudy.load(folder), Results.at(tmp_path / "results", "study")
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            if ask == "calibrate":
                calibrate(study, results, ledger)
            else:
                with with_stored_modes(study, lambda: nullcontext(ledger)) as asked:
                    found.append(explain(asked, results).effects)
            assert ledger.other_fingerprints(*fingerprints(study, results)) == 0
        counted.append(calls())
    fit, first, second = counted
    assert found[0].equals(found[1])
    # Only one stored point is evaluated again, on purpose; the nominal values are among the stored ones.
    assert sum((second - first).values()) == 1
    assert sum((first - fit)[point] for point in fit) == 1 and len(first) > len(fit)


@pytest.mark.slow
def test_a_search_stores_modes_that_least_squares_reuse(few, tmp_path):
    folder, calls = few
    study = LoadedStudy.load(folder)
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        found = calibrate(study, Results.at(tmp_path / "results", study.name), ledger, method="genetic")
        assert ledger.count(study.problem.ledger_key) == len(calls())
    assert found.best.statistics.misfit < 2e4
    twice = [point for point, count in calls().items() if count > 1]
    assert len(twice) <= 2  # evaluated again on purpose: the nominal values and the best point of the search


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_samples(few, tmp_path):
    folder, _ = few
    tables = []
    for workers in (1, 2):
        study = LoadedStudy.load(folder)
        with Ledger.open(tmp_path / f"ledger_{workers}.sqlite") as ledger:
            results = Results.at(tmp_path / f"results_{workers}", study.name)
            sensitivity(study, results, ledger, workers, quick=True)
        tables.append(pd.read_csv(results.path / "sensitivity_samples.csv"))
    assert tables[0].equals(tables[1]) and tables[0].notna().all(axis=None)


# -- child process -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_its_results_in_another_process_are_those_in_this_one(own, tmp_path):
    """The function fails where the tip is heavy, and tells in which process."""
    folder, _ = own
    told = (
        "if v['m_tip'] > 3.0: import os; raise RuntimeError(f'process {os.getpid()}')\n    return cantilever.bends(v)"
    )
    edit(folder / "model.py", "return cantilever.bends(v)", told)
    here = LoadedStudy.load(folder)
    there = isolated(here)
    point = {**ADOPTED, "m_tip": 2.0}
    one, other = (s.problem.compare(point) for s in (here, there))
    assert np.array_equal(one.modes.shapes, other.modes.shapes) and one.comparison_table().equals(
        other.comparison_table()
    )
    assert there.problem.fingerprint == here.problem.fingerprint
    with pytest.raises(EvaluationError) as fault:
        there.problem.compare({**ADOPTED, "m_tip": 3.5})
    assert "process" in str(fault.value) and f"process {os.getpid()}" not in str(fault.value)


@pytest.mark.slow
def test_a_point_that_ends_the_process_is_a_failed_row(own, tmp_path):
    folder, _ = own
    edit(
        folder / "model.py",
        "return cantilever.bends(v)",
        "if v['m_tip'] > 1.5: import os; os._exit(1)\n    return cantilever.bends(v)",
    )
    study = isolated(LoadedStudy.load(folder))
    points = [{**study.model.space.values, "m_tip": m} for m in (1.0, 2.0)]
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        with open_evaluator(recorded(study, ledger), 1, 2) as evaluator:
            good, bad = evaluator.evaluate(points)
        assert len(ledger.failed(study.problem.ledger_key)) == 1
    assert good.status == "ok" and good.responses["mac_m1"] > 0.9
    assert bad.status == "failed" and bad.error == WORKER_DIED


@pytest.mark.slow
def test_a_function_that_fails_at_the_nominal_values_is_reported_without_a_traceback(own, tmp_path):
    folder, _ = own
    edit(folder / "model.py", "return cantilever.bends(v)", "return {'natural_freq': [2.0, 1.0]}")
    study = isolated(LoadedStudy.load(folder))
    with pytest.raises(InputError) as fault:
        compare(study, Results.at(tmp_path / "results", study.name))
    assert "shapes" in str(fault.value) and "\n" not in str(fault.value)


def test_a_nondeterministic_function_is_refused(own, tmp_path):
    folder, _ = own
    edit(
        folder / "model.py", "return cantilever.bends(v)",
        "import random; v['m_tip'] *= 1 + 0.01 * random.random()\n    return cantilever.bends(v)",
    )  # fmt: skip
    study = LoadedStudy.load(folder)
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger, pytest.raises(InputError, match="deterministic"):
        calibrate(study, Results.at(tmp_path / "results", study.name), ledger)


# -- fingerprints ------------------------------------------------------------------------------------------------------


def test_changed_code_is_another_model_and_a_changed_pairing_is_not(own):
    folder, _ = own
    first = LoadedStudy.load(folder)
    edit(folder / "study.toml", "mode_count = 14", "mode_count = 13")
    paired = LoadedStudy.load(folder)
    edit(folder / "cantilever.py", "LENGTH, LINE, ELEMENTS, PROP_AT = 2.0", "LENGTH, LINE, ELEMENTS, PROP_AT = 2.1")
    longer = LoadedStudy.load(folder)
    assert paired.problem.ledger_key == first.problem.ledger_key != longer.problem.ledger_key
    assert paired.problem.fingerprint != first.problem.fingerprint


def test_models_of_matrices_have_no_user_function(folders):
    study = LoadedStudy.load(folders["matrices"])
    assert study.problem.user_function is None and isolated(study) is study


# -- what needs matrices -----------------------------------------------------------------------------------------------


def test_clusters_are_refused(own):
    folder, _ = own
    edit(folder / "study.toml", "mode_count = 14", "mode_count = 14\nclusters = { m1 = ['y'] }")
    with pytest.raises(InputError, match="cluster"):
        LoadedStudy.load(folder)


def test_a_finer_mesh_changes_the_rows_of_a_calibration(own):
    """Here it is the same function: no row changes."""
    folder, _ = own
    edit(folder / "study.toml", "[sensitivity]", "[explain]\nfiner_options = { elements = 16 }\n[sensitivity]")
    edit(folder / "model.py", "def function():", "def function(elements=8):")
    study = LoadedStudy.load(folder)
    assert study.finer_model() is None and isinstance(study.on_finer_mesh(), calib.ModalFunctionModel)
    change = mesh_changes(study, study.model.space.values)
    assert change.shape == (len(study.pair.rows), 1) and np.abs(change).max() < 1e-9


def test_more_modes_than_the_function_gives_are_refused(own, tmp_path):
    folder, _ = own
    edit(folder / "study.toml", "mode_count = 14", "mode_count = 15")
    with pytest.raises(InputError, match="14"):
        compare(LoadedStudy.load(folder), Results.at(tmp_path / "results", "study"))


def test_responses_cannot_be_compared_with_modes(own):
    folder, _ = own
    text = (folder / "study.toml").read_text()
    head, _, rest = text.partition("[measurement]")
    (folder / "study.toml").write_text(
        head + '[measurement]\nresponses = "r.csv"\n[held_out]' + rest.partition("[held_out]")[2]
    )
    (folder / "r.csv").write_text("response,value\na,1\n")
    with pytest.raises(InputError, match="modes"):
        LoadedStudy.load(folder)


@pytest.mark.slow
def test_without_locations_the_model_is_not_drawn(own, tmp_path):
    folder, _ = own
    edit(folder / "study.toml", 'sensors = "sensors.csv"\n', "")
    edit(folder / "model.py", "model.sensors,", "[s.name for s in model.sensors],")
    study, results = LoadedStudy.load(folder), Results.at(tmp_path / "results", "study")
    answer = compare(study, results)
    assert len(answer.hints) == 1 and answer.mean_mac > 0.9
    assert not (results.path / "mesh_points.csv").exists() and (results.path / "mac_before.csv").exists()
    assert {"comparison.png", "mac_before.png"} <= {p.name for p in Figures(results.path, "cantilever", True).save()}


@pytest.mark.slow
def test_with_locations_the_motion_of_its_sensors_is_drawn(own, tmp_path):
    folder, _ = own
    study, results = LoadedStudy.load(folder), Results.at(tmp_path / "results", "study")
    found = compare(study, results).comparison
    assert len(pd.read_csv(results.path / "mesh_points.csv")) == 4
    moved = pd.read_csv(results.path / "deflection_before.csv")
    first = moved[moved["mode"] == "m1"][["v", "w"]].to_numpy()
    aligned = found.aligned_shapes[:, 0].real
    np.testing.assert_allclose(first, aligned.reshape(4, 2), rtol=2e-5, atol=1e-12)
