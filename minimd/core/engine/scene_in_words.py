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
    pressure = units.shown_pressure

    def levels(value: Any, factor: float, unit: str) -> str:
        """A number in a unit, or those of a ramp with their steps."""
        if isinstance(value, float | int):
            return f"{factor * value:.10g} {unit}"
        points = (f"{factor * level:.10g} at {n}" for n, level in value)
        return f"{unit} by steps: {', '.join(points)}"

    shown = {
        "timestep": units.shown,
        "temperature": lambda value: levels(value, 1.0, units.temperature),
        "friction": lambda value: f"{value / units.to_picosecond:.10g} / {units.shown_time}",
        "relaxation_time": units.shown,
        "pressure": lambda value: levels(value, units.to_shown_pressure, pressure),
        "compressibility": lambda value: f"{value / units.to_shown_pressure:.10g} per {pressure}",
    }

    def settings(kind: str, of: Mapping[str, Any]) -> str:
        told = [f"{name.replace('_', ' ')} {shown.get(name, str)(of[name])}" for name in of]
        return ", ".join([kind, *told])

    rows = [("system", atoms), ("cell", cell)]
    if system.constraints:
        rows.append(("constraints", ", ".join(map(repr, system.constraints))))
    for potential in potentials:
        rows.append(("potential", potential))
    rows.append(("method", settings(method, parameters)))
    if barostat is not None:
        rows.append(("barostat", settings("stochastic cell rescaling", barostat.stated)))
    mass = "m"
    picosecond = ""
    if not units.is_reduced:
        mass = "u"
        picosecond = f", of which {units.to_picosecond**-1:.5g} make a ps"
    numbers = (
        f"of potentials: lengths in {units.length}, energies in {units.energy}, masses in {mass}, "
        f"times in {units.time}{picosecond}"
    )
    return [*rows, ("units", numbers)]
