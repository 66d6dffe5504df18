"""The model at values that are moved by hand, beside the measurement; it runs in a process of its own.

`calib.workbench.evaluators` starts it with the study's file, the parent folder of results, the part of them and the
name of a test. It reads one JSON object a line and answers each with one; before its first answer it tells its stages.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from calib.analyses.explained_fit import explained_fit
from calib.analyses.hypotheses_of_study import basis_of, perturbations_of
from calib.analyses.provenance.places import QUICK
from calib.analyses.reduction import reduction_of, worthwhile
from calib.analyses.sensitivity import selecting
from calib.analyses.staged import Found, required_calibration, stored_calibration, values_found
from calib.api.staged import loaded_after
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.modal.comparison import Comparison
from calib.errors.errors import EvaluationError, InputError, ToleranceError
from calib.execution.outcome import words_of
from calib.execution.stage import Progress
from calib.hypotheses.function_perturbations import model_hypotheses
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.problem.parameter import Parameter
from calib.report.html.space import MeshMotion
from calib.report.mesh import read_mesh
from calib.report.numbers import fixed, percent, significant
from calib.results.results import Results, json_value
from calib.structure.reduction.reduced import ReducedModel
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

_FAR = 4.0
"""Largest magnitude of a slider over the plausible one, where the limits of an effect lie further."""


def loaded(file: Path, root: Path, part: str) -> AnyStudy:
    """A study as its results were made; InputError where another one, whose values it adopts, is not calibrated."""

    def calibrated(one: LoadedStudy, _: Path) -> Found:
        found = values_found(one, root, quick=part.startswith(QUICK))
        return found or required_calibration(one, Results(root / one.name))

    return loaded_after(file, calibrated)


@dataclass(frozen=True, eq=False)
class WhatIf:
    """One test of a study, whose model is evaluated at any values and with any effects of its list.

    Attributes
    ----------
    study : LoadedStudy
    hypotheses : ModelHypotheses
        Of the fitted data, on a reduced basis where that is worthwhile.
    starts : sequence of (str, values, effects)
        Points to begin at: the nominal model, the calibrated one, and one with the effects that were found.
    motion : MeshMotion or None
        Draws a shape; None where nothing is drawn.
    """

    study: LoadedStudy
    hypotheses: ModelHypotheses[Any]
    starts: Sequence[tuple[str, Mapping[str, float], Sequence[str]]]
    motion: MeshMotion | None

    @classmethod
    def of(cls, file: Path, root: Path, part: str, test: str, progress: Progress) -> WhatIf:
        """Read a study, and find or train its reduced basis; InputError for anything wrong in it."""
        progress("reading the study")

        whole = loaded(file, root, part)
        study = next((one for one in whole.studies if one.test == test), whole.studies[0])
        home = Results(root / whole.name / part)
        with contextlib.suppress(InputError):  # without a selection all are free
            study = selecting(study, home)
        local = perturbations_of(whole)[study.test] if study.candidates else ()
        with contextlib.suppress(ToleranceError):
            basis = None
            if study.candidates:
                basis = basis_of(study, None, local, progress)
            elif worthwhile(study) and (found := reduction_of(study, None, progress)) is not None:
                basis = found.basis
        space = study.search_space.without(study.condition)
        hypotheses, _ = model_hypotheses(
            getattr(study.problem, "model", study.model), study.pair, study.candidates, (), space, study.test, basis
        )
        starts: list[tuple[str, Mapping[str, float], Sequence[str]]] = [("Nominal values", {}, ())]
        fitted = stored_calibration(whole, home)
        if fitted is not None:
            starts.append(("Calibrated", fitted.values, ()))
        explained = home.path / "explanation.json"
        names = json.loads(explained.read_text("utf-8")).get("chosen", []) if explained.is_file() else []
        if set(names) <= {one.name for one in study.candidates} and names:
            values = explained_fit(whole, home, names)
            starts += [(f"With {' and '.join(names)}", values, names)] if values else []
        mesh = read_mesh(root / study.name / part)
        return cls(study, hypotheses, starts, None if mesh is None else MeshMotion(mesh))

    def offered(self) -> dict[str, Any]:
        """What can be moved, and where to begin."""
        chosen, space = self.study.search_space, self.hypotheses.space
        free = [p for p in space.parameters if p.name in chosen.free_names]
        held = [p for p in self.study.sensitivity_space.parameters if p.name in space and p not in free]
        held = [p for p in held if p.name not in chosen.free_names and p.distribution != "fixed"]
        return {
            "parameters": [{**_slider(p), "free": p in free} for p in (*free, *held)],
            "effects": [
                {"name": e.name, "title": e.title, "plausible": e.plausible, "sliders": [
                    _slider(p, _FAR * e.plausible if p.name == e.name else math.inf) for p in e.parameters
                ]}
                for e in self.study.candidates
            ],
            "starts": [
                {"words": words, "values": {**self._nominal, **values}, "effects": list(names)}
                for words, values, names in self.starts
            ],
            "frfs": self._curves(),
            "at": self.at({"values": {}, "effects": []}),
        }  # fmt: skip

    @property
    def _nominal(self) -> dict[str, float]:
        own = self.study.sensitivity_space.values
        return {name: own.get(name, value) for name, value in self.hypotheses.pair.space.values.items()}

    def _curves(self) -> list[dict[str, Any]]:
        """Amplitudes of the measured FRFs, function by function."""
        problem = self.study.problem
        if not isinstance(problem, FRFProblem):
            return []
        measured = problem.measured
        return [
            {"name": one.name, "unit": measured.unit(one.response, one.reference),
             "freq": measured.freq[one.lines], "measured": np.abs(measured.values[one.index])}
            for one in measured.functions
        ]  # fmt: skip

    def at(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Responses at ``values`` with ``effects``; of ``mode`` the motion, of ``function`` the FRF; ``full`` order.

        Raises
        ------
        InputError
            For an unknown effect or parameter.
        EvaluationError
            Where the model cannot be solved.
        """
        names, hypotheses, full = tuple(asked.get("effects", ())), self.hypotheses, bool(asked.get("full", False))
        if full:
            variants: Any = hypotheses.variants
            hypotheses = replace(hypotheses, variants=replace(variants, basis=None))
        problem = hypotheses.fit_problem(names)
        values = {**self._nominal, **{name: float(value) for name, value in asked["values"].items()}}
        whole = problem.pair.space.complete({k: v for k, v in values.items() if k in problem.pair.space})
        found, residual = problem.at(whole), problem.residual(whole)
        if isinstance(found, Comparison):
            own = self._modes(found, str(asked.get("mode", "")))
        elif isinstance(problem.pair, FRFResidual):
            own = self._functions(problem.pair, whole, str(asked.get("function", "")))
        else:
            own = _numbers(problem.pair, found)
        return {"rms": float(np.sqrt(np.mean(residual**2))), "full": full, **own}

    def _modes(self, found: Comparison, mode: str) -> dict[str, Any]:
        reduced, out = found.model, dict[str, Any]()
        if isinstance(reduced, ReducedModel):
            chosen = found.pairing.model_index[found.pairing.paired]
            errors = reduced.indicator(found.values, found.modes.subset(chosen))
            out = {"error": float(np.max(errors, initial=0.0)), "tolerance": reduced.basis.tolerance}
        if self.motion is not None and mode in found.measured.names:
            out |= {"mode": mode, "motion": self.motion.packed(found.deflection_table(mode))}
        rows = found.comparison_table().to_dict("records")
        return {
            **out, "kind": "modes", "mac": found.mac, "model": [fixed(f, 2) for f in found.modes.natural_freq],
            "rows": [
                {"name": r["mode"], "partner": None if r["model_mode"] != r["model_mode"] else int(r["model_mode"]),
                 "measured": fixed(r["natural_freq_measured"], 2), "model": fixed(r["natural_freq_model"], 2),
                 "error": r["freq_error"], "error_words": percent(r["freq_error"], 2, sign=True),
                 "mac": r["mac"], "mac_words": fixed(r["mac"], 3)}
                for r in rows
            ],
        }  # fmt: skip

    def _functions(self, pair: FRFResidual, values: Mapping[str, float], function: str) -> dict[str, Any]:
        found, problem, model = pair.compared(values), pair.problem, pair.problem.model
        out: dict[str, Any] = {}
        if isinstance(model, ReducedModel):
            whole, loaded, tolerance = self.study.problem, problem.loaded_model, model.basis.tolerance
            assert isinstance(whole, FRFProblem)
            assert isinstance(loaded, ReducedModel)
            out = {"error": whole.basis_target(tolerance).estimate(loaded, values), "tolerance": tolerance}
        curve = next((f for f in problem.measured.functions if f.name == function), problem.measured.functions[0])
        return {
            **out, "kind": "frf", "function": curve.name, "curve": np.abs(found.model[curve.index]),
            "rows": [
                {"name": f"{r['response']}/{r['reference']}", "error": r["in_std"], "mac": r["frac"],
                 "error_words": fixed(r["in_std"], 2), "mac_words": fixed(r["frac"], 3)}
                for r in found.functions_table().to_dict("records")
            ],
        }  # fmt: skip


