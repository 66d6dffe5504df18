"""Changes that make stored evaluations of a function outdated, and models that are not reproducible."""

import os
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from calib.command import cli
from calib.errors.errors import InputError
from calib.results.fingerprint import digest_of
from calib.study.study import LoadedStudy
from models.railway import bogie_on_rig

MODEL = """
from functools import partial
from pathlib import Path
import numpy as np
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace
{before}
SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 2.0, 1.0, 3.0)))

def closed(power):
    def answer(values):
        return {{"y": values["a"] ** power, "z": values["b"]}}
    return answer

def given(values, *, power):
    return {{"y": values["a"] ** power, "z": values["b"]}}

class Kept:
    def __init__(self, table):
        self.table = table
    def __call__(self, values):
        return {{"y": values["a"] * float(self.table[1]), "z": values["b"]}}

def model(power=1.0):
    return FunctionModel("f", SPACE, {function})
"""
STUDY = """
title = "Powers"
model = "model.py:model"
model_options = { power = 1.0 }
depends_on = ["deck.inp"]
selection = ["a", "b"]
[measurement]
responses = "measured.csv"
[sensitivity]
samples = 8
[calibration]
population = 6
generations = 3
refine = false
cases = [{ name = "A1", seed = 1 }]
"""

pytestmark = pytest.mark.usefixtures("functions_in_this_process", "undrawn")


@pytest.fixture
def powers(tmp_path, monkeypatch):
    """Makes a study ``powers`` in the current directory, its model's function as told."""
    monkeypatch.chdir(tmp_path)

    def make(function="closed(power)", before=""):
        folder = Path("powers")
        folder.mkdir()
        (folder / "study.toml").write_text(STUDY)
        (folder / "model.py").write_text(MODEL.format(function=function, before=before))
        (folder / "deck.inp").write_text("1.0")
        (folder / "measured.csv").write_text("response,value,std\ny,3.0,0.1\nz,1.0,0.1\n")
        return folder

    return make


