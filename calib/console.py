"""What the command says: short tables and sentences on the terminal."""

from __future__ import annotations

import codecs
import io
import math
import sys
import traceback
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from calib.missing.findings import Findings
from calib.missing.verdict import rounded
from calib.questions.added import WORDS, Added, by_group, to_add
from calib.questions.calibrate import Calibration
from calib.questions.case import CaseFound
from calib.questions.compare import Answer
from calib.questions.explanation import Explanation
from calib.questions.extend import Extension
from calib.questions.joint_calibration import Fitted, JointCalibration
from calib.questions.record import assumptions_table, check_repeats
from calib.questions.sensitivity import Screening, Sensitivity
from calib.questions.versions import Versions
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile, shell_argument
from calib.version import __version__

WIDTH = 120
"""Columns of output that goes to no terminal."""

_out = Console(highlight=False, markup=False, soft_wrap=True, width=None if sys.stdout.isatty() else WIDTH)
_err = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)

WORST_SHOWN = 8
"""Rows of where a model fails, which the table beside it tells whole."""
ASSUMPTIONS_SHOWN = 60
"""Assumed values; a longer list, such as the vehicle's of 88, is better read in its file."""


_PLAIN = str.maketrans({"\u2212": "-", "\u2013": "-", "\u2014": "-", "\u2192": "->", "\u00d7": "x", "\u2026": "..."})
"""For streams whose code page has no such characters."""


def _in_code_page(fault: UnicodeError) -> tuple[str, int]:
    """What stands for characters that a stream cannot write: a plain one of the same meaning, or a question mark."""
    if not isinstance(fault, UnicodeEncodeError):
        raise fault
    text = fault.object[fault.start : fault.end].translate(_PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), fault.end


def write_to_any_code_page() -> None:
    """Let output go to a terminal or file of any code page; no character ends a command."""
    codecs.register_error("calib", _in_code_page)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower().replace("-", "") != "utf8":
            stream.reconfigure(errors="calib")


def say(text: str = "") -> None:
    """One line of output."""
    _out.print(text)


def complain(text: str) -> None:
    """One line on the error stream."""
    _err.print(f"calib: {text}")


def complain_of_input(fault: InputError, arguments: list[str]) -> None:
    """One line for what the user has to mend; the traceback of a fault in his own code goes to the log."""
    text = str(fault)
    log = None if fault.__cause__ is None else _log(" ".join(arguments), traceback.format_exc())
    complain(text if log is None else f"{text.rstrip('.')}; the traceback is in {log}.")


def complain_of_unexpected(fault: Exception, arguments: list[str]) -> None:
    """One line for what should not happen; its traceback goes to a log in the current directory."""
    log = _log(" ".join(arguments), traceback.format_exc())
    if log is not None:
        complain(f"unexpected {type(fault).__name__}: {fault}; the details are in {log}")


def tell_traces(asked: str, traces: Sequence[str]) -> None:
    """Put tracebacks of a user's code, without which an answer was found, into the log, and tell where they are."""
    log = _log(asked, "\n".join(traces)) if traces else None
    if log is not None:
        say(f"The traceback is in {log}.")


def _log(asked: str, trace: str) -> Path | None:
    """Put a traceback into a log in the current directory; where it cannot be, tell it."""
    log = Path.cwd() / "calib-error.log"
    stamp = datetime.now(UTC).isoformat(timespec="seconds")
    text = f"{stamp} calib {__version__}: {asked}\n{trace}\n"
    try:
        with log.open("a", encoding="utf-8") as stream:
            stream.write(text)
    except OSError:
        complain(text)
        return None
    return log


def head(study: StudyFile, verb: str) -> None:
    """Title line of one answer."""
    label = "  [synthetic measurement]" if study.synthetic else ""
    _out.print(f"\n{study.settings.title}: {verb}{label}", style="bold")


def tell_stale(rows: int) -> None:
    """Mention results of another state of the study."""
    if rows:
        belong, they = ("belongs", "it is") if rows == 1 else ("belong", "they are")
        rest = f"{belong} to another state of model or measurement; {they} kept and not used."
        say(f"{_count(rows, 'earlier evaluation')} {rest}")


# -- answers -----------------------------------------------------------------------------------------------------------


