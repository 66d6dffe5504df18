"""Benefit of an added effect: errors of the model without and with it, both calibrated in the same way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calib.analyses.calibration import Calibration
from calib.analyses.every_mode import with_held_out
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.errors.errors import EvaluationError
from calib.hypotheses.own_modes import COLUMNS as OWN_COLUMNS
from calib.hypotheses.own_modes import own_modes, own_modes_sentence
from calib.hypotheses.rules import RULES
from calib.inference.rules import WIDE
from calib.missing.adequacy import UNSEEN, contradicting
from calib.missing.candidate_fit import CandidateFit
from calib.missing.data_words import GROUPS
from calib.missing.explanation import NAMED, Explanation
from calib.missing.partial import is_simpler_form
from calib.problem.candidate import Candidate
from calib.results.results import Results
from calib.study.study import LoadedStudy

WORDS = {"fit": "used data", **GROUPS}
COLUMNS = ("group", "stage", "rows", "rms", "expected", "p", "unpaired")


@dataclass(frozen=True, eq=False)
class Added:
    """The effects that were added, and how the errors changed.

    Attributes
    ----------
    effects : tuple of Candidate
        Empty when nothing was added.
    sentence : str
        How the errors changed, or why no effect was added.
    conclusion : str
        Whether the model fits and predicts better with them; empty where the errors are unknown.
    errors : DataFrame
        ``added_errors.csv``: ``group, stage, rows, rms, expected, p, unpaired``, stages ``before`` and ``after``.
    parameters : DataFrame
        ``added_parameters.csv``: ``parameter, unit, added, nominal`` and, of the stages ``before`` and ``after``, the
        value and its ``_std`` and ``_identified``.
    own : str
        Modes of the effects' own that no measured mode pairs with, in words; empty without any.
    modes : DataFrame
        ``added_modes.csv``: ``mode, held_out, freq_kind, freq_measured`` and ``freq_, error_, mac_`` of the stages
        ``initial`` (nominal values), ``before`` (calibrated) and ``after`` (calibrated with the added effects).
    test : str
        Name of the test, where there are several.
    """

    effects: tuple[Candidate, ...]
    sentence: str
    conclusion: str
    own: str
    errors: pd.DataFrame
    parameters: pd.DataFrame
    modes: pd.DataFrame
    test: str = ""


def to_add(found: Explanation) -> CandidateFit | None:
    """The fit with the named effects if the verdict leaves no competing model; None otherwise."""
    if found.verdict not in NAMED or found.chosen is None or found.granted or found.mistakable:
        return None
    return found.chosen if set(found.equally_good) == set(found.chosen.names) else None


def nothing_added(found: Explanation) -> str:
    """Why no effect is added, in words."""
    untold = (
        f"These data cannot discriminate between {' and '.join(found.equally_good)}, so none of them is "
        "added: inspect the structure, or make a measurement that discriminates between them."
    )
    if found.steps is not None and found.steps.competing:
        pairs = "; and between ".join(f"{name} and {other}" for name, other in found.steps.competing)
        untold = f"These data cannot discriminate between {pairs}, so nothing is added: inspect the structure."
    if found.verdict in NAMED and found.granted:
        return "The measurement has errors beside what the model lacks: correct them first, so that nothing is added."
    if found.mistakable:
        pairs = "; and between ".join(f"{name} and {other}" for name, other in found.mistakable)
        untold = f"These data cannot discriminate between {pairs}, so nothing is added: inspect the structure."
    named = " and ".join(() if found.chosen is None else found.chosen.names)
    if is_simpler_form(found):
        return (
            f"Something like {named} is missing, but not exactly that, so nothing is added. 'calib extend' adds it "
            "anyway."
        )
    reasons = {
        "nothing_detectable": "These data show no missing effect, so nothing is added.",
        "noise_underestimated": "Correct the standard deviation of the measurement first: nothing is added.",
        "indistinguishable": untold,
        "two_effects": untold,
        "several_effects": untold,
        "measurement": "The measurement is what does not fit, so nothing is added to the model: correct it first.",
        "unconfirmed": f"The best-fitting explanation, {named}, is not confirmed: "
        f"{'nothing competed with it' if found.uncontested else 'validation data contradict it'}, so nothing is added. "
        "'calib extend' adds it anyway.",
        "partial": "The fitted effects explain only part of the misfit and may stand in for another cause, so nothing "
        "is added.",
        "misfit_unlocated": "No effect stands out, so nothing is added: check the data that fit worst.",
        "none_explains": "No listed cause explains the misfit, so nothing is added.",
    }
    return reasons[found.verdict]


def write_nothing_added(study: LoadedStudy, found: Explanation, results: Results, quick: bool = False) -> Added:
    """Report why no effect is added, and write ``added.json``."""
    nothing = pd.DataFrame()
    begin_analysis(results, "extend")
    answer = _written(Added((), nothing_added(found), "", "", nothing, nothing, nothing), results, effects=[])
    write_record(study, results, "extend", {}, (answer.sentence,), quick)
    return answer


def write_added(
    study: LoadedStudy,
    before: Calibration,
    found: CandidateFit,
    extended: LoadedStudy,
    after: Calibration,
    results: Results,
    quick: bool = False,
) -> Added:
    """Compare a calibrated model with its extended version, calibrated in the same way, and write the comparison.

    Parameters
    ----------
    study : Study
    before : Calibration
        Of ``study``.
    found : CandidateFit
        The explanation's fit with the added effects.
    extended : Study
        The study with these effects.
    after : Calibration
        Of ``extended``.
    results : Results
        Of ``study``; ``added.json``, the ``added_*`` tables and those of the comparison after are written there.
    quick : bool
        Whether both calibrations were quick runs.
    """
    effects = found.effects
    errors = _errors(before, after)
    parameters = _parameters(extended, effects, before, after)
    magnitudes = [_magnitude(effect, extended, after) for effect in effects]
    benefit = "" if errors.empty else f"With the effect{'s' * (len(effects) > 1)} {conclusion(errors)}."
    modes = _modes(before, after)
    in_full = f"{benefit} {_held_out_modes(modes)}".strip()
    words = [_sentence(magnitudes, errors, in_full), *_unsettled(magnitudes, found)]
    words += ["Both are quick runs: confirm them with full ones."] if quick else []
    own = _own_modes(study, effects, extended, after)
    told = own_modes_sentence(own)
    answer = Added(effects, " ".join(words), benefit, told, errors, parameters, modes, study.test)
    begin_analysis(results, "extend")
    results.write_table("added_errors", errors)
    results.write_table("added_parameters", parameters)
    if len(answer.modes):
        results.write_table("added_modes", answer.modes)
    end = after.best.answer
    results.write_table("comparison_added", end.table)
    if end.frfs is not None:
        results.write_table("frf_added", end.frfs.overlay_table())
        results.write_table("frf_lines_added", end.frfs.lines_table())
    if end.comparison is not None:
        results.write_table("where_it_fails_added", end.comparison.where_it_fails())
    given = extended.settings
    seeds = {**{case.name: case.seed for case in given.calibration.cases}, "reduction": given.reduction.seed}
    reached = {"mean_freq_error": end.mean_freq_error, "mean_mac": end.mean_mac}
    brought = {"own_modes": own.to_dict("records"), "own": told}
    _written(answer, results, effects=magnitudes, study=str(extended.file.parent), quick=quick, **brought, **reached)
    write_record(study, results, "extend", seeds, (answer.sentence, told) if told else (answer.sentence,), quick)
    return answer


def _written(answer: Added, results: Results, **more: object) -> Added:
    """Write ``added.json``."""
    results.write_json("added", {"sentence": answer.sentence, "conclusion": answer.conclusion, **more})
    return answer


def _errors(before: Calibration, after: Calibration) -> pd.DataFrame:
    stages = {"before": before.errors, "after": after.errors}
    known = [table.assign(stage=stage) for stage, table in stages.items() if table is not None]
    return pd.concat(known, ignore_index=True)[list(COLUMNS)] if len(known) == 2 else pd.DataFrame(columns=COLUMNS)


def _parameters(
    study: LoadedStudy, effects: Sequence[Candidate], before: Calibration, after: Calibration
) -> pd.DataFrame:
    """Fitted values without and with the added effects; NaN where a parameter was not fitted."""
    own = {name for effect in effects for name in effect.names}
    was, now = (
        c.verdicts.set_index("parameter")[["value", "std", "identified"]]
        .astype({"value": float, "std": float})
        .rename(columns={"value": stage, "std": f"{stage}_std", "identified": f"{stage}_identified"})
        for stage, c in (("before", before), ("after", after))
    )
    table = now.join(was)
    space = study.problem.space
    table = table[[name in space for name in table.index]]
    table["unit"] = [space[name].unit for name in table.index]
    table["added"] = [name in own for name in table.index]
    table["nominal"] = [space[name].value for name in table.index]
    stages = [f"{stage}{end}" for stage in ("before", "after") for end in ("", "_std", "_identified")]
    columns = ["unit", "added", "nominal", *stages]
    return table[columns].reset_index()


def _modes(before: Calibration, after: Calibration) -> pd.DataFrame:
    """All measured modes: nominal, calibrated, and calibrated with the added effects; empty for scalar responses."""
    if before.modes is None or after.modes is None:
        return pd.DataFrame()
    table = before.modes[["mode", "held_out", "freq_kind", "freq_measured"]].copy()
    stages = {"initial": (before.modes, "before"), "before": (before.modes, "after"), "after": (after.modes, "after")}
    for stage, (modes, own) in stages.items():
        for kind in ("freq", "error", "mac"):
            table[f"{kind}_{stage}"] = modes[f"{kind}_{own}"]
    return table


def _own_modes(
    study: LoadedStudy, effects: Sequence[Candidate], extended: LoadedStudy, after: Calibration
) -> pd.DataFrame:
    """Modes of the effects' own in the calibrated extended model; empty where it has none or cannot be solved."""
    used = after.best.answer.comparison
    if used is None:
        return pd.DataFrame(columns=list(OWN_COLUMNS))
    order = extended.settings.with_effects
    names = {effect.name for effect in effects}
    every = (one for e in study.library for one in e.family)
    placed = sorted((e for e in every if e.name in names), key=lambda effect: order.index(effect.name))
    with suppress(EvaluationError):
        return own_modes(study.model, placed, with_held_out(extended, used))
    return pd.DataFrame(columns=list(OWN_COLUMNS))


