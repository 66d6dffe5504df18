"""The test of a study with which figures and reports begin: the one in which the named effect shows most."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar

from calib.problem.joint import TEST
from calib.results.results import Results


class _OfTest(Protocol):
    @property
    def test(self) -> str:
        """Name of the test; empty where there is only one."""
        ...


T = TypeVar("T", bound=_OfTest)


def first_test(folder: Results) -> str:
    """The test that `calib.missing.pattern.reduction_table` marks; empty where no effect is named, and without it."""
    from calib.missing.pattern import BY_TEST
    from calib.report.tables import read_results

    name = f"{BY_TEST}.csv"
    if not folder.has(name):
        return ""
    table = read_results(folder.path / name, ["effects", TEST], flags=["shown_first"], may_be_empty=True)
    return next(iter(table.loc[table["shown_first"].astype(bool), TEST].astype(str)), "")


def first_test_first(parts: Iterable[T], folder: Results) -> tuple[T, ...]:
    """The parts of a study, of which `first_test` comes first; all others in the order of the study."""
    first = first_test(folder)
    return tuple(sorted(parts, key=lambda part: part.test != first))
