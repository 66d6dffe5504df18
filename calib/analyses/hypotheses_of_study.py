"""Adapters of the tests of a study to the explanation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from calib.analyses.explanation_result import facts_of
from calib.analyses.reduction import worthwhile
from calib.execution.stage import Progress
from calib.experiment.frfs import TestedFRFs
from calib.experiment.modes import TestedModes
from calib.experiment.responses import TestedResponses
from calib.hypotheses.library import basis_of, local_perturbations, modal_hypotheses
from calib.hypotheses.modal import ModalAdapter
from calib.hypotheses.model_hypotheses import hypotheses
from calib.hypotheses.scalar import FRFAdapter, ScalarAdapter
from calib.missing.facts import MeasurementFacts
from calib.missing.test import Adapter
from calib.results.results import Results
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import StructuralModel
from calib.study.several import AnyStudy
from calib.study.study import Study

Local = tuple[Perturbation, ...]


def adapter_of(
    study: Study, home: Results, progress: Progress, local: Local, held_sd: Mapping[str, float] | None = None
) -> Adapter:
    """The adapter of a study's test.

    ``local`` are the perturbations that the tests of its model share; ``held_sd`` are the standard deviations of the
    held parameters of all tests, by default of this one.
    """
    facts = facts_of(study)
    facts = facts if held_sd is None else replace(facts, held_sd=held_sd)
    return _OF_TEST[type(study.tested)](study, home, progress, local, facts)


def _of_responses(
    study: Study, home: Results, progress: Progress, local: Local, facts: MeasurementFacts
) -> ScalarAdapter:
    pair: Any = study.pair
    space = study.search_space.without(study.condition)
    found, own = hypotheses(study.asked, pair, study.candidates, local, space, study.test)
    return ScalarAdapter(found, own, facts, study.unseen)


def _of_frfs(study: Study, home: Results, progress: Progress, local: Local, facts: MeasurementFacts) -> FRFAdapter:
    pair: Any = study.pair
    basis, space = basis_of(study, home, local, progress), study.search_space.without(study.condition)
    return FRFAdapter.of(
        pair.suspected(study.test), study.candidates, local, space, facts, study.unseen, basis, worthwhile(study),
        study.finer_model,
    )  # fmt: skip


def _of_modes(study: Study, home: Results, progress: Progress, local: Local, facts: MeasurementFacts) -> ModalAdapter:
    found, own = modal_hypotheses(study, home, progress, local)
    return ModalAdapter(found, own, facts, study.whole_problem(), study.finer_model, reduced=worthwhile(study))


_OF_TEST: Mapping[type, Callable[..., Adapter]] = {
    TestedResponses: _of_responses,
    TestedFRFs: _of_frfs,
    TestedModes: _of_modes,
}


def perturbations_of(study: AnyStudy) -> dict[str, Local]:
    """Local perturbations by test: those of one model of matrices are the same in all tests of it.

    A function shares none.
    """
    groups: dict[str, list[Study]] = {}
    for one in study.studies:
        if isinstance(one.model, StructuralModel):
            groups.setdefault(repr((one.settings.model, one.settings.model_options)), []).append(one)
    out: dict[str, Local] = {one.test: () for one in study.studies}
    for group in groups.values():
        first, used = group[0], [data for one in group for data in one.tested.sensed]
        of = first.test if len(groups) > 1 else ""
        found = local_perturbations(first.model, used, first.search_space.values, of)
        out |= {one.test: found for one in group}
    return out
