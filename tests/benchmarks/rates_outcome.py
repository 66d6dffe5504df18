"""One synthetic test with its truth, and what an explanation of it says beside that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.explanation import SEVERAL, Explanation
from calib.missing.partial import is_simpler_form, magnitude_range
from calib.missing.profile import profile_interval
from calib.problem.effect import Effect


class Truth(Protocol):
    """What is true of a synthetic test."""

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters, magnitudes, nuisance parameters."""
        ...

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the effects of the twin."""
        ...


@dataclass(frozen=True, eq=False)
class Measured:
    """One synthetic test and its truth.

    Attributes
    ----------
    values : dict
        Parameters, magnitudes, nuisance parameters.
    parameters_of : mapping from str to tuple of str
        Effects of the twin, and the names of their parameters.
    clean, whole : MeasuredModes or MeasuredFRFs
        Without noise, and as measured; nothing is held_out.
    """

    values: Mapping[str, float]
    parameters_of: Mapping[str, tuple[str, ...]]
    clean: Any
    whole: Any

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the effects of the twin."""
        return tuple(self.parameters_of)

    def only(self, effect: Effect) -> dict[str, float]:
        """The truth as if it had this effect alone."""
        others = {n for name, own in self.parameters_of.items() if name != effect.name for n in own}
        return {n: v for n, v in self.values.items() if n not in others}


def outcome(found: Explanation, measured: Truth) -> dict[str, Any]:
    """What was found, and whether it is right.

    ``right``: the true effect (its group) is in the printed set and the best, or all of several are named; ``part``:
    one of several; ``second``: in the set but not the best; ``extra``: named with another one that is not there;
    ``wrong``: something is named and the truth is not in the set; otherwise the verdict itself.
    """
    stands = {name: g.effect.name for g in found.groups for name in g.names}
    true = {stands[name] for name in measured.hidden if name in stands}
    named = found.names_something
    best = list(found.chosen.names) if found.chosen is not None else []
    pairs = [t for t in found.candidate_fits if len(t.names) > 1]
    base = found.base_adequacy
    row: dict[str, Any] = {
        "verdict": found.verdict, "credible": list(found.credible), "best": best,
        "outcome": outcome_of(found.verdict, set(found.credible), best, true) if named else found.verdict,
        "z": _expected_score(found, measured, stands),
        "groups": {g.effect.name: list(g.names[1:]) for g in found.groups if g.others},
        "p_named": base.p_named, "p_perturbations": base.p_perturbations, "p_fit": base.p_fit,
        "p_family": base.p_family,
        "measured_scale": found.measured_scale,
        "noise_scale": found.noise_scale, "evaluations": found.evaluations,
        "begun_anew": found.begun_anew, "blamed": [t.names[0] for t in found.blamed],
        "steps": [] if found.steps is None else [list(step.candidate_fit.names) for step in found.steps.steps],
        "stopped": "" if found.steps is None else found.steps.stopped,
        "base_misfit": round(found.base.fit.misfit, 1),
        "nearly": _nearly(found, measured, true),
        "candidate_fits": [_row(t, found) for t in (*found.singles[:4], *pairs[:3])],
        "perturbation": None if found.perturbation is None else _row(found.perturbation, found),
    }  # fmt: skip
    row["kinds"] = _chances(found.base_adequacy)
    if found.chosen_adequacy is not None:
        after = found.chosen_adequacy
        row["kinds_after"] = _chances(after)
        row["after"] = {"p_named": after.p_named, "p_perturbations": after.p_perturbations, "p_fit": after.p_fit}
        row["after"] |= {"named": _largest(after.named), "perturbation": _largest(after.perturbations)}
    whole = [p.name for p in found.base.fit.fit_problem.space.free if p.integer]
    moved = {n: found.base.fit.values[n] for n in whole}
    row["places_right"] = all(measured.values[n] == v for n, v in moved.items())
    if found.chosen is not None:
        row["places_right_after"] = all(measured.values[n] == found.chosen.fit.values[n] for n in moved)
    return row


def _nearly(found: Explanation, measured: Truth, true: set[str]) -> dict[str, Any] | None:
    """Where something like an effect is told: whether that effect is hidden, and whether its range holds the truth."""
    if not is_simpler_form(found):
        return None
    assert found.chosen is not None
    (name,) = found.chosen.names
    low, high = magnitude_range(found)
    own = measured.values.get(name)
    return {"right": name in true, "range": [low, high], "holds": own is not None and low <= own <= high}


def magnitude(found: Explanation, measured: Truth) -> dict[str, Any]:
    """Of the one hidden effect, beside the truth; empty where the chosen model lacks it."""
    (name,) = measured.hidden
    candidate_fit, true = found.chosen, measured.values[name]
    if candidate_fit is None or name not in candidate_fit.names:
        return {}
    low, high = profile_interval(candidate_fit.fit, name)
    return {
        "magnitude": candidate_fit.fit.values[name], "magnitude_over_true": candidate_fit.fit.values[name] / true,
        "interval": [low, high], "covers": bool(low <= true <= high),
    }  # fmt: skip


def outcome_of(verdict: str, credible: set[str], best: list[str], true: set[str]) -> str:
    """Outcome of named effects, see `outcome`."""
    if verdict in SEVERAL:
        if credible == true:
            return "right"
        if credible < true:
            return "part"
        return "extra" if true and credible > true else "mixed" if credible & true else "wrong"
    if best[0] in true:
        return "right" if len(true) == 1 else "part"
    return "second" if credible & true else "wrong"


def _expected_score(found: Explanation, measured: Truth, stands: Mapping[str, str]) -> list[float]:
    """Of every true effect: its signature at the base fit times its magnitude, or the largest score on a grid."""
    named, out = found.base_adequacy.named, []
    for name in measured.hidden:
        owner = stands.get(name)
        if owner is None or owner not in named.owners:
            out.append(float("nan"))
            continue
        k = named.best(owner)
        out.append(float(named.magnitude[k] if named.points[k] else named.size[k] * abs(measured.values[name])))
    return [round(v, 2) for v in out]


def _row(one: CandidateFit, found: Explanation) -> dict[str, Any]:
    own = {n: one.fit.values[n] for e in one.effects for n in e.names}
    return {
        "names": list(one.names), "ln_bayes": round(found.ln_bayes(one), 2), "implausible": one.implausible,
        "values": own, "misfit": round(one.fit.misfit, 1),
    }  # fmt: skip


def _chances(check: AdequacyTests) -> dict[str, float]:
    """Of the misfit of each kind, and of the worst shape of one mode where there are shapes."""
    shapes = check.modes[check.modes["kind"] == "shape"]
    kinds = {str(k): float(p) for k, p in zip(check.kinds["kind"], check.kinds["p"], strict=True)}
    if shapes.empty:
        return kinds
    worst = shapes.loc[shapes["p"].idxmin()]
    return kinds | {f"shape of {worst['mode']}": float(worst["p"])}


def _largest(scores: Any) -> list[Any]:
    if not len(scores.owners):
        return []
    k = int(np.argmax(scores.magnitude))
    return [scores.owners[k], round(float(scores.z[k]), 2)]
