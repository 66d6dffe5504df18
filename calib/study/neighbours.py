"""Import of modules from a study's folder, and from the folders of the project that the study belongs to."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import ModuleType

PROJECT_SIGNS = ("pyproject.toml", ".git")
"""What makes a folder that of a project."""


def project_folders(folder: Path) -> tuple[Path, ...]:
    """Folders above a study's, the nearest first, up to that of its project; none where it belongs to no project.

    Without a project nothing above the study's folder counts: code of other people may lie there.
    """
    for k, above in enumerate((folder, *folder.parents)):
        if any((above / sign).exists() for sign in PROJECT_SIGNS):
            return tuple(folder.parents[:k])
    return ()


class Neighbours(importlib.abc.MetaPathFinder):
    """Finds modules in the folders of the last entered study, then in those of its project.

    Installed packages take precedence. A file of a study is run once per study, whether the study names it or other
    code of the study imports it. Modules of the previous study are dropped, so that equal names in two studies are two
    modules; those of a project stay as long as studies of the same project are entered, as installed ones do.
    """

    def __init__(self, run: Callable[[Path], ModuleType]):
        self._run = run
        self._folders: tuple[Path, ...] = ()
        self._projects: tuple[Path, ...] = ()
        self._names: set[str] = set()
        self._project_names: set[str] = set()
        self._paths: list[str] = []
        self._modules: dict[Path, ModuleType] = {}

    def enter(self, folders: Sequence[Path], projects: Sequence[Path] = ()) -> None:
        """Search these folders until the next call; modules of the study are loaded afresh.

        ``projects`` are the folders of the project, see `project_folders`.
        """
        if self not in sys.meta_path:
            sys.meta_path.append(self)
        _drop(self._names)
        if tuple(projects) != self._projects and not set(map(str, projects)) >= set(self._paths):
            _drop(self._project_names)
            sys.path[:] = [path for path in sys.path if path not in self._paths]
            self._project_names, self._paths = set(), []
        self._folders, self._projects = tuple(folders), tuple(projects)
        self._names, self._modules = set(), {}
        importlib.invalidate_caches()

    def module(self, path: Path) -> ModuleType:
        """The module of a file, run where it was not yet; raises whatever it raises."""
        path = path.resolve()
        if path not in self._modules:
            self._modules[path] = self._run(path)
        return self._modules[path]

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Part of the import protocol."""
        if path is not None or "." in fullname:
            return None
        for folder in self._folders:
            spec = self._in(folder, fullname)
            if spec is not None:
                self._names.add(fullname)
                return spec
        for folder in self._projects:
            if self._in(folder, fullname) is not None:
                return self._of_project(folder, fullname)
        return None

    def _of_project(self, folder: Path, name: str) -> importlib.machinery.ModuleSpec | None:
        """Found by Python itself from now on, here and in processes that this one starts, which inherit its path."""
        self._project_names.add(name)
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
            self._paths.append(str(folder))
        return importlib.machinery.PathFinder.find_spec(name, [str(folder)])

    def _in(self, folder: Path, name: str) -> importlib.machinery.ModuleSpec | None:
        file, package = folder / f"{name}.py", folder / name
        if (package / "__init__.py").is_file():
            places = [str(package)]
            return importlib.util.spec_from_file_location(
                name, package / "__init__.py", submodule_search_locations=places
            )
        if file.is_file():
            return importlib.machinery.ModuleSpec(name, _Known(self, file), origin=str(file))
        if package.is_dir() and any(package.glob("*.py")):
            spec = importlib.machinery.ModuleSpec(name, None, is_package=True)
            spec.submodule_search_locations = [str(package)]
            return spec
        return None


def _drop(names: Iterable[str]) -> None:
    """Forget modules of these names and those within them."""
    own = set(names)
    for name in [name for name in sys.modules if name.partition(".")[0] in own]:
        del sys.modules[name]


class _Known(importlib.abc.Loader):
    """Returns the module of a file that may already have been loaded under another name."""

    def __init__(self, neighbours: Neighbours, file: Path):
        self.neighbours, self.file = neighbours, file

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return self.neighbours.module(self.file)

    def exec_module(self, module: ModuleType) -> None:
        """It was run when it was made."""
