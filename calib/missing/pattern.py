"""Patterns in the data: the residual of the base model beside the signature of each effect that explains it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.facts import Places
from calib.problem.joint import TEST

MOST = 3
"""Indistinguishable effects whose patterns are given."""
PRIOR = "prior"
"""Kind of the rows of the parameters' priors, which share in the projection."""
PARAMETER_COLUMNS = ("effects", "effect", "parameter", "description", "unit", "value", "std")
PLACE_COLUMNS = ("effect", "perturbation", "kind", "x", "y", "z", "correlation")
BY_TEST = "reduction_by_test"
"""Name of the table of the tests in which the data ask for an effect."""
TEST_COLUMNS = ("effects", TEST, "rows", "before", "after", "share", "shown_first")


def explaining(found: Explanation) -> tuple[CandidateFit, ...]:
    """Fits whose effects are named or attempted: the chosen one, and at most two that are indistinguishable from it."""
    if found.chosen is None:
        return ()
    if found.verdict != "indistinguishable":
        return (found.chosen,)
    others = [t for t in found.singles if t.names[0] in found.credible and t.names != found.chosen.names]
    return (found.chosen, *others)[:MOST]


def pattern_table(found: Explanation, labels: pd.DataFrame) -> pd.DataFrame:
    """Residual of the base model, signature of each effect, and what is left, row by row of the data.

    All three are in standard deviations of the data, less what the parameters of the base model absorb to first order:
    ``P r``, ``a P g`` with the fitted magnitude a, and ``P r`` less the signatures of all effects of the fit. The
    signature is that of the score test, so that ``z = (a P g)^T P r/|a P g|`` up to the sign of a. Where a limit holds
    a parameter of the base model, all three keep the limits instead of P: the residual is that of the base fit, and the
    signature what the effect takes from it beside the others of its fit (`LinearisedFit.remaining`).

    Parameters
    ----------
    found : Explanation
    labels : DataFrame
        Labels of the rows of data, n_rows; text.

    Returns
    -------
    DataFrame
        ``effects`` (those of the fit, joined by " + "), ``effect``, the columns of ``labels``, ``residual, signature,
        left``; for each effect the rows of the data, then those of kind `PRIOR`, named as sensors: what correlated
        priors add, and one for each parameter.
        Without rows where no effect is named or attempted.
    """
    base, named = found.base.fit, found.base_adequacy.named
    count = len(base.augmented) - len(labels) - len(base.names)
    combined = [f"correlation {k}" for k in range(1, count + 1)]
    priors = pd.DataFrame({"kind": PRIOR, "sensor": [*combined, *base.names]})
    priors = priors.reindex(columns=labels.columns, fill_value="")
    rows = pd.concat([labels, priors], ignore_index=True)
    parts = []
    for fit in explaining(found):
        changes = {name: fit.fit.values[name] * named.raw[:, named.best(name)] for name in fit.names}
        whole = np.sum(list(changes.values()), axis=0)
        residual, remainder = base.remaining(np.zeros_like(whole)), base.remaining(whole)
        for name, change in changes.items():
            own = rows.assign(residual=residual, signature=base.remaining(whole - change) - remainder, left=remainder)
            own.insert(0, "effect", name)
            own.insert(0, "effects", " + ".join(fit.names))
            parts.append(own)
    columns = ["effects", "effect", *labels.columns, "residual", "signature", "left"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def parameter_table(found: Explanation) -> pd.DataFrame:
    """Fitted magnitude and nuisance parameters of each effect of `pattern_table`.

    Returns
    -------
    DataFrame
        `PARAMETER_COLUMNS`: description and unit are the library's, the standard deviation that of the fit; the
        magnitude of an effect comes first.
    """
    rows: list[tuple[object, ...]] = []
    for candidate_fit in explaining(found):
        fit, together = candidate_fit.fit, " + ".join(candidate_fit.names)
        std = dict(zip(fit.names, fit.std.tolist(), strict=True))
        for effect in candidate_fit.effects:
            for p in effect.parameters:
                value = fit.values[p.name]
                rows.append((together, effect.name, p.name, p.description, p.unit, value, std.get(p.name, np.nan)))
    return pd.DataFrame(rows, columns=list(PARAMETER_COLUMNS))


def place_table(found: Explanation, places: Places) -> pd.DataFrame:
    """Correlation of each effect's signature with those of the local perturbations.

    An effect of a library has no coordinates; the local perturbations that change the data alike tell where it acts.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every local perturbation, by name; m.

    Returns
    -------
    DataFrame
        `PLACE_COLUMNS`: for each effect of `pattern_table` every local perturbation that the parameters do not absorb,
        with the correlation of both signatures after projection, -1 to 1.
    """
    named, local = found.base_adequacy.named, found.base_adequacy.perturbations
    rows = []
    for name in dict.fromkeys(name for fit in explaining(found) for name in fit.names):
        alike = np.clip(local.unit.T @ named.unit[:, named.best(name)], -1.0, 1.0)
        for owner, size, correlation in zip(local.owners, local.size, alike, strict=True):
            kind, place, _ = places[owner]
            rows += [(name, owner, kind, *place, float(correlation))] if size > 0 else []
    return pd.DataFrame(rows, columns=list(PLACE_COLUMNS))


def reduction_table(found: Explanation, tests: Sequence[str]) -> pd.DataFrame:
    """Sum of squares of each test without and with the effects that are named or attempted, all tests fitted together.

    The joint fit minimises the sum of squares of all data and priors. That of one test may rise; its share of the
    whole decrease tells how much of the evidence is in it.

    Parameters
    ----------
    found : Explanation
    tests : sequence of str, n_rows
        Test of every row of the data.

    Returns
    -------
    DataFrame
        `TEST_COLUMNS`, for the fits of `explaining` and every test: ``before`` and ``after`` in units
        of the variance, ``share`` of the decrease over all data and priors (1 less that of the priors over all tests);
        NaN where there is no decrease. ``shown_first`` marks the test with the largest share by the first fit, where
        an effect is named; figures and reports begin with it.
    """
    labels, base, rows = np.array(tests), found.base.fit, []
    for candidate_fit in explaining(found):
        fit = candidate_fit.fit
        whole = base.misfit - fit.misfit
        for test in dict.fromkeys(tests):
            own = labels == test
            before, after = (float(np.sum(e[own] ** 2)) for e in (base.residual, fit.residual))
            share = (before - after) / whole if whole > 0 else np.nan
            rows.append((" + ".join(candidate_fit.names), test, int(own.sum()), before, after, share))
    table = pd.DataFrame(rows, columns=list(TEST_COLUMNS[:-1])).assign(shown_first=False)
    if found.names_something and found.chosen is not None:
        own = table[table["effects"] == " + ".join(found.chosen.names)].dropna(subset=["share"])
        if len(own):
            table.loc[own["share"].idxmax(), "shown_first"] = True
    return table
