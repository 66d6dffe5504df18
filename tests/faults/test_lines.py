"""Mistakes in the study's file, in tables and in universal files: the error carries file, line and column."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.command import cli
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.modal import Sensor

LOG = Path("calib-error.log")
SOUND = "def answer(values):\n    return {'y': values['a'], 'z': values['b']}\n"
RETURN = '    return FunctionModel("plain", SPACE, answer)'


# -- study.toml --------------------------------------------------------------------------------------------------------

KEYS = {
    "key misspelt": [("samples = 200", "⟦samplez⟧ = 200")],
    "section misspelt": [("[sensitivity]", "⟦[sensitivty]⟧")],
    "former key": [("[held_out]", "⟦[withheld]⟧")],
    "text for an integer": [("population = 30", 'population = ⟦"many"⟧')],
    "fraction for an integer": [("population = 30", "population = ⟦30.5⟧")],
    "text for a number": [("threshold = 0.3", 'threshold = ⟦"high"⟧')],
    "number for a list": [('selection = ["E", "m_top", "K_base"]', "selection = ⟦3⟧")],
    "number in a list of names": [("modes = []", "modes = [⟦3⟧]")],
    "wrong type in a list of tables": [('{ name = "A2", seed = 2 }', '{ name = "A2", seed = ⟦"one"⟧ }')],
    "unknown key in an inline table": [('{ name = "A2", seed = 2 }', '{ name = "A2", ⟦sead⟧ = 2, seed = 2 }')],
    "missing key in a list of tables": [('{ name = "A2", seed = 2 }', '⟦{ name = "A2" }⟧')],
    "cases of one name": [('"A2", seed', '⟦"A1"⟧, seed')],
    "a blank in a name": [('"A2", seed', '⟦"A 2"⟧, seed')],
    "model without its function": [('model = "model.py:mast"', 'model = ⟦"model.py"⟧')],
    "no cases": [('{ name = "A1", seed = 1 },\n    { name = "A2", seed = 2 },', ""), ("cases = [", "cases = ⟦[⟧")],
    "measured in two ways": [("[measurement]", "[[tests]]\nname = 'T'\nresponses = 'r.csv'\n⟦[measurement]⟧")],
    "number out of range": [("threshold = 0.3", "threshold = ⟦1.5⟧")],
    "limits reversed": [("limits = [0.3, 5.0]", "limits = ⟦[5.0, 0.3]⟧")],
    "search reversed": [("search = [0.2, 8.0]", "search = ⟦[8.0, 0.2]⟧")],
    "value outside its limits": [("value = 2.0", "value = ⟦20.0⟧")],
    "prior too small": [("# prior_sd = 1.0", "prior_sd = ⟦1e-300⟧")],
    "unknown parameter": [("[parameters.K_base]", "⟦[parameters.K_bass]⟧")],
    "unknown parameter selected": [('"m_top", "K_base"]', '"m_top", ⟦"K_best"⟧]')],
    "begin outside": [("population = 30", "begin_at = { E = ⟦900.0⟧ }\npopulation = 30")],
    "begin of another parameter": [("population = 30", "begin_at = { K_bass = ⟦1.0⟧ }\npopulation = 30")],
    "unknown mode held out": [("modes = []", 'modes = ["B1x", ⟦"B9x"⟧]')],
    "unknown sensor held out": [("sensors = []", 'sensors = [⟦"99x"⟧]')],
    "clusters of an unknown mode": [('B2z = ["mast.z"]', '⟦B9z⟧ = ["mast.z"]')],
    "unknown cluster": [('B2z = ["mast.z"]', 'B2z = ["mast.x", ⟦"mast.q"⟧]')],
    "override of an unknown mode": [("override = {}", 'override = { B1x = 1, ⟦"B 9"⟧ = 2 }')],
    "window reversed": [("freq_window = [0.5, 100.0]", "freq_window = ⟦[100.0, 0.5]⟧")],
    "too few modes": [("mode_count = 6", "mode_count = ⟦2⟧")],
    "weights zero": [("# weight_freq = 1.0", "weight_freq = ⟦0.0⟧"), ("# weight_mac = 1.0", "weight_mac = 0.0")],
    "file missing": [('shapes = ["shapes.csv"]', 'shapes = [⟦"shape.csv"⟧]')],
    "file of results missing": [("depends_on = []", 'depends_on = ["model.py", ⟦"deck.inp"⟧]')],
    "no such function": [('model = "model.py:mast"', 'model = ⟦"model.py:must"⟧')],
    "no such model file": [('model = "model.py:mast"', 'model = ⟦"mudel.py:mast"⟧')],
    "options that the model does not take": [("model_options = {}", "model_options = ⟦{ colour = 1 }⟧")],
    "effect without library": [("depends_on = []", 'with_effects = ⟦["lamp"]⟧')],
    "unknown parameter constrained": [
        (
            "[sensitivity]",
            "[[constraints]]\nname = 'c'\nlimits = [0, 1]\ncoefficients = { ⟦m_tip⟧ = 1.0 }\n[sensitivity]",
        )
    ],
    "limits of a constraint reversed": [
        (
            "[sensitivity]",
            "[[constraints]]\nname = 'c'\nlimits = ⟦[9, 1]⟧\ncoefficients = { m_top = 1.0 }\n[sensitivity]",
        )
    ],
    "base missing": [('title = "', 'base = ⟦"../none"⟧\ntitle = "')],
}
SYNTAX = {
    "header not closed": [("[held_out]  ", "[held_out⟦⟧  ")],
    "text not closed": [('std_of = "mean"  ', 'std_of = "mean⟦⟧  ')],
    "key twice": [("samples = 200", "samples = 200\nsamples⟦⟧ = 100")],
    "no value": [("samples = 200", "samples =⟦⟧ # ")],
}


def example(folder: Path) -> Path:
    write_example(folder)
    return folder


@pytest.mark.parametrize("changes", KEYS.values(), ids=KEYS)
def test_mistakes_in_a_study(tmp_path, changes, mistakes):
    folder = example(tmp_path / "mast")
    expected = mistakes.put(folder / "study.toml", *changes)
    mistakes.check(mistakes.refused(folder).at, expected)


@pytest.mark.parametrize("changes", SYNTAX.values(), ids=SYNTAX)
def test_a_study_that_is_no_toml(tmp_path, changes, mistakes):
    folder = example(tmp_path / "mast")
    expected = mistakes.put(folder / "study.toml", *changes)
    at = mistakes.refused(folder).at
    assert at is not None and (at.line, at.text.rstrip()) == (expected.line, expected.text)
    assert 1 <= at.column <= len(at.text) + 1  # where the parser stopped


def test_a_study_whose_last_lines_are_missing(tmp_path, mistakes):
    folder = example(tmp_path / "mast")
    text = (folder / "study.toml").read_text("utf-8")
    (folder / "study.toml").write_text(text[: text.index('"A2"')], "utf-8")
    at = mistakes.refused(folder).at
    assert at is not None and at.text.strip() == "{ name ="


def test_a_study_in_another_encoding(tmp_path, mistakes):
    folder = example(tmp_path / "mast")
    text = (folder / "study.toml").read_text("utf-8").replace("a mast with", "a ümlaut é")
    (folder / "study.toml").write_bytes(text.encode("utf-8").replace("é".encode(), b"\xe9"))
    at = mistakes.refused(folder).at
    assert at is not None and at.line == 3 and at.text[at.column - 1] == "\ufffd" and "ümlaut" in at.text


def test_a_study_with_a_byte_order_mark(tmp_path, mistakes):
    """As some editors of Windows write it, with their line ends."""
    folder = example(tmp_path / "mast")
    file = folder / "study.toml"

    def as_on_windows() -> None:
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))

    sound = file.read_bytes()
    as_on_windows()
    assert calib.Study.load(folder).loaded.settings.title.startswith("Example")
    file.write_bytes(b"title = 3\n" + sound.replace(b"title", b"# title", 1))
    as_on_windows()
    at = mistakes.refused(folder).at
    assert (at.line, at.text, at.column, at.length) == (1, "title = 3", 9, 1)


def test_a_key_of_the_study_below(tmp_path, mistakes):
    example(tmp_path / "mast")
    expected = mistakes.put(tmp_path / "mast/study.toml", ("limits = [0.3, 5.0]", "limits = ⟦[5.0, 0.3]⟧"))
    (tmp_path / "above").mkdir()
    (tmp_path / "above/study.toml").write_text('base = "../mast"\n[parameters.K_base]\nvalue = 1.0\n')
    mistakes.check(mistakes.refused(tmp_path / "above").at, expected)


def load_all(folder):
    return calib.Study.load(folder).loaded


TESTS = """title = "Two"
model = "model.py:model"
selection = ["a", "b"]
[[tests]]
name = "one"
responses = "measured.csv"
[[tests]]
name = "two"
responses = "measured.csv"
"""


@pytest.mark.parametrize(
    "lines",
    [
        "held_out = { responses = [⟦'q'⟧] }",
        "set = { ⟦c⟧ = 1.0 }",
        "set = { c = ⟦'x'⟧ }",
        "[tests.held_out]\nresponses = ['y', ⟦'q'⟧]",
        "accuracy = ⟦3.0⟧",
        "[tests.pairing]\n⟦treshold⟧ = 0.1",
        "[[tests]]\nname = ⟦'one'⟧\nresponses = 'measured.csv'",
        "⟦[pairing]⟧\nthreshold = 0.1",
    ],
)
def test_a_key_of_one_of_several_tests(plain, lines, mistakes):
    folder = plain(SOUND)
    expected = mistakes.marked(folder / "study.toml", TESTS + lines + "\n[calibration]\nstarts = 2\n")
    mistakes.check(mistakes.refused(folder, load_all).at, expected)


def test_what_no_test_has_is_shown_where_it_is_named(plain, mistakes):
    folder = plain(SOUND)
    expected = mistakes.marked(folder / "study.toml", TESTS.replace('"b"]', '⟦"c"⟧]'))
    mistakes.check(mistakes.refused(folder, load_all).at, expected)


# -- tables ------------------------------------------------------------------------------------------------------------

ENTRIES = {
    "letter in a number": ("modes.csv", "B1x,1.7117", "B1x,⟦1.7i17⟧"),
    "not a number": ("shapes.csv", "B1x,1,x,-0.13315", "B1x,1,x,⟦nan⟧"),
    "empty entry": ("modes.csv", "B1x,1.7117,natural", "B1x,⟦,⟧natural"),
    "blank entry": ("modes.csv", "B1x,1.7117,natural", "B1x,⟦ ⟧  ,natural"),
    "column missing": ("modes.csv", "mode,freq,freq_kind", "⟦⟧mode,freq"),
    "column misspelt": ("modes.csv", "freq,freq_kind,freq_std", "freq,freq_kind,⟦freq_sdt⟧"),
    "column twice": ("modes.csv", "damping,damping_std", "damping,⟦damping⟧"),
    "entry too many": ("shapes.csv", "B1x,1,x,-0.13315,0,0.02", "B1x,1,x,-0.13315,0,0.02, ⟦7⟧"),
    "mode twice": ("modes.csv", "B1z,", "⟦B1x⟧,"),
    "unknown mode": ("shapes.csv", "B1x,1,x", "⟦B7x⟧,1,x"),
    "unknown direction": ("shapes.csv", "B1x,1,x,", "B1x,1,⟦q⟧,"),
    "sensor twice": ("shapes.csv", "B1x,1,z,", "B1x,1,⟦x⟧,"),
    "no node": ("shapes.csv", "B1x,1,z,", "B1x,⟦1.5⟧,z,"),
    "node twice": ("sensors.csv", "4,0.0,6.0", "⟦3⟧,0.0,6.0"),
    "frequency of the wrong kind": ("modes.csv", "B1x,1.7117,natural", "B1x,1.7117,⟦undamped⟧"),
    "damping in percent": ("modes.csv", "natural,0.0051,0.004", "natural,0.0051,⟦4.0⟧"),
    "deviation too large": ("modes.csv", "natural,0.0051", "natural,⟦5.1⟧"),
    "sensor off the model": ("sensors.csv", "4,0.0,6.0,0.0", "⟦4⟧,0.0,9.0,0.0"),
    "quoted entry": ("modes.csv", "B1x,1.7117", '"B1,x""",  ⟦"1,7"⟧'),
    "not printable": ("modes.csv", "B1x,1.7117", "B1x,⟦\x07⟧1.7117"),
    "quotes not closed": ("modes.csv", "B1x,1.7117", 'B1x,⟦"⟧1.7117'),
}


