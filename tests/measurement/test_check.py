from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh

from calib.errors.errors import InputError
from calib.measurement.check import _additions, _Shapes, check_sensors
from calib.measurement.mac import mac


def chain_shapes(stiffness, n_modes):
    """Modes of masses in a row between two walls, one spring between neighbours."""
    k = np.diag(stiffness[:-1] + stiffness[1:]) - np.diag(stiffness[1:-1], 1) - np.diag(stiffness[1:-1], -1)
    return eigh(k)[1][:, :n_modes]


def ordinary(rng, n_sensors=12, n_modes=5, agreement=0.9, noise=0.025):
    """Measured and model shapes of a given MAC, sensors of very different motion, every mode in its own scale."""
    model = rng.lognormal(0.0, 0.6, (n_sensors, n_modes)) * rng.choice([-1.0, 1.0], (n_sensors, n_modes))
    error = np.sqrt(1 / agreement - 1) * np.sqrt((model**2).mean(axis=0)) * rng.normal(size=model.shape)
    truth = model + error
    measured = truth + noise * np.abs(truth).max(axis=0) * rng.normal(size=model.shape)
    return measured * rng.normal(size=n_modes), model


def names(n):
    return [f"{k}y" for k in range(n)]


@pytest.mark.slow
def test_no_false_alarm_under_noise_and_model_error():
    rng = np.random.default_rng(0)
    for n_sensors, n_modes, agreement in [
        (4, 2, 0.9),
        (6, 3, 0.9),
        (12, 2, 0.9),
        (12, 5, 0.9),
        (24, 8, 0.9),
        (12, 5, 0.5),
    ]:
        for _ in range(25):
            measured, model = ordinary(rng, n_sensors, n_modes, agreement)
            assert check_sensors(measured, model, names(n_sensors)) == ()


@pytest.mark.medium
def test_no_false_alarm_under_wrong_stiffness():
    """Model error that is physics, not noise: springs wrong by a factor of up to about three."""
    rng = np.random.default_rng(1)
    for _ in range(150):
        springs = np.ones(13)
        model = chain_shapes(springs, 5)
        truth = chain_shapes(springs * rng.lognormal(0.0, 0.4, 13), 5)
        measured = truth + 0.025 * np.abs(truth).max(axis=0) * rng.normal(size=truth.shape)
        assert check_sensors(measured, model, names(12)) == ()


@pytest.mark.medium
def test_a_flipped_sensor_is_found():
    rng = np.random.default_rng(2)
    found = 0
    for k in range(40):
        measured, model = ordinary(rng)
        measured[k % 12] *= -1
        findings = check_sensors(measured, model, names(12))
        assert all((f.kind, f.sensors) == ("flipped", (f"{k % 12}y",)) for f in findings)
        found += len(findings)
    assert found >= 34  # the others barely moved


def test_several_flipped_sensors_are_found():
    model = chain_shapes(np.ones(13), 6)
    truth = chain_shapes(np.linspace(0.7, 1.4, 13), 6)
    rng = np.random.default_rng(3)
    measured = truth + 0.025 * np.abs(truth).max(axis=0) * rng.normal(size=truth.shape)
    measured[[2, 5, 6, 9]] *= -1
    findings = check_sensors(measured, model, names(12))
    assert {f.sensors for f in findings} == {("2y",), ("5y",), ("6y",), ("9y",)}
    # one correction after the other
    assert all(one.mac_after == two.mac_before for one, two in pairwise(findings))
    measured[[2, 5, 6, 9]] *= -1
    assert findings[-1].mac_after == pytest.approx(np.mean(np.diag(mac(measured, model))))
    assert "2y" in next(f.sentence for f in findings if f.sensors == ("2y",))


def test_swapped_sensors_are_found():
    model = chain_shapes(np.ones(13), 5)
    truth = chain_shapes(np.linspace(0.7, 1.4, 13), 5)
    rng = np.random.default_rng(4)
    measured = truth + 0.025 * np.abs(truth).max(axis=0) * rng.normal(size=truth.shape)
    measured[[2, 7]] = measured[[7, 2]]
    measured[4] *= -1
    findings = check_sensors(measured * 1j, model, names(12))
    assert {(f.kind, f.sensors) for f in findings} == {("swapped", ("2y", "7y")), ("flipped", ("4y",))}


def test_a_swap_with_an_unmeasured_entry():
    model = chain_shapes(np.ones(13), 6)
    measured = model.copy()
    measured[[2, 7]] = measured[[7, 2]]
    measured[2, 0] = np.nan
    (finding,) = check_sensors(measured, model, names(12))
    assert finding.sensors == ("2y", "7y")
    assert finding.mac_after == pytest.approx(1.0)


def test_a_flip_that_changes_little_is_not_claimed():
    """A sensor on the nodal line of the symmetric modes moves in one mode only: its sign rests on the model alone."""
    model = chain_shapes(np.ones(12), 4)  # 11 masses, the middle one at rest in modes 2 and 4
    assert np.abs(model[5, [1, 3]]).max() < 1e-12
    measured = model[:, [0, 1, 3]].copy()
    measured[5] *= -1
    assert check_sensors(measured, model[:, [0, 1, 3]], names(11)) == ()
    seen_twice = model[:, :3].copy()
    seen_twice[5] *= -1
    (finding,) = check_sensors(seen_twice, model[:, :3], names(11))
    assert finding.sensors == ("5y",)


