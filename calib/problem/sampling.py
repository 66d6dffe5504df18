"""Latin hypercube samples of a parameter space under its constraints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtri

from calib.errors.errors import InputError
from calib.problem.prior import Correlated
from calib.problem.space import ParameterSpace

DECADES = 2.0
"""Decades between the limits of a parameter from which it is told that uniform samples leave the lower ones out."""
_BATCH_MAX = 50_000
_FEWEST = 1e-4
"""Smallest acceptance rate with which sampling continues."""
_TRIES = 100_000
"""Candidates drawn before the acceptance rate is checked."""
_NARROW = 0.01
"""Largest width of a constraint, over the range that its sum has between the limits, that candidates are moved into."""


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


@dataclass(frozen=True, eq=False)
class Narrow:
    """Equalities and narrow constraints of both sides, each solved for one parameter: random points hardly meet them.

    Attributes
    ----------
    rows : ndarray (n, n_free)
        Coefficients, so combined that no row has the pivot of another one.
    combined : ndarray (n, n)
        Each row as a sum of the constraints.
    lower, upper : ndarray (n,)
        Limits of the constraints, in their own order.
    every : ndarray (n, n_free)
        The constraints themselves.
    pivots : tuple of int
        The parameter that follows from the others, by row: the one by which its sum changes most within the limits.
    whole : tuple of int
        Those of them that are integers.
    """

    rows: np.ndarray
    combined: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    every: np.ndarray
    pivots: tuple[int, ...]
    whole: tuple[int, ...] = ()

    @classmethod
    def of(cls, space: ParameterSpace) -> Narrow:
        """The narrow constraints of a space; left out are those that depend on others.

        Of those on integers alone there remain equalities that some parameter solves in integers.
        """
        weights, low, high = space.constraint_rows()
        span = space.upper - space.lower
        kept, pivots = list[int](), list[int]()
        rows, combined = np.zeros((0, len(span))), np.zeros((0, len(weights)))
        for k, row in enumerate(weights):
            reach = np.abs(row) @ span
            if not 0 <= high[k] - low[k] <= _NARROW * reach:
                continue
            own, mix = row.copy(), np.eye(len(weights))[k]
            for j, pivot in enumerate(pivots):
                own, mix = own - own[pivot] * rows[j], mix - own[pivot] * combined[j]
            size = np.where(space.integer, 0.0, np.abs(own) * span)
            if not size.any() and low[k] == high[k]:  # of integers alone: those by which the others stay integers
                used = mix != 0  # limits of others may be infinite
                size = np.where(_divides(own, mix[used] @ low[used]), np.abs(own) * span, 0.0)
            pivot = int(np.argmax(size))
            if not size[pivot] > 1e-9 * reach:
                continue
            own, mix = own / own[pivot], mix / own[pivot]
            across = rows[:, pivot : pivot + 1]
            rows, combined = np.vstack([rows - across * own, own]), np.vstack([combined - across * mix, mix])
            kept.append(k)
            pivots.append(pivot)
        return cls(rows, combined[:, kept], low[kept], high[kept], weights[kept], tuple(pivots),
                   tuple(pivot for pivot in pivots if space.integer[pivot]))  # fmt: skip

    def filled(self, points: np.ndarray, share: np.ndarray | None = None) -> np.ndarray:
        """Points (n, n_free) moved into the narrow constraints along the pivots, which may leave their limits.

        The sums take the place ``share`` (n, n_constraints), 0 to 1, between the limits of each constraint: for uniform
        shares and other parameters the points are uniform over the admissible region. Without shares they move as
        little as they must.
        """
        if not self.pivots:
            return points
        if share is None:
            sums = np.clip(points @ self.every.T, self.lower, self.upper)
        else:
            sums = self.lower + share * (self.upper - self.lower)
        others = points.copy()
        others[:, self.pivots] = 0.0
        moved = points.copy()
        moved[:, self.pivots] = sums @ self.combined.T - others @ self.rows.T
        moved[:, self.whole] = np.round(moved[:, self.whole])
        return moved


def _divides(row: np.ndarray, total: float) -> np.ndarray:
    """Which coefficients (n,) divide all others and the total of an equality."""
    used = np.abs(row) > 0
    ratios = np.vstack([row[:, None] / np.where(used, row, 1.0), total / np.where(used, row, 1.0)])
    return used & (np.abs(ratios - np.round(ratios)) < 1e-9).all(axis=0)


def _rearranged(unit: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Columns of a hypercube (n, n_columns) with the same values, whose normal scores have a matrix of correlations."""
    count, size = unit.shape
    if not size or count < 2:
        return unit
    scores = ndtri(unit)
    if count > size:  # without the correlations that they have by chance
        basis, triangle = np.linalg.qr(scores - scores.mean(axis=0))
        scores = basis * np.sign(triangle.diagonal())
    ranks = np.argsort(np.argsort(scores @ np.linalg.cholesky(matrix).T, axis=0), axis=0)
    return np.take_along_axis(np.sort(unit, axis=0), ranks, axis=0)


def sample(space: ParameterSpace, count: int, seed: int | np.random.Generator, batch: int | None = None) -> Sample:
    """Draw points by Latin hypercube and keep those that meet the space's constraints.

    Without constraints the points are one Latin hypercube (McKay, Beckman and Conover 1979). With constraints, whole
    hypercubes are drawn until enough points are accepted; the sample is uniform over the admissible region but no
    longer a Latin hypercube, and its parameters are correlated. In equalities and other narrow constraints one
    parameter follows from the others, see `Narrow`. Integer parameters take each value with equal probability. Where
    priors are correlated the columns of each hypercube are rearranged, so that their ranks are correlated alike (Iman
    and Conover 1982).

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

    narrow, size, tied = Narrow.of(space), len(space.free), Correlated.of(space.free)
    columns = [space.free_names.index(name) for name in tied.names]
    engine = qmc.LatinHypercube(size + len(narrow.pivots), rng=np.random.default_rng(seed))
    kept: list[np.ndarray] = []
    asked = accepted = 0
    batch = batch or count
    while accepted < count:
        unit = engine.random(batch)
        unit[:, columns] = _rearranged(unit[:, columns], tied.matrix)
        points = narrow.filled(space.from_unit(unit[:, :size]), unit[:, size:])
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


def wide_sentence(space: ParameterSpace, runs: pd.DataFrame | None = None) -> str:
    """Says which free parameters have limits that span more than `DECADES`; empty for none.

    Where the limits are the smallest and the largest value of ``runs`` (n_runs, n_inputs), a small value near 0 spans
    decades too. Those are told alone whose median lies nearer to the middle of the decades than to that of the limits.
    """
    spans = [(p.name, math.log10(p.upper / p.lower)) for p in space.free if 0 < p.lower and not p.integer]
    wide = [(name, decades) for name, decades in spans if decades > DECADES and not space[name].is_log]
    if runs is not None:
        ends = {name: (space[name].lower, space[name].upper) for name, _ in wide}
        half = {name: math.sqrt(math.sqrt(low * high) * (low + high) / 2.0) for name, (low, high) in ends.items()}
        wide = [(n, decades) for n, decades in wide if n not in runs or float(runs[n].median()) < half[n]]
    if not wide:
        return ""
    names = ", ".join(f"{name} span {decades:.2g} decades" for name, decades in wide)
    between = "metamodels and searches" if runs is not None else "samples and searches"
    return (
        f"The limits of {names}: {between} between them are uniform, so that nine tenths lie in the "
        'uppermost decade and the others are hardly seen. State scale = "log" there, or narrow the limits.'
    )
