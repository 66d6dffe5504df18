"""Least squares on a basis that grows where fits end: the same optimum as at full order, for few solutions of it."""

import itertools
import weakref
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import calib
from calib.analyses import case
from calib.analyses import explain as explaining
from calib.analyses.explain import explanation_of
from calib.analyses.hypotheses_of_study import adapter_for
from calib.analyses.reduction import reduction_near
from calib.correlation.basis import BasisRequirements
from calib.execution.stage import silent
from calib.hypotheses.one_test import OneTest
from calib.missing.candidate_fit import CandidateFit
from calib.missing.linearised_fit import least_squares_fit
from calib.structure import model as models
from calib.structure.affine import Term
from calib.structure.eigenproblem.mode_systems import eigenvalues
from calib.structure.reduction.reduced import ReducedModel

SIDE, ZONES, MEASURED = 18, 4, 5
TRUE = {"zone_1": 0.7, "zone_2": 1.5, "zone_3": 1.2, "zone_4": 0.8}


def membrane(damped=False):
    """A membrane on its edge, 324 degrees of freedom, in four zones of unknown tension; ``damped`` by two dampers."""
    zones = [[] for _ in range(ZONES)]
    for row in range(SIDE):
        for column in range(SIDE):
            here = row * SIDE + column
            zone = 2 * (row >= SIDE // 2) + (column >= SIDE // 3)
            zones[zone] += [(here, other) for other in (here + 1, here + SIDE)[column == SIDE - 1 :] if other < SIDE**2]
    edge = np.zeros(SIDE**2)
    for k in range(SIDE):
        edge[[k, SIDE**2 - 1 - k, k * SIDE, k * SIDE + SIDE - 1]] = 1.0
    parameters = [calib.Parameter(f"zone_{k + 1}", 1.0, 0.4, 2.5, prior_sd=0.5) for k in range(ZONES)]
    damping = None
    if damped:
        points = np.zeros(SIDE**2)
        points[[5 * SIDE + 4, 12 * SIDE + 9]] = 1.0
        damping = {"c": sp.diags_array(points), "all": sp.diags_array(np.full(SIDE**2, 0.02))}
        parameters.append(calib.Parameter("c", 0.5, 0.1, 2.0, "Ns/m", prior_sd=0.5))
    return calib.StructuralModel.from_matrices(
        stiffness={f"zone_{k + 1}": links(some) for k, some in enumerate(zones)} | {"edge": sp.diags_array(edge)},
        mass=sp.diags_array(np.linspace(1.0, 1.4, SIDE**2)),
        damping=damping,
        dofs=[(node + 1, "z") for node in range(SIDE**2)],
        parameters=parameters,
        name="membrane",
    )


def links(pairs):
    """Springs of 1 N/m between pairs of masses."""
    signs = np.zeros((len(pairs), SIDE**2))
    for k, (one, other) in enumerate(pairs):
        signs[k, one], signs[k, other] = 1.0, -1.0
    return sp.csr_array(signs.T @ signs)


def measured_at(model, true):
    """A test of the model's own modes at other values, with noise."""
    rng = np.random.default_rng(4)
    modes = model.modes(true, MEASURED)
    sensors = tuple(calib.Sensor(node, "z") for node in range(7, SIDE**2, 29))
    shapes = model.sensor_rows(sensors) @ modes.shapes.astype(complex)
    shapes = shapes / np.abs(shapes).max(axis=0)
    freq = modes.natural_freq * (1 + 2e-3 * rng.standard_normal(MEASURED))
    damped = modes.is_complex
    ratio = modes.damping_ratio * (1 + 0.05 * rng.standard_normal(MEASURED)) if damped else np.full(MEASURED, np.nan)
    return calib.ModalTest(calib.MeasuredModes(
        tuple("abcde"), freq, freq * np.sqrt(1 - np.nan_to_num(ratio) ** 2), 2e-3 * freq, ratio,
        0.05 * ratio, sensors, shapes + 0.01 * rng.standard_normal(shapes.shape), np.full(shapes.shape, 0.01),
    ))  # fmt: skip


@pytest.fixture
def solved(monkeypatch):
    """Points solved at full order."""
    points = []
    whole = models.solve_modes

    def counted(k, *more, **keys):
        points.append(k.shape[0])
        return whole(k, *more, **keys)

    monkeypatch.setattr(models, "solve_modes", counted)
    return points


@pytest.mark.slow
@pytest.mark.parametrize("damped", [False, True])
def test_the_optimum_on_the_basis_is_that_of_full_order(solved, damped):
    model = membrane(damped)
    problem = calib.Problem(model, measured_at(model, TRUE | ({"c": 0.8} if damped else {})))
    solved.clear()
    on_basis = problem.calibrate(progress=False)
    few = len(solved)
    at_full_order = problem.calibrate(reduction=False, progress=False)
    assert few <= 6 < len(solved) - few
    one, other = on_basis.parameters, at_full_order.parameters
    np.testing.assert_array_less(np.abs(one["value"] - other["value"]), 0.02 * other["std"])
    np.testing.assert_allclose(one["std"], other["std"], rtol=0.01)


@pytest.mark.parametrize("damped", [False, True])
def test_the_basis_has_the_modes_and_their_derivatives_at_its_point(damped):
    model = membrane(damped)
    problem = calib.Problem(model, measured_at(model, TRUE))
    basis = reduction_near(problem.study().studies[0]).basis
    reduced, values = ReducedModel(model, basis), model.space.values
    exact, found = model.modes(values, MEASURED + 2), reduced.modes(values, MEASURED + 2)
    np.testing.assert_allclose(eigenvalues(found), eigenvalues(exact), rtol=1e-6)
    names, rows = model.space.free_names, np.eye(model.n_dof)[::40]
    truth = model.derivatives(values, exact, names, range(MEASURED), rows)
    slope = reduced.derivatives(values, found, names, range(MEASURED), rows @ basis.vectors)
    signs = np.sign(np.einsum("ij,ij->j", exact.shapes.conj(), reduced.lift(found.shapes)).real)[:MEASURED]
    np.testing.assert_allclose(slope.natural_freq, truth.natural_freq, atol=1e-4 * np.abs(truth.natural_freq).max())
    size = np.abs(truth.shapes).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(slope.shapes * signs / size, truth.shapes / size, atol=0.02)


def test_a_basis_that_serves_at_a_point_stays_and_one_that_does_not_grows():
    model = membrane()
    problem = calib.Problem(model, measured_at(model, TRUE))
    near = reduction_near(problem.study().studies[0])
    assert near.covering([model.space.values]) is near
    grown = near.covering([TRUE])
    assert grown.basis.size > near.basis.size and grown.error_at(TRUE) <= grown.basis.tolerance < near.error_at(TRUE)
    assert grown.covering([TRUE]) is grown


@pytest.mark.slow
def test_a_fit_whose_basis_never_grew_ends_at_full_order_all_the_same(monkeypatch):
    """The optimum does not rest on the certificate: only the number of solutions at full order does."""
    monkeypatch.setattr(case.Reduction, "covering", lambda self, points: self)
    model = membrane()
    problem = calib.Problem(model, measured_at(model, TRUE))
    poor = problem.calibrate(progress=False).parameters
    monkeypatch.undo()
    good = problem.calibrate(progress=False).parameters
    np.testing.assert_array_less(np.abs(poor["value"] - good["value"]), 0.02 * good["std"])


def explained(problem, **keys):
    return problem.explain(progress=False, **keys).explanation


@pytest.mark.slow
def test_an_explanation_on_the_basis_is_that_of_full_order(solved):
    """From the nominal values, which the fit leaves, and with a spring that the model lacks.

    Derivatives by perturbations are in the basis but for 3e-6 of their energy, 0.2 % of them.
    """
    model = membrane()
    spring = np.zeros(SIDE**2)
    spring[7 * SIDE + 6] = 0.5
    terms = (*model.stiffness.terms, Term("spring", sp.csr_array(sp.diags_array(spring))))
    test = measured_at(replace(model, stiffness=replace(model.stiffness, terms=terms)), TRUE)
    problem = calib.Problem(model, test)
    solved.clear()
    on_basis = explained(problem)
    few = len(solved)
    at_full_order = explained(problem, reduction=False)
    assert few <= 12 and on_basis.verdict == at_full_order.verdict == "none_explains"
    assert on_basis.figures["basis_error"] < 1e-3
    one, other = on_basis.tables["perturbations"], at_full_order.tables["perturbations"]
    assert one["perturbation"].tolist() == other["perturbation"].tolist()
    np.testing.assert_allclose(one["score"], other["score"], atol=3e-3 * other["score"].max())
    one, other = on_basis.tables["candidate_fits"], at_full_order.tables["candidate_fits"]
    np.testing.assert_allclose(one["misfit"], other["misfit"], rtol=1e-3)


@pytest.mark.medium
def test_a_basis_about_a_fit_grows_where_an_effect_leaves_it():
    model = membrane()
    (study,) = calib.Problem(model, measured_at(model, TRUE)).study().studies
    adapter = adapter_for(study, None, silent, {}, TRUE)
    local = next(e for e in adapter.hypotheses.perturbations if e.name == "stiffness of edge")
    near = least_squares_fit(adapter.hypotheses.fit_problem(()), (), adapter.hypotheses.space.complete(TRUE))
    far = replace(near, values={**near.values, local.name: 4 * local.plausible})
    base, strong = CandidateFit((), near, 0.0, ()), CandidateFit((local,), far, 0.0, ())
    assert adapter.covering([base]) is adapter
    grown = adapter.covering([base, strong])
    there = (adapter, grown)
    poor, good = (one.hypotheses.fit_problem((local.name,)).residual(far.values) for one in there)
    truth = adapter.full_residual(strong)
    assert np.abs(good - truth).max() < 0.01 < np.abs(poor - truth).max()
    assert grown.covering([base, strong]) is grown


@pytest.mark.medium
@pytest.mark.parametrize("method", ["auto", "genetic"])
def test_bases_of_effects_are_made_once_about_the_fit_whatever_calibrates_the_study(method, monkeypatch):
    made, model = [], membrane()
    own = BasisRequirements.with_effects

    def counted(self, model, basis, space, effects, local, progress, at):
        made.append(at)
        return own(self, model, basis, space, effects, local, progress, at)

    monkeypatch.setattr(BasisRequirements, "with_effects", counted)
    problem = calib.Problem(model, measured_at(model, TRUE))
    calibration = problem.settings.calibration.model_copy(update={"method": method})
    study = problem.study(problem.settings.model_copy(update={"calibration": calibration}))
    _, answer = explanation_of(study)
    (about,) = made
    base = answer.explanation.base.fit.values
    for name, value in TRUE.items():
        assert about[name] == pytest.approx(base[name], abs=0.05) and abs(value - 1.0) > 0.1


@pytest.mark.medium
@pytest.mark.parametrize("at_base", [True, False])
def test_models_of_a_decision_go_before_others_are_built(at_base, monkeypatch):
    model, before, gone, looks = membrane(), list[weakref.ref](), list[bool](), itertools.count()
    study = calib.Problem(model, measured_at(model, TRUE)).study()
    decide, covering = explaining.decision, OneTest.covering

    def grown(self, fits):
        """The basis grows once: at the first look, for the base fit, or at the second one, for all fits."""
        new = next(looks) == (0 if at_base else 1)
        return replace(self, hypotheses=replace(self.hypotheses)) if new else covering(self, fits)

    def decided(adapter, *more):
        gone.append(all(one() is None for one in before))
        found = decide(adapter, *more)
        before.extend(weakref.ref(one) for one in (adapter.hypotheses, found, found.base.fit))
        return found

    monkeypatch.setattr(explaining, "decision", decided)
    monkeypatch.setattr(OneTest, "covering", grown)
    _, answer = explanation_of(study)
    assert gone == [True, True] and answer.verdict
