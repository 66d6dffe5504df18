"""Several effects at once, found step by step from FRFs: a chain built by hand whose model lacks three of them."""

from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import calib
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition
from calib.study.loading import module_of

pytestmark = pytest.mark.slow
WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
HIDDEN = {"stiffness_2": 4e3, "mass_3": 0.4, "damping_4": 6.0}


def library():
    """A spring and a damper to the ground, and a further mass, at each of the four masses."""
    sizes = {"stiffness": ("N/m", 5e3, 1e5), "mass": ("kg", 0.5, 5.0), "damping": ("Ns/m", 5.0, 100.0)}
    return [_at(kind, node, *size) for kind, size in sizes.items() for node in range(1, WORLD.N + 1)]


def _at(kind, node, unit, plausible, upper):
    name = f"{kind}_{node}"
    matrix = sp.csr_array(np.diag(np.eye(WORLD.N)[node - 1]))
    term = (Term(name, matrix, Monomial(1.0, ((name, 1.0),))),)
    magnitude = calib.Parameter(name, 0.0, 0.0, upper, unit, prior_sd=plausible)
    return calib.Effect(
        name, name, "it is left out", "whether it is there", magnitude, lambda _: Addition(**{kind: term})
    )


@pytest.fixture(scope="module")
def explained():
    """The explanation of a chain with all three."""
    plain = WORLD.by_hand

    def with_three(values, ground=0.0, links=1.0):
        k, c, m = plain(values, ground, links)
        k[1, 1] += HIDDEN["stiffness_2"]
        m[2, 2] += HIDDEN["mass_3"]
        c[3, 3] += HIDDEN["damping_4"]
        return k, c, m

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WORLD, "by_hand", with_three)
        frfs = WORLD.measured(2)
    test = calib.FRFTest(frfs, held_out=["3x"], held_out_bands=[(20.0, 26.0)])
    return calib.Problem(WORLD.chain(), test).calibrate(starts=1, progress=False).explain(library(), progress=False)


def test_three_effects_are_named_with_their_magnitudes(explained):
    assert explained.verdict == "several_effects" and {e.name for e in explained.named} == set(HIDDEN)
    chosen = explained.explanation.explanation.chosen
    for name, true in HIDDEN.items():
        value, std = chosen.magnitude(name)
        assert abs(value - true) < 4 * std


def test_the_error_falls_with_every_step_in_data_used_and_held_out(explained):
    tables = explained.explanation.tables
    along = tables["steps_errors"].pivot(index="step", columns="group", values="rms")
    assert len(along) == len(tables["steps"]) == 4
    assert {"fit", "left_out", "held_out_sensors", "held_out_bands"} <= set(along.columns)
    assert (along.diff().dropna() < 0).all(axis=None) and (along.iloc[-1] < 1.2).all()


def test_the_model_with_all_of_them_is_calibrated(explained):
    fit = explained.with_named().calibrate(starts=1, progress=False)
    for name, true in HIDDEN.items():
        assert fit.values[name] == pytest.approx(true, rel=0.05)
