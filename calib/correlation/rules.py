"""Constants that decide which modes are paired, what counts as a deviation, and what stands for unknown errors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CompareRules:
    """Constants of the comparison of model and measurement; `record.json` holds those of a result.

    Attributes
    ----------
    level : float
        Probability that a correctly specified model passes a single comparison.
    far_error : float
        Frequency error of a pair that raises a warning, as a fraction.
    pair_near : float
        Frequency ratio (model over measured, or its inverse) up to which a pair by shape has its full weight.
    pair_far : float
        Frequency ratio from which such a pair has none.
    pair_agree : float
        Factor within which most pairs agree on a common ratio where units differ or the whole model is far off.
    order_scales : tuple of float
        Pairing by order: candidate mean absolute deviations of ln frequency from the common ratio.
    order_common : float
        Mean absolute ln of the common ratio (prior scale).
    order_common_most : float
        Largest cost of the common ratio: a model in other units is off by an arbitrary common factor.
    skip_measured : float
        Cost of a measured mode without a partner, as a negative logarithm of its probability.
    skip_model : float
        Cost of the first of a run of unmeasured model modes.
    skip_model_more : float
        Cost of each further one.
    near_zero : float
        Model modes below the lowest measured one by more than this factor count as rigid-body modes.
    unit_near : float
        Wrong units: relative tolerance of a ratio of measured over model to a factor, for errors of the model.
    unit_share : float
        Least fraction of the modes paired by shape that show the factor.
    unit_mac : float
        MAC from which a pair is accepted whatever its frequencies.
    unit_by_order : int
        Fewest modes, matched by ascending order, that show a factor; fewest responses of one name likewise.
    unit_by_shape : int
        Fewest modes matched by shape that show a factor.
    unit_far : float
        Ratio beyond which a value is reported even if no factor explains it.
    gross_frac : float
        FRAC of FRFs, with a real factor, from which this factor is told as a gross error.
    gross_near : float
        Relative tolerance of such a factor to a known one: a sign, or units.
    gross_order : float
        Most that another order of omega may leave of the disagreement without one, for it to be told.
    subspace_equal : float
        Model modes closer than this, in standard deviations of the difference of two measured frequencies, are
        compared by the subspace that they span.
    subspace_reach : float
        The same where the nominal model has such modes, as square and axisymmetric structures have: a measured one then
        differs a little. The residual jumps where a pair comes that close, so that a fit of any other structure,
        whose modes are close by chance, would end at the jump.
    subspace_seen : float
        Least singular value, over the largest, of a motion of such modes that the sensors see.
    twice_near : float
        Relative difference of frequencies below which two measured modes of one shape may be one, found twice.
    twice_mac : float
        MAC of their shapes from which they may.
    twice_like : float
        MAC from which a model mode looks like them; they are one if exactly one does.
    rigid_left : float
        Largest residual power of a rigid-body shape, per remaining degree of freedom; a random shape leaves about 1.
    rigid_spare : int
        Least number of sensors beyond the number of distinguishable rigid-body motions.
    corrections_tried : int
        Corrections of sensors in a round that are tested by pairing: those with the largest EMAC at the best partners.
    orthogonal_kept : float
        Cross-orthogonality that a pair should reach, rounded to two decimals (NASA-STD-5002).
    orthogonal_leak : float
        The same that other shapes should not exceed.
    own_from : int
        Least number of repeats for an individual standard deviation: with fewer, its t variate has no finite variance.
    unknown_response_std : float
        Assumed standard deviation of a scalar response where none is known, relative to the value.
    unknown_frf_std : float
        Assumed standard deviation of real and imaginary part of an FRF each, relative to the modulus, where none is
        known: that of 12 averages at a coherence of 0.99 (Bendat and Piersol 2010).
    mesh_reach : float
        Half-width of the limits of the multiple of a mesh's error, in its prior standard deviations.
    mesh_mac : float
        MAC below which a mode of the finer mesh is not the same one.
    mesh_near : float
        Relative difference of frequencies up to which modes may be turned into each other by another mesh.
    """

    level: float = 0.95
    far_error: float = 0.3
    pair_near: float = 2.0
    pair_far: float = 10.0
    pair_agree: float = 1.3
    order_scales: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2)
    order_common: float = 0.15
    order_common_most: float = 8.0
    skip_measured: float = 6.0
    skip_model: float = 3.0
    skip_model_more: float = 0.25
    near_zero: float = 5.0
    unit_near: float = 0.25
    unit_share: float = 0.75
    unit_mac: float = 0.7
    unit_by_order: int = 3
    unit_by_shape: int = 2
    unit_far: float = 100.0
    gross_frac: float = 0.95
    gross_near: float = 0.05
    gross_order: float = 0.25
    subspace_equal: float = 0.02
    subspace_reach: float = 2.0
    subspace_seen: float = 0.1
    twice_near: float = 0.01
    twice_mac: float = 0.98
    twice_like: float = 0.8
    rigid_left: float = 0.1
    rigid_spare: int = 3
    corrections_tried: int = 12
    orthogonal_kept: float = 0.9
    orthogonal_leak: float = 0.1
    own_from: int = 4
    unknown_response_std: float = 0.01
    unknown_frf_std: float = 0.02
    mesh_reach: float = 10.0
    mesh_mac: float = 0.5
    mesh_near: float = 3e-3


RULES = CompareRules()
"""Constants in force."""
