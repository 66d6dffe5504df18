"""A study: one model, one measurement and the questions asked of them, read from ``study.toml``."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import pandas as pd

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.errors import InputError
from calib.function import FunctionModel
from calib.limits import search_space, sensitivity_space
from calib.measurement.modal import MeasuredModes
from calib.measurement.read import read_measurement
from calib.settings import StudySettings, line_of, read_settings
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.model import StructuralModel

Problem = ModalProblem | FunctionProblem
Targets = Mapping[str, tuple[float, float | None]]


@dataclass(frozen=True)
class Study:
    """Model and measurement of one study, checked, with what is withheld already left out.

    Attributes
    ----------
    name : str
        Name of the study's folder.
    file : Path
        Its ``study.toml``.
    settings : StudySettings
    model : StructuralModel or FunctionModel
        With the study's parameter values, limits and constraints.
    measured : MeasuredModes or None
        None for a model without modes.
    targets : mapping from response name to (value, standard deviation or None)
        Measured plain responses; empty for a model with modes.
    problem : ModalProblem or FunctionProblem
        Named parameters in, named responses out.
    sensitivity_space, search_space : ParameterSpace
        All free parameters within their limits; the selected ones within the limits of the search.
    """

    name: str
    file: Path
    settings: StudySettings
    model: StructuralModel | FunctionModel
    measured: MeasuredModes | None
    targets: Targets
    problem: Problem
    sensitivity_space: ParameterSpace
    search_space: ParameterSpace

    @property
    def synthetic(self) -> bool:
        """Whether the measurement was made by a computer."""
        return self.settings.measurement.synthetic

    def selecting(self, names: tuple[str, ...]) -> Study:
        """The same study whose search is over the named parameters; only for one that leaves it to the sensitivity."""
        reader = _Reader(self.file, self.settings)
        return replace(self, search_space=search_space(self.sensitivity_space, self.settings, reader.place, names))

    @staticmethod
    def load(path: Path) -> Study:
        """Read a study folder (or its TOML file) with everything it names; InputError for anything wrong in it."""
        file = path if path.suffix == ".toml" else path / "study.toml"
        settings = read_settings(file)
        return _Reader(file, settings).study()


@dataclass(frozen=True)
class EvaluationSource:
    """Builds a study's evaluation function anew in another process.

    Attributes
    ----------
    path : str
        The study file.
    fingerprint : str
        Of the problem at the start; a study edited meanwhile is refused.
    basis : str
        File of a reduced basis to work on; empty for full order.
    """

    path: str
    fingerprint: str
    basis: str = ""

    def __call__(self) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
        """The function from named values to named responses."""
        problem = Study.load(Path(self.path)).problem
        if self.basis and isinstance(problem, ModalProblem):
            problem = problem.reduced(Basis.load(Path(self.basis)))
        if problem.fingerprint != self.fingerprint:
            raise InputError(
                "the study or its model changed while it was running", place=self.path, remedy="start the command again"
            )
        return problem.evaluate


@dataclass(frozen=True)
class _Reader:
    file: Path
    settings: StudySettings

    @property
    def folder(self) -> Path:
        return self.file.resolve().parent

    def place(self, *keys: int | str) -> str:
        """File and, where it can be told, line of a key."""
        line = line_of(self.file.read_text("utf-8"), keys)
        return f"{self.file}, line {line}" if line else str(self.file)

    def study(self) -> Study:
        model = self._model()
        space = sensitivity_space(model.space, self.settings, self.place)
        model = replace(model, space=space)
        measured, targets = self._measurement(model)
        problem = self._problem(model, measured, targets)
        selected = search_space(space, self.settings, self.place)
        if not self.settings.calibration.weight_freq + self.settings.calibration.weight_mac > 0:
            raise InputError("both weights are zero", place=self.place("calibration"), remedy="give one of them weight")
        return Study(
            self.folder.name, self.file, self.settings, model, measured, targets, problem, space, selected
        )  # fmt: skip

    # -- model ---------------------------------------------------------------------------------------------------------

    def _model(self) -> StructuralModel | FunctionModel:
        where, _, name = self.settings.model.rpartition(":")
        place = self.place("model")
        module = self._module(where, place)
        build = getattr(module, name, None)
        if not callable(build):
            raise InputError(f"{where!r} has no function {name!r}", place=place, remedy="correct the key 'model'")
        try:
            model = build(**self.settings.model_options)
        except InputError:
            raise
        except TypeError as fault:
            raise InputError(f"{name} cannot be called with these model_options ({fault})", place=place) from None
        except (Exception, SystemExit) as fault:
            # The function is the user's own: its mistakes are input, told without our traceback.
            raise InputError(f"{name} failed with {type(fault).__name__}: {fault}", place=place) from fault
        if not isinstance(model, StructuralModel | FunctionModel):
            raise InputError(
                f"{name} returns {type(model).__name__}",
                place=place,
                remedy="return a StructuralModel or a FunctionModel",
            )
        return model

    def _module(self, where: str, place: str) -> ModuleType:
        try:
            if not where.endswith(".py"):
                return importlib.import_module(where)
            path = self.folder / where
            if not path.is_file():
                raise InputError(f"there is no model file {where!r}", place=place, remedy="correct the key 'model'")
            unique = f"calib_study_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
            spec = importlib.util.spec_from_file_location(unique, path)
            if spec is None or spec.loader is None:
                raise InputError(f"{where!r} cannot be loaded", place=place)
            module = importlib.util.module_from_spec(spec)
            sys.modules[unique] = module
            spec.loader.exec_module(module)
            return module
        except ModuleNotFoundError as fault:
            if fault.name and where.startswith(fault.name):
                raise InputError(
                    f"unknown model: there is no module {where!r}", place=place, remedy="correct the key 'model'"
                ) from None
            raise InputError(f"{where!r} needs the module {fault.name!r}", place=place, remedy="install it") from None
        except InputError:
            raise
        except (Exception, SystemExit) as fault:
            raise InputError(f"{where!r} failed with {type(fault).__name__}: {fault}", place=place) from fault

    # -- measurement ---------------------------------------------------------------------------------------------------

    def _path(self, name: str, *keys: int | str) -> Path:
        path = self.folder / name
        if not path.is_file():
            raise InputError(
                f"there is no file {name!r}", place=self.place(*keys), remedy="paths are relative to the study's folder"
            )
        return path

    def _measurement(self, model: StructuralModel | FunctionModel) -> tuple[MeasuredModes | None, Targets]:
        given = self.settings.measurement
        if isinstance(model, FunctionModel) != bool(given.responses):
            words = (
                "plain responses (responses = '...')" if isinstance(model, FunctionModel) else "modes (files = [...])"
            )
            raise InputError(
                f"the model {model.name!r} is compared with measured {words}", place=self.place("measurement")
            )
        if given.responses:
            targets = read_targets(self._path(given.responses, "measurement", "responses"))
            for name in self.settings.withheld.modes + self.settings.withheld.sensors:
                if name not in targets:
                    raise InputError(f"withheld response {name!r} was not measured", place=self.place("withheld"))
            withheld = set(self.settings.withheld.modes + self.settings.withheld.sensors)
            return None, {k: v for k, v in targets.items() if k not in withheld}
        measured = read_measurement(
            [self._path(f, "measurement", "files") for f in given.files],
            shape_files=[self._path(f, "measurement", "shapes") for f in given.shapes],
            sensor_table=self._path(given.sensors, "measurement", "sensors") if given.sensors else None,
            repeats=given.repeats,
            std_of=given.std_of,
            mode_names=given.mode_names,
            synthetic=given.synthetic,
        )
        try:
            used = measured.without(self.settings.withheld.modes, self.settings.withheld.sensors)
        except InputError as fault:
            raise InputError(fault.problem, place=self.place("withheld"), remedy=fault.remedy) from None
        if not used.n_modes:
            raise InputError("every measured mode is withheld", place=self.place("withheld"))
        return used, {}

    def _problem(
        self, model: StructuralModel | FunctionModel, measured: MeasuredModes | None, targets: Targets
    ) -> Problem:
        if isinstance(model, FunctionModel):
            return FunctionProblem(model.space, model.function, targets, model.fingerprint)
        assert measured is not None
        pairing = self.settings.pairing
        count = pairing.mode_count if pairing.mode_count is not None else min(2 * measured.n_modes, model.n_dof)
        if count < measured.n_modes:
            raise InputError(
                f"mode_count is {count}, but {measured.n_modes} modes were measured",
                place=self.place("pairing", "mode_count"),
                remedy="ask the model for at least as many, better for a few more",
            )
        named = set(pairing.clusters) | set(pairing.override)
        withheld = set(self.settings.withheld.modes)
        for mode in sorted(named - set(measured.names) - withheld):
            raise InputError(
                f"mode {mode!r} was not measured",
                place=self.place("pairing"),
                remedy=f"the measured modes are {', '.join(measured.names)}",
            )
        try:
            return ModalProblem(
                model=model,
                measured=measured,
                mode_clusters={m: c for m, c in pairing.clusters.items() if m not in withheld},
                mode_count=count,
                threshold=pairing.threshold,
                freq_window=pairing.freq_window,
                override={m: k for m, k in pairing.override.items() if m not in withheld},
            )
        except InputError as fault:
            where = fault.place if fault.place and fault.place.startswith("sensor") else None
            place = f"{self.file}, {where}" if where else self.place("pairing")
            raise InputError(fault.problem, place=place, remedy=fault.remedy) from None


def read_targets(path: Path) -> dict[str, tuple[float, float | None]]:
    """Measured plain responses from a CSV with the columns ``response, value, std`` (std may be empty)."""
    try:
        table = pd.read_csv(path, comment="#", skipinitialspace=True)
    except (ValueError, UnicodeDecodeError, OSError) as fault:
        raise InputError(f"it is not a readable CSV table ({fault})", place=path) from None
    unknown = [c for c in table.columns if c not in ("response", "value", "std")]
    if unknown or not {"response", "value"} <= set(table.columns):
        raise InputError(
            f"its columns are {', '.join(map(str, table.columns))}", place=path, remedy="use response, value, std"
        )
    if table.empty:
        raise InputError("it holds no response", place=path)
    out: dict[str, tuple[float, float | None]] = {}
    for row in table.to_dict("records"):
        name = str(row["response"])
        try:
            value = float(row["value"])
            std = float(row.get("std", math.nan))
        except (TypeError, ValueError):
            raise InputError(f"response {name!r} has an entry that is no number", place=path) from None
        if not math.isfinite(value) or (math.isfinite(std) and std < 0) or name in out:
            raise InputError(
                f"response {name!r} is repeated, not finite or has a negative std", place=path, remedy="mend its row"
            )
        out[name] = (value, std if math.isfinite(std) else None)
    return out