def _magnitude(effect: Candidate, study: LoadedStudy, after: Calibration) -> dict[str, object]:
    """Name, title, fitted magnitude and its 95 % interval, clipped to the limits of the search."""
    name, limits = effect.magnitude.name, study.search_space[effect.magnitude.name]
    known = dict(zip(after.verdicts["parameter"], after.verdicts["std"], strict=True))
    value, reach = after.best.result.values[name], WIDE * float(known.get(name, math.nan))
    interval = np.clip([value - reach, value + reach], limits.lower, limits.upper).tolist()
    ends = dict(zip(("low", "high"), interval, strict=True))
    return {"name": effect.name, "title": effect.title, "unit": effect.magnitude.unit, "value": value, **ends}


# -- words -------------------------------------------------------------------------------------------------------------


def _sentence(magnitudes: Sequence[Mapping[str, Any]], errors: pd.DataFrame, summary: str) -> str:
    named = " and ".join(f"{s['title']} ({s['name']}), {_with_interval(s)}" for s in magnitudes)
    if errors.empty:
        return f"Added: {named}. The errors are unknown: the model cannot be evaluated near the best values."
    listed = "; ".join(
        f"{WORDS[r['group']]} {r['rms_before']:.2f} -> {r['rms_after']:.2f} ({r['expected_after']:.2f})"
        for r in by_group(errors).to_dict("records")
    )
    return (
        f"Added: {named}. {summary} Rms error in standard deviations, before -> after "
        f"(what a correct model would show): {listed}."
    )