def test_interchangeable_sensors_are_left_alone():
    """Two sensors with the same motion can be exchanged without any effect."""
    model = np.repeat(chain_shapes(np.ones(7), 4), 2, axis=0)
    rng = np.random.default_rng(5)
    measured = model + 0.01 * rng.normal(size=model.shape)
    assert check_sensors(measured, model, names(12)) == ()


def test_opposite_sensors_may_be_swapped_or_both_flipped():
    rng = np.random.default_rng(6)
    model = rng.normal(size=(10, 5))
    model[1] = -model[0]
    measured = model.copy()
    measured[[0, 1]] *= -1
    (finding,) = check_sensors(measured, model, names(10))
    assert finding.kind == "swapped"
    assert "reversing both signs would explain it as well" in finding.sentence


def test_two_modes_are_enough_for_a_clear_case_and_one_is_never():
    model = chain_shapes(np.ones(9), 2)
    measured = model.copy()
    measured[1] *= -1
    (finding,) = check_sensors(measured, model, names(8))
    assert (finding.kind, finding.sensors) == ("flipped", ("1y",))
    assert check_sensors(measured[:, :1], model[:, :1], names(8)) == ()
    # a second mode that was not measured leaves one
    measured[:, 1] = np.nan
    assert check_sensors(measured, model, names(8)) == ()


def test_dead_sensors_are_found():
    model = chain_shapes(np.ones(13), 4)
    measured = model / np.abs(model).max(axis=0)
    measured[3], measured[8] = 0.0, 0.25
    findings = check_sensors(measured, model, names(12))
    assert [(f.kind, f.sensors) for f in findings] == [("dead", ("3y",)), ("dead", ("8y",))]
    assert "zero in all 4" in findings[0].sentence and "constant in all 4" in findings[1].sentence
    assert findings[1].mac_after == pytest.approx(1.0)
    # a sensor that the model holds still too is not dead
    model[3] = 0.0
    assert [f.sensors for f in check_sensors(measured, model, names(12))] == [("8y",)]


def test_the_point_of_scaling_and_unmeasured_sensors_are_not_dead():
    free = np.diag([1.0] + [2.0] * 6 + [1.0]) - np.eye(8, k=1) - np.eye(8, k=-1)  # ends move most in every mode
    model = eigh(free)[1][:, [1, 2, 4]]
    measured = model / model[0]
    measured[4] = np.nan
    assert np.allclose(np.abs(measured[0]), np.nanmax(np.abs(measured), axis=0))
    assert check_sensors(measured, model, names(8)) == ()


def test_a_sensor_that_disagrees_in_some_modes_only_is_attributed_to_the_model():
    rng = np.random.default_rng(8)
    model = rng.normal(size=(12, 6))
    model[4] = 2.0
    measured = model.copy()
    measured[4] *= [-1, -1, -1, -1, 1, 1]
    assert check_sensors(measured, model, names(12)) == ()
    measured[4, 4:] *= -1
    (finding,) = check_sensors(measured, model, names(12))
    assert finding.sensors == ("4y",)


@pytest.mark.slow
def test_shapes_that_have_nothing_in_common_give_hardly_any_finding():
    """Many sign patterns are tried, and the best of them always fits by chance to some degree."""
    rng = np.random.default_rng(9)
    accused = sum(
        bool(check_sensors(rng.normal(size=(n, 12)), rng.normal(size=(n, 12)), names(n)))
        for n in (5, 6)
        for _ in range(60)
    )
    assert accused <= 1


def test_a_constant_scaling_point_of_a_poor_model_is_not_dead():
    model = chain_shapes(np.ones(9), 3)
    measured = model / model[0]
    measured /= np.abs(measured).max(axis=0)
    measured[1] = 1.0  # the largest in every mode, and not so in the model
    assert not [f for f in check_sensors(measured, model, names(8)) if f.kind == "dead"]


def test_the_mac_of_every_candidate_is_that_of_the_corrected_shapes():
    rng = np.random.default_rng(10)
    seen = rng.random((6, 4)) > 0.2
    a = np.where(seen, rng.normal(size=(6, 4)) + 1j * rng.normal(size=(6, 4)), 0.0)
    state = _Shapes(a, rng.normal(size=(6, 4)) + 0j, seen)
    tried = dict(_additions(state, np.arange(6), flips=True, swaps=True))
    assert len(tried) == 6 + 5
    for rows, value in tried.items():
        assert value == pytest.approx(state.after([rows]).mean_mac, rel=1e-12)


def test_wrong_arrays_are_refused():
    good = np.ones((5, 2))
    with pytest.raises(InputError, match="do not fit"):
        check_sensors(good, good[:4], names(5))
    with pytest.raises(InputError, match="do not fit"):
        check_sensors(good, good, names(4))
    with pytest.raises(InputError, match="not finite"):
        check_sensors(good, good * np.nan, names(5))
