"""Frequency response functions from universal files, their units and signs, and their standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
import pyuff

from calib.errors.errors import InputError
from calib.measurement.accuracy import Claim
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_repeats import FRFRepeat, combine_frfs, repeatability
from calib.measurement.modal import Sensor

FREQ = np.arange(0.0, 40.0, 0.5)
OMEGA = 2 * np.pi * FREQ


def receptance(k=3e4, c=60.0, m=2.0):
    return 1 / (k + 1j * c * OMEGA - m * OMEGA**2)


def dataset(values, response=(2, 3), reference=(1, 3), numerator=8, **more):
    given = {
        "type": 58, "func_type": 4, "rsp_node": response[0], "rsp_dir": response[1], "ref_node": reference[0],
        "ref_dir": reference[1], "x": FREQ, "data": values, "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": numerator, "orddenom_spec_data_type": 13, "binary": 0,
    }  # fmt: skip
    return {**given, **more}


UNITS = {
    "type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0,
    "temp_offset": 273.15,
}  # fmt: skip


@pytest.fixture
def written(tmp_path):
    def write(*sets, name="frf.uff"):
        path = tmp_path / name
        pyuff.UFF(str(path)).write_sets([dict(s) for s in sets], "overwrite")
        return path

    return write


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize(
    ("numerator", "quantity", "order"), [(8, "receptance", 0), (11, "mobility", 1), (12, "accelerance", 2)]
)
def test_text_and_binary_files_of_each_quantity(written, binary, numerator, quantity, order):
    values = receptance() * (1j * OMEGA) ** order
    found = read_uff_frfs(written(UNITS, dataset(values, numerator=numerator, binary=binary)))
    kept = slice(0 if order == 0 else 1, None)
    assert found.quantity == quantity and found.notes == ()
    np.testing.assert_allclose(found.freq, FREQ[kept])
    np.testing.assert_allclose(found.functions[(2, "z"), (1, "z")], values[kept], rtol=1e-10)


def test_negative_directions_reverse_the_sign_and_millimetres_and_g_are_converted(written):
    values = receptance() * -(OMEGA**2)
    path = written(
        {**UNITS, "units_code": 5, "length": 1e3, "force": 1.0},
        dataset(1e3 * values, (2, -3), (1, 3), 12),
        dataset(1e3 * values, (3, -2), (1, -3), 12),
        dataset(values / 9.80665, (4, 1), (1, 3), 12, ordinate_axis_units_lab="g/N"),
        dataset(values, (5, 4), (1, 3), 12),
        dataset(values / 9.80665, (6, 1), (1, 3), 12, ordinate_axis_units_lab="gn"),
    )
    found = read_uff_frfs(path)
    for key, expected in {
        ((2, "z"), (1, "z")): -values, ((3, "y"), (1, "z")): values, ((4, "x"), (1, "z")): values,
        ((5, "rx"), (1, "z")): values, ((6, "x"), (1, "z")): values,
    }.items():  # fmt: skip
        np.testing.assert_allclose(found.functions[key], expected[1:], rtol=1e-9)


def test_coherence_is_kept_and_other_functions_are_noted(written):
    found = read_uff_frfs(written(
        UNITS, dataset(receptance()), dataset(np.full(len(FREQ), 0.9), func_type=6),
        dataset(np.ones(len(FREQ)), func_type=2),
    ))  # fmt: skip
    np.testing.assert_allclose(found.coherence[(2, "z"), (1, "z")], 0.9)
    assert len(found.notes) == 1 and "1 function that is neither" in found.notes[0]
    one = combine_frfs([found], averages=16)
    expected = np.abs(receptance()) * np.sqrt((1 - 0.9) / (2 * 16 * 0.9))
    np.testing.assert_allclose(one.std[:, 0, 0], expected, rtol=1e-9)
    assert np.isnan(combine_frfs([found]).std).all()


def test_unknown_data_types_are_taken_for_frequency_and_force(written):
    path = written(UNITS, dataset(receptance(), abscissa_spec_data_type=0, orddenom_spec_data_type=0))
    np.testing.assert_allclose(read_uff_frfs(path).functions[(2, "z"), (1, "z")], receptance(), rtol=1e-10)


def test_a_line_without_coherence_has_a_finite_standard_deviation():
    key = ((2, "z"), (1, "z"))
    repeat = FRFRepeat("a", FREQ, "receptance", {key: receptance()}, {key: np.where(FREQ > 10, 0.9, 0.0)})
    std = combine_frfs([repeat], averages=16).std[:, 0, 0] / np.abs(receptance())
    assert np.all(np.isfinite(std)) and std[FREQ <= 10].min() > 100 and std[FREQ > 10].max() < 0.1


def test_lines_are_the_same_to_the_rounding_of_single_precision():
    single = FREQ.astype(np.float32).astype(float) * (1 + 6e-8)
    key = ((2, "z"), (1, "z"))
    found = combine_frfs([
        FRFRepeat(name, freq, "receptance", {key: share * receptance()})
        for name, freq, share in (("a", FREQ, 1.0), ("b", single, 1.01))
    ])  # fmt: skip
    np.testing.assert_array_equal(found.freq, FREQ)


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ([dataset(np.abs(receptance()))], "amplitude and phase"),
        ([dataset(receptance()), dataset(-receptance())], "opposite sign"),
        ([dataset(receptance()), dataset(receptance()[:-1], (3, 3), x=FREQ[:-1])], "common frequencies"),
        ([dataset(receptance()), dataset(receptance(), (3, 3), numerator=12)], "one quantity"),
        ([dataset(receptance(), numerator=0)], "neither displacement"),
        ([dataset(receptance(), orddenom_spec_data_type=12)], "motion over force"),
        ([dataset(receptance(), (2, 0))], "direction"),
        ([dataset(np.ones(len(FREQ)), func_type=2)], "no frequency response"),
        ([dataset(np.full(len(FREQ), np.inf + 0j))], "not finite"),
        ([dataset(0 * receptance())], "dead channel"),
        ([dataset(receptance()), UNITS, {**UNITS, "units_code": 5, "length": 1e3}], "different units"),
        ([dataset(receptance()), UNITS, {**UNITS, "force": 1e3}], "different units"),
        ([dataset(receptance()), {**UNITS, "length": 1e3}], "unit code 1"),
        ([dataset(receptance()), {**UNITS, "force": 0.0}], "force factor"),
    ],
)
def test_what_is_no_set_of_functions_is_refused(written, sets, words):
    with pytest.raises(InputError, match=words):
        read_uff_frfs(written(*sets))


def test_a_truncated_file_is_refused_and_a_stated_quantity_must_not_contradict(written):
    path = written(UNITS, dataset(receptance(), numerator=0))
    assert read_uff_frfs(path, "mobility").quantity == "mobility"
    with pytest.raises(InputError, match="says that it is receptance"):
        read_uff_frfs(written(dataset(receptance()), name="other.uff"), "mobility")
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match="truncated"):
        read_uff_frfs(path, "mobility")


# -- standard deviations -----------------------------------------------------------------------------------------------


def noisy(n, seed, share=0.02, floor=2e-7):
    """Repeats of one function with noise in proportion to it and a floor."""
    rng, true = np.random.default_rng(seed), receptance()
    std = np.sqrt((share * np.abs(true)) ** 2 + floor**2)
    return true + std * (rng.standard_normal((n, len(true))) + 1j * rng.standard_normal((n, len(true)))), std


@pytest.mark.parametrize("repeats", [2, 5])
def test_the_scatter_of_repeats_is_a_share_of_the_value_and_a_floor(repeats):
    ratios = []
    for seed in range(40):
        every, std = noisy(repeats, seed)
        ratios.append(repeatability(every) / std)
    middle = np.median(ratios, axis=0)
    assert np.all((0.85 < middle) & (middle < 1.15))  # at the resonance and far above it


def test_the_standard_deviation_is_that_of_the_mean():
    inside = []
    for seed in range(60):
        every, _ = noisy(4, seed)
        repeats = [FRFRepeat(str(k), FREQ, "receptance", {((2, "z"), (1, "z")): one}) for k, one in enumerate(every)]
        found = combine_frfs(repeats)
        inside.append(np.abs((found.values[:, 0, 0] - receptance()).real) < found.std[:, 0, 0])
    assert 0.64 < np.mean(inside) < 0.72  # 68 %
    assert found.n_repeats == 4 and found.responses[0].name == "2z" and found.references[0].name == "1z"


def test_without_noise_the_standard_deviation_is_zero():
    assert np.all(repeatability(np.array([receptance()] * 3)) < 1e-12 * np.abs(receptance()))


def test_functions_that_were_not_measured_stay_unknown():
    functions = {((2, "z"), (1, "z")): receptance(), ((3, "z"), (4, "z")): receptance()}
    found = combine_frfs([FRFRepeat("a", FREQ, "receptance", functions)])
    assert np.isnan(found.values[:, 0, 1]).all() and np.isnan(found.values[:, 1, 0]).all()
    np.testing.assert_array_equal(found.values[:, 1, 1], receptance())


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"freq": FREQ + 0.01}, "common lines"),
        ({"quantity": "mobility"}, "same quantity"),
        ({"functions": {((3, "z"), (1, "z")): receptance()}}, "2z/1z"),
    ],
)
def test_repeats_that_do_not_match_are_refused(changed, words):
    given = {"source": "a", "freq": FREQ, "quantity": "receptance", "functions": {((2, "z"), (1, "z")): receptance()}}
    with pytest.raises(InputError, match=words):
        combine_frfs([FRFRepeat(**given), FRFRepeat(**{**given, "source": "b", **changed})])


def test_measured_functions_are_listed_reference_by_reference_with_their_lines():
    responses, references = (Sensor(2, "z"), Sensor(3, "rx")), (Sensor(1, "z"), Sensor(3, "rx"))
    values = np.ones((4, 2, 2), dtype=complex)
    values[:, 1, 0] = values[1:3, 0, 1] = values[0, 1, 1] = np.nan
    frfs = MeasuredFRFs(np.arange(4.0), responses, references, "receptance", values, np.ones(values.shape))
    assert [f.name for f in frfs.functions] == ["2z/1z", "2z/3rx", "3rx/3rx"]
    assert [(responses[f.i], references[f.j]) for f in frfs.functions] == [
        (f.response, f.reference) for f in frfs.functions
    ]
    assert [f.lines.tolist() for f in frfs.functions] == [[0, 1, 2, 3], [0, 3], [1, 2, 3]]


def test_units_follow_the_directions():
    z, rz = Sensor(1, "z"), Sensor(1, "rz")
    ones = np.ones((2, 2, 2))
    for quantity, unit, other in (
        ("receptance", "m/N", "rad/Nm"), ("mobility", "m/(N s)", "rad/(Nm s)"),
        ("accelerance", "m/(N s2)", "rad/(Nm s2)"),
    ):  # fmt: skip
        frfs = MeasuredFRFs(np.array([1.0, 2.0]), (z, rz), (z, rz), quantity, ones + 0j, ones)
        assert (frfs.unit(z, z), frfs.unit(rz, rz)) == (unit, other)
    assert (frfs.unit(rz, z), frfs.unit(z, rz)) == ("rad/(N s2)", "m/(Nm s2)")


def shaped(lines, responses):
    ones = np.ones((lines, responses, 1))
    return {"values": ones + 0j, "std": ones}


def test_a_fingerprint_covers_all_that_an_evaluation_may_depend_on():
    ones = np.ones((2, 1, 1))
    one = MeasuredFRFs(np.array([1.0, 2.0]), (Sensor(1, "z"),), (Sensor(1, "z"),), "receptance", ones + 0j, ones)
    others = [
        replace(one, freq=np.array([1.0, 3.0])), replace(one, responses=(Sensor(2, "z"),)),
        replace(one, references=(Sensor(2, "z"),)), replace(one, quantity="mobility"), replace(one, values=ones + 1j),
        replace(one, std=2 * ones), replace(one, n_repeats=2), replace(one, accuracy=Claim(0.01)),
    ]  # fmt: skip
    assert len({each.fingerprint for each in (one, *others)}) == 9
    assert replace(one, source="elsewhere").fingerprint == one.fingerprint


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"values": np.zeros((2, 1, 1))}, "amplitude and phase"),
        ({"values": np.array([1.0, np.inf + 0j]).reshape(2, 1, 1)}, "infinity"),
        ({"std": np.zeros((1, 1, 1))}, "lines, responses, references"),
        ({"quantity": "compliance"}, "receptance"),
        ({"freq": np.array([2.0, 1.0])}, "ascend"),
        ({"freq": np.array([1.0, np.nan])}, "ascend"),
        ({"freq": np.array([-1.0, 1.0])}, "ascend"),
        ({"freq": np.zeros(1), "values": np.ones((1, 1, 1)) + 0j, "std": np.ones((1, 1, 1))}, "no line above 0 Hz"),
        ({"std": -np.ones((2, 1, 1))}, "negative"),
        ({**shaped(2, 2), "responses": (Sensor(1, "z"),) * 2}, "a response is given twice"),
        ({**shaped(0, 1), "freq": np.zeros(0)}, "no line"),
    ],
)
def test_wrong_arrays_are_refused(changed, words):
    ones = np.ones((2, 1, 1), dtype=complex)
    given = {"freq": np.array([1.0, 2.0]), "responses": (), "references": (), "quantity": "receptance", "values": ones}
    given |= {"responses": (Sensor(1, "z"),), "references": (Sensor(1, "z"),), "std": np.ones((2, 1, 1)), **changed}
    with pytest.raises(InputError, match=words):
        MeasuredFRFs(**given)
