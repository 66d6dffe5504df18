"""FRFTest: measured FRFs of a chain of masses, through every question that a problem answers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.correlation.frf.nuisance import AccelerometerMass, ChannelError
from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
HELD_OUT = {"held_out": ["3x"], "held_out_references": ["4x"], "held_out_bands": [(20.0, 26.0)]}
GROUPS = ["held_out_sensors", "held_out_references", "held_out_bands"]
CHANCE = 1e-4
"""Error rate of a statistical statement below: seeds are fixed, so no test fails by luck."""


def problem_of(frfs, **given):
    return calib.Problem(WORLD.chain(), calib.FRFTest(frfs, **given))


@pytest.fixture(scope="module")
def right():
    return problem_of(WORLD.measured(1), **HELD_OUT)


@pytest.fixture(scope="module")
def lacking():
    """The structure has a spring to the ground that the model lacks."""
    return problem_of(WORLD.measured(2, ground=WORLD.HIDDEN), **HELD_OUT)


@pytest.fixture(scope="module")
def explained(lacking):
    return lacking.explain(WORLD.effects(), progress=False)


def by_group(errors):
    return errors.set_index("group")


# -- comparison --------------------------------------------------------------------------------------------------------


def test_the_comparison_is_that_of_functions_by_hand(right):
    nominal = {"k": 1e4, "c": 8.0, "m": 2.0}
    used = right.pairs[0][1].used
    own = WORLD.truth(nominal, used.freq, (1, 4), (1,))
    table = right.compare().table.set_index(["response", "reference"])
    assert list(table.index) == [("1x", "1x"), ("4x", "1x")] and set(table["unit"]) == {"m/(N s2)"}
    for i, row in enumerate(table.itertuples()):
        test, model, std = used.values[:, i, 0], own[:, i, 0], used.std[:, i, 0]
        frac = np.abs(np.vdot(test, model)) ** 2 / (np.vdot(test, test) * np.vdot(model, model)).real
        in_std = np.sqrt(np.mean(np.abs((test - model) / std) ** 2) / 2)
        error = np.linalg.norm(test - model) / np.linalg.norm(test)
        found = (row.lines, row.frac, row.amplitude, row.error, row.in_std)
        expected = (50, frac, np.linalg.norm(model) / np.linalg.norm(test), error, in_std)
        assert found == pytest.approx(expected, rel=1e-6)
    (answer,) = right.compare().by_test.values()
    assert answer.mean_mac == pytest.approx(table["frac"].mean())
    assert answer.mean_freq_error == pytest.approx(table["error"].mean())


def test_a_comparison_names_its_worst_line_and_function(right):
    (answer,) = right.compare().by_test.values()
    lines = answer.frfs.lines_table()
    used = right.pairs[0][1].used
    own = WORLD.truth({"k": 1e4, "c": 8.0, "m": 2.0}, used.freq, (1, 4), (1,))
    each = np.sqrt(np.mean(np.abs((used.values - own) / used.std) ** 2, axis=(1, 2)) / 2)
    np.testing.assert_allclose(lines["in_std"], each, rtol=1e-6)
    worst = answer.table.loc[answer.table["frac"].idxmin()]
    said = str(right.compare())
    assert f"{used.freq[np.argmax(each)]:.4g} Hz" in said and f"{worst['response']}/{worst['reference']}" in said


# -- fit and held-out data ---------------------------------------------------------------------------------------------


def test_a_fit_finds_the_truth_and_meets_held_out_data(right):
    fit = right.calibrate(starts=1, progress=False)
    pulls = [(fit.values[n] - true) / fit.parameters.loc[n, "std"] for n, true in WORLD.TRUE.items()]
    assert np.max(np.abs(pulls)) < 4 and fit.parameters["identified"].all()
    errors = by_group(fit.errors)
    assert list(errors.index) == ["fit", "left_out", *GROUPS]
    # 60 lines less the 10 of the band; of the three responses and two references one each is held out; re and im
    assert errors["rows"].to_dict() == dict(
        zip(["fit", "left_out", *GROUPS], [2 * 50 * 2, 2 * 50 * 2, 2 * 60 * 2, 2 * 60 * 2, 2 * 10 * 2], strict=True)
    )
    assert (errors["p"] > CHANCE).all()
    assert ((errors["rms"] / errors["expected"] - 1).abs() < 4 / np.sqrt(2 * errors["rows"])).all()


@pytest.mark.slow
def test_held_out_data_contradict_a_model_that_lacks_something(lacking):
    errors = by_group(lacking.calibrate(starts=1, progress=False).errors)
    assert (errors.loc[GROUPS, "p"] < CHANCE).all()
    assert (errors.loc[GROUPS, "rms"] > 10 * errors.loc[GROUPS, "expected"]).all()


@pytest.mark.medium
def test_held_out_data_enter_no_fit(right):
    frfs = WORLD.measured(1)
    test = calib.FRFTest(frfs, **HELD_OUT)
    spoilt = frfs.values.copy()
    spoilt[:, 1] *= 7.0  # response 3x
    spoilt[:, :, 1] *= 5.0  # reference 4x
    spoilt[(frfs.freq >= 20.0) & (frfs.freq <= 26.0)] *= 3.0
    other = calib.FRFTest(replace(frfs, values=spoilt), **HELD_OUT)
    assert other.used.fingerprint == test.used.fingerprint
    assert all(
        other.unseen[group].measured.fingerprint != own.measured.fingerprint for group, own in test.unseen.items()
    )
    assert (
        problem_of(other.frfs, **HELD_OUT).calibrate(starts=1, progress=False).values
        == right.calibrate(starts=1, progress=False).values
    )


@pytest.mark.medium
def test_a_test_of_modes_and_one_of_frfs_inform_one_fit():
    model, frfs = WORLD.chain(), WORLD.measured(3, share=0.1, floor=0.02)
    shaken, tapped = calib.FRFTest(frfs, name="shaken"), calib.ModalTest(WORLD.modes(5), name="tapped")
    alone = [
        calib.Problem(model, test).calibrate(starts=1, progress=False).parameters["std"] for test in (shaken, tapped)
    ]
    both = calib.Problem(model, [shaken, tapped]).calibrate(starts=1, progress=False)
    for n, true in WORLD.TRUE.items():
        own = [std[n] for std in alone]
        assert both.parameters.loc[n, "std"] < 0.98 * min(own)
        assert abs(both.values[n] - true) < 4 * both.parameters.loc[n, "std"]
    assert set(both.errors["test"]) == {"shaken", "tapped"}


# -- explanation -------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_a_hidden_spring_is_named_with_its_stiffness(explained):
    assert explained.verdict == "effect" and [e.name for e in explained.named] == ["ground_2"]
    row = explained.table.set_index("name").loc["ground_2"]
    std = (row["magnitude_high"] - row["magnitude_low"]) / (2 * 1.96)
    assert abs(row["magnitude"] - WORLD.HIDDEN) < 4 * std and std < 0.05 * WORLD.HIDDEN
    # Nothing is left unexplained that would make parameters or predictions less certain.
    assert explained.intervals.empty and explained.predictions.empty
    assert ".predictions" not in explained.lines["Evidence"]


@pytest.mark.medium
def test_no_candidate_measurement_takes_information_away(explained):
    """Both sensors in use are forces already, of which one is held out: there is none to add."""
    table = explained.explanation.tables["next_measurement"]
    assert set(table["kind"]) == {"sensor", "held out", "repeats", "bench"}
    assert (table["gain"] >= 1 - 1e-9).all() and set(table["effect"]) == {"ground_2", "mass_3"}
    own = table[table["effect"] == "ground_2"].set_index("measurement")["gain"]
    for held in ("sensor 3x", "force at 4x", "the 10 lines from 20.03 to 25.83 Hz"):
        assert own[f"{held}, validation data so far"] > 1.01


@pytest.mark.medium
def test_nothing_is_named_where_nothing_is_missing(right):
    found = right.explain(WORLD.effects(), progress=False)
    assert found.verdict == "nothing_detectable" and not found.named


@pytest.mark.slow
def test_a_named_effect_makes_the_model_meet_held_out_data(lacking, explained):
    before = by_group(lacking.calibrate(starts=1, progress=False).errors)
    fit = explained.with_named().calibrate(starts=1, progress=False)
    after = by_group(fit.errors)
    assert (after.loc[GROUPS, "rms"] < 0.1 * before.loc[GROUPS, "rms"]).all() and (after["p"] > CHANCE).all()
    for n, true in {**WORLD.TRUE, "ground_2": WORLD.HIDDEN}.items():
        assert abs(fit.values[n] - true) < 4 * fit.parameters.loc[n, "std"]


# -- errors of the test itself -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wrong_channel():
    """FRFs of which response 3x reads 5 % too much."""
    frfs = WORLD.measured(4)
    factor = np.array([1.0, 1.05, 1.0])[:, None]
    return replace(frfs, values=frfs.values * factor, std=frfs.std * factor)


@pytest.mark.medium
def test_a_wrong_channel_is_found_and_counts_on_held_out_data(wrong_channel):
    bands = {"held_out_bands": [(20.0, 26.0)]}
    plain = by_group(problem_of(wrong_channel, **bands).calibrate(starts=1, progress=False).errors)
    assert plain.loc["held_out_bands", "p"] < CHANCE
    freed = problem_of(wrong_channel, nuisances=[ChannelError("gain", "3x", prior_sd=5.0)], **bands)
    fit = freed.calibrate(starts=1, progress=False)
    own = fit.parameters.loc["gain_3x"]
    assert abs(own["value"] - 5.0) < 4 * own["std"] and own["std"] < 0.3
    assert by_group(fit.errors).loc["held_out_bands", "p"] > CHANCE
    assert fit.errors["rows"].iloc[-1] == 2 * 10 * 6


def test_an_error_of_a_held_out_channel_is_no_parameter_of_the_fit(wrong_channel):
    gain = ChannelError("gain", "3x", prior_sd=5.0)
    assert "gain_3x" in problem_of(wrong_channel, nuisances=[gain]).space
    assert "gain_3x" not in problem_of(wrong_channel, nuisances=[gain], held_out=["3x"]).space
    mass = AccelerometerMass(Sensor(3, "x"), 0.1)  # it loads the structure, whatever is fitted
    assert "mass_3" in problem_of(wrong_channel, nuisances=[mass], held_out=["3x"]).space


@pytest.mark.slow
def test_channels_of_one_name_in_two_tests_have_a_gain_each():
    """Response 3x reads 5 % too much in one test and 4 % too little in the other."""
    off, gain = {"first": 5.0, "second": -4.0}, ChannelError("gain", "3x", prior_sd=5.0)
    tests = []
    for seed, (name, percent) in enumerate(off.items(), start=4):
        frfs, factor = WORLD.measured(seed), np.array([1.0, 1 + percent / 100, 1.0])[:, None]
        both = replace(frfs, values=frfs.values * factor, std=frfs.std * factor)
        tests.append(calib.FRFTest(both, nuisances=[gain], name=name))
    for problem in (
        calib.Problem(WORLD.chain(), tests),
        calib.Problem.join(*(calib.Problem(WORLD.chain(), test) for test in tests)),
    ):
        fit = problem.calibrate(starts=1, progress=False)
        for name, percent in off.items():
            own = fit.parameters.loc[f"gain_3x in test {name}"]
            assert abs(own["value"] - percent) < 4 * own["std"] and own["std"] < 0.3
        assert "gain_3x" not in problem.space and (fit.errors["p"] > CHANCE).all()


# -- refused -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"held_out": ["9x"]}, ("test", "held-out response '9x'", "1x, 3x, 4x")),
        ({"held_out": "3x"}, ("held_out",)),
        ({"held_out_references": ["3x"]}, ("held-out reference '3x'", "1x, 4x")),
        ({"held_out_bands": [(50.0, 60.0)]}, ("no line lies in the band [50, 60] Hz",)),
        ({"held_out_bands": [(5.0,)]}, ("held_out_bands", "(low, high)")),
        ({"held_out": ["1x", "3x", "4x"]}, ("no measured FRF is left",)),
        ({"held_out": ["1x"], "held_out_bands": [(0.0, 99.0)]}, ("no measured FRF is left",)),
        ({"nuisances": [ChannelError("gain", "9x")]}, ("'9x' was not measured", "1x, 3x, 4x")),
        ({"nuisances": [ChannelError("gain", "3x", "reference")]}, ("'3x' was not measured", "1x, 4x")),
        ({"nuisances": ["gain"]}, ("nuisances",)),
        ({"accuracy": "much"}, ("accuracy",)),
        ({"name": ""}, ("name",)),
    ],
)
def test_a_test_that_cannot_be_used_is_refused_where_it_is_made(given, words):
    with pytest.raises(InputError) as fault:
        calib.FRFTest(WORLD.measured(1), **given)
    assert all(word in str(fault.value) for word in words), str(fault.value)


def test_only_a_model_with_matrices_has_frfs():
    def function(v):
        return {"natural_freq": np.array([v["k"]]), "shapes": np.ones((1, 1))}

    space = calib.ParameterSpace([calib.Parameter("k", 1.0, 0.5, 2.0)])
    modal = calib.ModalFunctionModel("spring", space, function, (Sensor(1, "x"),), n_modes=1)
    with pytest.raises(InputError, match="test: the model spring has no matrices, so it has no FRFs; give"):
        calib.Problem(modal, calib.FRFTest(WORLD.measured(1))).calibrate(starts=1, progress=False)
    with pytest.raises(InputError, match="frfs"):
        calib.FRFTest(WORLD.modes(1))


@pytest.mark.medium
def test_the_prior_of_a_held_out_channel_widens_what_is_expected_there():
    """Its gain is off by twice its prior: no fit can know, and the data do not contradict the model."""
    data = WORLD.measured(3)
    at = [sensor.name for sensor in data.responses].index("3x")
    values = data.values.copy()
    values[:, at] *= 1.02
    off = replace(data, values=values)
    freed = calib.FRFTest(off, held_out=["3x"], nuisances=[ChannelError("gain", "3x", prior_sd=2.0)])
    blamed = calib.FRFTest(off, held_out=["3x"])
    rows = {}
    for name, test in (("freed", freed), ("blamed", blamed)):
        errors = calib.Problem(WORLD.chain(), test).calibrate(starts=1, progress=False).errors.set_index("group")
        rows[name] = errors.loc["held_out_sensors"]
    assert rows["blamed"]["p"] < 1e-3 < 0.05 < rows["freed"]["p"]
    assert rows["freed"]["rms"] == pytest.approx(rows["blamed"]["rms"]) and rows["freed"]["expected"] > 1.3


@pytest.mark.slow
@pytest.mark.parametrize("synthetic", [True, False])
def test_the_report_says_whether_the_functions_are_synthetic(unrendered, tmp_path, synthetic):
    fit = problem_of(replace(WORLD.measured(1), synthetic=synthetic)).calibrate(starts=1, progress=False)
    (page,) = fit.report(tmp_path / "report.html")
    assert ("The measurement is synthetic" in page.read_text()) == synthetic
