"""Cross-model cross-FRF equations against their literal form, exact recovery, noise, and what they cannot determine."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors import EvaluationError, InputError
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import (
    Change,
    CmcfSettings,
    Equations,
    InitialModel,
    MeasuredReceptance,
    Reduced,
)
from calib.structure.static_reduction import static_reduction
from models.solar_panel import GROUPS, MASTERS, solar_panel

SYMMETRIC = np.array([0.2, 0.2, 0.3, 0.3, 0.5, 0.5])
"""Relative changes of the Young's moduli, as in the article: the array stays symmetric."""
ASYMMETRIC = np.array([0.2, 0.1, 0.3, 0.05, 0.5, 0.25])
LEVEL = 4
ALL_STEPS = CmcfSettings(tolerance=0.0)


def transformation(masters, level, stiffness, mass):
    return static_reduction(stiffness, mass, masters, level).transformation


class Array:
    """The solar array as an initial model, and the structure with other Young's moduli that is measured."""

    def __init__(self):
        model = solar_panel()
        self.k, _, self.m = model.matrices({})
        nodes = zip(model.dofs.node, model.dofs.direction, strict=True)
        self.masters = np.array([k for k, (node, d) in enumerate(nodes) if node + 1 in MASTERS and d == 2])
        own = [model.matrix_derivatives({}, g)[0] * model.space[g].value for g in GROUPS]
        self.changes = tuple(Change(g, "stiffness", sp.csc_array(k)) for g, k in zip(GROUPS, own, strict=True))
        self.reduce = partial(transformation, self.masters, LEVEL)
        self.initial = InitialModel(self.k, self.m, self.changes, self.masters, self.reduce)
        self.whole = InitialModel(self.k, self.m, self.changes, np.arange(self.k.shape[0]))

    def stiffness(self, alpha):
        return sp.csc_array(self.k + sum(a * c.matrix for a, c in zip(alpha, self.changes, strict=True)))

    def freq(self, alpha, count=4):
        eigenvalues = la.eigh(self.stiffness(alpha).toarray(), self.m.toarray(), eigvals_only=True)
        return np.sqrt(eigenvalues[:count]) / (2 * np.pi)

    def receptance(self, alpha, freq):
        k, m = self.stiffness(alpha).toarray(), self.m.toarray()
        return np.array([la.inv(k - (2 * np.pi * f) ** 2 * m) for f in freq])

    def measured(self, alpha, offset):
        """What a test measures: the masters' partition of the whole receptance."""
        freq = self.freq(alpha) * (1 + offset)
        here = np.ix_(range(len(freq)), self.masters, self.masters)
        return MeasuredReceptance(freq, self.receptance(alpha, freq)[here], np.arange(12))

    def consistent(self, alpha, offset):
        """The receptance of the measured structure reduced to the masters, which has no modes beyond them."""
        freq = self.freq(alpha) * (1 + offset)
        k, t = self.stiffness(alpha), self.reduce(self.stiffness(alpha), self.m)
        found = [la.inv(t.T @ (k - (2 * np.pi * f) ** 2 * self.m) @ t) for f in freq]
        return MeasuredReceptance(freq, np.array(found), np.arange(12))

    def noisy(self, alpha, seed, offset=0.02):
        """5 % noise of the receptance, and frequencies tagged 3 % wrong; both uniform."""
        rng, true = np.random.default_rng(seed), self.measured(alpha, offset)
        receptance = true.receptance * (1 + 0.05 * rng.uniform(-1, 1, true.receptance.shape))
        return MeasuredReceptance(true.freq * (1 + 0.03 * rng.uniform(-1, 1, 4)), receptance, true.references)


@pytest.fixture(scope="module")
def array():
    return Array()


# -- the equations as the article writes them --------------------------------------------------------------------------


