"""A study whose model is a solver becomes one of matrices, from runs of the solver; other runs check it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.api.entries.entry import count
from calib.api.fe_agreement import CLOSE, FREQ_AGREES, MAC_AGREES, modes_together, span_mac
from calib.api.fe_import import Imported
from calib.api.fe_study import TEMPLATE, TermsByKind, model_of, toml_text, write_study
from calib.errors.errors import EvaluationError, InputError
from calib.execution.retry import Retrying
from calib.imports.matrices import ReadMatrices, read_matrices
from calib.imports.runs import MatrixTerms, terms_of_runs
from calib.measurement.modal import DIRECTIONS, MeasuredModes
from calib.problem.parameter import Parameter
from calib.structure.effects.terms import CONSTANT, term_name
from calib.structure.model import StructuralModel
from calib.structure.unit_system import SYSTEMS
from calib.study.solver import Solver, read_unless_missing
from calib.study.solver_settings import SolverSettings
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile

_FRESH = ((0.17, 0.83, 0.35, 0.65), (0.83, 0.35, 0.65, 0.17))
"""Checked points: parts of the way between the limits, taken in turn by the parameters."""
_NODES = 100
"""Nodes at which shapes are compared."""
_GENERIC = 'effects = "generic"              # composed of parts, supports and points of the model\n'
"""Line of the study that is written, unless the solver's study names effects."""


@dataclass(frozen=True, eq=False)
class _Check:
    """Modes of an imported model against those of the solver at one point."""

    values: Mapping[str, float]
    table: pd.DataFrame

    @property
    def freq(self) -> float:
        """Largest relative error of a frequency."""
        return float(self.table["freq_error"].abs().max())

    @property
    def mac(self) -> float:
        """Least MAC."""
        return float(self.table["mac"].min())

    @property
    def agrees(self) -> bool:
        return self.freq <= FREQ_AGREES and not self.mac < MAC_AGREES

    @property
    def at(self) -> str:
        return ", ".join(f"{name} = {value:.6g}" for name, value in self.values.items())

    @property
    def words(self) -> str:
        return f"{self.freq:.1e} in frequency and {self.mac:.5f} in MAC at {self.at}"


@dataclass(frozen=True, eq=False)
class _SolverRuns:
    """Runs of the solver of a study: for matrices, and for modes."""

    solver: Solver
    again: Retrying | None
    parameters: tuple[Parameter, ...]

    def matrices(self, values: Mapping[str, float]) -> ReadMatrices:
        """Those that a run wrote."""

        def read(folder: Path) -> ReadMatrices:
            files = [folder / name for name in self.solver.matrices]
            metres = SYSTEMS[self.solver.units].length
            return read_unless_missing(lambda: read_matrices(files, metres=metres), *files)

        return self._run(values, read, True)

    def modes(self, values: Mapping[str, float]) -> MeasuredModes:
        """Those that a run computed."""
        return self._run(values, self.solver.computed_modes, False)

    def _run(self, values: Mapping[str, float], read: Any, matrices: bool) -> Any:
        def call(at: Mapping[str, float]) -> Any:
            return self.solver.run(at, read, matrices)

        return call(values) if self.again is None else replace(self.again, function=call)(values)


def import_runs(file: Path, to: Path | None) -> Imported:
    """The model of matrices that runs of a study's solver give; see `calib.import_matrices`.

    Raises
    ------
    InputError
        For a study whose model is no solver, or whose solver writes no matrices, and where no parameter passes the
        check.
    """
    study = LoadedStudy.load(file, test=_first_test(file))
    function: Any = getattr(study.model, "function", None)
    again = function if isinstance(function, Retrying) else None
    solver = function.function if again is not None else function
    given = study.settings.solver
    if not isinstance(solver, Solver) or given is None:
        raise InputError("its model is no solver", place=file, remedy="give the files of the matrices themselves")
    if not solver.matrices or not solver.modes:
        lacking = "matrices" if not solver.matrices else "modes"
        raise InputError(f"its solver writes no {lacking}", place=study.place("model"),
                         remedy=f"name the file with {lacking} under [model]")  # fmt: skip
    runs = _SolverRuns(solver, again, solver.space.parameters)
    powers = {name: one.powers for name, one in given.parameters.items()}
    try:
        terms = terms_of_runs(runs.matrices, runs.parameters, powers)
        return _checked(study, given, runs, terms, to)
    except EvaluationError as fault:
        raise InputError(f"a run failed: {fault}", place=file, remedy="run the deck by itself to see why") from None


