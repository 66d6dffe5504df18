"""Frequency response functions: closed forms, superposition of modes, reciprocity, derivatives, and resonances."""

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError
from calib.problem.space import Parameter
from calib.structure import frf as frf_module
from calib.structure.frf import frf, frf_derivatives, motion_factor
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import train_basis
from models.railway import bogie_on_rig
from models.solar_panel import solar_panel


def chain(n=4, damping=True):
    """Masses in a row, the first on the ground; stiffness, damping and a mass are parameters."""
    links = np.zeros((n, n, n))
    for i in range(n):
        b = np.eye(n)[i] - (np.eye(n)[i - 1] if i else 0)
        links[i] = np.outer(b, b)
    last = np.diag(np.eye(n)[-1])
    space = [
        Parameter("k", 1e4, 1e3, 1e5, "N/m"),
        Parameter("c", 8.0, 1.0, 50.0, "Ns/m"),
        Parameter("m", 2.0, 1.0, 5.0, "kg"),
    ]
    return StructuralModel.from_matrices(
        {"k": links[0], "rest": 2e4 * links[1:].sum(axis=0)},
        {"m": last, "own": np.eye(n)},
        {"c": links[1], "rest": 3.0 * links[2:].sum(axis=0)} if damping else None,
        dofs=pd.DataFrame({"node": range(1, n + 1), "direction": "x"}),
        parameters=space if damping else [p for p in space if p.name != "c"],
    )


FREQ = np.array([0.0, 3.0, 9.7, 22.0, 40.0])


def test_one_mass_is_the_closed_form():
    model = StructuralModel.from_matrices(
        [[3e3]], [[2.0]], [[5.0]], dofs=pd.DataFrame({"node": [1], "direction": ["z"]})
    )
    omega = 2 * np.pi * FREQ
    closed = 1 / (3e3 + 5j * omega - 2 * omega**2)
    for quantity, order in (("receptance", 0), ("mobility", 1), ("accelerance", 2)):
        found = frf(model, {}, FREQ, np.eye(1), np.eye(1), quantity)[:, 0, 0]
        np.testing.assert_allclose(found, closed * (1j * omega) ** order, rtol=1e-13)
    far = frf(model, {}, np.array([1e5]), np.eye(1), np.eye(1), "accelerance")
    np.testing.assert_allclose(far, 1 / 2.0, rtol=1e-5)  # the mass line
    np.testing.assert_array_equal(motion_factor("mobility", [0.0]), [0.0])


def test_it_is_the_sum_over_all_modes_in_state_space():
    model = chain()
    k, c, m = (matrix.toarray() for matrix in model.matrices({}))
    n = len(k)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-la.solve(m, k), -la.solve(m, c)]])
    values, right = la.eig(a)
    left = la.inv(right)
    force = np.vstack([np.zeros((n, n)), la.inv(m)])
    omega = 2 * np.pi * FREQ
    summed = [right[:n] @ np.diag(1 / (1j * w - values)) @ left @ force for w in omega]
    np.testing.assert_allclose(frf(model, {}, FREQ, np.eye(n), np.eye(n)), summed, rtol=1e-10, atol=1e-16)


def test_responses_and_references_may_be_exchanged_and_combined():
    model, rng = chain(), np.random.default_rng(1)
    responses, references = rng.standard_normal((3, 4)), rng.standard_normal((2, 4))
    found = frf(model, {}, FREQ, responses, references)
    assert found.shape == (5, 3, 2)
    np.testing.assert_allclose(frf(model, {}, FREQ, references, responses), found.transpose(0, 2, 1), rtol=1e-11)
    whole = frf(model, {}, FREQ, np.eye(4), np.eye(4))
    np.testing.assert_allclose(found, responses @ whole @ references.T, rtol=1e-11)


