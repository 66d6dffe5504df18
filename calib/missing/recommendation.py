"""Experimental design: expected gain of each candidate measurement, and the recommendation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.missing.competing import EIGHT_OF_TEN, BayesFactor, CandidateMeasurement, CompetingModels, at_effect
from calib.missing.rules import RULES
from calib.problem.parameter import unit_words

MOST = 3
"""Invisible effects for which a measurement is recommended: more do not fit into a sentence."""
MANY = 5000
"""Rows of the table of gains from which it keeps, of each effect, the `KEPT` best measurements: of hundreds of effects
each has its own best sensors, and most rows are of no use for anything that is told or drawn."""
KEPT = 10
MEASURED = "measured as validation data so far"
HELD_OUT = ", validation data so far"
"""End of the name of a measured mode, or of sensors, held out for verification."""
COLUMNS = (
    "measurement", "kind", "effect", "gain", "gain_low", "gain_high", "magnitude_min", "ln_bayes", "ln_bayes_low",
    "ln_bayes_high", "chance", "words",
)  # fmt: skip
AVERAGED = (
    "These gains are averaged over the posterior of parameters and magnitudes; the range in brackets covers 8 of 10 "
    "cases."
)
USED = "Validation data that the fit uses no longer verify the result."
_ROUNDING = 1e-12
"""Share of a squared signature below which what the parameters leave of it is rounding."""
_HARDLY_SHOWN = 1000.0
"""A larger gain is of an effect that the present data hardly show, and its size says no more."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A model linearised at one posterior sample.

    Attributes
    ----------
    names : tuple of str
        Parameters, length p, including those of the effects of the model.
    prior_sd : ndarray (p,)
    slope : ndarray (n_rows, p)
        Whitened, of all measured and candidate rows, per unit of each parameter; 0 in rows that would not exist, such
        as those of a mode that cannot be identified.
    columns : ndarray (n_rows, m)
        Signatures of the effects, per unit of magnitude; for an effect of the model, its slope.
    weight : float
        Probability of the sample relative to the others.
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    slope: np.ndarray
    columns: np.ndarray
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class ExperimentalDesign:
    """Candidate measurements and the linearisations over which their gains are averaged; needs no new data.

    Attributes
    ----------
    effects : tuple of str
        Length m.
    measured : ndarray (n_rows,), bool
        Measured rows.
    measurements : tuple of CandidateMeasurement
    linearisations : tuple of Linearisation
        At posterior samples.
    competing : CompetingModels or None
        Two indistinguishable models.
    repeats : int
        Of the measurement that there is.
    band : (float, float)
        Frequencies between which it was measured, Hz; NaN where there are none.
    """

    effects: tuple[str, ...]
    measured: np.ndarray
    measurements: tuple[CandidateMeasurement, ...]
    linearisations: tuple[Linearisation, ...]
    competing: CompetingModels | None = None
    repeats: int = 1
    band: tuple[float, float] = (math.nan, math.nan)

    def sizes(self, measurement: CandidateMeasurement | None) -> np.ndarray:
        """Lengths of the projected signatures, (n_linearisations, m): expected scores of unit magnitudes."""
        rows = self.measured if measurement is None or measurement.rows is None else self.measured | measurement.rows
        scale = 1.0 if measurement is None else measurement.scale
        known = {} if measurement is None else measurement.prior_sd
        return np.array([self._sizes(linearisation, rows, scale, known) for linearisation in self.linearisations])

    def _sizes(
        self, linearisation: Linearisation, rows: np.ndarray, scale: float, known: Mapping[str, float]
    ) -> np.ndarray:
        prior = np.array(
            [min(s, known.get(n, math.inf)) for n, s in zip(linearisation.names, linearisation.prior_sd, strict=True)]
        )
        g, columns = linearisation.slope[rows] / scale * prior, linearisation.columns[rows] / scale
        information, cross = g.T @ g + np.eye(len(prior)), g.T @ columns
        whole = np.sum(columns * columns, axis=0)
        absorbed = np.zeros(len(self.effects))
        # An effect that is in the model does not absorb itself; the others have the same parameters beside them.
        for own in {name if name in linearisation.names else "" for name in self.effects}:
            others = [j for j, n in enumerate(linearisation.names) if n != own]
            of = [k for k, name in enumerate(self.effects) if (name if name in linearisation.names else "") == own]
            if others:
                beside = cross[np.ix_(others, of)]
                solved = la.solve(information[np.ix_(others, others)], beside, assume_a="pos")
                absorbed[of] = np.sum(beside * solved, axis=0)
        left = whole - absorbed
        return np.sqrt(np.where(left > _ROUNDING * whole, left, 0.0))

    def averaged(self, values: np.ndarray) -> tuple[float, float, float]:
        """Mean over linearisations with a finite value, and the quantiles of `EIGHT_OF_TEN`; NaN where none has one."""
        weights = np.array([linearisation.weight for linearisation in self.linearisations])
        known = np.isfinite(values) & (weights > 0)
        if not known.any():
            return math.nan, math.nan, math.nan
        values, weights = values[known], weights[known]
        low, high = np.quantile(values, EIGHT_OF_TEN, weights=weights, method="inverted_cdf")
        return float(np.average(values, weights=weights)), float(low), float(high)


