"""Score tests of candidates at a fitted model: signatures, scores and the family-wise p-value of the largest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np
import scipy.linalg as la
from scipy.special import ndtr, ndtri, stdtr

from calib.errors.errors import EvaluationError
from calib.missing.hypotheses import FitProblem
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.problem.candidate import Candidate
from calib.problem.labels import Labelled
from calib.problem.shared_points import solve_shared

_NEVER = 1e-3
"""Chance that any sample reaches a score, below which none is drawn."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of candidates at a fitted model, one column for each candidate or point of its grid.

    With ``g`` the signature (change of the data per unit of magnitude) and P the projector off what the parameters
    absorb, ``z = (P g)^T r/|P g|`` is a standard normal variate if nothing is missing (Rao's score test, 1948);
    ``z/|P g|`` is the magnitude after one step, ``z^2`` the predicted decrease of the sum of squares.

    Attributes
    ----------
    owners : tuple of str
        Candidate of every column, length m.
    points : tuple of mapping
        Magnitude and nuisance values at which a column was computed by difference; empty for a derivative.
    raw : ndarray (n_rows, m)
        g.
    unit : ndarray (n_rows + p, m)
        ``P g/|P g|``.
    size : ndarray (m,)
        ``|P g|``; 0 where the parameters absorb all of g.
    z, unabsorbed : ndarray (m,)
        Score, and unabsorbed fraction ``|P g|/|g|``.
    signed : ndarray (m,), bool
        Whether a negative score counts too.
    onset : ndarray (m,)
        Magnitude below which a column does not apply: that of its point where it pairs a further measured mode, which
        happens from some magnitude on and not in proportion to it; else 0.
    """

    owners: tuple[str, ...]
    points: tuple[Mapping[str, float], ...]
    raw: np.ndarray
    unit: np.ndarray
    size: np.ndarray
    z: np.ndarray
    unabsorbed: np.ndarray
    signed: np.ndarray
    onset: np.ndarray

    @property
    def magnitude(self) -> np.ndarray:
        """Test statistic: z, or ``|z|`` where both signs count, (m,)."""
        return np.where(self.signed, np.abs(self.z), self.z)

    def joined(self, other: Scores) -> Scores:
        """These columns, and after them those of another family at the same fit."""
        return Scores(
            (*self.owners, *other.owners), (*self.points, *other.points), np.hstack([self.raw, other.raw]),
            np.hstack([self.unit, other.unit]),
            *(np.concatenate([getattr(self, name), getattr(other, name)])
              for name in ("size", "z", "unabsorbed", "signed", "onset")),
        )  # fmt: skip

    def at(self, fit: LinearisedFit) -> Scores:
        """Scores of the same columns at another end point of the fit; see `LinearisedFit.relinearised`."""
        return replace(self, z=self.unit.T @ fit.augmented)

    def of(self, name: str) -> list[int]:
        """Columns of a candidate."""
        return [k for k, owner in enumerate(self.owners) if owner == name]

    def best(self, name: str) -> int:
        """Column of a candidate with the largest test statistic."""
        return max(self.of(name), key=lambda k: float(self.magnitude[k]))

    def steps(self, name: str, count: int) -> list[int]:
        """Columns of a candidate that are predicted to lower the sum of squares most at their own magnitude."""

        def drop(k: int) -> float:
            if not self.points[k]:
                return float(self.magnitude[k]) ** 2
            length = self.size[k] * abs(self.points[k][name])
            return float(2 * self.z[k] * length - length**2)

        return sorted(self.of(name), key=drop, reverse=True)[:count]


def scores(
    fit: LinearisedFit,
    candidates: Sequence[Candidate],
    fit_problems: Mapping[str, FitProblem],
    further: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Scores:
    """Score candidates at a fitted model.

    Parameters
    ----------
    fit : LinearisedFit
    candidates : sequence of Candidate
        Signatures are differences at the points of the grid, or derivatives for candidates without a grid.
    fit_problems : mapping from str to FitProblem
        For every candidate with a grid or a further point, the fit problem with that candidate added.
    further : mapping from str to mapping
        A further point of some candidates at which a signature is computed by difference.
    """
    plain = [e for e in candidates if not e.grid]
    owners = [e.name for e in plain]
    points: list[Mapping[str, float]] = [{} for _ in plain]
    columns = [_seen(-fit.fit_problem.jacobian(fit.values, owners), plain)] if plain else []
    onset = [0.0] * len(plain)
    more: dict[str, tuple[Mapping[str, float], ...]] = {name: (point,) for name, point in further.items()}
    tried = [(e.name, point) for e in candidates for point in (*e.grid, *more.get(e.name, ()))]
    solve_shared((fit_problems[name], {**fit.values, **point}) for name, point in tried)
    for name, point in tried:
        try:
            changed = fit_problems[name].residual({**fit.values, **point})
        except EvaluationError:
            continue
        owners.append(name)
        points.append(point)
        onset.append(abs(point[name]) if point is further.get(name) else 0.0)
        columns.append(((fit.residual - changed) / point[name])[:, None])
    raw = np.hstack(columns) if columns else np.zeros((len(fit.residual), 0))
    two_sided = {e.name: e.signed for e in candidates}
    return scored(fit, owners, points, raw, [two_sided[name] for name in owners], onset)


def _seen(changes: np.ndarray, candidates: Sequence[Candidate]) -> np.ndarray:
    """Changes of the data (n_rows, m), 0 for a candidate that changes nothing: rounding errors are no signature."""
    size = np.linalg.norm(changes, axis=0) * [e.plausible for e in candidates]
    return np.where(size > RULES.unseen, changes, 0.0)


def scored(
    fit: LinearisedFit,
    owners: Sequence[str],
    points: Sequence[Mapping[str, float]],
    raw: np.ndarray,
    signed: Sequence[bool] | np.ndarray,
    onset: Sequence[float] | np.ndarray,
) -> Scores:
    """Scores of given changes of the data (n_rows, m) at a fitted model; see `Scores`."""
    projected = fit.project_out(raw)
    whole, size = np.linalg.norm(raw, axis=0), np.linalg.norm(projected, axis=0)
    seen = size > RULES.absorbed * np.maximum(whole, 1e-300)
    safe = np.where(seen, size, 1.0)
    unit = np.where(seen, projected / safe, 0.0)
    return Scores(
        owners=tuple(owners),
        points=tuple(points),
        raw=raw,
        unit=unit,
        size=np.where(seen, size, 0.0),
        z=unit.T @ fit.augmented,
        unabsorbed=np.where(whole > 0, np.where(seen, size, 0.0) / np.maximum(whole, 1e-300), 0.0),
        signed=np.array(signed, dtype=bool),
        onset=np.array(onset, dtype=float),
    )


def family_p(found: Scores, labelled: Labelled, seed: int) -> float:
    """Family-wise p-value of the largest score.

    If nothing is missing, scores are correlated normal variates with the covariance ``U^T U`` of their unit directions.
    The standard deviation is estimated from a few repeats, so that the samples of every kind of response share a factor
    (``sqrt(nu/chi2_nu)``, as in Student's t). The smallest p-value is about ``1/Rules.samples``; a score that none of
    the samples would reach has it without any being drawn.
    """
    seen = found.size > 0
    if not seen.any():
        return 1.0
    unit, signed = found.unit[:, seen], found.signed[seen]
    kinds = [row.kind for row in labelled.rows]
    std_dof = np.array([labelled.std_dof.get(kind, np.inf) for kind in dict.fromkeys(kinds)])
    if RULES.samples * _reached(found.magnitude[seen].max(), unit.shape[1], std_dof) < _NEVER:
        return 1 / (RULES.samples + 1)
    blocks = [np.flatnonzero([k == kind for k in kinds]) for kind in dict.fromkeys(kinds)]
    blocks.append(np.arange(len(kinds), len(unit)))
    roots = [_root(unit[index]) for index in blocks]
    dof = (*std_dof.tolist(), np.inf)
    samples = np.zeros((unit.shape[1], RULES.samples))
    noise = _noise(seed, RULES.samples, tuple(zip(dof, (root.shape[1] for root in roots), strict=True)))
    for root, (factor, normal) in zip(roots, noise, strict=True):
        samples += factor * (root @ normal)
    largest = np.max(np.where(signed[:, None], np.abs(samples), samples), axis=0)
    return float((np.count_nonzero(largest >= found.magnitude[seen].max()) + 1) / (RULES.samples + 1))


def _reached(score: float, count: int, std_dof: np.ndarray) -> float:
    """Upper bound of the chance that any of some scores reaches a value where nothing is missing.

    A score is a sum over kinds k of normal variates times factors f_k, whose squared weights sum to 1: it reaches what
    one normal variate times the largest factor does, and each of these is a Student's t of that kind's degrees of
    freedom (Bonferroni over scores, kinds and the prior, whose factor is 1).
    """
    finite = std_dof[np.isfinite(std_dof)]
    return float(2 * count * ((len(std_dof) - len(finite) + 1) * ndtr(-score) + stdtr(finite, -score).sum()))


def noise_limit(scores: np.ndarray) -> float:
    """Absolute score that noise alone exceeds anywhere with a probability of `DecisionRules.noise_level`.

    Standard normal scores, Bonferroni over those that are known; as they are correlated, the limit is on the safe side.

    Parameters
    ----------
    scores : ndarray (n,)
        NaN where the parameters absorb the candidate.
    """
    return float(-ndtri(RULES.noise_level / (2 * max(int(np.isfinite(scores).sum()), 1))))


@lru_cache(maxsize=3)  # the candidates of one fit after another: effects, perturbations, faults of the measurement
def _noise(
    seed: int, count: int, parts: tuple[tuple[float, int], ...]
) -> tuple[tuple[np.ndarray | float, np.ndarray], ...]:
    """Common factor (count,) and independent normal variates (size, count) of parts of given dof and size."""
    rng = np.random.default_rng(seed)
    out: list[tuple[np.ndarray | float, np.ndarray]] = []
    for dof, size in parts:
        factor = np.sqrt(dof / rng.chisquare(dof, count)) if np.isfinite(dof) else 1.0
        out.append((factor, rng.standard_normal((size, count))))
    return tuple(out)


def _root(rows: np.ndarray) -> np.ndarray:
    """A matrix R with ``R R^T = U^T U`` of rows U (n, m): (m, n), or (m, m) where that is smaller.

    The smaller one is the symmetric root: signs of eigenvectors, which machines choose differently, change no sample.
    """
    if len(rows) <= rows.shape[1]:
        return rows.T
    eigenvalues, vectors = la.eigh(rows.T @ rows)
    return np.asarray((vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T)


def correlation(found: Scores, columns: Sequence[int]) -> np.ndarray:
    """Correlation of signatures after projection, (m, m): 1 for collinear candidates."""
    unit = found.unit[:, list(columns)]
    return np.clip(unit.T @ unit, -1.0, 1.0)
