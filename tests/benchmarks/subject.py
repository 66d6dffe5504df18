"""The studies that are timed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.structure.affine import AffineMatrix
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel
from calib.study.study import LoadedStudy
from calib.study.study_file import study_file
from calib.study.study_text import read_settings

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ("bogie", "vehicle")


def study_of(name: str) -> LoadedStudy:
    """A study by its folder's name; values it adopts from an earlier phase are those behind that one's measurements."""
    folder = ROOT / "studies" / name
    adopted = read_settings(study_file(folder)).adopted
    if adopted is None:
        return LoadedStudy.load(folder)
    truth = json.loads((ROOT / f"tests/truth/{Path(adopted.study).name}.json").read_text("utf-8"))["parameters"]
    return LoadedStudy.load(folder, {key: truth[key] for key in adopted.parameters})


def undamped(model: Any) -> Any:
    """The same model, full or reduced, without its damping."""
    if isinstance(model, ReducedModel):
        full = undamped(model.model)
        return ReducedModel(full, replace(model.basis, model_fingerprint=full.fingerprint))
    assert isinstance(model, StructuralModel)
    return replace(model, damping=AffineMatrix(model.n_dof, ()))
