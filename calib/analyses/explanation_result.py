"""Result of an explanation: sentences, tables, and the summary ``explanation.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.analyses.provenance.record import check_repeats, disagreements_table
from calib.analyses.uncertainty import accuracy_words, assumed_words, std_notes
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.detailed import Richer
from calib.missing.explanation import Explanation
from calib.missing.local import local_perturbation
from calib.missing.partial import is_nearly
from calib.missing.verdict import GROUPS as UNSEEN_GROUPS
from calib.results.answer import Answer
from calib.study.several import AnyStudy
from calib.study.study import Study

GROUPS = ("fit", *UNSEEN_GROUPS)
"""Groups of data whose errors are reported."""


@dataclass(frozen=True, eq=False)
class MeasurementFacts:
    """Facts about a measurement beside its rows, as an explanation needs them.

    Attributes
    ----------
    assumed : str
        Assumed standard deviations, in words; see `calib.analyses.uncertainty.assumed_words`.
    accuracy : str
        Accuracy claimed in addition to the repeats, in words; empty without.
    notes : tuple of str
        Caveats on the standard deviations, and repeats that disagree.
    disagreements : DataFrame
        Repeats that disagree with the others; see `calib.analyses.provenance.record.disagreements_table`.
    held_sd : mapping from str to float
        Standard deviations of held parameters that an earlier study determined.
    seed : int
        Of all random numbers.
    samples : int
        Posterior samples over which the recommendation is averaged.
    """

    assumed: str
    accuracy: str
    notes: tuple[str, ...]
    disagreements: pd.DataFrame
    held_sd: Mapping[str, float]
    seed: int
    samples: int

    @classmethod
    def of(cls, study: Study) -> MeasurementFacts:
        """The facts about a study's measurement."""
        own = study.settings.explain
        return cls(
            assumed_words(study), accuracy_words(study),
            (*corrections(study), *std_notes(study), *check_repeats(study)),
            disagreements_table(study), study.held_sd, own.seed, own.samples,
        )  # fmt: skip


def corrections(study: Study) -> tuple[str, ...]:
    """Notes on the faults that are taken out of the measurement on reading."""
    faults = study.settings.measurement.corrected
    return tuple(f"The measurement is corrected for {name} = {by:g}." for name, by in faults.items())


@dataclass(frozen=True, eq=False)
class ExplanationResult:
    """The verdict on what is missing, with its tables.

    Attributes
    ----------
    explanation : Explanation
    answer : Answer
        The verdict in a sentence, how sure it is, and what to do next.
    sentences : tuple of str
        The same with what supports it.
    notes : tuple of str
        Caveats, such as an assumed standard deviation.
    effects, errors : DataFrame
        ``effects.csv`` and ``errors.csv``.
    tables : mapping from str to DataFrame
        All others, by file name.
    figures : mapping from str to object
        Further entries of the summary.
    seconds : float
    traces : tuple of str
        Tracebacks of the commonest failures in the user's code.
    richer : tuple of Richer
        Richer members of the effect that nearly explains the data, from simple to rich.
    """

    explanation: Explanation
    answer: Answer
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    effects: pd.DataFrame
    errors: pd.DataFrame
    tables: dict[str, pd.DataFrame]
    figures: dict[str, object]
    seconds: float
    traces: tuple[str, ...] = ()
    richer: tuple[Richer, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict and what supports it."""
        return " ".join(self.sentences)

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.explanation.Explanation`."""
        return self.explanation.verdict


def summary(study: AnyStudy, answer: ExplanationResult) -> dict[str, object]:
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
        "nearly": is_nearly(found),
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
