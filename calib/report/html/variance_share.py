"""Section on sensitivity and the selection of parameters."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from calib.report.html.look import add_matrix, name_axis, new, number_axis, shown
from calib.report.html.numbers import fixed, flag, significant
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
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
    ("partial", "partial rank correlation", "RdBu_r", (-1.0, 1.0)),
    ("sensitivity", "Spearman's rank correlation", "RdBu_r", (-1.0, 1.0)),
    ("variance_share", "variance share (square root)", "Blues", (0.0, 1.0)),
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
    figure = new(130 + 44 * len(names), barmode="group")
    for measure, (label, colour) in MEASURES.items():
        size, floor = (
            table[f"max_{measure}"].abs().to_numpy(dtype=float),
            table[f"{measure}_floor"].to_numpy(dtype=float),
        )
        passed = size >= floor
        words = [
            shown(f"{n}, {label}: {fixed(s, 2)} (noise floor {fixed(f, 2)})")
            for n, s, f in zip(names, size, floor, strict=True)
        ]
        marker = {"color": [colour if p else "white" for p in passed], "line": {"color": colour, "width": 1.5}}
        figure.add_bar(
            x=size, y=list(range(len(names))), orientation="h", marker=marker, hovertext=words, hoverinfo="text",
            name=shown(label), showlegend=True,
        )  # fmt: skip
    figure.update_layout(
        xaxis=number_axis("largest absolute value over all responses", range=[0, 1]),
        yaxis=name_axis(names, reverse=True),
    )
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
        Plot("selection", caption, f"Bars. Selected: {', '.join(chosen) or 'none'}.", figure),
        Table("Selection of parameters", heads, rows, (4, 5)),
    ]


def _matrix(results: StudyResults) -> list[Plot]:
    found = [
        (label, colours, span, table)
        for name, label, colours, span in _MATRICES
        if (table := results.table(name, ["parameter"], others_are_numbers=True)) is not None
    ]
    if not found:
        return []
    parameters = found[0][3]["parameter"].astype(str).tolist()
    responses = [c for c in found[0][3].columns if c != "parameter"]
    labels = [_label(r) for r in responses]
    figure = new(
        max(300, 200 + 30 * len(parameters)), plot_bgcolor="#EDEDED", margin={"l": 60, "r": 20, "t": 70, "b": 90}
    )
    for k, (label, colours, span, table) in enumerate(found):
        values = table.set_index("parameter").reindex(index=parameters, columns=responses).to_numpy(dtype=float)
        cells = [[fixed(v, 2) if abs(v) >= 0.25 else "" for v in row] for row in values]
        hover = [
            [f"{p}, {r}: {fixed(v, 2)}" for r, v in zip(labels, row, strict=True)]
            for p, row in zip(parameters, values, strict=True)
        ]
        add_matrix(
            figure, values, parameters, labels, cells, colours=colours, span=span, label=label, hover=hover,
            visible=k == 0,
        )  # fmt: skip
    figure.update_layout(xaxis=name_axis(labels, tickangle=-90), yaxis=name_axis(parameters, reverse=True))
    _choose(figure, [label for label, *_ in found])
    caption = (
        "Every parameter and every response; values below 0.25 are not written. Choose the measure above the figure."
    )
    return [Plot("sensitivity-matrix", caption, f"Matrix. {_strongest(found[0][3], found[0][0], responses)}", figure)]


def _choose(figure: go.Figure, labels: list[str]) -> None:
    buttons = [
        {"label": shown(label), "method": "restyle", "args": [{"visible": [j == k for j in range(len(labels))]}]}
        for k, label in enumerate(labels)
    ]
    place = {"x": 0.0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "direction": "right", "type": "buttons"}
    figure.update_layout(updatemenus=[{**place, "buttons": buttons, "showactive": True, "pad": {"b": 8}}])


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


def _inputs(results: StudyResults) -> list[Plot]:
    table = results.table("input_correlation", ["parameter"], others_are_numbers=True)
    if table is None or len(table) < 2:
        return []
    names = table["parameter"].astype(str).tolist()
    values = table.set_index("parameter").reindex(columns=names).to_numpy(dtype=float)
    values = np.where(np.tril(np.ones_like(values, dtype=bool), -1), values, np.nan)[1:, :-1]
    figure = new(max(300, 160 + 30 * len(names)))
    cells = [[fixed(v, 2) if abs(v) >= 0.25 else "" for v in row] for row in values]
    add_matrix(
        figure, values, names[1:], names[:-1], cells, colours="RdBu_r", span=(-1.0, 1.0), label="rank correlation"
    )
    figure.update_layout(xaxis=name_axis(names[:-1], tickangle=-90), yaxis=name_axis(names[1:], reverse=True))
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    i, j = np.unravel_index(int(size.argmax()), size.shape)
    alt = f"Matrix. The largest is {fixed(values[i, j], 2)}, of {names[1:][i]} and {names[j]}."
    caption = "Rank correlation of the sampled parameters, induced by constraints; without constraints about 0."
    return [Plot("input-correlation", caption, alt, figure)]


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
