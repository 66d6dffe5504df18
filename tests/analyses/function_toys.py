"""Functions whose evidence has a closed form, and their hypotheses."""

import math
from pathlib import Path

import numpy as np

from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.hypotheses.function_perturbations import function_hypotheses
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel

CHAIN = Path(__file__).resolve().parents[2] / "studies" / "five_mass_chain"
STD = 0.01
N, P, E = 14, 3, 5


def hypotheses_of(model, targets, space, effects, repeats=None, step=1e-4):
    """Hypotheses of a function against measured responses."""
    problem = FunctionProblem(model.space, model.function, targets, "", repeats)
    return function_hypotheses(model, ResponseResidual(problem, step), effects, space)[0]


class Counted:
    """A function that records every point it is called with, and may fail at some."""

    def __init__(self, inner, refuse=lambda values: False):
        self.inner, self.refuse, self.asked = inner, refuse, []

    def __call__(self, values):
        self.asked.append(tuple(sorted(values.items())))
        if self.refuse(values):
            raise ZeroDivisionError("no answer here")
        return self.inner(values)


def effect(name, build=lambda model: None, lower=-10.0, upper=10.0, **options):
    return Effect(name, name, "", "", Parameter(name, 0.0, lower, upper, prior_sd=1.0), build, **options)


class Linear:
    """``y = A theta + B size``: a linear Gaussian model, for which every result has a closed form."""

    def __init__(self, seed, magnitude=0.0, hidden=0):
        rng = np.random.default_rng(seed)
        self.a, self.b = rng.standard_normal((N, P)), 0.3 * rng.standard_normal((N, E))
        self.names = [f"r_{i}" for i in range(N)]
        theta, size = rng.standard_normal(P), np.zeros(E)
        size[hidden] = magnitude
        self.y = self.a @ theta + self.b @ size + STD * rng.standard_normal(N)
        parameters = [Parameter(f"t{k}", 0.0, -20.0, 20.0, prior_sd=1.0) for k in range(P)]
        self.space = ParameterSpace((*parameters, Parameter("held", 2.0, 0.0, 4.0, distribution="fixed")))
        self.held = 0.3 * rng.standard_normal(N)
        self.y = self.y + 2.0 * self.held
        self.function = Counted(self.answer)

    def answer(self, values):
        theta = np.array([values[f"t{k}"] for k in range(P)])
        size = np.array([values.get(f"e{k}", 0.0) for k in range(E)])
        return dict(zip(self.names, self.a @ theta + self.b @ size + values["held"] * self.held, strict=True))

    def hypotheses(self, **options):
        model = FunctionModel("linear", self.space, self.function)
        targets = {name: (float(v), STD) for name, v in zip(self.names, self.y, strict=True)}
        effects = tuple(effect(f"e{k}") for k in range(E))
        return hypotheses_of(model, targets, self.space, effects, **options)

    def closed_form(self):
        """Score, unabsorbed fraction and log Bayes factor of each effect, from the marginal density of the data."""
        r, a, b = (self.y - 2.0 * self.held) / STD, self.a / STD, self.b / STD
        c = np.eye(N) + a @ a.T
        inverse = np.linalg.inv(c)
        size = np.sqrt(np.einsum("ij,ik,kj->j", b, inverse, b))
        z = b.T @ inverse @ r / size

        def ln_density(covariance):
            return -0.5 * (r @ np.linalg.solve(covariance, r) + np.linalg.slogdet(covariance)[1])

        ln_bayes = np.array([ln_density(c + np.outer(g, g)) - ln_density(c) for g in b.T])
        return z, size / np.linalg.norm(b, axis=0), ln_bayes


def curved(values):
    x, size = values["x"], values.get("size", 0.0)
    return {"a": math.exp(x), "b": x**2, "c": math.sin(size) + 3 * x, "d": x * size, "e": 1.0}
