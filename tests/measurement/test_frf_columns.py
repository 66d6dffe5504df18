"""FRFs as engineers have them: functions side by side, one text file each, channels that the file does not name."""

import zipfile

import numpy as np
import pytest
import pyuff
from scipy.io import savemat

from calib.errors.errors import InputError
from calib.measurement.files import matlab
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.places import Doubt

FREQ = np.arange(2.0, 22.0, 0.5)
W = 2 * np.pi * FREQ
VALUES = {name: 1 / (k - W**2 + 0.05j * k) for name, k in (("1z/1z", 3e3), ("2z/1z", 8e3), ("3x/1z", 1e4))}


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """MATLAB files are read in this process, which is faster."""
    monkeypatch.setattr(matlab, "apart", lambda function, *given: function(*given))


def wide(parts, separator=",", head="# unit: m/N\n", names=None, comma=False):
    """A table of all functions; ``parts`` name -> function of the values."""
    columns = [FREQ, *(make(values) for values in VALUES.values() for make in parts.values())]
    header = names or ["Frequency (Hz)", *(f"{name} {part}" for name in VALUES for part in parts)]
    lines = [
        separator.join(f"{x:.15g}".replace(".", "," if comma else ".") for x in row)
        for row in zip(*columns, strict=True)
    ]
    return head + "\n".join([separator.join(header), *lines]) + "\n"


RE_IM = {"re": np.real, "im": np.imag}
POLAR = {"magnitude": np.abs, "phase (deg)": lambda v: np.degrees(np.angle(v))}


def check(frfs):
    assert [one.name for one in frfs.functions] == list(VALUES) and frfs.quantity == "receptance"
    np.testing.assert_allclose(frfs.freq, FREQ)
    for one in frfs.functions:
        np.testing.assert_allclose(frfs.values[one.index], VALUES[one.name], rtol=1e-10)


@pytest.mark.parametrize(
    ("parts", "options"),
    [
        (RE_IM, {}),
        (POLAR, {}),
        ({"mag [dB]": lambda v: 20 * np.log10(np.abs(v)), "phase_rad": np.angle}, {}),
        ({"Real": np.real, "Imag": np.imag}, {"separator": ";", "comma": True}),
        (RE_IM, {"separator": "\t"}),
    ],
)
def test_functions_side_by_side(tmp_path, parts, options):
    path = tmp_path / "wide.csv"
    path.write_text(wide(parts, **options))
    check(read_frfs(path))


@pytest.mark.parametrize(
    ("form", "parts"),
    [
        ("Point{}:+{}/Point{}:+{}", ("Mag (m/N)", "Phase (deg)")),
        ("Deck:{}:+{}/Deck:{}:+{}", ("Mag (dB re 1 m/N)", "Phase [rad]")),
        ("FRF 7 {}{} / {}{}", ("re (m/N)", "im (m/N)")),
        ("H({}{}/{}{})", ("re [mm/N]", "im [mm/N]")),
    ],
)
def test_columns_are_named_as_analysers_do(tmp_path, form, parts):
    made = {
        "Mag (m/N)": np.abs, "Phase (deg)": lambda v: np.degrees(np.angle(v)), "Phase [rad]": np.angle,
        "Mag (dB re 1 m/N)": lambda v: 20 * np.log10(np.abs(v)), "re (m/N)": np.real, "im (m/N)": np.imag,
        "re [mm/N]": lambda v: 1e3 * v.real, "im [mm/N]": lambda v: 1e3 * v.imag,
    }  # fmt: skip
    channels = [form.format(*name.replace("/", "").upper()) for name in VALUES]
    names = ["Frequency", *(f"{channel} {part}" for channel in channels for part in parts)]
    path = tmp_path / "wide.csv"
    path.write_text(wide({part: made[part] for part in parts}, names=names, head=""))
    if "dB" in parts[0]:
        check(read_frfs(path, unit="m/N"))
        return
    check(read_frfs(path))
    with pytest.raises(InputError, match=r"it states the unit .?m/N, not cm/N"):
        read_frfs(path, unit="cm/N")


