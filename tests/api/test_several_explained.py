"""Joint explanation of several tests; measurements are synthetic, with noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import eigh

import calib
from calib.analyses.hypotheses_of_study import adapters_for
from calib.structure.affine import Monomial
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition
from models.five_mass_chain import five_mass_chain

pytestmark = pytest.mark.slow

STUDIES = Path(__file__).resolve().parents[2] / "studies"
STOREYS, MASS, STIFF, GROUND, LOAD = 6, 2000.0, 4e6, 4e5, 1500.0


# -- one test, cut in two ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chain():
    """Explanations of the chain's responses, their standard deviation known, as one test and split in two."""
    read = calib.read_responses(STUDIES / "five_mass_chain/measured.csv")
    given = calib.ResponseTest(read).measured.targets
    library = calib.Study.load(STUDIES / "five_mass_chain").loaded.library
    shapes = {name for name in given if name.startswith("shape")}
    first = calib.ResponseTest({n: v for n, v in given.items() if n not in shapes}, name="poles")
    second = calib.ResponseTest({n: v for n, v in given.items() if n in shapes}, name="shapes")
    free = ("k1", "k2", "k3", "k4", "k5", "damping")
    tests = (calib.ResponseTest(dict(given)), [first, second])
    return [calib.Problem(five_mass_chain(), test).keep(free).explain(library) for test in tests]


@pytest.mark.slow
def test_a_test_split_in_two_gives_the_same_result(chain):
    whole, cut = chain
    assert whole.verdict == cut.verdict == "effect"
    assert [e.name for e in whole.named] == [e.name for e in cut.named]
    mine, own = (why.table.set_index("name") for why in (cut, whole))
    fitted = own["ln_bayes"].notna()
    np.testing.assert_allclose(mine["z"], own.loc[mine.index, "z"], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mine.loc[own.index[fitted], "ln_bayes"], own.loc[fitted, "ln_bayes"], atol=0.02)
    p = [float(why.explanation.explanation.base_adequacy.p_fit) for why in chain]
    assert p[0] == pytest.approx(p[1], rel=1e-3)
    rows = [why.errors.set_index(["group", "stage"]).loc[("fit", "after")] for why in chain]
    assert rows[0]["rms"] == pytest.approx(rows[1]["rms"], rel=1e-3) and rows[0]["rows"] == rows[1]["rows"]


def test_perturbations_of_one_test_bear_its_name(chain):
    names = set(chain[1].explanation.explanation.base_adequacy.perturbations.owners)
    faults = {name for name in names if name.startswith(("offset", "scale"))}
    assert faults and all(name.endswith(("in test poles", "in test shapes")) for name in faults)
    assert set(chain[1].explanation.tables["response_misfit"]["test"]) == {"poles", "shapes"}


def test_the_pattern_of_a_test_split_in_two_is_that_of_the_whole(chain):
    whole, cut = (why.explanation.tables["why"] for why in chain)
    assert [cut.loc[cut["test"] == name, "kind"].tolist() for name in ("poles", "")] == [
        whole.loc[~whole["sensor"].str.startswith("shape") & (whole["kind"] != "prior"), "kind"].tolist(),
        ["prior"] * (whole["kind"] == "prior").sum(),
    ]
    columns = ["residual", "signature", "left"]
    mine, own = (table.set_index("sensor")[columns].sort_index() for table in (cut, whole))
    np.testing.assert_allclose(mine, own.loc[mine.index], rtol=0.01, atol=0.01)
    assert set(chain[1].explanation.tables["why"]["mode"]) == {""}


# -- modes under two conditions ----------------------------------------------------------------------------------------


def frame(load, spring=0.0, stiff=STIFF):
    """Stiffness and mass of a shear frame with a load on its top and a spring from floor 3 to the ground."""
    k = np.diag([2.0] * (STOREYS - 1) + [1.0]) - np.diag([1.0] * (STOREYS - 1), 1) - np.diag([1.0] * (STOREYS - 1), -1)
    k = k * stiff
    k[2, 2] += spring
    return k, np.diag([MASS] * (STOREYS - 1) + [MASS + load])


def measured(load, seed):
    rng = np.random.default_rng(seed)
    squares, shapes = eigh(*frame(load, spring=GROUND, stiff=1.06 * STIFF))
    freq, seen = np.sqrt(squares) / (2 * np.pi), shapes / np.abs(shapes).max(axis=0)
    std = np.full(seen.shape, 0.01)
    return calib.MeasuredModes(
        names=tuple(f"M{k + 1}" for k in range(STOREYS)),
        natural_freq=freq * (1 + 0.002 * rng.standard_normal(STOREYS)),
        damped_freq=freq,
        freq_std=0.002 * freq,
        damping_ratio=np.full(STOREYS, np.nan),
        damping_std=np.full(STOREYS, np.nan),
        sensors=tuple(calib.Sensor(k + 1, "x", (0.0, 0.0, 3.0 * (k + 1))) for k in range(STOREYS)),
        shapes=(seen + std * rng.standard_normal(seen.shape)).astype(complex),
        shape_std=std,
        synthetic=True,
    )


