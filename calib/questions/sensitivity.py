"""Which parameters matter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.errors import InputError
from calib.ledger import Ledger
from calib.questions.places import QUICK_SAMPLES, open_evaluator
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.sensitivity.spearman import noise_floor, spearman
from calib.study import Study


@dataclass(frozen=True)
class Sensitivity:
    """Rank correlations and what is behind them.

    Attributes
    ----------
    table : DataFrame (n_parameters, n_responses)
    samples : int
        Accepted points.
    failed : int
        Points the model could not be evaluated at.
    unpaired : int
        Points at which some measured mode found no partner.
    acceptance : float
        Part of the drawn points that kept the constraints.
    noise_floor : float
        Largest correlation that chance alone would give in the whole table, 95 %.
    """

    table: pd.DataFrame
    samples: int
    failed: int
    unpaired: int
    acceptance: float
    noise_floor: float


def sensitivity(
    study: Study,
    results: Results,
    ledger: Ledger,
    workers: int | None = None,
    quick: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sensitivity:
    """Latin hypercube over all free parameters and Spearman's rank correlation with every frequency and MAC."""
    settings = study.settings.sensitivity
    space = study.sensitivity_space
    count = min(settings.samples, QUICK_SAMPLES) if quick else settings.samples
    drawn = sample(space, count, settings.seed)
    points = [space.complete(x) for x in drawn.points]
    outcomes = []
    with open_evaluator(study, workers, count) as evaluator:
        for start in range(0, count, 50):
            outcomes += ledger.evaluate(study.problem.fingerprint, points[start : start + 50], evaluator)
            progress(len(outcomes), count)
    names = _sensitivity_responses(study)
    x = pd.DataFrame(drawn.points, columns=list(space.free_names))
    y = pd.DataFrame([{n: o.responses.get(n, np.nan) for n in names} for o in outcomes], columns=names)
    y = y.astype(float)
    failed = sum(o.status != "ok" for o in outcomes)
    unpaired = int(y.isna().any(axis=1).sum()) - failed
    if failed == count:
        raise InputError(f"all {count} samples failed: {outcomes[0].error}", place=study.file)
    table = spearman(x, y)
    complete = int((~y.isna().any(axis=1)).sum())
    results.write_table("sensitivity", table, index=True)
    results.write_table("sensitivity_samples", pd.concat([x, y], axis=1))
    floor = noise_floor(max(complete, 3), max(int(table.notna().sum().sum()), 1))
    return Sensitivity(table, count, failed, unpaired, drawn.acceptance, floor)


def _sensitivity_responses(study: Study) -> list[str]:
    if isinstance(study.problem, FunctionProblem):
        return list(study.problem.targets)
    kinds = ("natural_freq", "mac") if study.problem.measured.has_shapes else ("natural_freq",)
    return [f"{kind}_{mode}" for kind in kinds for mode in study.problem.measured.names]