def tell_comparison(study: Study, answer: Answer, folder: Results) -> None:
    """The comparison before anything is fitted."""
    _tell_withheld(study)
    for note in study.measurement_notes:
        say(f"Measurement: {note}.")
    for sentence in check_repeats(study):
        _out.print(sentence, style="yellow")
    for hint in answer.hints:
        _out.print(hint, style="yellow")
    for finding in answer.findings:
        _out.print(f"Check this sensor: {finding.sentence}", style="yellow")
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
            (r["kind"], r["what"], _number(r["value"], 3), _number(r["in_scatter"], 1), r["verdict"])
            for r in worst.to_dict("records")
        ]
        _table(("kind", "what", "value", "in units of scatter", "verdict"), rows)
    else:
        for sentence in answer.scatter:
            say(sentence)
    assumed = assumptions_table(study)
    if len(assumed):
        where = folder.path / "assumptions.csv"
        say(f"\nAssumed, not published or measured ({_count(len(assumed), 'item')}; the reasons are in {where}):")
        for row in assumed.head(ASSUMPTIONS_SHOWN).to_dict("records"):
            unit = "" if row["unit"] == "-" else f" {row['unit']}"
            say(f"  {row['item']}: {row['value']}{unit}")


def tell_sensitivity(study: Study, answer: Sensitivity, folder: Results) -> None:
    """Which parameters matter."""
    behind, *why, selected = answer.sentences
    for sentence in (behind, *why):
        say(sentence)
    rows = [
        (
            r["parameter"],
            *(_number(r[name], 2) for name in ("max_spearman", "max_partial", "max_influence")),
            "yes" if r["selected"] else "no",
            r["why"],
        )
        for r in answer.assessment.selection.to_dict("records")
    ]
    _table(("parameter", "Spearman", "partial", "influence", "selected", "why"), rows, left=("why",))
    say(selected)
    if study.model.space.constraints:
        say("Constraints correlate the sampled parameters with each other; Spearman's values alone may mislead.")


def tell_screening(answer: Screening, folder: Results) -> None:
    """Elementary effects or variance shares."""
    size = "mu_star" if answer.method == "morris" else "ST"
    names = answer.table["parameter"].drop_duplicates()
    known = answer.table.dropna(subset=[size]).sort_values(size, ascending=False, kind="stable")
    largest = known.drop_duplicates("parameter").set_index("parameter")
    found = [(n, largest.loc[n, size], largest.loc[n, "response"]) for n in names if n in largest.index]
    rows = [(str(n), f"{value:.3g}", str(response)) for n, value, response in found]
    rows += [(str(n), "", "no response: too few are known, or none changes") for n in names if n not in largest.index]
    say(f"{_count(answer.points, 'point')}. {answer.note}".rstrip())
    _table(("parameter", f"largest {size}", "on"), rows)
    say(f"All of them are in {folder.path / (answer.method + '.csv')}.")


def tell_calibration(study: StudyFile, answer: Fitted, folder: Results) -> None:
    """Cases, parameters, before and after; of several tests what all determine, and what each says of it."""
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
    _table(("case", "search", "at full order", "reported", *counts, "time"), cases)
    _print_points(answer)
    best = answer.best
    _print_verdicts(answer.verdicts, best)
    for sentence in answer.sentences:
        if sentence not in answer.contradictions:  # told at the end, beside the errors they rest on
            say(sentence)
    if answer.retried:
        say(
            f"Asked again, as by every command: {_count(answer.retried, 'point')} at which a process had died, or "
            "run out of memory or of time_limit."
        )
    _print_suspects(best.judgement.suspects)
    say(f"\nAfter calibration (case {best.name}):")
    _print_answer(best.answer)
    for warning in best.answer.warnings:
        _out.print(warning, style="yellow")
    before, after = answer.before, best.answer
    label = "error" if before.comparison is None else "frequency error"
    say(f"Mean {label} {100 * before.mean_freq_error:.2f} % -> {100 * after.mean_freq_error:.2f} %.")
    if not math.isnan(after.mean_mac):
        allowed = "" if math.isnan(after.noise_mac) else f" (noise alone allows {after.noise_mac:.4f})"
        say(f"Mean MAC {before.mean_mac:.4f} -> {after.mean_mac:.4f}{allowed}.")
    _tell_withheld(study)
    if answer.modes is not None and study.settings.withheld.modes:
        _print_modes(answer.modes)
    if answer.responses is not None:
        _print_responses(answer.responses)
    held = study.settings.withheld
    if answer.errors is not None and (held.modes or held.sensors or held.responses):
        say("Errors in units of the scatter:")
        _table(("data", *_ERRORS), [(WORDS[r["group"]], *_errors(r)) for r in answer.errors.to_dict("records")])
    for sentence in answer.contradictions:
        _out.print(sentence, style="yellow")


