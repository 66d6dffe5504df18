"""A solver as a process: decks, private folders, failures with their last lines, and studies that start it."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import calib
from calib.analyses.provenance.state import made_from, state_differences
from calib.analyses.runs_ahead import runs_ahead
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import Outcome
from calib.execution.process import run_command
from calib.imports.deck import deck_of, in_columns
from calib.results.fingerprint import FAILED_RUNS
from calib.results.ledger import Ledger
from calib.study.search_settings import ParetoSettings
from calib.study.solver import solver_model
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile
from tests.study.solver_chain import PARAMETERS, STUDY, TRUE, exact, runs, solver, study, template

LIBRARY = """import calib


def library():
    size = calib.Parameter("stretch", 0.0, -0.1, 0.1, prior_sd=0.01)

    def build(model):
        def stretched(values):
            found = dict(model.function(values))
            return {**found, "natural_freq": found["natural_freq"] * (1 + values["stretch"])}

        return stretched

    return (calib.Effect("stretch", "Stretch", "a factor", "all frequencies", size, build),)
"""
NOMINAL = {p.name: p.value for p in PARAMETERS}


def test_modes_come_back_with_shapes(tmp_path):
    found = solver(tmp_path).modes({"k": 2.5}, 2)
    freq, shapes = exact({**NOMINAL, "k": 2.5})
    np.testing.assert_allclose(found.natural_freq, freq, rtol=1e-12)
    for j in range(2):
        assert abs(shapes[:, j] @ found.shapes[:, j]) == pytest.approx(
            np.linalg.norm(shapes[:, j]) * np.linalg.norm(found.shapes[:, j])
        )
    assert not (tmp_path / FAILED_RUNS).exists() and not (tmp_path / "modes.csv").exists()


@pytest.mark.slow
def test_it_is_fitted_from_python_and_no_point_is_run_twice(tmp_path):
    freq, shapes = exact(TRUE)
    model = solver(tmp_path)
    test = calib.ModalTest(
        calib.modes(freq, shapes, sensors=["1z", "2z"], freq_std=1e-4 * freq, shape_std=1e-3 * abs(shapes))
    )
    fit = calib.Problem(model, test).keep(["k", "m"]).calibrate(method="gauss-newton", starts=1)
    assert fit.values["k"] == pytest.approx(2.3, rel=1e-3) and fit.values["m"] == pytest.approx(1.3, rel=1e-3)
    assert len(runs(tmp_path)) == len(set(runs(tmp_path)))


def test_the_step_of_differences_is_no_part_of_what_a_run_computes(tmp_path):
    assert solver(tmp_path, step=0.01).fingerprint == solver(tmp_path).fingerprint
    assert solver(tmp_path, n_modes=1).fingerprint != solver(tmp_path).fingerprint


def test_sensors_are_found_by_place(tmp_path):
    """The measurement numbers its nodes otherwise; the deck has the places."""
    (tmp_path / "mesh.inp").write_text("*NODE\n1,0,0,0\n2,0,0,1000\n")
    at = [calib.Sensor(9, "z", (0.0, 0.0, 1.001)), calib.Sensor(4, "z", (0.0, 0.0, 0.0))]
    table = "open('places.csv', 'w').write('node,x,y,z\\n1,0,0,0\\n2,0,0,1\\n')"
    placed = solver(tmp_path, table, sensors=at, coordinates="places.csv").modes({}, 2)
    np.testing.assert_allclose(placed.shapes[::-1], solver(tmp_path).modes({}, 2).shapes, rtol=1e-12)
    off = [calib.Sensor(9, "z", (0.0, 0.0, 4.0)), at[1]]
    with pytest.raises(InputError, match="off the model"):
        solver(tmp_path, table, sensors=off, coordinates="places.csv").modes({}, 2)
    near = solver(tmp_path, table, sensors=off, coordinates="places.csv", node_limit=3.5)
    np.testing.assert_array_equal(near.modes({}, 2).shapes, placed.shapes)
    text = STUDY.replace("[measurement]", "[measurement]\nnode_limit = 3.5")
    loaded = LoadedStudy.load(study(tmp_path, text=text))
    assert loaded.model.function.node_limit == 3.5 == loaded.model.sensor_tolerance


def test_a_motion_that_the_code_does_not_print_is_named(tmp_path):
    with pytest.raises(InputError, match="node 3 in z"):
        solver(tmp_path, sensors=["1z", "3z"]).modes({}, 2)


def test_numbers_instead_of_modes(tmp_path):
    more = "open('out.csv', 'w').write(f'response,value\\nload,{2 * k!r}\\n')"
    model = solver(tmp_path, more, modes="", shapes="", responses="out.csv")
    assert isinstance(model, calib.FunctionModel) and model.function(NOMINAL) == {"load": 4.0}


# -- failures ----------------------------------------------------------------------------------------------------------


def test_a_failure_tells_the_last_lines_and_keeps_its_folder(tmp_path):
    model = solver(tmp_path, "print('one'); print('two'); print('three'); print('*ERROR in *ELASTIC'); sys.exit(201)")
    with pytest.raises(EvaluationError, match=r"exit code 201.*two \| three \| \*ERROR in \*ELASTIC") as failed:
        model.modes({}, 2)
    assert "one" in failed.value.__notes__[0] and "one" not in str(failed.value)
    (kept,) = (tmp_path / FAILED_RUNS).iterdir()
    assert {f.name for f in kept.iterdir()} == {"solve.py", "values.csv", "calib_output.txt"}
    assert "k,2.0" in (kept / "values.csv").read_text()


@pytest.mark.medium
def test_folders_of_failed_runs_are_kept_up_to_a_number(tmp_path):
    model = solver(tmp_path, "sys.exit(1)")
    told = []
    for k in np.linspace(1.0, 3.0, 12):
        with pytest.raises(EvaluationError) as failed:
            model.modes({"k": float(k)}, 2)
        told.append(str(failed.value))
    assert len(list((tmp_path / FAILED_RUNS).iterdir())) == 10
    assert "10" in told[0] and set(told) == {told[0]}  # whichever worker ends first, a point tells the same


def test_missing_and_damaged_results_are_failures(tmp_path):
    for more, words in (
        ("print('no seat'); sys.exit()", r"wrote no modes\.csv.*no seat"),
        ("open('modes.csv', 'w').write('mode,freq'); sys.exit()", r"modes\.csv"),
    ):
        with pytest.raises(EvaluationError, match=words):
            solver(tmp_path, more).modes({}, 2)


@pytest.mark.medium
def test_a_run_beyond_the_time_limit_is_ended_with_all_that_it_started(tmp_path):
    more = f"""
