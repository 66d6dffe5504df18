"""A study of measured FRFs from the command line: a chain of masses on a spring that its model lacks."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.study.experiment import nuisances_of
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WORLD = module_of(ROOT / "tests/template/frf_chain.py")
COLUMNS = {
    "frf_before": ["response", "reference", "freq", "measured_re", "measured_im", "model_re", "model_im", "std"],
    "frf_lines_before": ["freq", "assurance", "amplitude", "in_std"],
    "comparison_before": ["response", "reference", "unit", "lines", "frac", "amplitude", "error", "in_std"],
    "frf_misfit": ["stage", "function", "freq", "re", "im"],
    "measured": ["response", "reference", "held_out", "quantity", "lines", "freq_min", "freq_max", "repeats"],
    "sensors": ["sensor", "node", "direction", "x", "y", "z", "part", "held_out", "shape_std"],
}
LINES = 50
"""Of the 60 without those of the held-out band."""


@pytest.fixture(scope="module")
def ran(asked, no_drawing, tmp_path_factory):
    """A folder with all results of the study, and what each command said."""
    folder = tmp_path_factory.mktemp("frf")
    WORLD.write_study(folder / "chain", ground=WORLD.HIDDEN)
    with no_drawing():
        said = {verb: asked(folder, verb, "chain", "-v") for verb in ("compare", "calibrate", "explain")}
    return folder, said


@pytest.fixture
def table(ran):
    return lambda name: pd.read_csv(ran[0] / f"results/chain/{name}.csv")


@pytest.mark.medium
@pytest.mark.parametrize("name", COLUMNS)
def test_tables_have_their_columns(table, name):
    assert list(table(name).columns) == COLUMNS[name]


@pytest.mark.medium
def test_the_files_are_read_as_they_were_written(table):
    repeats = WORLD.repeats_of(WORLD.truth(WORLD.TRUE, ground=WORLD.HIDDEN), 2)
    used = (WORLD.FREQ < 20.0) | (WORLD.FREQ > 26.0)
    overlay = table("frf_before")
    assert set(overlay["response"]) == {"1x", "4x"} and set(overlay["reference"]) == {"1x"}
    own = overlay[overlay["response"] == "4x"]
    mean = np.mean([repeat.functions[(4, "x"), (1, "x")] for repeat in repeats], axis=0)[used]
    np.testing.assert_allclose(own["freq"], WORLD.FREQ[used], rtol=1e-5)  # files and tables hold so many digits
    np.testing.assert_allclose(own["measured_re"] + 1j * own["measured_im"], mean, rtol=1e-4)
    model = WORLD.truth({"k": 1e4, "c": 8.0, "m": 2.0}, own["freq"].to_numpy(), (4,), (1,))[:, 0, 0]
    np.testing.assert_allclose(own["model_re"] + 1j * own["model_im"], model, rtol=2e-3)
    assert (overlay["std"] > 0).all() and len(overlay) == 2 * LINES == 2 * len(table("frf_lines_before"))


@pytest.mark.medium
def test_the_comparison_agrees_with_the_functions_it_is_of(table):
    overlay, found = table("frf_before"), table("comparison_before")
    for row in found.to_dict("records"):
        own = overlay[(overlay["response"] == row["response"]) & (overlay["reference"] == row["reference"])]
        test, model = (own[f"{of}_re"].to_numpy() + 1j * own[f"{of}_im"].to_numpy() for of in ("measured", "model"))
        frac = np.abs(np.vdot(test, model)) ** 2 / (np.vdot(test, test) * np.vdot(model, model)).real
        in_std = np.sqrt(np.mean(np.abs((test - model) / own["std"]) ** 2) / 2)
        assert row["lines"] == LINES and row["frac"] == pytest.approx(frac, rel=1e-6)
        assert row["in_std"] == pytest.approx(in_std, rel=1e-6)
        assert row["error"] == pytest.approx(np.linalg.norm(test - model) / np.linalg.norm(test), rel=1e-6)


def test_what_was_measured_is_told_with_what_is_held_out(table):
    found = table("measured").set_index(["response", "reference"])
    assert len(found) == 6 and (found["quantity"] == "accelerance").all() and (found["repeats"] == 4).all()
    held_out = {at for at, held in found["held_out"].items() if held}
    assert held_out == {("3x", "1x"), ("1x", "4x"), ("3x", "4x"), ("4x", "4x")}
    sensors = table("sensors").set_index("sensor")
    assert sensors["x"].to_dict() == {"1x": 0.0, "3x": 2.0, "4x": 3.0} and sensors["held_out"].to_dict()["3x"]


def test_the_verdict_names_the_spring(ran, table):
    folder, said = ran
    found = json.loads((folder / "results/chain/explanation.json").read_text())
    assert found["verdict"] == "effect" and "Verdict: effect" in said["explain"]
    best = table("effects").iloc[0]
    assert best["name"] == "ground_2" and best["magnitude_low"] < WORLD.HIDDEN < best["magnitude_high"]
    errors = table("errors").set_index(["group", "stage"])
    for group in ("held_out_sensors", "held_out_references", "held_out_bands"):
        assert errors.loc[(group, "before"), "p"] < 1e-6 and errors.loc[(group, "after"), "p"] > 1e-3
        assert errors.loc[(group, "after"), "rms"] < 0.1 * errors.loc[(group, "before"), "rms"]


def test_the_misfit_has_a_row_per_function_line_and_stage(table):
    found = table("frf_misfit")
    assert set(found["function"]) == {"1x/1x", "4x/1x"} and found.notna().all(axis=None)
    counts = found.groupby(["stage", "function"]).size()
    assert (counts == LINES).all() and found["stage"].nunique() >= 2
    rms = np.sqrt((found.set_index("stage")[["re", "im"]] ** 2).groupby("stage").mean().mean(axis=1))
    errors = table("errors").set_index(["group", "stage"])["rms"]
    assert rms["base"] == pytest.approx(errors[("fit", "before")], rel=1e-6)


def test_python_gives_the_same_from_the_folder(ran, here, table):
    answer = calib.Study.load(ran[0] / "chain").compare().table
    pd.testing.assert_frame_equal(answer, table("comparison_before"), rtol=1e-8)


@pytest.mark.slow
def test_report_draws_it_from_tables_alone(ran, here, unrendered, drawn, monkeypatch):
    shutil.copytree(ran[0], here, dirs_exist_ok=True)
    for solver in (
        "structure.reduction.frf_target.frf",
        "structure.reduction.frf_target.frf_solutions",
        "correlation.frf.problem.frf",
    ):
        monkeypatch.setattr(f"calib.{solver}", lambda *a, **k: pytest.fail("it solved"))
    assert cli.execute(["report", "chain"]) == 0
    assert {"frf_overlays", "frac", "frf_lines"} <= {p.stem for p in Path("results/chain").glob("*.png")}
    assert "1x/1x" in Path("results/chain/report.html").read_text(encoding="utf-8")


# -- bad studies -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words", "key"),
    [
        (
            'sensors = ["3x"], ref',
            'modes = ["m1"], ref',
            ("modes are held out, but the study measures FRFs",),
            "held_out",
        ),
        ('["3x"]', '["3x", "7x"]', ("held-out response '7x' was not measured", "1x, 3x, 4x"), "held_out"),
        ('["4x"]', '["3x"]', ("held-out reference '3x' was not measured", "1x, 4x"), "held_out"),
        ("[[20.0, 26.0]]", "[[50.0, 60.0]]", ("no line lies in the band [50, 60] Hz",), "held_out"),
        ("synthetic = true", "band = [50.0, 60.0]", ("no line lies in the band [50, 60] Hz",), "band"),
        ("synthetic = true", 'band = [2.0, 3.5]\nlines = "resonances"', ("no resonance rises",), "lines = "),
        ("synthetic = true", "nuisances = { gain = -1.0 }", ("gain",), "gain"),
        ("synthetic = true", "nuisances = { mass = 0.1 }", ("mass",), "mass"),
        ("synthetic = true", "nuisances = { resonance = 5.1 }", ("5.1", "5"), "resonance"),
        ("synthetic = true", 'lines = "peaks"', ("lines",), "lines = "),
        ("synthetic = true", 'quantity = "mobility"', ("mobility", "accelerance"), ""),
        ("synthetic = true", 'accuracy = { freq = "1 %" }', ("accuracy",), "accuracy"),
        ('model = "model.py:chain"', 'model = "function.py:spring"', ("no matrices", "StructuralModel"), "kind"),
    ],
)
def test_a_study_that_cannot_be_read_is_told_the_line(here, edit, capsys, one_sentence, old, new, words, key):
    WORLD.write_study(here / "chain", ground=WORLD.HIDDEN)
    Path("chain/function.py").write_text(
        "import calib\nimport numpy as np\n\n\ndef spring():\n"
        "    space = calib.ParameterSpace([calib.Parameter('k', 1.0, 0.5, 2.0)])\n"
        "    def modes(v):\n        return {'natural_freq': np.array([v['k']]), 'shapes': np.ones((1, 1))}\n"
        "    return calib.ModalFunctionModel('spring', space, modes, (calib.Sensor(1, 'x'),), n_modes=1)\n"
    )
    edit(here / "chain", old, new)
    capsys.readouterr()
    assert cli.execute(["compare", "chain"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "Traceback" not in said
    assert all(word in said for word in words), said
    found = re.search(r"study\.toml, line (\d+)", said)
    if "quantity" in new:  # the contradiction is in the file
        assert found is None and "repeat_1.uff" in said
    else:
        marked = (here / "chain/study.toml").read_text().splitlines()[int(found[1]) - 1]
        assert key in marked, said
    assert not list(Path("results").rglob("*.csv"))


def test_python_poses_the_problem_of_the_folder(ran):
    """The test in memory holds out the same data and has the same nuisances as the study."""
    study = calib.Study(ran[0] / "chain")
    problem = study.problem
    one = study.loaded
    assert problem.fit_problem.pair.problem.measured.fingerprint == one.problem.measured.fingerprint
    assert set(problem.tests.unseen) == set(one.unseen) and problem.tests.unseen
    assert problem.space.free_names == one.search_space.free_names


def test_a_transducer_loads_the_structure_though_its_function_is_held_out(tmp_path):
    file = WORLD.write_study(tmp_path / "chain") / "study.toml"
    own = 'kind = "frf"\nnuisances = { accelerometer = 0.02, gain = 1.0 }'
    file.write_text(file.read_text().replace('kind = "frf"', own))
    study = calib.Study(file.parent).loaded
    fitted, held_out = study.problem, study.unseen["held_out_sensors"]
    masses = {"mass_1", "mass_3", "mass_4"}
    assert masses <= set(fitted.space.names) and masses <= set(study.search_space.free_names)
    assert "gain_3x" not in fitted.space and set(held_out.unfitted(fitted.space.values)) == {"gain_3x", "gain_force_4x"}
    assert set(calib.Study(file.parent).problem.space.names) == set(study.search_space.names)


def test_a_resonance_that_only_held_out_data_show_frees_nothing(tmp_path):
    """What is held out would enter the fit by the frequency and the width of its peak."""
    file = WORLD.write_study(tmp_path / "chain") / "study.toml"
    own = 'kind = "frf"\nnuisances = { resonance = 2.0 }'
    file.write_text(file.read_text().replace('kind = "frf"', own))
    study = calib.Study(file.parent).loaded
    given = study.experiment.frfs
    at = [response.name for response in given.responses].index("3x")
    values = given.values.copy()
    values[:, at] += 50.0 / (1 - (given.freq / 35.0) ** 2 + 0.02j * given.freq / 35.0)[:, None]
    tested = replace(study.experiment, frfs=replace(given, values=values))
    peaks = tested.frfs.resonances()
    assert min(abs(r.freq - 35.0) for r in peaks) < 1.0 < min(abs(r.freq - 35.0) for r in tested.used.resonances())
    freed = {error.freq for error in nuisances_of(study, tested, study.model)}
    assert len(freed) == 3 and freed == {r.freq for r in tested.used.resonances()}
