"""Mistakes in the user's own code: file, line and exception on the screen, the traceback in the log."""

from pathlib import Path

import pytest

from calib.command import cli
from calib.errors.errors import InputError
from calib.study.study import LoadedStudy

LOG = Path("calib-error.log")


@pytest.fixture
def told(capsys, one_sentence):
    """The complaint of a command that must end with code 2."""

    def complaint(*arguments):
        capsys.readouterr()
        assert cli.execute(list(arguments)) == 2
        said = capsys.readouterr().err
        assert one_sentence(said) and "Traceback" not in said
        return said

    return complaint


def line_of(file: Path, text: str) -> int:
    return next(k for k, line in enumerate(file.read_text().splitlines(), 1) if text in line)


@pytest.fixture
def edited(plain):
    """The plain study with something done before its model is returned."""

    def edit(old: str, new: str) -> Path:
        folder = plain("def answer(values):\n    return {'y': values['a'], 'z': values['b']}\n")
        file = folder / "model.py"
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new, 1))
        return folder

    return edit


BUILD = 'return FunctionModel("plain", SPACE, answer)'


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        (BUILD, f"{{}}['nothing']  # here\n    {BUILD}", "KeyError"),
        (BUILD, f"len(5)  # here\n    {BUILD}", "TypeError"),
        ("import numpy as np", "import numpy as np\n1 / 0  # here", "ZeroDivisionError"),
        (BUILD, f"np.linalg.inv(np.zeros((2, 2)))  # here\n    {BUILD}", "LinAlgError"),
    ],
)
def test_an_exception_while_a_model_is_built(edited, told, old, new, kind):
    folder = edited(old, new)
    said = told("compare", str(folder))
    assert f"model.py, line {line_of(folder / 'model.py', '# here')}" in said and kind in said
    assert "model_options" not in said
    assert "# here" in LOG.read_text() and kind in LOG.read_text()


@pytest.mark.parametrize("options", ["{ colour = 1 }", "{ first = 1, second = 2 }"])
def test_options_that_a_model_does_not_take(edited, told, options):
    folder = edited("def model():", "def model(first=1):")
    study = folder / "study.toml"
    study.write_text(study.read_text().replace("selection", f"model_options = {options}\nselection", 1))
    assert "model_options" in told("compare", str(folder))
    assert not LOG.exists()


@pytest.mark.slow
def test_an_exception_while_a_model_is_evaluated(edited, told):
    folder = edited("return {'y': values['a'],", "return {'y': values['c'],  # here\n           ")
    said = told("compare", str(folder))
    assert f"KeyError: 'c' (model.py, line {line_of(folder / 'model.py', '# here')})" in said
    assert "# here" in LOG.read_text()


EFFECTS = """
{head}
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def library():
    magnitude = Parameter("bend", 0.0, -1.0, 1.0, prior_sd=0.5)
    return (Effect("bend", "a bend", "It is straight.", "Bends.", magnitude, lambda model: {build}),)
"""


@pytest.mark.parametrize(
    ("head", "own"),
    [
        ("from model import answer as own, SPACE\nimport model", "model.answer is own"),
        ("from shapes.round import own", "own({}) == 3"),
        ("import flat", "flat.own({}) == 4"),
    ],
)
def test_code_of_a_study_imports_what_stands_beside_it(edited, head, own):
    folder = edited(BUILD, BUILD)
    (folder / "shapes").mkdir()
    (folder / "shapes/round.py").write_text("def own(values):\n    return 3\n")
    (folder / "flat.py").write_text("def own(values):\n    return 4\n")
    (folder / "effects.py").write_text(EFFECTS.format(head=head, build=f"model.function if {own} else 0"))
    study = folder / "study.toml"
    study.write_text('effects = "effects.py:library"\nwith_effects = ["bend"]\n' + study.read_text())
    # `model` inside the effect is the argument there; the module's own function is compared by another name.
    text = (folder / "effects.py").read_text()
    (folder / "effects.py").write_text(text.replace("model.answer is own", "__import__('model').answer is own"))
    loaded = LoadedStudy.load(folder)
    assert [effect.name for effect in loaded.included] == ["bend"]
    assert loaded.problem.evaluate({"a": 2.0, "b": 1.5}) == {"y": 2.0, "z": 1.5}