@pytest.mark.parametrize("quantity", ["receptance", "accelerance"])
def test_derivatives_are_those_of_differences(quantity):
    model, names = chain(), ("k", "c", "m")
    responses, references = np.eye(4)[:3], np.eye(4)[[3]]
    values = {"k": 1.2e4, "c": 6.0, "m": 2.5}
    functions, slopes, *_ = frf_derivatives(model, values, FREQ, responses, references, names, quantity)
    np.testing.assert_array_equal(functions, frf(model, values, FREQ, responses, references, quantity))
    for name, slope in zip(names, slopes, strict=True):
        step = 1e-5 * values[name]
        ends = [
            frf(model, {**values, name: values[name] + s * step}, FREQ, responses, references, quantity)
            for s in (1, -1)
        ]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-9 * np.abs(slope).max())


def test_a_resonance_without_damping_is_told_and_its_neighbourhood_is_not():
    model = chain(damping=False)
    resonance = model.modes({}, 2).natural_freq[1]
    with pytest.raises(EvaluationError, match="without damping"):
        frf(model, {}, np.array([resonance]), np.eye(4), np.eye(4))
    near = frf(model, {}, resonance * np.array([1 - 1e-6, 1 + 1e-6]), np.eye(4), np.eye(4))
    assert np.all(np.isfinite(near)) and np.all(near[0, 0, 0] * near[1, 0, 0] < 0)  # the sign changes across it


def test_a_free_structure_has_no_static_receptance():
    model = StructuralModel.from_matrices(
        [[1e3, -1e3], [-1e3, 1e3]], np.eye(2), dofs=pd.DataFrame({"node": [1, 2], "direction": "x"})
    )
    with pytest.raises(EvaluationError, match="0 Hz"):
        frf(model, {}, np.array([0.0]), np.eye(2), np.eye(2))
    assert frf(model, {}, np.array([0.1]), np.eye(2), np.eye(2))[0, 0, 0].real < 0  # it moves against the force


def test_sparse_and_dense_matrices_agree_on_the_array():
    model = solar_panel()
    k, _, m = model.matrices({})
    here = np.flatnonzero(model.dofs.direction == 2)[[0, 20, 29]]
    rows = np.eye(90)[here]
    freq = np.array([0.1, 2.0, 11.0, 55.0])
    dense = [la.inv(k.toarray() - (2 * np.pi * f) ** 2 * m.toarray())[np.ix_(here, here)] for f in freq]
    np.testing.assert_allclose(frf(model, {}, freq, rows, rows), dense, rtol=1e-6)


