"""What labels, types of data and stray entries of universal files do to functions and modes."""

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.doubts import doubts_of
from calib.measurement.files.read import read_modes
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.files.read_records import read_records

FREQ = np.arange(0.0, 10.0)
VALUES = 1.0 / (1.0 - (FREQ / 4.3) ** 2 + 0.02j * FREQ)


def one(values=VALUES, response=(1, 3), reference=(4, 3), ordinate=(12, "", ""), under=(13, "", ""), **more):
    named = {}
    for axis, (code, label, unit) in (("ordinate", ordinate), ("orddenom", under)):
        named |= {f"{axis}_spec_data_type": code, f"{axis}_axis_lab": label, f"{axis}_axis_units_lab": unit}
    return named | {
        "type": 58, "func_type": 4, "rsp_node": response[0], "rsp_dir": response[1], "ref_node": reference[0],
        "ref_dir": reference[1], "x": FREQ, "data": values, "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
        "binary": 0, **more,
    }  # fmt: skip


SI = {
    "type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0,
    "temp_offset": 273.15,
}  # fmt: skip


@pytest.fixture
def written(tmp_path):
    def write(*sets, name="f.unv"):
        path = tmp_path / name
        pyuff.UFF(str(path)).write_sets([dict(s) for s in sets], "overwrite")
        return path

    return write


@pytest.mark.parametrize(
    ("motion", "force", "factor"),
    [
        ("m/s^2", "N", 1.0), ("mm/s2", "N", 1e-3), ("in/s2", "N", 0.0254), ("m/s2", "kN", 1e-3), ("g", "N", 9.80665),
        ("m/s2", "lbf", 1 / 4.4482216152605), ("mm/s/s", "", 1e-3), ("g/lbf", "", 9.80665 / 4.4482216152605),
        ("(1/kN)*(mm/s^2)", "kN", 1e-6), ("NONE", "kN", 1e-3),
    ],
)  # fmt: skip
@pytest.mark.parametrize("with_units", [False, True])
def test_units_on_labels_count(written, motion, force, factor, with_units):
    path = written(*[SI] * with_units, one(ordinate=(12, "Acceleration", motion), under=(13, "Force", force)))
    found = read_frfs(path)
    np.testing.assert_allclose(found.values[:, 0, 0], factor * VALUES[1:], rtol=1e-9)
    told = with_units and factor not in (1.0, 9.80665)
    assert bool(doubts_of(found)) == told
    assert not with_units or not any("assumed" in note for note in found.notes)


def test_a_frequency_axis_in_other_units(written):
    found = read_frfs(written(one(abscissa_axis_units_lab="rad/s")))
    np.testing.assert_allclose(found.freq, FREQ[1:] / (2 * np.pi))


def test_a_label_tells_the_quantity_where_the_type_does_not(written):
    assert read_frfs(written(one(ordinate=(0, "", "m/s")))).quantity == "mobility"
    assert read_frfs(written(one(ordinate=(1, "Frequency Function", "(1/N)*(m/s²)")))).quantity == "accelerance"
    with pytest.raises(InputError, match="says that it is mobility, not receptance"):
        read_frfs(written(one(ordinate=(0, "", "m/s"))), quantity="receptance")


def test_a_label_that_contradicts_its_type_is_refused_until_the_user_decides(written):
    path = written(one(ordinate=(12, "Velocity", "m/s")))
    with pytest.raises(InputError, match="type acceleration, but its label says 'Velocity m/s'"):
        read_frfs(path)
    for quantity in ("mobility", "accelerance"):
        found = read_frfs(path, quantity=quantity)
        assert found.quantity == quantity and quantity in doubts_of(found)[0]
    with pytest.raises(InputError, match=r"f\.unv"):
        read_frfs(path, quantity="receptance")
    with pytest.raises(InputError, match="denominator is of the type force, but its label says 'V'"):
        read_frfs(written(one(under=(13, "", "V"))))


@pytest.mark.parametrize(
    ("foreign", "what"),
    [
        ({"ordinate": (15, "Pressure", "Pa"), "response": (900, 0)}, "pressure over force"),
        ({"ordinate": (3, "Strain", "uE"), "response": (2, 3)}, "strain over force"),
        ({"ordinate": (0, "", "Pa"), "response": (2, 3)}, "pressure over"),
        ({"ordinate": (13, "", "N"), "under": (12, "", "m/s2")}, "force over acceleration"),
        ({"under": (12, "", "m/s2"), "response": (2, 3)}, "acceleration over acceleration"),
        ({"under": (1, "General", "V"), "response": (2, 3)}, "acceleration over general"),
    ],
)
def test_what_is_no_motion_over_a_force_is_skipped_and_alone_refused_whatever_is_stated(written, foreign, what):
    other = one(**foreign)
    coherence = other | {"func_type": 6, "data": np.ones(len(FREQ))}
    found = read_frfs(written(one(ordinate=(0, "", "")), other, coherence), quantity="accelerance")
    assert [function.name for function in found.functions] == ["1z/4z"]
    assert any(what in note for note in found.notes)
    with pytest.raises(InputError, match=what):
        read_frfs(written(other), quantity="receptance")


