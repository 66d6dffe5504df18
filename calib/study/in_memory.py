"""A study without a folder: models and tests in memory, with the settings that a study's file holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib.experiment import Test
from calib.problem.effect import Effect
from calib.study.loading import Model
from calib.study.settings import StudySettings
from calib.study.several import AnyStudy, JointStudy
from calib.study.study import LoadedStudy, with_nuisances

FILE = Path("problem")
"""What errors name in place of a study's file."""


@dataclass(frozen=True)
class MemoryStudy(LoadedStudy):
    """One test of a problem in memory, as the analyses take it.

    Attributes
    ----------
    key, label : str
        Fingerprint of the model without the test's condition, and its name; see `LoadedStudy.model_key`.
    among : str
        Name of the test where it is one of several; empty for the only one.
    not_selected : tuple of str
        Parameters that a selection holds at their nominal values.
    finer : StructuralModel, ModalFunctionModel or FunctionModel, optional
        The model on a finer mesh.
    """

    key: str = field(default="", kw_only=True)
    label: str = field(default="", kw_only=True)
    among: str = field(default="", kw_only=True)
    not_selected: tuple[str, ...] = field(default=(), kw_only=True)
    finer: Model | None = field(default=None, kw_only=True)

    in_memory = True

    @property
    def test(self) -> str:
        """Name of the test, where it is one of several."""
        return self.among

    @property
    def condition(self) -> dict[str, float]:
        """Parameter values of this test only, each in its own unit; none of an only test, whose space lacks them."""
        return dict(self.experiment.condition) if self.among else {}

    @property
    def synthetic(self) -> bool:
        """Whether the measurement is synthetic."""
        return self.experiment.synthetic

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """Effects that the model may lack."""
        return self.library

    @property
    def model_key(self) -> str:
        """Same for the tests of one model."""
        return self.key

    @property
    def model_label(self) -> str:
        """Name of the model."""
        return self.label

    @property
    def unselected(self) -> tuple[str, ...]:
        """Parameters that a selection leaves out."""
        return tuple(name for name in self.not_selected if name in self.model.space)

    @property
    def states_mesh(self) -> bool:
        """Whether an explanation counts an error of its mesh: of several models some may have no finer one."""
        return self.finer_model() is not None

    def place(self, *keys: int | str, mark: Any = "value") -> Any:
        """The argument that holds a setting, as an error names it."""
        return ", ".join(str(key) for key in keys) or str(self.file)

    @property
    def has_finer_mesh(self) -> bool:
        """Whether a finer mesh of its model is known."""
        return self.finer is not None

    def on_finer_mesh(self) -> Model | None:
        """The model on a finer mesh, under the condition of the test; None where there is none."""
        return self.finer


@dataclass(frozen=True)
class MemoryJointStudy(JointStudy):
    """Several tests of a problem in memory."""

    in_memory = True

    @property
    def test(self) -> str:
        """Empty: these are all tests together."""
        return ""

    def place(self, *keys: int | str, mark: Any = "value") -> Any:
        """The argument that holds a setting, as an error names it."""
        return ", ".join(str(key) for key in keys) or str(self.file)


@dataclass(frozen=True)
class TestedModel:
    """A model and one of its tests, as a problem in memory joins them.

    Attributes
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
        No condition applied.
    held : the same
        Its parameters fixed as the test's condition says.
    base : the same
        Before effects were added.
    test : ModalTest, FRFTest or ResponseTest
    """

    __test__ = False  # no test of pytest's

    model: Model
    held: Model
    base: Model
    test: Test


def study_in_memory(
    tests: Sequence[TestedModel],
    settings: StudySettings,
    library: Mapping[str, tuple[Effect, ...]],
    not_selected: Sequence[str] = (),
    held_sd: Mapping[str, float] | None = None,
    finer: Callable[[TestedModel], Model | None] = lambda tested: None,
) -> AnyStudy:
    """Models and tests as a study of one test or of several.

    Parameters
    ----------
    tests : sequence of TestedModel
    settings : StudySettings
        Of its analyses.
    library : mapping from str to tuple of Effect
        Effects that models may lack, by the name of the model.
    not_selected : sequence of str
        Parameters that a selection holds at their nominal values.
    held_sd : mapping from str to float, optional
        Standard deviations of held parameters that an earlier study determined.
    finer : callable
        The model on a finer mesh, under the condition of a test; None where there is none.
    """
    parts = tuple(
        _part(
            tested,
            settings,
            library,
            not_selected,
            held_sd or {},
            tested.test.located(finer(tested)),
            tested.test.name * (len(tests) > 1),
        )
        for tested in tests
    )
    return parts[0] if len(parts) == 1 else MemoryJointStudy("problem", FILE, settings, parts)


def _part(
    tested: TestedModel,
    settings: StudySettings,
    library: Mapping[str, tuple[Effect, ...]],
    not_selected: Sequence[str],
    held_sd: Mapping[str, float],
    finer: Model | None,
    among: str,
) -> MemoryStudy:
    test = tested.test
    model, base = test.located(tested.held), test.located(tested.base)
    problem = test.problem(model, base)
    space = with_nuisances(model.space, problem)
    space = space if among else space.without(dict(test.condition))
    return MemoryStudy(
        among or "problem", FILE, settings, model, test, problem, space, space, library.get(model.name, ()),
        {name: model.space[name].value for name in held_sd if name in model.space},
        {name: sd for name, sd in held_sd.items() if name in model.space},
        space.values, key=tested.model.fingerprint, label=model.name, among=among, not_selected=tuple(not_selected),
        finer=finer,
    )  # fmt: skip
