"""A scene as rows of text."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.structure.system import System


def scene_in_words(
    system: System,
    potentials: Iterable[str],
    method: str,
    parameters: Mapping[str, Any],
    barostat: StochasticCellRescaling | None,
) -> Rows:
    """What is simulated, the same for a simulation, a file, and the lines and the page of a run.
    method : its name."""
    units = system.units
    cell = "none, open in all directions"
    if system.cell.is_periodic:
        edges = np.linalg.norm(system.cell.vectors, axis=1)
        lengths = " × ".join([f"{edge:.4g}" for edge in edges])
        directions = " ".join(np.array(list("abc"))[system.cell.pbc])
        cell = f"{lengths} {units.length}, periodic along {directions}"
    atoms = f"{len(system)} atoms ({system.composition})"
    for name, group in system.groups().items():
        if len(group):
            atoms += f"; {len(group)} {name}"
    shown = {
        "timestep": units.shown,
        "temperature": lambda value: f"{value:.10g} {units.temperature}",
        "friction": lambda value: f"{value / units.to_picosecond:.10g} / {units.shown_time}",
        "relaxation_time": units.shown,
    }
    settings = [method]
    for name, value in parameters.items():
        settings.append(f"{name.replace('_', ' ')} {shown.get(name, str)(value)}")
    rows = [("system", atoms), ("cell", cell)]
    if system.constraints:
        rows.append(("constraints", ", ".join(map(repr, system.constraints))))
    for potential in potentials:
        rows.append(("potential", potential))
    rows.append(("method", ", ".join(settings)))
    if barostat is not None:
        rows.append(("barostat", repr(barostat)))
    return rows