def literal(array, measured, settings, steps, mutant=""):
    """Iterates of the proposed iteration by equations (24) to (31) of Li and Hong (2012), with their signs restored."""
    reduce, k, m, n = array.reduce, array.k, array.m, 12
    t_f = reduce(k, m)
    k_s, m_s = t_f.T @ k @ t_f, t_f.T @ m @ t_f
    blocks = [t_f.T @ c.matrix @ t_f for c in array.changes]
    omega = np.sqrt(la.eigh(k_s, m_s, eigvals_only=True)[: settings.orders]) * (1 + settings.offset)
    h = [la.inv(k_s - w**2 * m_s) for w in omega]
    star = 2 * np.pi * measured.freq

    def weight(h_i, w_j, h_j):
        return 1 / (la.norm(h_i.T @ (k_s - w_j**2 * m_s)) * la.norm(h_j))

    pairs = [(i, j, weight(h[i], star[j], measured.receptance[j])) for i in range(len(h)) for j in range(len(star))]
    a = np.vstack([
        np.column_stack([(w * h[i].T @ b @ measured.receptance[j]).ravel() for b in blocks]) for i, j, w in pairs
    ])  # fmt: skip

    def f(i, j):
        h_j = measured.receptance[j]
        squares = omega[i] ** 2 - star[j] ** 2 if mutant == "squares" else star[j] ** 2 - omega[i] ** 2
        ends = h_j - h[i].T if mutant == "ends" else h[i].T - h_j
        return ends + squares * h[i].T @ m_s @ h_j

    def g(i, j, alpha):
        k_k = array.stiffness(alpha)
        delta = reduce(k_k, m) - t_f
        y = star[j] ** 2 * m - k_k
        terms = {"first": t_f.T @ y @ delta, "second": delta.T @ y @ t_f, "third": delta.T @ y @ delta}
        inner = sum((term for name, term in terms.items() if name != mutant), np.zeros((n, n)))
        return (-1 if mutant == "sign" else 0 if mutant == "dropped" else 1) * h[i].T @ inner @ measured.receptance[j]

    out, alpha = [], np.zeros(len(blocks))
    for step in range(steps):
        rows = [w * (f(i, j) + (g(i, j, alpha) if step else 0)) for i, j, w in pairs]
        alpha = la.lstsq(a, np.ravel(rows))[0]
        out.append(alpha)

    def once(at):
        """The next iterate from any changes."""
        return la.lstsq(a, np.ravel([w * (f(i, j) + g(i, j, at)) for i, j, w in pairs]))[0]

    return np.array(out), once


def test_the_iterates_are_those_of_the_articles_equations(array):
    measured = array.consistent(SYMMETRIC, 0.02)
    own = cmcf(array.initial, measured, replace(ALL_STEPS, steps=5)).changes[1:]
    written, _ = literal(array, measured, ALL_STEPS, len(own))
    np.testing.assert_allclose(own, written, atol=1e-9)


@pytest.mark.parametrize("iteration", ["traditional", "traditional_total"])
def test_the_traditional_iterates_are_those_of_equation_32(array, iteration):
    """Its two readings: the next base is the updated model, or the initial one with the updated transformation."""
    measured, m = array.consistent(ASYMMETRIC, 0.02), array.m
    own = cmcf(array.initial, measured, replace(ALL_STEPS, steps=4, iteration=iteration)).changes[1:]
    alpha, written = np.zeros(6), []
    for _ in range(4):
        t = array.reduce(array.stiffness(alpha), m)
        total = iteration == "traditional_total"
        k_s, m_s = t.T @ array.stiffness(0 * alpha if total else alpha) @ t, t.T @ m @ t
        blocks, rows, right = [t.T @ c.matrix @ t for c in array.changes], [], []
        for w in np.sqrt(la.eigh(k_s, m_s, eigvals_only=True)[:8]) * 1.02:
            h = la.inv(k_s - w**2 * m_s)
            for star, h_j in zip(2 * np.pi * measured.freq, measured.receptance, strict=True):
                weight = 1 / (la.norm(h.T @ (k_s - star**2 * m_s)) * la.norm(h_j))
                rows.append(np.column_stack([(weight * h.T @ b @ h_j).ravel() for b in blocks]))
                right.append(weight * (h.T - h_j + (star**2 - w**2) * h.T @ m_s @ h_j).ravel())
        step = la.lstsq(np.vstack(rows), np.concatenate(right))[0]
        alpha = step if total else alpha + step
        written.append(alpha)
    np.testing.assert_allclose(own, written, atol=1e-9)
    assert np.abs(np.diff(written, axis=0)).max() > 1e-4


