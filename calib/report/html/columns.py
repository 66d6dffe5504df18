"""Columns of the tables that the page reads, by the name of the table without its stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_GAINS = "gain gain_low gain_high ln_bayes ln_bayes_low ln_bayes_high"
_INTERVALS = "value predicted low high low_unexplained high_unexplained"
_MODES = "freq_{0} error_{0} mac_{0}"


def _columns(text: str, numbers: str = "", **more: str) -> dict[str, Any]:
    """Arguments of `calib.results.table.read_table`, each a text with the names of the columns."""
    return {"text": text.split(), "numbers": numbers.split(), **{name: own.split() for name, own in more.items()}}


def _matrix(key: str) -> dict[str, Any]:
    """A table of numbers whose other columns are named by what they belong to."""
    return {"text": [key], "others_are_numbers": True}


_EVERY_MODE = _columns(
    "mode freq_kind",
    f"freq_measured {_MODES.format('before')} {_MODES.format('after')}",
    flags="held_out",
    if_there=_MODES.format("initial"),
)
_ERRORS = _columns("group stage", "rows rms expected p")
_UNEXPLAINED = _columns("parameter", "value low high value_unexplained low_unexplained high_unexplained", blank="unit")
_SUSPECTS = _columns("what", "rows chi2 p p_fit_without", flags="explains")

COLUMNS: Mapping[str, Mapping[str, Any]] = {
    # measurement
    "measured of modes": _columns(
        "mode", "natural_freq damped_freq freq_std damping_ratio damping_std repeats freq_std_used", flags="held_out",
        unique="mode",
    ),
    "measured of responses": _columns("response", "value std repeats", flags="held_out", unique="response"),
    "measured of frf": _columns("response reference quantity", "lines freq_min freq_max repeats", flags="held_out"),
    "sensors": _columns("sensor direction", "x y z shape_std", flags="held_out", blank="part"),
    "repeat_disagreements": _columns("sentence"),
    "sensor_check": _columns("sentence"),
    "node_partners": _columns("node", "x y z distance limit", blank="partner remark"),
    # comparison
    "comparison of modes": _columns(
        "mode",
        "model_mode natural_freq_measured natural_freq_model freq_error damping_ratio_measured damping_ratio_model "
        "mac emac margin",
        unique="mode",
    ),
    "comparison of responses": _columns("response", "measured model error error_in_std"),
    "mac": _matrix("mode"),
    "comac": _columns("sensor", "comac", if_there="motion"),
    "expansion": _columns("mode reduction", "residual imaginary tam_error", blank="reason"),
    "shapes": _columns("mode sensor direction", "x y z measured_re"),
    "model_places": _columns("name form", "x y z", blank="kind parameters", if_there="dx dy dz"),
    "deflection": _columns("mode", "point u v w", complete="point u v w"),
    "where_it_fails": _columns("kind what verdict", "value in_std", if_there="limit"),
    # sensitivity
    "selection": _columns(
        "parameter why",
        "max_spearman spearman_floor max_partial partial_floor max_variance_share variance_share_floor",
        flags="measured selected",
    ),
    **{name: _matrix("parameter") for name in ("partial", "sensitivity", "variance_share", "input_correlation")},
    "prognosis": _columns("response model", "cop lower upper error", blank="inputs"),
    "refined": _columns(
        "response", "cop error error_near cop_after error_after error_near_after", unique="response"
    ),
    "sensitivity_samples": {"text": [], "others_are_numbers": True},
    "morris": _columns("parameter response", "mu_star"),
    "sobol": _columns("parameter response", "ST"),
    # calibration
    "parameters": _columns(
        "case parameter unit", "value lower upper ratio spread std search_value", flags="on_limit stable identified"
    ),
    "parameter_space": _columns(
        "parameter", "value lower upper prior_sd", if_there="search_lower search_upper", flags="integer",
        blank="unit description source distribution scale",
    ),
    "verdicts": _columns("parameter unit sentence", "value lower upper ratio std spread", flags="identified",
        if_there="low high",
    ),
    "intervals": _columns(
        "parameter unit kind sentence", "value lower upper linear_lower linear_upper data_lower data_upper",
        flags="differs", unique="parameter",
    ),
    "profiles": _columns("parameter", "value rise rise_data interval_at"),
    "posterior_intervals": _columns(
        "parameter unit sentence", "mean std lower median upper linear_lower linear_upper", flags="differs",
        unique="parameter",
    ),
    "robustness": _columns(
        "response", "fitted measured std q025 q975 least most outside", blank="unit sentence", unbounded="least most",
        unique="response",
    ),
    "pareto": _columns("kind", "design first second objective", flags="knee lowest"),
    "pareto_objectives": _columns("name of responses", "weight least most knee lowest least_squares", unique="name"),
    "points": _columns("case point", "objective sum_of_squares prior total", if_there="mean_error mean_mac"),
    "errors_by_case": _columns("case point what", "measured model error mac"),
    "considered": _columns("parameter adds_to words", "value std std_without std_with", flags="matters", blank="unit"),
    "between_tests": _columns("parameter what", "value low high", blank="unit", if_there="p"),
    "std_by_test": _columns("parameter unit test", "std prior_sd"),
    "convergence": _columns("case", "generation best mean", complete="generation", unbounded="best mean"),
    "posterior_correlation": _matrix("parameter"),
    "confounded": _columns("parameter_a parameter_b words", "correlation"),
    "unseen_directions": _columns("words", "signal", flags="seen"),
    "predictions": _columns("mode", "natural_freq std lower upper"),
    "suspects_calibrated": _SUSPECTS,
    "unexplained_calibrated": _UNEXPLAINED,
    # explanation
    "pulls": _columns(
        "model parameter", "nominal value prior_sd standardised limit", flags="pulled", blank="unit",
        unbounded="standardised",
    ),
    "unexplained": _UNEXPLAINED,
    "effects": _columns(
        "name title",
        "z unabsorbed magnitude magnitude_low magnitude_high magnitude_min plausible largest ln_bayes ln_bayes_third "
        "ln_bayes_triple model_probability held_out_gain",
        flags="visible refitted credible told",
        if_there="told",
        blank="unit implausible confounded_with stands_for lacks look_for",
        unbounded="magnitude_min",
    ),
    "effect_places": _columns("effect", "x y z", complete="x y z"),
    "why": _columns("effects effect kind", "residual signature left"),
    "why_parameters": _columns("effect parameter", "value", blank="description unit"),
    "why_places": _columns("effect perturbation kind", "x y z correlation"),
    "reduction_by_test": _columns("effects", "rows before after share", unique="effects"),
    "confounding": _matrix("effect"),
    "perturbations": _columns("perturbation kind", "x y z score unabsorbed limit", flags="told", if_there="told"),
    "candidate_fits": _columns("effects", "misfit ln_bayes", blank="implausible"),
    "misfit_kinds": _columns("stage mode kind", "chi2 dof p"),
    "sensor_misfit": _columns("stage mode sensor direction", "x y z re im"),
    "response_misfit": _columns("stage response", "residual"),
    "frf_misfit": _columns("stage function", "freq re im"),
    "suspects_explained": _SUSPECTS,
    "faults": _columns(
        "fault kind", "score unabsorbed magnitude low high magnitude_min ln_bayes limit", flags="fitted blamed",
        blank="sensor unit told", unbounded="magnitude_min",
    ),
    "steps": _columns("effects", "step misfit ln_bayes p_family p_fit dof", blank="added left_again"),
    "steps_errors": _columns("effects group", "step rms expected p"),
    "steps_rejected": _columns("beside effect title why", "ln_bayes left_out"),
    "proposals": _columns(
        "name kind at title", "rank magnitude lower upper freq evidence ln_bayes score choices", flags="close",
        blank="unit implausible alike",
    ),
    "proposal_places": _columns("kind at", "rank evidence x y z", flags="fitted close"),
    "next_measurement": _columns(
        "measurement kind", f"{_GAINS} chance", unbounded=_GAINS, blank="effect", flags="told", if_there="told"
    ),
    "test_order": _columns(
        "kind what how narrows", "step freq_low freq_high resolution repeats gain width_now width_then",
        blank="excite sensors effect unit",
    ),
    # verification
    "errors": _ERRORS,
    "added_errors": _ERRORS,
    "data_errors": _columns("group", "rows rms expected p"),
    "unexplained_errors": _columns("group", "rows rms expected expected_unexplained p p_unexplained"),
    "unexplained_predictions": _columns(
        "group kind", _INTERVALS, flags="inside inside_unexplained", unbounded=_INTERVALS
    ),
    "modes": _EVERY_MODE,
    "added_modes": _EVERY_MODE,
    "added_parameters": _columns(
        "parameter", "nominal before before_std after after_std", flags="added before_identified after_identified",
        blank="unit",
    ),
    "responses": _columns(
        "response", "measured before after error_before error_after", flags="held_out", unique="response"
    ),
    "versions": _columns("group", "version rms expected", complete="version", blank="study effects"),
    # provenance
    "assumptions": _columns("item", blank="value unit reason"),
}  # fmt: skip
"""Of a table whose columns depend on what was measured, those of each kind."""
