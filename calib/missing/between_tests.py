"""Which parameters, or magnitudes of effects, differ between several tests of one structure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.inference.rules import WIDE
from calib.missing.goodness import p_words
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.missing.local import interval_words
from calib.missing.rules import RULES
from calib.missing.score import Scores, family_p, scored
from calib.problem.apart import ApartProblem
from calib.problem.joint import JointProblem, JointRows, of_test
from calib.results.answer import Answer

BETWEEN = "test_differences"
"""Name of the table."""
COLUMNS = ("parameter", "test", "value", "change", "change_low", "change_high", "unit", "z", "differs")

Difference = tuple[str, str]
"""Parameter and test."""


@dataclass(frozen=True)
class Differences:
    """Differences of shared parameters between tests.

    Attributes
    ----------
    table : DataFrame
        `COLUMNS`: what a parameter would be larger by in one test, ``value`` being that of the other tests, with its
        95 % interval. First those that differ, fitted together, in the order in which they were found; then the others,
        the largest score first, each to first order beside them.
    p : float
        Family-wise p-value of the largest score if nothing differs; 1 where nothing can differ.
    p_left : float
        The same of the largest score of the others, with those that differ fitted.
    alternatives : tuple of (str, ...)
        Other sets of differences that explain nearly as much, each in words.
    """

    table: pd.DataFrame
    p: float
    p_left: float = 1.0
    alternatives: tuple[str, ...] = ()

    def sentence(self, alpha: float) -> str:
        """The result in words; empty where no parameter is shared."""
        if self.table.empty:
            return ""
        count = f"the largest of {len(self.table)} differences between the tests"
        found = self.table[self.table["differs"].astype(bool)]
        if self.p > alpha or found.empty:
            return f"No parameter differs between the tests: {p_words(self.p)} for {count}."
        sizes = []
        for row in found.to_dict("records"):
            change, low, high = (float(row[name]) for name in ("change", "change_low", "change_high"))
            size = interval_words(change, low, high, str(row["unit"]))
            sizes.append(f"{row['parameter']} in {row['test']} by {size}")
        if self.alternatives:
            listed = "; or ".join([f"{', '.join(sizes)}", *self.alternatives])
            words = f"Between the tests something differs that cannot be told apart: {listed}"
        else:
            words = f"Between the tests {'these differ' if len(sizes) > 1 else 'this differs'}: {', '.join(sizes)}"
        rest = "" if self.p_left > alpha else " More differs than that."
        return f"{words}; {p_words(self.p)} for {count}.{rest}"

    def told(self, answer: Answer, alpha: float, named: bool) -> Answer:
        """The answer of an explanation with what differs: first, unless it names something that the model lacks."""
        found = self.table[self.table["differs"].astype(bool)]
        if self.p > alpha or found.empty:
            return answer
        if named:
            return replace(answer, sure=f"{answer.sure} {self.sentence(alpha)}")
        what = [f"{row['parameter']} in {row['test']}" for row in found.to_dict("records")]
        then = f"Ask what changed between the tests: it acts like {_in_words(what)}."
        return replace(answer, found=self.sentence(alpha), then=then)


def _in_words(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def differences(fit: LinearisedFit, tests: JointRows, seed: int, alpha: float) -> Differences:
    """Which parameters that several tests share differ in one of them, stepwise.

    Each is scored by the derivative of that test's data alone (Rao's score test, 1948; see `calib.missing.score`), all
    parameters projected out. Of two tests the second is told, since the first would differ by the opposite. While the
    largest score is significant, that parameter gets a difference of its own in that test, with the prior of the
    parameter around 0, and all of them are fitted together: single scores point at one parameter where several differ.
    What the others then explain as well no longer counts, and a difference whose interval holds 0 is dropped.

    Parameters
    ----------
    fit : LinearisedFit
        Of all tests together.
    tests : JointRows
        Labels of its rows.
    seed : int
        Of the samples behind the p-values.
    alpha : float
        Level of the family-wise test.
    """
    owner = np.array([row.test for row in tests.rows])
    asked: list[Difference] = []
    for k, name in enumerate(fit.names):
        acting = [test for test in tests.parts if np.any(fit.slope[owner == test, k])]
        asked += [(name, test) for test in (acting[1:] if len(acting) == 2 else acting if len(acting) > 2 else ())]
    if not asked:
        return Differences(pd.DataFrame(columns=list(COLUMNS)), 1.0)
    chosen, here = list[Difference](), fit
    first = found = _scored(fit, fit, asked, owner)
    p = p_left = family_p(first, tests, seed)
    while p_left <= alpha and len(chosen) < min(RULES.most_effects, len(asked)):
        k = int(np.argmax(found.magnitude))
        there = _freed(fit, here, [*chosen, _left(asked, chosen)[k]])
        if there is None:
            break
        chosen, here = [*chosen, _left(asked, chosen)[k]], there
        if not _left(asked, chosen):
            p_left = 1.0
            break
        found = _scored(fit, here, _left(asked, chosen), owner)
        p_left = family_p(found, tests, seed)
    chosen, here = _without_idle(fit, here, chosen)
    return Differences(
        _table(fit, here, asked, chosen, owner), p, p_left, _alternatives(fit, here, asked, chosen, owner)
    )


def _left(asked: Sequence[Difference], chosen: Sequence[Difference]) -> list[Difference]:
    return [one for one in asked if one not in chosen]


def _scored(fit: LinearisedFit, here: LinearisedFit, asked: Sequence[Difference], owner: np.ndarray) -> Scores:
    """Scores of differences beside those that are fitted."""
    raw = [np.where(owner == test, here.slope[:, fit.names.index(name)], 0.0) for name, test in asked]
    names = [of_test(test, name) for name, test in asked]
    return scored(here, names, [{}] * len(raw), np.column_stack(raw), [True] * len(raw), [0.0] * len(raw))


def _freed(fit: LinearisedFit, here: LinearisedFit, chosen: Sequence[Difference]) -> LinearisedFit | None:
    """The fit with some differences fitted too, from where an earlier one ended; None where the model fails.

    A factor on the standard deviation, which the differences may have raised, is taken as far as they leave a misfit.
    """
    joint: Any = fit.fit_problem
    most = 1.0
    while isinstance(joint, Altered) and joint.kept is None and not joint.held:
        joint, most = joint.inner, most * joint.scale
    if not isinstance(joint, JointProblem):
        return None
    apart = ApartProblem(joint, chosen)
    start = {p.name: here.values.get(p.name, p.value) for p in apart.space.parameters}
    try:
        found = least_squares_fit(apart, fit.effects, start)
    except EvaluationError:
        return None
    dof = max(len(found.residual) - len(found.names), 1)
    scale = min(max(1.0, math.sqrt(float(found.residual @ found.residual) / dof)), most)
    return replace(found, residual=found.residual / scale, slope=found.slope / scale)


def _spread(here: LinearisedFit, label: str) -> tuple[float, float]:
    """Fitted value of a difference and its standard deviation."""
    k = here.names.index(label)
    information = here.data_slope.T @ here.data_slope + np.diag(1 / here.prior_sd**2)
    return here.values[label], math.sqrt(np.linalg.inv(information)[k, k])


def _without_idle(
    fit: LinearisedFit, here: LinearisedFit, chosen: list[Difference]
) -> tuple[list[Difference], LinearisedFit]:
    """The differences without those whose interval holds 0, the least sure first."""
    while len(chosen) > 1:
        sure = {one: abs(value / std) for one in chosen for value, std in [_spread(here, _label(one))]}
        least = min(sure, key=lambda one: sure[one])
        there = None if sure[least] > WIDE else _freed(fit, here, [one for one in chosen if one != least])
        if there is None:
            break
        chosen, here = [one for one in chosen if one != least], there
    return chosen, here


def _label(one: Difference) -> str:
    name, test = one
    return of_test(test, name)


def _table(
    fit: LinearisedFit,
    here: LinearisedFit,
    asked: Sequence[Difference],
    chosen: Sequence[Difference],
    owner: np.ndarray,
) -> pd.DataFrame:
    space, rows = fit.fit_problem.space, []
    for name, test in chosen:
        change, std = _spread(here, _label((name, test)))
        ends = (change - WIDE * std, change + WIDE * std)
        rows.append((name, test, here.values[name], change, *ends, space[name].unit, change / std, True))
    others, left = list[tuple[object, ...]](), _left(asked, chosen)
    scores = _scored(fit, here, left, owner) if left else None
    for k, (name, test) in enumerate(left):
        if scores is not None and scores.size[k]:
            change, std = scores.z[k] / scores.size[k], 1 / scores.size[k]
            ends = (change - WIDE * std, change + WIDE * std)
            others.append((name, test, here.values[name], change, *ends, space[name].unit, scores.z[k], False))
    others.sort(key=lambda row: -abs(float(str(row[7]))))
    return pd.DataFrame([*rows, *others], columns=list(COLUMNS))


def _alternatives(
    fit: LinearisedFit,
    here: LinearisedFit,
    asked: Sequence[Difference],
    chosen: Sequence[Difference],
    owner: np.ndarray,
) -> tuple[str, ...]:
    """Sets with another difference in the place of one, which fit nearly as well to first order, in words."""
    left = _left(asked, chosen)
    if not chosen or not left:
        return ()
    n, out, labels = len(here.names), list[str](), [_label(one) for one in chosen]
    raw = [np.where(owner == test, here.slope[:, fit.names.index(name)], 0.0) for name, test in left]
    prior = [fit.prior_sd[fit.names.index(name)] for name, _ in left]
    wide = np.vstack([np.column_stack([here.slope, *raw]), np.diag(1 / np.concatenate([here.prior_sd, prior]))])
    # Steps of the shared parameters from the fit, and the differences themselves: without one it is 0.
    fitted = np.array([here.values[name] if name in labels else 0.0 for name in here.names])
    pulled = np.array([0.0 if name in labels else -shift for name, shift in zip(here.names, here.shift, strict=True)])
    data = np.concatenate([here.residual + here.slope @ fitted, pulled, np.zeros(len(left))])

    def squares(columns: Sequence[int]) -> float:
        part = wide[:, list(columns)]
        return float(np.sum((data - part @ np.linalg.lstsq(part, data, rcond=None)[0]) ** 2))

    best = squares(range(n))
    for one in chosen:
        kept = [k for k in range(n) if here.names[k] != _label(one)]
        for j, other in enumerate(left):
            if squares([*kept, n + j]) - best < 2 * RULES.credible:
                names = [_label(other), *(_label(same) for same in chosen if same != one)]
                out.append(" and ".join(names))
    return tuple(dict.fromkeys(out))