def test_a_line_that_is_dropped_anyway_may_hold_anything(written, tmp_path):
    values = VALUES.copy()
    values[0] = complex(np.nan, np.nan)
    path = written(one(7 * np.where(np.isnan(values), 9.0, values)))
    lines = [line.replace("6.30000000000e+01", "              NAN") for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    assert "NAN" in path.read_text()
    found = read_frfs(path)
    np.testing.assert_allclose(found.values[:, 0, 0], 7 * VALUES[1:], rtol=1e-9)
    assert doubts_of(found) == ()
    table = tmp_path / "t.csv"
    table.write_text("# unit: g/N\nfreq,response,reference,re,im,coherence\n0,2z,1z,nan,,1.25\n1,2z,1z,1,2,1.0000001\n")
    assert read_frfs(table).freq.tolist() == [1.0]


def test_a_coherence_counts_only_where_it_is_used(tmp_path):
    table = tmp_path / "t.csv"
    head = "# unit: g/N\nfreq,response,reference,re,im,coherence\n0,2z,1z,1,0,1.25\n1,2z,1z,3,0.2,1.0000001\n"
    table.write_text(head + "2,2z,1z,4,-1,0.9\n")
    found = read_frfs(table, averages=5)
    std = np.abs(found.values[1, 0, 0]) * np.sqrt(0.1 / (2 * 5 * 0.9))
    np.testing.assert_allclose(found.std[:, 0, 0], [np.nan, std])
    assert any("is 1 at 1 Hz, above it by rounding" in note for note in found.notes)
    table.write_text(head + "2,2z,1z,4,-1,1.25\n")
    assert np.isnan(read_frfs(table).std).all()
    with pytest.raises(InputError, match=r"2z/1z is 1\.25 at 2 Hz"):
        read_frfs(table, averages=5)


def test_words_of_a_function_with_frequencies_too_many_do_not_contradict_themselves(written):
    path = written(one(VALUES.astype(complex)))
    lines = path.read_text().splitlines()
    last = max(k for k, line in enumerate(lines) if line.strip() == "-1")
    lines[last - 1] = lines[last - 1][:20]  # half a value is left
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        read_frfs(path)
    words = str(caught.value)
    assert "announces 10" in words and "has 10 values" not in words


def modes_text(freqs, damping=0.01, kind=2):
    out = ""
    for number, freq in enumerate(freqs, start=1):
        lines = [*["NONE"] * 5, "".join(f"{n:10d}" for n in (1, kind, 2, 8, 2, 3))]
        lines += ["".join(f"{n:10d}" for n in (2, 4, 1, number)), "".join(f"{x:13.5E}" for x in (freq, 1, damping, 0))]
        lines += [f"{1:10d}", "".join(f"{x:13.5E}" for x in (number, 0.5, 0.0))]
        out += "\n".join([f"{-1:6d}", f"{55:6d}", *lines, f"{-1:6d}", ""])
    return out


@pytest.mark.parametrize("rigid", [0.0, -1e-5, 1e-6])
def test_rigid_body_motions_are_left_out_and_told(tmp_path, rigid):
    path = tmp_path / "m.unv"
    path.write_text(modes_text([rigid, 12.5, 30.0]))
    table, shapes = tmp_path / "m.csv", tmp_path / "s.csv"
    table.write_text(f"mode,freq,freq_kind\na,{rigid},natural\nb,12.5,natural\nc,30,natural\n")
    shapes.write_text("mode,node,direction,re\na,1,x,1\nb,1,x,1\nc,1,x,1\nb,1,y,0.25\nc,1,y,0.5\n")
    for found in (read_modes(path), read_modes(table), read_modes(table, shapes=shapes)):
        np.testing.assert_allclose(found.natural_freq, [12.5, 30.0])
        assert "rigid-body motion" in doubts_of(found)[0]
    table.write_text("mode,freq,freq_kind\na,-5,natural\n")
    with pytest.raises(InputError, match="-5"):
        read_modes(table)


def test_a_file_of_rigid_body_motions_alone_is_refused(tmp_path):
    for name, text in (("m.unv", modes_text([0.0])), ("m.csv", "mode,freq,freq_kind\na,0,natural\n")):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match="rigid-body"):
            read_modes(tmp_path / name)


