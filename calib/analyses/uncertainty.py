"""Standard deviations behind the results of a study: stated, claimed as accuracy, or assumed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from calib.correlation.frf_residual import UNKNOWN_STD as UNKNOWN_FRF
from calib.correlation.frf_residual import FRFProblem
from calib.correlation.response_residual import UNKNOWN_STD
from calib.correlation.standard_deviations import assumptions
from calib.joint import said
from calib.measurement.frf import MeasuredFRFs
from calib.several import AnyStudy
from calib.structure.model import Assumption
from calib.study import Study

_LISTED = 4
"""Responses that are listed by name."""


def assumed_std(study: Study) -> tuple[Assumption, ...]:
    """Standard deviations that calibration and explanation assume; empty when all are stated."""
    problem = study.problem
    if isinstance(problem, FRFProblem):
        return assumed_frfs(problem.measured)
    return assumed_responses(study.targets) if study.measured is None else assumptions(study.measured)


def assumed_responses(targets: Mapping[str, tuple[float, float | None]]) -> tuple[Assumption, ...]:
    """The same for scalar responses, each a value with its standard deviation or None."""
    unknown = [name for name, (_, std) in targets.items() if not std]
    if not unknown:
        return ()
    value = f"{100 * UNKNOWN_STD:g}"
    reason = "no standard deviation and no accuracy is stated"
    listed = ", ".join(unknown) if len(unknown) <= _LISTED else f"{unknown[0]} and {len(unknown) - 1} more responses"
    return (Assumption(f"standard deviation of {listed}", value, "% of each", reason),)


def assumed_frfs(frfs: MeasuredFRFs) -> tuple[Assumption, ...]:
    """The same for FRFs."""
    if not (np.isfinite(frfs.values) & ~np.isfinite(frfs.total_std)).any():
        return ()
    reason = "neither repeats nor coherence are given"
    return (Assumption("standard deviation of FRFs", f"{100 * UNKNOWN_FRF:g}", "% of each modulus", reason),)


def claimed_frf(frfs: MeasuredFRFs) -> str:
    """The claimed accuracy of FRFs in words; empty without."""
    words = "at each line by itself; errors that lines share make the true intervals wider"
    return f"{frfs.accuracy.words('SI')} of FRFs, {words}" if frfs.accuracy.given else ""


def assumed_words(study: Study) -> str:
    """The same in a few words, such as ``standard deviation of natural frequencies 0.5 % of each``; empty for none."""
    return in_words(assumed_std(study))


def in_one(study: AnyStudy, words: Callable[[Study], str]) -> str:
    """A few words on every test, in one line."""
    return "; ".join(filter(None, said({one.test: [words(one)] for one in study.studies})))


def in_words(assumed: Iterable[Assumption]) -> str:
    """Assumptions in one line; empty for none."""
    return "; ".join(f"{a.item} {a.value} {a.unit} ({a.reason})" for a in assumed)


def std_notes(study: Study) -> tuple[str, ...]:
    """Notes on the standard deviations of a study; see `notes_on`."""
    return notes_on(accuracy_words(study), assumed_words(study))


def notes_on(claimed: str, assumed: str) -> tuple[str, ...]:
    """Notes on standard deviations, from the claimed accuracy and the assumptions in words."""
    out = [f"Claimed accuracy, added to the standard deviation in quadrature: {claimed}."] if claimed else []
    if assumed:
        out.append(f"Standard deviations that are not stated and that calibration and explanation assume: {assumed}.")
    return tuple(out)


def accuracy_words(study: Study) -> str:
    """The claimed accuracy of a study in words; empty without."""
    if study.whole is not None:
        return study.whole.accuracy.words
    if study.frfs is not None:
        return claimed_frf(study.frfs)
    return claimed_words(study.settings.measurement.accuracy)


def claimed_words(given: str | float | Mapping[str, str | float] | None) -> str:
    """A claimed accuracy of scalar responses in words; empty without."""
    if given is None:
        return ""
    if isinstance(given, Mapping):
        return ", ".join(f"{value} of {name}" for name, value in given.items())
    return f"{given} of every value"
