"""What a comparison and a sensitivity analysis have to say."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

from calib.analyses.provenance.record import assumptions_table, check_repeats
from calib.api.entries.entry import Entry, Rows, Warned, When, Words, count, decimals, off
from calib.measurement.places import Doubt
from calib.problem.parameter import unit_words
from calib.results.results import Results
from calib.study.study_file import shell_argument

if TYPE_CHECKING:
    from calib.analyses.compare import ComparisonResult
    from calib.analyses.refine import Refined
    from calib.analyses.screening import Screening
    from calib.analyses.sensitivity import Sensitivity
    from calib.study.several import AnyStudy
    from calib.study.study import LoadedStudy

_FUNCTIONS, _INPUTS = 24, 4
"""FRFs, and inputs of a metamodel, that are printed; the tables in the results folder have all."""
WORST = 6
"""Rows of the largest deviations; the table in the results folder has all."""


def compared_entries(study: LoadedStudy, result: ComparisonResult, folder: Results | None = None) -> list[Entry]:
    """A comparison without a fit; ``folder`` has its tables."""
    out: list[Entry] = [
        *map(Words, held_out(study)),
        *(Words(f"Measurement: {note}.") for note in study.experiment.notes if not isinstance(note, Doubt)),
        *map(Warned, check_repeats(study)),
        *map(Warned, result.hints),
        *(Warned(finding.warning) for finding in result.sensor_findings),
        pair_entries(result),
        *more_on_pairs(result),
        *(Words(sentence) for sentence in result.sentences if sentence not in result.hints),
    ]
    if result.comparison is not None:
        rows = [
            (r["kind"], r["what"], decimals(r["value"], 3), decimals(r["in_std"], 1), r["verdict"])
            for r in result.comparison.where_it_fails().to_dict("records")
        ]
        heads = ("kind", "what", "value", "in standard deviations", "verdict")
        out.append(Rows.of("Largest deviations:", heads, rows, ("what", "verdict"), most=WORST))
    assumed = assumptions_table(study)
    if len(assumed):
        where = "" if folder is None else f"; the reasons are in {folder.path / 'assumptions.csv'}"
        out.append(Words(f"\nAssumed, not published or measured ({count(len(assumed), 'item')}{where}):"))
    for row in assumed.to_dict("records"):
        out.append(Words(f"  {row['item']}: {row['value']}{unit_words(row['unit'])}"))
    return out


def undamped_entries(result: ComparisonResult) -> list[Entry]:
    """Undamped frequencies of the paired modes beside the damped ones; why there are none, for other models."""
    if result.undamped is None:
        return [Words("Undamped frequencies are those of a model with matrices and of a test by modes.", when="always")]
    rows = [
        (
            r["mode"], f"{r['natural_freq_measured']:.3f}", f"{r['undamped_freq_model']:.3f}",
            off(r["undamped_error"]), f"{r['natural_freq_model']:.3f}", f"{r['damped_freq_model']:.3f}",
            decimals(r["alike"], 3),
        )
        for r in result.undamped.to_dict("records")
    ]  # fmt: skip
    heads = ("mode", "measured Hz", "undamped Hz", "error", "|lambda|/2pi Hz", "damped Hz", "alike")
    return [Rows.of("Undamped frequencies (stiffness and mass alone):", heads, rows)]


def pair_entries(result: ComparisonResult, title: str = "", when: When = "always") -> Rows:
    """Every measured mode or response with that of the model."""
    table = result.table.to_dict("records")
    if result.frfs is not None:
        return _functions(table, title, when)
    if result.comparison is None:
        responses = [(r["response"], f"{r['measured']:.6g}", f"{r['model']:.6g}", off(r["error"])) for r in table]
        return Rows.of(title, ("response", "measured", "model", "error"), responses, when=when)
    rows = []
    for r in table:
        paired = not math.isnan(r["natural_freq_model"])
        rows.append(
            (
                str(r["mode"]),
                str(r["model_mode"]) if paired else "",
                f"{r['natural_freq_measured']:.3f}",
                f"{r['natural_freq_model']:.3f}" if paired else "not paired",
                off(r["freq_error"]) if paired else "",
                *(decimals(100 * r[name], 2) for name in ("damping_ratio_measured", "damping_ratio_model")),
                decimals(r["mac"], 3),
            )
        )
    heads = ("mode", "model mode", "measured Hz", "model Hz", "error", "damping %", "model %", "MAC")
    of = f"{title.removesuffix(':')}, natural" if title else "Natural"
    return Rows.of(f"{of} frequencies (|lambda|/2pi of the eigenvalue lambda):", heads, rows, when=when)


def _functions(table: Iterable[Mapping[Hashable, Any]], title: str, when: When) -> Rows:
    """Every FRF with the criteria of `calib.correlation.frf.comparison`."""
    rows = []
    for r in table:
        name = f"{r['response']}/{r['reference']}"
        criteria = (decimals(r["frac"], 3), decimals(r["amplitude"], 3), f"{100 * r['error']:.1f} %")
        rows.append((name, str(r["lines"]), *criteria, decimals(r["in_std"], 2)))
    heads = ("FRF", "lines", "FRAC", "amplitude", "error", "in standard deviations")
    return Rows.of(title, heads, rows, when=when, most=_FUNCTIONS)


def more_on_pairs(result: ComparisonResult) -> Iterator[Rows]:
    """EMAC and margin of every pair."""
    if result.comparison is not None and result.table["emac"].notna().any():
        rows = [
            (str(r["mode"]), *(decimals(r[name], 3) for name in ("mac", "emac", "margin")))
            for r in result.table.to_dict("records")
        ]
        yield Rows.of("How certain the pairs are:", ("mode", "MAC", "EMAC", "margin"), rows, when="verbose")


def held_out(study: AnyStudy) -> Iterator[str]:
    """What is held out, in words."""
    for one in study.studies:
        if words := one.experiment.held_out_words:
            yield f"Held out{f' in test {one.test}' if one.test != study.test else ''}, never fitted: {words}."


def failed_entries(why: str, study: AnyStudy) -> list[Warned]:
    """Why points failed, and the command that evaluates them once more."""
    if not why or study.in_memory:
        return [Warned(why)] if why else []
    command = f"calib again {shell_argument(study.file)}"
    return [Warned(f"{why} Failed points are not evaluated again, unless by: {command}")]


def sensitivity_entries(study: AnyStudy, result: Sensitivity | Screening) -> list[Entry]:
    """A sensitivity analysis by any method."""
    from calib.analyses.sensitivity import Sensitivity

    return _samples(study, result) if isinstance(result, Sensitivity) else _screening(study, result)


def _samples(study: AnyStudy, result: Sensitivity) -> list[Entry]:
    """A sensitivity analysis by rank correlations."""
    measures = ("max_spearman", "max_partial", "max_variance_share")
    table = result.assessment.selection.sort_values("selected", ascending=False, kind="stable").to_dict("records")
    rows = [
        (r["parameter"], *(decimals(r[name], 2) for name in measures), "yes" if r["selected"] else "no") for r in table
    ]
    reasons = [(r["parameter"], r["why"]) for r in table]
    out: list[Entry] = [*([Warned(result.wide)] if result.wide else []), *failed_entries(result.why_failed, study)]
    out += [
        Rows.of("", ("parameter", "Spearman", "partial", "variance share", "selected"), rows, most=20),
        Rows.of("Why:", ("parameter", "why"), reasons, ("why",), when="verbose"),
        _prognosed(result.prognosis.table),
        *(Words(sentence) for sentence in result.sentences if sentence not in (result.wide, result.why_failed)),
    ]
    if any(one.model.space.constraints for one in study.studies):
        out.append(Words("Constraints correlate the sampled parameters; Spearman's coefficients alone may mislead."))
    return out


def refined_entries(result: Refined) -> list[Entry]:
    """The new runs, and the errors of the metamodels with and without them."""
    inputs = list(result.runs.columns[: result.runs.columns.get_loc("weight")])
    runs = [tuple(f"{row[name]:.5g}" for name in [*inputs, "weight"]) for row in result.runs.to_dict("records")]
    columns = [c for c in result.table.columns[1:] if not (result.proposed and c.endswith("_after"))]
    errors = [
        (str(row["response"]), *("" if pd.isna(row[c]) else f"{row[c]:.3g}" for c in columns))
        for row in result.table.to_dict("records")
    ]
    words = {"cop": "CoP", "error": "error", "error_near": "error near the measurement"}
    heads = [words[c.removesuffix("_after")] + ", with them" * c.endswith("_after") for c in columns]
    return [
        Rows.of("Proposed runs:" if result.proposed else "New runs:", (*inputs, "weight"), runs, left=inputs),
        Rows.of("Metamodels:", ("response", *heads), errors),
        *(Words(sentence) for sentence in result.sentences),
    ]


def _largest(inputs: list[str]) -> str:
    return ", ".join(inputs[:_INPUTS]) + (f" and {len(inputs) - _INPUTS} more" if len(inputs) > _INPUTS else "")


def _prognosed(table: pd.DataFrame) -> Rows:
    """Metamodels of the responses."""
    rows = [
        (
            str(r["response"]), str(r["model"]), decimals(r["cop"], 3),
            f"{decimals(r['lower'], 2)} to {decimals(r['upper'], 2)}" if pd.notna(r["cop"]) else "",
            _largest(str(r["inputs"]).split(", ")),
        )
        for r in table.to_dict("records")
    ]  # fmt: skip
    heads = ("response", "metamodel", "CoP", "95 %", "inputs")
    return Rows.of("How well metamodels predict the responses:", heads, rows, ("inputs",), most=_FUNCTIONS)


def _screening(study: AnyStudy, result: Screening) -> list[Entry]:
    """A sensitivity analysis by Morris or Sobol."""
    size = "mu_star" if result.method == "morris" else "ST"
    names = result.table["parameter"].drop_duplicates()
    known = result.table.dropna(subset=[size]).sort_values(size, ascending=False, kind="stable")
    largest = known.drop_duplicates("parameter").set_index("parameter")
    rows = [(str(n), f"{r[size]:.3g}", str(r["response"])) for n, r in largest.iterrows()]
    rows += [(str(n), "", "no response: too few are known, or none changes") for n in names if n not in largest.index]
    return [
        *failed_entries(result.why_failed, study),
        Rows.of("", ("parameter", f"largest {size}", "on"), rows, most=20),
        *(Words(sentence) for sentence in result.sentences if sentence != result.why_failed),
    ]
