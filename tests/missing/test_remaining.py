"""What is left of a residual where a limit holds a parameter, against bounded least squares."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from calib.missing.linearised_fit import LinearisedFit
from calib.problem.space import Parameter, ParameterSpace

N, UPPER = 9, 0.3
PRIOR = np.array([1.0, 2.0, 0.5])


def fit_of(seed, active):
    """End of a linear fit of which the first parameter is at its upper limit."""
    rng = np.random.default_rng(seed)
    g = rng.standard_normal((N, 3))
    y = g @ [0.9, -0.4, 0.2] + 0.1 * rng.standard_normal(N)
    space = ParameterSpace(tuple(
        Parameter(n, 0.0, -5.0, UPPER if n == "a" else 5.0, prior_sd=s) for n, s in zip("abc", PRIOR, strict=True)
    ))  # fmt: skip
    theta = bounded(g, y)
    values = dict(zip("abc", theta.tolist(), strict=True))
    return g, y, LinearisedFit(
        (), SimpleNamespace(space=space), ("a", "b", "c"), values, y - g @ theta, g, PRIOR, theta / PRIOR, True,
        active=frozenset(active),
    )  # fmt: skip


def bounded(g, y):
    matrix, right = np.vstack([g, np.diag(1 / PRIOR)]), np.concatenate([y, np.zeros(3)])
    return lsq_linear(matrix, right, ([-5.0] * 3, [UPPER, 5.0, 5.0]), tol=1e-14).x


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [0.0, 0.6, 3.0])
def test_what_is_left_is_that_of_a_bounded_fit(seed, size):
    """Of a small change the limit still holds the parameter, a large one takes it off."""
    g, y, fit = fit_of(seed, ["a"])
    assert fit.values["a"] == pytest.approx(UPPER)
    change = size * (0.8 * g[:, 0] + 0.2 * np.random.default_rng(9).standard_normal(N))
    theta = bounded(g, y - change)
    expected = np.concatenate([y - change - g @ theta, -theta / PRIOR])
    np.testing.assert_allclose(fit.remaining(change), expected, atol=1e-6)


def test_without_a_limit_it_is_the_projection():
    _, _, fit = fit_of(1, [])
    change = np.random.default_rng(2).standard_normal(N)
    expected = fit.projected - fit.project_out(change[:, None])[:, 0]
    np.testing.assert_allclose(fit.remaining(change), expected, atol=1e-12)
