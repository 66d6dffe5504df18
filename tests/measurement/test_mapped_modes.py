"""Modes from MATLAB files and workbooks by names that the user gives: the same as from tables."""

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from calib.errors.errors import InputError
from calib.measurement.files import matlab
from calib.measurement.files.read import read_modes
from calib.study.study_file import StudyFile

FREQ, DAMPING = np.array([8.0, 12.5]), np.array([0.02, 0.01])
SHAPES = np.array([[1.0, -0.5], [0.25, 1.0], [0.5 + 0.1j, np.nan]])
CHANNELS = ["1y", "2-y", "3z"]
NAMED = {"freq": "f", "damping": "zeta", "shapes": "Phi"}
MODES = "mode,freq,freq_kind,freq_std,damping\nA,8.0,natural,0.1,0.02\nB,12.5,natural,,0.01\n"
LINES = "mode,node,direction,re,im\nA,1,y,1,0\nA,2,-y,0.25,0\nA,3,z,0.5,0.1\nB,1,y,-0.5,0\nB,2,-y,1,0\n"


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """MATLAB files are read in this process, which is faster."""
    monkeypatch.setattr(matlab, "apart", lambda function, *given: function(*given))


@pytest.fixture
def tables(tmp_path):
    (tmp_path / "modes.csv").write_text(MODES)
    (tmp_path / "shapes.csv").write_text(LINES)
    return read_modes(tmp_path / "modes.csv", shapes=tmp_path / "shapes.csv")


