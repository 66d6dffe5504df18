"""An answer that names something lists its doubts, each with a way to check it."""

from dataclasses import replace

import pandas as pd
import pytest

from calib.missing.data_words import for_readers
from calib.missing.reservations import reservations
from calib.missing.tables import effects_table
from tests.missing.verdict_cases import dressed, first

pytestmark = pytest.mark.usefixtures("fewer_samples")
NO_SUSPECTS = pd.DataFrame({"what": [], "p_fit_without": [], "explains": []})


@pytest.fixture(scope="module")
def found(toy):
    return replace(first(dressed(toy(effects=5)), {"E2": 1.5}, "effect"), suspects=NO_SUSPECTS)


@pytest.fixture
def effects(found):
    return effects_table(found, {}, {}).assign(visible=True)


def test_every_doubt_has_a_check_and_a_cause_outside_the_list_is_always_one(found, effects):
    doubts = reservations(found, effects)
    assert doubts and all(one.doubt.endswith(".") and one.check.endswith(".") for one in doubts)
    assert any("5 listed ones" in one.doubt for one in doubts)


def test_only_an_answer_that_names_something_has_doubts(found, effects):
    assert reservations(replace(found, verdict="none_explains"), effects, "elsewhere") == ()


def test_a_place_of_the_data_comes_first_and_an_assumed_std_is_told(found, effects):
    usual = reservations(found, effects)
    more = reservations(found, effects, "The data point elsewhere.", "0.5 % of every frequency")
    assert more[0].doubt == "The data point elsewhere." and len(more) == len(usual) + 2
    assert any("0.5 % of every frequency" in one.doubt for one in more)


def test_a_datum_without_which_all_fits_is_told_as_what_it_is(found, effects):
    usual = [one.doubt for one in reservations(found, effects)]
    for what, word in (("mode 2B", "excitation"), ("sensor 12y", "mounting")):
        kinds = [what.split()[0], "mode"]
        table = pd.DataFrame({"what": [what, "mode 9B"], "kind": kinds, "p_fit_without": [0.02, 0.5]})
        table = table.assign(explains=[True, False])
        (more,) = [one for one in reservations(replace(found, suspects=table), effects) if one.doubt not in usual]
        assert what in more.doubt and "p = 0.02" in more.doubt and word in more.check and "9B" not in more.doubt


@pytest.mark.parametrize(("p", "told"), [(0.009, False), (0.05, True), (0.2, False)])
def test_a_fit_that_was_nearly_rejected_names_what_fits_worst(found, effects, p, told):
    modes = pd.DataFrame({"mode": ["1B", "2B"], "kind": ["frequency", "shape"], "p": [0.3, 0.004]})
    doubts = reservations(replace(found, chosen_adequacy=replace(found.chosen_adequacy, p_fit=p, modes=modes)), effects)
    assert any("shape of 2B" in one.check for one in doubts) == told


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("frf", "FRFs"),
        ("freq", "frequencies"),
        ("growth", "responses growth"),
        ("response", "responses"),
    ],
)
def test_data_without_modes_are_told_by_their_kind(found, effects, kind, words):
    modes = pd.DataFrame({"mode": [""], "kind": [kind], "p": [0.004]})
    tests = replace(found.chosen_adequacy, p_fit=0.05, modes=modes)
    checks = [one.check for one in reservations(replace(found, chosen_adequacy=tests), effects)]
    assert f"Look at the {words} in the measurement, and measure again." in checks


def test_invisible_effects_are_counted_beyond_six(found, effects):
    many = pd.concat(
        [effects, *(effects.iloc[-1:].assign(name=f"F{k}", title=f"Crack {k}", visible=False) for k in range(8))]
    )
    (doubt,) = [one.doubt for one in reservations(found, many) if "cannot show" in one.doubt]
    assert "crack 0; crack 1;" in doubt and "Crack 6" not in doubt and "2 more" in doubt


def test_a_mode_of_the_model_has_no_measured_frequency_and_a_high_one_no_exponent():
    words = "Measured 2 matches model mode 2: check mode 2, and the natural frequency of 12."
    assert for_readers(words, [], {"2": 11.04, "12": 1234.5}) == (
        "Measured 2 matches model mode 2: check mode 2 (11 Hz), and the natural frequency of 12 (1230 Hz)."
    )


def test_sentences_name_effects_in_words_and_a_mode_first_with_its_frequency():
    freqs = {"2B": 11.04, "2B-3": 20.0, "9B": 35.5}
    words = "Without mode 2B-3 brake_unit fits; brake_unit_freq and damping of 9B. Or mode 2B, then mode 2B. Mode 9B."
    assert for_readers(words, ["brake_unit"], freqs) == (
        "Without mode 2B-3 (20 Hz) brake unit fits; brake_unit_freq and damping of 9B (35.5 Hz). Or mode 2B (11 Hz), "
        "then mode 2B. Mode 9B."
    )


@pytest.mark.parametrize(("unit", "told"), [("kg", True), ("kN/m", False)])
def test_what_is_a_mass_can_be_weighed(found, effects, unit, told):
    of_unit = effects.assign(unit=unit, refitted=True)
    of_unit.loc[of_unit["name"] == "E2", ["magnitude_low", "magnitude_high"]] = [54.4, 74.2]
    checks = " ".join(one.check for one in reservations(found, of_unit))
    assert ("54 to 74 kg" in checks) == told and ("Weigh" in checks) == told
