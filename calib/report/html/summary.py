"""Summary at the top of the page: the verdict and its key numbers."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from calib.report.html.effects import effects_table
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.numbers import fixed, flag, percent, significant, with_unit

DATA = {
    "fit": "error in fitted data",
    "left_out": "leave-one-out error",
    "held_out_sensors": "error at held-out sensors",
    "held_out_modes": "error in held-out modes",
    "held_out_responses": "error in held-out responses",
}


@dataclass(frozen=True)
class Summary:
    """Contents of the summary box.

    Attributes
    ----------
    verdict : str
    facts : tuple of (name, formatted number)
    origin : str
        Study, version and time of the last analysis.
    """

    verdict: str
    facts: tuple[tuple[str, str], ...]
    origin: str = ""


def summary(results: StudyResults) -> Summary:
    """Return the verdict of the last analysis that has one, with the key numbers."""
    facts = [*_measured(results), *_calibrated(results), *_explained(results)]
    verdict = _explanation(results) or _calibration(results) or _comparison(results)
    return Summary(verdict, tuple(facts), _origin(results))


def _origin(results: StudyResults) -> str:
    last = max(results.analyses.values(), key=lambda a: str(a.get("when", "")), default=None)
    if last is None:
        return ""
    quick = ", a quick run" if any(a.get("quick") for a in results.analyses.values()) else ""
    version = last.get("versions", {}).get("calib", "")
    what = "A fit from Python" if results.record.get("notebook") else f"Study {results.name}, analysed"
    return f"{what} on {str(last.get('when', ''))[:10]} by calib {version}{quick}."


def _explanation(results: StudyResults) -> str:
    explanation = results.explanation
    table = effects_table(results) if explanation else None
    titles = {} if table is None else {str(r["name"]): str(r["title"]) for r in table.to_dict("records")}
    chosen = [titles.get(name, name) for name in explanation.get("chosen", [])]
    credible = [titles.get(name, name) for name in explanation.get("credible_set", [])]
    fault = explanation.get("measurement_fault")
    if isinstance(fault, dict):
        credible.append(f"{fault.get('name', '')}, a fault of the measurement")
    datum = explanation.get("wrong_datum")
    if isinstance(datum, dict):
        credible.append(f"{datum.get('what', '')}, an erroneous datum")
    verdicts = {
        "effect": f"Something is missing in the model, and it is named: {' and '.join(chosen)}.",
        "two_effects": f"Two things are missing in the model, and they are named: {' and '.join(chosen)}.",
        "indistinguishable": f"Something is missing in the model; these data cannot tell which: {'; '.join(credible)}.",
        "unconfirmed": f"{' and '.join(chosen)} would fit, but is not confirmed: no effect is named.",
        "partial": f"Something is missing in the model; {' and '.join(chosen) or 'an effect'} explains a part of it.",
        "none_explains": "Something is missing in the model that no effect of the library explains.",
        "misfit_unlocated": "The misfit exceeds the measurement uncertainty, but no missing effect stands out.",
        "nothing_detectable": "These data show no missing effect.",
        "noise_underestimated": "The measurement uncertainty seems to be understated; no effect can be named.",
    }
    verdict = verdicts.get(str(explanation.get("verdict", "")), "")
    return f"{verdict} {results.added.get('conclusion', '')}".strip()


def _calibration(results: StudyResults) -> str:
    figures = results.summary
    if not figures:
        return ""
    label = "mean error" if results.scalar else "mean frequency error"
    words = f"Calibrated: the {label} fell from {percent(figures['mean_freq_error_before'])} % to "
    words += f"{percent(figures['mean_freq_error_after'])} %"
    if figures.get("mean_mac_after") is not None:
        macs = (fixed(figures[f"mean_mac_{stage}"], 3) for stage in STAGES)
        words += f", the mean MAC went from {' to '.join(macs)}"
    fits = next((s for s in results.sentences("calibrate") if s.startswith("Sum of squares")), "")
    return " ".join([f"{words}.", *filter(None, [fits]), *map(str, figures.get("contradictions", ()))])


def _comparison(results: StudyResults) -> str:
    if results.scalar:
        table = results.table("comparison_before", ["response"], ["error"])
        error = None if table is None else table["error"].abs().mean()
    else:
        compared = results.compared("before")
        error = None if compared is None else compared["freq_error"].abs().mean()
    if error is None or pd.isna(error):
        stale = "There are no results for the present state of the study."
        return stale if results.stale else "No comparison has been run yet."
    return f"Compared, nothing fitted: the mean error of the model is {percent(error)} %."


def _measured(results: StudyResults) -> list[tuple[str, str]]:
    name = "response" if results.scalar else "mode"
    table = results.table("measured", [name])
    if table is None:
        return []
    sensors = results.table("sensors", ["sensor"])
    words = f"{len(table)} {name}{'s' * (len(table) != 1)}"
    words += "" if sensors is None else f", {len(sensors)} sensors"
    repeats = results.record.get("repeats")
    return [("measured", words + (f", {repeats} repeats" if repeats and repeats > 1 else ""))]


def _calibrated(results: StudyResults) -> list[tuple[str, str]]:
    figures = results.summary
    if not figures:
        compared = results.compared("before")
        if compared is None or not compared["freq_error"].notna().any():
            return []
        out = [("mean frequency error, nothing fitted", f"{percent(compared['freq_error'].abs().mean())} %")]
        mac = compared["mac"].mean()
        return out if pd.isna(mac) else [*out, ("mean MAC, nothing fitted", fixed(mac, 3))]
    label = "mean error" if results.scalar else "mean frequency error"
    errors = [figures[f"mean_freq_error_{stage}"] for stage in ("before", "after")]
    added = results.added if results.added_names else {}
    errors += [added["mean_freq_error"]] if added else []
    more = f", with {' + '.join(results.added_names)}" if added else ""
    floor = figures.get("noise_freq_error")
    allowed = "" if floor is None else f" (noise allows {percent(floor)} %)"
    out = [(f"{label}, calibrated{more}", " → ".join(f"{percent(error)} %" for error in errors) + allowed)]
    if figures.get("mean_mac_after") is not None:
        noise = "" if figures.get("noise_mac") is None else f" (noise allows {fixed(figures['noise_mac'], 3)})"
        macs = [figures[f"mean_mac_{stage}"] for stage in ("before", "after")] + ([added["mean_mac"]] if added else [])
        out.append((f"mean MAC, calibrated{more}", " → ".join(fixed(mac, 3) for mac in macs) + noise))
    verdicts = results.table("verdicts", ["parameter"], flags=["identified"])
    if verdicts is not None:
        known = verdicts["identified"].dropna()  # counted as in the sentences
        out.append(("parameters identified", f"{sum(map(flag, known))} of {len(known)}"))
    return out


def _explained(results: StudyResults) -> list[tuple[str, str]]:
    explanation = results.explanation
    out = []
    if explanation.get("verdict") in ("effect", "indistinguishable", "two_effects"):
        table = effects_table(results)
        for r in [] if table is None else table.to_dict("records"):
            if r["name"] in explanation.get("chosen", []) and flag(r["refitted"]):
                interval = f"{significant(r['magnitude_low'], 3)} to {significant(r['magnitude_high'], 3)}"
                out.append(
                    (f"magnitude of {r['name']}", f"{with_unit(r['magnitude'], str(r['unit']))} (95 %: {interval})")
                )
    for group, found in (_added_errors(results) or explanation.get("errors", {})).items():
        if found.get("before") is not None:
            after = "" if found.get("after") is None else f" → {fixed(found['after'], 2)}"
            out.append((DATA.get(group, group), f"{fixed(found['before'], 2)}{after} σ"))
    return out


def _added_errors(results: StudyResults) -> dict[str, dict[str, float]]:
    """Errors of the calibrated models by group and stage, where effects were added."""
    table = results.table("added_errors", ["group", "stage"], ["rms"])
    if table is None:
        return {}
    rms = table.set_index(["group", "stage"])["rms"]
    return {group: {stage: float(rms[group, stage]) for stage in STAGES} for group in dict.fromkeys(table["group"])}
