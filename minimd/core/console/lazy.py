"""Names of a package that are loaded when they are first used (SPEC 1): the stub beside the package, which editors and
type checkers read, says where each is."""

import ast
import sys
from _thread import RLock
from importlib import import_module
from types import ModuleType
from typing import Any

# two threads that load modules which need each other would each see one half loaded
_LOADING = RLock()


def places_of(package: str) -> dict[str, str]:
    """The public names of a package and the modules that define them, in the order of its stub.
    Raises ImportError if the installation has no stub."""
    spec: Any = sys.modules[package].__spec__
    stub = f"{spec.origin.removesuffix('c')}i"
    try:
        text = spec.loader.get_data(stub)  # in a zip, too
    except OSError as error:
        raise ImportError(
            f"{package} needs its stub, {stub}, to find its names; install minimd anew"
        ) from error
    imports = [node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom)]
    return {
        alias.name: node.module or ""
        for node in imports
        for alias in node.names
        if alias.name[0] != "_"
    }


def submodule(package: str, name: str) -> ModuleType | None:
    """The module of this name in a package, loaded; None if there is none."""
    full_name = f"{package}.{name}"
    if name.startswith("_") or not name.isidentifier():
        return None
    try:
        return import_module(full_name)
    except ModuleNotFoundError as error:
        if error.name != full_name:  # it is there, but another one that it needs is not
            raise
        return None


class LazyNames:
    """The public names of a package with a stub; its load and listed serve as __getattr__ and __dir__ of the package.

    places : the module that defines each, by name."""

    def __init__(self, package: str) -> None:
        self.package = package
        self.places = places_of(package)

    def load(self, name: str) -> Any:
        """A public name, or a module in the package.
        Raises AttributeError if it is neither."""
        with _LOADING:
            value = self._defined(name) if name in self.places else submodule(self.package, name)
        if value is None:
            raise AttributeError(f"module {self.package!r} has no attribute {name!r}")
        setattr(sys.modules[self.package], name, value)
        return value

    def listed(self) -> list[str]:
        """The public names."""
        return [*self.places, "__all__", "__doc__"]

    def _defined(self, name: str) -> Any:
        place = self.places[name]
        try:
            members = vars(import_module(place))
            return members[name] if name in members else submodule(place, name)
        except AttributeError as error:
            # raised by a module that was loaded: import would say "cannot import name"
            raise ImportError(f"{place} cannot be loaded: {error}") from error
