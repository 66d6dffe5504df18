"""Every key of ``study.toml`` with its type, default and validation."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from calib.errors import InputError
from calib.measurement.accuracy import Accuracy, Claim

Pair = tuple[float, float]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
LONGEST_NAME = 255
"""Bytes in the name of a file or folder that the common file systems allow."""


def possible_path(text: str) -> str:
    """A path that file systems accept; ValueError for any other."""
    if "\0" in text:
        raise ValueError("a path cannot hold a zero character")
    longest = max((len(part.encode("utf-8", "replace")) for part in re.split(r"[/\\]", text)), default=0)
    if longest > LONGEST_NAME or len(text) > 4000:
        raise ValueError(f"a name of {longest} bytes in the path is too long: {LONGEST_NAME} are possible")
    return text


PathText = Annotated[str, AfterValidator(possible_path)]
Share = Annotated[float, Field(ge=0, le=1)]
FUNCTION = r"^[^:]+:[A-Za-z_]\w*$"
"""Names a function: ``"file.py:function"`` in the study's folder, or ``"package.module:function"``."""
NAME = r"^[A-Za-z0-9_-]+$"
"""Name of a case or a test, which names files."""


class WrongBelow(ValueError):
    """A wrong value below the section or list that is checked; ``keys`` lead there."""

    def __init__(self, words: str, *keys: int | str):
        super().__init__(words)
        self.keys = keys


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MeasurementSettings(_Section):
    """``[measurement]``: files, relative to the study's folder.

    ``pooling`` tells whether mean and standard deviation exclude outliers among the repeats (``"robust"``), or whether
    these are only reported (``"plain"``).
    ``accuracy`` is the claimed accuracy beside the repeatability: a share such as ``"1 %"`` of every value, or by kind
    (``freq``, ``damping``, ``shape``; for scalar responses by name or kind) a share or a number in the value's unit.
    """

    files: tuple[PathText, ...] = ()
    shapes: tuple[PathText, ...] = ()
    sensors: PathText | None = None
    responses: PathText | None = None
    mode_names: tuple[str, ...] | None = None
    repeats: int | None = Field(default=None, ge=1, le=1_000_000)
    std_of: Literal["mean", "repeat"] = "mean"
    pooling: Literal["robust", "plain"] = "robust"
    accuracy: str | float | dict[str, str | float] | None = None
    synthetic: bool = False

    @field_validator("accuracy")
    @classmethod
    def _claim(
        cls, given: str | float | dict[str, str | float] | None, info: ValidationInfo
    ) -> str | float | dict[str, str | float] | None:
        claims = given.values() if isinstance(given, dict) else () if given is None else (given,)
        for claim in claims:
            Claim.of(claim)
        if info.data.get("files"):
            Accuracy.of(given)
        elif given is not None and not isinstance(given, dict | str):
            raise ValueError("one accuracy for all responses is a share such as '1 %'; give numbers by response")
        return given

    @model_validator(mode="after")
    def _one_kind(self) -> MeasurementSettings:
        if bool(self.files) == bool(self.responses) and self.model_fields_set:
            raise ValueError("name either measured modes (files = [...]) or scalar responses (responses = '...')")
        return self


class HeldOutSettings(_Section):
    """``[held_out]``: measured modes and sensors, or scalar responses, that no fit uses."""

    modes: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    responses: tuple[str, ...] = ()


class PairingSettings(_Section):
    """``[pairing]``: how measured and model modes are paired."""

    mode_count: int | None = Field(default=None, ge=1, le=1_000_000)
    threshold: Share = 0.3
    freq_window: Pair | None = None
    clusters: dict[str, tuple[str, ...]] = {}
    override: dict[str, int] = {}

    @field_validator("freq_window")
    @classmethod
    def _ordered(cls, window: Pair | None) -> Pair | None:
        if window is not None and not 0 <= window[0] < window[1]:
            raise ValueError(f"the window {list(window)} is not [lower, upper] in Hz")
        return window


class TestSettings(MeasurementSettings):
    """``[[tests]]``: measurements under one condition; files as under ``[measurement]``.

    Attributes
    ----------
    name : str
        Label of this test's results; its tables and figures go to ``<study>.<name>``.
    set : dict
        Parameter values of this test only, each in its own unit.
    held_out : HeldOutSettings
        Data that no fit uses.
    pairing : PairingSettings
    model, model_options, effects
        Another model for this test, other options of the model, and the library of effects of another model.
    """

    __test__ = False  # no test of pytest's

    name: str = Field(pattern=NAME, max_length=100)
    set: dict[str, float] = {}
    held_out: HeldOutSettings = HeldOutSettings()
    pairing: PairingSettings = PairingSettings()
    model: PathText | None = Field(default=None, pattern=FUNCTION)
    model_options: dict[str, Any] | None = None
    effects: PathText | None = Field(default=None, pattern=FUNCTION)


class ParameterSettings(_Section):
    """``[parameters.NAME]``: changes to one parameter of the model, in its own unit."""

    value: float | None = None
    limits: Pair | None = None
    search: Pair | None = None
    prior_sd: float | None = Field(default=None, gt=0)
    fixed: bool | None = None


class AdoptedSettings(_Section):
    """``[adopted]``: parameters that are held at the fitted values of another study.

    Attributes
    ----------
    study : str
        Folder of that study, relative to this one.
    parameters : tuple of str
    """

    study: PathText
    parameters: tuple[str, ...] = Field(min_length=1)


class ConstraintSettings(_Section):
    """``[[constraints]]``: limits on a weighted sum of parameters."""

    name: str
    coefficients: dict[str, float]
    limits: Pair
    unit: str = "-"


