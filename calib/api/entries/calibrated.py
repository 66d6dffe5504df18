"""What a calibration has to say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from calib.analyses.added import WORDS
from calib.analyses.calibration import Calibration, Fitted, JointCalibration
from calib.analyses.case_found import FITTED, SEARCH
from calib.analyses.intervals import Intervals
from calib.analyses.pareto import FRONT, Pareto, in_words
from calib.analyses.robustness import Robustness
from calib.api.entries.compared import failed_entries, held_out, more_on_pairs, pair_entries
from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals, off
from calib.problem.parameter import unit_words
from calib.study.several import AnyStudy

ERRORS = ("rows", "rms", "of a correct model", "p")
ERRORS_TITLE = "Errors in standard deviations:"
_WHY = {
    "misfit": "the model does not fit",
    "held_out": "validation data contradict",
    "few_data": "too few data to see a model error",
    "wide": "std too large",
    "prior": "rests on the prior",
    "limit": "on its search limit",
    "constraint": "held by a constraint",
    "beside_limit": "moved by a limit of others",
    "solutions": "differs between solutions",
}
"""Why a parameter is not identified; see `calib.inference.verdicts.parameter_verdicts`."""
_COUNTS = ("asked", "solved", "reused", "infeasible", "failed")


def interval_entries(result: Intervals) -> list[Entry]:
    """Both intervals of every parameter, then where they differ and what the rest rests on."""
    heads = ("parameter", "value", "95 % interval", "linearised", "by the data")
    title = "Intervals by the profile likelihood, all other parameters fitted:"
    rows = [
        (r["parameter"], f"{r['value']:.4g}{unit_words(r['unit'])}", _ends(r, ""), _ends(r, "linear_"), r["kind"])
        for r in result.table.to_dict("records")
    ]
    each = [Words(words, when="verbose") for words in result.sentences[: len(rows)]]
    rest = [Words(words, when="always") for words in result.sentences[len(rows) :]]
    return [Rows.of(title, heads, rows, left=("by the data",), most=len(rows)), *each, *rest]


def _ends(row: Mapping[Any, Any], which: str) -> str:
    ends = (row[f"{which}lower"], row[f"{which}upper"])
    return " to ".join("limit" if end != end else f"{end:.4g}" for end in ends)


def robustness_entries(result: Robustness) -> list[Entry]:
    """Quantiles of every response, those with limits first, then what the samples rest on."""
    heads = ("response", "fitted", "measured", "std", "95 % of the samples", "allowed", "outside")
    table = result.table.to_dict("records")
    rows = [
        (
            r["response"], f"{r['fitted']:.5g}{unit_words(r['unit'])}", _known(r["measured"], "{:.5g}"),
            _known(r["std"], "{:.2g}"), f"{r['q025']:.5g} to {r['q975']:.5g}",
            f"{r['least']:.5g} to {r['most']:.5g}" if r["least"] == r["least"] else "",
            _known(100 * r["outside"], "{:.3g} %"),
        )
        for r in table
    ]  # fmt: skip
    title = "Responses over what is known of the parameters:"
    each = [Words(words, when="verbose") for words in result.sentences[: -len(result.notes)]]
    rest = [Words(words, when="always") for words in result.notes]
    return [Rows.of(title, heads, rows), *each, *rest]


def pareto_entries(result: Pareto) -> list[Entry]:
    """The ends of the front, its knee and the best by the weights, beside the fit; then what is to be said of them."""
    objectives = result.objectives.to_dict("records")
    front, rest = result.front, result.table[result.table["kind"] != FRONT]
    ends = front.index.isin(front.index[[0, -1]])
    rows = [
        (
            str(row["design"]), _mark(row, front), in_words(row["first"], objectives[0]["of"]),
            in_words(row["second"], objectives[1]["of"]), f"{row['objective']:.5g}",
        )
        for part in (front[front["knee"] | front["lowest"] | ends], rest)
        for row in part.to_dict("records")
    ]  # fmt: skip
    heads = ("design", "", *(f"{row['name']}, mean {row['of']}" for row in objectives), "objective")
    title = f"The front of {' and '.join(row['name'] for row in objectives)}:"
    return [Rows.of(title, heads, rows, left=("",)), *(Words(words, when="always") for words in result.sentences)]


def _mark(row: Mapping[Any, Any], front: pd.DataFrame) -> str:
    """What a design of the front is."""
    if row["kind"] != FRONT:
        return str(row["kind"])
    ends = ["end"] * (row["first"] in (front["first"].min(), front["first"].max()))
    return ", ".join([*["knee"] * row["knee"], *["lowest objective"] * row["lowest"], *ends])


def _known(value: float, form: str) -> str:
    return "" if value != value else form.format(value)


def calibrated_entries(study: AnyStudy, result: Fitted) -> list[Entry]:
    """A calibration against one test or several."""
    if isinstance(result, JointCalibration):
        return [
            *map(Warned, result.doubts),
            *failed_entries(result.why_failed, study),
            *_parameters(result.any),
            _by_test(result.any.best.statistics.by_test),
            *(Words(words) for words in result.sentences if words not in {*result.doubts, result.why_failed}),
            *_retried(result.any),
            *suspect_rows(result.any.best.statistics.suspects),
            Rows.of(ERRORS_TITLE, ("test", "data", *ERRORS), _of_tests(result), left=("data",)),
        ]
    best, held_out_words = result.best, list(held_out(study))
    out: list[Entry] = [
        *map(Warned, dict.fromkeys((*result.doubts, *best.answer.warnings))),
        *failed_entries(result.why_failed, study),
        *_retried(result),
        *_parameters(result),
        *_changes(result),
    ]
    if result.errors is not None and held_out_words:
        rows = [(WORDS[r["group"]], *errors_row(r)) for r in result.errors.to_dict("records")]
        out.append(Rows.of(ERRORS_TITLE, ("data", *ERRORS), rows))
    told = {*result.doubts, *best.answer.warnings, *result.contradictions, result.why_failed}
    out += [Words(sentence) for sentence in result.sentences if sentence not in told]
    out += [
        *suspect_rows(best.statistics.suspects),
        *map(Words, held_out_words),
        _ends_of_cases(result),
        _cases(result),
        *_points(result),
        pair_entries(best.answer, f"After calibration (case {best.name}):", when="verbose"),
        *more_on_pairs(best.answer),
    ]
    return out


def errors_row(row: Mapping[Any, Any]) -> tuple[str, ...]:
    """One row of `ERRORS`."""
    return str(row["rows"]), decimals(row["rms"], 2), decimals(row["expected"], 2), f"{row['p']:.2g}"


def suspect_rows(table: pd.DataFrame) -> Iterator[Rows]:
    """Single data whose removal would make the model fit."""
    guilty = table[table["explains"].astype(bool)]
    rows = [
        (r["what"], str(r["rows"]), decimals(r["chi2"], 1), f"{r['p']:.2g}", f"{r['p_fit_without']:.2g}")
        for r in guilty.to_dict("records")
    ]
    heads = ("left out", "rows", "lowers the sum of squares by", "p", "p of the fit without")
    yield Rows.of("The model fits without any one of these (by a linear estimate):", heads, rows, most=4)


def _of_tests(result: JointCalibration) -> Iterator[tuple[str, ...]]:
    for test, one in result.tests.items():
        for r in [] if one.errors is None else one.errors.to_dict("records"):
            yield test, WORDS[r["group"]], *errors_row(r)


def _retried(result: Calibration) -> list[Words]:
    again = count(result.retried, "point")
    why = f"Evaluated again: {again} at which an earlier process died or ran out of memory or time_limit."
    return [Words(why, when="always")] if result.retried else []


def _parameters(result: Calibration) -> Iterator[Rows]:
    """The fitted parameters, each with whether the data determine it."""
    best, rows, reasons = result.best, [], []
    for r in result.verdicts.to_dict("records"):
        spread = "" if pd.isna(r["spread"]) else f"{100 * r['spread']:.0f} %"
        std = "–" if r["parameter"] in best.statistics.whole else "" if pd.isna(r["std"]) else f"{r['std']:.3g}"
        unit = unit_words(r["unit"])
        why = [_WHY[reason] for reason in r["not_identified"].split(", ") if reason]
        why += [_WHY["limit"]] if r["on_limit"] and _WHY["limit"] not in why else []
        known = "" if pd.isna(r["identified"]) else "yes" if r["identified"] else "no"
        remark = f"{known}: {', '.join(why)}" if why else known
        numbers = (f"{r['value']:.5g}{unit}", std, f"{r['needed']:.3g}", f"{100 * r['ratio']:.0f} %")
        rows.append((r["parameter"], *numbers, spread, remark))
        reasons.append((r["parameter"], r["sentence"]))
    heads = ("parameter", f"value in {best.name}", "std", "needed", "of range", "spread", "identified")
    yield Rows.of("", heads, rows, left=("identified",), most=20)
    if (wide := result.with_misfit) is not None:
        title = "95 % intervals of the fit alone, and with what the model lacks, which may have pulled parameters:"
        both = [_both_intervals(r) for r in wide.to_dict("records")]
        yield Rows.of(title, ("parameter", "fit alone", "with the misfit"), both, most=20)
    yield Rows.of("Why:", ("parameter", "verdict"), reasons, left=("verdict",), when="verbose")


def _both_intervals(r: Mapping[Any, Any]) -> tuple[str, str, str]:
    unit = unit_words(r["unit"])
    alone, wide = (f"{r['low' + more]:.5g} to {r['high' + more]:.5g}{unit}" for more in ("", "_unexplained"))
    return str(r["parameter"]), alone, wide


def _by_test(table: pd.DataFrame) -> Rows:
    """Standard deviation of every parameter from each test alone and from all, and that of its prior."""
    tests = list(dict.fromkeys(table["test"]))
    rows = []
    for name, own in table.groupby("parameter", sort=False):
        std = own.set_index("test")["std"]
        rows.append((str(name), f"{own['prior_sd'].iloc[0]:.3g}", *(f"{std[test]:.3g}" for test in tests)))
    title = "Standard deviations from the data of each test alone, at the joint fit:"
    return Rows.of(title, ("parameter", "prior", *tests), rows, most=20)


def _changes(result: Calibration) -> Iterator[Rows]:
    """Every measured mode or response before and after; on request where nothing is held out."""
    if result.modes is not None:
        stages = [stage for stage in ("initial", "before", "after") if f"error_{stage}" in result.modes]
        rows = [
            (
                _named(r, "mode"),
                *(decimals(r[f"freq_{stage}"], 3) for stage in ("measured", *stages)),
                *(off(r[f"error_{s}"]) for s in stages),
                *(decimals(r[f"mac_{stage}"], 3) for stage in stages),
            )
            for r in result.modes.to_dict("records")
        ]
        heads = [f"{kind} {stage}" for kind in ("error", "MAC") for stage in stages]
        of = _FREQUENCIES[str(result.modes["freq_kind"].iloc[0])]
        title = f"{of} of every measured mode, and their errors:"
        if result.modes["held_out"].any():
            title = title[:-1] + "; MAC over the sensors used, of validation modes over all:"
        yield Rows.of(title, ("mode", "measured Hz", *stages, *heads), rows)
    elif result.responses is not None:
        rows = [
            (
                _named(r, "response"),
                *(f"{r[stage]:.6g}" for stage in ("measured", "before", "after")),
                *(off(r[f"error_{s}"]) for s in ("before", "after")),
            )
            for r in result.responses.to_dict("records")
        ]
        heads = ["response", "measured", "before", "after", "error before", "error after"]
        yield Rows.of("Every measured response:", heads, rows)
    else:
        yield pair_entries(result.best.answer, "After calibration:")


_FREQUENCIES = {
    "natural": "Natural frequencies (|lambda|/2pi of the eigenvalue lambda)",
    "damped": "Damped frequencies (Im lambda/2pi of the eigenvalue lambda)",
}


def _named(row: Mapping[Any, Any], what: str) -> str:
    return str(row[what]) + (" (validation)" if row["held_out"] else "")


def _cases(result: Calibration) -> Rows:
    rows = [
        (
            c.name,
            "" if c.search is None else f"{c.search.misfit:.5g}",
            "" if c.search is None else f"{c.search_full_order:.5g}",
            f"{c.result.misfit:.5g}",
            *(str(getattr(c.result, name)) for name in _COUNTS),
            f"{c.result.seconds:.0f} s",
        )
        for c in result.cases
    ]
    return Rows.of("Cases:", ("case", "search", "at full order", "reported", *_COUNTS, "time"), rows, when="verbose")


def _ends_of_cases(result: Calibration) -> Rows:
    """Errors where each search ended and after least squares: either may have the lower ones."""
    modal, rows = result.modes is not None, []
    for case in result.cases:
        if case.search is not None and case.statistics.fit is not None:
            both = case.points.set_index("point").loc[[SEARCH, FITTED]]
            mac = [decimals(value, 4) for value in both["mean_mac"]] if modal else []
            errors = [f"{100 * value:.2f} %" for value in both["mean_error"]]
            rows.append((case.name, *errors, *mac, *(f"{value:.4g}" for value in both["objective"])))
    kinds = ("error", "MAC", "objective") if modal else ("error", "objective")
    title = f"Mean errors of {'natural frequencies and MAC' if modal else 'responses'}, by search and by least squares:"
    return Rows.of(title, ("case", *(f"{kind} {by}" for kind in kinds for by in ("search", "fit"))), rows)


def _points(result: Calibration) -> Iterator[Rows]:
    """Objective of the search and sum of squares, at the end of the searches and of least squares."""
    rows = [
        (r["case"], r["point"], *(f"{r[name]:.5g}" for name in ("objective", "sum_of_squares", "prior", "total")))
        for case in result.cases
        if case.search is not None and case.statistics.fit is not None
        for r in case.points.to_dict("records")
    ]
    title = "What the search minimises (objective) and what least squares minimises (total), at the end of each:"
    yield Rows.of(
        title, ("case", "point", "objective", "sum of squares", "prior", "total"), rows, left=("point",), when="verbose"
    )
