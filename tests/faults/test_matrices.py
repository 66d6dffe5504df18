"""Models given as matrices of another program: half a matrix, zero rows, no elements to draw, or a wrong mesh."""

import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from calib.command import cli
from calib.errors.errors import InputError
from calib.structure.affine import AffineMatrix, Term
from calib.structure.soundness import require_sound
from calib.study.study import LoadedStudy

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
def test_half_a_matrix_is_refused(bare, capsys, half, one_sentence):
    folder = bare(f'half = "{half}"')
    assert cli.execute(["compare", str(folder)]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and f"only the {half} half" in said and "'springs' of the stiffness" in said
    assert not Path("results").exists() or not list(Path("results").rglob("*.csv"))


def test_a_matrix_that_is_not_symmetric_is_refused(bare):
    with pytest.raises(InputError, match="not symmetric"):
        LoadedStudy.load(bare('half = "skew"'))


def test_damping_and_mass_are_looked_at_too(bare):
    model = LoadedStudy.load(bare()).model
    half = AffineMatrix(3, (Term("half", sp.csr_array(np.triu(np.ones((3, 3))))),))
    for kind in ("damping", "mass"):
        with pytest.raises(InputError) as caught:
            require_sound(type(model)(**{**vars(model), kind: half}))
        assert kind in caught.value.place


@pytest.mark.parametrize(("rounding", "refused"), [(1e-9, False), (1e-3, True)])
def test_rounding_does_not_make_a_matrix_unsymmetric(bare, rounding, refused):
    model = LoadedStudy.load(bare()).model
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
        LoadedStudy.load(bare("empty = true"))
    assert "1 of 3" in caught.value.problem and "uy of node 2 at (1, 0, 0) m" in caught.value.problem


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "verbs"), [pytest.param("[0, 2]", ["run"], marks=pytest.mark.slow), ("[0]", ["compare", "report"])]
)
def test_a_mesh_without_elements_allows_every_analysis(bare, capsys, request, no_drawing, shape, verbs):
    if verbs != ["run"]:  # which draws figures to the last pixel
        request.getfixturevalue("unrendered")
    folder = bare(f"shape = {shape}")
    for verb in verbs:
        with no_drawing() if verb == "compare" else nullcontext():
            assert cli.execute([verb, str(folder)]) == 0, capsys.readouterr().err
    made = {path.name for path in Path("results/bare").iterdir()}
    assert {"report.html", "model.png"} <= made and not Path("calib-error.log").exists()


LINES, NO_FACES = np.array([[0, 1], [1, 2]]), np.zeros((0, 4), dtype=int)
OFF = np.array([[0.0, 0, 0], [1, 0, np.nan], [2, 0, 0]])


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        ({"lines": np.zeros((0, 2), dtype=int)}, "0 lines, but 2 groups"),
        ({"lines": LINES, "groups": ()}, "2 lines, but 0 groups"),
        ({"lines": {}}, "lines is {}"),
        ({"lines": [[0, 1], [2]]}, "lines is [[0, 1], [2]]"),
        ({"lines": np.array([[0, 1, 2], [0, 1, 2]])}, "(2, 3)"),
        ({"lines": LINES + 9}, "row 0 of lines names point 9"),
        ({"lines": LINES - 1}, "row 0 of lines names point -1"),
        ({"lines": np.array([[0, 1], [1, 2.5]])}, "row 1 of lines names point 2.5"),
        ({"lines": np.array([[0, 1], [1, np.nan]])}, "row 1 of lines names point nan"),
        ({"groups": "ab"}, "groups is 'ab'"),
        ({"groups": None}, "groups is None"),
        ({"faces": np.array([[0, 1, 2, 3]]), "face_groups": ("wall",)}, "row 0 of faces names point 3"),
        ({"faces": np.array([[0, 1, 2, 0]])}, "1 faces, but 0 face_groups"),
        ({"face_groups": ("wall",)}, "0 faces, but 1 face_groups"),
        ({"points": OFF}, "point 1 is"),
        ({"points": np.zeros((4, 3))}, "4 points"),
        ({"points": np.zeros((3, 2))}, "(3, 2)"),
        ({"points": None}, "points is None"),
    ],
)
def test_a_mesh_that_does_not_fit_is_refused(bare, mesh, said):
    model = LoadedStudy.load(bare()).model
    whole = replace(model.mesh, lines=LINES, groups=("bar", "bar"), faces=NO_FACES)
    require_sound(replace(model, mesh=whole))
    with pytest.raises(InputError) as caught:
        require_sound(replace(model, mesh=replace(whole, **mesh)))
    assert said in caught.value.problem and "mesh" in caught.value.place and caught.value.remedy


def test_a_mesh_whose_points_are_unknown_is_sound(bare):
    model = LoadedStudy.load(bare()).model
    unknown = replace(model, mesh=replace(model.mesh, points=np.full((3, 3), np.nan)))
    require_sound(unknown)
    np.testing.assert_array_equal(unknown.modes({}, 1).natural_freq, model.modes({}, 1).natural_freq)
    points = np.full((3, 3), np.nan)
    points[0] = 0.0
    with pytest.raises(InputError, match="point 1 is"):  # all or none
        require_sound(replace(model, mesh=replace(model.mesh, points=points)))


@pytest.mark.parametrize("lines", ["np.zeros((0, 2), int)", "{}", "q.lines + 9", "q.lines, groups=()"])
def test_a_mesh_that_does_not_fit_is_the_users_to_mend(mast, capsys, lines, one_sentence):
    file = mast / "model.py"
    text = file.read_text()
    changed = f"mesh=(lambda q: __import__('dataclasses').replace(q, lines={lines}))(mesh),"
    assert text.count("mesh=mesh,") == 1
    file.write_text(text.replace("mesh=mesh,", changed))
    assert cli.execute(["compare", str(mast)]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "model mast, mesh" in said and "study.toml" in said
    assert not Path("calib-error.log").exists() and not list(Path().glob("results/**/*.csv"))
