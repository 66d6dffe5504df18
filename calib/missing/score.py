"""Fingerprints of candidates on a fitted residual, their scores, and whether the largest could be chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import scipy.linalg as la

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.missing.hypotheses import Question
from calib.missing.rules import RULES
from calib.missing.state import State
from calib.problem import Labelled


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of candidates at a fitted model, one column a candidate or a point of its grid.

    With ``g`` the change of the data by one unit of strength and P the projector off everything that the parameters
    absorb, ``z = (P g)^T r/|P g|`` is a standard normal variate if nothing is missing (Rao's score test, 1948);
    ``z/|P g|`` is the strength in one step, ``z^2`` the decrease of the sum of squares it promises.

    Attributes
    ----------
    owners : tuple of str
        Candidate of every column, length m.
    points : tuple of mapping
        Strength and nuisance values at which a column was taken by difference; empty for a derivative.
    raw : ndarray (n_rows, m)
        g.
    unit : ndarray (n_rows + p, m)
        P g over its length.
    size : ndarray (m,)
        Length of P g; 0 where the parameters absorb all.
    z, gamma : ndarray (m,)
        Score, and the share ``|P g|/|g|`` that the parameters cannot absorb.
    signed : ndarray (m,), bool
        Whether a negative score counts too.
    onset : ndarray (m,)
        Size of the strength below which a column says nothing: where it pairs a further measured mode, that of its
        point, since it does so from some strength on and not in proportion to it; else 0.
    """

    owners: tuple[str, ...]
    points: tuple[Mapping[str, float], ...]
    raw: np.ndarray
    unit: np.ndarray
    size: np.ndarray
    z: np.ndarray
    gamma: np.ndarray
    signed: np.ndarray
    onset: np.ndarray

    @property
    def strength(self) -> np.ndarray:
        """Of the test: z, or its size where both signs count, (m,)."""
        return np.where(self.signed, np.abs(self.z), self.z)

    def at(self, state: State) -> Scores:
        """The same columns where a fit is expected to end elsewhere; see `State.elsewhere`."""
        return replace(self, z=self.unit.T @ state.augmented)

    def only(self, names: Sequence[str]) -> Scores:
        """The columns of some candidates."""
        kept = [k for k, owner in enumerate(self.owners) if owner in names]
        return Scores(
            owners=tuple(self.owners[k] for k in kept),
            points=tuple(self.points[k] for k in kept),
            raw=self.raw[:, kept],
            unit=self.unit[:, kept],
            size=self.size[kept],
            z=self.z[kept],
            gamma=self.gamma[kept],
            signed=self.signed[kept],
            onset=self.onset[kept],
        )

    def of(self, name: str) -> list[int]:
        """Columns of a candidate."""
        return [k for k, owner in enumerate(self.owners) if owner == name]

    def best(self, name: str) -> int:
        """Column of a candidate with the largest promised decrease."""
        return max(self.of(name), key=lambda k: float(self.strength[k]))

    def steps(self, name: str, count: int) -> list[int]:
        """The columns of a candidate that would lower the sum of squares most at their own strength."""

        def drop(k: int) -> float:
            if not self.points[k]:
                return float(self.strength[k]) ** 2
            length = self.size[k] * abs(self.points[k][name])
            return float(2 * self.z[k] * length - length**2)

        return sorted(self.of(name), key=drop, reverse=True)[:count]


