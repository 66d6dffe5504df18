"""Robustness of a fitted model: its responses over what the data leave open of its parameters."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import special

from calib.analyses.case import objective_of
from calib.analyses.fit_statistics import ObjectiveTerms, statistics_at
from calib.analyses.intervals import scanned_problem
from calib.analyses.joint_responses import Responses
from calib.analyses.provenance.places import Workers
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import ROBUSTNESS, SAMPLES
from calib.analyses.sensitivity import evaluated, response_units, table_of
from calib.analyses.staged import required_calibration
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.inference.freed import beside_data
from calib.inference.identify import posterior
from calib.problem.prior import Prior
from calib.problem.sampling import Narrow
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.results.table import read_table
from calib.study.settings import RobustnessSettings
from calib.study.several import AnyStudy

QUANTILES = {"q025": 0.025, "q05": 0.05, "median": 0.5, "q95": 0.95, "q975": 0.975}
COLUMNS = ("response", "unit", "fitted", "measured", "mean", "std", *QUANTILES, "least", "most", "samples", "outside",
           "outside_low", "outside_high", "sentence")  # fmt: skip
_ROUNDS = 200
"""Draws of all samples after which constraints count as excluding them."""


@dataclass(frozen=True)
class RobustnessRun:
    """What a robustness analysis is computed with besides the study.

    Attributes
    ----------
    ledger : Ledger
    settings : RobustnessSettings
    drawn : DataFrame or None
        Samples of the posterior of the fitted parameters; by default they are drawn from the linearised posterior.
    homes, workers, progress
        As in `calib.analyses.intervals.IntervalsRun`.
    """

    ledger: Ledger
    settings: RobustnessSettings
    drawn: pd.DataFrame | None = None
    homes: Mapping[str, Results] = field(default_factory=dict)
    workers: Workers = None
    progress: Progress = silent


@dataclass(frozen=True, eq=False)
class Robustness:
    """Responses of a model over the posterior of its parameters.

    Attributes
    ----------
    table : DataFrame
        `COLUMNS`, a row for each response, those with limits first. ``samples`` counts those that have the response;
        ``outside`` is their share outside the limits, with its 95 % interval (Clopper and Pearson 1934); NaN without
        limits.
    samples : DataFrame (n_samples, n_params + n_responses)
        Parameters in their units, then responses; NaN where the model has none.
    failed : int
        Samples at which the model could not be evaluated.
    notes : tuple of str
        What the samples rest on.
    seconds : float
    """

    table: pd.DataFrame
    samples: pd.DataFrame
    failed: int
    notes: tuple[str, ...]
    seconds: float

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each response with limits, then what the samples rest on."""
        each = zip(self.table["response"], self.table["sentence"], strict=True)
        return (*(f"{name}: {words}" for name, words in each if words), *self.notes)

    @property
    def answer(self) -> Answer:
        """The response that is most often outside its limits, or the one that spreads most."""
        limited = self.table[self.table["outside"].notna()]
        if len(limited):
            worst = limited.iloc[int(limited["outside"].argmax())]
            found = f"{worst['response']}: {worst['sentence']}" if worst["outside"] > 0 else _none_outside(limited)
            then = "Limits hold for the model's responses: a measurement scatters about them."
        else:
            relative = (self.table["std"] / self.table["fitted"].abs()).replace(np.inf, np.nan).fillna(0.0)
            worst = self.table.iloc[int(relative.argmax())]
            found = f"{worst['response']} spreads most, by {100 * relative.max():.2g} % (one standard deviation)."
            then = "State what is allowed: [robustness] limits, or --limit RESPONSE LEAST MOST."
        return Answer(found, self.notes[0], then)


def _none_outside(limited: pd.DataFrame) -> str:
    most = 100 * float(limited["outside_high"].max())
    return f"No sample is outside the limits; the share is below {most:.2g} % for every response (95 %)."


