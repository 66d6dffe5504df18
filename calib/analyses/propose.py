"""Proposals of a study: effects that nobody listed, as a library in a study of its own among the results."""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
import tomlkit

from calib.analyses.explained_fit import explained_fit
from calib.analyses.extend import NAME, anywhere, draft_of, put_among, require_valid, set_aside, unwritable
from calib.analyses.hypotheses_of_study import adapter_for, require_usable
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.stale import stale_answers
from calib.errors.errors import EvaluationError, InputError
from calib.execution.stage import Progress, silent
from calib.hypotheses.proposals.code import FUNCTION, library_text
from calib.hypotheses.proposals.proposal import Proposals
from calib.hypotheses.proposals.proposal_search import Search
from calib.hypotheses.proposals.words import (
    answer_of,
    lost_words,
    no_places,
    no_proposals,
    not_sought,
    proposals_table,
    proposed_places_table,
)
from calib.missing.adapter import Adapter
from calib.missing.collinear import Group
from calib.missing.explanation import OPEN, Explanation
from calib.missing.recommendation import recommend, recommendation
from calib.missing.refits import Refits
from calib.missing.settings import Settings
from calib.results.answer import Answer
from calib.results.json_file import read_json
from calib.results.results import Results
from calib.structure.effects.compositions import Measured, compositions
from calib.study.loading import Model
from calib.study.settings import ExplainSettings
from calib.study.several import AnyStudy
from calib.study.study_file import shell_argument

PROPOSED, FILE = "_proposed", "proposed_effects.py"
"""End of the name of the study with the proposals, and the file of its library."""
RANKED = 5
"""Proposals that are told."""


@dataclass(frozen=True, eq=False)
class ProposalResult:
    """What is proposed, in words and as a table.

    Attributes
    ----------
    proposals : Proposals or None
        None where nothing was sought, since nothing unlisted seems missing.
    answer : Answer
    table : DataFrame
        ``proposals.csv``.
    places : DataFrame
        ``proposal_places.csv``.
    sentences : tuple of str
        What would tell apart what the data do not, and what could not be tried.
    seconds : float
    folder : Path or None
        Of the study whose library has the proposals; None where there are none.
    aside : Path or None
        Where a study was moved that stood in its place: one that had been changed, or any where there are none.
    """

    proposals: Proposals | None
    answer: Answer
    table: pd.DataFrame = field(default_factory=no_proposals)
    places: pd.DataFrame = field(default_factory=no_places)
    sentences: tuple[str, ...] = ()
    seconds: float = 0.0
    folder: Path | None = None
    aside: Path | None = None


@dataclass(frozen=True)
class ProposalStart:
    """What an explanation found, as far as proposals need it.

    Attributes
    ----------
    verdict : str
    named : tuple of str
        Effects or faults of the measurement that it names.
    scale : float
        Factor on the standard deviation.
    base : mapping from str to float
        Fitted values without effects; empty where they are unknown.
    attempt : mapping from str to float
        Fitted values with the best attempt.
    beside : tuple of str
        Effects of that attempt, where they have strong evidence.
    """

    verdict: str
    named: tuple[str, ...]
    scale: float
    base: Mapping[str, float]
    attempt: Mapping[str, float] = field(default_factory=dict)
    beside: tuple[str, ...] = ()

    @classmethod
    def of(cls, found: Explanation) -> ProposalStart:
        """What an explanation found, with the fits of its best attempt."""
        explained = cls(found.verdict, (), found.noise_scale, found.base.fit.values)
        if found.verdict == "partial" and found.chosen is not None:
            explained = replace(explained, attempt=found.chosen.fit.values, beside=found.chosen.names)
        return explained


def propose(
    study: AnyStudy,
    results: Results,
    count: int = RANKED,
    progress: Progress = silent,
    homes: Mapping[str, Results] = MappingProxyType({}),
) -> ProposalResult:
    """Compose effects that explain what no effect of the library explains; write them as a study and a table.

    Parameters
    ----------
    study : Study or JointStudy
        Of several tests, all of one model.
    results : Results
        With the explanation of the study.
    count : int
        Proposals that are written.
    progress : callable
    homes : mapping from str to Results
        By name of the test: they hold the reduced bases; by default ``results``.

    Raises
    ------
    InputError
        Without an explanation of the study as it is, for tests of several models, and where nothing can be written.
    """
    explained = _explained(study, results)
    tests = study.studies
    models = {one.model_key for one in tests}
    if len(models) > 1:
        raise InputError(
            "its tests have several models, of each of which other effects would be composed", place=study.file,
            remedy="propose for a study of the tests of one model",
        )  # fmt: skip
    begin_analysis(results, "propose")
    if explained.verdict not in OPEN:
        names = " ".join(explained.named)
        remedy = f"add what was named: calib extend {shell_argument(study.file)} {names} --into FOLDER"
        found = ProposalResult(None, not_sought(explained.verdict, explained.named, remedy))
        return _kept(study, results, found, count)
    require_usable(study)
    found = compose_for(study, results, explained, count, progress, homes)
    if found.proposals is not None and found.proposals.ranked and not found.proposals.measurement:
        found = _written(study, results, found)
    return _kept(study, results, found, count)