def test_units_behind_the_names_of_columns_must_agree(tmp_path):
    path = tmp_path / "wide.csv"
    units = ("m/N", "mm/N", "m/N")
    names = ["f", *(f"{name} {part} ({unit})" for name, unit in zip(VALUES, units, strict=True) for part in RE_IM)]
    path.write_text(wide(RE_IM, names=names, head=""))
    with pytest.raises(InputError, match="'m/N' and 'mm/N'"):
        read_frfs(path)


@pytest.mark.parametrize("foreign", ["Mic 7z/1z {} (Pa/N)", "Mic:7:z/1z {}", "Strain gauge 7z/1z {}"])
def test_columns_of_a_microphone_are_left_out_and_noted(tmp_path, foreign):
    path, names = tmp_path / "wide.csv", [f"{name} {part}" for name in VALUES for part in RE_IM]
    rows = wide(RE_IM, names=["f", *names]).splitlines()
    at = next(k for k, row in enumerate(rows) if row.startswith("f,"))
    more = [foreign.format(part) for part in RE_IM]
    every = [",".join([row, *(more if k == 0 else ["3.0", "4.0"])]) for k, row in enumerate(rows[at:])]
    path.write_text("\n".join([*rows[:at], *every]))
    found = read_frfs(path)
    check(found)
    assert [note for note in found.notes if isinstance(note, Doubt) and more[0] in note]
    path.write_text("\n".join([*rows[:at], ",".join(["f", *more]), "1,3,4", "2,3,4"]))
    with pytest.raises(InputError, match="no motion"):
        read_frfs(path)


@pytest.mark.parametrize("parts", [RE_IM, POLAR])
def test_channels_named_by_the_user(tmp_path, parts):
    path = tmp_path / "wide.csv"
    names = ["f", *(f"H{k} {part}" for k in range(3) for part in parts)]
    path.write_text(wide(parts, names=names))
    check(read_frfs(path, channels=list(VALUES)))
    for channels, words in (
        (["1z/1z"], "more functions"),
        ([*VALUES, "9z/1z"], "3 functions for 4"),
        (["1z"], "no response"),
    ):
        with pytest.raises(InputError, match=words):
            read_frfs(path, channels=channels)


def test_columns_with_coherence_and_entries_that_were_not_measured(tmp_path):
    path = tmp_path / "wide.csv"
    lines = wide({**RE_IM, "coherence": lambda v: np.full(len(v), 0.9)}).splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:4], "", "", *cells[6:]])
    path.write_text("\n".join(lines))
    frfs = read_frfs(path, averages=4)
    assert np.isnan(frfs.values[5, 1, 0]) and np.isfinite(frfs.values[5, 0, 0])
    np.testing.assert_allclose(frfs.std[0, 0, 0], np.abs(VALUES["1z/1z"][0]) * np.sqrt(0.1 / (2 * 4 * 0.9)))


