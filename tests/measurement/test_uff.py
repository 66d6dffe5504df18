import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.uff import drop_unmeasured, read_uff, write_uff
from calib.measurement.mac import mac
from calib.measurement.modal import DIRECTIONS, Sensor


def modes(rng, directions=("y", "z"), n_nodes=4, n_modes=3, is_complex=True):
    sensors = [
        Sensor(10 * node, direction, (0.5 * node, -1.25, 1e-3 * node))
        for node in range(1, n_nodes + 1)
        for direction in directions
    ]
    shapes = rng.normal(size=(len(sensors), n_modes))
    if is_complex:
        shapes = shapes + 1j * rng.normal(size=shapes.shape)
    return {
        "names": [f"{m}BT" for m in range(1, n_modes + 1)],
        "natural_freq": np.sort(rng.uniform(5, 40, n_modes)),
        "damping_ratio": rng.uniform(0.001, 0.2, n_modes),
        "sensors": sensors,
        "shapes": shapes,
    }


def records(path, **changes):
    """A file with one normal mode of two nodes, written through pyuff."""
    nodes = changes.pop("nodes", [1, 2])
    data = {
        "type": 55,
        "analysis_type": 2,
        "data_ch": 2,
        "spec_data_type": 8,
        "load_case": 1,
        "mode_n": 1,
        "freq": 10.0,
        "modal_damp_vis": 0.02,
        "node_nums": nodes,
        "r1": np.zeros(len(nodes)),
        "r2": np.arange(1.0, len(nodes) + 1),
        "r3": np.zeros(len(nodes)),
    } | changes
    pyuff.UFF(str(path)).write_sets([data], mode="add")


def units(path, code, length):
    data = {"type": 164, "units_code": code, "length": length, "force": 1.0, "temp": 1.0, "temp_offset": 0.0}
    pyuff.UFF(str(path)).write_sets([data], mode="add")


def places(path, nodes=(1, 2), **changes):
    data = {"type": 15, "node_nums": list(nodes), "x": [0.0, 1500.0], "y": [0.0, 0.0], "z": [-3.25, 0.0]} | changes
    pyuff.UFF(str(path)).write_sets([data], mode="add")


@pytest.mark.parametrize("directions", [("y",), ("x", "y", "z"), ("z", "ry"), DIRECTIONS])
@pytest.mark.parametrize("is_complex", [True, False])
def test_round_trip(tmp_path, directions, is_complex):
    given = modes(np.random.default_rng(0), directions, is_complex=is_complex)
    path = tmp_path / "one.uff"
    write_uff(path, **given)
    assert [p.name for p in tmp_path.iterdir()] == ["one.uff"]
    found = read_uff(path)
    (repeat,) = drop_unmeasured([found.repeat])
    assert repeat.names == tuple(given["names"]) and repeat.named
    # eigenvalues carry six digits in each part
    np.testing.assert_allclose(repeat.natural_freq, given["natural_freq"], rtol=1e-5)
    np.testing.assert_allclose(repeat.damping_ratio, given["damping_ratio"], rtol=2e-5)
    assert {f"{n}{d}" for n, d in repeat.shape_set.sensors} == {s.name for s in given["sensors"]}
    rows = [repeat.shape_set.sensors.index((s.node, s.direction)) for s in given["sensors"]]
    np.testing.assert_allclose(repeat.shape_set.shapes[rows], given["shapes"], rtol=1e-5, atol=1e-5)
    for sensor in given["sensors"]:
        np.testing.assert_allclose(found.points[sensor.node], sensor.point, rtol=1e-5)
    assert repeat.notes == ()
    again = tmp_path / "two.uff"
    write_uff(again, **given)
    assert again.read_bytes() == path.read_bytes()


def test_nodes_that_were_not_measured_in_a_mode_come_back_as_unknown(tmp_path):
    given = modes(np.random.default_rng(1))
    given["shapes"][2:4, 1] = np.nan
    write_uff(tmp_path / "one.unv", **given)
    (repeat,) = drop_unmeasured([read_uff(tmp_path / "one.unv").repeat])
    np.testing.assert_array_equal(np.isnan(repeat.shape_set.shapes.real), np.isnan(given["shapes"].real))
    given["shapes"][0, 2] = np.nan  # its other direction was measured: zero would be wrong
    with pytest.raises(InputError, match="node 10 lacks some of its directions"):
        write_uff(tmp_path / "two.unv", **given)
    assert not (tmp_path / "two.unv").exists()


def test_the_writer_refuses_what_the_format_cannot_hold(tmp_path):
    good = modes(np.random.default_rng(2))
    path = tmp_path / "one.uff"
    for change, message in [
        ({"names": ["a b", "c", "d"]}, "not one word"),
        ({"names": ["a", "a", "d"]}, "share a name"),
        ({"damping_ratio": np.full(3, np.nan)}, "damping ratio"),
        ({"shapes": good["shapes"][:-1]}, "do not fit together"),
        ({"sensors": [Sensor(s.node, s.direction) for s in good["sensors"]]}, "has no place"),
        ({"shapes": good["shapes"] * np.inf}, "finite"),
    ]:
        with pytest.raises(InputError, match=message), np.errstate(invalid="ignore"):
            write_uff(path, **(good | change))
    with pytest.raises(InputError, match="cannot be written"):
        write_uff(tmp_path / "nowhere" / "one.uff", **good)
    assert list(tmp_path.iterdir()) == []


