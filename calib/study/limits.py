"""The parameter spaces of a study: the model's parameters with the values, limits and selection of its file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.problem.prior import prior_correlations
from calib.problem.space import LinearConstraint, ParameterSpace
from calib.study.settings import ParameterSettings, StudySettings

PlaceOf = Callable[..., Place]
"""Place of a key of the study, such as ``place("parameters", "K_block")``."""


def sensitivity_space(
    space: ParameterSpace,
    settings: StudySettings,
    place: PlaceOf,
    adopted: Mapping[str, float],
    elsewhere: Collection[str] = (),
) -> ParameterSpace:
    """The model's space with the study's values, limits and constraints; InputError with its place for any fault.

    ``adopted`` are values of parameters that this study holds at the result of another one; ``elsewhere`` are
    parameters of the models of other tests: their keys are ignored here.
    """
    lacking = set(elsewhere) - set(space.names)
    space = _holding(space, settings, place, adopted, lacking)
    for name, change in settings.parameters.items():
        if name in lacking:
            continue
        fields: dict[str, object] = {}
        if change.value is not None:
            fields["value"] = change.value
        if change.limits is not None:
            fields["lower"], fields["upper"] = change.limits
        if change.prior_sd is not None:
            fields["prior_sd"] = change.prior_sd
        for key in ("needed", "scale", "prior"):
            if (stated := getattr(change, key)) is not None:
                fields[key] = stated
        if change.fixed is not None:
            fields["distribution"] = "fixed" if change.fixed else "uniform"
        try:
            space = space.replace(name, **fields)
            if change.search is not None:
                space.widen({name: change.search})
        except InputError as fault:
            where = _of_parameter(space, name, change, place)
            raise InputError(fault.problem, place=where, remedy=fault.remedy) from None
        parameter = space[name]
        if parameter.distribution != "fixed" and not parameter.lower <= parameter.value <= parameter.upper:
            key = "value" if change.value is not None else "limits"
            raise InputError(
                f"value {parameter.value:g} {parameter.unit} is outside its limits "
                f"[{parameter.lower:g}, {parameter.upper:g}]",
                place=place("parameters", name, key).of(f"[parameters.{name}]"),
                remedy="move one of them",
            )
    for k, c in enumerate(settings.constraints):
        if lacking & set(c.coefficients):
            continue
        try:
            own = LinearConstraint(c.name, tuple(c.coefficients.items()), *c.limits, unit=c.unit)
            space = ParameterSpace(space.parameters, (*space.constraints, own))
        except InputError as fault:
            unknown = next((name for name in c.coefficients if name not in space), None)
            if unknown is not None:
                where = place("constraints", k, "coefficients", unknown, mark="key")
            else:
                where = place("constraints", k, *(["limits"] if c.limits[0] > c.limits[1] else []))
            raise InputError(fault.problem, place=where, remedy=fault.remedy) from None
    return _feasible(_correlated(space, settings, place, lacking), "limits", place)


def _correlated(
    space: ParameterSpace, settings: StudySettings, place: PlaceOf, lacking: Collection[str]
) -> ParameterSpace:
    """The space with correlated priors; one that this model lacks stays in the matrix of the others."""
    names, matrix = settings.prior_correlation.parameters, settings.prior_correlation.matrix
    if not names and not matrix:
        return space
    where = place("prior_correlation", *(["matrix"] if matrix else [])).of("[prior_correlation]")
    try:
        for name, own in prior_correlations(names, matrix).items():
            if name not in lacking:
                where = place("prior_correlation", "parameters", names.index(name))
                space = space.replace(name, prior_correlation=own)
    except InputError as fault:
        raise InputError(fault.problem, place=where, remedy=fault.remedy) from None
    return space


def _of_parameter(space: ParameterSpace, name: str, change: ParameterSettings, place: PlaceOf) -> Place:
    """Place of the key that is wrong by itself, else of the parameter's table."""
    what = f"[parameters.{name}]"
    stated = {key: getattr(change, key) for key in ("value", "prior_sd", "needed", "scale", "prior")}
    limits = {"limits": change.limits, "search": change.search}
    tried: list[tuple[str, dict[str, object]]]
    tried = [(key, {key: value}) for key, value in stated.items() if value is not None]
    tried += [(key, {"lower": pair[0], "upper": pair[1]}) for key, pair in limits.items() if pair is not None]
    if name in space:
        for key, fields in tried:
            if _fails(partial(space.replace, name, **fields)):
                return place("parameters", name, key).of(what)
    return place("parameters", name, mark="key").of(what)


def _fails(call: Callable[[], object]) -> bool:
    try:
        call()
    except InputError:
        return True
    return False


