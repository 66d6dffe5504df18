"""Constants that decide between the verdicts of an explanation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DecisionRules:
    """Constants of the decision; `record.json` holds those of a result.

    Attributes
    ----------
    credible : float
        Effects whose log evidence is within this of the best belong to the credible set (Bayes factor of 20:1).
    guard : float
        Factor on the standard deviation from which it counts as understated (two and a half standard errors with 8
        modes).
    least_modes : int
        Fewer modes cannot tell an effect from a parameter.
    least_responses : int
        The same for scalar responses.
    detectable : float
        Expected score from which an effect is found with about 90 % power at a family-wise level of 1 %.
    samples : int
        Samples behind family-wise p-values; one over it is the smallest p-value.
    unseen : float
        Change of the data by a plausible magnitude, in standard deviations, below which a candidate changes nothing.
    absorbed : float
        A signature of which less than this part is left unabsorbed counts as fully absorbed.
    alike_std : float
        Significance level of the test that modes differ by more than a common factor.
    followed : float
        Part of a row's variance left by the parameters below which the row is not tested.
    contradicted : float
        p-value of the prediction of held-out data below which they contradict the model.
    pull : float
        Family-wise level at which a parameter counts as pulled.
    near_limit : float
        Family-wise p-value up to which a model that is not rejected nearly was.
    nuisance : float
        Largest distance of a nuisance parameter from its nominal value, in prior standard deviations.
    same : float
        Correlation of signatures from which a local perturbation is collinear with a named effect.
    far : float
        Log Bayes factor from which other effects are fitted only if theirs is predicted to be a quarter of it.
    close : float
        Effects whose log evidence is within this of the best are refined.
    nearly : float
        The same, as a part of the log evidence that the best one has gained.
    refined : int
        Number of effects, and of pairs of effects, refitted with free integers.
    freed : int
        Most generic effects whose richer members are tried where nothing generic explains the data, or one of another
        kind does.
    smaller_steps : tuple of float
        Parts of a step that are tried where the full step raised the sum of squares.
    least_residuals : int
        Evaluations granted to a fit that the verdict needs although the budget is used up.
    hopeless : float
        A rough fit with a sum of squares so many times that of another is not refined.
    continued : int
        Fits that continue one which has not converged, before it is scored as it is; a bound on their cost.
    walk : int
        Steps of integers to better ones nearby: from one end of the bogie's seven places to the other.
    beyond : float
        Times the budget that continued fits and steps of integers may spend beyond it.
    anew : float
        Part of the budget that is added for refits from the nominal values.
    trapped : float
        Sum of squares over the number of rows that every effect leaves, above which further starts are fitted.
    anew_further : float
        Part of the budget that is added for these.
    rebased : float
        Least decrease of the base model's sum of squares, over the mean square that it leaves or over 1 if that is
        more, with which a decision begins again from a better base fit.
    rebasings : int
        How often it may.
    base_starts : int
        Further points from which a base model that is rejected or pulled is fitted, where nothing explains that.
    overstated : float
        Probability that independent errors of the stated standard deviations leave so small a sum of squares, below
        which scores of data without modes prove nothing.
    rejected : float
        Score of an effect from which the base model is strongly rejected.
    rejected_fit : float
        The same as a p-value of its goodness of fit.
    magnitudes : tuple of float
        Parts of the plausible magnitude from which an effect without a grid is fitted, beside that of one step.
    starts_anew : int
        Number of starts of one effect that are fitted.
    paired : float
        Least part of the budget for pairs of effects, whatever single effects have spent.
    decades : tuple of float
        Powers of ten times the plausible magnitude at which an effect is tried for pairing further modes.
    by_far : float
        Part of the log evidence that the best effect of a partial explanation gains, below which anything else is far
        behind: the verdict is then that something like it is missing.
    leaves : float
        The same by what is left: so many times the sum of squares that the best effect leaves.
    little : float
        Decrease of the sum of squares by anything further, over that by this effect, below which it explains nearly
        all.
    least_share : float
        Least part of the base model's sum of squares that a place which is told takes, and the effect of a partial
        explanation.
    minor_size : float
        Part of its plausible magnitude, and of what the first effect has of its own, below which a further is small.
    minor_gain : float
        Part of the log evidence of the first effect below which a further one gains little. One that is small and
        gains little beside a first is not named: the first has another form than listed.
    most_effects : int
        Effects that a stepwise search may take in.
    further : int
        Groups of collinear effects that are fitted beside those taken in, at every step.
    stepped : float
        Least part of the budget for the stepwise search, whatever was spent before.
    competing : int
        Other groups that are fitted in the place of each effect before several are named.
    worth : float
        Smallest predicted decrease of the sum of squares for which another integer is tried.
    blamed : int
        Number of faults of the measurement that are fitted.
    screened : int
        Number of faults of pairs, those of the largest scores, that are kept of all.
    pairs_share : float
        Share of the probability of any fault, and of a false alarm by one, that those of pairs have: the limits of the
        others hardly depend on them.
    pairs_least : float
        Least share of the sum of squares of the base model that a fault of a pair takes to be told where something is
        left: of many pairs one always resembles a smooth error of all channels somewhat.
    whole : float
        Distance of a magnitude from 1 below which a fault that is there wholly or not at all, an exchange, is there.
    confounded : float
        Correlation of signatures from which effects are reported as confounded.
    early : float
        Part of the budget for single effects.
    late : float
        Part of the budget after which integer parameters are not chosen again.
    pairs_of_best : int
        Effects tried beside the best one.
    pairs_of_next : int
        Effects tried beside the runner-up.
    noise_level : float
        Probability that noise alone gives the score that figures mark as noise.
    suspect : float
        Family-wise level at which one datum counts as the one without which everything fits.
    worthwhile : float
        Ratio of scores from which a further measurement is recommended.
    left_noise : float
        Score that noise gives a local perturbation anyway, where the place of what is left is sought.
    left_near : float
        Relative distance below which what is left is near the effect.
    left_most : float
        Share of what is left, in the modes that an effect changes, that is most of it.
    left_changed : float
        Share of an effect's signature in the fewest modes that count as those it changes.
    unexplained_size : float
        Posterior probability that the common size of unexplained candidates is not larger than assumed.
    unexplained_seen : float
        Unabsorbed part of a signature below which the data cannot tell its size.
    proposed, proposed_of_a_kind, proposed_hung, proposed_mounts : int
        Compositions that are fitted, by predicted evidence; of one kind among them; places of a hung mass; damper
        mounts.
    tried_mounts : int
        Damper mounts of which signatures are taken, those at the dampers with the largest scores.
    accuracies : int
        Combinations of accuracies of frequencies, damping and shapes that are fitted, to tell where a verdict changes.
    equal : float
        Log evidence, less the logarithm of the choices, within which proposals count as equal, whether it is that of a
        fit or predicted from a signature.
    """

    credible: float = 3.0
    guard: float = 1.11
    least_modes: int = 4
    least_responses: int = 4
    detectable: float = 4.0
    samples: int = 8000
    unseen: float = 1e-4
    absorbed: float = 1e-6
    alike_std: float = 0.01
    followed: float = 0.02
    contradicted: float = 1e-3
    pull: float = 0.01
    near_limit: float = 0.1
    nuisance: float = 2.0
    same: float = 0.98
    far: float = 30.0
    close: float = 10.0
    nearly: float = 0.35
    refined: int = 3
    freed: int = 2
    smaller_steps: tuple[float, ...] = (0.1, 0.01)
    least_residuals: int = 8
    hopeless: float = 1.05
    continued: int = 4
    walk: int = 6
    beyond: float = 5.0
    anew: float = 0.5
    trapped: float = 10.0
    anew_further: float = 1.0
    rebased: float = 1.0
    rebasings: int = 2
    base_starts: int = 6
    overstated: float = 1e-3
    rejected: float = 10.0
    rejected_fit: float = 1e-6
    magnitudes: tuple[float, ...] = (1 / 3, 1.0, 3.0)
    starts_anew: int = 2
    paired: float = 0.5
    decades: tuple[float, ...] = (-2, -1, 0, 1, 2)
    by_far: float = 0.5
    leaves: float = 5.0
    little: float = 0.02
    least_share: float = 0.02
    minor_size: float = 0.25
    minor_gain: float = 0.3
    most_effects: int = 4
    further: int = 3
    stepped: float = 1.0
    competing: int = 1
    worth: float = 0.5
    blamed: int = 3
    screened: int = 20
    pairs_share: float = 0.1
    pairs_least: float = 0.5
    whole: float = 0.25
    confounded: float = 0.9
    early: float = 0.7
    late: float = 0.85
    pairs_of_best: int = 3
    pairs_of_next: int = 2
    noise_level: float = 0.01
    suspect: float = 0.01
    worthwhile: float = 1.2
    left_noise: float = 2.0
    left_near: float = 0.6
    left_most: float = 0.5
    left_changed: float = 0.8
    unexplained_size: float = 0.999
    unexplained_seen: float = 1e-3
    proposed: int = 10
    proposed_of_a_kind: int = 3
    proposed_hung: int = 3
    proposed_mounts: int = 2
    tried_mounts: int = 12
    accuracies: int = 3
    equal: float = 3.0


RULES = DecisionRules()
"""Constants in force."""
