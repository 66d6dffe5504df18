"""The command as a user meets it: exit codes, sentences, files."""

import json
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.command.example import write_example
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
COMPARISON = [
    "mode", "model_mode", "natural_freq_measured", "natural_freq_model", "damped_freq_measured", "damped_freq_model",
    "freq_error", "damping_ratio_measured", "damping_ratio_model", "mac", "emac", "margin",
]  # fmt: skip
PARAMETERS = [
    "case", "parameter", "value", "unit", "lower", "upper", "scale", "ratio", "on_limit", "spread", "stable", "std",
    "low", "high", "identified", "search_value", "search_on_limit", "std_from",
]  # fmt: skip
SUMMARY = {
    "study", "synthetic", "best_case", "mean_freq_error_before", "mean_freq_error_after", "mean_mac_before",
    "mean_mac_after", "evaluations", "solved", "reused", "infeasible", "failed", "seconds", "cases",
}  # fmt: skip

GENERATIONS = 4

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


def test_the_schema_is_printed_as_json(capsys):
    assert cli.execute(["schema"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {tuple(one["required"]) for one in told["anyOf"]} == {("title", "model"), ("base",)}
    assert {"measurement", "tests", "selection", "calibration"} <= set(told["properties"])


def small_mast(folder: Path) -> Path:
    """The example study, small."""
    file = folder / "mast/study.toml"
    assert cli.execute(["new", str(file.parent)]) == 0
    text = file.read_text()
    file.write_text(
        text.replace("generations = 60", f"generations = {GENERATIONS}").replace("samples = 200", "samples = 20")
    )
    return file.parent


@pytest.fixture
def mast(here):
    return small_mast(Path())


@pytest.fixture(scope="module")
def whole(asked, tmp_path_factory):
    """A folder with a whole run of the example, and its output."""
    folder = tmp_path_factory.mktemp("whole")
    small_mast(folder)
    return folder, asked(folder, "run", "mast", "--workers", "1", "-v")


@pytest.fixture
def answered(whole, here):
    """The same in the current directory, which may be changed."""
    shutil.copytree(whole[0], here, dirs_exist_ok=True)
    return Path("mast")


def read(folder: str, name: str) -> pd.DataFrame:
    return pd.read_csv(Path(folder) / name)


def test_run_does_every_analysis_and_writes_the_documented_files(whole):
    folder, out = whole[0] / "results/mast", whole[1]
    for stage in ("before", "after"):
        assert list(read(folder, f"comparison_{stage}.csv")) == COMPARISON
    assert list(read(folder, "parameters.csv")) == PARAMETERS
    assert read(folder, "sensitivity.csv").columns[0] == "parameter"
    assert read(folder, "mac_before.csv").columns[0] == "mode" and len(read(folder, "mac_before.csv").columns) == 1 + 6
    summary = json.loads((folder / "summary.json").read_text())
    assert summary.keys() >= SUMMARY
    assert summary["synthetic"] and summary["study"] == "mast"
    assert set(summary["cases"]) == {"A1", "A2"}
    assert summary["evaluations"] == sum(case["evaluations"] for case in summary["cases"].values()) > 0
    assert summary["evaluations"] == sum(summary[k] for k in ("solved", "reused", "infeasible", "failed"))
    for case in summary["cases"].values():
        assert case.keys() >= SUMMARY - {"study", "synthetic", "best_case", "cases"}
    figures = [
        "comparison",
        "mac_before",
        "mac_after",
        "comac",
        "model",
        "model_modes_before",
        "model_modes_after",
        "mode_shapes_after",
        "modes",
        "sensitivity",
        "parameters",
    ]
    for name in figures:
        assert (folder / f"{name}.png").is_file()
        assert f"{name}.png" in out
    assert "synthetic" in out
    assert not (folder / "convergence.png").exists()  # its starts agree, so that nothing was searched
    # It has no library of effects: nothing is explained, nothing added.
    assert ": explain" not in out and ": extend" not in out
    assert not (folder / "explanation.json").exists() and not (folder / "added.json").exists()
    assert summary["mean_freq_error_after"] < 0.5 * summary["mean_freq_error_before"]
    after = read(folder, "comparison_after.csv")
    assert after["freq_error"].abs().mean() == pytest.approx(summary["mean_freq_error_after"], rel=1e-6)


@pytest.mark.slow
def test_quick_and_single_cases_leave_the_whole_run_alone(mast):
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 0
    whole = {p.name: p.read_bytes() for p in Path("results/mast").glob("*.csv")}
    assert cli.execute(["compare", "mast", "--quick"]) == 0
    assert cli.execute(["calibrate", "mast", "--quick", "--workers", "1"]) == 0
    assert cli.execute(["calibrate", "mast", "--case", "A2", "--workers", "1"]) == 0
    assert {p.name: p.read_bytes() for p in Path("results/mast").glob("*.csv")} == whole
    one = read("results/mast/case_A2", "parameters.csv")
    assert set(one["case"]) == {"A2"} and one["spread"].isna().all()
    both = read("results/mast", "parameters.csv")
    pd.testing.assert_series_equal(
        one["value"].reset_index(drop=True), both.loc[both["case"] == "A2", "value"].reset_index(drop=True)
    )
    again = json.loads(Path("results/mast/case_A2/summary.json").read_text())
    assert again["evaluations"] == again["cases"]["A2"]["evaluations"] > 0
    assert Path("results/mast/quick/summary.json").exists()
    assert Path("results/mast/quick/comparison_before.csv").exists()


@pytest.mark.medium
def test_a_repeated_command_solves_nothing_twice_and_gives_the_same_result(answered):
    first = {
        n: Path("results/mast", n).read_bytes() for n in ("parameters.csv", "comparison_after.csv", "convergence.csv")
    }
    rows = sqlite3.connect("results/mast/ledger.sqlite").execute("select count(*) from evaluation").fetchone()
    assert cli.execute(["calibrate", "mast", "--workers", "2"]) == 0
    assert first == {n: Path("results/mast", n).read_bytes() for n in first}
    assert rows == sqlite3.connect("results/mast/ledger.sqlite").execute("select count(*) from evaluation").fetchone()


@pytest.mark.medium
def test_a_changed_measurement_makes_old_rows_stale_and_says_so(answered, capsys):
    modes = Path("mast/modes.csv").read_text().replace("1.7117", "1.7217")
    Path("mast/modes.csv").write_text(modes)
    assert cli.execute(["sensitivity", "mast", "--workers", "1"]) == 0
    assert "another state of model or measurement" in capsys.readouterr().out


@pytest.mark.slow
def test_the_measures_can_choose_the_parameters(mast, capsys):
    text = Path("mast/study.toml").read_text()
    Path("mast/study.toml").write_text(text.replace('["E", "m_top", "K_base"]', '"from sensitivity"', 1))
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 2
    assert "calib sensitivity" in capsys.readouterr().err
    assert cli.execute(["sensitivity", "mast", "--workers", "1"]) == 0
    table = read("results/mast", "selection.csv").set_index("parameter")
    table["selected"] = [name != "E" for name in table.index]
    table.to_csv("results/mast/selection.csv")  # chosen by hand, which belongs into study.toml
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 2
    assert "selection.csv" in capsys.readouterr().err
    assert cli.execute(["sensitivity", "mast", "--workers", "1"]) == 0
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 0
    assert set(read("results/mast", "parameters.csv")["parameter"]) == {"E", "m_top", "K_base"}


@pytest.mark.slow
def test_morris_and_sobol_on_request(mast):
    for method, column in (("morris", "mu_star"), ("sobol", "ST")):
        assert cli.execute(["sensitivity", "mast", "--method", method, "--quick", "--workers", "1"]) == 0
        table = read("results/mast/quick", f"{method}.csv")
        assert column in table and set(table["parameter"]) == {"E", "m_top", "K_base"}


@pytest.mark.slow
def test_rows_of_the_reduced_problem_are_not_called_stale(here, capsys):
    question = ["calibrate", str(ROOT / "studies/bogie"), "--quick", "--case", "GB1", "--workers", "1"]
    assert cli.execute(question) == 0
    first = capsys.readouterr().out
    rows = sqlite3.connect("results/bogie/ledger.sqlite").execute("select count(distinct fingerprint) from evaluations")
    assert rows.fetchone() == (2,)  # on the basis and at full order
    assert cli.execute(question) == 0
    again = capsys.readouterr().out
    assert "another state" not in first + again


@pytest.mark.slow
def test_report_draws_and_tells_from_tables_alone(whole, answered, drawn, unrendered, monkeypatch, capsys):
    told = Path("results/mast/report.html")
    assert f"Report:   {told}" in whole[1]
    first = told.read_bytes()
    for figure in (told, *Path("results/mast").glob("*.png")):
        figure.unlink()
    monkeypatch.setattr("calib.correlation.modal.problem.ModalProblem.evaluate", lambda *a: pytest.fail("it solved"))
    assert cli.execute(["report", "mast"]) == 0
    assert len(list(Path("results/mast").glob("*.png"))) >= 8
    assert told.read_bytes() == first and str(told) in capsys.readouterr().out


@pytest.mark.slow
def test_a_single_analysis_writes_no_report_but_updates_an_older_one(mast, drawn, monkeypatch):
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    told = Path("results/mast/report.html")
    assert cli.execute(["compare", "mast"]) == 0 and not told.exists()
    told.write_text("an older one")
    assert cli.execute(["compare", "mast"]) == 0 and "Mode by mode before calibration" in told.read_text("utf-8")


@pytest.mark.medium
def test_results_go_where_they_are_told(mast):
    assert cli.execute(["compare", "mast", "--results", "out/here"]) == 0
    assert Path("out/here/mast/comparison_before.csv").exists() and not Path("results").exists()


@pytest.mark.slow
def test_the_measured_rig_without_shapes(here, drawn, unrendered, capsys):
    shutil.copytree(ROOT / "studies/four_storey_rig", "rig")
    text = (
        Path("rig/study.toml").read_text().replace("[calibration]", "[calibration]\ngenerations = 6\npopulation = 12")
    )
    Path("rig/study.toml").write_text(text)
    assert cli.execute(["run", "rig", "--workers", "1", "--quick"]) == 0
    out = capsys.readouterr().out
    assert "synthetic" not in out
    assert read("results/rig/quick", "comparison_after.csv")["model_mode"].tolist() == [1, 2, 3, 4]
    assert read("results/rig/quick", "comparison_after.csv")["mac"].isna().all()
    assert json.loads(Path("results/rig/quick/summary.json").read_text())["mean_mac_after"] is None


@pytest.mark.medium
@pytest.mark.parametrize("verb", ["compare", "sensitivity", "calibrate", "report", "run"])
def test_every_command_reads_and_checks_every_file(mast, verb, capsys, one_sentence):
    assert cli.execute(["compare", "mast"]) == 0
    before = {p: p.read_bytes() for p in Path("results/mast").iterdir()}
    Path("mast/sensors.csv").write_bytes(b"\x00\xff\xfe rubbish \x80")
    capsys.readouterr()
    assert cli.execute([verb, "mast"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "sensors.csv" in said and "Traceback" not in said
    assert {p: p.read_bytes() for p in Path("results/mast").iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare", "nowhere"], "no such study file"),
        (["calibrate", "mast", "--case", "A9"], "the cases are A1, A2"),
        (["report", "mast"], "no results"),
        (["calibrate", "mast", "--workers", "0"], "--workers"),
        (["frobnicate"], "frobnicate"),
        (["new", "mast"], "not an empty folder"),
    ],
)
def test_bad_commands_end_with_code_2_and_one_sentence(mast, arguments, words, capsys):
    assert cli.execute(arguments) == 2
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said
    assert not Path("calib-error.log").exists()


def test_unwritable_results_are_told(mast, capsys):
    Path("taken").write_text("a file, not a folder")
    assert cli.execute(["compare", "mast", "--results", "taken"]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_unexpected_failures_leave_their_traceback_in_a_log(mast, capsys, monkeypatch):
    monkeypatch.setattr("calib.analyses.compare.compare", lambda *a: 1 / 0)
    assert cli.execute(["compare", "mast"]) == 1
    said = capsys.readouterr().err
    assert "Traceback" not in said and "ZeroDivisionError" in said
    assert "Traceback" in Path("calib-error.log").read_text()


@pytest.mark.medium
def test_help_texts_read_well(capsys):
    assert cli.execute(["--help"]) == 0
    assert "..." not in capsys.readouterr().out.replace("[ARGS]...", "")
    for verb in ("new", "compare", "sensitivity", "calibrate", "extend", "report", "run"):
        assert cli.execute([verb, "--help"]) == 0
        assert "Usage: calib" in capsys.readouterr().out


@pytest.mark.slow
def test_a_suspicious_sensor_is_named_before_comparing(here, capsys, monkeypatch):
    load = LoadedStudy.load

    def tampered(path, *adopted):
        study = load(path, *adopted)
        measured = study.problem.measured
        shapes = measured.shapes.copy()
        names = [s.name for s in measured.sensors]
        shapes[names.index("104y")] *= -1
        one, two = names.index("101y"), names.index("116x")
        shapes[[one, two]] = shapes[[two, one]]
        return replace(study, problem=replace(study.problem, measured=replace(measured, shapes=shapes)))

    monkeypatch.setattr("calib.study.study.LoadedStudy.load", staticmethod(tampered))
    assert cli.execute(["compare", str(ROOT / "studies/bogie")]) == 0
    warnings = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Check this sensor")]
    assert len(warnings) == 2
    assert any("104y" in line and "revers" in line for line in warnings)
    assert any("101y" in line and "116x" in line for line in warnings)
    assert set(read("results/bogie", "sensor_check.csv")["kind"]) == {"flipped", "swapped"}


def test_a_model_that_always_fails_is_told(mast, capsys):
    text = Path("mast/study.toml").read_text().replace("mode_count = 6", "mode_count = 500")
    Path("mast/study.toml").write_text(text)
    assert cli.execute(["compare", "mast"]) == 2
    assert "500" in capsys.readouterr().err


def test_example_writes_nothing_half(here, monkeypatch):
    monkeypatch.setattr(
        "pathlib.Path.write_bytes", lambda *a: (_ for _ in ()).throw(OSError(28, "No space left on device"))
    )
    with pytest.raises(Exception, match="No space left"):
        write_example(Path("mast"))
    assert not Path("mast").exists() and not list(Path().glob(".calib-new-*"))


STEPS = """\
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def build():
    space = ParameterSpace((Parameter("a", 1.0, 0.0, 3.0), Parameter("n", 2.0, 1.0, 5.0, integer=True)))
    return FunctionModel("steps", space, lambda v: {"s": v["a"] + v["n"], "p": v["a"] * v["n"], "q": v["n"] ** 2})
"""


@pytest.mark.medium
@pytest.mark.parametrize("method", ["genetic", "gauss-newton"])
def test_integers_have_no_standard_deviation(here, capsys, method):
    """Only their integer values have a meaning; the neighbouring ones fit millions of times worse here."""
    Path("steps").mkdir()
    Path("steps/model.py").write_text(STEPS)
    Path("steps/measured.csv").write_text("response,value,std\ns,4.5,0.01\np,4.5,0.01\nq,9.0,0.01\n")
    Path("steps/study.toml").write_text(
        'title = "steps"\nmodel = "model.py:build"\nselection = ["a", "n"]\n'
        '[measurement]\nresponses = "measured.csv"\n'
        "[calibration]\npopulation = 20\ngenerations = 10\nstarts = 2\n"
        'cases = [{ name = "A1", seed = 1 }]\n'
    )
    assert cli.execute(["calibrate", "steps", "--workers", "1", "--method", method]) == 0
    words = next(x.split() for x in capsys.readouterr().out.splitlines() if x.startswith("n  "))
    assert words[:3] == ["n", "3", "–"]
    (folder,) = {p.parent for p in Path("results/steps").rglob("verdicts.csv")}
    for name in ("parameters", "verdicts"):
        table = read(folder, name + ".csv").set_index("parameter")
        assert pd.isna(table.loc["n", "std"]) and table.loc["a", "std"] > 0 and table.loc["n", "identified"]