def test_equal_names_in_two_studies_are_two_modules(edited, tmp_path):
    folder = edited("import numpy as np", "import numpy as np\nimport flat")
    text = (folder / "model.py").read_text().replace("'y': values['a']", "'y': flat.SIZE")
    (folder / "model.py").write_text(text)
    found = []
    for name, size in (("one", 1.0), ("two", 2.0), ("one", 1.0)):
        target = tmp_path / name
        if not target.exists():
            target.mkdir()
            for file in folder.iterdir():
                if file.is_file():
                    (target / file.name).write_text(file.read_text())
            (target / "flat.py").write_text(f"SIZE = {size}\n")
        found.append(LoadedStudy.load(target).problem.evaluate({})["y"])
    assert found == [1.0, 2.0, 1.0]
    (tmp_path / "one/flat.py").write_text("SIZE = 12345.0\n")
    assert LoadedStudy.load(tmp_path / "one").problem.evaluate({})["y"] == 12345.0


BENT = """
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def broken(model):
    def bent(values):
        return {name: y for name, x in model.function(values).items()}  # here
    return bent

def sound(model):
    def bent(values):
        return {name: x + values["other"] * x**2 for name, x in model.function(values).items()}
    return bent

def library():
    def effect(name, build):
        return Effect(name, name, "It is straight.", "Bends.", Parameter(name, 0.0, -1.0, 1.0, prior_sd=0.5), build)
    return (effect("bend", broken), effect("other", sound))[:COUNT]
"""
RESPONSES = {1: 3.2, 2: 5.5, 3: 7.1, 4: 9.9, 5: 16.0}
"""Made up: no values of the two parameters give them."""


@pytest.fixture
def bent(plain):
    """Makes the plain study with five responses and a library whose first effect fails everywhere."""

    def make(count: int, head: str = "") -> Path:
        folder = plain(
            "def answer(values):\n    return {f'y{k}': values['a'] * k + values['b'] for k in range(1, 6)}\n"
        )
        rows = [f"y{k},{y},0.01\n" for k, y in RESPONSES.items()]
        (folder / "measured.csv").write_text("".join(["response,value,std\n", *rows]))
        (folder / "effects.py").write_text(BENT.replace("COUNT", str(count)))
        study = folder / "study.toml"
        study.write_text(f'effects = "effects.py:library"\n{head}\n{study.read_text()}')
        return folder

    return make


def fault_of(folder: Path) -> str:
    return f"NameError: name 'y' is not defined (effects.py, line {line_of(folder / 'effects.py', '# here')})"


@pytest.mark.slow
def test_an_exception_in_the_only_effect(bent, told):
    folder = bent(1)
    assert fault_of(folder) in told("explain", str(folder))
    assert "# here" in LOG.read_text()


@pytest.mark.slow
def test_an_exception_in_one_effect_of_several(bent, undrawn, capsys):
    folder = bent(2)
    assert cli.execute(["explain", str(folder)]) == 0
    assert fault_of(folder) in " ".join(capsys.readouterr().out.split())
    assert "# here" in LOG.read_text() and "NameError" in LOG.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--method", "gauss-newton", "--workers", "1"]])
def test_an_exception_in_an_effect_that_a_calibrated_model_has(bent, told, options):
    folder = bent(2, 'with_effects = ["bend"]')
    for _ in range(2):  # the second time the ledger knows what failed
        assert fault_of(folder) in told("calibrate", str(folder), *options)
        assert "# here" in LOG.read_text()
        LOG.unlink()


def test_a_module_that_is_nowhere(edited):
    folder = edited("import numpy as np", "import numpy as np\nimport nowhere_at_all")
    with pytest.raises(InputError, match="nowhere_at_all") as caught:
        LoadedStudy.load(folder)
    assert "study's folder" in caught.value.remedy


@pytest.mark.parametrize("line", ["from calib.space import Parameter", "from calib.problem import Problem"])
def test_a_former_place_of_a_public_name(edited, line):
    """A module that is gone, and one that is a room now: the user's line is shown, and where the names are told."""
    folder = edited("import numpy as np", f"import numpy as np\n{line}")
    with pytest.raises(InputError, match="calib does not have") as caught:
        LoadedStudy.load(folder)
    assert "page on import paths" in caught.value.remedy
    assert caught.value.at is not None and line in caught.value.at.text