@pytest.mark.parametrize(("name", "old", "new"), ENTRIES.values(), ids=ENTRIES)
def test_mistakes_in_a_table(tmp_path, name, old, new, mistakes):
    folder = example(tmp_path / "mast")
    expected = mistakes.put(folder / name, (old, new))
    mistakes.check(mistakes.refused(folder).at, expected)


def test_a_missing_entry_is_marked_behind_the_line(tmp_path, mistakes):
    folder = example(tmp_path / "mast")
    expected = mistakes.put(folder / "shapes.csv", ("B1x,1,x,-0.13315,0,0.02", "B1x,1,x,-0.13315,0⟦⟧"))
    at = mistakes.refused(folder).at
    assert at is not None and (at.line, at.text, at.column) == (expected.line, expected.text, len(expected.text) + 1)


def test_a_table_from_a_spreadsheet(plain, mistakes):
    folder = plain(SOUND)
    text = '\ufeffsep=;\r\nresponse;value;std\r\n"y; z";3,0;0,1\r\nz;1.0;0,1\r\n'
    (folder / "measured.csv").write_text(text, "utf-8", newline="")
    at = mistakes.refused(folder).at
    assert at is not None and (at.line, at.text, at.column, at.length) == (4, "z;1.0;0,1", 3, 3)


