"""Blocks on the predictions of held-out data after a misfit that nothing explains."""

from __future__ import annotations

from calib.report.html.page import Block, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import chance, fixed, flag
from calib.report.predictions import NUMBERS
from calib.report.verification import GROUPS

_ERRORS = ["rms", "expected", "expected_unexplained", "p", "p_unexplained"]


def predictions(results: StudyResults) -> list[Block]:
    """Intervals and errors with and without the unexplained misfit; nothing where everything is explained."""
    flags = ["inside", "inside_unexplained"]
    table = results.table("unexplained_predictions", ["group", "kind"], NUMBERS, flags=flags, unbounded=NUMBERS)
    errors = results.table("unexplained_errors", ["group"], ["rows", *_ERRORS])
    if table is None or errors is None:
        return []
    counts = {
        str(group): [sum(map(flag, own[name])) for name in flags] + [len(own)]
        for group, own in table.groupby("group", sort=False)
    }
    rows = []
    for r in errors.to_dict("records"):
        group = str(r["group"])
        alone, beside, total = counts.get(group, [0, 0, 0])
        numbers = [chance(r[name]) if name.startswith("p") else fixed(r[name], 2) for name in _ERRORS]
        rows.append((GROUPS.get(group, group), f"{alone} of {total}", f"{beside} of {total}", *numbers))
    words = (
        "A misfit that nothing explains reaches data that were not fitted too. The intervals with it assume that "
        "every effect of the library and every local perturbation is present with a small magnitude, scaled to the "
        "misfit. They include the noise of the measurement."
    )
    heads = ("data", "inside alone", "inside with it", "rms, σ", "expected, σ", "with it, σ", "p", "p with it")
    caption = "Held-out data by the base model, alone and with the unexplained misfit"
    told = "; ".join(f"{row[0]}: {row[1]} inside, {row[2]} with the misfit" for row in rows)
    figure = "Predictions of held-out data with 95 % intervals, of the fit alone and with the unexplained misfit."
    return [
        Words(words),
        *results.picture("held_out_predictions", figure, f"Bars and dots. {told}."),
        Table(caption, heads, tuple(rows)),
    ]
