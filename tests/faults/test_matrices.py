"""Models given as matrices of another program: half a matrix, empty places, no elements to draw."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from calib import cli
from calib.errors import InputError
from calib.structure.affine import AffineMatrix, Term
from calib.structure.soundness import require_sound
from calib.study import Study

BARE = Path(__file__).parents[1] / "template/bare_chain"


@pytest.fixture
def bare(here):
    """Makes the study of three masses, with options of its model."""

    def make(options: str = "") -> Path:
        shutil.copytree(BARE, "bare", ignore=shutil.ignore_patterns("__pycache__"))
        file = Path("bare/study.toml")
        file.write_text(file.read_text().replace("model_options = {}", f"model_options = {{ {options} }}"))
        return Path("bare")

    return make


@pytest.mark.parametrize("half", ["upper", "lower"])
def test_half_a_matrix_is_refused(bare, capsys, half):
    folder = bare(f'half = "{half}"')
    assert cli.answer(["compare", str(folder)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f"only the {half} half" in said and "'springs' of the stiffness" in said
    assert not Path("results").exists() or not list(Path("results").rglob("*.csv"))


def test_a_matrix_that_is_not_symmetric_is_refused(bare):
    with pytest.raises(InputError, match="not symmetric"):
        Study.load(bare('half = "skew"'))


def test_damping_and_mass_are_looked_at_too(bare):
    model = Study.load(bare()).model
    half = AffineMatrix(3, (Term("half", sp.csr_array(np.triu(np.ones((3, 3))))),))
    for kind in ("damping", "mass"):
        with pytest.raises(InputError) as caught:
            require_sound(type(model)(**{**vars(model), kind: half}))
        assert kind in caught.value.place


@pytest.mark.parametrize(("rounding", "refused"), [(1e-9, False), (1e-3, True)])
def test_rounding_does_not_make_a_matrix_unsymmetric(bare, rounding, refused):
    model = Study.load(bare()).model
    matrix = model.stiffness.terms[0].matrix.toarray() * (1 + rounding * np.arange(9.0).reshape(3, 3))
    assert (matrix != matrix.T).any()
    rounded = type(model)(**{**vars(model), "stiffness": AffineMatrix(3, (Term("k", sp.csr_array(matrix)),))})
    try:
        require_sound(rounded)
    except InputError as fault:
        assert refused and "not symmetric" in fault.problem
    else:
        assert not refused


def test_an_empty_degree_of_freedom_is_named(bare):
    with pytest.raises(InputError) as caught:
        Study.load(bare("empty = true"))
    assert "1 of 3" in caught.value.problem and "uy of node 2 at (1, 0, 0) m" in caught.value.problem


@pytest.mark.parametrize(("shape", "verbs"), [("[0, 2]", ["run"]), ("[0]", ["compare", "report"])])
def test_a_mesh_without_elements_can_be_asked_everything(bare, capsys, shape, verbs):
    folder = bare(f"shape = {shape}")
    for verb in verbs:
        assert cli.answer([verb, str(folder)]) == 0, capsys.readouterr().err
    made = {path.name for path in Path("results/bare").iterdir()}
    assert {"report.html", "model.png"} <= made and not Path("calib-error.log").exists()
