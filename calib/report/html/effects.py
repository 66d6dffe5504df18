"""Section on the candidate effects, ranked, and on local perturbations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from plotly.subplots import make_subplots

from calib.report.explanation import LEAST_BAYES_FACTOR, ranked
from calib.report.html.look import add_matrix, filled, name_axis, new, number_axis, shown, wrapped
from calib.report.html.numbers import counted, fixed, flag, significant, with_unit
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.html.space import AXES_NOTE, add_dots, new_space
from calib.report.html.study_results import StudyResults
from calib.report.mesh import rest_lines
from calib.report.style import BLACK, BLUE, GREY, ORANGE, REST, SKY

NUMBERS = (
    "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min", "plausible", "largest",
    "ln_bayes", "ln_bayes_third", "ln_bayes_triple", "model_probability", "held_out_gain",
)  # fmt: skip
TERMS = (
    ("z", "score of an effect, standard normal for a correctly specified model; not corrected for multiple testing"),
    ("ln Bayes", "ln Bayes factor of the effect against the base model; a linear estimate where it was not refitted"),
    ("γ", "unabsorbed fraction: part of the effect's signature that the parameters cannot absorb"),
    ("smallest visible", "smallest magnitude at which these data would show the effect"),
    ("model probability", "posterior probability among the base model and the effects of the library"),
    ("credible set", "the effects that remain possible explanations"),
)
LOOKS = {
    "credible set": (ORANGE, ""),
    "refitted": (BLUE, ""),
    "not refitted: linear estimate": (SKY, "/"),
    "not visible with these data": (REST, "."),
}
_SHOWN_PERTURBATIONS = 12


def effects_table(results: StudyResults) -> pd.DataFrame | None:
    """Read ``effects.csv``, sorted by decreasing evidence."""
    table = results.table(
        "effects",
        ["name", "title"],
        NUMBERS,
        flags=["visible", "refitted", "credible"],
        blank=["unit", "implausible", "confounded_with", "stands_for", "lacks", "look_for"],
        unbounded=["magnitude_min"],
    )
    return None if table is None else ranked(table)


def section(results: StudyResults) -> Section | None:
    """Effects ranked, with the credible set; in grey those that are not visible with these data."""
    table = effects_table(results)
    if table is None:
        return None
    credible = [f"{r['title']} ({r['name']})" for r in table.to_dict("records") if flag(r["credible"])]
    note = f"Credible set: {'; '.join(credible)}." if credible else "No effect of the library is credible."
    hidden = [str(r["name"]) for r in table.to_dict("records") if not flag(r["visible"])]
    grey = f" Not visible with these data at a plausible magnitude (grey): {', '.join(hidden)}." if hidden else ""
    blocks = [
        Words(f"Tested: {counted(len(table), 'effect')} of the study's library. {note}{grey}"),
        Terms(TERMS),
        _effect_plot(table),
        _effect_rows(table),
        *_physics(table),
        *_confounding(results),
        *_local_perturbations(results),
    ]
    return Section("effects", "Candidate effects, ranked", tuple(blocks))


def _look(row: Mapping[Any, Any]) -> str:
    names = list(LOOKS)
    if flag(row["credible"]):
        return names[0]
    if not flag(row["visible"]):
        return names[3]
    return names[1] if flag(row["refitted"]) else names[2]


def _effect_plot(table: pd.DataFrame) -> Plot:
    records = table.to_dict("records")
    labels = [
        words
        if flag(r["visible"])
        else "<br>".join(f'<span style="color:{GREY}">{w}</span>' for w in words.split("<br>"))
        for r in records
        for words in [wrapped(str(r["title"]))]
    ]
    threshold = float(np.log(max(len(table), 1)) + LEAST_BAYES_FACTOR)
    look = new(150 + 40 * len(table), margin={"l": 60, "r": 30, "t": 60, "b": 60}, barmode="overlay")
    figure = make_subplots(1, 2, shared_yaxes=True, column_widths=[0.6, 0.4], horizontal_spacing=0.04, figure=look)
    for name, (colour, pattern) in LOOKS.items():
        at = [k for k, r in enumerate(records) if _look(r) == name]
        if not at:
            continue
        rows = table.iloc[at]
        words = [
            shown(f"{r['name']}: ln Bayes {fixed(r['ln_bayes'], 1)}, z {fixed(r['z'], 1)}")
            for r in rows.to_dict("records")
        ]
        written = [
            fixed(v, 1) + (" implausible" if i else "")
            for v, i in zip(rows["ln_bayes"], rows["implausible"], strict=True)
        ]
        figure.add_bar(
            x=rows["ln_bayes"].to_numpy(dtype=float), y=at, orientation="h", name=name, showlegend=True, text=written,
            hoverinfo="text", hovertext=words, textposition="outside", cliponaxis=False, row=1, col=1,
            marker=filled(colour, pattern),
        )  # fmt: skip
    figure.add_vline(x=threshold, line={"color": BLACK, "dash": "dash", "width": 1}, row=1, col=1)
    ratio = (table["magnitude_min"] / table["plausible"]).to_numpy(dtype=float)
    seen = table["visible"].map(flag).to_numpy(dtype=bool)
    for mask, symbol, colour in ((seen, "circle", BLUE), (~seen, "circle-open", GREY)):
        known = np.flatnonzero(mask & np.isfinite(ratio))
        words = [
            shown(f"{r['name']}: visible from {with_unit(r['magnitude_min'], str(r['unit']))}, "
                  f"plausible magnitude {with_unit(r['plausible'], str(r['unit']))}")
            for r in table.iloc[known].to_dict("records")
        ]  # fmt: skip
        figure.add_scatter(
            x=ratio[known], y=known, mode="markers", hovertext=words, hoverinfo="text", showlegend=False, row=1, col=2,
            marker={"color": colour, "size": 10, "symbol": symbol, "line": {"width": 2, "color": colour}},
        )  # fmt: skip
    figure.add_vline(x=1.0, line={"color": BLACK, "width": 1}, row=1, col=2)
    axis = name_axis(labels, reverse=True, ticktext=labels)
    figure.update_layout(
        xaxis=number_axis("ln Bayes against the base model", range=_room(table["ln_bayes"], threshold)),
        xaxis2=number_axis("smallest visible magnitude / plausible magnitude", type="log", dtick=1),
        yaxis=axis,
        yaxis2=name_axis(labels, reverse=True, ticktext=labels, showticklabels=False),
    )
    best = "; ".join(f"{r['title']} {fixed(r['ln_bayes'], 1)}" for r in records[:3])
    caption = (
        f"Left: evidence for each effect, with the threshold for one of {len(table)} effects, {fixed(threshold, 1)}, "
        "dashed. Right: smallest visible magnitude; beyond the line at 1 only an implausibly large effect is visible."
    )
    return Plot("ranked-effects", caption, f"Bars and dots. The strongest evidence: {best}.", figure)


def _room(values: pd.Series, threshold: float) -> list[float]:
    known = [v for v in values if np.isfinite(v)] + [0.0, threshold]
    low, high = min(known), max(known)
    return [low - 0.12 * (high - low), high + 0.35 * (high - low)]


def _effect_rows(table: pd.DataFrame) -> Table:
    rows, grey = [], []
    for k, r in enumerate(table.to_dict("records")):
        unit = str(r["unit"])
        magnitude = "not refitted"
        if flag(r["refitted"]):
            interval = f"{significant(r['magnitude_low'], 3)} to {significant(r['magnitude_high'], 3)}"
            magnitude = f"{with_unit(r['magnitude'], unit)} ({interval})"
        remarks = [
            *(["credible"] if flag(r["credible"]) else []),
            *([] if flag(r["visible"]) else ["not visible"]),
            *([str(r["implausible"])] if r["implausible"] else []),
            *([f"confounded with {r['confounded_with']}"] if r["confounded_with"] else []),
            *([f"represents {r['stands_for']} too"] if r["stands_for"] else []),
        ]
        rows.append(
            (
                str(r["title"]),
                str(r["name"]),
                fixed(r["z"], 1),
                fixed(r["ln_bayes"], 1),
                "–" if np.isnan(r["model_probability"]) else f"{100 * r['model_probability']:.1f} %",
                fixed(r["unabsorbed"], 2),
                magnitude,
                "never" if np.isinf(r["magnitude_min"]) else with_unit(r["magnitude_min"], unit, 2),
                "; ".join(remarks),
            )
        )
        if not flag(r["visible"]):
            grey.append(k)
    heads = ("effect", "name", "z", "ln Bayes", "model probability", "γ", "magnitude (95 %)", "smallest visible",
             "remark")  # fmt: skip
    return Table("Every effect of the library, ranked", heads, tuple(rows), (1, 8), tuple(grey))


def _physics(table: pd.DataFrame) -> list[Table]:
    """What the model lacks without each effect, and what to inspect on the structure; nothing where no row has it."""
    if not (table["lacks"] + table["look_for"]).astype(bool).any():
        return []
    rows = tuple((str(r["title"]), str(r["lacks"]), str(r["look_for"])) for r in table.to_dict("records"))
    grey = tuple(k for k, visible in enumerate(table["visible"]) if not flag(visible))
    heads = ("effect", "the model without it", "what to look for")
    return [Table("Description of the effects", heads, rows, (1, 2), grey)]


def _confounding(results: StudyResults) -> list[Plot]:
    table = results.table("confounding", ["effect"], others_are_numbers=True)
    if table is None:
        return []
    names = table["effect"].astype(str).tolist()
    values = table.set_index("effect").reindex(columns=names).to_numpy(dtype=float)
    figure = new(max(320, 180 + 28 * len(names)), plot_bgcolor="#EDEDED")
    cells = [[fixed(v, 2) for v in row] for row in values]
    add_matrix(figure, values, names, names, cells, colours="RdBu_r", span=(-1.0, 1.0), label="correlation")
    figure.update_layout(xaxis=name_axis(names, tickangle=-90), yaxis=name_axis(names, reverse=True))
    close = [
        f"{names[i]} and {names[j]} {fixed(values[i, j], 2)}" for i, j in np.argwhere(np.abs(np.tril(values, -1)) > 0.9)
    ]
    note = f"Collinear (over 0.9): {'; '.join(close)}." if close else "No two effects are collinear (over 0.9)."
    caption = f"Correlation of the effects' signatures after projecting out the parameters. {note}"
    return [Plot("confounding", caption, f"Matrix of correlations. {note}", figure)]


def _local_perturbations(results: StudyResults) -> list[Block]:
    table = results.table("perturbations", ["perturbation", "kind"], ["x", "y", "z", "score", "unabsorbed"])
    if table is None:
        return []
    order = table["score"].abs().sort_values(ascending=False, kind="stable").index
    table = table.loc[order].reset_index(drop=True)
    rows = tuple(
        (str(r["perturbation"]), str(r["kind"]), fixed(r["score"], 1, sign=True), fixed(r["unabsorbed"], 2))
        for r in table.head(_SHOWN_PERTURBATIONS).to_dict("records")
    )
    first = ", ".join(f"{r[0]} {r[2]}" for r in rows[:3])
    caption = f"Local perturbations with the largest scores, of {len(table)}: places to inspect, not causes"
    placed = table.dropna(subset=["x", "y", "z", "score"])
    out: list[Block] = []
    if len(placed):
        points, score = placed[["x", "y", "z"]].to_numpy(dtype=float), placed["score"].to_numpy(dtype=float)
        reach = float(np.abs(score).max()) or 1.0
        figure = new_space(rest_lines(results.folder), points)
        marker = {
            "color": score, "colorscale": "RdBu_r", "cmin": -reach, "cmax": reach, "line": {"color": BLACK, "width": 1},
            "size": 4 + 16 * np.abs(score) / reach, "colorbar": {"title": {"text": "score z"}, "thickness": 14},
        }  # fmt: skip
        words = [f"{r['perturbation']}: z {fixed(r['score'], 1, sign=True)}" for r in placed.to_dict("records")]
        add_dots(figure, points, words, "local perturbations", marker)
        note = f"Scores of local perturbations at their locations: places to inspect, not causes. {AXES_NOTE}"
        alt = f"Scores of {len(placed)} local perturbations. The largest: {first}."
        out.append(Plot("local-perturbations", note, alt, figure))
    return [*out, Table(caption, ("local perturbation", "kind", "score z", "γ"), rows, (1,))]
