"""Parameters against Tables 3 and 5 of the case study, and the marks of assumed values."""

import pytest

from calib import LinearConstraint, ParameterSpace
from models.railway import bogie_on_rig
from models.railway.bogie import ASSUMPTIONS as BOGIE_ASSUMPTIONS
from models.railway.parameters import BOGIE, RIG
from models.railway.rig import ASSUMPTIONS as RIG_ASSUMPTIONS

# symbol: name, nominal, lower, upper, unit. Limits follow from mean and standard deviation of a uniform distribution
# where the article prints those; None where neither value nor limits survive.
PUBLISHED = {
    "KP": ("K_primary", None, None, None, "kN/m"),
    "cP": ("c_primary", None, None, None, "kNs/m"),
    "Kbls": ("K_rod_upper", None, None, None, "MN/m"),
    "Kbli": ("K_rod_lower", 25, 20, 30, "MN/m"),
    "Krc": ("K_rail", None, None, None, "MN/m"),
    "Mlc": ("m_girder_centre", None, 0, 150, "kg/m"),
    "Mle": ("m_girder_ends", 38, 0, 60, "kg/m"),
    "Mt": ("m_crossbar", None, 0, 250, "kg/m"),
    "Me": ("m_axle", 271, None, None, "kg/m"),
    "Kb": ("K_block", 12_000, 9_000, 15_000, "kN/m"),
    "Kbtl": ("K_contact", None, 500, 50_000, "kN/m"),
    "Pos_le": ("pos_long_left", 5, 2, 8, "-"),
    "Pos_ld": ("pos_long_right", 5, 2, 8, "-"),
    "Pos_te": ("pos_lat_left", 0, -1, 1, "-"),
    "Pos_td": ("pos_lat_right", 0, -1, 1, "-"),
    "Em": ("E_wood", 10, 4, 12, "GPa"),
}
PRINTED_MEAN = {"KP": 564, "cP": 18, "Kbls": 6.5, "Mlc": 75, "Kbtl": 25_250}
# mean and standard deviation, printed for these
UNIFORM = {"Kbli": (25, 2.9), "Mlc": (75, 43.3), "Mle": (30, 17.3), "Mt": (125, 72.2), "Kb": (12_000, 1_732),
           "Kbtl": (25_250, 14_289), "Pos_le": (5, 1.7), "Pos_te": (0, 0.6), "Em": (8, 2.3)}  # fmt: skip
DETERMINISTIC = {"Krc", "Me"}

BY_SYMBOL = {p.symbol: p for p in BOGIE + RIG}


@pytest.mark.medium
def test_tables_are_complete():
    assert list(BY_SYMBOL) == list(PUBLISHED)
    assert all(p.source.endswith("Table 3") for p in BOGIE) and all(p.source.endswith("Table 5") for p in RIG)
    assert all(p.description for p in BOGIE + RIG)
    assert bogie_on_rig().space.names == tuple(p.name for p in BOGIE + RIG)


@pytest.mark.parametrize("symbol", PUBLISHED)
def test_published_numbers_are_kept(symbol, assert_published):
    assert_published(BY_SYMBOL[symbol], PUBLISHED[symbol], symbol in DETERMINISTIC)
    assert BY_SYMBOL[symbol].integer == symbol.startswith("Pos")


@pytest.mark.parametrize("symbol", UNIFORM)
def test_limits_have_the_printed_mean_and_deviation(symbol):
    mean, deviation = UNIFORM[symbol]
    p = BY_SYMBOL[symbol]
    digits = 0.5 * 10.0 ** -(len(str(deviation).partition(".")[2]))  # printed to this
    assert (p.lower + p.upper) / 2 == pytest.approx(mean)
    assert p.prior_width == pytest.approx(deviation, abs=digits + 1e-9)


@pytest.mark.parametrize("symbol", PRINTED_MEAN)
def test_lost_nominal_values_take_the_printed_mean(symbol):
    assert BY_SYMBOL[symbol].value == PRINTED_MEAN[symbol]


@pytest.mark.parametrize("symbol", PUBLISHED)
def test_assumed_says_exactly_what_is_lost(symbol):
    _, nominal, lower, _, _ = PUBLISHED[symbol]
    text = BY_SYMBOL[symbol].assumed
    assert ("value" in text) == (nominal is None)
    assert ("limits" in text) == (lower is None)
    assert ("spacing" in text) == symbol.startswith("Pos")
    assert bool(text) == (nominal is None or lower is None or symbol.startswith("Pos"))


def test_nominal_added_masses_sum_to_the_printed_842_kg():
    space = ParameterSpace(BOGIE)
    lengths = (("m_girder_centre", 4.46), ("m_girder_ends", 3.56), ("m_crossbar", 5.26))
    assert sum(length * space[name].value for name, length in lengths) == pytest.approx(842, abs=0.5)
    constrained = ParameterSpace(BOGIE, (LinearConstraint("added mass", lengths, 842 - 150, 842 + 150, "kg"),))
    constrained.require_feasible()


@pytest.mark.parametrize("assumption", BOGIE_ASSUMPTIONS + RIG_ASSUMPTIONS, ids=lambda a: a.item)
def test_every_assumption_says_what_how_much_and_why(assumption):
    for text in (assumption.item, assumption.value, assumption.unit, assumption.reason):
        assert text.strip()
    assert assumption.unit == "-" or any(letter.isalpha() for letter in assumption.unit)


@pytest.mark.medium
def test_assumptions_of_the_model_are_those_of_its_parts_without_repeats():
    listed = bogie_on_rig().assumptions
    assert listed == BOGIE_ASSUMPTIONS + RIG_ASSUMPTIONS
    assert len({a.item for a in listed}) == len(listed)
