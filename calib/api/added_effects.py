"""A study with the effects that an explanation named, calibrated in the same way and compared with it before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from calib.analyses import added
from calib.analyses import extend as extension
from calib.analyses.calibration import Fitted
from calib.analyses.versions import write_versions
from calib.api import steps
from calib.missing.explanation import Explanation

S = TypeVar("S", bound=Any)
"""A study of this folder."""


def with_named(study: S, before: Fitted, found: Explanation) -> S | None:
    """The study extended by the named effects and calibrated; None when none is named.

    Parameters
    ----------
    study : Study
        See `calib.api.study.Study`, which asks this.
    before : Fitted
    found : Explanation
    """
    loaded, named = study.loaded, added.to_add(found)
    if named is None:
        study.listener.nothing_added(added.nothing_added(found))
        for one in study.tests:
            added.write_nothing_added(one.one, found, one.folder, study.quick)
        return None
    study.listener.begins(loaded, "extend")
    fitted = {*loaded.search_space.free_names, *(name for e in named.effects for name in e.names)}
    fitted &= set(named.fit.fit_problem.space.free_names)
    begin_at = {name: value for name, value in named.fit.values.items() if name in fitted}
    written = extension.extend_among(loaded, named.names, study.folder.path, begin_at)
    study.listener.extended(written)
    extended: S = replace(study, path=written.file, read=None)
    after = steps.fitted(extended)
    study.listener.begins(loaded, "before and after")
    for own, other in zip(study.tests, extended.tests, strict=True):
        test = own.one.test
        was, now = before.seen(test), after.seen(test)
        answer = added.write_added(own.one, was, named, other.one, now, own.folder, study.quick)
        if not study.quick:
            write_versions(other.one, study.results)
        study.listener.added(answer, written, other.folder)
    return extended
