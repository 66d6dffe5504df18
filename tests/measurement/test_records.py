"""Time records from tables and universal files: what is read, and what is refused with the place and the remedy."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.csv_record import read_record_csv
from calib.measurement.files.read_records import hold_records, read_records
from calib.measurement.record import MeasuredRecord, parse_motion_unit
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
AMBIENT = module_of(ROOT / "tests/template/ambient_chain.py")
FRF = module_of(ROOT / "tests/template/frf_chain.py")
VALUES = np.random.default_rng(0).standard_normal((1200, 4))


def table(tmp_path, values=VALUES, name="record.csv", **others):
    return AMBIENT.write_csv(tmp_path / name, values, **others)


def universal(tmp_path, *sets, name="record.uff"):
    pyuff.UFF(str(tmp_path / name)).write_sets([dict(one) for one in sets], mode="overwrite")
    return tmp_path / name


def sets(**others):
    return [AMBIENT.uff_set(k + 1, VALUES[:, k], **others) for k in range(4)]


def test_a_table_and_a_universal_file_hold_the_same_record(tmp_path):
    (from_table,) = read_records(table(tmp_path))
    (from_uff,) = read_records(universal(tmp_path, *sets()))
    for own in (from_table, from_uff):
        assert [sensor.name for sensor in own.sensors] == ["1x", "2x", "3x", "4x"]
        assert own.rate == pytest.approx(AMBIENT.RATE) and own.motion == "acceleration"
        np.testing.assert_allclose(own.values, VALUES, rtol=1e-6, atol=1e-7)


def test_signs_units_places_and_semicolons(tmp_path):
    path = tmp_path / "record.csv"
    header = "# unit: g\ntime;1x;2-x;3rx"
    rows = [";".join(f"{v:.7f}".replace(".", ",") for v in (k / 64, *row[:3])) for k, row in enumerate(VALUES)]
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    places = tmp_path / "sensors.csv"
    places.write_text("node,x,y,z\n1,0,0,0\n2,1,0,0\n3,2,0,0\n", encoding="utf-8")
    (own,) = read_records(path, sensors=places, synthetic=True)
    np.testing.assert_allclose(own.values, VALUES[:, :3] * [9.80665, -9.80665, 1.0], atol=1e-5)
    assert [(s.name, s.point) for s in own.sensors][1] == ("2x", (1.0, 0.0, 0.0)) and own.synthetic


@pytest.mark.parametrize(
    ("header", "factor", "motion"),
    [
        ("Time (s),Acc 1X (g),Acc 2X (g),Acc 3:-X (g),4x (g)", 9.80665, "acceleration"),
        ("TIME [s],Point1:+X [mm/s],Point2:+X [mm/s],Deck:3:-X [mm/s],node 4 x [mm/s]", 1e-3, "velocity"),
        ("time,1x,2x,3-x,4x", 1.0, None),
    ],
)
def test_columns_are_named_as_analysers_do(tmp_path, header, factor, motion):
    (own,) = read_records(table(tmp_path, header=header))
    assert [sensor.name for sensor in own.sensors] == ["1x", "2x", "3x", "4x"] and own.motion == motion
    np.testing.assert_allclose(own.values, VALUES * factor * [1, 1, -1, 1], rtol=1e-6, atol=1e-7)


def test_a_sensor_against_its_axis_in_a_universal_file_is_reversed(tmp_path):
    every = sets()
    every[1]["rsp_dir"] = -1
    (own,) = read_records(universal(tmp_path, *every))
    np.testing.assert_allclose(own.values, VALUES * [1, -1, 1, 1], rtol=1e-6, atol=1e-7)


def test_records_take_the_order_of_sensors_of_the_first(tmp_path):
    paths = [table(tmp_path), table(tmp_path, VALUES[:, ::-1], "two.csv", header="# unit: m/s2\ntime,4x,3x,2x,1x")]
    one, two = read_records(paths)
    assert one.sensors == two.sensors
    np.testing.assert_array_equal(one.values, two.values)


@pytest.mark.parametrize(
    ("text", "motion", "factor"),
    [("m/s2", "acceleration", 1.0), ("mm/s^2", "acceleration", 1e-3), ("g", "acceleration", 9.80665),
     ("in/s", "velocity", 0.0254), ("µm", "displacement", 1e-6)],
)  # fmt: skip
def test_units(text, motion, factor):
    assert parse_motion_unit(text, "here") == (motion, pytest.approx(factor))


def test_content_tells_records_from_frfs(tmp_path):
    frfs = sorted(FRF.write_study(tmp_path / "chain").glob("repeat_*.uff"))
    record = universal(tmp_path, *sets())
    assert not hold_records(frfs) and hold_records([record]) and hold_records([table(tmp_path)])
    with pytest.raises(InputError, match="holds no time record, as"):
        hold_records([*frfs, record])


def gap(values):
    out = values.copy()
    out[100, 2] = np.nan
    return out


@pytest.mark.parametrize(
    ("values", "header", "word"),
    [
        (gap(VALUES), None, "3x has no value 1.5625 s"),
        (VALUES * [1, 1, 1, 0], None, "dead channel"),
        (VALUES[:200], None, "200 samples are too few"),
        (VALUES, "time,1x,2x,3x,voltage", "neither 'time' nor a node"),
        (VALUES, "time,1x,2x,3x,force", "names no node"),
        (VALUES, "Time (s),1x,2x,3x,Hammer (N)", "names no node"),
        (VALUES, "time (ms),1x,2x,3x,4x", "time is in 'ms'"),
        (VALUES, "time,1x (g),2x (g),3x (g),4x (m/s2)", "'4x .m/s2.' differ in unit"),
        (VALUES, "# unit: m/s2\ntime,1x (g),2x (g),3x (g),4x (g)", "two units"),
        (VALUES, "time,1x (V),2x (V),3x (V),4x (V)", "unit 'V' is unknown"),
        (VALUES, "time,1x,2x,3x,1x", "twice"),
        (VALUES, "# unit: kg\ntime,1x,2x,3x,4x", "unknown"),
    ],
)
def test_bad_tables_are_refused_in_one_sentence(tmp_path, values, header, word):
    path = table(tmp_path, values, **({} if header is None else {"header": header}))
    with pytest.raises(InputError, match=word) as fault:
        read_records(path)
    assert "record.csv" in str(fault.value) and fault.value.remedy


def test_unequal_sampling_is_refused_where_it_occurs(tmp_path):
    path = table(tmp_path)
    lines = path.read_text("utf-8").splitlines()
    path.write_text("\n".join(lines[:700] + lines[750:]), encoding="utf-8")
    with pytest.raises(InputError, match=r"not equally spaced: 10\.89"):
        read_records(path)


@pytest.mark.parametrize(
    ("rate", "gap", "words"), [(2048.0, None, None), (2048.0, 600, "equally"), (9000.0, None, "digits")]
)
def test_times_of_six_digits_are_equally_spaced_where_these_tell_a_gap(tmp_path, rate, gap, words):
    """The last of them are rounded to 0.1 ms, a fifth of the distance at 2048 Hz."""
    time = 20.0 + np.arange(len(VALUES)) / rate
    lines = ["time,1x,2x", *(f"{t:.6g},{a:.6g},{b:.6g}" for t, (a, b) in zip(time, VALUES[:, :2], strict=True))]
    path = tmp_path / "record.csv"
    path.write_text("\n".join(line for k, line in enumerate(lines) if k != gap))
    if words is None:
        assert read_records(path)[0].rate == pytest.approx(rate, rel=1e-4)
        return
    with pytest.raises(InputError, match=words):
        read_records(path)


def test_a_byte_that_is_no_text_is_refused(tmp_path):
    path = table(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[:20000] + b"\xf8" + content[20001:])
    with pytest.raises(InputError) as fault:
        read_records(path)
    assert "record.csv" in str(fault.value) and fault.value.remedy


def test_a_word_in_a_table_is_shown_with_its_line(tmp_path):
    path = table(tmp_path)
    lines = path.read_text("utf-8").splitlines()
    lines[500] = lines[500].rsplit(",", 1)[0] + ",overload"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match="overload") as fault:
        read_records(path)
    assert "line 501" in str(fault.value)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"abscissa_spec_data_type": 18}, "no time"),
        ({"rsp_dir": 0}, "direction is 0"),
        ({"rsp_node": 1}, "twice"),
        ({"ordinate_spec_data_type": 8}, "not that of the first sensor"),
        ({"x": np.arange(1100) / 64, "data": VALUES[:1100, 3], "num_pts": 1100}, "same instants"),
    ],
)
def test_bad_universal_files_are_refused(tmp_path, change, word):
    every = sets()
    every[3] |= change
    with pytest.raises(InputError, match=word) as fault:
        read_records(universal(tmp_path, *every))
    assert fault.value.remedy


def test_records_that_differ_are_refused(tmp_path):
    first = table(tmp_path)
    fewer = table(tmp_path, VALUES[:, :3], "fewer.csv", header="# unit: m/s2\ntime,1x,2x,3x")
    other = table(tmp_path, VALUES, "other.csv", header="# unit: m/s\ntime,1x,2x,3x,4x")
    for files in ([first, fewer], [fewer, first]):
        with pytest.raises(InputError, match="lacks 4x"):
            read_records(files)
    with pytest.raises(InputError, match="motion is not that"):
        read_records([first, other])


def test_records_with_sensors_of_their_own_are_set_ups(tmp_path):
    first = table(tmp_path, VALUES[:, :3], "one.csv", header="# unit: m/s2\ntime,1x,2x,4x")
    other = table(tmp_path, VALUES[:, [3, 0]], "two.csv", header="# unit: m/s2\ntime,3x,1x")
    again = table(tmp_path, 2 * VALUES[:, [0, 3]], "three.csv", header="# unit: m/s2\ntime,1x,3x")
    places = tmp_path / "sensors.csv"
    places.write_text("node,x,y,z\n1,0,0,0\n2,1,0,0\n3,2,0,0\n4,3,0,0\n", encoding="utf-8")
    read = read_records([first, other, again], sensors=places)
    assert [[s.name for s in one.sensors] for one in read] == [["1x", "2x", "4x"], ["3x", "1x"], ["3x", "1x"]]
    np.testing.assert_allclose(read[2].values, 2 * read[1].values, rtol=1e-6)
    assert read[1].sensors[0].point == (2.0, 0.0, 0.0)


def stamped(path, form, separator=","):
    """A record whose time is given by time stamps that cross midnight."""
    start = datetime(2026, 11, 29, 23, 59, 55)
    rows = []
    for k, row in enumerate(VALUES[:1100]):
        cells = [f"{v:.7f}" for v in row]
        if separator == ";":
            cells = [cell.replace(".", ",") for cell in cells]
        rows.append(separator.join([form(start + timedelta(seconds=k / 64)), *cells]))
    path.write_text("\n".join(["# unit: m/s2", separator.join(["time", "1x", "2x", "3x", "4x"]), *rows]), "utf-8")
    return path


@pytest.mark.parametrize(
    ("form", "separator"),
    [
        (lambda t: t.isoformat(" ", "microseconds"), ","),
        (lambda t: t.isoformat("T", "milliseconds") + "Z", ","),
        (lambda t: f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond // 1000:03d}", ";"),
        (lambda t: f"{t:%H:%M:%S}.{t.microsecond // 1000:03d}", ","),
        (lambda t: f'"{t:%m/%d/%Y %I:%M:%S}.{t.microsecond // 1000:03d} {t:%p}"', "\t"),
    ],
)
def test_time_stamps_are_seconds(tmp_path, form, separator):
    (own,) = read_records(stamped(tmp_path / "stamped.csv", form, separator))
    assert own.rate == pytest.approx(64.0, rel=1e-4)
    np.testing.assert_allclose(own.values, VALUES[:1100], atol=1e-6)


@pytest.mark.parametrize(
    ("form", "word"),
    [
        (lambda t: f"{t:%H:%M:%S}", "not equally spaced"),  # whole seconds
        (lambda t: "12:00:00" if t.second == 0 else "noon", "noon"),
        (lambda t: f"{40 - t.day:02d}.11.2026 {t:%H:%M:%S.%f}", "do not ascend"),
        (lambda t: f"{6 + (t.day > 29)}/{7 + (t.day > 29)}/2026 {t:%H:%M:%S.%f}", "two ways"),
    ],
)
def test_time_stamps_that_say_no_instant_are_refused(tmp_path, form, word):
    with pytest.raises(InputError, match=word) as fault:
        read_records(stamped(tmp_path / "stamped.csv", form))
    assert fault.value.remedy


def test_values_that_are_not_finite_are_refused_in_python_too():
    with pytest.raises(InputError, match="no value"):
        MeasuredRecord(64.0, gap(VALUES), AMBIENT.record(AMBIENT.chain(), 1000, 1).sensors)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("Time (s),12z (g),5rx (deg/s2)", "'deg/s2'"),
        ("Time (s),12z,force 3z (kgf)", "'kgf'"),
        ("time,12z,Mic:3:z", "'Mic:3:z'"),
    ],
)
def test_units_and_channels_that_would_be_misread_are_refused(tmp_path, header, words):
    rows = [",".join([f"{0.001 * k:.3f}", *["1.0"] * header.count(",")]) for k in range(2000)]
    file = tmp_path / "record.csv"
    file.write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match=words):
        read_record_csv(file)


def test_a_force_is_one_with_or_without_a_separator(tmp_path):
    file, rows = tmp_path / "record.csv", [f"{0.001 * k:.3f},{k % 7},{k % 5}" for k in range(2000)]
    for name in ("force 3z", "force_3z", "Hammer3z", "Hammer 3z (N)"):
        file.write_text("\n".join([f"time,12z,{name}", *rows]))
        assert [sensor.name for sensor in read_record_csv(file).references] == ["3z"]