def recommend(design: ExperimentalDesign) -> pd.DataFrame:
    """Gain of every candidate measurement for every effect, best first.

    Returns
    -------
    DataFrame
        ``measurement, kind, effect``; ``gain``: factor on the expected score of the effect, the mean over the
        linearisations, between ``gain_low`` and ``gain_high`` in 8 of 10; ``magnitude_min``: magnitude whose mean score
        then is `DecisionRules.detectable`; ``ln_bayes``: expected log Bayes factor for the true one of two competing
        models, with its range, and the ``chance`` that it is beyond 20:1 (NaN without competing models); ``words``.
    """
    now, competing = design.sizes(None), design.competing
    rows = []
    for measurement in design.measurements:
        there = design.sizes(measurement)
        bayes_factor = BayesFactor(*[math.nan] * 4) if competing is None else competing.bayes_factor(measurement)
        for k, name in enumerate(design.effects):
            with np.errstate(divide="ignore", invalid="ignore"):
                gain, low, high = design.averaged(np.where(now[:, k] > 0, there[:, k] / now[:, k], np.nan))
            size = design.averaged(there[:, k])[0]
            least = RULES.detectable / size if size > 0 else math.inf
            words = f"{measurement.name}: {score_gain_words(gain)} times the score of {name} ({low:.2g} to {high:.2g})"
            if competing is not None and name == competing.names[0]:
                words = f"{measurement.name}: {_in_words(bayes_factor, competing.names)}"
            expected = (bayes_factor.mean, bayes_factor.low, bayes_factor.high, bayes_factor.chance)
            rows.append((measurement.name, measurement.kind, name, gain, low, high, least, *expected, words))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    if competing is None:
        return table.sort_values("gain", ascending=False, ignore_index=True, kind="stable")
    # Of the rows of a measurement that of the pair comes first: its words give the Bayes factor.
    table["own"] = table["effect"] == competing.names[0]
    order = ["ln_bayes", "own", "gain"]
    return table.sort_values(order, ascending=False, ignore_index=True, kind="stable").drop(columns="own")


def with_few_rows(table: pd.DataFrame) -> pd.DataFrame:
    """The table of `recommend` as stored: of more than `MANY` rows the `KEPT` best measurements of each effect."""
    if len(table) <= MANY:
        return table
    return table[table.groupby("effect", sort=False).cumcount() < KEPT].reset_index(drop=True)


