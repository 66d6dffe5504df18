"""Loads what a study names as ``"module:function"``: its model and the library of effects that it may lack."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from calib.errors.errors import InputError
from calib.errors.own_code import defined_at, raised_at, refuses
from calib.errors.place import Place
from calib.execution.outcome import error_line
from calib.execution.retry import retrying
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes, Sensor
from calib.problem.effect import Effect
from calib.problem.parameter import Parameter
from calib.results.fingerprint import digest_of
from calib.structure.effects.extend import extend
from calib.structure.function_model import FunctionModel, extend_function
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.structure.soundness import require_sound
from calib.study.measurement_settings import GENERIC, RUNS
from calib.study.neighbours import Neighbours, project_folders
from calib.study.settings import StudySettings
from calib.study.solver_settings import SolverSettings

Model = StructuralModel | ModalFunctionModel | FunctionModel
_KEYS = {"model": ("model",), "effects": ("effects",), "finer_options": ("explain", "finer_options")}
_LISTED = 20
"""Most effects named where one is unknown."""
"""Keys for which a function is called."""

Sensed = tuple[Model, Sequence[MeasuredModes | MeasuredFRFs]]
"""A model, and what its tests measured at sensors."""
PlaceOf = Callable[..., Place]
"""Place of a key of the study, such as ``place("model")``."""


@dataclass(frozen=True)
class Sources:
    """The code that a study names; each of its files is run once.

    Attributes
    ----------
    settings : StudySettings
    folder : Path
        The study's; files are relative to it.
    place : callable
        See `PlaceOf`.
    sensors : callable
        Those of the measured shapes, which a solver is asked for.
    """

    settings: StudySettings
    folder: Path
    place: PlaceOf
    sensors: Callable[[], tuple[Sensor, ...]] = tuple
    _entered: list[bool] = field(init=False, repr=False, compare=False, default_factory=list)

    def model(self) -> Model:
        """The model without effects; InputError for whatever is wrong with it."""
        name, place = self.settings.model_name, self.place("model")
        if self.settings.solver is not None:
            model: Any = self._solver(self.settings.solver)
        elif name.endswith(RUNS):
            model = self._runs(name)
        else:
            model = self._call("model", name, self.settings.model_options)
        if not isinstance(model, StructuralModel | ModalFunctionModel | FunctionModel):
            raise InputError(
                f"{name.rpartition(':')[2]} returns {type(model).__name__}",
                place=place,
                remedy="return a StructuralModel, a ModalFunctionModel or a FunctionModel",
                at=self._definition("model", name),
            )
        if not isinstance(model, StructuralModel) and (retry := self.settings.retry) is not None:
            model = replace(model, function=retrying(model.function, retry.pattern, retry.times, retry.wait))
        if isinstance(model, StructuralModel):
            try:
                require_sound(model)
            except InputError as fault:
                at = self._definition("model", name)
                there = place.of(fault.place or "")
                raise InputError(fault.problem, place=there, remedy=fault.remedy, at=fault.at or at) from None
        return model

    def _solver(self, given: SolverSettings) -> Model:
        """A solver; see `calib.study.solver.solver_model`."""
        from calib.study.solver import solver_model  # most studies have none

        if self.settings.model_options:
            words = "a solver takes no model_options"
            raise InputError(words, place=self.place("model_options"), remedy="write its keys under [model]")
        parameters = []
        for name, one in given.parameters.items():
            try:
                parameters.append(
                    Parameter(name, one.value, *one.limits, one.unit, integer=one.integer, prior_sd=one.prior_sd)
                )
            except InputError as fault:
                place = self.place("model", "parameters", name)
                raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
        options = given.model_dump(exclude={"parameters", "sensors"})
        options["node_limit"] = self.settings.measurement.node_limit
        try:
            return solver_model(
                parameters=parameters, sensors=given.sensors or self.sensors(), folder=self.folder,
                time_limit=self.settings.calibration.time_limit, **options,
            )  # fmt: skip
        except InputError as fault:
            there = fault.at or self.place("model")
            raise InputError(fault.problem, place=fault.place, remedy=fault.remedy, at=there) from None

    def _runs(self, name: str) -> Model:
        """A table of runs; see `calib.study.runs.read_runs`."""
        from calib.study.runs import read_runs  # metamodels are for tables of runs alone

        options, path = self.settings.model_options, self.folder / name
        if not path.is_file():
            remedy = "paths are relative to the study's folder"
            raise InputError(f"there is no table of runs {name!r}", place=self.place("model"), remedy=remedy)
        if mismatch := _mismatch(read_runs, {"path": path, **options}):
            words = f"a table of runs cannot be read with these model_options ({mismatch})"
            place = self.place("model_options") if options else self.place("model")
            raise InputError(words, place=place, remedy="write model_options = { inputs = [...] }")
        return read_runs(path, **options)

    def finer(self) -> Model | None:
        """The model without effects on a finer mesh; None when the study names no options for one."""
        options, name = self.settings.explain.finer_options, self.settings.model_name
        if not options or not name:
            return None
        model = self._call("finer_options", name, {**self.settings.model_options, **options})
        return model if isinstance(model, StructuralModel | ModalFunctionModel | FunctionModel) else None

    def library(self, base: Model, sensed: Callable[[], Sensed]) -> tuple[Effect, ...]:
        """The effects that the model may lack, in the order of their library; none when the study names none.

        ``sensed`` returns the model and what its tests measured, for generic effects at their sensors.

        Raises
        ------
        InputError
            When the library cannot be loaded or is not a tuple of effects, or when two of its parameters, or one of
            them and one of the base model, share a name.
        """
        if not self.settings.libraries:
            return ()
        place = self.place("effects")
        named = [function for function in self.settings.libraries if function != GENERIC]
        library = tuple(effect for function in named for effect in self._library(function, place))
        if GENERIC in self.settings.libraries:
            from calib.structure.effects.compositions import generic_effects  # for these alone

            taken = [name for effect in library for one in effect.family for name in one.names]
            model, measured = sensed()
            try:
                library += generic_effects(model, measured, taken)
            except InputError as fault:
                raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
        require_distinct(library, base, place)
        return library

    def _library(self, function: str, place: Place) -> tuple[Effect, ...]:
        library = self._call("effects", function, {})
        if not isinstance(library, tuple) or not all(isinstance(effect, Effect) for effect in library):
            found = type(library).__name__
            if isinstance(library, tuple | list):
                found += " of " + (", ".join(sorted({type(effect).__name__ for effect in library})) or "nothing")
            name = function.rpartition(":")[2]
            at = self._definition("effects", function)
            raise InputError(f"{name} returns {found}", place=place, remedy="return a tuple of Effect", at=at)
        return library

    def included(self, library: Sequence[Effect]) -> tuple[Effect, ...]:
        """The effects in the study's model, in the order of ``with_effects``."""
        names = self.settings.with_effects
        if names and not self.settings.libraries:
            raise InputError(
                "effects are named, but no list that holds them", place=self.place("with_effects"),
                remedy="add the key 'effects'",
            )  # fmt: skip
        for k, name in enumerate(names):
            if name in names[:k]:
                place = self.place("with_effects", k)
                raise InputError(f"the effect {name!r} is named twice", place=place, remedy="name it once")
        for effect in library:
            of_family = [name for name in names if name in (one.name for one in effect.family)]
            if len(of_family) > 1:
                one, other = of_family[:2]
                raise InputError(
                    f"{one!r} and {other!r} are the same effect in less and in more detail",
                    place=self.place("with_effects", names.index(other)), remedy="name one of them",
                )  # fmt: skip
        return tuple(pick(library, name, self.place("with_effects", k)) for k, name in enumerate(names))

    def _call(self, key: str, function: str, options: Mapping[str, Any]) -> Any:
        """Result of the function that is named under a key."""
        where, _, name = function.rpartition(":")
        place = self.place(*_KEYS[key])
        module = self._module(key, where)
        build = getattr(module, name, None)
        if not callable(build):
            near = difflib.get_close_matches(name, [n for n, f in vars(module).items() if callable(f)], n=1)
            words = f"{where!r} has no function {name!r}" + (f" (did you mean {near[0]!r}?)" if near else "")
            raise InputError(words, place=place, remedy=f"correct the key {key!r}")
        mismatch = _mismatch(build, options)
        if mismatch is not None:
            whose = {"model": "with these model_options", "finer_options": "with these finer_options"}
            if key == "model" and options:
                place = self.place("model_options")
            raise InputError(f"{name} cannot be called {whose.get(key, 'without arguments')} ({mismatch})", place=place)
        try:
            return build(**options)
        except InputError as fault:  # of a wrong option, or of the user's own call of calib
            line = self.place("model_options") if key == "model" and options else place
            raise fault.with_line((None if refuses(fault) else raised_at(fault)) or line) from fault.__cause__
        except KeyboardInterrupt:
            raise
        except BaseException as fault:  # an exit too, or an exception that is no Exception
            # The function is the user's own: its errors are bad input, reported without our traceback.
            raise InputError(f"{name} failed with {error_line(fault)}", place=place, at=raised_at(fault)) from fault

    def _definition(self, key: str, function: str) -> Place | None:
        """Line that defines a function that is named under a key."""
        where, _, name = function.rpartition(":")
        return defined_at(getattr(self._module(key, where), name, None))

    def _module(self, key: str, where: str) -> ModuleType:
        place, remedy = self.place(*_KEYS[key]), f"correct the key {key!r}"
        what = "library of effects" if key == "effects" else "model"
        try:
            if not self._entered:
                keys = (self.settings.model_name, *self.settings.libraries)
                named = [self.folder / key.rpartition(":")[0] for key in keys]
                own = [path.parent.resolve() for path in named if path.suffix == ".py"]
                # A module is named relative to the project of the file that names it, which may be that of a base.
                naming = [Path(self.place(key).file).resolve().parent for key in ("model", "effects")]
                above = [folder for home in (self.folder, *naming) for folder in project_folders(home)]
                _NEIGHBOURS.enter(list(dict.fromkeys([self.folder, *own])), list(dict.fromkeys(above)))
                self._entered.append(True)
            if not where.endswith(".py"):
                return importlib.import_module(where)
            path = self.folder / where
            if not path.is_file():
                raise InputError(f"there is no {what} file {where!r}", place=place, remedy=remedy)
            return _NEIGHBOURS.module(path)  # a second run would make other classes of the same names
        except ImportError as fault:
            if (fault.name or "").partition(".")[0] == "calib":
                raise InputError(
                    f"{where!r} imports what calib does not have: {fault}", place=place,
                    remedy="import public names from calib and calib.structure; the page on import paths lists them "
                    "with their former places", at=raised_at(fault),
                ) from None  # fmt: skip
            if not isinstance(fault, ModuleNotFoundError):
                raise InputError(
                    f"{where!r} failed with {error_line(fault)}", place=place, at=raised_at(fault)
                ) from fault
            if fault.name and where.startswith(fault.name):
                raise InputError(
                    f"unknown {what}: there is no module {where!r}{_found_instead(where)}", place=place,
                    remedy=f"{remedy}, or put the module into the study's folder or into that of its project",
                ) from None  # fmt: skip
            raise InputError(
                f"{where!r} needs the module {fault.name!r}", place=place,
                remedy="install it, or put its file into the study's folder", at=raised_at(fault),
            ) from None  # fmt: skip
        except InputError as fault:
            raise fault.with_line(raised_at(fault)) from fault.__cause__
        except KeyboardInterrupt:
            raise
        except BaseException as fault:  # an exit too, or an exception that is no Exception
            raise InputError(f"{where!r} failed with {error_line(fault)}", place=place, at=raised_at(fault)) from fault


