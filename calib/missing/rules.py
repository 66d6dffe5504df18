"""What decides between the verdicts of an explanation, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """Constants of the decision; `record.json` holds those that an answer was made with.

    Attributes
    ----------
    credible : float
        Effects whose log evidence is within this of the best belong to the credible set (odds of 20:1).
    guard : float
        Factor on the scatter from which it counts as understated (two and a half standard errors with 8 modes).
    least_modes : int
        Fewer modes cannot tell an effect from a parameter.
    least_responses : int
        Nor can fewer plain responses.
    detectable : float
        Expected score from which an effect is found with about 90 % power at a family-wise level of 1 %.
    draws : int
        Of normal variates behind family-wise chances; one over it is the smallest that can be told.
    absorbed : float
        Columns of which the parameters leave less than this part are no directions at all.
    alike_scatter : float
        Level at which modes differ by more than a common factor.
    followed : float
        Part of a row's variance left by the parameters below which it says nothing.
    contradicted : float
        Chance of a right model predicting a group as badly, below which the group contradicts it.
    strain : float
        Family-wise level at which a parameter counts as strained.
    nuisance : float
        Largest distance of a nuisance parameter from its middle value, in prior standard deviations.
    at_limit : float
        Distance from a limit at which a parameter is on it, over its range.
    at_limit_std : float
        The same over its posterior standard deviation.
    same : float
        Correlation of fingerprints from which a local change says the same as a named effect.
    far : float
        Log Bayes factor from which an effect leaves no room for those that promise a quarter of it.
    close : float
        Effects whose log evidence is within this of the best are fitted to the end.
    nearly : float
        The same, as a part of what the best one has gained.
    polished : int
        Effects, and pairs of effects, that may move whole numbers back.
    smaller_steps : tuple of float
        Parts of a step that are tried where the whole step ended above the fit it began from.
    least_residuals : int
        Residuals of a fit that the verdict needs although the budget is used up.
    hopeless : float
        A rough fit that leaves so much more than another is not followed.
    anew : float
        Part of the budget that is added to it, for a base fit that was led astray.
    rejected : float
        Score of an effect from which the base model is strongly rejected.
    rejected_fit : float
        The same as a chance of its misfit as a whole.
    magnitudes : tuple of float
        Parts of the plausible strength that an effect without a grid begins with, beside the one that one step leads
        to.
    starts_anew : int
        Starts of one effect that are followed.
    paired : float
        Part of the budget that pairs of effects may spend at least, whatever single effects have spent.
    decades : tuple of float
        Powers of ten times the plausible strength at which an effect is tried for what it pairs.
    worth : float
        Smallest promised decrease for which another whole number is tried.
    confounded : float
        Correlation of fingerprints from which effects are named as confounded.
    """

    credible: float = 3.0
    guard: float = 1.11
    least_modes: int = 4
    least_responses: int = 4
    detectable: float = 4.0
    draws: int = 8000
    absorbed: float = 1e-6
    alike_scatter: float = 0.01
    followed: float = 0.02
    contradicted: float = 1e-3
    strain: float = 0.01
    nuisance: float = 2.0
    at_limit: float = 1e-3
    at_limit_std: float = 0.05
    same: float = 0.98
    far: float = 30.0
    close: float = 10.0
    nearly: float = 0.35
    polished: int = 3
    smaller_steps: tuple[float, ...] = (0.1, 0.01)
    least_residuals: int = 8
    hopeless: float = 1.05
    anew: float = 0.5
    rejected: float = 10.0
    rejected_fit: float = 1e-6
    magnitudes: tuple[float, ...] = (1 / 3, 1.0, 3.0)
    starts_anew: int = 2
    paired: float = 0.5
    decades: tuple[float, ...] = (-2, -1, 0, 1, 2)
    worth: float = 0.5
    confounded: float = 0.9


RULES = Rules()
"""Those in force."""
