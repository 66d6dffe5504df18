"""What the page tells of the analyses: those that were run, with versions and seeds, and those that were not."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.report.html.study_results import StudyResults


def runs(results: StudyResults) -> pd.DataFrame:
    """Extent, time, seeds and versions of every analysis."""
    from_python = results.record.get("notebook")
    return pd.DataFrame(
        [
            {
                "analysis": analysis if from_python else f"calib {analysis}",
                "extent": ("quick run" if run.get("quick") else "full run") + ", stale" * (analysis in results.stale),
                "when": str(run.get("when", "")).replace("T", " ").replace("+00:00", " UTC"),
                "seeds": _listed(run.get("seeds", {})) or "none needed",
                "versions": _listed(run.get("versions", {})),
            }
            for analysis, run in results.analyses.items()
        ]
    )


def _listed(named: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in named.items())


def not_run(results: StudyResults) -> dict[str, str]:
    """What an analysis without results in this folder would tell, with its name."""
    if results.record.get("notebook"):  # there is no study folder for the command
        return {}
    lacking = {
        "Model against measurement, mode by mode": ("compare", not results.has("comparison_before")),
        "Which parameters matter": ("sensitivity", not results.has("selection")),
        "Identified parameters and errors after a calibration": ("calibrate", not results.has("parameters")),
        "Which effects the model lacks": (
            "explain", not results.explanation and bool(results.record.get("effects_known"))
        ),
        "The model with the named effects added": (
            "run",
            not results.added and results.explanation.get("verdict") in ("effect", "two_effects", "several_effects"),
        ),
    }  # fmt: skip
    return {what: name for what, (name, lacks) in lacking.items() if lacks and name not in results.stale}
