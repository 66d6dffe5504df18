"""Frequencies and damping ratios as plain numbers: closed forms of a chain of two masses on two springs."""

import numpy as np
import pytest

import calib
from calib.correlation.modal.responses import ModalResponses
from calib.problem.differences import central_jacobian
from calib.problem.problem import PairProblem
from calib.structure.affine import parameter
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition
from calib.structure.function_model import slope_entry

FIRST, SECOND = np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[1.0, -1.0], [-1.0, 1.0]])
GOLDEN = np.sqrt((3 + np.array([-1.0, 1.0]) * np.sqrt(5)) / 2)
"""Natural frequencies of equal masses and springs, over sqrt(k/m)."""


def chain(damped=True, **options):
    """Masses of 10 kg on springs k1 and k2; damping is b times the stiffness at 1 N/m times 1000."""
    both = FIRST + SECOND
    return calib.StructuralModel.from_matrices(
        stiffness={"k1": FIRST, "k2": SECOND},
        mass=np.diag([10.0, 10.0]),
        damping={"b": 1e3 * both} if damped else {},
        dofs=[(1, "x"), (2, "x")],
        parameters=[
            calib.Parameter("k1", 30.0, 10.0, 90.0, "kN/m"),
            calib.Parameter("k2", 50.0, 10.0, 90.0, "kN/m"),
            *([calib.Parameter("b", 0.01, 0.001, 0.1, "-")] if damped else []),
        ],
        **options,
    )


def function(v):
    """The same as a function of modes, undamped."""
    squares, shapes = np.linalg.eigh(1e3 * (v["k1"] * FIRST + v["k2"] * SECOND) / 10.0)
    return {"natural_freq": np.sqrt(squares) / (2 * np.pi), "shapes": shapes}


def solver():
    return calib.ModalFunctionModel("chain", chain(False).space, function, sensors=["1x", "2x"], n_modes=2)


def closed(k, b=0.0):
    """Frequencies, Hz, and damping ratios of equal springs of k kN/m with damping 1000 b/k of the stiffness, in s."""
    omega = GOLDEN * np.sqrt(1e3 * k / 10.0)
    return omega / (2 * np.pi), 1e3 * b / (1e3 * k) * omega / 2


def sheet(k=40.0, b=0.02, damping=True, std=1e-3, **options):
    freq, ratio = closed(k, b)
    values = {f"freq_{j}": (f, std * f) for j, f in enumerate(freq, 1)}
    values |= {f"damping_{j}": (z, std * z) for j, z in enumerate(ratio, 1)} if damping else {}
    return calib.ResponseTest(values, **options)


def test_the_responses_are_those_of_the_closed_form():
    table = calib.Problem(chain(), sheet()).compare({"k1": 40.0, "k2": 40.0, "b": 0.02}).table.set_index("response")
    np.testing.assert_allclose(table["model"], table["measured"], rtol=1e-9)
    np.testing.assert_allclose(table.loc[["freq_1", "freq_2"], "model"], closed(40.0)[0], rtol=1e-9)
    twice = calib.Problem(chain(), sheet()).compare({"k1": 80.0, "k2": 80.0, "b": 0.02}).table["error"]
    np.testing.assert_allclose(twice[:2], np.sqrt(2) - 1, rtol=1e-9)


@pytest.mark.parametrize("model", [chain, lambda: chain(False), solver], ids=["damped", "undamped", "function"])
def test_stiffnesses_follow_from_the_numbers_of_a_sheet(model):
    made = model()
    fit = calib.Problem(made, sheet(damping=made.dissipates)).calibrate(starts=1, progress=False)
    assert fit.values["k1"] == pytest.approx(40.0, rel=1e-4) and fit.values["k2"] == pytest.approx(40.0, rel=1e-4)
    if made.dissipates:
        assert fit.values["b"] == pytest.approx(0.02, rel=1e-4)
    # sd of the stiffnesses, linear in the relative errors of both frequencies
    slope = central_jacobian(
        lambda v: np.log(function(v)["natural_freq"]), solver().space, {"k1": 40.0, "k2": 40.0}, ["k1", "k2"], 1e-4
    )
    expected = 1e-3 * np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    if not made.dissipates:
        np.testing.assert_allclose(fit.parameters.loc[["k1", "k2"], "std"], expected, rtol=2e-2)


def test_derivatives_are_exact_and_need_no_differences():
    model, names = chain(), ("k1", "k2", "b")
    test = sheet()
    pair = test.pair(model)
    values = model.space.values
    told = ModalResponses(model, 2).derivatives_by(values, names)
    numeric = central_jacobian(
        lambda v: np.array(list(ModalResponses(model, 2)(v).values())), model.space, values, names, 1e-5
    )
    responses = list(ModalResponses(model, 2)(values))
    exact = np.array([[told[slope_entry(r, n)] for n in names] for r in responses])
    np.testing.assert_allclose(exact, numeric, rtol=1e-5, atol=1e-10)
    problem = PairProblem(pair, model.space)
    slope = problem.jacobian(values, names)
    assert problem.counts.solved == 1
    measured = list(test.measured.targets)
    np.testing.assert_allclose(slope, -np.array([exact[responses.index(r)] for r in measured]) / pair.std[:, None])
    assert ModalResponses(solver(), 2).derivatives_by(values, names) == {}