def test_the_true_changes_are_a_fixed_point_and_wrong_signs_are_not(array):
    measured = array.consistent(SYMMETRIC, 0.02)
    _, once = literal(array, measured, ALL_STEPS, 1)
    assert np.abs(once(SYMMETRIC) - SYMMETRIC).max() < 1e-9
    for mutant in ("sign", "first", "second", "third", "squares", "ends", "dropped"):
        _, wrong = literal(array, measured, ALL_STEPS, 1, mutant)
        assert np.abs(wrong(SYMMETRIC) - SYMMETRIC).max() > 5e-3, mutant


def test_the_left_factors_add_weights_and_no_equations(array):
    reduced = Reduced.of(array.initial, np.zeros(6))
    equations = Equations.at(reduced, array.consistent(SYMMETRIC, 0.02), ALL_STEPS)
    stacked = np.vstack([np.kron(w, np.eye(12)) for w in equations.left])
    assert stacked.shape == (1152, 144) and np.linalg.matrix_rank(stacked) == 144


def test_with_few_references_the_independent_equations_are_fewer(array):
    """Of 8 left factors, 4 lines and 12 masters: 12 x 2 x 4 equations with two references, not 8 times as many."""
    reduced = Reduced.of(array.initial, np.zeros(6))
    some = array.consistent(SYMMETRIC, 0.02)
    two = MeasuredReceptance(some.freq, some.receptance[:, :, [0, 7]], np.array([0, 7]))
    equations = Equations.at(reduced, two, ALL_STEPS)
    stacked = np.vstack([np.kron(np.kron(w, np.eye(2)), np.eye(4)) for w in equations.left])
    assert equations.inverse.shape == (6, 8 * 4 * 12 * 2) and np.linalg.matrix_rank(stacked) == 4 * 12 * 2


def test_every_iterate_is_a_step_of_newtons_method_with_a_frozen_jacobian(array):
    """f + G_k - A alpha_k is the weighted imbalance of the updated model; G_k has three terms, or two products."""
    measured, alpha = array.consistent(SYMMETRIC, 0.02), np.array([0.1, 0.3, 0.2, 0.25, 0.4, 0.6])
    reduced, start = (Reduced.of(array.initial, a) for a in (alpha, np.zeros(6)))
    equations = Equations.at(start, measured, ALL_STEPS)
    t_f, t_e = array.reduce(array.k, array.m), array.reduce(array.stiffness(alpha), array.m)
    delta, k_s, m_s = t_e - t_f, t_f.T @ array.k @ t_f, t_f.T @ array.m @ t_f
    blocks = [t_f.T @ c.matrix @ t_f for c in array.changes]
    chord = np.einsum("ipm,jmq->ijpq", equations.left, reduced.imbalance(measured))
    omega = np.sqrt(la.eigh(k_s, m_s, eigvals_only=True)[:8]) * 1.02
    for i, w_i in enumerate(omega):
        h = la.inv(k_s - w_i**2 * m_s)
        for j, star in enumerate(2 * np.pi * measured.freq):
            h_j, y = measured.receptance[j], star**2 * array.m - array.stiffness(alpha)
            g = h.T @ (t_f.T @ y @ delta + delta.T @ y @ t_f + delta.T @ y @ delta) @ h_j
            products = h.T @ (t_e.T @ y @ t_e - t_f.T @ y @ t_f) @ h_j
            f = h.T - h_j + (star**2 - w_i**2) * h.T @ m_s @ h_j
            left = f + g - h.T @ sum(a * b for a, b in zip(alpha, blocks, strict=True)) @ h_j
            # differences of terms 1e8 times as large; a wrong sign or a term that is missing makes 1e-2
            assert la.norm(products - g) < 1e-6 * la.norm(g) and la.norm(chord[i, j] - left) < 1e-6 * la.norm(left)


# -- exact recovery ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [SYMMETRIC, ASYMMETRIC], ids=["symmetric", "asymmetric"])
@pytest.mark.parametrize("offset", [1e-3, 0.02, 0.1])
def test_with_all_degrees_of_freedom_one_step_is_exact(array, alpha, offset):
    freq = array.freq(alpha) * (1 + offset)
    measured = MeasuredReceptance(freq, array.receptance(alpha, freq), np.arange(90))
    found = cmcf(array.whole, measured, CmcfSettings(offset=offset, steps=1))
    np.testing.assert_allclose(found.changes[1], alpha, atol=1e-9)


