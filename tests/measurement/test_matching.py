import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement import matching
from calib.measurement.files.read import read_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.mac import mac
from calib.measurement.matching import match_modes
from calib.measurement.modal import Sensor

FREQ = np.array([8.0, 12.0, 12.6, 20.0, 31.0, 45.0])
SENSORS = [Sensor(n, d, (float(n), 0.5, 0.0)) for n in range(1, 6) for d in ("y", "z")]
TRUTH = np.random.default_rng(11).normal(size=(len(SENSORS), len(FREQ)))


def given(rng, held, order=None, noise=0.01):
    """Frequencies and shapes of one repeat that holds some of the modes, in some order."""
    modes = list(held) if order is None else [held[k] for k in order]
    shapes = TRUTH[:, modes] * (1 + 0 * 1j) + noise * rng.normal(size=(len(SENSORS), len(modes)))
    factors = np.exp(1j * rng.uniform(0, 6, len(modes))) * rng.uniform(0.1, 10, len(modes))
    return FREQ[modes] * (1 + 0.002 * rng.normal(size=len(modes))), shapes * factors, modes


def match(repeats, shapes=True):
    nothing = [np.zeros((0, len(f)), dtype=complex) for f, _, _ in repeats]
    return match_modes(
        [f"r{k}" for k in range(len(repeats))], [f for f, _, _ in repeats],
        [s for _, s, _ in repeats] if shapes else nothing,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_every_column_is_one_mode(seed):
    """Whatever modes the repeats lack and in whatever order they stand."""
    rng = np.random.default_rng(seed)
    repeats = []
    for _ in range(5):
        held = np.sort(rng.choice(len(FREQ), size=rng.integers(3, len(FREQ) + 1), replace=False))
        repeats.append(given(rng, held, rng.permutation(len(held))))
    index = match(repeats).index
    truth = [{repeats[k][2][place] for k, place in enumerate(column) if place >= 0} for column in index.T]
    assert all(len(modes) == 1 for modes in truth)
    assert len(truth) == len(set().union(*(set(m) for _, _, m in repeats)))
    assert index[0, : len(repeats[0][0])].tolist() == list(range(len(repeats[0][0])))


def test_many_repeats_are_scored_a_repeat_at_a_time(monkeypatch):
    """One product of shapes a repeat, however many modes were found: no loop over pairs of modes."""
    rng, calls = np.random.default_rng(5), []
    repeats = [given(rng, range(len(FREQ)), rng.permutation(len(FREQ))) for _ in range(40)]
    monkeypatch.setattr(matching, "mac", lambda x, y: calls.append(y.shape[1]) or mac(x, y))
    index = match(repeats).index
    assert calls == [len(FREQ) * k for k in range(1, 40)]
    truth = [{modes[place] for (_, _, modes), place in zip(repeats, column, strict=True)} for column in index.T]
    assert sorted(map(sorted, truth)) == [[mode] for mode in range(len(FREQ))]


def test_one_mode_missing_and_another_at_the_end(tmp_path):
    """The number of modes is the same in every file, and yet the third mode of one is the fourth of the others."""
    rng = np.random.default_rng(0)
    files = []
    for k, held in enumerate(([0, 1, 2, 3, 4], [0, 1, 2, 3, 4], [0, 1, 3, 4, 5], [0, 1, 2, 3, 4])):
        freq, shapes, _ = given(rng, held)
        names = [str(m + 1) for m in range(5)]
        damping = np.full(5, 0.01)
        files.append(tmp_path / f"{k}.uff")
        write_uff(files[-1], names=names, natural_freq=freq, damping_ratio=damping, sensors=SENSORS, shapes=shapes)
    found = read_modes(files)
    np.testing.assert_allclose(found.natural_freq, FREQ, rtol=0.005)
    assert np.nanmax(found.freq_std / found.natural_freq) < 0.005
    rows = [found.sensors.index(s) for s in SENSORS]
    assert np.all(np.diag(mac(found.shapes[rows], TRUTH)) > 0.995)
    assert found.counts("freq").tolist() == [4, 4, 3, 4, 4, 1]
    assert np.isnan(found.freq_std[-1])
    notes = [note for note in found.notes if "of 4 repeats" in note]
    assert ["not in" in note and "2.uff" in note for note in notes] == [True, False]
    assert ["mode 6" in note and "only in" in note and "2.uff" in note for note in notes] == [False, True]


def test_frequencies_alone_are_matched_with_gaps():
    rng = np.random.default_rng(1)
    freq = np.array([8.0, 12.0, 14.0, 20.0, 31.0])
    repeats = [(freq[list(h)] * (1 + 0.001 * rng.normal(size=len(h))), None, h) for h in ((0, 1, 2, 3), (0, 2, 3, 4))]
    assert match(repeats, shapes=False).index.tolist() == [[0, 1, 2, 3, -1], [0, -1, 1, 2, 3]]


def test_ambiguous_modes_are_refused():
    """Two modes of one frequency and the same shape at the sensors."""
    shapes = np.repeat(TRUTH[:, :1], 2, axis=1).astype(complex)
    with pytest.raises(InputError, match=r"r1: its modes 1 \(10 Hz\), 2 \(10 Hz\) cannot be matched"):
        match([(np.array([10.0, 10.0]), shapes, None)] * 2)
    # the gap may be on either side
    with pytest.raises(InputError, match="cannot be matched"):
        match([(np.array([10.0, 10.4]), None, None), (np.array([10.2]), None, None)], shapes=False)


def test_a_bad_shape_at_the_frequency_of_a_mode_is_set_aside():
    rng = np.random.default_rng(2)
    for bad in range(4):
        repeats = [given(rng, [0, 1, 3, 4]) for _ in range(4)]
        repeats[bad][1][:, 2] = rng.normal(size=len(SENSORS))
        found = match(repeats)
        assert found.index.shape == (4, 4)
        ((repeat, place, column, agreement),) = found.set_aside
        assert (repeat, place) == (bad, 2) and agreement < 0.5
        assert found.index[bad, column] == -1
        others = [k for k in range(4) if k != bad]
        assert {repeats[k][2][found.index[k, column]] for k in others} == {3}


def test_a_wrong_channel_does_not_make_another_mode():
    """The sensor that moves most is turned round: the MAC is small, and yet it is the same mode."""
    rng = np.random.default_rng(3)
    for bad in range(4):
        repeats = [given(rng, [0, 1, 3, 4]) for _ in range(4)]
        most = int(np.argmax(np.abs(TRUTH[:, 3])))
        for freq, shapes, _ in repeats:
            assert freq.shape == (4,)
            shapes[most, 2] *= 3  # three quarters of the motion
        repeats[bad][1][most] *= -1
        assert mac(repeats[bad][1], repeats[bad - 1][1])[2, 2] < 0.5
        found = match(repeats)
        assert found.set_aside == ()
        assert found.index.tolist() == [[0, 1, 2, 3]] * 4
