"""Section on the candidate effects, ranked, and on local perturbations."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.report.alike import place_words
from calib.report.explanation import COLLINEAR, only_predicted, ranked
from calib.report.html.page import Block, Picture, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import counted, fixed, flag, place, places, probability, significant, with_unit
from calib.report.scene import PLACE
from calib.report.why import BY_TEST, PRIOR, explained_words, further_parameters

NUMBERS = (
    "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min", "plausible", "largest",
    "ln_bayes", "ln_bayes_third", "ln_bayes_triple", "model_probability", "held_out_gain",
)  # fmt: skip
TERMS = (
    (
        "z",
        "score of an effect, standard normal for a correctly specified model, not corrected for multiple "
        "testing; negative where the data ask for a negative magnitude. Its size alone does not count: whatever is "
        "missing raises the scores of all effects with a similar signature",
    ),
    ("ln Bayes", "ln Bayes factor of the effect against the base model; a linear estimate where it was not refitted"),
    ("γ", "unabsorbed fraction: part of the effect's signature that the parameters cannot absorb"),
    ("smallest visible", "smallest magnitude at which these data would show the effect"),
    (
        "not visible",
        "the smallest visible magnitude is beyond the plausible one. A large z then asks for an implausible magnitude, "
        "for which ln Bayes gives no credit",
    ),
    ("model probability", "posterior probability among the base model and the effects of the library"),
    ("credible set", "the effects that remain possible explanations"),
)
_SHOWN_PERTURBATIONS = 12
_DOTS = (
    "Dots on the structure are local perturbations; colour and area show the correlation ρ of their signature with "
    "that of the effect, and 1 marks the largest."
)
_SHOWN_PLACES = 4
"""Places of an effect: one at each corner of a structure."""


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
        *_why(results),
        *_effect_picture(results, table),
        _effect_rows(table),
        *_physics(results, table),
        *_confounding(results),
        *_local_perturbations(results),
    ]
    return Section("effects", "Candidate effects, ranked", tuple(blocks))


def _why(results: StudyResults) -> list[Picture]:
    table = results.table("why", ["effects", "effect", "kind"], ["residual", "signature", "left"])
    if table is None:
        return []
    fits = results.table("candidate_fits", ["effects"], ["misfit"])
    misfit = {} if fits is None else dict(zip(fits["effects"], fits["misfit"], strict=True))
    by_test = results.table(BY_TEST, ["effects"], ["rows", "before", "after", "share"], unique="effects")
    told = []
    for together in dict.fromkeys(table["effects"]):
        rows = table[table["effects"] == together]
        own = rows[rows["effect"] == rows["effect"].iloc[0]]  # each effect of a fit has all rows
        words = explained_words(own, by_test)
        if {"none", together} <= misfit.keys() and (own["kind"] == PRIOR).any():  # the fits are of all rows
            words += f"; fitted, it falls from {significant(misfit['none'], 3)} to {significant(misfit[together], 3)}"
        told.append(words)
    fitted = results.table("why_parameters", ["effect", "parameter"], ["value"], blank=["description", "unit"])
    names = list(dict.fromkeys(table["effect"]))
    told += [words for name in names for words in further_parameters(fitted, name)]
    alike = results.table("why_places", ["effect", "perturbation", "kind"], ["x", "y", "z", "correlation"])
    dots = "" if alike is None else f" {_DOTS}"
    star = " The star is where the effect acts in the library's model." if results.has("effect_places") else ""
    caption = (
        "Residual (measurement minus calibrated base model), signature of the effect at its fitted magnitude, and what "
        "is left, in standard deviations σ, less what the parameters absorb. Open dots are imaginary parts, im. An "
        "effect that is there has the pattern of the residual. "
        f"{'. '.join(told)}.{dots}{star} {results.axes}"
    )
    if alike is not None:
        told += [f"{n}: {words}" for n in names if (words := place_words(alike, n))]
    return results.picture("why_this_effect", caption, f"Bars, dots and places. {'; '.join(told)}.")


def _effect_picture(results: StudyResults, table: pd.DataFrame) -> list[Picture]:
    best = "; ".join(f"{r['title']} {fixed(r['ln_bayes'], 1)}" for r in table.head(3).to_dict("records"))
    caption = (
        "Left: evidence for each effect; its limit is dashed. Right: smallest visible magnitude; beyond the line at 1 "
        "only an implausibly large effect is visible."
    )
    if table["implausible"].astype(bool).any():
        caption += " A cross is a fit with implausible values; the remark in the table says which."
    return results.picture("ranked_effects", caption, f"Bars and dots. The strongest evidence: {best}.")


def _effect_rows(table: pd.DataFrame) -> Table:
    rows, grey, predicted = [], [], only_predicted(table)
    for k, r in enumerate(table.to_dict("records")):
        unit = str(r["unit"])
        magnitude = "not refitted"
        if flag(r["refitted"]):
            interval = f"{significant(r['magnitude_low'], 3)} to {significant(r['magnitude_high'], 3)}"
            magnitude = f"{with_unit(r['magnitude'], unit)} ({interval})"
        plausible = with_unit(r["plausible"], unit, 2)
        remarks = [
            *(["credible"] if flag(r["credible"]) else []),
            *([_behind(table, float(r["ln_bayes"]))] if predicted.iloc[k] else []),
            *([] if flag(r["visible"]) else [f"not visible at a plausible magnitude of {plausible}"]),
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
                probability(r["model_probability"]),
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


def _behind(table: pd.DataFrame, ln_bayes: float) -> str:
    """Why an effect with evidence was not refitted, in words: that of the best credible one is larger."""
    best = next((r for r in table.to_dict("records") if flag(r["credible"])), None)
    lead = 0.0 if best is None else float(best["ln_bayes"]) - ln_bayes
    less = f"ln Bayes less than {best['name']} by {fixed(lead, 1)}; " if best is not None and lead > 0 else ""
    return f"{less}linear prediction only"


def _physics(results: StudyResults, table: pd.DataFrame) -> list[Block]:
    """What the model lacks without each effect, what to inspect on the structure, and where each effect acts.

    Nothing where no effect tells what to inspect; no places where the model has none.
    """
    if not (table["lacks"] + table["look_for"]).astype(bool).any():
        return []
    acts = results.table("effect_places", ["effect"], PLACE, complete=PLACE)
    at = {} if acts is None else {name: own[[*PLACE]].to_numpy().tolist() for name, own in acts.groupby("effect")}
    rows = tuple(
        (
            str(r["title"]),
            str(r["lacks"]),
            str(r["look_for"]),
            *([places(at.get(str(r["name"]), []), _SHOWN_PLACES, ", ")] if at else []),
        )
        for r in table.to_dict("records")
    )
    grey = tuple(k for k, visible in enumerate(table["visible"]) if not flag(visible))
    heads = ("effect", "the model without it", "what to look for", *(["acts at (x, y, z), m"] if at else []))
    axes = [Words(results.axes)] if at else []
    return [*axes, Table("Description of the effects", heads, rows, (1, 2, 3), grey)]


def _confounding(results: StudyResults) -> list[Picture]:
    table = results.table("confounding", ["effect"], others_are_numbers=True)
    if table is None:
        return []
    names = table["effect"].astype(str).tolist()
    values = table.set_index("effect").reindex(columns=names).to_numpy(dtype=float)
    close = [
        f"{names[i]} and {names[j]} {fixed(values[i, j], 2)}"
        for i, j in np.argwhere(np.abs(np.tril(values, -1)) > COLLINEAR)
    ]
    note = (
        f"Collinear (over {COLLINEAR}): {'; '.join(close)}."
        if close
        else f"No two effects are collinear (over {COLLINEAR})."
    )
    caption = f"Correlation of the effects' signatures after projecting out the parameters. {note}"
    return results.picture("confounding", caption, f"Matrix of correlations. {note}")


def _local_perturbations(results: StudyResults) -> list[Block]:
    table = results.perturbations
    if table is None:
        return []
    order = table["score"].abs().sort_values(ascending=False, kind="stable").index
    table = table.loc[order].reset_index(drop=True)
    rows = tuple(
        (
            str(r["perturbation"]),
            str(r["kind"]),
            fixed(r["score"], 1, sign=True),
            fixed(r["unabsorbed"], 2),
            place([r[axis] for axis in PLACE]),
        )
        for r in table.head(_SHOWN_PERTURBATIONS).to_dict("records")
    )
    first = ", ".join(f"{r[0]} {r[2]}" for r in rows[:3])
    caption = f"Local perturbations with the largest scores, of {len(table)}: places to inspect, not causes"
    note = f"Scores of local perturbations at their locations: places to inspect, not causes. {results.axes}"
    alt = f"Scores of {counted(len(table), 'local perturbation')}. The largest: {first}."
    return [
        *results.picture("perturbation_map", note, alt),
        Table(caption, ("local perturbation", "kind", "score z", "γ", "place (x, y, z), m"), rows, (1, 4)),
    ]
