"""A study: one model, one measurement and the questions asked of them, read from ``study.toml``."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from calib.correlation.problem import FunctionProblem, ModalProblem, usual_mode_count
from calib.effect import Effect
from calib.errors import InputError
from calib.fingerprint import code_files, digest_of, digest_of_files
from calib.function import FunctionModel
from calib.given import path as path_of
from calib.limits import parameter_hints, search_space, sensitivity_space
from calib.loading import Model, Sources, fingerprint_of, with_effects
from calib.measurement.accuracy import Accuracy
from calib.measurement.disagreements import Disagreement
from calib.measurement.modal import MeasuredModes
from calib.measurement.read import read_modes
from calib.measurement.responses import MeasuredResponses, read_responses, response_kinds
from calib.settings import StudySettings, TestSettings
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.extend import extend
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.study_text import place_of, read_layers, read_settings

ForwardProblem = ModalProblem | FunctionProblem
Targets = Mapping[str, tuple[float, float | None]]
_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Part:
    """One of the tests of a study.

    Attributes
    ----------
    index : int
        Its place in the file, from 0.
    given : TestSettings
    several : bool
        Whether there are others beside it.
    """

    index: int
    given: TestSettings
    several: bool


@dataclass(frozen=True)
class StudyFile:
    """What a study's file says, read and checked without running any code that it names.

    Attributes
    ----------
    name : str
        Name of the study's folder, of one of several tests with that of the test.
    file : Path
        Its ``study.toml``.
    settings : StudySettings
        Of one test those of a study with that test alone.
    part : Part or None
        Which of the tests under ``[[tests]]`` it is; None for a study with ``[measurement]``, and for all tests
        together.
    """

    name: str
    file: Path
    settings: StudySettings
    part: Part | None = field(default=None, kw_only=True)

    @staticmethod
    def read(path: Path, test: str = "") -> StudyFile:
        """Read a study folder's TOML file, or that file; InputError for anything wrong in it.

        Of several tests the one named, or all of them together.
        """
        file = study_file(path)
        settings, name = read_settings(file), file.resolve().parent.name
        if not test and len(settings.tests) != 1:
            return StudyFile(name, file, settings)
        index = next((k for k, one in enumerate(settings.tests) if one.name == test), 0)
        part = Part(index, settings.tests[index], settings.several) if settings.tests else None
        own = settings.of_test(test or settings.tests[0].name)
        return StudyFile(f"{name}.{test}" if settings.several else name, file, own, part=part)

    @property
    def test(self) -> str:
        """Name of the test, where it is one of several."""
        return self.part.given.name if self.part is not None and self.part.several else ""

    @property
    def condition(self) -> dict[str, float]:
        """Parameters that hold for this test only, each in its own unit."""
        return {} if self.part is None else dict(self.part.given.set)

    @property
    def parts(self) -> tuple[StudyFile, ...]:
        """Every test by itself; a study with one test is its only part."""
        if not self.settings.several:
            return (self,)
        return tuple(StudyFile.read(self.file, test.name) for test in self.settings.tests)

    @property
    def synthetic(self) -> bool:
        """Whether the measurement, or some of it, was made by a computer."""
        measured = self.settings.tests or (self.settings.measurement,)
        return any(one.synthetic for one in measured)

    def measurement(self) -> tuple[MeasuredModes | None, MeasuredResponses | None]:
        """Everything that one test has measured: modes, or plain responses; InputError where it cannot be read."""
        return self._reader.measurement()

    def place(self, *keys: int | str) -> str:
        """File and, where it can be told, line of a key."""
        return self._reader.place(*keys)

    @property
    def _reader(self) -> _Reader:
        return _Reader(self.file, self.settings, self.part)

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that the study reads, itself included, without links."""
        return (*(layer.file.resolve() for layer in read_layers(self.file)), *self.named_files.values())

    @property
    def named_files(self) -> Mapping[str, Path]:
        """Every file that the study names, by the path it writes, without links."""
        given, folder = self.settings, self.file.resolve().parent
        code = [where for f in given.functions if (where := f.rpartition(":")[0]).endswith(".py")]
        files = list(code)
        for data in given.tests or (given.measurement,):
            files += [*data.files, *data.shapes, *filter(None, [data.sensors, data.responses])]
        files += given.depends_on
        return {file: (folder / file).resolve() for file in files}

    @property
    def code_files(self) -> list[Path]:
        """All code in the study's folder, and what lies beside a file with code that it names elsewhere."""
        given, folder = self.settings, self.file.resolve().parent
        files = code_files(folder)
        for named in given.functions:
            path = (folder / named.rpartition(":")[0]).resolve()
            if path.suffix == ".py" and not path.is_relative_to(folder):
                files += sorted(path.parent.glob("*.py"))
        return files

    @property
    def file_digests(self) -> Mapping[str, str]:
        """Digests of the named files and of all code as they are now; one that is gone has none.

        Named files are told by the path that the study writes, others by that from its folder.
        """
        folder, named = self.file.resolve().parent, self.named_files
        others = {Path(os.path.relpath(p, folder)).as_posix(): p for p in self.code_files if p not in named.values()}
        found = ((name, _digest_of_file(path)) for name, path in {**named, **others}.items())
        return {name: digest for name, digest in found if digest}


