"""Posterior of the parameters by sampling, which assumes no linear model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import LeastSquares
from calib.inference.identify import Posterior
from calib.inference.rules import RULES, WIDE
from calib.problem.prior import Prior
from calib.problem.space import ParameterSpace

EXTRA = "pip install calib[posterior]"

WALKERS = 4
"""Walkers for each parameter; an ensemble needs at least 2 (Foreman-Mackey et al. 2013)."""

_TAILS = (0.025, 0.5, 0.975)


@dataclass(frozen=True, eq=False)
class SampledPosterior:
    """Samples of the posterior, their convergence, and their intervals beside the linearised ones.

    Attributes
    ----------
    samples : DataFrame (n_samples, n_params)
        Independent to within their autocorrelation: thinned by half its time, the first steps left out.
    table : DataFrame
        ``parameter, value, unit, mean, std, lower, median, upper, linear_lower, linear_upper, differs, sentence``; the
        interval is that of 95 % with equal tails. ``differs`` is False for chains that have not converged.
    acceptance : float
        Mean share of accepted moves.
    autocorrelation : float
        Longest integrated autocorrelation time, steps; NaN where it cannot be estimated.
    steps : int
        Of every walker.
    failed : int
        Points at which the model could not be solved; they count as impossible.
    """

    samples: pd.DataFrame
    table: pd.DataFrame
    acceptance: float
    autocorrelation: float
    steps: int
    failed: int

    @property
    def converged(self) -> bool:
        """Whether the chains are long enough for their own autocorrelation time."""
        return self.steps >= RULES.chain * self.autocorrelation  # False for NaN

    @property
    def sentences(self) -> tuple[str, ...]:
        """How far the samples can be trusted, then the parameters whose interval differs from the linearised one."""
        time = "an unknown number of" if math.isnan(self.autocorrelation) else f"{self.autocorrelation:.0f}"
        words = f"{len(self.samples)} samples of the posterior; autocorrelation over {time} of {self.steps} steps"
        if not self.converged:
            words += ": too few steps to compare intervals by; take more"
        failed = f"{self.failed} points could not be solved and count as impossible." if self.failed else ""
        own = self.table.loc[self.table["differs"].astype(bool)]
        each = (f"{name}: {sentence}" for name, sentence in zip(own["parameter"], own["sentence"], strict=True))
        return (f"{words}.", *([failed] if failed else []), *each)


def sampled_posterior(
    problem: LeastSquares,
    space: ParameterSpace,
    best: Mapping[str, float],
    known: Posterior,
    steps: int,
    seed: int,
    step: Callable[[], None] = lambda: None,
) -> SampledPosterior:
    """Sample ``exp(-|r|^2/2)`` times the prior within limits and linear constraints.

    By the affine-invariant ensemble of Goodman and Weare (2010) in emcee; walkers start about the optimum with the
    linearised covariance. Integers keep their best values.

    Parameters
    ----------
    problem : LeastSquares
    space : ParameterSpace
    best : mapping
        Fitted values, each in its own unit.
    known : Posterior
        Linearised about the fitted values.
    steps : int
        Of every walker; the first third is left out.
    seed : int
    step : callable
        Called after every step of all walkers.

    Raises
    ------
    InputError
        When emcee is not installed, or nothing is free.
    """
    try:
        import emcee
    except ImportError:
        raise InputError(
            "samples of the posterior need the package emcee", place="posterior",
            remedy=f"install it: {EXTRA}",
        ) from None  # fmt: skip
    names, prior = list(known.names), Prior.of(space)
    if not names:
        raise InputError("no parameter is free", place="posterior", remedy="free at least one that is not an integer")
    chosen, failed = [space[name] for name in names], 0
    # Walkers move along the scales of the parameters.
    lower, upper = (np.array([p.coordinate(getattr(p, end)) for p in chosen]) for end in ("lower", "upper"))

    def value_of(x: np.ndarray) -> dict[str, float]:
        return {p.name: p.of_coordinate(at) for p, at in zip(chosen, x.tolist(), strict=True)}

    def log_density(x: np.ndarray) -> float:
        nonlocal failed
        values = {**best, **value_of(x)}
        if np.any(x < lower) or np.any(x > upper) or not space.feasible(_point(space, values))[0]:
            return -math.inf
        try:
            vector = problem.residual(values)
        except EvaluationError:
            failed += 1
            return -math.inf
        return -0.5 * float(vector @ vector) + prior.log_density(values)

    rng = np.random.default_rng(seed)
    walkers = max(WALKERS * len(names), 8)
    centre = np.array([p.coordinate(best[p.name]) for p in chosen])
    stretch = np.array([best[p.name] if p.is_log else 1.0 for p in chosen])
    covariance = known.covariance / np.outer(stretch, stretch)
    start = _start(rng, walkers, centre, covariance, lower, upper, log_density)
    sampler = emcee.EnsembleSampler(walkers, len(names), log_density)
    sampler.random_state = np.random.RandomState(seed).get_state()
    for _ in sampler.sample(start, iterations=steps):
        step()
    time = float(np.max(emcee.autocorr.integrated_time(sampler.get_chain(discard=steps // 3), tol=0), initial=0.0))
    thin = max(int(time / 2), 1) if math.isfinite(time) else 1
    flat = sampler.get_chain(discard=steps // 3, thin=min(thin, max(steps // 10, 1)), flat=True)
    samples = pd.DataFrame([value_of(x) for x in flat], columns=names)
    table = _table(samples, space, best, known.std.tolist(), steps >= RULES.chain * time)
    return SampledPosterior(samples, table, float(np.mean(sampler.acceptance_fraction)), time, steps, failed)


def _point(space: ParameterSpace, values: Mapping[str, float]) -> np.ndarray:
    """Free parameters as the row (1, n_free) that constraints are asked with."""
    return np.array([[values[name] for name in space.free_names]])


def _start(
    rng: np.random.Generator,
    walkers: int,
    centre: np.ndarray,
    covariance: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    log_density: Callable[[np.ndarray], float],
) -> np.ndarray:
    """Walkers about the optimum by half the linearised spread, all at possible points (n_walkers, n_params)."""
    # A direction without information has the width of its limits.
    spread = np.diag(np.minimum(np.sqrt(np.diag(covariance)), (upper - lower) / 4))
    correlation = np.nan_to_num(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))))
    np.fill_diagonal(correlation, 1.0)
    root = np.linalg.svd(spread @ correlation @ spread, hermitian=True)
    shape = root.U * np.sqrt(root.S)
    found, scale, tries = list[np.ndarray](), 0.5, 0
    while len(found) < walkers:
        point = np.clip(centre + scale * (shape @ rng.standard_normal(len(centre))), lower, upper)
        # On a limit all walkers would share a coordinate, and the ensemble never leave it.
        inside = np.where(point <= lower, lower + rng.uniform(0, 0.01) * (upper - lower), point)
        inside = np.where(inside >= upper, upper - rng.uniform(0, 0.01) * (upper - lower), inside)
        if math.isfinite(log_density(inside)):
            found.append(inside)
        tries += 1
        if tries % (20 * walkers) == 0:
            scale /= 4
            if scale < 1e-4:
                raise InputError(
                    "no possible points were found about the fitted values", place="posterior",
                    remedy="check limits, constraints and failed points near them",
                )  # fmt: skip
    return np.array(found)


def _table(
    samples: pd.DataFrame, space: ParameterSpace, best: Mapping[str, float], std: Sequence[float], converged: bool
) -> pd.DataFrame:
    rows = []
    for name, own in zip(samples.columns, std, strict=True):
        p, value, drawn = space[name], float(best[name]), samples[name].to_numpy()
        lower, median, upper = np.quantile(drawn, _TAILS)
        linear = (max(p.moved(value, -WIDE * own), p.lower), min(p.moved(value, WIDE * own), p.upper))
        # Whichever is narrower: a density that fills its limits has no normal scale.
        scale = RULES.profile_differs * WIDE * min(float(own) / p.span_at(value), 1 / 4)
        apart = [abs(p.position(a) - p.position(b)) for a, b in zip((lower, upper), linear, strict=True)]
        differs = converged and max(apart) > scale
        unit = "" if p.unit == "-" else f" {p.unit}"
        words = f"95 % of the samples lie from {lower:.4g} to {upper:.4g}{unit}"
        words += f"; the linearised interval differs: {linear[0]:.4g} to {linear[1]:.4g}{unit}." if differs else "."
        rows.append(
            {
                "parameter": name, "value": value, "unit": p.unit, "mean": float(drawn.mean()),
                "std": float(drawn.std(ddof=1)), "lower": float(lower), "median": float(median), "upper": float(upper),
                "linear_lower": linear[0], "linear_upper": linear[1], "differs": differs, "sentence": words,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
