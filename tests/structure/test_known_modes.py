"""Derivatives of many modes by one factor and all known modes, against sums over the whole spectrum and differences."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.structure.eigenproblem import derivatives
from calib.structure.eigenproblem.derivatives import eigen_derivatives, eigenvalues
from calib.structure.eigenproblem.known_modes import bands, iterated, steps_of
from calib.structure.eigenproblem.solve import solve_modes

SIDE, SOLVED, WANTED = 13, 24, 12
N = SIDE**2
NOTHING = sp.csc_array((N, N))


def line(ends: float) -> sp.csc_array:
    """Masses in a row on springs of 1 N/m; ``ends`` hold the first and the last one."""
    main = np.full(SIDE, 2.0)
    main[[0, -1]] = 1.0 + ends
    return sp.csc_array(sp.diags_array([-np.ones(SIDE - 1), main, -np.ones(SIDE - 1)], offsets=[-1, 0, 1]))


def membrane(stretch: float, ends: float = 1.0):
    """Stiffness and mass of a membrane; almost or quite square, its modes come in pairs."""
    one = sp.eye_array(SIDE)
    k = sp.csc_array(sp.kron(line(ends), one) + (1 + stretch) * sp.kron(one, line(ends)))
    return k, sp.csc_array(sp.diags_array(1.0 + 0.3 * np.random.default_rng(2).random(N) * (stretch > 0.1)))


def changes():
    """A stiffer corner, heavier nodes, and both."""
    corner = np.zeros(N)
    corner[:20] = 1.0
    heavy = np.zeros(N)
    heavy[30:60:3] = 0.5
    k, m = sp.csc_array(sp.diags_array(corner)), sp.csc_array(sp.diags_array(heavy))
    return [(k, NOTHING, NOTHING), (NOTHING, NOTHING, m), (0.3 * k, NOTHING, -0.2 * m)]


def by_all_modes(k, m, slopes, modes, which):
    """Shapes' derivatives as sums over the whole spectrum, exact but for rounding: (n_params, n_dof, n_which)."""
    squares, shapes = la.eigh(k.toarray(), m.toarray())
    out = []
    for dk, _, dm in slopes:
        columns = []
        for i in which:
            square, phi = (2 * np.pi * modes.natural_freq[i]) ** 2, modes.shapes[:, i]
            part = shapes.T @ (dk @ phi - square * (dm @ phi))
            apart = square - squares
            own = np.abs(apart) < 1e-9 * square
            columns.append(shapes[:, ~own] @ (part[~own] / apart[~own]) - 0.5 * phi * (phi @ (dm @ phi)))
        out.append(np.column_stack(columns))
    return np.array(out)


@pytest.fixture
def together(monkeypatch):
    """Modes that were solved together; a mode by a factor with a border is an error."""
    solved = []
    for kind in (derivatives.Undamped, derivatives.Damped):
        own = kind.together

        def noted(self, shift, systems, own=own):
            solved.extend(one.mode for one in systems)
            return own(self, shift, systems)

        def refused(self, system):
            raise AssertionError("a factor with a border")

        monkeypatch.setattr(kind, "together", noted)
        monkeypatch.setattr(kind, "alone", refused)
    return solved


@pytest.mark.parametrize("stretch", [0.3, 1e-3, 1e-5])
@pytest.mark.parametrize("ends", [1.0, 0.0])  # held, and free to move as a whole
def test_close_modes_and_rigid_motions_are_those_of_the_whole_spectrum(together, stretch, ends):
    k, m = membrane(stretch, ends)
    modes = solve_modes(k, None, m, SOLVED)
    assert len(modes.excluded) == (ends == 0)
    found = eigen_derivatives(k, NOTHING, m, changes(), modes, ("a", "b", "c"), range(WANTED))
    assert sorted(together) == list(range(WANTED)) and found.regular.all()
    expected = by_all_modes(k, m, changes(), modes, range(WANTED))
    size = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found.shapes / size, expected / size, atol=2e-5)


def test_a_few_of_the_modes_need_no_factor_with_a_border(together):
    """Also with a single parameter, and whatever the order in which they are asked for."""
    k, m = membrane(0.3)
    modes = solve_modes(k, None, m, SOLVED)
    found = eigen_derivatives(k, NOTHING, m, changes()[:1], modes, ("a",), [7, 2, 2], np.eye(N)[:4])
    expected = by_all_modes(k, m, changes()[:1], modes, [7, 2, 2])[:, :4]
    np.testing.assert_allclose(found.shapes, expected, atol=1e-5 * np.abs(expected).max())


def test_modes_at_the_end_of_those_solved_take_a_factor_with_a_border():
    k, m = membrane(0.3)
    modes = solve_modes(k, None, m, SOLVED)
    found = eigen_derivatives(k, NOTHING, m, changes(), modes, ("a", "b", "c"))
    expected = by_all_modes(k, m, changes(), modes, range(SOLVED))
    size = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found.shapes / size, expected / size, atol=2e-5)


