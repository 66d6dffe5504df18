"""Cross-model cross-FRF equations: iterates and terms against their literal form in Li and Hong (2012)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as la

from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Equations, MeasuredReceptance, Reduced
from calib.study.loading import module_of

CASES = module_of(Path(__file__).parents[1] / "template/updated.py")


@pytest.fixture(scope="module")
def array():
    return CASES.Array()


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


@pytest.mark.slow
def test_the_iterates_are_those_of_the_articles_equations(array):
    measured = array.consistent(CASES.SYMMETRIC, 0.02)
    own = cmcf(array.initial, measured, replace(CASES.ALL_STEPS, steps=5)).changes[1:]
    written, _ = literal(array, measured, CASES.ALL_STEPS, len(own))
    np.testing.assert_allclose(own, written, atol=1e-9)


@pytest.mark.parametrize("iteration", ["traditional", "traditional_total"])
def test_the_traditional_iterates_are_those_of_equation_32(array, iteration):
    """Its two readings: the next base is the updated model, or the initial one with the updated transformation."""
    measured, m = array.consistent(CASES.ASYMMETRIC, 0.02), array.m
    own = cmcf(array.initial, measured, replace(CASES.ALL_STEPS, steps=4, iteration=iteration)).changes[1:]
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


@pytest.mark.slow
def test_the_true_changes_are_a_fixed_point_and_wrong_signs_are_not(array):
    measured = array.consistent(CASES.SYMMETRIC, 0.02)
    _, once = literal(array, measured, CASES.ALL_STEPS, 1)
    assert np.abs(once(CASES.SYMMETRIC) - CASES.SYMMETRIC).max() < 1e-9
    for mutant in ("sign", "first", "second", "third", "squares", "ends", "dropped"):
        _, wrong = literal(array, measured, CASES.ALL_STEPS, 1, mutant)
        assert np.abs(wrong(CASES.SYMMETRIC) - CASES.SYMMETRIC).max() > 5e-3, mutant


def test_the_left_factors_add_weights_and_no_equations(array):
    reduced = Reduced.of(array.initial, np.zeros(6))
    equations = Equations.at(reduced, array.consistent(CASES.SYMMETRIC, 0.02), CASES.ALL_STEPS)
    stacked = np.vstack([np.kron(w, np.eye(12)) for w in equations.left])
    assert stacked.shape == (1152, 144) and np.linalg.matrix_rank(stacked) == 144


def test_with_few_references_the_independent_equations_are_fewer(array):
    """Of 8 left factors, 4 lines and 12 masters: 12 x 2 x 4 equations with two references, not 8 times as many."""
    reduced = Reduced.of(array.initial, np.zeros(6))
    some = array.consistent(CASES.SYMMETRIC, 0.02)
    two = MeasuredReceptance(some.freq, some.receptance[:, :, [0, 7]], np.array([0, 7]))
    equations = Equations.at(reduced, two, CASES.ALL_STEPS)
    stacked = np.vstack([np.kron(np.kron(w, np.eye(2)), np.eye(4)) for w in equations.left])
    assert equations.inverse.shape == (6, 8 * 4 * 12 * 2) and np.linalg.matrix_rank(stacked) == 4 * 12 * 2


def test_every_iterate_is_a_step_of_newtons_method_with_a_frozen_jacobian(array):
    """f + G_k - A alpha_k is the weighted imbalance of the updated model; G_k has three terms, or two products."""
    measured, alpha = array.consistent(CASES.SYMMETRIC, 0.02), np.array([0.1, 0.3, 0.2, 0.25, 0.4, 0.6])
    reduced, start = (Reduced.of(array.initial, a) for a in (alpha, np.zeros(6)))
    equations = Equations.at(start, measured, CASES.ALL_STEPS)
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
