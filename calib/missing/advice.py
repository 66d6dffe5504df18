"""What to measure next: how much better each further measurement would show or tell apart what may be missing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.missing.option import Option
from calib.missing.rivals import EIGHT_OF_TEN, Odds, Rivals
from calib.missing.rules import RULES

WORTHWHILE = 1.2
"""Smallest factor on the expected score for which a measurement is advised."""
WITHHELD = ", withheld so far"
"""How the name of a mode ends that was measured but is kept for verification."""
COLUMNS = (
    "option", "kind", "effect", "gain", "gain_low", "gain_high", "phi_min", "ln_bayes", "ln_bayes_low",
    "ln_bayes_high", "chance", "words",
)  # fmt: skip
AVERAGED = (
    "All this is averaged over what parameters and strengths may be, the range in brackets holds in 8 of 10 cases."
)


@dataclass(frozen=True, eq=False)
class View:
    """A model linearised at one point of what its parameters may be.

    Attributes
    ----------
    names : tuple of str
        Parameters, length p; with those of the effects that the model has.
    prior_sd : ndarray (p,)
    slope : ndarray (n_rows, p)
        Of all that was and could be measured, whitened, per one of each parameter's own unit; 0 in rows that would not
        be there, such as those of a mode that cannot be identified.
    columns : ndarray (n_rows, m)
        Fingerprints of the effects, per unit of strength. That of an effect that the model has is its own slope.
    weight : float
        How probable the point is beside the others.
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    slope: np.ndarray
    columns: np.ndarray
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Prospects:
    """What could be measured, seen from everything that the model may be: no data are needed for it.

    Attributes
    ----------
    effects : tuple of str
        Length m.
    measured : ndarray (n_rows,), bool
        Rows that were measured.
    options : tuple of Option
    views : tuple of View
        At points of the posterior.
    rivals : Rivals or None
        Two models to be told apart.
    """

    effects: tuple[str, ...]
    measured: np.ndarray
    options: tuple[Option, ...]
    views: tuple[View, ...]
    rivals: Rivals | None = None

    def sizes(self, option: Option | None) -> np.ndarray:
        """Lengths of the effects' fingerprints after projection, (n_views, m): expected scores of unit strengths."""
        rows = self.measured if option is None or option.rows is None else self.measured | option.rows
        scale = 1.0 if option is None else option.scale
        known = {} if option is None else option.prior_sd
        return np.array([self._sizes(view, rows, scale, known) for view in self.views])

    def _sizes(self, view: View, rows: np.ndarray, scale: float, known: Mapping[str, float]) -> np.ndarray:
        prior = np.array([min(s, known.get(n, math.inf)) for n, s in zip(view.names, view.prior_sd, strict=True)])
        g, columns = view.slope[rows] / scale * prior, view.columns[rows] / scale
        information, cross = g.T @ g + np.eye(len(prior)), g.T @ columns
        whole = np.sum(columns * columns, axis=0)
        out = np.empty(len(self.effects))
        for k, name in enumerate(self.effects):
            others = [j for j, n in enumerate(view.names) if n != name]
            own = cross[others, k]
            follow = la.solve(information[np.ix_(others, others)], own, assume_a="pos") if others else own
            out[k] = math.sqrt(max(whole[k] - own @ follow, 0.0))
        return out

    def averaged(self, values: np.ndarray) -> tuple[float, float, float]:
        """Mean over the views where a value is known, and the levels of `EIGHT_OF_TEN`; NaN where none is."""
        weights = np.array([view.weight for view in self.views])
        known = np.isfinite(values) & (weights > 0)
        if not known.any():
            return math.nan, math.nan, math.nan
        values, weights = values[known], weights[known]
        low, high = np.quantile(values, EIGHT_OF_TEN, weights=weights, method="inverted_cdf")
        return float(np.average(values, weights=weights)), float(low), float(high)


