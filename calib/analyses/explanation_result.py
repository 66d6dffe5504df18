"""Result of a study's explanation: the facts that it starts from, its part for each test, ``explanation.json``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.hypotheses.joint import JointAdapter
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.explanation import Explanation
from calib.missing.findings import ExplanationResult
from calib.missing.local import local_perturbation
from calib.missing.partial import is_simpler_form
from calib.missing.test import Adapter
from calib.missing.verdict import GROUPS as UNSEEN_GROUPS
from calib.problem.joint import TEST
from calib.study.several import AnyStudy

GROUPS = ("fit", *UNSEEN_GROUPS)
"""Groups of data whose errors are reported."""


def by_test(adapter: Adapter, answer: ExplanationResult) -> dict[str, ExplanationResult]:
    """The result as each of several tests sees it; empty for a single test, which is no part of another."""
    if not isinstance(adapter, JointAdapter):
        return {}
    return {test: _of_test(adapter, test, answer) for test in adapter.adapters}


def _of_test(adapter: JointAdapter, test: str, answer: ExplanationResult) -> ExplanationResult:
    """The result for one test: its own errors, in the stages of the joint ones, and its own rows."""
    found = answer.explanation
    last = next((stage for stage in answer.errors["stage"] if stage != "before"), "")
    stages = {"before": found.base} | ({last: found.chosen} if last and found.chosen is not None else {})
    errors = adapter.adapters[test].errors(adapter.fits_of(test, stages), found.noise_scale)[0]
    errors = errors[list(answer.errors.columns.drop("std_from"))].assign(std_from=answer.errors["std_from"].iloc[0])
    tables = {}
    for name, table in answer.tables.items():
        own = table[table[TEST] == test].drop(columns=TEST) if TEST in table else table
        if TEST not in table or len(own):
            tables[name] = own
    return replace(answer, errors=errors, tables=tables)


def explanation_summary(study: AnyStudy, answer: ExplanationResult) -> dict[str, object]:
    """``explanation.json``."""
    found, check = answer.explanation, answer.explanation.base_adequacy
    columns = (
        "name", "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min", "ln_bayes",
        "model_probability", "held_out_gain", "implausible", "confounded_with",
    )  # fmt: skip
    errors: dict[str, dict[str, float | None]] = {group: {"before": None, "after": None} for group in GROUPS}
    for row in answer.errors[answer.errors["stage"] != "attempt"].to_dict("records"):
        errors[str(row["group"])][str(row["stage"])] = float(row["rms"])
    chosen, fits = found.chosen, found.chosen_adequacy if found.fault_adequacy is None else found.fault_adequacy
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "verdict": found.verdict,
        "sentence": answer.sentence,
        "sentences": list(answer.sentences),
        "notes": list(answer.notes),
        "alpha": found.alpha,
        "p_family": check.p_family,
        "p_fit": check.p_fit,
        "credible_set": list(found.credible),
        "effects": answer.effects[list(columns)].replace(np.inf, np.nan).to_dict("records"),
        "chosen": [] if chosen is None else list(chosen.names),
        "chosen_values": {} if chosen is None else {n: chosen.fit.values[n] for e in chosen.effects for n in e.names},
        "adequacy_p": None if fits is None else min(fits.p_family, fits.p_fit),
        "adequacy_p_family": None if fits is None else fits.p_family,
        "adequacy_p_fit": None if fits is None else fits.p_fit,
        "noise_scale": found.noise_scale,
        "measured_noise_scale": found.measured_scale,
        "local_perturbations": len(set(check.perturbations.owners)),
        "local_perturbation": None if found.perturbation is None else _local_perturbation(found.perturbation),
        "refused": found.refused or None,
        "nearly": is_simpler_form(found),
        "measurement_fault": None if found.fault is None else _local_perturbation(found.fault),
        "faults": 0 if check.faults is None else len(set(check.faults.owners)),
        "blamed": [_local_perturbation(t) for t in found.blamed],
        "wrong_datum": None if found.datum is None else _wrong_datum(found, found.datum),
        "evaluations": found.evaluations,
        "begun_anew": found.begun_anew,
        "errors": errors,
        "seconds": answer.seconds,
        **answer.figures,
    }


def _local_perturbation(perturbation: CandidateFit) -> dict[str, object]:
    change = local_perturbation(perturbation)
    unit = change.effect.magnitude.unit
    return {"name": change.effect.name, "value": change.value, "low": change.low, "high": change.high, "unit": unit}


def _wrong_datum(found: Explanation, datum: WrongDatum) -> dict[str, object]:
    return {"what": datum.what, "kind": datum.kind, "ln_bayes": datum.ln_evidence - found.base.ln_evidence}