def test_linked_elements_change_together(array):
    """The two panels as one group, and the two halves of the yoke."""
    linked = tuple(
        Change(name, "stiffness", array.changes[i].matrix + array.changes[j].matrix)
        for name, i, j in (("panels", 0, 1), ("yoke", 4, 5))
    )
    model = replace(array.initial, changes=(*linked, *array.changes[2:4]))
    measured = array.consistent(np.array([0.2, 0.2, 0.3, 0.05, 0.5, 0.5]), 0.02)
    found = cmcf(model, measured, ALL_STEPS)
    assert found.names == ("panels", "yoke", *GROUPS[2:4])
    np.testing.assert_allclose(found.changes[-1], [0.2, 0.5, 0.3, 0.05], atol=1e-8)
    assert found.values["yoke"] == found.changes[-1][1]


@pytest.mark.parametrize("alpha", [SYMMETRIC, ASYMMETRIC], ids=["symmetric", "asymmetric"])
@pytest.mark.parametrize("weighting", ["block", "white"])
def test_without_noise_every_iteration_tends_to_the_truth(array, alpha, weighting):
    measured, firsts = array.consistent(alpha, 0.02), []
    for iteration in ("proposed", "traditional", "traditional_total"):
        found = cmcf(array.initial, measured, replace(ALL_STEPS, weighting=weighting, iteration=iteration))
        errors = np.abs(found.changes[1:] - alpha).max(axis=1)
        assert errors[-1] < 1e-8 and len(errors) == 15
        large = errors[:-1] > 1e-8
        assert np.all(errors[1:][large] < 0.35 * errors[:-1][large])
        firsts.append(found.changes[1])
        assert found.builds == (1 if iteration == "proposed" else 15)
    np.testing.assert_allclose(firsts[1], firsts[0], rtol=1e-12)
    np.testing.assert_allclose(firsts[2], firsts[0], rtol=1e-12)


def test_a_model_that_is_right_is_left_alone(array):
    found = cmcf(array.initial, array.consistent(np.zeros(6), -0.05), ALL_STEPS)
    assert np.abs(found.changes[-1]).max() < 1e-8
    assert cmcf(array.initial, array.consistent(np.zeros(6), -0.05)).converged


@pytest.mark.parametrize(("offset", "most"), [(1e-3, 1e-4), (0.02, 2e-3)])
def test_a_measured_receptance_holds_modes_beyond_the_masters(array, offset, most):
    found = cmcf(array.initial, array.measured(SYMMETRIC, offset), replace(ALL_STEPS, offset=offset))
    error = np.abs(found.changes[-1] - SYMMETRIC).max()
    assert 1e-7 < error < most
    np.testing.assert_allclose(array.freq(found.changes[-1]), array.freq(SYMMETRIC), rtol=2e-4)


def test_units_and_the_order_of_masters_do_not_matter(array):
    measured = array.measured(ASYMMETRIC, 0.02)
    own = cmcf(array.initial, measured, ALL_STEPS).changes[-1]
    larger = [Change(c.name, c.kind, 1e3 * c.matrix) for c in array.changes]
    scaled = InitialModel(1e3 * array.k, 1e3 * array.m, tuple(larger), array.masters, array.reduce)
    lighter = replace(measured, receptance=measured.receptance / 1e3)
    np.testing.assert_allclose(cmcf(scaled, lighter, ALL_STEPS).changes[-1], own, atol=1e-8)
    order = np.random.default_rng(2).permutation(12)
    turned = InitialModel(
        array.k, array.m, array.changes, array.masters[order], partial(transformation, array.masters[order], LEVEL)
    )
    moved = replace(measured, receptance=measured.receptance[:, order][:, :, order])
    np.testing.assert_allclose(cmcf(turned, moved, ALL_STEPS).changes[-1], own, atol=1e-8)


def test_one_reference_is_enough_without_noise(array):
    whole = array.consistent(ASYMMETRIC, 0.02)
    one = MeasuredReceptance(whole.freq, whole.receptance[:, :, [3]], np.array([3]))
    assert np.abs(cmcf(array.initial, one, ALL_STEPS).changes[-1] - ASYMMETRIC).max() < 1e-5


# -- damping and mass --------------------------------------------------------------------------------------------------


