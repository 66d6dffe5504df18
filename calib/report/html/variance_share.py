"""Section on sensitivity and the selection of parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calib.report.correlation import pairs
from calib.report.html.page import Block, Picture, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, significant
from calib.report.sensitivity import MEASURES, RESPONSE_KINDS

TERMS = (
    ("Spearman's rank correlation", "monotonic dependence of a response on a parameter, −1 to 1; constraints bias it"),
    ("partial rank correlation", "the same, controlled for all other parameters"),
    (
        "variance share",
        "square root of the share of a response's variance that no other parameter explains; non-monotonic effects and "
        "interactions count",
    ),
    ("noise floor", "value that chance alone reaches in a sample of this size"),
)
_MATRICES = (
    ("partial", "partial rank correlation"),
    ("sensitivity", "Spearman's rank correlation"),
    ("variance_share", "variance share (square root)"),
)


def section(results: StudyResults) -> Section | None:
    """Measures of sensitivity, the selection and its reasons, and screenings where they were requested."""
    blocks = [*_selection(results), *_matrix(results), *_inputs(results), *_screenings(results)]
    return Section("sensitivity", "Sensitivity and selection of parameters", tuple(blocks)) if blocks else None


def _selection(results: StudyResults) -> list[Block]:
    numbers = [name for measure in MEASURES for name in (f"max_{measure}", f"{measure}_floor")]
    table = results.table("selection", ["parameter", "why"], numbers, flags=["measured", "selected"])
    if table is None:
        return []
    names = table["parameter"].astype(str).tolist()
    rows = tuple(
        (
            str(r["parameter"]),
            *(fixed(abs(r[f"max_{measure}"]), 2) for measure in MEASURES),
            "yes" if flag(r["selected"]) else "no",
            str(r["why"]),
        )
        for r in table.to_dict("records")
    )
    chosen = [n for n, s in zip(names, table["selected"], strict=True) if flag(s)]
    sentences = [Words(words, "reported") for words in results.sentences("sensitivity")]
    caption = "Largest value of each measure over all responses. Hollow bars are below their noise floor."
    heads = ("parameter", "Spearman", "partial", "variance share", "selected", "why")
    return [
        *sentences,
        Terms(TERMS),
        *results.picture("selection", caption, f"Bars. Selected: {', '.join(chosen) or 'none'}."),
        Table("Selection of parameters", heads, rows, (4, 5)),
    ]


def _matrix(results: StudyResults) -> list[Picture]:
    """The matrix of the first measure; those of the others are folded, and say how far they differ from it."""
    out: list[Picture] = []
    first: tuple[str, pd.DataFrame] | None = None
    for name, label in _MATRICES:
        table = results.table(name, ["parameter"], others_are_numbers=True)
        if table is None:
            continue
        alt = f"Matrix. {_strongest(table, label, [c for c in table.columns if c != 'parameter'])}"
        found = results.picture(name, f"{label.capitalize()} of every parameter with every response.", alt)
        values = table.set_index("parameter")
        if first is None:
            first = label, values
            out += found
        else:
            words = f"{label.capitalize()}: {_difference(values, *first)}"
            out += [replace(picture, folded=words) for picture in found]
    return out


def _difference(values: pd.DataFrame, label: str, of_first: pd.DataFrame) -> str:
    """Where the absolute values of two measures differ most."""
    one, other = values.reindex_like(of_first).abs().to_numpy(dtype=float), of_first.abs().to_numpy(dtype=float)
    apart = np.abs(one - other)
    if np.isnan(apart).all():
        return f"nothing in common with the {label}"
    at = divmod(int(np.nanargmax(apart)), apart.shape[1])
    which = f"{of_first.index[at[0]]} on {_label(str(of_first.columns[at[1]]))}"
    return f"differs most from the {label} for {which}, {fixed(one[at], 2)} instead of {fixed(other[at], 2)}"


def _strongest(table: pd.DataFrame, label: str, responses: list[str]) -> str:
    values = table.set_index("parameter")[responses].abs()
    found = []
    for name, row in values.iterrows():
        if row.notna().any():
            found.append(f"{name} on {_label(str(row.idxmax()))} ({fixed(float(row.max()), 2)})")
    return f"Largest absolute {label} of each parameter: {'; '.join(found)}."


def _label(response: str) -> str:
    for beginning, kind in RESPONSE_KINDS.items():
        if response.startswith(beginning):
            return f"{kind} {response.removeprefix(beginning)}"
    return response


def _inputs(results: StudyResults) -> list[Picture]:
    table = results.table("input_correlation", ["parameter"], others_are_numbers=True)
    if table is None or len(table) < 2:
        return []
    a, b, value = pairs(table).iloc[0]
    alt = f"Bars. The largest is {fixed(value, 2)}, of {a} and {b}."
    caption = "Rank correlation of the sampled parameters, induced by constraints; without constraints about 0."
    return results.picture("input_correlation", caption, alt)


def _screenings(results: StudyResults) -> list[Block]:
    out: list[Block] = []
    for method, size, what in (
        ("morris", "mu_star", "mean absolute elementary effect μ* (Morris)"),
        ("sobol", "ST", "total-effect index ST (Sobol)"),
    ):
        table = results.table(method, ["parameter", "response"], [size])
        if table is None:
            continue
        largest = table.loc[table.groupby("parameter", sort=False)[size].idxmax().dropna()]
        rows = tuple(
            (str(r["parameter"]), significant(r[size], 3), str(r["response"])) for r in largest.to_dict("records")
        )
        out += [Words(words, "reported") for words in results.sentences(f"sensitivity --method {method}")]
        out.append(Table(f"Largest {what} of every parameter", ("parameter", size, "response"), rows, (2,)))
    return out
