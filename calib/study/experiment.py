"""The test of a study: what its file says of the measurement, as a test of `calib.experiment`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from calib.correlation.frf.nuisance import Nuisance, belonging_to, channel_nuisances
from calib.correlation.frf.places import place_nuisances
from calib.correlation.frf.resonances import of_every_resonance
from calib.errors.errors import InputError
from calib.experiment import FRFTest, ModalTest, ResponseTest
from calib.experiment.test import UNNAMED, ForwardProblem, Test, TestError
from calib.measurement.files.csv_format import place_of_node
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import MeasuredResponses
from calib.structure.function_model import FunctionModel
from calib.structure.model import StructuralModel
from calib.study.loading import Model
from calib.study.study_file import StudyFile


def experiment_of(study: StudyFile, model: Model) -> Test:
    """Everything that was measured, of a kind that the model has: scalar responses, modes or FRFs.

    Raises
    ------
    InputError
        For a measurement that cannot be read, one that the model has nothing to compare with, and data held out that
        were not measured.
    """
    settings = study.settings.measurement
    if isinstance(model, FunctionModel) and not settings.responses:
        raise InputError(
            f"the model {model.name!r} is compared with measured scalar responses (responses = '...')",
            place=study.place("measurement"),
        )
    if settings.kind == "frf" and not settings.responses and not isinstance(model, StructuralModel):
        raise InputError(
            f"the model {model.name!r} has no matrices, so it has no FRFs", place=study.place("measurement", "kind"),
            remedy="return a StructuralModel; matrices of other codes make one too",
        )  # fmt: skip
    data = study.measured_data()
    _require_own(study, _KINDS[type(data)][0])
    with with_place(study, model):
        return _KINDS[type(data)][1](study, data, model)


def _modal(study: StudyFile, modes: MeasuredModes, model: Any) -> ModalTest:
    settings = study.settings
    pairing, held = settings.pairing, settings.held_out
    return ModalTest(
        modes,
        held_out=(*held.modes, *held.sensors),
        name=study.test or UNNAMED,
        condition=study.condition,
        clusters=pairing.clusters,
        mode_count=pairing.mode_count,
        freq_window=pairing.freq_window,
        threshold=pairing.threshold,
        override=pairing.override,
        set_ups=settings.measurement.set_ups,
        node_limit=settings.measurement.node_limit,
    )


def _frf(study: StudyFile, frfs: MeasuredFRFs, model: StructuralModel) -> FRFTest:
    held = study.settings.held_out
    test = FRFTest(
        frfs, held.sensors, held.references, held.bands, name=study.test or UNNAMED, condition=study.condition,
        node_limit=study.settings.measurement.node_limit,
    )  # fmt: skip
    return replace(test, nuisances=nuisances_of(study, test, model))


def nuisances_of(study: StudyFile, test: FRFTest, model: StructuralModel) -> tuple[Nuisance, ...]:
    """Those that the study names, of all channels and transducers of the test, held-out ones included."""
    settings = study.settings.measurement.nuisances
    found: tuple[Nuisance, ...] = channel_nuisances(test.frfs, **settings.model_dump(exclude={"place", "resonance"}))
    if settings.resonance is not None:
        found += of_every_resonance(test.used, settings.resonance)  # what is held out enters no fit
    if settings.place is not None:
        found += place_nuisances(test.frfs, settings.place, model)
    return belonging_to(study.test, found)


def _responses(study: StudyFile, responses: MeasuredResponses, model: Any) -> ResponseTest:
    settings = study.settings.measurement
    return ResponseTest(
        responses, study.settings.held_out.responses, study.test or UNNAMED, study.condition, settings.accuracy,
        settings.repeats,
    )  # fmt: skip


_KINDS: dict[type, tuple[type[Test], Callable[..., Test]]] = {
    MeasuredModes: (ModalTest, _modal),
    MeasuredFRFs: (FRFTest, _frf),
    MeasuredResponses: (ResponseTest, _responses),
}


def _require_own(study: StudyFile, kind: type[Test]) -> None:
    """InputError where something is held out that this kind of measurement does not have."""
    for key, names in study.settings.held_out.model_dump().items():
        if names and key not in kind.can_hold_out:
            raise InputError(
                f"{key} are held out, but the study measures {kind.words}",
                place=study.place("held_out", key),
                remedy=f"name {' or '.join(kind.can_hold_out)} under [held_out]",
            )


def problem_of(study: StudyFile, test: Test, model: Model, base: Any) -> ForwardProblem:
    """The forward problem of a study's model, whose errors name the place in its file."""
    with with_place(study, model):
        found: ForwardProblem = test.problem(model, base)
        return found


@contextmanager
def with_place(study: StudyFile, model: Any) -> Iterator[None]:
    """Give errors of a test, and mismatches of it and a model, their place in the study or its table of sensors."""
    try:
        yield
    except TestError as fault:
        place = study.place(*_in_file(study, fault.keys), mark=fault.mark)
        raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
    except InputError as fault:
        raise _mismatch(study, model, fault) from None


def _in_file(study: StudyFile, keys: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Keys as the file has them: modes and sensors are held out under two of them."""
    if keys[:1] != ("held_out",) or len(keys) != 2 or not isinstance(keys[1], int):
        return keys
    held = study.settings.held_out
    every = [(key, k) for key in ("modes", "sensors") for k in range(len(getattr(held, key)))]
    return ("held_out", *every[keys[1]])


def _mismatch(study: StudyFile, model: Any, fault: InputError) -> InputError:
    """A mismatch of model and measurement, with its place in the study or in its table of sensors."""
    settings = study.settings.measurement
    if settings.responses:
        place = study.place("measurement", "responses")
        return InputError(fault.problem, place=place, remedy=fault.remedy, at=fault.at)
    if fault.place and fault.place.startswith("sensor"):
        table, node = settings.sensors, re.match(r"sensor (\d+)", fault.place)
        at = place_of_node(study.folder / table, int(node[1])) if table and node else None
        where = f"{study.file}, {fault.place}"
        return InputError(fault.problem, place=where, remedy=fault.remedy, at=at, table=fault.table)
    clusters = study.settings.pairing.clusters.items()
    unknown = [(mode, k) for mode, named in clusters for k, name in enumerate(named) if name not in model.clusters]
    place = study.place("pairing", "clusters", *unknown[0]) if unknown else study.place("pairing")
    return InputError(fault.problem, place=place, remedy=fault.remedy)
