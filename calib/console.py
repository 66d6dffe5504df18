"""Terminal output of the command: short tables, sentences and progress bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pandas as pd

from calib import progress, terminal
from calib.analyses.added import WORDS, Added, by_group, to_add
from calib.analyses.calibrate import Calibration
from calib.analyses.case import CaseFound, SearchProgress
from calib.analyses.compare import ComparisonResult
from calib.analyses.explanation_result import ExplanationResult
from calib.analyses.extend import Extension
from calib.analyses.joint_calibration import Fitted, JointCalibration
from calib.analyses.record import assumptions_table, check_repeats
from calib.analyses.sensitivity import SampleProgress, Screening, Sensitivity
from calib.analyses.versions import Versions
from calib.front.listener import Listener
from calib.missing.explanation import Explanation
from calib.missing.refits import Progress
from calib.missing.verdict import rounded
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile, shell_argument
from calib.terminal import count, number, say, table, warn

WORST_SHOWN = 8
"""Rows shown of the largest residuals; the table in the results folder has all."""
ASSUMPTIONS_SHOWN = 60
"""Assumed values shown; ``assumptions.csv`` has all."""


class _Printing(Listener):
    def samples(self) -> AbstractContextManager[SampleProgress]:
        return progress.samples()

    def search(self) -> AbstractContextManager[SearchProgress]:
        return progress.search()

    def doing(self) -> AbstractContextManager[Progress]:
        return progress.doing()

    def first(self, earlier: StudyFile, path: Path) -> None:
        say(f"{earlier.settings.title} comes first: {path} takes over what it finds.")

    def begins(self, study: StudyFile, verb: str) -> None:
        label = "  [synthetic measurement]" if study.synthetic else ""
        say(f"\n{study.settings.title}: {verb}{label}", style="bold")

    def other_state(self, rows: int) -> None:
        if rows:
            belong, they = ("belongs", "it is") if rows == 1 else ("belong", "they are")
            rest = f"{belong} to another state of model or measurement; {they} kept but not used."
            say(f"{count(rows, 'earlier evaluation')} {rest}")

    def compared(self, study: Study, answer: ComparisonResult, folder: Results) -> None:
        _tell_held_out(study)
        for note in study.measurement_notes:
            say(f"Measurement: {note}.")
        for sentence in check_repeats(study):
            warn(sentence)
        for hint in answer.hints:
            warn(hint)
        for finding in answer.sensor_findings:
            warn(f"Check this sensor: {finding.sentence}")
        _print_answer(answer)
        if answer.comparison is not None:
            *first, last = answer.sentences
            for sentence in first:
                if sentence not in answer.hints:
                    say(sentence)
            say()
            say(last)
            worst = answer.comparison.where_it_fails().head(WORST_SHOWN)
            rows = [
                (r["kind"], r["what"], number(r["value"], 3), number(r["in_std"], 1), r["verdict"])
                for r in worst.to_dict("records")
            ]
            table(("kind", "what", "value", "in standard deviations", "verdict"), rows)
        else:
            for sentence in answer.std_notes:
                say(sentence)
        assumed = assumptions_table(study)
        if len(assumed):
            where = folder.path / "assumptions.csv"
            say(f"\nAssumed, not published or measured ({count(len(assumed), 'item')}; the reasons are in {where}):")
            for row in assumed.head(ASSUMPTIONS_SHOWN).to_dict("records"):
                unit = "" if row["unit"] == "-" else f" {row['unit']}"
                say(f"  {row['item']}: {row['value']}{unit}")

    def sampled(self, study: Study, answer: Sensitivity, folder: Results) -> None:
        behind, *why, selected = answer.sentences
        for sentence in (behind, *why):
            say(sentence)
        rows = [
            (
                r["parameter"],
                *(number(r[name], 2) for name in ("max_spearman", "max_partial", "max_variance_share")),
                "yes" if r["selected"] else "no",
                r["why"],
            )
            for r in answer.assessment.selection.to_dict("records")
        ]
        table(("parameter", "Spearman", "partial", "variance share", "selected", "why"), rows, left=("why",))
        say(selected)
        if study.model.space.constraints:
            say("Constraints correlate the sampled parameters; Spearman's coefficients alone may mislead.")

    def screened(self, answer: Screening, folder: Results) -> None:
        size = "mu_star" if answer.method == "morris" else "ST"
        names = answer.table["parameter"].drop_duplicates()
        known = answer.table.dropna(subset=[size]).sort_values(size, ascending=False, kind="stable")
        largest = known.drop_duplicates("parameter").set_index("parameter")
        found = [(n, largest.loc[n, size], largest.loc[n, "response"]) for n in names if n in largest.index]
        rows = [(str(n), f"{value:.3g}", str(response)) for n, value, response in found]
        rows += [
            (str(n), "", "no response: too few are known, or none changes") for n in names if n not in largest.index
        ]
        for sentence in answer.sentences:
            say(sentence)
        table(("parameter", f"largest {size}", "on"), rows)
        say(f"All of them are in {folder.path / (answer.method + '.csv')}.")

    def calibrated(self, study: StudyFile, answer: Fitted, folder: Results) -> None:
        if isinstance(answer, JointCalibration):
            _tell_joint_calibration(answer, folder)
            return
        counts = ("asked", "solved", "reused", "infeasible", "failed")
        cases = [
            (
                c.name,
                "" if c.search is None else f"{c.search.misfit:.5g}",
                "" if c.search is None else f"{c.search_full_order:.5g}",
                f"{c.result.misfit:.5g}",
                *(str(getattr(c.result, name)) for name in counts),
                f"{c.result.seconds:.0f} s",
            )
            for c in answer.cases
        ]
        table(("case", "search", "at full order", "reported", *counts, "time"), cases)
        _print_points(answer)
        best = answer.best
        _print_verdicts(answer.verdicts, best)
        for sentence in answer.sentences:
            if sentence not in answer.contradictions:  # told at the end, beside the errors they rest on
                say(sentence)
        _tell_retried(answer)
        _print_suspects(best.statistics.suspects)
        say(f"\nAfter calibration (case {best.name}):")
        _print_answer(best.answer)
        for warning in best.answer.warnings:
            warn(warning)
        before, after = answer.before, best.answer
        label = "error" if before.comparison is None else "frequency error"
        say(f"Mean {label} {100 * before.mean_freq_error:.2f} % -> {100 * after.mean_freq_error:.2f} %.")
        if not math.isnan(after.mean_mac):
            allowed = "" if math.isnan(after.noise_mac) else f" (noise alone allows {after.noise_mac:.4f})"
            say(f"Mean MAC {before.mean_mac:.4f} -> {after.mean_mac:.4f}{allowed}.")
        _tell_held_out(study)
        if answer.modes is not None and study.settings.held_out.modes:
            _print_modes(answer.modes)
        if answer.responses is not None:
            _print_responses(answer.responses)
        held = study.settings.held_out
        if answer.errors is not None and (held.modes or held.sensors or held.responses):
            say("Errors in standard deviations:")
            table(("data", *_ERRORS), [(WORDS[r["group"]], *_errors(r)) for r in answer.errors.to_dict("records")])
        for sentence in answer.contradictions:
            warn(sentence)

    def explained(self, study: StudyFile, answer: ExplanationResult, folder: Results) -> None:
        _tell_held_out(study)
        for note in answer.notes:
            warn(note)
        say(f"\n{answer.verdict}", style="bold")
        say(answer.sentence)
        _print_suspects(answer.tables["suspects_explained"])
        say()
        rows = []
        for r in answer.effects.to_dict("records"):
            unit = "" if r["unit"] == "-" else f" {r['unit']}"
            magnitude = (
                f"{r['magnitude']:.3g} [{r['magnitude_low']:.3g}, {r['magnitude_high']:.3g}]{unit}"
                if r["refitted"]
                else ""
            )
            least = f"{rounded(r['magnitude_min'])}{unit}" if math.isfinite(r["magnitude_min"]) else ""
            least = ", ".join([*([least] if least else []), *([] if r["visible"] else ["not visible"])])
            remark = "credible" if r["credible"] else r["implausible"]
            numbers = (number(r["z"], 1), number(r["ln_bayes"], 1))
            if not r["refitted"] and numbers[1]:
                numbers = numbers[0], f"{numbers[1]} (linear)"
            rows.append((r["name"], *numbers, number(r["unabsorbed"], 2), magnitude, least, remark))
        heads = ("effect", "z", "ln Bayes", "unabsorbed", "magnitude, 95 %", "smallest visible", "remark")
        if rows:
            table(heads, rows, left=("remark",))
        found = answer.explanation
        effects = count(sum(len(g.names) for g in found.groups), "effect")
        local = count(len(answer.tables["perturbations"]), "local perturbation")
        tests = f"{effects} and {local} tested"
        fits = count(len(answer.tables["candidate_fits"]), "model")
        work = f"{fits} fitted, {count(found.evaluations, 'model evaluation')}"
        say(f"\n{tests}, {work}, {answer.seconds:.0f} s.")
        if rows:
            against = "ln Bayes is against the base model, for the plausible size of each effect"
            say(f"z is a score, not a probability; {against}.")
        if len(answer.errors):
            errors = [(str(r["group"]), str(r["stage"]), *_errors(r)) for r in answer.errors.to_dict("records")]
            name = "" if found.chosen is None else " and ".join(found.chosen.names)
            label = f" and after with {name}" if name else ""
            if (answer.errors["stage"] == "attempt").any():
                label = f" and with {name}: best attempt, not believed"
            say(f"\nErrors in standard deviations, before{label}:")
            table(("data", "stage", *_ERRORS), errors)
        terminal.tell_traces(f"explain {study.file}", answer.traces)

    def may_add(self, study: StudyFile, found: Explanation) -> None:
        if named := to_add(found):
            them = "them" if len(named.names) > 1 else "it"
            say(f"Add {them} with: calib extend {shell_argument(study.file)} {' '.join(named.names)} --into FOLDER")

    def extended(self, written: Extension) -> None:
        effects, folder = written.effects, written.file.parent
        more = "one effect" if len(effects) == 1 else f"{len(effects)} effects"
        named = " and ".join(f"{effect.title} ({effect.name})" for effect in effects)
        say(f"Written: {folder}, which builds on the same study and has {more} more in its model: {named}.")
        if written.selected:
            say(f"Its calibration may change {', '.join(written.selected)} too.")
        else:
            names = ", ".join(name for effect in effects for name in effect.names)
            say(f"Its model has {names} too; the study leaves the selection to 'calib sensitivity'.")
        if written.aside is not None:
            say(f"The study that was there had been changed, and is kept as {written.aside}, without its results.")

    def added(self, answer: Added, written: Extension, folder: Results) -> None:
        rows = [
            (WORDS[r["group"]], str(r["rows_after"]), *(number(r[f"rms_{stage}"], 2) for stage in ("before", "after")),
             number(r["expected_after"], 2), *(f"{r[f'p_{stage}']:.2g}" for stage in ("before", "after")))
            for r in by_group(answer.errors).to_dict("records")
        ]  # fmt: skip
        if rows:
            say("Both models calibrated in the same way; rms errors in standard deviations:")
            table(("data", "rows", "before", "after", "of a correctly specified model", "p before", "p after"), rows)
        say(answer.sentence)
        say(f"\nThe extended study: {written.file.parent}")
        say(f"Its results: {folder.path}")

    def versions(self, found: Versions) -> None:
        rows = [
            (
                str(r["study"]),
                str(r["effects"]) or "none",
                str(r["group"]),
                number(r["rms"], 2),
                number(r["expected"], 2),
            )
            for r in found.table.to_dict("records")
        ]
        if rows:
            say("\nErrors in standard deviations over the versions of the model:")
            table(("study", "effects", "data", "rms", "of a correctly specified model"), rows, left=("effects", "data"))
        for note in found.notes:
            warn(note)

    def nothing_added(self, sentence: str) -> None:
        say(sentence)

    def drawn(self, figures: Sequence[Path], outdated: Mapping[str, str], report: Path | None) -> None:
        if figures:
            say("\nFigures, each beside its table:")
            for path in figures:
                say(f"  {path}")
        for sentence in outdated.values():
            warn(f"\n{sentence}")
        if report is not None:
            say(f"\nThe report, one file that opens offline: {report}")


PRINTING: Listener = _Printing()
"""Prints progress and results, with bars on a terminal."""

_ERRORS = ("rows", "rms", "of a correctly specified model", "p")


def _tell_joint_calibration(answer: JointCalibration, folder: Results) -> None:
    _print_verdicts(answer.verdicts, answer.any.best)
    for sentence in answer.sentences:
        say(sentence)
    _tell_retried(answer.any)
    _print_suspects(answer.any.best.statistics.suspects)
    rows = [
        (test, WORDS[r["group"]], *_errors(r))
        for test, one in answer.tests.items()
        if one.errors is not None
        for r in one.errors.to_dict("records")
    ]
    say("Errors in standard deviations:")
    table(("test", "data", *_ERRORS), rows, left=("data",))
    say(f"The joint results are in {folder.path}, those of each test beside it.")


def _tell_retried(answer: Calibration) -> None:
    if answer.retried:
        say(
            f"Evaluated again: {count(answer.retried, 'point')} at which an earlier process died or ran out of "
            "memory or time_limit."
        )


def _errors(row: Mapping[Any, Any]) -> tuple[str, ...]:
    """One row of `_ERRORS`."""
    return str(row["rows"]), number(row["rms"], 2), number(row["expected"], 2), f"{row['p']:.2g}"


def _print_verdicts(verdicts: pd.DataFrame, best: CaseFound) -> None:
    rows = []
    for r in verdicts.to_dict("records"):
        spread = "" if pd.isna(r["spread"]) else f"{100 * r['spread']:.0f} %"
        std = "–" if r["parameter"] in best.statistics.whole else "" if pd.isna(r["std"]) else f"{r['std']:.3g}"
        unit = "" if r["unit"] == "-" else f" {r['unit']}"
        rows.append(
            (r["parameter"], f"{r['value']:.5g}{unit}", std, f"{100 * r['ratio']:.0f} %", spread, r["sentence"])
        )
    heads = ("parameter", f"value in {best.name}", "std", "of range", "spread", "verdict")
    table(heads, rows, left=("verdict",))


def _print_points(answer: Calibration) -> None:
    """Objective of the search and sum of squares, at the end of the searches and of least squares."""
    rows = [
        (r["case"], r["point"], *(f"{r[name]:.5g}" for name in ("objective", "sum_of_squares", "prior", "total")))
        for case in answer.cases
        if case.search is not None and case.statistics.fit is not None
        for r in case.points.to_dict("records")
    ]
    if rows:
        say("What the search minimises (objective) and what least squares minimises (total), at the end of each:")
        table(("case", "point", "objective", "sum of squares", "prior", "total"), rows, left=("point",))


def _print_suspects(suspects: pd.DataFrame) -> None:
    """Single data whose removal would make the model fit."""
    guilty = suspects[suspects["explains"].astype(bool)].head(WORST_SHOWN)
    if len(guilty):
        rows = [
            (r["what"], str(r["rows"]), number(r["chi2"], 1), f"{r['p']:.2g}", f"{r['p_fit_without']:.2g}")
            for r in guilty.to_dict("records")
        ]
        say("\nThe model fits, to first order, if any one of these is left out:")
        table(("left out", "rows", "lowers the sum of squares by", "p", "p of the fit without"), rows)


def _tell_held_out(study: StudyFile) -> None:
    for part in study.parts:
        held, of = part.settings.held_out, f" in test {part.test}" if part.test != study.test else ""
        if held.modes or held.sensors:
            modes, sensors = (", ".join(names) or "none" for names in (held.modes, held.sensors))
            say(f"Held out{of}, never fitted: modes {modes}; sensors {sensors}.")
        if held.responses:
            say(f"Held out{of}, never fitted: {', '.join(held.responses)}.")


def _print_modes(modes: pd.DataFrame) -> None:
    stages = [stage for stage in ("initial", "before", "after") if f"error_{stage}" in modes]
    rows = [
        (
            str(r["mode"]) + (" (held out)" if r["held_out"] else ""),
            *(number(r[f"damped_freq_{stage}"], 3) for stage in ("measured", *stages)),
            *("" if pd.isna(r[f"error_{s}"]) else f"{100 * r[f'error_{s}']:+.2f} %" for s in stages),
            *(number(r[f"mac_{stage}"], 3) for stage in stages),
        )
        for r in modes.to_dict("records")
    ]
    say("Damped frequencies of every measured mode:")
    heads = [f"{kind} {stages[0]}" if stage is stages[0] else stage for kind in ("error", "MAC") for stage in stages]
    table(("mode", "measured Hz", *stages, *heads), rows)


def _print_responses(responses: pd.DataFrame) -> None:
    rows = [
        (
            str(r["response"]) + (" (held out)" if r["held_out"] else ""),
            *(f"{r[stage]:.6g}" for stage in ("measured", "before", "after")),
            *("" if pd.isna(r[f"error_{s}"]) else f"{100 * r[f'error_{s}']:+.2f} %" for s in ("before", "after")),
        )
        for r in responses.to_dict("records")
    ]
    say("Every measured response:")
    table(("response", "measured", "before", "after", "error before", "error after"), rows)


def _print_answer(answer: ComparisonResult) -> None:
    if answer.comparison is None:
        responses = [
            (r["response"], f"{r['measured']:.6g}", f"{r['model']:.6g}", f"{100 * r['error']:+.2f} %")
            for r in answer.table.to_dict("records")
        ]
        table(("response", "measured", "model", "error"), responses)
        return
    rows = []
    for r in answer.table.to_dict("records"):
        paired = not math.isnan(r["natural_freq_model"])
        rows.append(
            (
                str(r["mode"]),
                str(r["model_mode"]) if paired else "",
                f"{r['natural_freq_measured']:.3f}",
                f"{r['natural_freq_model']:.3f}" if paired else "not paired",
                f"{100 * r['freq_error']:+.2f} %" if paired else "",
                *(number(r[name], 4) for name in ("damping_ratio_measured", "damping_ratio_model")),
                *(number(r[name], 3) for name in ("mac", "emac", "margin")),
            )
        )
    heads = ("mode", "model mode", "measured Hz", "model Hz", "error", "damping", "model", "MAC", "EMAC", "margin")
    table(heads, rows)
    paired_count = sum(1 for r in rows if r[3] != "not paired")
    mean = f"mean error {100 * answer.mean_freq_error:.2f} % over {paired_count} of {count(len(rows), 'mode')}"
    say(f"Frequencies are natural ones (|lambda|/2pi); {mean}.")
    if not math.isnan(answer.mean_mac):
        say(f"Mean MAC {answer.mean_mac:.4f}; noise alone allows {number(answer.noise_mac, 4) or 'an unknown value'}.")
