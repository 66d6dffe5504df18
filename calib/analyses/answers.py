"""The answers of the analyses, made from their results; that of an explanation is `calib.missing.verdict`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from calib.analyses.uncertainty import ASSUMED
from calib.correlation.frf.comparison import FRFComparison
from calib.correlation.modal.comparison import BEYOND, UNTESTED, WITHIN, Comparison
from calib.hypotheses.rules import RULES
from calib.inference.verdicts import identified_sentence
from calib.problem.joint import of_test
from calib.results.answer import Answer, signed

if TYPE_CHECKING:
    import pandas as pd

    from calib.analyses.fit_statistics import FitStatistics

NAMED = 6
"""Largest number of parameters or sensors named in a sentence."""
UNTRIED = "Not all neighbours of these integers were tried: another combination may fit better."
FIT = (
    "Fit the parameters that matter: calib sensitivity STUDY, then calib calibrate STUDY, or all at once: "
    "calib run STUDY."
)
RELY = "Use the model within the frequencies and limits that it was fitted in."
UNFITTED = "The model has no parameters. To fit it, bring it as matrices or as a function with parameters."
_EXPLAIN = "Find what the model lacks before it is used: calib explain STUDY."
_FINE = "Nothing calls for a calibration."


class _Compared(Protocol):
    """What is asked of `calib.analyses.compare.ComparisonResult`."""

    @property
    def table(self) -> pd.DataFrame: ...
    @property
    def mean_freq_error(self) -> float: ...
    @property
    def mean_mac(self) -> float: ...
    @property
    def noise_mac(self) -> float: ...
    @property
    def comparison(self) -> Comparison | None: ...
    @property
    def frfs(self) -> FRFComparison | None: ...
    @property
    def checks(self) -> Sequence[str]: ...
    @property
    def std_notes(self) -> Sequence[str]: ...


def of_comparison(result: _Compared) -> Answer:
    """Answer of a comparison without a fit, with the standard deviation that a fit would assume."""
    answer = _of_comparison(result)
    return replace(answer, sure=" ".join([answer.sure, *(n for n in result.std_notes if n.startswith(ASSUMED))]))


def _of_comparison(result: _Compared) -> Answer:
    found = result.comparison
    if result.frfs is not None:
        return _of_frfs(result.frfs, result.checks)
    if found is None:
        return _of_responses(result)
    agreement, tested = found.summary()
    if result.checks:
        then = _check_first(result.checks)
    elif not len(found.pairing.paired):
        what = "places and directions of the sensors" if found.measured.has_shapes else "the units of both"
        then = f"Check first: {what}, since no measured mode is one of the model's."
    elif found.far:
        then = f"Check first: the pairing and the units of {enumerated(found.far)}, far off in frequency."
    else:
        verdicts = found.where_it_fails()["verdict"]
        then = FIT if (verdicts == BEYOND).any() or not (verdicts == WITHIN).any() else _FINE
    return _compared(agreement, tested, then)


def _compared(found: str, sure: str, then: str) -> Answer:
    return Answer(found, sure, then, "sensitivity" if then == FIT else "")


def _check_first(checks: Sequence[str]) -> str:
    return f"Check first: {'; '.join(checks)}."


def _of_responses(result: _Compared) -> Answer:
    table = result.table
    words = f"The mean error of the model is {100 * result.mean_freq_error:.2f} % over {_count(len(table), 'response')}"
    known = table.dropna(subset=["error"])
    if len(known):
        worst = known.iloc[int(known["error"].abs().to_numpy().argmax())]
        words += f"; the largest is {signed(100 * worst['error'], 2)} % ({worst['response']})"
    in_std = table["error_in_std"].abs().dropna()
    if in_std.empty:
        tested, off = UNTESTED, 1
    else:
        off = int((in_std > RULES.off).sum())
        tested = f"{off} of {_count(len(in_std), 'response')} are off by more than {RULES.off:g} standard deviations."
    return _compared(f"{words}.", tested, FIT if off else _FINE)


def _of_frfs(found: FRFComparison, checks: Sequence[str]) -> Answer:
    table, lines = found.functions_table(), found.lines_table()
    worst, line = table.iloc[int(table["frac"].argmin())], lines.iloc[int(lines["in_std"].argmax())]
    in_std = float(np.sqrt((table["in_std"] ** 2 * table["lines"]).sum() / table["lines"].sum()))
    words = (
        f"Mean FRAC {table['frac'].mean():.3f} over {_count(len(table), 'FRF')}, least {worst['frac']:.3f} "
        f"({worst['response']}/{worst['reference']}); mean error {100 * table['error'].mean():.1f} %."
    )
    tested = (
        f"The error is {in_std:.3g} standard deviations in root mean square (1 for a right model), "
        f"largest at {line['freq']:.4g} Hz ({line['in_std']:.3g})."
    )
    then = _check_first(checks) if checks else FIT if in_std > RULES.off else _FINE
    return _compared(words, tested, then)


def of_sensitivity(table: pd.DataFrame, tested: str) -> Answer:
    """Answer of a sensitivity analysis by rank correlations from its selection; ``tested`` tells how sure."""
    matter = table.loc[table["measured"].astype(bool), "parameter"].tolist()
    count = f"{len(matter)} of {_count(len(table), 'parameter')} {'matters' if len(matter) == 1 else 'matter'}"
    words = f"{count}: {enumerated(matter)}." if matter else f"{count}: none moves a response beyond chance."
    selected = table.loc[table["selected"].astype(bool), "parameter"].tolist()
    without, beside = ([n for n in a if n not in b] for a, b in ((matter, selected), (selected, matter)))
    if without:
        words += f" The study leaves out {enumerated(without)}."
    if beside:
        words += f" The study also selects {enumerated(beside)}."
    then = "Fit the selected parameters: calib calibrate." if selected else "Widen the limits, or name the parameters."
    return Answer(words, tested, then, "calibrate" if selected else "")


def screening_answer(method: str, table: pd.DataFrame, tested: str) -> Answer:
    """Answer of a sensitivity analysis by Morris or Sobol; ``tested`` tells how sure."""
    size = "mu_star" if method == "morris" else "ST"
    known = table.dropna(subset=[size])
    largest = known.groupby("parameter", sort=False)[size].max().sort_values(ascending=False, kind="stable")
    order = [f"{name} ({value:.2g})" for name, value in largest.items()]
    words = f"By their largest {size}: {enumerated(order)}." if order else "No response is known, so nothing is ranked."
    then = "Name the parameters that matter in 'selection', then fit them: calib calibrate."
    return Answer(words, tested, then)


def of_fit(
    statistics: FitStatistics,
    verdicts: pd.DataFrame,
    pairs: Mapping[str, tuple[_Compared, _Compared]],
    contradictions: Sequence[str] = (),
    agreement: str = "one case",
    search: str = "",
    too_few: str = "",
) -> Answer:
    """Answer of any fit.

    Parameters
    ----------
    statistics : FitStatistics
    verdicts : DataFrame
        From `calib.inference.verdicts.parameter_verdicts`.
    pairs : mapping from str to (ComparisonResult, ComparisonResult)
        Before and after the fit, by name of the test.
    contradictions : sequence of str
        On held-out data.
    agreement : str
        See `calib.inference.agreement.Agreement`.
    search : str
        Errors where a genetic search before the fit ended, in words.
    too_few : str
        Why an explanation would refuse the data; empty where it would not. See `calib.missing.settings.too_few`.
    """
    fits = {
        True: "The calibrated model fits the data within their standard deviation",
        False: "The calibrated model does not fit the data within their standard deviation",
        None: "The calibrated model leaves too few data to see an error of it",
    }[statistics.fits]
    changes = [of_test(test, _change(*pair)) if test else _change(*pair) for test, pair in pairs.items()]
    changes += [search] if search else []
    sure = [f"The fit has p = {statistics.p_fit:.2g}.", identified_sentence(verdicts), _AGREEMENT[agreement]]
    sure += contradictions
    held = statistics.considered
    sure += [*held.loc[held["matters"].astype(bool), "words"].head(1), statistics.mesh]
    sure += [] if statistics.between is None else [statistics.between.sentence]
    if statistics.assumed:
        sure.append(f"This rests on an assumed standard deviation: {statistics.assumed}.")
    if statistics.identification.ratios_only:
        sure.append("The data see ratios only: all of them can grow by the same factor.")
    if not statistics.complete:
        sure.append(UNTRIED)
    suspected = statistics.suspects[statistics.suspects["explains"].astype(bool)]["what"].tolist()
    if suspected:
        sure.append(f"Without {suspected[0]} alone it would fit.")
    checks = [
        f"{what} in test {test}" if test else what
        for test, (before, fitted) in pairs.items()
        for what in before.checks or fitted.checks
    ]
    after = _next(statistics, verdicts, suspected, bool(contradictions), agreement, too_few)
    then = _check_first(checks) if checks else after
    command = "explain" if then.startswith(_EXPLAIN) else ""
    return Answer(f"{fits}: {'; '.join(changes)}.", " ".join(filter(None, sure)), then, command)


_AGREEMENT = {
    "one case": "",
    "one solution": "All good cases agree on one solution.",
    "several solutions": "The solution is not unique: several sets of parameters fit equally well.",
    "not settled": "Only one case reaches the best fit.",
}


def _next(
    statistics: FitStatistics,
    verdicts: pd.DataFrame,
    suspected: Sequence[str],
    contradicted: bool,
    agreement: str,
    too_few: str,
) -> str:
    """What to do after a fit; what casts most doubt comes first.

    A datum without which everything fits is no reason to doubt it before an explanation has weighed it: what a model
    lacks often shows in one mode.
    """
    own = statistics.between
    if own is not None and statistics.fits is False and not contradicted and own.p_fit > statistics.alpha:
        varying = enumerated(own.table["parameter"].unique().tolist())
        return f"Use the value that each test has of {varying}, in between_tests.csv: with these the model fits."
    if statistics.fits is False or contradicted:
        if not too_few:
            also = f" It also weighs whether the {suspected[0]} is wrong." if suspected else ""
            return f"{_EXPLAIN}{also}"
        return f"Check the {suspected[0]} before the model." if suspected else f"Measure more: {too_few}."
    if statistics.identification.ratios_only:
        return "Hold a parameter that is known, such as a mass: it settles the others."
    if statistics.fits is None:
        return "Measure more, or fit fewer parameters."
    if agreement == "not settled":
        return "Give the search more generations or cases."
    bad = verdicts.loc[verdicts["identified"].notna() & ~verdicts["identified"].fillna(True).astype(bool), "parameter"]
    if len(bad):
        which = enumerated(bad.tolist())
        return f"Do not rely on single values that are not identified: {which}; measure them apart, or leave them out."
    return RELY


def _change(before: _Compared, after: _Compared) -> str:
    label = "mean error" if before.comparison is None else "mean error of natural frequencies"
    words = f"{label} {100 * before.mean_freq_error:.2f} % -> {100 * after.mean_freq_error:.2f} %"
    if not math.isnan(after.mean_mac):
        allowed = "" if np.isnan(after.noise_mac) else f" (a perfect model: {after.noise_mac:.3f})"
        words += (
            f", mean {'MAC' if after.frfs is None else 'FRAC'} {before.mean_mac:.3f} -> {after.mean_mac:.3f}{allowed}"
        )
    return words


def enumerated(names: Sequence[str]) -> str:
    """Names in a row; of many only the first."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'s' * (number != 1)}"
