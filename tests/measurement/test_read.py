import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.modal import Sensor

SENSORS = [Sensor(n, d, (float(n), 0.0, 0.5)) for n in (1, 2, 3) for d in ("y", "z")]
FREQ, DAMPING = np.array([8.0, 12.0]), np.array([0.6, 0.01])


def uff(folder, name, *, seed=0, noise=0.0, **changes):
    truth = np.random.default_rng(7).normal(size=(len(SENSORS), 2)) + 0.2j
    rng = np.random.default_rng(seed)
    shapes = (truth + noise * rng.normal(size=truth.shape)) * np.exp(1j * seed)
    given = {"names": ("a", "b"), "natural_freq": FREQ + noise * rng.normal(size=2), "damping_ratio": DAMPING}
    write_uff(folder / name, **(given | {"sensors": SENSORS, "shapes": shapes} | changes))
    return folder / name


def csv(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


MODES = "mode,freq,freq_kind,freq_std,damping\na,8,damped,0.4,0.6\nb,12,natural,,\n"
SHAPES = "mode,node,direction,re,im,std\na,1,y,2,0,0.2\na,2,-y,1,0,0.1\nb,1,y,-1,0,\nb,2,y,1,1,\n"


def test_repeats_of_universal_files(tmp_path):
    files = [uff(tmp_path, f"{k}.uff", seed=k, noise=0.01) for k in range(4)]
    found = read_modes(files, synthetic=True)
    assert found.names == ("a", "b")
    assert found.n_repeats == 4 and found.synthetic
    assert set(found.sensors) == set(SENSORS)
    np.testing.assert_allclose(found.natural_freq, FREQ, atol=0.05)
    np.testing.assert_allclose(found.damped_freq, found.natural_freq * np.sqrt(1 - found.damping_ratio**2))
    assert np.all((found.freq_std > 0) & (found.freq_std < 0.02))
    assert np.all((found.shape_std > 0) & (found.shape_std < 0.02))
    np.testing.assert_allclose(np.abs(found.shapes).max(axis=0), 1.0)
    assert str(files[0]) in found.source
    assert found.notes == ()
    renamed = read_modes(files, mode_names=("1BT", "1BV"))
    assert renamed.names == ("1BT", "1BV")
    np.testing.assert_array_equal(renamed.shapes, found.shapes)


def test_a_single_universal_file_has_no_known_std(tmp_path):
    found = read_modes([uff(tmp_path, "one.UNV")])
    assert np.isnan(found.freq_std).all() and np.isnan(found.shape_std).all()
    assert any("standard deviation of the frequencies is unknown" in note for note in found.notes)


def test_the_sensor_table_takes_precedence_over_the_file(tmp_path):
    table = csv(tmp_path, "sensors.csv", "node,x,y,z,on\n2,9,8,7,girder\n99,0,0,0,\n")
    found = read_modes([uff(tmp_path, "one.uff")], sensors=table)
    assert {(s.point, s.on) for s in found.sensors if s.node == 2} == {((9.0, 8.0, 7.0), "girder")}
    assert {(s.point, s.on) for s in found.sensors if s.node == 1} == {((1.0, 0.0, 0.5), None)}


def without_node_3(path):
    lines = path.read_text().splitlines(keepends=True)
    start = lines.index("    15\n")
    gone = next(k for k in range(start, len(lines)) if lines[k].startswith("         3"))
    path.write_text("".join(lines[:gone] + lines[gone + 1 :]))


def test_a_measured_node_without_coordinates_is_refused_unless_the_table_has_it(tmp_path):
    path = uff(tmp_path, "one.uff")
    without_node_3(path)
    with pytest.raises(InputError, match=r"one.uff: node 3 was measured but has no coordinates"):
        read_modes([path])
    table = csv(tmp_path, "sensors.csv", "node,x,y,z\n3,0,1,2\n")
    assert read_modes([path], sensors=table).sensors[-1].point == (0.0, 1.0, 2.0)


def test_repeats_that_do_not_belong_together_are_refused(tmp_path):
    one = uff(tmp_path, "one.uff")
    moved = uff(tmp_path, "moved.uff", sensors=[Sensor(s.node, s.direction, (2.0 * s.node, 0, 0)) for s in SENSORS])
    with pytest.raises(InputError, match=r"moved.uff: node 1 is at another place than in .*one.uff"):
        read_modes([one, moved])


def test_a_repeat_that_lacks_a_mode_or_a_sensor_is_used_for_the_rest(tmp_path):
    files = [uff(tmp_path, f"{k}.uff", seed=k, noise=0.01) for k in range(3)]
    shapes = np.random.default_rng(7).normal(size=(len(SENSORS), 2)) + 0.2j
    one = {"names": ("a",), "natural_freq": FREQ[:1], "damping_ratio": DAMPING[:1], "shapes": shapes[:, :1]}
    short = uff(tmp_path, "short.uff", **one)
    fewer = uff(tmp_path, "fewer.uff", sensors=SENSORS[:-2], shapes=shapes[:-2])
    found = read_modes([*files, short, fewer])
    assert found.n_repeats == 5
    assert found.counts("freq").tolist() == found.counts("damping").tolist() == [5, 4]
    rows = [found.sensors.index(s) for s in SENSORS]
    assert found.counts("shape")[rows].tolist() == [[5, 4]] * 4 + [[4, 3]] * 2
    assert found.without(modes=["a"]).counts("shape").shape == (6, 1)
    np.testing.assert_allclose(found.natural_freq, FREQ, atol=0.05)
    assert found.fingerprint != read_modes(files).fingerprint
    notes = " ".join(found.notes)
    assert "short.uff" in notes and "fewer.uff" in notes


def test_csv_with_shapes_and_places(tmp_path):
    found = read_modes(
        [csv(tmp_path, "modes.csv", MODES)],
        shapes=[csv(tmp_path, "shapes.csv", SHAPES)],
        sensors=csv(tmp_path, "sensors.csv", "node,x,y,z,on\n1,0,0,0,frame\n"),
        std_of="repeat",
        repeats=4,
    )
    np.testing.assert_allclose(found.natural_freq, [10, 12])
    np.testing.assert_allclose(found.damped_freq, [8, 12])
    np.testing.assert_allclose(found.freq_std, [0.25, np.nan])
    np.testing.assert_allclose(found.shapes, np.array([[1, -1 / np.sqrt(2)], [-0.5, (1 + 1j) / np.sqrt(2)]]))
    np.testing.assert_allclose(found.shape_std, [[0.05, np.nan], [0.025, np.nan]])
    assert found.sensors == (Sensor(1, "y", (0.0, 0.0, 0.0), "frame"), Sensor(2, "y"))
    assert found.n_repeats == 4
    assert "no place is known for nodes 2" in found.notes
    assert "damping of b unknown: natural and damped frequencies taken as equal" in found.notes


def test_frequencies_alone(tmp_path):
    found = read_modes([csv(tmp_path, "modes.csv", MODES)])
    assert not found.has_shapes
    assert found.shapes.shape == (0, 2)


def test_csv_repeats_are_matched_by_name(tmp_path):
    one = csv(tmp_path, "1.csv", "mode,freq,freq_kind\na,10,natural\nb,20,natural\n")
    two = csv(tmp_path, "2.csv", "mode,freq,freq_kind\nb,22,natural\na,12,natural\n")
    one_shape = csv(tmp_path, "s1.csv", "mode,node,direction,re\na,1,y,1\na,2,y,2\nb,1,y,1\nb,2,y,-1\n")
    two_shape = csv(tmp_path, "s2.csv", "mode,node,direction,re\nb,2,-y,-3\nb,1,y,-3\na,2,y,-2\na,1,y,-1\n")
    found = read_modes([one, two], shapes=[one_shape, two_shape])
    np.testing.assert_allclose(found.natural_freq, [11, 21])
    np.testing.assert_allclose(found.freq_std, 1.0)
    np.testing.assert_allclose(found.shapes, [[0.5, 1], [1, -1]])
    np.testing.assert_allclose(found.shape_std, 0.0, atol=1e-15)
    single = read_modes([one, two], shapes=[one_shape])
    np.testing.assert_allclose(single.freq_std, 1.0)
    assert np.isnan(single.shape_std).all()


def test_wrong_arguments_are_named(tmp_path):
    universal, table = uff(tmp_path, "one.uff"), csv(tmp_path, "modes.csv", MODES)
    shapes = csv(tmp_path, "shapes.csv", SHAPES)
    for arguments, message in [
        (([],), "no measurement file"),
        (([tmp_path / "none.uff"],), "none.uff: there is no such file"),
        (([tmp_path],), "there is no such file"),
        (([universal, table],), "mixed"),
        (([universal, universal],), "given twice"),
        (([csv(tmp_path, "modes.txt", MODES)],), "modes.txt: unknown kind of file"),
    ]:
        with pytest.raises(InputError, match=message):
            read_modes(*arguments)
    for options, message in [
        ({"files": [universal], "shapes": [shapes]}, "shape files belong to CSV only"),
        ({"files": [table], "shapes": [universal]}, "unknown kind of shape file"),
        ({"files": [table], "shapes": [shapes, csv(tmp_path, "t.csv", SHAPES)]}, "2 shape files for 1 repeats"),
        ({"files": [table], "repeats": 0}, "number of repeats is given as 0"),
        ({"files": [universal, uff(tmp_path, "two.uff")], "repeats": 3}, "given as 3, but 2"),
        ({"files": [table], "std_of": "repeat"}, "number of repeats is not given"),
        ({"files": [table], "mode_names": ("x",)}, "1 mode names are given for 2"),
        ({"files": [table], "mode_names": ("x", "x")}, "given twice"),
    ]:
        with pytest.raises(InputError, match=message):
            read_modes(**options)