def damped(kind):
    """A chain of five masses whose stiffness, mass or damping changes, and its receptance at its own resonances."""
    n = 5
    links = [np.zeros((n, n)) for _ in range(n)]
    for i, link in enumerate(links):
        b = np.eye(n)[i] - (np.eye(n)[i - 1] if i else 0)
        link += 1e4 * np.outer(b, b)
    masses = [np.diag(np.eye(n)[i]) for i in range(n)]
    k, m = sum(links), sum(masses)
    changes = [Change(f"k{i}", "stiffness", sp.csc_array(link)) for i, link in enumerate(links)]
    truth = [0.1, -0.1, 0.2, 0.0, 0.3]
    z = {
        "stiffness": k + sum(a * link for a, link in zip(truth, links, strict=True)),
        "mass": m,
        "loss": 0 * k,
        "c": 0 * k,
    }
    if kind == "mass":
        changes += [Change("m3", "mass", sp.csc_array(masses[3]))]
        truth += [0.25]
        z["mass"] = m + 0.25 * masses[3]
    if kind == "structural":
        changes += [Change(f"d{i}", "structural", sp.csc_array(links[i])) for i in (0, 2)]
        truth += [0.01, 0.03]
        z["loss"] = 0.01 * links[0] + 0.03 * links[2]
    if kind == "viscous":
        changes += [Change("c2", "viscous", sp.csc_array(links[2]))]
        truth += [1e-4]
        z["c"] = 1e-4 * links[2]
    omega = np.sqrt(la.eigh(z["stiffness"], z["mass"], eigvals_only=True)[:4])
    omega = omega * (1.01 if kind == "mass" else 1.0)
    dynamic = [z["stiffness"] + 1j * w * z["c"] + 1j * z["loss"] - w**2 * z["mass"] for w in omega]
    receptance = np.array([la.inv(d) for d in dynamic])
    model = InitialModel(sp.csc_array(k), sp.csc_array(m), tuple(changes), np.arange(n))
    real = receptance.real if kind == "mass" else receptance
    return model, MeasuredReceptance(omega / (2 * np.pi), real, np.arange(n)), np.array(truth)


@pytest.mark.parametrize("kind", ["mass", "structural", "viscous"])
def test_mass_and_damping_are_recovered_in_one_step_even_at_resonance(kind):
    model, measured, truth = damped(kind)
    found = cmcf(model, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth, atol=1e-9)


def test_a_damped_initial_model_is_updated_from_its_real_changes():
    """The left factors and slopes of a stiffness are real; with damping in the model the equations are not."""
    model, measured, truth = damped("structural")
    loss, stiff = truth[5:], tuple(c for c in model.changes if c.kind == "stiffness")
    losses = sum(x * c.matrix for x, c in zip(loss, (c for c in model.changes if c.kind == "structural"), strict=True))
    known = replace(model, changes=stiff, structural=sp.csc_array(losses))
    found = cmcf(known, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth[:5], atol=1e-9)
    viscous, measured, truth = damped("viscous")
    known = replace(viscous, changes=viscous.changes[:5], viscous=sp.csc_array(truth[5] * viscous.changes[5].matrix))
    found = cmcf(known, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth[:5], atol=1e-9)


def test_real_data_update_a_damped_model():
    """A is real then and the imbalance is not: its imaginary part is that of a damping that nothing may change."""
    model, _, truth = damped("structural")
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    changed = model.stiffness.toarray() + sum(a * c.matrix.toarray() for a, c in zip(truth[:5], stiff, strict=True))
    omega = 2 * np.pi * np.array([3.0, 9.0])
    receptance = np.array([la.inv(changed - w**2 * model.mass.toarray()) for w in omega])
    lossy = replace(model, changes=stiff, structural=sp.csc_array(0.02 * stiff[0].matrix))
    found = cmcf(lossy, MeasuredReceptance(omega / (2 * np.pi), receptance, np.arange(5)), CmcfSettings(orders=4))
    np.testing.assert_allclose(found.changes[-1], truth[:5], atol=1e-9)