UNIT_FACTOR = 100.0
"""Ratio of the study's value to the model's own from which a wrong unit is suspected."""


def parameter_hints(space: ParameterSpace, settings: StudySettings) -> tuple[str, ...]:
    """Warnings of values and limits that differ from the model's own by `UNIT_FACTOR` or more.

    The largest magnitude given is compared with the largest of the model's value and limits; both must be non-zero.
    ``space`` is the model's own.
    """
    out = []
    for name, change in settings.parameters.items():
        if name not in space.names:
            continue
        own = space[name]
        for key, values, known in (
            ("value", (change.value,), (own.value,)),
            ("limits", change.limits or (), (own.lower, own.upper)),
            ("search", change.search or (), (own.lower, own.upper)),
        ):
            sizes = [abs(x) for x in values if x is not None]
            largest, usual = max(sizes, default=0.0), max(abs(x) for x in (*known, own.value))
            if not (largest > 0 and usual > 0):
                continue
            ratio = largest / usual
            if ratio >= UNIT_FACTOR or (key == "value" and ratio <= 1 / UNIT_FACTOR and largest < own.lower):
                out.append(
                    f"[parameters.{name}] {key} is {ratio:.3g} times the model's own ({largest:.4g}; the model has "
                    f"{usual:.4g} {own.unit}): values are in the parameter's own unit."
                )
                break
    return tuple(out)


def _holding(
    space: ParameterSpace,
    settings: StudySettings,
    place: PlaceOf,
    adopted: Mapping[str, float],
    lacking: Collection[str],
) -> ParameterSpace:
    if settings.adopted is None:
        return space
    for k, name in enumerate(settings.adopted.parameters):
        if name in lacking:
            continue
        where = place("adopted", "parameters", k)
        if name in settings.parameters:
            raise InputError(
                f"the parameter {name!r} is adopted and changed as well", place=where, remedy="leave one of them out"
            )
        if name not in adopted:
            raise InputError(
                f"the value of {name!r} is to come from the study {settings.adopted.study!r} and is not known",
                place=where,
                remedy=f"calibrate that study first, with {name!r} among its parameters",
            )
        try:
            space = space.freeze({name: adopted[name]})
        except InputError as fault:
            raise InputError(fault.problem, place=where, remedy=fault.remedy) from None
    return space


def search_space(
    space: ParameterSpace,
    settings: StudySettings,
    place: PlaceOf,
    selection: tuple[str, ...] | None = None,
    elsewhere: Collection[str] = (),
) -> ParameterSpace:
    """The selected parameters within the limits of the search, every other one fixed at its nominal value.

    The selection is that of the study, or ``selection`` where the study leaves it to the sensitivity analysis; without
    either, every free parameter is selected. ``elsewhere`` are parameters that other tests leave free: their keys are
    ignored here.
    """
    if settings.listed is not None:
        names = settings.listed
    else:
        by_measures = selection if settings.selected_by_sensitivity else None
        names = space.free_names if by_measures is None else by_measures
    missing = {name for name in elsewhere if name not in space.free_names}
    names = tuple(name for name in names if name not in missing)
    if not names:
        raise InputError("no parameter is selected", place=place("selection"), remedy="name at least one")
    changes = settings.parameters.items()
    wide = {name: c.search for name, c in changes if c.search is not None and name not in missing}
    try:
        chosen = space.widen(wide).keep(names)
    except InputError as fault:
        selected = settings.listed or ()
        wrong = [k for k, name in enumerate(selected) if name in names and _fails(partial(space.keep, [name]))]
        raise InputError(fault.problem, place=place("selection", *wrong[:1]), remedy=fault.remedy) from None
    for name, value in settings.calibration.begin_values.items():
        if name in missing:
            continue
        _require_inside(chosen, name, value, place("calibration", "begin_at", name))
    return _feasible(chosen, "search limits", place)


def _require_inside(space: ParameterSpace, name: str, value: float, place: Place) -> None:
    if name not in space.free_names:
        raise InputError(f"begin_at names {name!r}, which is not selected", place=place, remedy="select it")
    lower, upper = space[name].lower, space[name].upper
    if not lower <= value <= upper:
        raise InputError(
            f"begin_at has {name} = {value:g}, outside its search limits {lower:g} to {upper:g}", place=place,
            remedy="name a value within them",
        )  # fmt: skip


def _feasible(space: ParameterSpace, label: str, place: PlaceOf) -> ParameterSpace:
    try:
        space.require_feasible()
    except InputError as fault:
        words = f"within the parameters' {label}: {fault.problem}"
        raise InputError(words, place=place("constraints"), remedy=fault.remedy) from None
    return space
