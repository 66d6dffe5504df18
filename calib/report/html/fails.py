"""Section on the misfit by comparison, mode, sensor and response, in standard deviations."""

from __future__ import annotations

import numpy as np
import pandas as pd
from plotly.subplots import make_subplots

from calib.report.html.compared import COLOURS
from calib.report.html.look import PATTERNS, add_matrix, filled, name_axis, new, number_axis, shown
from calib.report.html.numbers import chance, fixed, flag, significant
from calib.report.html.page import Block, Plot, Section, Table, Words
from calib.report.html.space import AXES_NOTE, add_dots, new_space
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.mesh import rest_lines
from calib.report.misfit import KINDS
from calib.report.misfit import STAGES as MODELS
from calib.report.style import REST, added
from calib.report.where import sensor_rms

WORST = 15
_MOST = 16.0
"""Upper end of the colour scale of -log10 p."""
_LEAST_DOF = 0.5


def section(results: StudyResults) -> Section | None:
    """Comparisons over their standard deviations, worst first, and residuals of the fit by mode, kind and sensor."""
    blocks = [*_worst(results), *_kinds(results), *_sensors(results), *_responses(results), *_suspects(results)]
    return Section("fails", "Where the model fails", tuple(blocks)) if blocks else None


def _suspects(results: StudyResults) -> list[Block]:
    """Suspect data, without any one of which all other data fit: of the calibration and of the explanation."""
    blocks: list[Block] = []
    for name, which in (("suspects_calibrated", "the calibrated model"), ("suspects_explained", "the base model")):
        table = results.table(name, ["what"], ["rows", "chi2", "p", "p_fit_without"], flags=["explains"])
        suspects = [] if table is None else table[table["explains"].map(flag)].to_dict("records")
        rows = tuple(
            (str(r["what"]), fixed(r["rows"], 0), *(significant(r[n], 3) for n in ("chi2", "p", "p_fit_without")))
            for r in suspects
        )
        heads = ("excluded", "rows", "reduction of the sum of squares", "p", "p of the fit without it")
        if rows:
            caption = f"Suspect data: without any one of these {which} fits all other data, to first order"
            blocks.append(Table(caption, heads, rows))
    return blocks


def _worst(results: StudyResults) -> list[Block]:
    columns = ["value", "in_std"]
    tables = {
        s: t
        for s in STAGES
        if (t := results.table(f"where_it_fails_{s}", ["kind", "what", "verdict"], columns)) is not None
    }
    if not tables:
        return []
    sentences = [Words(words, "reported") for words in results.sentences("compare")[-1:]]
    newest = list(tables)[-1]
    rows = tuple(
        (f"{r['kind']} {r['what']}", significant(r["value"], 3), fixed(r["in_std"], 1), str(r["verdict"]))
        for r in tables[newest].to_dict("records")
    )
    heads = ("comparison", "value", "in standard deviations", "verdict")
    caption = f"Every comparison {newest} calibration, worst first"
    return [*sentences, *_worst_plot(tables), Table(caption, heads, rows, (3,))]


def _worst_plot(tables: dict[str, pd.DataFrame]) -> list[Plot]:
    sizes = {
        stage: pd.Series(
            table["in_std"].to_numpy(), [f"{k} {w}" for k, w in zip(table["kind"], table["what"], strict=True)]
        )
        for stage, table in tables.items()
    }
    first = next(iter(sizes.values())).dropna()
    if first.empty:
        return []
    names = list(first.sort_values(ascending=False, kind="stable").index[:WORST])
    figure = new(110 + 30 * len(names), barmode="group")
    for stage, size in sizes.items():
        values = size.reindex(names).to_numpy(dtype=float)
        words = [
            shown(f"{n}, {stage}: {fixed(v, 1)} times its standard deviation")
            for n, v in zip(names, values, strict=True)
        ]
        figure.add_bar(
            x=values, y=list(range(len(names))), orientation="h", name=f"{stage} calibration", hovertext=words,
            hoverinfo="text", showlegend=True,
            marker=filled(COLOURS[stage], PATTERNS[stage]),
        )  # fmt: skip
    figure.add_vline(x=1.0, line={"color": "black", "dash": "dash", "width": 1})
    figure.update_layout(
        xaxis=number_axis("in standard deviations", type="log", dtick=1),
        yaxis=name_axis(names, reverse=True),
    )
    worst = f"{names[0]}, {fixed(first[names[0]], 1)} times its standard deviation"
    caption = f"The {len(names)} worst comparisons. Dashed: the average of a correctly specified model."
    return [Plot("worst", caption, f"Bars. The worst comparison is {worst}.", figure)]


