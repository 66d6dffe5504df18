"""Mistakes in the user's files: the error carries file, line and column of what is wrong.

The wrong text of every mistake stands between ⟦ and ⟧, which are taken out of the file; ⟦⟧ marks a line of which no
column is known.
"""

import pickle
from dataclasses import dataclass
from pathlib import Path

import pytest

import calib
from calib import cli
from calib.errors import InputError
from calib.evaluate import Evaluator
from calib.executor import ExecutorEvaluator
from calib.measurement.read import read_modes
from calib.place import Place
from calib.study import EvaluationSource, Study

LOG = Path("calib-error.log")


@dataclass(frozen=True)
class Expected:
    """Where the mistake was put."""

    file: Path
    line: int
    text: str
    column: int | None
    marked: str


def put(file: Path, *changes: tuple[str, str]) -> Expected:
    """Make the changes of a file and return the marked place."""
    text = file.read_text("utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return marked(file, text)


def marked(file: Path, text: str) -> Expected:
    before, _, rest = text.partition("⟦")
    wrong, _, after = rest.partition("⟧")
    clean = before + wrong + after
    file.write_text(clean, "utf-8")
    line = before.count("\n") + 1
    own = clean.split("\n")[line - 1].rstrip()
    return Expected(file, line, own, len(before) - before.rfind("\n") if wrong else None, wrong)


def check(at: Place | None, expected: Expected) -> None:
    assert at is not None
    assert Path(at.file).resolve() == expected.file.resolve()
    assert (at.line, at.text.rstrip()) == (expected.line, expected.text)
    if expected.column is None:
        assert at.column is None
    else:
        assert at.column == expected.column
        assert at.text[at.column - 1 : at.column - 1 + at.length] == expected.marked


@pytest.fixture
def in_this_process(monkeypatch):
    """The study's function is evaluated in this process, not in a child."""
    monkeypatch.setattr("calib.front.study.isolated", lambda study: study)


def refused(folder: Path, act=Study.load) -> InputError:
    with pytest.raises(InputError) as caught:
        act(folder)
    fault = caught.value
    copy = pickle.loads(pickle.dumps(fault))  # as on the way from a worker process
    assert (copy.at, copy.sentence, str(copy)) == (fault.at, fault.sentence, str(fault))
    assert copy.__notes__ == fault.__notes__ and len(fault.__notes__) == 1
    return fault


# -- study.toml --------------------------------------------------------------------------------------------------------

KEYS = {
    "key misspelt": [("samples = 200", "⟦samplez⟧ = 200")],
    "section misspelt": [("[sensitivity]", "⟦[sensitivty]⟧")],
    "former key": [("[held_out]", "⟦[withheld]⟧")],
    "text for an integer": [("population = 30", 'population = ⟦"many"⟧')],
    "fraction for an integer": [("population = 30", "population = ⟦30.5⟧")],
    "text for a number": [("threshold = 0.3", 'threshold = ⟦"high"⟧')],
    "number for a list": [('selection = ["E", "m_top", "K_base"]', "selection = ⟦3⟧")],
    "number in a list of names": [("modes = []", "modes = [⟦3⟧]")],
    "wrong type in a list of tables": [('{ name = "A2", seed = 2 }', '{ name = "A2", seed = ⟦"one"⟧ }')],
    "unknown key in an inline table": [('{ name = "A2", seed = 2 }', '{ name = "A2", ⟦sead⟧ = 2, seed = 2 }')],
    "missing key in a list of tables": [('{ name = "A2", seed = 2 }', '⟦{ name = "A2" }⟧')],
    "cases of one name": [('"A2", seed', '"A1", seed'), ("cases = [", "cases = ⟦[⟧")],
    "number out of range": [("threshold = 0.3", "threshold = ⟦1.5⟧")],
    "limits reversed": [("limits = [0.3, 5.0]", "limits = ⟦[5.0, 0.3]⟧")],
    "search reversed": [("search = [0.2, 8.0]", "search = ⟦[8.0, 0.2]⟧")],
    "value outside its limits": [("value = 2.0", "value = ⟦20.0⟧")],
    "prior too small": [("# prior_sd = 1.0", "prior_sd = ⟦1e-300⟧")],
    "unknown parameter": [("[parameters.K_base]", "⟦[parameters.K_bass]⟧")],
    "unknown parameter selected": [('"m_top", "K_base"]', '"m_top", ⟦"K_best"⟧]')],
    "begin outside": [("population = 30", "begin_at = { E = ⟦900.0⟧ }\npopulation = 30")],
    "begin of another parameter": [("population = 30", "begin_at = { K_bass = ⟦1.0⟧ }\npopulation = 30")],
    "unknown mode held out": [("modes = []", 'modes = ["B1x", ⟦"B9x"⟧]')],
    "unknown sensor held out": [("sensors = []", 'sensors = [⟦"99x"⟧]')],
    "clusters of an unknown mode": [('B2z = ["mast.z"]', '⟦B9z⟧ = ["mast.z"]')],
    "unknown cluster": [('B2z = ["mast.z"]', 'B2z = ["mast.x", ⟦"mast.q"⟧]')],
    "override of an unknown mode": [("override = {}", 'override = { B1x = 1, ⟦"B 9"⟧ = 2 }')],
    "window reversed": [("freq_window = [0.5, 100.0]", "freq_window = ⟦[100.0, 0.5]⟧")],
    "too few modes": [("mode_count = 6", "mode_count = ⟦2⟧")],
    "weights zero": [("weight_freq = 1.0", "weight_freq = ⟦0.0⟧"), ("weight_mac = 1.0", "weight_mac = 0.0")],
    "file missing": [('shapes = ["shapes.csv"]', 'shapes = [⟦"shape.csv"⟧]')],
    "file of results missing": [("depends_on = []", 'depends_on = ["model.py", ⟦"deck.inp"⟧]')],
    "no such function": [('model = "model.py:mast"', 'model = ⟦"model.py:must"⟧')],
    "no such model file": [('model = "model.py:mast"', 'model = ⟦"mudel.py:mast"⟧')],
    "options that the model does not take": [("model_options = {}", "model_options = ⟦{ colour = 1 }⟧")],
    "effect without library": [("depends_on = []", 'with_effects = ⟦["lamp"]⟧')],
    "unknown parameter constrained": [
        (
            "[sensitivity]",
            "[[constraints]]\nname = 'c'\nlimits = [0, 1]\ncoefficients = { ⟦m_tip⟧ = 1.0 }\n[sensitivity]",
        )
    ],
    "limits of a constraint reversed": [
        (
            "[sensitivity]",
            "[[constraints]]\nname = 'c'\nlimits = ⟦[9, 1]⟧\ncoefficients = { m_top = 1.0 }\n[sensitivity]",
        )
    ],
    "base missing": [('title = "', 'base = ⟦"../none"⟧\ntitle = "')],
}
SYNTAX = {
    "header not closed": [("[held_out]  ", "[held_out⟦⟧  ")],
    "text not closed": [('std_of = "mean"  ', 'std_of = "mean⟦⟧  ')],
    "key twice": [("samples = 200", "samples = 200\nsamples⟦⟧ = 100")],
    "no value": [("samples = 200", "samples =⟦⟧ # ")],
}


def example(folder: Path) -> Path:
    cli.write_example(folder)
    return folder


@pytest.mark.parametrize("changes", KEYS.values(), ids=KEYS)
def test_mistakes_in_a_study(tmp_path, changes):
    folder = example(tmp_path / "mast")
    expected = put(folder / "study.toml", *changes)
    check(refused(folder).at, expected)


@pytest.mark.parametrize("changes", SYNTAX.values(), ids=SYNTAX)
def test_a_study_that_is_no_toml(tmp_path, changes):
    folder = example(tmp_path / "mast")
    expected = put(folder / "study.toml", *changes)
    at = refused(folder).at
    assert at is not None and (at.line, at.text.rstrip()) == (expected.line, expected.text)
    assert 1 <= at.column <= len(at.text) + 1  # where the parser stopped


def test_a_study_whose_last_lines_are_missing(tmp_path):
    folder = example(tmp_path / "mast")
    text = (folder / "study.toml").read_text("utf-8")
    (folder / "study.toml").write_text(text[: text.index('"A2"')], "utf-8")
    at = refused(folder).at
    assert at is not None and at.text.strip() == "{ name ="


def test_a_study_in_another_encoding(tmp_path):
    folder = example(tmp_path / "mast")
    text = (folder / "study.toml").read_text("utf-8").replace("a mast with", "a ümlaut é")
    (folder / "study.toml").write_bytes(text.encode("utf-8").replace("é".encode(), b"\xe9"))
    at = refused(folder).at
    assert at is not None and at.line == 3 and at.text[at.column - 1] == "\ufffd" and "ümlaut" in at.text


def test_a_key_of_the_study_below(tmp_path):
    example(tmp_path / "mast")
    expected = put(tmp_path / "mast/study.toml", ("limits = [0.3, 5.0]", "limits = ⟦[5.0, 0.3]⟧"))
    (tmp_path / "above").mkdir()
    (tmp_path / "above/study.toml").write_text('base = "../mast"\n[parameters.K_base]\nvalue = 1.0\n')
    check(refused(tmp_path / "above").at, expected)


TESTS = """title = "Two"
model = "model.py:model"
selection = ["a", "b"]
[[tests]]
name = "one"
responses = "measured.csv"
[[tests]]
name = "two"
responses = "measured.csv"
"""


@pytest.mark.parametrize(
    "lines",
    [
        "held_out = { responses = [⟦'q'⟧] }",
        "set = { ⟦c⟧ = 1.0 }",
        "set = { c = ⟦'x'⟧ }",
        "[tests.held_out]\nresponses = ['y', ⟦'q'⟧]",
        "accuracy = ⟦3.0⟧",
        "[tests.pairing]\n⟦treshold⟧ = 0.1",
    ],
)
def test_a_key_of_one_of_several_tests(plain, lines):
    folder = plain(SOUND)
    expected = marked(folder / "study.toml", TESTS + lines + "\n[calibration]\nstarts = 2\n")
    check(refused(folder, load_all).at, expected)


def test_what_no_test_has_is_shown_where_it_is_named(plain):
    folder = plain(SOUND)
    expected = marked(folder / "study.toml", TESTS.replace('"b"]', '⟦"c"⟧]'))
    check(refused(folder, load_all).at, expected)


# -- tables ------------------------------------------------------------------------------------------------------------

ENTRIES = {
    "letter in a number": ("modes.csv", "B1x,1.7117", "B1x,⟦1.7i17⟧"),
    "not a number": ("shapes.csv", "B1x,1,x,-0.13315", "B1x,1,x,⟦nan⟧"),
    "empty entry": ("modes.csv", "B1x,1.7117,natural", "B1x,⟦,⟧natural"),
    "blank entry": ("modes.csv", "B1x,1.7117,natural", "B1x,⟦ ⟧  ,natural"),
    "column missing": ("modes.csv", "mode,freq,freq_kind", "⟦⟧mode,freq"),
    "column misspelt": ("modes.csv", "freq,freq_kind,freq_std", "freq,freq_kind,⟦freq_sdt⟧"),
    "column twice": ("modes.csv", "damping,damping_std", "damping,⟦damping⟧"),
    "entry too many": ("shapes.csv", "B1x,1,x,-0.13315,0,0.02", "B1x,1,x,-0.13315,0,0.02, ⟦7⟧"),
    "mode twice": ("modes.csv", "B1z,", "⟦B1x⟧,"),
    "unknown mode": ("shapes.csv", "B1x,1,x", "⟦B7x⟧,1,x"),
    "unknown direction": ("shapes.csv", "B1x,1,x,", "B1x,1,⟦q⟧,"),
    "sensor twice": ("shapes.csv", "B1x,1,z,", "B1x,1,⟦x⟧,"),
    "no node": ("shapes.csv", "B1x,1,z,", "B1x,⟦1.5⟧,z,"),
    "node twice": ("sensors.csv", "4,0.0,6.0", "⟦3⟧,0.0,6.0"),
    "frequency of the wrong kind": ("modes.csv", "B1x,1.7117,natural", "B1x,1.7117,⟦undamped⟧"),
    "damping in percent": ("modes.csv", "natural,0.0051,0.004", "natural,0.0051,⟦4.0⟧"),
    "deviation too large": ("modes.csv", "natural,0.0051", "natural,⟦5.1⟧"),
    "sensor off the model": ("sensors.csv", "4,0.0,6.0,0.0", "⟦4⟧,0.0,9.0,0.0"),
    "quoted entry": ("modes.csv", "B1x,1.7117", '"B1,x""",  ⟦"1,7"⟧'),
    "not printable": ("modes.csv", "B1x,1.7117", "B1x,⟦\x07⟧1.7117"),
    "quotes not closed": ("modes.csv", "B1x,1.7117", 'B1x,⟦"⟧1.7117'),
}


@pytest.mark.parametrize(("name", "old", "new"), ENTRIES.values(), ids=ENTRIES)
def test_mistakes_in_a_table(tmp_path, name, old, new):
    folder = example(tmp_path / "mast")
    expected = put(folder / name, (old, new))
    check(refused(folder).at, expected)


def test_a_missing_entry_is_marked_behind_the_line(tmp_path):
    folder = example(tmp_path / "mast")
    expected = put(folder / "shapes.csv", ("B1x,1,x,-0.13315,0,0.02", "B1x,1,x,-0.13315,0⟦⟧"))
    at = refused(folder).at
    assert at is not None and (at.line, at.text, at.column) == (expected.line, expected.text, len(expected.text) + 1)


def test_a_table_from_a_spreadsheet(plain):
    folder = plain(SOUND)
    text = '\ufeffsep=;\r\nresponse;value;std\r\n"y; z";3,0;0,1\r\nz;1.0;0,1\r\n'
    (folder / "measured.csv").write_text(text, "utf-8", newline="")
    at = refused(folder).at
    assert at is not None and (at.line, at.text, at.column, at.length) == (4, "z;1.0;0,1", 3, 3)


def test_a_byte_of_another_encoding(tmp_path):
    folder = example(tmp_path / "mast")
    data = (folder / "modes.csv").read_bytes().replace(b"B1x", b"B\xb0x")
    (folder / "modes.csv").write_bytes(data)
    at = refused(folder).at
    assert at is not None and at.column == 2 and at.text.startswith("B\ufffdx")


# -- universal files ---------------------------------------------------------------------------------------------------


@pytest.fixture
def universal(tmp_path) -> Path:
    from numpy import array

    from calib.measurement.modal import Sensor
    from calib.measurement.uff import write_uff

    path = tmp_path / "one.uff"
    sensors = [Sensor(n, "z", (float(n), 0.0, 0.0)) for n in (1, 2)]
    shapes = array([[1.0 + 0.5j], [0.25 - 0.125j]])
    write_uff(
        path, names=("1B",), natural_freq=array([5.0]), damping_ratio=array([0.01]), sensors=sensors, shapes=shapes
    )
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2.50000e-01", "⟦2.50000e-0l⟧"),
        ("2.50000e-01", "⟦nan⟧"),
        ("    -1\n    -1\n    15", "    -1\n⟦⟧rubbish\n    -1\n    15"),
        ("    -1\n    55 ", "    -1\n⟦⟧    5B "),
    ],
)
def test_a_damaged_dataset(universal, old, new):
    expected = put(universal, (old, new))
    check(refused(universal, read_modes).at, expected)