def _tell_joint_calibration(answer: JointCalibration, folder: Results) -> None:
    first = next(iter(answer.tests.values()))
    _print_verdicts(answer.verdicts, first.best)
    for sentence in answer.sentences:
        say(sentence)
    rows = [
        (test, WORDS[r["group"]], *_errors(r))
        for test, one in answer.tests.items()
        if one.errors is not None
        for r in one.errors.to_dict("records")
    ]
    say("Errors in units of the scatter:")
    _table(("test", "data", *_ERRORS), rows, left=("data",))
    say(f"What all tests say is in {folder.path}, what each says by itself beside it.")


_ERRORS = ("rows", "rms", "of a right model", "p")


def _errors(row: Mapping[Any, Any]) -> tuple[str, ...]:
    """One row of `_ERRORS`."""
    return str(row["rows"]), _number(row["rms"], 2), _number(row["expected"], 2), f"{row['p']:.2g}"


def _print_verdicts(verdicts: pd.DataFrame, best: CaseFound) -> None:
    rows = []
    for r in verdicts.to_dict("records"):
        spread = "" if pd.isna(r["spread"]) else f"{100 * r['spread']:.0f} %"
        std = "–" if r["parameter"] in best.judgement.whole else "" if pd.isna(r["std"]) else f"{r['std']:.3g}"
        unit = "" if r["unit"] == "-" else f" {r['unit']}"
        rows.append(
            (r["parameter"], f"{r['value']:.5g}{unit}", std, f"{100 * r['ratio']:.0f} %", spread, r["sentence"])
        )
    heads = ("parameter", f"value in {best.name}", "std", "of range", "spread", "verdict")
    _table(heads, rows, left=("verdict",))


def _print_points(answer: Calibration) -> None:
    """Both criteria where searches and least squares ended, side by side."""
    rows = [
        (r["case"], r["point"], *(f"{r[name]:.5g}" for name in ("objective", "sum_of_squares", "prior", "total")))
        for case in answer.cases
        if case.search is not None and case.judgement.fit is not None
        for r in case.points.to_dict("records")
    ]
    if rows:
        say("What the search makes small (objective) and what least squares do (total), where each of them ended:")
        _table(("case", "point", "objective", "sum of squares", "prior", "total"), rows, left=("point",))


def _print_suspects(table: pd.DataFrame) -> None:
    """Data without each of which everything fits."""
    guilty = table[table["explains"].astype(bool)].head(WORST_SHOWN)
    if len(guilty):
        rows = [
            (r["what"], str(r["rows"]), _number(r["chi2"], 1), f"{r['p']:.2g}", f"{r['p_fit_without']:.2g}")
            for r in guilty.to_dict("records")
        ]
        say("\nWithout any one of these everything fits, to first order:")
        _table(("left out", "rows", "lowers the sum of squares by", "p", "p of the fit without"), rows)


def tell_extension(extension: Extension) -> None:
    """The new study that was written, and what to ask of it."""
    effects, folder = extension.effects, extension.file.parent
    more = "one effect" if len(effects) == 1 else f"{len(effects)} effects"
    named = " and ".join(f"{effect.title} ({effect.name})" for effect in effects)
    say(f"Written: {folder}, which builds on the same study and has {more} more in its model: {named}.")
    if extension.selected:
        say(f"Its calibration may change {', '.join(extension.selected)} too.")
    else:
        names = ", ".join(name for effect in effects for name in effect.names)
        say(f"Its model has {names} too; the study leaves the selection to 'calib sensitivity'.")
    if extension.aside is not None:
        say(f"The study that was there had been changed, and is kept as {extension.aside}, without its answers.")


