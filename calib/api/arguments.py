"""Arguments of the analyses of a problem: the keys of a study's file, with the same names, defaults and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

from pydantic import BaseModel, ValidationError

from calib.errors.arguments import values
from calib.errors.errors import InputError
from calib.results.former_names import MOVED
from calib.study.search_settings import CalibrationSettings
from calib.study.settings import ExplainSettings, StudySettings

if TYPE_CHECKING:
    import pandas as pd

DEFAULTS = StudySettings.model_construct(title="problem", model="")
"""Settings of a problem that comes from no study."""

_Section = TypeVar("_Section", bound=BaseModel)


class SearchKeys(TypedDict, total=False):
    """Keys of ``[calibration]`` on its genetic search and on the starts of least squares; see `CalibrationSettings`."""

    refine: bool
    weight_freq: float
    weight_mac: float
    population: int
    generations: int
    crossover: float
    mutation: float
    sigma_start: float
    sigma_end: float
    begin_at: Mapping[str, float] | str
    start_population: str | Sequence[Mapping[str, float]] | Sequence[str] | pd.DataFrame


class CalibrationKeys(SearchKeys, total=False):
    """Keys of ``[calibration]`` that steer a calibration; ``alpha`` and ``mesh_sd`` of ``[explain]``, which it shares.

    ``time_limit`` is not among them: a function in this process cannot be ended.
    """

    method: str
    starts: int
    freq_kind: str
    varies: Sequence[str]
    alpha: float
    mesh_sd: float


class ExplainKeys(TypedDict, total=False):
    """Keys of ``[explain]``; the finer mesh itself is an argument, not options of a model."""

    alpha: float
    refits: int
    merge: float
    samples: int
    seed: int
    mesh_sd: float


def with_keys(settings: _Section, verb: str, keys: Mapping[str, Any]) -> _Section:
    """Settings with other values of some keys; InputError for an unknown key or a value that it cannot have.

    None leaves a key as it is.
    """
    arguments = {name: getattr(value, "tolist", lambda value=value: value)() for name, value in keys.items()}
    arguments = {name: value for name, value in arguments.items() if value is not None}
    try:
        return type(settings)(**{name: getattr(settings, name) for name in settings.model_fields_set} | arguments)
    except ValidationError as fault:
        first = fault.errors()[0]
        place = ", ".join([verb, *(str(key) for key in first["loc"])])
        words = str(first["msg"]).removeprefix("Value error, ")
        if first["type"] == "extra_forbidden" and str(first["loc"][-1]) in MOVED:
            raise InputError(
                "there is no such argument any more", place=place, remedy=MOVED[str(first["loc"][-1])]
            ) from None
        if first["type"] == "extra_forbidden":
            known = ", ".join(type(settings).model_fields)
            raise InputError("there is no such argument", place=place, remedy=f"the keys are {known}") from None
        raise InputError(f"it is {first['input']!r:.40}", place=place, remedy=_lower(words)) from None


def calibration_settings(
    settings: StudySettings,
    keys: Mapping[str, Any],
    cases: int | Sequence[int] | None,
    seed: int | None,
    reduction: bool | Mapping[str, Any] | None,
    verb: str = "calibrate",
) -> StudySettings:
    """Settings of a calibration.

    Parameters
    ----------
    settings : StudySettings
        Values of all keys that are not given.
    keys : mapping
        As `CalibrationKeys`. A number of starts asks for ``gauss-newton``, the method that takes it.
    cases : int or sequence of int, optional
        Number of cases, with seeds ``seed, seed + 1, ...``, or their seeds.
    seed : int, optional
        Of the first case; 1 by default.
    reduction : bool or mapping, optional
        Whether large models are reduced, or keys of ``[reduction]``.
    """
    keys = dict(keys)
    explain = with_keys(settings.explain, verb, {name: keys.pop(name, None) for name in ("alpha", "mesh_sd")})
    if keys.get("starts") is not None:
        keys.setdefault("method", "gauss-newton")
    if keys.get("begin_at") is not None and not isinstance(keys["begin_at"], str):
        keys["begin_at"] = values(keys["begin_at"], f"{verb}, begin_at")
    if hasattr(keys.get("start_population"), "to_dict"):
        keys["start_population"] = keys["start_population"].to_dict("records")
    if cases is not None or seed is not None:
        keys["cases"] = _cases(settings.calibration, cases, seed, verb)
    calibration = with_keys(settings.calibration, verb, keys)
    if not calibration.weight_freq + calibration.weight_mac > 0:
        raise InputError("both weights are zero", place=f"{verb}, weight_freq", remedy="give one of them weight")
    update = {"calibration": calibration, "explain": explain, "reduction": _reduction(settings, reduction, verb)}
    return settings.model_copy(update=update)


def explain_settings(
    settings: StudySettings, keys: Mapping[str, Any], reduction: bool | Mapping[str, Any] | None
) -> StudySettings:
    """Settings of an explanation; as `calibration_settings`."""
    explain: ExplainSettings = with_keys(settings.explain, "explain", keys)
    return settings.model_copy(update={"explain": explain, "reduction": _reduction(settings, reduction, "explain")})


class RobustnessKeys(TypedDict, total=False):
    """Keys of ``[robustness]``."""

    samples: int | None
    seed: int | None
    limits: Mapping[str, Sequence[float]]


def robustness_settings(settings: StudySettings, keys: RobustnessKeys) -> StudySettings:
    """Settings of a robustness analysis; limits of responses add to those of the settings, name by name."""
    given = {name: tuple(pair) for name, pair in keys.get("limits", {}).items()}
    every = {**keys, "limits": {**settings.robustness.limits, **given}}
    return settings.model_copy(update={"robustness": with_keys(settings.robustness, "robustness", every)})


class ParetoKeys(TypedDict, total=False):
    """Keys of ``[pareto]``."""

    objectives: Mapping[str, Sequence[str]]
    population: int | None
    generations: int | None
    seed: int | None


def pareto_settings(settings: StudySettings, keys: ParetoKeys) -> StudySettings:
    """Settings of a search for the front of two groups of responses."""
    given = {name: (own,) if isinstance(own, str) else tuple(own) for name, own in keys.get("objectives", {}).items()}
    every = {**keys, "objectives": given or None}
    return settings.model_copy(update={"pareto": with_keys(settings.pareto, "pareto", every)})


def _reduction(settings: StudySettings, reduction: bool | Mapping[str, Any] | None, verb: str) -> Any:
    keys = {"use": reduction} if isinstance(reduction, bool) else reduction or {}
    return with_keys(settings.reduction, f"{verb}, reduction", keys)


def _cases(
    settings: CalibrationSettings, cases: int | Sequence[int] | None, seed: int | None, verb: str
) -> tuple[dict[str, Any], ...]:
    """Cases by number or by seed; without either those of the settings from another seed on."""
    first, count = 1 if seed is None else seed, len(settings.cases) if cases is None else cases
    for name, value in (("seed", first), ("cases", count)):
        if not isinstance(value, Sequence) and (isinstance(value, bool) or int(value) != value):
            raise InputError(f"it is {value!r:.40}", place=f"{verb}, {name}", remedy="give an integer")
    if not isinstance(count, Sequence):
        if count < 1:
            raise InputError(f"it is {count}", place=f"{verb}, cases", remedy="give at least one")
        return tuple({"name": f"C{k + 1}", "seed": int(first) + k} for k in range(int(count)))
    return tuple({"name": f"C{k}", "seed": int(one)} for k, one in enumerate(count, start=1))


def _lower(words: str) -> str:
    return words[:1].lower() + words[1:]