@pytest.mark.parametrize(
    "head", ["", "Measured by hand\n\nf/Hz\tRe\tIm\n", "% made by a script\nFrequency Magnitude Phase\n"]
)
def test_one_text_file_for_each_function_repeat_by_repeat(tmp_path, head):
    polar = "Phase" in head
    for repeat in (1, 2):
        for k, values in enumerate(VALUES.values()):
            parts = (
                [np.abs(values) * repeat, np.degrees(np.angle(values))]
                if polar
                else [repeat * values.real, repeat * values.imag]
            )
            rows = zip(FREQ, *parts, strict=True)
            text = head + "\n".join("\t".join(f"{x:.14e}" for x in row) for row in rows) + "\n"
            (tmp_path / f"r{repeat}_{k}.txt").write_text(text)
    frfs = read_frfs(str(tmp_path / "r1_*.txt"), channels=list(VALUES), unit="m/N")
    check(frfs)
    both = read_frfs(str(tmp_path / "r*.txt"), channels=list(VALUES), unit="m/N")
    assert both.n_repeats == 2
    np.testing.assert_allclose(both.values, 1.5 * frfs.values)
    with pytest.raises(InputError, match="channels = "):
        read_frfs(str(tmp_path / "r1_*.txt"), unit="m/N")
    with pytest.raises(InputError, match="no multiple of the 2 channels"):
        read_frfs(str(tmp_path / "r1_*.txt"), unit="m/N", channels=["1z/1z", "2z/1z"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("freq,1z/1z re,1z/1z im\n1,2\n", "names 3"),
        ("Frequency (kHz),1z/1z re,1z/1z im\n1,2,3\n2,2,4\n", "'kHz'"),
        ("freq,1z/1z re,1z/1z im\n1,2,3\n2,x,4\n", "no number"),
        ("freq,1z/1z re\n1,2\n2,3\n", "re only"),
        ("freq,1z/1z re,1z/1z im\n1,2,3\n1,2,4\n", "twice"),
        ("freq,1z/1z re,1z/1z im,1-z/1z re,1-z/1z im\n1,2,3,4,5\n2,2,4,4,5\n", "along and against"),
        ("freq,1z/1z magnitude,1z/1z phase\n1,-2,3\n2,2,4\n", "negative"),
        ("freq,1z/1z re,1z/1z im\n1,2,0\n2,3,0\n", "amplitude"),
        ("freq,1z/1z re,1z/1z volts\n1,2,0\n2,3,0\n", "volts"),
        ("freq,1z/1z re,1z/1z re\n1,2,0\n2,3,0\n", "two columns"),
    ],
)
def test_what_is_no_table_of_functions_is_refused(tmp_path, text, words):
    path = tmp_path / "wide.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_frfs(path, unit="m/N")
    assert "wide.csv" in str(caught.value)


@pytest.mark.parametrize("nodes", [(0, 0, 0), (1, 2, 3)])
def test_functions_of_a_universal_file_without_directions(tmp_path, nodes):
    path = tmp_path / "f.unv"
    sets = [
        {
            "type": 58, "func_type": kind, "rsp_node": node, "rsp_dir": 0, "ref_node": 0, "ref_dir": 0, "x": FREQ,
            "data": values if kind == 4 else np.full(len(FREQ), 0.5), "abscissa_spacing": 1, "binary": 0,
            "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 8 if kind == 4 else 0,
            "orddenom_spec_data_type": 13 if kind == 4 else 0,
        }
        for kind in (4, 6) for node, values in zip(nodes, VALUES.values(), strict=True)
    ]  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    with pytest.raises(InputError, match="channels = "):
        read_frfs(path)
    frfs = read_frfs(path, channels=list(VALUES), averages=3)
    check(frfs)
    assert np.isfinite(frfs.std[:, 0, 0]).all()
    turned = read_frfs(path, channels=["1-z/1z", "2z/1z", "3x/1z"])
    np.testing.assert_allclose(turned.values[:, 0, 0], -VALUES["1z/1z"], rtol=1e-10)
    with pytest.raises(InputError, match="2 channels are named, but it holds 3"):
        read_frfs(path, channels=["1z/1z", "2z/1z"])


MATRIX = np.stack(list(VALUES.values()), axis=1)
NAMED = {"freq": "f", "frf": "H"}


@pytest.mark.parametrize("form", ["2-D", "turned", "3-D"])
def test_variables_of_a_matlab_file(tmp_path, form):
    path = tmp_path / "h.mat"
    shaped = {"2-D": MATRIX, "turned": MATRIX.T, "3-D": MATRIX[:, :, None]}[form]
    savemat(path, {"f": FREQ[:, None], "H": shaped, "C": np.full(shaped.shape, 0.8), "words": "by hand"})
    frfs = read_frfs(path, channels=list(VALUES), variables=NAMED | {"coherence": "C"}, unit="m/N", averages=4)
    check(frfs)
    np.testing.assert_allclose(frfs.std[:, 0, 0], np.abs(VALUES["1z/1z"]) * np.sqrt(0.2 / (2 * 4 * 0.8)))


