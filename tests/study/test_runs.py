"""A table of runs is a model: it is compared, sampled, fitted and explained, and its errors of prediction count."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.compare import comparison_at
from calib.analyses.sensitivity import response_units
from calib.api.metamodel_figures import _computed, _figure
from calib.problem.sampling import sample
from calib.study import runs
from calib.study.runs import read_runs

SPACE = calib.ParameterSpace(
    (calib.Parameter("k", 30.0, 20.0, 40.0, "kN/m"), calib.Parameter("m", 7.0, 5.0, 9.0, "kg"))
)
TRUE = {"k": 33.0, "m": 6.2}


def computed(k, m):
    """Frequencies of two masses in a chain, Hz, and their whole mass, kg."""
    w = np.sqrt(1e3 * np.asarray(k) / np.asarray(m)) / (2 * np.pi)
    return {"f1": 0.618 * w, "f2": 1.618 * w, "mass": 2.0 * np.asarray(m)}


def table(count=60, seed=1, noise=0.0):
    points = pd.DataFrame(sample(SPACE, count, seed).points, columns=["k", "m"])
    found = points.assign(**computed(points["k"], points["m"]))
    found["f2"] += noise * np.random.default_rng(seed).standard_normal(count)
    return found


def written(folder, found, units="kN/m,kg,Hz,Hz,kg"):
    lines = found.to_csv(index=False, na_rep="").splitlines()
    (folder / "runs.csv").write_text("\n".join([lines[0], *([units] if units else []), *lines[1:]]), encoding="utf-8")
    return folder / "runs.csv"


def measured(std=0.02):
    values = computed(**TRUE)
    return {name: (float(values[name]), std) for name in ("f1", "f2", "mass")}


def study(folder, more="", limits=""):
    rows = [f"{name},{value!r},{std}" for name, (value, std) in measured().items()]
    (folder / "measured.csv").write_text("\n".join(["response,value,std", *rows]), encoding="utf-8")
    (folder / "study.toml").write_text(
        f"""title = "table"
