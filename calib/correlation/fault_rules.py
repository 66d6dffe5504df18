"""Plausible sizes and limits of what a test may get wrong: of suspected faults, and of nuisances that a fit frees."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FaultRules:
    """Sizes of errors of a test; `record.json` holds those of a result.

    Attributes
    ----------
    gain : float
        Plausible gain error of a sensor in a modal test: a swapped sign is twice, a dead channel once as much.
    gain_lower : float
        Smallest such error, and error of the factor of a set-up: beyond a swapped sign, which is -2.
    gain_upper : float
        The largest: ten times the motion.
    set_up : float
        Plausible error of the common factor of a group of sensors.
    phase : float
        Plausible phase of a delay at the highest measured frequency, rad.
    rotation : float
        Plausible misalignment of a sensor's axis, deg.
    rotation_most : float
        Largest misalignment, deg: an axis taken for another one, of either sign, is well inside it.
    shift : float
        Plausible error of a sensor's place along the structure, mm, but no more than `shift_part` allows.
    shift_part : float
        Largest plausible error of a place, as a part of the way to the next nodes.
    shift_most : float
        Largest error of a place, over the plausible one.
    cross_talk : float
        Plausible share of another channel.
    exchange_most : float
        Largest part of an exchange of two channels or axes, which is 1 where they are exchanged.
    mixed : float
        Plausible share of a neighbouring mode in a measured shape, over the size of the shape.
    mixed_most : float
        Largest such share.
    mixed_apart : float
        Largest difference of the natural frequencies of two modes that an analysis may mix, over their mean.
    damping : float
        Plausible damping ratio that the analysis adds at the middle of the measured frequencies.
    damping_most : float
        Largest such ratio, over the plausible one.
    frf_gain : float
        Plausible gain error of a channel of FRFs, %; a swapped sign is -200 %.
    frf_gain_lower : float
        Smallest gain error of a suspected channel of FRFs, %: at -200 the sign is swapped.
    frf_phase : float
        Plausible error of the phase of a channel of FRFs, deg.
    gain_sd : float
        Default prior standard deviation of a channel's gain that a fit frees, %: assumed, the order of a comparison
        calibration in mid band. A calibration sheet states more; its expanded uncertainty is two standard deviations.
    phase_sd : float
        The same of its phase, deg.
    gain_weakest : float
        Lower limit of such a gain, %: at -100 the channel is dead.
    mass_sd : float
        Default prior standard deviation of an added mass, over that of the data sheet: assumed, cable and stud
        included.
    limit : float
        Distance of the limits of errors that a fit frees, and of delays, in prior standard deviations: they exclude
        nothing that the prior allows.
    resonance_most : float
        Largest stated error of the model at its resonances, %: the factor of the functions is linear in it.
    """

    gain: float = 1.0
    gain_lower: float = -3.0
    gain_upper: float = 9.0
    set_up: float = 0.5
    phase: float = 0.3
    rotation: float = 15.0
    rotation_most: float = 120.0
    shift: float = 100.0
    shift_part: float = 0.5
    shift_most: float = 5.0
    cross_talk: float = 0.1
    exchange_most: float = 2.0
    mixed: float = 0.3
    mixed_most: float = 1.0
    mixed_apart: float = 0.2
    damping: float = 0.01
    damping_most: float = 20.0
    frf_gain: float = 100.0
    frf_gain_lower: float = -300.0
    frf_phase: float = 60.0
    gain_sd: float = 1.0
    phase_sd: float = 0.5
    gain_weakest: float = -90.0
    mass_sd: float = 0.1
    limit: float = 10.0
    resonance_most: float = 5.0


RULES = FaultRules()
"""Sizes in force."""