def _kinds(results: StudyResults) -> list[Block]:
    table = results.table("misfit_kinds", ["stage", "mode", "kind"], ["chi2", "dof", "p"])
    if table is None:
        return []
    table = table.replace({"kind": {"freq": "frequency"}})
    present = list(dict.fromkeys(table["kind"]))
    kinds = [*(k for k in KINDS if k in present), *(k for k in present if k not in KINDS)]
    modes, stages = list(dict.fromkeys(table["mode"])), [s for s in MODELS if (table["stage"] == s).any()]
    name = " + ".join(results.explanation.get("chosen", []))
    titles = ["base model, calibrated" if s == "base" else added(s, name) for s in stages]
    look = new(150 + 34 * max(len(modes), 4), plot_bgcolor="#EDEDED", margin={"l": 60, "r": 20, "t": 70, "b": 50})
    figure = make_subplots(1, len(stages), subplot_titles=[shown(t) for t in titles], shared_yaxes=True, figure=look)
    for k, stage in enumerate(stages):
        rows = table[table["stage"] == stage].set_index(["mode", "kind"])
        rows = rows.reindex(pd.MultiIndex.from_product([modes, kinds]))
        chi2, dof, p = (rows[c].to_numpy(dtype=float).reshape(len(modes), len(kinds)) for c in ("chi2", "dof", "p"))
        with np.errstate(divide="ignore", invalid="ignore"):
            unlikely = np.minimum(-np.log10(p), _MOST) + 0.0
            ratio = np.where(dof >= _LEAST_DOF, chi2 / dof, np.nan)
        cells = [[fixed(v, 0 if v >= 10 else 2) for v in row] for row in ratio]
        hover = [
            [f"{m}, {kind}: χ²/ν {c}, p {chance(v)}" for kind, c, v in zip(kinds, line, chances, strict=True)]
            for m, line, chances in zip(modes, cells, p, strict=True)
        ]
        add_matrix(
            figure, unlikely, modes, kinds, cells, colours="OrRd", span=(0.0, _MOST), label="−log₁₀ p", hover=hover,
            bar=k == 0, row=1, col=k + 1,
        )  # fmt: skip
    for k in range(len(stages)):
        figure.update_layout({f"xaxis{k + 1 if k else ''}": name_axis(kinds)})
        figure.update_layout({f"yaxis{k + 1 if k else ''}": name_axis(modes, "" if k else "mode", reverse=True)})
    base = table[table["stage"] == "base"].sort_values("p")
    worst = ", ".join(f"{r['kind']} of {r['mode']} (p {chance(r['p'])})" for r in base.head(3).to_dict("records"))
    caption = (
        "Residuals after the fit. The cells hold χ² over its degrees of freedom ν, about 1 for a correctly specified "
        "model; the darker a cell, the less noise alone explains it. A dash: too few degrees of freedom."
    )
    return [Plot("misfit-kinds", caption, f"Matrix. The least likely misfits of the base model: {worst}.", figure)]


def _sensors(results: StudyResults) -> list[Block]:
    table = results.table("sensor_misfit", ["stage", "mode", "sensor", "direction"], ["x", "y", "z", "re", "im"])
    if table is None or not (table["stage"] == "base").any():
        return []
    found = sensor_rms(table[table["stage"] == "base"]).dropna()
    if found.empty:
        return []
    points, rms = found[["x", "y", "z"]].to_numpy(dtype=float), found["rms"].to_numpy(dtype=float)
    words = [f"{r['sensor']}: {fixed(r['rms'], 2)} times its standard deviation" for r in found.to_dict("records")]
    figure = new_space(rest_lines(results.folder), points)
    largest = max(3.0, float(rms.max()))
    marker = {
        "color": rms, "colorscale": "YlOrRd", "cmin": 0.0, "cmax": largest, "size": 5.0 + 15.0 * rms / largest,
        "line": {"color": "black", "width": 1}, "colorbar": {"title": {"text": "rms, σ"}, "thickness": 14},
    }  # fmt: skip
    add_dots(figure, points, words, "sensors", marker)
    alt = f"Misfit at {len(found)} sensors. The worst: {'; '.join(words[:3])}."
    caption = "Misfit of the shapes at the sensors over all modes, calibrated base model, in standard deviations σ."
    return [Plot("sensor-misfit", f"{caption} {AXES_NOTE}", alt, figure)]


def _responses(results: StudyResults) -> list[Block]:
    table = results.table("response_misfit", ["stage", "response"], ["residual"])
    if table is None:
        return []
    names, name = list(dict.fromkeys(table["response"])), " + ".join(results.explanation.get("chosen", []))
    figure = new(380, barmode="group")
    for stage, look in (("base", "before"), ("explained", "after"), ("attempt", "attempt")):
        rows = table[table["stage"] == stage].set_index("response")["residual"]
        if rows.empty:
            continue
        values = rows.reindex(names).to_numpy(dtype=float)
        title = "base model, calibrated" if stage == "base" else added(stage, name)
        figure.add_bar(
            x=list(range(len(names))), y=values, name=shown(title), showlegend=True, hoverinfo="text",
            hovertext=[shown(f"{n}, {title}: {fixed(v, 2, sign=True)}") for n, v in zip(names, values, strict=True)],
            marker=filled(COLOURS.get(look, REST), PATTERNS[look]),
        )  # fmt: skip
    figure.update_layout(xaxis=name_axis(names, tickangle=-90), yaxis=number_axis("residual, σ"))
    base = table[table["stage"] == "base"].set_index("response")["residual"].abs()
    worst = f"{base.idxmax()}, {fixed(base.max(), 1)} σ" if len(base) else "unknown"
    caption = "Residual of every response after the fit, in standard deviations σ."
    return [Plot("response-misfit", caption, f"Bars. The largest of the base model is {worst}.", figure)]
