"""Thresholds by which parameters count as identified and cases as agreeing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """Thresholds of the verdicts; `record.json` holds those that a result was made with.

    Attributes
    ----------
    needed : float
        Largest posterior standard deviation of an identified parameter, over its nominal value, where the study does
        not state what is needed; see `calib.inference.identify.needed_std`.
    whole : float
        The same of an integer, in steps: all its other values together then have a probability of at most 4 %.
    none : float
        Largest nominal value, over a stated prior standard deviation, that is as good as 0.
    by_data : float
        Smallest ``data_share`` of an identified parameter: the part of the information that the data give; see
        `Posterior`.
    narrow : float
        Largest standard deviation of a linear constraint, over that of its sum without it, with which the constraint
        counts as data; see `calib.inference.constraints.constraint_rows`.
    considered : float
        Smallest share of the variance of a fitted parameter that a held one adds where it is named.
    linear : float
        Largest error of the shift of an estimate by a held parameter, over its standard deviation with this parameter,
        up to which the shift counts as linear.
    confounded : float
        Absolute posterior correlation from which two parameters count as confounded.
    trades : float
        Absolute posterior correlation from which a parameter that is not identified is reported to trade with another.
    seen : float
        Change of the whitened residual by one prior standard deviation below which the data hardly see a direction.
    takes_part : float
        Smallest component (of a unit vector) of a parameter that is named as part of a direction.
    stable : float
        Largest difference between cases, over the range between the limits, of a stable parameter (Ribeiro et al.
        2013).
    nearly_equal : float
        Relative difference up to which misfits count as equal.
    equal : float
        Insignificant difference of sums of squares: a third of a standard deviation of one parameter.
    unseen : float
        Largest share of the search space, expected to lead to an optimum not found yet, at which starts of least
        squares agree; see `calib.inference.starts.Optima`.
    most_starts : int
        Starts after which a genetic search follows if they do not agree.
    further_starts : int
        Further starts of least squares on FRFs where the fit from those of the study is rejected.
    profile_differs : float
        Distance of the ends of an interval by the profile likelihood, or by samples of the posterior, from those of
        the linearised interval, over its half-width, from which the two are said to differ.
    chain : float
        Steps of a chain over its autocorrelation time from which intervals of its samples are compared (Goodman and
        Weare 2010; Foreman-Mackey et al. 2013).
    refits : int
        Combinations of integer parameters that least squares fits from each start.
    refits_after_search : int
        The same after a genetic search: its own and the nearest neighbours.
    """

    needed: float = 0.10
    whole: float = 0.2
    none: float = 0.01
    by_data: float = 0.5
    narrow: float = 1.0
    considered: float = 0.2
    linear: float = 0.25
    confounded: float = 0.9
    trades: float = 0.5
    seen: float = 1.0
    takes_part: float = 0.3
    stable: float = 0.10
    nearly_equal: float = 0.05
    equal: float = 0.1
    unseen: float = 0.10
    most_starts: int = 20
    further_starts: int = 6
    profile_differs: float = 0.2
    chain: float = 50.0
    refits: int = 25
    refits_after_search: int = 12


WIDE = 1.96
"""Half-width of a 95 % interval, in standard deviations; the root of the increase of the sum of squares at its ends."""

RULES = Rules()
"""The thresholds in force."""
