"""``calib extend``: a new study with one more effect, written whole or not at all; the old one is unchanged."""

import shutil
import tomllib
from pathlib import Path

import pytest

from calib.analyses.extend import write_extension
from calib.command import cli
from calib.errors.errors import InputError
from calib.study.study import LoadedStudy


def settings(folder: str | Path) -> dict:
    return tomllib.loads(Path(folder, "study.toml").read_text("utf-8"))


@pytest.fixture
def refusal(tree):
    """Returns the message; asserts that nothing was written."""

    def said(study: Path, effect: str, folder: str | Path) -> str:
        before = {p for p in Path().iterdir()}
        old = tree(study)
        with pytest.raises(InputError) as caught:
            write_extension(LoadedStudy.load(study), [effect], Path(folder))
        assert {p for p in Path().iterdir()} == before and tree(study) == old
        return str(caught.value)

    return said


def test_the_new_study_is_the_old_one_with_the_effect(rig, tree):
    before = tree(rig)
    made = write_extension(LoadedStudy.load(rig), ["top_cables"], Path("new"))
    new, old = LoadedStudy.load(Path("new")), LoadedStudy.load(rig)
    assert tree(rig) == before and made.file == Path("new/study.toml") and set(tree("new")) == {"study.toml"}
    assert settings("new") == {
        "title": "Four-storey laboratory rig + top cables",
        "base": "../rig",
        "with_effects": ["top_cables"],
        "selection": ["k1", "k2", "k3", "k4", "top_cables"],
    }
    assert new.search_space.free_names == ("k1", "k2", "k3", "k4", "top_cables")
    assert [e.name for e in new.candidates] == ["low_cables"]
    assert new.problem.evaluate({}) == pytest.approx(old.problem.evaluate({}), rel=1e-12, nan_ok=True)
    heavier = new.problem.evaluate({"top_cables": 0.05})
    assert heavier["natural_freq_1"] < 0.99 * old.problem.evaluate({})["natural_freq_1"]


def test_an_extended_study_can_be_extended_again(rig):
    write_extension(LoadedStudy.load(rig), ["top_cables"], Path("once"))
    Path("deeper/down").mkdir(parents=True)
    write_extension(LoadedStudy.load(Path("once")), ["low_cables"], Path("deeper/down/twice"))
    twice = LoadedStudy.load(Path("deeper/down/twice"))
    assert twice.settings.with_effects == ("top_cables", "low_cables") and twice.candidates == ()
    assert twice.settings.base == "../../../once"
    assert twice.settings.title.endswith("rig + top cables + low cables")
    assert twice.settings.selection[4:] == ("top_cables", "low_cables")
    assert settings("once")["with_effects"] == ["top_cables"]


def test_a_change_in_the_base_study_changes_the_extended_one(rig, edited):
    write_extension(LoadedStudy.load(rig), ["top_cables"], Path("new"))
    before = LoadedStudy.load(Path("new")).measured.natural_freq[0]
    text = (rig / "measured.csv").read_text()
    assert "15.545" in text
    (rig / "measured.csv").write_text(text.replace("15.545", "15.645"))
    assert LoadedStudy.load(Path("new")).measured.natural_freq[0] == pytest.approx(before + 0.1, abs=1e-3)


def test_several_effects_are_added_at_once(rig):
    made = write_extension(LoadedStudy.load(rig), ["top_cables", "low_cables"], Path("new"))
    new = LoadedStudy.load(Path("new"))
    assert new.settings.with_effects == ("top_cables", "low_cables") and new.settings.title.endswith(
        "rig + top cables + low cables"
    )
    assert made.selected == ("top_cables", "low_cables") == new.search_space.free_names[4:]
    assert [e.name for e in made.effects] == ["top_cables", "low_cables"]


def test_a_fixed_parameter_of_an_effect_is_not_selected(sums):
    write_extension(LoadedStudy.load(sums), ["bend"], Path("new"))
    new = LoadedStudy.load(Path("new"))
    assert new.search_space.free_names == ("a", "b", "bend", "bend_at")
    assert new.problem.evaluate({"bend": 0.5, "bend_at": 2.0}) == {"s": 4.0}


@pytest.mark.medium
def test_a_selection_by_the_sensitivity_analysis_stays_so(sums, edited):
    text = Path(sums, "study.toml").read_text()
    selection = text[text.index("selection") : text.index("effects")]
    edited(sums, selection, 'selection = "from sensitivity"\n')
    made = write_extension(LoadedStudy.load(sums), ["bend"], Path("new"))
    assert made.selected == () and LoadedStudy.load(Path("new")).settings.selection == "from sensitivity"
    assert "bend" in LoadedStudy.load(Path("new")).search_space.free_names


