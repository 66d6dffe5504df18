"""Models against an imagined test: their slopes and signatures there, and how two of them differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import scipy.linalg as la
from scipy.special import ndtri

from calib.errors.errors import EvaluationError, InputError
from calib.execution.stage import Progress
from calib.execution.tasks import each, in_this_process
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.missing.candidate_fit import CandidateFit
from calib.missing.competing import CompetingModel, CompetingModels
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.recommendation import Linearisation
from calib.missing.score import Scores
from calib.problem.candidate import Candidate
from calib.problem.problem import Counts, PairProblem

_TRIES = 200
"""Attempts to draw a sample inside the limits before it is moved onto them."""


class Imagined(Protocol):
    """A noise-free test of a fitted model, with more than was measured."""

    @property
    def hypotheses(self) -> ModelHypotheses[Any]:
        """Those whose models the test is imagined of."""

    def fit_problem(self, effects: tuple[str, ...]) -> PairProblem[Any]:
        """The problem of a variant of the model against this test."""

    def forget(self) -> None:
        """Drop all cached points."""

    def identified(self, fit_problem: PairProblem[Any], values: Mapping[str, float]) -> np.ndarray:
        """Mask of the rows that a test of the structure with these values would measure, (n_rows,)."""

    def loose(self, fit_problem: PairProblem[Any], values: Mapping[str, float]) -> np.ndarray:
        """Change of the residual by one standard deviation of every factor fitted to the test, (n_rows, n_factors)."""


def imagined_linearisations(
    imagined: Imagined,
    believed: Sequence[CandidateFit],
    effects: Sequence[Candidate],
    found: Scores,
    scale: float,
    measured: np.ndarray,
    samples: int,
    seed: int,
    progress: Progress,
) -> tuple[tuple[Linearisation, ...], CompetingModels | None]:
    """Linearisations at posterior samples of the credible models, and the two models where the data allow both.

    Where derivatives cost evaluations of the model, they are taken at the fits alone, where they are known.

    Parameters
    ----------
    imagined : Imagined
    believed, effects, found, scale, samples, seed, progress
        As of `calib.hypotheses.design.modal.modal_design`.
    measured : (n_rows,) bool ndarray
        Rows that were measured.
    """
    seeds = np.random.default_rng(seed).integers(2**31, size=len(believed))
    points = [truncated_samples(one.fit, samples, int(s)) for one, s in zip(believed, seeds, strict=True)]
    competing = None
    if len(believed) > 1:
        first, second = (_competing(imagined, b, own, scale) for b, own in zip(believed[:2], points[:2], strict=True))
        competing = CompetingModels((first, second), measured, seed)
    shares = (1.0,) if competing is None else competing.weights
    if imagined.fit_problem(believed[0].names).by_differences:
        points = [(one.fit.values,) for one in believed]
    requested = [
        (k, values, share) for k, (own, share) in enumerate(zip(points, shares, strict=True)) for values in own
    ]
    for one in believed:  # built here, so that no other process needs to
        for names in (one.names, *((*one.names, name) for name, point in _points(one, effects, found) if point)):
            imagined.fit_problem(names)
    tasks = each if _shareable(imagined) else in_this_process
    done = tasks(
        _linearisation, (imagined, believed, effects, found, scale), requested,
        lambda number: progress("what to measure next", number, len(requested)),
    )  # fmt: skip
    for _, counts in done:
        imagined.hypotheses.counts.add(counts)
    return tuple(linearisation for linearisation, _ in done if linearisation is not None), competing


def _shareable(imagined: Imagined) -> bool:
    """Whether other processes may solve the models: a user's function is called here, in order, and never twice."""
    return imagined.hypotheses.variants.calls is None


def _linearisation(
    shared: tuple[Imagined, Sequence[CandidateFit], Sequence[Candidate], Scores, float],
    requested: tuple[int, Mapping[str, float], float],
) -> tuple[Linearisation | None, Counts]:
    """A linearisation at one sample, and the points requested for it: as many whatever was requested before."""
    (imagined, believed, effects, found, scale), (k, values, share) = shared, requested
    if _shareable(imagined):
        imagined.forget()
    with imagined.hypotheses.counts.apart() as counts:
        out = _at(imagined, believed[k], values, effects, found, scale, share)
    return out, counts


def _points(one: CandidateFit, effects: Sequence[Candidate], found: Scores) -> list[tuple[str, Mapping[str, float]]]:
    """Effects that a model lacks, each with the point of its grid where its signature is taken; empty for a slope."""
    return [(e.name, found.points[found.best(e.name)]) for e in effects if e.name not in one.names]


