"""Figures and the HTML report of a fit, drawn from the same tables as those of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from calib.analyses.answers import of_fit
from calib.analyses.calibration_tables import before_and_after, tables_of, write_calibration
from calib.analyses.compare import ComparisonResult, comparison_at, write_comparison
from calib.analyses.joint_responses import own_values
from calib.analyses.provenance.record import assumptions_of, limits_table, made_with, sensors_table
from calib.api.protocols import Solved
from calib.correlation.modal.expansion import orthogonality
from calib.errors.errors import InputError
from calib.execution.temporary import TemporaryFolder
from calib.experiment import Test
from calib.experiment.test import Model, test_place
from calib.inference.cases import CaseResult
from calib.problem.joint import stacked
from calib.problem.problem import Counts
from calib.results.results import Results
from calib.results.written import whole
from calib.study.study import LoadedStudy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from calib.api.display import Compared


CASE = "fit"
"""Name of the only case of a fit in tables."""


FIGURES = (
    "frequency_errors", "mac", "mac_matrix", "comac", "cross_orthogonality", "self_orthogonality", "parameters",
)  # fmt: skip
"""Figures of a fit."""


def compared_stages(fit: Solved, test: Test) -> tuple[ComparisonResult, ComparisonResult]:
    """One test before the fit, at the nominal values, and after it."""
    one = _part(fit, test)
    if fit.calibration is not None:
        found = fit.calibration.seen(one.test)
        return found.before, found.best.answer
    return comparison_at(one, one.model.space.values), comparison_at(one, own_values(one, fit.values))


def _part(fit: Solved, test: Test) -> LoadedStudy:
    """A test with its model, as the analyses take them."""
    return next(one for one in fit.problem.study().studies if one.experiment.name == test.name)


def figures_of(fit: Solved) -> tuple[str, ...]:
    """Names of the figures that a fit can draw of at least one of its tests."""
    modal = [modes for _, test in fit.problem.pairs if (modes := test.fitted_modes) is not None]
    if not modal:
        return ("parameters",)
    return FIGURES if any(modes.has_shapes for modes in modal) else ("frequency_errors", "parameters")


def chosen_test(fit: Solved, name: str) -> tuple[Model, Test]:
    """The test of that name with its model, or the only one; InputError for an unknown name, or none of several."""
    pairs = {test.name: (model, test) for model, test in fit.problem.pairs}
    if not name and len(pairs) == 1:
        return next(iter(pairs.values()))
    if name not in pairs:
        what = f"there is no test {name!r}" if name else f"there are {len(pairs)} tests"
        raise InputError(what, place="figure", remedy=f"name one of them: {', '.join(pairs)}")
    return pairs[name]


def draw_figure(fit: Solved, name: str, test: str, ax: Axes | None) -> Axes:
    """See `calib.api.fit.Fit.figure`."""
    from calib.report.parameters import draw_parameters

    if name not in FIGURES:
        raise InputError(f"there is no figure {name!r}", place="figure", remedy=f"the figures are {', '.join(FIGURES)}")
    _, selected = chosen_test(fit, test)
    if name == "parameters":
        tables = _tables(fit)
        wide = tables.get("unexplained_calibrated")
        return draw_parameters(tables["parameters"], ax, prior=fit.problem.space.frame(), with_misfit=wide)
    if (modes := selected.fitted_modes) is None:
        raise InputError("it has no modes", place=test_place(selected), remedy="draw its parameters")
    _require_shapes(name, modes.has_shapes, test_place(selected))
    return _draw_stages(name, *compared_stages(fit, selected), ax)


def comparison_figures(found: Compared) -> tuple[str, ...]:
    """Names of the figures that a comparison can draw of at least one of its tests."""
    modal = [one.comparison for one in found.by_test.values() if one.comparison is not None]
    shapes = any(comparison.measured.has_shapes for comparison in modal)
    return FIGURES[:-1] if shapes else FIGURES[:1] * bool(modal)


def draw_comparison_figure(found: ComparisonResult, name: str, place: str, ax: Axes | None) -> Axes:
    """See `calib.api.display.Compared.figure`."""
    if name not in FIGURES[:-1]:
        known = ", ".join(FIGURES[:-1])
        raise InputError(f"there is no figure {name!r}", place="figure", remedy=f"the figures are {known}")
    if found.comparison is None:
        raise InputError("it has no modes", place=place, remedy="name a test of modes")
    _require_shapes(name, found.comparison.measured.has_shapes, place)
    return _draw_stages(name, found, None, ax)


def _require_shapes(name: str, has_shapes: bool, place: str) -> None:
    if name != "frequency_errors" and not has_shapes:
        raise InputError("no shapes were measured", place=place, remedy="draw the frequency errors")


def _draw_stages(name: str, before: ComparisonResult, after: ComparisonResult | None, ax: Axes | None) -> Axes:
    """A figure of modes, before a fit and after it; matrices are those of the latter."""
    from calib.report.comparison import draw_comac, draw_frequency_error, draw_mac, draw_mac_matrix
    from calib.report.orthogonality import draw_cross_orthogonality, draw_self_orthogonality

    if name == "frequency_errors":
        return draw_frequency_error(before.table, None if after is None else after.table, ax)
    if name == "mac":
        return draw_mac(before.table, None if after is None else after.table, ax)
    first, last = before.comparison, (after or before).comparison
    assert first is not None and last is not None
    if name == "mac_matrix":
        return draw_mac_matrix(last.mac_table(), ax)
    if name == "cross_orthogonality":
        return draw_cross_orthogonality(orthogonality(last).cross_table(), ax)
    if name == "self_orthogonality":
        return draw_self_orthogonality(orthogonality(last).self_table(), ax)
    return draw_comac(first.comac_table(), None if after is None else last.comac_table(), ax)


def write_page(fit: Solved, path: Path) -> Path:
    """See `calib.api.fit.Fit.report`."""

    def write(model: Model, test: Test, folder: Results) -> None:
        _write(fit, model, test, folder)

    return _page(fit.problem.pairs, path, write, lambda folder: _write_together(fit, folder))


def write_comparison_page(found: Compared, path: Path) -> Path:
    """See `calib.api.display.Compared.report`."""
    pairs = [(one.model, one.experiment) for one in found.studies.values()]

    def write(model: Model, test: Test, folder: Results) -> None:
        answer = found.by_test[test.name]
        write_comparison(folder, answer, "before")
        _write_inputs(model, test, folder)
        told = {"compare": ((*answer.sentences, *found.notes), found.answer_of(test.name).plain)}
        _write_record(_named(model, test), folder, told)

    return _page(pairs, path, write, lambda folder: _write_record(_all_named(pairs), folder, {}))


def _page(
    pairs: Sequence[tuple[Model, Test]],
    path: Path,
    write: Callable[[Model, Test, Results], None],
    write_together: Callable[[Results], None],
) -> Path:
    """A page of the tables that ``write`` puts into a folder for each test, and ``write_together`` for several."""
    from calib.report.html.study_results import StudyResults
    from calib.report.html.write import page

    several = len(pairs) > 1
    with ExitStack() as stack:
        tests = []
        for number, (model, test) in enumerate(pairs, 1):
            folder = stack.enter_context(TemporaryFolder())
            write(model, test, Results(folder))
            title = f"{model.name} against {test.name}"
            part = (test.name, f"test{number}-") if several else ("", "")
            tests.append(StudyResults(folder, title, test.synthetic, {}, "", (), *part))
        if several:
            folder = stack.enter_context(TemporaryFolder())
            write_together(Results(folder))
            models = " and ".join(dict.fromkeys(model.name for model, _ in pairs))
            title = f"{models} against {', '.join(test.name for _, test in pairs)}"
            synthetic = any(one.synthetic for one in tests)
            text = page(StudyResults(folder, title, synthetic, {}, "", tuple(tests)))
        else:
            text = page(tests[0])
    try:
        with whole(path) as draft:
            draft.write_text(text, encoding="utf-8")
    except OSError as fault:
        raise InputError(f"it cannot be written ({fault.strerror})", place=path, remedy="name another place") from None
    return path


def _write_together(fit: Solved, folder: Results) -> None:
    """Write the tables of all tests together: parameters, what is assumed, and the answer."""
    pairs, space = fit.problem.pairs, fit.problem.space
    for name, table in _tables(fit).items():
        folder.write_table(name, table)
    folder.write_table("parameter_space", limits_table(space, space))
    assumed = {test.name: assumptions_of(model, test.assumed) for model, test in pairs}
    folder.write_table("assumptions", stacked(assumed))
    stages = {test.name: compared_stages(fit, test) for _, test in pairs}
    answer = of_fit(fit.statistics, fit.parameters.reset_index(), stages)
    answer = answer if fit.calibration is None else fit.calibration.answer
    _write_record(_all_named(pairs), folder, {"calibrate": (fit.sentences, answer.plain)})


def _write(fit: Solved, model: Model, test: Test, folder: Results) -> None:
    """Write the tables that the report reads."""
    before, after = compared_stages(fit, test)
    write_comparison(folder, before, "before")
    if fit.calibration is None:
        write_comparison(folder, after, "after")
        for name, table in _tables(fit).items():
            folder.write_table(name, table)
        summary = {"best_case": CASE, "method": "gauss-newton", **before_and_after(before, after)}
        folder.write_json("summary", {**summary, "noise_mac": after.noise_mac})
    else:
        one = _part(fit, test)
        own = fit.calibration.seen(one.test)
        write_calibration(one, folder, own, "gauss-newton" if own.best.search is None else "genetic", 0.0)
    errors = fit.errors
    folder.write_table("data_errors", errors[errors["test"] == test.name].drop(columns="test"))
    space = fit.problem.space
    folder.write_table("parameter_space", limits_table(space, space))
    _write_inputs(model, test, folder)
    answer = of_fit(fit.statistics, fit.parameters.reset_index(), {"": (before, after)})
    answer = answer if fit.calibration is None else fit.calibration.answer
    told = {"compare": (before.sentences, before.answer.plain), "calibrate": (fit.sentences, answer.plain)}
    _write_record(_named(model, test), folder, told)


def _write_inputs(model: Model, test: Test, folder: Results) -> None:
    """Write what the results rest on: assumptions and sensors."""
    folder.write_table("assumptions", assumptions_of(model, test.assumed))
    if (modes := test.measured_modes) is not None and modes.has_shapes:
        folder.write_table("sensors", sensors_table(modes, test.held_out_sensors))


def _write_record(named: str, folder: Results, told: Mapping[str, tuple[Sequence[str], Mapping[str, str]]]) -> None:
    """Write what each analysis says of models, in words: its sentences and its answer."""
    analyses = {
        name: {**made_with(name), "quick": False, "sentences": list(sentences), "answer": answer}
        for name, (sentences, answer) in told.items()
    }
    folder.write_json("record", {"notebook": True, "model": named, "analyses": analyses})


def _named(model: Model, test: Test) -> str:
    return f"{model.name} ({test.pair(model).fingerprint})"


def _all_named(pairs: Sequence[tuple[Model, Test]]) -> str:
    return ", ".join(dict.fromkeys(_named(model, test) for model, test in pairs))


def _tables(fit: Solved) -> dict[str, pd.DataFrame]:
    """The tables of a fit, in the form of a study's."""
    if fit.calibration is not None:
        tables: Mapping[str, pd.DataFrame] = fit.calibration.tables
        return dict(tables)
    result = CaseResult.fitted(CASE, fit.statistics.values, Counts(), pd.DataFrame(), 0.0)
    return tables_of(fit.problem.space, [(result, fit.statistics)], fit.statistics)