def test_zeros_of_components_without_a_sensor_are_not_measurements(tmp_path):
    """A direction that is zero in every mode of every repeat goes; one that moves anywhere stays, with its zeros."""
    for k, moving in enumerate([0.0, 0.5]):
        path = tmp_path / f"{k}.uff"
        records(path, r1=np.array([0.0, moving]))
        records(path, r2=np.array([0.0, 2.0]), mode_n=2, freq=20.0)
    one, two = drop_unmeasured([read_uff(tmp_path / f"{k}.uff").repeat for k in (0, 1)])
    assert one.shape_set.sensors == two.shape_set.sensors
    assert set(one.shape_set.sensors) == {(1, "y"), (2, "y"), (2, "x")}
    # 1y moves in the first mode, so that its zero in the second is a measurement
    np.testing.assert_allclose(one.shape_set.shapes[one.shape_set.sensors.index((1, "y"))], [1.0, 0.0])
    # 2x was dead in the first repeat
    assert np.isnan(one.shape_set.shapes[one.shape_set.sensors.index((2, "x"))]).all()
    assert any("sensor 2x is zero in every mode" in note for note in one.notes)
    np.testing.assert_allclose(two.shape_set.shapes[two.shape_set.sensors.index((2, "x"))], [0.5, 0.0])


def test_modes_without_any_shape_are_frequencies_alone(tmp_path):
    path = tmp_path / "one.uff"
    records(path, r2=np.zeros(2))
    (repeat,) = drop_unmeasured([read_uff(path).repeat])
    assert repeat.shape_set is None
    records(path, mode_n=2, freq=20.0)
    (repeat,) = drop_unmeasured([read_uff(path).repeat])
    np.testing.assert_allclose(repeat.shape_set.shapes, [[np.nan, 1], [np.nan, 2]])


def test_normal_modes_have_natural_frequency_and_damping(tmp_path):
    path = tmp_path / "one.uff"
    records(path)
    records(path, freq=20.0, modal_damp_vis=0.0, modal_damp_his=0.03)
    found = read_uff(path).repeat
    np.testing.assert_allclose(found.natural_freq, [10, 20])
    np.testing.assert_allclose(found.damping_ratio, [0.02, np.nan])
    assert any("hysteretic" in note for note in found.notes)


@pytest.mark.parametrize("analysis_type", [3, 7])
def test_eigenvalues_of_a_pair_are_one_mode(tmp_path, analysis_type):
    path = tmp_path / "one.uff"
    root = 2 * np.pi * 10 * (-0.6 + 0.8j)
    shape = np.array([1.0, 0.5 - 0.5j])
    zero = np.zeros(2, dtype=complex)
    below = {"analysis_type": analysis_type, "eig": root.conjugate(), "r1": zero, "r2": shape.conj(), "r3": zero}
    records(path, **below)
    alone = read_uff(path).repeat  # a mode given by its lower half only is conjugated
    records(path, **(below | {"eig": root, "r2": shape}))
    pair = read_uff(path).repeat
    for repeat in (alone, pair):
        np.testing.assert_allclose(repeat.natural_freq, [10.0], rtol=1e-5)
        np.testing.assert_allclose(repeat.damping_ratio, [0.6], rtol=1e-5)
        np.testing.assert_allclose(repeat.shape_set.shapes[1::3, 0], shape, rtol=1e-5)


def test_lengths_are_converted_and_rotations_keep_their_size(tmp_path):
    path = tmp_path / "one.uff"
    units(path, 5, 1000.0)
    places(path)
    one, zero = np.array([1.0, 1.0]), np.zeros(2)
    records(path, data_ch=3, r2=1000 * one, r4=one, r5=zero, r6=zero)
    found = read_uff(path)
    assert found.points == {1: (0.0, 0.0, -0.00325), 2: (1.5, 0.0, 0.0)}
    (repeat,) = drop_unmeasured([found.repeat])
    assert set(repeat.shape_set.sensors) == {(1, "y"), (2, "y"), (1, "rx"), (2, "rx")}
    np.testing.assert_allclose(repeat.shape_set.shapes, 1.0)


def test_contradicting_units_are_refused_and_absent_ones_noted(tmp_path):
    path = tmp_path / "one.uff"
    places(path)
    records(path)
    assert any("no units" in note for note in read_uff(path).repeat.notes)
    units(path, 1, 3.28084)
    with pytest.raises(InputError, match=r"one.uff, line \d+: dataset 164 states unit code 1"):
        read_uff(path)