def _at(
    imagined: Imagined,
    candidate_fit: CandidateFit,
    values: Mapping[str, float],
    effects: Sequence[Candidate],
    found: Scores,
    scale: float,
    share: float,
) -> Linearisation | None:
    """Slopes and signatures at a point; None where the model cannot be solved there or near it."""
    fit_problem, names = imagined.fit_problem(candidate_fit.names), candidate_fit.fit.names
    points = dict(_points(candidate_fit, effects, found))
    differentiable = [name for name, point in points.items() if not point]
    try:
        identified, here = imagined.identified(fit_problem, values), fit_problem.residual(values)
        slope = -fit_problem.jacobian(values, [*names, *differentiable])
    except EvaluationError:
        return None
    columns = []
    for effect in effects:
        if effect.name in candidate_fit.names or effect.name in differentiable:
            columns.append(slope[:, [*names, *differentiable].index(effect.name)])
            continue
        there = {**values, **points[effect.name]}
        other = imagined.fit_problem((*candidate_fit.names, effect.name))
        try:
            changed, both = other.residual(there), imagined.identified(other, there)
            columns.append(np.where(both, here - changed, 0.0) / there[effect.name])
        except (EvaluationError, InputError):
            columns.append(np.zeros(len(here)))
    factor = identified[:, None] / scale
    loose = imagined.loose(fit_problem, values) * identified[:, None]
    every = (*names, *(f"scale {k}" for k in range(loose.shape[1])))
    known = np.append(candidate_fit.fit.prior_sd, np.ones(loose.shape[1]))
    slopes = np.hstack([slope[:, : len(names)] * factor, loose])
    return Linearisation(every, known, slopes, np.column_stack(columns) * factor, share)


def _competing(
    imagined: Imagined, candidate_fit: CandidateFit, points: Sequence[Mapping[str, float]], scale: float
) -> CompetingModel:
    """Predictions of a model at its fit and at posterior samples, relative to the imagined test."""
    fit_problem, fit = imagined.fit_problem(candidate_fit.names), candidate_fit.fit
    there = imagined.identified(fit_problem, fit.values)
    kept, sampled, identified = [], [], []
    for values in points:
        try:
            rows = imagined.identified(fit_problem, values)
            sampled.append(np.where(rows, -fit_problem.residual(values), 0.0) / scale)
        except EvaluationError:
            continue
        kept.append(values)
        identified.append(rows)
    factor = there / scale
    predicted, slope = -fit_problem.residual(fit.values) * factor, -fit_problem.jacobian(fit.values, fit.names)
    return CompetingModel(
        candidate_fit.names[0], candidate_fit.ln_evidence, fit, predicted, slope * factor[:, None], tuple(kept),
        np.array(sampled).reshape(len(kept), len(there)),
        np.array(identified, bool).reshape(len(kept), len(there)), there,
        imagined.loose(fit_problem, fit.values) * there[:, None],
    )  # fmt: skip


def truncated_samples(fit: LinearisedFit, count: int, seed: int) -> tuple[dict[str, float], ...]:
    """Posterior samples of all parameters; the same seed gives the same samples.

    The posterior is a Gaussian about the fit (Laplace's approximation), truncated at the limits. The samples are a
    Latin hypercube (McKay, Beckman and Conover 1979), so that a few of them fill it evenly. A sample outside the limits
    is drawn again, and moved onto them if all attempts fail.

    Parameters
    ----------
    fit : LinearisedFit
    count : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    p = len(fit.names)
    space = fit.fit_problem.space
    lower, upper = (np.array([getattr(space[n], side) for n in fit.names], dtype=float) for side in ("lower", "upper"))
    centre = np.array([fit.values[n] for n in fit.names])
    # Magnitudes first: the first coordinate of a triangular root keeps the stratification.
    order = np.array(sorted(range(p), key=lambda k: fit.names[k] not in fit.effects), dtype=int)
    root = np.zeros((p, p))
    root[order] = la.cholesky(fit.covariance[np.ix_(order, order)], lower=True) if p else root
    strata = np.array([rng.permutation(count) for _ in range(p)]).reshape(p, count)
    even = ndtri((strata + rng.uniform(size=(p, count))) / count)
    out = []
    for k in range(count):
        point = centre + root @ even[:, k]
        for _ in range(_TRIES):
            if np.all((point >= lower) & (point <= upper)):
                break
            point = centre + root @ rng.standard_normal(p)
        inside = np.clip(point, lower, upper)
        out.append({**fit.values, **dict(zip(fit.names, inside.tolist(), strict=True))})
    return tuple(out)
