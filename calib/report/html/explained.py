"""What the model lacks: parameters under strain, the verdict, and all that was tried."""

from __future__ import annotations

import numpy as np

from calib.report.html.answers import Answers
from calib.report.html.look import name_axis, new, number_axis, shown
from calib.report.html.numbers import chance, fixed, flag, with_unit, yes
from calib.report.html.page import Block, Plot, Section, Table, Words
from calib.report.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, added

_OF_VERDICT = 2
"""Sentences that say what is missing and what it is; all others support them."""
_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, SKY)


def strained(answers: Answers) -> Section | None:
    """How far the parameters had to move, with and without what may be missing."""
    numbers = ["adopted", "value", "standardised", "limit"]
    table = answers.table(
        "strain", ["model", "parameter"], numbers, flags=["strained"], blank=["unit"], unbounded=["standardised"]
    )
    if table is None:
        return None
    models, names = list(dict.fromkeys(table["model"])), list(dict.fromkeys(table["parameter"]))
    believed = "explained" if _names_something(answers) else "attempt"
    figure = new(130 + 34 * len(names))
    for k, model in enumerate(models):
        rows = table[table["model"] == model].set_index("parameter").reindex(names)
        label = "base model" if model == "base" else added(believed, model)
        words = [
            shown(
                f"{n}, {label}: {with_unit(r['adopted'], str(r['unit']))} → "
                f"{with_unit(r['value'], str(r['unit']), 4)}, {fixed(r['standardised'], 1, sign=True)}"
            )
            for n, r in rows.iterrows()
        ]
        figure.add_scatter(
            x=rows["standardised"].to_numpy(dtype=float), y=np.arange(len(names)) + 0.16 * (k - (len(models) - 1) / 2),
            mode="markers", hovertext=words, hoverinfo="text", name=shown(label), showlegend=True,
            marker={"color": _COLOURS[k % len(_COLOURS)], "size": 10, "symbol": ("circle", "square", "diamond")[k % 3]},
        )  # fmt: skip
    limits = table["limit"].dropna().round(3).unique()
    for limit in limits:
        for side in (-limit, limit):
            figure.add_vline(x=side, line={"color": BLACK, "dash": "dash", "width": 1})
    reach = 1.1 * float(np.nanmax(np.abs([*table["standardised"].replace([np.inf, -np.inf], np.nan), *limits, 3.0])))
    axis = number_axis("shift from the adopted value, standardised", range=[-reach, reach])
    figure.update_layout(xaxis=axis, yaxis=name_axis(names, reverse=True))
    pulled = [f"{r['parameter']} ({r['model']})" for r in table.to_dict("records") if flag(r["strained"])]
    told = f"Strained: {', '.join(pulled)}." if pulled else "No parameter is strained."
    rows = tuple(
        (
            str(r["parameter"]),
            str(r["model"]),
            with_unit(r["adopted"], str(r["unit"]), 4),
            with_unit(r["value"], str(r["unit"]), 4),
            fixed(r["standardised"], 2, sign=True),
            yes(r["strained"]),
        )
        for r in table.to_dict("records")
    )
    intro = (
        "A parameter that had to go far from what was known of it may hide missing physics. The shift is standardised: "
        "with a right model it is a standard normal number, and the dashed limits hold for all parameters together."
    )
    caption = f"Shift of every parameter from its adopted value. {told}"
    heads = ("parameter", "model", "adopted", "fitted", "standardised shift", "strained")
    return Section(
        "strained",
        "Parameters under strain",
        (
            Words(intro),
            Plot("strain", caption, f"Dots. {told}", figure),
            Table("Parameters under strain", heads, rows, (1, 5)),
        ),
    )


def verdict(answers: Answers) -> Section | None:
    """The verdict in full, with what supports it."""
    told = answers.explanation
    if not told:
        return None
    facts = [
        ("effects and local changes, all looked at once", told.get("p_family")),
        ("the fit of the base model as a whole", told.get("p_fit")),
        ("effects and local changes after adding what is named or tried", told.get("adequacy_p_family")),
        ("the fit as a whole after adding it", told.get("adequacy_p_fit")),
    ]
    rows = tuple((what, chance(float(p))) for what, p in facts if p is not None)
    notes = [Words(str(note), "told") for note in told.get("notes", [])]
    parts = [str(words).replace(" -> ", " → ") for words in told.get("sentences", [told.get("sentence", "")])]
    supports = [Words(words, "told") for words in parts[_OF_VERDICT:]]
    caption = "Chance of what was seen, or more, if the model were right"
    table = Table(caption, ("looking at", "p"), rows)
    blocks: list[Block] = [Words(" ".join(parts[:_OF_VERDICT]), "verdict"), *supports, *notes, table]
    return Section("verdict", "Verdict", tuple(blocks))


def tried(answers: Answers) -> Section | None:
    """Every model that was fitted."""
    table = answers.table("tried", ["effects"], ["misfit", "ln_bayes"], blank=["implausible"])
    if table is None:
        return None
    rows = tuple(
        (str(r["effects"]), fixed(r["misfit"], 1), fixed(r["ln_bayes"], 1), str(r["implausible"]))
        for r in table.to_dict("records")
    )
    count = answers.explanation.get("evaluations")
    work = f" {count} evaluations of the model were needed." if count else ""
    intro = f"Every model that was calibrated anew.{work} The misfit is the sum of squares in units of the scatter."
    heads = ("added to the base model", "misfit", "ln Bayes", "not believed because")
    return Section("tried", "Every effect tried", (Words(intro), Table("Models that were fitted", heads, rows, (3,))))


def _names_something(answers: Answers) -> bool:
    return answers.explanation.get("verdict") in ("effect", "indistinguishable", "two_effects")
