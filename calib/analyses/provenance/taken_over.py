"""Values found by an earlier study, read without running the code of either study."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from calib.analyses.provenance.places import QUICK
from calib.errors.errors import InputError
from calib.results.json_file import read_json
from calib.results.results import Results
from calib.results.table import read_table
from calib.study.study_file import StudyFile, study_file


def found_earlier(study: StudyFile, results: Results) -> list[dict[str, float]]:
    """Results of the study named under ``[adopted]``: of its full run, and of its quick run.

    Parameters
    ----------
    study : StudyFile
        The study that adopts values.
    results : Results
        Its folder, or one below; that of the earlier study is beside it.

    Returns
    -------
    list of dict from parameter name to value
        The adopted parameters that the earlier study fits; empty where it has no readable results, or nothing is
        adopted.
    """
    adopted = study.settings.adopted
    home = next((path for path in (results.path, *results.path.parents) if path.name == study.name), None)
    if adopted is None or home is None:
        return []
    name = study_file(study.file.resolve().parent / adopted.study).resolve().parent.name
    out = []
    for folder in (home.parent / name, home.parent / name / QUICK):
        with suppress(InputError):
            values = _best_case(folder)
            out.append({parameter: values[parameter] for parameter in adopted.parameters if parameter in values})
    return out


def _best_case(folder: Path) -> dict[str, float]:
    best = read_json(folder / "summary.json", {"best_case": str}, ["best_case"])["best_case"]
    table = read_table(folder / "parameters.csv", ["case", "parameter"], ["value"], complete=["value"])
    found = table[table["case"] == best]
    return dict(zip(found["parameter"], found["value"], strict=True))
