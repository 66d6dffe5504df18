import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.inference.objective import FrequencyMacObjective, JointObjective, ResponseObjective

FREQ = {"first": 2.0, "second": 5.0}
PERFECT = {"natural_freq_first": 2.0, "natural_freq_second": 5.0, "mac_first": 1.0, "mac_second": 1.0}


def objective(**changes):
    return FrequencyMacObjective(**{"modes": ("first", "second"), "natural_freq": FREQ, "use_mac": True} | changes)


def test_the_formula():
    responses = PERFECT | {"natural_freq_first": 2.2, "natural_freq_second": 4.0, "mac_second": 0.7}
    assert objective()(PERFECT) == 0.0
    assert objective()(responses) == pytest.approx(0.1 + 0.2 + 0.3)
    assert objective(weight_freq=2.0, weight_mac=10.0)(responses) == pytest.approx(0.6 + 3.0)
    assert objective(use_mac=False)(responses) == pytest.approx(0.3)


def test_errors_are_those_that_the_misfit_sums():
    responses = PERFECT | {"natural_freq_first": 2.2, "natural_freq_second": 4.0, "mac_second": 0.7}
    table = objective().errors(responses).set_index("what")
    assert table.loc["second", ["measured", "model", "mac"]].tolist() == [5.0, 4.0, 0.7]
    assert table["error"].to_dict() == pytest.approx({"first": 0.1, "second": -0.2})
    assert table["error"].abs().sum() + (1 - table["mac"]).sum() == pytest.approx(objective()(responses))
    assert objective(use_mac=False).errors(responses)["mac"].isna().all()
    told = ResponseObjective({"down": -4.0, "up": 2.0}).errors({"down": -3.0, "up": 2.5})
    assert told["error"].tolist() == pytest.approx([0.25, 0.25])


def test_a_mode_without_partner_is_wholly_wrong():
    lost = PERFECT | {"natural_freq_second": math.nan, "mac_second": math.nan}
    assert objective()(lost) == 2.0
    assert objective(weight_freq=3.0, weight_mac=0.5)(lost) == 3.5
    assert objective(use_mac=False)({k: v for k, v in lost.items() if "freq" in k}) == 1.0
    assert objective()(PERFECT | {"natural_freq_second": math.nan}) == 2.0
    assert objective()(PERFECT | {"mac_second": math.nan}) == 1.0


@given(st.floats(0.1, 10.0), st.floats(0.1, 10.0), st.floats(0, 1))
def test_only_ratios_count(factor, model, mac):
    one = FrequencyMacObjective(("a",), {"a": 3.0})
    other = FrequencyMacObjective(("a",), {"a": 3.0 * factor})
    assert one({"natural_freq_a": model, "mac_a": mac}) == pytest.approx(
        other({"natural_freq_a": model * factor, "mac_a": mac})
    )


def test_scalar_responses():
    plain = ResponseObjective({"stiffness": 200.0, "shift": -4.0})
    assert plain({"stiffness": 200.0, "shift": -4.0, "other": 9.0}) == 0.0
    assert plain({"stiffness": 210.0, "shift": -3.0}) == pytest.approx(0.05 + 0.25)
    assert plain({"stiffness": math.nan, "shift": -4.0}) == math.inf


def test_identities_differ_when_the_misfit_does():
    changes = [
        {},
        {"weight_freq": 2.0},
        {"weight_mac": 2.0},
        {"use_mac": False},
        {"modes": ("first",)},
        {"natural_freq": FREQ | {"second": 5.000000001}},
    ]
    identities = [objective(**c).identity for c in changes]
    identities += [ResponseObjective(t).identity for t in ({"a": 1.0}, {"a": 1.5}, {"b": 1.0}, {"a": 1.0, "b": 2.0})]
    assert len(set(identities)) == 10
    assert objective(use_mac=False).identity == objective(use_mac=False, weight_mac=7.0).identity
    assert ResponseObjective({"a": 1, "b": 2.0}).identity == ResponseObjective({"b": 2.0, "a": 1.0}).identity


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"modes": ()}, "no mode"),
        ({"modes": ("third",)}, "'third' is None"),
        ({"natural_freq": {"first": 0.0, "second": 5.0}}, "'first' is 0.0"),
        ({"weight_mac": -1.0}, "weight_mac is -1.0"),
        ({"weight_freq": math.nan}, "weight_freq is nan"),
        ({"weight_freq": 0.0, "weight_mac": 0.0}, "the weight of frequencies is 0"),
        ({"weight_freq": 0.0, "use_mac": False}, "no shapes were measured"),
    ],
)
def test_what_cannot_be_compared(changes, text):
    with pytest.raises(InputError, match=text):
        objective(**changes)


def test_targets_that_cannot_be_compared():
    for targets in ({}, {"a": 0.0}, {"a": math.nan}):
        with pytest.raises(InputError):
            ResponseObjective(targets)
    with pytest.raises(InputError, match="no response 'a'"):
        ResponseObjective({"a": 1.0})({"b": 1.0})
    with pytest.raises(InputError, match="no response 'mac_first'"):
        objective()({"natural_freq_first": 2.0})


def test_objectives_of_several_tests_add_up():
    joint = JointObjective({"modes": objective(), "weight": ResponseObjective({"m": 10.0})})
    responses = {f"modes: {n}": v for n, v in (PERFECT | {"natural_freq_first": 2.2}).items()} | {"weight: m": 12.0}
    assert joint(responses) == pytest.approx(0.1 + 0.2)
    with pytest.raises(InputError, match="'m'"):
        joint({n: v for n, v in responses.items() if n != "weight: m"})
    others = (
        JointObjective({"modes": objective(), "weight": ResponseObjective({"m": 11.0})}),
        JointObjective({"modes": objective()}),
        JointObjective({"modes": objective(), "mass": ResponseObjective({"m": 10.0})}),
    )
    assert len({o.identity for o in (joint, *others)}) == 4
