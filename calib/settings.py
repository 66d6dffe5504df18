"""What may stand in ``study.toml``: every key with its type, default and check."""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
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
    """A path that an operating system can be asked for; ValueError for any other."""
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


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MeasurementSettings(_Section):
    """``[measurement]``: files, relative to the study's folder.

    ``pooling`` says whether mean and scatter go without what disagrees with the other repeats at a strict level
    (``"robust"``), or whether it is only named (``"plain"``).
    ``accuracy`` is what is claimed beside the repeatability: a share such as ``"1 %"`` of every value, or by kind
    (``freq``, ``damping``, ``shape``; of plain responses by name or kind), shares or numbers in the value's own unit.
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
        if bool(self.files) == bool(self.responses):
            raise ValueError("name either measured modes (files = [...]) or plain responses (responses = '...')")
        return self


class WithheldSettings(_Section):
    """``[withheld]``: measured modes and sensors, or plain responses, that no fit ever sees."""

    modes: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    responses: tuple[str, ...] = ()


class PairingSettings(_Section):
    """``[pairing]``: how measured and model modes find each other."""

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


class ParameterSettings(_Section):
    """``[parameters.NAME]``: changes to one parameter of the model, in its own unit."""

    value: float | None = None
    limits: Pair | None = None
    search: Pair | None = None
    prior_sd: float | None = Field(default=None, gt=0)
    fixed: bool | None = None


class AdoptedSettings(_Section):
    """``[adopted]``: parameters that another study has found; here they are held at its values.

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

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    seed: Seed


class ReductionSettings(_Section):
    """``[reduction]``: search on a reduced basis of the model; what is reported is always solved at full order."""

    use: bool = True
    tolerance: float = Field(default=1e-5, gt=0, lt=0.1)
    seed: Seed = 1


class CalibrationSettings(_Section):
    """``[calibration]``.

    ``begin_at`` names values of parameters from which least squares begins too, beside where a search ended;
    ``polish`` tells whether least squares follow a search at all.
    """

    method: Literal["genetic", "gauss-newton"] = "genetic"
    polish: bool = True
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
    cases: tuple[CaseSettings, ...] = Field(min_length=1)

    @field_validator("cases")
    @classmethod
    def _distinct(cls, cases: tuple[CaseSettings, ...]) -> tuple[CaseSettings, ...]:
        names = [case.name for case in cases]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two cases are named {name!r}")
        return cases


class ExplainSettings(_Section):
    """``[explain]``: which physical effect is missing.

    Attributes
    ----------
    alpha : float
        Chance of calling something missing when nothing is.
    refits : int
        Most promising effects that are calibrated with the whole model.
    merge : float
        Correlation from which on effects count as one, unless the signal at hand tells them apart.
    finer_options : dict
        Model options of a finer discretisation.
    draws : int
        Points of the posterior over which the advice on what to measure next is averaged.
    seed : int
    """

    alpha: float = Field(default=0.01, gt=0, lt=0.5)
    refits: int = Field(default=6, ge=1, le=10_000)
    merge: float = Field(default=0.98, gt=0, le=1)
    finer_options: dict[str, Any] = {}
    draws: int = Field(default=10, ge=1, le=100_000)
    seed: Seed = 1


class StudySettings(_Section):
    """The whole file.

    ``depends_on`` names files, relative to the study's folder, that the model reads: input of a solver, tables.
    """

    title: str
    model: PathText = Field(pattern=FUNCTION)
    model_options: dict[str, Any] = {}
    depends_on: tuple[PathText, ...] = ()
    effects: PathText | None = Field(default=None, pattern=FUNCTION)
    with_effects: tuple[str, ...] = ()
    extended_from: PathText | None = None
    measurement: MeasurementSettings
    withheld: WithheldSettings = WithheldSettings()
    pairing: PairingSettings = PairingSettings()
    adopted: AdoptedSettings | None = None
    parameters: dict[str, ParameterSettings] = {}
    constraints: tuple[ConstraintSettings, ...] = ()
    selection: tuple[str, ...] | Literal["from sensitivity"]
    reduction: ReductionSettings = ReductionSettings()
    sensitivity: SensitivitySettings = SensitivitySettings()
    calibration: CalibrationSettings
    explain: ExplainSettings = ExplainSettings()