def compose_for(
    study: AnyStudy,
    results: Results | None,
    explained: ProposalStart,
    count: int = RANKED,
    progress: Progress = silent,
    homes: Mapping[str, Results] = MappingProxyType({}),
) -> ProposalResult:
    """The same without writing anything; arguments as in `propose`, a study in memory has no ``results``."""
    adapter = adapter_for(study, results, progress, homes, explained.base)
    measured = [data for one in study.studies for data in one.experiment.sensed]
    taken = [name for effect in study.library for one in effect.family for name in one.names]
    model = study.studies[0].model
    return composed(adapter, model, measured, taken, study.settings.explain, explained, count, progress)


def composed(
    adapter: Adapter,
    model: Model,
    measured: Sequence[Measured],
    taken: Sequence[str],
    given: ExplainSettings,
    explained: ProposalStart,
    count: int = RANKED,
    progress: Progress = silent,
) -> ProposalResult:
    """Compose, fit and rank; ``taken`` are names that are used otherwise. Nothing is written."""
    started = time.perf_counter()
    own = compositions(model, measured, explained.base or model.space.values, taken)
    if not own.plain:
        words = "Nothing can be proposed: the model names no parts, and has no matrices from which to compose effects."
        then = "Give it parts that its function scales: calib.structure.function_parts.ScaledPart."
        return ProposalResult(None, Answer(words, "Nothing was tested.", then))
    hypotheses = adapter.with_effects(own.effects)
    settings = Settings(given.alpha, given.refits, given.merge, given.seed, math.inf)
    fits = Refits(hypotheses, settings, explained.scale, progress)
    search = Search(fits, own.plain, own.mounts, own.hung, own.held, hypotheses.row_freqs)
    start = explained.base or hypotheses.fit_problem(()).space.values
    try:
        found = search.proposals((), start)
        if explained.beside:
            beside = search.proposals(explained.beside, explained.attempt or start)
            found = max(found, beside, key=_reached)
    except EvaluationError as fault:
        raise InputError(f"the model cannot be fitted: {fault}", remedy="check values and limits") from None
    progress("intervals")
    found = found.settled(count)
    advice = _advice(adapter, hypotheses, found, progress)
    sentences = (*advice, *lost_words(found))
    seconds = time.perf_counter() - started
    return ProposalResult(
        found, answer_of(found), proposals_table(found), proposed_places_table(found), sentences, seconds
    )


def _reached(found: Proposals) -> float:
    """Log evidence of the best proposal with what it was fitted beside."""
    return found.base.ln_evidence + (found.ranked[0].evidence if found.ranked else 0.0)


def _advice(adapter: Adapter, hypotheses: Any, found: Proposals, progress: Progress) -> tuple[str, ...]:
    """What would tell the two best proposals apart, where these data do not and candidate measurements are known."""
    if len(found.close) < 2 or found.base.effects or found.adequacy is None or found.measurement:
        return ()
    one, other = (p.candidate_fit for p in found.close[:2])
    fits = Refits(hypotheses, Settings(budget=math.inf), found.scale, progress)
    named = fits.scores(found.base.fit, [*one.effects, *other.effects])
    adequacy = replace(found.adequacy, named=named)
    explanation = Explanation(
        verdict="indistinguishable", base=found.base, base_adequacy=adequacy,
        groups=tuple(Group(e) for e in (*one.effects, *other.effects)), candidate_fits=(one, other), perturbation=None,
        chosen=one, chosen_adequacy=found.adequacy, credible=(*one.names, *other.names), noise_scale=found.scale,
        measured_scale=1.0, evaluations=0, alpha=fits.settings.alpha,
    )  # fmt: skip
    whole: Any = adapter
    design = replace(whole, hypotheses=hypotheses).design(explanation, progress)
    if design is None or design.competing is None:
        return ()
    best = recommendation(recommend(design), design.competing.names, ())
    return () if best is None else (best.sentence,)


# -- what was found before ---------------------------------------------------------------------------------------------