def advise(prospects: Prospects, threshold: float = 4.0) -> pd.DataFrame:
    """Gain of every option for every effect, best first.

    Parameters
    ----------
    prospects : Prospects
    threshold : float
        Expected score of the smallest visible strength.

    Returns
    -------
    DataFrame
        ``option, kind, effect``; ``gain``: factor on the expected score of the effect, the mean over the views, between
        ``gain_low`` and ``gain_high`` in 8 of 10; ``phi_min``: strength whose mean score then is the threshold;
        ``ln_bayes``: log odds to expect for the true one of two rivals, with their range, and the ``chance`` that they
        are beyond 20:1 (NaN without rivals); ``words``.
    """
    now, rivals = prospects.sizes(None), prospects.rivals
    rows = []
    for option in prospects.options:
        there = prospects.sizes(option)
        odds = Odds(*[math.nan] * 4) if rivals is None else rivals.odds(option)
        for k, name in enumerate(prospects.effects):
            with np.errstate(divide="ignore", invalid="ignore"):
                gain, low, high = prospects.averaged(np.where(now[:, k] > 0, there[:, k] / now[:, k], np.nan))
            size = prospects.averaged(there[:, k])[0]
            least = threshold / size if size > 0 else math.inf
            words = f"{option.name}: {gain:.2g} times the score of {name} ({low:.2g} to {high:.2g})"
            if rivals is not None and name == rivals.names[0]:
                words = f"{option.name}: {_in_words(odds, rivals.names)}"
            told = (odds.mean, odds.low, odds.high, odds.chance)
            rows.append((option.name, option.kind, name, gain, low, high, least, *told, words))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    if rivals is None:
        return table.sort_values("gain", ascending=False, ignore_index=True, kind="stable")
    # Of an option's rows the pair's own comes first: it tells the odds.
    table["own"] = table["effect"] == rivals.names[0]
    order = ["ln_bayes", "own", "gain"]
    return table.sort_values(order, ascending=False, ignore_index=True, kind="stable").drop(columns="own")


def _in_words(odds: Odds, pair: tuple[str, str]) -> str:
    spread = f"{_as_odds(odds.low)} to {_as_odds(odds.high)}"
    right = f"beyond 20:1 with a chance of {100 * odds.chance:.0f} %"
    return f"odds of {_as_odds(odds.mean)} for the true one of {pair[0]} and {pair[1]} ({spread}), {right}"


def _as_odds(ln_odds: float) -> str:
    """Such as 150:1, or 1:3 where they are against it."""
    if abs(ln_odds) >= math.log(1e4):
        return "over 10,000:1" if ln_odds > 0 else "under 1:10,000"
    size = f"{float(f'{math.exp(abs(ln_odds)):.2g}'):g}"
    return f"{size}:1" if ln_odds >= 0 else f"1:{size}"


def advice_sentence(table: pd.DataFrame, pair: tuple[str, str] | None, unseen: Sequence[str]) -> str:
    """The best next measurement in a sentence; empty when none is worthwhile.

    A withheld mode needs no measurement, but used it verifies nothing any more: the sentence says so and names what is
    best of the really new measurements beside it.

    Parameters
    ----------
    table : DataFrame
        From `advise`.
    pair : (str, str) or None
        Two effects to be told apart.
    unseen : sequence of str
        Effects that are not visible, for the advice without a pair.
    """
    if table.empty:
        return ""
    if pair is not None:
        own = table[table["effect"] == pair[0]]
        best = own.iloc[0]
        if float(best["ln_bayes"]) < RULES.credible:
            intro = f"No measurement looked at would tell {pair[0]} from {pair[1]}"
            return f"{intro}; the best gives {best['words']}. {AVERAGED}"
        told = [_with_what_is_new(own)]
        intro = "To tell them apart, measure next: "
    else:
        wanted = [table[(table["effect"] == name) & (table["gain"] >= WORTHWHILE)] for name in unseen]
        told = [_with_what_is_new(own) for own in wanted if len(own)][:3]
        intro = "To see more, measure next: "
    if not told:
        return ""
    used = " A withheld mode that is used no longer verifies the result." if any(WITHHELD in t for t in told) else ""
    return f"{intro}{'; '.join(told)}. {AVERAGED}{used}"


def _with_what_is_new(options: pd.DataFrame) -> str:
    """The best of some options, and the best that is really new beside it where that is a withheld mode."""
    words, new = options["words"].astype(str), ~options["option"].astype(str).str.endswith(WITHHELD)
    if new.iloc[0] or not new.any():
        return str(words.iloc[0])
    return f"{words.iloc[0]} (new: {words[new].iloc[0]})"
