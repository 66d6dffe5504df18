"""Every key of ``study.toml`` with its type, default and validation."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    field_validator,
    model_validator,
)

from calib.errors.errors import InputError
from calib.study.measurement_settings import (
    GENERIC,
    MODEL,
    RUNS,
    HeldOutSettings,
    LibraryText,
    MeasurementSettings,
    Pair,
    PairingSettings,
    PathText,
    Section,
    Seed,
    TestSettings,
    WrongBelow,
)
from calib.study.search_settings import CalibrationSettings, ParetoSettings, ReductionSettings
from calib.study.solver_settings import ComputeSettings, SolverSettings

_GRACE = 10.0
"""Seconds that a process has to end a solver that takes too long, and to tell what it said."""


class ParameterSettings(Section):
    """``[parameters.NAME]``: changes to one parameter of the model, in its own unit."""

    value: float | None = None
    """Nominal value."""
    limits: Pair | None = None
    """Lower and upper limit; the range of the sensitivity analysis."""
    search: Pair | None = None
    """Lower and upper limit of the calibration; by default ``limits``."""
    prior_sd: float | None = Field(default=None, gt=0)
    """Standard deviation of the prior; by default that of a uniform distribution between the limits. A parameter that
    is not selected is uncertain by it. Of a log-normal prior it is ``value`` times that of the logarithm."""
    scale: Literal["linear", "log"] | None = None
    """``"log"``: samples, searches, fits, intervals and figures take the logarithm; for limits over several decades."""
    prior: Literal["normal", "log-normal", "heavy-tailed", "uniform"] | tuple[Pair, ...] | None = None
    """What is known before the test: ``"normal"`` about ``value``, ``"log-normal"`` with the median ``value`` (default
    with ``scale = "log"``), ``"heavy-tailed"`` about ``value`` (Cauchy), ``"uniform"`` between the limits, or pairs
    ``[value, density]``."""
    needed: float | None = Field(default=None, gt=0)
    """Largest standard deviation with which it counts as identified; by default 10 % of the nominal value, or the prior
    standard deviation where that value is 0 or a position. Of an integer at most 0.2."""
    fixed: bool | None = None
    """Whether the parameter keeps its value, which counts as exact, in every analysis."""


class AdoptedSettings(Section):
    """``[adopted]``: parameters that are held at the fitted values of another study."""

    study: PathText
    """Folder of that study, relative to this one."""
    parameters: tuple[str, ...] = Field(min_length=1)
    """Parameters that keep the values fitted there."""


class ConstraintSettings(Section):
    """``[[constraints]]``: limits on a weighted sum of parameters."""

    name: str
    """Label in tables and messages."""
    coefficients: dict[str, float]
    """Weight of each parameter in the sum."""
    limits: Pair
    """Lower and upper limit of the sum, in ``unit``; two equal ones make one parameter follow from the others."""
    unit: str = "-"
    """Unit of the sum."""


class PriorCorrelationSettings(Section):
    """``[prior_correlation]``: priors that are not independent."""

    parameters: tuple[str, ...] = ()
    """Parameters in the order of the matrix."""
    matrix: tuple[tuple[float, ...], ...] = ()
    """Correlations of their priors: a row and a column for each, 1 on the diagonal, positive definite."""


class SensitivitySettings(Section):
    """``[sensitivity]``: samples of the sensitivity analysis."""

    samples: int = Field(default=500, ge=3, le=1_000_000)
    """Samples of the Latin hypercube."""
    seed: Seed = 1
    """Seed of the samples."""


_Bound = Annotated[float, Field(allow_inf_nan=True)]


class RobustnessSettings(Section):
    """``[robustness]``: samples of the fitted parameters that are pushed through the model."""

    samples: int = Field(default=500, ge=10, le=1_000_000)
    """Samples of the posterior."""
    seed: Seed = 1
    """Seed of the samples."""
    limits: dict[str, tuple[_Bound, _Bound]] = {}
    """Least and largest allowed value of responses, in their units: ``{ natural_freq_1B = [1.9, inf] }``."""

    @field_validator("limits")
    @classmethod
    def _ordered(cls, limits: dict[str, tuple[_Bound, _Bound]]) -> dict[str, tuple[_Bound, _Bound]]:
        for name, (least, most) in limits.items():
            if not least < most:
                raise WrongBelow(f"limits of {name!r} are not [least, most]", name)
        return limits


class RetrySettings(Section):
    """``retry``: a function of your own is called again where it fails for a reason that passes."""

    pattern: str = Field(min_length=1)
    """Regular expression in the failure's text, such as ``"LICENSE"``."""
    times: int = Field(default=5, ge=1, le=10_000)
    """Further calls at most."""
    wait: float = Field(default=60.0, ge=0, le=1e6)
    """Seconds before each of them; they do not count for ``time_limit``."""

    @field_validator("pattern")
    @classmethod
    def _expression(cls, value: str) -> str:
        try:
            re.compile(value)
        except re.error as fault:
            raise ValueError(f"the pattern is no regular expression ({fault})") from None
        return value