def test_a_byte_of_another_encoding(tmp_path, mistakes):
    folder = example(tmp_path / "mast")
    data = (folder / "modes.csv").read_bytes().replace(b"B1x", b"B\xb0x")
    (folder / "modes.csv").write_bytes(data)
    at = mistakes.refused(folder).at
    assert at is not None and at.column == 2 and at.text.startswith("B\ufffdx")


# -- universal files ---------------------------------------------------------------------------------------------------


@pytest.fixture
def universal(tmp_path) -> Path:
    path = tmp_path / "one.uff"
    sensors = [Sensor(n, "z", (float(n), 0.0, 0.0)) for n in (1, 2)]
    shapes = np.array([[1.0 + 0.5j], [0.25 - 0.125j]])
    write_uff(
        path,
        names=("1B",),
        natural_freq=np.array([5.0]),
        damping_ratio=np.array([0.01]),
        sensors=sensors,
        shapes=shapes,
    )
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2.50000e-01", "⟦2.50000e-0l⟧"),
        ("2.50000e-01", "⟦nan⟧"),
        ("    -1\n    55 ", "    -1\n⟦⟧    5B "),
    ],
)
def test_a_damaged_dataset(universal, old, new, mistakes):
    expected = mistakes.put(universal, (old, new))
    mistakes.check(mistakes.refused(universal, read_modes).at, expected)


