"""Comparison of model and measurement at one point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from calib.analyses.answers import enumerated, of_comparison
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import traced
from calib.analyses.provenance.state import ORTHOGONALITY
from calib.analyses.uncertainty import std_notes
from calib.correlation.frf.comparison import FRFComparison
from calib.correlation.frf.gross_errors import GrossError, gross_errors
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.mesh_error import write_geometry
from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.expansion import ExpandedShapes, Orthogonality, deflections, expanded_shapes, orthogonality
from calib.correlation.modal.found_twice import FoundTwice, found_twice
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.rigid import numbers_hints, unpaired_sentence, unpaired_table
from calib.correlation.modal.sensors import suspicious_sensors
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.rules import RULES
from calib.correlation.units import frequency_hint, response_hints
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import as_cause, named_responses
from calib.experiment.test import ForwardProblem
from calib.measurement.check import SensorFinding, place_hints
from calib.measurement.doubts import doubts_of, modal_doubts
from calib.measurement.partners import NodePartners
from calib.results.answer import Answer, signed
from calib.results.results import Results
from calib.structure.located import sensor_partners
from calib.study.study import LoadedStudy


@dataclass(frozen=True)
class ComparisonResult:
    """Model against measurement at one point.

    Attributes
    ----------
    table : DataFrame
        ``comparison_*.csv``.
    mean_freq_error : float
        Mean absolute frequency error over the paired modes; of scalar responses and FRFs the mean relative error.
    mean_mac : float
        Over the paired modes; NaN without shapes. Of FRFs the mean FRAC.
    noise_mac : float
        Mean MAC that noise alone would allow a perfect model; NaN where unknown.
    comparison : Comparison or None
        Of modes.
    frfs : FRFComparison or None
        Of FRFs.
    sensor_findings : tuple of SensorFinding
        Suspicious sensors.
    chosen : mapping from str to int
        Measured modes that the user has paired, with the number of their model mode.
    hints : tuple of str
        Values that look like other units.
    std_notes : tuple of str
        Caveats on the standard deviations; see `calib.analyses.uncertainty`.
    gross_errors : tuple of GrossError
        Of FRFs.
    unit_hints : tuple of str
        Those of the hints that concern the units of the measurement.
    found_twice : tuple of FoundTwice
        Measured modes that look like one.
    data_doubts : tuple of str
        Those of the hints on measured modes that contradict themselves; see `calib.measurement.doubts.modal_doubts`.
    partners : NodePartners or None
        Measured nodes on the model, by distance; None where numbers decide.
    """

    table: pd.DataFrame
    mean_freq_error: float
    mean_mac: float
    noise_mac: float
    comparison: Comparison | None
    frfs: FRFComparison | None = None
    sensor_findings: tuple[SensorFinding, ...] = ()
    chosen: Mapping[str, int] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    std_notes: tuple[str, ...] = ()
    gross_errors: tuple[GrossError, ...] = ()
    unit_hints: tuple[str, ...] = ()
    data_doubts: tuple[str, ...] = ()
    partners: NodePartners | None = None
    found_twice: tuple[FoundTwice, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """What looks wrong in the measurement itself: units, signs and sensors."""
        sensors = (finding.warning for finding in self.sensor_findings)
        return (*self.data_doubts, *self.unit_hints, *(one.sentence for one in self.found_twice), *sensors)

    @property
    def checks(self) -> tuple[str, ...]:
        """What is to be checked in the measurement before anything else, such as ``sensors 1z, 2z``."""
        axes = [f"the axes of {one.whose}" for one in self.sensor_findings if one.whose]
        single = (finding.sensors for finding in self.sensor_findings if not finding.whose)
        doubtful = list(dict.fromkeys(name for names in single for name in names))
        sensors = [f"{'sensor' if len(doubtful) == 1 else 'sensors'} {enumerated(doubtful)}"] if doubtful else []
        data = ["the measured modes, whose values are doubtful"] if self.data_doubts else []
        errors = [*(error.check for error in self.gross_errors), *(twice.check for twice in self.found_twice)]
        unsure = self.comparison is not None and numbers_hints(self.comparison)
        numbers = ["places of the nodes, which are matched by number"] if unsure else []
        return (*data, *errors, *numbers, *axes, *sensors)

    @property
    def orthogonality(self) -> Orthogonality | None:
        """Mass-orthogonality of measured shapes; None without shapes, matrices or a way to expand them."""
        return self._orthogonality if isinstance(self._orthogonality, Orthogonality) else None

    @cached_property
    def _orthogonality(self) -> Orthogonality | str:
        """The same, or why there is none; empty where it is not to be expected."""
        found = self.comparison
        if found is None or not found.measured.has_shapes or found.model.reducible is None:
            return ""
        try:
            return orthogonality(found)
        except (InputError, EvaluationError) as fault:
            return str(fault)

    @cached_property
    def expanded(self) -> ExpandedShapes | None:
        """Measured shapes on the whole model by its paired modes, else by static expansion; None as above."""
        if self.orthogonality is None or self.comparison is None:
            return None
        try:
            return expanded_shapes(self.comparison)
        except InputError:
            return expanded_shapes(self.comparison, self.orthogonality.by)

    @cached_property
    def undamped(self) -> pd.DataFrame | None:
        """Frequencies of stiffness and mass alone; see `calib.correlation.modal.undamped.undamped_table`."""
        from calib.correlation.modal.undamped import undamped_table  # few comparisons need it

        return None if self.comparison is None else undamped_table(self.comparison)

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        return of_comparison(self)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Caveats on the comparison and, for modes, where the model fails."""
        found = self.comparison
        partners = [self.partners.sentence] if self.partners is not None else []
        if found is None:
            return (*self.hints, *partners, *self.std_notes)
        kinds = [root.kind for root in found.modes.excluded]
        out = [*partners, *self.std_notes]
        if kinds:
            parts = ", ".join(f"{kinds.count(k)} {k}" for k in dict.fromkeys(kinds))
            out.append(f"Eigenvalues of the model that are no vibration modes and are not paired: {parts}.")
        out += self.warnings
        if not found.measured.has_shapes:
            out.append(
                "No mode shapes were measured: modes are paired by ascending frequency, with gaps where model or "
                "measurement has an extra mode, and model modes are tracked by their own shapes when parameters change."
            )
            error = dict(zip(found.measured.names, np.abs(found.freq_error), strict=True))
            met = [f"measured {k} ({name}) matches model mode {j} within {_percent(error[name])}"
                   for k, name, j in found.shifts]  # fmt: skip
            if met:
                out.append(f"Mode numbers differ: {', '.join(met)}.")
        lost = unpaired_table(found)
        if lost["looks_rigid"].any():
            out.append(unpaired_sentence(lost, "The model"))
        if found.modes.groups:
            close = "; ".join(" and ".join(str(j + 1) for j in group) for group in found.modes.groups)
            out.append(
                f"Model modes closer in frequency than the measurement can tell: {close}. Their directions mean "
                "nothing: they are turned to the measured shapes inside the motion that they span."
            )
        if found.crossings:
            met = [f"{a} and {b}" for a, b in found.crossings]
            out.append(f"The order of the model modes differs from the measured one: {', '.join(met)} cross.")
        if self.chosen:
            listed = ", ".join(f"{mode} with model mode {number}" for mode, number in self.chosen.items())
            out.append(f"Paired as the study says and not as computed: {listed}.")
        checked = self._orthogonality
        if isinstance(checked, Orthogonality):
            out.append(checked.sentence)
        elif checked:
            out.append(f"Mass-orthogonality is not known: {checked}")
        return (*out, "Where it fails: " + found.sentence())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts about units and pairs."""
        found, out = self.comparison, list(self.hints)
        if found is not None and found.lost:
            out.append(
                f"The model modes of {', '.join(found.lost)} have no successor among the {found.modes.n_modes} "
                "that are solved here, so these measured modes have no partner: a larger mode_count may find them."
            )
        if found is not None and found.far:
            error = dict(zip(found.measured.names, found.freq_error, strict=True))
            listed = ", ".join(f"{name} ({signed(100 * error[name], 0)} %)" for name in found.far)
            out.append(
                f"More than {100 * RULES.far_error:.0f} % off in frequency: {listed}. Check the pairing and the units."
            )
        return tuple(out)


def comparison_at(study: LoadedStudy, values: Mapping[str, float]) -> ComparisonResult:
    """Compare a study's model and measurement at named values; raises as `comparison_of`."""
    return comparison_of(study.problem, values, (*study.hints, *_undrawn(study)), std_notes(study))