@pytest.mark.parametrize(
    ("model", "responses", "words"),
    [
        (chain, {"freq_1": 6.0, "mass": 20.0}, "has no response 'mass'"),
        (chain, {"freq_0": 6.0}, "has no response 'freq_0'"),
        (solver, {"freq_3": 6.0}, "freq_3 is beyond the 2 modes"),
        (lambda: chain(False), {"freq_1": 6.0, "damping_1": 0.01}, "has no damping"),
    ],
)
def test_what_a_model_does_not_have_is_refused(model, responses, words):
    with pytest.raises(calib.InputError, match=words) as told:
        calib.Problem(model(), calib.ResponseTest(responses, name="sheet"))
    assert "sheet" in str(told.value)


# -- what is missing ---------------------------------------------------------------------------------------------------

N = 6


def long_chain(name="chain"):
    """Six masses of 10 kg in a row, one stiffness factor for all springs."""
    k = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    return calib.StructuralModel.from_matrices(
        stiffness={"k": k},
        mass=np.diag([10.0] * N),
        dofs=[(j + 1, "x") for j in range(N)],
        parameters=[calib.Parameter("k", 40.0, 10.0, 90.0, "kN/m")],
    )


def to_ground(node):
    row = np.eye(N)[node - 1]
    name = f"ground_{node}"
    return calib.Effect(
        name, f"A spring from mass {node} to the ground", "It is free.", "A contact.",
        calib.Parameter(name, 0.0, 0.0, 60.0, "kN/m", prior_sd=15.0),
        lambda model: Addition(stiffness=(outer_term(name, [row], parameter(name)),)),
    )  # fmt: skip


def numbers(k, ground, noise, seed=1):
    """Frequencies of the chain with a spring at mass 2 to the ground, measured with noise."""
    k = 1e3 * k * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)) + 1e3 * ground * np.diag(np.eye(N)[1])
    freq = np.sqrt(np.linalg.eigvalsh(k / 10.0)) / (2 * np.pi)
    rng = np.random.default_rng(seed)
    return {f"freq_{j}": (f * (1 + noise * rng.standard_normal()), noise * f) for j, f in enumerate(freq, 1)}


@pytest.mark.medium
def test_a_missing_spring_is_named_from_frequencies_alone():
    """Of masses 1 to 3 only: the others are alike by symmetry."""
    library = [to_ground(1), to_ground(2), to_ground(3)]
    test = calib.ResponseTest(numbers(40.0, 12.0, 2e-4))
    why = calib.Problem(long_chain(), test).explain(library, progress=False)
    assert why.verdict == "effect" and [e.name for e in why.named] == ["ground_2"]
    fit = why.with_named().calibrate(starts=1, progress=False)
    assert fit.values["ground_2"] == pytest.approx(12.0, rel=0.02)
    assert set(why.explanation.tables["perturbations"]["perturbation"]) == {"stiffness of k", "mass of mass"}
    right = calib.ResponseTest(numbers(40.0, 0.0, 2e-4))
    assert calib.Problem(long_chain(), right).explain(library, progress=False).verdict == "nothing_detectable"


def test_a_function_of_modes_is_explained_by_plain_numbers_too():
    def modes(v):
        k = 1e3 * v["k"] * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
        k[1, 1] += 1e3 * v.get("ground_2", 0.0)
        k[0, 0] += 1e3 * v.get("ground_1", 0.0)
        squares, shapes = np.linalg.eigh(k / 10.0)
        return {"natural_freq": np.sqrt(squares) / (2 * np.pi), "shapes": shapes}

    space = long_chain().space
    model = calib.ModalFunctionModel("chain", space, modes, [f"{j + 1}x" for j in range(N)], N)
    library = [
        calib.Effect(n, n, "It is free.", "A contact.", calib.Parameter(n, 0.0, 0.0, 60.0, "kN/m", prior_sd=15.0),
                     lambda model: None)
        for n in ("ground_1", "ground_2")
    ]  # fmt: skip
    why = calib.Problem(model, calib.ResponseTest(numbers(40.0, 12.0, 2e-4))).explain(library, progress=False)
    assert why.verdict == "effect" and [e.name for e in why.named] == ["ground_2"]


def test_held_out_numbers_and_a_second_test_of_modes():
    freq, shapes = (function({"k1": 40.0, "k2": 40.0})[n] for n in ("natural_freq", "shapes"))
    unknown = np.full(2, np.nan)
    sensors = tuple(calib.Sensor(j, "x") for j in (1, 2))
    modes = calib.MeasuredModes(
        ("1", "2"), freq, freq, 1e-3 * freq, unknown, unknown, sensors, shapes, 0.01 * np.ones_like(shapes)
    )
    model = chain(False)
    both = [calib.ModalTest(modes, name="tapped"), sheet(damping=False, name="sheet", held_out=["freq_2"])]
    fit = calib.Problem(model, both).calibrate(starts=1, progress=False)
    assert fit.values["k2"] == pytest.approx(40.0, rel=1e-3)
    errors = fit.errors.set_index(["test", "group"])
    assert errors.loc[("sheet", "held_out_responses"), "rms"] < 0.1
    assert "sheet: freq_1" in {row.sensor for row in fit.problem.fit_problem.rows}
