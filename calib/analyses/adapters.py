"""Adapters of the tests of a study to the explanation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from calib.analyses.adapter import Adapter
from calib.analyses.explanation_result import MeasurementFacts
from calib.analyses.function_hypotheses import function_hypotheses
from calib.analyses.group_adapter import FRFAdapter, ScalarAdapter
from calib.analyses.library import basis_of, faults_of, local_perturbations, modal_hypotheses
from calib.analyses.modal_adapter import ModalAdapter
from calib.analyses.reduction import worthwhile
from calib.correlation.frf_problem import FRFProblem
from calib.correlation.frf_residual import FRFResidual
from calib.correlation.function_problem import FunctionProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.function import FunctionModel
from calib.results import Results
from calib.several import AnyStudy
from calib.stage import Progress
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.structure.perturbations import Perturbation
from calib.study import Study


def adapter_of(
    study: Study,
    home: Results,
    progress: Progress,
    local: tuple[Perturbation, ...] | None,
    held_sd: Mapping[str, float] | None = None,
) -> Adapter:
    """The adapter of a study's test.

    ``local`` are the perturbations of its model, None for a function; ``held_sd`` are the standard deviations of the
    held parameters of all tests, by default of this one.
    """
    problem, space = study.problem, study.search_space.without(study.condition)
    facts = MeasurementFacts.of(study)
    facts = facts if held_sd is None else replace(facts, held_sd=held_sd)
    if isinstance(problem, FunctionProblem):
        assert isinstance(study.model, FunctionModel)
        pair = ResponseResidual(problem)
        scalar, own = function_hypotheses(study.model, pair, study.candidates, space, study.test)
        return ScalarAdapter(scalar, own, facts, study.unseen)
    if isinstance(problem, FRFProblem):
        assert local is not None
        basis = basis_of(study, home, local, progress)
        return FRFAdapter.of(
            FRFResidual(problem).suspected(study.test),
            study.candidates,
            local,
            space,
            facts,
            study.unseen,
            basis,
            worthwhile(study),
            study.finer_model,
        )
    if isinstance(problem.model, ModalFunctionModel):  # which may be behind a ledger
        modal_pair = ModalResidual(problem, faults=faults_of(study))
        modal, own = function_hypotheses(problem.model, modal_pair, study.candidates, space, study.test)
    else:
        modal, own = modal_hypotheses(study, home, progress, local)
    return ModalAdapter(modal, own, facts, study.whole_problem(), study.finer_model, reduced=worthwhile(study))


def perturbations_of(study: AnyStudy) -> dict[str, tuple[Perturbation, ...]]:
    """Local perturbations by test: those of one model are the same in all tests of it."""
    groups: dict[str, list[Study]] = {}
    for one in study.studies:
        if isinstance(one.model, StructuralModel):
            groups.setdefault(repr((one.settings.model, one.settings.model_options)), []).append(one)
    out: dict[str, tuple[Perturbation, ...]] = {}
    for group in groups.values():
        model, used = group[0].model, [o.problem.measured for o in group if not isinstance(o.problem, FunctionProblem)]
        assert isinstance(model, StructuralModel)
        of = group[0].test if len(groups) > 1 else ""
        found = local_perturbations(model, used, group[0].search_space.values, of)
        out |= {one.test: found for one in group}
    return out