def the_same(found, tables, names=("A", "B")):
    assert found.names == names
    assert [(s.node, s.direction) for s in found.sensors] == [(s.node, s.direction) for s in tables.sensors]
    for name in ("natural_freq", "damping_ratio", "shapes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(tables, name))


def in_version_7_3(path, values):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in values.items():
            array = np.atleast_2d(value).T
            if np.iscomplexobj(array):
                array = np.rec.fromarrays([array.real, array.imag], names="real,imag")
            file[name] = array
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\0\2IM" + path.read_bytes()[128:])


@pytest.mark.parametrize("shapes", [SHAPES, SHAPES.T])
@pytest.mark.parametrize("save", [savemat, in_version_7_3])
def test_variables_of_a_matlab_file(tmp_path, tables, shapes, save):
    save(tmp_path / "test.mat", {"f": FREQ, "zeta": DAMPING, "Phi": shapes})
    found = read_modes(tmp_path / "test.mat", variables=NAMED, channels=CHANNELS)
    the_same(found, tables, ("1", "2"))
    keys = f"files = ['test.mat']\nchannels = {CHANNELS}\n[measurement.variables]\n"
    keys += "".join(f"{name} = '{own}'\n" for name, own in NAMED.items())
    (tmp_path / "study.toml").write_text(f"title = 'Mast'\nmodel = 'model.py:mast'\n[measurement]\n{keys}")
    the_same(StudyFile.read(tmp_path).measured_data(), tables, ("1", "2"))


def test_damped_frequencies_and_modes_without_shapes(tmp_path):
    savemat(tmp_path / "test.mat", {"fd": FREQ * np.sqrt(1 - DAMPING**2), "zeta": DAMPING, "s": [0.1, np.nan]})
    named = {"damped_freq": "fd", "damping": "zeta", "freq_std": "s"}
    found = read_modes(tmp_path / "test.mat", variables=named)
    np.testing.assert_allclose(found.natural_freq, FREQ, rtol=1e-14)
    assert not found.has_shapes and found.freq_std[0] == pytest.approx(0.1, rel=1e-3)


def test_files_are_repeats(tmp_path):
    rng = np.random.default_rng(0)
    for k in range(4):
        savemat(tmp_path / f"{k}.mat", {"f": FREQ + rng.normal(0, 0.01, 2), "Phi": SHAPES[:2].real})
    found = read_modes(tmp_path / "*.mat", variables={"freq": "f", "shapes": "Phi"}, channels=CHANNELS[:2])
    assert found.n_repeats == 4 and np.all((found.freq_std > 0) & (found.freq_std < 0.02))


@pytest.mark.parametrize(
    ("variables", "channels", "words"),
    [
        ({"damping": "zeta"}, [], "frequencies are not named"),
        ({"freq": "f", "damped_freq": "f"}, [], "natural and damped"),
        ({"freq": "g"}, [], "'g'.* it holds"),
        ({"freq": "f", "dampling": "zeta"}, [], "'dampling'"),
        ({"freq": "f", "damping": "Phi"}, [], "'Phi' has 6 complex numbers for 2 modes"),
        ({"freq": "f", "shapes": "Phi"}, [], r"channels = \['1z'"),
        ({"freq": "f", "shapes": "Phi"}, CHANNELS[:2], r"\(3, 2\), for 2 channels and 2 modes"),
        ({"freq": "f", "shapes": "Phi"}, [*CHANNELS[:2], "x3"], "'x3'"),
        ({"freq": "f", "shapes": "Phi"}, [*CHANNELS[:2], "1y"], "row 3.* 1y is given twice"),
        ({"freq": "bad"}, [], "mode 2, variable bad.*-1 Hz"),
        ({"freq": "f", "damping": "bad"}, [], "mode 1, variable bad.*ratio 8"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, variables, channels, words):
    path = tmp_path / "test.mat"
    savemat(path, {"f": FREQ, "zeta": DAMPING, "Phi": SHAPES, "bad": [8.0, -1.0]})
    with pytest.raises(InputError, match=words) as caught:
        read_modes(path, variables=variables, channels=channels)
    assert str(path) in str(caught.value)


def workbook(path, **sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        page = book.create_sheet(name)
        for row in rows:
            page.append(row)
    book.save(path)
    return path


def cells(text):
    def number(cell):
        try:
            return float(cell)
        except ValueError:
            return cell or None

    return [[number(cell) for cell in line.split(",")] for line in text.splitlines()]


RENAMED = [["Measured on Monday"], ["No", "f (Hz)", "zeta", "by"], ["A", 8, 0.02, "ab"], ["B", 12.5, 0.01, "cd"]]
CALLED = {"mode": "No", "freq": "f (Hz)", "damping": "zeta"}
WIDE = [["Sensor", "A re", "A im", "B"], ["1y", 1, 0, -0.5], ["2-y", 0.25, 0, 1], ["3z", 0.5, 0.1, None]]
APART = [["node", "direction", *WIDE[0][1:]], *([int(r[0][0]), r[0][1:], *r[1:]] for r in WIDE[1:])]


@pytest.mark.parametrize("wide", [WIDE, APART])
def test_a_workbook_with_sheets_of_its_own_form(tmp_path, tables, wide):
    path = workbook(tmp_path / "test.xlsx", Notes=[["none"]], Modes=RENAMED, Shapes=wide)
    found = read_modes(path, variables=CALLED | {"sheet": "Modes", "shapes": "Shapes"})
    the_same(found, tables)


def test_a_workbook_of_tables(tmp_path, tables):
    path = workbook(tmp_path / "test.xlsx", modes=cells(MODES), shapes=cells(LINES))
    the_same(read_modes(path, variables={"shapes": "shapes"}), tables)


def test_modes_without_names_are_those_of_the_columns_in_order(tmp_path, tables):
    rows = [["freq", "damping"], [8, 0.02], [12.5, 0.01]]
    path = workbook(tmp_path / "test.xlsx", modes=rows, shapes=WIDE)
    the_same(read_modes(path, variables={"shapes": "shapes"}), tables, ("1", "2"))


@pytest.mark.parametrize(
    ("modes", "shapes", "variables", "words"),
    [
        (RENAMED, WIDE, {}, "freq"),
        (RENAMED, WIDE, CALLED | {"damping": "damp"}, "'damp'"),
        (RENAMED, WIDE, CALLED | {"shapes": "None"}, "no sheet 'None'"),
        (RENAMED[:2], WIDE, CALLED, "nothing below"),
        ([*RENAMED, ["C", "x", 0.1]], WIDE, CALLED, r"row 5, column f \(Hz\).*'x'"),
        ([["freq", "dampng"], [8, 0.1]], WIDE, {}, "'dampng'"),
        (RENAMED, [["", "A", "D"], ["1y", 1, 2]], CALLED | {"shapes": "shapes"}, "'D'"),
        (RENAMED, [["", "A"], ["1y", "much"]], CALLED | {"shapes": "shapes"}, "row 2.*'much'"),
        (RENAMED, [["", "A"], ["y1", 1]], CALLED | {"shapes": "shapes"}, "'y1'"),
    ],
)
def test_a_workbook_that_does_not_fit_is_refused(tmp_path, modes, shapes, variables, words):
    path = workbook(tmp_path / "test.xlsx", modes=modes, shapes=shapes)
    with pytest.raises(InputError, match=words) as caught:
        read_modes(path, variables=variables)
    assert str(path) in str(caught.value)


def test_names_belong_to_such_files_alone(tmp_path, tables):
    with pytest.raises(InputError, match="leave them out"):
        read_modes(tmp_path / "modes.csv", variables={"freq": "f"})
    savemat(tmp_path / "test.mat", {"f": FREQ})
    with pytest.raises(InputError, match="one format"):
        read_modes(tmp_path / "test.mat", shapes=tmp_path / "shapes.csv", variables={"freq": "f"})
