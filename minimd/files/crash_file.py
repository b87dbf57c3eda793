"""The file that a failed run leaves: an H5MD file with the last good state, an earlier one, and what it takes to go there again.

frames               the earlier state and the last good one, with forces and observables; the restart is the last good one
minimd/crash_report       findings, method, options and potentials in words, as JSON
    positions ...    the earlier state to the last bit
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from minimd.diagnosis.causes import Moment
from minimd.diagnosis.crash_report import SUFFIX, CrashReport
from minimd.files.h5md_schema import opened
from minimd.files.h5md_writer import H5MDWriter, read_file
from minimd.integrators import SPLITTINGS, THERMOSTATS, Splitting
from minimd.structure.system import System

if TYPE_CHECKING:
    from minimd.simulation.simulation import Simulation


@dataclass(frozen=True)
class CrashFile:
    """What such a file holds.

    findings : CrashReport.  system : System in the earlier state, with its constraints.  start : that state.  method : as it was.
    precision, skin, noise_shift : of the simulation.  potentials : in words.  scene, title : texts; the scene is empty if the run came from a script.
    """

    findings: CrashReport
    system: System
    start: Moment
    method: Splitting
    precision: Any
    skin: float | None
    noise_shift: int
    potentials: list[str]
    scene: str
    title: str


def free_name(path: Path, overwrite: bool) -> Path:
    """The path; where a file stands there that may not be replaced, the first free one with a number."""
    suffix = SUFFIX if path.name.endswith(SUFFIX) else path.suffix
    stem, number, found = path.name.removesuffix(suffix), 1, path
    while found.exists() and not overwrite:
        number += 1
        found = path.with_name(f"{stem}-{number}{suffix}")
    return found


def write_crash_report(path: Path, simulation: "Simulation", findings: CrashReport) -> None:
    """Write the file of a simulation that has just failed and stands in its last good state, where it is left.

    Raises
    ------
    OSError : if it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")  # so that nothing half written stands where somebody looks for a crash report
    try:
        _write(part, simulation, findings)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _write(path: Path, simulation: "Simulation", findings: CrashReport) -> None:
    last, start = simulation.moment, simulation.failed_from or simulation.moment
    writer = H5MDWriter(path, simulation, store_forces=True)
    try:
        for moment in (start, last):
            simulation.go_to(moment)
            writer.write(simulation.frame())
    finally:
        simulation.go_to(last)
        writer.close(completed=False)
    with opened(path, "r+") as h5:
        group = h5.create_group("minimd/crash_report")
        group["positions"], group["velocities"] = start.positions, start.velocities
        group.attrs.update({"step": np.int64(start.step), "time": np.float64(start.time), "heat": np.float64(start.heat)})
        group["findings"] = json.dumps(findings.asdict())
        group["simulation"] = json.dumps(_description(simulation))
        group["words"] = str(findings)


def _description(simulation: "Simulation") -> dict[str, Any]:
    method, options = simulation.method, simulation.options
    return {
        "method": method.name,
        "parameters": method.parameters,
        "precision": options.precision,
        "skin": options.skin,
        "noise_shift": simulation.noise_shift,
        "potentials": [f"{type(one).__name__}: {one!r}" for one in simulation.potentials],
    }


def read_crash_report(path: str | Path) -> CrashFile:
    """What the file of a failed run holds.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as minimd.h5md.read_file, or if it is not the file of a failed run.
    """
    contents = read_file(path)
    with opened(path, "r") as h5:
        if "minimd/crash_report/simulation" not in h5:
            raise ValueError(f"file {str(path)!r} holds no crash report; give the .crash.h5md file of a run that failed")
        group = h5["minimd/crash_report"]
        told, findings = (json.loads(group[name].asstr()[()]) for name in ("simulation", "findings"))
        at = group.attrs
        start = Moment(int(at["step"]), float(at["time"]), group["positions"][:], group["velocities"][:], float(at["heat"]))
    methods = {**SPLITTINGS, **THERMOSTATS}
    if told["method"] not in methods:
        raise ValueError(
            f"the run in {str(path)!r} was made with the method {told['method']!r}, which is not one of minimd; run it again from its script"
        )
    system = contents.system
    system.positions[:], system.velocities[:] = start.positions, start.velocities
    return CrashFile(
        findings=CrashReport.of(findings),
        system=system,
        start=start,
        method=methods[told["method"]](**told["parameters"]),
        precision=told["precision"],
        skin=told["skin"],
        noise_shift=told["noise_shift"],
        potentials=told["potentials"],
        scene=contents.scene,
        title=contents.title,
    )