@dataclass(frozen=True)
class Study(StudyFile):
    """Model and measurement of one study, checked, with what is withheld already left out.

    Attributes
    ----------
    name : str
        Name of the study's folder.
    file : Path
        Its ``study.toml``.
    settings : StudySettings
    model : StructuralModel, ModalFunctionModel or FunctionModel
        With the study's effects, parameter values, limits and constraints.
    measured : MeasuredModes or None
        None for a model without modes.
    targets : mapping from response name to (value, standard deviation or None)
        Measured plain responses; empty for a model with modes.
    problem : ModalProblem or FunctionProblem
        Named parameters in, named responses out.
    sensitivity_space, search_space : ParameterSpace
        All free parameters within their limits; the selected ones within the limits of the search.
    whole : MeasuredModes or None
        The measurement with nothing withheld. For verification only: never given to a fit.
    whole_targets : mapping from response name to (value, standard deviation or None)
        Likewise for plain responses.
    library : tuple of Effect
        Every effect that the study knows, in its model or not.
    adopted, adopted_sd : mapping from parameter name to value
        Taken over from an earlier study, and the standard deviations of those that this one holds.
    initial : mapping from parameter name to value
        All values before any calibration, those taken over as the model itself has them.
    hints : tuple of str
        Values that look like other units than the model's parameters are in.
    responses : MeasuredResponses or None
        The plain responses with nothing withheld and the repeats behind them; None for a model with modes.
    read_files : mapping from path to digest
        Named files and all code as they were when the study was read; see `file_digests`.
    library_digest : str
        Of what builds the effects, with all it holds and the files it stands in, wherever these are.
    """

    model: Model
    measured: MeasuredModes | None
    targets: Targets
    problem: ForwardProblem
    sensitivity_space: ParameterSpace
    search_space: ParameterSpace
    whole: MeasuredModes | None = None
    whole_targets: Targets = field(default_factory=dict)
    library: tuple[Effect, ...] = ()
    adopted: Mapping[str, float] = field(default_factory=dict)
    adopted_sd: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    responses: MeasuredResponses | None = None
    read_files: Mapping[str, str] = field(default_factory=dict)
    library_digest: str = ""

    @property
    def studies(self) -> tuple[Study, ...]:
        """Every test as a study of its own: it is the only one; see `calib.several.JointStudy`."""
        return (self,)

    def each(self, change: Callable[[Study], Study]) -> Study:
        """The same with a change of every test's study."""
        return change(self)

    @property
    def held_sd(self) -> dict[str, float]:
        """Standard deviations of the held parameters that are known with a scatter only."""
        return {name: sd for name, sd in self.adopted_sd.items() if sd > 0}

    def measurement(self) -> tuple[MeasuredModes | None, MeasuredResponses | None]:
        """Everything that was measured, as it was read when the study was."""
        return self.whole, self.responses

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Where one repeat of the measurement disagrees with the others."""
        given = self.whole or self.responses
        return () if given is None else given.disagreements

    @property
    def measurement_notes(self) -> tuple[str, ...]:
        """What a reader of the measurement must know."""
        given = self.whole or self.responses
        return () if given is None else given.notes

    @property
    def repeats(self) -> int | None:
        """Repeats behind the measured values; None where a study of plain responses does not tell."""
        if self.whole is not None:
            return self.whole.n_repeats
        told = None if self.responses is None else self.responses.repeats
        return self.settings.measurement.repeats if told is None else told

    @property
    def included(self) -> tuple[Effect, ...]:
        """Effects of the library that are in the model, in the order they were added."""
        known = {effect.name: effect for effect in self.library}
        return tuple(known[name] for name in self.settings.with_effects)

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """Effects of the library that the model lacks."""
        return tuple(effect for effect in self.library if effect.name not in self.settings.with_effects)

    def whole_problem(self) -> ModalProblem | None:
        """The modal problem over everything measured, what is withheld included; None for plain responses.

        For verification only: never given to a fit. As many more model modes are solved as the withheld modes need.

        Raises
        ------
        InputError
            When a withheld sensor has no place on the model, or a withheld mode an impossible pair.
        """
        problem, whole, pairing = self.problem, self.whole, self.settings.pairing
        if not isinstance(problem, ModalProblem) or whole is None:
            return None
        if pairing.mode_count is None:
            more = 2 * (whole.n_modes - problem.measured.n_modes)
            count = min(problem.mode_count + more, problem.model.n_modes)
        else:
            count = problem.mode_count + max(0, whole.n_modes - pairing.mode_count)
        try:
            return replace(
                problem, measured=whole, mode_clusters=pairing.clusters, override=pairing.override, mode_count=count
            )
        except InputError as fault:
            raise self._reader.misfit(fault) from None

    def finer_model(self) -> StructuralModel | None:
        """The model on a finer mesh, effects included; None when the study names no options for one."""
        reader = self._reader
        finer = Sources(self.settings, reader.folder, reader.place).finer()
        return None if finer is None else extend(finer, self.included)

    def selecting(self, names: tuple[str, ...]) -> Study:
        """The same study whose search is over the named parameters; only for one that leaves it to the sensitivity."""
        elsewhere = names if self.test else ()
        space = search_space(self.sensitivity_space, self.settings, self.place, names, elsewhere)
        return replace(self, search_space=space)

    @staticmethod
    def load(
        path: str | Path, adopted: Mapping[str, float] = _NONE, adopted_sd: Mapping[str, float] = _NONE, test: str = ""
    ) -> Study:
        """Read a study folder (or its TOML file) with everything it names; InputError for anything wrong in it.

        ``adopted`` are values that an earlier study has found, where this one takes some over, and ``adopted_sd`` their
        standard deviations as far as they are known; see `calib.questions.phases`. Of several tests ``test`` is read;
        all of them together are a `calib.several.JointStudy`.
        """
        told = StudyFile.read(path_of(path, "study"), test)
        if told.settings.several:
            names = ", ".join(one.name for one in told.settings.tests)
            raise InputError(f"it has several tests, {names}", place=told.file, remedy="name one of them")
        read = told.file_digests  # before the code runs: what changes from here on is not what was read
        return replace(told._reader.study(adopted, adopted_sd), read_files=read)


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
    adopted : tuple of (parameter name, value)
        Taken over from an earlier study.
    test : str
        Of several, the one that is asked.
    """

    path: str
    fingerprint: str
    basis: str = ""
    adopted: tuple[tuple[str, float], ...] = ()
    test: str = ""

    def __call__(self) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
        """The function from named values to named responses."""
        study = Study.load(Path(self.path), dict(self.adopted), test=self.test)
        problem = study.problem
        if self.basis and isinstance(problem, ModalProblem):
            problem = problem.reduced(Basis.load(Path(self.basis)))
        if problem.fingerprint != self.fingerprint:
            raise InputError(
                "the study or its model changed while it was running, or the model holds something that is another one "
                "each time it is built (a temporary folder, a time stamp)",
                place=self.path,
                remedy="start the command again, or make inside the function what is new for every call",
            )
        return problem.evaluate if isinstance(study.model, StructuralModel) else _Extendable(study).evaluate


