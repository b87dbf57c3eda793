"""minimd: a molecular-dynamics mini-engine, fast and exact. Its modules are described in docs/architecture.md.

Public names are loaded when they are first used; __init__.pyi says where each is.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

from minimd.core.console import __version__ as __version__
from minimd.core.console.annexes import provide
from minimd.core.console.lazy import LazyNames, submodule
from minimd.moved import follow_moved_modules

# in which people look for a name that is not here
ROOMS = "integrators", "observers", "lattice", "units"
ELSEWHERE = "; docs/where-is.md has words of other programs, docs/limits.md what is not here"
HIDDEN = {"ensemble", "grade", "replay", "view", "water"}  # modules behind functions of these names

_names = LazyNames(__name__)
__all__ = sorted(_names.places)
provide("observers by kind", "minimd.observers:KINDS")
provide("potentials of a scene", "minimd.scene.document:potentials_of_scene")
follow_moved_modules()


class Face(ModuleType):
    """This module. A function keeps its name when a package of that name is loaded: md.view is the function."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in HIDDEN):
            super().__setattr__(name, value)

    def __reduce__(self) -> Any:
        """For cloudpickle, which knows modules by their type, and else would copy what functions of a script use."""
        return import_module, (self.__name__,)


sys.modules[__name__].__class__ = Face


def __getattr__(name: str) -> Any:
    """A public name, or a package of minimd, such as the bridge to LAMMPS, loaded when it is first used."""
    if name in _names.places:
        return _names.load(name)
    module = submodule(__name__, name)
    if module is not None:
        return module
    hint = "" if name.startswith("_") else _hint(name)
    raise AttributeError(f"module 'minimd' has no attribute {name!r}{hint}")


def _hint(name: str) -> str:
    """Where a name is that is not here, what is in its place, or a public name that is nearly the same."""
    from minimd.core.console.words import near
    from minimd.foreign_words import answer_to

    for room in ROOMS:
        module = _names.load(room)
        if name in getattr(module, "__all__", dir(module)):
            return f"; it is minimd.{room}.{name}{answer_to(name, str)}"
    return answer_to(name) or near(name, __all__) or ELSEWHERE


def __dir__() -> list[str]:
    """The public names only; other modules of minimd can be imported, too."""
    return [*__all__, "__all__", "__doc__", "__version__"]
