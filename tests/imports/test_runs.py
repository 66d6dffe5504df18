"""Terms of matrices from runs: exact where the powers are right, with no more runs than parameters act together."""

import itertools

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

import calib
from calib.errors.errors import InputError
from calib.imports.matrices import ReadMatrices
from calib.imports.runs import terms_of_runs, wide_factors

N = 5
PARAMETERS = [
    calib.Parameter("E", 70.0, 50.0, 90.0, "GPa"),
    calib.Parameter("t", 4.0, 3.0, 5.0, "mm"),
    calib.Parameter("rho", 2700.0, 2500.0, 2900.0, "kg/m3"),
    calib.Parameter("k", 3.0, 1.0, 5.0, "N/mm"),
]
POWERS = {"E": [1], "t": [-1, 1, 2, 3], "rho": [1], "k": [1]}


def basis(count, seed=3):
    """Symmetric matrices; each has entries of its own."""
    rng = np.random.default_rng(seed)
    return [(m + m.T) for m in rng.standard_normal((count, N, N))]


ONES = basis(8)


class Code:
    """Writes matrices of a plate on springs, of which half is of another thickness, and counts its runs."""

    def __init__(self, more=0.0, rows=lambda v: range(1, N + 1)):
        self.calls, self.more, self.rows = [], more, rows

    def __call__(self, v):
        self.calls.append(dict(v))
        membrane, bending, edge, constant, soil, mass, rotary, point = ONES
        t, e = v["t"], v["E"]
        k = e * (t * membrane + t**3 * bending + edge / t) + constant + v["k"] * soil
        k = k + self.more * v["k"] * t * edge
        m = v["rho"] * (t * mass + t**3 * rotary) + point
        dofs = pd.DataFrame({"node": list(self.rows(v)), "direction": "z"})
        matrices = {"stiffness": {"K": sp.coo_array(k)}, "mass": {"M": sp.coo_array(m)}, "damping": {}}
        return ReadMatrices(matrices, dofs)


def summed(terms, kind, values):
    """A matrix of the terms at some values."""
    nominal = {p.name: p.value for p in PARAMETERS}
    parts = [
        np.prod([(values[n] / nominal[n]) ** a for n, a in powers]) * matrix.toarray()
        for powers, matrix in terms.matrices[kind].items()
    ]
    return sum(parts)


@pytest.mark.parametrize("more", [0.0, 0.4])
def test_matrices_at_fresh_values_are_those_of_the_code(more):
    code = Code(more)
    terms = terms_of_runs(code, PARAMETERS, POWERS)
    for values in ({"E": 61.0, "t": 3.3, "rho": 2550.0, "k": 4.4}, {"E": 88.0, "t": 4.9, "rho": 2900.0, "k": 1.2}):
        read = code(values)
        for kind, name in (("stiffness", "K"), ("mass", "M")):
            wanted = read.matrices[kind][name].toarray()
            np.testing.assert_allclose(summed(terms, kind, values), wanted, atol=1e-11 * abs(wanted).max())


def test_terms_and_runs_are_as_few_as_the_parameters_need():
    code = Code()
    terms = terms_of_runs(code, PARAMETERS, POWERS)
    alone = 1 + 1 + 4 + 1 + 1
    tried = len(list(itertools.combinations(PARAMETERS, 2)))
    assert len(code.calls) == terms.runs == alone + tried + 2 * 3  # E and t, t and rho: 4 runs each, one of them tried
    assert set(terms.together) == {frozenset({"E", "t"}), frozenset({"t", "rho"})}
    known = {frozenset(powers) for powers in terms.matrices["stiffness"]}
    assert {frozenset({("E", 1), ("t", 3)}), frozenset({("E", 1), ("t", -1)}), frozenset({("k", 1)})} <= known
    assert not any(("rho", 1) in powers for powers in terms.matrices["stiffness"])


@pytest.mark.parametrize("digits", [6, 9, 13])
def test_rounding_of_the_file_makes_no_parameters_act_together(digits):
    """Of matrices with large entries beside those in which parameters do act together."""
    code = Code()

    def written(values):
        read = code(values)
        for own in read.matrices.values():
            for one in own.values():
                one.data *= np.where(np.minimum(one.row, one.col) == 0, 1e9, 1.0)
                one.data[:] = [float(f"{v:.{digits}e}") for v in one.data]
        return read

    assert set(terms_of_runs(written, PARAMETERS, POWERS).together) == {frozenset({"E", "t"}), frozenset({"t", "rho"})}


def test_parameters_that_are_held_keep_their_nominal_values():
    code = Code(0.4)
    terms = terms_of_runs(code, PARAMETERS, POWERS).without(["t"])
    assert not any(name == "t" for own in terms.matrices.values() for powers in own for name, _ in powers)
    values = {"E": 61.0, "t": 4.0, "rho": 2550.0, "k": 4.4}
    wanted = code(values).matrices["stiffness"]["K"].toarray()
    np.testing.assert_allclose(summed(terms, "stiffness", values), wanted, atol=1e-11 * abs(wanted).max())


def test_runs_are_wide_and_distinct():
    for count in (1, 2, 3, 4, 5):
        factors = wide_factors(count)
        assert len(set(factors)) == count and 1.0 not in factors and max(factors) == factors[-1] == pytest.approx(2.0)
        assert count == 1 or min(factors) == pytest.approx(0.5)


def test_a_parameter_that_renumbers_the_rows_is_refused():
    code = Code(rows=lambda v: range(N, 0, -1) if v["t"] > 7 else range(1, N + 1))
    with pytest.raises(InputError, match="t x 2"):
        terms_of_runs(code, PARAMETERS, POWERS)


@pytest.mark.parametrize(
    "parameter, words",
    [(calib.Parameter("n", 2, 1, 4, integer=True), "integer"), (calib.Parameter("gap", 0.0, 0.0, 4.0), "nominal")],
)
def test_parameters_without_wide_values_are_refused(parameter, words):
    with pytest.raises(InputError, match=words):
        terms_of_runs(Code(), [parameter], {parameter.name: [1]})