@dataclass(frozen=True, eq=False)
class _Extendable:
    """The function of a study with those effects of its library whose parameters are among the values.

    A function of modes tells their numbers, see `calib.structure.modal_answer.numbers_of`.
    """

    study: Study
    _made: dict[tuple[str, ...], Callable[[Mapping[str, float]], dict[str, float]]] = field(
        init=False, repr=False, default_factory=dict
    )

    def evaluate(self, values: Mapping[str, float]) -> dict[str, float]:
        """As `FunctionProblem.evaluate`; effects are built one upon the other in the order of the values."""
        owner = {name: effect for effect in self.study.candidates for name in effect.names}
        effects = {owner[name].name: owner[name] for name in values if name in owner}
        key = tuple(effects)
        if key not in self._made:
            model = with_effects(self.study.model, tuple(effects.values()), str(self.study.file))
            if isinstance(model, ModalFunctionModel):
                self._made[key] = model.numbers
            else:
                problem = self.study.problem
                assert isinstance(model, FunctionModel) and isinstance(problem, FunctionProblem)
                self._made[key] = replace(problem, space=model.space, function=model.function).evaluate
        return self._made[key](values)


def _digest_of_file(path: Path) -> str:
    """Of its content; empty for one that cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError:
        return ""


def study_file(path: Path) -> Path:
    """The TOML file of a study that is named by its folder or by that file."""
    return path if path.suffix == ".toml" else path / "study.toml"


def shell_argument(path: Path) -> str:
    """A study or another path as an argument to type: a study by its folder, quoted where a shell needs it."""
    return shlex.quote(str(path.parent if path.name == "study.toml" else path))


@dataclass(frozen=True)
class _Reader:
    file: Path
    settings: StudySettings
    part: Part | None

    @property
    def folder(self) -> Path:
        return self.file.resolve().parent

    def place(self, *keys: int | str) -> str:
        """File and, where it can be told, line of a key."""
        layers = read_layers(self.file)
        if self.part is not None:
            own = keys[1:] if keys[:1] == ("measurement",) else keys
            if (there := place_of(layers, "tests", self.part.index, *own)) != str(self.file):
                return there
        return place_of(layers, *keys)

    def study(self, adopted: Mapping[str, float], adopted_sd: Mapping[str, float]) -> Study:
        sources = Sources(self.settings, self.folder, self.place)
        base = sources.model()
        library = sources.library(base)
        told = digest_of([(e.name, e.build) for e in library])[:16]  # before any is asked, which may fill its caches
        included = sources.included(library)
        model = with_effects(base, included, self.place("with_effects"))
        several = self.part is not None and self.part.several
        elsewhere = {name for _, name in self.settings.mentioned} if several else ()
        space = sensitivity_space(model.space, self.settings, self.place, adopted, elsewhere)
        hints = parameter_hints(model.space, self.settings)
        taken = self.settings.adopted.parameters if self.settings.adopted else ()
        initial = {**space.values, **{name: model.space[name].value for name in taken if name in model.space}}
        model = replace(model, space=space)
        for name in self.settings.depends_on:
            self._path(name, "depends_on")
        whole, responses = self._measurement(model)
        whole_targets = {} if responses is None else responses.targets
        measured, targets = self._used(whole, whole_targets)
        problem: ForwardProblem
        if isinstance(model, FunctionModel):
            assert isinstance(base, FunctionModel)
            mark = self._fingerprint(fingerprint_of(base, included, model))
            assert responses is not None
            problem = FunctionProblem(
                space, model.function, targets, mark, self._pooled_repeats(responses), responses.shares
            )
        else:
            assert measured is not None and not isinstance(base, FunctionModel)
            if isinstance(model, ModalFunctionModel):
                assert isinstance(base, ModalFunctionModel)
                model = replace(model, identity=self._fingerprint(fingerprint_of(base, included, model)))
            problem = self._problem(model, measured, model.n_modes - base.n_modes)
        selected = search_space(space, self.settings, self.place, elsewhere=elsewhere)
        if not self.settings.calibration.weight_freq + self.settings.calibration.weight_mac > 0:
            raise InputError("both weights are zero", place=self.place("calibration"), remedy="give one of them weight")
        name = f"{self.folder.name}.{self.part.given.name}" if self.part and several else self.folder.name
        return Study(
            name, self.file, self.settings, model, measured, targets, problem, space, selected,
            whole, whole_targets, library, dict(adopted), {n: adopted_sd[n] for n in taken if n in adopted_sd}, initial,
            hints, responses, library_digest=told, part=self.part,
        )  # fmt: skip

    def _fingerprint(self, function: str) -> str:
        """That of a function, its options, all code in the study's folder, and the files that it depends on."""
        given, folder = self.settings, self.folder
        files = StudyFile(folder.name, self.file, given, part=self.part).code_files
        files += [self._path(name, "depends_on") for name in given.depends_on]
        return digest_of(function, given.model_options, digest_of_files(files, folder))[:16]

    # -- measurement ---------------------------------------------------------------------------------------------------

    def _path(self, name: str, *keys: int | str) -> Path:
        path = self.folder / name
        if not path.is_file():
            raise InputError(
                f"there is no file {name!r}", place=self.place(*keys), remedy="paths are relative to the study's folder"
            )
        return path

    def _measurement(self, model: Model) -> tuple[MeasuredModes | None, MeasuredResponses | None]:
        """Everything that was measured, of the kind that the model answers."""
        given = self.settings.measurement
        if isinstance(model, FunctionModel) != bool(given.responses):
            words = (
                "plain responses (responses = '...')" if isinstance(model, FunctionModel) else "modes (files = [...])"
            )
            raise InputError(
                f"the model {model.name!r} is compared with measured {words}", place=self.place("measurement")
            )
        return self.measurement()

    def measurement(self) -> tuple[MeasuredModes | None, MeasuredResponses | None]:
        """Everything that was measured, as the study's file alone tells."""
        given = self.settings.measurement
        if given.responses:
            responses = read_responses(self._path(given.responses, "measurement", "responses"), given.pooling)
            kinds = response_kinds(responses.targets)
            try:
                return None, responses.pooled(kinds).claiming(kinds, given.accuracy)
            except InputError as fault:
                place = self.place("measurement", "accuracy")
                raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
        measured = read_modes(
            [self._path(f, "measurement", "files") for f in given.files],
            shapes=[self._path(f, "measurement", "shapes") for f in given.shapes],
            sensors=self._path(given.sensors, "measurement", "sensors") if given.sensors else None,
            repeats=given.repeats,
            std_of=given.std_of,
            mode_names=given.mode_names,
            pooling=given.pooling,
            synthetic=given.synthetic,
        )
        return replace(measured, accuracy=Accuracy.of(given.accuracy)), None

    def _pooled_repeats(self, responses: MeasuredResponses) -> float | None:
        """Repeats behind the standard deviations of plain responses, as many as tell as much when pooled."""
        told = responses.pooled_repeats
        return self.settings.measurement.repeats if told is None else told

    def _used(self, whole: MeasuredModes | None, whole_targets: Targets) -> tuple[MeasuredModes | None, Targets]:
        """What was measured and is not withheld."""
        held = self.settings.withheld
        for key, names in held.model_dump().items():
            if names and (key == "responses") != (whole is None):
                kind, own = ("plain responses", "responses") if whole is None else ("modes", "modes or sensors")
                raise InputError(
                    f"{key} are withheld, but the study measures {kind}",
                    place=self.place("withheld", key),
                    remedy=f"name {own} under [withheld]",
                )
        if whole is None:
            names = held.responses
            for name in names:
                if name not in whole_targets:
                    raise InputError(f"withheld response {name!r} was not measured", place=self.place("withheld"))
            targets = {name: target for name, target in whole_targets.items() if name not in names}
            if not targets:
                raise InputError(
                    "every measured response is withheld", place=self.place("withheld"), remedy="leave some to fit"
                )
            return None, targets
        try:
            used = whole.without(held.modes, held.sensors)
        except InputError as fault:
            raise InputError(fault.problem, place=self.place("withheld"), remedy=fault.remedy) from None
        if not used.n_modes:
            raise InputError(
                "every measured mode is withheld", place=self.place("withheld"), remedy="leave some to fit"
            )
        if whole.has_shapes and not used.has_shapes:
            raise InputError(
                "every sensor is withheld",
                place=self.place("withheld", "sensors"),
                remedy="leave some to tell the modes apart by",
            )
        return used, {}

    def _problem(
        self, model: StructuralModel | ModalFunctionModel, measured: MeasuredModes, n_added: int
    ) -> ModalProblem:
        """ForwardProblem over what is used; the degrees of freedom that effects added bring as many modes more."""
        pairing = self.settings.pairing
        default = usual_mode_count(measured, model.n_modes - n_added)
        count = pairing.mode_count if pairing.mode_count is not None else default
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
                mode_count=count + n_added,
                threshold=pairing.threshold,
                freq_window=pairing.freq_window,
                override={m: k for m, k in pairing.override.items() if m not in withheld},
            )
        except InputError as fault:
            raise self.misfit(fault) from None

    def misfit(self, fault: InputError) -> InputError:
        """What does not fit between model and measurement, with its place in the study."""
        where = fault.place if fault.place and fault.place.startswith("sensor") else None
        place = f"{self.file}, {where}" if where else self.place("pairing")
        return InputError(fault.problem, place=place, remedy=fault.remedy)
