"""Modules that have moved, under their old names, with a warning: for one release."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec  # importlib.abc loads fifteen modules
from types import ModuleType
from typing import Any

MOVED = {
    **{f"minimd.{room}": f"minimd.core.{room}" for room in (
        "compiled", "console", "structure", "neighbors", "constraints", "potentials", "forces", "engine",
        "minimization", "diagnosis", "simulation", "files")},
    **{f"minimd.forces.{name}": f"minimd.core.diagnosis.{name}" for name in ("contacts", "evaluation")},
    "minimd.potentials.water": "minimd.scene.water",
    "minimd.potentials.openmm_system": "minimd.openmm.openmm_system",
    "minimd.simulation.past": "minimd.past.past",
    "minimd.simulation.archiving": "minimd.past.archiving",
    "minimd.core.simulation.past": "minimd.past.past",  # from minimd.simulation import past
    "minimd.core.simulation.archiving": "minimd.past.archiving",
    "minimd.integrators.splitting": "minimd.core.integrators",
    "minimd.integrators.method": "minimd.core.integrators.method",
    "minimd.integrators.methods": "minimd.textbook.methods",
    "minimd.integrators.ode": "minimd.textbook.ode",
    "minimd.integrators.dae": "minimd.textbook.dae",
    "minimd.integrators.manifold": "minimd.textbook.manifold",
    "minimd.replay": "minimd.past.replay",
    "minimd.analysis": "minimd.view",
    "minimd.document": "minimd.scene",
    "minimd.grade": "minimd.judge",
    "minimd_bench": "minimd.bench",
}  # fmt: skip
STAYS = {"minimd.grade"}  # no warning: it is the public name
HERE = {"minimd.potentials"}  # a module of its own; what was in the folder has moved


def new_name(name: str) -> str | None:
    """The new name of a module; None if it has not moved."""
    parts = name.split(".") if name not in HERE else []
    for k in range(len(parts), 0, -1):
        new = MOVED.get(".".join(parts[:k]))
        if new is not None:
            return ".".join([new, *parts[k:]])
    return None


class Following:
    """Finds a module under its old name: the same module, so that classes are the same, also in old pickles."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Called by import."""
        new = new_name(name)
        loader: Any = self
        return None if new is None else ModuleSpec(name, loader, origin=new)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module itself."""
        from minimd.old_names import attributes_of, warn  # few scripts need them

        new = spec.origin or ""
        try:
            module = import_module(new)
        except ModuleNotFoundError as error:
            if error.name != new:
                raise
            raise ModuleNotFoundError(f"No module named {spec.name!r}", name=spec.name) from error
        if spec.name not in STAYS:
            warn(f"{spec.name} is {new} now; the old name goes with the next release")
        self._specs.setdefault(new, module.__spec__)
        vars(module).setdefault("__getattr__", attributes_of(new))
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is run again. Import has given the module the spec of its old name: put its own back."""
        module.__spec__ = self._specs[module.__name__]


def follow_moved_modules() -> None:
    """Let import find them, before it finds folders that were left behind with old bytecode: namespace packages."""
    finders: list[Any] = sys.meta_path
    if not any(isinstance(finder, Following) for finder in finders):
        finders.insert(0, Following())
