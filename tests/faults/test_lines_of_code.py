"""Mistakes in the user's own code: the error carries the line that raised it, or that defines what is wrong."""

import linecache
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import calib
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.errors.own_code import defined_at, raised_at
from calib.errors.place import Place
from calib.execution.evaluate import Evaluator
from calib.execution.executor import ExecutorEvaluator
from calib.study.study import EvaluationSource, LoadedStudy

ROOT = Path(__file__).parents[2]
SOUND = "def answer(values):\n    return {'y': values['a'], 'z': values['b']}\n"
RETURN = '    return FunctionModel("plain", SPACE, answer)'


@pytest.fixture
def in_this_process(monkeypatch):
    """The study's function is evaluated in this process, not in a child."""
    monkeypatch.setattr("calib.api.staged.isolated", lambda study: study)


def compare(folder):
    calib.Study.load(folder).compare()


BUILDING = {
    "exception": (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"),
    "exception of a library": (RETURN, f"    ⟦np.linalg.inv(np.zeros((2, 2)))⟧\n{RETURN}"),
    "exception of several lines": (RETURN, f"    x = ⟦float(⟧\n        'text')\n{RETURN}"),
    "exit": (RETURN, f"    ⟦raise SystemExit(3)⟧\n{RETURN}"),
    "no word at import": ("import numpy as np", "import numpy as np\n⟦raise ImportError()⟧"),
    "exit at import": ("import numpy as np", "import numpy as np\n⟦raise SystemExit⟧"),
    "no Exception": ("import numpy as np", "import numpy as np\n⟦raise type('E', (BaseException,), {})⟧"),
    "a text that cannot be made": (
        "import numpy as np",
        "import numpy as np\n⟦raise type('E', (Exception,), {'__str__': lambda self: 1 / 0})⟧",
    ),
    "at import": ("import numpy as np", "import numpy as np\nx = ⟦{}['é']⟧"),
    "after letters of two bytes": ("import numpy as np", "import numpy as np\nx = 'ßß', ⟦{}['é']⟧"),
    "limits reversed in the model": ('Parameter("b", 2.0, 1.0, 3.0)', '⟦Parameter("b", 2.0, 3.0, 1.0)⟧'),
    "limits reversed in its function": (RETURN, f'    ⟦Parameter("c", 2.0, 3.0, 1.0)⟧\n{RETURN}'),
    "unknown unit in the model": ('Parameter("b", 2.0, 1.0, 3.0)', '⟦Parameter("b", 2.0, 1.0, 3.0, "furlong")⟧'),
    "wrong syntax": ("import numpy as np", "import numpy as np\nx = 3 ⟦6⟧"),
    "bracket not closed": ("import numpy as np", "import numpy as np\nx = ⟦(⟧3"),
    "wrong indentation": (RETURN, f"    x = 1\n     ⟦ ⟧{RETURN.strip()}"),
    "no such module": ("import numpy as np", "⟦import nowhere_at_all⟧\nimport numpy as np"),
    "no such name": ("import numpy as np", "⟦from math import nothing⟧\nimport numpy as np"),
    "no model": (RETURN, "    return 3", "def model():", "def ⟦model⟧():"),
}


@pytest.mark.parametrize("changes", BUILDING.values(), ids=BUILDING)
def test_mistakes_in_a_model(plain, changes, mistakes):
    folder = plain(SOUND)
    pairs = list(zip(changes[::2], changes[1::2], strict=True))
    expected = mistakes.put(folder / "model.py", *pairs)
    at = mistakes.refused(folder).at
    mistakes.check(at, expected)


def test_an_option_that_a_model_refuses_is_shown_where_it_is_given(plain, mistakes):
    folder = plain(SOUND)
    refusal = f"    if size < 0:\n        raise InputError('size is negative', place='size')\n{RETURN}"
    mistakes.put(
        folder / "model.py",
        ("import numpy as np", "import numpy as np\nfrom calib.errors.errors import InputError"),
        ("def model():", "def model(size):"),
        (RETURN, refusal),
    )
    expected = mistakes.put(folder / "study.toml", ("selection", "model_options = ⟦{ size = -1 }⟧\nselection"))
    mistakes.check(mistakes.refused(folder).at, expected)


def test_an_option_that_a_shipped_model_refuses(tmp_path, mistakes):
    shutil.copytree(ROOT / "studies/hidden_effect", tmp_path / "car", ignore=shutil.ignore_patterns("__pycache__"))
    expected = mistakes.put(tmp_path / "car/study.toml", ('{ seats = "rigid" }', '⟦{ seats = "soft" }⟧'))
    mistakes.check(mistakes.refused(tmp_path / "car").at, expected)


def test_a_mistake_in_the_use_of_shipped_elements(tmp_path, mistakes):
    write_example(tmp_path / "mast")
    section = "from models.fem.section import Section\nTUBE = ⟦Section(4e-3, 4e-6, 7e-6, 6e-6, density=-7850.0)⟧"
    expected = mistakes.put(tmp_path / "mast/model.py", ("import numpy as np", f"import numpy as np\n{section}"))
    mistakes.check(mistakes.refused(tmp_path / "mast").at, expected)


@pytest.mark.parametrize("name", ["/tmp/ipykernel_7/1234567.py", "<ipython-input-3-0a1b2c3d>"])
def test_a_cell_of_a_notebook(name, monkeypatch):
    """Its source stands in no file."""
    source = "def half(x):\n    return x / 0\n"
    monkeypatch.setitem(linecache.cache, name, (len(source), None, source.splitlines(keepends=True), name))
    names = {}
    exec(compile(source, name, "exec"), names)
    with pytest.raises(ZeroDivisionError) as caught:
        names["half"](1.0)
    assert raised_at(caught.value) == Place(name, 2, "    return x / 0", 12, 5)
    assert defined_at(names["half"]) == Place(name, 1, "def half(x):", 5, 4)
    assert defined_at(len) is None and defined_at(shutil.copy) is None and defined_at(LoadedStudy.load) is None


def test_a_mistake_in_a_module_beside_the_model(plain, mistakes):
    folder = plain(SOUND)
    mistakes.put(folder / "model.py", ("import numpy as np", "import numpy as np\nimport beside"))
    expected = mistakes.marked(folder / "beside.py", "def half(x):\n    return ⟦x / 0⟧\n\nhalf(3)\n")
    mistakes.check(mistakes.refused(folder).at, expected)


EVALUATING = {
    "exception": "def answer(values):\n    return {'y': ⟦values['c']⟧}\n",
    "exception of a library": "def answer(values):\n    ⟦np.linalg.inv(np.zeros((2, 2)))⟧\n",
    "own refusal": "from calib import EvaluationError\ndef answer(values):\n    ⟦raise EvaluationError('no')⟧\n",
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
def test_mistakes_while_a_model_is_evaluated(plain, in_this_process, function, mistakes):
    folder = plain("")
    expected = mistakes.put(folder / "model.py", ("\n\n\n\n", f"\n\n{function}\n"))
    mistakes.check(mistakes.refused(folder, compare).at, expected)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["exception", "NaN"])
def test_the_line_comes_from_the_child_process_and_from_the_ledger(plain, kind, mistakes):
    folder = plain("")
    expected = mistakes.put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING[kind]}\n"))
    for _ in range(2):  # the second time the ledger knows that the point fails
        mistakes.check(mistakes.refused(folder, compare).at, expected)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["exception", "own refusal", "NaN"])
