"""Constants that decide what is read from measured files and repeats, and which sensors are suspected."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadRules:
    """Constants of reading; `record.json` holds those of a result.

    Attributes
    ----------
    rounded_freq : float
        Share of the highest frequency of a file up to which a negative frequency is a zero with rounding.
    rigid_freq : float
        Share of the highest frequency of a file below which a mode is a rigid-body motion: rounding of the squares.
    doubt_modes : int
        Fewest modes that must share a strange property before it is told.
    doubt_entries : int
        Fewest entries of shapes likewise.
    percent_damping : float
        Damping ratio that all modes exceed only where they are percent.
    shape_std_most : float
        Standard deviation of a shape, over its largest entry, above which it says nothing.
    same_repeats : int
        Fewest repeats of which the same value to the last digit is told.
    absent_lines : float
        Largest share of the lines of all functions that one function may lack.
    in_hertz : float
        Largest relative deviation from 2 pi of the factor by which modal A and B tell eigenvalues in Hz.
    gap_lines : int
        Lines in a row that are interpolated where every function is needed on every line.
    local_axis : float
        Cosine below which a local axis has no part in a global direction, 0.6 degrees: sensors are mounted no better.
    farthest_freq : float
        Largest relative difference of frequency between repeats of one mode.
    same_mac : float
        Smallest MAC between repeats of one mode.
    same_score : float
        Score (see `calib.measurement.matching.match_modes`) below which two modes are not the same.
    ambiguous : float
        An assignment whose sum of scores is this close to the best one counts as equally good.
    same_freq : float
        A mode this close in frequency (relative) to one that its repeat lacks is that mode, even if its shape differs.
    mac_but_one : float
        With this MAC without one sensor it is the same mode, and that sensor is wrong in one of the repeats.
    sensors_but_one : int
        Fewest sensors for that test.
    sensors_for_mac : int
        With fewer common sensors a MAC says nothing, and modes are matched by frequency.
    noted_mac : float
        MAC of a mode between repeats below which a note tells that it may be another mode.
    outlier_level : float
        Significance level of one test of a table of Gaussian repeats; `calib.measurement.outliers.find_outlying` tells
        the false-alarm rate.
    value_level : float
        The same for a table of single numbers, which is tested once; shapes are tested as entries, channels and modes.
    named_level : float
        The same for single numbers that are reported but kept.
    outlier_repeats : int
        Fewest repeats that are tested: of two that disagree, the wrong one is unknown.
    outliers_most : int
        Largest number of outliers searched for in one group, always fewer than half of it.
    outlier_groups : int
        With fewer groups the variances of the others are not used to moderate that of a group.
    alike_dof : tuple of float
        Degrees of freedom of the variances of groups around their common one: hypotheses of equal prior probability.
        The standard deviations of groups then spread by a factor of 1.9, 1.5, 1.3, 1.2 and 1.1.
    spoilt : float
        Share of groups whose variance contains an outlier.
    spoilt_width : float
        Width over which the logarithm of such a variance may lie.
    shape_resolution : float
        Standard deviation, in parts of the largest entry, that rounding alone gives shapes.
    value_resolution : float
        Smallest relative standard deviation of a single number: closer agreement of repeats counts as rounding.
    found_most : int
        Largest number of disagreements of shapes searched for in one measurement.
    dead_below : float
        Share of its usual motion below which a channel of one repeat is dead.
    turned_below : float
        Gain of a channel against the other repeats below which it is turned round.
    entry_share : float
        A single entry with this share of a block's excess is reported instead of the block.
    moves_above : float
        Root mean square motion (largest entry of a mode: 1) from which a sensor's sign can be compared in two repeats.
    collinear_above : float
        MAC over the modes above which the motions of two channels are collinear.
    resonance_widths : float
        Window around a resonance over its half-power width: at its ends a mode has 1/26 of its power at the peak.
    prominence : float
        Least rise of a resonance above the valleys beside it, dB: twice the 3 dB by which its width is measured.
    above_noise : float
        Least power of a resonance over the mean power of the noise: noise alone exceeds it once in 20 000 lines of a
        single function, ``exp(-10)``, and less often in sums over several.
    setup_scale : float
        Largest relative difference of what two set-ups of FRFs have in common: beyond it one has another sensitivity.
    lines_most : int
        Lines of FRFs up to which each is a line by itself in a test.
    group_width : float
        Width of a group of lines that become one, over their distance from the nearest pole.
    hit_level, hit_noise : float
        A pulse of a hammer's force exceeds this share of the largest one, and this multiple of the noise.
    hit_share : float
        Largest share of the samples of a record that pulses take: a shaker's force takes more.
    double_hit : float
        Distance to the next pulse, over the usual one, below which it belongs to a double hit.
    pulse_samples, offset_samples : int
        Samples beside a pulse that count as part of it, and fewest of which an offset is the mean.
    clipped_samples : int
        Samples of a block that are equal to its largest one to the last digit, by which an overload is told.
    clipped_step : float
        Jump beside them, over the range of the block: the peak of rounded values is flat without one.
    decayed : float
        What an exponential window leaves at the end of a block where a response has not decayed.
    still_moving : float
        Power of a line in the last quarter of a block, over the median of all lines, that is no noise: noise alone
        exceeds it once in a billion.
    force_drop : float
        Fall of the force's power spectrum, dB, at which the lines end.
    rate_over_lines : float
        Samples a second over the highest line: filters against aliasing act above.
    check_sensors : int
        With fewer sensors that move, a wrong one cannot be identified.
    check_gain : float
        Rise of the mean MAC below which the correction of a sensor is not worth a sentence.
    check_evidence : float
        Log-likelihood ratio required of a single correction; a probability of about 3e-5 for the worst-placed sensor.
    check_other_modes : float
        Log-likelihood ratio required of all modes but the best one: a single odd mode points to the model, not to a
        sensor.
    check_against : float
        Largest share of MAC lost in some modes to the MAC gained in others.
    check_residual : float
        Floor of 1 - MAC (2 % of the motion), so that exact data do not make a negligible change significant.
    dead_measured : float
        Share of the largest motion below which a sensor is dead in every mode, while the model moves there.
    dead_model : float
        Share of the largest motion from which the model moves there.
    partner_size : float
        Largest distance of a measured node from the model, over the model's size: a tape measure, and half of the depth
        of a section whose middle is modelled.
    partner_spacing : float
        Largest distance from a model node, over that from there to the next node: on a line of nodes another one is
        nearer beyond.
    partner_ambiguous : float
        Two nodes are as near where their distances differ by less than this share of the distance between them.
    partner_told : float
        Share of its limit beyond which a distance is told.
    partner_share : float
        Share of the measured nodes that lie within their limits where units of length agree.
    """

    rounded_freq: float = 1e-3
    rigid_freq: float = 1e-6
    doubt_modes: int = 2
    doubt_entries: int = 3
    percent_damping: float = 0.2
    shape_std_most: float = 1.0
    same_repeats: int = 3
    absent_lines: float = 0.25
    in_hertz: float = 0.01
    gap_lines: int = 2
    local_axis: float = 0.01
    farthest_freq: float = 0.1
    same_mac: float = 0.5
    same_score: float = 0.25
    ambiguous: float = 0.1
    same_freq: float = 0.02
    mac_but_one: float = 0.9
    sensors_but_one: int = 5
    sensors_for_mac: int = 3
    noted_mac: float = 0.5
    outlier_level: float = 2e-4
    value_level: float = 5e-4
    named_level: float = 1e-2
    outlier_repeats: int = 3
    outliers_most: int = 10
    outlier_groups: int = 3
    alike_dof: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0, 64.0)
    spoilt: float = 0.05
    spoilt_width: float = 14.0
    shape_resolution: float = 1e-4
    value_resolution: float = 1e-6
    found_most: int = 25
    dead_below: float = 0.2
    turned_below: float = -0.5
    entry_share: float = 0.8
    moves_above: float = 0.1
    collinear_above: float = 0.8
    resonance_widths: float = 5.0
    prominence: float = 6.0
    above_noise: float = 10.0
    setup_scale: float = 0.2
    lines_most: int = 2000
    group_width: float = 0.2
    hit_level: float = 0.1
    hit_noise: float = 8.0
    hit_share: float = 0.1
    double_hit: float = 0.5
    pulse_samples: int = 4
    offset_samples: int = 16
    clipped_samples: int = 3
    clipped_step: float = 0.01
    decayed: float = 0.01
    still_moving: float = 30.0
    force_drop: float = 30.0
    rate_over_lines: float = 2.56
    check_sensors: int = 4
    check_gain: float = 0.002
    check_evidence: float = 8.0
    check_other_modes: float = 4.0
    check_against: float = 0.2
    check_residual: float = 4e-4
    dead_measured: float = 1e-3
    dead_model: float = 0.05
    partner_size: float = 0.02
    partner_spacing: float = 0.5
    partner_ambiguous: float = 0.1
    partner_told: float = 0.75
    partner_share: float = 0.75


RULES = ReadRules()
"""Constants in force."""
