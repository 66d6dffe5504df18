"""A study with several tests, which are fitted and explained together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.errors.toml_places import Mark
from calib.problem.effect import Effect
from calib.problem.joint import joined
from calib.problem.space import ParameterSpace
from calib.study.loading import lacking
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class JointStudy(StudyFile):
    """Models and measurements of a study with several tests, checked.

    Attributes
    ----------
    studies : tuple of Study
        Each test as a study of its own, in the order of the file.
    """

    studies: tuple[LoadedStudy, ...]

    in_memory: ClassVar[bool] = False
    """See `LoadedStudy.in_memory`."""

    @staticmethod
    def load(
        path: str | Path, adopted: Mapping[str, float] = _NONE, adopted_sd: Mapping[str, float] = _NONE
    ) -> JointStudy:
        """Read a study folder (or its TOML file) with everything it names; see `calib.study.study.LoadedStudy.load`."""
        file = StudyFile.read(path_of(path, "study"))
        studies = tuple(LoadedStudy.load(file.file, adopted, adopted_sd, test.name) for test in file.settings.tests)
        for study in studies:
            for name in study.condition:
                if name not in study.model.space:
                    raise InputError(
                        f"the model of test {study.test} has no parameter {name!r}",
                        place=study.place("set", name, mark="key"),
                        remedy="correct its name",
                    )
        for keys, name in file.settings.mentioned:
            if not any(name in study.search_space for study in studies):  # a test's own parameters, too
                mark: Mark = "value" if isinstance(keys[-1], int) else "key"
                place = file.place(*keys, mark=mark)
                raise InputError(
                    f"neither a model nor a test has a parameter {name!r}", place=place, remedy="correct its name"
                )
            if keys[0] == "selection" and not any(name in study.search_space.free_names for study in studies):
                raise InputError(
                    f"parameter {name!r} is fixed in every test and cannot be selected", place=file.place(*keys),
                    remedy="leave it out",
                )  # fmt: skip
        return JointStudy(file.name, file.file, file.settings, studies)

    def each(self, change: Callable[[LoadedStudy], LoadedStudy]) -> JointStudy:
        """A copy with ``change`` applied to the study of every test."""
        return replace(self, studies=tuple(map(change, self.studies)))

    @cached_property
    def search_space(self) -> ParameterSpace:
        """All parameters except those that a test's condition sets; free are those that a fit moves."""
        return joined({s.test: s.search_space.without(s.condition) for s in self.studies})

    @property
    def space(self) -> ParameterSpace:
        """All parameters, those of the tests' nuisances included; see `search_space`."""
        return self.search_space

    @property
    def repeats(self) -> None:
        """None: each test has its own number."""
        return

    @property
    def adopted(self) -> Mapping[str, float]:
        """Values adopted from an earlier study."""
        return {name: value for study in self.studies for name, value in study.adopted.items()}

    @property
    def held_sd(self) -> dict[str, float]:
        """Standard deviations of the held parameters whose values are uncertain."""
        return {name: sd for study in self.studies for name, sd in study.held_sd.items()}

    @property
    def library(self) -> tuple[Effect, ...]:
        """Every effect of the libraries, whether in a model or not."""
        return tuple({e.name: e for study in self.studies for e in study.library}.values())

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """Effects of the library that the models lack."""
        return lacking(self.library, self.settings.with_effects)

    @property
    def included(self) -> tuple[Effect, ...]:
        """Effects that are in the models."""
        return tuple({e.name: e for study in self.studies for e in study.included}.values())


AnyStudy = LoadedStudy | JointStudy


def load(path: str | Path, adopted: Mapping[str, float] = _NONE, adopted_sd: Mapping[str, float] = _NONE) -> AnyStudy:
    """A study with one test or with several; see `calib.study.study.LoadedStudy.load`."""
    several = StudyFile.read(path_of(path, "study")).settings.several
    return (JointStudy if several else LoadedStudy).load(path, adopted, adopted_sd)