@pytest.mark.parametrize(
    ("variables", "channels", "words"),
    [
        ({}, list(VALUES), "variables = "),
        ({"freq": "f", "frf": "G"}, list(VALUES), "no numeric variable 'G'"),
        ({"freq": "f", "frf": "words"}, list(VALUES), "no numeric variable 'words'"),
        (NAMED, ["1z/1z"], "1 channels"),
        (NAMED, ["1z/1z", "1z/1z", "2z/1z"], "named twice"),
        ({"freq": "f", "frf": "A"}, list(VALUES), "real"),
        ({"freq": "H", "frf": "H"}, list(VALUES), "ascend"),
    ],
)
def test_variables_that_do_not_fit_are_refused(tmp_path, variables, channels, words):
    path = tmp_path / "h.mat"
    savemat(path, {"f": FREQ, "H": MATRIX, "A": np.abs(MATRIX), "words": "by hand"})
    with pytest.raises(InputError, match=words):
        read_frfs(path, channels=channels, variables=variables, unit="m/N")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(InputError, match=r"h\.mat"):
        read_frfs(path, channels=channels, variables=variables, unit="m/N")


def test_a_matlab_file_of_version_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "h.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["f"] = FREQ[None, :]
        stored = np.zeros(MATRIX.T.shape, dtype=[("real", "f8"), ("imag", "f8")])
        stored["real"], stored["imag"] = MATRIX.T.real, MATRIX.T.imag
        file["H"] = stored
    head = "MATLAB 7.3 MAT-file".ljust(124).encode() + b"\x00\x02IM"
    path.write_bytes(head + path.read_bytes()[128:])
    check(read_frfs(path, channels=list(VALUES), variables=NAMED, unit="m/N"))


@pytest.mark.parametrize("sheet", [None, "FRFs"])
def test_a_sheet_of_a_workbook(tmp_path, sheet):
    openpyxl = pytest.importorskip("openpyxl")
    path, book = tmp_path / "h.xlsx", openpyxl.Workbook()
    page = book.active if sheet is None else book.create_sheet(sheet)
    page.append(["made up"])
    page.append(["freq", *(f"{name} {part}" for name in VALUES for part in RE_IM)])
    for k, f in enumerate(FREQ.tolist()):
        page.append([f, *(float(part(v[k])) for v in VALUES.values() for part in RE_IM.values())])
    book.save(path)
    check(read_frfs(path, unit="m/N", variables={} if sheet is None else {"sheet": sheet}))
    with pytest.raises(InputError, match="no sheet 'X'"):
        read_frfs(path, unit="m/N", variables={"sheet": "X"})
    page["B7"] = "lost"
    book.save(path)
    with pytest.raises(InputError, match="'lost'"):
        read_frfs(path, unit="m/N", variables={} if sheet is None else {"sheet": sheet})
    page["B7"] = 1.0
    book.save(path)
    sheets = {}
    with zipfile.ZipFile(path) as archive:
        sheets = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:  # the sheet is read row by row
        for name, content in sheets.items():
            archive.writestr(name, content[:-40] if "worksheets/" in name else content)
    with pytest.raises(InputError, match="no workbook"):
        read_frfs(path, unit="m/N", variables={} if sheet is None else {"sheet": sheet})
    path.write_bytes(b"PK nothing")
    with pytest.raises(InputError, match="no workbook"):
        read_frfs(path, unit="m/N")


def test_numbers_that_are_not_finite_bring_no_warning_of_numpy(tmp_path, recwarn):
    path = tmp_path / "h.csv"
    path.write_text("# unit: m/N\nfreq,1z/1z re,1z/1z im\n1,2,3\n2,1,1e400\n3,1,2\n")
    values = read_frfs(path).values.ravel()
    assert {2 + 3j, 1 + 2j} <= set(values[np.isfinite(values)].tolist())
    assert not [str(one.message) for one in recwarn.list if issubclass(one.category, RuntimeWarning)]