def schema() -> dict[str, Any]:
    """JSON schema of ``study.toml``, by which editors complete and check its keys."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **StudySettings.model_json_schema()}


def read_settings(file: Path) -> StudySettings:
    """Read and check a study file; InputError names file, line, key and remedy."""
    try:
        text = file.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise InputError(
            "there is no such study file",
            place=file,
            remedy="name a folder that holds a study.toml, or make one with 'calib new'",
        ) from None
    except UnicodeDecodeError as fault:
        raise InputError(f"it is not UTF-8 text (byte {fault.start})", place=file, remedy="save it as UTF-8") from None
    except OSError as fault:
        raise InputError(f"it cannot be read ({fault.strerror})", place=file) from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise InputError(f"it is not valid TOML: {fault}", place=file, remedy="mend that line") from None
    try:
        return StudySettings.model_validate(data)
    except ValidationError as fault:
        raise _explain(fault, file, text) from None
    except RecursionError:
        raise InputError("it is nested too deeply", place=file) from None


def _explain(fault: ValidationError, file: Path, text: str) -> InputError:
    """The first complaint in one sentence, with its line; an unknown key comes first, which may be the missing one."""
    first = min(fault.errors(), key=lambda error: error["type"] != "extra_forbidden")
    keys = tuple(first["loc"])
    label = ".".join(str(k) for k in keys) or "the file"
    line = line_of(text, keys)
    place = f"{file}, line {line}" if line else str(file)
    kind, words = first["type"], first["msg"].removeprefix("Value error, ")
    given = repr(first.get("input"))
    given = given if len(given) < 60 else given[:57] + "..."
    if kind == "extra_forbidden":
        known = _known_keys(keys[:-1])
        near = difflib.get_close_matches(str(keys[-1]), known, n=1, cutoff=0.5)
        return InputError(
            f"unknown key {label!r}" + (f" (did you mean {near[0]!r}?)" if near else ""),
            place=place,
            remedy=f"the keys known there are {', '.join(known)}" if known else None,
        )
    if kind == "missing":
        return InputError(f"{label!r} is missing", place=place, remedy="add it")
    if kind == "value_error":
        return InputError(f"{label}: {words}", place=place)
    return InputError(f"{label} = {given} is not allowed: {words[:1].lower() + words[1:]}", place=place)


def _known_keys(keys: tuple[int | str, ...]) -> list[str]:
    section: Any = StudySettings
    for key in keys:
        if isinstance(key, int) or not (isinstance(section, type) and issubclass(section, BaseModel)):
            continue
        field = section.model_fields.get(str(key))
        section = _section_of(field.annotation) if field is not None else section
    return list(section.model_fields) if isinstance(section, type) and issubclass(section, BaseModel) else []


def _section_of(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _section_of(part)
        if found is not None:
            return found
    return None


def line_of(text: str, keys: tuple[int | str, ...]) -> int | None:
    """Line (from 1) that most likely holds a key of a TOML text; None when it cannot be told."""
    names = [str(k) for k in keys if not isinstance(k, int)]
    index = next((k for k in keys if isinstance(k, int)), None)
    lines = text.splitlines()
    section, seen, best = "", -1, None
    for number, line in enumerate(lines, start=1):
        header = re.match(r"\s*\[\[?\s*([^\]]+?)\s*\]\]?", line)
        if header and "=" not in line.split("#")[0]:
            section = header.group(1).replace('"', "").replace("'", "")
            seen = seen + 1 if line.lstrip().startswith("[[") else -1
            if section == ".".join(names) and (index is None or seen < 0 or seen == index):
                return number
            continue
        key = re.match(r"""\s*["']?([A-Za-z0-9_.-]+)["']?\s*=""", line)
        if not key:
            continue
        path = [p for p in (*section.split("."), *key.group(1).split(".")) if p]
        if path == names[: len(path)] and (index is None or seen < 0 or seen == index):
            if len(path) == len(names):
                return number
            best = number
    return best