def test_real_and_imaginary_parts_are_equations_of_their_own():
    """With damping in the model, among its changes or in the receptance, of which real data may need none."""
    model, measured, _ = damped("structural")
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    real = replace(measured, receptance=np.abs(measured.receptance))
    lossy = sp.csc_array(0.02 * stiff[0].matrix)
    rows = {}
    for name, changes, loss, data in (
        ("none", stiff, None, real), ("model", stiff, lossy, real), ("change", model.changes, None, real),
        ("data", stiff, None, measured),
    ):  # fmt: skip
        reduced = Reduced.of(replace(model, changes=changes, structural=loss), np.zeros(len(changes)))
        rows[name] = Equations.at(reduced, data, CmcfSettings(orders=4)).inverse.shape[1]
    assert rows == {"none": 400, "model": 800, "change": 800, "data": 800}


def test_the_loss_of_a_model_is_removed_by_undamped_data():
    model, _, _ = damped("structural")
    omega = 2 * np.pi * np.array([3.0, 9.0])
    receptance = np.array([la.inv(model.stiffness.toarray() - w**2 * model.mass.toarray()) for w in omega])
    lossy = replace(model, structural=sp.csc_array(0.02 * model.changes[5].matrix))
    found = cmcf(lossy, MeasuredReceptance(omega / (2 * np.pi), receptance, np.arange(5)), CmcfSettings(orders=4))
    np.testing.assert_allclose(found.changes[-1], [0, 0, 0, 0, 0, -0.02, 0], atol=1e-9)


def test_damping_of_the_array_is_recovered_in_one_step_at_its_resonances(array):
    """All degrees of freedom, loss factors of 1 to 3 %, real unknowns from complex equations, 12 references."""
    loss = np.array([0.01, 0.02, 0.03, 0.01, 0.02, 0.03])
    lossy = [c.matrix * (1 + a) * e for c, a, e in zip(array.changes, ASYMMETRIC, loss, strict=True)]
    k, m = array.stiffness(ASYMMETRIC) + 1j * sum(lossy), array.m.toarray()
    freq = array.freq(ASYMMETRIC)
    receptance = np.array([la.inv(k.toarray() - (2 * np.pi * f) ** 2 * m)[:, array.masters] for f in freq])
    changes = (*array.changes, *(Change(f"loss of {c.name}", "structural", c.matrix) for c in array.changes))
    measured = MeasuredReceptance(freq, receptance, array.masters)
    found = cmcf(replace(array.whole, changes=changes), measured, CmcfSettings(steps=1)).changes[1]
    np.testing.assert_allclose(found[:6], ASYMMETRIC, atol=1e-9)
    np.testing.assert_allclose(found[6:] / (1 + found[:6]), loss, atol=1e-9)


# -- noise -------------------------------------------------------------------------------------------------------------


def iterated(array, seed, iteration):
    """Largest frequency error of six orders in %, its means, and steps until all errors stay within 0.1 %."""
    found = cmcf(array.initial, array.noisy(SYMMETRIC, seed), replace(ALL_STEPS, iteration=iteration))
    errors = np.array([100 * (array.freq(c, 6) / array.freq(SYMMETRIC, 6) - 1) for c in found.changes[1:]])
    settled = np.all(np.abs(errors - errors[-1]) < 0.1, axis=1)
    return np.abs(errors[-1]), 1 + max((k + 1 for k, near in enumerate(settled) if not near), default=0)