def test_pivots_are_chosen_anew_where_those_near_the_diagonal_are_too_small(monkeypatch):
    """A factor that never leaves the diagonal loses all digits where it nearly vanishes."""
    n = 300
    stiffness = sp.csc_array(sp.diags_array([np.full(n - 1, 0.5), np.ones(n), np.full(n - 1, 0.5)], offsets=[-1, 0, 1]))
    off, mass = sp.csc_array((n, n)), sp.eye_array(n, format="csc")
    freq = (1 + 1e-11) / (2 * np.pi)  # nearly no diagonal is left
    rows = np.eye(n)[:3]
    monkeypatch.setattr(frf_module, "_THRESHOLD", 0.0)
    ((found,),) = frf_module.frf_solutions((stiffness, off, mass), [freq], rows)
    dynamic = (stiffness - (2 * np.pi * freq) ** 2 * mass).toarray()
    np.testing.assert_allclose(found, np.linalg.solve(dynamic, rows.T), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_on_a_reduced_basis_the_bogie_has_nearly_the_same_functions():
    model = bogie_on_rig()
    space = model.space.keep(["K_primary", "m_crossbar"])
    reduced = ReducedModel(model, train_basis(model, space, 12, seed=1))
    rows = np.zeros((2, model.n_dof))
    rows[[0, 1], np.flatnonzero(model.dofs.direction == 1)[[10, 60]]] = 1.0
    freq = np.linspace(2.0, 40.0, 25)
    small = rows @ reduced.basis.vectors
    values = {"K_primary": 600.0}
    exact = frf_derivatives(model, values, freq, rows, rows, ("K_primary",))
    near = frf_derivatives(reduced, values, freq, small, small, ("K_primary",))
    for full, own in zip(exact[:2], near[:2], strict=True):
        assert np.abs(own - full).max() < 0.02 * np.abs(full).max()


@pytest.mark.medium
def test_functions_of_further_motions_and_forces_follow_from_the_same_solutions():
    model = bogie_on_rig(element_size=0.3)
    rng, freq = np.random.default_rng(8), np.linspace(7.0, 31.0, 5)
    responses, references, motions, forces = (rng.standard_normal((n, model.n_dof)) for n in (3, 2, 4, 1))
    found = frf_derivatives(model, {}, freq, responses, references, (), "accelerance", (motions, forces))
    for own, rows in ((found.felt, (motions, references)), (found.driven, (responses, forces))):
        exact = frf(model, {}, freq, *rows, "accelerance")
        np.testing.assert_allclose(own, exact, rtol=1e-8, atol=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_few_dampers_are_superposed_on_undamped_modes(rank):
    rng, n = np.random.default_rng(rank), 24
    root = rng.standard_normal((n, n))
    k, b = 1e4 * (root @ root.T + np.eye(n)), rng.standard_normal((n, rank))
    m, c = np.eye(n) + 0.1 * np.eye(n, k=1) + 0.1 * np.eye(n, k=-1), 40 * b @ b.T
    at_mode = np.sqrt(la.eigh(k, m, eigvals_only=True)[3]) / (2 * np.pi)
    rows, freq = rng.standard_normal((3, n)), np.array([0.0, 5.0, 40.0, at_mode * (1 + 1e-4), at_mode * (1 + 1e-8)])
    calls = []
    with pytest.MonkeyPatch.context() as patch:
        direct = frf_module._factored
        patch.setattr(frf_module, "_factored", lambda scaled, at, loads: calls.extend(at) or direct(scaled, at, loads))
        found = [x for (x,) in frf_module.frf_solutions((k, c, m), freq, rows)]
    for line, x in zip(freq, found, strict=True):
        omega = 2 * np.pi * line
        load = (k + 1j * omega * c - omega**2 * m) @ x
        np.testing.assert_allclose(load, rows.T, atol=1e-9 * np.abs(k).max() * np.abs(x).max())
    assert calls == [freq[-1]]  # at an undamped resonance the superposition would cancel
    assert len(freq) == len(found)


def test_lines_that_do_not_fit_into_one_block_are_solved_as_those_that_do(monkeypatch):
    rng, n = np.random.default_rng(2), 6
    root, rows, freq = rng.standard_normal((n, n)), rng.standard_normal((2, n)), np.linspace(1.0, 30.0, 11)
    k = 1e4 * (root @ root.T + np.eye(n))
    found = []
    for lines in (11, 4, 0.5):
        monkeypatch.setattr(frf_module, "_BLOCK", int(lines * n * n))
        found.append([x for (x,) in frf_module.frf_solutions((k, 1e-3 * k, np.eye(n)), freq, rows)])
    assert len(found[0]) == 11
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    stiff = np.linalg.eigvalsh(k)[[1, 3]] ** 0.5 / (2 * np.pi)  # two lines on resonances without damping
    with pytest.raises(EvaluationError, match=f"{stiff[0]:.6g} Hz"):
        list(frf_module.frf_solutions((k, 1e-30 * k, np.eye(n)), np.array([1.0, *stiff]), rows))


def test_material_damping_and_free_structures_are_solved_line_by_line():
    k, m = np.diag([1e3, 2e3, 3e3, 4e3]), np.eye(4)
    free = np.array([[1.0, -1, 0, 0], [-1, 2, -1, 0], [0, -1, 2, -1], [0, 0, -1, 1]]) * 1e3
    for stiffness, damping in ((k, 0.01 * k), (free, np.zeros((4, 4)))):
        (found,) = [x for (x,) in frf_module.frf_solutions((stiffness, damping, m), np.array([3.0]), np.eye(4))]
        omega = 6 * np.pi
        np.testing.assert_allclose(
            found, la.inv(stiffness + 1j * omega * damping - omega**2 * m), rtol=1e-10, atol=1e-14
        )
