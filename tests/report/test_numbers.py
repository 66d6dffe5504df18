import math

import pytest

from calib.report.numbers import (
    counted,
    fixed,
    flag,
    p_in_words,
    percent,
    place,
    places,
    probability,
    short,
    significant,
    with_unit,
    yes,
)
from calib.results.answer import with_std


@pytest.mark.parametrize(
    ("value", "digits", "sign", "words"),
    [
        (3.14159, 2, False, "3.14"),
        (-3.14159, 2, False, "−3.14"),
        (3.14159, 2, True, "+3.14"),
        (-0.001, 2, False, "0.00"),
        (-0.03, 1, True, "0.0"),
        (0.03, 1, True, "0.0"),
        (-0.06, 1, True, "−0.1"),
        (math.nan, 2, False, "–"),
        (math.inf, 2, False, "∞"),
        (-math.inf, 2, True, "−∞"),
    ],
)
def test_fixed(value, digits, sign, words):
    assert fixed(value, digits, sign) == words


@pytest.mark.parametrize(
    ("value", "digits", "words"),
    [
        (123.456, 4, "123.5"),
        (0.0012345, 3, "0.00123"),
        (99999.4, 3, "100000"),
        (-12.34, 3, "−12.3"),
        (7.0, 5, "7"),
        (0.0, 3, "0"),
        (1.5e-9, 2, "1.5e−09"),
        (2.5e9, 3, "2.50e+09"),
        (math.nan, 3, "–"),
    ],
)
def test_significant(value, digits, words):
    assert significant(value, digits) == words


def test_units_fractions_and_probabilities():
    assert percent(0.12345, 1, sign=True) == "+12.3"
    assert with_unit(63.5652, "kg") == "63.6 kg" and with_unit(0.5, "-") == "0.500" and with_unit(math.nan, "kg") == "–"
    assert (
        p_in_words(1e-9) == "< 0.001"
        and p_in_words(0.0371) == "0.037"
        and p_in_words(0.9999) == "> 0.99"
        and p_in_words(math.nan) == "–"
    )
    assert counted(1, "mode") == "1 mode" and counted(0, "mode") == "0 modes"


@pytest.mark.parametrize(
    ("value", "std", "words"),
    [
        (705.31, 80.2, "705 ± 80 kN/m"),
        (25250.0, 14300.0, "25000 ± 14000 kN/m"),
        (10.0, 0.0901, "10.000 ± 0.090 kN/m"),
        (90.6, 83.4, "91 ± 83 kN/m"),
        (-0.0004, 0.0996, "0.00 ± 0.10 kN/m"),
        (0.0067871, 2.5e-4, "0.00679 ± 0.00025 kN/m"),
        (3.2e-9, 1e-10, "3.2e-09 ± 1e-10 kN/m"),
        (7.0, math.inf, "7 ± inf kN/m"),
    ],
)
def test_a_value_ends_at_the_decimal_of_its_standard_deviation(value, std, words):
    assert with_std(value, std, " kN/m") == words


def test_unknown_flags_are_no_and_are_shown_as_unknown():
    assert flag(True) and not flag(False) and not flag(None) and not flag(math.nan)
    assert (yes(True), yes(False), yes(None)) == ("yes", "no", "–")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.25, "0.25"),
        (204.46, "204"),
        (-1.42, "−1.42"),
        (1234.0, "1234"),
        (45678.9, "45700"),
        (math.nan, "–"),
        (0, "0"),
    ],
)
def test_a_number_in_a_figure_has_neither_zeros_at_its_end_nor_an_exponent(value, words):
    assert short(value) == words


def test_places_have_signs_and_their_number():
    assert place((1.114, -0.625, -0.001)) == "(+1.11, −0.62, 0.00)"
    assert place((1.0, math.nan, 0.0)) == "–"
    corners = [(1.0, 0.0, 2.0), (-1.0, 0.0, 2.0), (1.0, 0.0, -2.0)]
    assert places(corners, 3, "; ") == "; ".join(map(place, corners))
    assert places(corners, 1) == f"{place(corners[0])} and 2 more" and places([], 3) == ""


def test_no_probability_claims_certainty():
    given = (1.0, 0.994, 0.99, 0.896, 0.01, 0.0099, 0.0, float("nan"))
    told = ["> 99 %", "> 99 %", "99 %", "90 %", "1 %", "< 1 %", "< 1 %", "–"]
    assert [probability(share) for share in given] == told
