"""A space in which a constraint binds two parameters, of which only one affects the responses."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from calib.problem.sampling import sample
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace


def bound_space(width: float) -> ParameterSpace:
    """Two masses whose sum is held within ``width``, a stiffness, a position, and an inert parameter."""
    names = ("mass", "inert_mass", "stiffness", "nothing")
    free = tuple(Parameter(name, 0.5, 0.0, 1.0) for name in names)
    place = Parameter("place", 0.0, -1.0, 1.0, integer=True)
    total = LinearConstraint("total mass", (("mass", 1.0), ("inert_mass", 1.0)), 1.0 - width, 1.0 + width)
    return ParameterSpace((*free, place), (total,))


def bound_sample(seed: int, n: int, width: float = 0.2) -> pd.DataFrame:
    """Points whose two masses have a rank correlation of about -0.9 (at the default width)."""
    space = bound_space(width)
    return pd.DataFrame(sample(space, n, seed).points, columns=list(space.free_names))


def bound_responses(points: pd.DataFrame, seed: int, noise: float = 0.05) -> pd.DataFrame:
    """Responses that depend on mass, stiffness and place, but neither on the other mass nor on ``nothing``."""
    m, k, x = points["mass"], points["stiffness"], points["place"]
    exact = {
        "freq": np.sqrt((1 + k) / (1 + m)),
        "even": x**2 + 0.1 * k,
        "valley": (m - 0.5) ** 2,
        "product": (m - 0.5) * (k - 0.5) + 0.1 * x**2,
        "steep": np.exp(3 * m) * (1 + 0.2 * k),
    }
    rng = np.random.default_rng([seed, 7])
    return pd.DataFrame({c: v + noise * v.std() * rng.standard_normal(len(points)) for c, v in exact.items()})


Draw = Callable[..., tuple[pd.DataFrame, pd.DataFrame]]


@pytest.fixture
def draw() -> Draw:
    """Points and responses of a seed."""

    def drawn(seed: int, n: int, width: float = 0.2, noise: float = 0.05) -> tuple[pd.DataFrame, pd.DataFrame]:
        points = bound_sample(seed, n, width)
        return points, bound_responses(points, seed, noise)

    return drawn


@pytest.fixture
def bound(draw: Draw) -> tuple[pd.DataFrame, pd.DataFrame]:
    return draw(1, 300)