import subprocess, time
child = subprocess.Popen(['sleep', '60'])
open({str(tmp_path / "pid")!r}, 'w').write(str(child.pid))
time.sleep(60)
"""
    for limit in (0.5, 4.0, 32.0):  # of a busy machine the first may be over before the script begins
        with pytest.raises(EvaluationError, match=rf"took longer than {limit:g} s"):
            solver(tmp_path, more, time_limit=limit).modes({}, 2)
        if (tmp_path / "pid").exists():
            break
    _wait_for_end(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(sys.platform == "win32", reason="processes are ended otherwise there")
def test_what_a_killed_process_has_started_ends_with_it(tmp_path):
    script = (
        "import sys; from pathlib import Path; from calib.execution.process import run_command;"
        "run_command(['sh', '-c', 'echo $$ > pid; sleep 60'], Path(sys.argv[1]))"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)])
    while not ((tmp_path / "pid").exists() and (tmp_path / "pid").read_text().strip()):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    _wait_for_end(int((tmp_path / "pid").read_text()))


def test_exit_codes_and_signals(tmp_path):
    assert run_command(["sh", "-c", "exit 7"], tmp_path) == 7
    assert run_command(["sh", "-c", "kill -9 $$"], tmp_path) == -9
    assert run_command(["sh", "-c", "cat; echo done"], tmp_path) == 0  # nobody waits for input
    assert (tmp_path / "calib_output.txt").read_text() == "done\n"


def test_licences_that_are_taken_are_waited_for(tmp_path):
    more = f"""
if not __import__('os').path.exists({str(tmp_path / "seat")!r}):
    open({str(tmp_path / "seat")!r}, 'w')
    print('LICENSE denied'); [print('closing') for _ in range(9)]; sys.exit(3)
