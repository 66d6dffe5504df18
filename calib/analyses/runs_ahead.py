"""What a solver will be started for, how often and how long, told before its first run."""

from __future__ import annotations

from typing import Literal

from calib.analyses.provenance.isolation import Workers
from calib.analyses.provenance.places import QUICK_SAMPLES, QUICK_STARTS
from calib.execution.executor import Injected
from calib.execution.worker import available_cores
from calib.results.ledger import Ledger
from calib.structure.modal_function import ModalFunctionModel
from calib.study.search_settings import ParetoSettings
from calib.study.several import AnyStudy

_STEPS = 5
"""Steps of least squares on numbers from one start to its end, in the usual case."""
_FIT = (8, 4)
"""Runs for modes from one start to its end, and more of them for each parameter: the geometric mean of 21 and 26, which
the frame in CalculiX takes with its four without and with a stated accuracy."""
_EXPLAIN = (36, 12)
"""The same of an explanation from a calibrated model, of 81 and 89."""
_EFFECT = 25
"""Runs for a listed effect that is fitted; assumed."""
_AGREE = 6
"""Starts after which fits usually agree, where a study leaves their number to that."""

Verb = Literal["sensitivity", "calibrate", "explain", "pareto"]


def runs_ahead(
    study: AnyStudy,
    ledger: Ledger,
    verb: Verb,
    workers: Workers = None,
    quick: bool = False,
    front: ParetoSettings | None = None,
) -> str:
    """How often an analysis will start the solver of a study, and how long that takes; empty without a solver.

    Parameters
    ----------
    study : Study
    ledger : Ledger
        A stored run tells how long one takes.
    verb : {"sensitivity", "calibrate", "explain", "pareto"}
    workers : int, Injected or None
        See `calib.analyses.provenance.places.open_evaluator`.
    quick : bool
    front : ParetoSettings, optional
        Those of ``"pareto"``.
    """
    settings = study.settings
    if settings.solver is None:
        return ""
    stored = next((s for one in study.studies if (s := ledger.stored(one.problem.ledger_key)) is not None), None)
    runs, why = _runs(study, verb, quick, front)
    told = f"The solver, {settings.solver.command!r}, will be started about {runs} times: {why}."
    if stored is None:
        return f"{told} How long one takes is not known yet."
    at_once = workers.at_once if isinstance(workers, Injected) else workers or available_cores()
    whole = runs * stored.seconds / at_once
    shared = f" with {at_once} at once" if at_once > 1 else ""
    unit, size = ("min", 60.0) if whole >= 120 else ("s", 1.0)
    return f"{told} One took {stored.seconds:.2g} s: {whole / size:.2g} {unit}{shared}, less what is stored."


def _runs(study: AnyStudy, verb: Verb, quick: bool, front: ParetoSettings | None) -> tuple[int, str]:
    """Expected runs of a verb, and of what they are made."""
    settings, tests = study.settings, len(study.studies)
    calibration = settings.calibration
    if verb == "sensitivity":
        samples = QUICK_SAMPLES if quick else settings.sensitivity.samples
        return samples, f"{samples} samples"
    if front is not None:
        runs = tests * front.population * front.generations
        return runs, f"{front.generations} generations of {front.population} at most"
    free = len(study.search_space.free)
    fixed = calibration.method == "gauss-newton"
    starts = QUICK_STARTS if quick else calibration.starts if fixed else _AGREE
    cases = 1 if verb == "explain" or calibration.method == "auto" else len(calibration.cases)
    modal = all(isinstance(one.model, ModalFunctionModel) for one in study.studies)
    if verb == "explain" and modal:
        listed = max(len(one.candidates) for one in study.studies)
        effects = listed + _EFFECT * min(listed, settings.explain.refits)
        runs = tests * (_EXPLAIN[0] + _EXPLAIN[1] * free + effects)
        return (
            runs,
            "fits with changes of single kinds of results, measurement errors and effects; more or fewer by half",
        )
    step = tests * (1 + 2 * free)
    one_start, why = _STEPS * step, f"{step} for a step of least squares, some {_STEPS} steps from a start"
    if modal:
        one_start = tests * (_FIT[0] + _FIT[1] * free)
        why = f"some {one_start} from a start to its end, more or fewer by half"
    runs = cases * starts * one_start
    if calibration.method == "genetic" and verb == "calibrate":
        searched = cases * tests * calibration.population * calibration.generations
        return runs + searched, f"up to {searched} for the searches, and {why}"
    return runs, f"{why}, {starts} starts"
