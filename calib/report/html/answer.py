"""What stands first on the page: where, how much, the parameters afterwards, doubts with how to check each."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from calib.report.answer import AnsweredPlace
from calib.report.explanation_plan import read_place
from calib.report.html.cells import flagged
from calib.report.html.effects import ranked_effects
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, magnitude_in_words, significant, with_unit
from calib.results.answer import in_prose, names_in_words

_NAMED = ("effect", "indistinguishable", "two_effects", "several_effects")
"""Verdicts that name an effect."""
_EXTENDED = "_extended"
"""End of the name of an extended study."""
_NEAR = 0.1
"""Half the width, over its frequency, of the band in which a mode that an effect adds is looked for."""


def names_something(results: StudyResults) -> bool:
    """Whether the verdict names an effect."""
    return results.explanation.get("verdict") in _NAMED


def place_in_words(results: StudyResults) -> str:
    """The marks of the picture of the place; empty without one."""
    found = _place(results)
    named = [in_prose(str(name)) for name in results.explanation.get("chosen", [])]
    like = "" if names_something(results) else "something like "
    marks = {} if found is None else found.marks(f"{like}{names_in_words(named)}" if named else "")
    return "; ".join(f"{mark}: {words}" for mark, words in marks.items())


def _place(results: StudyResults) -> AnsweredPlace | None:
    return read_place(results.folder, not names_something(results))


def magnitudes(results: StudyResults) -> pd.DataFrame | None:
    """Rows of ``effects.csv`` of what is named, fitted ones only; None without any."""
    table = ranked_effects(results) if names_something(results) else None
    if table is None:
        return None
    own = flagged(table[table["name"].isin(results.explanation.get("chosen", []))], "refitted")
    return own.reset_index(drop=True) if len(own) else None


def magnitudes_in_words(table: pd.DataFrame) -> list[str]:
    """Magnitude of each with its 95 % interval."""
    return [magnitude_in_words(r) for r in table.to_dict("records")]


@dataclass(frozen=True, eq=False)
class Afterwards:
    """Parameters of the last model.

    Attributes
    ----------
    table : DataFrame
        Columns ``parameter, unit, nominal, before, before_std, value, std, identified, meaning``; of the
        magnitudes that `magnitudes` has, the value that stands there.
    effects : str
        What the last model has and the first has not; empty where there is one model only.
    misfit : bool
        Whether the first model does not fit, so that none of its parameters is identified.
    whole : bool
        Whether a parameter is a whole number.
    """

    table: pd.DataFrame
    effects: str
    misfit: bool
    whole: bool


def parameters_afterwards(results: StudyResults) -> Afterwards | None:
    """The parameters of the last calibrated model with what each means; None before any calibration."""
    space = results.table("parameter_space")
    known = {} if space is None else space.set_index("parameter").to_dict("index")
    added = results.table("added_parameters") if results.added_effects else None
    if added is not None:
        table = added.rename(columns={"after": "value", "after_std": "std", "after_identified": "identified"})
    elif (verdicts := results.table("verdicts")) is not None:
        table = verdicts.assign(nominal=[known.get(n, {}).get("value", float("nan")) for n in verdicts["parameter"]])
    else:
        return None
    fitted = results.table("why_parameters")
    of_effects = {} if fitted is None else dict(zip(fitted["parameter"], fitted["description"], strict=True))
    meaning = [str(known.get(name, {}).get("description", of_effects.get(name, ""))) for name in table["parameter"]]
    own = {str(effect["name"]) for effect in results.added.get("effects", [])} | set(effects_in_model(results))
    nominal = table["nominal"].where(~table["parameter"].isin(own))  # that of a magnitude is none
    above = magnitudes(results)
    told = {} if above is None or added is None else dict(zip(above["name"], above["magnitude"], strict=True))
    values = [told.get(name, value) for name, value in zip(table["parameter"], table["value"], strict=True)]
    table = table.assign(meaning=meaning, nominal=nominal, value=values)
    first = table["identified" if added is None else "before_identified"].dropna()
    misfit = float(results.summary.get("birge") or 1.0) > 1.0 and not any(map(flag, first))
    whole = any(flag(row.get("integer", False)) for row in known.values())
    return Afterwards(table.reset_index(drop=True), results.added_effects, misfit, whole)


def effects_in_model(results: StudyResults) -> list[str]:
    """Effects that the model of the study has from another study's explanation."""
    return [str(name) for name in results.record.get("effects_in_model", [])]


def of_extended(results: StudyResults) -> str:
    """What the model of an extended study has beside that of the first, with magnitudes; empty for other studies."""
    names, verdicts, space = effects_in_model(results), results.table("verdicts"), results.table("parameter_space")
    known = {} if verdicts is None else verdicts.set_index("parameter").to_dict("index")
    meaning = {} if space is None else space.set_index("parameter")["description"].to_dict()
    words = []
    for name in names:
        r = known.get(name)
        size = "" if r is None else f", about {with_unit(r['value'], str(r['unit']), 2)} (± {significant(r['std'], 1)})"
        what = f" ({meaning[name]})" if meaning.get(name) else ""
        words.append(f"{in_prose(name)}{what}{size}")
    return " and ".join(words)


def first_page(results: StudyResults) -> str:
    """Address of the page that explains the effects of an extended study, relative to this one; empty without it."""
    folder = results.figures.folder if isinstance(results.figures.folder, Path) else results.figures.folder.folder
    own = str(results.record.get("study", ""))
    if not effects_in_model(results) or not own.endswith(_EXTENDED):
        return ""
    parts = [own.removesuffix(_EXTENDED) if part == own else part for part in folder.parts]
    first = Path(*parts)
    if parts == list(folder.parts) or not (first / "explanation.json").is_file():
        return ""
    return Path(os.path.relpath(first / "report.html", folder)).as_posix()


def doubts(results: StudyResults) -> list[tuple[str, str]]:
    """What speaks against the answer, and how to check each; those of the explanation, then of what followed it."""
    if not results.explanation:
        return []
    found = [(str(one["doubt"]), str(one["check"])) for one in results.explanation.get("doubts", [])]
    found += [_own_mode(own) for own in results.added.get("own_modes", []) if not own.get("paired")]
    if any(run.get("quick") for run in results.analyses.values()):
        found.append(("This is a quick run with small searches.", "Run it in full: calib run without --quick."))
    return found


def _own_mode(own: Mapping[str, Any]) -> tuple[str, str]:
    freq, name = float(own["natural_freq"]), in_prose(str(own["effect"]))
    low, high = (with_unit(freq * (1 + side * _NEAR), "Hz", 3) for side in (-1, 1))
    return (
        f"{name[:1].upper()}{name[1:]} adds a mode at {with_unit(freq, 'Hz', 3)} that no measured mode pairs with. "
        f"The {name} has {fixed(100 * float(own['share']), 0)} % of the kinetic energy of that mode and the structure "
        f"has the rest: its frequency is not the natural frequency of the {name} alone.",
        f"Look for a peak between {low} and {high} in the FRFs at the place, or excite there and measure it.",
    )


def score_cells(table: pd.DataFrame) -> list[str]:
    """How far each named effect changes the data, and the smallest magnitude that would show."""
    return [
        f"{fixed(abs(r['z']), 0)} standard deviations; {significant(r['magnitude_min'], 2)} {r['unit']} would just show"
        for r in table.to_dict("records")
    ]
