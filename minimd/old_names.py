"""What a script or a pickle of an earlier version gets that asks for a module by its old name, see moved.py: a warning,
and the classes of the module under their old names.  For one release."""

import sys
import warnings
from collections.abc import Callable
from typing import Any

from minimd.core.console.lazy import submodule

RENAMED = {  # by module, under its new name: old and new names
    "minimd.bench.engines": {"Engine": "LoadedEngine"},
    "minimd.core.compiled.fixed_point": {"Steps": "GridSteps"},
    "minimd.core.compiled.normal_numbers": {"Stream": "NoiseStream"},
    "minimd.core.compiled.snapshot": {"Snapshot": "FunctionSnapshot"},
    "minimd.core.constraints.closed_forms": {"Molecules": "TriatomicMolecules"},
    "minimd.core.constraints.groups": {"Pairs": "LoneBonds"},
    "minimd.core.constraints.networks": {"Memory": "NetworkScratch"},
    "minimd.core.diagnosis.report": {"Drift": "DriftRate"},
    "minimd.core.engine.cell_rescaling": {"Molecules": "StrainedBodies"},
    "minimd.core.engine.record_picture": {"Series": "DrawnRecord"},
    "minimd.core.forces.cluster_loop": {"Work": "LoopWork"},
    "minimd.core.forces.cluster_term": {"Evaluation": "ClusterEvaluation"},
    "minimd.core.integrators.steps": {"Counting": "StepCounting", "Evaluation": "ForceSource"},
    "minimd.core.neighbors.cluster_memory": {"Memory": "ClusterMemory"},
    "minimd.core.neighbors.cluster_search": {"Work": "SearchMemory"},
    "minimd.core.neighbors.search": {"Grid": "BinGrid"},
    "minimd.core.simulation.engine_attribute": {"Measured": "MeasuredAttribute"},
    "minimd.ensemble.workers": {"Worker": "WorkerProcess"},
    "minimd.judge.findings": {"Measured": "Measurement"},
    "minimd.judge.forces": {"Forces": "Probe"},
    "minimd.judge.problems": {"Problem": "TrialProblem"},
    "minimd.judge.scenes": {"Springs": "AnharmonicSprings"},
    "minimd.lammps.program": {"Program": "LammpsProgram"},
    "minimd.observers.radial_distribution": {"Counting": "PairCounting"},
    "minimd.textbook.ode.functions": {"Field": "VectorField"},
}


def attributes_of(module: str) -> Callable[[str], Any]:
    """The __getattr__ of a module that is asked for by its old name: classes under their old names; and the modules in
    a package, which were its attributes when an import loaded them all."""

    def load(name: str) -> Any:
        new = RENAMED.get(module, {}).get(name)
        value = submodule(module, name) if new is None else getattr(sys.modules[module], new)
        if value is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return value

    return load


def warn(message: str) -> None:
    """Warn at the line of the user, below the frames of minimd and of import."""
    frame: Any = sys._getframe(1)
    while frame.f_back is not None and _root_of(frame) in ("minimd", "importlib"):
        frame = frame.f_back
    module = frame.f_globals.get("__name__", "")
    warnings.warn_explicit(
        message, DeprecationWarning, frame.f_code.co_filename, frame.f_lineno, module
    )


def _root_of(frame: Any) -> str:
    """The package to which the code of a frame belongs."""
    root, _, _ = frame.f_globals.get("__name__", "").partition(".")
    return str(root)