def _numbers(pair: Any, solution: Any) -> dict[str, Any]:
    errors = -pair.of(solution)
    rows = zip(pair.rows, pair.measured_values, pair.measured_values + errors * pair.std, errors, strict=True)
    return {"kind": "numbers", "rows": [
        {"name": row.sensor or row.mode or row.kind, "measured": significant(value), "model": significant(own),
         "error": error, "error_words": fixed(error, 1, sign=True)}
        for row, value, own, error in rows
    ]}  # fmt: skip


def _slider(p: Parameter, most: float = math.inf) -> dict[str, Any]:
    upper = min(p.upper, most) if most > p.lower else p.upper
    return {
        "name": p.name, "words": p.description, "unit": "" if p.unit == "-" else p.unit, "lower": max(p.lower, -most),
        "upper": upper, "value": p.value, "integer": p.integer, "log": p.scale == "log" and p.lower > 0,
    }  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Answer requests until the input ends, which ends the process at once, whatever it computes."""
    told = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a user's code prints is no answer
    asked: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read, args=(asked,), daemon=True).start()

    def tell(content: Mapping[str, Any]) -> None:
        print(json.dumps(json_value(content), separators=(",", ":"), allow_nan=False), file=told, flush=True)

    def progress(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        tell({"stage": stage, "done": done, "total": total})

    file, root, part, test = arguments
    try:
        what_if = WhatIf.of(Path(file), Path(root), part, test, progress)
        tell({"ready": what_if.offered()})
    except (InputError, EvaluationError) as fault:
        tell({"fault": getattr(fault, "sentence", str(fault))})
        return
    except Exception as fault:  # of a user's code
        tell({"fault": words_of(fault)})
        return
    while True:
        try:
            tell({"found": what_if.at(json.loads(asked.get()))})
        except Exception as fault:  # the page says what failed; the next values may be good
            tell({"fault": getattr(fault, "sentence", None) or str(fault) or words_of(fault)})


def _read(asked: SimpleQueue[str]) -> None:
    for line in sys.stdin:
        asked.put(line)
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
