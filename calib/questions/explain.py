"""Which physical effect a study's model lacks: everything that is told and written about it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.correlation.residual import ModalResidual
from calib.errors import EvaluationError, InputError
from calib.missing import explain as engine
from calib.missing.advice import advice_sentence, advise, expected_odds
from calib.missing.explain import Findings, Trial
from calib.missing.left_out import left_out
from calib.missing.profile import profile_interval
from calib.missing.tables import (
    confounding_table,
    effects_table,
    misfit_table,
    strain_table,
    strength_of,
    tried_table,
)
from calib.missing.verdict import sentence
from calib.questions.budget import Budget, discretisation_budget
from calib.questions.hypotheses import ModalHypotheses
from calib.questions.library import SettledModal, modal_hypotheses
from calib.questions.prospects import modal_prospects
from calib.questions.verify import modal_errors
from calib.results import Results
from calib.structure.extend import extend
from calib.structure.model import StructuralModel
from calib.study import Study

Progress = Callable[[str], None]
NAMES_SOMETHING = ("effect", "indistinguishable", "two_effects")
BASIS_ERROR = 0.05
"""Largest difference of whitened residuals on the reduced basis from full order, in units of the scatter."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is missing, with the tables that show it.

    Attributes
    ----------
    findings : Findings
    sentence : str
    notes : tuple of str
        What a reader must know, such as a scatter that had to be assumed.
    effects, atoms, confounding, strain, misfit, sensors, errors, tried, next_measurement : DataFrame
        The tables of the same names.
    budget : Budget or None
        What the discretisation alone would look like; None without a finer mesh.
    basis_error : float
        Largest difference of the whitened residual from full order, at the base model and at the explanation.
    seconds : float
    """

    findings: Findings
    sentence: str
    notes: tuple[str, ...]
    effects: pd.DataFrame
    atoms: pd.DataFrame
    confounding: pd.DataFrame
    strain: pd.DataFrame
    misfit: pd.DataFrame
    sensors: pd.DataFrame
    errors: pd.DataFrame
    tried: pd.DataFrame
    next_measurement: pd.DataFrame
    budget: Budget | None
    basis_error: float
    seconds: float

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.explain.Findings`."""
        return self.findings.verdict


def explain(study: Study, results: Results, progress: Progress = lambda words: None) -> Explanation:
    """Find which effect of the study's library its model lacks; write all tables and ``explanation.json``.

    Raises
    ------
    InputError
        When the study names no effects, all of them are in the model, or too little was measured.
    """
    if not study.library:
        raise InputError(
            "the study names no effects that its model may lack", place=study.file,
            remedy='add effects = "module:function" (the tutorial of studies/five_mass_chain shows how)',
        )  # fmt: skip
    if not study.candidates:
        raise InputError("every effect of the library is in the model already", place=study.file)
    if isinstance(study.problem, FunctionProblem):
        raise NotImplementedError
    started = time.perf_counter()
    settled = modal_hypotheses(study, results, progress)
    hypotheses = settled.hypotheses
    given = study.settings.explain
    settings = engine.Settings(given.alpha, given.refits, given.merge, given.seed)
    try:
        found = engine.explain(hypotheses, settings, progress)
    except EvaluationError as fault:
        raise InputError(
            f"the model cannot be fitted: {fault}", place=study.file, remedy="check values, limits and supports"
        ) from None
    answer = _answer(study, settled, found, progress, started)
    _write(study, results, settled, answer)
    return answer


def _answer(study: Study, settled: SettledModal, found: Findings, progress: Progress, started: float) -> Explanation:
    hypotheses = settled.hypotheses
    named = found.verdict in NAMES_SOMETHING
    progress("intervals and data that were left out")
    intervals = {}
    if found.verdict in ("effect", "indistinguishable"):
        by_name = {t.names[0]: t for t in found.singles}
        intervals = {name: profile_interval(by_name[name].state, name) for name in found.credible}
    gains = _gains(hypotheses, found)
    effects = effects_table(found, intervals, gains)
    progress("withheld data")
    errors, basis_error = _errors(study, hypotheses, found)
    progress("what to measure next")
    table, advice = _next(study, hypotheses, found, effects)
    found = replace(found, evaluations=hypotheses.evaluations)
    budget = _budget(study, hypotheses, found, progress)
    told = sentence(found, effects, errors if named else errors.head(0), advice)
    return Explanation(
        findings=found,
        sentence=told,
        notes=_notes(study, basis_error, budget),
        effects=effects,
        atoms=_atoms(settled, found),
        confounding=confounding_table(found),
        strain=strain_table(found),
        misfit=misfit_table(found),
        sensors=_sensors(hypotheses, found),
        errors=errors,
        tried=tried_table(found),
        next_measurement=table,
        budget=budget,
        basis_error=basis_error,
        seconds=time.perf_counter() - started,
    )


