"""Rules of every analysis: the frozen constants that its record holds and that its state depends on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calib.correlation import fault_rules as faults
from calib.correlation import rules as comparison
from calib.correlation import standard_deviations
from calib.hypotheses import rules as analyses
from calib.inference import rules as inference
from calib.measurement import rules as reading
from calib.missing import rules as missing
from calib.problem import degrees_of_freedom, parameter
from calib.sensitivity import rules as sensitivity
from calib.structure import rules as models

_COMPARED = ("reading", "degrees_of_freedom", "floors", "comparison")
# A calibration tests its fit, single data and held-out data as an explanation does.
_FITTED = (*_COMPARED, "faults", "models", "limits", "inference", "missing", "analyses")
_USED: Mapping[str, tuple[str, ...]] = {
    "compare": (*_COMPARED, "analyses"),
    "sensitivity": (*_COMPARED, "sensitivity"),
    "calibrate": _FITTED,
    "explain": _FITTED,
    "propose": _FITTED,
    "extend": _FITTED,
}


def every_rule() -> dict[str, Any]:
    """All objects of rules in force, frozen dataclasses, by the name that `record.json` has for them."""
    return {
        "reading": reading.RULES,
        "degrees_of_freedom": degrees_of_freedom.RULES,
        "floors": standard_deviations.USUAL,
        "comparison": comparison.RULES,
        "faults": faults.RULES,
        "models": models.RULES,
        "sensitivity": sensitivity.RULES,
        "limits": parameter.RULES,
        "inference": inference.RULES,
        "analyses": analyses.RULES,
        "missing": missing.RULES,
    }


def rules_of(analysis: str) -> dict[str, Any]:
    """Rules that an analysis depends on, by name.

    Parameters
    ----------
    analysis : str
        One of `calib.analyses.provenance.state.WRITES`.
    """
    every = every_rule()
    return {name: every[name] for name in _USED[analysis.partition(" ")[0]]}