def _first_test(file: Path) -> str:
    """Name of the first of several tests; empty for a study with one."""
    settings = StudyFile.read(file).settings
    return settings.tests[0].name if settings.several else ""


def _checked(
    study: LoadedStudy, given: SolverSettings, runs: _SolverRuns, terms: MatrixTerms, to: Path | None
) -> Imported:
    """The model with the parameters whose terms give the solver's own modes at fresh points."""
    units, label = runs.solver.units, study.model.name
    held: dict[str, _Check] = {}
    solved = 0

    def checked(model: StructuralModel, values: Mapping[str, float]) -> _Check:
        nonlocal solved
        solved += 1
        own = runs.modes({**study.model.space.values, **values})
        return _Check(values, _against_solver(model, values, own))

    parameters = runs.parameters
    model = _model(terms, parameters, units, label)
    checks = [checked(model, values) for values in _fresh(parameters)]
    if not all(one.agrees for one in checks):
        alone = {p.name: checked(model, next(_fresh([p]))) for p in parameters}
        held = {name: one for name, one in alone.items() if not one.agrees}
        parameters = tuple(replace(p, distribution="fixed") if p.name in held else p for p in parameters)
        if 0 < len(held) < len(parameters):
            terms = terms.without(held)
            model = _model(terms, parameters, units, label)
            checks = [checked(model, values) for values in _fresh(parameters)]
    notes = _notes(terms, solved)
    worst = max(checks, key=lambda one: one.freq)
    if len(held) == len(parameters):
        told = "; ".join(f"{name}: {one.words}" for name, one in held.items())
        raise InputError(
            f"no parameter gives the solver's own modes ({told})", place=study.place("model"),
            remedy="state other powers, or stay with the solver as a process",
        )  # fmt: skip
    warnings = tuple(
        f"{name} stays at {study.model.space[name].value:g}: its terms are off by {one.words}. State other powers of "
        "it in the solver's study, or leave it to the solver as a process."
        for name, one in held.items()
    )
    points = count(len(checks), "fresh point")
    words = f"At {points} the model is off from the solver's own modes by at most {worst.words}"
    if all(one.agrees for one in checks):
        notes += (f"{words}: it may take the solver's place.",)
    else:
        warnings += (f"{words}: do not rely on it. State other powers, or stay with the solver.",)
    found = (*terms.first.notes, *notes)
    out = Imported(model, terms.first, worst.table, found, warnings, units, measured=True, at=worst.at)
    if to is None:
        return out
    decks, files = (
        [toml_text(_path_to(study.folder / name, to)) for name in names] for names in (given.template, given.files)
    )
    text = Template((TEMPLATE / "affine_study.toml").read_text("utf-8")).substitute(
        title=toml_text(f"{study.settings.title}, matrices from runs"), base=toml_text(_path_to(study.folder, to)),
        decks=", ".join(decks), files=", ".join(files), effects="" if study.settings.libraries else _GENERIC,
    )  # fmt: skip
    source = f"{terms.runs} runs of {runs.solver.title}"
    folder = write_study(model, terms.first, units, _scaled(terms, parameters, units), source, to, text, {})
    return replace(out, study=folder)


def _path_to(target: Path, folder: Path) -> str:
    return Path(os.path.relpath(target, folder.resolve())).as_posix()