def tell_added(answer: Added, extension: Extension, folder: Results) -> None:
    """What was added, the errors before and after on every group of data, and where the extended study is."""
    rows = [
        (WORDS[r["group"]], str(r["rows_after"]), *(_number(r[f"rms_{stage}"], 2) for stage in ("before", "after")),
         _number(r["expected_after"], 2), *(f"{r[f'p_{stage}']:.2g}" for stage in ("before", "after")))
        for r in by_group(answer.errors).to_dict("records")
    ]  # fmt: skip
    if rows:
        say("Both models calibrated alike; rms errors in units of the scatter:")
        _table(("data", "rows", "before", "after", "of a right model", "p before", "p after"), rows)
    say(answer.sentence)
    say(f"\nThe extended study, to be opened, moved or gone on with: {extension.file.parent}")
    say(f"Its own answers: {folder.path}")


def tell_explanation(study: StudyFile, answer: Explanation, folder: Results) -> None:
    """The verdict, the ranked effects, and the errors on data that were used and not used."""
    _tell_withheld(study)
    for note in answer.notes:
        _out.print(note, style="yellow")
    _out.print(f"\n{answer.verdict}", style="bold")
    say(answer.sentence)
    _print_suspects(answer.tables["suspects_explained"])
    say()
    rows = []
    for r in answer.effects.to_dict("records"):
        unit = "" if r["unit"] == "-" else f" {r['unit']}"
        phi = f"{r['phi']:.3g} [{r['phi_low']:.3g}, {r['phi_high']:.3g}]{unit}" if r["refitted"] else ""
        least = f"{rounded(r['phi_min'])}{unit}" if math.isfinite(r["phi_min"]) else ""
        least = ", ".join([*([least] if least else []), *([] if r["visible"] else ["not visible"])])
        remark = "credible" if r["credible"] else r["implausible"]
        numbers = (_number(r["z"], 1), _number(r["ln_bayes"], 1))
        if not r["refitted"] and numbers[1]:
            numbers = numbers[0], f"{numbers[1]} (linear)"
        rows.append((r["name"], *numbers, _number(r["gamma"], 2), phi, least, remark))
    heads = ("effect", "z", "ln Bayes", "gamma", "strength, 95 %", "smallest visible", "remark")
    if rows:
        _table(heads, rows, left=("remark",))
    found = answer.findings
    counts = len(answer.tables["atoms"]), len(answer.tables["tried"])
    tests = (
        f"{_count(sum(len(g.names) for g in found.groups), 'effect')} and {_count(counts[0], 'local change')} tested"
    )
    work = f"{_count(counts[1], 'model')} fitted, {_count(found.evaluations, 'model evaluation')}"
    say(f"\n{tests}, {work}, {answer.seconds:.0f} s.")
    if rows:
        against = "ln Bayes is against the base model, for the plausible size of each effect"
        say(f"z is a score and no probability; {against}.")
    if len(answer.errors):
        errors = [(str(r["group"]), str(r["stage"]), *_errors(r)) for r in answer.errors.to_dict("records")]
        name = "" if found.chosen is None else " and ".join(found.chosen.names)
        label = f" and after with {name}" if name else ""
        if (answer.errors["stage"] == "attempt").any():
            label = f" and with {name}: best attempt, not believed"
        say(f"\nErrors in units of the scatter, before{label}:")
        _table(("data", "stage", *_ERRORS), errors)


def tell_what_to_add(study: StudyFile, found: Findings) -> None:
    """The command that adds what was named, where it has no rival."""
    if named := to_add(found):
        them = "them" if len(named.names) > 1 else "it"
        say(f"Add {them} with: calib extend {shell_argument(study.file)} {' '.join(named.names)} --into FOLDER")


def tell_versions(versions: Versions) -> None:
    """Errors over the versions of a model that has been extended, and which of them are not known."""
    rows = [
        (str(r["study"]), str(r["effects"]) or "none", str(r["group"]), _number(r["rms"], 2), _number(r["expected"], 2))
        for r in versions.table.to_dict("records")
    ]
    if rows:
        say("\nErrors in units of the scatter over the versions of the model:")
        _table(("study", "effects", "data", "rms", "of a right model"), rows, left=("effects", "data"))
    for note in versions.notes:
        _out.print(note, style="yellow")