@pytest.mark.parametrize("seeds", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_noise_of_receptance_and_frequencies(array, seeds):
    """5 % noise of the receptance and 3 % of the frequencies; this geometry, offset and weighting."""
    errors, steps = zip(*(iterated(array, seed, "proposed") for seed in range(seeds)), strict=True)
    worst = np.max(errors, axis=1)
    assert worst.max() <= 4.5 and np.median(worst) <= 3.0 and np.median(steps) <= 3
    before = np.abs(100 * (array.freq(np.zeros(6), 6) / array.freq(SYMMETRIC, 6) - 1))
    assert np.all(np.mean(errors, axis=0) <= before / 4)


def test_white_weights_give_equal_noise_to_the_equations_of_all_lines(array):
    """Multiplicative noise of the receptance of a model that is right: the imbalance is noise alone."""
    reduced, true = Reduced.of(array.initial, np.zeros(6)), array.consistent(np.zeros(6), 0.02)
    spread = {}
    for weighting in ("white", "block", "none"):
        equations = Equations.at(reduced, true, CmcfSettings(weighting=weighting))
        squares = 0.0
        for seed in range(20):
            noise = 1 + 0.01 * np.random.default_rng(seed).uniform(-1, 1, true.receptance.shape)
            imbalance = reduced.imbalance(replace(true, receptance=true.receptance * noise))
            rows = np.einsum("ipm,jmq,ij->ijpq", equations.left, imbalance, equations.weight)
            squares = squares + np.sum(rows**2, axis=(2, 3))
        spread[weighting] = np.sqrt(squares.max() / squares.min())
    assert spread["white"] < 2 and spread["block"] > 5 and spread["none"] > 100


def test_noise_shrinks_the_changes_unless_the_weights_are_white(array):
    """The receptance stands on both sides; block weights let its noise attenuate the changes."""
    true = array.freq(SYMMETRIC, 6)
    signed = {}
    for weighting in ("white", "block"):
        settings = replace(ALL_STEPS, weighting=weighting, steps=5)
        errors = [
            array.freq(cmcf(array.initial, array.noisy(SYMMETRIC, seed), settings).changes[-1], 6) / true - 1
            for seed in range(8)
        ]
        signed[weighting] = 100 * np.mean(errors, axis=0)
    assert np.all(np.abs(signed["white"]) < 2.0) and np.all(signed["block"] < -3.0)


@pytest.mark.slow
def test_the_traditional_iteration_settles_later_under_noise(array):
    """True of this configuration alone: without noise the order depends on the weighting."""
    steps = {
        iteration: np.median([iterated(array, seed, iteration)[1] for seed in range(20)])
        for iteration in ("proposed", "traditional")
    }
    assert steps["traditional"] >= 2 * steps["proposed"]


# -- refused -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 1e-8, -1e-6, "next"])
def test_a_receptance_at_a_resonance_of_the_model_is_refused(array, offset):
    own = Reduced.of(array.initial, np.zeros(6)).freq(8)
    given = own[4] / own[3] - 1 if offset == "next" else offset  # the offset leads from one resonance to the next
    with pytest.raises(EvaluationError, match="offset"):
        cmcf(array.initial, array.measured(SYMMETRIC, 0.02), CmcfSettings(offset=given))


def test_a_receptance_beside_a_resonance_is_not_refused(array):
    found = cmcf(array.initial, array.measured(SYMMETRIC, 1e-3), CmcfSettings(offset=1e-3))
    assert np.all(np.isfinite(found.changes)) and found.converged


def test_too_few_or_dependent_equations_are_refused(array):
    whole = array.measured(SYMMETRIC, 0.02)
    model, measured, _ = damped("mass")
    few = MeasuredReceptance(measured.freq[:1], measured.receptance[:1, :, :1], np.array([0]))
    with pytest.raises(InputError, match="5 independent equations do not determine 6"):
        cmcf(model, few)
    twice = replace(array.initial, changes=(*array.changes, replace(array.changes[0], name="again")))
    with pytest.raises(InputError, match="determine 6 of 7"):
        cmcf(twice, whole)
    nothing = replace(array.initial, changes=(*array.changes, Change("none", "stiffness", 0 * array.k)))
    with pytest.raises(InputError, match="1 of the changes"):
        cmcf(nothing, whole)


def test_a_factor_that_would_not_stay_positive_is_refused():
    model, _, _ = damped("structural")
    softer = -la.inv(model.stiffness.toarray())[None]
    measured = MeasuredReceptance(np.array([1e-6]), softer, np.arange(5))
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    with pytest.raises(EvaluationError, match=r"the factor of k\d becomes -1"):
        cmcf(replace(model, changes=stiff), measured, CmcfSettings(orders=4))


@pytest.mark.parametrize("fault", ["nan", "shape"])
def test_a_receptance_that_is_none_is_refused(array, fault):
    good = array.measured(SYMMETRIC, 0.02)
    bad = good.receptance.copy()
    bad[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="lines, masters, references"):
        MeasuredReceptance(good.freq, bad if fault == "nan" else good.receptance[:2], good.references)


def test_places_without_a_reduction_and_nothing_to_change_are_refused(array):
    with pytest.raises(InputError, match="reduction"):
        InitialModel(array.k, array.m, array.changes, array.masters)
    with pytest.raises(InputError, match="parameter"):
        InitialModel(array.k, array.m, (), array.masters, array.reduce)
