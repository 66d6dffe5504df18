"""Which kind of test a study measures, chosen once for the model that is compared with it."""

from __future__ import annotations

from calib.errors.errors import InputError
from calib.experiment.frfs import TestedFRFs
from calib.experiment.modes import TestedModes
from calib.experiment.responses import TestedResponses
from calib.experiment.tested import Tested
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import MeasuredResponses
from calib.structure.function_model import FunctionModel
from calib.structure.model import StructuralModel
from calib.study.loading import Model
from calib.study.study_file import StudyFile

_OF_DATA: dict[type, type[Tested]] = {
    MeasuredModes: TestedModes,
    MeasuredResponses: TestedResponses,
    MeasuredFRFs: TestedFRFs,
}


def tested_for(study: StudyFile, model: Model) -> Tested:
    """Everything that was measured, of a kind that the model has: scalar responses, modes or FRFs.

    Raises
    ------
    InputError
        For a measurement that cannot be read, and one that the model has nothing to compare with.
    """
    given = study.settings.measurement
    if isinstance(model, FunctionModel) and not given.responses:
        raise InputError(
            f"the model {model.name!r} is compared with measured scalar responses (responses = '...')",
            place=study.place("measurement"),
        )
    if given.kind == "frf" and not given.responses and not isinstance(model, StructuralModel):
        raise InputError(
            f"the model {model.name!r} has no matrices, so it has no FRFs", place=study.place("measurement", "kind"),
            remedy="return a StructuralModel; matrices of other codes make one too",
        )  # fmt: skip
    if given.responses and study.settings.explain.finer_options:
        raise InputError(
            "finer_options tell the error of the mesh in modes and FRFs, and the study measures scalar responses",
            place=study.place("explain", "finer_options"), remedy="take finer_options out",
        )  # fmt: skip
    measured = study.measurement()
    return _OF_DATA[type(measured)](study, measured)