def test_a_truncated_file_is_shown_where_its_last_dataset_begins(universal):
    lines = universal.read_text().splitlines()
    universal.write_text("\n".join(lines[:-1]) + "\n")
    at = refused(universal, read_modes).at
    assert at is not None and lines[at.line - 1].strip() == "-1" and lines[at.line].strip() == "55"


def test_a_dataset_without_a_wrong_entry_is_shown_by_its_number(universal):
    text = universal.read_text()
    node = next(line for line in text.splitlines() if line.endswith("2.00000E+00  0.00000E+00  0.00000E+00"))
    universal.write_text(text.replace(node, node.replace("         2 ", "         1 ", 1)))  # node 1 has two places
    at = refused(universal, read_modes).at
    assert at is not None and at.text.strip() == "15" and text.splitlines()[at.line - 1].strip() == "15"


# -- the user's own code -----------------------------------------------------------------------------------------------

SOUND = "def answer(values):\n    return {'y': values['a'], 'z': values['b']}\n"
RETURN = '    return FunctionModel("plain", SPACE, answer)'


def load_all(folder):
    return calib.Study.load(folder).loaded


def compare(folder):
    calib.Study.load(folder).compare()


BUILDING = {
    "exception": (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"),
    "exception of a library": (RETURN, f"    ⟦np.linalg.inv(np.zeros((2, 2)))⟧\n{RETURN}"),
    "exception of several lines": (RETURN, f"    x = ⟦float(⟧\n        'text')\n{RETURN}"),
    "exit": (RETURN, f"    ⟦raise SystemExit(3)⟧\n{RETURN}"),
    "at import": ("import numpy as np", "import numpy as np\nx = ⟦{}['é']⟧"),
    "after letters of two bytes": ("import numpy as np", "import numpy as np\nx = 'ßß', ⟦{}['é']⟧"),
    "limits reversed in the model": ('Parameter("b", 2.0, 1.0, 3.0)', '⟦Parameter("b", 2.0, 3.0, 1.0)⟧'),
    "unknown unit in the model": ('Parameter("b", 2.0, 1.0, 3.0)', '⟦Parameter("b", 2.0, 1.0, 3.0, "furlong")⟧'),
    "wrong syntax": ("import numpy as np", "import numpy as np\nx = 3 ⟦6⟧"),
    "bracket not closed": ("import numpy as np", "import numpy as np\nx = ⟦(⟧3"),
    "wrong indentation": (RETURN, f"    x = 1\n     ⟦ ⟧{RETURN.strip()}"),
    "no such module": ("import numpy as np", "⟦import nowhere_at_all⟧\nimport numpy as np"),
    "no such name": ("import numpy as np", "⟦from math import nothing⟧\nimport numpy as np"),
    "no model": (RETURN, "    return 3", "def model():", "def ⟦model⟧():"),
}


@pytest.mark.parametrize("changes", BUILDING.values(), ids=BUILDING)
def test_mistakes_in_a_model(plain, changes):
    folder = plain(SOUND)
    pairs = list(zip(changes[::2], changes[1::2], strict=True))
    expected = put(folder / "model.py", *pairs)
    at = refused(folder).at
    check(at, expected)


def test_a_mistake_in_a_module_beside_the_model(plain):
    folder = plain(SOUND)
    put(folder / "model.py", ("import numpy as np", "import numpy as np\nimport beside"))
    expected = marked(folder / "beside.py", "def half(x):\n    return ⟦x / 0⟧\n\nhalf(3)\n")
    check(refused(folder).at, expected)


EVALUATING = {
    "exception": "def answer(values):\n    return {'y': ⟦values['c']⟧}\n",
    "exception of a library": "def answer(values):\n    ⟦np.linalg.inv(np.zeros((2, 2)))⟧\n",
    "own refusal": "from calib.errors import EvaluationError\ndef answer(values):\n    ⟦raise EvaluationError('no')⟧\n",
    "NaN": "def ⟦answer⟧(values):\n    return {'y': np.nan, 'z': 1.0}\n",
    "infinite": "@staticmethod\ndef ⟦answer⟧(values):\n    return {'y': np.inf, 'z': 1.0}\n",
    "response missing": "def ⟦answer⟧(values):\n    return {'y': 1.0}\n",
    "text": "def ⟦answer⟧(values):\n    return {'y': 1.0, 'z': 'one'}\n",
    "no responses": "def ⟦answer⟧(values):\n    return 3.0\n",
    "lambda": "⟦⟧answer = lambda values: {'y': 1.0}\n",
    "partial": (
        "import functools\ndef ⟦any_of⟧(values, x):\n    return {'y': x}\nanswer = functools.partial(any_of, x=1.0)\n"
    ),
    "object": ("class Solver:\n    def ⟦__call__⟧(self, values):\n        return {'y': 1.0}\nanswer = Solver()\n"),
}


@pytest.mark.parametrize("function", EVALUATING.values(), ids=EVALUATING)
def test_mistakes_while_a_model_is_evaluated(plain, in_this_process, function):
    folder = plain("")
    expected = put(folder / "model.py", ("SPACE = ", "SPACE = "), ("\n\n\n\n", f"\n\n{function}\n"))
    check(refused(folder, compare).at, expected)


@pytest.mark.parametrize("kind", ["exception", "NaN"])
def test_the_line_comes_from_the_child_process_and_from_the_ledger(plain, kind):
    folder = plain("")
    expected = put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING[kind]}\n"))
    for _ in range(2):  # the second time the ledger knows that the point fails
        check(refused(folder, compare).at, expected)