def _budget(study: Study, hypotheses: ModalHypotheses, found: Findings, progress: Progress) -> Budget | None:
    finer = study.finer_model()
    if finer is None:
        return None
    progress("what the discretisation alone would look like")
    return discretisation_budget(hypotheses, found.base.state, finer)


def _notes(study: Study, basis_error: float, budget: Budget | None) -> tuple[str, ...]:
    out = [] if budget is None else [budget.sentence]
    measured = study.measured
    if measured is not None and measured.n_repeats == 1:
        known = np.isfinite(measured.freq_std).any()
        out.append(
            "There are no repeats: the scatter is the one the file states."
            if known
            else "There are no repeats and no standard deviations: a scatter of 0.5 % of frequencies, 10 % of damping "
            "ratios and 3 % of the largest entry of shapes is assumed. Probabilities are as good as this assumption."
        )
    if basis_error > BASIS_ERROR:
        out.append(f"The reduced basis errs by {basis_error:.2g} standard deviations; set use = false in [reduction].")
    return tuple(out)


def _gains(hypotheses: ModalHypotheses, found: Findings) -> dict[str, float]:
    """Gain of every fitted effect in the log density of modes that are left out one by one."""
    modes = [row.mode for row in hypotheses.rows]

    def density(trial: Trial) -> float:
        s = trial.state
        return float(np.sum(left_out(s.residual, s.slope, s.prior_sd, modes).elpd))

    base = density(found.base)
    return {t.names[0]: density(t) - base for t in found.singles}


def _errors(study: Study, hypotheses: ModalHypotheses, found: Findings) -> tuple[pd.DataFrame, float]:
    """Errors before and after at full order, and how far the reduced residual was from it."""
    assert isinstance(study.problem, ModalProblem) and isinstance(study.model, StructuralModel)
    whole = study.whole_problem()
    parts, worst = [], 0.0
    stages = [("before", found.base)] + ([("after", found.chosen)] if found.chosen is not None else [])
    for stage, trial in stages:
        state = trial.state
        named = [e for e in trial.effects if e.name in {c.name for c in study.candidates}]
        model = extend(study.model, named)
        more = model.n_dof - study.model.n_dof
        fitted = replace(study.problem, model=model, mode_count=study.problem.mode_count + more)
        everything = None if whole is None else replace(whole, model=model, mode_count=whole.mode_count + more)
        table = modal_errors(
            fitted, everything, state.values, state.names, state.prior_sd, hypotheses.floors,
            hypotheses.scatter_freedom, found.noise_scale,
        )  # fmt: skip
        parts.append(table.assign(stage=stage))
        full = ModalResidual(fitted, hypotheses.floors).residual(state.values) / found.noise_scale
        worst = max(worst, float(np.abs(full - state.residual).max()))
    errors = pd.concat(parts, ignore_index=True)
    return errors[["group", "stage", "rows", "rms", "expected", "p", "unpaired"]], worst


def _next(
    study: Study, hypotheses: ModalHypotheses, found: Findings, effects: pd.DataFrame
) -> tuple[pd.DataFrame, str]:
    """What to measure next, seen from the base model."""
    candidates = [g.effect for g in found.groups]
    named = found.base_check.named
    held = set(study.settings.withheld.modes)
    whole = study.whole
    withheld = {} if whole is None else dict(zip(whole.names, whole.natural_freq.tolist(), strict=True))
    withheld = {name: freq for name, freq in withheld.items() if name in held}
    prospects = modal_prospects(hypotheses, found.base.state, candidates, named, found.noise_scale, withheld)
    fitted = {t.names[0]: strength_of(t, t.names[0])[0] for t in found.singles}
    strengths = [fitted.get(e.name, e.plausible) for e in candidates]
    pair = (found.credible[0], found.credible[1]) if found.verdict == "indistinguishable" else None
    table = advise(prospects, strengths, pair)
    unseen = effects.loc[~effects["visible"].astype(bool), "name"].tolist()
    told = advice_sentence(table, pair, unseen)
    if pair is not None:
        now = expected_odds(prospects, strengths, pair)
        told = f"Odds to expect with these sensors: {np.exp(min(now, 20.0)):.2g}:1. {told}"
    return table, told