def _explained(study: AnyStudy, results: Results) -> ProposalStart:
    """The explanation in a folder; InputError without one of the study as it is."""
    remedy = f"run it first: calib explain {shell_argument(study.file)}"
    if not results.has("explanation.json"):
        raise InputError("the study was not explained yet", place=study.file, remedy=remedy)
    if sentence := stale_answers(study, results).sentences.get("explain"):
        raise InputError(sentence.partition(", so ")[0], place=study.file, remedy=remedy)
    kinds = {"verdict": str, "noise_scale": float, "chosen": [str], "credible_set": [str], "blamed": [{"name": str}]}
    stored = read_json(results.path / "explanation.json", kinds, tuple(kinds), remedy)
    named = [*stored["credible_set"], *(one["name"] for one in stored["blamed"])]
    beside = tuple(stored["chosen"]) if stored["verdict"] == "partial" else ()
    base, attempt = (explained_fit(study, results, names) for names in ((), beside))
    return ProposalStart(
        stored["verdict"], tuple(named), stored["noise_scale"], base, attempt if beside else {}, beside
    )  # fmt: skip


# -- writing -----------------------------------------------------------------------------------------------------------


def _kept(study: AnyStudy, results: Results, found: ProposalResult, count: int) -> ProposalResult:
    """Write tables, ``proposals.json`` and the record; earlier proposals are set aside where there are none now."""
    if found.folder is None:
        found = replace(found, aside=set_aside(_folder(study, results)))
    results.write_table("proposals", found.table)
    results.write_table("proposal_places", found.places)
    p = found.proposals
    fault = None if p is None or p.fault is None else p.fault.names[0]
    results.write_json(
        "proposals",
        {
            "study": study.name, "synthetic": study.synthetic, "proposed": found.folder is not None,
            **found.answer.plain, "sentences": list(found.sentences),
            "beside": [] if p is None else list(p.base.names), "p_family": np.nan if p is None else p.p_family,
            "lost": [] if p is None else [{"title": one.title, "reason": one.reason} for one in p.lost],
            "tested": 0 if p is None else p.tested, "evaluations": 0 if p is None else p.evaluations,
            "adequacy_p_family": np.nan if p is None or p.adequacy is None else p.adequacy.p_family,
            "adequacy_p_fit": np.nan if p is None or p.adequacy is None else p.adequacy.p_fit,
            "measurement_fault": fault, "wrong_datum": None if p is None or p.datum is None else p.datum.what,
            "written": "" if found.folder is None else str(found.folder),
            "set_aside": "" if found.aside is None else str(found.aside), "seconds": found.seconds,
        },
    )  # fmt: skip
    options = () if count == RANKED else ("--rank", str(count))
    seeds = {"probabilities": study.settings.explain.seed}
    write_record(study, results, "propose", seeds, options=options, answer=found.answer)
    return found


def _folder(study: AnyStudy, results: Results) -> Path:
    """Of the study with the proposals."""
    return results.path / f"{study.name}{PROPOSED}"


def _written(study: AnyStudy, results: Results, found: ProposalResult) -> ProposalResult:
    """The result with its study: it builds on the given one, and has the proposals in its library too."""
    assert found.proposals is not None
    folder = _folder(study, results)
    new = folder.parent.resolve() / folder.name
    source = study.file.resolve()
    libraries = [_seen_from(new, source.parent, name) for name in study.settings.libraries]
    document = tomlkit.document()
    document["title"] = f"{study.settings.title}, with proposed effects"
    document["base"] = anywhere(source.parent if source.name == NAME else source, new)
    document["effects"] = [*libraries, f"{FILE}:{FUNCTION}"]
    text = library_text(found.proposals.ranked, study.settings.title, found.proposals.base.names)
    with draft_of(new, folder) as draft:
        try:
            draft.chmod(0o755)
            (draft / NAME).write_text(tomlkit.dumps(document), encoding="utf-8", newline="")
            (draft / FILE).write_text(text, encoding="utf-8", newline="")
        except OSError as fault:
            raise unwritable(fault, folder) from None
        require_valid(study, draft / NAME, folder)
        for cache in draft.rglob("__pycache__"):  # made by the check
            shutil.rmtree(cache, ignore_errors=True)
        aside = put_among(draft, new, folder)
    return replace(found, folder=folder, aside=aside)


def _seen_from(new: Path, old: Path, function: str) -> str:
    """The name of a library with its file relative to another folder."""
    where, _, name = function.rpartition(":")
    if not where.endswith(".py") or Path(where).is_absolute():
        return function
    return f"{Path(os.path.relpath(old / where, new)).as_posix()}:{name}"
