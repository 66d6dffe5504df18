"""Former names of keys, tables and columns: they are refused with an error that gives the present name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

KEYS: Mapping[str, str] = {"withheld": "held_out", "polish": "refine", "draws": "samples"}
"""Keys of ``study.toml``, by their last part."""

MOVED: Mapping[str, str] = {
    "fixed_sd": "parameters that are not selected are uncertain by their prior_sd: state it for each, under "
    "[parameters.NAME] of a study or as an argument of calib.Parameter, or fix one that is exact (fixed = true)"
}
"""Keys of ``study.toml`` in whose place there are others, and what to write."""

TABLES: Mapping[str, str] = {
    "atoms.csv": "perturbations.csv",
    "influence.csv": "variance_share.csv",
    "strain.csv": "pulls.csv",
    "tried.csv": "candidate_fits.csv",
}
"""Files of a results folder."""

COLUMNS: Mapping[str, str] = {
    "adopted": "nominal",
    "atom": "perturbation",
    "fits_within_scatter": "fits_within_std",
    "freedom": "dof",
    "gamma": "unabsorbed",
    "heldout_gain": "held_out_gain",
    "in_scatter": "in_std",
    "influence_floor": "variance_share_floor",
    "influence_response": "variance_share_response",
    "max_influence": "max_variance_share",
    "on_bound": "on_limit",
    "option": "measurement",
    "phi": "magnitude",
    "phi_high": "magnitude_high",
    "phi_low": "magnitude_low",
    "phi_min": "magnitude_min",
    "posterior": "model_probability",
    "scatter": "std_from",
    "search_on_bound": "search_on_limit",
    "strained": "pulled",
    "withheld": "held_out",
}
"""Columns of these tables."""

RECORD: Mapping[str, str] = {"questions": "analyses"}
"""Keys of ``record.json``."""


def old_column(missing: str, header: Iterable[str]) -> str | None:
    """The former name of a missing column, if the header has it."""
    return next((name for name in header if COLUMNS.get(name) == missing), None)
