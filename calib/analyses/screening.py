"""Screening for independent inputs: elementary effects (Morris) or variance shares (Sobol)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pandas as pd

from calib.analyses.answers import screening_answer
from calib.analyses.failures import reasons, reasons_sentence
from calib.analyses.joint_responses import Responses
from calib.analyses.provenance.places import QUICK_BASE, QUICK_TRAJECTORIES, Workers
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.sensitivity import evaluated, table_of, varied
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.sensitivity.rules import RULES
from calib.sensitivity.variance import Design, morris_design, morris_effects, sobol_design, sobol_shares
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

TRAJECTORIES, BASE = 20, 128
"""Trajectories of Morris, twice those that usually rank well (`RULES.trajectories`), and base points of Sobol, a power
of 2: the shares of a smooth function of five parameters then have a standard error of 0.01."""


@dataclass(frozen=True)
class Screening:
    """Elementary effects (Morris) or variance shares (Sobol).

    Attributes
    ----------
    method : {"morris", "sobol"}
    table : DataFrame
        One row per parameter and response.
    points : int
        Evaluated points.
    note : str
        What the sampling ignores, such as constraints.
    failed : int
        Points at which the model could not be evaluated.
    unpaired : int
        Points at which some response is unknown though the model was evaluated.
    why_failed : str
        The commonest reasons of failure; empty without any.
    """

    method: str
    table: pd.DataFrame
    points: int
    note: str
    failed: int = 0
    unpaired: int = 0
    why_failed: str = ""

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        return screening_answer(self.method, self.table, self.sentences[0])

    @property
    def sentences(self) -> tuple[str, ...]:
        """Number of points, those that are lost, with the trajectories that they take along; reasons of failure."""
        points = f"{self.points} point{'s' * (self.points != 1)}"
        points += f", {self.failed} failed" if self.failed else ""
        points += f", {self.unpaired} left a response unknown" if self.unpaired else ""
        told = " ".join(filter(None, [f"{points}.", self._dropped, self.note]))
        return (told, *([self.why_failed] if self.why_failed else []))

    @property
    def _dropped(self) -> str:
        """What is left of the trajectories, in words; empty where all are."""
        if self.method != "morris" or not self.table["dropped"].any():
            return ""
        rows = self.table.drop_duplicates("response").to_dict("records")
        worst, least = (pick(rows, key=lambda row: row["dropped"]) for pick in (max, min))
        words = f"{worst['dropped']} of {worst['dropped'] + worst['trajectories']} trajectories are dropped"
        if least["dropped"] < worst["dropped"]:
            words += f" for {worst['response']}, {least['dropped']} for {least['response']}"
        words += "; the others hold where the model can be evaluated, not over the whole limits."
        if worst["trajectories"] < RULES.trajectories:
            words += f" Fewer than {RULES.trajectories} rank parameters less surely."
        return words


def screen(
    study: LoadedStudy,
    results: Results,
    ledger: Ledger,
    method: Literal["morris", "sobol"],
    workers: Workers = None,
    quick: bool = False,
    ignore_constraints: bool = False,
    progress: Progress = silent,
) -> Screening:
    """Morris' elementary effects or Sobol's variance shares; writes their table, see `screened`."""
    answer = screened(study, ledger, method, workers, quick, ignore_constraints, progress)
    analysis = f"sensitivity --method {method}"
    begin_analysis(results, analysis)
    results.write_table(method, answer.table)
    options, seed = ["--ignore-constraints"] * ignore_constraints, study.settings.sensitivity.seed
    write_record(study, results, analysis, {"points": seed}, answer.sentences, quick, options, answer.answer)
    return answer


def screened(
    study: AnyStudy,
    ledger: Ledger,
    method: Literal["morris", "sobol"],
    workers: Workers = None,
    quick: bool = False,
    ignore_constraints: bool = False,
    progress: Progress = silent,
) -> Screening:
    """Morris' elementary effects or Sobol's variance shares, for independent inputs between their limits."""
    space, seed = varied(study), study.settings.sensitivity.seed
    design: Design
    if method == "morris":
        design = morris_design(
            space, QUICK_TRAJECTORIES if quick else TRAJECTORIES, seed, ignore_constraints=ignore_constraints
        )
    elif method == "sobol":
        design = sobol_design(space, QUICK_BASE if quick else BASE, seed, ignore_constraints)
    else:
        raise InputError(
            f"there is no method {method!r}", place="sensitivity, method", remedy="it is ranks, morris or sobol"
        )
    outcomes = evaluated(study, ledger, [space.complete(x) for x in design.points], workers, progress)
    responses = table_of(outcomes, Responses.of(study).measured)
    failed = sum(o.status != "ok" for o in outcomes)
    unpaired = int(responses.isna().any(axis=1).sum()) - failed
    why = reasons_sentence(space, reasons(outcomes), len(outcomes))
    table = morris_effects(design, responses) if method == "morris" else sobol_shares(design, responses)
    return Screening(method, table, len(design.points), design.note, failed, unpaired, why)
