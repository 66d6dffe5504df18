"""What to measure next: how much better each further measurement would show or tell apart what may be missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.missing.evidence import CREDIBLE
from calib.missing.tables import expected_ln_bayes

WORTHWHILE = 1.2
"""Smallest factor on the expected score for which a measurement is advised."""
WITHHELD = ", withheld so far"
"""How the name of a mode ends that was measured but is kept for verification."""
COLUMNS = ("option", "kind", "effect", "gain", "phi_min", "ln_bayes", "words")


@dataclass(frozen=True, eq=False)
class Option:
    """One further measurement.

    Attributes
    ----------
    name : str
        In words.
    kind : {"sensor", "mode", "repeats", "bench"}
    rows : ndarray (n_rows,), bool or None
        Rows it adds to those that were measured.
    scale : float
        On the scatter of all rows, such as ``1/sqrt(2)`` for twice the repeats.
    prior_sd : mapping from str to float
        Standard deviations of parameters after a test of a part by itself.
    """

    name: str
    kind: str
    rows: np.ndarray | None = None
    scale: float = 1.0
    prior_sd: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Prospects:
    """What could be measured, linearised at a fitted model: no data are needed for it.

    Attributes
    ----------
    names : tuple of str
        Parameters, length p.
    prior_sd : ndarray (p,)
    slope : ndarray (n_rows, p)
        Of all that was and could be measured, whitened, per one of each parameter's own unit.
    effects : tuple of str
        Length m.
    columns : ndarray (n_rows, m)
        Their fingerprints, per unit of strength.
    measured : ndarray (n_rows,), bool
        Rows that were measured.
    options : tuple of Option
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    slope: np.ndarray
    effects: tuple[str, ...]
    columns: np.ndarray
    measured: np.ndarray
    options: tuple[Option, ...]

    def seen(self, option: Option | None) -> np.ndarray:
        """Inner products of the effects' fingerprints after projection, (m, m): lengths squared on the diagonal."""
        rows = self.measured if option is None or option.rows is None else self.measured | option.rows
        scale = 1.0 if option is None else option.scale
        prior = self.prior_sd.copy()
        for name, sd in ({} if option is None else option.prior_sd).items():
            k = self.names.index(name)
            prior[k] = min(prior[k], sd)
        g = self.slope[rows] / scale * prior
        columns = self.columns[rows] / scale
        cross = g.T @ columns
        return columns.T @ columns - cross.T @ la.solve(g.T @ g + np.eye(len(prior)), cross, assume_a="pos")


def advise(
    prospects: Prospects, strengths: Sequence[float], pair: tuple[str, str] | None = None, threshold: float = 4.0
) -> pd.DataFrame:
    """Gain of every option for every effect, best first.

    Parameters
    ----------
    prospects : Prospects
    strengths : sequence of float
        Strength of each effect at which two of them are to be told apart, length m.
    pair : (str, str), optional
        Two effects to be told apart.
    threshold : float
        Expected score of the smallest visible strength.

    Returns
    -------
    DataFrame
        ``option, kind, effect, gain, phi_min, ln_bayes, words``: factor on the expected score of the effect, its
        smallest visible strength then, and the log odds to expect between the pair (NaN without one).
    """
    now = np.sqrt(np.maximum(np.diag(prospects.seen(None)), 0.0))
    rows = []
    for option in prospects.options:
        matrix = prospects.seen(option)
        size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        odds = math.nan if pair is None else _odds(prospects.effects, matrix, strengths, pair)
        for k, name in enumerate(prospects.effects):
            gain = float(size[k] / now[k]) if now[k] > 0 else math.nan
            least = threshold / float(size[k]) if size[k] > 0 else math.inf
            words = f"{option.name}: {gain:.2g} times the score of {name}"
            if pair is not None and name == pair[0]:
                words = f"{option.name}: odds of {_in_words(odds)} between {pair[0]} and {pair[1]}"
            rows.append((option.name, option.kind, name, gain, least, odds, words))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    if pair is None:
        return table.sort_values("gain", ascending=False, ignore_index=True, kind="stable")
    # Of an option's rows the pair's own comes first: it tells the odds.
    table["own"] = table["effect"] == pair[0]
    order = ["ln_bayes", "own", "gain"]
    return table.sort_values(order, ascending=False, ignore_index=True, kind="stable").drop(columns="own")


def expected_odds(prospects: Prospects, strengths: Sequence[float], pair: tuple[str, str]) -> float:
    """Log odds to expect between two effects with what was measured."""
    return _odds(prospects.effects, prospects.seen(None), strengths, pair)


def _odds(effects: tuple[str, ...], matrix: np.ndarray, strengths: Sequence[float], pair: tuple[str, str]) -> float:
    a, b = effects.index(pair[0]), effects.index(pair[1])
    if not (matrix[a, a] > 0 and matrix[b, b] > 0):
        return 0.0
    rho = float(matrix[a, b] / math.sqrt(matrix[a, a] * matrix[b, b]))
    return expected_ln_bayes(abs(strengths[a]) * math.sqrt(float(matrix[a, a])), min(max(rho, -1.0), 1.0))


def _in_words(ln_odds: float) -> str:
    return f"{float(f'{math.exp(ln_odds):.2g}'):g}:1" if ln_odds < math.log(1e4) else "over 10,000:1"


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
        if float(best["ln_bayes"]) < CREDIBLE:
            return f"No measurement looked at would tell {pair[0]} from {pair[1]}; the best gives {best['words']}."
        told = [_with_what_is_new(own)]
        intro = "To tell them apart, measure next: "
    else:
        wanted = [table[(table["effect"] == name) & (table["gain"] >= WORTHWHILE)] for name in unseen]
        told = [_with_what_is_new(own) for own in wanted if len(own)][:3]
        intro = "To see more, measure next: "
    if not told:
        return ""
    used = " A withheld mode that is used no longer verifies the result." if any(WITHHELD in t for t in told) else ""
    return intro + "; ".join(told) + "." + used


def _with_what_is_new(options: pd.DataFrame) -> str:
    """The best of some options, and the best that is really new beside it where that is a withheld mode."""
    words, new = options["words"].astype(str), ~options["option"].astype(str).str.endswith(WITHHELD)
    if new.iloc[0] or not new.any():
        return str(words.iloc[0])
    return f"{words.iloc[0]} (new: {words[new].iloc[0]})"
