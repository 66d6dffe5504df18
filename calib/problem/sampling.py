"""Latin hypercube samples of a parameter space under its constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace

_BATCH_MAX = 50_000
_FEWEST = 1e-4
"""Smallest acceptance rate with which sampling continues."""
_TRIES = 100_000
"""Candidates drawn before the acceptance rate is checked."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Accepted points of a space.

    Attributes
    ----------
    points : ndarray (count, n_free)
        Over the free parameters, each in its own unit.
    asked : int
        Candidates drawn.
    accepted : int
        Candidates that kept the constraints, at least ``count``.
    """

    points: np.ndarray
    asked: int
    accepted: int

    @property
    def acceptance(self) -> float:
        """Share of the candidates that kept the constraints."""
        return self.accepted / self.asked


def sample(space: ParameterSpace, count: int, seed: int | np.random.Generator, batch: int | None = None) -> Sample:
    """Draw points by Latin hypercube and keep those that meet the space's constraints.

    Without constraints the points are one Latin hypercube (McKay, Beckman and Conover 1979). With constraints, whole
    hypercubes are drawn until enough points are accepted; the sample is uniform over the admissible region but no
    longer a Latin hypercube, and its parameters are correlated. Integer parameters take each value with equal
    probability.

    Parameters
    ----------
    space : ParameterSpace
    count : int
        Accepted points wanted.
    seed : int or numpy.random.Generator
        Same seed, same points.
    batch : int, optional
        Candidates of the first hypercube; ``count`` by default.

    Returns
    -------
    Sample

    Raises
    ------
    InputError
        When no parameter is free, or the constraints accept fewer than 1 candidate in 10,000.
    """
    if count < 1:
        raise InputError(f"{count} points are requested", place="sample", remedy="request at least 1")
    if not space.free:
        raise InputError("no parameter is free", place="sample", remedy="select at least one parameter")
    space.require_feasible()
    from scipy.stats import qmc  # slow to import, and not every command samples

    engine = qmc.LatinHypercube(len(space.free), rng=np.random.default_rng(seed))
    kept: list[np.ndarray] = []
    asked = accepted = 0
    batch = batch or count
    while accepted < count:
        points = space.from_unit(engine.random(batch))
        good = points[space.feasible(points)]
        kept.append(good)
        asked, accepted = asked + batch, accepted + len(good)
        if asked >= _TRIES and accepted < _FEWEST * asked:
            raise InputError(
                f"the constraints accept only {accepted} of {asked} points ({100 * accepted / asked:.2g} %)",
                place="sample",
                remedy="widen the constraints or narrow the parameter limits to the admissible region",
            )
        missing = (count - accepted) * asked / max(accepted, 1)
        batch = int(np.clip(1.1 * missing, max(count, 100), _BATCH_MAX))
    return Sample(np.concatenate(kept)[:count], asked, accepted)