"""
    model = solver(tmp_path, more)
    again = calib.retrying(model.function, "LICENSE", wait=0.0)
    assert len(again(NOMINAL)["natural_freq"]) == 2 and len(runs(tmp_path)) == 2


# -- at the door -------------------------------------------------------------------------------------------------------


def test_wrong_templates_are_refused_with_their_line(tmp_path):
    for text, line, words in (
        ("a\n{{ q }} {{ k }}{{ m }}{{ t }}", 2, "no parameter"),
        ("a\nb\n{{ k }", 3, "no template"),
    ):
        (tmp_path / "deck").write_text(text)
        with pytest.raises(InputError, match=words) as refused:
            solver(tmp_path, template=tmp_path / "deck")
        assert refused.value.at.line == line
    (tmp_path / "deck").write_text("{{ k }} {{ m }}")
    with pytest.raises(InputError, match="'t'"):
        solver(tmp_path, template=tmp_path / "deck")


@pytest.mark.parametrize(
    "options, words",
    [
        ({"modes": ""}, "neither"), ({"responses": "x.csv"}, "both"), ({"files": "none.inc"}, "none.inc"),
        ({"sensors": []}, "sensors ="), ({"units": "mm-g"}, "mm-t-N"), ({"template": []}, "deck"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        solver(tmp_path, **options)


def test_a_program_that_is_not_there_is_no_failed_point(tmp_path):
    template(tmp_path)
    model = solver_model("no_such_program -i x", template=tmp_path / "solve.py.j2", modes="m.csv",
                               sensors=["1z"], parameters=PARAMETERS, folder=tmp_path)  # fmt: skip
    with pytest.raises(InputError, match="no_such_program"):
        model.modes({}, 2)


def test_numbers_have_a_decimal_point_and_all_digits():
    values = {"a": 1e6, "b": 1e-7, "c": 210000.0, "d": 0.1 + 0.2, "n": 3.0}
    own = [calib.Parameter(name, v, -1e9, 1e9, integer=name == "n") for name, v in values.items()]
    assert (
        deck_of("{{ a }} {{ b }} {{ c }} {{ d }} {{ n }}", own, values) == f"1000000.0 1.0e-07 210000.0 {0.1 + 0.2!r} 3"
    )
    assert deck_of("{{ 2 * a | columns(8) }}|{{ c | columns(8) }}", own, values).split("|")[1] == "210000.0"


@pytest.mark.parametrize("value", [210000.123456, -7.85e-9, 1.0, 123456789.0, -1.5e-120, 0.0, 3.3e25])
def test_numbers_fit_their_columns_with_as_many_digits_as_possible(value):
    text = in_columns(value, 8)
    known = float(re.sub(r"(?<=[\d.])([-+]\d+)$", r"e\1", text))  # Nastran leaves the e out
    assert len(text) <= 8 and "." in text
    assert known == pytest.approx(value, rel=5e-2 if abs(value) < 1e-99 else 5e-4)


# -- studies -----------------------------------------------------------------------------------------------------------


def test_a_change_of_the_deck_or_of_the_command_is_another_model(tmp_path):
    one = solver(tmp_path).fingerprint
    assert solver(tmp_path).fingerprint == one
    assert solver(tmp_path, "pass").fingerprint != one
    (tmp_path / "mesh.inc").write_text("1")
    with_mesh = solver(tmp_path, files="mesh.inc").fingerprint
    (tmp_path / "mesh.inc").write_text("2")
    assert len({one, with_mesh, solver(tmp_path, files="mesh.inc").fingerprint}) == 3


def test_a_program_of_the_study_belongs_to_the_model_and_is_found_from_a_derived_study(tmp_path):
    folder = study(tmp_path / "chain", text=re.sub('command = ".*"', 'command = "./run.sh -S"', STUDY))

    def load(folder, said=""):
        program = tmp_path / "chain/run.sh"
        program.write_text(f'#!/bin/sh\necho "{said}"\nexec {sys.executable} -I "$@" solve.py\n')
        program.chmod(0o755)
        return LoadedStudy.load(folder)

    (tmp_path / "other").mkdir()
    (tmp_path / "other/study.toml").write_text('base = "../chain"\ntitle = "other"\n')
    first, other = load(folder), load(tmp_path / "other")
    np.testing.assert_allclose(other.model.modes({}, 2).natural_freq, exact(NOMINAL)[0], rtol=1e-12)
    assert other.problem.ledger_key == first.problem.ledger_key != load(folder, "more").problem.ledger_key
    assert "./run.sh" in first.read_files


def test_runs_stay_valid_where_a_study_with_an_effect_is_copied_or_given_more_time(tmp_path):
    head = 'effects = "library.py:library"\nwith_effects = ["stretch"]\n'
    folder = study(tmp_path / "chain", text=STUDY.replace("[model]", f"{head}[model]", 1))
    (folder / "library.py").write_text(LIBRARY)
    key = LoadedStudy.load(folder).problem.ledger_key
    copied = shutil.copytree(folder, tmp_path / "copy")
    assert LoadedStudy.load(copied).problem.ledger_key == key
    text = (copied / "study.toml").read_text()
    (copied / "study.toml").write_text(f"{text}time_limit = 7.0\n")
    assert LoadedStudy.load(copied).problem.ledger_key == key
    (copied / "study.toml").write_text(text.replace("-I -S", "-I"))
    assert LoadedStudy.load(copied).problem.ledger_key != key


def test_a_changed_template_outdates_results_where_no_code_is_run(tmp_path):
    folder = study(tmp_path / "chain")
    then = made_from(StudyFile.read(folder), "compare")
    template(folder, "pass")
    assert state_differences(then, made_from(StudyFile.read(folder), "compare")) == ["solve.py.j2"]


@pytest.mark.medium
def test_a_comparison_does_not_rely_on_stored_runs_of_another_solver(tmp_path):
    """It reads a file that the study does not name."""
    folder = study(tmp_path / "chain", f"k = float(open({str(tmp_path / 'k')!r}).read())")
    (tmp_path / "k").write_text("2.0")
    loaded = calib.Study.load(folder, results=tmp_path / "results", progress=False)
    loaded.compare()
    (tmp_path / "k").write_text("2.1")
    with pytest.raises(InputError, match="other results"):
        loaded.compare()


def test_a_study_asks_its_solver_for_what_was_measured(tmp_path):
    loaded = LoadedStudy.load(study(tmp_path / "chain"))
    assert [s.name for s in loaded.model.sensors] == ["1z", "2z"] and not runs(tmp_path / "chain")
    assert {"solve.py.j2"} <= set(loaded.read_files)
    (tmp_path / "other").mkdir()
    (tmp_path / "other/study.toml").write_text('base = "../chain"\ntitle = "other"\n[model]\nstep = 0.01\n')
    other = LoadedStudy.load(tmp_path / "other")
    assert other.model.step == 0.01 and len(other.model.modes({}, 2).natural_freq) == 2


@pytest.mark.parametrize(
    "old, new, line, words",
    [
        ('modes = "modes.csv"', 'mode = "modes.csv"', 5, "did you mean 'modes'"),
        ("limits = [1.0, 3.0]", "limits = [3.0, 1.0]", 10, "lower limit"),
        ("powers = [-1, 1, 2, 3]", "powers = [1, 1]", 12, "powers"),
        ("n_modes = 2", "n_modes = 0", 8, "n_modes"),
        ('title = "chain"', 'title = "chain"\nmodel_options = {a = 1}', 2, "model_options"),
        ("k = {", "q = {", None, "'k'"),
    ],
)  # fmt: skip
def test_wrong_keys_are_refused_with_their_line(tmp_path, old, new, line, words):
    folder = study(tmp_path)
    text = (folder / "study.toml").read_text()
    assert old in text
    (folder / "study.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words) as refused:
        LoadedStudy.load(folder)
    assert line is None or refused.value.at.line == line


def test_a_solver_that_takes_too_long_is_ended_before_its_process(tmp_path):
    """The process that waits for it tells what it said."""
    loaded = LoadedStudy.load(study(tmp_path, text=STUDY + "time_limit = 7.0\n"))
    assert loaded.model.function.time_limit == 7.0 < loaded.settings.evaluation_limit


def test_what_a_solver_will_be_started_for_is_told(tmp_path):
    loaded = LoadedStudy.load(study(tmp_path))
    with Ledger.in_memory() as ledger:
        told = runs_ahead(loaded, ledger, "calibrate", 1)
        assert "about 32 times" in told and "not known" in told  # 2 starts of 8 + 2 x 4 runs
        values = loaded.model.space.complete({})
        outcome = Outcome(values, "ok", {"natural_freq 1": 1.0}, seconds=6.0)
        ledger.append(loaded.problem.ledger_key, [outcome])
        assert "3.2 min" in runs_ahead(loaded, ledger, "calibrate", 1)
        explained = runs_ahead(loaded, ledger, "explain", 2)
        assert "about 60 times" in explained and ": 3 min with 2 at once" in explained
        assert "500 samples" in runs_ahead(loaded, ledger, "sensitivity", 1)
        front = ParetoSettings(population=10, generations=7)
        assert "about 70 times: 7 generations of 10" in runs_ahead(loaded, ledger, "pareto", 1, front=front)


def _wait_for_end(pid):
    """Returns when a process is gone, or a zombie that its new parent has not collected yet."""
    while True:
        try:
            os.kill(pid, 0)
            with open(f"/proc/{pid}/stat") as file:
                if file.read().rpartition(")")[2].split()[0] == "Z":
                    return
        except (OSError, ProcessLookupError):
            return
        time.sleep(0.02)


def test_a_deck_whose_nodes_are_in_an_included_file_has_nodes(tmp_path):
    from calib.study.solver import _has_nodes

    (deck := tmp_path / "deck.inp").write_text("*include, input=mesh.inc\n")
    assert not _has_nodes(deck)
    (tmp_path / "mesh.inc").write_text("*Node\n1, 0, 0, 0\n")
    assert _has_nodes(deck)