def test_a_truncated_file_is_shown_where_its_last_dataset_begins(universal, mistakes):
    lines = universal.read_text().splitlines()
    universal.write_text("\n".join(lines[:-1]) + "\n")
    at = mistakes.refused(universal, read_modes).at
    assert at is not None and lines[at.line - 1].strip() == "-1" and lines[at.line].strip() == "55"


def test_a_dataset_without_a_wrong_entry_is_shown_by_its_number(universal, mistakes):
    text = universal.read_text()
    node = next(line for line in text.splitlines() if line.endswith("2.00000E+00  0.00000E+00  0.00000E+00"))
    universal.write_text(text.replace(node, node.replace("         2 ", "         1 ", 1)))  # node 1 has two places
    at = mistakes.refused(universal, read_modes).at
    assert at is not None and at.text.strip() == "15" and text.splitlines()[at.line - 1].strip() == "15"


# -- on the screen -----------------------------------------------------------------------------------------------------


def test_the_command_shows_sentence_file_line_and_mark(tmp_path, monkeypatch, capsys, one_sentence, mistakes):
    monkeypatch.chdir(tmp_path)
    example(Path("mast"))
    expected = mistakes.put(Path("mast/study.toml"), ("population = 30", 'population = ⟦"many"⟧'))
    assert cli.execute(["compare", "mast"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and not LOG.exists()
    _, where, line, mark = said.splitlines()
    assert where == f"  mast/study.toml, line {expected.line}"
    assert line == f"  {expected.line} | {expected.text}"
    assert mark.count("^") == len('"many"') and mark.index("^") == line.index('"many"')


def test_an_exception_keeps_its_traceback_in_the_log(plain, capsys, one_sentence, mistakes):
    folder = plain(SOUND)
    expected = mistakes.put(folder / "model.py", (RETURN, f"    ⟦1 / 0⟧\n{RETURN}"))
    assert cli.execute(["compare", "plain"]) == 2
    said = capsys.readouterr().err
    assert one_sentence(said) and "ZeroDivisionError: division by zero" in said and str(LOG) in said
    assert said.splitlines()[1:3] == [f"  plain/model.py, line {expected.line}", f"  {expected.line} |     1 / 0"]
    assert "Traceback" in LOG.read_text() and "1 / 0" in LOG.read_text()


def test_nothing_is_shown_where_there_is_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["compare", "nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert InputError("a", place="workers").at is None and not hasattr(InputError("a", place="workers"), "__notes__")