def test_double_precision_nodes_and_unknown_datasets_beside_modes(tmp_path):
    path = tmp_path / "one.uff"
    nodes = {"type": 2411, "node_nums": [1, 2], "def_cs": [1, 1], "disp_cs": [1, 1], "color": [1, 1]}
    nodes |= {"x": [0.0, 1.5], "y": [0.0, 0.0], "z": [0.1, 0.2]}
    pyuff.UFF(str(path)).write_sets([nodes], mode="add")
    records(path)
    response = {"type": 55, "analysis_type": 5, "data_ch": 2, "spec_data_type": 8, "load_case": 1, "freq_step_n": 1}
    response |= {"freq": 3.0, "node_nums": [1], "r1": np.ones(1), "r2": np.ones(1), "r3": np.ones(1)}
    pyuff.UFF(str(path)).write_sets([response], mode="add")
    with path.open("ab") as handle:  # a binary function, whose bytes would be no text
        handle.write(b"    -1\n    58b     1     2\n\xff\x00\x1a garbage\n    -1\n")
    found = read_uff(path)
    assert found.points[2] == (1.5, 0.0, 0.2)
    assert found.repeat.names == ("1",)


def test_lines_padded_to_80_columns_and_other_line_ends_are_read(tmp_path):
    given = modes(np.random.default_rng(3))
    path = tmp_path / "one.uff"
    write_uff(path, **given)
    plain = read_uff(path)
    lines = path.read_text().splitlines()
    path.write_bytes("".join(f"{line:<80}\r\n" for line in lines).encode())
    padded = read_uff(path)
    np.testing.assert_array_equal(padded.repeat.shape_set.shapes, plain.repeat.shape_set.shapes)
    assert padded.points == plain.points


def test_names_come_from_id_lines_only_when_all_modes_have_one(tmp_path):
    path = tmp_path / "one.uff"
    records(path, id3="MODE 1BV")
    assert read_uff(path).repeat.names == ("1BV",)
    records(path, id1="some comment", freq=11.0)
    assert read_uff(path).repeat.names == ("1", "2")
    assert not read_uff(path).repeat.named


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  1.00000e+00", "          nan", "node 1y in the dataset 55 that starts here has no finite value"),
        ("  1.00000e+01", "          nan", "frequency in the dataset 55 that starts here is nan"),
        ("  1.00000e+01", " -1.00000e+01", "frequency in the dataset 55 that starts here is -10"),
        ("  2.00000e-02", "  1.00000e+00", "damping ratio in the dataset 55 that starts here is 1"),
        ("  2.00000e-02", " -1.00000e-02", "damping ratio in the dataset 55 that starts here is -0.01"),
        ("  2.00000e-02", "          nan", "damping ratio in the dataset 55 that starts here is nan"),
        ("         2\n", "         1\n", "gives a node twice"),
        ("  2.00000e+00", "          abc", "the dataset 55 that starts here cannot be read"),
    ],
)
def test_bad_values_are_named(tmp_path, old, new, message):
    path = tmp_path / "one.uff"
    records(path)
    text = path.read_text()
    assert old in text
    path.write_text(new.join(text.rsplit(old, 1)) if "\n" in old else text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_uff(path)
    assert message in str(caught.value)
    assert f"{path}, line 1" in str(caught.value)


def test_files_without_modes_say_what_they_hold(tmp_path):
    path = tmp_path / "one.uff"
    units(path, 1, 1.0)
    places(path)
    with pytest.raises(InputError, match=r"no modes \(dataset 55 or 2414\), only datasets 15, 164"):
        read_uff(path)
    for text in (b"", b"\n \n"):
        path.write_bytes(text)
        with pytest.raises(InputError, match=r"one.uff: it is empty"):
            read_uff(path)
    path.write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError, match=r"one.uff, line 1: text outside the datasets"):
        read_uff(path)


def test_a_file_cut_off_is_never_taken_for_a_shorter_measurement(tmp_path):
    given = modes(np.random.default_rng(4))
    path = tmp_path / "one.uff"
    write_uff(path, **given)
    text = path.read_bytes()
    last = text.rindex(b"\n    55")
    # from inside the last dataset to just before its closing line
    for stop in range(last + 1, len(text.rstrip()), 37):
        path.write_bytes(text[:stop])
        with pytest.raises(InputError, match=r"one.uff, line \d+"):
            read_uff(path)


def test_a_node_label_of_minus_one_does_not_end_the_dataset(tmp_path):
    path = tmp_path / "one.uff"
    records(path)
    path.write_text(path.read_text().replace("         2\n", "        -1\n"))
    with pytest.raises(InputError, match=r"one.uff, line 1: the dataset 55 that starts here cannot be read"):
        read_uff(path)


def test_a_mac_of_one_survives_the_six_digits(tmp_path):
    given = modes(np.random.default_rng(5), DIRECTIONS)
    given["shapes"] *= np.array([1e-12, 1.0, 1e8])
    write_uff(tmp_path / "one.uf", **given)
    found = read_uff(tmp_path / "one.uf").repeat.shape_set
    rows = [found.sensors.index((s.node, s.direction)) for s in given["sensors"]]
    for m in range(3):
        assert mac(found.shapes[rows], given["shapes"])[m, m] == pytest.approx(1.0, abs=1e-9)
