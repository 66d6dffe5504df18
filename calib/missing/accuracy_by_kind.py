"""Accuracies of frequencies, damping and shapes at which a verdict would change, each kind by itself."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress, silent
from calib.missing.accuracy import at_accuracy, family_p_at, reweighted, weighted_labels
from calib.missing.explanation import Explanation
from calib.missing.goodness import overall_p
from calib.missing.hypotheses import Altered, Hypotheses
from calib.missing.linearised_fit import FINE, LinearisedFit, least_squares_fit
from calib.missing.rules import RULES

_UPDATED = replace(FINE, evaluated_end=False)
"""Of fits whose sum of squares alone is compared."""
TABLE = "accuracy_by_kind"
COLUMNS = ("frequency", "shape", "damping", "p_fit", "missing")
GRIDS = {
    "frequency": (0.002, 0.005, 0.01, 0.02),
    "damping": (0.1, 0.2, 0.5),
    "shape": (0.02, 0.05, 0.1, 0.2, 0.3),
}
"""Accuracies tried of each kind, ascending: relative to each value, of shapes to the largest entry."""
KEYS = {"frequency": "freq", "damping": "damping", "shape": "shape"}
WORDS = {"frequency": "frequencies", "damping": "damping", "shape": "shapes"}


@dataclass(frozen=True, eq=False)
class AccuracyByKind:
    """Where the verdict changes, and what the model then reaches.

    Attributes
    ----------
    table : DataFrame
        `COLUMNS`: accuracies of frequencies and of shapes, 0 as stated; the least one of ``damping`` with which the
        goodness of fit passes, the largest tried where none does, NaN without damping; ``p_fit`` there, and
        ``missing``, whether it fails.
    told : mapping from str to float
        The accuracy of each kind, 0 as stated, at which nothing would be missing and that takes least evidence away,
        confirmed by a fit; empty where none of the table does.
    before, after : float
        Largest frequency error of the base model, and of its fit with that accuracy, a fraction.
    """

    table: pd.DataFrame
    told: Mapping[str, float]
    before: float
    after: float

    @property
    def sentence(self) -> str:
        """The fact in a sentence."""
        if not self.told:
            tried = ", ".join(f"{WORDS[kind]} {100 * GRIDS[kind][-1]:g} %" for kind in GRIDS if self._has(kind))
            return f"Even with less accurate data ({tried}) something would be missing (by a fit with these weights)."
        held = [WORDS[kind] for kind, at in self.told.items() if not at]
        rest = f" ({' and '.join(held)} as stated)" if held else ""
        return (
            f"With an accuracy of {self._listed}{rest} nothing would be detectable: the largest frequency error would "
            f"be {100 * self.after:.2g} % instead of {100 * self.before:.2g} % (by a fit with these weights)."
        )

    @property
    def then(self) -> str:
        """The same as a next step, which it is only where nothing else explains the data; empty without."""
        if not self.told:
            return ""
        keys = ", ".join(f'{KEYS[kind]} = "{100 * at:g} %"' for kind, at in self.told.items() if at)
        return (
            f"Only if your test has it, state an accuracy of {self._listed} (accuracy = {{ {keys} }}): with it the "
            "model fits."
        )

    @property
    def _listed(self) -> str:
        return " and ".join(f"{100 * at:g} % for {WORDS[kind]}" for kind, at in self.told.items() if at)

    def _has(self, kind: str) -> bool:
        return bool(self.table[kind].notna().any())


def accuracy_by_kind(
    found: Explanation, hypotheses: Hypotheses, seed: int, progress: Progress = silent
) -> AccuracyByKind | None:
    """Fit the base model with the largest accuracies of `GRIDS`, and find the least ones that it needs.

    Shapes that are claimed too accurate can drag parameters far from what frequencies say; a linearisation there says
    nothing of a fit with other weights. So the base model is fitted once with the loosest weights. All combinations are
    judged from there to first order, by the goodness of fit; those that pass are tried by the evidence they take away,
    the sum of the logarithms of the growth of the standard deviations, until one passes all tests after a fit of its
    own with no parameter on a limit. Accuracies add in quadrature to the stated standard deviations.

    None where an effect is named or nothing is missing, without shapes or without frequencies, and where the model
    cannot be fitted.

    Parameters
    ----------
    found : Explanation
    hypotheses : Hypotheses
        With the faults granted that the explanation tells.
    seed : int
        Of the samples behind family-wise probabilities.
    progress : callable
    """
    kinds = tuple(kind for kind in GRIDS if any(row.kind == kind for row in hypotheses.rows))
    settled = found.names_something or found.verdict == "nothing_detectable"
    if settled or not {"frequency", "shape"} <= {*kinds}:
        return None
    progress("accuracy at which the verdict would change")
    search = _Search(found, hypotheses, seed, kinds)
    loosest = {kind: GRIDS[kind][-1] for kind in kinds}
    start = found.base.fit.values
    try:
        loose = search.fitted(loosest, start)
        told, reached = (loosest, loose) if search.passes(loose, loosest) else ({}, None)
        table = search.table(loose, loosest)
        for one in search.least(loose, loosest) if told else ():
            there = search.fitted(one, loose.values)
            if search.passes(there, one):
                told, reached = one, there
                break
    except EvaluationError:
        return None
    after = math.nan if reached is None else search.frequency_error(reached, search.weight(told))
    return AccuracyByKind(table, told, search.frequency_error(found.base.fit, 1.0 / found.noise_scale), after)


@dataclass(frozen=True, eq=False)
class _Search:
    """The base model with other weights, by the accuracy of each kind."""

    found: Explanation
    hypotheses: Hypotheses
    seed: int
    kinds: tuple[str, ...]

    @property
    def std(self) -> np.ndarray:
        """Relative standard deviation of every row as it is stated, (n_rows,)."""
        return np.asarray(self.hypotheses.relative_std, dtype=float)

    def weight(self, accuracies: Mapping[str, float]) -> np.ndarray:
        """Stated over larger standard deviation of every row, (n_rows,)."""
        return at_accuracy(self.std, np.array([accuracies.get(row.kind, 0.0) for row in self.hypotheses.rows]))

    def fitted(self, accuracies: Mapping[str, float], start: Mapping[str, float]) -> LinearisedFit:
        """The base model fitted with the weights of some accuracies."""
        weight, base = self.weight(accuracies), self.found.base.fit
        problem = Altered(self.hypotheses.fit_problem(()), 1.0 / weight)
        known = {name: self.found.noise_scale * weight * column for name, column in base.columns.items()}
        return least_squares_fit(problem, (), dict(start), settings=_UPDATED, columns=known, exact=start == base.values)

    def p_fit(self, fit: LinearisedFit, accuracies: Mapping[str, float]) -> float:
        """Goodness of a fit that has these weights."""
        return overall_p(fit, weighted_labels(self.hypotheses, self.weight(accuracies)))

    def passes(self, fit: LinearisedFit, accuracies: Mapping[str, float]) -> bool:
        """Whether neither scores nor goodness of fit reject it, and no limit holds a parameter."""
        if fit.active or self.p_fit(fit, accuracies) <= self.found.alpha:
            return False
        weight = self.weight(accuracies)
        labels, of_base = weighted_labels(self.hypotheses, weight), weight * self.found.noise_scale
        return family_p_at(self.found, fit, of_base, labels, self.seed) > self.found.alpha

    def relinearised(
        self, loose: LinearisedFit, loosest: Mapping[str, float], accuracies: Mapping[str, float]
    ) -> LinearisedFit:
        """First-order fit with some accuracies, from the fit with the loosest."""
        return reweighted(loose, self.weight(accuracies) / self.weight(loosest))

    def table(self, loose: LinearisedFit, loosest: Mapping[str, float]) -> pd.DataFrame:
        """See `AccuracyByKind`."""
        damping = (0.0, *GRIDS["damping"]) if "damping" in self.kinds else (math.nan,)
        lines = []
        for freq, shape in itertools.product((0.0, *GRIDS["frequency"]), (0.0, *GRIDS["shape"])):
            for damped in damping:
                one = {"frequency": freq, "shape": shape, "damping": damped}
                at = {kind: one[kind] for kind in self.kinds}
                p = self.p_fit(self.relinearised(loose, loosest, at), at)
                if p > self.found.alpha:
                    break
            lines.append((freq, shape, damped, p, p <= self.found.alpha))
        return pd.DataFrame(lines, columns=list(COLUMNS))

    def least(self, loose: LinearisedFit, loosest: Mapping[str, float]) -> list[dict[str, float]]:
        """Combinations that pass all tests to first order, those that take least evidence away first; a few."""
        every = [
            dict(zip(self.kinds, at, strict=True)) for at in itertools.product(*((0.0, *GRIDS[k]) for k in self.kinds))
        ]
        out: list[dict[str, float]] = []
        for one in sorted(every, key=self._lost):
            if len(out) == RULES.accuracies:
                break
            if self.passes(self.relinearised(loose, loosest, one), one):
                out.append(one)
        return out

    def _lost(self, accuracies: Mapping[str, float]) -> float:
        """Evidence that accuracies take away: of every kind the logarithm of the growth of its standard deviations."""
        growth, rows = -np.log(self.weight(accuracies)), self.hypotheses.rows
        return sum(
            float(np.mean([g for g, row in zip(growth, rows, strict=True) if row.kind == k])) for k in self.kinds
        )

    def frequency_error(self, fit: LinearisedFit, weight: np.ndarray | float) -> float:
        """Largest relative error of a frequency in a fit that has these weights."""
        errors = np.abs(fit.residual / weight * self.std)
        return float(
            np.nanmax([e for e, row in zip(errors, self.hypotheses.rows, strict=True) if row.kind == "frequency"])
        )
