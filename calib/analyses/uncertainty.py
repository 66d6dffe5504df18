"""Standard deviations behind the results of a study: stated, claimed as accuracy, or assumed."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from calib.problem.joint import prefixed
from calib.structure.model import Assumption
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

ASSUMED = "Calibration and explanation assume a standard deviation"
"""Beginning of the sentence on standard deviations that are not stated."""


def assumed_std(study: LoadedStudy) -> tuple[Assumption, ...]:
    """Standard deviations that calibration and explanation assume; empty when all are stated."""
    return study.problem.assumed_std


def assumed_words(study: LoadedStudy) -> str:
    """The same in a few words, such as ``natural frequencies 0.5 % of each``; empty for none."""
    return assumptions_in_words(assumed_std(study))


def in_one(study: AnyStudy, words: Callable[[LoadedStudy], str]) -> str:
    """A few words on every test, in one line."""
    return "; ".join(filter(None, prefixed({one.test: [words(one)] for one in study.studies})))


def assumptions_in_words(assumed: Iterable[Assumption]) -> str:
    """Assumed standard deviations in one line, those of one reason together; empty for none."""
    by_reason = dict[str, list[str]]()
    for a in assumed:
        by_reason.setdefault(a.reason, []).append(f"{a.item.removeprefix('standard deviation of ')} {a.value} {a.unit}")
    return "; ".join(f"{', '.join(items)} ({reason})" for reason, items in by_reason.items())


def std_notes(study: LoadedStudy) -> tuple[str, ...]:
    """Notes on the standard deviations of a study; see `accuracy_notes`."""
    return accuracy_notes(accuracy_words(study), assumed_words(study))


def accuracy_notes(claimed: str, assumed: str) -> tuple[str, ...]:
    """Notes on standard deviations, from the claimed accuracy and the assumptions in words."""
    out = [f"Claimed accuracy, added to the standard deviation in quadrature: {claimed}."] if claimed else []
    if assumed:
        out.append(f"{ASSUMED}: {assumed}.")
    return tuple(out)


def accuracy_words(study: LoadedStudy) -> str:
    """The claimed accuracy of a study in words; empty without."""
    return study.experiment.claimed