def _undrawn(study: LoadedStudy) -> tuple[str, ...]:
    """A note where no node or sensor has a location, so that modes cannot be drawn."""
    if study.whole is None or study.solved_model.mesh.placed.any():
        return ()
    return ("No location of the model's nodes or sensors is known: its modes are not drawn.",)


def comparison_of(
    problem: ForwardProblem, values: Mapping[str, float], hints: Sequence[str] = (), std_notes: Sequence[str] = ()
) -> ComparisonResult:
    """Compare model and measurement at named values; EvaluationError when the model cannot be solved there.

    Modes are paired, FRFs compared function by function, any other kind of data value by value. ``hints`` and
    ``std_notes`` are passed on to the result, with what must not be missed about the measurement.
    """
    partners = _partners(problem)
    told = () if partners is None else (f"Check this: {words}" for words in partners.warnings)
    hints = (*doubts_of(getattr(problem, "measured", None)), *told, *hints)
    if isinstance(problem, FRFProblem):
        found = FRFResidual(problem).compared(values)
        table = found.functions_table()
        wrong = gross_errors(found.measured, found.model)
        unit_hints = tuple(error.sentence for error in wrong)
        return ComparisonResult(
            table, _mean(table["error"]), _mean(table["frac"]), np.nan, None, found,
            hints=(*hints, *unit_hints), std_notes=tuple(std_notes), gross_errors=wrong, unit_hints=unit_hints,
            partners=partners,
        )  # fmt: skip
    if not isinstance(problem, ModalProblem):
        return _scalar_answer(problem, values, hints, std_notes)
    comparison = problem.compare(values)
    table = comparison.comparison_table()
    sensor_findings = suspicious_sensors(problem, comparison)
    mac = comparison.mac if comparison.measured.has_shapes else None
    words = frequency_hint(comparison.measured.natural_freq, comparison.modes.natural_freq, mac)
    unit_hints, twice = () if words is None else (words,), found_twice(comparison)
    return ComparisonResult(
        table=table,
        mean_freq_error=_mean(table["freq_error"].abs()),
        mean_mac=_mean(table["mac"]),
        noise_mac=_mean(pd.Series(comparison.noise_mac())),
        comparison=comparison,
        sensor_findings=sensor_findings,
        chosen=problem.override,
        hints=(
            *numbers_hints(comparison),
            *hints,
            *unit_hints,
            *(one.sentence for one in twice),
            *place_hints(comparison.measured, sensor_findings),
        ),
        std_notes=tuple(std_notes),
        unit_hints=unit_hints,
        data_doubts=modal_doubts(comparison.measured),
        partners=partners,
        found_twice=twice,
    )


