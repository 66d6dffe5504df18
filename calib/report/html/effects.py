"""Effects that the model may lack, ranked, and the unnamed local changes beside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from plotly.subplots import make_subplots

from calib.report.explanation import LEAST_ODDS, ranked
from calib.report.html.answers import Answers
from calib.report.html.look import add_matrix, filled, name_axis, new, number_axis, shown, wrapped
from calib.report.html.numbers import counted, fixed, flag, significant, with_unit
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.html.space import AXES_TOLD, add_dots, new_space
from calib.report.mesh import rest_lines
from calib.report.style import BLACK, BLUE, GREY, ORANGE, REST, SKY

NUMBERS = (
    "z", "gamma", "phi", "phi_low", "phi_high", "phi_min", "plausible", "largest", "ln_bayes", "ln_bayes_third",
    "ln_bayes_triple", "posterior", "heldout_gain",
)  # fmt: skip
TERMS = (
    ("z", "score of an effect, standard normal if nothing is missing; no probability, as many are looked at"),
    (
        "ln Bayes",
        "natural logarithm of the odds for the effect against the base model; where not fitted a linear estimate",
    ),
    ("γ", "share of the effect's change of the data that the parameters cannot absorb"),
    ("smallest visible", "strength from which these data would show the effect"),
    ("posterior", "probability within the library, as if one of its effects were the cause"),
    ("credible set", "the effects that remain possible explanations"),
)
LOOKS = {
    "in the credible set": (ORANGE, ""),
    "fitted": (BLUE, ""),
    "not fitted: linear estimate": (SKY, "/"),
    "cannot be seen with these data": (REST, "."),
}
_SHOWN_ATOMS = 12


def effects_table(answers: Answers) -> pd.DataFrame | None:
    """``effects.csv`` by falling evidence."""
    table = answers.table(
        "effects",
        ["name", "title"],
        NUMBERS,
        flags=["visible", "refitted", "credible"],
        blank=["unit", "implausible", "confounded_with", "stands_for", "lacks", "look_for"],
        unbounded=["phi_min"],
    )
    return None if table is None else ranked(table)


def section(answers: Answers) -> Section | None:
    """Effects ranked, with the credible set, and in grey what these data cannot show."""
    table = effects_table(answers)
    if table is None:
        return None
    credible = [f"{r['title']} ({r['name']})" for r in table.to_dict("records") if flag(r["credible"])]
    told = f"Credible set: {'; '.join(credible)}." if credible else "No effect of the library is credible."
    unseen = [str(r["name"]) for r in table.to_dict("records") if not flag(r["visible"])]
    cannot = (
        f" Of {', '.join(unseen)} these data would show nothing at a plausible strength; they are grey."
        if unseen
        else ""
    )
    blocks = [
        Words(f"{counted(len(table), 'effect')} of the study's library were tested. {told}{cannot}"),
        Terms(TERMS),
        _effect_plot(table),
        _effect_rows(table),
        *_physics(table),
        *_confounding(answers),
        *_local_changes(answers),
    ]
    return Section("effects", "What may be missing, ranked", tuple(blocks))


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
    threshold = float(np.log(max(len(table), 1)) + LEAST_ODDS)
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
    ratio = (table["phi_min"] / table["plausible"]).to_numpy(dtype=float)
    seen = table["visible"].map(flag).to_numpy(dtype=bool)
    for mask, symbol, colour in ((seen, "circle", BLUE), (~seen, "circle-open", GREY)):
        known = np.flatnonzero(mask & np.isfinite(ratio))
        words = [
            shown(f"{r['name']}: visible from {with_unit(r['phi_min'], str(r['unit']))}, "
                  f"plausible size {with_unit(r['plausible'], str(r['unit']))}")
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
        xaxis2=number_axis("smallest visible strength / plausible size", type="log", dtick=1),
        yaxis=axis,
        yaxis2=name_axis(labels, reverse=True, ticktext=labels, showticklabels=False),
    )
    best = "; ".join(f"{r['title']} {fixed(r['ln_bayes'], 1)}" for r in records[:3])
    caption = (
        f"Left: evidence for each effect; one of {len(table)} must pass the dashed {fixed(threshold, 1)}. Right: from "
        "which strength these data would show it; beyond the line at 1 only an implausibly strong one."
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
        strength = "not fitted"
        if flag(r["refitted"]):
            interval = f"{significant(r['phi_low'], 3)} to {significant(r['phi_high'], 3)}"
            strength = f"{with_unit(r['phi'], unit)} ({interval})"
        remarks = [
            *(["credible"] if flag(r["credible"]) else []),
            *([] if flag(r["visible"]) else ["cannot be seen"]),
            *([str(r["implausible"])] if r["implausible"] else []),
            *([f"looks like {r['confounded_with']}"] if r["confounded_with"] else []),
            *([f"stands for {r['stands_for']} too"] if r["stands_for"] else []),
        ]
        rows.append(
            (
                str(r["title"]),
                str(r["name"]),
                fixed(r["z"], 1),
                fixed(r["ln_bayes"], 1),
                "–" if np.isnan(r["posterior"]) else f"{100 * r['posterior']:.1f} %",
                fixed(r["gamma"], 2),
                strength,
                "no strength" if np.isinf(r["phi_min"]) else with_unit(r["phi_min"], unit, 2),
                "; ".join(remarks),
            )
        )
        if not flag(r["visible"]):
            grey.append(k)
    heads = ("effect", "name", "z", "ln Bayes", "posterior", "γ", "strength (95 %)", "smallest visible", "remark")
    return Table("Every effect of the library, ranked", heads, tuple(rows), (1, 8), tuple(grey))


def _physics(table: pd.DataFrame) -> list[Table]:
    """What each effect is about, for who has to go and look; an earlier version of the tool did not write it."""
    if not (table["lacks"] + table["look_for"]).astype(bool).any():
        return []
    rows = tuple((str(r["title"]), str(r["lacks"]), str(r["look_for"])) for r in table.to_dict("records"))
    grey = tuple(k for k, visible in enumerate(table["visible"]) if not flag(visible))
    heads = ("effect", "what the model does without it", "what to look for")
    return [Table("What each effect is about", heads, rows, (1, 2), grey)]


def _confounding(answers: Answers) -> list[Plot]:
    table = answers.table("confounding", ["effect"], others_are_numbers=True)
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
    told = f"Hard to tell apart (over 0.9): {'; '.join(close)}." if close else "No two are alike beyond 0.9."
    caption = f"How alike the effects look once all that the parameters absorb is taken out. {told}"
    return [Plot("confounding", caption, f"Matrix of correlations. {told}", figure)]


def _local_changes(answers: Answers) -> list[Block]:
    table = answers.table("atoms", ["atom", "kind"], ["x", "y", "z", "score", "gamma"])
    if table is None:
        return []
    order = table["score"].abs().sort_values(ascending=False, kind="stable").index
    table = table.loc[order].reset_index(drop=True)
    rows = tuple(
        (str(r["atom"]), str(r["kind"]), fixed(r["score"], 1, sign=True), fixed(r["gamma"], 2))
        for r in table.head(_SHOWN_ATOMS).to_dict("records")
    )
    first = ", ".join(f"{r[0]} {r[2]}" for r in rows[:3])
    caption = (
        f"Unnamed local changes of the model with the largest scores, of {len(table)}; places to look at, not causes"
    )
    placed = table.dropna(subset=["x", "y", "z", "score"])
    out: list[Block] = []
    if len(placed):
        points, score = placed[["x", "y", "z"]].to_numpy(dtype=float), placed["score"].to_numpy(dtype=float)
        reach = float(np.abs(score).max()) or 1.0
        figure = new_space(rest_lines(answers.folder), points)
        marker = {
            "color": score, "colorscale": "RdBu_r", "cmin": -reach, "cmax": reach, "line": {"color": BLACK, "width": 1},
            "size": 4 + 16 * np.abs(score) / reach, "colorbar": {"title": {"text": "score z"}, "thickness": 14},
        }  # fmt: skip
        words = [f"{r['atom']}: z {fixed(r['score'], 1, sign=True)}" for r in placed.to_dict("records")]
        add_dots(figure, points, words, "local changes", marker)
        told = f"Scores of local changes where they would be made: places to look at, not causes. {AXES_TOLD}"
        out.append(Plot("local-changes", told, f"Scores of {len(placed)} local changes. The largest: {first}.", figure))
    return [*out, Table(caption, ("local change", "kind", "score z", "γ"), rows, (1,))]