def _unsettled(magnitudes: Sequence[Mapping[str, Any]], found: CandidateFit) -> list[str]:
    """A sentence for each magnitude that differs from the fit of the explanation, which has the same model."""
    fit = found.fit
    std = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    fitted = {effect.name: effect.magnitude.name for effect in found.effects}
    out = []
    for s in magnitudes:
        name = fitted[s["name"]]
        if abs(s["value"] - fit.values[name]) > RULES.unsettled * std.get(name, math.inf):
            there = _with_interval({**s, "value": fit.values[name], "low": math.nan})
            out.append(
                f"The explanation fitted {s['name']} = {there}; this calibration ended elsewhere: give its search more "
                "generations or cases."
            )
    return out


def _with_interval(magnitude: Mapping[str, Any]) -> str:
    unit = "" if magnitude["unit"] == "-" else f" {magnitude['unit']}"
    if math.isnan(magnitude["low"]):
        return f"{magnitude['value']:.3g}{unit}"
    return f"{magnitude['value']:.3g}{unit} (95 %: {magnitude['low']:.3g} to {magnitude['high']:.3g}{unit})"


def conclusion(errors: pd.DataFrame) -> str:
    """Whether the extended model fits and predicts better, in words.

    Predictions are compared with held-out data or, where nothing is held out, left out one by one. An error that
    noise explains both before and after tells nothing, whether it falls or not.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, rms, expected, p`` of the stages ``before`` and ``after``.
    """
    table = by_group(errors).set_index("group")
    fell = table["rms_after"] < RULES.fallen * table["rms_before"]
    quiet = (table["p_before"] > RULES.within) & (table["p_after"] > RULES.within)
    unseen = [group for group in UNSEEN if group in table.index] or ["left_out"]
    better = [WORDS[g] for g in unseen if fell[g] and not quiet[g]]
    same = [WORDS[g] for g in unseen if not fell[g] and not quiet[g]]
    noise = [WORDS[g] for g in unseen if quiet[g]]
    words = "the model fits better" if fell["fit"] else "the model fits no better"
    if better and not same:
        every = unseen != ["left_out"] and not noise
        words += f" and predicts {'validation data' if every else ' and '.join(better)} better"
    elif better:
        words += f", predicts {' and '.join(better)} better, {' and '.join(same)} no better"
    else:
        words += ", predicts no better"
    words += f"; {' and '.join(noise)} stay within the noise" if noise else ""
    against = [WORDS[g] for g in contradicting(errors, "after")]
    return words + (f"; not confirmed: {' and '.join(against)} contradict it" if against else "")