class ExplainSettings(Section):
    """``[explain]``: which physical effect is missing."""

    alpha: float = Field(default=0.01, gt=0, lt=0.5)
    """False-alarm rate: probability of reporting a missing effect when there is none."""
    refits: int = Field(default=6, ge=1, le=10_000)
    """Most promising effects that are fitted together with all parameters."""
    merge: float = Field(default=0.98, gt=0, le=1)
    """Correlation of signatures from which effects count as collinear, unless the data discriminate between them."""
    finer_options: dict[str, Any] = {}
    """Model options of a finer mesh, from which the discretisation error is estimated, in calibrations as well."""
    samples: int = Field(default=10, ge=1, le=100_000)
    """Posterior samples over which the recommended next measurement is averaged."""
    mesh_sd: float | None = Field(default=None, gt=0, le=10)
    """Standard deviation of the error of the mesh, over the change that the mesh of ``finer_options`` makes in the
    predictions; by default the mesh is exact."""
    seed: Seed = 1
    """Seed of all random numbers of the analysis."""


class StudySettings(Section):
    """The whole file: a model, and its measurement under ``[measurement]`` or test by test under ``[[tests]]``.

    Keys of ``base`` hold where this file does not override them, tables key by key and lists as a whole; paths there
    stay relative to their own folder.
    """

    title: str
    """Title in figures and report."""
    model: Annotated[PathText, Field(pattern=MODEL)] | SolverSettings
    """Function that returns the model: ``"file.py:function"`` in the folder, or ``"package.module:function"``; or a
    table of runs, ``"runs.csv"``, with ``model_options = { inputs = [...] }``; or under ``[model]`` a solver."""
    model_options: dict[str, Any] = {}
    """Keyword arguments of that function."""
    depends_on: tuple[PathText, ...] = ()
    """Files that the model reads, such as a solver's input, relative to the folder; results become outdated
    when one changes."""
    decks: tuple[PathText, ...] = ()
    """Templates of a solver's input, with ``{{ NAME }}`` where values of parameters belong, into which ``calib deck``
    writes calibrated values; by default those under ``[model]``."""
    deck_files: tuple[PathText, ...] = ()
    """Files that ``calib deck`` copies beside these as they are; by default the ``files`` under ``[model]``."""
    retry: RetrySettings | None = None
    """When a failed evaluation of that function is repeated: ``{ pattern = "LICENSE", times = 5, wait = 60 }``."""
    effects: LibraryText | tuple[LibraryText, ...] | None = None
    """Function that returns the library of effects that the model may lack, or a list of such functions; ``"generic"``
    among them composes effects of the model's own parts, joints, supports and points."""
    with_effects: tuple[str, ...] = ()
    """Effects of the library that are in the model."""
    base: PathText | tuple[PathText, ...] | None = None
    """Another study whose keys hold where this file does not override them; of several the first that exists."""
    measurement: MeasurementSettings = MeasurementSettings()
    """The measurement."""
    tests: tuple[TestSettings, ...] = ()
    """Several measurements, each with the keys of ``[measurement]``, instead of it."""
    held_out: HeldOutSettings = HeldOutSettings()
    """Data that no fit uses."""
    pairing: PairingSettings = PairingSettings()
    """How measured and model modes are paired."""
    adopted: AdoptedSettings | None = None
    """Parameters held at the fitted values of another study."""
    parameters: dict[str, ParameterSettings] = {}
    """Changes to parameters of the model."""
    constraints: tuple[ConstraintSettings, ...] = ()
    """Linear constraints on parameters, kept by samples and searches."""
    prior_correlation: PriorCorrelationSettings = PriorCorrelationSettings()
    """Correlated priors, kept by samples as well."""
    selection: tuple[str, ...] | Literal["from sensitivity"] | None = None
    """Parameters that are fitted: names, or ``"from sensitivity"``; by default every free one."""
    reduction: ReductionSettings = ReductionSettings()
    """Reduced basis of a search."""
    sensitivity: SensitivitySettings = SensitivitySettings()
    """Sensitivity analysis."""
    calibration: CalibrationSettings = CalibrationSettings()
    """Calibration."""
    robustness: RobustnessSettings = RobustnessSettings()
    """Responses over what is known of the fitted parameters."""
    pareto: ParetoSettings = ParetoSettings()
    """Trade-off between two groups of responses."""
    explain: ExplainSettings = ExplainSettings()
    """Search for a missing effect."""
    compute: ComputeSettings = ComputeSettings()
    """Who evaluates."""

    @field_validator("tests")
    @classmethod
    def _named(cls, tests: tuple[TestSettings, ...]) -> tuple[TestSettings, ...]:
        names = [test.name for test in tests]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise WrongBelow(f"two tests are named {name!r}", k, "name")
        return tests

    @model_validator(mode="after")
    def _measured(self) -> StudySettings:
        own = bool(self.measurement.files or self.measurement.responses)
        if own == bool(self.tests):
            words = "name what was measured, either under [measurement] or test by test under [[tests]]"
            raise WrongBelow(words, *(["measurement"] if own else []))
        for key, default in (("held_out", HeldOutSettings()), ("pairing", PairingSettings())):
            if self.tests and getattr(self, key) != default:
                words = "with [[tests]], held-out and pairing belong to a test: [tests.held_out], [tests.pairing]"
                raise WrongBelow(words, key)
        return self

    @property
    def evaluation_limit(self) -> float:
        """Seconds after which the process of an evaluation is ended: a solver is ended before, by who waits for it."""
        return self.calibration.time_limit + (_GRACE if self.solver is not None else 0.0)

    @property
    def several(self) -> bool:
        """Whether several tests are fitted together."""
        return len(self.tests) > 1

    @property
    def libraries(self) -> tuple[str, ...]:
        """Functions that return the library of effects; `GENERIC` may be among them."""
        if self.effects is None:
            return ()
        return (self.effects,) if isinstance(self.effects, str) else self.effects

    @property
    def functions(self) -> tuple[str, ...]:
        """Functions that build models and effects, as named in the file; a table of runs has none."""
        named = (self.model_name, *self.libraries, *(f for test in self.tests for f in (test.model, test.effects)))
        return tuple(dict.fromkeys(name for name in named if name and name != GENERIC and not name.endswith(RUNS)))

    @property
    def model_name(self) -> str:
        """What ``model`` names, a function or a table; empty for a solver."""
        return self.model if isinstance(self.model, str) else ""

    @property
    def solver(self) -> SolverSettings | None:
        """The solver under ``[model]``."""
        return None if isinstance(self.model, str) else self.model

    @property
    def model_files(self) -> tuple[str, ...]:
        """Files that decide on the model beside its code: those of a solver, ``depends_on``, tables of runs."""
        tables = (self.model_name, *(test.model or "" for test in self.tests))
        of_solver = () if self.solver is None else self.solver.inputs
        return (*of_solver, *self.depends_on, *(name for name in tables if name.endswith(RUNS)))

    @property
    def listed(self) -> tuple[str, ...] | None:
        """The parameters that the study selects by name; None where it names none."""
        return self.selection if isinstance(self.selection, tuple) else None

    @property
    def selected_by_sensitivity(self) -> bool:
        """Whether the selection is left to the sensitivity analysis."""
        return self.selection is not None and self.listed is None

    @property
    def mentioned(self) -> tuple[tuple[tuple[int | str, ...], str], ...]:
        """Every parameter that the file mentions, with its key."""
        selected = self.listed or ()
        adopted = () if self.adopted is None else self.adopted.parameters
        tied = self.prior_correlation.parameters
        constrained = [(k, name) for k, c in enumerate(self.constraints) for name in c.coefficients]
        return (
            *((("parameters", name), name) for name in self.parameters),
            *((("constraints", k, "coefficients", name), name) for k, name in constrained),
            *((("prior_correlation", "parameters", k), name) for k, name in enumerate(tied)),
            *((("adopted", "parameters", k), name) for k, name in enumerate(adopted)),
            *((("selection", k), name) for k, name in enumerate(selected)),
            *((("calibration", "begin_at", name), name) for name in self.calibration.begin_values),
        )

    def of_test(self, name: str) -> StudySettings:
        """Settings of a study with one test alone, its ``set`` values fixed; InputError for an unknown name."""
        known = {test.name: test for test in self.tests}
        if name not in known:
            raise InputError(f"there is no test {name!r}", remedy=f"the tests are {', '.join(known)}")
        test = known[name]
        held = {p: ParameterSettings(value=value, fixed=True) for p, value in test.set.items()}
        other: dict[str, Any] = (
            {} if test.model is None else {"model": test.model, "effects": test.effects, "model_options": {}}
        )
        options = {} if test.model_options is None else {"model_options": test.model_options}
        own = test.model_dump(include=set(MeasurementSettings.model_fields))
        title = f"{self.title}: {name}" if self.several else self.title
        changed = {
            "title": title,
            "tests": (),
            "measurement": MeasurementSettings(**own),
            "held_out": test.held_out,
            "pairing": test.pairing,
            "parameters": {**self.parameters, **held},
            **other,
            **options,
        }
        return self.model_copy(update=changed)