def test_the_line_comes_from_worker_processes(plain, kind, mistakes):
    folder = plain("")
    expected = mistakes.put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING[kind]}\n"))
    study = LoadedStudy.load(folder)
    with Evaluator(EvaluationSource.of(study, study.problem), 2) as evaluator:
        outcomes = evaluator.evaluate([{"a": 1.5}, {"a": 2.5}])
    assert {o.status for o in outcomes} == {"failed"}
    for outcome in outcomes:
        mistakes.check(outcome.at, expected)


def test_the_line_comes_from_a_given_executor(plain, mistakes):
    folder = plain("")
    expected = mistakes.put(folder / "model.py", ("\n\n\n\n", f"\n\n{EVALUATING['exception']}\n"))
    study = LoadedStudy.load(folder)
    with ThreadPoolExecutor(1) as pool:
        (outcome,) = ExecutorEvaluator(EvaluationSource.of(study, study.problem), pool).evaluate([{"a": 1.5}])
    mistakes.check(outcome.at, expected)


@pytest.mark.slow
def test_a_model_that_cannot_be_built_in_a_worker(plain, mistakes):
    folder = plain(SOUND)
    study = LoadedStudy.load(folder)
    expected = mistakes.put(folder / "model.py", (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"))
    with (
        Evaluator(EvaluationSource.of(study, study.problem), 2) as evaluator,
        pytest.raises(InputError) as caught,
    ):
        evaluator.evaluate([{"a": 1.5}])
    mistakes.check(caught.value.at, expected)


MODAL = """
import numpy as np
from calib.structure.modal_function import ModalFunctionModel
from calib.problem.space import Parameter, ParameterSpace

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
def test_modes_that_do_not_fit(plain, in_this_process, result, mistakes):
    folder = plain(SOUND)
    (folder / "modes.csv").write_text("mode,freq,freq_kind,freq_std\nM1,1.0,natural,0.01\nM2,2.0,natural,0.01\n")
    (folder / "study.toml").write_text(
        "title = 'String'\nmodel = 'model.py:model'\n[measurement]\nfiles = ['modes.csv']\n"
    )
    expected = mistakes.marked(folder / "model.py", MODAL.replace("RESULT", result))
    mistakes.check(mistakes.refused(folder, compare).at, expected)


EFFECTS = """
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def build(model):
    BODY

def library():
    magnitude = Parameter("bend", 0.0, -1.0, 1.0, prior_sd=0.5)
    return (Effect("bend", "a bend", "It is straight.", "Bends.", magnitude, build),)
"""


@pytest.mark.parametrize(
    ("changes", "act"),
    [
        ((("BODY", "return ⟦model.nothing⟧"),), LoadedStudy.load),
        ((("BODY", "return 3"), ("def build", "def ⟦build⟧")), LoadedStudy.load),
        ((("BODY", "pass"), ("-1.0, 1.0", "1.0, -1.0"), ("Parameter(\"bend", "⟦Parameter(\"bend"),
          ("sd=0.5)", "sd=0.5)⟧")), LoadedStudy.load),
        ((("BODY", "pass"), ("return (Effect", "return [Effect"), (", build),)", ", build)]"),
          ("def library", "def ⟦library⟧")), LoadedStudy.load),
        pytest.param((("BODY", "return lambda values: ⟦values['gone']⟧"),), compare, marks=pytest.mark.slow),
        pytest.param((("BODY", "def ⟦bent⟧(values):\n        return {'y': 1.0}\n    return bent"),), compare,
                     marks=pytest.mark.slow),
        pytest.param((("BODY", "def ⟦bent⟧(values):\n        return {'y': 1.0, 'z': float('nan')}\n    return bent"),),
                     compare, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_mistakes_in_an_effect(plain, changes, act, mistakes):
    folder = plain(SOUND)
    mistakes.put(folder / "study.toml", ("title", 'effects = "effects.py:library"\nwith_effects = ["bend"]\ntitle'))
    (folder / "effects.py").write_text(EFFECTS)
    expected = mistakes.put(folder / "effects.py", *changes)
    mistakes.check(mistakes.refused(folder, act).at, expected)


@pytest.mark.parametrize(
    ("body", "isolated"),
    [
        pytest.param("return lambda values: {'y1': ⟦values['gone']⟧}", True, marks=pytest.mark.slow),
        ("return lambda values: {'y1': ⟦values['gone']⟧}", False),
        pytest.param("def ⟦bent⟧(values):\n        return {'y1': 0.0}\n    return bent", True, marks=pytest.mark.slow),
        ("def ⟦bent⟧(values):\n        return {'y1': 0.0}\n    return bent", False),
        ("def ⟦bent⟧(values):\n        return 3.0\n    return bent", False),
        pytest.param(
            "return lambda values: {name: 2 * y for name, y in model.function(values).items()}",
            True,
            marks=pytest.mark.slow,
        ),
        ("return lambda values: {name: 2 * y for name, y in model.function(values).items()}", False),
    ],
)
def test_mistakes_in_an_effect_of_the_library(plain, request, body, isolated, mistakes):
    """It fails everywhere, or changes the model even at magnitude 0."""
    if not isolated:
        request.getfixturevalue("in_this_process")
    folder = plain("def answer(values):\n    return {f'y{k}': values['a'] * k + values['b'] for k in range(1, 6)}\n")
    made_up = "".join(f"y{k},{y},0.01\n" for k, y in enumerate((3.2, 5.5, 7.1, 9.9, 16.0), start=1))
    (folder / "measured.csv").write_text(f"response,value,std\n{made_up}")
    mistakes.put(folder / "study.toml", ("title", 'effects = "effects.py:library"\ntitle'))
    (folder / "effects.py").write_text(EFFECTS)
    whole = [] if "⟦" in body else [("def build", "def ⟦build⟧")]
    expected = mistakes.put(folder / "effects.py", ("BODY", body), *whole)
    mistakes.check(mistakes.refused(folder, lambda f: calib.Study.load(f).explain()).at, expected)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("return Addition(", "return ⟦3 / 0⟧, Addition("),
        ("sp.csr_array(np.diag(np.eye(4)[storey]))", "sp.csr_array(np.eye(5))"),
    ],
)
def test_mistakes_in_an_effect_of_matrices(tmp_path, old, new, mistakes):
    shutil.copytree(ROOT / "studies/four_storey_rig", tmp_path / "rig", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "tests/template/rig_effects.py", tmp_path / "rig/effects.py")
    head = 'effects = "effects.py:library"\nwith_effects = ["top_cables"]\n'
    file = tmp_path / "rig/study.toml"
    file.write_text(head + file.read_text("utf-8"), "utf-8")
    effects = tmp_path / "rig/effects.py"
    if "⟦" in new:
        expected = mistakes.put(
            effects, ("    return lambda model: Addition(", "    return lambda model: (⟦1 / 0⟧) or Addition(")
        )
    else:
        expected = mistakes.put(effects, (old, new), ("    return lambda model", "⟦⟧    return lambda model"))
    mistakes.check(mistakes.refused(tmp_path / "rig").at, expected)