def _partners(problem: ForwardProblem) -> NodePartners | None:
    """Measured nodes on the model; None where nothing was measured by sensors, or numbers decide."""
    if isinstance(problem, FRFProblem):
        return sensor_partners(problem.model, (*problem.measured.responses, *problem.measured.references))
    return sensor_partners(problem.model, problem.measured.sensors) if isinstance(problem, ModalProblem) else None


def _scalar_answer(
    problem: FunctionProblem, values: Mapping[str, float], hints: Sequence[str], std_notes: Sequence[str]
) -> ComparisonResult:
    responses = named_responses(problem.evaluate, values)
    rows = []
    targets = getattr(problem, "compared", problem.targets)  # of a kind of its own, the targets
    for name, (value, std) in targets.items():
        error = (responses[name] - value) / abs(value) if value else np.nan
        in_std = (responses[name] - value) / std if std else np.nan
        rows.append((name, value, responses[name], error, in_std))
    table = pd.DataFrame(rows, columns=["response", "measured", "model", "error", "error_in_std"])
    if units := getattr(problem, "units", {}):
        table["unit"] = [units.get(name, "") for name in table["response"]]
    measured = {name: value for name, (value, _) in problem.targets.items()}
    unit_hints = response_hints(measured, responses)
    return ComparisonResult(
        table, _mean(table["error"].abs()), np.nan, np.nan, None, hints=(*hints, *unit_hints),
        std_notes=tuple(std_notes), unit_hints=unit_hints,
    )  # fmt: skip


