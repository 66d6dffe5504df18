"""Blocks on FRFs: the model beside the measurement."""

from __future__ import annotations

from calib.report.frf import OVERLAID
from calib.report.frf_tables import read_stages
from calib.report.html.page import Block, Picture, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, percent, significant

TERMS = (
    ("FRAC", "frequency response assurance criterion: 1 for functions that are proportional over all their lines"),
    ("amplitude", "norm of the model's function over that of the measured one, over all lines"),
    ("error", "norm of the difference of the two functions over that of the measured one"),
    ("in standard deviations", "root mean square of the difference over its standard deviation: 1 for a right model"),
)


def frf_blocks(results: StudyResults, stage: str) -> list[Block]:
    """Criteria of every function at one stage; the figures show all stages and stand with the latest."""
    stages = read_stages(results.folder, "comparison", results.stages)
    if stage not in stages:
        return []
    table, words = stages[stage].sort_values("frac", kind="stable"), results.in_words(stage)
    rows = tuple(
        (
            f"{r['response']}/{r['reference']}",
            fixed(r["lines"], 0),
            fixed(r["frac"], 3),
            fixed(r["amplitude"], 3),
            percent(r["error"], 1),
            significant(r["in_std"], 3),
        )
        for r in table.to_dict("records")
    )
    worst = table.iloc[0]
    note = f"Mean FRAC, {words}: {fixed(table['frac'].mean(), 3)}; the least is that of "
    note += f"{worst['response']}/{worst['reference']}, {fixed(worst['frac'], 3)}."
    heads = ("FRF", "lines", "FRAC", "amplitude", "error, %", "in std")
    blocks: list[Block] = [Words(note)]
    if stage == list(stages)[-1]:
        overlays = f"The {min(OVERLAID, len(table))} functions that agree least: amplitude and phase."
        blocks += results.picture("frf_overlays", overlays, f"Curves. {note}")
        blocks += results.picture("frac", "FRAC of every function, smallest first.", f"Dots. {note}")
        lines = read_stages(results.folder, "frf_lines", [stage])[stage]
        freq, in_std = max(zip(lines["freq"].tolist(), lines["in_std"].tolist(), strict=True), key=lambda line: line[1])
        where = f"The largest error, {words}, is {significant(in_std, 3)} standard deviations at "
        where += f"{significant(freq, 4)} Hz."
        blocks += results.picture("frf_lines", f"Error of every line, over all functions. {where}", f"Curves. {where}")
    return [*blocks, Table(f"Every function, {words}", heads, rows), Terms(TERMS)]


def misfit_picture(results: StudyResults) -> list[Picture]:
    """Residuals of the FRFs after the fit of an explanation."""
    table = results.table("frf_misfit", ["stage", "function"], ["freq", "re", "im"])
    if table is None:
        return []
    size = (table["re"] ** 2 + table["im"] ** 2).groupby([table["stage"], table["function"]], sort=False).mean() / 2
    latest = size[str(table["stage"].iloc[-1])]
    caption = "Residuals of the FRFs after the fit, by function and band, in standard deviations: 1 for a right model."
    alt = (
        f"Matrix. The worst function is {latest.idxmax()}, {fixed(float(latest.max()) ** 0.5, 2)} standard deviations."
    )
    return results.picture("frf_misfit", caption, alt)
