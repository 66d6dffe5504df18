import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.modal import Sensor

PLACES = {n: (0.5 * n, 1.0 + 0.1 * n, 0.25) for n in range(1, 7)}


@pytest.fixture
def uff(tmp_path):
    sensors = [Sensor(n, d, PLACES[n]) for n in PLACES for d in ("y", "z")]
    shapes = np.random.default_rng(0).normal(size=(len(sensors), 2))
    write_uff(
        tmp_path / "one.uff", names=("a", "b"), natural_freq=np.array([8.0, 9.0]), damping_ratio=np.full(2, 0.01),
        sensors=sensors, shapes=shapes,
    )  # fmt: skip
    return tmp_path / "one.uff"


def read(uff, places, scale=1.0):
    table = uff.parent / "sensors.csv"
    rows = "".join(f"{n},{','.join(f'{scale * x:.9g}' for x in place)}\n" for n, place in places.items())
    table.write_text("node,x,y,z\n" + rows)
    return read_modes([uff], sensors=table)


def notes_of(found):
    return [note for note in found.notes if "sensors.csv" in note]


def test_a_table_that_agrees_is_not_mentioned(uff):
    found = read(uff, {n: (x + 0.005, y, z - 0.005) for n, (x, y, z) in PLACES.items()})
    assert found.misplaced == () and notes_of(found) == []


def test_a_table_of_other_nodes_is_refused(uff):
    with pytest.raises(InputError, match=r"sensors.csv: none of its 6 nodes \(101, 102, 103, ...\) was measured"):
        read(uff, {n + 100: place for n, place in PLACES.items()})
    some = read(uff, {1: PLACES[1], 77: (0.0, 0.0, 0.0)})
    assert {s.point for s in some.sensors if s.node == 1} == {PLACES[1]}


def test_a_contradicting_place_is_reported_with_its_distance(uff):
    found = read(uff, PLACES | {3: (1.5, 1.3, 2.25), 5: (2.6, 1.5, 0.25)})
    assert [one.node for one in found.misplaced] == [3, 5]
    assert [one.distance for one in found.misplaced] == pytest.approx([2.0, 0.1])
    assert {s.point for s in found.sensors if s.node == 3} == {(1.5, 1.3, 2.25)}
    (note,) = notes_of(found)
    assert "2 of 6" in note and "node 3 by 2 m" in note


@pytest.mark.parametrize(("scale", "word"), [(1000.0, "1000 times"), (0.001, "0.001 times")])
def test_millimetres_are_recognised(uff, scale, word):
    found = read(uff, PLACES, scale)
    assert len(found.misplaced) == 6
    (note,) = notes_of(found)
    assert word in note and "millimetres" in note