def shear_frame():
    load = np.zeros((STOREYS, STOREYS))
    load[-1, -1] = 1.0
    k, m = frame(0.0, stiff=1.0)
    dofs = pd.DataFrame({"node": range(1, STOREYS + 1), "direction": "x", "x": 0.0, "y": 0.0})
    dofs["z"] = 3.0 * dofs["node"]
    space = [
        calib.Parameter("k", STIFF, 0.5 * STIFF, 2 * STIFF, "N/m", prior_sd=0.2 * STIFF),
        calib.Parameter("load", 0.0, 0.0, 5000.0, "kg"),
    ]
    return calib.StructuralModel.from_matrices({"k": k}, {"own": m, "load": load}, dofs=dofs, parameters=space)


def grounded(name, floor):
    def build(model):
        row = np.zeros(model.n_dof)
        row[floor - 1] = 1.0
        return Addition(stiffness=(outer_term(name, [row], Monomial(1.0, ((name, 1.0),))),))

    size = calib.Parameter(name, 0.0, 0.0, 5e6, "N/m", prior_sd=5e5)
    return calib.Effect(name, name, "The frame stands free.", "A contact with the neighbour.", size, build)


LIBRARY = tuple(grounded(f"contact_{floor}", floor) for floor in (1, 3, 5))


@pytest.fixture(scope="module")
def modal_tests():
    return [calib.ModalTest(measured(x, seed), name=n, condition={"load": x})
            for n, x, seed in (("empty", 0.0, 1), ("loaded", LOAD, 2))]  # fmt: skip


@pytest.fixture(scope="module")
def both(modal_tests):
    problem = calib.Problem(shear_frame(), modal_tests)
    return problem, problem.explain(LIBRARY)


def test_two_conditions_name_the_effect_more_sharply_than_one(both, modal_tests):
    _, why = both
    alone = calib.Problem(shear_frame(), modal_tests[0]).explain(LIBRARY)
    width = []
    for found in (alone, why):
        assert found.verdict == "effect" and [e.name for e in found.named] == ["contact_3"]
        row = found.table.set_index("name").loc["contact_3"]
        assert row["magnitude_low"] < GROUND < row["magnitude_high"]
        width.append(row["magnitude_high"] - row["magnitude_low"])
    assert width[1] < 0.85 * width[0]


def test_the_named_effect_acts_in_both_tests(both):
    problem, why = both
    before, after = problem.calibrate(starts=1), why.with_named().calibrate(starts=1)
    assert before.statistics.fits is False and after.statistics.fits
    assert after.values["contact_3"] == pytest.approx(GROUND, rel=0.1)
    rms = after.errors.set_index(["group", "test"])["rms"]
    assert max(rms["fit", "empty"], rms["fit", "loaded"]) < 1.3


def test_local_perturbations_are_one_in_all_tests_of_a_model(both, modal_tests):
    problem, why = both
    scores = why.explanation.explanation.base_adequacy.perturbations
    assert len(set(scores.owners)) == 3 + 2 * STOREYS  # springs, own mass and load, and two a sensor
    one = list(scores.owners).index("grounded spring at sensor 3x")
    half = len(problem.fit_problem.rows) // 2
    assert np.abs(scores.raw[:half, one]).max() > 0 and np.abs(scores.raw[half:, one]).max() > 0
    fewer = replace(modal_tests[1], modes=modal_tests[1].modes.without((), ("3x",)))
    adapters = adapters_for(calib.Problem(shear_frame(), [modal_tests[0], fewer]).study(effects={"matrices": LIBRARY}))
    assert "grounded spring at sensor 3x" in {e.name for e in adapters["loaded"].hypotheses.perturbations}


def test_a_load_that_is_held_differs_by_test(both):
    problem, why = both
    assert "load" not in problem.space and "load" not in why.explanation.explanation.base.fit.values


# -- several models ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def beside(modal_tests):
    """The frame, and a scale on which one storey's spring was weighed."""
    space = calib.ParameterSpace((calib.Parameter("k", STIFF, 0.5 * STIFF, 2 * STIFF, "N/m"),))
    rig = calib.FunctionModel("rig", space, lambda v: {"deflection": 1e3 / v["k"], "twice": 2e3 / v["k"]})
    test = calib.ResponseTest({"deflection": (1e3 / (1.06 * STIFF), 1e-6), "twice": (2e3 / (1.06 * STIFF), 2e-6)},
                              name="bench")  # fmt: skip
    return calib.Problem.join(calib.Problem(shear_frame(), modal_tests), calib.Problem(rig, test))


@pytest.mark.slow
def test_effects_of_joined_problems_are_given_by_model(beside):
    def soft(model):
        return lambda v: {n: r * (1 + v["soft"]) for n, r in model.function(v).items()}

    size = calib.Parameter("soft", 0.0, 0.0, 1.0, "-", prior_sd=0.1)
    bench = calib.Effect("soft", "Soft bench", "The bench is rigid.", "Its feet.", size, soft)
    why = beside.explain({"matrices": LIBRARY, "rig": [bench]})
    assert why.verdict == "effect" and [e.name for e in why.named] == ["contact_3"]
    assert set(why.table["name"]) == {"contact_1", "contact_3", "contact_5", "soft"}
    fit = why.with_named().calibrate(starts=1)
    assert fit.statistics.fits and fit.values["k"] == pytest.approx(1.06 * STIFF, rel=5e-3)
    names = set(why.explanation.explanation.base_adequacy.perturbations.owners)
    assert "mass of load" in names and any("in test bench" in name for name in names)  # only one model has masses


def test_effects_of_an_unknown_model_are_refused(beside):
    with pytest.raises(calib.InputError, match="tower"):
        beside.explain({"tower": LIBRARY})
    with pytest.raises(calib.InputError):
        beside.with_effects({"tower": LIBRARY})
