"""Constants that decide which poles of FRFs and of ambient records count as modes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IdentifyRules:
    """Constants of modal identification; they are those of `calib modes`, which writes modes and no `record.json`.

    Attributes
    ----------
    frf_order_most : int
        Largest number of poles of FRFs.
    lines_per_order : int
        Fewest lines behind each pole: a function adds an equation a line, and each pole brings an unknown to the common
        denominator and one to the function's own numerator, so that about half of the equations are left over.
    band_parts : int
        Parts of the band in which poles are sought by themselves as well.
    lines_least : int
        Fewest lines of FRFs: ten orders, of which the rule of stabilisation needs five.
    freq_change : float
        Largest relative change of a stable pole's natural frequency from one order to the next.
    damping_change : float
        Likewise of its damping ratio.
    damping_lines : float
        Change of the real part of a pole, over the distance of lines, below which its damping counts as unchanged.
    stable_mac : float
        Smallest MAC between its residues over all functions at the two orders.
    skipped : int
        Orders that a pole may be missing between.
    orders_least : int
        Fewest orders at which a mode is stable.
    orders_share : float
        The same, over all orders.
    overdamped : float
        Above this ratio a pole of FRFs has no resonance and stands for other errors of the fit.
    compared_lines : int
        Fewest lines by which a mode is checked; the nearest, where its half-power width holds fewer.
    excess_most : float
        Largest error beyond noise around a mode, over the FRF: the FRAC is then about 0.99.
    excess_sure : float
        Standard deviations by which the sum of squared errors around a mode must exceed its expectation to count as
        misfit: one in three million by chance, while a search looks at a few dozen modes.
    width_lines, mode_lines : int
        Lines that a resonance needs within its half-power width, and in a band each: where no pole is stable, fewer
        are told.
    own_freq_reach, own_damping_reach : float
        Prior standard deviations of a function's own pole: of its frequency in half half-power widths, of the logarithm
        of its damping ratio. They keep functions in check that hardly show a mode.
    own_seen : float
        Largest standard deviation of a function's own pole, over that of the prior, with which it counts.
    pair_widths : float
        Lines around a pair of poles by which it is told from one that moves, in half-power widths to both sides.
    pair_surely : float
        Difference of two values of the information criterion that is beyond doubt.
    functions_least : int
        Fewest functions that show a mode by which its scatter between functions is judged.
    scatter_chance : float
        Inverse of the chance by which noise alone would make functions differ as much.
    scatter_least : float
        Least scatter of a natural frequency that matters, over its damping ratio.
    scatter_alone : float
        Scatter of one mode, over the median of the others, from which on it may be that of two modes.
    mpc_least : float
        Least modal phase collinearity of a shape under one reference, which has no other evidence of a mode.
    residual_told : float
        Residual around a mode, in standard deviations of the FRFs, from which on it is told.
    accepted_reach : float
        Largest relative distance of an accepted frequency from its pole, where the half-power width is smaller.
    record_order_most : int
        Largest number of states of ambient records: two a mode, half of which pyOMA2's clusters ask for.
    rows_least : int
        Fewest block rows of the Hankel matrix: correlations over 40 samples.
    parts : int
        Parts into which records are cut for standard deviations, which then have a relative error of 13 %.
    samples_per_row : int
        Fewest samples of a part, over the block rows.
    record_overdamped : float
        Above this ratio a pole of records stands for noise.
    same_mac : float
        Least MAC of a mode with itself when a part of the records is left out.
    damping_unsure : float
        Largest standard deviation of a damping ratio, over the ratio: above it the pole may as well be undamped, a hum.
    orders_resampled : tuple of int
        Orders at which parts of records are left out, for modes that have poles there; of each part their median
        counts, as of the whole the median over all orders does: at single orders poles of noise come close.
    rate_over_band : float
        Samples a second that are kept, over the highest frequency of a band.
    periods_least : float
        Fewest periods of a mode in the lags of the Hankel matrix: of slower ones the damping is biased beyond its
        standard deviation.
    one_shape_least : float
        Least share of the correlations of a mode that one shape describes.
    lags : int
        Lags of the correlations behind half-spectra.
    window_end : float
        What the exponential window leaves of the last one.
    look_alike : float
        MAC of two measured shapes from which a first look says that sensors do not tell them apart.
    look_complex : float
        Phase collinearity of a shape below which a first look tells it.
    look_coherence : float
        Coherence at a resonance below which it is told.
    look_held : float
        Share of samples at the largest or smallest value from which a channel counts as clipped or held.
    """

    frf_order_most: int = 40
    lines_per_order: int = 3
    band_parts: int = 4
    lines_least: int = 20
    freq_change: float = 0.01
    damping_change: float = 0.05
    damping_lines: float = 0.01
    stable_mac: float = 0.95
    skipped: int = 1
    orders_least: int = 5
    orders_share: float = 0.25
    overdamped: float = 0.9
    compared_lines: int = 5
    excess_most: float = 0.1
    excess_sure: float = 5.0
    width_lines: int = 3
    mode_lines: int = 20
    own_freq_reach: float = 1.0
    own_damping_reach: float = 0.5
    own_seen: float = 0.5
    pair_widths: float = 5.0
    pair_surely: float = 40.0
    functions_least: int = 3
    scatter_chance: float = 1e4
    scatter_least: float = 1e-3
    scatter_alone: float = 3.0
    mpc_least: float = 0.5
    residual_told: float = 5.0
    accepted_reach: float = 0.01
    record_order_most: int = 60
    rows_least: int = 20
    parts: int = 30
    samples_per_row: int = 8
    record_overdamped: float = 0.5
    same_mac: float = 0.8
    damping_unsure: float = 0.5
    orders_resampled: tuple[int, ...] = tuple(range(16, 50, 4))
    rate_over_band: float = 2.56
    periods_least: float = 1.0
    one_shape_least: float = 0.9
    lags: int = 256
    window_end: float = 0.01
    look_alike: float = 0.9
    look_complex: float = 0.9
    look_coherence: float = 0.8
    look_held: float = 0.01


RULES = IdentifyRules()
"""Constants in force."""