def scores(
    state: State,
    candidates: Sequence[Effect],
    questions: Mapping[str, Question],
    further: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Scores:
    """Score candidates at a fitted model.

    Parameters
    ----------
    state : State
    candidates : sequence of Effect
        Those with a grid are asked at its points, the others by their derivative.
    questions : mapping from str to Question
        For every candidate with a grid or a further point, the state's question with that candidate added.
    further : mapping from str to mapping
        A point of some candidates at which they are asked by difference too.
    """
    plain = [e for e in candidates if not e.grid]
    owners = [e.name for e in plain]
    points: list[Mapping[str, float]] = [{} for _ in plain]
    columns = [-state.question.jacobian(state.values, owners)] if plain else []
    onset = [0.0] * len(plain)
    for effect in candidates:
        for point in (*effect.grid, *([further[effect.name]] if effect.name in further else [])):
            try:
                changed = questions[effect.name].residual({**state.values, **point})
            except EvaluationError:
                continue
            owners.append(effect.name)
            points.append(point)
            onset.append(abs(point[effect.name]) if point is further.get(effect.name) else 0.0)
            columns.append(((state.residual - changed) / point[effect.name])[:, None])
    raw = np.hstack(columns) if columns else np.zeros((len(state.residual), 0))
    two_sided = {e.name: e.signed for e in candidates}
    return scored(state, owners, points, raw, [two_sided[name] for name in owners], onset)


def scored(
    state: State,
    owners: Sequence[str],
    points: Sequence[Mapping[str, float]],
    raw: np.ndarray,
    signed: Sequence[bool] | np.ndarray,
    onset: Sequence[float] | np.ndarray,
) -> Scores:
    """Scores of changes of the data (n_rows, m) that are known, at a fitted model; see `Scores`."""
    outside = state.outside(raw)
    whole, size = np.linalg.norm(raw, axis=0), np.linalg.norm(outside, axis=0)
    seen = size > RULES.absorbed * np.maximum(whole, 1e-300)
    safe = np.where(seen, size, 1.0)
    unit = np.where(seen, outside / safe, 0.0)
    return Scores(
        owners=tuple(owners),
        points=tuple(points),
        raw=raw,
        unit=unit,
        size=np.where(seen, size, 0.0),
        z=unit.T @ state.augmented,
        gamma=np.where(whole > 0, np.where(seen, size, 0.0) / np.maximum(whole, 1e-300), 0.0),
        signed=np.array(signed, dtype=bool),
        onset=np.array(onset, dtype=float),
    )


def family_p(found: Scores, labelled: Labelled, seed: int) -> float:
    """Chance that the largest of all scores is as large as found although nothing is missing.

    Scores are correlated normal variates with covariance ``U^T U`` of their unit directions. What is known of the
    scatter comes from a few repeats, so that every kind of response is drawn with a common factor of its own
    (``sqrt(nu/chi2_nu)``, as in Student's t); 1/8000 is the smallest value that can be told.
    """
    seen = found.size > 0
    if not seen.any():
        return 1.0
    unit, signed = found.unit[:, seen], found.signed[seen]
    rng = np.random.default_rng(seed)
    kinds = [row.kind for row in labelled.rows]
    blocks = {kind: np.flatnonzero([k == kind for k in kinds]) for kind in dict.fromkeys(kinds)}
    drawn = np.zeros((unit.shape[1], RULES.draws))
    for kind, index in (*blocks.items(), ("", np.arange(len(kinds), len(unit)))):
        freedom = labelled.scatter_freedom.get(kind, np.inf)
        factor = (
            np.sqrt(freedom / rng.chisquare(freedom, RULES.draws)) if np.isfinite(freedom) else np.ones(RULES.draws)
        )
        drawn += factor * (_root(unit[index].T @ unit[index]) @ rng.standard_normal((unit.shape[1], RULES.draws)))
    largest = np.max(np.where(signed[:, None], np.abs(drawn), drawn), axis=0)
    return float((np.count_nonzero(largest >= found.strength[seen].max()) + 1) / (RULES.draws + 1))


def _root(matrix: np.ndarray) -> np.ndarray:
    """A square root of a positive semidefinite matrix."""
    size, turn = la.eigh(matrix)
    return turn * np.sqrt(np.maximum(size, 0.0))


def correlation(found: Scores, columns: Sequence[int]) -> np.ndarray:
    """Correlation of fingerprints after projection, (m, m): how alike candidates look to data and parameters."""
    unit = found.unit[:, list(columns)]
    return np.clip(unit.T @ unit, -1.0, 1.0)
