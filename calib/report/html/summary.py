"""The answer before the story: a verdict in one line, and the few numbers that carry it."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from calib.report.html.answers import STAGES, Answers
from calib.report.html.effects import effects_table
from calib.report.html.numbers import fixed, flag, percent, significant, with_unit

DATA = {
    "fit": "error in fitted data",
    "left_out": "error in data left out in turn",
    "withheld_sensors": "error at withheld sensors",
    "withheld_modes": "error in withheld modes",
    "withheld_responses": "error in withheld responses",
}


@dataclass(frozen=True)
class Summary:
    """What stands in the box at the top.

    Attributes
    ----------
    verdict : str
    facts : tuple of (what, number in words)
    origin : str
        Study, version and time of the last question.
    """

    verdict: str
    facts: tuple[tuple[str, str], ...]
    origin: str = ""


def summary(answers: Answers) -> Summary:
    """The verdict of the last question that has one, and its numbers."""
    facts = [*_measured(answers), *_calibrated(answers), *_explained(answers)]
    verdict = _explanation(answers) or _calibration(answers) or _comparison(answers)
    return Summary(verdict, tuple(facts), _origin(answers))


def _origin(answers: Answers) -> str:
    last = max(answers.questions.values(), key=lambda q: str(q.get("when", "")), default=None)
    if last is None:
        return ""
    quick = ", a quick look" if any(q.get("quick") for q in answers.questions.values()) else ""
    version = last.get("versions", {}).get("calib", "")
    what = "A fit from Python" if answers.record.get("notebook") else f"Study {answers.name}, answered"
    return f"{what} on {str(last.get('when', ''))[:10]} by calib {version}{quick}."


def _explanation(answers: Answers) -> str:
    told = answers.explanation
    table = effects_table(answers) if told else None
    titles = {} if table is None else {str(r["name"]): str(r["title"]) for r in table.to_dict("records")}
    chosen = [titles.get(name, name) for name in told.get("chosen", [])]
    credible = [titles.get(name, name) for name in told.get("credible_set", [])]
    fault = told.get("measurement_fault")
    if isinstance(fault, dict):
        credible.append(f"{fault.get('name', '')}, a fault of the measurement")
    datum = told.get("wrong_datum")
    if isinstance(datum, dict):
        credible.append(f"{datum.get('what', '')}, measured wrong")
    words = {
        "effect": f"Something is missing in the model, and it is named: {' and '.join(chosen)}.",
        "two_effects": f"Two things are missing in the model, and they are named: {' and '.join(chosen)}.",
        "indistinguishable": f"Something is missing in the model; these data cannot tell which: {'; '.join(credible)}.",
        "unconfirmed": f"{' and '.join(chosen)} would fit, but that is not confirmed: nothing is named.",
        "partial": f"Something is missing in the model; {' and '.join(chosen) or 'an effect'} explains a part only.",
        "none_explains": "Something is missing in the model that no effect of the library explains.",
        "misfit_unlocated": "The misfit is beyond the scatter, but nothing stands out that could be missing.",
        "nothing_detectable": "Nothing is missing in the model that these data could show.",
        "noise_underestimated": "The scatter of the measurement seems to be understated; nothing can be named.",
    }
    told_of = " ".join([words.get(str(told.get("verdict", "")), ""), str(answers.added.get("conclusion", ""))])
    return told_of.strip()


def _calibration(answers: Answers) -> str:
    told = answers.summary
    if not told:
        return ""
    label = "mean error" if answers.plain else "mean frequency error"
    words = f"Calibrated: the {label} fell from {percent(told['mean_freq_error_before'])} % to "
    words += f"{percent(told['mean_freq_error_after'])} %"
    if told.get("mean_mac_after") is not None:
        words += f", the mean MAC went from {fixed(told['mean_mac_before'], 3)} to {fixed(told['mean_mac_after'], 3)}"
    fits = next((s for s in answers.sentences("calibrate") if s.startswith("Sum of squares")), "")
    return " ".join([f"{words}.", *filter(None, [fits]), *map(str, told.get("contradictions", ()))])


def _comparison(answers: Answers) -> str:
    if answers.plain:
        table = answers.table("comparison_before", ["response"], ["error"])
        error = None if table is None else table["error"].abs().mean()
    else:
        compared = answers.compared("before")
        error = None if compared is None else compared["freq_error"].abs().mean()
    if error is None or pd.isna(error):
        return "No answer is of the present state of the study." if answers.stale else "Nothing was compared yet."
    return f"Compared, nothing fitted: the model misses the measurement by {percent(error)} % on average."


def _measured(answers: Answers) -> list[tuple[str, str]]:
    name = "response" if answers.plain else "mode"
    table = answers.table("measured", [name])
    if table is None:
        return []
    sensors = answers.table("sensors", ["sensor"])
    words = f"{len(table)} {name}{'s' * (len(table) != 1)}"
    words += "" if sensors is None else f", {len(sensors)} sensors"
    repeats = answers.record.get("repeats")
    return [("measured", words + (f", {repeats} repeats" if repeats and repeats > 1 else ""))]


def _calibrated(answers: Answers) -> list[tuple[str, str]]:
    told = answers.summary
    if not told:
        compared = answers.compared("before")
        if compared is None or not compared["freq_error"].notna().any():
            return []
        out = [("mean frequency error, nothing fitted", f"{percent(compared['freq_error'].abs().mean())} %")]
        mac = compared["mac"].mean()
        return out if pd.isna(mac) else [*out, ("mean MAC, nothing fitted", fixed(mac, 3))]
    label = "mean error" if answers.plain else "mean frequency error"
    errors = [told[f"mean_freq_error_{stage}"] for stage in ("before", "after")]
    added = answers.added if answers.added_names else {}
    errors += [added["mean_freq_error"]] if added else []
    more = f", with {' + '.join(answers.added_names)}" if added else ""
    floor = told.get("noise_freq_error")
    allowed = "" if floor is None else f" (noise allows {percent(floor)} %)"
    out = [(f"{label}, calibrated{more}", " → ".join(f"{percent(error)} %" for error in errors) + allowed)]
    if told.get("mean_mac_after") is not None:
        noise = "" if told.get("noise_mac") is None else f" (noise allows {fixed(told['noise_mac'], 3)})"
        macs = [told[f"mean_mac_{stage}"] for stage in ("before", "after")] + ([added["mean_mac"]] if added else [])
        out.append((f"mean MAC, calibrated{more}", " → ".join(fixed(mac, 3) for mac in macs) + noise))
    verdicts = answers.table("verdicts", ["parameter"], flags=["identified"])
    if verdicts is not None:
        judged = verdicts["identified"].dropna()  # as the sentences count
        out.append(("parameters identified", f"{sum(map(flag, judged))} of {len(judged)}"))
    return out


def _explained(answers: Answers) -> list[tuple[str, str]]:
    told = answers.explanation
    out = []
    if told.get("verdict") in ("effect", "indistinguishable", "two_effects"):
        table = effects_table(answers)
        for r in [] if table is None else table.to_dict("records"):
            if r["name"] in told.get("chosen", []) and flag(r["refitted"]):
                interval = f"{significant(r['phi_low'], 3)} to {significant(r['phi_high'], 3)}"
                out.append((f"strength of {r['name']}", f"{with_unit(r['phi'], str(r['unit']))} (95 %: {interval})"))
    for group, found in (_added_errors(answers) or told.get("errors", {})).items():
        if found.get("before") is not None:
            after = "" if found.get("after") is None else f" → {fixed(found['after'], 2)}"
            out.append((DATA.get(group, group), f"{fixed(found['before'], 2)}{after} σ"))
    return out


def _added_errors(answers: Answers) -> dict[str, dict[str, float]]:
    """Errors of the calibrated models by group and stage, where something was added."""
    table = answers.table("added_errors", ["group", "stage"], ["rms"])
    if table is None:
        return {}
    rms = table.set_index(["group", "stage"])["rms"]
    return {group: {stage: float(rms[group, stage]) for stage in STAGES} for group in dict.fromkeys(table["group"])}