def robustness_at(study: AnyStudy, values: Mapping[str, float], run: RobustnessRun) -> Robustness:
    """Push samples of the posterior through the model; nothing is written.

    Parameters that are held though uncertain are drawn from their priors, and the fitted ones follow them as a fit
    would, to first order.

    Raises
    ------
    InputError
        For limits of a response that the model does not have, and where no sample is left: constraints exclude all, or
        the model could be evaluated at none.
    """
    started = time.perf_counter()
    points, notes = _points(study.each(lambda one: recorded(one, run.ledger, run.workers)), values, run)
    space, limits = study.search_space, run.settings.limits
    every = [space.complete({str(name): value for name, value in one.items()}) for one in points.to_dict("records")]
    centre, *outcomes = evaluated(study, run.ledger, [space.complete(dict(values)), *every], run.workers, run.progress)
    names = list(dict.fromkeys(name for one in (centre, *outcomes) for name in one.responses))
    if unknown := [name for name in limits if name not in names]:
        remedy = f"the responses are {', '.join(names[:12])}" + ", ..." * (len(names) > 12)
        words = f"limits are given for {unknown[0]!r}, which is no response"
        raise InputError(words, place="robustness", remedy=remedy)
    responses = table_of(outcomes, names)
    failed = sum(one.status != "ok" for one in outcomes)
    if failed == len(outcomes):
        remedy = "check the model near its fitted parameters"
        raise InputError(f"the model fails at all {failed} samples", place="robustness", remedy=remedy)
    if failed:
        notes.append(f"The model could not be evaluated at {failed} of {len(outcomes)} samples, which do not count.")
    targets, units = objective_of(study).targets, response_units(study, names)
    told = [*Responses.of(study).measured, *(name for name in names if not _of_pairing(name)), *limits]
    names = [name for name in dict.fromkeys(told) if name in names and (name in limits or responses[name].std() > 0)]
    repeated = responses[names].T.duplicated()  # such as damped frequencies without damping
    names = [name for name in names if name in limits or not repeated[name]]
    rows = [
        _row(name, units.get(name, "-"), centre.responses.get(name, np.nan), targets.get(name, np.nan),
             responses[name].to_numpy(), limits.get(name))
        for name in sorted(names, key=lambda name: (name not in limits, names.index(name)))
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    samples = pd.concat([points, responses], axis=1)
    return Robustness(table, samples, failed, tuple(notes), time.perf_counter() - started)


def _of_pairing(response: str) -> bool:
    """Whether a response tells how a model mode was paired."""
    return response.rpartition(": ")[2].startswith(("emac_", "margin_"))


def _row(
    name: str, unit: str, fitted: float, measured: float, drawn: np.ndarray, limits: tuple[float, float] | None
) -> tuple[object, ...]:
    """One row of the table."""
    known = drawn[np.isfinite(drawn)]
    numbers = [np.nan] * (2 + len(QUANTILES))
    if len(known):
        numbers = [known.mean(), known.std(ddof=min(1, len(known) - 1)), *np.quantile(known, list(QUANTILES.values()))]
    head = (name, unit, fitted, measured, *map(float, numbers))
    if limits is None or not len(known):
        words = "" if limits is None else "No sample has this response, so that nothing is known of its limits."
        return (*head, *(limits or (np.nan, np.nan)), len(known), np.nan, np.nan, np.nan, words)
    outside = int(np.count_nonzero((known < limits[0]) | (known > limits[1])))
    low, high = share_interval(outside, len(known))
    share = outside / len(known)
    words = f"{100 * share:.3g} % of {len(known)} samples are outside {_between(limits, unit)} "
    words += f"(95 %: {100 * low:.3g} to {100 * high:.3g} %)."
    return (*head, *limits, len(known), share, low, high, words)


def _between(limits: tuple[float, float], unit: str) -> str:
    scale = f" {unit}" if unit not in ("", "-") else ""
    if np.isinf(limits[0]):
        return f"what is allowed, at most {limits[1]:.6g}{scale}"
    if np.isinf(limits[1]):
        return f"what is allowed, at least {limits[0]:.6g}{scale}"
    return f"{limits[0]:.6g} to {limits[1]:.6g}{scale}"


def share_interval(count: int, total: int) -> tuple[float, float]:
    """95 % interval of the share that a count of independent samples estimates (Clopper and Pearson 1934)."""
    low = float(special.betaincinv(count, total - count + 1, 0.025)) if count else 0.0
    high = float(special.betaincinv(count + 1, total - count, 0.975)) if count < total else 1.0
    return low, high


# -- samples -----------------------------------------------------------------------------------------------------------


def _points(study: AnyStudy, values: Mapping[str, float], run: RobustnessRun) -> tuple[pd.DataFrame, list[str]]:
    """Samples of fitted and of uncertain held parameters, by name, and what is to be said of them.

    The fitted ones follow errors of the mesh and those that data share, too.
    """
    problem, _ = scanned_problem(study, run.homes, run.ledger, run.workers, run.progress)
    space, terms, count = problem.space, ObjectiveTerms.of(study), run.settings.samples
    names = tuple(p.name for p in space.free if not p.integer)
    birge = statistics_at(problem, terms, values).birge
    held_sd = {name: sd for name, sd in terms.held_sd.items() if name in study.search_space}
    slope = np.asarray(problem.jacobian(values, names)) / birge
    moved = np.asarray(problem.jacobian(values, tuple(held_sd))) * list(held_sd.values())
    shared = np.hstack([terms.mesh_at(values, len(slope)), problem.shared_errors])
    moved = np.hstack([moved, shared]) / birge
    prior = Prior.of(space).widths(values, names)
    beside = beside_data(space, names, values, slope, held_sd).beside(shared.shape[1])
    slope, moved = np.vstack([slope, beside.slope]), np.vstack([moved, beside.held])
    covariance = posterior(names, slope, prior).covariance
    rng, own = np.random.default_rng(run.settings.seed), study.search_space
    left, right, _ = np.linalg.svd(covariance / np.outer(prior, prior), hermitian=True)
    root = prior[:, None] * left * np.sqrt(right)
    follow = -covariance @ slope.T @ moved
    kept = list[np.ndarray]()
    drawn_names = [*names, *held_sd]
    centre = np.array([values[name] for name in drawn_names])
    for _ in range(_ROUNDS):
        z = rng.standard_normal((count, moved.shape[1]))
        if run.drawn is None:
            change = rng.standard_normal((count, len(names))) @ root.T
        else:
            rows = rng.choice(len(run.drawn), count, replace=len(run.drawn) < count)
            change = run.drawn[list(names)].to_numpy()[rows] - centre[: len(names)]
        change = np.hstack([change + z @ follow.T, z[:, : len(held_sd)] * list(held_sd.values())])
        kept.append(_within(space, own, drawn_names, centre, change, values))
        if sum(map(len, kept)) >= count:
            break
    else:
        raise InputError(
            f"the constraints leave {sum(map(len, kept))} of {_ROUNDS * count} samples", place="robustness",
            remedy="sample the posterior itself: calib intervals --samples STEPS",
        )  # fmt: skip
    points = pd.DataFrame(np.vstack(kept)[:count], columns=drawn_names)
    source = "the linearised posterior" if run.drawn is None else "the samples of the posterior"
    notes = [f"{count} samples of {source}; they scatter by what is known of the parameters alone."]
    if birge > 1.0:
        notes.append(f"The model does not fit: the samples are for {birge:.3g} times the standard deviations.")
    if held_sd:
        notes.append(f"Held parameters are drawn from their priors: {', '.join(held_sd)}.")
    if whole := [p.name for p in space.free if p.integer]:
        notes.append(f"Integers keep their fitted values: {', '.join(whole)}.")
    return points[[name for name in drawn_names if name in own]], notes


def _within(
    space: ParameterSpace,
    own: ParameterSpace,
    names: Sequence[str],
    centre: np.ndarray,
    change: np.ndarray,
    values: Mapping[str, float],
) -> np.ndarray:
    """Points after changes (n, n_names), reflected at their limits, that keep the constraints."""
    from calib.inference.genetic import reflect

    points = np.empty_like(change)
    for k, name in enumerate(names):
        p = space[name]
        low, high = p.coordinate(p.lower), p.coordinate(p.upper)
        at = p.coordinate(centre[k]) + change[:, k] / (centre[k] if p.is_log else 1.0)
        at = reflect(at[:, None], np.array([low]), np.array([high]))[:, 0] if high > low else at
        points[:, k] = np.clip(np.exp(at), p.lower, p.upper) if p.is_log else at
    if not own.constraints:
        return points
    free = list(own.free_names)
    whole = np.tile([values[name] for name in free], (len(points), 1)).astype(float)
    shared = [name for name in names if name in free]
    whole[:, [free.index(name) for name in shared]] = points[:, [list(names).index(name) for name in shared]]
    whole = Narrow.of(own).filled(whole)
    points[:, [list(names).index(name) for name in shared]] = whole[:, [free.index(name) for name in shared]]
    return np.asarray(points[own.feasible(whole)])


# -- of a study in a folder --------------------------------------------------------------------------------------------


def robustness(study: AnyStudy, results: Results, run: RobustnessRun, quick: bool = False) -> Robustness:
    """Robustness about the stored calibration of a study; writes ``robustness.csv`` and ``robustness_samples.csv``.

    Samples of the posterior that `calib.analyses.intervals` left are used where there are some.

    Raises
    ------
    InputError
        Where the study is not calibrated as it is now.
    """
    values = required_calibration(study, results).values
    found = robustness_at(study, values, run)
    begin_analysis(results, "robustness")
    results.remove(*ROBUSTNESS)
    results.write_table("robustness", found.table)
    results.write_table("robustness_samples", found.samples)
    seeds = {"samples": run.settings.seed}
    write_record(study, results, "robustness", seeds, found.sentences, quick, answer=found.answer)
    return found


def posterior_samples(results: Results) -> pd.DataFrame | None:
    """Samples of the posterior that `calib.analyses.intervals` left; None without any."""
    path = results.path / f"{SAMPLES}.csv"
    return read_table(path, [], others_are_numbers=True) if path.exists() else None
