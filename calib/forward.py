"""The forward problem of a study's fits: the model against the measured data that are not held out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from calib.correlation.frf_nuisance import Nuisance, belonging_to, concerned, of_every_channel
from calib.correlation.frf_places import of_every_place
from calib.correlation.frf_problem import FRFProblem
from calib.correlation.frf_residual import FRFResidual
from calib.correlation.function_problem import FunctionProblem
from calib.correlation.problem import ModalProblem, usual_mode_count
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.errors import InputError
from calib.function import FunctionModel
from calib.loading import Model
from calib.measurement.csv_format import place_of_node
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import HeldOutFRFs
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import MeasuredResponses
from calib.problem import Pair
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.modal_model import ModalModel
from calib.structure.model import StructuralModel
from calib.study_file import Measured, StudyFile

ForwardProblem = ModalProblem | FunctionProblem | FRFProblem
Targets = Mapping[str, tuple[float, float | None]]


class UnseenPair(Pair, Protocol):
    """A pair whose rows compare one measured value each."""

    @property
    def measured_values(self) -> np.ndarray:
        """What was measured in every row, (n_rows,)."""
        ...

    @property
    def std(self) -> np.ndarray:
        """Its standard deviation, (n_rows,)."""
        ...


class UnseenData(Protocol):
    """Held-out data that are compared entry by entry: scalar responses or FRFs."""

    def pair(self, problem: Any) -> UnseenPair:
        """Their whitened residual for the model of the fitted problem."""

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Prior standard deviations of parameters of the data themselves that have no fitted value."""


@dataclass(frozen=True, eq=False)
class UnseenResponses:
    """Held-out scalar responses.

    Attributes
    ----------
    targets : mapping from response name to (value, standard deviation or None)
    """

    targets: Targets

    def pair(self, problem: FunctionProblem) -> ResponseResidual:
        """See `UnseenData`."""
        return ResponseResidual(replace(problem, targets=self.targets))

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Empty: they have no parameters of their own."""
        return {}


@dataclass(frozen=True, eq=False)
class UnseenFRFs:
    """Held-out FRFs.

    Attributes
    ----------
    measured : MeasuredFRFs
    nuisances : tuple of Nuisance
        All that concern them, those that no fit determines included.
    """

    measured: MeasuredFRFs
    nuisances: tuple[Nuisance, ...]

    def pair(self, problem: FRFProblem) -> FRFResidual:
        """See `UnseenData`."""
        return FRFResidual(replace(problem, measured=self.measured, nuisances=self.nuisances))

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Such as the gain of a held-out channel; see `UnseenData`."""
        own = (nuisance.parameter for nuisance in self.nuisances)
        return {p.name: p.prior_width for p in own if p.name not in values}


Unseen = Mapping[str, UnseenData]
"""Held-out scalar responses or FRFs, by group; only groups that hold something."""
HELD_OUT_RESPONSES = "held_out_responses"
"""Group of held-out responses, as tables name it."""


def pair_of(problem: ForwardProblem) -> ModalResidual | ResponseResidual | FRFResidual:
    """The whitened residual of a problem."""
    if isinstance(problem, FRFProblem):
        return FRFResidual(problem)
    return ResponseResidual(problem) if isinstance(problem, FunctionProblem) else ModalResidual(problem)


def measured_for(study: StudyFile, model: Model) -> Measured:
    """Everything that was measured, of a kind that the model returns: scalar responses, modes or FRFs."""
    given = study.settings.measurement
    if isinstance(model, FunctionModel) != bool(given.responses):
        words = "scalar responses (responses = '...')" if isinstance(model, FunctionModel) else "modes (files = [...])"
        raise InputError(
            f"the model {model.name!r} is compared with measured {words}", place=study.place("measurement")
        )
    if given.kind == "frf" and not isinstance(model, StructuralModel):
        raise InputError(
            f"the model {model.name!r} has no matrices, so it has no FRFs", place=study.place("measurement", "kind"),
            remedy="return a StructuralModel; matrices of other codes make one too",
        )  # fmt: skip
    return study.measurement()


_OF_KIND: Mapping[type, tuple[str, tuple[str, ...]]] = {
    MeasuredModes: ("modes", ("modes", "sensors")),
    MeasuredResponses: ("scalar responses", ("responses",)),
    MeasuredFRFs: ("FRFs", ("sensors", "references", "bands")),
}
"""Each kind of measurement in words, and what of it can be held out."""


def require_own(study: StudyFile, given: Measured) -> None:
    """InputError where something is held out that this kind of measurement does not have."""
    kind, own = _OF_KIND[type(given)]
    for key, names in study.settings.held_out.model_dump().items():
        if names and key not in own:
            raise InputError(
                f"{key} are held out, but the study measures {kind}",
                place=study.place("held_out", key),
                remedy=f"name {' or '.join(own)} under [held_out]",
            )


def unseen_responses(whole: Targets, names: Sequence[str]) -> dict[str, UnseenResponses]:
    """The named scalar responses as a group of held-out data; empty for none."""
    return {HELD_OUT_RESPONSES: UnseenResponses({name: whole[name] for name in names})} if names else {}


