"""Import of modules from a study's folder by the code in that folder."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType


class Neighbours(importlib.abc.MetaPathFinder):
    """Finds modules in the folders of the last entered study; installed packages take precedence.

    A file is run once per study, whether the study names it or other code of the study imports it. Modules of the
    previous study are dropped, so that equal names in two studies are two modules.
    """

    def __init__(self, run: Callable[[Path], ModuleType]):
        self._run = run
        self._folders: tuple[Path, ...] = ()
        self._names: set[str] = set()
        self._modules: dict[Path, ModuleType] = {}

    def enter(self, folders: Sequence[Path]) -> None:
        """Search these folders until the next call; modules are loaded afresh."""
        if self not in sys.meta_path:
            sys.meta_path.append(self)
        within = tuple(f"{name}." for name in self._names)
        for name in [n for n in sys.modules if n in self._names or (within and n.startswith(within))]:
            del sys.modules[name]
        self._folders = tuple(folders)
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
        return None

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


class _Known(importlib.abc.Loader):
    """Returns the module of a file that may already have been loaded under another name."""

    def __init__(self, neighbours: Neighbours, file: Path):
        self.neighbours, self.file = neighbours, file

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return self.neighbours.module(self.file)

    def exec_module(self, module: ModuleType) -> None:
        """It was run when it was made."""
