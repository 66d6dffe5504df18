"""A study with several tests: read, compared, fitted and explained together; bad input is refused."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest

import calib
from calib.api import steps
from calib.api.figures import first_test_first
from calib.command import cli
from calib.errors.errors import InputError
from calib.report.figures import Figures
from calib.report.numbers import fixed
from calib.results.results import Results
from calib.study.several import JointStudy, load
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile
from calib.study.study_text import read_settings
from tests.api import cantilever
from tests.study.conftest import GROUND, STIFF, STUDY, told, write_study

BENCH = '\n[[tests]]\nname = "bench"\nmodel = "model.py:bench"\nresponses = "bench.csv"\n'


def edit(folder, old, new):
    file = folder / "study.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    return folder


# -- the whole run -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_run_names_what_is_missing_and_adds_it(frame):
    _, results = frame
    found = told(results / "frame/explanation.json")
    assert found["verdict"] == "effect" and found["credible_set"] == ["contact_3"]
    after = pd.read_csv(results / "frame_extended/verdicts.csv").set_index("parameter")
    for name, true in (("contact_3", GROUND), ("k", 1.06 * STIFF)):
        assert abs(after.loc[name, "value"] - true) < 4 * after.loc[name, "std"] < 0.05 * true
    assert told(results / "frame_extended/summary.json")["p_fit"] > 0.01 > told(results / "frame/summary.json")["p_fit"]


@pytest.mark.slow
def test_each_test_has_its_own_results_and_the_parameters_of_all(frame):
    _, results = frame
    tables = {t: pd.read_csv(results / f"frame.{t}/parameters.csv") for t in ("empty", "loaded")}
    pd.testing.assert_frame_equal(tables["empty"], tables["loaded"])
    pd.testing.assert_frame_equal(tables["empty"], pd.read_csv(results / "frame/parameters.csv"))
    modes = {t: pd.read_csv(results / f"frame.{t}/comparison_after.csv") for t in tables}
    assert list(modes["loaded"]["mode"]) == ["M1", "M2", "M3", "M4", "M6"] and len(modes["empty"]) == 6
    assert modes["loaded"]["natural_freq_model"].iloc[0] < 0.95 * modes["empty"]["natural_freq_model"].iloc[0]
    errors = pd.read_csv(results / "frame/data_errors.csv")
    assert set(errors["test"]) == {"empty", "loaded"}
    assert set(errors.loc[errors["group"].str.startswith("held_out"), "test"]) == {"loaded"}
    for test in tables:
        own = told(results / f"frame.{test}/explanation.json")
        assert own["verdict"] == "effect"


@pytest.mark.slow
def test_the_pattern_of_the_effect_is_given_by_test(frame):
    _, results = frame
    for test, modes in (("empty", 6), ("loaded", 5)):
        table = pd.read_csv(results / f"frame.{test}/why.csv", keep_default_na=False)
        assert set(table["effect"]) == {"contact_3"} and "test" not in table and "prior" not in set(table["kind"])
        assert set(table["mode"]) <= {f"M{k}" for k in range(1, 7)} and table["mode"].nunique() == modes
        assert (table["residual"] ** 2).sum() > 2 * (table["left"] ** 2).sum()
        assert "why_this_effect" in Figures(results / f"frame.{test}", "", True).plan
    assert "why_this_effect" not in Figures(results / "frame", "", True).plan


OF_ALL = {"parameters", "ranked_effects", "confounding", "errors_before_after"}
"""Figures of what all tests say together."""


@pytest.mark.slow
def test_a_calibration_draws_each_test_by_itself_and_all_together(own, monkeypatch, tmp_path):
    drawn, results = {}, tmp_path / "results"

    def planned(figures, *given):
        drawn[str(figures.folder.folder.relative_to(results))] = set(figures.plan)
        return []

    monkeypatch.setattr(Figures, "save", planned)
    asked = ["calibrate", str(own), "--case", "C1", "--workers", "1", "--results", str(results)]
    assert cli.execute(asked) == 0
    assert list(drawn) == [f"frame{end}/case_C1" for end in (".loaded", ".empty", "")]  # what is drawn last leads
    assert drawn["frame/case_C1"] == {"parameters"}
    assert (
        drawn["frame.empty/case_C1"] == drawn["frame.loaded/case_C1"] > {"parameters", "model", "modes", "comparison"}
    )


@pytest.mark.slow
def test_the_run_draws_each_test_by_itself_and_all_together(run, unrendered, tmp_path):
    study, results, drawn, reported = run
    table = pd.read_csv(results / "frame/reduction_by_test.csv").set_index("test")
    first = table["share"].idxmax()
    order = [*[f".{test}" for test in table.index if test != first][::-1], f".{first}", ""]
    extended = ["frame_extended.loaded", "frame_extended.empty", "frame_extended"]
    assert drawn == extended + [f"frame{end}" for end in order]
    assert table["shown_first"].tolist() == [test == first for test in table.index]
    assert first_test_first(StudyFile.read(study).parts, Results(results / "frame"))[0].test == first
    assert reported == ["frame_extended", "frame"]
    together = shutil.copytree(results / "frame", tmp_path / "frame")
    assert {path.stem for path in Figures(together, "together", True).save()} >= OF_ALL


@pytest.mark.slow
def test_report_draws_what_every_folder_holds(frame, tmp_path):
    study, results = shutil.copytree(frame[0], tmp_path / "frame"), shutil.copytree(frame[1], tmp_path / "results")
    shutil.rmtree(results / "frame/frame_extended")
    assert not [*results.rglob("*.png")]
    assert cli.execute(["report", str(study), "--results", str(results)]) == 0
    names = {end: {png.stem for png in results.glob(f"frame{end}/*.png")} for end in ("", ".empty", ".loaded")}
    assert names[""] >= OF_ALL
    assert [path.parent.name for path in results.rglob("report.html")] == ["frame"]
    _check_page((results / "frame/report.html").read_text(), told(results / "frame/explanation.json"))
    of_one = {"model", "mode_shapes_before", "mode_shapes_after", "modes", "selection", "sensor_misfit", "added_errors"}
    assert names[".empty"] == names[".loaded"] >= of_one | {"ranked_effects"}


def _check_page(text, explained):
    """One page: parameters once, the errors of all tests at its head, a section for each test."""
    head = text[: text.index("<section")]
    for group in ("held_out_modes", "held_out_sensors"):
        before, after = (fixed(explained["errors"][group][stage], 2) for stage in ("before", "after"))
        assert f"{before} → {after} σ" in head
    assert text.count("<caption>Identifiability of the parameters</caption>") == 1
    names = re.findall(r'<section id="([^"]+)"', text)
    assert [name for name in names if name.startswith("test")] == ["test1-test", "test2-test"]
    assert len(ids := re.findall(r' id="([^"]+)"', text)) == len(set(ids))


@pytest.mark.slow
def test_the_decrease_of_each_test_is_that_of_the_joint_fits(frame):
    _, results = frame
    table = pd.read_csv(results / "frame/reduction_by_test.csv").set_index("test")
    fits = pd.read_csv(results / "frame/candidate_fits.csv").set_index("effects")["misfit"]
    whole = fits["none"] - fits["contact_3"]
    np.testing.assert_allclose(table["share"], (table["before"] - table["after"]) / whole, rtol=1e-6)
    for test in table.index:
        own = pd.read_csv(results / f"frame.{test}/reduction_by_test.csv")
        assert list(own.columns) == [c for c in table.reset_index().columns if c != "test"]
        assert own[["before", "after"]].to_numpy().tolist() == [table.loc[test, ["before", "after"]].tolist()]
        errors = pd.read_csv(results / f"frame.{test}/errors.csv").set_index(["group", "stage"])
        for stage in ("before", "after"):
            fit = errors.loc[("fit", stage)]
            assert table.loc[test, stage] == pytest.approx(fit["rows"] * fit["rms"] ** 2, rel=1e-6)


@pytest.mark.slow
def test_errors_of_a_test_are_its_share_of_the_errors_of_all(frame):
    _, results = frame
    whole = pd.read_csv(results / "frame/errors.csv").set_index(["group", "stage"])
    own = {t: pd.read_csv(results / f"frame.{t}/errors.csv").set_index(["group", "stage"]) for t in ("empty", "loaded")}
    for stage in ("before", "after"):
        parts = [table.loc["fit", stage] for table in own.values()]
        assert whole.loc[("fit", stage), "rows"] == sum(part["rows"] for part in parts)
        squares = sum(part["rows"] * part["rms"] ** 2 for part in parts)
        assert whole.loc[("fit", stage), "rms"] ** 2 * whole.loc[("fit", stage), "rows"] == pytest.approx(squares)


@pytest.mark.slow
def test_nothing_is_solved_twice_and_the_result_stays(frame, undrawn, tmp_path):
    study, results = frame
    again = shutil.copytree(results, tmp_path / "results")
    before = (again / "frame/parameters.csv").read_bytes()
    answer = calib.Study.load(study, again, workers=1).calibrate()
    counts = [case.result.solved for case in answer.of.tests["empty"].cases]
    # Residuals and derivatives are in the ledger; the frequencies of all modes, which are predicted, are solved once.
    assert max(counts) <= 2 and (again / "frame/parameters.csv").read_bytes() == before


@pytest.mark.slow
def test_a_result_is_outdated_where_another_test_has_changed(frame, tmp_path):
    study, results = frame
    own = shutil.copytree(study, tmp_path / "frame")
    again = shutil.copytree(results, tmp_path / "results")
    (again / "frame/owner.json").unlink()
    for test in ("empty", "loaded"):
        (again / f"frame.{test}/owner.json").unlink()
    edit(own, "load = 1500.0", "load = 1400.0")
    from calib.analyses.provenance.stale import stale_answers

    empty = next(part for part in StudyFile.read(own).parts if part.test == "empty")
    stale = stale_answers(empty, Results(again / "frame.empty"))
    assert "calibrate" in stale.sentences and "compare" not in stale.sentences
    assert "calibrate" in stale_answers(StudyFile.read(own), Results(again / "frame")).sentences


@pytest.mark.slow
def test_the_problem_of_a_study_is_the_one_it_fits(frame):
    study, results = frame
    fit = calib.Study.load(study, results).problem.calibrate(starts=1)
    stored = pd.read_csv(results / "frame/verdicts.csv").set_index("parameter")
    assert fit.values["k"] == pytest.approx(stored.loc["k", "value"], rel=1e-6)
    assert fit.parameters["std"]["k"] == pytest.approx(stored.loc["k", "std"], rel=1e-3)


@pytest.mark.slow
def test_the_record_of_all_tests_has_the_rows_of_each(frame):
    _, results = frame
    record = told(results / "frame/record.json")
    assert record["tests"] == ["empty", "loaded"]
    assert record["files"] == ["empty.csv", "empty_shapes.csv", "loaded.csv", "loaded_shapes.csv"]
    assert {"calibrate", "explain"} <= set(record["analyses"])
    for table in ("measured", "sensors", "assumptions"):
        whole = pd.read_csv(results / f"frame/{table}.csv")
        for test, own in whole.groupby("test"):
            part = pd.read_csv(results / f"frame.{test}/{table}.csv")
            pd.testing.assert_frame_equal(own.drop(columns="test").reset_index(drop=True), part, check_dtype=False)
    assert told(results / "frame.loaded/record.json")["tests"] == ["loaded"]


@pytest.mark.slow
def test_functions_of_modes_in_several_tests_evaluate_no_point_again(functions_in_this_process, tmp_path):
    folder = cantilever.write_study(tmp_path / "study", tmp_path / "calls", prop=2500.0, selected=cantilever.FEW)
    text = (folder / "study.toml").read_text()
    given = text[text.index("[measurement]") : text.index("[sensitivity]")]
    one = given.replace("[held_out]", "[tests.held_out]").replace("[pairing]", "[tests.pairing]")
    tests = (one.replace("[measurement]", f'[[tests]]\nname = "{name}"') for name in ("first", "second"))
    (folder / "study.toml").write_text(text.replace(given, "\n".join(tests)))
    effects, counted = [], []
    for _ in range(2):
        effects.append(steps.explain_step(calib.Study.load(folder, tmp_path / "results")).effects)
        counted.append(len((tmp_path / "calls").read_text().splitlines()))
    pd.testing.assert_frame_equal(*effects)
    assert counted[0] > 40 and counted[1] - counted[0] <= 2  # one stored point a test, on purpose


# -- what is read ------------------------------------------------------------------------------------------------------


def test_conditions_hold_for_their_test(own):
    study = load(own)
    assert isinstance(study, JointStudy) and study.search_space.names == ("k",)
    assert [one.model.space["load"].value for one in study.studies] == [0.0, 1500.0]
    assert all(one.model.space["load"].distribution == "fixed" for one in study.studies)
    assert [one.name for one in study.studies] == ["frame.empty", "frame.loaded"]


def test_a_condition_outside_the_limits_is_refused_at_its_line(own):
    line = STUDY[: STUDY.index("load = 1500.0")].count("\n") + 1
    with pytest.raises(InputError, match=rf"study\.toml, line {line}: load = 1e\+09 kg is outside its limits 0 to "):
        load(edit(own, "load = 1500.0", "load = 1e9"))


def test_one_test_is_a_study_as_ever(own):
    text = STUDY[: STUDY.index('[[tests]]\nname = "loaded"')] + STUDY[STUDY.index("[sensitivity]") :]
    (own / "study.toml").write_text(text)
    one = load(own)
    assert (
        isinstance(one, LoadedStudy)
        and one.name == "frame"
        and one.test == ""
        and one.settings.title == "A frame, empty and loaded"
    )
    plain = text.replace('[[tests]]\nname = "empty"\nset = { load = 0.0 }\n', "[measurement]\n")
    (own / "study.toml").write_text(plain)
    assert LoadedStudy.load(own).measured.fingerprint == one.measured.fingerprint


@pytest.mark.slow
def test_another_model_is_fitted_beside(own, undrawn, tmp_path):
    (own / "study.toml").write_text(
        STUDY.replace("starts = 2", "starts = 1").replace("[sensitivity]", f"{BENCH}\n[sensitivity]")
    )
    answer = calib.Study.load(own, tmp_path / "results", workers=1).calibrate("C1")
    assert set(answer.of.tests) == {"empty", "loaded", "bench"}
    for folder in (answer.folder, tmp_path / "results/frame.bench/case_C1"):
        assert told(folder / "record.json")["analyses"]["calibrate"]["options"] == ["--case", "C1"]
    found = calib.Study.load(own, tmp_path / "results", workers=1).explain()
    assert found.of.verdict == "effect" and list(found.of.explanation.credible) == ["contact_3"]
    assert any("in test bench" in name for name in found.of.explanation.base_adequacy.perturbations.owners)


@pytest.mark.medium
def test_a_study_that_builds_on_another_takes_what_it_does_not_say(own):
    other = own.parent / "other"
    other.mkdir()
    (other / "study.toml").write_text('base = "../frame"\ntitle = "without starts"\n\n[calibration]\nstarts = 1\n')
    given, base = read_settings(other / "study.toml"), read_settings(own / "study.toml")
    assert given.calibration.starts == 1 and given.calibration.cases == base.calibration.cases
    assert given.title == "without starts" and given.model == "../frame/model.py:frame"
    assert [t.files for t in given.tests] == [("../frame/empty.csv",), ("../frame/loaded.csv",)]
    study = load(other)
    assert study.studies[0].measured.fingerprint == load(own).studies[0].measured.fingerprint
    assert own.resolve() / "study.toml" in study.inputs


def test_selection_and_cases_are_needed_by_no_study(own):
    text = STUDY.replace('selection = ["k"]\n', "")
    text = text[: text.index("[calibration]")]
    (own / "study.toml").write_text(text)
    study = load(own)
    assert study.search_space.free_names == ("k",)
    assert [case.name for case in study.settings.calibration.cases] == ["C1"]


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('name = "loaded"', 'name = "empty"', None),
        ("load = 1500.0", "weight = 1500.0", "weight"),
        ('selection = ["k"]', 'selection = ["k", "load"]', "selection"),
        ('selection = ["k"]', 'selection = ["q"]', "selection"),
        ('modes = ["M5"]', 'modes = ["M9"]', "held_out"),
        ('files = ["loaded.csv"]', 'files = ["nowhere.csv"]', "nowhere.csv"),
        ("[sensitivity]", "[held_out]\nmodes = ['M1']\n\n[sensitivity]", None),
        ("[sensitivity]", "[measurement]\nfiles = ['empty.csv']\n\n[sensitivity]", None),
        ("[sensitivity]", "[parameters]\nk9 = { value = 1.0 }\n\n[sensitivity]", "k9"),
        ("title", 'base = "../frame"\ntitle', "base"),
        ("title", 'base = "../gone"\ntitle', "base"),
        ('selection = ["k"]', 'extended_from = "../gone"', "extended_from"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(own, capsys, old, new, key, one_sentence):
    edit(own, old, new)
    assert cli.execute(["calibrate", str(own), "--results", str(own.parent / "results"), "--workers", "1"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "Traceback" not in said
    if key is not None:
        lines = (own / "study.toml").read_text().splitlines()
        assert f"study.toml, line {1 + next(k for k, line in enumerate(lines) if key in line)}\n" in said


def test_a_study_of_several_tests_is_none_of_one(own):
    with pytest.raises(InputError):
        LoadedStudy.load(own)
    with pytest.raises(InputError):
        LoadedStudy.load(own, test="none")


def test_values_are_not_adopted_from_several_tests(own, tmp_path, capsys):
    later = write_study(tmp_path / "later", STUDY + '\n[adopted]\nstudy = "../frame"\nparameters = ["k"]\n')
    edit(later, 'selection = ["k"]\n', "")
    assert cli.execute(["compare", str(later), "--results", str(tmp_path / "results")]) == 2
    assert "several" in capsys.readouterr().err
