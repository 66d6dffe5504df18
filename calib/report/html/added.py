"""Section on the model calibrated with the effects that an explanation named: its modes and parameters."""

from __future__ import annotations

from calib.report.html.compared import mode_table, plain_blocks
from calib.report.html.page import Block, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.html.verified import every_mode_table
from calib.report.numbers import flag, significant, with_unit, yes


def section(results: StudyResults) -> Section | None:
    """Modes and parameters with the added effects, beside those without them."""
    name = results.added_effects
    if not name:
        return None
    note = (
        f"The model with {name}, calibrated like the model without it. The verdict quotes magnitudes and errors of the "
        f"explanation's own fits, by least squares alone. The extended study is in {results.added['study']}."
    )
    own = str(results.added.get("own", ""))
    told = [Words(own, "reported")] if own else []
    blocks = [Words(note), *_modes(results, name), *told, *_parameters(results, name), *_every_mode(results, name)]
    return Section("added", f"The model with {name}, calibrated", tuple(blocks))


def _modes(results: StudyResults, name: str) -> list[Block]:
    """Mode by mode, the scalar responses, or the FRFs."""
    if results.kind != "modes":
        return plain_blocks(results, "added")
    table = results.compared("added")
    return [] if table is None else [mode_table(table, f"Mode by mode, calibrated with {name}")]


def _every_mode(results: StudyResults, name: str) -> list[Block]:
    """Held-out modes too, at the nominal values, calibrated without and with the effects."""
    labels = {"initial": "nominal", "before": f"without {name}", "after": f"with {name}"}
    caption = f"Every measured mode, held-out ones too: nominal values, calibrated without and with {name}"
    tables = every_mode_table(results, "added_modes", labels, caption)
    if not tables:
        return []
    alt = "; ".join(f"{row[0]} {row[-4]} %" for row in tables[0].rows)
    return [*results.picture("added_modes", f"{caption}.", f"Dots. Errors with {name}: {alt}."), *tables]


def _parameters(results: StudyResults, name: str) -> list[Block]:
    stages = ("before", "after")
    numbers = ["nominal", *(f"{stage}{end}" for stage in stages for end in ("", "_std"))]
    flags = ["added", *(f"{stage}_identified" for stage in stages)]
    table = results.table("added_parameters", ["parameter"], numbers, flags=flags, blank=["unit"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            "added" if flag(r["added"]) else "",
            with_unit(r["nominal"], str(r["unit"]), 4),
            *(
                cell
                for stage in stages
                for cell in (
                    significant(r[stage]),
                    significant(r[f"{stage}_std"], 2),
                    yes(r[f"{stage}_identified"]),
                )
            ),
        )
        for r in table.to_dict("records")
    )
    moved = table[(table["after"] - table["before"]).abs() > 2 * table["before_std"]]
    note = "; ".join(
        f"{r['parameter']} {significant(r['before'])} → {with_unit(r['after'], str(r['unit']), 4)} "
        f"(nominal {significant(r['nominal'])})"
        for r in moved.to_dict("records")
    )
    words = f"Without {name}, other parameters compensated by more than two standard deviations: {note}."
    heads = ("parameter", "", "nominal", "without", "std", "identified", f"with {name}", "std", "identified")
    return [
        Table(f"Parameters, calibrated without and with {name}", heads, rows, (1, 5, 8), unfolded=True),
        *([Words(words)] if note else []),
    ]
