import re
import shutil
from pathlib import Path

import pytest

from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.study.study import EvaluationSource, LoadedStudy

ROOT = Path(__file__).resolve().parent.parent
BOGIE, RIG = ROOT / "studies/bogie", ROOT / "studies/four_storey_rig"


@pytest.fixture
def example(tmp_path):
    write_example(tmp_path / "mast")
    return tmp_path / "mast"


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    file = folder / "study.toml"
    text = file.read_text("utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    file.write_text(text, "utf-8")
    return folder


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        LoadedStudy.load(folder)
    return str(caught.value)


@pytest.mark.medium
def test_the_studies_of_the_repository_load():
    bogie, rig = LoadedStudy.load(BOGIE), LoadedStudy.load(RIG)
    assert bogie.measured.names == tuple(f"{k}BT" for k in range(1, 9))
    assert len(bogie.measured.sensors) == 30 and bogie.measured.n_repeats == 5 and bogie.synthetic
    assert not rig.synthetic and not rig.measured.has_shapes and rig.measured.n_repeats == 100
    assert len(bogie.search_space.free) == 10 and len(bogie.sensitivity_space.free) == 14


@pytest.mark.medium
def test_limits_of_sensitivity_and_search_differ_as_in_the_case_study():
    study = LoadedStudy.load(BOGIE)
    assert (study.sensitivity_space["K_rod_lower"].lower, study.sensitivity_space["K_rod_lower"].upper) == (20.0, 30.0)
    assert (study.search_space["K_rod_lower"].lower, study.search_space["K_rod_lower"].upper) == (10.0, 40.0)


@pytest.mark.slow
def test_a_copied_folder_works_anywhere(tmp_path, monkeypatch):
    shutil.copytree(BOGIE, tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    copy = LoadedStudy.load(Path("elsewhere"))
    assert copy.name == "elsewhere"
    assert copy.problem.fingerprint == LoadedStudy.load(BOGIE).problem.fingerprint


def test_held_out_modes_and_sensors_never_reach_the_problem(example):
    whole = LoadedStudy.load(example)
    edited(example, ("modes = []\nsensors = []  ", 'modes = ["B2x"]\nsensors = ["4x"]  '))
    part = LoadedStudy.load(example)
    assert part.measured.names == ("B1x", "B1z", "B2z")
    assert [s.name for s in part.measured.sensors] == [s.name for s in whole.measured.sensors if s.name != "4x"]
    assert set(part.problem.evaluate({})) < set(whole.problem.evaluate({}))
    assert part.problem.fingerprint != whole.problem.fingerprint


def test_a_study_edited_while_it_runs_is_refused(example):
    study = LoadedStudy.load(example)
    source = EvaluationSource(str(study.file), study.problem.fingerprint)
    assert source()({}) == study.problem.evaluate({})
    edited(example, ("mode_count = 6", "mode_count = 7"))
    with pytest.raises(InputError, match="changed while"):
        source()


def test_what_is_needed_of_a_parameter_is_a_key_of_the_study(example):
    assert LoadedStudy.load(example).search_space["K_base"].needed is None
    edited(example, ("# needed = 0.1", "needed = 0.1"))
    assert LoadedStudy.load(example).search_space["K_base"].needed == 0.1


BAD = [
    ("unknown key", ("[held_out]", "[held_out]\nmodez = []"), "unknown key 'held_out.modez'", "modes, sensors"),
    ("key of the file", ("[held_out]", "[held_out]\ndecks = []"), "'decks' is no key of [held_out]", "above the first"),
    ("key misspelt", ("selection = ", "selektion = "), "unknown key 'selektion'", "'selection'"),
    ("section misspelt", ("[measurement]", "[messurement]"), "unknown key 'messurement'", "'measurement'"),
    ("too many samples", ("samples = 200", "samples = 100000000000"), "sensitivity.samples", "1000000"),
    ("too large a population", ("population = 30", "population = 1000000000"), "calibration.population", "100000"),
    ("too many repeats", ("[measurement]", "[measurement]\nrepeats = 10000000000"), "measurement.repeats", "1000000"),
    ("too large a seed", ("seed = 1\n", "seed = 99999999999999999999\n"), "sensitivity.seed", "2147483648"),
    ("tiny prior", ("# prior_sd = 1.0", "prior_sd = 1e-300"), "prior_sd is 1e-300", "K_base"),
    ("huge prior", ("# prior_sd = 1.0", "prior_sd = 1e300"), "prior_sd is 1e+300", "K_base"),
    ("nothing needed", ("# needed = 0.1", "needed = 0.0"), "parameters.K_base.needed", "greater than 0"),
    ("endless need", ("# needed = 0.1", "needed = inf"), "needed", "K_base"),
    ("huge limit", ("limits = [0.3, 5.0]", "limits = [0.3, 1e308]"), "upper is 1e+308", "K_base"),
    ("long file name", ("modes.csv", "x" * 300 + ".csv"), "measurement.files", "255"),
    ("long model name", ("model.py:mast", "x" * 300 + ".py:mast"), "model", "255"),
    ("zero in a file name", ("modes.csv", "a\\u0000b.csv"), "measurement.files", "zero"),
    ("unknown parameter", ("[parameters.K_base]", "[parameters.K_bass]"), "unknown parameter 'K_bass'", "K_base"),
    ("limits reversed", ("limits = [0.3, 5.0]", "limits = [5.0, 0.3]"), "not below upper", "K_base"),
    ("search reversed", ("search = [0.2, 8.0]", "search = [8.0, 0.2]"), "not below upper", "K_base"),
    ("value outside", ("value = 2.0", "value = 20.0"), "outside its limits", "[0.3, 5]"),
    ("value not finite", ("value = 2.0", "value = nan"), "nan", "parameters.K_base.value"),
    ("unknown model", ("model.py:mast", "mudel.py:mast"), "mudel.py", "model"),
    ("unknown function", ("model.py:mast", "model.py:must"), "no function 'must'", "model"),
    ("unknown module", ("model.py:mast", "nowhere.at_all:mast"), "no module 'nowhere.at_all'", "model"),
    ("model without colon", ("model.py:mast", "model.py"), "model = 'model.py'", "file.py:function"),
    ("bad option", ("model_options = {}", "model_options = { colour = 1 }"), "model_options", "colour"),
    (
        "unknown selection",
        ('"m_top", "K_base"]', '"m_top", "K_best"]'),
        "unknown parameter 'K_best'",
        "E, m_top, K_base",
    ),
    ("empty selection", ('selection = ["E", "m_top", "K_base"]', "selection = []"), "no parameter is selected", ""),
    (
        "selection neither a list nor the words for it",
        ('selection = ["E", "m_top", "K_base"]', 'selection = "sensitivity"'),
        "a list or 'from sensitivity'",
        "'sensitivity'",
    ),
    ("missing file", ('files = ["modes.csv"]', 'files = ["mudes.csv"]'), "no file 'mudes.csv'", "relative"),
    ("missing section key", ("title = ", "# title = "), "'title' is missing", "add it"),
    ("too few modes", ("mode_count = 6", "mode_count = 2"), "mode_count is 2", "4 modes were measured"),
    ("unknown cluster", ('B2z = ["mast.z"]', 'B2z = ["mast.q"]'), "mast.q", "mast.x, mast.z"),
    ("unknown mode", ('B2z = ["mast.z"]', 'B9z = ["mast.z"]'), "'B9z'", "B1x"),
    ("unknown held_out", ("modes = []", 'modes = ["Q"]'), "'Q'", "B1x"),
    ("window reversed", ("freq_window = [0.5, 100.0]", "freq_window = [100.0, 0.5]"), "freq_window", "Hz"),
    ("twin cases", ('"A2", seed = 2', '"A1", seed = 2'), "two cases are named 'A1'", ""),
    ("no cases", ('{ name = "A1", seed = 1 },\n    { name = "A2", seed = 2 },', ""), "calibration.cases", ""),
    (
        "begin outside",
        ("[calibration]", "[calibration]\nbegin_at = { E = 900.0 }"),
        "outside its search limits",
        "E = 900",
    ),
    ("begin unselected", ("[calibration]", "[calibration]\nbegin_at = { h = 1.0 }"), "'h', which is not selected", ""),
    ("wrong type", ("population = 30", 'population = "many"'), "calibration.population", "many"),
    ("both weights zero", ("# weight_freq = 1.0", "weight_freq = 0.0"), "weights", ""),
    ("std without repeats", ('std_of = "mean"', 'std_of = "repeat"'), "repeats", ""),
    ("broken toml", ("[held_out]", "[held_out"), "not valid TOML", "line"),
    (
        "infeasible",
        (
            "[sensitivity]",
            '[[constraints]]\nname = "c"\ncoefficients = { m_top = 1.0 }\nlimits = [500, 600]\n[sensitivity]',
        ),
        "no point within the limits keeps the constraints",
        "widen",
    ),
]


@pytest.mark.parametrize(("change", "words", "more"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_bad_studies_are_refused_in_one_sentence_with_their_place(example, change, words, more):
    changes = [change] + ([("# weight_mac = 1.0", "weight_mac = 0.0")] if "weight_freq" in change[0] else [])
    said = complaint(edited(example, *changes))
    assert words in said and more in said
    assert str(example) in said
    assert "\n" not in said.strip() or "TOML" in said
    assert said.endswith(".")


def test_complaints_name_the_line(example):
    edited(example, ("population = 30", "population = -30"))
    lines = (example / "study.toml").read_text().splitlines()
    number = next(k for k, line in enumerate(lines, start=1) if "population" in line)
    assert re.search(rf"line {number}\b", complaint(example))


def test_a_missing_study_is_refused(tmp_path):
    assert "no such study file" in complaint(tmp_path)
    (tmp_path / "model.py").write_text("")
    assert "no such study file" in complaint(tmp_path / "model.py")


def test_a_failing_model_is_the_users_own_fault(example):
    (example / "model.py").write_text("def mast():\n    return 1 / 0\n")
    assert "ZeroDivisionError" in complaint(example)
    (example / "model.py").write_text("def mast():\n    return 7\n")
    assert "returns int" in complaint(example)
    (example / "model.py").write_text("import not_there_at_all\n")
    assert "not_there_at_all" in complaint(example)


def test_non_finite_matrices_are_told(example):
    text = (example / "model.py").read_text()
    (example / "model.py").write_text(
        text.replace('Term("antenna", diagonal(', "Term(\"antenna\", float('nan') * diagonal(")
    )
    assert "not finite" in complaint(example)


def test_a_sensor_off_the_model_is_told(example):
    text = (example / "sensors.csv").read_text()
    (example / "sensors.csv").write_text(text.replace("4,0.0,6.0,0.0", "4,0.0,9.0,0.0"))
    said = complaint(example)
    assert "node 4 by 3 m (limit 120 mm)" in said


def test_every_file_of_a_study_is_read_at_once(example):
    (example / "shapes.csv").write_text("mode,node,direction,re,im,std\nB1x,1,x,nan,0,0.1\n")
    assert "shapes.csv" in complaint(example)


def test_functions_are_models_too(tmp_path):
    (tmp_path / "model.py").write_text(
        "from calib.structure.function_model import FunctionModel\n"
        "from calib.problem.space import Parameter, ParameterSpace\n"
        "def build():\n"
        "    space = ParameterSpace((Parameter('a', 1.0, 0.0, 3.0), Parameter('b', 1.0, 0.0, 3.0)))\n"
        "    return FunctionModel('sums', space, lambda v: {'s': v['a'] + v['b'], 'p': v['a'] - v['b']})\n"
    )
    (tmp_path / "measured.csv").write_text("response,value,std\ns,3.0,0.01\np,1.0,\n")
    (tmp_path / "study.toml").write_text(
        'title = "sums"\nmodel = "model.py:build"\nselection = ["a", "b"]\n[measurement]\nresponses = "measured.csv"\n'
        '[calibration]\ncases = [{ name = "F1", seed = 1 }]\n'
    )
    study = LoadedStudy.load(tmp_path)
    assert study.problem.evaluate({"a": 2.0}) == {"s": 3.0, "p": 1.0}
    assert study.targets == {"s": (3.0, 0.01), "p": (1.0, None)}
    (tmp_path / "measured.csv").write_text("response,value,std\ns,x,0.01\n")
    assert "not a number" in complaint(tmp_path)
