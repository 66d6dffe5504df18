"""Universal files as other programs write them: binary functions, analysis data, Fortran's exponents."""

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.uff import drop_unmeasured, read_uff, write_uff
from calib.measurement.modal import Sensor

SENSORS = [Sensor(n, d, (float(n), 0.5, 0.0)) for n in (1, 2, 3) for d in ("y", "z")]
FREQ, DAMPING = np.array([1000.0, 2345.6]), np.array([0.01, 0.002])
ROOTS = 2 * np.pi * FREQ * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))


N_ROWS = len(SENSORS)


def shapes(n_rows=N_ROWS):
    rng = np.random.default_rng(3)
    return rng.normal(size=(n_rows, 2)) + 1j * rng.normal(size=(n_rows, 2))


def modes(path):
    write_uff(path, names=("a", "b"), natural_freq=FREQ, damping_ratio=DAMPING, sensors=SENSORS, shapes=shapes())
    return path


def binary_function(data, count=None):
    """A dataset 58b as other programs write it: eleven lines of text, then bytes."""
    size = len(data) if count is None else count
    head = f"{-1:6d}\n{58:6d}b{1:6d}{2:6d}{11:12d}{size:12d}{0:6d}{0:6d}{0:12d}{0:12d}\n"
    text = "".join(f"line {k}\n" for k in range(11))
    return (head + text).encode() + data + b"\n" + f"{-1:6d}\n".encode()


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_bytes_that_look_like_the_end_of_a_dataset_are_skipped(tmp_path, end):
    path = modes(tmp_path / "one.uff")
    plain = read_uff(path)
    data = b"\x00\x01" + end + b"    -1" + end + b"    55" + end + b"\xff\x1a    -1" + end
    path.write_bytes(binary_function(data) + path.read_bytes() + binary_function(data))
    found = read_uff(path)
    np.testing.assert_array_equal(found.repeat.natural_freq, plain.repeat.natural_freq)
    np.testing.assert_array_equal(found.repeat.shape_set.shapes, plain.repeat.shape_set.shapes)
    damaged = path.read_bytes().replace(b"5.00000E-01", b"        nan", 1)
    path.write_bytes(damaged)
    with pytest.raises(InputError) as caught:
        read_uff(path)
    line = int(caught.value.place.rsplit("line ", 1)[1])
    assert damaged.splitlines()[line].strip() == b"15"  # the line after the '-1' line that is named


@pytest.mark.parametrize("off", [-3, 5, 10**6])
def test_a_wrong_count_of_bytes_does_not_lose_the_rest(tmp_path, off):
    path = modes(tmp_path / "one.uff")
    data = bytes(range(14, 200))
    path.write_bytes(binary_function(data, len(data) + off) + path.read_bytes())
    assert read_uff(path).repeat.names == ("a", "b")


def test_a_damaged_count_of_lines_does_not_lose_the_rest(tmp_path):
    path = modes(tmp_path / "one.uff")
    damaged = binary_function(b"text").replace(f"{11:12d}".encode(), b"2" + 10 * b" " + b"1", 1)
    path.write_bytes(damaged + path.read_bytes())
    assert read_uff(path).repeat.names == ("a", "b")


def test_a_binary_function_cut_off_is_refused(tmp_path):
    path = modes(tmp_path / "one.uff")
    path.write_bytes(path.read_bytes() + binary_function(b"\n    -1\n" * 5)[:-20])
    with pytest.raises(InputError, match=r"one\.uff"):
        read_uff(path)


def analysis_data(kind, width, is_complex, *, result=8, location=1):
    """A dataset 2414 with the text of the format's description, for every mode."""
    values = shapes(3 * width)
    values = values if is_complex else values.real
    out = ""
    for m in range(2):
        root = ROOTS[m]
        reals = (0.0, FREQ[m], 0.0, 1.0, DAMPING[m], 0.0) if kind == 2 else (0.0,) * 6
        roots = (0.0,) * 6 if kind == 2 else (root.real, root.imag, 1.0, 0.0, 0.0, 0.0)
        out += f"{-1:6d}\n{2414:6d}\n{m + 1:10d}\n{'analysis':80}\n{location:10d}\n"
        out += "".join(f"{text:80}\n" for text in (f"mode {'ab'[m]}", "NONE", "NONE", "NONE", "NONE"))
        out += "".join(f"{n:10d}" for n in (1, kind, 2 if width == 3 else 3, result, 5 if is_complex else 2, width))
        out += "\n" + "".join(f"{n:10d}" for n in (0, 0, 0, 0, 1, m + 1, 0, 0)) + "\n" + f"{0:10d}{0:10d}\n"
        out += "".join(f"{x:13.5e}" for x in reals) + "\n" + "".join(f"{x:13.5e}" for x in roots) + "\n"
        for node in range(3):
            row = values[width * node : width * (node + 1), m]
            flat = [x for v in row for x in ((v.real, v.imag) if is_complex else (v,))]
            out += f"{node + 1:10d}\n"
            out += "".join("".join(f"{x:13.5e}" for x in flat[k : k + 6]) + "\n" for k in range(0, len(flat), 6))
        out += f"{-1:6d}\n"
    return out, values


