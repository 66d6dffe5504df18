"""``calib extend``: a new study with one more effect, whole or not at all, the old one untouched."""

import os
import shutil
import tomllib
from pathlib import Path

import pytest

from calib import cli
from calib.errors import InputError
from calib.questions.extend import EARLIER, extend, extend_among, found_among
from calib.study import Study

RIG = Path(__file__).resolve().parents[2] / "studies/four_storey_rig"

RIG_EFFECTS = """\
import numpy as np
import scipy.sparse as sp
from calib.effect import Effect
from calib.space import Parameter
from calib.structure.affine import Term, parameter
from calib.structure.extend import Addition

def mass_at(storey, name):
    return lambda model: Addition(mass=(Term(name, sp.csr_array(np.diag(np.eye(4)[storey])), parameter(name)),))

def library():
    return tuple(
        Effect(name, f"cables on storey {storey + 1}", "Weighed without cables.", "Cables.",
               Parameter(name, 0.0, 0.0, 0.1, "kg", prior_sd=0.02), mass_at(storey, name))
        for storey, name in ((1, "low_cables"), (3, "top_cables"))
    )
"""

SUMS = """\
from calib.effect import Effect
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

def build():
    space = ParameterSpace((Parameter("a", 1.0, 0.0, 3.0), Parameter("b", 1.0, 0.0, 3.0)))
    return FunctionModel("sums", space, lambda v: {"s": v["a"] + v["b"]})

def bent(model):
    return lambda v: {"s": model.function(v)["s"] + v["bend"] * v["bend_at"] * v["bend_scale"]}

def library():
    strength = Parameter("bend", 0.0, -1.0, 1.0, prior_sd=0.5)
    more = (Parameter("bend_at", 1.0, 0.0, 2.0), Parameter("bend_scale", 2.0, 2.0, 2.0, distribution="fixed"))
    grid = ({"bend": 0.1, "bend_at": 1.0, "bend_scale": 2.0},)
    return (Effect("bend", "a bend", "It is straight.", "Bends.", strength, bent, nuisance=more, grid=grid),)
"""