def score_gain_words(gain: float) -> str:
    """A factor on a score, such as ``2.4``."""
    return f"more than {_HARDLY_SHOWN:g}" if gain > _HARDLY_SHOWN else f"{gain:.2g}"


def _in_words(bayes_factor: BayesFactor, pair: tuple[str, str]) -> str:
    spread = f"{as_ratio(bayes_factor.low)} to {as_ratio(bayes_factor.high)}"
    right = f"beyond 20:1 with a chance of {100 * bayes_factor.chance:.0f} %"
    return f"odds of {as_ratio(bayes_factor.mean)} for the true one of {pair[0]} and {pair[1]} ({spread}), {right}"


def as_ratio(ln_bayes: float) -> str:
    """A log Bayes factor as a ratio, such as 150:1, or 1:3 against."""
    if abs(ln_bayes) >= math.log(1e4):
        return "over 10,000:1" if ln_bayes > 0 else "under 1:10,000"
    size = rounded(math.exp(abs(ln_bayes)))
    return f"{size}:1" if ln_bayes >= 0 else f"1:{size}"


def rounded(value: float) -> str:
    """Two significant digits without an exponent where that reads better."""
    return f"{float(f'{value:.2g}'):g}"


class Interval(NamedTuple):
    """95 % interval of a magnitude, in its unit."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Recommendation:
    """The best next measurement in words.

    Attributes
    ----------
    sentence : str
        With its gain and the spread of it.
    short : str
        What to measure only; empty where nothing is worthwhile.
    """

    sentence: str
    short: str = ""


def recommendation(
    table: pd.DataFrame,
    pair: tuple[str, str] | None,
    unseen: Sequence[str],
    named: Sequence[str] = (),
    intervals: Mapping[str, Interval] = MappingProxyType({}),
) -> Recommendation | None:
    """The best next measurements in words, by gain; None when none is worthwhile.

    What narrows the magnitude of a named effect comes first. Without a pair, each invisible effect has its own best
    measurement; those of the `MOST` largest gains are told, the largest first. Held-out data need no new measurement,
    but no longer verify the result once they are used: the sentence says so and also names the best new measurement.

    Parameters
    ----------
    table : DataFrame
        From `recommend`.
    pair : (str, str) or None
        Two indistinguishable effects.
    unseen : sequence of str
        Effects that are not visible; used without a pair.
    named : sequence of str
        Effects that are named; used without a pair.
    intervals : mapping from str to Interval
        Present 95 % intervals of their magnitudes, as far as they are known.
    """
    if table.empty:
        return None
    if pair is None and named:
        more = recommendation(table, None, [name for name in unseen if name not in named])
        parts = [_narrowing(table, name, intervals) for name in named]
        return Recommendation(
            " ".join([*parts, *([] if more is None else [more.sentence])]),
            " ".join(
                _narrowing_in_short(table, named, intervals)
                or ([_no_need(n) for n in named] if more is None else [more.short])
            ),
        )
    if pair is not None:
        own = table[table["effect"] == pair[0]]
        best = own.iloc[0]
        if float(best["ln_bayes"]) < RULES.credible:
            intro = f"No measurement looked at would tell {pair[0]} from {pair[1]}"
            return Recommendation(f"{intro}; the best gives {best['words']}. {AVERAGED}", f"{intro}.")
        advised = [own]
        purpose = "To tell them apart"
    else:
        wanted = [table[(table["effect"] == name) & (table["gain"] >= RULES.worthwhile)] for name in unseen]
        advised = sorted((own for own in wanted if len(own)), key=lambda own: -float(own["gain"].iloc[0]))[:MOST]
        purpose = "To see further effects"
    if not advised:
        return None
    names = list(dict.fromkeys(str(own["measurement"].iloc[0]) for own in advised))
    if not any(map(_is_held_out, names)):
        words = "; ".join(str(own["words"].iloc[0]) for own in advised)
        short = f"{purpose}, measure next: {'; or '.join(names)}."
        return Recommendation(f"{purpose}, measure next: {words}. {AVERAGED}", short)
    words = "; ".join(map(_used_or_measured, advised))
    return Recommendation(f"{purpose}, {words}. {AVERAGED} {USED}", f"{purpose}, {_in_short(names)}.")


def _narrowing(table: pd.DataFrame, name: str, intervals: Mapping[str, Interval]) -> str:
    """What narrows the magnitude of a named effect most: its standard deviation falls as its expected score rises."""
    own = table[table["effect"] == name]
    there = own[own["measurement"].str.startswith(at_effect(name)) & (own["gain"] < RULES.worthwhile)]
    little = "".join(
        f" More sensors where {name} acts add little ({gain:.3g} times its score)." for gain in there["gain"]
    )
    own = own[own["gain"] >= RULES.worthwhile]
    if own.empty:
        return f"{_no_need(name)}{little}"
    first = own.iloc[0]
    width = _widths(intervals.get(name), float(first["gain"]), str(first["measurement"]).removesuffix(HELD_OUT))
    narrower = f" Its 95 % interval is {width}." if width else ""
    return f"To narrow the magnitude of {name}, {_used_or_measured(own)}.{narrower}{little}"


def _widths(interval: Interval | None, gain: float, it: str = "it") -> str:
    """Width of an interval now and with a measurement, such as ``about 20 kg wide now, about 12 kg with it``.

    The standard deviation falls as the expected score rises. Empty where the present interval is not known.
    """
    width = math.nan if interval is None else interval.high - interval.low
    if interval is None or not (math.isfinite(width) and width > 0):
        return ""
    unit = unit_words(interval.unit)
    return f"about {rounded(width)}{unit} wide now, about {rounded(width / gain)}{unit} with {it}"


def _no_need(name: str) -> str:
    return f"{name} needs no further measurement: none looked at raises its score {RULES.worthwhile:g} times."


def _narrowing_in_short(table: pd.DataFrame, named: Sequence[str], intervals: Mapping[str, Interval]) -> list[str]:
    """The best measurement for each magnitude that needs one; those that need the same one share a sentence."""
    best: dict[str, dict[str, str]] = {}
    for name in named:
        own = table[(table["effect"] == name) & (table["gain"] >= RULES.worthwhile)]
        if len(own):
            width = _widths(intervals.get(name), float(own["gain"].iloc[0]))
            best.setdefault(str(own["measurement"].iloc[0]), {})[name] = width
    out = []
    for measurement, widths in best.items():
        *others, last = widths
        names = f"{', '.join(others)} and {last}" if others else last
        words = "; ".join(f"{name} {width}" if others else width for name, width in widths.items() if width)
        narrower = f" (95 % interval {words})" if words else ""
        out.append(f"To narrow the magnitude{'s' * bool(others)} of {names}, {_in_short([measurement])}{narrower}.")
    return out


def _in_short(names: Sequence[str]) -> str:
    """What to use and what to measure, in the order given; neighbours of one kind share their verb."""
    steps = []
    for held, group in groupby(names, key=_is_held_out):
        words = " or ".join(name.removesuffix(HELD_OUT) for name in group)
        steps.append(f"let the fit use {words}, {MEASURED}" if held else f"measure {words}")
    return "; or ".join(steps)


def _is_held_out(measurement: str) -> bool:
    return measurement.endswith(HELD_OUT)


def _used_or_measured(measurements: pd.DataFrame) -> str:
    """What to do for the best measurement; for a held-out mode, and for the best new one."""
    words, held = measurements["words"].astype(str), measurements["measurement"].astype(str).map(_is_held_out)
    further = f"measure {words[~held].iloc[0]}" if not held.all() else ""
    if not held.iloc[0]:
        return further
    use = f"let the fit use {words.iloc[0].replace(HELD_OUT, f', {MEASURED}', 1)}"
    return f"{use}, or {further}" if further else use