def _notes(terms: MatrixTerms, solved: int) -> tuple[str, ...]:
    """How many runs and terms there are, and which parameters act together."""
    groups = "; ".join(" and ".join(sorted(group)) for group in terms.together)
    together = f" These act together: {groups}." if groups else ""
    runs = f"{terms.runs} runs with matrices gave {terms.count} terms, {solved} runs with modes check them."
    return (runs + together,)


def _fresh(parameters: Sequence[Parameter]) -> Any:
    """Points within the limits at which nothing was fitted; fixed parameters stay."""
    for parts in _FRESH:
        yield {
            p.name: float(f"{p.lower + parts[k % len(parts)] * (p.upper - p.lower):.6g}")
            for k, p in enumerate(parameters)
            if p.distribution != "fixed"
        }


def _model(terms: MatrixTerms, parameters: Sequence[Parameter], units: str, name: str) -> StructuralModel:
    return model_of(terms.first, _scaled(terms, parameters, units), parameters, units, name)


def _scaled(terms: MatrixTerms, parameters: Sequence[Parameter], units: str) -> TermsByKind:
    """The terms by name, over the parameters themselves instead of their factors on the nominal values."""
    nominal = {p.name: p.value * p.si_factor / SYSTEMS[units].unit_of(p) for p in parameters}
    out: dict[Any, dict[str, tuple[Any, Any]]] = {}
    for kind, own in terms.matrices.items():
        out[kind] = {}
        for powers, matrix in own.items():
            name = term_name(dict(powers))
            scale = float(np.prod([nominal[n] ** -float(power) for n, power in powers]))
            by = {n: float(power) for n, power in powers}
            if not powers and kind == "stiffness":
                by = {p.name: 0.0 for p in parameters if p.distribution == "fixed"}  # the deck needs their values
            out[kind][name] = (sp.coo_array(scale * matrix), by)
        if kind != "damping" or len(out[kind]) > 1 or out[kind][CONSTANT][0].nnz:
            continue
        out[kind] = {}
    return out


def _against_solver(model: StructuralModel, values: Mapping[str, float], own: MeasuredModes) -> pd.DataFrame:
    """Frequencies and shapes of the model and of the solver in ascending order, close modes as subspaces.

    Returns
    -------
    DataFrame
        ``mode, freq, code_freq`` (Hz), ``freq_error`` (relative), ``mac``; NaN where no shapes are known.
    """
    known = {label: k for k, label in enumerate(model.labels)}
    index = [6 * known[s.node] + DIRECTIONS.index(s.direction) if s.node in known else -1 for s in own.sensors]
    moved = np.diff(model.dofs.expansion.indptr) > 0
    nodes = list(dict.fromkeys(s.node for s, k in zip(own.sensors, index, strict=True) if k >= 0 and moved[k]))
    picked = set(nodes[:: len(nodes) // _NODES + 1])
    used = [i for i, (s, k) in enumerate(zip(own.sensors, index, strict=True)) if s.node in picked and moved[k]]
    wanted = min(own.n_modes + 2, model.n_dof)
    found = model.modes(values, wanted)
    freq = np.asarray(found.natural_freq)
    n = min(own.n_modes, len(freq))
    code = own.natural_freq[:n]
    shapes = np.asarray(model.dofs.expansion[[index[i] for i in used]] @ found.shapes).real
    theirs = own.shapes[used].real
    # A last mode whose neighbour the solver did not compute spans nothing with it.
    if n < len(freq) and freq[n] < (1 + CLOSE) * freq[n - 1] and n > 1:
        n -= 1
    beside = {j: list(group) for group in modes_together(code) for j in group}
    rows = [
        (j + 1, freq[j], code[j], freq[j] / code[j] - 1, span_mac(shapes[:, j], theirs[:, beside[j]])) for j in range(n)
    ]
    return pd.DataFrame(rows, columns=["mode", "freq", "code_freq", "freq_error", "mac"])
