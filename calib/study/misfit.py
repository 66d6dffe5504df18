"""A mismatch of model and measurement, with its place in the study or in its table of sensors."""

from __future__ import annotations

import re

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import place_of_node
from calib.structure.modal_model import ModalModel
from calib.study.study_file import StudyFile


def misfit(study: StudyFile, model: ModalModel, fault: InputError) -> InputError:
    """A mismatch of model and measurement, with its place in the study or in its table of sensors."""
    if fault.place and fault.place.startswith("sensor"):
        table, node = study.settings.measurement.sensors, re.match(r"sensor (\d+)", fault.place)
        at = place_of_node(study.folder / table, int(node[1])) if table and node else None
        return InputError(fault.problem, place=f"{study.file}, {fault.place}", remedy=fault.remedy, at=at)
    clusters = study.settings.pairing.clusters.items()
    unknown = [(mode, k) for mode, named in clusters for k, name in enumerate(named) if name not in model.clusters]
    place = study.place("pairing", "clusters", *unknown[0]) if unknown else study.place("pairing")
    return InputError(fault.problem, place=place, remedy=fault.remedy)
