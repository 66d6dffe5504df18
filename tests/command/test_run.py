"""``calib run`` of a study with a library of effects: explained, extended, calibrated again, and reported."""

import html
import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.analyses import calibrate as calibration
from calib.command import cli
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
FOLDER, OWN = Path("results/mast/quick"), Path("results/mast_extended/quick")
UNSEEN = ("held_out_sensors", "held_out_modes")
RUN = ["run", "mast", "--quick", "--workers", "1", "-v"]

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


def quick(folder: Path, write_study, asked, edit, hidden) -> str:
    """Output of a quick run of a mast; one mode and two sensors are held out."""
    study = write_study(folder / "mast", hidden)
    edit(study, *HELD)
    edit(study, "[calibration]", "[sensitivity]\nsamples = 12\n\n[calibration]")
    return asked(folder, *RUN)


@pytest.fixture(scope="module")
def lacking(write_study, asked, edit, no_drawing, tmp_path_factory):
    """A folder with the run of a mast with a guy rope that its model lacks, without figures, and its output."""
    folder = tmp_path_factory.mktemp("lacking")
    with no_drawing():
        return folder, quick(folder, write_study, asked, edit, {"guy": 12000.0})


@pytest.fixture
def within(lacking, tmp_path, monkeypatch):
    """A copy of that folder as the current one, and its output."""
    shutil.copytree(lacking[0], tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return lacking[1]


def tables(folder: Path) -> dict[str, bytes]:
    """Every table below a folder, without times."""
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*.csv"))}


def heads(out: str) -> list[str]:
    """The analyses whose results an output holds, in its order."""
    return [line.split(": ")[1].split("  ")[0] for line in out.splitlines() if line.endswith("[synthetic measurement]")]


@pytest.mark.medium
def test_what_is_named_is_added_and_held_out_errors_fall(within):
    study = LoadedStudy.load(FOLDER / "mast_extended")
    assert study.settings.with_effects == ("guy",) and "guy" in study.search_space.free_names
    errors = pd.read_csv(FOLDER / "added_errors.csv").set_index(["group", "stage"])
    for stage, folder in (("before", FOLDER), ("after", OWN)):
        told = pd.read_csv(folder / "data_errors.csv").set_index("group")
        assert list(errors.xs(stage, level="stage")["rms"]) == list(told["rms"])
    for group in ("fit", "left_out", *UNSEEN):
        assert errors.loc[(group, "after"), "rms"] < 0.9 * errors.loc[(group, "before"), "rms"]
    for group in UNSEEN:
        assert errors.loc[(group, "after"), "rms"] < 1.3 * errors.loc[(group, "after"), "expected"]
    added = json.loads((FOLDER / "added.json").read_text())
    (guy,) = added["effects"]
    assert guy["low"] < 12000.0 < guy["high"] and guy["high"] - guy["low"] < 2000.0 and added["quick"] is True
    found = pd.read_csv(FOLDER / "added_parameters.csv").set_index("parameter")
    assert list(found.index[found["added"]]) == ["guy"] and found.loc["guy", "after"] == pytest.approx(guy["value"])
    # Without the rope another parameter had to compensate for it.
    shift = (found["before"] - found["nominal"]).abs() > (found["after"] - found["nominal"]).abs()
    assert shift["E"] and shift["K_base"]
    verdicts = pd.read_csv(OWN / "verdicts.csv").set_index("parameter")
    assert list(found["after_identified"]) == list(verdicts["identified"].reindex(found.index))
    for name in ("comparison", "where_it_fails"):  # of the extended study
        assert (FOLDER / f"{name}_added.csv").read_bytes() == (OWN / f"{name}_after.csv").read_bytes()
    modes = pd.read_csv(FOLDER / "added_modes.csv").set_index("mode")
    assert modes["held_out"]["B3x"] and abs(modes["error_after"]["B1x"]) < abs(modes["error_before"]["B1x"])


@pytest.mark.medium
def test_the_output_is_in_order_with_its_numbers(within):
    verbs = ["run", "compare", "sensitivity", "calibrate", "explain", "extend", "calibrate", "before and after"]
    assert heads(within) == verbs
    end = within[within.index("before and after  [synthetic") :]
    added = json.loads((FOLDER / "added.json").read_text())
    assert added["sentence"] in end and "Both are quick runs" in end
    assert (
        added["conclusion"].startswith("With the effect the model fits better and predicts ")
        and added["conclusion"] in end
    )
    errors = pd.read_csv(FOLDER / "added_errors.csv").set_index(["group", "stage"])
    for words, group in {"used data": "fit", "validation sensors": UNSEEN[0], "validation modes": UNSEEN[1]}.items():
        before, after = errors.loc[(group, "before")], errors.loc[(group, "after")]
        (line,) = [x for x in end.splitlines() if x.startswith(f"{words}  ")]
        assert line.removeprefix(words).split()[:4] == [
            str(int(after["rows"])), f"{before['rms']:.2f}", f"{after['rms']:.2f}", f"{after['expected']:.2f}",
        ]  # fmt: skip
        assert f"{words} {before['rms']:.2f} -> {after['rms']:.2f} ({after['expected']:.2f})" in added["sentence"]
    assert str(FOLDER / "mast_extended") in end and str(OWN) in end and "Add it with" not in within


@pytest.mark.slow
def test_figures_and_reports_of_both_are_drawn_and_redrawn(within, drawn, monkeypatch):
    monkeypatch.setattr("calib.correlation.modal.problem.ModalProblem.compare", lambda *a: pytest.fail("it solved"))
    assert cli.execute(["report", "mast"]) == 0
    assert (FOLDER / "added_errors.png").stat().st_size > 5000 and (OWN / "comparison.png").exists()
    page = (FOLDER / "report.html").read_text()
    assert 'id="errors"' in page and "Prediction errors before and after adding the effects" in page
    conclusion = json.loads((FOLDER / "added.json").read_text())["conclusion"]
    assert html.escape(conclusion.replace(" -> ", " → "), quote=False) in page and ", a quick run." in page
    assert "mast_extended" in page and (OWN / "report.html").exists()
    for figure in [*Path("results").rglob("*.png"), *Path("results").rglob("report.html")]:
        figure.unlink()
    assert cli.execute(["report", "mast"]) == 0
    assert (FOLDER / "report.html").read_text() == page and (OWN / "report.html").exists()


@pytest.mark.slow
def test_the_same_run_again_says_the_same(lacking, monkeypatch):
    monkeypatch.chdir(lacking[0])
    before = tables(Path("results"))
    assert cli.execute(RUN) == 0
    assert tables(Path("results")) == before
    assert sorted(p.name for p in FOLDER.glob("mast_extended*")) == ["mast_extended"]


@pytest.mark.slow
def test_an_interrupted_run_is_completed_by_the_same_command(within, monkeypatch):
    whole = tables(Path("results"))
    shutil.rmtree("results")
    calibrate, calls = calibration.calibrate, []

    def stopped(*given, **more):
        calls.append(given[0].name)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return calibrate(*given, **more)

    monkeypatch.setattr(calibration, "calibrate", stopped)
    assert cli.execute(RUN) == 130 and calls == ["mast", "mast_extended"]
    assert not (FOLDER / "added.json").exists() and not list(Path("results").rglob(".*"))
    assert cli.execute(RUN) == 0
    assert tables(Path("results")) == whole


@pytest.mark.medium
def test_a_later_analysis_removes_what_rested_on_the_earlier_one(within):
    assert cli.execute(["calibrate", "mast", "--quick", "--workers", "1"]) == 0
    assert not list(FOLDER.glob("added*"))


@pytest.mark.slow
def test_two_effects_are_added_together(here, write_study, asked, edit):
    quick(here, write_study, asked, edit, {"platform": 25.0, "stuck_base": 0.6})
    assert LoadedStudy.load(FOLDER / "mast_extended").settings.with_effects == ("platform", "stuck_base")
    added = json.loads((FOLDER / "added.json").read_text())
    assert [e["name"] for e in added["effects"]] == ["platform", "stuck_base"]
    assert "With the effects the model fits better" in added["sentence"]


@pytest.mark.slow
def test_a_calibration_that_ends_elsewhere_than_the_explanation_says_so(within, monkeypatch):
    assert "ended elsewhere" not in json.loads((FOLDER / "added.json").read_text())["sentence"]
    calibrate = calibration.calibrate

    def astray(study, *given, **more):
        """A search that stays where the rope is too stiff."""
        text = study.file.read_text()
        if "guy" in study.search_space.free_names and "limits = [20000" not in text:
            text = re.sub(r"begin_at = .*\n", "", text)  # it is within no such limits
            study.file.write_text(f"{text}\n[parameters.guy]\nlimits = [20000, 1e5]\nvalue = 3e4\n")
            study = LoadedStudy.load(study.file)
        return calibrate(study, *given, **more)

    monkeypatch.setattr(calibration, "calibrate", astray)
    assert cli.execute(RUN) == 0
    told = json.loads((FOLDER / "added.json").read_text())["sentence"]
    own = json.loads((FOLDER / "explanation.json").read_text())["chosen_values"]["guy"]
    assert f"The explanation fitted guy = {own:.3g} N/m; this calibration ended elsewhere" in told


@pytest.mark.slow
def test_where_nothing_is_missing_the_run_reports_it_and_ends(here, write_study, asked, edit):
    out = quick(here, write_study, asked, edit, {})
    words = "These data show no missing effect, so nothing is added."
    assert words in out.splitlines() and "before and after" not in out
    assert heads(out) == ["run", "compare", "sensitivity", "calibrate", "explain"]
    assert json.loads((FOLDER / "added.json").read_text())["sentence"] == words
    assert not list(FOLDER.glob("mast_extended*")) and not Path("results/mast_extended").exists()
    assert (FOLDER / "explanation.json").exists()


@pytest.mark.slow
def test_the_extended_study_can_be_moved_and_run(within):
    shutil.move(FOLDER / "mast_extended", "mast_2")
    assert cli.execute(["explain", "mast_2"]) == 0
    assert json.loads(Path("results/mast_2/explanation.json").read_text())["verdict"] == "nothing_detectable"
    assert cli.execute(["report", "mast"]) == 0  # what was moved away is not missed


@pytest.mark.slow
def test_a_model_without_matrices_is_run_to_the_end_too(here, asked):
    """Nothing is held out there, so leave-one-out data decide."""
    truth = json.loads((ROOT / "tests/truth/five_mass_chain.json").read_text())
    out = asked(here, "run", str(ROOT / "studies/five_mass_chain"), "--quick", "--workers", "1")
    assert "With the effect the model fits better and predicts data left out in turn better." in out
    (effect,) = json.loads(Path("results/five_mass_chain/quick/added.json").read_text())["effects"]
    magnitude = truth["magnitude"][truth["effect"]]
    assert effect["name"] == truth["effect"] and effect["low"] < magnitude < effect["high"]
    assert not Path("results/five_mass_chain/quick/added_modes.csv").exists()


def test_a_command_computes_on_one_thread(here, monkeypatch):
    seen = []
    monkeypatch.setattr("calib.api.study.Study.report", lambda *given: seen.append(threadpool_info()))
    with threadpool_limits(2):
        assert cli.execute(["report", "mast"]) == 0
        assert {pool["num_threads"] for pool in threadpool_info()} == {2}
    assert seen[0] and {pool["num_threads"] for pool in seen[0]} == {1}


@pytest.mark.slow
def test_a_run_goes_on_where_the_modes_are_too_few_to_explain(here, write_study, capsys, edit):
    write_study(here / "mast", {"guy": 12000.0})
    edit(here / "mast", "modes = []", 'modes = ["B2z", "B3x", "B3z"]')
    assert cli.execute(RUN) == 0
    out = capsys.readouterr().out
    assert "3 measured modes cannot tell" in out and "calib explain" not in out
    assert not (FOLDER / "explanation.json").exists() and (FOLDER / "summary.json").exists()