def used_targets(study: StudyFile, whole: Targets) -> Targets:
    """The scalar responses that are not held out."""
    names = study.settings.held_out.responses
    for k, name in enumerate(names):
        if name not in whole:
            place = study.place("held_out", "responses", k)
            remedy = f"the measured responses are {', '.join(whole)}"
            raise InputError(f"held-out response {name!r} was not measured", place=place, remedy=remedy)
    targets = {name: target for name, target in whole.items() if name not in names}
    if not targets:
        raise InputError(
            "every measured response is held out",
            place=study.place("held_out", "responses"),
            remedy="leave some to fit",
        )
    return targets


def unseen_frfs(groups: Mapping[str, MeasuredFRFs], nuisances: Sequence[Nuisance]) -> dict[str, UnseenFRFs]:
    """Held-out FRFs by group with the nuisances of their test that concern them."""
    return {group: UnseenFRFs(own, concerned(nuisances, own)) for group, own in groups.items()}


def held_out_frfs(study: StudyFile) -> HeldOutFRFs:
    """What a study of FRFs holds out."""
    given = study.settings.held_out
    return HeldOutFRFs(given.sensors, given.references, given.bands)


def used_frfs(study: StudyFile, whole: MeasuredFRFs) -> MeasuredFRFs:
    """The FRFs that are not held out."""
    held = held_out_frfs(study)
    unknown = held.unknown(whole)
    if unknown is not None:
        keys, fault = unknown
        raise InputError(fault.problem, place=study.place("held_out", *keys), remedy=fault.remedy)
    return held.split(whole)[0]


def nuisances_of(study: StudyFile, model: StructuralModel, whole: MeasuredFRFs) -> tuple[Nuisance, ...]:
    """The nuisances that a study names, of all channels and transducers of the test, held-out ones included."""
    given = study.settings.measurement.nuisances
    found: tuple[Nuisance, ...] = of_every_channel(whole, **given.model_dump(exclude={"place"}))
    if given.place is not None:
        found += of_every_place(whole, given.place, model)
    return belonging_to(study.test, found)


def used_modes(study: StudyFile, whole: MeasuredModes) -> MeasuredModes:
    """The modes that are not held out, at sensors that are not."""
    held = study.settings.held_out
    try:
        used = whole.without(held.modes, held.sensors)
    except InputError as fault:
        sensors = [sensor.name for sensor in whole.sensors]
        unknown = [("modes", k) for k, name in enumerate(held.modes) if name not in whole.names]
        unknown += [("sensors", k) for k, name in enumerate(held.sensors) if name not in sensors]
        place = study.place("held_out", *(unknown[0] if unknown else ()))
        raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
    if not used.n_modes:
        place = study.place("held_out", "modes")
        raise InputError("every measured mode is held out", place=place, remedy="leave some to fit")
    if whole.has_shapes and not used.has_shapes:
        raise InputError(
            "every sensor is held out",
            place=study.place("held_out", "sensors"),
            remedy="leave some by which modes are paired",
        )
    return used


def frf_problem(study: StudyFile, model: StructuralModel, whole: MeasuredFRFs) -> FRFProblem:
    """The problem over the FRFs in use; transducers load the structure at held-out sensors too."""
    used = used_frfs(study, whole)
    try:
        return FRFProblem(model, used, concerned(nuisances_of(study, model, whole), used))
    except InputError as fault:
        raise misfit(study, model, fault) from None


def function_problem(
    study: StudyFile, model: FunctionModel, fingerprint: str, targets: Targets, measured: MeasuredResponses
) -> FunctionProblem:
    """The problem over the scalar responses in use; ``repeats`` is the number equivalent to the pooled ones."""
    pooled = measured.pooled_repeats
    repeats = study.settings.measurement.repeats if pooled is None else pooled
    return FunctionProblem(model.space, model.function, targets, fingerprint, repeats, measured.shares)


def modal_problem(
    study: StudyFile, model: StructuralModel | ModalFunctionModel, measured: MeasuredModes, n_added: int
) -> ModalProblem:
    """The problem over the modes in use; as many more modes are solved as effects add degrees of freedom."""
    pairing = study.settings.pairing
    default = usual_mode_count(measured, model.n_modes - n_added)
    count = pairing.mode_count if pairing.mode_count is not None else default
    if count < measured.n_modes:
        raise InputError(
            f"mode_count is {count}, but {measured.n_modes} modes were measured",
            place=study.place("pairing", "mode_count"),
            remedy="solve at least as many, better a few more",
        )
    named = {mode: key for key in ("override", "clusters") for mode in getattr(pairing, key)}
    held_out = set(study.settings.held_out.modes)
    for mode in sorted(named.keys() - set(measured.names) - held_out):
        raise InputError(
            f"mode {mode!r} was not measured",
            place=study.place("pairing", named[mode], mode, mark="key"),
            remedy=f"the measured modes are {', '.join(measured.names)}",
        )
    try:
        return ModalProblem(
            model=model,
            measured=measured,
            mode_clusters={m: c for m, c in pairing.clusters.items() if m not in held_out},
            mode_count=count + n_added,
            threshold=pairing.threshold,
            freq_window=pairing.freq_window,
            override={m: k for m, k in pairing.override.items() if m not in held_out},
        )
    except InputError as fault:
        raise misfit(study, model, fault) from None


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