def _held_out_modes(modes: pd.DataFrame) -> str:
    """How many held-out modes have a smaller frequency error with the effects, and those whose error grew, in words."""
    if modes.empty:
        return ""
    known = modes[modes["held_out"].astype(bool) & modes[["error_before", "error_after"]].notna().all(axis=1)]
    if known.empty:
        return ""
    before, after = (100 * known[f"error_{stage}"].abs() for stage in ("before", "after"))
    grew = [
        f"{mode} ({was:.2f} -> {now:.2f} %)"
        for mode, was, now in zip(known["mode"], before, after, strict=True)
        if now > was
    ]
    fell = len(known) - len(grew)
    if not fell:
        return f"The frequency error grows in every validation mode: {', '.join(grew)}."
    words = f"The frequency error falls in {fell} of {len(known)} validation mode{'s' * (len(known) > 1)}"
    return f"{words}; it grows for {', '.join(grew)}." if grew else f"{words}."


def by_group(errors: pd.DataFrame) -> pd.DataFrame:
    """One row per group of data, in the order of `WORDS`; each column once as ``*_before`` and once as ``*_after``."""
    before, after = (errors[errors["stage"] == stage] for stage in ("before", "after"))
    table = before.merge(after, on="group", suffixes=("_before", "_after")).set_index("group")
    return table.reindex([group for group in WORDS if group in table.index]).reset_index()