def nominal_comparison(study: LoadedStudy) -> ComparisonResult:
    """Compare the model at its nominal values with the measurement.

    Raises
    ------
    InputError
        Where it cannot be evaluated there; of a study in memory the EvaluationError itself.
    """
    nominal = study.model.space.values
    try:
        return comparison_at(study, nominal)
    except EvaluationError as fault:
        if study.in_memory:
            raise
        again = traced(study.problem, nominal, fault)
        check = "check parameter values, supports and mode_count"
        raise InputError(
            f"the model cannot be evaluated at its nominal values: {fault}",
            place=study.file,
            remedy=check if again.at is None else "correct the function that fails",
            at=again.at,
        ) from as_cause(again)


def compare(study: LoadedStudy, results: Results, undamped: bool = False) -> ComparisonResult:
    """Compare the model at its nominal values with the measurement; writes ``*_before`` tables, and undamped modes."""
    answer = nominal_comparison(study)
    begin_analysis(results, "compare")
    write_comparison(results, answer, "before")
    results.remove("undamped.csv")
    if undamped and answer.undamped is not None:
        results.write_table("undamped", answer.undamped)
    sensor_findings = [
        (f.kind, " ".join(f.sensors), f.mac_before, f.mac_after, f.sentence) for f in answer.sensor_findings
    ]
    columns = ["kind", "sensors", "mac_before", "mac_after", "sentence"]
    if answer.partners is None:
        results.remove("node_partners.csv")
    else:
        results.write_table("node_partners", answer.partners.table)
    results.write_table("sensor_check", pd.DataFrame(sensor_findings, columns=columns))
    write_record(study, results, "compare", {}, answer.sentences, answer=answer.answer)
    return answer


def write_comparison(results: Results, answer: ComparisonResult, stage: str) -> None:
    """Write every table of one comparison, named ``*_before`` or ``*_after``."""
    results.write_table(f"comparison_{stage}", answer.table)
    if answer.frfs is not None:
        results.write_table(f"frf_{stage}", answer.frfs.overlay_table())
        results.write_table(f"frf_lines_{stage}", answer.frfs.lines_table())
        write_geometry(results, answer.frfs.structure)
    if answer.comparison is None:
        return
    results.write_table(f"where_it_fails_{stage}", answer.comparison.where_it_fails())
    write_model_modes(results, answer.comparison, stage)
    if answer.comparison.measured.has_shapes:
        results.write_table(f"mac_{stage}", answer.comparison.mac_table())
        results.write_table(f"comac_{stage}", answer.comparison.comac_table())
        results.write_table(f"shapes_{stage}", answer.comparison.shapes_table())
        _write_orthogonality(results, answer, stage)


def _write_orthogonality(results: Results, answer: ComparisonResult, stage: str) -> None:
    """Write the tables of expanded shapes and of their orthogonality; earlier ones go where there are none."""
    checked, expanded = answer.orthogonality, answer.expanded
    if checked is None or expanded is None:
        results.remove(*(f"{name}_{stage}.csv" for name in ORTHOGONALITY))
        return
    tables = (checked.cross_table(), checked.self_table(), checked.modes_table(expanded.residual), expanded.table())
    for name, table in zip(ORTHOGONALITY, tables, strict=True):
        results.write_table(f"{name}_{stage}", table)


def write_model_modes(results: Results, comparison: Comparison, stage: str, like: Comparison | None = None) -> None:
    """Write the mesh, and frequencies, damping and deflections of the paired model modes, from which they are drawn.

    They face as the shapes of ``like`` do, a comparison with other sensors whose shapes are drawn beside them.
    """
    write_geometry(results, comparison.model)
    names = {f"{name}_model": name for name in ("natural_freq", "damped_freq", "damping_ratio")}
    modes = comparison.comparison_table().iloc[comparison.pairing.paired][["mode", *names]]
    results.write_table(f"model_modes_{stage}", modes.rename(columns=names))
    results.write_table(f"deflection_{stage}", deflections(comparison, like or comparison))


def _percent(fraction: float) -> str:
    return "1 %" if fraction <= 0.01 else f"{100 * fraction:.0f} %"


def _mean(values: pd.Series) -> float:
    return float(values.mean()) if values.notna().any() else float("nan")
