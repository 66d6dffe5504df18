"""The shortlist of hung masses, from the signatures of masses held fast."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.hypotheses.proposals.proposal_search import Search, hung_over_fixed
from calib.missing.score import scores
from calib.structure.effects.composition import HungBy


def test_a_hung_mass_moves_with_its_carrier_below_its_frequency_and_against_it_above():
    freqs, natural = np.array([0.01, 3.0, 6.0, 9.0, 300.0]), np.array([6.0])
    (slow, below, at, above, fast) = hung_over_fixed(freqs, natural)[:, 0]
    assert abs(slow - 1) < 1e-3 and 1.2 < below < 4 / 3 and abs(at) < 1e-12 and -0.8 < above < -0.7 and -1e-3 < fast < 0


def test_it_is_what_a_hung_mass_does_to_the_frequencies_of_a_carrier():
    """To first order, for a mass of 1e-6 on an oscillator of unit mass: the frequency falls by half its moved mass."""
    natural, small = 6.0, 1e-6
    for own in (2.0, 4.5, 8.0, 15.0):
        k, hung = (2 * np.pi * own) ** 2, small * (2 * np.pi * natural) ** 2
        stiffness = np.array([[k + hung, -hung], [-hung, hung]])
        squares = np.linalg.eigvals(stiffness / np.array([[1.0], [small]])).real
        freq = np.sqrt(squares[np.argmin(np.abs(squares - k))]) / (2 * np.pi)
        fixed = -own * small / 2
        (factor,) = hung_over_fixed(np.array([own]), np.array([natural]))[0]
        undamped = 1 / (1 - (own / natural) ** 2)
        np.testing.assert_allclose((freq - own) / fixed, undamped, rtol=2e-3)
        assert np.sign(factor) == np.sign(undamped) and abs(factor / undamped - 1) < 0.25


@pytest.mark.parametrize("lowest", [0.0, 2.0])
def test_a_line_at_0_hz_hangs_a_mass_as_any_other(toy, lowest):
    toy = toy().drawn(np.random.default_rng(4), {"E0": 8.0})
    hung = [
        HungBy(SimpleNamespace(effect=effect, place=(float(k), 0.0, 0.0)), effect.name)
        for k, effect in enumerate(toy.effects)
    ]
    freqs, lost = np.linspace(2.0, 6.0, len(toy.rows)), []
    freqs[0] = lowest
    search = Search(None, (), (), hung, toy.effects, freqs)
    fit = toy.calibrated()
    found = search._hung(fit, scores(fit, (), {}), lost)
    assert found[0] is hung[0].composed and lost == []


def test_lines_at_0_hz_alone_hang_no_mass(toy):
    toy = toy()
    hung = [HungBy(SimpleNamespace(effect=toy.effects[0], place=(0.0, 0.0, 0.0)), toy.effects[0].name)]
    search = Search(None, (), (), hung, toy.effects, np.zeros(len(toy.rows)))
    fit = toy.calibrated()
    assert search._hung(fit, scores(fit, (), {}), []) == []