@pytest.mark.parametrize("kind", ["exception", "own refusal", "NaN"])
def test_the_line_comes_from_worker_processes(plain, kind):
    folder = plain("")
    expected = put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING[kind]}\n"))
    study = Study.load(folder)
    with Evaluator(EvaluationSource.of(study, study.problem), 2) as evaluator:
        outcomes = evaluator.evaluate([{"a": 1.5}, {"a": 2.5}])
    assert {o.status for o in outcomes} == {"failed"}
    for outcome in outcomes:
        check(outcome.at, expected)


def test_the_line_comes_from_a_given_executor(plain):
    from concurrent.futures import ThreadPoolExecutor

    folder = plain("")
    expected = put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING['exception']}\n"))
    study = Study.load(folder)
    with ThreadPoolExecutor(1) as pool:
        (outcome,) = ExecutorEvaluator(EvaluationSource.of(study, study.problem), pool).evaluate([{"a": 1.5}])
    check(outcome.at, expected)


def test_a_model_that_cannot_be_built_in_a_worker(plain):
    folder = plain(SOUND)
    study = Study.load(folder)
    expected = put(folder / "model.py", (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"))
    with (
        Evaluator(EvaluationSource.of(study, study.problem), 2) as evaluator,
        pytest.raises(InputError) as caught,
    ):
        evaluator.evaluate([{"a": 1.5}])
    check(caught.value.at, expected)


MODAL = """
import numpy as np
from calib.structure.modal_function import ModalFunctionModel
from calib.space import Parameter, ParameterSpace

def ⟦string⟧(values):
    RESULT

def model():
    space = ParameterSpace((Parameter("line", 0.02, 0.01, 0.05, "kg/m"),))
    return ModalFunctionModel("string", space, string, sensors=["1z", "2z"], n_modes=2)
"""


@pytest.mark.parametrize(
    "result",
    [
        "return [1.0, 2.0], np.ones((3, 2))",
        "return [1.0, np.nan], np.eye(2)",
        "return [2.0, 1.0], np.eye(2)",
        "return [1.0], np.ones((2, 1))",
        "return {'natural_freq': [1.0, 2.0]}",
    ],
)
def test_modes_that_do_not_fit(plain, in_this_process, result):
    folder = plain(SOUND)
    (folder / "modes.csv").write_text("mode,freq,freq_kind,freq_std\nM1,1.0,natural,0.01\nM2,2.0,natural,0.01\n")
    (folder / "study.toml").write_text(
        "title = 'String'\nmodel = 'model.py:model'\n[measurement]\nfiles = ['modes.csv']\n"
    )
    expected = marked(folder / "model.py", MODAL.replace("RESULT", result))
    check(refused(folder, compare).at, expected)


EFFECTS = """
from calib.effect import Effect
from calib.space import Parameter

def build(model):
    BODY

def library():
    magnitude = Parameter("bend", 0.0, -1.0, 1.0, prior_sd=0.5)
    return (Effect("bend", "a bend", "It is straight.", "Bends.", magnitude, build),)
"""


@pytest.mark.parametrize(
    ("changes", "act"),
    [
        ((("BODY", "return ⟦model.nothing⟧"),), Study.load),
        ((("BODY", "return 3"), ("def build", "def ⟦build⟧")), Study.load),
        ((("BODY", "pass"), ("-1.0, 1.0", "1.0, -1.0"), ("Parameter(\"bend", "⟦Parameter(\"bend"),
          ("sd=0.5)", "sd=0.5)⟧")), Study.load),
        ((("BODY", "pass"), ("return (Effect", "return [Effect"), (", build),)", ", build)]"),
          ("def library", "def ⟦library⟧")), Study.load),
        ((("BODY", "return lambda values: ⟦values['gone']⟧"),), compare),
        ((("BODY", "def ⟦bent⟧(values):\n        return {'y': 1.0}\n    return bent"),), compare),
        ((("BODY", "def ⟦bent⟧(values):\n        return {'y': 1.0, 'z': float('nan')}\n    return bent"),), compare),
    ],
)  # fmt: skip
def test_mistakes_in_an_effect(plain, changes, act):
    folder = plain(SOUND)
    put(folder / "study.toml", ("title", 'effects = "effects.py:library"\nwith_effects = ["bend"]\ntitle'))
    (folder / "effects.py").write_text(EFFECTS)
    expected = put(folder / "effects.py", *changes)
    check(refused(folder, act).at, expected)


@pytest.mark.parametrize(
    ("body", "isolated"),
    [
        ("return lambda values: {'y1': ⟦values['gone']⟧}", True),
        ("return lambda values: {'y1': ⟦values['gone']⟧}", False),
        ("def ⟦bent⟧(values):\n        return {'y1': 0.0}\n    return bent", True),
        ("return lambda values: {name: 2 * y for name, y in model.function(values).items()}", True),
        ("return lambda values: {name: 2 * y for name, y in model.function(values).items()}", False),
    ],
)
def test_mistakes_in_an_effect_of_the_library(plain, request, body, isolated):
    """It fails everywhere, or changes the model even at magnitude 0."""
    if not isolated:
        request.getfixturevalue("in_this_process")
    folder = plain("def answer(values):\n    return {f'y{k}': values['a'] * k + values['b'] for k in range(1, 6)}\n")
    made_up = "".join(f"y{k},{y},0.01\n" for k, y in enumerate((3.2, 5.5, 7.1, 9.9, 16.0), start=1))
    (folder / "measured.csv").write_text(f"response,value,std\n{made_up}")
    put(folder / "study.toml", ("title", 'effects = "effects.py:library"\ntitle'))
    (folder / "effects.py").write_text(EFFECTS)
    whole = [] if "⟦" in body else [("def build", "def ⟦build⟧")]
    expected = put(folder / "effects.py", ("BODY", body), *whole)
    check(refused(folder, lambda f: calib.Study.load(f).explain()).at, expected)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("return Addition(", "return ⟦3 / 0⟧, Addition("),
        ("sp.csr_array(np.diag(np.eye(4)[storey]))", "sp.csr_array(np.eye(5))"),
    ],
)
def test_mistakes_in_an_effect_of_matrices(tmp_path, old, new):
    import shutil

    root = Path(__file__).parents[2]
    shutil.copytree(root / "studies/four_storey_rig", tmp_path / "rig", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "tests/template/rig_effects.py", tmp_path / "rig/effects.py")
    head = 'effects = "effects.py:library"\nwith_effects = ["top_cables"]\n'
    file = tmp_path / "rig/study.toml"
    file.write_text(head + file.read_text("utf-8"), "utf-8")
    effects = tmp_path / "rig/effects.py"
    if "⟦" in new:
        expected = put(
            effects, ("    return lambda model: Addition(", "    return lambda model: (⟦1 / 0⟧) or Addition(")
        )
    else:
        expected = put(effects, (old, new), ("    return lambda model", "⟦⟧    return lambda model"))
    check(refused(tmp_path / "rig").at, expected)