def dissipation(strength: float) -> sp.csc_array:
    """Two strong dampers to the ground and a little damping everywhere."""
    own = np.full(N, 0.02)
    own[[40, 100]] = 1.0
    return sp.csc_array(strength * sp.diags_array(own))


@pytest.mark.medium
@pytest.mark.parametrize("strength", [0.1, 1.0])
def test_damped_modes_are_those_of_differences(together, strength):
    k, m = membrane(0.3)
    c = dissipation(strength)
    slopes = [*changes(), (NOTHING, c, NOTHING)]
    modes = solve_modes(k, c, m, SOLVED)
    found = eigen_derivatives(k, c, m, slopes, modes, ("a", "b", "c", "d"), range(WANTED))
    assert sorted(together) == list(range(WANTED)) and found.regular.all()
    half = 2e-4
    for q, (dk, dc, dm) in enumerate(slopes):
        ends = {
            s: solve_modes(*(sp.csc_array(a + s * half * b) for a, b in ((k, dk), (c, dc), (m, dm))), SOLVED)
            for s in (2, 1, -1, -2)
        }
        shapes = {}
        for s, end in ends.items():
            turn = np.sign(np.einsum("ij,ij->j", modes.shapes.conj(), end.shapes).real)
            shapes[s] = (end.shapes * turn)[:, :WANTED]
        expected = (8 * (shapes[1] - shapes[-1]) - (shapes[2] - shapes[-2])) / (12 * half)
        size = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(found.shapes[q] / size, expected / size, atol=5e-5)
        lam = {s: eigenvalues(end)[:WANTED] for s, end in ends.items()}
        slope = (8 * (lam[1] - lam[-1]) - (lam[2] - lam[-2])) / (12 * half)
        np.testing.assert_allclose(found.eigenvalue[q], slope, atol=1e-6 * np.abs(slope).max())


def test_a_damper_on_an_undamped_model_gives_imaginary_parts(together):
    k, m = membrane(0.3)
    c = dissipation(1.0)
    modes = solve_modes(k, None, m, SOLVED)
    found = eigen_derivatives(k, NOTHING, m, [(NOTHING, c, NOTHING)], modes, ("c",), range(WANTED))
    squares, shapes = la.eigh(k.toarray(), m.toarray())
    for i in range(WANTED):
        omega, phi = 2 * np.pi * modes.natural_freq[i], modes.shapes[:, i]
        part, apart = shapes.T @ (c @ phi), omega**2 - squares
        own = np.abs(apart) < 1e-9 * omega**2
        expected = omega * (shapes[:, ~own] @ (part[~own] / apart[~own]))
        np.testing.assert_allclose(found.shapes[0, :, i].imag, expected, atol=2e-5 * np.abs(expected).max())
        np.testing.assert_allclose(found.shapes[0, :, i].real, 0.0, atol=2e-5 * np.abs(expected).max())


def test_pairs_of_equal_frequency_that_a_change_keeps_stay_regular(together):
    """A square membrane: its whole stiffness or mass does not split the pairs, a corner does."""
    k, m = membrane(0.0)
    modes = solve_modes(k, None, m, SOLVED)
    found = eigen_derivatives(
        k, NOTHING, m, [(k, NOTHING, NOTHING), (NOTHING, NOTHING, m)], modes, ("k", "m"), range(WANTED)
    )
    assert found.regular.all()
    np.testing.assert_allclose(found.shapes[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(found.shapes[1], -0.5 * modes.shapes[:, :WANTED], atol=1e-6)
    corner = eigen_derivatives(k, NOTHING, m, changes()[:1], modes, ("a",), range(WANTED))
    assert not corner.regular.all() and corner.regular[0]


def test_iterations_end_where_the_ratio_says():
    """A spectrum between 1 and 1.5: no column takes more steps than the bound, and the solution is exact."""
    rng = np.random.default_rng(0)
    turn = la.qr(rng.standard_normal((60, 60)))[0]
    spectrum = rng.uniform(1.0, 1.5, 60)
    matrix, right = (turn * spectrum) @ turn.T, rng.standard_normal((60, 3))
    most = int(np.ceil(steps_of(np.array([1.5]))[0]))
    taken = []

    def operate(block, at):
        taken.append(len(at))
        return matrix @ block

    size = np.linalg.norm(right, axis=0)
    found, good = iterated(operate, lambda block, at: block, right, size)
    assert good.all() and len(taken) <= most + 4
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-4, atol=1e-5)
    assert not iterated(operate, lambda block, at: block, right, size, 1)[1].any()


def test_bands_hold_every_mode_once_and_leave_out_the_last():
    known = np.arange(1.0, 41.0) ** 2
    for columns in (1, 10, 300):
        found = bands(known, range(40), columns, regular=True)
        held = [j for _, some in found for j in some]
        assert len(held) == len(set(held)) and 39 not in held and set(range(9)) <= set(held)
    assert len(bands(known, range(20), 300, regular=True)) > len(bands(known, range(20), 1, regular=True))
    assert 0.0 not in [shift for shift, _ in bands(known, range(20), 3, regular=False)]
    assert bands(known, range(20), 3, regular=False, shifted=False) == []
