"""Names of a package that are loaded when they are first used (SPEC 1): the stub beside the package, which editors and
type checkers read, says where each is."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any


def places_of(package_file: str) -> dict[str, str]:
    """The public names of a package and the modules that define them, in the order of its stub."""
    with open(f"{package_file.removesuffix('c')}i", encoding="utf-8") as stub:
        imports = [node for node in ast.parse(stub.read()).body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names if alias.name[0] != "_"}


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


def lazily(package: str, package_file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """__getattr__, __dir__ and __all__ of a package with a stub.  Modules in the package are attributes, too."""
    places = places_of(package_file)

    def load(name: str) -> Any:
        value = loaded(name) if name in places else submodule(package, name)
        if value is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)
        return value

    def loaded(name: str) -> Any:
        try:
            members = vars(import_module(places[name]))
            return members[name] if name in members else submodule(places[name], name)
        except AttributeError as error:  # raised by a module that was loaded: import would say "cannot import name"
            raise ImportError(f"{places[name]} cannot be loaded: {error}") from error

    return load, lambda: [*places, "__all__", "__doc__"], list(places)