class SensitivitySettings(_Section):
    """``[sensitivity]``."""

    samples: int = Field(default=500, ge=3, le=1_000_000)
    seed: Seed = 1


class CaseSettings(_Section):
    """``[[calibration.cases]]``: one run of the search from its own initial population."""

    name: str = Field(pattern=NAME, max_length=100)
    seed: Seed


class ReductionSettings(_Section):
    """``[reduction]``: search on a reduced basis of the model; reported results are always solved at full order."""

    use: bool = True
    tolerance: float = Field(default=1e-5, gt=0, lt=0.1)
    seed: Seed = 1


class CalibrationSettings(_Section):
    """``[calibration]``.

    ``begin_at`` is a further start of least squares, besides the end of each search; ``refine`` tells whether least
    squares follow a search at all.
    """

    method: Literal["genetic", "gauss-newton"] = "genetic"
    refine: bool = True
    starts: int = Field(default=6, ge=1, le=10_000)
    time_limit: float = Field(default=3600.0, gt=0, le=1e7)
    weight_freq: float = Field(default=1.0, ge=0, le=1e12)
    weight_mac: float = Field(default=1.0, ge=0, le=1e12)
    population: int = Field(default=30, ge=4, le=100_000)
    generations: int = Field(default=250, ge=2, le=1_000_000)
    crossover: Share = 0.5
    mutation: Share = 0.15
    sigma_start: float = Field(default=0.10, gt=0, le=1)
    sigma_end: float = Field(default=0.01, gt=0, le=1)
    begin_at: dict[str, float] = Field(default_factory=dict)
    cases: tuple[CaseSettings, ...] = Field(default=(CaseSettings(name="C1", seed=1),), min_length=1)

    @field_validator("cases")
    @classmethod
    def _distinct(cls, cases: tuple[CaseSettings, ...]) -> tuple[CaseSettings, ...]:
        names = [case.name for case in cases]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise WrongBelow(f"two cases are named {name!r}", k, "name")
        return cases


class ExplainSettings(_Section):
    """``[explain]``: which physical effect is missing.

    Attributes
    ----------
    alpha : float
        False-alarm rate: the probability of reporting a missing effect when there is none.
    refits : int
        Number of most promising effects that are calibrated with the whole model.
    merge : float
        Correlation of signatures from which effects count as collinear, unless the data discriminate between them.
    finer_options : dict
        Model options of a finer mesh.
    samples : int
        Posterior samples over which the recommended next measurement is averaged.
    seed : int
    """

    alpha: float = Field(default=0.01, gt=0, lt=0.5)
    refits: int = Field(default=6, ge=1, le=10_000)
    merge: float = Field(default=0.98, gt=0, le=1)
    finer_options: dict[str, Any] = {}
    samples: int = Field(default=10, ge=1, le=100_000)
    seed: Seed = 1


class StudySettings(_Section):
    """The whole file.

    ``base`` is another study whose keys hold where this file does not override them (tables key by key, lists as a
    whole); its paths are relative to its own folder. Of several given places the first that exists counts.
    ``depends_on`` names files, relative to the study's folder, that the model reads, such as a solver's input. The
    measurement is described under ``[measurement]``, or test by test under ``[[tests]]``. Without a ``selection`` every
    free parameter is fitted.
    """

    title: str
    model: PathText = Field(pattern=FUNCTION)
    model_options: dict[str, Any] = {}
    depends_on: tuple[PathText, ...] = ()
    effects: PathText | None = Field(default=None, pattern=FUNCTION)
    with_effects: tuple[str, ...] = ()
    base: PathText | tuple[PathText, ...] | None = None
    measurement: MeasurementSettings = MeasurementSettings()
    tests: tuple[TestSettings, ...] = ()
    held_out: HeldOutSettings = HeldOutSettings()
    pairing: PairingSettings = PairingSettings()
    adopted: AdoptedSettings | None = None
    parameters: dict[str, ParameterSettings] = {}
    constraints: tuple[ConstraintSettings, ...] = ()
    selection: tuple[str, ...] | Literal["from sensitivity"] | None = None
    reduction: ReductionSettings = ReductionSettings()
    sensitivity: SensitivitySettings = SensitivitySettings()
    calibration: CalibrationSettings = CalibrationSettings()
    explain: ExplainSettings = ExplainSettings()

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
    def several(self) -> bool:
        """Whether several tests are fitted together."""
        return len(self.tests) > 1

    @property
    def functions(self) -> tuple[str, ...]:
        """Functions that build models and effects, as named in the file."""
        named = (self.model, self.effects, *(f for test in self.tests for f in (test.model, test.effects)))
        return tuple(dict.fromkeys(name for name in named if name))

    @property
    def mentioned(self) -> tuple[tuple[tuple[int | str, ...], str], ...]:
        """Every parameter that the file mentions, with its key."""
        selected = self.selection if isinstance(self.selection, tuple) else ()
        adopted = () if self.adopted is None else self.adopted.parameters
        constrained = [(k, name) for k, c in enumerate(self.constraints) for name in c.coefficients]
        return (
            *((("parameters", name), name) for name in self.parameters),
            *((("constraints", k, "coefficients", name), name) for k, name in constrained),
            *((("adopted", "parameters", k), name) for k, name in enumerate(adopted)),
            *((("selection", k), name) for k, name in enumerate(selected)),
            *((("calibration", "begin_at", name), name) for name in self.calibration.begin_at),
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


def schema() -> dict[str, Any]:
    """JSON schema of ``study.toml``, with which editors complete and check its keys."""
    keys = StudySettings.model_json_schema()
    needed = keys.pop("required")
    either = [{"required": needed}, {"required": ["base"]}]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **keys, "anyOf": either}