model = "runs.csv"
model_options = {{ inputs = ["k", "m"] }}
{more}
[measurement]
responses = "measured.csv"
[calibration]
method = "gauss-newton"
{limits}
""",
        encoding="utf-8",
    )
    return folder / "study.toml"


@pytest.mark.medium
def test_a_table_predicts_what_was_computed(tmp_path):
    problem = calib.Problem.from_runs(written(tmp_path, table()), ["k", "m"], calib.ResponseTest(measured(0.005)))
    model = problem.model
    assert [(p.name, p.unit) for p in model.space] == [("k", "kN/m"), ("m", "kg")]
    found = model.function(TRUE)
    for name, value in computed(**TRUE).items():
        assert found[name] == pytest.approx(float(value), rel=1e-3)
    fit = problem.calibrate(starts=3)
    assert fit.values["k"] == pytest.approx(TRUE["k"], rel=5e-3)
    assert fit.values["m"] == pytest.approx(TRUE["m"], rel=5e-3)


@pytest.mark.medium
def test_the_error_of_prediction_is_in_every_standard_deviation(tmp_path):
    rough = read_runs(written(tmp_path, table(noise=0.5)), inputs=["k", "m"])
    error = rough.metamodels.errors["f2"]
    assert 0.3 < error < 0.8
    test = calib.ResponseTest(measured(0.02))
    problem = test.problem(rough)
    std = dict(zip(problem.targets, test.residual(problem).std, strict=True))
    assert std["f2"] == pytest.approx(np.hypot(0.02, error)) and std["mass"] == pytest.approx(0.02, abs=1e-4)
    unknown = calib.ResponseTest({"f2": 18.0}).problem(rough)
    assert unknown.compared["f2"][1] > error
    row = calib.Problem(rough, test).compare().table.set_index("response").loc["f2"]
    assert row["error_in_std"] == pytest.approx(row["error"] * row["measured"] / std["f2"])
    wide, exact = (
        calib.Problem(model, test).calibrate(starts=1).parameters["std"]["k"]
        for model in (rough, replace(rough, metamodels=None))
    )
    assert wide > 1.1 * exact
    assert any("f2" in one.value and "runs.csv" in one.item for one in rough.assumptions)


@pytest.mark.slow
def test_a_study_of_a_table_tells_the_prognosis_of_its_runs_and_fits(tmp_path):
    found = table()
    found.loc[[3, 7], ["f1", "f2", "mass"]] = np.nan
    written(tmp_path, found)
    loaded = calib.Study.load(study(tmp_path), results=tmp_path / "results")
    told = loaded.sensitivity(residuals=["f1"], surfaces=[("f2", "k", "m")]).of
    assert all((loaded.folder.path / name).stat().st_size > 0 for name in ("residuals_f1.png", "surface_f2_k_m.png"))
    stored = pd.read_csv(loaded.folder.path / "prognosis.csv")
    pd.testing.assert_frame_equal(stored, told.prognosis.table, rtol=1e-6)
    assert len(pd.read_csv(loaded.folder.path / "prognosis_inputs.csv")) == 3 * 2
    assert (told.prognosis.table["designs"] == 58).all() and told.prognosis.table["cop"].min() > 0.99
    listed = loaded.designs().table
    own = listed[listed["case"] == "runs"].set_index(["k", "m"])
    assert len(own) == len(found) and (own["status"] == "failed").sum() == 2 and listed["rank"].is_monotonic_increasing
    for row in found.dropna().to_dict("records"):  # what was computed, not what a metamodel makes of it
        assert own.loc[(row["k"], row["m"]), "f1"] == pytest.approx(row["f1"], rel=1e-12)
    assert own["objective"].min() == own["objective"].iloc[0]
    fit = loaded.calibrate()
    values = pd.read_csv(loaded.folder.path / "verdicts.csv").set_index("parameter")["value"]
    assert values["k"] == pytest.approx(TRUE["k"], rel=0.01) and len(fit.table) == 2


@pytest.mark.medium
@pytest.mark.parametrize(
    ("response", "inputs", "words"),
    [("f1", ("k", "mu"), "'mu' is no input"), ("f1", ("k", "k"), "named twice"), ("f9", None, "no response 'f9'")],
)
def test_a_metamodel_is_drawn_by_its_name(tmp_path, response, inputs, words):
    test = calib.ResponseTest(measured())
    found = calib.Problem.from_runs(written(tmp_path, table()), ["k", "m"], test).sensitivity(
        samples=30, progress=False
    )
    assert found.draw(tmp_path / "own.png", "f1", ("k", "m")).stat().st_size > 0
    assert list(found.prognosis.table["response"]) == ["f1", "f2", "mass"]
    with pytest.raises(calib.InputError, match=words):
        found.draw(tmp_path / "other.png", response, inputs)
    assert not (tmp_path / "other.png").exists()


@pytest.mark.medium
def test_another_table_is_another_model(tmp_path):
    one = read_runs(written(tmp_path, table()), inputs=["k", "m"])
    other = read_runs(written(tmp_path, table(seed=2)), inputs=["k", "m"])
    assert one.fingerprint != other.fingerprint
    again = read_runs(written(tmp_path, table()), inputs=["k", "m"])
    assert one.fingerprint == again.fingerprint


def test_beyond_the_runs_nothing_is_predicted(tmp_path):
    written(tmp_path, table())
    model = read_runs(tmp_path / "runs.csv", inputs=["k", "m"])
    with pytest.raises(calib.EvaluationError, match=r"k = 50 is outside the runs"):
        model.function({"k": 50.0, "m": 7.0})
    file = study(tmp_path, limits="[parameters.k]\nlimits = [10.0, 39.0]\n")
    with pytest.raises(calib.InputError, match=r"k = 10 is outside the runs, which go from 2\d") as fault:
        comparison_at(calib.Study.load(file).loaded, TRUE)
    assert "extrapolate" in str(fault.value) and str(file) in str(fault.value)


@pytest.mark.parametrize(
    ("change", "inputs", "words"),
    [
        (lambda t: t, ["k", "mu"], r"mu"),
        (lambda t: t, [], r"no inputs"),
        (lambda t: t[["k", "m"]], ["k", "m"], r"no outputs"),
        (
            lambda t: t.assign(f1=["bad", *t["f1"][1:]]),
            ["k", "m"],
            r"runs.csv, line 3.*column f1.*'bad'.*failed run empty",
        ),
        (lambda t: t.assign(k=[None, *t["k"][1:]]), ["k", "m"], r"runs.csv, line 3.*column k.*empty"),
        (lambda t: t.assign(m=7.0), ["k", "m"], r"column m.* 7 in every run"),
        (lambda t: t[:15], ["k", "m"], r"15 runs .*too few for 2 inputs.*20 at least"),
    ],
)
def test_what_is_no_table_of_runs_is_refused_in_one_sentence(tmp_path, change, inputs, words):
    file = written(tmp_path, change(table()), units="" if change(table()).shape[1] < 5 else "kN/m,kg,Hz,Hz,kg")
    with pytest.raises(calib.InputError) as fault:
        read_runs(file, inputs=inputs)
    assert re.search(words, str(fault.value)) and "\n" not in str(fault.value)


def test_a_column_of_words_is_no_response(tmp_path):
    found = table().assign(status=["failed", *["Succeeded"] * 59])
    assert list(read_runs(written(tmp_path, found, ""), ["k", "m"]).metamodels.values) == ["f1", "f2", "mass"]


@pytest.mark.parametrize(
    ("column", "numbers", "is_response"),
    [
        ("Design", range(1, 61), False),
        ("Design", [7, *range(11, 70)], False),  # of a larger table
        ("run_no.", range(160, 100, -1), False),
        ("anything", range(60), False),
        ("Design", [*range(59), 1], True),
        ("Design", np.linspace(1.0, 2.0, 60), True),
        ("revolutions", range(20, 80), True),
    ],
)
def test_a_column_that_numbers_the_runs_is_no_response_and_that_is_told(tmp_path, column, numbers, is_response):
    found = table()
    found.insert(0, column, list(numbers))
    file = written(tmp_path, found, f"{'-' if is_response else ''},kN/m,kg,Hz,Hz,kg")
    model = read_runs(file, ["k", "m"])
    assert (column in model.metamodels.values) == is_response
    assert any(one.item == f"column {column} of runs.csv" for one in model.assumptions) != is_response
    assert column in read_runs(file, ["k", "m"], [column, "f1"]).metamodels.values
    assert model.metamodels.units == {"f1": "Hz", "f2": "Hz", "mass": "kg", **({column: "-"} if is_response else {})}


@pytest.mark.medium
def test_axes_of_responses_have_the_unit_of_the_table(tmp_path):
    test = calib.ResponseTest(measured())
    found = calib.Problem.from_runs(written(tmp_path, table()), ["k", "m"], test).sensitivity()
    units = response_units(found.study, ["f1", "mass"])
    assert units == {"f1": "Hz", "mass": "kg"}
    runs = found.study.model.metamodels
    runs.values.loc[3] = np.nan  # a run that failed
    drawn = _figure(found.prognosis["f1"], _computed(found.study, found.samples), ("k", "m"), units)
    flat, bar, space = drawn.axes
    (dots,) = [c for c in flat.collections if c.get_gid() == "designs"]
    np.testing.assert_array_equal(dots.get_offsets(), runs.points.drop(index=3))
    assert "59 designs" in flat.get_title(loc="left")
    assert (bar.get_ylabel(), space.get_title(), flat.get_xlabel()) == ("f1, Hz", "f1, Hz", "k, kN/m")


def test_an_unknown_unit_is_refused(tmp_path):
    with pytest.raises(calib.InputError, match="unknown unit 'furlong'"):
        read_runs(written(tmp_path, table(), "furlong,kg,Hz,Hz,kg"), inputs=["k", "m"])


@pytest.mark.parametrize(
    ("options", "words"),
    [("{ }", r"inputs"), ('{ inputs = ["k"], colour = 1 }', r"colour"), (None, r"no table of runs 'runs.csv'")],
)
def test_a_study_of_a_table_names_the_line_of_what_is_wrong(tmp_path, options, words):
    file = study(tmp_path)
    if options is not None:
        written(tmp_path, table())
        file.write_text(file.read_text("utf-8").replace('{ inputs = ["k", "m"] }', options), encoding="utf-8")
    with pytest.raises(calib.InputError, match=words) as fault:
        comparison_at(calib.Study.load(file).loaded, TRUE)
    assert str(file) in str(fault.value)


@pytest.mark.medium
def test_other_metamodels_of_the_same_runs_are_another_model(tmp_path, monkeypatch):
    """Which are chosen depends on what is installed: points that others predicted are not found again."""
    path, before = written(tmp_path, table()), runs.prognosis
    one = read_runs(path, ["k", "m"])

    def other(*given):
        found = before(*given)
        first, *rest = found.models
        return replace(found, models=(replace(first, kind="another kind"), *rest))

    monkeypatch.setattr(runs, "prognosis", other)
    assert read_runs(path, ["k", "m"]).fingerprint != one.fingerprint


# -- one row for every run and response --------------------------------------------------------------------------------


def long_table(found, run=True):
    """The same runs, a row for each response; the second run has failed, the third has no mass."""
    rows = ["run,k,m,response,value" if run else "k,m,response,value", ",kN/m,kg,," if run else "kN/m,kg,,"]
    for k, row in enumerate(found.to_dict("records")):
        head = f"R{k},{row['k']!r},{row['m']!r}" if run else f"{row['k']!r},{row['m']!r}"
        if k == 1:
            rows.append(f"{head},,")
            continue
        rows += [
            f"{head},{name},{'' if (k, name) == (2, 'mass') else repr(row[name])}" for name in ("f1", "f2", "mass")
        ]
    return "\n".join(rows)


@pytest.mark.parametrize("run", [True, False])
def test_a_long_table_is_the_wide_one(tmp_path, run):
    found = table(count=30)
    wide = found.copy()
    wide.loc[1, ["f1", "f2", "mass"]] = np.nan
    wide.loc[2, "mass"] = np.nan
    (tmp_path / "long.csv").write_text(long_table(found, run), encoding="utf-8")
    mine, own = read_runs(tmp_path / "long.csv", ["k", "m"]), read_runs(written(tmp_path, wide), ["k", "m"])
    pd.testing.assert_frame_equal(mine.metamodels.prognosis.table, own.metamodels.prognosis.table)
    assert [(p.name, p.unit, p.lower) for p in mine.space] == [(p.name, p.unit, p.lower) for p in own.space]
    assert mine.function(TRUE) == own.function(TRUE)
    some = read_runs(tmp_path / "long.csv", ["k", "m"], outputs=["f2"])
    assert list(some.function(TRUE)) == ["f2"]


def test_contradictions_of_a_long_table_are_refused_with_their_line(tmp_path):
    lines = long_table(table(count=25)).splitlines()
    for line, words in (
        ("R0,31.0,7.0,f3,1.0", "column k: run R0 has 31 here"),
        (lines[2], "run R0 has f1 twice"),
    ):
        (tmp_path / "long.csv").write_text("\n".join([*lines, line]), encoding="utf-8")
        with pytest.raises(calib.InputError, match=words):
            read_runs(tmp_path / "long.csv", ["k", "m"])
    (tmp_path / "long.csv").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(calib.InputError, match=r"no response 'f9'.*f1, f2, mass"):
        read_runs(tmp_path / "long.csv", ["k", "m"], outputs=["f9"])