SUMS_STUDY = """\
title = 'sums'   # of two numbers
model = "model.py:build"
selection = [
    "a",   # the first
    "b"    # the second
]
effects = "model.py:library"

# What was measured.
[measurement]
responses = "data/measured.csv"
[calibration]
population = 20
generations = 5
cases = [{ name = "F1", seed = 1 }]   # one will do
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def rig(here):
    shutil.copytree(RIG, here / "rig", ignore=shutil.ignore_patterns("__pycache__"))
    (here / "rig/effects.py").write_text(RIG_EFFECTS)
    file = here / "rig/study.toml"
    file.write_text('effects = "effects.py:library"\n' + file.read_text("utf-8"), "utf-8")
    return Path("rig")


@pytest.fixture
def sums(here):
    Path("sums/data").mkdir(parents=True)
    Path("sums/model.py").write_text(SUMS)
    Path("sums/data/measured.csv").write_text("response,value,std\ns,3.0,0.01\n")
    Path("sums/study.toml").write_text(SUMS_STUDY)
    return Path("sums")


def settings(folder: str | Path) -> dict:
    return tomllib.loads(Path(folder, "study.toml").read_text("utf-8"))


def tree(folder: str | Path) -> dict[str, bytes]:
    """Every file, but for what Python compiled."""
    files = [p for p in Path(folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def edit(folder: Path, *changes: tuple[str, str]) -> None:
    file = folder / "study.toml"
    text = file.read_text("utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    file.write_text(text, "utf-8")


def refusal(study: Path, effect: str, folder: str | Path) -> str:
    """What is said; nothing may have been written."""
    before = {p for p in Path().iterdir()}
    old = tree(study)
    with pytest.raises(InputError) as caught:
        extend(Study.load(study), [effect], Path(folder))
    assert {p for p in Path().iterdir()} == before and tree(study) == old
    return str(caught.value)


def test_the_new_study_is_the_old_one_with_the_effect(rig):
    before = tree(rig)
    made = extend(Study.load(rig), ["top_cables"], Path("new"))
    new, old = Study.load(Path("new")), Study.load(rig)
    assert tree(rig) == before and made.file == Path("new/study.toml") and made.moved == ()
    assert new.settings.with_effects == ("top_cables",) and new.settings.extended_from == "../rig"
    assert new.settings.title == "Four-storey laboratory rig + top_cables"
    assert new.settings.selection == ("k1", "k2", "k3", "k4", "top_cables") == new.search_space.free_names
    assert [e.name for e in new.candidates] == ["low_cables"]
    assert new.problem.evaluate({}) == pytest.approx(old.problem.evaluate({}), rel=1e-12, nan_ok=True)
    heavier = new.problem.evaluate({"top_cables": 0.05})
    assert heavier["natural_freq_1"] < 0.99 * old.problem.evaluate({})["natural_freq_1"]
    own = {"study.toml", "README.md"}
    assert "README.md" in before and not Path("new/README.md").exists()
    assert {k: v for k, v in tree("new").items() if k != "study.toml"} == {
        k: v for k, v in before.items() if k not in own
    }


def test_an_extended_study_can_be_extended_again(rig):
    extend(Study.load(rig), ["top_cables"], Path("once"))
    Path("deeper/down").mkdir(parents=True)
    extend(Study.load(Path("once")), ["low_cables"], Path("deeper/down/twice"))
    twice = Study.load(Path("deeper/down/twice"))
    assert twice.settings.with_effects == ("top_cables", "low_cables") and twice.candidates == ()
    assert twice.settings.extended_from == "../../../once"
    assert twice.settings.title.endswith("rig + top_cables + low_cables")
    assert twice.settings.selection[4:] == ("top_cables", "low_cables")
    assert settings("once")["with_effects"] == ["top_cables"]


def test_several_effects_are_added_at_once(rig):
    made = extend(Study.load(rig), ["top_cables", "low_cables"], Path("new"))
    new = Study.load(Path("new"))
    assert new.settings.with_effects == ("top_cables", "low_cables") and new.settings.title.endswith(
        "rig + top_cables + low_cables"
    )
    assert made.selected == ("top_cables", "low_cables") == new.search_space.free_names[4:]
    assert [e.name for e in made.effects] == ["top_cables", "low_cables"]


def test_comments_and_order_of_the_study_file_stay(sums):
    extend(Study.load(sums), ["bend"], Path("new"))
    expected = SUMS_STUDY.replace("title = 'sums'", 'title = "sums + bend"')
    expected = expected.replace('"b"    # the second\n', '"b",    # the second\n    "bend",\n    "bend_at"\n')
    expected = expected.replace(':library"\n', ':library"\nwith_effects = ["bend"]\nextended_from = "../sums"\n')
    said = Path("new/study.toml").read_text()
    assert [line.strip() for line in said.splitlines()] == [line.strip() for line in expected.splitlines()]


def test_a_fixed_parameter_of_an_effect_is_not_selected(sums):
    extend(Study.load(sums), ["bend"], Path("new"))
    new = Study.load(Path("new"))
    assert new.search_space.free_names == ("a", "b", "bend", "bend_at")
    assert new.problem.evaluate({"bend": 0.5, "bend_at": 2.0}) == {"s": 4.0}


def test_a_selection_left_to_the_sensitivity_stays_so(sums):
    selection = SUMS_STUDY[SUMS_STUDY.index("selection") : SUMS_STUDY.index("effects")]
    edit(sums, (selection, 'selection = "from sensitivity"\n'))
    made = extend(Study.load(sums), ["bend"], Path("new"))
    assert made.selected == () and settings("new")["selection"] == "from sensitivity"
    assert "bend" in Study.load(Path("new")).search_space.free_names


def test_line_ends_and_names_of_the_old_file_stay(sums):
    text = SUMS_STUDY.replace("of two numbers", "é").replace("\n", "\r\n")
    Path("sums/other.toml").write_bytes(text.encode())
    made = extend(Study.load(Path("sums/other.toml")), ["bend"], Path("new"))
    assert made.file == Path("new/other.toml")
    assert Study.load(made.file).settings.extended_from == "../sums/other.toml"
    written = made.file.read_bytes()
    assert "é".encode() in written and b'\r\nwith_effects = ["bend"]\r\nextended_from' in written
    assert "with_effects" not in settings("new")


def test_results_caches_and_hidden_files_are_left_behind(sums, monkeypatch):
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    for folder in ("results", "data/results", "__pycache__", ".git", "data/more"):
        Path("sums", folder).mkdir(exist_ok=True)
        Path("sums", folder, "file.txt").write_text("x")
    Path("sums/.hidden").write_text("x")
    Path("sums/data/.hidden").write_text("x")
    Path("sums/make_data.py").write_text("print()\n")
    Path("sums/README.md").write_text("of the old study")
    Path("sums/data/README.md").write_text("of the data")
    extend(Study.load(sums), ["bend"], Path("new"))
    files = {str(p.relative_to("new")) for p in Path("new").rglob("*") if p.is_file()}
    assert files == {
        "study.toml",
        "model.py",
        "data/measured.csv",
        "data/more/file.txt",
        "data/README.md",
        "make_data.py",
    }


def test_paths_that_lead_out_of_the_study_lead_to_the_same_files(rig):
    Path("shared/code").mkdir(parents=True)
    shutil.move("rig/measured.csv", "shared/measured.csv")
    shutil.move("rig/effects.py", "shared/code/effects.py")
    edit(rig, ('"measured.csv"', '"../shared/measured.csv"'), ('"effects.py:', '"../rig/../shared/code/effects.py:'))
    Path("deep").mkdir()
    made = extend(Study.load(rig), ["top_cables"], Path("deep/new"))
    assert settings("deep/new")["measurement"]["files"] == ["../../shared/measured.csv"]
    assert settings("deep/new")["effects"] == "../../shared/code/effects.py:library"
    assert dict(made.moved) == {
        "../shared/measured.csv": "../../shared/measured.csv",
        "../rig/../shared/code/effects.py": "../../shared/code/effects.py",
    }
    old, new = Study.load(rig), Study.load(Path("deep/new"))
    assert new.measured.fingerprint == old.measured.fingerprint


def test_data_in_what_is_not_copied_are_read_where_they_are(sums):
    Path("sums/results").mkdir()
    shutil.move("sums/data/measured.csv", "sums/results/measured.csv")
    edit(sums, ("data/measured.csv", "results/measured.csv"))
    extend(Study.load(sums), ["bend"], Path("new"))
    assert settings("new")["measurement"]["responses"] == "../sums/results/measured.csv"
    assert Study.load(Path("new")).targets == {"s": (3.0, 0.01)}


def test_absolute_paths_and_links_keep_their_meaning(sums, here):
    edit(sums, ('"data/measured.csv"', f'"{here}/sums/data/measured.csv"'))
    Path("elsewhere").write_text("notes")
    os.symlink("../elsewhere", "sums/notes.txt")
    extend(Study.load(sums), ["bend"], Path("new"))
    assert settings("new")["measurement"]["responses"] == f"{here}/sums/data/measured.csv"
    assert Path("new/notes.txt").read_text() == "notes" and not Path("new/notes.txt").is_symlink()


def test_a_link_to_a_folder_around_the_study_is_refused(sums):
    os.symlink("..", "sums/up")
    assert "leads to a folder around the study" in refusal(sums, "bend", "new")


def test_what_cannot_be_is_refused_in_one_sentence(sums, rig):
    assert "unknown effect 'top_cable' (did you mean 'top_cables'?)" in refusal(rig, "top_cable", "new")
    assert "effects are low_cables, top_cables" in refusal(rig, "qqq", "new")
    Path("taken").mkdir()
    assert "taken: it exists already" in refusal(rig, "top_cables", "taken")
    assert "it exists already" in refusal(rig, "top_cables", "rig")
    assert "inside the study" in refusal(rig, "top_cables", "rig/new")
    assert "no folder 'nowhere'" in refusal(rig, "top_cables", "nowhere/new")
    assert "taken for a study file" in refusal(rig, "top_cables", "new.toml")
    extend(Study.load(rig), ["top_cables"], Path("new"))
    said = refusal(Path("new"), "top_cables", "newer")
    assert "is in the model already; the effects it lacks are low_cables" in said
    edit(sums, ('effects = "model.py:library"\n', ""))
    assert "names no library of effects" in refusal(sums, "bend", "newer")


def test_a_study_that_would_not_load_is_not_put_in_place(sums):
    text = SUMS.replace("def build():", "from pathlib import Path\ndef build():").replace(
        "    space = P", "    (Path(__file__).parent / '.secret').read_text()\n    space = P", 1
    )
    Path("sums/model.py").write_text(text)
    Path("sums/.secret").write_text("x")
    said = refusal(sums, "bend", "new")
    assert "was not written" in said and "new/study.toml" in said and ".calib-extend" not in said


@pytest.mark.parametrize("what", ["shutil.copytree", "pathlib.Path.write_text", "pathlib.Path.rename"])
@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_nothing_half_written_stays(sums, monkeypatch, what, fault):
    study = Study.load(sums)

    def fail(*arguments, **more):
        raise fault

    monkeypatch.setattr(what, fail)
    with pytest.raises(InputError if isinstance(fault, OSError) else KeyboardInterrupt) as caught:
        extend(study, ["bend"], Path("new"))
    if isinstance(fault, OSError):
        assert "No space left" in str(caught.value)
    assert {p.name for p in Path().iterdir()} == {"sums"}


# -- among results -----------------------------------------------------------------------------------------------------


def test_a_study_among_results_can_be_moved(rig):
    Path("shared").mkdir()
    shutil.move("rig/measured.csv", "shared/measured.csv")
    edit(rig, ('"measured.csv"', '"../shared/measured.csv"'))
    Path("results/rig").mkdir(parents=True)
    made = extend_among(Study.load(rig), ["top_cables"], Path("results/rig"))
    assert made.file == Path("results/rig/rig_extended/study.toml")
    assert found_among(Study.load(rig), Path("results/rig")) == made.file
    Path("far/away").mkdir(parents=True)
    shutil.move("results/rig/rig_extended", "far/away/mine")
    new, old = Study.load(Path("far/away/mine")), Study.load(rig)
    assert new.measured.fingerprint == old.measured.fingerprint
    assert Path(new.settings.extended_from).resolve() == rig.resolve()
    assert found_among(old, Path("results/rig")) is None


def test_least_squares_of_a_study_among_results_begin_at_what_is_known(rig):
    Path("results").mkdir()
    study = Study.load(rig)
    space = study.search_space
    known = {space.free_names[0]: space.lower[0], "top_cables": 0.1}
    made = extend_among(study, ["top_cables"], Path("results"), known)
    assert Study.load(made.file).settings.calibration.begin_at == known


def test_the_same_study_among_results_stays_and_another_is_kept_aside(rig):
    Path("results").mkdir()
    study, written = Study.load(rig), Path("results/rig_extended")

    def there():
        return {p.name for p in Path("results").iterdir()}

    extend_among(study, ["top_cables"], Path("results"))
    Path(written, "results").mkdir()
    Path(written, "results/answer.csv").write_text("what the user asked of it")
    first = tree(written)
    extend_among(study, ["top_cables"], Path("results"))
    assert tree(written) == first and there() == {"rig_extended"}
    (written / "notes.txt").write_text("changed by the user")
    changed = tree(written)
    extend_among(study, ["low_cables"], Path("results"))
    assert Study.load(written).settings.with_effects == ("low_cables",) and "notes.txt" not in tree(written)
    assert tree(f"results/rig_extended{EARLIER}") == changed and there() == {"rig_extended", f"rig_extended{EARLIER}"}
    extend_among(study, ["top_cables"], Path("results"))
    assert Study.load(Path(f"results/rig_extended{EARLIER}")).settings.with_effects == ("low_cables",)
    assert there() == {"rig_extended", f"rig_extended{EARLIER}"}


@pytest.mark.parametrize("place", ["sums/results/sums", "sums/answers/sums"])
def test_results_within_the_study_are_no_part_of_the_new_one(sums, place):
    Path(place).mkdir(parents=True)
    Path(place, "summary.json").write_text("{}")
    made = extend_among(Study.load(sums), ["bend"], Path(place))
    assert set(tree(made.file.parent)) == {"study.toml", "model.py", "data/measured.csv"}
    assert extend_among(Study.load(sums), ["bend"], Path(place)).file == made.file
    assert len(list(Path(place).iterdir())) == 2


@pytest.mark.parametrize("call", [1, 2])
def test_a_stop_while_replacing_leaves_a_whole_study_or_none(sums, monkeypatch, call):
    Path("results").mkdir()
    extend_among(Study.load(sums), ["bend"], Path("results"))
    edit(Path("sums"), ("'sums'", "'other'"))
    rename, calls = Path.rename, []

    def stopped(self, target):
        calls.append(target)
        if len(calls) == call:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "rename", stopped)
        extend_among(Study.load(sums), ["bend"], Path("results"))
    for folder in Path("results").iterdir():
        assert not folder.name.startswith(".") and Study.load(folder).settings.with_effects == ("bend",)
    extend_among(Study.load(sums), ["bend"], Path("results"))
    assert Study.load(Path("results/sums_extended")).settings.title == "other + bend"


def test_the_command_says_what_to_do_next_and_that_works(sums, capsys):
    assert cli.answer(["extend", "sums", "bend", "--into", "new"]) == 0
    out = capsys.readouterr().out
    assert "Written: new" in out and "a bend (bend)" in out and "may change bend, bend_at too" in out
    assert "calib calibrate new" in out
    assert cli.answer(["calibrate", "new", "--workers", "1"]) == 0
    assert "bend_at" in Path("results/new/parameters.csv").read_text()
    assert cli.answer(["extend", "sums", "bent", "--into", "newer"]) == 2
    said = capsys.readouterr().err
    assert "did you mean 'bend'?" in said and said.count("\n") == 1 and not Path("newer").exists()
    assert cli.answer(["extend", "sums", "bend"]) == 2
    assert "--into" in capsys.readouterr().err