def _mismatch(build: Callable[..., Any], options: Mapping[str, Any]) -> TypeError | None:
    """Why a function cannot take these options; None where it can, or where its signature is unknown (built-ins)."""
    try:
        signature = inspect.signature(build)
    except (TypeError, ValueError):
        return None
    try:
        signature.bind(**options)
    except TypeError as fault:
        return fault
    return None


def _found_instead(where: str) -> str:
    """Where the package lies that was found in place of the one that holds a module; empty where there is none."""
    package, _, below = where.partition(".")
    places = list(getattr(sys.modules.get(package), "__path__", ()))
    return f" ({package!r} is {places[0]})" if below and places else ""


def module_of(path: Path) -> ModuleType:
    """A file of Python that belongs to no package, run as a module; raises whatever it raises."""
    unique = f"calib_study_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(unique, path, loader=_FromSource(unique, str(path)))
    if spec is None or spec.loader is None:
        raise InputError("it cannot be loaded", place=path, remedy="give a file that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[unique] = module
    spec.loader.exec_module(module)
    return module


class _FromSource(importlib.machinery.SourceFileLoader):
    """Always compiles the source: cached bytecode is matched by second and size, which an edit may leave unchanged."""

    def get_code(self, fullname: str) -> CodeType:
        """Code of the file as it is now."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


_NEIGHBOURS = Neighbours(module_of)


def require_distinct(library: Sequence[Effect], base: Model, place: Place | str) -> None:
    """InputError where two parameters of a library, or one of them and one of the base model, share a name."""
    owner: dict[str, str] = {}
    for effect in library:
        for name in dict.fromkeys(name for one in effect.family for name in one.names):
            if name in base.space:
                raise InputError(
                    f"the effect {effect.name!r} has a parameter {name!r}, as has the model {base.name!r}",
                    place=place,
                    remedy="rename it or leave the effect out of the list",
                )
            if name in owner:
                raise InputError(
                    f"the effects {owner[name]!r} and {effect.name!r} both have a parameter {name!r}",
                    place=place,
                    remedy="rename one of them",
                )
            owner[name] = effect.name


def pick(library: Sequence[Effect], name: str, place: Place) -> Effect:
    """The effect of that name; InputError with the nearest name when there is none."""
    known = {one.name: one for effect in library for one in effect.family}
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        few = list(known) if len(known) <= _LISTED else difflib.get_close_matches(name, known, n=_LISTED, cutoff=0.0)
        which = "the listed effects are" if few == list(known) else f"the nearest of {len(known)} listed effects are"
        raise InputError(
            f"unknown effect {name!r}" + (f" (did you mean {near[0]!r}?)" if near else ""),
            place=place,
            remedy=f"{which} {', '.join(few) or 'none'}",
        )
    return known[name]


def extended(model: Model, effects: Sequence[Effect]) -> Model:
    """The model with effects added; InputError when one does not fit the model."""
    return extend(model, effects) if isinstance(model, StructuralModel) else extend_function(model, effects)


def lacking(library: Sequence[Effect], names: Collection[str]) -> tuple[Effect, ...]:
    """Effects of a library of whose family no member is among the names of those in a model."""
    return tuple(effect for effect in library if not any(one.name in names for one in effect.family))


def with_effects(base: Model, effects: Sequence[Effect], place: Place | str) -> Model:
    """The model with effects added; InputError when one does not fit the model or fails."""
    if not effects:
        return base
    try:
        return extended(base, effects)
    except InputError as fault:
        where = f"{place}, {fault.place}" if fault.place else place
        at = fault.at or raised_at(fault) or (place if isinstance(place, Place) else None)
        raise InputError(fault.problem, place=where, remedy=fault.remedy, at=at) from None
    except (Exception, SystemExit) as fault:
        names = ", ".join(repr(effect.name) for effect in effects)
        raise InputError(f"adding {names} failed with {error_line(fault)}", place=place, at=raised_at(fault)) from fault


def fingerprint_of(
    base: FunctionModel | ModalFunctionModel, effects: Sequence[Effect], extended: FunctionModel | ModalFunctionModel
) -> str:
    """Hash over a function and the effects added to it; without effects that of the function."""
    if not effects:
        return base.fingerprint
    names, builds = [effect.name for effect in effects], [effect.build for effect in effects]
    return digest_of(base.fingerprint, names, extended.function, builds)[:16]
