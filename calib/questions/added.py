"""What an effect that was named and added brings: errors before and after, both models calibrated alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calib.effect import Effect
from calib.missing.findings import Findings, Trial
from calib.missing.held_out import UNSEEN, contradicting
from calib.missing.verdict import GROUPS
from calib.questions.calibrate import Calibration
from calib.questions.record import begin_answer, write_record
from calib.results import Results
from calib.study import Study

WORDS = {"fit": "used data", **GROUPS}
COLUMNS = ("group", "stage", "rows", "rms", "expected", "p", "unpaired")
TWO_SIDED = 1.96
"""Standard deviations on either side that hold 95 %."""
FALLEN = 0.98
"""Ratio of two errors under which the second has fallen; less hardly shows in the two decimals they are told with."""
UNSETTLED = 2.0
"""Standard deviations between a strength as calibrated and as explained from which one of them has not settled."""
WITHIN = 0.05
"""Chance of a right model from which an error is that of noise."""


@dataclass(frozen=True, eq=False)
class Added:
    """What was added, and what it brought.

    Attributes
    ----------
    effects : tuple of Effect
        Empty when nothing was added.
    sentence : str
        What they bring, or why none was added.
    conclusion : str
        Whether the model fits and predicts better with them; empty where that is not known.
    errors : DataFrame
        ``added_errors.csv``: ``group, stage, rows, rms, expected, p, unpaired``, stages ``before`` and ``after``.
    parameters : DataFrame
        ``added_parameters.csv``: ``parameter, unit, added, adopted, before, before_std, after, after_std``.
    modes : DataFrame
        ``added_modes.csv``: ``mode, withheld, damped_freq_measured`` and ``damped_freq_, error_, mac_`` of the stages
        ``initial`` (nothing fitted), ``before`` (calibrated) and ``after`` (calibrated with what was added).
    """

    effects: tuple[Effect, ...]
    sentence: str
    conclusion: str
    errors: pd.DataFrame
    parameters: pd.DataFrame
    modes: pd.DataFrame


def to_add(found: Findings) -> Trial | None:
    """The explanation that a verdict names without a rival; None for every other verdict."""
    if found.verdict not in ("effect", "two_effects") or found.chosen is None:
        return None
    return found.chosen if set(found.untold) == set(found.chosen.names) else None


def nothing_added(found: Findings) -> str:
    """Why nothing is added."""
    untold = (
        f"These data cannot tell between {' and '.join(found.untold)}, so none of them is "
        "added: look at the structure, or measure what would tell them apart."
    )
    named = " and ".join(() if found.chosen is None else found.chosen.names)
    reasons = {
        "nothing_detectable": "Nothing is missing that these data could show, so nothing is added and the story ends "
        "here.",
        "noise_underestimated": "The scatter of the measurement has to be mended first, so nothing is added.",
        "indistinguishable": untold,
        "two_effects": untold,
        "unconfirmed": f"What fits, {named}, is not confirmed: "
        f"{'it had no unnamed rival' if found.unrivalled else 'withheld data contradict it'}, so nothing is added. "
        "'calib extend' adds it all the same.",
        "partial": "What was tried explains a part only and may stand in for something else, so nothing is added.",
        "misfit_unlocated": "No effect stands out, so nothing is added: look at the measurement that fits worst.",
        "none_explains": "No effect of the library explains what is missing, so nothing is added.",
    }
    return reasons[found.verdict]


def write_nothing_added(study: Study, found: Findings, results: Results, quick: bool = False) -> Added:
    """Tell why nothing is added, and write it."""
    nothing = pd.DataFrame()
    begin_answer(results, "extend")
    answer = _written(Added((), nothing_added(found), "", nothing, nothing, nothing), results, effects=[])
    write_record(study, results, "extend", {}, (answer.sentence,), quick)
    return answer


def write_added(
    study: Study,
    before: Calibration,
    found: Trial,
    extended: Study,
    after: Calibration,
    results: Results,
    quick: bool = False,
) -> Added:
    """Compare a calibrated model with the same one that has effects more, calibrated alike; write what they bring.

    Parameters
    ----------
    study : Study
    before : Calibration
        Of its model.
    found : Trial
        The explanation: what was added, as it was fitted there.
    extended : Study
        The study with them.
    after : Calibration
        Of its model.
    results : Results
        Of ``study``; here ``added.json`` and the ``added_*`` tables are written.
    quick : bool
        Whether both were small searches for a first look.
    """
    effects = found.effects
    errors = _errors(before, after)
    parameters = _parameters(extended, effects, before, after)
    strengths = [_strength(effect, extended, after) for effect in effects]
    told = "" if errors.empty else f"With {'it' if len(effects) == 1 else 'them'} {conclusion(errors)}."
    words = [_sentence(strengths, errors, told), *_unsettled(strengths, found)]
    words += ["Both are quick looks: ask the whole to be sure."] if quick else []
    answer = Added(effects, " ".join(words), told, errors, parameters, _modes(before, after))
    begin_answer(results, "extend")
    results.write_table("added_errors", errors)
    results.write_table("added_parameters", parameters)
    if len(answer.modes):
        results.write_table("added_modes", answer.modes)
    given = extended.settings
    seeds = {**{case.name: case.seed for case in given.calibration.cases}, "reduction": given.reduction.seed}
    reached = {"mean_freq_error": after.best.answer.mean_freq_error, "mean_mac": after.best.answer.mean_mac}
    _written(answer, results, effects=strengths, study=str(extended.file.parent), quick=quick, **reached)
    write_record(study, results, "extend", seeds, (answer.sentence,), quick)
    return answer


def _written(answer: Added, results: Results, **more: object) -> Added:
    """Write ``added.json``."""
    results.write_json("added", {"sentence": answer.sentence, "conclusion": answer.conclusion, **more})
    return answer


def _errors(before: Calibration, after: Calibration) -> pd.DataFrame:
    stages = {"before": before.errors, "after": after.errors}
    known = [table.assign(stage=stage) for stage, table in stages.items() if table is not None]
    return pd.concat(known, ignore_index=True)[list(COLUMNS)] if len(known) == 2 else pd.DataFrame(columns=COLUMNS)


def _parameters(study: Study, effects: Sequence[Effect], before: Calibration, after: Calibration) -> pd.DataFrame:
    """Fitted values without and with what was added; NaN where a parameter was not fitted."""
    own = {name for effect in effects for name in effect.names}
    found = [c.verdicts.set_index("parameter")[["value", "std"]].astype(float) for c in (before, after)]
    table = found[1].rename(columns={"value": "after", "std": "after_std"})
    table = table.join(found[0].rename(columns={"value": "before", "std": "before_std"}))
    space = study.model.space
    table = table[[name in space for name in table.index]]
    table["unit"] = [space[name].unit for name in table.index]
    table["added"] = [name in own for name in table.index]
    table["adopted"] = [space[name].value for name in table.index]
    columns = ["unit", "added", "adopted", "before", "before_std", "after", "after_std"]
    return table[columns].reset_index()


def _modes(before: Calibration, after: Calibration) -> pd.DataFrame:
    """All measured modes, nothing fitted, fitted, and fitted with what was added; empty for plain responses."""
    if before.modes is None or after.modes is None:
        return pd.DataFrame()
    table = before.modes[["mode", "withheld", "damped_freq_measured"]].copy()
    stages = {"initial": (before.modes, "before"), "before": (before.modes, "after"), "after": (after.modes, "after")}
    for stage, (modes, own) in stages.items():
        for kind in ("damped_freq", "error", "mac"):
            table[f"{kind}_{stage}"] = modes[f"{kind}_{own}"]
    return table


def _strength(effect: Effect, study: Study, after: Calibration) -> dict[str, object]:
    """Name, title, fitted strength and its 95 % interval, between the limits of the search."""
    name, limits = effect.strength.name, study.search_space[effect.strength.name]
    known = dict(zip(after.verdicts["parameter"], after.verdicts["std"], strict=True))
    value, reach = after.best.result.values[name], TWO_SIDED * float(known.get(name, math.nan))
    interval = np.clip([value - reach, value + reach], limits.lower, limits.upper).tolist()
    ends = dict(zip(("low", "high"), interval, strict=True))
    return {"name": effect.name, "title": effect.title, "unit": effect.strength.unit, "value": value, **ends}


# -- words -------------------------------------------------------------------------------------------------------------


def _sentence(strengths: Sequence[Mapping[str, Any]], errors: pd.DataFrame, told_of: str) -> str:
    named = " and ".join(f"{s['title']} ({s['name']}), {_with_interval(s)}" for s in strengths)
    if errors.empty:
        return f"Added: {named}. Its errors are not known: the model fails beside the best values."
    told = "; ".join(
        f"{WORDS[r['group']]} {r['rms_before']:.2f} -> {r['rms_after']:.2f} ({r['expected_after']:.2f})"
        for r in by_group(errors).to_dict("records")
    )
    return (
        f"Added: {named}. {told_of} Rms error in units of the scatter, before -> after "
        f"(what a right model would show): {told}."
    )


def _unsettled(strengths: Sequence[Mapping[str, Any]], found: Trial) -> list[str]:
    """Says so when a search has ended elsewhere than the explanation, which has fitted the same model."""
    state = found.state
    std = dict(zip(state.names, np.sqrt(np.diag(state.covariance)), strict=True))
    fitted = {effect.name: effect.strength.name for effect in found.effects}
    out = []
    for s in strengths:
        name = fitted[s["name"]]
        if abs(s["value"] - state.values[name]) > UNSETTLED * std.get(name, math.inf):
            there = _with_interval({**s, "value": state.values[name], "low": math.nan})
            out.append(
                f"The explanation's own fit has {there} of {s['name']}: this calibration ended elsewhere, give its "
                "search more generations or cases."
            )
    return out


def _with_interval(strength: Mapping[str, Any]) -> str:
    unit = "" if strength["unit"] == "-" else f" {strength['unit']}"
    if math.isnan(strength["low"]):
        return f"{strength['value']:.3g}{unit}"
    return f"{strength['value']:.3g}{unit} (95 %: {strength['low']:.3g} to {strength['high']:.3g}{unit})"


def conclusion(errors: pd.DataFrame) -> str:
    """Whether a model with effects more fits and predicts better, in words.

    Data count as predicted that no fit has seen; where nothing is withheld, what was left out in turn.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, rms, expected, p`` of the stages ``before`` and ``after``.
    """
    table = by_group(errors).set_index("group")
    fell = table["rms_after"] < FALLEN * table["rms_before"]
    quiet = ~fell & (table["p_before"] > WITHIN) & (table["p_after"] > WITHIN)
    unseen = [group for group in UNSEEN if group in table.index] or ["left_out"]
    better = [WORDS[g] for g in unseen if fell[g]]
    same = [WORDS[g] for g in unseen if not fell[g] and not quiet[g]]
    noise = [WORDS[g] for g in unseen if quiet[g]]
    told = "the model fits better" if fell["fit"] else "the model fits no better"
    if better and not same:
        told += (
            " and predicts better what no fit has seen"
            if unseen != ["left_out"]
            else f" and predicts {better[0]} better"
        )
    elif better:
        told += f", predicts {' and '.join(better)} better, {' and '.join(same)} no better"
    else:
        told += ", predicts no better"
    told += f"; {' and '.join(noise)} stay within the noise" if noise else ""
    against = [WORDS[g] for g in contradicting(errors, "after")]
    return told + (f"; not confirmed: {' and '.join(against)} contradict it" if against else "")


def by_group(errors: pd.DataFrame) -> pd.DataFrame:
    """One row a group of data in the order of `WORDS`, with ``rows, rms, expected, p`` as ``rms_before, rms_after``."""
    before, after = (errors[errors["stage"] == stage] for stage in ("before", "after"))
    table = before.merge(after, on="group", suffixes=("_before", "_after")).set_index("group")
    return table.reindex([group for group in WORDS if group in table.index]).reset_index()