@pytest.mark.parametrize("width", [3, 6])
@pytest.mark.parametrize(("kind", "is_complex"), [(2, False), (3, True), (7, True)])
def test_mode_shapes_of_analysis_data(tmp_path, kind, is_complex, width):
    text, values = analysis_data(kind, width, is_complex)
    path = tmp_path / "one.unv"
    path.write_text(text)
    (repeat,) = drop_unmeasured([read_uff(path).repeat])
    assert repeat.names == ("a", "b") and repeat.named
    np.testing.assert_allclose(repeat.natural_freq, FREQ, rtol=1e-5)
    np.testing.assert_allclose(repeat.damping_ratio, DAMPING, rtol=2e-3)
    directions = ("x", "y", "z", "rx", "ry", "rz")[:width]
    rows = [repeat.shape_set.sensors.index((node, d)) for node in (1, 2, 3) for d in directions]
    np.testing.assert_allclose(repeat.shape_set.shapes[rows], values, rtol=1e-5, atol=1e-5)
    path.write_text(text.replace("e-01", "D-01").replace("e+00", "d+00").replace("e+03", "D+03"))
    np.testing.assert_array_equal(read_uff(path).repeat.natural_freq, repeat.natural_freq)


def test_analysis_data_that_are_no_modes_are_noted(tmp_path):
    path = tmp_path / "one.unv"
    text, _ = analysis_data(3, 3, True)
    stress, _ = analysis_data(3, 3, True, result=2)
    elements, _ = analysis_data(2, 3, False, location=2)
    path.write_text(text + stress)
    found = read_uff(path).repeat
    assert found.names == ("a", "b")
    assert sum("2414" in note for note in found.notes) == 1
    path.write_text(stress + elements)
    with pytest.raises(InputError, match="no modes"):
        read_uff(path)
    path.write_text(text.replace(f"{ROOTS[0].imag:13.5e}", "          abc"))
    with pytest.raises(InputError, match=r"line 1: the dataset 2414 that starts here cannot be read"):
        read_uff(path)


def test_modes_of_datasets_55_come_before_those_of_2414(tmp_path):
    path = modes(tmp_path / "one.unv")
    text, _ = analysis_data(2, 3, False)
    path.write_text(path.read_text() + text)
    found = read_uff(path).repeat
    assert len(found.names) == 2
    assert any("2414" in note for note in found.notes)


def test_exponents_with_a_d(tmp_path):
    path = modes(tmp_path / "one.uff")
    plain = read_uff(path)
    lines = path.read_text().splitlines()
    kept = [line if line.startswith("mode") else line.replace("e+", "D+").replace("e-", "D-") for line in lines]
    path.write_text("\n".join(kept) + "\n")
    assert "D+0" in path.read_text()
    found = read_uff(path)
    np.testing.assert_array_equal(found.repeat.shape_set.shapes, plain.repeat.shape_set.shapes)
    np.testing.assert_array_equal(found.repeat.natural_freq, plain.repeat.natural_freq)
    assert found.points == plain.points


def test_frequency_responses_among_the_modes_are_noted(tmp_path):
    path = modes(tmp_path / "one.uff")
    response = {"type": 55, "analysis_type": 5, "data_ch": 2, "spec_data_type": 8, "load_case": 1, "freq_step_n": 1}
    response |= {"freq": 3.0, "node_nums": [1], "r1": np.ones(1), "r2": np.ones(1), "r3": np.ones(1)}
    for _ in range(3):
        pyuff.UFF(str(path)).write_sets([response], mode="add")
    found = read_uff(path).repeat
    assert found.names == ("a", "b")
    (note,) = found.notes
    assert "3 datasets 55 of analysis type 5" in note


def test_numbers_in_order_are_places_and_no_names(tmp_path):
    path = tmp_path / "one.uff"
    write_uff(path, names=("1", "2"), natural_freq=FREQ, damping_ratio=DAMPING, sensors=SENSORS, shapes=shapes())
    assert not read_uff(path).repeat.named
    write_uff(path, names=("1", "3"), natural_freq=FREQ, damping_ratio=DAMPING, sensors=SENSORS, shapes=shapes())
    assert read_uff(path).repeat.named