def _atoms(settled: SettledModal, found: Findings) -> pd.DataFrame:
    scores = found.base_check.atoms
    where = {name: k for k, name in enumerate(scores.owners)}
    rows = []
    for atom in settled.atoms:
        k = where[atom.effect.name]
        rows.append((atom.effect.name, atom.kind, *atom.place, atom.sensor, scores.z[k], scores.gamma[k]))
    return pd.DataFrame(rows, columns=["atom", "kind", "x", "y", "z", "sensor", "score", "gamma"])


def _sensors(hypotheses: ModalHypotheses, found: Findings) -> pd.DataFrame:
    """Whitened residuals of shapes by sensor: ``stage, mode, sensor, node, direction, x, y, z, re, im``."""
    sensors = {s.name: s for s in hypotheses.problem.measured.sensors}
    stages = [("base", found.base)] + ([("explained", found.chosen)] if found.chosen is not None else [])
    parts: dict[tuple[str, str, str], dict[str, float]] = {}
    for stage, trial in stages:
        for row, e in zip(hypotheses.rows, trial.state.residual, strict=True):
            if row.kind == "shape":
                parts.setdefault((stage, row.mode, row.sensor), {})[row.part] = float(e)
    rows = []
    for (stage, mode, name), entry in parts.items():
        s = sensors[name]
        point = s.point or (np.nan, np.nan, np.nan)
        rows.append((stage, mode, name, s.node, s.direction, *point, entry.get("re", 0.0), entry.get("im", 0.0)))
    columns = ["stage", "mode", "sensor", "node", "direction", "x", "y", "z", "re", "im"]
    return pd.DataFrame(rows, columns=columns)


# -- files -------------------------------------------------------------------------------------------------------------

TABLES = (
    "effects", "atoms", "confounding", "strain", "errors", "tried", "next_measurement",
)  # fmt: skip


def _write(study: Study, results: Results, settled: SettledModal, answer: Explanation) -> None:
    for name in TABLES:
        results.write_table(name, getattr(answer, name))
    results.write_table("misfit_kinds", answer.misfit)
    results.write_table("sensor_misfit", answer.sensors)
    results.write_table("structure", structure_table(study))
    if answer.budget is not None:
        results.write_table("discretisation", answer.budget.table)
    results.write_json("explanation", summary(study, answer))


def structure_table(study: Study) -> pd.DataFrame:
    """Lines of the model's mesh: ``x0, y0, z0, x1, y1, z1, group``."""
    assert isinstance(study.model, StructuralModel)
    mesh = study.model.mesh
    ends = np.hstack([mesh.points[mesh.lines[:, 0]], mesh.points[mesh.lines[:, 1]]])
    return pd.DataFrame(ends, columns=["x0", "y0", "z0", "x1", "y1", "z1"]).assign(group=list(mesh.groups))


def summary(study: Study, answer: Explanation) -> dict[str, object]:
    """``explanation.json``."""
    found, check = answer.findings, answer.findings.base_check
    columns = (
        "name", "z", "gamma", "phi", "phi_low", "phi_high", "phi_min", "ln_bayes", "posterior", "heldout_gain",
        "implausible", "confounded_with",
    )  # fmt: skip
    table = answer.effects[list(columns)].to_dict("records")
    errors: dict[str, dict[str, float | None]] = {
        group: {"before": None, "after": None}
        for group in ("fit", "left_out", "withheld_sensors", "withheld_modes")
    }  # fmt: skip
    for row in answer.errors.to_dict("records"):
        errors[str(row["group"])][str(row["stage"])] = float(row["rms"])
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "verdict": found.verdict,
        "sentence": answer.sentence,
        "notes": list(answer.notes),
        "p_family": check.p_family,
        "p_fit": check.p_fit,
        "credible_set": list(found.credible),
        "effects": table,
        "chosen": [] if found.chosen is None else list(found.chosen.names),
        "chosen_values": {} if found.chosen is None else _own_values(found.chosen),
        "adequacy_p": None
        if found.chosen_check is None
        else min(found.chosen_check.p_family, found.chosen_check.p_fit),
        "noise_scale": found.noise_scale,
        "measured_noise_scale": found.measured_scale,
        "local_changes": len(set(check.atoms.owners)),
        "evaluations": found.evaluations,
        "basis_error": answer.basis_error,
        "discretisation": None if answer.budget is None else answer.budget.largest,
        "errors": errors,
        "seconds": answer.seconds,
    }


def _own_values(trial: Trial) -> dict[str, float]:
    return {name: trial.state.values[name] for effect in trial.effects for name in effect.names}
