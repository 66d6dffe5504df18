"""Measured FRFs from files: tables and universal files, repeats, units, places, and damaged input."""

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.doubts import doubts_of
from calib.measurement.files.csv_frf import read_frfs_csv
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.frf_units import FRFUnits, parse_unit

FREQ = np.arange(1.0, 30.0, 1.5)
OMEGA = 2 * np.pi * FREQ
PLACES = "node,x,y,z,on\n1,0,0,0,\n2,1,0,0,beam\n3,2,0,0.5,\n"


def accelerance(k, m=2.0):
    return -(OMEGA**2) / (k + 20j * OMEGA - m * OMEGA**2)


FUNCTIONS = {("2z", "1z"): accelerance(3e4), ("3x", "1z"): accelerance(5e3), ("2z", "3x"): accelerance(9e3)}


def table(functions=FUNCTIONS, head="# unit: (m/s2)/N", columns="freq,response,reference,re,im", extra="", freq=FREQ):
    lines = [
        f"{f!r},{response},{reference},{v.real!r},{v.imag!r}{extra}"
        for (response, reference), values in functions.items()
        for f, v in zip(freq.tolist(), values.tolist(), strict=True)
    ]
    return "\n".join([*([head] if head else []), columns, *lines]) + "\n"


@pytest.fixture
def write(tmp_path):
    def one(text, name="frf.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return one


def test_a_table_holds_every_function_at_its_places(write):
    rows = table().splitlines()
    shuffled = [*rows[:2], *np.random.default_rng(1).permutation(rows[2:]).tolist()]
    frfs = read_frfs(write("\n".join(shuffled)), sensors=write(PLACES, "sensors.csv"), synthetic=True)
    assert frfs.quantity == "accelerance" and frfs.synthetic and frfs.n_repeats == 1 and frfs.notes == ()
    np.testing.assert_array_equal(frfs.freq, FREQ)
    responses, references = ([s.name for s in ends] for ends in (frfs.responses, frfs.references))
    assert set(responses) == {"2z", "3x"} and set(references) == {"1z", "3x"}
    for (response, reference), values in FUNCTIONS.items():
        np.testing.assert_array_equal(frfs.values[:, responses.index(response), references.index(reference)], values)
    assert np.isnan(frfs.values[:, responses.index("3x"), references.index("3x")]).all()
    two, three = frfs.responses[responses.index("2z")], frfs.references[references.index("3x")]
    assert (two.point, two.on, three.point) == ((1.0, 0.0, 0.0), "beam", (2.0, 0.0, 0.5))


def test_files_are_repeats(write):
    rng = np.random.default_rng(2)
    noisy = [{k: v * (1 + 0.1 * rng.standard_normal(len(v))) for k, v in FUNCTIONS.items()} for _ in range(3)]
    for k, functions in enumerate(noisy):
        write(table(functions), f"repeat_{k}.csv")
    folder = write("", "x.txt").parent
    frfs = read_frfs(str(folder / "repeat_*.csv"))
    assert frfs.n_repeats == 3 and np.isfinite(frfs.std[:, 0, 0]).all() and len(frfs.source.split(", ")) == 3
    np.testing.assert_allclose(frfs.values[:, 0, 0], np.mean([f["2z", "1z"] for f in noisy], axis=0))


@pytest.mark.parametrize(
    ("unit", "quantity", "motion", "force"),
    [
        ("m/N", "receptance", 1.0, 1.0),
        ("mm/kN", "receptance", 1e-3, 1e3),
        ("(m/s)/N", "mobility", 1.0, 1.0),
        ("in/(lbf s)", "mobility", 0.0254, 4.4482216152605),
        ("m/s^2/N", "accelerance", 1.0, 1.0),
        ("m/(N s²)", "accelerance", 1.0, 1.0),
        ("g/N", "accelerance", 9.80665, 1.0),
        ("1/kg", "accelerance", 1.0, 1.0),
    ],
)
def test_units_are_converted_and_imply_the_quantity(write, unit, quantity, motion, force):
    found = read_frfs_csv(write(table(head=f"# unit: {unit}")))
    assert found.quantity == quantity
    np.testing.assert_allclose(found.functions[(3, "x"), (1, "z")], FUNCTIONS["3x", "1z"] * motion / force, rtol=1e-12)
    np.testing.assert_array_equal(
        read_frfs_csv(write(table(head="")), unit=unit).functions[(3, "x"), (1, "z")],
        found.functions[(3, "x"), (1, "z")],
    )


def test_rotations_are_in_radians_and_moments_have_arms_in_the_unit_of_length():
    _, units = parse_unit("mm/kN", "here")
    z, rx = (1, "z"), (1, "rx")
    assert [units.factor(key) for key in ((z, z), (rx, z), (z, rx), (rx, rx))] == pytest.approx([1e-6, 1e-3, 1e-3, 1.0])
    in_g = parse_unit("g/kN", "here")[1]
    assert [in_g.factor(key) for key in ((z, z), (z, rx), (rx, rx))] == pytest.approx([9.80665e-3, 9.80665e-3, 1e-3])
    assert FRFUnits().agrees(FRFUnits(force=1 + 1e-6)) and not FRFUnits().agrees(FRFUnits(force=2.0))
    assert not FRFUnits().agrees(FRFUnits(motion=9.81))


def test_a_quantity_alone_is_taken_in_metres_and_newtons_and_noted(write):
    found = read_frfs_csv(write(table(head="# quantity = mobility")))
    assert found.quantity == "mobility" and len(found.notes) == 1
    np.testing.assert_array_equal(found.functions[(2, "z"), (1, "z")], FUNCTIONS["2z", "1z"])
    assert read_frfs(write(table(head="")), quantity="receptance").quantity == "receptance"


def test_negative_directions_reverse_the_sign_each(write):
    values = FUNCTIONS["2z", "1z"]
    given = {("2-z", "1z"): values, ("3x", "1-z"): values, ("4-RX", "2-y"): values}
    found = read_frfs_csv(write(table(given))).functions
    for key, sign in {((2, "z"), (1, "z")): -1, ((3, "x"), (1, "z")): -1, ((4, "rx"), (2, "y")): 1}.items():
        np.testing.assert_array_equal(found[key], sign * values)


def test_simulated_values_may_be_real_and_measured_ones_positive(write):
    undamped = {("2z", "1z"): 1 / (3e4 - 2 * OMEGA**2) + 0j}
    stiff = {("2z", "1z"): 1 / (9e6 + 1e3j * OMEGA)}
    assert np.all(stiff["2z", "1z"].real > 0) and np.any(undamped["2z", "1z"].real < 0)
    for functions in (undamped, stiff):
        found = read_frfs_csv(write(table(functions, head="# unit: m/N")))
        np.testing.assert_array_equal(found.functions[(2, "z"), (1, "z")], functions["2z", "1z"])


def test_coherence_gives_standard_deviations(write):
    text = table(columns="freq,response,reference,re,im,coherence", extra=",0.8")
    frfs = read_frfs(write(text), averages=10)
    np.testing.assert_allclose(frfs.std[:, 0, 0], np.abs(frfs.values[:, 0, 0]) * np.sqrt(0.2 / (2 * 10 * 0.8)))
    assert np.isnan(read_frfs(write(text)).std).all()
    with pytest.raises(InputError, match="no coherence"):
        read_frfs(write(table()), averages=10)


def test_at_no_frequency_only_a_receptance_is_kept(write):
    freq = np.concatenate([[0.0], FREQ[1:]])
    for head, count in (("# unit: m/N", len(FREQ)), ("# unit: m/s/N", len(FREQ) - 1)):
        assert len(read_frfs_csv(write(table(head=head, freq=freq))).freq) == count


ONE = {("2z", "1z"): FUNCTIONS["2z", "1z"]}
SHIFTED = table({("3z", "1z"): ONE["2z", "1z"]}, head="", freq=FREQ + 1e-3).split("\n", 1)[1]


@pytest.mark.parametrize(
    ("text", "words", "line"),
    [
        (table(columns="freq,response,reference,re").replace(",im", ""), "entries", 3),
        ("freq,response,reference,re\n1,2z,1z,3\n", "amplitude and phase", None),
        ("freq,response,reference,magnitude\n1,2z,1z,3\n", "unknown column 'magnitude'", 1),
        (table({k: np.abs(v) + 0j for k, v in ONE.items()}), "amplitude and phase", None),
        (table({**ONE, ("3z", "1z"): 0 * FREQ + 0j}), "dead channel", 2 + len(FREQ) + 1),
        (table(ONE) + table(ONE, head="").split("\n", 1)[1], "twice", 2 + len(FREQ) + 1),
        (table(ONE) + "1.0,3z,1z,2,1\n", "3z/1z has 1 lines, the first one 20", None),
        (table(ONE) + SHIFTED, "no line", 23),
        (table(head=""), "neither quantity nor unit", None),
        (table(head="# unit: furlong/N"), "furlong/N' is unknown", 1),
        (table(head="# quantity: compliance"), "'compliance' is unknown", 1),
        (table(head="# quantity: mobility\n# unit: m/N"), "receptance and mobility", 1),
        (table(head="# unit: mm/N\n# unit: m/N"), "stated twice", 2),
        (table(ONE).replace("2z", "2q"), "12z or 12-z", 3),
        (table(ONE).replace("1z", "z"), "12z or 12-z", 3),
        (table(ONE) + "-1.0,2z,1z,2,1\n", "outside", 23),
        (table(ONE) + "99,2z,1z,1e200,1\n", "not plausible", 23),
        (table(ONE) + "99,2z,1z,nan,1\n", "not a number", 23),
    ],
)  # fmt: skip
def test_damaged_tables_are_refused_at_their_line(write, text, words, line):
    with pytest.raises(InputError, match=words) as caught:
        read_frfs(write(text))
    assert line is None or caught.value.at.line == line


def test_columns_that_name_no_channels_are_refused_with_the_first_of_them(write):
    names = ",".join(
        f"FRF Point{k}:+Z / Hammer:-Z {part}" for k in range(1, 9) for part in ("Mag [g/N]", "Phase [deg]")
    )
    path = write(f"Frequency [Hz],{names}\n1,{','.join('12' * 8)}\n")
    with pytest.raises(InputError, match=r"Point1.*--channels"):
        read_frfs(path, unit="g/N")
    lacking = write("freq,response,ref,re,im,one,two,three,four\n1,2z,1z,1,1,0,0,0,0\n")
    with pytest.raises(InputError, match=r"'reference' is missing; .*one of ref, re, im, one, two and 2 more"):
        read_frfs(lacking, unit="g/N")


def test_contradictions_of_arguments_and_files_are_refused(write):
    path = write(table(head="# unit: mm/N"))
    for given, words in (({"unit": "m/N"}, "not m/N"), ({"quantity": "mobility"}, "receptance and mobility")):
        with pytest.raises(InputError, match=words):
            read_frfs(path, **given)
    with pytest.raises(InputError, match="compliance"):
        read_frfs(path, quantity="compliance")
    other = write(table(ONE, head="# unit: mm/N"), "other.csv")
    with pytest.raises(InputError, match=r"2z/3x|3x/1z"):
        read_frfs([path, other])
    with pytest.raises(InputError, match="averages"):
        read_frfs([path, other], averages=3)
    with pytest.raises(InputError, match="none of its 1 nodes"):
        read_frfs(path, sensors=write("node,x,y,z\n77,0,0,0\n", "far.csv"))


def test_a_large_table_is_read_at_once_and_to_the_same_digits(write, monkeypatch):
    """What is wrong in it is still told by its line."""
    rows = table(
        {**FUNCTIONS, ("4-z", "1z"): FUNCTIONS["2z", "1z"]},
        columns="freq,response,reference,re,im,coherence",
        extra=",0.8",
    )
    lines = [*rows.splitlines()[:2], "0,2z,1z,,,", *reversed(rows.splitlines()[2:])]
    path = write("\n".join(lines) + "\n# the end\n")
    slow = read_frfs_csv(path)
    monkeypatch.setattr("calib.measurement.files.csv_frf.LARGE", 10)
    monkeypatch.setattr("calib.measurement.files.csv_frf.read_rows", lambda *_: pytest.fail("read line by line"))
    fast = read_frfs_csv(path)
    np.testing.assert_array_equal(fast.freq, slow.freq)
    assert list(fast.functions) == list(slow.functions) and fast.notes == slow.notes
    for key, values in slow.functions.items():
        np.testing.assert_array_equal(fast.functions[key], values)
        np.testing.assert_array_equal(fast.coherence[key], slow.coherence[key])
    monkeypatch.undo()
    monkeypatch.setattr("calib.measurement.files.csv_frf.LARGE", 10)
    for wrong in (
        "7,2q,1z,1,1,1",
        "7,2z,1z,nan,1,1",
        lines[5],
        "7,2z,1z,1e200,1,1",
        "7,2z,1z,1,1,1,1",
        "-7,2z,1z,1,1,1",
    ):
        with pytest.raises(InputError) as caught:
            read_frfs_csv(write("\n".join([*lines, wrong]) + "\n"))
        assert caught.value.at.line == len(lines) + 1


# -- universal files ---------------------------------------------------------------------------------------------------


def universal(path, functions, units=None, points=None, **more):
    sets = [] if units is None else [{
        "type": 164, "units_code": 9, "units_description": "own", "temp_mode": 1, "length": units[0],
        "force": units[1], "temp": 1.0, "temp_offset": 273.15,
    }]  # fmt: skip
    if points is not None:
        sets.append({
            "type": 2411, "node_nums": list(points), "def_cs": [0] * len(points), "disp_cs": [0] * len(points),
            "color": [0] * len(points), **{axis: [p[k] for p in points.values()] for k, axis in enumerate("xyz")},
        })  # fmt: skip
    for (response, reference), values in functions.items():
        sets.append({
            "type": 58, "func_type": 4, "rsp_node": response[0], "rsp_dir": response[1], "ref_node": reference[0],
            "ref_dir": reference[1], "x": FREQ, "data": values, "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
            "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13, "binary": 0, **more,
        })  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    return path


TWO = {((2, 3), (1, 3)): accelerance(3e4), ((3, 1), (1, 5)): accelerance(5e3)}


def test_universal_files_bring_units_of_length_and_force_and_places(tmp_path):
    points = {1: (0.0, 0.0, 0.0), 2: (1000.0, 0.0, 0.0), 3: (2000.0, 0.0, 500.0)}
    path = universal(tmp_path / "a.uff", TWO, (1e3, 1e-3), points)  # millimetres and kilonewtons
    frfs = read_frfs(path, sensors=None)
    np.testing.assert_allclose(frfs.values[:, 0, 0], 1e-3 / 1e3 * accelerance(3e4), rtol=1e-9)
    # under a moment in kN mm, which is one N m
    np.testing.assert_allclose(frfs.values[:, 1, 1], 1e-3 * accelerance(5e3), rtol=1e-9)
    assert [s.point for s in (*frfs.responses, frfs.references[1])] == [(1.0, 0, 0), (2.0, 0, 0.5), (0.0, 0, 0)]
    assert frfs.references[1].name == "1ry" and frfs.notes == ()


def test_the_sensor_table_takes_precedence_over_the_file(tmp_path, write):
    path = universal(tmp_path / "a.uff", TWO, (1.0, 1.0), {1: (0.0, 0, 0), 2: (1.0, 0, 0), 3: (2.0, 0, 0)})
    frfs = read_frfs(path, sensors=write(PLACES, "sensors.csv"))
    assert frfs.responses[1].point == (2.0, 0.0, 0.5) and [m.node for m in frfs.misplaced] == [3]


def test_a_stated_unit_stands_where_the_file_has_none_and_must_not_contradict_it(tmp_path):
    bare = universal(tmp_path / "bare.uff", TWO)
    assert "metres and newtons assumed" in read_uff_frfs(bare).notes[0]
    found = read_uff_frfs(bare, unit="g/N")
    assert found.notes == ()
    np.testing.assert_allclose(found.functions[(2, "z"), (1, "z")], 9.80665 * accelerance(3e4), rtol=1e-9)
    stated = universal(tmp_path / "mm.uff", TWO, (1e3, 1.0))
    in_mm = read_uff_frfs(stated, unit="mm/s2/N")
    np.testing.assert_allclose(in_mm.functions[(2, "z"), (1, "z")], 1e-3 * accelerance(3e4), rtol=1e-9)
    labelled = universal(tmp_path / "g.uff", TWO, ordinate_axis_units_lab="g")
    np.testing.assert_allclose(
        read_uff_frfs(labelled, unit="g/kN").functions[(2, "z"), (1, "z")], 9.80665e-3 * accelerance(3e4), rtol=1e-9
    )
    for path, unit, words in (
        (stated, "m/s2/N", "not the stated one"), (labelled, "m/s2/N", "not the stated one"),
        (bare, "m/N", "not receptance"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            read_uff_frfs(path, unit=unit)
    with pytest.raises(InputError, match="no unit of mobility"):
        read_uff_frfs(bare, "mobility", "g/N")


def test_an_abscissa_in_seconds_and_a_coherence_given_twice_are_refused(tmp_path):
    path = universal(tmp_path / "t.uff", TWO, abscissa_spec_data_type=17)
    with pytest.raises(InputError, match="no frequency"):
        read_uff_frfs(path)
    twice = universal(tmp_path / "c.uff", TWO)
    for _ in range(2):
        one = {
            "type": 58, "func_type": 6, "rsp_node": 2, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3, "x": FREQ,
            "data": np.ones(len(FREQ)), "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
            "ordinate_spec_data_type": 0, "orddenom_spec_data_type": 0, "binary": 0,
        }  # fmt: skip
        pyuff.UFF(str(twice)).write_sets([one], "add")
    with pytest.raises(InputError, match="coherence is there twice"):
        read_uff_frfs(twice)


def test_a_driving_point_that_is_there_twice_is_its_mean(tmp_path):
    first, second = accelerance(3e4), 1.06 * accelerance(3.001e4)
    path = universal(tmp_path / "twice.uff", {((1, 3), (1, 3)): first, ((2, 3), (1, 3)): accelerance(5e3)})
    again = universal(tmp_path / "again.uff", {((1, 3), (1, 3)): second, ((3, 1), (1, 3)): accelerance(9e3)})
    path.write_bytes(path.read_bytes() + again.read_bytes())
    found = read_uff_frfs(path)
    assert list(found.functions) == [((1, "z"), (1, "z")), ((2, "z"), (1, "z")), ((3, "x"), (1, "z"))]
    np.testing.assert_allclose(found.functions[(1, "z"), (1, "z")], (first + second) / 2, rtol=1e-5)
    apart = 100 * np.linalg.norm(second - first) / np.linalg.norm(first)
    assert any("1z/1z" in note and f"{apart:.2g} %" in note for note in doubts_of(found))
    for gain, word in ((-1.0, "sign"), (1.5, "1.5 times")):
        other = universal(tmp_path / "other.uff", {((1, 3), (1, 3)): gain * first})
        both = tmp_path / "both.uff"
        both.write_bytes(universal(tmp_path / "one.uff", {((1, 3), (1, 3)): first}).read_bytes() + other.read_bytes())
        with pytest.raises(InputError, match=word):
            read_uff_frfs(both)


def test_a_function_with_a_value_too_few_is_refused(tmp_path):
    path = universal(tmp_path / "a.uff", {((2, 3), (1, 3)): accelerance(3e4)})
    lines = path.read_text().splitlines()
    last = max(k for k, line in enumerate(lines) if line.strip() == "-1")
    lines[last - 1] = lines[last - 1][:40]  # without its last number
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="it has 19 values, but announces 20"):
        read_uff_frfs(path)


@pytest.mark.parametrize("kind", ["csv", "uff"])
def test_damaged_bytes_are_read_or_refused_and_nothing_else(tmp_path, kind):
    """Bytes changed, cut out and put in at random; no exception but InputError, and only numbers."""
    if kind == "csv":
        whole = table(ONE, columns="freq,response,reference,re,im,coherence", extra=",0.8").encode()
    else:
        whole = universal(tmp_path / "whole.uff", TWO, (1e3, 1.0), {1: (0.0, 0, 0), 2: (1.0, 0, 0), 3: (2.0, 0, 0)})
        whole = whole.read_bytes()
    rng, path, outcomes = np.random.default_rng(7), tmp_path / f"damaged.{kind}", {"read": 0, "refused": 0}
    for _ in range(60):
        damaged = bytearray(whole)
        for _ in range(rng.integers(1, 3)):
            at = int(rng.integers(len(damaged)))
            if rng.integers(2):
                damaged[at : at + int(rng.integers(1, 20))] = b""
            else:
                damaged[at : at + 1] = rng.choice(list(b"0123456789-+.eE,\nna\x00\xff "), 2).astype(np.uint8).tobytes()
        path.write_bytes(bytes(damaged))
        try:
            frfs = read_frfs(path)
        except InputError:
            outcomes["refused"] += 1
        else:
            outcomes["read"] += 1
            assert np.isfinite(frfs.freq).all() and np.isfinite(frfs.values).any(axis=(1, 2)).all()
    assert min(outcomes.values()) > 0