def tell_figures(paths: Sequence[Path]) -> None:
    """Where the pictures are."""
    if paths:
        say("\nFigures, each beside its table:")
        for path in paths:
            say(f"  {path}")


def tell_outdated(sentences: Mapping[str, str]) -> None:
    """Answers beside the present one that are of another state of the study."""
    for sentence in sentences.values():
        _out.print(f"\n{sentence}", style="yellow")


def tell_kept(paths: Sequence[Path]) -> None:
    """Files that were in the way of results and that calib did not write."""
    for path in paths:
        say(f"\nKept under another name, since calib did not write it or it was changed since: {path}")


def tell_report(path: Path) -> None:
    """Where the report is."""
    say(f"\nThe whole story, in one file that opens offline: {path}")


def _tell_withheld(study: StudyFile) -> None:
    for part in study.parts:
        held, of = part.settings.withheld, f" in test {part.test}" if part.test != study.test else ""
        if held.modes or held.sensors:
            modes, sensors = (", ".join(names) or "none" for names in (held.modes, held.sensors))
            say(f"Withheld{of}, never fitted: modes {modes}; sensors {sensors}.")
        if held.responses:
            say(f"Withheld{of}, never fitted: {', '.join(held.responses)}.")


def _print_modes(modes: pd.DataFrame) -> None:
    stages = [stage for stage in ("initial", "before", "after") if f"error_{stage}" in modes]
    rows = [
        (
            str(r["mode"]) + (" (withheld)" if r["withheld"] else ""),
            *(_number(r[f"damped_freq_{stage}"], 3) for stage in ("measured", *stages)),
            *("" if pd.isna(r[f"error_{s}"]) else f"{100 * r[f'error_{s}']:+.2f} %" for s in stages),
            *(_number(r[f"mac_{stage}"], 3) for stage in stages),
        )
        for r in modes.to_dict("records")
    ]
    say("Damped frequencies of every measured mode:")
    heads = [f"{kind} {stages[0]}" if stage is stages[0] else stage for kind in ("error", "MAC") for stage in stages]
    _table(("mode", "measured Hz", *stages, *heads), rows)


def _print_responses(responses: pd.DataFrame) -> None:
    rows = [
        (
            str(r["response"]) + (" (withheld)" if r["withheld"] else ""),
            *(f"{r[stage]:.6g}" for stage in ("measured", "before", "after")),
            *("" if pd.isna(r[f"error_{s}"]) else f"{100 * r[f'error_{s}']:+.2f} %" for s in ("before", "after")),
        )
        for r in responses.to_dict("records")
    ]
    say("Every measured response:")
    _table(("response", "measured", "before", "after", "error before", "error after"), rows)


def _print_answer(answer: Answer) -> None:
    if answer.comparison is None:
        plain = [
            (r["response"], f"{r['measured']:.6g}", f"{r['model']:.6g}", f"{100 * r['error']:+.2f} %")
            for r in answer.table.to_dict("records")
        ]
        _table(("response", "measured", "model", "error"), plain)
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
                *(_number(r[name], 4) for name in ("damping_ratio_measured", "damping_ratio_model")),
                *(_number(r[name], 3) for name in ("mac", "emac", "margin")),
            )
        )
    heads = ("mode", "model mode", "measured Hz", "model Hz", "error", "damping", "model", "MAC", "EMAC", "margin")
    _table(heads, rows)
    paired_count = sum(1 for r in rows if r[3] != "not paired")
    mean = f"mean error {100 * answer.mean_freq_error:.2f} % over {paired_count} of {_count(len(rows), 'mode')}"
    say(f"Frequencies are natural ones (|lambda|/2pi); {mean}.")
    if not math.isnan(answer.mean_mac):
        say(f"Mean MAC {answer.mean_mac:.4f}; noise alone allows {_number(answer.noise_mac, 4) or 'an unknown value'}.")


def _count(number: int, thing: str) -> str:
    """Something in its number."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _number(value: float, digits: int) -> str:
    return "" if pd.isna(value) else f"{value:.{digits}f}"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[str] = ()) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for k, name in enumerate(heads):
        table.add_column(name, justify="left" if k == 0 or name in left else "right", no_wrap=False, overflow="fold")
    for row in rows:
        table.add_row(*row)
    _out.print(table)
