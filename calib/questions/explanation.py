"""What an explanation tells: its sentences, its tables, and the summary that other programs read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.missing.findings import Findings, Trial, WrongDatum
from calib.missing.local import local_change
from calib.missing.verdict import GROUPS as UNSEEN_GROUPS
from calib.questions.record import check_repeats, disagreements_table
from calib.questions.scatter import accuracy_words, assumed_words, scatter_notes
from calib.several import AnyStudy
from calib.study import Study

GROUPS = ("fit", *UNSEEN_GROUPS)
"""Groups of data whose errors are told."""


@dataclass(frozen=True, eq=False)
class Told:
    """What an explanation must know of a measurement beside its rows.

    Attributes
    ----------
    assumed : str
        Standard deviations that nobody stated; see `calib.questions.scatter.assumed_words`.
    accuracy : str
        What is claimed beside the repeats; ``none`` without.
    notes : tuple of str
        What a reader must know of the scatter, and where repeats disagree.
    disagreements : DataFrame
        Repeats that disagree with the others; see `calib.questions.record.disagreements_table`.
    held_sd : mapping from str to float
        Standard deviations of parameters that are held and were found earlier.
    seed : int
        Of all draws.
    draws : int
        Points over which advice is averaged.
    """

    assumed: str
    accuracy: str
    notes: tuple[str, ...]
    disagreements: pd.DataFrame
    held_sd: Mapping[str, float]
    seed: int
    draws: int

    @classmethod
    def of(cls, study: Study) -> Told:
        """That of a study."""
        own = study.settings.explain
        return cls(
            assumed_words(study), accuracy_words(study), (*scatter_notes(study), *check_repeats(study)),
            disagreements_table(study), study.held_sd, own.seed, own.draws,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is missing, with the tables that show it.

    Attributes
    ----------
    findings : Findings
    sentences : tuple of str
        The verdict and what supports it.
    notes : tuple of str
        What a reader must know, such as a scatter that had to be assumed.
    effects, errors : DataFrame
        ``effects.csv`` and ``errors.csv``.
    tables : mapping from str to DataFrame
        All others by the name of their file.
    figures : mapping from str to object
        Further numbers of the summary.
    seconds : float
    traces : tuple of str
        Tracebacks of the commonest failures in the user's code.
    """

    findings: Findings
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    effects: pd.DataFrame
    errors: pd.DataFrame
    tables: dict[str, pd.DataFrame]
    figures: dict[str, object]
    seconds: float
    traces: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict and what supports it."""
        return " ".join(self.sentences)

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.findings.Findings`."""
        return self.findings.verdict


def summary(study: AnyStudy, answer: Explanation) -> dict[str, object]:
    """``explanation.json``."""
    found, check = answer.findings, answer.findings.base_check
    columns = (
        "name", "z", "gamma", "phi", "phi_low", "phi_high", "phi_min", "ln_bayes", "posterior", "heldout_gain",
        "implausible", "confounded_with",
    )  # fmt: skip
    errors: dict[str, dict[str, float | None]] = {group: {"before": None, "after": None} for group in GROUPS}
    for row in answer.errors[answer.errors["stage"] != "attempt"].to_dict("records"):
        errors[str(row["group"])][str(row["stage"])] = float(row["rms"])
    chosen, fits = found.chosen, found.chosen_check
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "verdict": found.verdict,
        "sentence": answer.sentence,
        "sentences": list(answer.sentences),
        "notes": list(answer.notes),
        "p_family": check.p_family,
        "p_fit": check.p_fit,
        "credible_set": list(found.credible),
        "effects": answer.effects[list(columns)].replace(np.inf, np.nan).to_dict("records"),
        "chosen": [] if chosen is None else list(chosen.names),
        "chosen_values": {} if chosen is None else {n: chosen.state.values[n] for e in chosen.effects for n in e.names},
        "adequacy_p": None if fits is None else min(fits.p_family, fits.p_fit),
        "adequacy_p_family": None if fits is None else fits.p_family,
        "adequacy_p_fit": None if fits is None else fits.p_fit,
        "noise_scale": found.noise_scale,
        "measured_noise_scale": found.measured_scale,
        "local_changes": len(set(check.atoms.owners)),
        "local_change": None if found.atom is None else _local_change(found.atom),
        "refused": found.refused or None,
        "measurement_fault": None if found.fault is None else _local_change(found.fault),
        "wrong_datum": None if found.datum is None else _wrong_datum(found, found.datum),
        "evaluations": found.evaluations,
        "begun_anew": found.begun_anew,
        "errors": errors,
        "seconds": answer.seconds,
        **answer.figures,
    }


def _local_change(atom: Trial) -> dict[str, object]:
    change = local_change(atom)
    unit = change.effect.strength.unit
    return {"name": change.effect.name, "value": change.value, "low": change.low, "high": change.high, "unit": unit}


def _wrong_datum(found: Findings, datum: WrongDatum) -> dict[str, object]:
    return {"what": datum.what, "kind": datum.kind, "ln_bayes": datum.ln_evidence - found.base.ln_evidence}