# -- on the screen -----------------------------------------------------------------------------------------------------


def test_the_command_shows_sentence_file_line_and_mark(tmp_path, monkeypatch, capsys, one_sentence):
    monkeypatch.chdir(tmp_path)
    example(Path("mast"))
    expected = put(Path("mast/study.toml"), ("population = 30", 'population = ⟦"many"⟧'))
    assert cli.execute(["compare", "mast"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and not LOG.exists()
    _, where, line, mark = said.splitlines()
    assert where == f"  mast/study.toml, line {expected.line}"
    assert line == f"  {expected.line} | {expected.text}"
    assert mark.count("^") == len('"many"') and mark.index("^") == line.index('"many"')


def test_an_exception_keeps_its_traceback_in_the_log(plain, capsys, one_sentence):
    folder = plain(SOUND)
    expected = put(folder / "model.py", (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"))
    assert cli.execute(["compare", "plain"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "ZeroDivisionError: division by zero" in said and str(LOG) in said
    assert said.splitlines()[1:3] == [f"  plain/model.py, line {expected.line}", f"  {expected.line} |     1 / 0"]
    assert "Traceback" in LOG.read_text() and "1 / 0" in LOG.read_text()


def test_nothing_is_shown_where_there_is_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["compare", "nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert InputError("a", place="workers").at is None and not hasattr(InputError("a", place="workers"), "__notes__")