def test_a_study_file_of_another_name_can_be_extended(sums):
    Path("sums/study.toml").rename("sums/other.toml")
    made = write_extension(LoadedStudy.load(Path("sums/other.toml")), ["bend"], Path("new"))
    assert made.file == Path("new/study.toml") and settings("new")["base"] == "../sums/other.toml"
    assert LoadedStudy.load(made.file).targets == {"s": (3.0, 0.01)}


def test_paths_lead_to_the_same_files_from_every_study(rig, edited):
    Path("shared/code").mkdir(parents=True)
    shutil.move("rig/measured.csv", "shared/measured.csv")
    shutil.move("rig/effects.py", "shared/code/effects.py")
    edited(rig, '"measured.csv"', '"../shared/measured.csv"')
    edited(rig, '"effects.py:', '"../rig/../shared/code/effects.py:')
    Path("deep").mkdir()
    write_extension(LoadedStudy.load(rig), ["top_cables"], Path("deep/new"))
    old, new = LoadedStudy.load(rig), LoadedStudy.load(Path("deep/new"))
    assert new.settings.measurement.files == ("../../shared/measured.csv",)
    assert new.measured.fingerprint == old.measured.fingerprint


def test_absolute_paths_are_kept(sums, here, edited):
    edited(sums, '"data/measured.csv"', f'"{here}/sums/data/measured.csv"')
    write_extension(LoadedStudy.load(sums), ["bend"], Path("new"))
    assert LoadedStudy.load(Path("new")).settings.measurement.responses == f"{here}/sums/data/measured.csv"


def test_impossible_extensions_are_refused_in_one_sentence(sums, rig, edited, refusal):
    assert "unknown effect 'top_cable' (did you mean 'top_cables'?)" in refusal(rig, "top_cable", "new")
    assert "effects are low_cables, top_cables" in refusal(rig, "qqq", "new")
    Path("taken").mkdir()
    assert "taken: it exists already" in refusal(rig, "top_cables", "taken")
    assert "it exists already" in refusal(rig, "top_cables", "rig")
    assert "inside the study" in refusal(rig, "top_cables", "rig/new")
    assert "no folder 'nowhere'" in refusal(rig, "top_cables", "nowhere/new")
    assert "taken for a study file" in refusal(rig, "top_cables", "new.toml")
    write_extension(LoadedStudy.load(rig), ["top_cables"], Path("new"))
    said = refusal(Path("new"), "top_cables", "newer")
    assert "is in the model already; the effects it lacks are low_cables" in said
    edited(sums, 'effects = "model.py:library"\n', "")
    assert "names no list of possible causes" in refusal(sums, "bend", "newer")


def test_an_invalid_new_study_is_not_written(sums, monkeypatch):
    study = LoadedStudy.load(sums)
    text = Path("sums/model.py").read_text()
    Path("sums/model.py").write_text(text.replace("def build():", "def build(needed):"))
    with pytest.raises(InputError) as caught:
        write_extension(study, ["bend"], Path("new"))
    said = str(caught.value)
    assert "was not written" in said and ".calib-extend" not in said and {p.name for p in Path().iterdir()} == {"sums"}
    at = caught.value.at
    assert (Path(at.file), at.text) == (Path("sums/study.toml").resolve(), 'model = "model.py:build"')


@pytest.mark.parametrize("what", ["pathlib.Path.write_text", "pathlib.Path.rename"])
@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_nothing_half_written_remains(sums, monkeypatch, what, fault):
    study = LoadedStudy.load(sums)

    def fail(*arguments, **more):
        raise fault

    monkeypatch.setattr(what, fail)
    with pytest.raises(InputError if isinstance(fault, OSError) else KeyboardInterrupt) as caught:
        write_extension(study, ["bend"], Path("new"))
    if isinstance(fault, OSError):
        assert "No space left" in str(caught.value)
    assert {p.name for p in Path().iterdir()} == {"sums"}


@pytest.mark.slow
def test_the_command_names_the_next_command_and_that_works(sums, capsys):
    assert cli.execute(["extend", "sums", "bend", "--into", "new"]) == 0
    out = capsys.readouterr().out
    assert "Written: new" in out and "a bend (bend)" in out and "may change bend, bend_at too" in out
    assert "calib calibrate new" in out
    assert cli.execute(["calibrate", "new", "--workers", "1"]) == 0
    assert "bend_at" in Path("results/new/parameters.csv").read_text()
    capsys.readouterr()  # how long it took, on a busy machine
    assert cli.execute(["extend", "sums", "bent", "--into", "newer"]) == 2
    said = capsys.readouterr().err
    assert "did you mean 'bend'?" in said and said.count("\n") == 1 and not Path("newer").exists()
    assert cli.execute(["extend", "sums", "bend"]) == 2
    assert "--into" in capsys.readouterr().err
