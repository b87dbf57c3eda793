"""Names of a package that are loaded when they are first used (SPEC 1): the stub beside the package, which editors and
type checkers read, says where each is."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def places_of(package_file: str) -> dict[str, str]:
    """The public names of a package and the modules that define them, in the order of its stub."""
    with open(f"{package_file.removesuffix('c')}i", encoding="utf-8") as stub:
        imports = [node for node in ast.parse(stub.read()).body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names if alias.name[0] != "_"}


def lazily(package: str, package_file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """__getattr__, __dir__ and __all__ of a package with a stub."""
    places = places_of(package_file)

    def load(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            place = sys.modules[package] if places[name] == package else import_module(places[name])
            is_there = name in vars(place) or (place is not sys.modules[package] and hasattr(place, name))
            value = getattr(place, name) if is_there else import_module(f"{places[name]}.{name}")
        except AttributeError as error:  # raised by a module that was loaded: import would say "cannot import name"
            raise ImportError(f"{places[name]} cannot be loaded: {error}") from error
        setattr(sys.modules[package], name, value)
        return value

    return load, lambda: [*places, "__all__", "__doc__"], list(places)
