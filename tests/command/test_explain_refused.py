"""Bad input of ``calib explain``, ``extend`` and ``report``: one sentence, and nothing left behind."""

import json
from pathlib import Path

import pytest

from calib.command import cli
from calib.correlation import basis as requirements


@pytest.fixture
def refused(capsys, one_sentence):
    """Exit code 2, one sentence with all words, nothing but empty folders behind."""

    def check(arguments, *words):
        capsys.readouterr()
        assert cli.execute(arguments) == 2
        said = capsys.readouterr().err
        assert one_sentence(said) and "Traceback" not in said
        for word in words:
            assert word in said, said
        assert not Path("calib-error.log").exists()
        assert not any(p.is_file() for p in Path("results").rglob("*"))
        return said

    return check


@pytest.mark.medium
def test_a_study_without_effects_is_told_the_place(guyed, capsys, edit, explanation):
    edit(guyed, 'effects = "effects.py:library"\n', "")
    assert cli.execute(["explain", "mast", "-v"]) == 0
    found = explanation()
    assert found["verdict"] == "none_explains" and found["effects"] == [] and found["p_family"] < 0.01
    assert found["local_perturbation"]["name"] in Path("results/mast/perturbations.csv").read_text()
    assert "0 effects" in capsys.readouterr().out


@pytest.mark.medium
def test_a_model_that_has_all_effects_lacks_nothing_more(guyed, edit, explanation):
    edit(guyed, "selection =", 'with_effects = ["lamp", "platform", "guy", "stuck_base"]\nselection =')
    text = (guyed / "study.toml").read_text()
    edit(
        guyed,
        text[text.index("selection = [") :].split("]")[0],
        f'{text[text.index("selection = [") :].split("]")[0]}, "guy"',
    )
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["verdict"] == "nothing_detectable"


@pytest.mark.parametrize("worthwhile_dofs", [requirements.WORTHWHILE_DOFS, 10])
@pytest.mark.parametrize("held", [["B2z", "B3x", "B3z"], ["B1x", "B1z", "B2x", "B2z", "B3x"]])
def test_too_few_modes_are_told_before_a_basis_is_trained(guyed, refused, monkeypatch, held, worthwhile_dofs, edit):
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", worthwhile_dofs)
    monkeypatch.setattr(requirements, "train", lambda *a, **k: pytest.fail("a basis is trained"))
    edit(guyed, "modes = []", f"modes = {json.dumps(held)}")
    words = f"{6 - len(held)} measured modes cannot tell a missing effect from a parameter"
    refused(["explain", "mast"], words, "measure at least 4")


def test_an_unknown_library(guyed, refused, edit):
    edit(guyed, "effects.py:library", "effects.py:nothing")
    refused(["explain", "mast"], "nothing", "study.toml")


def test_an_effect_that_builds_nonsense(guyed, refused):
    text = (guyed / "effects.py").read_text()
    broken = text.replace("return Addition(", "return dict(")
    assert broken != text
    (guyed / "effects.py").write_text(broken)
    refused(["explain", "mast"], "effect ", "return an Addition")


@pytest.mark.slow
def test_a_finer_mesh_that_cannot_be_built(guyed, refused, edit):
    edit(guyed, "[calibration]", "[explain]\nfiner_options = { elements = 3 }\n\n[calibration]")
    refused(["explain", "mast"], "elements")


def test_results_that_cannot_be_written(guyed, refused):
    Path("taken").write_text("a file, not a folder")
    refused(["explain", "mast", "--results", "taken"], "cannot be written")


def test_an_unknown_effect_is_no_extension(guyed, refused, files):
    before = files(".")
    refused(["extend", "mast", "gui", "--into", "mast_2"], "unknown effect 'gui'", "platform, lamp, guy, stuck_base")
    assert not Path("mast_2").exists() and files(".") == before and not list(Path().glob(".calib*"))


@pytest.mark.medium
def test_an_effect_in_the_model_is_no_extension(guyed, refused):
    assert cli.execute(["extend", "mast", "guy", "--into", "mast_2"]) == 0
    refused(["extend", "mast_2", "guy", "--into", "mast_3"], "in the model already", "the effects it lacks are")
    assert not Path("mast_3").exists()


def test_no_results_are_no_report(guyed, refused):
    refused(["report", "mast"], "there are no results to draw", "calib run mast")
