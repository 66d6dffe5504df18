"""Frequency response functions written to universal files and read back, by our reader and by pyuff alone."""

import struct
from dataclasses import replace

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.files.uff_frf_write import write_uff_frfs
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, Sensor

EVEN = 0.25 * np.arange(1, 31)
UNEVEN = np.array([0.5, 0.75, 1.5, 10.125, 100.5])
EXACT = {"double": 5e-12, "single": 5e-6, "binary": 0.0}
"""Largest relative error of a value: half a unit of its last digit."""


def functions(freq=EVEN, quantity="accelerance", seed=1, **changes):
    """Random functions over seven decades at places in all directions; one of them was not measured."""
    rng = np.random.default_rng(seed)
    responses = tuple(Sensor(10 + k, d, (0.1 * k, -0.2, 1.5)) for k, d in enumerate(DIRECTIONS))
    references = (Sensor(10, "x", (0.0, -0.2, 1.5)), Sensor(99, "rz", (1.0, 2.0, -3.0)))
    shape = (len(freq), len(responses), len(references))
    values = 10 ** rng.uniform(-6, 1, shape) * np.exp(2j * np.pi * rng.random(shape))
    values[:, 2, 1] = np.nan
    given = {"freq": freq, "responses": responses, "references": references, "quantity": quantity, "values": values}
    return MeasuredFRFs(**{**given, "std": np.full(shape, np.nan), **changes})


def written(tmp_path, frfs, **more):
    path = tmp_path / "one.uff"
    write_uff_frfs(path, frfs, **more)
    return path


@pytest.mark.parametrize("form", EXACT)
@pytest.mark.parametrize("freq", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_what_is_written_is_read_back_to_its_digits(tmp_path, form, freq, quantity):
    frfs = functions(freq, quantity)
    found = read_uff_frfs(written(tmp_path, frfs, form=form))
    assert found.quantity == quantity and found.notes == ()
    np.testing.assert_array_equal(found.freq, freq)
    assert len(found.functions) == 11
    for i, response in enumerate(frfs.responses):
        for j, reference in enumerate(frfs.references):
            key = (response.node, response.direction), (reference.node, reference.direction)
            if (i, j) == (2, 1):
                assert key not in found.functions
                continue
            true, own = frfs.values[:, i, j], found.functions[key]
            assert np.all(np.abs(own.real - true.real) <= EXACT[form] * np.abs(true.real))
            assert np.all(np.abs(own.imag - true.imag) <= EXACT[form] * np.abs(true.imag))


def test_binary_frequencies_lose_nothing(tmp_path):
    freq = np.sort(np.random.default_rng(3).uniform(1, 100, 20))
    np.testing.assert_array_equal(read_uff_frfs(written(tmp_path, functions(freq), form="binary")).freq, freq)
    text = read_uff_frfs(written(tmp_path, functions(freq))).freq
    np.testing.assert_allclose(text, freq, rtol=5e-6)
    assert not np.array_equal(text, freq)


def test_a_spacing_that_six_digits_cannot_hold_is_written_line_by_line(tmp_path):
    freq = np.arange(1, 1001) / 3  # the step as six digits would shift the last line by a thousandth of a step
    found = read_uff_frfs(written(tmp_path, functions(freq, values=np.ones((1000, 6, 2)) * (1 + 1j)))).freq
    np.testing.assert_allclose(found, freq, rtol=5e-6)


@pytest.mark.parametrize("freq", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_a_binary_function_states_its_number_of_bytes(tmp_path, freq):
    frfs = functions(freq)
    data = written(tmp_path, frfs, form="binary").read_bytes()
    heads = [k for k in range(len(data)) if data.startswith(b"    58b", k)]
    assert len(heads) == 11
    numbers = len(freq) * (2 if np.array_equal(freq, EVEN) else 3)
    for head in heads:
        start = head
        texts, count = int(data[head + 19 : head + 31]), int(data[head + 31 : head + 43])
        for _ in range(texts + 1):
            start = data.index(b"\n", start) + 1
        assert count == 8 * numbers and data[start + count :].startswith(b"    -1\n")
    first = struct.unpack(f"<{numbers}d", data[start : start + count])
    last = frfs.values[:, -1, -1]
    np.testing.assert_array_equal(first[-2:], [last[-1].real, last[-1].imag])


@pytest.mark.parametrize("synthetic", [True, False])
def test_the_header_holds_units_places_and_whether_it_is_synthetic(tmp_path, synthetic):
    path = written(tmp_path, functions(synthetic=synthetic), title="a  test\nof two lines")
    sets = pyuff.UFF(str(path)).read_sets()
    assert [data["type"] for data in sets[:4]] == [151, 164, 15, 58]
    assert sets[1]["units_code"] == 1 and sets[1]["length"] == sets[1]["force"] == 1.0
    assert sets[0]["model_name"].strip() == ("SYNTHETIC " if synthetic else "") + "a test of two lines"
    for data in sets[3:]:
        assert data["id1"].startswith("SYNTHETIC ") == synthetic and data["id2"].strip() == "a test of two lines"
        assert data["func_type"] == 4 and data["orddenom_spec_data_type"] == 13
    nodes = dict(zip(sets[2]["node_nums"], zip(*(sets[2][c] for c in "xyz"), strict=True), strict=True))
    assert nodes[99] == (1.0, 2.0, -3.0) and len(nodes) == 7


def test_without_places_there_is_no_table_of_nodes_and_the_same_functions_give_the_same_bytes(tmp_path):
    frfs = functions(responses=tuple(Sensor(10 + k, d) for k, d in enumerate(DIRECTIONS)))
    first = written(tmp_path, frfs).read_bytes()
    assert b"\n    15\n" not in first and read_uff_frfs(tmp_path / "one.uff").functions
    assert written(tmp_path, frfs).read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["one.uff"]


def changed(at, value):
    values = functions().values
    values[at] = value
    return {"values": values}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (changed((3, 0, 0), np.nan), "10x/10x holds a value that is not a finite number"),
        (changed((3, 1, 0), 2e100), "11y/10x holds"),
        (changed(np.s_[:, 3, 1], 0.0), "13rx/99rz is zero on every line"),
        (changed(np.s_[:], np.nan), "no function was measured"),
        ({"references": (Sensor(10, "x"), Sensor(10, "x"))}, "a reference is given twice"),
        ({"responses": tuple(Sensor(10**10 + k, "x") for k in range(6))}, "ten digits"),
        ({"references": (Sensor(10, "x", (9.0, 0.0, 0.0)), Sensor(99, "rz", (1.0, 0.0, 0.0)))}, "two places"),
        ({"freq": 1000.0 + 1e-3 * np.sqrt(np.arange(30))}, "six digits"),
    ],
)
def test_what_the_format_cannot_hold_is_refused_and_nothing_is_left(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        write_uff_frfs(tmp_path / "one.uff", functions(**changes))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_missing_is_named_and_an_old_file_survives_a_failure(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="cannot be written"):
        write_uff_frfs(tmp_path / "nowhere" / "one.uff", functions())
    old = written(tmp_path, functions()).read_bytes()
    monkeypatch.setattr("pyuff.UFF.write_sets", lambda self, *_, **__: open(self._filename, "w").write("half") / 0)
    with pytest.raises(InputError, match="cannot be written"):
        write_uff_frfs(tmp_path / "one.uff", replace(functions(), synthetic=True))
    assert (tmp_path / "one.uff").read_bytes() == old and len(list(tmp_path.iterdir())) == 1
