"""What the models of several tests lack, asked of all tests together."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from calib.effect import Effect
from calib.errors import InputError
from calib.joint import of_test
from calib.loading import with_effects
from calib.missing.explain import require_modes
from calib.questions.explain import Progress, Side, answered, decided, keep, side_of
from calib.questions.explained_fit import TABLE, explained_fits
from calib.questions.explanation import Explanation
from calib.questions.joint_record import write_joint_record
from calib.questions.joint_side import TEST, JointSide
from calib.questions.library import local_changes
from calib.questions.record import check_repeats, write_record
from calib.results import Results
from calib.several import JointStudy
from calib.structure.atoms import Atom
from calib.structure.model import StructuralModel
from calib.study import Study


def explain_jointly(
    study: JointStudy,
    folders: Mapping[str, Results],
    results: Results,
    progress: Progress = lambda words: None,
) -> Explanation:
    """As `calib.questions.explain.explain`, of all tests: an effect acts in every test whose library has it.

    ``folders`` are those of the tests, by name: they keep the reduced bases, and what each test says of the answer.
    """
    for one in study.studies:
        for effect in one.candidates:  # one that cannot be built is told by its name, before anything is solved
            with_effects(one.model, [effect], str(study.file))
    _require_alike(study)
    if any(one.measured is not None for one in study.studies):
        require_modes(sum(len(one.targets) if one.measured is None else one.measured.n_modes for one in study.studies))
    started = time.perf_counter()
    local = _local(study)
    sides: dict[str, Side] = {
        one.test: side_of(one, folders[one.test], progress, local.get(one.test)) for one in study.studies
    }
    side = JointSide.of(sides)
    found = decided(side, study, progress)
    answer = answered(side, found, progress, started)
    repeats = [of_test(one.test, note) for one in study.studies for note in check_repeats(one)]
    tables = answer.tables | {TABLE: explained_fits(study, found)}
    answer = replace(answer, notes=(*repeats, *answer.notes), tables=tables)
    of_all = {name: table for name, table in answer.tables.items() if TEST not in table}
    keep(study, results, replace(answer, tables=of_all))
    seeds = {"probabilities": study.settings.explain.seed, "reduction": study.settings.reduction.seed}
    write_joint_record(study, results, "explain", seeds)
    for one in study.studies:
        seen = replace(answer, errors=_errors(side, one.test, answer), tables=of_all | _own(answer, one.test))
        keep(one, folders[one.test], seen)
        write_record(one, folders[one.test], "explain", seeds)
    return answer


def _own(answer: Explanation, test: str) -> dict[str, pd.DataFrame]:
    """Tables of one test out of those that have the rows of all."""
    mixed = {name: table for name, table in answer.tables.items() if TEST in table}
    own = {name: table[table[TEST] == test].drop(columns=TEST) for name, table in mixed.items()}
    return {name: table for name, table in own.items() if len(table)}


def _errors(side: JointSide, test: str, answer: Explanation) -> pd.DataFrame:
    """Errors of one test, in the stages of the joint ones."""
    found = answer.findings
    last = next((stage for stage in answer.errors["stage"] if stage != "before"), "")
    stages = {"before": found.base} | ({last: found.chosen} if last and found.chosen is not None else {})
    own = {stage: side.hypotheses.of(test, trial) for stage, trial in stages.items()}
    table = side.sides[test].errors(own, found.noise_scale)[0]
    return table[list(answer.errors.columns.drop("scatter"))].assign(scatter=answer.errors["scatter"].iloc[0])


def _local(study: JointStudy) -> dict[str, tuple[Atom, ...]]:
    """Local changes by test: those of one model are the same in all tests of it."""
    groups: dict[str, list[Study]] = {}
    for one in study.studies:
        if isinstance(one.model, StructuralModel):
            groups.setdefault(repr((one.settings.model, one.settings.model_options)), []).append(one)
    out: dict[str, tuple[Atom, ...]] = {}
    for group in groups.values():
        model, used = group[0].model, [one.measured for one in group if one.measured is not None]
        assert isinstance(model, StructuralModel)
        of = group[0].test if len(groups) > 1 else ""
        found = local_changes(model, used, group[0].search_space.values, of)
        out |= {one.test: found for one in group}
    return out


def _require_alike(study: JointStudy) -> None:
    """InputError where two libraries mean different things by one name."""
    known: dict[str, Effect] = {}
    for effect in (e for one in study.studies for e in one.candidates):
        other = known.setdefault(effect.name, effect)
        if other.parameters != effect.parameters:
            raise InputError(
                f"the libraries of two tests have different effects {effect.name!r}", place=study.file,
                remedy="give one of them another name, or both the same strength",
            )  # fmt: skip
