"""Section on the misfit by comparison, mode, sensor and response, in standard deviations."""

from __future__ import annotations

import pandas as pd

from calib.report.html import limits
from calib.report.html.frf import misfit_picture
from calib.report.html.page import Block, Picture, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import chance, counted, fixed, flag, significant
from calib.report.where import sensor_rms


def section(results: StudyResults) -> Section | None:
    """Comparisons over their standard deviations, worst first, and residuals of the fit by mode, kind and sensor."""
    blocks = [
        *limits.key(results),
        *_worst(results),
        *_kinds(results),
        *_sensors(results),
        *_responses(results),
        *misfit_picture(results),
        *_suspects(results),
    ]
    return Section("fails", "Where the model fails", tuple(blocks)) if blocks else None


def _suspects(results: StudyResults) -> list[Block]:
    """Suspect data, without any one of which all other data fit.

    Calibration and explanation both fit the base model to the same data: a suspect of both is told once.
    """
    numbers = ["rows", "chi2", "p", "p_fit_without"]
    tables = [
        table[table["explains"].map(flag)]
        for name in ("suspects_explained", "suspects_calibrated")
        if (table := results.table(name, ["what"], numbers, flags=["explains"])) is not None
    ]
    suspects = pd.concat(tables).drop_duplicates("what") if tables else pd.DataFrame()
    rows = tuple(
        (str(r["what"]), fixed(r["rows"], 0), *(significant(r[n], 3) for n in numbers[1:]))
        for r in suspects.to_dict("records")
    )
    heads = ("excluded", "rows", "reduction of the sum of squares", "p", "p of the fit without it")
    caption = "Suspect data: without one of these the base model fits all others, to first order"
    return [Table(caption, heads, rows)] if rows else []


def _worst(results: StudyResults) -> list[Block]:
    columns = ["value", "in_std"]
    tables = {
        s: t
        for s in results.stages
        if (t := results.table(f"where_it_fails_{s}", ["kind", "what", "verdict"], columns, if_there=["limit"]))
        is not None
    }
    if not tables:
        return []
    sentences = [Words(words, "reported") for words in results.sentences("compare")[-1:]]
    if sentences:
        sentences.insert(0, Words("Before calibration, at the values of the study:"))
    stages = {stage: results.in_words(stage) for stage in tables}
    newest = list(tables)[-1]
    in_std = pd.concat({s: t.set_index(["kind", "what"])["in_std"] for s, t in tables.items()}, axis=1)
    limited = "limit" in tables[newest]  # a table of an earlier version lacks it
    rows = tuple(
        (
            f"{r['kind']} {r['what']}",
            *(fixed(in_std.loc[(r["kind"], r["what"]), stage], 2) for stage in stages),
            *([fixed(r["limit"], 2)] if limited else []),
            significant(r["value"], 3),
            str(r["verdict"]),
        )
        for r in tables[newest].to_dict("records")
    )
    own = ["its limit, σ"] if limited else []
    heads = ("comparison", *(f"{words}, σ" for words in stages.values()), *own, "value", "verdict")
    caption = f"Every comparison in standard deviations; limit, value, verdict and order: {stages[newest]}"
    return [*sentences, *_worst_picture(results, tables), Table(caption, heads, rows, (len(heads) - 1,))]


def _worst_picture(results: StudyResults, tables: dict[str, pd.DataFrame]) -> list[Picture]:
    first = next(iter(tables.values())).dropna(subset=["in_std"])
    if first.empty:
        return []
    worst = first.sort_values("in_std", ascending=False, kind="stable").iloc[0]
    words = f"{worst['kind']} {worst['what']}, {fixed(worst['in_std'], 1)} times its standard deviation"
    caption = "The worst comparisons. Dashed: the average of a correctly specified model."
    return results.picture("where_it_fails", caption, f"Dots. The worst comparison is {words}.")


def _kinds(results: StudyResults) -> list[Picture]:
    table = results.table("misfit_kinds", ["stage", "mode", "kind"], ["chi2", "dof", "p"])
    if table is None:
        return []
    base = table[table["stage"] == "base"].replace({"kind": {"freq": "frequency"}}).sort_values("p")
    worst = ", ".join(f"{r['kind']} of {r['mode']} (p {chance(r['p'])})" for r in base.head(3).to_dict("records"))
    caption = (
        "Residuals after the fit. The cells hold χ² over its degrees of freedom ν, about 1 for a correctly specified "
        "model. Of one frequency, which the parameters follow, less than one degree of freedom is left. The darker a "
        "cell, the less noise alone explains it. A dash: too few degrees of freedom."
    )
    alt = f"Matrix. The least likely misfits of the base model: {worst}."
    return results.picture("where_it_fails_sigma", caption, alt)


def _sensors(results: StudyResults) -> list[Picture]:
    table = results.sensor_misfit
    if table is None or not (table["stage"] == "base").any():
        return []
    found = sensor_rms(table[table["stage"] == "base"]).dropna()
    words = [f"{r['sensor']}: {fixed(r['rms'], 2)} times its standard deviation" for r in found.to_dict("records")]
    alt = f"Misfit at {counted(len(found), 'sensor')}. The worst: {'; '.join(words[:3])}."
    caption = "Misfit of the shapes at the sensors over all modes, calibrated base model, in standard deviations σ."
    return results.picture("sensor_misfit", f"{caption} {results.axes}", alt)


def _responses(results: StudyResults) -> list[Picture]:
    table = results.table("response_misfit", ["stage", "response"], ["residual"])
    if table is None:
        return []
    base = table[table["stage"] == "base"].set_index("response")["residual"].abs()
    worst = f"{base.idxmax()}, {fixed(base.max(), 1)} σ" if len(base) else "unknown"
    caption = "Residual of every response after the fit, in standard deviations σ."
    return results.picture("response_misfit", caption, f"Bars. The largest of the base model is {worst}.")