def test_an_overdamped_mode_is_left_out(tmp_path):
    path = tmp_path / "m.unv"
    text = modes_text([12.5, 30.0], kind=3)
    path.write_text(text.replace(f"{12.5:13.5E}{1:13.5E}", f"{-40.0:13.5E}{0:13.5E}").replace(
        f"{30:13.5E}{1:13.5E}", f"{-0.5:13.5E}{62.0:13.5E}"))  # fmt: skip
    found = read_modes(path)
    np.testing.assert_allclose(found.natural_freq, [np.hypot(0.5, 62.0) / (2 * np.pi)], rtol=1e-5)
    assert "overdamped" in doubts_of(found)[0]


def test_text_between_datasets_is_noted_and_numbers_there_are_refused(tmp_path):
    path = tmp_path / "m.unv"
    one, two = modes_text([12.5]), modes_text([30.0])
    path.write_text("Workpiece\n" + one + "written by hand on 19 May\n" + two)
    found = read_modes(path)
    assert found.n_modes == 2 and any("line 1: 2 lines of text" in note for note in found.notes)
    for between in ("  1.00000E+00  2.00000E+00\n", "    55\nNONE\n"):
        path.write_text(one + between + two)
        with pytest.raises(InputError, match="text outside the datasets"):
            read_modes(path)


def test_a_file_whose_analysis_data_are_no_modes_says_what_they_are(tmp_path):
    path = tmp_path / "m.unv"
    head = [f"{1:10d}", "static", f"{1:10d}", *["NONE"] * 5, "".join(f"{n:10d}" for n in (1, 1, 2, 8, 2, 3))]
    body = ["".join(f"{n:10d}" for n in (0,) * 8), f"{0:10d}{0:10d}", *["".join(f"{0.0:13.5E}" for _ in range(6))] * 2]
    static = "\n".join([f"{-1:6d}", f"{2414:6d}", *head, *body, f"{1:10d}", f"{1.0:13.5E}" * 3, f"{-1:6d}", ""])
    path.write_text(static + modes_text([12.5]))
    assert read_modes(path).n_modes == 1
    path.write_text(static)
    with pytest.raises(InputError, match=r"no modes, only datasets 2414 of analysis type 1 \(static\)"):
        read_modes(path)


def test_records_follow_their_labels_and_leave_out_what_is_no_motion(written):
    time = 0.01 * np.arange(1200)
    rng = np.random.default_rng(2)
    wave = rng.normal(size=(2, len(time)))
    common = {"func_type": 1, "x": time, "abscissa_spec_data_type": 17, "ord_data_type": 4, "under": (0, "", "")}
    own = one(wave[0], ordinate=(12, "Acceleration", "mm/s2"), **common)
    force = one(wave[1], (2, 0), ordinate=(15, "Sound", "Pa"), **common)
    (record,) = read_records(written(SI, own, force))
    np.testing.assert_allclose(record.values[:, 0], 1e-3 * wave[0], rtol=1e-9)
    assert any("pressure skipped" in note for note in record.notes)
    with pytest.raises(InputError, match="label says 'Velocity m/s'"):
        read_records(written(one(wave[0], ordinate=(12, "Velocity", "m/s"), **common)))


@pytest.mark.parametrize("with_b", [True, False])
@pytest.mark.parametrize("in_hertz", [True, False])
def test_eigenvalues_in_hertz_are_noticed_by_modal_a(tmp_path, in_hertz, with_b):
    """Modal A is 2 i omega of the damped mode where the modal mass is 1, modal B is -lambda A."""
    path, text = tmp_path / "m.unv", ""
    for root in (-1.2 + 80j, -3.0 + 190j):
        a = 2j * root.imag
        b = -root * a if with_b else 0j
        written = root / (2 * np.pi) if in_hertz else root
        numbers = (written.real, written.imag, a.real, a.imag, b.real, b.imag)
        one = modes_text([1.0], kind=3).splitlines()
        at = next(k for k, line in enumerate(one) if line.startswith("  1.00000E+00  1.00000E+00"))
        one[at] = "".join(f"{x:13.5E}" for x in numbers)
        text += "\n".join(one) + "\n"
    path.write_text(text)
    found = read_modes(path)
    size = np.abs([-1.2 + 80j, -3.0 + 190j])
    np.testing.assert_allclose(found.natural_freq, size / (2 * np.pi), rtol=1e-5)
    np.testing.assert_allclose(found.damping_ratio, [1.2, 3.0] / size, rtol=1e-4)
    assert any("in Hz" in said for said in doubts_of(found)) == in_hertz
