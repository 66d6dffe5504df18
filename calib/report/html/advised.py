"""What to measure next, and what that promises."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from calib.report.html.answers import Answers
from calib.report.html.look import name_axis, new, number_axis, shown, wrapped
from calib.report.html.numbers import fixed, significant
from calib.report.html.page import Plot, Section, Table, Words
from calib.report.style import GREEN, GREY, ORANGE, PURPLE, SKY
from calib.report.verification import best_options

_TICKS = [factor * 10**power for power in range(-1, 6) for factor in (1, 2, 5)]
_KINDS = {"sensor": SKY, "mode": ORANGE, "repeats": GREEN, "bench": PURPLE}


def section(answers: Answers) -> Section | None:
    """What further measurements promise."""
    worth = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    numbers = [*worth, "phi_min"]
    table = answers.table(
        "next_measurement", ["option", "kind"], [*numbers, "chance"], unbounded=numbers, blank=["effect"]
    )
    if table is None:
        return None
    best = best_options(table)
    finite = best["gain"].replace(np.inf, np.nan)
    words = [shown(f"{r['option']}: × {fixed(r['gain'], 2)} for {r['effect']}") for r in best.to_dict("records")]
    labels = [wrapped(str(option), 48) for option in best["option"]]
    lines = max(label.count("<br>") + 1 for label in labels)
    figure = new(120 + (18 + 16 * lines) * len(best), margin={"l": 60, "r": 60, "t": 30, "b": 60})
    figure.add_bar(
        x=finite.to_numpy(dtype=float), y=list(range(len(best))), orientation="h", hovertext=words, hoverinfo="text",
        text=[f"× {fixed(v, 1)}" for v in best["gain"]], textposition="outside", cliponaxis=False,
        marker={"color": [_KINDS.get(str(kind), GREY) for kind in best["kind"]]},
    )  # fmt: skip
    figure.update_layout(
        xaxis=number_axis("factor in the expected score; 1 is no gain", type="log", tickvals=_TICKS),
        yaxis=name_axis(labels, reverse=True, ticktext=labels),
    )
    odds = table["ln_bayes"].notna().any()
    rows = tuple(
        (
            str(r["option"]),
            str(r["kind"]),
            str(r["effect"]),
            f"× {fixed(r['gain'], 2)} ({fixed(r['gain_low'], 2)} to {fixed(r['gain_high'], 2)})",
            "never" if np.isinf(r["phi_min"]) else significant(r["phi_min"], 2),
            *([_odds(r), f"{fixed(100 * r['chance'], 0)} %"] if odds else []),
        )
        for r in best.to_dict("records")
    )
    heads = (
        "measurement",
        "kind",
        "for the effect",
        "score",
        "smallest visible then",
        *(["expected ln odds for the true one", "chance of more than 20:1"] if odds else []),
    )
    first = best.to_dict("records")[0]
    told = f"Most is gained by: {first['option']} (× {fixed(first['gain'], 1)} in the score of {first['effect']})."
    intro = (
        "What each further measurement would gain, computed from the model before anything is measured and averaged "
        "over what parameters and strengths may be; ranges in brackets hold in 8 of 10 cases. A withheld mode that is "
        "used no longer verifies the result."
    )
    caption = f"The {len(best)} measurements of most worth, each for the effect whose score it raises most."
    return Section(
        "next",
        "What to measure next",
        (
            Words(f"{intro} {told}"),
            Plot("next-measurement", caption, f"Bars. {told}", figure),
            Table("Measurements of most worth", heads, rows, (1, 2)),
        ),
    )


def _odds(row: Mapping[Hashable, Any]) -> str:
    """Log odds with their range."""
    return f"{fixed(row['ln_bayes'], 1)} ({fixed(row['ln_bayes_low'], 1)} to {fixed(row['ln_bayes_high'], 1)})"