def changed(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def fingerprint(folder: Path) -> str:
    found = LoadedStudy.load(folder).problem.fingerprint
    assert LoadedStudy.load(folder).problem.fingerprint == found
    return found


OPTION = ("study.toml", "power = 1.0 }", "power = 1.7 }")


@pytest.mark.parametrize(
    ("function", "change"),
    [
        ("closed(power)", OPTION),
        ("partial(given, power=power)", OPTION),
        ("Kept(np.array([0.0, power]))", OPTION),
        ("lambda values, power=power: given(values, power=power)", OPTION),
        ("closed(len(Path(__file__).with_name('deck.inp').read_text()))", ("deck.inp", "1.0", "11.0")),
        ("closed(power)", ("deck.inp", "1.0", "2.0")),
        ("closed(power)", ("parts/shape.py", "1", "2")),
        ("closed(power)", ("model.py", "values[\"b\"]", "2 * values[\"b\"]")),
    ],
)  # fmt: skip
def test_whatever_a_function_depends_on_is_in_its_fingerprint(powers, function, change):
    folder = powers(function)
    (folder / "parts").mkdir()
    (folder / "parts/shape.py").write_text("SIZE = 1\n")
    before = fingerprint(folder)
    changed(folder / change[0], *change[1:])
    assert fingerprint(folder) != before


def test_what_does_not_matter_to_a_function_is_not_in_its_fingerprint(powers, tmp_path):
    folder = powers()
    before = fingerprint(folder)
    for place in ("results/powers_extended", "another"):
        (folder / place).mkdir(parents=True)
        (folder / place / "study.toml").write_text("")
        (folder / place / "model.py").write_text("")
    changed(folder / "study.toml", "samples = 8", "samples = 9")
    (folder / "notes.txt").write_text("remember")
    assert fingerprint(folder) == before
    (tmp_path / "elsewhere").mkdir()
    os.rename(folder, tmp_path / "elsewhere/powers")
    assert fingerprint(tmp_path / "elsewhere/powers") == before


def test_a_file_that_a_study_depends_on_must_exist(powers):
    folder = powers()
    (folder / "deck.inp").unlink()
    with pytest.raises(InputError, match=r"there is no file 'deck\.inp'") as caught:
        LoadedStudy.load(folder)
    assert caught.value.place.endswith("study.toml, line 5")


def test_what_cannot_be_looked_into_and_what_holds_itself():
    loop = [1.0]
    loop.append(loop)
    with open(os.devnull) as stream:
        assert digest_of(stream, loop) == digest_of(stream, loop) != digest_of(stream, [1.0])
    assert digest_of({1, 2}) != digest_of({1, 3}) and digest_of((1, 2)) != digest_of([1, 2])


@pytest.mark.slow
def test_what_an_object_has_kept_of_its_answers_is_no_part_of_what_it_is():
    rig = bogie_on_rig(0.3)
    told = digest_of(rig)
    rig.locator.row((0.0, 0.5, 0.0), 1)
    assert "_known" in vars(rig.locator.frame)
    assert digest_of(rig) == told != digest_of(bogie_on_rig(0.25))


@pytest.mark.parametrize("form", ["csr", "csc", "coo", "bsr", "dok", "lil", "dia"])
@pytest.mark.parametrize("kind", [sp.coo_array, sp.coo_matrix])
def test_of_a_sparse_matrix_count_its_entries(kind, form):
    rows, columns, values = [0, 1, 1, 1, 1], [2, 2, 0, 2, 2], [3.0, 0.1, 5.0, 0.2, 0.3]

    def told(values, shape=(2, 4)):
        matrix = kind((values, (rows, columns)), shape).asformat(form)
        first = digest_of(lambda v: matrix @ v)
        getattr(matrix, "has_canonical_format", None), matrix @ np.ones(shape[1])  # both may note what they have found
        assert digest_of(lambda v: matrix @ v) == first
        if hasattr(matrix, "sum_duplicates"):
            matrix.sum_duplicates()
        assert digest_of(lambda v: matrix @ v) == first
        return first

    assert len({told(values), told([3.0, 0.1, 5.5, 0.2, 0.3]), told(values, (2, 5))}) == 3


def test_neither_the_order_of_its_entries_nor_what_scipy_has_noted_of_it_counts():
    sorted_one = sp.csr_array(([1.0, 2.0, 3.0], [0, 2, 1], [0, 2, 3]), (2, 3))
    told = digest_of(sorted_one)
    assert sorted_one.has_canonical_format and digest_of(sorted_one) == told
    other = sp.csr_array(([2.0, 1.0, 3.0], [2, 0, 1], [0, 2, 3]), (2, 3))
    assert digest_of(sorted_one) == digest_of(other) != digest_of(sorted_one.T.tocsr())
    assert other.indices.tolist() == [2, 0, 1]


# -- stored points, asked anew -----------------------------------------------------------------------------------------

HIDDEN = "import os\nFILE = os.environ['CALIB_TEST_DECK']\n"
READING = "lambda values: {'y': values['a'] ** float(open(FILE).read()), 'z': values['b']}"


def told(capsys, *arguments):
    capsys.readouterr()
    assert cli.execute(list(arguments)) == 2
    return capsys.readouterr().err


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("verb", [["sensitivity"], ["sensitivity", "--method", "morris"], ["calibrate"]])
def test_a_model_that_reads_what_nobody_declared_is_told(powers, capsys, monkeypatch, tmp_path, verb):
    monkeypatch.setenv("CALIB_TEST_DECK", str(tmp_path / "hidden.inp"))
    (tmp_path / "hidden.inp").write_text("1.0")
    powers(READING, HIDDEN)
    assert cli.execute([*verb[:1], "powers", *verb[1:], "--workers", "1"]) == 0
    assert cli.execute([*verb[:1], "powers", *verb[1:], "--workers", "1"]) == 0
    (tmp_path / "hidden.inp").write_text("1.7")
    said = told(capsys, *verb[:1], "powers", *verb[1:], "--workers", "1")
    assert "'y'" in said and "depends_on" in said
    (tmp_path / "hidden.inp").write_text("1.0")
    assert cli.execute([*verb[:1], "powers", *verb[1:], "--workers", "1"]) == 0


@pytest.mark.parametrize("verb", ["sensitivity", "calibrate"])
def test_a_model_that_is_not_deterministic_is_told_at_its_first_run(powers, capsys, verb):
    powers("lambda values: {'y': values['a'] + DRAW.random(), 'z': values['b']}", "DRAW = np.random.default_rng(1)")
    assert "not deterministic" in told(capsys, verb, "powers", "--workers", "1")


@pytest.mark.parametrize("taken", [0, 1])
def test_a_failure_that_passes_is_no_stale_point(powers, capsys, taken):
    """The first call fails, as where a licence is taken, or the second."""
    powers(
        "lambda values: {'y': values['a'] / float(next(CALLS) != TAKEN), 'z': values['b']}",
        f"import itertools\nCALLS, TAKEN = itertools.count(), {taken}",
    )
    said = told(capsys, "calibrate", "powers", "--workers", "1")
    assert "retry" in said and "calib again" in said and "stale" not in said


def test_a_slow_model_that_is_not_deterministic_is_told_when_its_best_point_is_asked_anew(powers, capsys, monkeypatch):
    monkeypatch.setattr("calib.analyses.provenance.stored.CHEAP", 0.0)
    powers("lambda values: {'y': values['a'] + DRAW.random(), 'z': values['b']}", "DRAW = np.random.default_rng(1)")
    assert "not deterministic" in told(capsys, "calibrate", "powers", "--workers", "1")
